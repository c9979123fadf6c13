"""The method: thicken exactly what is narrower than the minimum feature F (paper, Algorithm 1, one slice).

Ŝ = M̂ ⊕ F, where M̂ is the meso-skeleton. Mode "as_printed" gives Ŝ: every feature is at least F, corners
come out as round as the tool makes them. Mode "add_only" gives S ∪ Ŝ, for printers that draw with a mask:
nothing that was there is taken away.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numba import types

from layerfix.bits import ROWS, WORK, pack, popcount, unpack
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import Room, fill_columns, to_rows
from layerfix.layers.morphology import dilate_columns, disc_half_widths, erode_columns, working_box
from layerfix.layers.skeleton import Radius, Spurs, check_spurs, radii_px, thin_anchored
from layerfix.layers.thickness import narrowest
from layerfix.stack import Change
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Layer, LayerStack

Mode = Literal["as_printed", "add_only"]
MODES: tuple[Mode, ...] = get_args(Mode)


@njit(types.UniTuple(types.int64, 3)(ROWS, WORK), cache=True, nogil=True)
def _count_changes(before, after):  # type: ignore[no-untyped-def]
    """(solid before, added, removed) in pixels."""
    solid, added, removed = 0, 0, 0
    for y in range(before.shape[0]):
        for w in range(before.shape[1]):
            a, b = before[y, w], after[y, w]
            if a:
                solid += popcount(a)
            if a != b:
                added += popcount(b & ~a)
                removed += popcount(a & ~b)
    return solid, added, removed


def _corrected(
    rows: Rows, width: int, half_widths: NDArray[np.int64], spur_rounds: float, add_only: bool, room: Room
) -> tuple[Rows, NDArray[np.uint64], NDArray[np.uint64], NDArray[np.uint64]] | None:
    """(corrected rows; S, M̂ and M as columns, in `room`); None for an empty layer."""
    outer = working_box(rows, half_widths)
    if outer[1] == 0:
        return None
    out = np.zeros(rows.shape, np.uint64)
    solid, skeleton, anchor, printed, scratch = room.columns(outer, 5)
    fill_columns(rows, outer, solid)
    np.copyto(skeleton, solid)
    erode_columns(solid, half_widths, anchor, scratch)
    thin_anchored(skeleton, anchor, spur_rounds, scratch)
    dilate_columns(skeleton, half_widths, printed, scratch)
    if add_only:
        np.bitwise_or(printed, solid, out=printed)
    to_rows(printed, outer, width, out)
    return out, solid, skeleton, anchor


def feature_radius_px(min_feature_mm: float, pixel_mm: tuple[float, float]) -> tuple[float, float]:
    """(rx, ry) of F in pixels: half the minimum feature over the pitch on each axis.

    Raises InputError if it is not above 0, or so small that F is a single pixel and nothing can be too thin.
    """
    if not 0 < min_feature_mm < np.inf:
        raise InputError(f"minimum feature {min_feature_mm} mm: it must be above 0")
    rx, ry = min_feature_mm / 2 / pixel_mm[0], min_feature_mm / 2 / pixel_mm[1]
    if max(rx, ry) < 1 - 1e-9:
        raise InputError(
            f"minimum feature {format_mm(min_feature_mm)} is under two pixels of"
            f" {' × '.join(format_mm(p) for p in sorted(set(pixel_mm)))}: no layer can hold anything thinner,"
            " so there is nothing to correct; use smaller pixels or a larger feature"
        )
    return rx, ry


def _check_mode(mode: str) -> None:
    if mode not in MODES:
        raise InputError(f"mode='{mode}' is not known; choose from {', '.join(MODES)}")


def correct(
    stack: LayerStack, *, min_feature_mm: float, mode: Mode = "as_printed", spurs: Spurs = "paper"
) -> LayerStack:
    """The stack with everything narrower than `min_feature_mm` thickened to it (paper, Algorithm 1).

    min_feature_mm  diameter of F, the smallest dot or bead the printer makes
    mode            "as_printed": M̂ ⊕ F; "add_only": S ∪ (M̂ ⊕ F)
    spurs           the end-point rule of the meso-skeleton, see `meso_skeleton`
    returns         a stack of the same frame and z's; each layer carries its `Change`. What F would add past
                    the frame's edge is cut off, so leave min_feature_mm / 2 of margin
    raises          InputError for a feature that is not above 0, under two pixels or larger than the frame
    """
    _check_mode(mode)
    check_spurs(spurs)
    rx, ry = feature_radius_px(min_feature_mm, stack.pixel_mm)
    if 2 * rx > stack.width and 2 * ry > stack.height:
        raise InputError(
            f"minimum feature {format_mm(min_feature_mm)} is larger than the layers, which are"
            f" {format_mm(stack.width * stack.pixel_mm[0])} × {format_mm(stack.height * stack.pixel_mm[1])}"
        )
    half_widths = disc_half_widths(rx, ry)
    return stack.map(_Correction(half_widths, (rx, ry), mode == "add_only", stack.pixel_mm))


@dataclass(frozen=True, eq=False)
class _Correction:
    """One layer corrected. A value, not a closure: stacks can be pickled."""

    half_widths: NDArray[np.int64]
    radius_px: tuple[float, float]
    add_only: bool
    pixel_mm: tuple[float, float]
    room: Room = field(default_factory=Room)

    def __call__(self, layer: Layer) -> Layer:
        half_widths, pixel_mm = self.half_widths, self.pixel_mm
        found = _corrected(layer.rows, layer.width, half_widths, max(self.radius_px), self.add_only, self.room)
        if found is None:
            return replace(layer, change=Change(0, 0, 0, None, self.radius_px))
        rows, *columns = found
        limit_mm = 2 * max(half_widths[0] + 1, len(half_widths)) * max(pixel_mm)
        thinnest_mm: float = narrowest(*columns, limit_mm, *pixel_mm)
        solid, added, removed = _count_changes(layer.rows, rows)
        change = Change(solid, added, removed, thinnest_mm if thinnest_mm < limit_mm else None, self.radius_px)
        return replace(layer, rows=rows, change=change)


def correct_rows(rows: Rows, width: int, radius: tuple[float, float], mode: Mode) -> Rows:
    """One layer corrected as packed rows: (H, words) → (H, words); radius is (rx, ry) in px."""
    _check_mode(mode)
    half_widths = disc_half_widths(*radius)
    found = _corrected(rows, width, half_widths, max(radius), mode == "add_only", Room())
    return np.zeros_like(rows) if found is None else found[0]


def correct_image(
    image: ArrayLike, radius_px: Radius, mode: Mode = "as_printed", *, spurs: Spurs = "paper"
) -> NDArray[np.bool_]:
    """One layer corrected: (H, W) bool → (H, W) bool. Arguments as in `meso_skeleton` and `correct`."""
    check_spurs(spurs)
    rows = pack(image)
    width = np.shape(image)[1]
    return unpack(correct_rows(rows, width, radii_px(radius_px), mode), width)
