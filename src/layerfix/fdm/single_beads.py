"""Skeletal lines → single beads: chains joined at junctions, widths along them, ends carried to the edge."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from layerfix.fdm.chains import along_ridge, spot_px, trace_lines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Field = NDArray[np.float32]
    Floats = NDArray[np.float64]

TANGENT_PX = 6  # pixels of a chain that tell its direction at an end
LEAST_RADIUS_MM = 0.04  # of the way round a dot
ENDS_SLOPE = 0.6  # pixels: a ridge that falls faster is the round end of a place, where it falls by one a pixel
# Half a disc lies beyond the end of a ridge, π / 8 of a thickness long at its width; half of that is laid.
PAST_END = 0.2
LEAST_STROKE, LONGEST_STROKE_MM = 0.4, 2.0  # of the place's thickness; what is shorter is a dot
STRAIGHT = 0.85  # of its length are the ends of a stroke apart, or it follows the flat top of something round
NEARLY_ROUND = 1.3  # discs: the ridge of so round a spot bends anywhere
ROUND = 1.5  # discs: a dot fills no more, or it is one of several lobes
THIN = 0.6  # of the narrowest bead
FULL = 0.9  # of the widest bead, at which short strokes are laid at most
STUB_PX = 5  # pixels
LARGEST_SPOT = 1.5  # widest beads from its middle: what is larger is a place in something else
SMOOTH_PX = 5  # pixels over which place and width are averaged along a chain


def bead_lines(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    middle: Field,
    remaining: Field,
    pixel_mm: float,
    range_mm: tuple[float, float],
    *,
    dots: bool,
) -> list[Floats]:
    """(n, 3) x, y in px and spacing in mm of one bead each, from the pixels of skeletal lines.

    middle        (n, 3) mm: thickness there, and where the middle of the place lies beside the pixel
    remaining     (H, W) mm to the edge
    range_mm      the least and the largest spacing of a bead
    dots          whether a line shorter than it is wide is laid, too
    """
    if not len(rows):
        return []
    points, starts = trace_lines(np.zeros(remaining.shape, np.uint8), rows, columns)
    narrowest_mm = range_mm[0]
    chains, open_ends = _joined(_without_stubs([points[a:b] for a, b in pairwise(starts)]))
    known = dict(zip(zip(columns.tolist(), rows.tolist(), strict=True), middle.tolist(), strict=True))
    beads: list[Floats] = []
    spots: list[tuple[Floats, float]] = []
    for k, (chain, ends) in enumerate(zip(chains, open_ends, strict=True)):
        facts = np.array([known[int(x), int(y)] for x, y in chain])
        spacing, line = facts[:, 0], chain + facts[:, 1:] / pixel_mm
        extent_px = np.ptp(line, axis=0).max()
        if extent_px * pixel_mm < max(spacing.max(), narrowest_mm) / 2 and (all(ends) or _alone(k, chains)):
            if dots or spacing.max() >= 1.25 * narrowest_mm:
                spots.append((line.mean(axis=0), float(spacing.max())))
            continue
        line = np.column_stack([_smoothed(line[:, 0]), _smoothed(line[:, 1]), _smoothed(spacing)])
        if not _ring(chain):
            for end in (0, 1):
                line = line[::-1]
                if ends[end]:
                    line = _carried_on(line, remaining, pixel_mm)
        if (
            len(line) > 1
            and np.ptp(line[:, :2], axis=0).max() > 0
            and not _neck(line, remaining, pixel_mm, range_mm[0])
        ):
            beads.append(line)
    return beads + spot_beads(spots, remaining, pixel_mm, range_mm)


def _neck(line: Floats, remaining: Field, pixel_mm: float, narrowest_mm: float) -> bool:
    """Whether a line is shorter and much thinner than a bead, between places that are thicker and get their own."""
    if _length(line) * pixel_mm > narrowest_mm or line[:, 2].max() > THIN * narrowest_mm:
        return False
    reach = round(narrowest_mm / pixel_mm)
    x, y = np.rint(line[:, :2].mean(axis=0)).astype(np.int64)
    around = remaining[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
    return bool(2 * around.max() > narrowest_mm)


def _alone(k: int, chains: list[Floats]) -> bool:
    """Whether no other chain ends near the ends of chain k."""
    tips = chains[k][[0, -1]]
    return not any((np.abs(c[[0, -1], None] - tips).max(axis=2) <= 2).any() for c in chains[:k] + chains[k + 1 :])


def spot_beads(
    spots: list[tuple[Floats, float]], remaining: Field, pixel_mm: float, range_mm: tuple[float, float]
) -> list[Floats]:
    """A stroke or a dot each for places whose skeleton is hardly more than a pixel: (its x, y in px, thickness)."""
    narrowest_mm, widest_mm = range_mm
    lines = []
    for middle, thickness in spots:
        x, y = np.rint(middle).astype(np.int64).tolist()
        area_mm2 = spot_px(remaining, x, y, round(LARGEST_SPOT * widest_mm / pixel_mm)) * pixel_mm**2
        disc = math.pi / 4 * thickness**2
        stroke = _stroke(middle, remaining, pixel_mm)
        long = _length(stroke) * pixel_mm > LEAST_STROKE * max(thickness, narrowest_mm)
        if long and not 0 < area_mm2 < NEARLY_ROUND * disc:
            lines.append(_filling(stroke, area_mm2, widest_mm, pixel_mm))
        else:
            lines.append(_dot(middle, min(max(area_mm2, disc), ROUND * disc), narrowest_mm, pixel_mm))
    return lines


def _ring(chain: Floats) -> bool:
    return len(chain) > 2 and bool((chain[0] == chain[-1]).all())


def _dot(middle: Floats, area_mm2: float, narrowest_mm: float, pixel_mm: float) -> Floats:
    """The narrowest bead round the middle of a dot, as long as gives its area: a stroke would stick out."""
    radius_px = max(area_mm2 / (2 * math.pi * narrowest_mm), LEAST_RADIUS_MM) / pixel_mm
    angle = np.linspace(0, 2 * np.pi, 9)
    x, y = middle[0] + radius_px * np.cos(angle), middle[1] + radius_px * np.sin(angle)
    loop = np.column_stack([x, y, np.full(len(angle), narrowest_mm)])
    loop[-1] = loop[0]
    return loop


def _length(line: Floats) -> float:
    return float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())


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
    """The line carried on along the ridge as far as the place is as wide: lines of a skeleton end before it does."""
    back = line[max(len(line) - 1 - TANGENT_PX, 0)]
    x, y, spacing = line[-1]
    if (line[-1, :2] == back[:2]).all():
        return line
    angle = math.atan2(y - back[1], x - back[0])
    ridge = along_ridge(remaining, x, y, angle, ENDS_SLOPE * pixel_mm, round(4 * spacing / pixel_mm))
    more = np.column_stack([ridge[:, :2], np.clip(2 * ridge[:, 2], 0.5 * spacing, 1.5 * spacing)])[1:]
    x, y, spacing = more[-1] if len(more) else line[-1]
    if len(more):
        back = ridge[max(len(ridge) - 1 - TANGENT_PX, 0)]
        angle = math.atan2(y - back[1], x - back[0])
    tip = PAST_END * spacing / pixel_mm
    return np.vstack([line, more, [[x + tip * math.cos(angle), y + tip * math.sin(angle), spacing]]])


def _stroke(middle: Floats, remaining: Field, pixel_mm: float) -> Floats:
    """The longest way along the ridge both ways from a point, (n, 3): a place whose skeleton is a dot may be long."""
    x, y = middle
    longest = round(LONGEST_STROKE_MM / pixel_mm)
    best, farthest = np.array([[x, y, 0.0]]), 0.0
    for turn in range(8):
        angle = turn * math.pi / 8
        ways = [along_ridge(remaining, x, y, a, ENDS_SLOPE * pixel_mm, longest) for a in (angle + math.pi, angle)]
        line = np.vstack([ways[0][:0:-1], ways[1]])
        chord = math.hypot(*(line[-1, :2] - line[0, :2]))
        if chord > max(farthest, STRAIGHT * _length(line)):
            best, farthest = line, chord
    return np.column_stack([best[:, :2], 2 * best[:, 2]])


def _filling(stroke: Floats, area_mm2: float, widest_mm: float, pixel_mm: float) -> Floats:
    """A short stroke, straight on at both ends until no wider than the nozzle lays it fills its area.

    That is at least what it crosses and half a disc beyond each end.
    """
    length = _length(stroke) * pixel_mm
    crossed = float(stroke[:, 2].mean()) * length + math.pi / 8 * float((stroke[[0, -1], 2] ** 2).sum())
    area = max(area_mm2, crossed)
    wanted = max(length, area / (FULL * widest_mm))
    along = (stroke[-1, :2] - stroke[0, :2]) / math.hypot(*(stroke[-1, :2] - stroke[0, :2]))
    more = along * (wanted - length) / 2 / pixel_mm
    points = np.vstack([stroke[0, :2] - more, stroke[:, :2], stroke[-1, :2] + more])
    return np.column_stack([points, np.full(len(points), area / wanted)])


def _without_stubs(chains: list[Floats]) -> list[Floats]:
    """Chains but for the shortest that hang on another by one end: where they fork off, a line would end."""
    short = [k for k, chain in enumerate(chains) if 1 < len(chain) <= STUB_PX and not _ring(chain)]
    if not short:
        return chains
    tips = np.array([chain[[0, -1]] for chain in chains])
    stubs: set[int] = set()
    for k in short:
        near = (np.abs(tips[:, None] - tips[k][None, :, None]).max(axis=3) <= 2).any(axis=2)
        near[k] = False
        if near.any(axis=0).sum() == 1 and not stubs.intersection(np.flatnonzero(near.any(axis=1)).tolist()):
            stubs.add(k)
    return [chain for k, chain in enumerate(chains) if k not in stubs]


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
