"""Corrections that leave something free: gaps between parts, holes, and places where nothing is to be added.

Gaps. The result T of the method may join parts and close holes. Kept apart, S is first trimmed to T (its corners, as
far as that parts nothing), then grown through T ∖ S by simple pixels only, those nearest to a skeletal path first: of
two walls that are both thickened, each gets half of the gap. A pixel is simple if its coming joins and closes nothing
(solid 8-connected, void 4-connected), so the result has S's topology, and it lies in T. For a gap of several pixels
the same is done once with T widened by half the gap; what was refused is the seam, and around it a gap's width stays
free.

Places kept free. F is drawn around a path's pixel only if it adds nothing in them; otherwise around the nearest pixel
within F's radius where it does not: the material goes to the other side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numba import types

from layerfix.bits import U0, U1, WORK, lowest_bit
from layerfix.kernels import njit
from layerfix.layers.components import NUMBERS, RUNS, label_runs, measured_parts
from layerfix.layers.morphology import HALF_WIDTHS, dilate_columns, disc_half_widths
from layerfix.layers.neighbours import around, bit_at, is_simple

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.layers.feature import Feature

    Columns = NDArray[np.uint64]

Grow = Literal["both", "inward", "outward"]
Kind = Literal["gap", "keep_out"]
GROWS: tuple[Grow, ...] = get_args(Grow)
DISTANCES = types.Array(types.float64, 1, "C")
STEPS_PER_PX = 8  # distances are told apart by so much
WAITING, REFUSED, ADDED = 0, 1, 2


@dataclass(frozen=True)
class Conflict:
    """A place that stays under F, because what is to be kept free is too near.

    kind      "gap": of what F would add, this part was withheld; "keep_out": F fits nowhere here
    box_mm    (left, bottom, right, top) on the stack's frame
    width_mm  about how wide the feature is there now
    """

    kind: Kind
    box_mm: tuple[float, float, float, float]
    width_mm: float
    z_mm: tuple[float, float] = (0.0, 0.0)


@njit(types.Tuple((NUMBERS, NUMBERS))(WORK, WORK), cache=True, nogil=True)
def _missing(have, wanted):  # type: ignore[no-untyped-def]  # numba types it
    """Pixels of `wanted` that are not in `have`, by rows: (where each row begins; their columns)."""
    words, height = wanted.shape
    starts, n = np.zeros(height + 1, np.int64), 0
    xs = np.empty(256, np.int64)
    for y in range(height):
        for w in range(words):
            word = wanted[w, y] & ~have[w, y]
            while word != U0:
                if n == xs.shape[0]:
                    longer = np.empty(2 * n, np.int64)
                    for k in range(n):
                        longer[k] = xs[k]
                    xs = longer
                xs[n] = w * 64 + lowest_bit(word)
                n += 1
                word &= word - U1
        starts[y + 1] = n
    return starts, xs[:n].copy()


@njit
def _at_or_after(xs, first, stop, x):  # type: ignore[no-untyped-def]  # numba types it
    """The first of xs[first … stop - 1], which rise, that is at least x."""
    while first < stop:
        middle = (first + stop) // 2
        if xs[middle] < x:
            first = middle + 1
        else:
            stop = middle
    return first


@njit(
    DISTANCES(NUMBERS, NUMBERS, WORK, types.int64, types.int64, types.UniTuple(types.float64, 2),
              types.UniTuple(types.float64, 2)),
    cache=True,
    nogil=True,
)  # fmt: skip
def _distances(starts, xs, paths, reach_x, reach_y, offset_px, pixel_mm):  # type: ignore[no-untyped-def]  # numba types it
    """How far each pixel is from the middle of the nearest F that is drawn, in mm; inf if none reaches it."""
    out = np.full(xs.shape[0], np.inf)
    height = starts.shape[0] - 1
    for w in range(paths.shape[0]):
        for y in range(paths.shape[1]):
            word = paths[w, y]
            while word != U0:
                x = w * 64 + lowest_bit(word)
                word &= word - U1
                for v in range(max(y - reach_y, 0), min(y + reach_y + 1, height)):
                    dy = (v - y - offset_px[1]) * pixel_mm[1]
                    k = _at_or_after(xs, starts[v], starts[v + 1], x - reach_x)
                    while k < starts[v + 1] and xs[k] <= x + reach_x:
                        dx = (xs[k] - x - offset_px[0]) * pixel_mm[0]
                        out[k] = min(out[k], dx * dx + dy * dy)
                        k += 1
    return np.sqrt(out)


@njit(types.int64(WORK, NUMBERS, NUMBERS, NUMBERS), cache=True, nogil=True)
def _grow(solid, starts, xs, order):  # type: ignore[no-untyped-def]  # numba types it
    """Add the pixels that are simple when their turn comes, or become so by what comes after. Returns how many."""
    ys = np.empty(xs.shape[0], np.int64)
    for y in range(starts.shape[0] - 1):
        for k in range(starts[y], starts[y + 1]):
            ys[k] = y
    state = np.zeros(xs.shape[0], np.uint8)
    again, added, refused = np.empty(xs.shape[0] + 1, np.int64), 0, 0
    for place in range(order.shape[0]):
        again[0], n = order[place], 1
        while n > 0:
            n -= 1
            k = again[n]
            y, x = ys[k], xs[k]
            if state[k] == ADDED:
                continue
            refused -= state[k] == REFUSED
            if not is_simple(around(solid.T, y, x)):
                state[k] = REFUSED
                refused += 1
                continue
            state[k] = ADDED
            solid[x >> 6, y] |= U1 << np.uint64(x & 63)
            added += 1
            if refused == 0:
                continue
            for v in range(max(y - 1, 0), min(y + 2, starts.shape[0] - 1)):
                i = _at_or_after(xs, starts[v], starts[v + 1], x - 1)
                while i < starts[v + 1] and xs[i] <= x + 1:
                    if state[i] == REFUSED and n < again.shape[0]:
                        again[n] = i
                        n += 1
                    i += 1
    return added


@njit(types.boolean(WORK, WORK), cache=True, nogil=True)
def _trim(solid, goal):  # type: ignore[no-untyped-def]  # numba types it
    """Take away what is outside the goal, as far as that parts and closes nothing. Returns whether all went."""
    left, before = -1, -2
    while left != before and left != 0:
        before, left = left, 0
        for y in range(solid.shape[1]):
            for w in range(solid.shape[0]):
                word = solid[w, y] & ~goal[w, y]
                while word != U0:
                    x = w * 64 + lowest_bit(word)
                    word &= word - U1
                    if is_simple(around(solid.T, y, x)):
                        solid[w, y] &= ~(U1 << np.uint64(x & 63))
                    else:
                        left += 1
    return left == 0


@njit(types.void(RUNS, NUMBERS, types.int64, WORK), cache=True, nogil=True)
def _draw_part(runs, number, which, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = one component."""
    out[:] = U0
    for k in range(runs.shape[0]):
        if number[k] == which:
            for x in range(runs[k, 1], runs[k, 2]):
                out[x >> 6, runs[k, 0]] |= U1 << np.uint64(x & 63)


