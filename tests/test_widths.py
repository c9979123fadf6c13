"""Suggested widths: the law once more and slowly, shapes of known width, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import layerfix
from layerfix import Layer, LayerStack, load_printer
from layerfix.commands.options import Options
from layerfix.commands.widths import WidthOptions, suggest
from layerfix.errors import InputError
from layerfix.layers.widths import MAX_CANDIDATES, Widths, candidates_mm, suggest_widths
from tests import slow_metric, slow_twin
from tests.making import box, thin_part, write_stl
from tests.pictures_as_text import block, drawing, framed, images, picture, round_dot, strip
from tests.test_correction import SYMMETRIES

EIGHT = np.ones((3, 3))  # neighbours of a solid pixel; those of the void are scipy's usual four
SIZES = st.sampled_from([1, 63, 64, 65, 130])
SHAPES = ("blobs", "parts", "strokes", "stripes")
pitches = st.one_of(st.just((1.0, 1.0)), st.tuples(st.just(1.0), st.floats(0.6, 1.6)))


@st.composite
def layers(draw: st.DrawFn) -> np.ndarray:
    """Images at random, some of which print: enlarged, or without what a disc of 4 or 6 px does not reach."""
    scale = draw(st.sampled_from([1, 1, 4, 6, 9, 14]))
    image = draw(images(widths=SIZES, heights=st.integers(1, 70 // scale + 20), kinds=SHAPES))
    if scale > 1:
        shape = image.shape
        return np.kron(image, np.ones((scale, scale), bool))[: shape[0] * 3, : shape[1]]
    width = draw(st.sampled_from([0.0, 4.0, 6.0]))
    return opening(image, width, (1.0, 1.0)) if width else image


@st.composite
def ranges(draw: st.DrawFn, widest: float = 2.5) -> dict[str, float]:
    """min_mm, max_mm and step_mm at pixels of about 1 mm."""
    low = draw(st.floats(3.3, 8))
    return {
        "min_mm": low,
        "max_mm": low * draw(st.floats(1, widest)),
        "step_mm": draw(st.sampled_from([0.25, 0.5, 0.7, 1.0])),
    }


def suggested(*images_: np.ndarray, pixel_mm: float | tuple[float, float] = 1.0, **how: float) -> Widths:
    """`suggest_widths` for a stack of images."""
    return suggest_widths(LayerStack.from_images(images_, pixel_mm=pixel_mm, layer_mm=0.2), **how)


def width_of(image: np.ndarray, pixel_mm: float, low: float, high: float, step: float = 0.05, **how: float) -> float:
    """The suggestion for one layer; 0 if it is too thin for all."""
    found = suggested(image, pixel_mm=pixel_mm, min_mm=low, max_mm=high, step_mm=step, **how)
    return 0.0 if found.too_thin[0] else float(found.width_mm[0])


# The slow twin


def opening(solid: np.ndarray, width_mm: float, pixel_mm: tuple[float, float]) -> np.ndarray:
    """S ∘ F(d), F by its size: the pixels whose centres lie within d / 2 of a pixel's centre or corner."""
    return slow_metric.opening(solid, width_mm / pixel_mm[0], width_mm / pixel_mm[1])


def reach(solid: np.ndarray, kept: np.ndarray, pixel_mm: tuple[float, float]) -> float:
    """How far from what is kept the farthest lost pixel is, in mm."""
    if not (solid & ~kept).any():
        return 0.0
    if not kept.any():
        return math.inf
    return float(ndimage.distance_transform_edt(~kept, sampling=pixel_mm[::-1])[solid & ~kept].max())


def same_topology(solid: np.ndarray, kept: np.ndarray) -> bool:
    """One part of kept ⊆ solid in each part of solid, and one void of kept round each of solid's."""
    for inner, outer, neighbours in ((kept, solid, EIGHT), (~solid, ~kept, None)):
        labels, count = ndimage.label(outer, neighbours)
        if ndimage.label(inner, neighbours)[1] != count or len(np.unique(labels[inner])) != count:
            return False
    return True


