"""The meso-skeleton M̂: where the print head must be able to go (paper, Algorithm 2).

M̂ is the erosion M = S ⊖ F plus one-pixel paths through whatever is narrower than F. It is S thinned until
nothing changes, with M's pixels anchored: never deleted. (The paper deletes and ORs them back after each
round; on 2,500 random images that broke the topology of 6, the anchored form of none.)

How far a path reaches into an end is the spur rule. "paper" takes a pixel a round off its ends, r times: how much
that is in mm depends on the direction. "metric" (`layerfix.layers.metric`) measures: all directions alike.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numba import types

from layerfix.bits import WORK, pack, unpack
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import BLOCK, Room, fill_columns, to_columns, to_rows
from layerfix.layers.drawing import anchor_columns, box_with_reach
from layerfix.layers.feature import Feature, Radius, feature_of_radius, feature_of_size
from layerfix.layers.metric.ends import set_ends
from layerfix.layers.metric.levels import PLAN, plan_for
from layerfix.layers.metric.rule import ZEROS, thin_metric, zeros_needed
from layerfix.layers.metric.tiles import IMAGES
from layerfix.layers.morphology import HALF_WIDTHS, disc_half_widths, working_box
from layerfix.layers.thinning import FIRST, SECOND, SPURS, flag_free, remove_spurs, start_changes, sub_iteration

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows

Spurs = Literal["metric", "paper"]
SPUR_RULES: tuple[Spurs, ...] = get_args(Spurs)
SCRATCH_IMAGES = 4


@njit(types.void(WORK, WORK, types.float64, WORK), cache=True, nogil=True)
def thin_anchored(columns, anchor, spur_rounds, scratch):  # type: ignore[no-untyped-def]  # numba types it
    """Algorithm 2's loop in place: thin `columns` around `anchor`, removing spurs while j < spur_rounds."""
    words, height = columns.shape
    blocks = (height - 2) // BLOCK
    changed = np.zeros((4, words, blocks), np.uint8)
    active = np.zeros((words, blocks), np.uint8)
    gone = np.zeros((2, height), np.uint64)
    start_changes(columns, changed)
    flag_free(columns, anchor, anchor, changed)
    j = 0
    again = True
    while again:
        again = sub_iteration(columns, anchor, FIRST, changed, active, gone)
        again = sub_iteration(columns, anchor, SECOND, changed, active, gone) or again
        if j < spur_rounds:
            again = remove_spurs(columns, anchor, changed, active, gone, scratch) or again
        elif j < spur_rounds + 1:
            changed[SPURS] = np.uint8(0)
        j += 1


def feature_and_rule(
    radius_px: Radius | None, min_feature_px: Radius | None, spurs: Spurs | None
) -> tuple[Feature, Spurs]:
    """F from what was given by radius or by size, and the spur rule, which then is "paper" or "metric" if not given.

    Raises InputError unless exactly one of the two was given, and for a rule that is not known.
    """
    if (radius_px is None) == (min_feature_px is None):
        raise InputError("give the minimum feature either by radius_px or by min_feature_px")
    feature = feature_of_size(min_feature_px) if min_feature_px is not None else feature_of_radius(radius_px or 0.0)
    rule = spurs or ("metric" if feature.by_size else "paper")
    check_spurs(rule)
    return feature, rule


def check_spurs(spurs: str) -> None:
    """Raises InputError for a spur rule that is not known."""
    if spurs not in SPUR_RULES:
        raise InputError(f"spurs='{spurs}' is not known; choose from {', '.join(SPUR_RULES)}")


