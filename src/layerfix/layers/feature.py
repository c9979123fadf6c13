"""F, the minimum printable feature, as pixels: the structuring element of the method.

By radius (the paper's form): the offsets with (dx/rx)² + (dy/ry)² ≤ 1. Around a pixel's centre a disc is always an
odd number of pixels wide, 2·⌊r⌋ + 1; half of all sizes come out a pixel too wide.

By size: F is the pixels whose centres lie within d/2 of a point. The point is a pixel's centre where d, rounded to
whole pixels, is odd, and a pixel's corner where it is even, on each axis of its own. So F is round(d) pixels wide. It
is written as a symmetric disc G, swept over a block of one or two pixels: F = G ⊕ block. Of an even F, the half pixel
that has no place goes to +x and +y (east and down), everywhere: a straight wall stays straight, and a layer that is
moved comes out moved. (Half a pixel towards the frame's middle would keep mirror images, and bend walls across it.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.layers.morphology import disc_half_widths
from layerfix.units import format_mm, one_or_two

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_SIZE_PX = 8192  # a disc of half a gigabyte of offsets; no printer is that coarse
Radius = float | tuple[float, float]


@dataclass(frozen=True, eq=False)
class Feature:
    """F on a pixel frame.

    half_widths  of G, entry |dy| is the largest |dx|; int64, falling
    block        (bx, by): 1 where F is an even number of pixels wide and reaches a pixel further east (down), else 0
    radius_px    (rx, ry): half of F's size, in pixels, before any rounding
    by_size      F is as wide as its size says, and is drawn only where S ∘ F misses something (`drawing`)
    """

    half_widths: NDArray[np.int64]
    block: tuple[int, int]
    radius_px: tuple[float, float]
    by_size: bool

    @property
    def size_px(self) -> tuple[int, int]:
        """How many pixels F is wide and high."""
        return 2 * int(self.half_widths[0]) + 1 + self.block[0], 2 * len(self.half_widths) - 1 + self.block[1]

    @property
    def offset_px(self) -> tuple[float, float]:
        """(x, y) of F's middle from its pixel's centre, east and down: half a pixel where F is even."""
        return self.block[0] / 2, self.block[1] / 2

    @property
    def reach_px(self) -> tuple[int, int]:
        """How far F reaches from its pixel at most, along x and y."""
        return int(self.half_widths[0]) + self.block[0], len(self.half_widths) - 1 + self.block[1]


def feature_of_radius(radius_px: Radius) -> Feature:
    """F by radius: the paper's disc. Raises InputError unless one or two numbers above 0 are given."""
    rx, ry = one_or_two(radius_px, "radius", "px")
    if max(rx, ry) > MAX_SIZE_PX / 2:
        raise InputError(f"radius {radius_px} px: at most {MAX_SIZE_PX // 2} px")
    return Feature(disc_half_widths(rx, ry), (0, 0), (rx, ry), by_size=False)


def feature_of_size(size_px: Radius) -> Feature:
    """F by size: round(size) pixels wide on each axis. Raises InputError unless given one or two numbers above 0."""
    dx, dy = one_or_two(size_px, "minimum feature", "px")
    if max(dx, dy) > MAX_SIZE_PX:
        raise InputError(f"minimum feature {size_px} px: at most {MAX_SIZE_PX} px")
    (reach_x, bx), (reach_y, by) = _reach_and_block(dx), _reach_and_block(dy)
    rows = (2 * np.arange(reach_y + 1) + by) / dy  # 1 is F's edge
    guess = np.floor(dx / 2 * np.sqrt(np.maximum(1 + 1e-9 - rows**2, 0)) - bx / 2).astype(np.int64) + 1
    inside = ((2 * guess + bx) / dx) ** 2 + rows**2 <= 1 + 1e-9
    half_widths = np.clip(np.where(inside, guess, guess - 1), 0, reach_x)
    half_widths[0] = reach_x  # the middle row and column are full, however flat F is
    return Feature(half_widths, (bx, by), (dx / 2, dy / 2), by_size=True)


def _reach_and_block(size_px: float) -> tuple[int, int]:
    """(how far G reaches, 1 if F is an even number of pixels wide) along one axis."""
    width = max(1, math.floor(size_px + 0.5 + 1e-9))
    block = 1 - width % 2
    return (width - 1 - block) // 2, block


def feature_of_mm(min_feature_mm: float, pixel_mm: tuple[float, float]) -> Feature:
    """F by its size in mm. Raises InputError as `check_feature_mm` and `feature_of_size` do."""
    check_feature_mm(min_feature_mm, pixel_mm)
    return feature_of_size((min_feature_mm / pixel_mm[0], min_feature_mm / pixel_mm[1]))


def check_feature_mm(min_feature_mm: float, pixel_mm: tuple[float, float]) -> None:
    """Raises InputError unless F is above 0 and so large that something can be too thin: two pixels."""
    if not 0 < min_feature_mm < np.inf:
        raise InputError(f"minimum feature {min_feature_mm} mm: it must be above 0")
    dx, dy = min_feature_mm / pixel_mm[0], min_feature_mm / pixel_mm[1]
    if max(dx, dy) < 2 * (1 - 1e-9):
        raise InputError(
            f"minimum feature {format_mm(min_feature_mm)} is under two pixels of"
            f" {' × '.join(format_mm(p) for p in sorted(set(pixel_mm)))}: no layer can hold anything thinner,"
            " so there is nothing to correct; use smaller pixels or a larger feature"
        )
