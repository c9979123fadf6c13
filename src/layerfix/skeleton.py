"""The meso-skeleton M̂: where the print head must be able to go (paper, Algorithm 2).

M̂ is the erosion M = S ⊖ F plus one-pixel paths through whatever is narrower than F. It is S thinned until
nothing changes, with M's pixels anchored: never deleted. (The paper deletes and ORs them back after each
round; on 2,500 random images that broke the topology of 6, the anchored form of none.)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit, types

from layerfix.bits import U0, WORK, pack, unpack
from layerfix.errors import InputError
from layerfix.morphology import (
    bounding_box,
    disc_half_widths,
    erode_padded,
    padded_crop,
    paste,
)
from layerfix.thinning import FIRST, SECOND, SPURS, remove_spurs, start_changes, sub_iteration

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows

SPUR_RULES = ("paper",)
Radius = float | tuple[float, float]


@njit(types.void(WORK, WORK, types.float64, WORK), cache=True, nogil=True)
def thin_anchored(padded, anchor, spur_rounds, scratch):  # type: ignore[no-untyped-def]
    """Algorithm 2's loop in place: thin `padded` around `anchor`, with spurs removed while j < spur_rounds."""
    height, words = padded.shape
    changed = np.empty((3, height), np.uint64)
    active = np.zeros(height, np.uint64)
    deleted = np.zeros((2, words), np.uint64)
    start_changes(padded, changed)
    j = 0
    again = True
    while again:
        again = sub_iteration(padded, anchor, FIRST, changed, active, deleted)
        again = sub_iteration(padded, anchor, SECOND, changed, active, deleted) or again
        if j < spur_rounds:
            again = remove_spurs(padded, anchor, changed, active, deleted, scratch) or again
        else:
            changed[SPURS] = U0
        j += 1


def radii_px(radius_px: Radius) -> tuple[float, float]:
    """(rx, ry) of a radius given as one number or two. Raises InputError unless both are above 0."""
    rx, ry = (radius_px, radius_px) if isinstance(radius_px, (int, float)) else radius_px
    if not (0 < rx < np.inf and 0 < ry < np.inf):
        raise InputError(f"radius {radius_px} px: it must be above 0")
    return float(rx), float(ry)


def check_spurs(spurs: str) -> None:
    """Raises InputError for a spur rule that is not known."""
    if spurs not in SPUR_RULES:
        raise InputError(f"spurs='{spurs}' is not known; choose from {', '.join(SPUR_RULES)}")


def meso_skeleton_rows(rows: Rows, radius: tuple[float, float]) -> Rows:
    """`meso_skeleton` on packed rows: (H, words) → (H, words)."""
    out = np.zeros_like(rows)
    box = bounding_box(rows)
    if box[1]:
        padded = padded_crop(rows, box)
        anchor, scratch = np.empty_like(padded), np.empty_like(padded)
        erode_padded(padded, disc_half_widths(*radius), anchor, scratch)
        thin_anchored(padded, anchor, max(radius), scratch)
        paste(padded, box, out)
    return out


def meso_skeleton(image: ArrayLike, radius_px: Radius, *, spurs: str = "paper") -> NDArray[np.bool_]:
    """The meso-skeleton M̂ of one layer (paper, Algorithm 2, anchored).

    image      (H, W) bool, True where the layer is solid; outside is empty
    radius_px  radius of the minimum feature F in pixels: one number, or (rx, ry) for pixels that are not square
    spurs      the end-point rule; "paper" shortens a skeletal path by one pixel a round, for max(rx, ry) rounds
    returns    (H, W) bool, M ⊆ M̂ ⊆ S, with the components (8-connected) and holes (4-connected) of S
    raises     InputError for a radius that is not above 0, an unknown rule, an array that is no image
    """
    check_spurs(spurs)
    rows = pack(image)
    return unpack(meso_skeleton_rows(rows, radii_px(radius_px)), np.shape(image)[1])