def twin(
    image: np.ndarray, widths: np.ndarray, pixel_mm: tuple[float, float], loss_mm: float
) -> tuple[list[bool], list[bool]]:
    """For each candidate: whether the law holds, and whether what breaks it would break it for the widest, too."""
    solid = np.pad(image, 1)
    limits = np.maximum(widths / 4, loss_mm) + max(pixel_mm)
    holds, for_good = [], []
    for width, limit in zip(widths, limits, strict=True):
        kept = opening(solid, width, pixel_mm)
        far, same = reach(solid, kept, pixel_mm), same_topology(solid, kept)
        holds.append(same and far <= limit + 1e-9)
        for_good.append(not same or far > limits[-1] + 1e-9)
    return holds, for_good


@settings(max_examples=400)
@given(
    layers(),
    ranges(),
    pitches,
    st.one_of(st.just(0.0), st.floats(0, 3)),
)
def test_the_suggestion_is_the_widest_that_the_twin_lets_pass(image, between, pixel_mm, loss_mm):
    """Every candidate tried slowly: the suggestion holds and the next does not, nor does any wider one.

    Openings by digital discs are not nested: in about one random image of a thousand a candidate breaks the topology
    and a wider one does not. "Any wider" is not asked for there.
    """
    widths = candidates_mm(**between)
    found = suggested(image, pixel_mm=pixel_mm, loss_mm=loss_mm, **between)
    holds, for_good = twin(image, widths, pixel_mm, loss_mm)
    picked = -1 if found.too_thin[0] else int(np.flatnonzero(widths == found.width_mm[0])[0])
    shown = f"{holds}\n{drawing(image)}"
    assert picked < 0 or holds[picked], shown
    assert picked == len(widths) - 1 or not holds[picked + 1], shown
    if for_good == sorted(for_good):
        assert picked == max((k for k, held in enumerate(holds) if held), default=-1), shown
    if found.too_thin[0]:
        assert found.width_mm[0] == pytest.approx(between["min_mm"])


def test_where_openings_are_not_nested_the_widest_may_be_missed():
    """A digital disc of 6 px parts this plate at its notch, those of 4.5, of 6.5 and 7 px do not."""
    image = picture("""
        # # # # # . . . .
        # # # # # # # # #
        # # # # # # # # #
        # # # # # # # # #
        # # # # # # # # #
        # # # # # # . . #
        # # # # # # . . .
        . # # # # # . . .
    """)
    holds, for_good = twin(image, candidates_mm(3, 7, 0.5), (1.0, 1.0), 0.0)
    assert holds == [True, True, True, False, True, True, False, True, True]
    assert for_good != sorted(for_good)
    found = suggested(image, min_mm=3, max_mm=7, step_mm=0.5)
    assert not found.too_thin[0]
    assert holds[int(2 * (found.width_mm[0] - 3))]
    assert suggested(image, min_mm=6.5, max_mm=7, step_mm=0.5).width_mm[0] == 7


@given(layers(), ranges(), pitches)
def test_a_larger_loss_never_narrows_what_the_twin_lets_pass(image, between, pixel_mm):
    """Whatever holds with a loss holds with a larger one; so a layer that was not too thin is not with more loss."""
    strict = suggested(image, pixel_mm=pixel_mm, **between)
    for loss_mm in (1.0, 3.0):
        found = suggested(image, pixel_mm=pixel_mm, loss_mm=loss_mm, **between)
        _, for_good = twin(image, candidates_mm(**between), pixel_mm, loss_mm)
        if for_good == sorted(for_good):
            assert found.width_mm[0] >= strict.width_mm[0]
            assert not found.too_thin[0] or strict.too_thin[0]


@given(layers(), ranges(), pitches, st.sampled_from([*SYMMETRIES]))
def test_a_layer_gets_the_same_however_it_lies(image, between, pixel_mm, name):
    """Mirrored and turned: the same width, area and outline, with the pixels turned along."""
    turned, swaps = SYMMETRIES[name]
    one = suggested(image, pixel_mm=pixel_mm, **between)
    other = suggested(turned(image), pixel_mm=pixel_mm[::-1] if swaps else pixel_mm, **between)
    assert (one.width_mm[0], one.too_thin[0]) == (other.width_mm[0], other.too_thin[0])
    assert other.area_mm2 == pytest.approx(one.area_mm2)
    assert other.outline_mm == pytest.approx(one.outline_mm)