def one_by_one(columns: Columns) -> Iterator[tuple[NDArray[np.int64], Columns]]:
    """Yield (area and box, the columns with nothing else) of each component; the columns are good until the next."""
    runs, parent, _ = label_runs(columns, False)
    number, parts = measured_parts(runs, parent)
    out = np.empty_like(columns)
    for k, part in enumerate(parts):
        _draw_part(runs, number, k, out)
        yield part, out


@njit(types.int64(WORK, WORK, HALF_WIDTHS, types.int64, types.int64, WORK, WORK), cache=True, nogil=True)
def move_paths(paths, free, half_widths, bx, by, centres, stuck):  # type: ignore[no-untyped-def]  # numba types it
    """centres = for each path pixel the pixel around which F is drawn; stuck = those for which there is none.

    free  pixels around which F adds nothing where nothing is to be added. Of several as near the first by rows.
    Returns how many are stuck.
    """
    reach_y, reach_x = half_widths.shape[0] - 1 + by, half_widths[0] + bx
    centres[:] = U0
    stuck[:] = U0
    count = 0
    for w in range(paths.shape[0]):
        for y in range(paths.shape[1]):
            word = paths[w, y]
            while word != U0:
                x = w * 64 + lowest_bit(word)
                word &= word - U1
                nearest, best_y, best_x = np.int64(1) << 60, y, x
                if bit_at(free.T, y, x):
                    nearest = np.int64(0)
                for dy in range(-reach_y if nearest else 0, reach_y + 1 if nearest else 0):
                    for dx in range(-reach_x, reach_x + 1):
                        # F there has to hold the path's pixel.
                        inside = False
                        for v in range(by + 1):
                            for u in range(bx + 1):
                                i, j = abs(-dx - u), abs(-dy - v)
                                inside |= j < half_widths.shape[0] and i <= half_widths[j]
                        if inside and dx * dx + dy * dy < nearest and bit_at(free.T, y + dy, x + dx):
                            nearest, best_y, best_x = np.int64(dx * dx + dy * dy), y + dy, x + dx
                if nearest == np.int64(1) << 60:
                    stuck[w, y] |= U1 << np.uint64(x & 63)
                    count += 1
                else:
                    centres[best_x >> 6, best_y] |= U1 << np.uint64(best_x & 63)
    return count


