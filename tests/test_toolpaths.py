"""Toolpaths: the beads laid back on the layers, infill, order, and what is refused."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from dataclasses import replace
from threading import Lock

import cv2
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import settings as settings_of_hypothesis
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon, box

import layerfix as lf
from layerfix import Layer, LayerStack, PathSettings, plan_toolpaths, settings_for
from layerfix.errors import InputError
from layerfix.fdm import KINDS, LayerPaths, Path
from layerfix.fdm.beads import spacing_mm
from layerfix.fdm.order import in_short_order, short_tour
from layerfix.samples import sample
from tests.beads import (
    LAYER_MM,
    NARROWEST_MM,
    NO_SKIRT,
    OVERLAP_MM,
    PIXEL_MM,
    SPACING_MM,
    WIDEST_MM,
    WIDTH_MM,
    area_of,
    beads_on,
    drawn,
    length_mm,
    lines_of,
    proof,
    shape_of,
    stack_of,
    volume_mm3,
)
from tests.pictures_as_text import KINDS as DRAWERS

PRINTER = "prusa-mk3s-0.4"
INFILL = {"Solid infill", "Top solid infill", "Internal infill"}


def walls(width_mm: float, *lines: list[tuple[float, float]]) -> shapely.Geometry:
    """Walls of one width along lines, cut off square at their ends."""
    return shapely.union_all([LineString(line).buffer(width_mm / 2, cap_style="flat") for line in lines])


def words() -> np.ndarray:
    """Writing in strokes of 0.9 mm, corrected."""
    image = np.zeros((200, 640), np.uint8)
    cv2.putText(image, "layer 8", (20, 150), cv2.FONT_HERSHEY_SIMPLEX, 4.5, 1, 18)
    return lf.correct_image(image.astype(bool), 8, "as_printed")


def of_kind(paths: LayerPaths, *kinds: str) -> list[Path]:
    """Only these."""
    return [path for path in paths.paths if path.kind in kinds]


def same(one: LayerPaths, other: LayerPaths) -> bool:
    """Whether the nozzle does exactly the same."""
    return len(one.paths) == len(other.paths) and all(
        a.kind == b.kind and np.array_equal(a.points_mm, b.points_mm) and np.array_equal(a.width_mm, b.width_mm)
        for a, b in zip(one.paths, other.paths, strict=True)
    )


# The proof: the beads laid back on the layer


@pytest.fixture(scope="module")
def part() -> LayerStack:
    """The built-in test part, corrected: a plate of seven layers, with fins, pins and holes standing on it."""
    sliced = lf.slice_mesh(sample("test-part").mesh(), pixel_mm=PIXEL_MM, layer_mm=LAYER_MM, margin_mm=0.8)
    return lf.correct(sliced, min_feature_mm=0.8, mode="as_printed")


@pytest.fixture(scope="module")
def settings() -> PathSettings:
    return settings_for(lf.load_printer(PRINTER), skirt_loops=0)


@pytest.mark.parametrize("index", [0, 1, 6, 7, 18, 31])
def test_solid_layers_of_the_test_part(part, settings, index):
    """IoU, every component, nothing outside, widths the nozzle can lay, and as much plastic as there is room for."""
    beads = plan_toolpaths(part, replace(settings, density=1.0))[index]
    found = proof(beads.paths, shape_of(part, part[index]))
    assert found.iou >= 0.97
    assert found.least_component > 0.78  # a pin of 0.8 mm, which is F and two beads
    assert found.outside < 0.01
    assert found.astray_mm < 1e-6
    assert found.narrowest_mm >= NARROWEST_MM
    assert found.widest_mm <= WIDEST_MM
    assert found.volume_over_covered == pytest.approx(1, abs=0.03)


def test_every_component_of_the_sparse_part_is_laid(part, settings):
    """With 20 % infill nothing of the outlines is lost either: not a component without a bead of its own."""
    beads = plan_toolpaths(part, settings)
    for index in (5, 12, 31):
        parts = shapely.get_parts(shape_of(part, part[index]))
        tree = shapely.STRtree([shapely.linestrings(path.points_mm) for path in beads[index].paths])
        assert set(tree.query(parts, "intersects")[0].tolist()) == set(range(len(parts)))


def test_a_layer_is_planned_alike_alone_and_among_all(part, settings):
    """Item k, iteration and `each` give the same paths, with any number of workers; the z's are the stack's."""
    few = part[:9]
    alone = [plan_toolpaths(few, settings)[k] for k in (0, 5, 8)]
    for workers in (1, 2, 5):
        planned = plan_toolpaths(few.with_workers(workers), settings)
        every = list(planned)
        assert len(planned) == len(every) == 9
        assert [paths.z_mm for paths in every] == [tuple(z) for z in few.z_mm.tolist()]
        assert all(same(a, every[k]) for a, k in zip(alone, (0, 5, 8), strict=True))
        for layer, paths in planned.each():
            assert layer.z_mm == paths.z_mm
            assert same(paths, every[few.z_mm[:, 1].tolist().index(paths.z_mm[1])])


PICTURES = {
    "plate": box(1, 1, 15, 11),
    "L": box(1, 1, 4, 11) | box(1, 1, 13, 4),
    "ring": Point(7, 7).buffer(6, 64) - Point(7, 7).buffer(3, 64),
    "plate with a hole": box(1, 1, 13, 13) - Point(6, 7).buffer(2.2, 64),
    "wedge": Polygon([(1, 1), (1, 5), (19, 3.4), (19, 2.6)]),
    **{f"T of {w}": walls(w, [(1, 9), (15, 9)], [(8, 9), (8, 1)]) for w in (0.8, 1.0, 1.3, 1.7)},
    **{f"X of {w}": walls(w, [(1, 5), (15, 5)], [(8, 10), (8, 1)]) for w in (0.8, 1.0, 1.3, 1.7)},
    **{f"Y of {w}": walls(w, [(1, 5), (8, 5), (13, 9)], [(8, 5), (13, 1)]) for w in (0.8, 1.0, 1.3, 1.7)},
    **{f"fan at {a}": walls(0.9, [(1, 2), (12, 2)], [(1, 2), (1 + 11 * math.cos(math.radians(a)),
       2 + 11 * math.sin(math.radians(a)))]) for a in (20, 45)},
}  # fmt: skip


@pytest.mark.parametrize("name", [*PICTURES, "words"])
def test_pictures(name):
    """Whatever is at least two beads wide is covered, and nothing beside it; junctions have no gap and no lump."""
    stack = stack_of(words() if name == "words" else drawn((20, 14), PICTURES[name]))
    shape = shape_of(stack, stack[0])
    found = proof(plan_toolpaths(stack, NO_SKIRT)[0].paths, shape)
    assert found.iou >= 0.95
    assert found.outside < 0.02
    assert found.astray_mm < 1e-6
    assert NARROWEST_MM <= found.narrowest_mm <= found.widest_mm <= WIDEST_MM
    assert 0.94 < found.volume_over_covered < 1.035


@pytest.mark.parametrize("width", [0.8, 1.0, 1.3, 1.7])
def test_junctions_are_covered_in_the_middle(width):
    """A disc as wide as the walls, in the middle of an X, a T and a Y, has at most 8 % open and is not laid twice."""
    for name in (f"{letter} of {width}" for letter in "XTY"):
        shape = PICTURES[name]
        beads = beads_on(drawn((20, 14), shape)).paths
        middle = shapely.intersection(Point(8, 9 if name[0] == "T" else 5).buffer(width), shape)
        cover = shapely.intersection(area_of(beads), middle).area
        assert cover > 0.92 * middle.area, name


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("width", np.arange(0.65, 3.01, 0.05).round(2).tolist())
def test_strips_of_two_beads_and_more(width, upright):
    """Covered, nothing beside, and as much plastic as the strip is large, but for its rounded sides (s / w)."""
    lying = box(1, 1, 21, 1 + width)
    image = drawn((22, width + 2), lying)
    stack = stack_of(image.T if upright else image)
    found = proof(plan_toolpaths(stack, NO_SKIRT)[0].paths, shape_of(stack, stack[0]))
    assert found.covered > 0.975
    assert found.outside < 0.023
    assert (width - OVERLAP_MM) / width - 0.03 < found.volume_over_shape < 1.03


@pytest.mark.parametrize("width", np.arange(0.4, 0.61, 0.05).round(2).tolist())
def test_strips_of_one_bead(width):
    """One stroke from end to end, as wide as the strip within two steps of the widths, a little wider at its ends."""
    stack = stack_of(drawn((22, width + 2), box(1, 1, 21, 1 + width)))
    shape = shape_of(stack, stack[0])
    (stroke,) = plan_toolpaths(stack, NO_SKIRT)[0].paths
    found = proof([stroke], shape)
    middles = (stroke.points_mm[1:, 0] + stroke.points_mm[:-1, 0]) / 2
    inner = (middles > 2) & (middles < 20)
    assert abs(stroke.width_mm - width)[inner].max() < 0.045
    assert stroke.width_mm.max() < 1.35 * width
    assert length_mm([stroke]) == pytest.approx(20 - 0.6 * width, abs=0.25)
    assert found.covered > 0.91
    assert found.outside < 0.11
    assert found.astray_mm < 1e-6


@pytest.mark.parametrize("apart", [0.5, 0.6, 0.65, 0.7, 0.75, 0.8])
def test_round_lobes_beyond_a_neck_are_laid(apart):
    """Two pins that touch: each as wide as the printer's least, the neck between them narrower."""
    pins = Point(1.5, 1.5).buffer(0.42, 64) | Point(1.5 + apart, 1.5).buffer(0.42, 64)
    stack = stack_of(drawn((4, 3), pins))
    found = proof(plan_toolpaths(stack, NO_SKIRT)[0].paths, shape_of(stack, stack[0]))
    assert found.covered > 0.93
    assert found.outside < 0.04
    assert found.astray_mm < 1e-6


