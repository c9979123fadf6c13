"""What of a grey layer is solid, once more: from the definition, pixel by pixel, with scipy's components."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tests import slow_twin

ALL_AROUND = np.ones((3, 3))
BESIDE = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))
PATTERN_PX = 16


def reached(seed: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Components of a mask that hold a pixel of the seed."""
    labels, count = ndimage.label(mask, ALL_AROUND)
    touched = np.zeros(count + 1, bool)
    touched[labels[seed & mask]] = True
    touched[0] = False
    return touched[labels]


def crests(grey: np.ndarray) -> np.ndarray:
    """Brighter than both neighbours on a line; of two equal ones side by side the lower or right one."""
    g = np.pad(grey.astype(int), 2)

    def seen_from(dy: int, dx: int) -> np.ndarray:
        return g[2 + dy : g.shape[0] - 2 + dy, 2 + dx : g.shape[1] - 2 + dx]

    here, out = seen_from(0, 0), np.zeros(grey.shape, bool)
    for dy, dx in ((1, 0), (0, 1)):
        after, before, farther = (seen_from(k * dy, k * dx) for k in (1, -1, -2))
        out |= (here > after) & ((here > before) | ((here == before) & (here > farther)))
    return out


def pruned(solid: np.ndarray, doubtful: np.ndarray) -> np.ndarray:
    """Without doubtful pixels whose going parts nothing, taken in reading order until there are none."""
    padded, again = np.pad(solid, 1), True
    while again:
        again = False
        for y, x in np.argwhere(doubtful & padded[1:-1, 1:-1]) + 1:
            ring = [bool(padded[y + dy, x + dx]) for dy, dx in BESIDE]
            turns = sum(not ring[k] and (ring[k + 1] or ring[(k + 2) % 8]) for k in range(0, 8, 2))
            if turns == 1 or not any(ring):
                padded[y, x] = False
                again = True
    return padded[1:-1, 1:-1]


def dimmed_in(grey: np.ndarray, threshold: int, floor: int) -> np.ndarray:
    """Areas of dim pixels that no way leads to from the void, with the bright pixels between them; and parts without
    a bright pixel that are wider than strokes."""
    faint, bright = grey >= floor, grey >= threshold
    lone = faint & ~reached(bright, faint)
    broad = reached(slow_twin.opening(lone, 2.5, 2.5), lone)
    dim = faint & ~bright
    inside = dim & ~reached(dim & ndimage.binary_dilation(~faint, ALL_AROUND), dim)
    if inside.sum() < PATTERN_PX:
        return broad
    return broad | slow_twin.opening(ndimage.binary_dilation(inside, ALL_AROUND), 2.5, 2.5) & faint


def solid_in(grey: np.ndarray, threshold: int = 128, floor: int = 32) -> np.ndarray:
    """Bright pixels, faint strokes on their own, crests of thin strokes, dimmed interiors."""
    bright = grey >= threshold
    if not 0 < floor < threshold:
        return bright
    faint = grey >= floor
    crest = crests(grey) & faint & ~bright
    wide = slow_twin.dilation(slow_twin.opening(bright, 1, 1), 4, 4)
    solid = pruned(bright | crest, crest & wide)
    return solid | (faint & ~reached(bright, faint)) | dimmed_in(grey, threshold, floor)
