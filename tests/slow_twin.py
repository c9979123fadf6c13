"""The method once more, slow and plain: what the fast kernels are compared with, bit by bit.

Images are (H, W) bool, True where solid; outside the frame is empty. Nothing here comes from the package:
it is written from the paper (Ulu et al., equation 3 and Algorithm 2) and the definitions beside it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

# Offsets (dx, dy) of the neighbours x1 … x8: x1 = east, then counter-clockwise; y grows downwards.
NEIGHBOURS = ((1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1))


def disc(rx: float, ry: float) -> list[tuple[int, int]]:
    """Offsets (dx, dy) with (dx/rx)² + (dy/ry)² ≤ 1 (+1e-9)."""
    reach_x, reach_y = int(rx) + 1, int(ry) + 1
    return [
        (dx, dy)
        for dy in range(-reach_y, reach_y + 1)
        for dx in range(-reach_x, reach_x + 1)
        if (dx / rx) ** 2 + (dy / ry) ** 2 <= 1 + 1e-9
    ]


def seen_at(image: np.ndarray, dx: int, dy: int) -> np.ndarray:
    """For every pixel: is its neighbour at (dx, dy) solid?"""
    height, width = image.shape
    padded = np.pad(image, ((abs(dy), abs(dy)), (abs(dx), abs(dx))))
    return padded[abs(dy) + dy : abs(dy) + dy + height, abs(dx) + dx : abs(dx) + dx + width]


def dilation(image: np.ndarray, rx: float, ry: float) -> np.ndarray:
    """S ⊕ F: pixels with a solid pixel in the disc around them."""
    grown = np.zeros_like(image)
    for dx, dy in disc(rx, ry):
        grown |= seen_at(image, dx, dy)
    return grown


def erosion(image: np.ndarray, rx: float, ry: float) -> np.ndarray:
    """S ⊖ F: pixels with nothing but solid pixels in the disc around them."""
    kept = image.copy()
    for dx, dy in disc(rx, ry):
        kept &= seen_at(image, dx, dy)
    return kept


def opening(image: np.ndarray, rx: float, ry: float) -> np.ndarray:
    """S ∘ F: what an uncorrected print keeps."""
    return dilation(erosion(image, rx, ry), rx, ry)


def sub_iteration(image: np.ndarray, anchor: np.ndarray, which: int) -> np.ndarray:
    """The image after Guo–Hall sub-iteration 1 or 2 (equation 3); anchored pixels stay."""
    x = [None, *(seen_at(image, dx, dy) for dx, dy in NEIGHBOURS)]
    x.append(x[1])  # x9 is x1 again
    crossings = sum((~x[2 * k - 1] & (x[2 * k] | x[2 * k + 1])).astype(int) for k in (1, 2, 3, 4))
    n1 = sum((x[2 * k - 1] | x[2 * k]).astype(int) for k in (1, 2, 3, 4))
    n2 = sum((x[2 * k] | x[2 * k + 1]).astype(int) for k in (1, 2, 3, 4))
    a = crossings == 1
    b = (np.minimum(n1, n2) >= 2) & (np.minimum(n1, n2) <= 3)
    c = ((x[2] | x[3] | ~x[8]) & x[1]) == 0 if which == 1 else ((x[6] | x[7] | ~x[4]) & x[5]) == 0
    return image & ~(a & b & c & ~anchor)


def spur_step(image: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """The image after one spur removal: of the end points at the start, first those go whose neighbour lies
    E, NE, N or NW, then those of the others that still are end points."""
    upper = np.any([seen_at(image, dx, dy) for dx, dy in NEIGHBOURS[:4]], axis=0)
    ends = _end_points(image) & ~anchor
    half_way = image & ~(ends & upper)
    return half_way & ~(ends & ~upper & _end_points(half_way))


def _end_points(image: np.ndarray) -> np.ndarray:
    """Solid pixels with exactly one solid 8-neighbour."""
    return image & (sum(seen_at(image, dx, dy).astype(int) for dx, dy in NEIGHBOURS) == 1)


def steps(image: np.ndarray, anchor: np.ndarray, spur_rounds: float) -> Iterator[np.ndarray]:
    """Algorithm 2's loop, anchored: the image after each sub-iteration and each spur removal, to the end."""
    now, before, j = image, None, 0
    while before is None or not np.array_equal(now, before):
        before = now
        for which in (1, 2):
            now = sub_iteration(now, anchor, which)
            yield now
        if j < spur_rounds:
            now = spur_step(now, anchor)
            yield now
        j += 1


def meso_skeleton(image: np.ndarray, rx: float, ry: float) -> np.ndarray:
    """M̂: S thinned until nothing changes, with M = S ⊖ F anchored."""
    *_, last = steps(image, erosion(image, rx, ry), max(rx, ry))
    return last


def corrected(image: np.ndarray, rx: float, ry: float, mode: str) -> np.ndarray:
    """Ŝ = M̂ ⊕ F ("as_printed"), or S ∪ Ŝ ("add_only")."""
    printed = dilation(meso_skeleton(image, rx, ry), rx, ry)
    return {"as_printed": printed, "add_only": image | printed}[mode]


def components(image: np.ndarray) -> int:
    """Solid parts, connected through edges and corners."""
    return int(ndimage.label(image, np.ones((3, 3)))[1])


def holes(image: np.ndarray) -> int:
    """Void parts, connected through edges, without the one that reaches outside the frame."""
    return int(ndimage.label(~np.pad(image, 1))[1]) - 1


def topology(image: np.ndarray) -> tuple[int, int]:
    """(components, holes)."""
    return components(image), holes(image)
