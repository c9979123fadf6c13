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
from layerfix.layers.components import smaller_than
from layerfix.layers.drawing import anchor_columns, box_with_reach, draw_paths, find_paths, open_columns
from layerfix.layers.feature import Feature, Radius, feature_of_mm
from layerfix.layers.skeleton import Spurs, check_spurs, feature_and_rule, scratch_images, skeleton_columns
from layerfix.layers.thickness import narrowest
from layerfix.layers.topology import TopologyChange, changes_of
from layerfix.stack import Change
from layerfix.units import format_mm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Layer, LayerStack

    Columns = NDArray[np.uint64]

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
    rows: Rows, width: int, feature: Feature, spurs: Spurs, add_only: bool, room: Room
) -> tuple[Rows, tuple[int, int, int, int], Columns, Columns, Columns] | None:
    """(corrected rows; box; as columns of it, in `room`: S, the paths that were drawn, the result); None if empty."""
    half_widths, block = feature.half_widths, feature.block
    outer = box_with_reach(rows, *feature.reach_px)
    if outer[1] == 0:
        return None
    out = np.zeros(rows.shape, np.uint64)
    solid, anchor, skeleton, printed, paths, *scratch = room.columns(outer, 5 + scratch_images(spurs))
    fill_columns(rows, outer, solid)
    anchor_columns(solid, half_widths, *block, anchor, scratch[0])
    open_columns(anchor, half_widths, printed, scratch[0])
    skeleton_columns(solid, anchor, feature, spurs, skeleton, scratch, room)
    if find_paths(solid, skeleton, anchor, printed, half_widths, *block, feature.by_size, paths):
        draw_paths(paths, printed, half_widths, *block, scratch[0])
    if add_only:
        np.bitwise_or(printed, solid, out=printed)
    to_rows(printed, outer, width, out)
    return out, outer, solid, paths, printed


def _check_mode(mode: str) -> None:
    if mode not in MODES:
        raise InputError(f"mode='{mode}' is not known; choose from {', '.join(MODES)}")


def correct(
    stack: LayerStack,
    *,
    min_feature_mm: float | Sequence[float],
    mode: Mode = "as_printed",
    spurs: Spurs = "metric",
    ignore_below_mm2: float = 0.0,
) -> LayerStack:
    """The stack with everything narrower than `min_feature_mm` thickened to it (paper, Algorithm 1).

    min_feature_mm  diameter of F, the smallest dot or bead the printer makes. In pixels it is rounded, on each axis,
                    and what is that wide already is left alone (see `layerfix.layers.feature`). Or one for each
                    layer: first layers are often drawn wider
    mode            "as_printed": S ∘ F and what was too thin, drawn with F; "add_only": that and all of S
    spurs           the end-point rule of the meso-skeleton, see `meso_skeleton`
    ignore_below_mm2  parts of a layer with less area are left as they are: specks, that would become dots of F's size
    returns         a stack of the same frame and z's; each layer carries its `Change`. What F would add past
                    the frame's edge is cut off, so leave min_feature_mm / 2 of margin
    raises          InputError for a feature that is not above 0, under two pixels or larger than the frame, for other
                    than one feature a layer, and for an area that is negative
    """
    _check_mode(mode)
    check_spurs(spurs)
    if not 0 <= ignore_below_mm2 < np.inf:
        raise InputError(f"ignore below {ignore_below_mm2} mm²: it must be 0 or more")
    sizes_mm = [min_feature_mm] if isinstance(min_feature_mm, (int, float)) else [float(d) for d in min_feature_mm]
    if not isinstance(min_feature_mm, (int, float)) and len(sizes_mm) != len(stack):
        raise InputError(f"{len(sizes_mm)} minimum features for {len(stack)} layers: give one, or one for each")
    features = {size_mm: feature_of_mm(size_mm, stack.pixel_mm) for size_mm in dict.fromkeys(sizes_mm)}
    for size_mm, feature in features.items():
        if feature.radius_px[0] * 2 > stack.width and feature.radius_px[1] * 2 > stack.height:
            raise InputError(
                f"minimum feature {format_mm(size_mm)} is larger than the layers, which are"
                f" {format_mm(stack.width * stack.pixel_mm[0])} × {format_mm(stack.height * stack.pixel_mm[1])}"
            )
    of_layer = tuple(features[size_mm] for size_mm in sizes_mm)
    ignore_px = ignore_below_mm2 / (stack.pixel_mm[0] * stack.pixel_mm[1])
    if stack.repeats is not None and len(sizes_mm) > 1:
        other = np.concatenate([[True], np.diff(sizes_mm) != 0])
        stack = replace(stack, repeats=stack.repeats & ~other)
    return stack.map(
        _Correction(
            of_layer,
            stack.z_mm[:, 0],
            spurs,
            mode == "add_only",
            stack.pixel_mm,
            stack.origin_mm,
            ignore_px * (1 - 1e-9),
        ),
        pixels_only=True,
    )