def test_narrower_than_any_bead_is_laid_with_the_narrowest():
    """Nothing is left out: a hair of one pixel gets a stroke, and the layer says that something came out larger."""
    hair = beads_on(drawn((22, 2), box(1, 1, 21, 1.05)))
    assert {float(w) for path in hair.paths for w in path.width_mm} == {NARROWEST_MM}
    assert 18.7 < length_mm(hair.paths) < 20.1
    speck = beads_on(drawn((2, 2), box(1, 1, 1.1, 1.1)))
    assert len(speck.paths) == 1
    assert speck.small_parts == 1


@pytest.mark.parametrize("diameter", np.arange(0.4, 1.21, 0.1).round(1).tolist())
def test_dots(diameter):
    """Each has one bead that covers it; from two narrow beads on, little beside it: it gets its material."""
    stack = stack_of(drawn((3, 3), Point(1.51, 1.52).buffer(diameter / 2, 64)))
    shape = shape_of(stack, stack[0])
    (bead,) = plan_toolpaths(stack, NO_SKIRT)[0].paths
    found = proof([bead], shape)
    assert found.covered > (0.89 if diameter > 0.65 else 0.75)
    assert found.outside < (0.09 if diameter > 0.65 else 0.9)
    assert found.astray_mm < 1e-6
    assert NARROWEST_MM <= found.narrowest_mm <= found.widest_mm <= WIDEST_MM
    assert found.volume_over_shape < 1.1


