"""Pictures for tests: drawn as text, drawn as strips, discs and rings, and made at random."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import strategies as st
from scipy import ndimage

# Around the word size of packed rows, 64.
WIDTHS = (1, 2, 63, 64, 65, 127, 128, 129, 130)


def picture(drawing: str) -> np.ndarray:
    """Lines such as ``. # #`` as a (H, W) bool image; spaces and empty lines are for the eye only.

    >>> picture('''
    ...     . # #
    ...     # . .
    ... ''').astype(int).tolist()
    [[0, 1, 1], [1, 0, 0]]
    """
    lines = ["".join(line.split()) for line in drawing.splitlines() if line.strip()]
    strange = set("".join(lines)) - {".", "#"}
    if strange or len({len(line) for line in lines}) != 1:
        raise ValueError(f"a picture has lines of one length of '.' and '#', not {sorted(strange) or lines}")
    return np.array([[letter == "#" for letter in line] for line in lines])


def drawing(image: np.ndarray) -> str:
    """The image as lines such as ``. # #``, so that a failed comparison shows what differs."""
    return "\n".join(" ".join("#" if solid else "." for solid in row) for row in image)


def framed(image: np.ndarray, margin_px: int) -> np.ndarray:
    """The image with so many void pixels on every side."""
    return np.pad(np.asarray(image, bool), margin_px)


def block(height: int, width: int, margin_px: int) -> np.ndarray:
    """A solid rectangle."""
    return framed(np.ones((height, width), bool), margin_px)


def strip(
    width: float, degrees: float, *, length: float = 80.0, size_px: int = 110, pixel: tuple[float, float] = (1.0, 1.0)
) -> np.ndarray:
    """A straight wall through the middle, in the unit of `pixel`; its direction is counter-clockwise from east."""
    y, x = np.mgrid[:size_px, :size_px]
    x, y = (x - size_px / 2 + 0.2) * pixel[0], (size_px / 2 - 0.3 - y) * pixel[1]
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (abs(y * c - x * s) <= width / 2) & (abs(x * c + y * s) <= length / 2)


def round_dot(radius: float, size_px: int, pixel: tuple[float, float] = (1.0, 1.0)) -> np.ndarray:
    """A filled circle in the middle of a square frame of odd size, in the unit of `pixel`."""
    y, x = np.mgrid[:size_px, :size_px] - size_px // 2
    return (x * pixel[0]) ** 2 + (y * pixel[1]) ** 2 <= radius**2 + 1e-9


def _noise(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    return random.random((height, width)) < random.choice([0.02, 0.2, 0.5, 0.7, 0.9, 0.99, 1.0])


def _blobs(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    smooth = ndimage.gaussian_filter(random.random((height, width)), random.uniform(0.5, 4))
    return smooth <= np.quantile(smooth, random.uniform(0.1, 0.95))


def _stripes(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    y, x = np.mgrid[:height, :width]
    angle, period = random.uniform(0, np.pi), random.uniform(2, 24)
    wave = (x * np.cos(angle) + y * np.sin(angle) + random.uniform(0, period)) % period
    return wave < period * random.uniform(0.1, 0.95)


def _strokes(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    y, x = np.mgrid[:height, :width]
    image = np.zeros((height, width), bool)
    for _ in range(random.integers(1, 9)):
        (x0, x1), (y0, y1) = random.uniform(-3, width + 3, 2), random.uniform(-3, height + 3, 2)
        along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / max((x1 - x0) ** 2 + (y1 - y0) ** 2, 1e-9)
        along = np.clip(along, 0, 1)
        away = np.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0))
        image |= away <= random.choice([0.5, 0.8, 1.5, 3, 6])
    return image


def _parts(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Like a sliced part: a block, slots and holes in it, fins, pins and a ring beside it."""
    y, x = np.mgrid[:height, :width]
    image = np.zeros((height, width), bool)
    for solid in random.permutation([True, True, True, False, False]):
        y0, x0 = random.uniform(0, height), random.uniform(0, width)
        if random.random() < 0.5:
            across, along = random.uniform(0.5, 1 + width / 3), random.uniform(0.5, 12)
            image[(abs(x - x0) < across) & (abs(y - y0) < along)] = solid
        else:
            away, radius = np.hypot(x - x0, y - y0), random.uniform(0.5, 14)
            image[(away < radius) & (away > random.choice([0, radius - 2.5]) - 1)] = solid
    return image


AROUND_THE_WORD_SIZE = st.sampled_from(WIDTHS)
SMALL = st.integers(1, 40)
KINDS = {"noise": _noise, "blobs": _blobs, "stripes": _stripes, "strokes": _strokes, "parts": _parts}


@st.composite
def images(
    draw: st.DrawFn,
    widths: st.SearchStrategy[int] = AROUND_THE_WORD_SIZE,
    heights: st.SearchStrategy[int] = SMALL,
    kinds: tuple[str, ...] = tuple(KINDS),
) -> np.ndarray:
    """A (H, W) bool image of any of KINDS; what is solid may touch the frame."""
    kind, height, width = draw(st.sampled_from(kinds)), draw(heights), draw(widths)
    return KINDS[kind](np.random.default_rng(draw(st.integers(0, 2**32 - 1))), height, width)


def radii(low: float = 0.4, high: float = 7.0) -> st.SearchStrategy[tuple[float, float]]:
    """(rx, ry) in px: equal or not, whole and half numbers among them."""
    one = st.one_of(st.floats(low, high), st.integers(1, int(2 * high)).map(lambda n: max(n / 2, low)))
    return st.one_of(one.map(lambda r: (r, r)), st.tuples(one, one))
