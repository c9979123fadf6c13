"""The method: the slow twin, laws 2 to 6, and small pictures of what it does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from layerfix import Layer, LayerStack, correct, correct_image, meso_skeleton, slice_mesh
from layerfix.errors import InputError
from layerfix.layers.correction import MODES
from layerfix.layers.feature import feature_of_mm
from layerfix.layers.verdict import judge
from layerfix.samples import sample
from tests import slow_metric, slow_twin
from tests.pictures_as_text import KINDS, block, drawing, framed, images, picture, radii, round_dot, strip

# Turned and mirrored in every way, and whether that swaps x and y.
SYMMETRIES = {
    "mirrored left to right": (np.fliplr, False),
    "mirrored top to bottom": (np.flipud, False),
    "half a turn": (lambda image: np.rot90(image, 2), False),
    "a quarter turn": (np.rot90, True),
    "three quarter turns": (lambda image: np.rot90(image, 3), True),
    "transposed": (np.transpose, True),
    "transposed the other way": (lambda image: np.rot90(image.T, 2), True),
}
MARGIN_PX = 8  # what correction may grow into: more than any radius of `radii`
each_mode = pytest.mark.parametrize("mode", MODES)
any_mode = st.sampled_from(MODES)


def stack_of(*layers: np.ndarray, pixel_mm: float | tuple[float, float] = 1.0) -> LayerStack:
    """Images as a stack; at a pitch of 1 mm a feature in mm is one in pixels."""
    return LayerStack.from_images(layers, pixel_mm=pixel_mm, layer_mm=0.1)


def assert_same(result: np.ndarray, expected: np.ndarray) -> None:
    """Equal to the pixel; shows both as text if not."""
    assert np.array_equal(result, expected), f"\n{drawing(result)}\n\nexpected\n{drawing(expected)}"


def sliced(name: str, *where: int) -> list[np.ndarray]:
    """Layers of a built-in part."""
    part = sample(name)
    stack = slice_mesh(part.mesh(), pixel_mm=part.pixel_mm, layer_mm=part.layer_mm)
    return [stack[index].image() for index in where]


@pytest.fixture(scope="module")
def real_layers() -> dict[str, np.ndarray]:
    """Layers of built-in parts, with walls, fins and pins below 8 px, and one without."""
    return {
        f"{name} {index}": image
        for name, where in (("test-part", (3, 27)), ("spherical-shell", (5, 300)), ("helical-tower", (371,)))
        for index, image in zip(where, sliced(name, *where), strict=True)
    }


# The slow twin


@settings(max_examples=200)
@given(images(), radii(), any_mode)
def test_equals_the_twin(image, radius, mode):
    """Bit for bit in both modes, whatever touches the frame."""
    assert_same(correct_image(image, radius, mode), slow_twin.corrected(image, *radius, mode))


@given(images(heights=st.integers(60, 150), widths=st.integers(1, 150)), radii(), any_mode)
def test_equals_the_twin_on_larger_images(image, radius, mode):
    """Several blocks of rows and several words."""
    assert_same(correct_image(image, radius, mode), slow_twin.corrected(image, *radius, mode))


@settings(max_examples=30)
@given(images(heights=st.integers(1, 9), widths=st.sampled_from([4095, 4100, 8300])), radii(0.6, 4), any_mode)
def test_equals_the_twin_on_wide_images(image, radius, mode):
    """Past 4096 px, too."""
    assert_same(correct_image(image, radius, mode), slow_twin.corrected(image, *radius, mode))


@given(images(widths=st.integers(2, 130), heights=st.integers(2, 40)), radii(1, 7), any_mode)
def test_correct_does_to_a_stack_what_correct_image_does_to_an_image(image, radius, mode):
    """The feature in mm over the pitch is its size in px; the change is counted to the pixel."""
    rx, ry = radius
    assume(not (2 * rx > image.shape[1] and 2 * ry > image.shape[0]))
    layer = correct(stack_of(image, pixel_mm=(0.6 / rx, 0.6 / ry)), min_feature_mm=1.2, mode=mode)[0]
    expected = correct_image(image, mode=mode, min_feature_px=(1.2 / (0.6 / rx), 1.2 / (0.6 / ry)))
    assert_same(layer.image(), expected)
    change = layer.change
    assert (change.solid_px, change.added_px, change.removed_px) == (
        image.sum(),
        (expected & ~image).sum(),
        (image & ~expected).sum(),
    )


# Laws


@given(images(), radii())
def test_law_2_what_comes_out_is_printable(image, radius):
    """Ŝ ∘ F = Ŝ, where the frame cuts nothing off."""
    printed = correct_image(framed(image, MARGIN_PX), radius, "as_printed")
    assert_same(slow_twin.opening(printed, *radius), printed)


def test_law_2_on_real_layers(real_layers):
    """Ŝ ∘ F = Ŝ on layers of built-in parts."""
    for image in real_layers.values():
        printed = correct_image(image, 4, "as_printed")
        assert np.array_equal(slow_twin.opening(printed, 4, 4), printed)


@given(images(), radii())
def test_law_3_the_printable_part_is_what_an_uncorrected_print_keeps(image, radius):
    """Ŝ = (S ∘ F) ∪ (M̂ \\ M) ⊕ F; so without a skeletal path, Ŝ = S ∘ F."""
    printed = correct_image(image, radius, "as_printed")
    opened = slow_twin.opening(image, *radius)
    path = meso_skeleton(image, radius) & ~slow_twin.erosion(image, *radius)
    assert_same(printed, opened | slow_twin.dilation(path, *radius))
    if not path.any():
        assert_same(printed, opened)


@given(images(kinds=("noise", "blobs", "strokes")), radii(1, 3.5))
def test_law_3_what_was_printable_is_left_alone(image, radius):
    """On shapes wider than the feature there is no skeletal path, and as_printed is S ∘ F."""
    wide = slow_twin.dilation(framed(image, 30), 2 * radius[0] + 4, 2 * radius[1] + 4)
    path = meso_skeleton(wide, radius) & ~slow_twin.erosion(wide, *radius)
    assume(image.any() and not path.any())
    assert_same(correct_image(wide, radius, "as_printed"), slow_twin.opening(wide, *radius))


@pytest.mark.parametrize(
    "image",
    [block(25, 40, 4), round_dot(14, 41), round_dot(25, 61) & ~round_dot(10, 61)],
    ids=["block", "disc", "ring"],
)
def test_law_3_on_wide_shapes(image):
    """No path in a block, a disc and a wide ring: as_printed is S ∘ F, add_only is S."""
    assert_same(meso_skeleton(image, 3), slow_twin.erosion(image, 3, 3))
    assert_same(correct_image(image, 3, "as_printed"), slow_twin.opening(image, 3, 3))
    assert_same(correct_image(image, 3, "add_only"), image)


@given(images(), radii())
def test_law_4_add_only_takes_nothing_away(image, radius):
    """add_only is S ∪ Ŝ."""
    added = correct_image(image, radius, "add_only")
    assert not (image & ~added).any()
    assert_same(added, image | correct_image(image, radius, "as_printed"))


@given(images(widths=st.integers(1, 130), heights=st.integers(1, 90)), radii(), st.sampled_from([*SYMMETRIES]))
def test_law_5_the_skeleton_has_the_same_topology_however_the_image_lies(image, radius, name):
    """Mirrored and turned images: the same components and holes of M̂, on anything."""
    turned, swaps = SYMMETRIES[name]
    skeleton = meso_skeleton(turned(image), radius[::-1] if swaps else radius)
    assert slow_twin.topology(skeleton) == slow_twin.topology(meso_skeleton(image, radius))


def drawn_part() -> np.ndarray:
    """A plate with a hole, fins of 1 to 6 px in several directions, pins and a thin ring; gaps of 20 px and more."""
    part = np.zeros((420, 420), bool)
    part[20:150, 20:200] = True
    part[60:110, 60:110] = False
    for k, width in enumerate(range(1, 7)):
        part[150:190, 25 + 29 * k : 25 + 29 * k + width] = True
    for k, (degrees, width) in enumerate([(0, 4), (17, 3), (38, 5), (45, 2), (62, 4), (81, 6)]):
        y, x = 220 + 90 * (k // 3), 100 * (k % 3)
        part[y : y + 90, x : x + 90] |= strip(width, degrees, length=60, size_px=90)
    for k, radius in enumerate((0, 1, 1.5, 2.5, 4)):
        part[30 + 36 * k : 45 + 36 * k, 380:395] |= round_dot(radius, 15)
    part[30:131, 230:331] |= round_dot(48, 101) & ~round_dot(45, 101)
    part[150:201, 250:301] |= round_dot(22, 51)
    return part


@each_mode
@pytest.mark.parametrize("name", SYMMETRIES)
@pytest.mark.parametrize("radius", [(3, 3), (4.5, 4.5), (6, 6), (6.3, 5)])
def test_law_5_a_part_comes_out_the_same_however_it_lies(radius, name, mode):
    """Mirrored and turned: the same topology, and area within 1 %, where gaps are wider than the feature."""
    turned, swaps = SYMMETRIES[name]
    part = drawn_part()
    one = correct_image(part, radius, mode)
    other = correct_image(turned(part), radius[::-1] if swaps else radius, mode)
    assert slow_twin.topology(other) == slow_twin.topology(one) == slow_twin.topology(part)
    assert abs(int(other.sum()) - int(one.sum())) <= 0.01 * one.sum()


@each_mode
@pytest.mark.parametrize("name", SYMMETRIES)
def test_law_5_area_of_real_layers(real_layers, name, mode):
    """Layers of built-in parts, mirrored and turned: area within 1 %."""
    turned, _ = SYMMETRIES[name]
    for layer, image in real_layers.items():
        one, other = correct_image(image, 4, mode), correct_image(turned(image), 4, mode)
        assert abs(int(other.sum()) - int(one.sum())) <= 0.01 * one.sum(), layer


@given(
    images(widths=st.just(400), heights=st.just(400), kinds=("noise", "blobs")),
    st.floats(1, 5),
    st.sampled_from([*SYMMETRIES]),
    any_mode,
)
def test_law_5_area_of_random_images(image, radius, name, mode):
    """Random 400 px images, mirrored and turned: area within 1 %.

    It is no law of small or striped ones. Each end of a path may lie a pixel further out, which is several per
    cent of the area of a 100 px image of thin strokes; and where walls of 2 px lie closer than the feature,
    all of them grow towards the same side: one image of nothing but such stripes differed by 9.6 %.
    """
    assume(image.sum() > 10_000)
    one = correct_image(framed(image, MARGIN_PX), radius, mode)
    other = correct_image(framed(SYMMETRIES[name][0](image), MARGIN_PX), radius, mode)
    assert abs(int(other.sum()) - int(one.sum())) <= 0.01 * one.sum()


@each_mode
def test_law_6_empty_stays_empty(mode):
    """An empty layer, and one between others, comes out empty and says that nothing changed."""
    empty = np.zeros((30, 70), bool)
    fixed = correct(stack_of(empty, strip(2, 20, size_px=70)[:30], empty), min_feature_mm=6, mode=mode)
    for layer in (fixed[0], fixed[2]):
        assert layer.count_px() == 0
        assert (layer.change.solid_px, layer.change.added_px, layer.change.removed_px) == (0, 0, 0)
        assert layer.change.thinnest_mm is None
    assert fixed[1].change.added_px > 0


@each_mode
def test_law_6_frame_pitch_and_z_survive(mode):
    """Width, height, pitch, origin, z's and the number of workers are those of the input."""
    z_mm = np.array([[0, 0.3], [0.3, 0.35], [0.5, 0.6]])
    rows = stack_of(strip(2, 20, size_px=90))[0].rows

    def make(index: int) -> Layer:
        return Layer(rows, 90, (z_mm[index, 0], z_mm[index, 1]))

    stack = LayerStack(90, 90, (0.05, 0.08), z_mm, make, origin_mm=(-3.5, 12.25), workers=2)
    fixed = correct(stack, min_feature_mm=0.4, mode=mode)
    assert (fixed.width, fixed.height, fixed.pixel_mm) == (90, 90, (0.05, 0.08))
    assert (fixed.origin_mm, fixed.workers) == ((-3.5, 12.25), 2)
    assert np.array_equal(fixed.z_mm, z_mm)
    assert [layer.z_mm for layer in fixed] == [tuple(z) for z in z_mm.tolist()]
    assert {(layer.width, layer.height) for layer in fixed} == {(90, 90)}