@given(layers(), ranges(), st.integers(1, 70))
def test_empty_room_round_a_layer_changes_nothing(image, between, margin):
    """Outside the frame is empty, too."""
    one, other = suggested(image, **between), suggested(framed(image, margin), **between)
    assert (one.width_mm[0], one.too_thin[0]) == (other.width_mm[0], other.too_thin[0])
    assert other.area_mm2 == pytest.approx(one.area_mm2)
    assert other.outline_mm == pytest.approx(one.outline_mm)


# Shapes


def square(side: float, degrees: float, pixel_mm: float) -> np.ndarray:
    """A turned square, in mm, with room on every side."""
    size = int(1.6 * side / pixel_mm)
    y, x = (np.mgrid[:size, :size] - size / 2 + np.array([0.3, 0.2]).reshape(2, 1, 1)) * pixel_mm
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (abs(x * c + y * s) <= side / 2) & (abs(y * c - x * s) <= side / 2)


def wedge(degrees: float, height_mm: float, pixel_mm: float) -> np.ndarray:
    """An isosceles triangle with this angle at its tip, which points up."""
    size = int(1.3 * height_mm / pixel_mm)
    y, x = np.mgrid[:size, :size] * pixel_mm
    y, x = y - 0.1 * height_mm, x - size * pixel_mm / 2 + 0.3 * pixel_mm
    return (y >= 0) & (y <= height_mm) & (abs(x) <= y * math.tan(math.radians(degrees / 2)))


@pytest.mark.parametrize("degrees", range(0, 46, 5))
@pytest.mark.parametrize("side", [1.0, 2.0])
def test_a_square_is_bounded_by_its_side_at_every_turn(side, degrees):
    """Its corners lose 0.207 d, which is less than d/4: the side, or up to two steps (and a pixel) less."""
    width = width_of(square(side, degrees, 0.02), 0.02, 0.5 * side, 1.5 * side)
    assert side - 0.1 - 1e-9 <= width <= side + 1e-9


@pytest.mark.parametrize("degrees", [0, 17, 45, 80, 90, 133])
@pytest.mark.parametrize("across", [0.6, 1.0, 1.6, 2.4])
def test_a_strip_is_bounded_by_its_width(across, degrees):
    """At every angle within a step and two pixels below."""
    wall = strip(across, degrees, length=6, size_px=300, pixel=(0.025, 0.025))
    assert across - 0.1 - 1e-9 <= width_of(wall, 0.025, 0.4, 3) <= across + 1e-9


def test_tips_of_60_degrees_count_and_a_loss_lets_them_pass():
    """A tip of 60° loses d/2, twice the limit; with `loss_mm` the suggestion is about twice the loss."""
    tip = wedge(60, 6, 0.025)
    assert width_of(tip, 0.025, 0.4, 1.2) == 0
    assert width_of(tip, 0.025, 0.4, 1.2, loss_mm=0.15) == 0
    for loss_mm in (0.25, 0.35, 0.5):
        assert 2 * loss_mm - 0.1 - 1e-9 <= width_of(tip, 0.025, 0.4, 1.2, loss_mm=loss_mm) <= 2 * loss_mm + 0.05
    assert width_of(tip, 0.025, 0.4, 1.2, loss_mm=0.7) == 1.2


@pytest.mark.parametrize("degrees", [100, 120, 150])
def test_blunt_tips_do_not_count(degrees):
    """Corners over 90° lose less: such a wedge, cut off at its sharp ends, takes the widest."""
    tip = wedge(degrees, 3, 0.025)
    middle = tip.shape[1] // 2
    assert width_of(tip[:, middle - 40 : middle + 40], 0.025, 0.4, 1.2) == 1.2


@pytest.mark.parametrize("wall", [0.5, 0.8, 1.1])
def test_a_ring_is_bounded_by_its_wall(wall):
    """A step and two pixels below the wall, or the wall."""
    ring = round_dot(3, 301, (0.025, 0.025)) & ~round_dot(3 - wall, 301, (0.025, 0.025))
    assert wall - 0.1 - 1e-9 <= width_of(ring, 0.025, 0.4, 2) <= wall + 0.025


@pytest.mark.parametrize("diameter", [0.6, 1.0, 1.5])
def test_a_dot_is_bounded_by_its_diameter(diameter):
    """Alone, and beside a plate that could take any width, however much may be lost: a part must not go."""
    dot = round_dot(diameter / 2, 101, (0.025, 0.025))
    beside = np.hstack([block(80, 80, 10)[:, :-10], dot[:100]])
    for image, loss_mm in ((dot, 0.0), (beside, 0.0), (beside, 2.0)):
        width = width_of(image, 0.025, 0.4, 2, loss_mm=loss_mm)
        assert diameter - 0.1 - 1e-9 <= width <= diameter + 0.025