def test_a_wedge_uses_one_bead_two_three_and_infill():
    """The beads' widths follow the wedge: they are narrow and wide along it, never beyond what the nozzle lays."""
    beads = beads_on(drawn((20, 14), PICTURES["wedge"]))
    widths = np.concatenate([path.width_mm for path in beads.paths])
    assert widths.min() < 0.40
    assert widths.max() > 0.55
    assert {path.kind for path in beads.paths} >= {"External perimeter", "Perimeter", "Top solid infill"}


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_perimeters_are_counted(count):
    """A large plate has so many loops, one bead apart, the outermost half a bead inside the edge."""
    beads = beads_on(drawn((20, 14), box(1, 1, 19, 13)), replace(NO_SKIRT, perimeters=count))
    loops = [p for p in beads.paths if p.kind in ("External perimeter", "Perimeter") and p.closed]
    assert Counter(p.kind for p in loops) == Counter({"External perimeter": 1, "Perimeter": count - 1} if count > 1
                                                     else {"External perimeter": 1})  # fmt: skip
    left = sorted(float(p.points_mm[:, 0].min()) for p in loops)
    expected = 1 + OVERLAP_MM / 2 + SPACING_MM * (np.arange(count) + 0.5)
    assert left == pytest.approx(expected.tolist(), abs=0.5 * PIXEL_MM)


def test_inner_perimeters_come_before_the_outer_one_and_infill_last():
    """Part by part: what leans on nothing is laid after what it can lean on."""
    beads = beads_on(drawn((20, 14), box(1, 1, 19, 13)))
    order = [path.kind for path in beads.paths]
    stages = ["Perimeter", "External perimeter", "Top solid infill"]
    assert [kind for kind, _ in itertools.groupby(order)] == stages


any_seed = st.integers(0, 2**32 - 1)


@settings_of_hypothesis(max_examples=100)
@given(any_seed, st.sampled_from(list(DRAWERS)), st.booleans(), st.sampled_from([1, 2, 4]))
def test_whatever_is_drawn_can_be_planned(seed, kind, corrected, perimeters):
    """Noise, blobs, stripes, strokes and parts: beads such as the nozzle lays, with a beginning and an end."""
    image = random_layer(seed, kind, corrected)
    stack = stack_of(image, np.roll(image, 9, axis=1))
    changes = {"perimeters": perimeters, "density": 0.3, "top_layers": 1, "bottom_layers": 1}
    for beads in plan_toolpaths(stack, replace(NO_SKIRT, **changes)):
        for path in beads.paths:
            assert path.kind in KINDS
            assert len(path.points_mm) == len(path.width_mm) + 1 > 1
            assert np.isfinite(path.points_mm).all()
            assert ((path.width_mm >= NARROWEST_MM - 1e-9) & (path.width_mm <= WIDEST_MM + 1e-9)).all()
            assert path.lengths_mm.sum() > 0


def random_layer(seed: int, kind: str, corrected: bool) -> np.ndarray:
    """A picture of one kind, up to 10 mm wide."""
    random = np.random.default_rng(seed)
    image = np.pad(DRAWERS[kind](random, int(random.integers(20, 120)), int(random.integers(20, 190))), 10)
    return lf.correct_image(image, 8, "as_printed") if corrected else image


@pytest.mark.parametrize("kind", list(DRAWERS))
def test_random_corrected_layers(kind):
    """Once corrected, no component is left open, little is laid beside it, and nothing far too thick."""
    for seed in range(60):
        stack = stack_of(random_layer(seed, kind, corrected=True))
        if not stack[0].count_px():
            continue
        beads = plan_toolpaths(stack, NO_SKIRT)[0]
        found = proof(beads.paths, shape_of(stack, stack[0]))
        assert found.least_component > 0.75, seed
        assert found.outside < 0.17, seed  # a short wide stroke in a round spot: its round ends stick out
        assert found.volume_over_shape < 1.4, seed
        assert found.astray_mm < 0.06 * length_mm(beads.paths), seed


# Infill


