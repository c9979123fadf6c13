"""What is kept free: gaps, holes, places; which side material goes to; what stays too thin for it, and is told."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from layerfix import LayerStack, compare_topology, correct
from layerfix.errors import InputError
from tests.making import box, joined, run_layerfix, save_stl
from tests.pictures_as_text import block, framed, images

ALL_AROUND = np.ones((3, 3))
MODES = ("as_printed", "add_only")


def stack_of(*layers: np.ndarray, pixel_mm=1.0) -> LayerStack:
    return LayerStack.from_images(layers, pixel_mm=pixel_mm, layer_mm=0.5)


def fixed(image: np.ndarray, size: float, **how) -> np.ndarray:
    return correct(stack_of(image), min_feature_mm=size, **how)[0].image()


def counts(image: np.ndarray) -> tuple[int, int]:
    """Components and voids."""
    return ndimage.label(image, ALL_AROUND)[1], ndimage.label(~np.pad(image, 1))[1]


@settings(max_examples=300)
@given(images(), st.integers(2, 14), st.sampled_from(MODES), st.sampled_from([0.5, 1.0, 2.0, 3.0]))
def test_nothing_joins_and_nothing_closes(image, size, mode, gap):
    """The topology is that of S, and nothing is added that the method would not add."""
    image = framed(image, size + 4)
    kept = fixed(image, size, mode=mode, keep_gaps_mm=gap)
    assert counts(kept) == counts(image)
    changes = compare_topology(image, kept)
    if mode == "add_only":
        assert changes == []
    else:  # a hole may move by a pixel
        assert {change.kind for change in changes} <= {"closed", "opened"}
    free = fixed(image, size, mode=mode)
    assert not (kept & ~free).any()
    assert mode == "as_printed" or not (image & ~kept).any()


@pytest.mark.parametrize("gap", [1, 2, 3, 4])
@pytest.mark.parametrize("apart", [5, 6, 7])
def test_two_walls_share_what_is_between_them(apart, gap):
    """Two lines of a pixel: each grows away from the other in full, towards it to the middle; the gap stays."""
    image = framed(np.zeros((30, 80), bool), 12)
    image[20, 14:90] = image[20 + apart + 1, 14:90] = True
    (layer,) = correct(stack_of(image), min_feature_mm=9, keep_gaps_mm=gap)
    kept = layer.image()
    assert ndimage.label(kept, ALL_AROUND)[1] == 2
    across = kept[:, 40]
    solid = np.flatnonzero(across)
    between = ~across[20 : 20 + apart + 2]
    assert between.sum() >= min(gap, apart)
    assert between.sum() <= gap + 1 + (apart - gap) % 2
    assert (20 - solid[0], solid[-1] - 20 - apart - 1) == (4, 4)
    assert {one.kind for one in layer.change.conflicts} == {"gap"}
    assert all(5 <= one.width_mm <= 9 for one in layer.change.conflicts)
    assert layer.change.topology == ()


def test_a_hole_stays_open():
    """A pin hole in a thin plate."""
    image = block(5, 30, 10)
    image[12, 25] = False
    assert not compare_topology(image, fixed(image, 9, mode="add_only", keep_gaps_mm=1))
    assert compare_topology(image, fixed(image, 9, mode="add_only"))


@settings(max_examples=200)
@given(images(), images(), st.integers(2, 12), st.sampled_from(MODES))
def test_nothing_is_added_where_nothing_is_to_be(image, other, size, mode):
    """Whatever is kept out; where it is nowhere near, the result is as without."""
    height, width = (min(a, b) for a, b in zip(image.shape, other.shape, strict=True))
    image, other = (framed(one[:height, :width], size + 2) for one in (image, other))
    kept = fixed(image, size, mode=mode, keep_out=stack_of(other))
    assert not (kept & ~image & other).any()
    assert np.array_equal(
        fixed(image, size, mode=mode, keep_out=stack_of(other & image)), fixed(image, size, mode=mode)
    )


@pytest.mark.parametrize("size", [6, 7, 10])
def test_material_goes_to_the_other_side(size):
    """A wall of 3 px beside a bore: as wide as F, all of it away from the bore."""
    image = framed(np.zeros((30, 80), bool), 14)
    image[20:23, 16:90] = True
    bore = np.zeros_like(image)
    bore[23:40, :] = True
    (layer,) = correct(stack_of(image), min_feature_mm=size, keep_out=stack_of(bore))
    across = layer.image()[:, 50]
    assert np.flatnonzero(across).tolist() == list(range(23 - size, 23))
    assert layer.change.conflicts == ()
    assert ndimage.label(layer.image(), ALL_AROUND)[1] == 1


@pytest.mark.parametrize("mode", ["add_only", "as_printed"])
def test_where_nothing_fits_it_is_told(mode):
    """A wall between two bores: it stays as it is, and its place and width are a conflict."""
    image = framed(np.zeros((30, 80), bool), 14)
    image[20:23, 16:90] = True
    bores = framed(np.ones((30, 80), bool), 14) & ~image
    (layer,) = correct(
        stack_of(image, pixel_mm=0.1), min_feature_mm=0.9, keep_out=stack_of(bores, pixel_mm=0.1), mode=mode
    )
    assert np.array_equal(layer.image(), image)
    (conflict, *more) = layer.change.conflicts
    assert conflict.kind == "keep_out"
    assert conflict.width_mm == pytest.approx(0.3)
    assert not more
    left, bottom, right, top = conflict.box_mm
    assert right - left > 6
    assert top - bottom <= 0.3


def test_outward_and_inward():
    """A ring of 3 px: outward its hole stays, inward its outside does; in both it is F wide."""
    y, x = np.indices((121, 121)) - 60
    ring = framed((np.hypot(y, x) < 40) & (np.hypot(y, x) >= 37), 10)
    hole = ndimage.binary_fill_holes(ring) & ~ring
    outward, inward = (fixed(ring, 9, mode="add_only", grow=grow) for grow in ("outward", "inward"))
    assert not (outward & hole).any()
    assert not (inward & ~hole & ~ring).any()
    row = ring.shape[0] // 2
    for one in (outward, inward):
        assert one[row, : ring.shape[1] // 2].sum() in (9, 10)
        assert compare_topology(ring, one) == []


def test_layers_find_their_own_keep_out():
    """By height, whatever the layers' numbers."""
    image = framed(np.zeros((30, 60), bool), 12)
    image[20, 20:60] = True
    below = np.zeros_like(image)
    below[21:, :] = True
    thick = LayerStack.from_images([below, np.zeros_like(image)], pixel_mm=1.0, layer_mm=1.0)
    layers = correct(stack_of(*[image] * 5), min_feature_mm=5, keep_out=thick)
    assert [bool((layer.image() & below).any()) for layer in layers] == [False, False, True, True, True]