@pytest.mark.parametrize("neck_px", [20, 30])
def test_blobs_are_not_parted_at_their_neck(neck_px):
    """Two squares and a neck between: its width, however much may be lost."""
    image = np.zeros((120, 310), bool)
    image[10:110, 10:110] = image[10:110, 200:300] = True
    image[60 - neck_px // 2 : 60 + neck_px // 2, 105:205] = True
    for loss_mm in (0.0, 0.5):
        width = width_of(image, 0.025, 0.4, 2, loss_mm=loss_mm)
        assert neck_px * 0.025 - 0.1 - 1e-9 <= width <= neck_px * 0.025 + 1e-9


def test_a_part_that_goes_is_not_made_up_for_by_one_that_breaks():
    """A dot is lost where two blobs are parted at their neck: two parts before and after, but not the same two."""
    image = np.zeros((120, 380), bool)
    image[10:110, 10:110] = image[10:110, 200:300] = True
    image[50:70, 105:205] = True
    image[50:70, 330:350] = round_dot(9, 21)[:20, :20]
    widths = np.array([0.4, 0.7, 1.0])
    assert slow_twin.topology(opening(image, 0.7, (0.025, 0.025))) == slow_twin.topology(image) == (2, 0)
    assert twin(image, widths, (0.025, 0.025), 3.0)[0] == [True, False, False]
    assert width_of(image, 0.025, 0.4, 1.0, 0.3, loss_mm=3) == 0.4


@pytest.mark.parametrize("wall_px", [20, 30])
def test_a_hole_near_the_edge_stays_a_hole(wall_px):
    """The wall between a slot and the edge is kept, however much may be lost."""
    image = block(200, 200, 5)
    image[5 + wall_px : 11 + wall_px, 60:150] = False
    for loss_mm in (0.0, 1.0):
        width = width_of(image, 0.025, 0.3, 2, loss_mm=loss_mm)
        assert wall_px * 0.025 - 0.1 - 1e-9 <= width <= wall_px * 0.025 + 1e-9
    image[5 + wall_px : 11 + wall_px, 60:150] = True
    assert width_of(image, 0.025, 0.3, 2) == 2


def test_a_joint_at_a_corner_is_too_thin_for_all():
    """Two squares that touch in one point are one part; every opening parts them."""
    image = np.zeros((130, 130), bool)
    image[5:65, 5:65] = image[65:125, 65:125] = True
    assert width_of(image, 0.05, 0.4, 2, loss_mm=1) == 0


def test_pixels_that_are_not_square():
    """A wall of 0.96 mm in pixels of 20 × 30 µm, 30 × 20 µm and 20 × 20 µm, lying and standing."""
    for pixel_mm in ((0.02, 0.03), (0.03, 0.02), (0.02, 0.02)):
        for degrees in (0, 90):
            wall = strip(0.96, degrees, length=4, size_px=280, pixel=pixel_mm)
            width = width_of(wall, pixel_mm, 0.5, 1.5, 0.02)
            assert 0.96 - 0.08 - 1e-9 <= width <= 0.96 + 1e-9, (pixel_mm, degrees)


def test_an_empty_layer_takes_the_widest_bead():
    """Nothing is lost where nothing is."""
    found = suggested(np.zeros((24, 60), bool), block(4, 40, 10), min_mm=6, max_mm=9, step_mm=1)
    assert found.width_mm.tolist() == [9, 6]
    assert found.too_thin.tolist() == [False, True]
    assert found.area_mm2.tolist() == [0, 160]
    assert found.outline_mm[0] == 0


def test_area_and_outline():
    """The area to the pixel; the outline of discs and of squares at every turn within 6 %, of a ring both of its."""
    ring = round_dot(50, 121) & ~round_dot(30, 121)
    found = suggested(ring, pixel_mm=0.05, min_mm=0.4, max_mm=0.5)
    assert found.area_mm2[0] == pytest.approx(ring.sum() * 0.0025)
    assert found.outline_mm[0] == pytest.approx(2 * math.pi * 80 * 0.05, rel=0.01)
    flat = suggested(round_dot(2, 141, (0.03, 0.05)), pixel_mm=(0.03, 0.05), min_mm=0.4, max_mm=0.5)
    assert flat.outline_mm[0] == pytest.approx(4 * math.pi, rel=0.06)
    for degrees in range(0, 46, 15):
        found = suggested(square(2, degrees, 0.02), pixel_mm=0.02, min_mm=0.4, max_mm=0.5)
        assert found.outline_mm[0] == pytest.approx(8, rel=0.06)


# The stack around


def test_heights_survive_and_layers_do_not_depend_on_each_other():
    """z's of any height; each layer gets what it gets alone; the frame's origin plays no part."""
    layers = [block(n, 40, 10) for n in (30, 8, 3, 20)]
    layers = [np.pad(layer, ((0, 50 - len(layer)), (0, 0))) for layer in layers]
    z_mm = np.array([[0, 0.3], [0.3, 0.35], [0.5, 0.6], [0.6, 0.8]])
    plain = LayerStack.from_images(layers, pixel_mm=1.0, layer_mm=0.1)

    def make(index: int) -> Layer:
        return replace(plain[index], z_mm=tuple(z_mm[index]))

    stack = LayerStack(plain.width, plain.height, (1.0, 1.0), z_mm, make, origin_mm=(-3, 7.5))
    found = suggest_widths(stack, min_mm=4, max_mm=12, step_mm=1)
    assert np.array_equal(found.z_mm, z_mm)
    assert len(found) == 4
    alone = [suggested(layer, min_mm=4, max_mm=12, step_mm=1).width_mm[0] for layer in layers]
    assert found.width_mm.tolist() == alone
    assert found.width_mm.tolist() == [12, 8, 4, 12]
    assert found.ranges() == [(0, 0.3, 12), (0.3, 0.35, 8), (0.5, 0.6, 4), (0.6, 0.8, 12)]
    assert (found.range_mm, found.step_mm) == ((4, 12), 1)


def test_any_number_of_workers_finds_the_same_and_the_input_is_untouched():
    """1, 2 and 8 threads over 40 layers."""
    random = np.random.default_rng(5)
    layers = [ndimage.gaussian_filter(random.random((70, 130)), 6) > 0.49 for _ in range(40)]
    stack = LayerStack.from_images(layers, pixel_mm=1.0, layer_mm=0.1)
    found = [suggest_widths(stack.with_workers(n), min_mm=3, max_mm=12, step_mm=0.5) for n in (1, 2, 8)]
    assert len(set(found[0].width_mm.tolist())) > 2
    for other in found[1:]:
        for name in ("width_mm", "too_thin", "area_mm2", "outline_mm"):
            assert np.array_equal(getattr(found[0], name), getattr(other, name)), name
    assert all(np.array_equal(layer.image(), image) for layer, image in zip(stack, layers, strict=True))


def test_it_is_public():
    """As `layerfix.suggest_widths`."""
    assert layerfix.suggest_widths is suggest_widths


# Candidates, and what is refused


@given(st.floats(0.05, 5), st.floats(0, 3), st.floats(0.005, 1))
def test_candidates_begin_and_end_where_they_should(low, room, step):
    """From min to max, rising by one step; the last may be shorter."""
    widths = candidates_mm(low, low + room, step)
    assert widths[0] == pytest.approx(low)
    assert widths[-1] == pytest.approx(low + room, abs=2e-9)
    gaps = np.diff(widths)
    assert gaps[:-1] == pytest.approx(step, abs=3e-9)
    assert (gaps <= step + 3e-9).all()


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"min_mm": 9, "max_mm": 8}, "the narrowest comes first"),
        ({"min_mm": 0, "max_mm": 8}, "the narrowest comes first"),
        ({"min_mm": -2, "max_mm": 8}, "the narrowest comes first"),
        ({"min_mm": 4, "max_mm": math.inf}, "the narrowest comes first"),
        ({"min_mm": math.nan, "max_mm": 8}, "the narrowest comes first"),
        ({"min_mm": 4, "max_mm": 8, "step_mm": 0}, "step 0 mm: it must be above 0"),
        ({"min_mm": 4, "max_mm": 8, "step_mm": -1}, "step -1 mm: it must be above 0"),
        ({"min_mm": 4, "max_mm": 8, "step_mm": math.nan}, "it must be above 0"),
        ({"min_mm": 4, "max_mm": 8, "step_mm": 0.001}, f"4000 widths; at most {MAX_CANDIDATES}"),
        ({"min_mm": 4, "max_mm": 8, "step_mm": 1e-320}, f"at most {MAX_CANDIDATES}"),
        ({"min_mm": 4, "max_mm": 8, "loss_mm": -0.1}, "loss -0.1 mm: it must be 0 or more"),
        ({"min_mm": 4, "max_mm": 8, "loss_mm": math.nan}, "it must be 0 or more"),
        ({"min_mm": 1.9, "max_mm": 8}, "under two pixels"),
    ],
)
def test_what_makes_no_sense_is_refused(how, words):
    """One line that names the value."""
    with pytest.raises(InputError, match=words) as problem:
        suggested(block(20, 20, 2), **how)
    assert "\n" not in str(problem.value)


