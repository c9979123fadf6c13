"""What becomes of parts and voids: drawn pictures, and scipy's labels on anything."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy import ndimage, sparse

from layerfix import LayerStack, TopologyChange, compare_topology, correct, correct_image
from layerfix.errors import InputError
from tests.pictures_as_text import block, framed, images

ALL_AROUND = np.ones((3, 3))


def groups_of(before: np.ndarray, after: np.ndarray, shape: np.ndarray | None) -> list[tuple[list[int], list[int]]]:
    """Areas of the components before and after that hang together, as a graph says it: of two that share pixels, one
    shares more with the other than with any else (the first of equals, as they are met)."""
    (one, n), (other, m) = ndimage.label(before, shape), ndimage.label(after, shape)
    both = before & after
    shared = Counter(zip((one[both] - 1).tolist(), (other[both] - 1).tolist(), strict=True))  # as they are met
    first = {a: max((pair for pair in shared if pair[0] == a), key=shared.__getitem__) for a, _ in shared}
    last = {b: max(sorted(pair for pair in shared if pair[1] == b), key=shared.__getitem__) for _, b in shared}
    a, b = (np.array([pair[k] for pair in {*first.values(), *last.values()}], int) for k in (0, 1))
    edges = sparse.coo_matrix((np.ones(len(a)), (a, n + b)), (n + m, n + m))
    _, group = sparse.csgraph.connected_components(edges, directed=False)
    areas = np.bincount(one[before] - 1, minlength=n), np.bincount(other[after] - 1, minlength=m)
    return [(areas[0][group[:n] == k].tolist(), areas[1][group[n:] == k].tolist()) for k in set(group.tolist())]


def expected(before: np.ndarray, after: np.ndarray) -> list[tuple[str, int, float]]:
    """(kind, count, area) of each change, the largest first."""
    changes: list[tuple[str, int, float]] = []
    for old, new in groups_of(before, after, ALL_AROUND):
        changes += [("merged", len(old), sum(old) - max(old))] if len(old) > 1 else []
        changes += [("split", len(new), sum(new) - max(new))] if len(new) > 1 else []
        changes += [("lost", 1, old[0])] if not new else []
        changes += [("new", 1, new[0])] if not old else []
    for old, new in groups_of(~before, ~after, None):
        changes += [("opened", len(old), sum(old) - max(old))] if len(old) > 1 else []
        changes += [("enclosed", len(new), sum(new) - max(new))] if len(new) > 1 else []
        changes += [("closed", 1, old[0])] if not new else []
        changes += [("opened", 1, new[0])] if not old else []
    return sorted(changes, key=lambda change: (-change[2], change))


@settings(max_examples=200)
@given(images(), images())
def test_as_the_labels_say(one, other):
    """Any two layers of one size, one that holds the other, one that lost a part of it."""
    height, width = min(one.shape[0], other.shape[0]), min(one.shape[1], other.shape[1])
    one, other = one[:height, :width], other[:height, :width]
    for before, after in ((one, other), (one, one | other), (one | other, one)):
        found = [(c.kind, c.count, c.area_mm2) for c in compare_topology(before, after)]
        # The outside is one void, which a frame's edge does not cut, and it is the largest.
        around = (np.pad(image, 2 * max(height, width)) for image in (before, after))
        assert sorted(found, key=lambda change: (-change[2], change)) == expected(*around)


def test_a_channel_closes_at_its_mouth():
    """The slot of a fork, whose tines grow together at their ends: the rest of it is a void of its own."""
    before = block(20, 40, 4)
    before[10:14, 14:44] = False
    after = before.copy()
    after[10:14, 41:44] = True
    (change,) = compare_topology(before, after)
    assert (change.kind, change.count, change.area_mm2) == ("enclosed", 2, 4 * 27.0)
    assert change.box_mm == (14.0, -14.0, 41.0, -10.0)
    (change,) = compare_topology(after, before)
    assert (change.kind, change.count, change.area_mm2) == ("opened", 2, 4 * 27.0)


def test_two_bars_grow_together():
    """Where, and how much of them."""
    image = framed(np.zeros((20, 40), bool), 10)
    image[14, 12:48] = image[18, 12:30] = True
    (change,) = compare_topology(image, correct_image(image, min_feature_px=6))
    assert change == TopologyChange("merged", 2, (12.0, -19.0, 48.0, -14.0), 18.0)


def test_what_grows_over_a_lost_corner_is_another_part():
    """Two plates; one loses its corner, the other grows over it: neither fell apart, nor grew together."""
    before, after = np.zeros((2, 30, 40), bool)
    before[5:15, 5:15] = before[5:15, 20:30] = True
    after[5:15, 5:12] = after[5:15, 14:30] = True
    assert compare_topology(before, after) == []


@settings(max_examples=100)
@given(images())
def test_correction_lets_nothing_fall_apart(image):
    """Each part's skeleton is in one part of the result."""
    fixed = correct_image(framed(image, 10), min_feature_px=6)
    assert {"split", "lost", "new"}.isdisjoint(c.kind for c in compare_topology(framed(image, 10), fixed))


