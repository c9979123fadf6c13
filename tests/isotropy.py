"""How alike a shape comes out at every angle: ``python -m tests.isotropy [sizes]`` prints the table.

Every measure draws one shape at many angles and places and corrects it with F of d pixels, by the paper's rule (F by
radius) and by the metric rule (F by size). Lengths in px, areas in d² or px; what is ideal is 0.

  corners     what is added at a corner of a square and of a hexagon, at most
  strips      the length of strips of 1 px to d - 1 px after correction less before: least, most, share beyond ± 2 px
  60°         added and lost at a corner of 60° at most
  bumps       what is added at bumps shorter than d / 4, at most; the tips of ones of d and longer: least, most
  edges       added per px of a straight edge with noise of a pixel, at most
  mirrored    pixels that differ when a drawing is mirrored across x, y, turned, transposed
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from layerfix import correct_image

Corrected = Callable[[np.ndarray], np.ndarray]
ANGLES = np.arange(0, 91, 5.0)
PLACES = (0.0, 0.3, 0.55)


def rules(d: int) -> dict[str, Corrected]:
    """By name: how a layer is corrected with F of d pixels."""
    return {
        "paper": lambda image: correct_image(image, d / 2, spurs="paper"),
        "metric": lambda image: correct_image(image, min_feature_px=d, spurs="metric"),
    }


def axes(size_px: int, degrees: float, place: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates u, v of pixel centres in a frame that is turned and moved."""
    y, x = np.mgrid[:size_px, :size_px] - size_px / 2 + 0.5 + place
    t = np.deg2rad(degrees)
    return x * np.cos(t) + y * np.sin(t), y * np.cos(t) - x * np.sin(t)


def polygons(d: int, sides: int, angles: np.ndarray = ANGLES) -> Iterator[np.ndarray]:
    """Regular polygons much larger than F."""
    inner, size = {3: (2.0, 8.4), 4: (2.0, 5.9), 6: (3.5, 8.4)}[sides]
    n = int(size * d) + 10
    for degrees in angles:
        for place in PLACES:
            faces = [axes(n, degrees + 360 * k / sides, place)[0] <= inner * d for k in range(sides)]
            yield np.all(faces, axis=0)


def corners(fix: Corrected, d: int, sides: int, angles: np.ndarray = ANGLES) -> tuple[float, float]:
    """(added, lost) at a corner of a polygon, at most; in d²."""
    added, lost = 0.0, 0.0
    for image in polygons(d, sides, angles):
        fixed = fix(image)
        added = max(added, (fixed & ~image).sum() / sides / d**2)
        lost = max(lost, (image & ~fixed).sum() / sides / d**2)
    return added, lost


