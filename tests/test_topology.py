"""What merges and what closes: drawn pictures, and scipy's labels on anything."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy import ndimage

from layerfix import LayerStack, TopologyChange, compare_topology, correct, correct_image
from layerfix.errors import InputError
from tests.pictures_as_text import block, framed, images

ALL_AROUND = np.ones((3, 3))


def expected(before: np.ndarray, after: np.ndarray) -> list[tuple[str, int, float]]:
    """(kind, count, area) of each change, the largest first."""
    labels, count = ndimage.label(before, ALL_AROUND)
    later, _ = ndimage.label(after, ALL_AROUND)
    becomes: dict[int, list[int]] = {}
    changes: list[tuple[str, int, float]] = []
    for k in range(1, count + 1):
        values = later[(labels == k) & after]
        if len(values):
            becomes.setdefault(int(values[0]), []).append(int((labels == k).sum()))
        else:
            changes.append(("lost", 1, float((labels == k).sum())))
    changes += [("merged", len(v), float(sum(v) - max(v))) for v in becomes.values() if len(v) > 1]
    voids, count = ndimage.label(~np.pad(before, 1))
    left = ~np.pad(after, 1)
    for k in range(1, count + 1):
        if not (left & (voids == k)).any():
            changes.append(("closed", 1, float((voids == k).sum())))
    return sorted(changes, key=lambda change: (-change[2], change))


@settings(max_examples=200)
@given(images(), images())
def test_as_the_labels_say(one, other):
    """Any two layers of one size of which the later holds the earlier, and ones that lose something."""
    height, width = min(one.shape[0], other.shape[0]), min(one.shape[1], other.shape[1])
    one, other = one[:height, :width], other[:height, :width]
    union = one | other
    found = [(c.kind, c.count, c.area_mm2) for c in compare_topology(one, union)]
    assert sorted(found, key=lambda change: (-change[2], change)) == expected(one, union)
    parts, count = ndimage.label(one, ALL_AROUND)
    fewer = one & (parts != 1)
    lost = [c for c in compare_topology(one, fewer) if c.kind == "lost"]
    assert len(lost) == min(count, 1)


def test_two_bars_grow_together():
    """Where, and how much of them."""
    image = framed(np.zeros((20, 40), bool), 10)
    image[14, 12:48] = image[18, 12:30] = True
    (change,) = compare_topology(image, correct_image(image, min_feature_px=6))
    assert change == TopologyChange("merged", 2, (12.0, -19.0, 48.0, -14.0), 18.0)


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
    assert compare_topology(np.zeros((5, 5), bool), np.ones((5, 5), bool)) == []


def test_what_does_not_match_is_refused():
    """Sizes, numbers of layers, a stack and an image."""
    stack = LayerStack.from_images([block(4, 9, 2)], pixel_mm=1.0, layer_mm=1.0)
    more = LayerStack.from_images([block(4, 9, 2)] * 2, pixel_mm=1.0, layer_mm=1.0)
    for one, other in ((stack, more), (stack, block(4, 9, 2)), (block(4, 9, 2), block(5, 9, 2))):
        with pytest.raises(InputError, match=r"match|stack"):
            compare_topology(one, other)