@each_mode
def test_law_6_any_number_of_workers_gives_the_same_bits(mode):
    """1, 2 and 8 threads; the input is as it was."""
    random = np.random.default_rng(3)
    layers = [KINDS[kind](random, 90, 130) for kind in [*KINDS] * 4]
    stack = stack_of(*layers)
    fixed = correct(stack, min_feature_mm=7, mode=mode)
    expected = [correct_image(image, mode=mode, min_feature_px=7) for image in layers]
    changes = [layer.change for layer in fixed.with_workers(1)]
    for workers in (1, 2, 8):
        made = list(fixed.with_workers(workers))
        assert all(np.array_equal(a.image(), b) for a, b in zip(made, expected, strict=True))
        assert [layer.change for layer in made] == changes
    assert all(np.array_equal(layer.image(), image) for layer, image in zip(stack, layers, strict=True))


@given(images(), radii(), any_mode)
def test_law_6_the_input_is_untouched(image, radius, mode):
    """Also when it may not be written to."""
    image.flags.writeable = False
    before = image.copy()
    correct_image(image, radius, mode)
    assert_same(image, before)


# Pictures


def test_a_pin_becomes_a_disc():
    """One pixel grows to the feature."""
    for mode in MODES:
        assert_same(
            correct_image(block(1, 1, 3), 2, mode),
            picture("""
                . . . . . . .
                . . . # . . .
                . . # # # . .
                . # # # # # .
                . . # # # . .
                . . . # . . .
                . . . . . . .
            """),
        )