def test_a_loss_larger_than_the_layer_takes_no_memory():
    """No pixel is farther away than the frame is large."""
    image = np.hstack([block(30, 30, 5), block(4, 20, 18)])
    how = {"min_mm": 3, "max_mm": 12, "step_mm": 1}
    assert suggested(image, loss_mm=1e6, **how).width_mm == suggested(image, loss_mm=80, **how).width_mm


@pytest.mark.parametrize(
    ("printer", "wanted", "words"),
    [
        ("prusa-sl1s", {}, "prusa-sl1s .* has no nozzle"),
        (None, {}, "give --printer"),
        ("prusa-mk3s-0.6", {"min_mm": 0.3}, "0.3 mm: a nozzle of 0.6 mm lays 0.51 mm to 1.2 mm"),
        ("prusa-mk3s-0.6", {"max_mm": 1.3}, "1.3 mm: a nozzle of 0.6 mm lays 0.51 mm to 1.2 mm"),
        ("prusa-mk3s-0.6", {"min_mm": 1.1, "max_mm": 0.9}, "the narrowest comes first"),
        ("prusa-mk3s-0.6", {"slicer": "cura"}, "slicer 'cura' is not known; choose from prusa, orca"),
        ("prusa-mk3s-0.6", {"bands": 0}, "0 bands: a whole number, at least one"),
        ("prusa-mk3s-0.6", {"band_height_mm": -1.0}, "band height -1.0 mm"),
    ],
)
def test_what_a_printer_cannot_do_is_refused(tmp_path, printer, wanted, words):
    """Widths out of the nozzle's range are told the range; printers without a nozzle have none."""
    part = write_stl(tmp_path / "part.stl", box([0, 0, 0], [5, 5, 2]))
    options = Options(printer=load_printer(printer) if printer else None)
    with pytest.raises(InputError, match=words):
        suggest(part, [], options, WidthOptions(**wanted))