def test_a_hole_closes():
    """A pin hole in a thin plate."""
    image = block(5, 30, 10)
    image[12, 25] = False
    (change,) = compare_topology(image, image | correct_image(image, min_feature_px=9))
    assert (change.kind, change.area_mm2, change.box_mm) == ("closed", 1.0, (25.0, -13.0, 26.0, -12.0))


def test_stacks_say_where_in_mm_and_at_what_height():
    """On the frame of the stack; `correct` says the same of each layer."""
    image = framed(np.zeros((20, 40), bool), 10)
    image[14, 12:48] = image[18, 12:30] = True
    stack = LayerStack.from_images([np.zeros_like(image), image, image], pixel_mm=(0.1, 0.2), layer_mm=0.5)
    fixed = correct(stack, min_feature_mm=1.2)
    changes = compare_topology(stack, fixed)
    assert [change.z_mm for change in changes] == [(0.5, 1.0), (1.0, 1.5)]
    left, bottom, right, top = changes[0].box_mm
    x, y = stack.origin_mm
    assert (left - x, right - x, y - top, y - bottom) == pytest.approx((1.2, 4.8, 2.8, 3.8))
    assert changes[0].area_mm2 == pytest.approx(18 * 0.02)
    assert [change for layer in fixed for change in layer.change.topology] == changes


def test_nothing_happens_to_what_stays():
    """Equal layers, an empty one, one that only gets thicker."""
    image = block(4, 30, 8)
    for other in (image, correct_image(image, min_feature_px=8)):
        assert compare_topology(image, other) == []
    (change,) = compare_topology(np.zeros((5, 5), bool), np.ones((5, 5), bool))
    assert (change.kind, change.area_mm2) == ("new", 25.0)


def test_what_does_not_match_is_refused():
    """Sizes, numbers of layers, a stack and an image."""
    stack = LayerStack.from_images([block(4, 9, 2)], pixel_mm=1.0, layer_mm=1.0)
    more = LayerStack.from_images([block(4, 9, 2)] * 2, pixel_mm=1.0, layer_mm=1.0)
    for one, other in ((stack, more), (stack, block(4, 9, 2)), (block(4, 9, 2), block(5, 9, 2))):
        with pytest.raises(InputError, match=r"match|stack"):
            compare_topology(one, other)


def test_what_differs_within_a_word_or_in_mm_does_not_match():
    """Widths of one word of pixels, pitches, corners and heights."""
    image = block(20, 40, 2)
    one = LayerStack.from_images([image], pixel_mm=0.1, layer_mm=0.1)
    narrow = np.ascontiguousarray(image[:, :33])
    wide = f"layers of {image.shape[1]} × {image.shape[0]} px and 33 × {image.shape[0]} px"
    pitch, height = (LayerStack.from_images([image], pixel_mm=p, layer_mm=h) for p, h in ((0.2, 0.1), (0.1, 0.4)))
    for other, words in (
        (pitch, "pixels of 0.1 × 0.1 and of 0.2 × 0.2 mm"),
        (height, "layer 0 is at z 0 to 0.1 mm in one and at 0 to 0.4 mm in the other"),
        (replace(one, origin_mm=(1.0, 1.0)), "corners of"),
    ):
        with pytest.raises(InputError, match=words):
            compare_topology(one, other)
    with pytest.raises(InputError, match=wide):
        compare_topology(image, narrow)
    with pytest.raises(InputError, match=wide):
        compare_topology(one[0], LayerStack.from_images([narrow], pixel_mm=0.1, layer_mm=0.1)[0])
    assert compare_topology(one, one) == []