@njit(
    types.void(
        WORK, WORK, HALF_WIDTHS, types.int64, types.int64, types.boolean, types.float64, PLAN, WORK, IMAGES, ZEROS
    ),
    cache=True,
    nogil=True,
)
def skeleton_columns(solid, anchor, half_widths, bx, by, metric, rounds, plan, out, scratch, zeros):  # type: ignore[no-untyped-def]  # numba types it
    """out = M̂ of the columns `solid`, thinned around `anchor`.

    half_widths, bx, by   F
    metric, rounds, plan  `spur_numbers`
    scratch               SCRATCH_IMAGES more columns; zeros: `zeros_needed` words, if metric
    """
    for w in range(solid.shape[0]):
        here, line = solid[w], out[w]
        for y in range(here.shape[0]):
            line[y] = here[y]
    if metric:
        thin_metric(out, solid, anchor, scratch, plan, zeros)
        set_ends(out, solid, anchor, half_widths, bx, by)
    else:
        thin_anchored(out, anchor, rounds, scratch[0])


def spur_numbers(feature: Feature, spurs: Spurs) -> tuple[bool, float, tuple[Any, ...]]:
    """(whether ends are measured; by how many rounds they are shortened if not; the plan) of a rule, for kernels."""
    plan = plan_for(*feature.radius_px) if spurs == "metric" else plan_for(1.0, 1.0)
    return spurs == "metric", float(max(feature.radius_px)), plan.numbers


def meso_skeleton_rows(rows: Rows, width: int, feature: Feature, spurs: Spurs) -> Rows:
    """`meso_skeleton` on packed rows: (H, words) → (H, words)."""
    out = np.zeros_like(rows)
    outer = box_with_reach(rows, *feature.reach_px)
    if outer[1]:
        room = Room()
        images = room.columns(outer, 3 + SCRATCH_IMAGES)
        solid, anchor, skeleton, scratch = images[0], images[1], images[2], images[3:]
        fill_columns(rows, outer, solid)
        anchor_columns(solid, feature.half_widths, *feature.block, anchor, scratch[0])
        metric, rounds, plan = spur_numbers(feature, spurs)
        zeros = room.zeros(zeros_needed(plan, *solid.shape))
        half_widths, (bx, by) = feature.half_widths, feature.block
        skeleton_columns(solid, anchor, half_widths, bx, by, metric, rounds, plan, skeleton, scratch, zeros)
        to_rows(skeleton, outer, width, out)
    return out


def thinned_rows(rows: Rows, anchor: Rows, width: int, spur_rounds: float) -> Rows:
    """Packed rows thinned around an anchor of one's own instead of M: (H, words) → (H, words).

    spur_rounds  how many pixels paths are shortened by at their ends
    """
    out = np.zeros_like(rows)
    outer = working_box(rows, disc_half_widths(1.0, 1.0))
    if outer[1]:
        columns, fixed = to_columns(rows, outer), to_columns(anchor, outer)
        thin_anchored(columns, fixed, spur_rounds, np.empty_like(columns))
        to_rows(columns, outer, width, out)
    return out


def meso_skeleton(
    image: ArrayLike,
    radius_px: Radius | None = None,
    *,
    min_feature_px: Radius | None = None,
    spurs: Spurs | None = None,
) -> NDArray[np.bool_]:
    """The meso-skeleton M̂ of one layer (paper, Algorithm 2, anchored).

    image           (H, W) bool, True where the layer is solid; outside is empty
    radius_px       radius of the minimum feature F in pixels, as the paper's disc around a pixel's centre:
                    one number, or (rx, ry) for pixels that are not square
    min_feature_px  or F's size in pixels: F is round(size) pixels wide, even sizes, too
    spurs           how far paths reach into ends: "paper" shortens them by one pixel a round, for max(rx, ry) rounds;
                    "metric" measures them, alike in all directions. Usually "paper" by radius, "metric" by size
    returns         (H, W) bool, A ⊆ M̂ ⊆ S, with the components (8-connected) and holes (4-connected) of S.
                    A is the erosion S ⊖ F; of an F of even size, with the pixel east (south) of each of its pixels
    raises          InputError for a radius or size that is not above 0, an unknown rule, an array that is no image
    """
    feature, rule = feature_and_rule(radius_px, min_feature_px, spurs)
    rows, width = pack(image), np.shape(image)[1]
    return unpack(meso_skeleton_rows(rows, width, feature, rule), width)