@njit(types.void(WORK, types.boolean, WORK), cache=True, nogil=True)
def void_parts(solid, holes, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = the holes (void parts that the outside does not reach), or the outside."""
    runs, parent, _ = label_runs(solid, True)
    number, _ = measured_parts(runs, parent)
    out[:] = U0
    for k in range(runs.shape[0]):
        if (number[k] != 0) == holes:  # the first run is the border's
            y = runs[k, 0]
            for x in range(runs[k, 1], runs[k, 2]):
                out[x >> 6, y] |= U1 << np.uint64(x & 63)


def grow_apart(
    solid: Columns,
    skeleton: Columns,
    goal: Columns,
    paths: Columns,
    feature: Feature,
    gap_px: tuple[float, float],
    pixel_mm: tuple[float, float],
) -> list[tuple[NDArray[np.int64], float]]:
    """goal = what of it can be had with the topology of `solid`. Returns conflicts: (part's area, box; width in mm).

    paths   centres of the F's that were drawn
    gap_px  (x, y) of what is to stay free between parts, at least a pixel
    """
    start = solid.copy()
    if not _trim(start, goal):
        start = skeleton & goal
        starts, xs = _missing(start, solid & goal)
        _grow(start, starts, xs, np.arange(len(xs)))
    target = goal
    if max(gap_px) > 1:
        half = disc_half_widths(gap_px[0] / 2, gap_px[1] / 2)
        wide, scratch = np.empty_like(goal), np.empty_like(goal)
        dilate_columns(goal, half, wide, scratch)
        grown = start.copy()
        _grow_towards(grown, wide, paths, feature, gap_px, pixel_mm)
        seam, zone = wide & ~grown, np.empty_like(goal)
        across = disc_half_widths(*(np.ceil((g - 1) / 2) + 0.25 for g in gap_px))
        dilate_columns(seam, across, zone, scratch)
        target = goal & ~(zone & ~start)
    _grow_towards(start, target, paths, feature, (0.0, 0.0), pixel_mm)
    withheld = goal & ~start
    goal[:] = start
    if not withheld.any():
        return []
    found = []
    radius_mm = min(r * p for r, p in zip(feature.radius_px, pixel_mm, strict=True))
    for part, only in one_by_one(withheld):
        starts, xs = _missing(np.zeros_like(only), only)
        far_mm = _distances_to(starts, xs, paths, feature, (0.0, 0.0), pixel_mm)
        reached_mm = min(float(far_mm.min()), radius_mm) - min(pixel_mm) / 2
        found.append((part, radius_mm + reached_mm))
    return found


def _distances_to(
    starts: NDArray[np.int64],
    xs: NDArray[np.int64],
    paths: Columns,
    feature: Feature,
    more_px: tuple[float, float],
    pixel_mm: tuple[float, float],
) -> NDArray[np.float64]:
    reach = [r + int(np.ceil(m)) + 1 for r, m in zip(feature.reach_px, more_px, strict=True)]
    found: NDArray[np.float64] = _distances(starts, xs, paths, *reach, feature.offset_px, pixel_mm)
    return found


def _grow_towards(
    solid: Columns,
    goal: Columns,
    paths: Columns,
    feature: Feature,
    more_px: tuple[float, float],
    pixel_mm: tuple[float, float],
) -> None:
    """Grow `solid` in `goal`, nearest to the paths first; of those as near, every other row and column first."""
    starts, xs = _missing(solid, goal)
    if not len(xs):
        return
    far_mm = _distances_to(starts, xs, paths, feature, more_px, pixel_mm)
    steps = np.minimum(np.floor(far_mm / min(pixel_mm) * STEPS_PER_PX), 1 << 40).astype(np.int64)
    rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    turn = np.array([0, 2, 3, 1])[2 * (rows & 1) + (xs & 1)]
    _grow(solid, starts, xs, np.argsort(4 * steps + turn, kind="stable"))


def centres_apart(
    solid: Columns, forbidden: Columns, paths: Columns, feature: Feature, centres: Columns, stuck: Columns
) -> int:
    """centres = where F is drawn for each path pixel without adding anything in `forbidden`; see `move_paths`."""
    half_widths, (bx, by) = feature.half_widths, feature.block
    # F around p meets a pixel q of K if p is in K ⊕ (F mirrored): G is symmetric, the block goes the other way.
    scratch, blocked, reach = (np.empty_like(solid) for _ in range(3))
    dilate_columns(forbidden & ~solid, half_widths, reach, scratch)
    _dilate_back(reach, bx, by, blocked)
    return int(move_paths(paths, ~blocked, half_widths, bx, by, centres, stuck))


@njit(types.void(WORK, types.int64, types.int64, WORK), cache=True, nogil=True)
def _dilate_back(columns, bx, by, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = `columns` and its pixels moved west (bx), north (by) and north-west (both)."""
    words, height = columns.shape
    for w in range(words):
        for y in range(height):
            c = columns[w, y]
            if by and y + 1 < height:
                c |= columns[w, y + 1]
            if bx:
                east = columns[w + 1, y] if w + 1 < words else U0
                if by and y + 1 < height and w + 1 < words:
                    east |= columns[w + 1, y + 1]
                c |= (c >> U1) | (east << np.uint64(63))
            out[w, y] = c
