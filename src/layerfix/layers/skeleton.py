"""The meso-skeleton M̂: where the print head must be able to go (paper, Algorithm 2).

M̂ is the erosion M = S ⊖ F plus one-pixel paths through whatever is narrower than F. It is S thinned until
nothing changes, with M's pixels anchored: never deleted. (The paper deletes and ORs them back after each
round; on 2,500 random images that broke the topology of 6, the anchored form of none.)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numba import types

from layerfix.bits import WORK, pack, unpack
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import BLOCK, to_columns, to_rows
from layerfix.layers.morphology import disc_half_widths, erode_columns, working_box
from layerfix.layers.thinning import FIRST, SECOND, SPURS, remove_spurs, start_changes, sub_iteration
from layerfix.units import one_or_two

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows

Spurs = Literal["paper"]
SPUR_RULES: tuple[Spurs, ...] = get_args(Spurs)
MAX_RADIUS_PX = 4096  # a disc of half a gigabyte of offsets; no printer is that coarse
Radius = float | tuple[float, float]


@njit(types.void(WORK, WORK, types.float64, WORK), cache=True, nogil=True)
def thin_anchored(columns, anchor, spur_rounds, scratch):  # type: ignore[no-untyped-def]
    """Algorithm 2's loop in place: thin `columns` around `anchor`, removing spurs while j < spur_rounds."""
    words, height = columns.shape
    blocks = (height - 2) // BLOCK
    changed = np.empty((3, words, blocks), np.uint8)
    active = np.zeros((words, blocks), np.uint8)
    gone = np.zeros((2, height), np.uint64)
    start_changes(columns, changed)
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


def radii_px(radius_px: Radius) -> tuple[float, float]:
    """(rx, ry) of a radius given as one number or two. Raises InputError unless both are above 0."""
    rx, ry = one_or_two(radius_px, "radius", "px")
    if max(rx, ry) > MAX_RADIUS_PX:
        raise InputError(f"radius {radius_px} px: at most {MAX_RADIUS_PX} px")
    return rx, ry


def check_spurs(spurs: str) -> None:
    """Raises InputError for a spur rule that is not known."""
    if spurs not in SPUR_RULES:
        raise InputError(f"spurs='{spurs}' is not known; choose from {', '.join(SPUR_RULES)}")


def meso_skeleton_rows(rows: Rows, width: int, radius: tuple[float, float]) -> Rows:
    """`meso_skeleton` on packed rows: (H, words) → (H, words)."""
    out, disc = np.zeros_like(rows), disc_half_widths(*radius)
    outer = working_box(rows, disc)
    if outer[1]:
        columns = to_columns(rows, outer)
        anchor, scratch = np.empty_like(columns), np.empty_like(columns)
        erode_columns(columns, disc, anchor, scratch)
        thin_anchored(columns, anchor, max(radius), scratch)
        to_rows(columns, outer, width, out)
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


def meso_skeleton(image: ArrayLike, radius_px: Radius, *, spurs: Spurs = "paper") -> NDArray[np.bool_]:
    """The meso-skeleton M̂ of one layer (paper, Algorithm 2, anchored).

    image      (H, W) bool, True where the layer is solid; outside is empty
    radius_px  radius of the minimum feature F in pixels: one number, or (rx, ry) for pixels that are not square
    spurs      the end-point rule; "paper" shortens a skeletal path by one pixel a round, for max(rx, ry) rounds
    returns    (H, W) bool, M ⊆ M̂ ⊆ S, with the components (8-connected) and holes (4-connected) of S
    raises     InputError for a radius that is not above 0, an unknown rule, an array that is no image
    """
    check_spurs(spurs)
    rows, width = pack(image), np.shape(image)[1]
    return unpack(meso_skeleton_rows(rows, width, radii_px(radius_px)), width)
