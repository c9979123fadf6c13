"""Per-layer extrusion widths: the largest structuring element that prints a layer without an important change.

Source: the paper's "Structuring Element Size". Two rules:

"opening". A width d prints layer S if the opening P = S ∘ F(d)
  (1) has one component (8-connected) in each of S's, and one void (4-connected) round each of S's voids, and
  (2) loses no pixel that is farther than max(d / 4, loss_mm) and a pixel from what remains.
A corner of 90° at any turn loses 0.207 d, so corners of squares do not count; a tip of 60° loses d / 2 and does, from
8 px on. (The pixel is what the raster allows: half of it at the lost pixel, whose centre is not its edge, and half at
the remaining one.)

"thinning", the paper's own words: the first layer of thinning where the skeleton becomes one pixel wide. As contours
are taken off S, the first line that is left, and is no insignificant end, is where S is narrowest: after w / 2 of
contours in a place that is w wide. It is measured there, between both edges, within half a pixel.

Both agree within a pixel where layers have no corners: on rings, walls, plates with holes. They part at corners and
tips. A tip narrows to nothing: thinning takes what is significant of it by its angle, opening by how much it loses.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, U63, lowest_bit, popcount
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import Room, fill_columns, to_columns
from layerfix.layers.components import label_runs, same_topology
from layerfix.layers.drawing import anchor_columns, box_with_reach, open_columns
from layerfix.layers.feature import Feature, feature_of_mm
from layerfix.layers.morphology import HALF_WIDTHS
from layerfix.layers.print_paths import IMAGES_OF_LAYER, PATHS, SOLID, printed_and_paths, tool_of
from layerfix.layers.thickness import narrowest
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.stack import Layer, LayerStack

Rule = Literal["opening", "thinning"]
RULES: tuple[Rule, ...] = get_args(Rule)
MAX_CANDIDATES = 1000
NEARLY = 1e-9  # mm; what two ways of computing a length may differ by
UNKNOWN, FAILS_FOR_GOOD, FAILS, HOLDS = -1, 0, 1, 2
STARTS = types.Array(types.int64, 1, "C")
LIMITS = types.Array(types.float64, 1, "C")
OFFSETS = types.Array(types.int64, 2, "C")
SUGGESTION = types.Tuple((types.int64, types.boolean, types.int64, types.UniTuple(types.int64, 4)))


@njit
def _reach_mm(lost, kept, offsets, distances_mm):  # type: ignore[no-untyped-def]  # numba types it
    """The farthest that a lost pixel is from what is kept, in mm; inf if it is past the last of the offsets.

    offsets: (n, 2) dx, dy in px by distance.
    """
    words, height = lost.shape
    farthest = 0.0
    for w in range(words):
        for y in range(height):
            word = lost[w, y]
            while word != U0:
                x = w * 64 + lowest_bit(word)
                word &= word - U1
                found = False
                for k in range(offsets.shape[0]):
                    i, j = x + offsets[k, 0], y + offsets[k, 1]
                    if 0 <= i < 64 * words and 0 <= j < height and (kept[i >> 6, j] >> np.uint64(i & 63)) & U1:
                        farthest, found = max(farthest, distances_mm[k]), True
                        break
                if not found:
                    return np.inf
    return farthest


@njit
def _opened(solid, half_widths, bx, by, kept, scratch, lost):  # type: ignore[no-untyped-def]  # numba types it
    """kept = solid ∘ F, lost = the rest (also used as scratch); True if anything is lost."""
    anchor_columns(solid, half_widths, bx, by, lost, scratch)
    open_columns(lost, half_widths, kept, scratch)
    any_lost = U0
    for w in range(solid.shape[0]):
        for y in range(solid.shape[1]):
            lost[w, y] = solid[w, y] & ~kept[w, y]
            any_lost |= lost[w, y]
    return any_lost != U0


@njit
def _boundary_px(columns):  # type: ignore[no-untyped-def]  # numba types it
    """How often pixels change along rows, along columns, and along the two diagonals."""
    words, height = columns.shape
    across, down, falling, rising = 0, 0, 0, 0
    for w in range(1, words - 1):
        west, here, east = columns[w - 1], columns[w], columns[w + 1]
        for y in range(1, height):
            c, up = here[y], here[y - 1]
            across += popcount(c ^ ((c << U1) | (west[y] >> U63)))
            down += popcount(c ^ up)
            falling += popcount(c ^ ((up << U1) | (west[y - 1] >> U63)))
            rising += popcount(c ^ ((up >> U1) | (east[y - 1] << U63)))
    return across, down, falling, rising


@njit
def _verdict(solid, half_widths, block, limit_mm, last_mm, parts, voids, offsets, distances_mm, work):  # type: ignore[no-untyped-def]  # numba types it
    """HOLDS, FAILS, or FAILS_FOR_GOOD: for every wider candidate, too."""
    kept, scratch, lost = work[0], work[1], work[2]
    if not _opened(solid, half_widths, block[0], block[1], kept, scratch, lost):
        return HOLDS
    reach_mm = _reach_mm(lost, kept, offsets, distances_mm)
    if reach_mm > last_mm + NEARLY or not same_topology(solid, kept, parts, voids):
        return FAILS_FOR_GOOD
    return FAILS if reach_mm > limit_mm + NEARLY else HOLDS


@njit(SUGGESTION(ROWS, HALF_WIDTHS, STARTS, OFFSETS, LIMITS, OFFSETS, LIMITS), cache=True, nogil=True)
def _suggest(rows, discs, starts, blocks, limits_mm, offsets, distances_mm):  # type: ignore[no-untyped-def]  # numba types it
    """(number of the widest candidate that holds, or 0; whether it does; solid pixels; `_boundary_px`).

    discs, starts, blocks: half widths of the candidates' discs, one after the other, and their blocks (`Feature`);
    limits_mm: of the reach, for each.

    "Fails for good" is monotone: the topology stays broken, and what is too far for the widest candidate is too far
    for all. So the first that does is found by halving; below it the law itself is tried downwards, mostly once.
    (Openings by discs of pixels are not quite nested: in about one of a thousand random images a wider candidate
    holds again. Then this finds one that holds while the next one fails, too.)
    """
    last = starts.shape[0] - 2
    widest = discs[starts[last] : starts[last + 1]]
    outer = box_with_reach(rows, widest[0] + 1, widest.shape[0])
    if outer[1] == 0:
        return last, True, 0, (0, 0, 0, 0)
    solid = to_columns(rows, outer)
    work = np.empty((3, *solid.shape), np.uint64)
    pixels = 0
    for w in range(solid.shape[0]):
        for y in range(solid.shape[1]):
            pixels += popcount(solid[w, y])
    edges = _boundary_px(solid)
    parts, voids = label_runs(solid, False)[2], label_runs(solid, True)[2]
    verdicts = np.full(last + 1, UNKNOWN)
    low, high = -1, last + 1  # low does not fail for good, high does
    at = last
    while True:
        if verdicts[at] == UNKNOWN:
            half_widths = discs[starts[at] : starts[at + 1]]
            verdicts[at] = _verdict(
                solid,
                half_widths,
                blocks[at],
                limits_mm[at],
                limits_mm[last],
                parts,
                voids,
                offsets,
                distances_mm,
                work,
            )
        halving = high - low > 1
        if halving and verdicts[at] == FAILS_FOR_GOOD:
            high = at
        elif halving:
            low = at
        if high - low > 1:
            at = (low + high) // 2
            continue
        if halving:
            at = low
        elif verdicts[at] == HOLDS:
            return at, True, pixels, edges
        else:  # it fails, but not for good: a narrower one may hold
            at -= 1
        if at < 0:
            return 0, False, pixels, edges


@dataclass(frozen=True, eq=False)
class Widths:
    """An extrusion width for every layer.

    z_mm        (layers, 2): bottom and top
    width_mm    (layers,)
    too_thin    (layers,) bool: not even the narrowest width prints the layer unchanged; correct these
    area_mm2, outline_mm   (layers,) solid area, and length of all outlines
    range_mm, step_mm      what was asked for
    thinning_mm (layers,) width where thinning first leaves a line, at most the widest candidate
    """

    z_mm: NDArray[np.float64]
    width_mm: NDArray[np.float64]
    too_thin: NDArray[np.bool_]
    area_mm2: NDArray[np.float64]
    outline_mm: NDArray[np.float64]
    range_mm: tuple[float, float]
    step_mm: float
    thinning_mm: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.width_mm)

    def ranges(self) -> list[tuple[float, float, float]]:
        """(bottom, top, width) in mm of each stretch of layers with one width."""
        starts = np.flatnonzero(np.diff(self.width_mm, prepend=np.nan) != 0)
        stops = np.append(starts[1:], len(self)) - 1
        return [
            (float(self.z_mm[a, 0]), float(self.z_mm[b, 1]), float(self.width_mm[a]))
            for a, b in zip(starts, stops, strict=True)
        ]


def candidates_mm(min_mm: float, max_mm: float, step_mm: float) -> NDArray[np.float64]:
    """The widths tried: from min_mm in steps, and max_mm. Raises InputError for a range that is none."""
    if not 0 < min_mm <= max_mm < np.inf:
        raise InputError(f"widths from {format_mm(min_mm)} to {format_mm(max_mm)}: the narrowest comes first")
    if not 0 < step_mm < np.inf:
        raise InputError(f"width step {step_mm} mm: it must be above 0")
    steps = (max_mm - min_mm) / step_mm + 1e-9
    if steps > MAX_CANDIDATES:
        raise InputError(
            f"a step of {format_mm(step_mm)} from {format_mm(min_mm)} to {format_mm(max_mm)} makes {steps:.0f}"
            f" widths; at most {MAX_CANDIDATES} are tried"
        )
    widths = np.round(min_mm + step_mm * np.arange(int(steps) + 1), 9)
    return widths if widths[-1] > max_mm - 1e-9 else np.append(widths, max_mm)


def suggest_widths(
    stack: LayerStack,
    *,
    min_mm: float,
    max_mm: float,
    step_mm: float = 0.05,
    loss_mm: float = 0.0,
    rule: Rule = "opening",
) -> Widths:
    """For each layer, the widest of the candidates that prints it without an important change (see the module).

    min_mm, max_mm, step_mm  the candidates; a layer that none of them prints unchanged gets min_mm and is `too_thin`
    loss_mm  a loss that does not matter however narrow the bead: tips may come out blunter by so much
    rule     "opening": by what opening the layer loses; "thinning": by where thinning first leaves a line
    raises   InputError for a range that is none, widths under two pixels, a loss below 0 or with the
             rule "thinning", and an unknown rule
    """
    widths = candidates_mm(min_mm, max_mm, step_mm)
    if not 0 <= loss_mm < np.inf:
        raise InputError(f"loss {loss_mm} mm: it must be 0 or more")
    if min_mm < 2 * max(stack.pixel_mm) * (1 - 1e-9):
        raise InputError(
            f"widths from {format_mm(min_mm)}: that is under two pixels of {format_mm(max(stack.pixel_mm))};"
            " use smaller pixels or wider beads"
        )
    if rule not in RULES:
        raise InputError(f"rule='{rule}' is not known; choose from {', '.join(RULES)}")
    if rule == "thinning" and loss_mm:
        raise InputError(f"a loss of {format_mm(loss_mm)} goes with the rule 'opening'; 'thinning' looks at none")
    features = [feature_of_mm(float(d), stack.pixel_mm) for d in widths]
    discs, blocks = [f.half_widths for f in features], np.array([f.block for f in features], np.int64)
    starts = np.concatenate([[0], np.cumsum([len(d) for d in discs])])
    limits_mm = np.maximum(widths / 4, loss_mm) + max(stack.pixel_mm)
    frame_mm = float(np.hypot(stack.width * stack.pixel_mm[0], stack.height * stack.pixel_mm[1]))
    offsets, distances_mm = _offsets(min(float(limits_mm.max()), frame_mm), stack.pixel_mm)
    half_widths = np.concatenate(discs)

    thinned = _Thinned(features[-1], stack.pixel_mm)

    def suggest(layer: Layer) -> tuple[int, bool, int, tuple[int, int, int, int], float]:
        found: tuple[int, bool, int, tuple[int, int, int, int]] = _suggest(
            layer.rows, half_widths, starts, blocks, limits_mm, offsets, distances_mm
        )
        return (*found, thinned(layer))

    found = list(stack.each(suggest, once=True))
    thinning_mm = np.array([min(width, max_mm) for *_, width in found])
    picked = np.array([k for k, *_ in found])
    too_thin = np.array([not holds for _, holds, *_ in found], np.bool_)
    if rule == "thinning":
        fits = widths[None, :] <= thinning_mm[:, None] + max(stack.pixel_mm) / 2
        picked, too_thin = np.maximum(fits.sum(axis=1) - 1, 0), np.logical_not(fits.any(axis=1))
    pixel_mm2 = stack.pixel_mm[0] * stack.pixel_mm[1]
    return Widths(
        stack.z_mm,
        widths[picked],
        too_thin,
        np.array([pixels * pixel_mm2 for _, _, pixels, *_ in found], np.float64),
        np.array([_outline_mm(edges, stack.pixel_mm) for *_, edges, _ in found], np.float64),
        (min_mm, max_mm),
        step_mm,
        thinning_mm,
    )


@dataclass(frozen=True, eq=False)
class _Thinned:
    """Where a layer is narrowest: the width in mm at which thinning first leaves a line, inf if F leaves none."""

    feature: Feature
    pixel_mm: tuple[float, float]
    room: Room = field(default_factory=Room)

    def __call__(self, layer: Layer) -> float:
        feature = self.feature
        outer = box_with_reach(layer.rows, *feature.reach_px)
        if outer[1] == 0:
            return np.inf
        images = self.room.columns(outer, IMAGES_OF_LAYER)
        fill_columns(layer.rows, outer, images[SOLID])
        printed_and_paths(images, tool_of(feature, "metric"), self.room)
        limit_mm = max(2 * r * p for r, p in zip(feature.radius_px, self.pixel_mm, strict=True))
        return float(narrowest(images[SOLID], images[PATHS], limit_mm, *self.pixel_mm, False))


def _offsets(limit_mm: float, pixel_mm: tuple[float, float]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """((n, 2) dx, dy in px, (n,) their lengths in mm) of all steps up to a limit, the shortest first."""
    rx, ry = (int(limit_mm / p + 1e-6) for p in pixel_mm)
    dx, dy = np.meshgrid(np.arange(-rx, rx + 1), np.arange(-ry, ry + 1))
    steps = np.stack([dx.ravel(), dy.ravel()], axis=1)
    lengths = np.hypot(steps[:, 0] * pixel_mm[0], steps[:, 1] * pixel_mm[1])
    order = np.argsort(lengths, kind="stable")
    order = order[(lengths[order] <= limit_mm + NEARLY) & (lengths[order] > 0)]
    return np.ascontiguousarray(steps[order]), np.ascontiguousarray(lengths[order])


def _outline_mm(edges: tuple[int, int, int, int], pixel_mm: tuple[float, float]) -> float:
    """Length of the outlines from how often lines in four directions cross them (Cauchy and Crofton)."""
    across, down, falling, rising = edges
    px, py = pixel_mm
    diagonal = px * py / np.hypot(px, py)
    return float(np.pi / 8 * (across * py + down * px + (falling + rising) * diagonal))