def test_what_cannot_be_is_refused():
    """Names, lengths, frames."""
    stack = stack_of(block(9, 9, 4))
    for how, says in (
        ({"grow": "up"}, "grow='up' is not known"), ({"keep_gaps_mm": 0}, "keep gaps of 0 mm"),
        ({"keep_out": stack_of(block(9, 9, 5))}, "is not on the frame"),
        ({"keep_out": stack_of(block(9, 9, 4), pixel_mm=2.0)}, "is not on the frame"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=says):
            correct(stack, min_feature_mm=4, **how)


FIX = ("--pixel", "50um", "--layer", "0.1mm", "--min-feature", "0.6mm")


def test_the_command_keeps_gaps_and_says_what_stays_thin(tmp_path):
    """Two fins: they grow together; apart, with a conflict for each layer; and a bore that stays."""
    fins = joined(box([0, 0, 0], [4, 0.2, 0.4]), box([0, 0.5, 0], [4, 0.7, 0.4]))
    save_stl(tmp_path / "fins.stl", fins)
    run = run_layerfix("fix", tmp_path / "fins.stl", tmp_path / "a.zip", *FIX)
    assert "8 parts grew together into 4, in 4 layers" in run.out
    run = run_layerfix("fix", tmp_path / "fins.stl", tmp_path / "b.zip", *FIX, "--keep-gaps", "0.1mm", "--json")
    said = json.loads(run.out)
    assert said["topology"] == []
    assert len({conflict["z_mm"][0] for conflict in said["conflicts"]}) == 4
    assert all(0.3 < conflict["width_mm"] < 0.6 for conflict in said["conflicts"])
    run = run_layerfix("fix", tmp_path / "fins.stl", tmp_path / "c.zip", *FIX, "--keep-gaps", "0.1mm")
    assert "under 0.6 mm" in run.out
    save_stl(tmp_path / "bore.stl", box([-1, 0.2, -1], [5, 0.5, 1]))
    run = run_layerfix(
        "fix", tmp_path / "fins.stl", tmp_path / "d.zip", *FIX, "--keep-out", tmp_path / "bore.stl", "--json"
    )
    said = json.loads(run.out)
    assert (run.code, said["topology"], said["conflicts"]) == (0, [], [])
    assert said["added_mm3"] == pytest.approx(2 * 0.4 * 4 * 0.4, rel=0.2)


@pytest.mark.parametrize("mode", ["add_only", "as_printed"])
@pytest.mark.parametrize("grow", ["inward", "outward"])
def test_what_may_grow_nowhere_stays(mode, grow):
    """A wall beside a block, a pin in a ring: thin, told, and there, whatever else the tool rounds off."""
    image = framed(np.zeros((40, 60), bool), 14)
    if grow == "inward":
        thin = np.zeros_like(image)
        thin[18:48, 60:63] = True
        image[18:48, 18:50] = True
    else:
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        off = np.hypot(y - 34, x - 40)
        image |= (off <= 18) & (off > 8)
        thin = off <= 1.5
    image |= thin
    (layer,) = correct(stack_of(image), min_feature_mm=8, grow=grow, mode=mode)
    assert (layer.image() & thin).sum() == thin.sum()
    assert layer.change.conflicts
