"""Algorithm 2 as one would write it with NumPy and OpenCV: what the packed kernels are measured against.

`correct` spells the paper's conditions out on whole arrays. `correct_by_lookup` is the tuned form: cv2 builds
the neighbourhood code of every pixel, and a table of 256 entries says whether it goes.
"""

import cv2
import numpy as np


def disc(rx: float, ry: float) -> np.ndarray:
    """The structuring element F as a cv2 kernel."""
    x, y = int(rx + 1e-9), int(ry + 1e-9)
    dy, dx = np.mgrid[-y : y + 1, -x : x + 1]
    return ((dx / rx) ** 2 + (dy / ry) ** 2 <= 1 + 1e-9).astype(np.uint8)


def neighbours(solid: np.ndarray) -> list[np.ndarray]:
    """x1 … x8 of every pixel: east, then counter-clockwise."""
    p = np.pad(solid, 1)
    return [
        p[1:-1, 2:], p[:-2, 2:], p[:-2, 1:-1], p[:-2, :-2],
        p[1:-1, :-2], p[2:, :-2], p[2:, 1:-1], p[2:, 2:],
    ]  # fmt: skip


def deletable(x: list[np.ndarray], first: bool) -> np.ndarray:
    """Equation 3 of the paper on arrays of any shape."""
    x1, x2, x3, x4, x5, x6, x7, x8 = x
    b = [~x1 & (x2 | x3), ~x3 & (x4 | x5), ~x5 & (x6 | x7), ~x7 & (x8 | x1)]
    crossing = sum(v.astype(np.uint8) for v in b)
    n1 = sum(v.astype(np.uint8) for v in (x1 | x2, x3 | x4, x5 | x6, x7 | x8))
    n2 = sum(v.astype(np.uint8) for v in (x2 | x3, x4 | x5, x6 | x7, x8 | x1))
    n = np.minimum(n1, n2)
    side = (x2 | x3 | ~x8) & x1 if first else (x6 | x7 | ~x4) & x5
    return (crossing == 1) & (n >= 2) & (n <= 3) & ~side


def end_points(x: list[np.ndarray]) -> np.ndarray:
    """Exactly one neighbour."""
    return sum(v.astype(np.uint8) for v in x) == 1


def remove_spurs(solid: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """Ends whose neighbour lies E, NE, N or NW, then the others that still are ends."""
    x = neighbours(solid)
    ends = solid & ~anchor & end_points(x)
    upper = ends & (x[0] | x[1] | x[2] | x[3])
    solid = solid & ~upper
    return solid & ~(ends & ~upper & end_points(neighbours(solid)))


def correct(solid: np.ndarray, rx: float, ry: float) -> np.ndarray:
    """The corrected layer Ŝ of a bool image, as_printed."""
    kernel = disc(rx, ry)
    anchor = cv2.erode(solid.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0).astype(bool)
    skeleton, j = solid, 0
    while True:
        before = skeleton
        for first in (True, False):
            skeleton = skeleton & ~(deletable(neighbours(skeleton), first) & ~anchor)
        if j < max(rx, ry):
            skeleton = remove_spurs(skeleton, anchor)
        j += 1
        if np.array_equal(skeleton, before):
            return cv2.dilate(skeleton.astype(np.uint8), kernel).astype(bool)


_CODES = np.arange(256, dtype=np.uint8)
_X = [(_CODES >> k & 1).astype(bool) for k in range(8)]
_KEEP = {first: np.where(deletable(_X, first), 0, 255).astype(np.uint8) for first in (True, False)}
_END = np.where(end_points(_X), 255, 0).astype(np.uint8)
_UPPER_END = np.where(end_points(_X) & (_X[0] | _X[1] | _X[2] | _X[3]), 255, 0).astype(np.uint8)
_WEIGHTS = np.array([[8, 4, 2], [16, 0, 1], [32, 64, 128]], np.float32)


def _codes(image: np.ndarray) -> np.ndarray:
    return cv2.filter2D(image, cv2.CV_8U, _WEIGHTS, borderType=cv2.BORDER_CONSTANT)


def correct_by_lookup(solid: np.ndarray, rx: float, ry: float) -> np.ndarray:
    """The same result with cv2 doing all the work on 0/1 images: filter2D, LUT, bitwise operations."""
    kernel = disc(rx, ry)
    image = solid.astype(np.uint8)
    anchor = cv2.erode(image, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    not_anchor = 1 - anchor
    j = 0
    while True:
        before = image
        for first in (True, False):
            image = image & (cv2.LUT(_codes(image), _KEEP[first]) | anchor)
        if j < max(rx, ry):
            codes = _codes(image)
            ends = cv2.LUT(codes, _END) & image & not_anchor
            upper = cv2.LUT(codes, _UPPER_END) & image & not_anchor
            image = image & ~upper
            image = image & ~(ends & ~upper & cv2.LUT(_codes(image), _END))
        j += 1
        if np.array_equal(image, before):
            return cv2.dilate(image, kernel).astype(bool)
