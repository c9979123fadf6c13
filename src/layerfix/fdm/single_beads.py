"""Skeletal lines → single beads: chains joined at junctions, widths along them, ends carried to the edge."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from layerfix.fdm.chains import trace_lines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Field = NDArray[np.float32]
    Floats = NDArray[np.float64]

TANGENT_PX = 6  # pixels of a chain that tell its direction at an end
LEAST_RADIUS_MM = 0.04  # of the way round a dot
SMOOTH_PX = 5  # pixels over which place and width are averaged along a chain


def bead_lines(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    middle: Field,
    remaining: Field,
    pixel_mm: float,
    narrowest_mm: float,
    *,
    dots: bool,
) -> list[Floats]:
    """(n, 3) x, y in px and spacing in mm of one bead each, from the pixels of skeletal lines.

    middle        (n, 3) mm: thickness there, and where the middle of the place lies beside the pixel
    remaining     (H, W) mm to the edge
    narrowest_mm  the least spacing of a bead
    dots          whether a line shorter than it is wide is laid, too
    """
    if not len(rows):
        return []
    points, starts = trace_lines(np.zeros(remaining.shape, np.uint8), rows, columns)
    chains, open_ends = _joined([points[a:b] for a, b in pairwise(starts)])
    known = dict(zip(zip(columns.tolist(), rows.tolist(), strict=True), middle.tolist(), strict=True))
    beads: list[Floats] = []
    for chain, ends in zip(chains, open_ends, strict=True):
        facts = np.array([known[int(x), int(y)] for x, y in chain])
        spacing, chain = facts[:, 0], chain + facts[:, 1:] / pixel_mm
        extent_px = np.ptp(chain, axis=0).max() if _ring(chain) else len(chain)
        if (all(ends) or _ring(chain)) and extent_px * pixel_mm < max(spacing.max(), narrowest_mm) / 2:
            if dots or spacing.max() >= 1.25 * narrowest_mm:
                beads.append(_dot(chain.mean(axis=0), float(spacing.max()), narrowest_mm, pixel_mm))
            continue
        line = np.column_stack([_smoothed(chain[:, 0]), _smoothed(chain[:, 1]), _smoothed(spacing)])
        for end in (0, 1):
            line = line[::-1]
            if ends[1 - end]:
                line = _carried_on(line, remaining, pixel_mm)
        if len(line) > 1 and np.ptp(line[:, :2], axis=0).max() > 0:
            beads.append(line)
    return beads


def _ring(chain: Floats) -> bool:
    return len(chain) > 2 and bool((chain[0] == chain[-1]).all())


def _dot(middle: Floats, thickness_mm: float, narrowest_mm: float, pixel_mm: float) -> Floats:
    """The narrowest bead round the middle of a dot, as long as gives its area: a stroke would stick out."""
    radius_px = max(thickness_mm**2 / (8 * narrowest_mm), LEAST_RADIUS_MM) / pixel_mm
    angle = np.linspace(0, 2 * np.pi, 9)
    x, y = middle[0] + radius_px * np.cos(angle), middle[1] + radius_px * np.sin(angle)
    loop = np.column_stack([x, y, np.full(len(angle), narrowest_mm)])
    loop[-1] = loop[0]
    return loop


def _smoothed(values: Floats) -> Floats:
    """The running mean over SMOOTH_PX, the ends kept."""
    if len(values) < 3:
        return values.astype(np.float64)
    reach = min(SMOOTH_PX // 2, (len(values) - 1) // 2)
    sums = np.cumsum(np.concatenate([[0.0], values]))
    k = np.arange(len(values))
    near = np.minimum(np.minimum(k, len(values) - 1 - k), reach)
    means: Floats = (sums[k + near + 1] - sums[k - near]) / (2 * near + 1)
    return means


def _carried_on(line: Floats, remaining: Field, pixel_mm: float) -> Floats:
    """The line with its last point moved on, straight, as far as its bead stays inside."""
    back = line[max(len(line) - 1 - TANGENT_PX, 0)]
    along = line[-1, :2] - back[:2]
    length = math.hypot(*along)
    if length == 0:
        return line
    x, y, spacing = line[-1]
    step, far = along / length / 2, 0
    height, width = remaining.shape
    while far < 4 * spacing / pixel_mm:
        i, j = round(x + (far + 1) * step[0]), round(y + (far + 1) * step[1])
        if not (0 <= i < width and 0 <= j < height) or remaining[j, i] < spacing / 2 - 0.75 * pixel_mm:
            break
        far += 1
    if not far:
        return line
    return np.vstack([line, [x + far * step[0], y + far * step[1], spacing]])


def _joined(chains: list[Floats]) -> tuple[list[Floats], list[tuple[bool, bool]]]:
    """Chains that meet at a junction and go straight on there as one; and of each chain, whether its start and its
    end are free (no other chain meets it there)."""
    lines = list(chains)
    ends = [(k, side) for k, chain in enumerate(lines) if len(chain) > 1 and not _ring(chain) for side in (0, 1)]
    places = np.array([lines[k][-side] for k, side in ends]).reshape(-1, 2)
    free = dict.fromkeys(ends, True)
    pairs = []
    for a in range(len(ends)):
        near = np.flatnonzero(np.abs(places[a + 1 :] - places[a]).max(axis=1) <= 2) + a + 1
        for b in near.tolist():
            if ends[a][0] == ends[b][0]:
                continue
            free[ends[a]] = free[ends[b]] = False
            pairs.append((_bend(lines, ends[a], ends[b]), a, b))
    joined: dict[tuple[int, int], tuple[int, int]] = {}
    for bend, a, b in sorted(pairs):
        if bend < math.pi / 3 and ends[a] not in joined and ends[b] not in joined:
            joined[ends[a]], joined[ends[b]] = ends[b], ends[a]
    return _chained(lines, joined, free)


def _bend(lines: list[Floats], one: tuple[int, int], other: tuple[int, int]) -> float:
    """By how much the way turns from the end of one line onto another, in radians."""

    def outwards(line: Floats, side: int) -> Floats:
        tip, back = (line[-1], line[max(len(line) - 1 - TANGENT_PX, 0)]) if side else (line[0], line[:TANGENT_PX][-1])
        return np.asarray(tip - back)

    a, b = outwards(lines[one[0]], one[1]), -outwards(lines[other[0]], other[1])
    return abs(math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b)))


def _chained(
    lines: list[Floats], joined: dict[tuple[int, int], tuple[int, int]], free: dict[tuple[int, int], bool]
) -> tuple[list[Floats], list[tuple[bool, bool]]]:
    """Follow the joints from line to line."""
    done: set[int] = set()
    out, open_ends = [], []
    begins = [(k, side) for k in range(len(lines)) for side in (0, 1) if (k, side) not in joined]
    begins += [(k, 0) for k in range(len(lines))]  # circles of joined lines have no beginning
    for k, side in begins:
        if k in done:
            continue
        parts, at, first = [], (k, side), free.get((k, side), True)
        while True:
            done.add(at[0])
            parts.append(lines[at[0]] if at[1] == 0 else lines[at[0]][::-1])
            leaving = (at[0], 1 - at[1])
            if leaving not in joined or joined[leaving][0] in done:
                break
            at = joined[leaving]
        out.append(np.concatenate(parts))
        open_ends.append((first, free.get(leaving, True) and leaving not in joined))
    return out, open_ends