def strip_widths(d: int) -> list[float]:
    """Widths in px under d."""
    small = {w for w in (4, 5, 7) if w < d}
    return sorted({1, 1.5, 2, 3, d // 2, 3 * d // 4, d - 3, d - 2, d - 1} | small)


def strip_errors(fix: Corrected, d: int, angles: np.ndarray = ANGLES) -> np.ndarray:
    """(strips,) how much longer each strip is after correction, in px."""
    errors = []
    for width in strip_widths(d):
        for degrees in angles:
            for place in (0, 0.25, 0.5):
                length = 5 * d + 20 + place
                u, v = axes(int(length + 3 * d), degrees)
                image = (abs(u) <= length / 2) & (abs(v + place) <= width / 2)
                errors.append(np.ptp(u[fix(image)]) - np.ptp(u[image]))
    return np.array(errors)


def bumps(
    fix: Corrected, d: int, lengths: tuple[float, ...], angles: np.ndarray = ANGLES
) -> tuple[float, float, float]:
    """(added in d² at most, tip after less before: least, most) of bars of these lengths in d on a block."""
    added, tips = 0.0, []
    for width in sorted({1, 2, 3, d // 4, d // 2, 3 * d // 4, d - 1}):
        for length in lengths:
            for degrees in angles:
                u, v = axes(10 * d + 40, degrees, 0.2)
                half = np.where(u <= 0, 2.5 * d, width / 2)
                image = (u <= length * d) & (u > -2.5 * d) & (abs(v) <= half)
                fixed, middle = fix(image), abs(v) <= 1.5 * d
                tips.append(u[fixed & middle].max() - u[image].max())
                added = max(added, (fixed & ~image & middle).sum() / d**2)
    return added, min(tips), max(tips)


def edges(fix: Corrected, d: int, angles: np.ndarray = ANGLES) -> float:
    """Added per px of a noisy straight edge, at most."""
    random, most = np.random.default_rng(d), 0.0
    for degrees in angles:
        for kind in range(3):
            u, v = axes(9 * d + 40, degrees, 0.2)
            row = (v + 8 * d).astype(int)
            noise = (random.uniform(-1, 1, u.shape), random.uniform(-1, 1, 40 * d)[row],
                     random.integers(-1, 2, 40 * d)[row // max(1, d // 4)])[kind]  # fmt: skip
            image = ndimage.binary_fill_holes((u > -2.5 * d) & (abs(v) <= 2.5 * d) & (u - noise <= 1.5 * d))
            labels = ndimage.label(image, np.ones((3, 3)))[0]
            image = labels == np.bincount(labels.ravel())[1:].argmax() + 1
            most = max(most, (fix(image) & ~image & (abs(v) <= 1.8 * d) & (u > 0)).sum() / (3.6 * d))
    return most


def writing() -> np.ndarray:
    """Three lines of letters with strokes of 2, 4 and 9 px."""
    image = np.zeros((420, 620), np.uint8)
    cv2.putText(image, "Mesh R4", (14, 100), cv2.FONT_HERSHEY_COMPLEX, 3.4, 1, 4)
    cv2.putText(image, "kfix 27", (20, 220), cv2.FONT_HERSHEY_SIMPLEX, 3.2, 1, 9)
    cv2.putText(image, "thin WAX", (20, 340), cv2.FONT_HERSHEY_SCRIPT_COMPLEX, 3.4, 1, 2)
    return np.pad(image > 0, 20)


def gear() -> np.ndarray:
    """Eighteen teeth, five spokes."""
    y, x = np.mgrid[:420, :420] - 210.0
    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    tooth = abs((angle * 18 / 2 / np.pi + 0.13) % 1 - 0.5) < 0.34 - 0.14 * (radius - 150) / 40
    spoke = abs((angle * 5 / 2 / np.pi + 0.3) % 1 - 0.5) < 0.46
    wheel = ((radius < 150) | ((radius < 190) & tooth)) & (radius > 45) & ~((radius > 70) & (radius < 125) & spoke)
    return np.pad(wheel, 20)


TURNS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "x": (np.fliplr, np.fliplr),
    "y": (np.flipud, np.flipud),
    "turned": (np.rot90, lambda image: np.rot90(image, -1)),
    "transposed": (np.transpose, np.transpose),
}


def mirrored(fix: Corrected, image: np.ndarray) -> list[int]:
    """Pixels in which the correction of the mirrored drawing is not the mirrored correction, for each of `TURNS`."""
    fixed = fix(image)
    return [int((fixed != back(fix(np.ascontiguousarray(turn(image))))).sum()) for turn, back in TURNS.values()]


def table(d: int) -> Iterator[str]:
    """Lines for one size."""
    for name, fix in rules(d).items():
        square, hexagon, sharp = (corners(fix, d, sides) for sides in (4, 6, 3))
        errors = strip_errors(fix, d)
        short, long = bumps(fix, d, (0.15, 0.2, 0.24)), bumps(fix, d, (1, 1.5, 3))
        yield (
            f"d = {d} {name}: corners {square[0]:.3f} {hexagon[0]:.3f} d²;"
            f" strips {errors.min():.1f} … {errors.max():.1f} px,"
            f" {100 * (abs(errors) > 2.01).mean():.1f} % beyond 2 px; 60° +{sharp[0]:.3f} -{sharp[1]:.3f} d²;"
            f" bumps {short[0]:.3f} d², tips {long[1]:.1f} … {long[2]:.1f} px; edges {edges(fix, d):.4f};"
            f" mirrored writing {mirrored(fix, writing())}, gear {mirrored(fix, gear())} px"
        )


if __name__ == "__main__":
    for size in [int(text) for text in sys.argv[1:]] or [8, 12, 14, 20, 30]:
        for line in table(size):
            print(line, flush=True)