@pytest.mark.parametrize("density", [0.1, 0.2, 0.4, 0.8])
def test_volume_of_sparse_infill_follows_the_density(density):
    """In the middle of a block, away from the perimeters, the share of the area is the density."""
    stack = stack_of(*[drawn((42, 32), box(1, 1, 41, 31))] * 11)
    planned = plan_toolpaths(stack, replace(NO_SKIRT, density=density))
    for index in (5, 6):
        sparse = of_kind(planned[index], "Internal infill")
        assert of_kind(planned[index], "Solid infill", "Top solid infill") == []
        inside = shapely.intersection(lines_of(sparse), box(5, 5, 37, 27)).length * SPACING_MM
        assert inside / (32 * 22) == pytest.approx(density, rel=0.04)
        room = (40 - 4 * SPACING_MM) * (30 - 4 * SPACING_MM) * LAYER_MM
        assert density * 0.9 < volume_mm3(sparse) / room < density * 1.25


def test_no_sparse_infill_at_density_0_and_only_solid_at_1():
    """The two ends of the scale."""
    stack = stack_of(*[drawn((22, 22), box(1, 1, 21, 21))] * 11)
    hollow = plan_toolpaths(stack, replace(NO_SKIRT, density=0.0))[5]
    assert {path.kind for path in hollow.paths} == {"External perimeter", "Perimeter"}
    full = plan_toolpaths(stack, replace(NO_SKIRT, density=1.0))[5]
    assert {path.kind for path in full.paths} == {"External perimeter", "Perimeter", "Solid infill"}
    assert proof(full.paths, shape_of(stack, stack[5])).iou > 0.97


def test_infill_lies_at_45_degrees_turned_from_layer_to_layer():
    """Most of its length runs one way; the next layer's the other way. Lines are a spacing apart."""
    stack = stack_of(*[drawn((22, 22), box(1, 1, 21, 21))] * 4)
    turns = []
    for beads in plan_toolpaths(stack, NO_SKIRT):
        along = np.concatenate([np.diff(path.points_mm, axis=0) for path in of_kind(beads, *INFILL)])
        long = along[np.hypot(*along.T) > 2]
        angles = np.degrees(np.arctan2(long[:, 1], long[:, 0])) % 180
        assert np.ptp(angles) < 0.5
        turns.append(round(float(np.median(angles))))
        starts = np.concatenate([path.points_mm[:-1] for path in of_kind(beads, *INFILL)])[np.hypot(*along.T) > 2]
        turn = math.radians(turns[-1])
        away = np.unique(np.round(starts @ [-math.sin(turn), math.cos(turn)], 2))
        assert np.median(np.diff(away[np.diff(away, prepend=-9) > 0.1])) == pytest.approx(SPACING_MM, abs=0.011)
    assert turns in ([45, 135, 45, 135], [135, 45, 135, 45])


def close_to(area: shapely.Geometry, expected: shapely.Geometry, reach_mm: float) -> bool:
    """Whether two areas differ only within a distance of the other's edge."""
    if expected.is_empty or area.is_empty:
        return bool(expected.is_empty and area.is_empty)
    return shapely.buffer(expected, reach_mm).covers(area) and shapely.buffer(area, reach_mm).covers(
        shapely.buffer(expected, -reach_mm)
    )


def closed_up(paths: list[Path]) -> shapely.Geometry:
    """The area that solid infill fills, the gaps between its lines closed."""
    return shapely.buffer(shapely.buffer(area_of(paths), 0.3), -0.3)