def test_two_pixels_survive_as_one_disc():
    """Not erased, and not longer than they must be."""
    for pair in ("# #", "# .\n. #", ". #\n# .", "#\n#"):
        fixed = correct_image(framed(picture(pair), 5), 2, "as_printed")
        assert slow_twin.topology(fixed) == (1, 0)
        assert fixed.sum() == len(slow_twin.disc(2, 2))


def test_a_thin_wall_reaches_the_minimum():
    """A 1 px wall becomes as wide as the disc and stays about as long."""
    assert_same(
        correct_image(framed(picture("# # # # # # # # # # # #"), 3), 1.5, "as_printed"),
        picture("""
            . . . . . . . . . . . . . . . . . .
            . . . . . . . . . . . . . . . . . .
            . . . . # # # # # # # # # # . . . .
            . . . . # # # # # # # # # # . . . .
            . . . . # # # # # # # # # # . . . .
            . . . . . . . . . . . . . . . . . .
            . . . . . . . . . . . . . . . . . .
        """),
    )


@each_mode
@pytest.mark.parametrize("width", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("turned", [np.asarray, np.transpose], ids=["lying", "standing"])
def test_every_wall_under_the_minimum_reaches_it(width, turned, mode):
    """Radius 3 is a feature of 7 px: 1 to 6 px walls come out 7 px wide along their length."""
    fixed = turned(correct_image(turned(block(width, 60, 8)), 3, mode))
    assert set(fixed[:, 20:-20].sum(axis=0)) == {7}
    assert abs(np.ptp(np.flatnonzero(fixed.any(axis=0))) + 1 - 60) <= 4


@pytest.mark.parametrize("degrees", np.arange(0, 90, 15))
@pytest.mark.parametrize("width", [2, 4, 6])
def test_a_slanted_wall_holds_the_tool_everywhere(width, degrees):
    """At every angle the wall stays whole, and a tool a pixel smaller moves from end to end inside it."""
    fixed = correct_image(strip(width, degrees), 5, "as_printed")
    inside = slow_twin.erosion(fixed, 4, 4)
    assert slow_twin.components(inside) == 1
    assert np.hypot(*np.ptp(np.nonzero(inside), axis=1)) >= 80 - 2 * 5 - 6


def test_a_wide_block_loses_only_corners_as_printed_and_nothing_with_add_only():
    """as_printed rounds the corners; add_only draws the block as it was."""
    image = block(9, 12, 2)
    assert_same(correct_image(image, 3, "add_only"), image)
    fixed = correct_image(image, 3, "as_printed")
    assert not (fixed & ~image).any()
    gone = image & ~fixed
    assert gone.sum() == 4 * 5
    y, x = np.nonzero(gone)
    from_edge = np.minimum(y - 2, 10 - y) + np.minimum(x - 2, 13 - x)
    assert from_edge.max() <= 2
    assert correct(stack_of(image), min_feature_mm=6)[0].change.removed_px == 4  # F of 6 px is rounder than a square


def test_a_thin_ring_keeps_its_hole():
    """One component and one hole, and everywhere wide enough."""
    ring = round_dot(20, 61) & ~round_dot(18, 61)
    for mode in MODES:
        fixed = correct_image(ring, 3, mode)
        assert slow_twin.topology(fixed) == (1, 1)
    assert slow_twin.components(slow_twin.erosion(correct_image(ring, 3, "as_printed"), 3, 3)) == 1


def two_walls(slot_px: int) -> np.ndarray:
    """Two walls of one pixel with a slot between them."""
    image = np.zeros((20 + slot_px, 60), bool)
    image[9, 10:50] = image[10 + slot_px, 10:50] = True
    return image


@each_mode
def test_a_slot_narrower_than_the_feature_between_two_thin_walls_closes(mode):
    """The skeleton keeps both walls, but each grows by the radius towards the other: a slot of 2 r px or less
    is filled. The paper names this limit (its section on limitations); nothing here prevents it."""
    for slot_px in (3, 6):
        assert slow_twin.components(meso_skeleton(two_walls(slot_px), 3)) == 2
        assert slow_twin.components(correct_image(two_walls(slot_px), 3, mode)) == 1


@each_mode
@pytest.mark.parametrize("slot_px", [7, 8, 12])
def test_a_slot_wider_than_the_feature_stays_open(slot_px, mode):
    """The walls grow, and a slot of 2 r + 1 px or more is left."""
    fixed = correct_image(two_walls(slot_px), 3, mode)
    assert slow_twin.topology(fixed) == (2, 0)
    assert (~fixed[10 : 10 + slot_px, 30]).sum() == slot_px - 6


def test_what_is_wide_enough_beside_something_thin_stays_as_it_is():
    """A fin on a plate is thickened; the plate's far side is untouched with add_only."""
    image = framed(np.zeros((40, 80), bool), 6)
    image[10:40, 10:45] = True
    image[24:26, 45:80] = True
    fixed = correct_image(image, 4, "add_only")
    assert_same(fixed[:, :35], image[:, :35])
    assert set(fixed[:, 55:70].sum(axis=0)) == {9}
    assert slow_twin.topology(fixed) == (1, 0)


def test_what_would_grow_past_the_frame_is_cut_off():
    """A pin in the corner is a quarter of a disc."""
    corner = np.zeros((6, 70), bool)
    corner[0, 69] = True
    fixed = correct_image(corner, 3, "as_printed")
    assert fixed.sum() == sum(dx <= 0 <= dy for dx, dy in slow_twin.disc(3, 3))


@each_mode
def test_correcting_a_corrected_layer_hardly_changes_it(mode):
    """Once everything is wide enough, there is (almost) nothing left to do."""
    once = correct_image(drawn_part(), 5, mode)
    twice = correct_image(once, 5, mode)
    assert (once ^ twice).sum() <= 0.005 * once.sum()


# One feature for each layer, and specks


def test_every_layer_may_have_a_feature_of_its_own():
    """A first layer that is drawn wider; whoever makes the layers."""
    line = block(1, 60, 12)
    fixed = correct(stack_of(line, line, line), min_feature_mm=[9, 4, 5])
    for workers in (1, 2):
        widths = [layer.image()[:, 40].sum() for layer in fixed.with_workers(workers)]
        assert widths == [9, 4, 5]
    assert [layer.change.radius_px[0] for layer in fixed] == [4.5, 2, 2.5]


def test_features_are_as_many_as_layers():
    """The message says how many of both."""
    with pytest.raises(InputError, match="2 minimum features for 3 layers"):
        correct(stack_of(*[block(9, 9, 4)] * 3), min_feature_mm=[4, 5])


@each_mode
def test_specks_are_left_as_they_are_if_asked(mode):
    """A pixel that would become a dot of F's size stays a pixel; what is as large as the limit is corrected."""
    image = block(2, 40, 14)
    image[5, 5] = True  # a speck of one pixel
    image[24, 10:13] = True  # one of three
    one = correct(stack_of(image), min_feature_mm=8, mode=mode)[0]
    assert one.count_px() > correct(stack_of(block(2, 40, 14)), min_feature_mm=8, mode=mode)[0].count_px() + 80
    left = correct(stack_of(image), min_feature_mm=8, mode=mode, ignore_below_mm2=3)[0]
    assert left.change.ignored_px == 1
    assert left.image()[:9, :9].sum() == 1
    assert left.image()[24, 11]
    assert left.count_px() == one.count_px() - len(slow_metric.feature_offsets(8, 8)) + 1
    both = correct(stack_of(image), min_feature_mm=8, mode=mode, ignore_below_mm2=4)[0]
    assert both.change.ignored_px == 4


def test_a_layer_of_nothing_but_specks_stays():
    """Nothing added, nothing removed."""
    image = np.zeros((30, 70), bool)
    image[3, 4] = image[20, 65] = True
    layer = correct(stack_of(image), min_feature_mm=6, ignore_below_mm2=2)[0]
    assert_same(layer.image(), image)
    assert (layer.change.added_px, layer.change.removed_px, layer.change.ignored_px) == (0, 0, 2)


@pytest.mark.parametrize("area", [-1, float("nan"), float("inf")])
def test_an_area_is_0_or_more(area):
    """The message names it."""
    with pytest.raises(InputError, match="ignore below"):
        correct(stack_of(block(9, 9, 4)), min_feature_mm=4, ignore_below_mm2=area)


# The door


def test_the_radii_are_half_the_feature_over_the_pitch():
    """Each axis has its own."""
    assert feature_of_mm(0.4, (0.05, 0.05)).radius_px == pytest.approx((4, 4))
    assert feature_of_mm(0.114, (0.019, 0.024)).radius_px == pytest.approx((3, 2.375))


@pytest.mark.parametrize("feature_mm", [0, -0.4, float("nan"), float("inf")])
def test_a_feature_is_above_0(feature_mm):
    """The message names the value."""
    with pytest.raises(InputError, match=rf"minimum feature {feature_mm} mm: it must be above 0"):
        correct(stack_of(block(20, 20, 4)), min_feature_mm=feature_mm)


@pytest.mark.parametrize(
    ("feature_mm", "pixel_mm", "message"),
    [
        (0.09, 0.05, "90 µm is under two pixels of 50 µm"),
        (0.03, (0.019, 0.024), "30 µm is under two pixels of 19 µm × 24 µm"),
    ],
)
def test_a_feature_under_two_pixels_is_refused(feature_mm, pixel_mm, message):
    """Nothing can be thinner than a pixel; the message says so with both values."""
    with pytest.raises(InputError, match=message):
        correct(stack_of(block(20, 20, 4), pixel_mm=pixel_mm), min_feature_mm=feature_mm)


def test_a_feature_of_exactly_two_pixels_is_taken():
    """0.3 mm over pixels of 0.15 mm is two pixels, rounding or not."""
    assert correct(stack_of(block(1, 1, 4), pixel_mm=0.15), min_feature_mm=0.3)[0].count_px() == 4


def test_a_feature_larger_than_the_layer_is_refused():
    """The message names both sizes."""
    with pytest.raises(InputError, match="30 mm is larger than the layers, which are 28 mm × 18 mm"):
        correct(stack_of(block(10, 20, 4)), min_feature_mm=30)


@pytest.mark.parametrize("mode", ["add", "", "AS_PRINTED"])
def test_an_unknown_mode_lists_the_known(mode):
    """For stacks and for images."""
    message = rf"mode='{mode}' is not known; choose from as_printed, add_only"
    with pytest.raises(InputError, match=message):
        correct(stack_of(block(9, 9, 4)), min_feature_mm=4, mode=mode)
    with pytest.raises(InputError, match=message):
        correct_image(block(9, 9, 4), 2, mode)


def test_an_unknown_spur_rule_lists_the_known():
    """For stacks and for images."""
    message = r"spurs='sharp' is not known; choose from metric, paper"
    with pytest.raises(InputError, match=message):
        correct(stack_of(block(9, 9, 4)), min_feature_mm=4, spurs="sharp")
    with pytest.raises(InputError, match=message):
        correct_image(block(9, 9, 4), 2, spurs="sharp")


def test_bad_values_are_refused_before_any_layer_is_made():
    """correct checks when it is called, not when the first layer is read."""
    made: list[int] = []

    def make(index: int) -> Layer:
        made.append(index)
        raise AssertionError("a layer was made")

    stack = LayerStack(30, 30, (0.1, 0.1), np.array([[0, 0.1]]), make)
    for wrong in ({"min_feature_mm": 0}, {"min_feature_mm": 9}, {"min_feature_mm": 0.4, "mode": "x"}):
        with pytest.raises(InputError):
            correct(stack, **wrong)
    correct(stack, min_feature_mm=0.4)
    assert not made


def test_slicings_note_of_closed_gaps_survives_correction():
    """The other facts about a layer stay with it."""
    from layerfix.stack import Gaps

    rows = stack_of(block(9, 9, 4))[0].rows
    stack = LayerStack(17, 17, (1, 1), np.array([[0, 1]]), lambda _: Layer(rows, 17, (0, 1), gaps=Gaps(2, 0.3)))
    assert correct(stack, min_feature_mm=4)[0].gaps == Gaps(2, 0.3)


def test_layers_that_are_alike_have_their_own_heights():
    """What merged, what would be lost and what stays too narrow is told at each layer's height, though the layers are
    worked on once; and where F differs they are not taken for one."""
    image = np.zeros((40, 60), bool)
    image[10:30, 5:25] = image[10:30, 28:50] = True  # three pixels apart
    image[10:30, 26] = True  # a wall between, which grows into both
    stack = LayerStack.from_images([image] * 5, pixel_mm=0.1, layer_mm=0.1)
    for workers in (1, 2):
        for layer in correct(stack.with_workers(workers), min_feature_mm=0.6):
            assert layer.change.topology
            assert {one.z_mm for one in layer.change.topology} == {layer.z_mm}
        for layer in correct(stack.with_workers(workers), min_feature_mm=0.6, keep_gaps_mm=0.1):
            assert layer.change.conflicts
            assert {one.z_mm for one in layer.change.conflicts} == {layer.z_mm}
        for verdict, layer in zip(judge(stack.with_workers(workers), min_feature_mm=0.6), stack, strict=True):
            assert {one.z_mm for one in (*verdict.lost, *verdict.topology)} == {verdict.z_mm} == {layer.z_mm}
    wide = correct(stack, min_feature_mm=[0.6, 0.6, 1.0, 1.0, 0.6])
    alone = {size: correct(stack, min_feature_mm=size)[0].image() for size in (0.6, 1.0)}
    for layer, size in zip(wide.with_workers(1), (0.6, 0.6, 1.0, 1.0, 0.6), strict=True):
        assert np.array_equal(layer.image(), alone[size])