@dataclass(frozen=True, eq=False)
class _Correction:
    """One layer corrected. A value, not a closure: stacks can be pickled."""

    features: tuple[Feature, ...]  # one, or one for each layer
    bottoms_mm: NDArray[np.float64]
    spurs: Spurs
    add_only: bool
    pixel_mm: tuple[float, float]
    origin_mm: tuple[float, float]
    ignore_px: float
    room: Room = field(default_factory=Room)

    def __call__(self, layer: Layer) -> Layer:
        feature, pixel_mm = self._feature(layer), self.pixel_mm
        specks = smaller_than(layer.rows, self.ignore_px) if self.ignore_px > 0 else None
        ignored_px = int(np.bitwise_count(specks).sum()) if specks is not None else 0
        wanted = layer.rows & ~specks if specks is not None and ignored_px else layer.rows
        layer_found = _corrected(wanted, layer.width, feature, self.spurs, self.add_only, self.room)
        if layer_found is None:
            return replace(
                layer,
                change=Change(ignored_px, 0, 0, None, feature.radius_px, feature.offset_px, ignored_px=ignored_px),
            )
        rows, outer, solid_columns, path_columns, printed_columns = layer_found
        feature_mm = max(2 * r * p for r, p in zip(feature.radius_px, pixel_mm, strict=True))
        thinnest_mm: float = narrowest(solid_columns, path_columns, feature_mm, *pixel_mm)
        if specks is not None and ignored_px:
            rows |= specks
        solid, added, removed = _count_changes(layer.rows, rows)
        paths = None
        if layer.source is not None:
            paths = np.zeros_like(rows)
            to_rows(path_columns, outer, layer.width, paths)
        topology: tuple[TopologyChange, ...] = ()
        if added:
            corner_px = 64 * outer[2], outer[0]
            topology = changes_of(solid_columns, printed_columns, corner_px, pixel_mm, self.origin_mm, layer.z_mm)
        thinnest = thinnest_mm if thinnest_mm < np.inf else None
        change = Change(
            solid, added, removed, thinnest, feature.radius_px, feature.offset_px, topology, ignored_px, paths
        )
        return replace(layer, rows=rows, change=change)

    def _feature(self, layer: Layer) -> Feature:
        if len(self.features) == 1:
            return self.features[0]
        return self.features[int(np.abs(self.bottoms_mm - layer.z_mm[0]).argmin())]


def correct_rows(rows: Rows, width: int, feature: Feature, mode: Mode, spurs: Spurs) -> Rows:
    """One layer corrected as packed rows: (H, words) → (H, words)."""
    _check_mode(mode)
    found = _corrected(rows, width, feature, spurs, mode == "add_only", Room())
    return np.zeros_like(rows) if found is None else found[0]


def correct_image(
    image: ArrayLike,
    radius_px: Radius | None = None,
    mode: Mode = "as_printed",
    *,
    min_feature_px: Radius | None = None,
    spurs: Spurs | None = None,
) -> NDArray[np.bool_]:
    """One layer corrected: (H, W) bool → (H, W) bool. Arguments as in `meso_skeleton` and `correct`.

    By radius it is the paper's M̂ ⊕ F (or S ∪ M̂ ⊕ F); by size, what is printable already is left alone.
    """
    feature, rule = feature_and_rule(radius_px, min_feature_px, spurs)
    rows, width = pack(image), np.shape(image)[1]
    return unpack(correct_rows(rows, width, feature, mode, rule), width)