@pytest.fixture(scope="module")
def pyramid() -> LayerStack:
    """Steps of 3 mm on all sides, each three layers high."""
    return stack_of(*[drawn((32, 32), box(1 + 3 * (k // 3), 1 + 3 * (k // 3), 31 - 3 * (k // 3), 31 - 3 * (k // 3)))
                      for k in range(12)])  # fmt: skip


@pytest.mark.parametrize(("top", "bottom"), [(1, 1), (2, 1), (3, 2), (4, 4)])
def test_solid_infill_of_a_pyramid(pyramid, top, bottom):
    """It is where one of the next layers is open, within a bead; where nothing lies on it, it is `Top`."""
    planned = plan_toolpaths(pyramid, replace(NO_SKIRT, top_layers=top, bottom_layers=bottom))
    shapes = [shape_of(pyramid, layer) for layer in pyramid]
    for index, beads in enumerate(planned):
        room = shapely.buffer(shapes[index], -2 * SPACING_MM)
        over = [shapes[k] if k < 12 else Polygon() for k in range(index + 1, index + 1 + top)]
        under = [shapes[k] if k >= 0 else Polygon() for k in range(index - bottom, index)]
        closed = shapely.intersection_all([shapes[index], *over, *under])
        solid = closed_up(of_kind(beads, "Solid infill", "Top solid infill"))
        assert close_to(solid, shapely.difference(room, closed), 1.75 * WIDTH_MM), index
        bare = closed_up(of_kind(beads, "Top solid infill"))
        roof = shapely.difference(room, shapes[index + 1] if index < 11 else Polygon())
        assert close_to(bare, roof, 1.3 * WIDTH_MM), index
        sparse = lines_of(of_kind(beads, "Internal infill"))
        assert shapely.difference(sparse, shapely.buffer(closed, PIXEL_MM)).is_empty


def test_solid_infill_of_an_overhang():
    """A plate on a post: solid above what hangs in the air, sparse over the post, whatever lies on top."""
    post, plate = drawn((32, 22), box(12, 1, 20, 21)), drawn((32, 22), box(1, 1, 31, 21))
    stack = stack_of(*[post] * 6, *[plate] * 9)
    planned = plan_toolpaths(stack, replace(NO_SKIRT, top_layers=3, bottom_layers=2))
    for index in (6, 7):
        solid = closed_up(of_kind(planned[index], "Bridge infill" if index == 6 else "Solid infill"))
        hanging = shapely.difference(box(1, 1, 31, 21).buffer(-2 * SPACING_MM), box(12, 0, 20, 22))
        assert close_to(solid, hanging, (2.5 if index == 6 else 1.75) * WIDTH_MM)  # held by two beads over the post
        assert of_kind(planned[index], "Top solid infill") == []
    assert not of_kind(planned[8], "Solid infill", "Top solid infill")
    assert {p.kind for p in planned[12].paths if p.kind in INFILL} == {"Solid infill"}
    assert {p.kind for p in planned[14].paths if p.kind in INFILL} == {"Top solid infill"}
    assert of_kind(planned[3], *INFILL)
    assert not of_kind(planned[2], "Top solid infill")


def test_regions_of_infill_do_not_lie_on_each_other():
    """A roof beside what is covered: as much plastic as there is room for, along their border too."""
    low = drawn((32, 32), box(1, 1, 31, 31))
    high = drawn((32, 32), shapely.union_all([box(x, 3, x + 2, 29) for x in range(3, 29, 4)]))
    stack = stack_of(*[low] * 3, *[high] * 3)
    beads = plan_toolpaths(stack, replace(NO_SKIRT, density=1.0))[2]
    assert {path.kind for path in beads.paths} >= {"Solid infill", "Top solid infill"}
    found = proof(beads.paths, shape_of(stack, stack[2]))
    assert found.iou > 0.98
    assert found.volume_over_covered == pytest.approx(1, abs=0.03)


# Skirt, seam, order


def test_the_skirt_goes_round_everything_on_the_first_layer_only():
    """So many loops, so far away; none with 0. The rest of the layer is as without it."""
    parts = box(10, 10, 14, 14) | box(20, 12, 26, 13)
    stack = stack_of(*[drawn((36, 26), parts)] * 3)
    with_skirt = plan_toolpaths(stack, replace(NO_SKIRT, skirt_loops=3, skirt_gap_mm=2.0))
    without = plan_toolpaths(stack, NO_SKIRT)
    loops = of_kind(with_skirt[0], "Skirt/Brim")
    assert len(loops) == 3
    assert [path.kind for path in with_skirt[0].paths[:4]].count("Skirt/Brim") == 3
    hull = shapely.convex_hull(parts)
    for loop, k in zip(loops, (2, 1, 0), strict=True):
        assert loop.closed
        assert shapely.contains(Polygon(loop.points_mm), parts)
        away = shapely.distance(shapely.linestrings(loop.points_mm), hull)
        assert away == pytest.approx(2.0 + WIDTH_MM / 2 + k * SPACING_MM, abs=1.5 * PIXEL_MM)
    assert same(replace(with_skirt[0], paths=with_skirt[0].paths[3:]), without[0])
    assert not of_kind(without[0], "Skirt/Brim")
    for k in (1, 2):
        assert same(with_skirt[k], without[k])


def test_the_seam_at_the_rear():
    """Every loop starts where y is largest; nearest and random ones do not."""
    stack = stack_of(*[drawn((22, 22), Point(6, 6).buffer(4) | Point(15, 15).buffer(4))] * 3)

    def shares(seam: str) -> float:
        loops = [p for beads in plan_toolpaths(stack, replace(NO_SKIRT, seam=seam)) for p in beads.paths if p.closed]
        assert len(loops) >= 12
        return np.mean([p.points_mm[0, 1] == p.points_mm[:, 1].max() for p in loops])

    assert shares("rear") == 1
    assert shares("random") < 0.5
    assert shares("nearest") < 0.8


def test_random_seams_differ_between_layers_but_not_between_runs():
    """A layer's loops start elsewhere than those below; planned again they start there again."""
    stack = stack_of(*[drawn((12, 12), Point(6, 6).buffer(4))] * 5)
    once, again = ([[p.points_mm[0].tolist() for p in beads.paths if p.closed] for beads in
                    plan_toolpaths(stack, replace(NO_SKIRT, seam="random"))] for _ in range(2))  # fmt: skip
    assert once == again
    assert len({tuple(map(tuple, starts)) for starts in once}) > 3


def travel_mm(ends: np.ndarray, order: np.ndarray, flip: np.ndarray) -> float:
    """From end to start, the way to the first not counted."""
    a = np.where(flip[:, None], ends[order][:, 2:], ends[order][:, :2])
    b = np.where(flip[:, None], ends[order][:, :2], ends[order][:, 2:])
    return float(np.hypot(*(a[1:] - b[:-1]).T).sum())


def nearest_first(ends: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest end next, and nothing improved."""
    left, order, flip = list(range(len(ends))), [], []
    while left:
        away = [(np.hypot(*(ends[k, c : c + 2] - at)), k, c == 2) for k in left for c in (0, 2)]
        _, k, turned = min(away)
        order.append(k)
        flip.append(turned)
        left.remove(k)
        at = ends[k, :2] if turned else ends[k, 2:]
    return np.array(order), np.array(flip)


@pytest.mark.parametrize("seed", range(6))
def test_the_order_is_shorter_than_nearest_first_and_far_shorter_than_at_random(seed):
    """Every path once; 2-opt takes at least a twentieth off the nearest neighbour's way, on the whole."""
    random = np.random.default_rng(seed)
    middles = random.uniform(0, 100, (150, 2))
    ends = np.hstack([middles, middles + random.normal(0, 3, (150, 2))])
    order, flip = short_tour(ends, 0.0, 0.0)
    assert sorted(order.tolist()) == list(range(150))
    greedy = travel_mm(ends, *nearest_first(ends, np.zeros(2)))
    assert travel_mm(ends, order, flip) < 0.97 * greedy
    assert travel_mm(ends, order, flip) < 0.3 * travel_mm(ends, random.permutation(150), flip)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_small_orders_are_nearly_the_best(count):
    """At most a third longer than the best of all orders from the same start, and mostly the best."""
    ratios = []
    for seed in range(8):
        ends = np.random.default_rng(seed).uniform(0, 10, (count, 4))
        order, flip = short_tour(ends, 0.0, 0.0)

        def whole(order, flip, ends=ends):
            first = ends[order[0], 2:] if flip[0] else ends[order[0], :2]
            return travel_mm(ends, np.array(order), np.array(flip)) + np.hypot(*first)

        best = min(whole(o, f) for o in itertools.permutations(range(count))
                   for f in itertools.product([False, True], repeat=count))  # fmt: skip
        ratios.append(whole(order, flip) / best)
    assert max(ratios) < 1.7
    assert np.median(ratios) < 1.12
    if count == 1:
        assert max(ratios) == pytest.approx(1)


def test_in_short_order_keeps_and_reverses_paths():
    """The same paths, each forwards or backwards; the first begins near where the nozzle is."""
    random = np.random.default_rng(1)
    paths = [Path(random.uniform(0, 50, (4, 2)), random.uniform(0.4, 0.6, 3), KINDS[k % 3]) for k in range(30)]
    laid = in_short_order(paths, np.array([0.0, 0.0]))
    assert in_short_order([], np.array([0.0, 0.0])) == []

    def key(path: Path) -> tuple:
        both = (
            (path.points_mm.tolist(), path.width_mm.tolist()),
            (
                path.points_mm[::-1].tolist(),
                path.width_mm[::-1].tolist(),
            ),
        )
        return path.kind, str(min(both))

    assert Counter(map(key, laid)) == Counter(map(key, paths))
    now, before = (sum(LayerPaths((0, 0.2), tuple(each)).travels_mm()) for each in (laid, paths))
    assert now < 0.5 * before


def test_a_layer_travels_less_than_in_any_random_order(part, settings):
    """The paths of a real layer, part by part: far less than at random."""
    beads = plan_toolpaths(part, settings)[12]
    random = np.random.default_rng(0)
    shuffled = [beads.paths[k] for k in random.permutation(len(beads.paths))]
    assert sum(beads.travels_mm()) < 0.25 * sum(replace(beads, paths=tuple(shuffled)).travels_mm())


# Widths


def main_width_mm(path: Path) -> float:
    """What most of a path's length is laid with."""
    widths, which = np.unique(path.width_mm, return_inverse=True)
    return float(widths[np.bincount(which, path.lengths_mm).argmax()])


def test_each_layer_has_the_width_it_is_given(settings):
    """A wide layer has fewer and wider beads, but where they turn; without widths the first layer has its own."""
    stack = stack_of(*[drawn((22, 22), box(1, 1, 21, 21))] * 3)
    planned = plan_toolpaths(stack, settings, width_mm=[0.4, 0.8, 0.5])
    for beads, width in zip(planned, (0.4, 0.8, 0.5), strict=True):
        widths = np.concatenate([path.width_mm for path in beads.paths])
        lengths = np.concatenate([path.lengths_mm for path in beads.paths])
        assert lengths[np.abs(widths - width) < 1e-6].sum() > 0.85 * lengths.sum()
    assert length_mm(planned[0].paths) > 1.8 * length_mm(planned[1].paths)
    one, each = plan_toolpaths(stack, settings, width_mm=0.5), plan_toolpaths(stack, settings, width_mm=[0.5] * 3)
    assert same(one[1], each[1])
    usual = plan_toolpaths(stack, settings)
    assert main_width_mm(usual[0].paths[0]) == settings.first_layer_width_mm == 0.42
    assert main_width_mm(usual[1].paths[0]) == settings.width_mm == 0.45


def test_volume_and_travel_of_a_layer():
    """What `LayerPaths` says is what its paths add up to."""
    beads = beads_on(drawn((12, 12), box(1, 1, 5, 5) | box(7, 7, 11, 11)))
    assert beads.volume_mm3() == pytest.approx(volume_mm3(beads.paths))
    ways = [math.dist(a.points_mm[-1], b.points_mm[0]) for a, b in itertools.pairwise(beads.paths)]
    assert sum(beads.travels_mm()) == pytest.approx(sum(ways))
    assert max(ways) > 2


def test_paths_turn_round_and_start_elsewhere():
    """Reversed twice is the same; a loop begun elsewhere covers the same pieces with the same widths."""
    points = np.array([[0, 0], [4, 0], [4, 3], [0, 0]], float)
    loop = Path(points, np.array([0.4, 0.5, 0.6]), "Perimeter")
    assert loop.closed
    assert loop.lengths_mm.tolist() == [4, 3, 5]
    assert np.array_equal(loop.reversed().reversed().points_mm, points)
    assert loop.reversed().width_mm.tolist() == [0.6, 0.5, 0.4]
    moved = loop.starting_at(1)
    assert moved.points_mm.tolist() == [[4, 0], [4, 3], [0, 0], [4, 0]]
    assert moved.width_mm.tolist() == [0.5, 0.6, 0.4]
    assert not Path(points[:-1], loop.width_mm[:-1], "Perimeter").closed


def test_empty_layers_have_no_paths():
    """Nothing is laid where nothing is; layers round them are planned all the same."""
    solid, empty = drawn((8, 8), box(1, 1, 7, 7)), np.zeros((160, 160), bool)
    planned = plan_toolpaths(stack_of(solid, empty, solid), replace(NO_SKIRT, skirt_loops=2))
    assert [bool(beads.paths) for beads in planned] == [True, False, True]
    assert plan_toolpaths(stack_of(empty), replace(NO_SKIRT, skirt_loops=2))[0].paths == ()


def test_a_part_that_touches_the_frame():
    """The frame's edge is the part's."""
    stack = stack_of(np.ones((130, 128), bool))
    found = proof(plan_toolpaths(stack, NO_SKIRT)[0].paths, shape_of(stack, stack[0]))
    assert found.iou > 0.97
    assert found.outside < 0.01
    assert found.astray_mm < 1e-6


def test_the_place_is_that_of_the_stack():
    """Another origin moves the beads along with the layer, wherever it is in the frame."""
    image = drawn((22, 12), box(9, 3, 19, 8))
    here, there = stack_of(image), replace(stack_of(image), origin_mm=(-7.0, 100.0))
    a, b = (plan_toolpaths(stack, NO_SKIRT)[0] for stack in (here, there))
    shift = np.array(there.origin_mm) - np.array(here.origin_mm)
    assert proof(b.paths, shape_of(there, there[0])).iou > 0.97
    assert shapely.hausdorff_distance(shapely.affinity.translate(lines_of(a.paths), *shift), lines_of(b.paths)) < 1e-6


# Layers with their neighbours


@pytest.mark.parametrize("workers", [1, 2, 7])
@pytest.mark.parametrize(("below", "above"), [(0, 0), (2, 3), (4, 1)])
def test_neighbours_come_in_order_and_every_layer_is_made_once(workers, below, above):
    """For any number of workers; at the ends there are fewer."""
    count, made, lock = 40, Counter(), Lock()
    images = np.random.default_rng(0).random((count, 5, 70)) < 0.5
    stack = stack_of(*images)
    make = stack.make

    def counted(index: int) -> Layer:
        with lock:
            made[index] += 1
        return make(index)

    watched = replace(stack, make=counted, workers=workers)
    tops = stack.z_mm[:, 1].tolist()

    def use(index, lower, layer, upper):
        assert tops.index(layer.z_mm[1]) == index
        return [tops.index(x.z_mm[1]) for x in lower], tops.index(layer.z_mm[1]), [
            tops.index(x.z_mm[1]) for x in upper
        ], layer.image()  # fmt: skip

    for index, (lower, here, upper, image) in enumerate(watched.each_with_neighbours(use, below=below, above=above)):
        assert here == index
        assert lower == list(range(max(index - below, 0), index))
        assert upper == list(range(index + 1, min(index + above + 1, count)))
        assert np.array_equal(image, images[index])
    assert made == Counter(range(count))


def test_an_error_in_a_neighbour_comes_out():
    """And does not leave the others waiting."""
    stack = stack_of(*np.ones((9, 4, 4), bool))
    make = stack.make

    def broken(index: int) -> Layer:
        if index == 5:
            raise InputError("layer 5 is broken")
        return make(index)

    with pytest.raises(InputError, match="layer 5 is broken"):
        list(replace(stack, make=broken, workers=3).each_with_neighbours(lambda *a: a, below=2, above=2))


# What is refused


PLATE = np.ones((64, 64), bool)


@pytest.mark.parametrize(
    ("stack", "changes", "message"),
    [
        (stack_of(PLATE, pixel_mm=(0.05, 0.06)), {}, "square"),
        (stack_of(PLATE, pixel_mm=0.14), {}, "too coarse"),
        (stack_of(PLATE, layer_mm=0.41), {}, "above the nozzle"),
        (stack_of(PLATE, PLATE, first_layer_mm=0.5), {}, "above the nozzle"),
        (stack_of(PLATE, layer_mm=0.36), {}, "narrowest bead"),
        (stack_of(PLATE), {"width_mm": 0.33}, "extrusion width"),
        (stack_of(PLATE), {"width_mm": 0.81}, "extrusion width"),
        (stack_of(PLATE, PLATE), {"width_mm": [0.45, 0.9]}, "extrusion width"),
        (stack_of(PLATE, PLATE), {"width_mm": [0.45] * 3}, r"shape \(3,\): one for all, or one for each of 2 layers"),
    ],
    ids=[
        "not square",
        "coarse",
        "high layer",
        "high first layer",
        "taller than wide",
        "narrow",
        "wide",
        "one",
        "three for two",
    ],
)
def test_what_no_nozzle_can_lay(stack, changes, message):
    """Refused before any work, with the value and what would do."""
    with pytest.raises(InputError, match=message):
        plan_toolpaths(stack, NO_SKIRT, **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"perimeters": 0}, "perimeters 0"),
        ({"perimeters": -1}, "perimeters -1"),
        ({"perimeters": 1.5}, "perimeters 1.5: a whole number"),
        ({"density": 2.0}, "density 2"),
        ({"density": -0.1}, "density"),
        ({"density": math.nan}, "density"),
        ({"seam": "front"}, "nearest, rear, random"),
        ({"width_mm": 0.2}, "extrusion width"),
        ({"first_layer_width_mm": 0.9}, "extrusion width"),
        ({"first_layer_width_mm": 0.0}, "extrusion width 0 mm"),
        ({"top_layers": -1}, "top layers"),
        ({"skirt_loops": -2}, "skirt loops"),
        ({"nozzle_mm": 0.0}, "nozzle"),
        ({"nozzle_mm": math.inf}, "nozzle"),
    ],
)
def test_settings_that_cannot_be(changes, message):
    """Each names the value or the choices."""
    with pytest.raises(InputError, match=message):
        replace(NO_SKIRT, **changes)


def test_the_highest_layer_and_the_coarsest_pixels_that_still_go():
    """At the limits nothing is refused and everything is covered."""
    stack = stack_of(drawn((12, 12), box(1, 1, 11, 11), 0.13), pixel_mm=0.13, layer_mm=0.33)
    beads = plan_toolpaths(stack, NO_SKIRT)[0]
    assert proof(beads.paths, shape_of(stack, stack[0]), 0.33).covered > 0.95


def test_settings_of_a_printer():
    """Its nozzle, widths and range, with changes; a resin printer has none."""
    found = settings_for(lf.load_printer(PRINTER), perimeters=3)
    assert (found.nozzle_mm, found.width_mm, found.first_layer_width_mm) == (0.4, 0.45, 0.42)
    assert found.range_mm == (0.34, 0.8)
    assert found.perimeters == 3
    with pytest.raises(InputError, match="nozzle"):
        settings_for(lf.load_printer("prusa-sl1s"))


def test_sparse_infill_lies_on_itself(settings):
    """Lines of every second layer are the same lines, wherever the part's outline is."""
    shapes = [drawn((30, 30), Point(15.0 + 0.1 * k, 15).buffer(13 - 0.7 * k)) for k in range(12)]
    layers = plan_toolpaths(stack_of(*shapes), replace(settings, top_layers=0, bottom_layers=0))
    spacing = spacing_mm(settings.width_mm, 0.2) / settings.density
    phases = []
    for k in (3, 5, 7, 9):
        for path in (p for p in layers[k].paths if p.kind == "Internal infill"):
            a, b = path.points_mm[:-1], path.points_mm[1:]
            along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
            lines = np.abs(np.abs(along[:, 0]) - np.sqrt(0.5)) < 1e-6  # the ways between them are not at 45 degrees
            lines &= path.lengths_mm > 3
            across = np.where(along[:, 0] * along[:, 1] > 0, a[:, 1] - a[:, 0], a[:, 1] + a[:, 0]) / np.sqrt(2)
            phases += (across[lines] % spacing).tolist()
    turns = np.exp(2j * np.pi * np.array(phases) / spacing)
    assert len(phases) > 20
    assert abs(turns.mean()) > 0.999


def test_a_gap_in_z_covers_nothing(settings):
    """The layer under a gap is a top, the one over it a bottom."""
    stack = stack_of(*[drawn((12, 12), box(1, 1, 11, 11))] * 20)
    z = stack.z_mm.copy()
    z[10:] += 5.0
    make = stack.make
    apart = replace(stack, z_mm=z, make=lambda k: replace(make(k), z_mm=tuple(z[k].tolist())))
    kinds = [{path.kind for path in layer.paths} for layer in plan_toolpaths(apart, settings)]
    assert "Top solid infill" in kinds[9]
    assert "Solid infill" in kinds[10]
    assert all(("Internal infill" in kinds[k]) == (k in (4, 5, 14, 15)) for k in range(20))
    alone = plan_toolpaths(apart, settings)
    assert [{path.kind for path in alone[k].paths} for k in (4, 9, 10, 15)] == [kinds[k] for k in (4, 9, 10, 15)]