def test_thin_layers_are_listed(tmp_path):
    """A fin of 0.1 mm above a plate: the narrowest width from the fin on, and its heights."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    summary = suggest(part, [], Options(printer=load_printer("prusa-mk3s-0.4")), WidthOptions())
    assert summary.too_thin == summary.layers - 3
    assert summary.too_thin_z_mm == ((pytest.approx(0.5), pytest.approx(2.0)),)
    assert summary.ranges[-1][2] == pytest.approx(0.34)


# Corners, and the paper's own words


def turned_box(a: float, b: float, degrees: float, pixel_mm: float) -> np.ndarray:
    """A turned rectangle, in mm, with room on every side."""
    size = int(1.7 * max(a, b) / pixel_mm)
    y, x = (np.mgrid[:size, :size] - size / 2 + np.array([0.3, 0.2]).reshape(2, 1, 1)) * pixel_mm
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (abs(x * c + y * s) <= a / 2) & (abs(y * c - x * s) <= b / 2)


@pytest.mark.parametrize("width_px", [4, 5, 6, 8, 10, 12, 16, 20])
def test_a_right_angle_does_not_count_at_any_turn(width_px):
    """A square of 3 mm and a box of 6 × 4 mm, in steps of 3°, at widths from four pixels on."""
    d = round(0.05 * width_px, 9)
    for degrees in range(0, 90, 3):
        assert width_of(turned_box(3, 3, degrees, 0.05), 0.05, d, d) == d
        assert width_of(turned_box(6, 4, degrees, 0.05), 0.05, d, d) == d


@pytest.mark.parametrize("width_px", [8, 12, 16])
def test_a_sharp_tip_counts_at_every_turn(width_px):
    """A triangle with angles of 60°: its tips lose half the width."""
    y, x = np.mgrid[-80:81, -80:81] * 0.05
    for degrees in range(0, 120, 7):
        turns = np.radians(degrees + np.array([0, 120, 240]))
        triangle = np.all([x * math.cos(t) + y * math.sin(t) <= 1 for t in turns], axis=0)
        d = 0.05 * width_px
        assert width_of(triangle, 0.05, d, d) == 0


def rings_and_walls() -> list[tuple[np.ndarray, float]]:
    """Layers without corners, and how wide they are at their narrowest, in px."""
    y, x = np.mgrid[-90:91, -90:91] + 0.13
    r = np.hypot(x, y)
    found = [((r < 70) & (r >= 70 - w), w) for w in (7, 9.5, 12, 15)]
    found += [((r < 80) & (np.hypot(x - 35, y) > 25) & (np.hypot(x + 35, y) > 35 - gap / 2), 10 + gap / 2)
              for gap in (0, 4)]  # fmt: skip
    for w, degrees in ((8, 0), (8, 31), (11, 17), (14, 45)):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        along, across = x * c + y * s, y * c - x * s
        found.append((np.hypot(np.maximum(abs(along) - 60, 0), across) <= w / 2, w))
    return found


@pytest.mark.parametrize("case", range(10))
def test_both_rules_agree_where_there_are_no_corners(case):
    """Within a pixel of each other, and of the width as drawn."""
    image, wide = rings_and_walls()[case]
    rules = ("opening", "thinning")
    found = [suggested(image, min_mm=4, max_mm=20, step_mm=0.5, rule=rule) for rule in rules]
    opening_mm, thinning_mm = (float(widths.width_mm[0]) for widths in found)
    assert abs(opening_mm - thinning_mm) <= 1
    assert abs(thinning_mm - wide) <= 1
    assert abs(found[0].thinning_mm[0] - wide) <= 1
    assert not any(widths.too_thin[0] for widths in found)


def test_they_part_at_a_blunt_tip_that_thinning_does_not_see():
    """A wedge of 80°: it loses more than a quarter of the width, but its tip is no significant end."""
    y, x = np.mgrid[-60:61, -60:61]
    wedge = (abs(y) <= (x + 50) * math.tan(math.radians(40))) & (x < 40) & (abs(y) < 45)
    wide = {rule: suggested(wedge, min_mm=4, max_mm=30, step_mm=1.0, rule=rule) for rule in ("opening", "thinning")}
    assert wide["thinning"].width_mm[0] == 30
    assert wide["opening"].width_mm[0] < 30


def test_thinning_says_what_correction_says():
    """The width at the narrowest place, as `correct` measures it with the widest candidate."""
    layers = [strip(13, 3 + k) for k in range(5)] + [block(20, 20, 12)]
    size = np.max([one.shape for one in layers], axis=0)
    padded = [np.pad(one, [(0, n - m) for n, m in zip(size, one.shape, strict=True)]) for one in layers]
    stack = LayerStack.from_images(padded, pixel_mm=1.0, layer_mm=0.2)
    found = suggest_widths(stack, min_mm=4, max_mm=12, step_mm=1.0)
    said = [layer.change.thinnest_mm for layer in layerfix.correct(stack, min_feature_mm=12)]
    assert found.thinning_mm.tolist() == pytest.approx([12 if width is None else min(width, 12) for width in said])


def test_thinning_takes_no_loss():
    """It looks at none; nothing is ignored."""
    stack = LayerStack.from_images([np.ones((99, 99), bool)], pixel_mm=0.05, layer_mm=0.2)
    with pytest.raises(InputError, match="a loss of 2 mm goes with the rule 'opening'"):
        suggest_widths(stack, min_mm=0.4, max_mm=0.8, loss_mm=2.0, rule="thinning")
    assert len(suggest_widths(stack, min_mm=0.4, max_mm=0.8, rule="thinning")) == 1


def test_an_unknown_rule_is_refused():
    """And the known ones are named."""
    with pytest.raises(InputError, match="rule='paper' is not known; choose from opening, thinning"):
        suggested(block(9, 9, 3), min_mm=3, max_mm=6, rule="paper")
