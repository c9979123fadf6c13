"""The method: thicken exactly what is narrower than the minimum feature F (paper, Algorithm 1, one slice).

Ŝ = M̂ ⊕ F, where M̂ is the meso-skeleton. Mode "as_printed" gives Ŝ: every feature is at least F, corners
come out as round as the tool makes them. Mode "add_only" gives S ∪ Ŝ, for printers that draw with a mask:
nothing that was there is taken away.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from layerfix.bits import pack, unpack
from layerfix.errors import InputError
from layerfix.layers.columns import Room, to_rows
from layerfix.layers.components import smaller_than
from layerfix.layers.feature import Feature, Radius, feature_of_mm, feature_of_size
from layerfix.layers.gaps import GROWS, Conflict, Grow
from layerfix.layers.heights import Raised, with_min_layers
from layerfix.layers.latest import Latest
from layerfix.layers.one_layer import Free, corrected_columns, finish
from layerfix.layers.skeleton import Spurs, check_spurs, feature_and_rule
from layerfix.layers.specks import with_specks
from layerfix.layers.topology import TopologyChange, box_of, changes_of
from layerfix.stack import Change
from layerfix.units import format_mm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Layer, LayerStack


Mode = Literal["as_printed", "add_only"]
MODES: tuple[Mode, ...] = get_args(Mode)


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
    ignore_specks: bool = False,
    keep_gaps_mm: float | None = None,
    keep_out: LayerStack | None = None,
    grow: Grow = "both",
    min_layers: int = 1,
) -> LayerStack:
    """The stack with everything narrower than `min_feature_mm` thickened to it (paper, Algorithm 1).

    min_feature_mm  diameter of F, the smallest dot or bead the printer makes. In pixels it is rounded, on each axis,
                    and what is that wide already is left alone (see `layerfix.layers.feature`). Or one for each
                    layer: first layers are often drawn wider
    mode            "as_printed": S ∘ F and what was too thin, drawn with F; "add_only": that and all of S
    spurs           the end-point rule of the meso-skeleton, see `meso_skeleton`
    ignore_below_mm2  parts of a layer with less area are left as they are: specks, that would become dots of F's size
    ignore_specks   parts with nothing below and nothing above are left as they are
    keep_gaps_mm    what is to stay free between parts, and in holes and channels; at least a pixel stays. None: parts
                    may grow together, holes may close. See `layerfix.layers.gaps`
    keep_out        a stack on the same frame: nothing is added where it is solid; material goes to the other side
    min_layers      what is solid for fewer layers in a row becomes so many high first (`layerfix.layers.heights`)
    grow            "outward": nothing is added in holes; "inward": nothing is added outside; "both"
    returns         a stack of the same frame and z's; each layer carries its `Change`. What F would add past
                    the frame's edge is cut off, so leave min_feature_mm / 2 of margin
    raises          InputError for a feature that is not above 0, under two pixels or larger than the frame, for other
                    than one feature a layer, an area below 0, a gap that is not above 0, another frame of keep_out
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
    if grow not in GROWS:
        raise InputError(f"grow='{grow}' is not known; choose from {', '.join(GROWS)}")
    if keep_gaps_mm is not None and not 0 < keep_gaps_mm < np.inf:
        raise InputError(f"keep gaps of {keep_gaps_mm} mm: it must be above 0")
    if keep_out is not None:
        _check_same_frame(stack, keep_out)
    if stack.repeats is not None and len(sizes_mm) > 1:
        other = np.concatenate([[True], np.diff(sizes_mm) != 0])
        stack = replace(stack, repeats=stack.repeats & ~other)
    return with_min_layers(with_specks(stack) if ignore_specks else stack, min_layers).map(
        _Correction(
            of_layer,
            stack.z_mm[:, 0],
            spurs,
            mode == "add_only",
            stack.pixel_mm,
            stack.origin_mm,
            ignore_px * (1 - 1e-9),
            keep_gaps_mm,
            keep_out,
            grow,
        ),
        pixels_only=keep_out is None and not ignore_specks,
    )


def _check_same_frame(stack: LayerStack, other: LayerStack) -> None:
    """Raises InputError unless the pixels of two stacks are the same places."""
    same = (stack.width, stack.height) == (other.width, other.height)
    near = np.allclose([*stack.pixel_mm, *stack.origin_mm], [*other.pixel_mm, *other.origin_mm], atol=1e-6)
    if not (same and near):
        corners = [f" at x {one.origin_mm[0]:g}, y {one.origin_mm[1]:g} mm" for one in (other, stack)]
        raise InputError(
            f"keep_out {other!r}{corners[0]} is not on the frame of {stack!r}{corners[1]} (upper left corners); give"
            " layers of that frame, or a mesh (`slice_like` cuts it)"
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
    keep_gaps_mm: float | None
    keep_out: LayerStack | None
    grow: Grow
    keep_paths: bool = False  # each layer's change tells where F was drawn, greys or not
    room: Room = field(default_factory=Room)
    latest: Latest[tuple[Feature, Layer]] = field(default_factory=Latest)

    def __call__(self, layer: Layer) -> Layer:
        pixels_only = layer.specks is None and layer.source is None and self.keep_out is None
        known = self.latest.of(layer) if pixels_only else None
        if known is not None and known[0] is self._feature(layer):
            return _at_height(known[1], layer)
        done = self._worked_on(layer)
        if pixels_only:
            self.latest.keep(layer, (self._feature(layer), done))
        return done

    def _worked_on(self, layer: Layer) -> Layer:
        feature, pixel_mm = self._feature(layer), self.pixel_mm
        specks = smaller_than(layer.rows, self.ignore_px) if self.ignore_px > 0 else None
        if layer.specks is not None:
            specks = layer.specks if specks is None else specks | layer.specks
        ignored_px = int(np.bitwise_count(specks).sum()) if specks is not None else 0
        wanted = layer.rows & ~specks if specks is not None and ignored_px else layer.rows
        small = layer.small
        if small is not None and specks is not None:
            y, x = small.T.clip(0)
            inside = (y < layer.height) & (x < layer.width)
            y, x = np.where(inside, y, 0), np.where(inside, x, 0)
            small = small[(specks[y, x >> 6] >> (x & 63).astype(np.uint64)) & np.uint64(1) == 0]
        found = corrected_columns(
            wanted,
            feature,
            self.spurs,
            self.add_only,
            self.room,
            self._free(layer),
            pixel_mm,
            small,
        )
        if found is None:
            return replace(
                layer,
                change=Change(ignored_px, 0, 0, None, feature.radius_px, feature.offset_px, ignored_px=ignored_px),
            )
        rows, outer = np.zeros_like(layer.rows), found.outer
        feature_mm = max(2 * r * p for r, p in zip(feature.radius_px, pixel_mm, strict=True))
        if specks is not None and ignored_px:
            rows |= specks
        solid, added, removed, thinnest_mm = finish(
            layer.rows, found.solid, found.paths, found.printed, outer, layer.width, feature_mm, *pixel_mm, rows
        )
        paths = None
        if getattr(layer.source, "held", None) is not None or self.keep_paths:
            paths = np.zeros_like(rows)
            to_rows(found.centres, outer, layer.width, paths)
            if layer.raised_px and layer.source is not None:
                paths |= layer.rows & ~layer.source.seen  # drawn in full
        topology: tuple[TopologyChange, ...] = ()
        corner_px = 64 * outer[2], outer[0]
        if added:
            topology = changes_of(found.solid, found.printed, corner_px, pixel_mm, self.origin_mm, layer.z_mm)
        thinnest = thinnest_mm if thinnest_mm < np.inf else None
        change = Change(
            solid, added, removed, thinnest, feature.radius_px, feature.offset_px, topology,
            tuple(Conflict(kind, box_of(part, corner_px, pixel_mm, self.origin_mm), width, layer.z_mm)
                  for kind, part, width in found.conflicts),
            ignored_px, paths,
        )  # fmt: skip
        return replace(layer, rows=rows, change=change)

    def _free(self, layer: Layer) -> Free | None:
        if self.keep_gaps_mm is None and self.keep_out is None and self.grow == "both":
            return None
        gap_px, keep_out = None, None
        if self.keep_gaps_mm is not None:
            gap_px = self.keep_gaps_mm / self.pixel_mm[0], self.keep_gaps_mm / self.pixel_mm[1]
        if self.keep_out is not None:
            bounds, middle = self.keep_out.z_mm, sum(layer.z_mm) / 2
            at = int(np.searchsorted(bounds[:, 0], middle, side="right")) - 1
            if at >= 0 and middle < bounds[at, 1]:
                keep_out = self.keep_out.make(at).rows
        return Free(gap_px, self.grow, keep_out)

    def _feature(self, layer: Layer) -> Feature:
        if len(self.features) == 1:
            return self.features[0]
        return self.features[int(np.abs(self.bottoms_mm - layer.z_mm[0]).argmin())]


def _at_height(done: Layer, layer: Layer) -> Layer:
    """A layer whose pixels are those of one that was corrected already."""
    change = done.change
    if change is not None:
        topology = tuple(replace(one, z_mm=layer.z_mm) for one in change.topology)
        conflicts = tuple(replace(one, z_mm=layer.z_mm) for one in change.conflicts)
        change = replace(change, topology=topology, conflicts=conflicts)
    return replace(layer, rows=done.rows, change=change)


def corrected_like(stack: LayerStack, fixed: LayerStack) -> LayerStack:
    """Another slicing of the same part, corrected as `fixed` was: every layer by the feature at its height.

    stack   at other pixels and layers, on the same plate
    fixed   what `correct` made
    returns a stack whose changes tell where F was drawn (`Change.paths`), in mode add_only
    raises  InputError if `correct` did not make `fixed`, or kept gaps or places free, or raised layers: that depends
            on the pixels
    """
    why_not = why_not_elsewhere(fixed)
    if why_not:
        raise InputError(why_not)
    done: _Correction = _correction_of(fixed).change
    middles = stack.z_mm.mean(axis=1)
    at = np.clip(np.searchsorted(fixed.z_mm[:, 0], middles, side="right") - 1, 0, len(fixed) - 1)
    scaled = [
        feature_of_size((
            2 * f.radius_px[0] * done.pixel_mm[0] / stack.pixel_mm[0],
            2 * f.radius_px[1] * done.pixel_mm[1] / stack.pixel_mm[1],
        ))
        for f in done.features
    ]  # fmt: skip
    features = (
        tuple(scaled)
        if len(scaled) == 1
        else tuple(scaled[int(np.abs(done.bottoms_mm - fixed.z_mm[k, 0]).argmin())] for k in at)
    )
    area = done.pixel_mm[0] * done.pixel_mm[1] / (stack.pixel_mm[0] * stack.pixel_mm[1])
    change = replace(
        done, features=features, bottoms_mm=stack.z_mm[:, 0], add_only=True, pixel_mm=stack.pixel_mm,
        origin_mm=stack.origin_mm, ignore_px=done.ignore_px * area, keep_paths=True, room=Room(), latest=Latest(),
    )  # fmt: skip
    return stack.map(change)


def why_not_elsewhere(fixed: LayerStack) -> str:
    """Why the correction of these layers cannot be made on other pixels, with nothing taken away; "" if it can."""
    make = _correction_of(fixed)
    if make is None:
        return "these layers were not made by correct(), which says how thin is too thin"
    done: _Correction = make.change
    if not done.add_only:
        return "these layers were corrected as_printed, which takes corners away, too; add_only keeps all there was"
    if done.keep_gaps_mm is not None or done.keep_out is not None or isinstance(make.make, Raised):
        return "gaps and places that are kept free, and layers that are raised, are so to the pixel"
    return ""


def telling_paths(fixed: LayerStack) -> LayerStack:
    """The same layers, whose changes also tell where F was drawn; others than those of `correct` as they are."""
    if _correction_of(fixed) is None:
        return fixed

    def telling(make: Any) -> Any:
        if isinstance(getattr(make, "change", None), _Correction):
            return replace(make, change=replace(make.change, keep_paths=True, room=Room(), latest=Latest()))
        return replace(make, make=telling(make.make))

    return replace(fixed, make=telling(fixed.make))


def before(fixed: LayerStack) -> LayerStack:
    """The layers that `correct` was given. Raises InputError for layers that it did not make."""
    if _correction_of(fixed) is None:
        raise InputError("these layers were not made by correct(): nothing says what was changed")

    def without(make: Any) -> Any:
        if isinstance(getattr(make, "change", None), _Correction):
            return make.make
        return replace(make, make=without(make.make))

    return replace(fixed, make=without(fixed.make), repeats=None)


def _correction_of(fixed: LayerStack) -> Any:
    """What makes the layers of a stack as `correct` left them; None if it did not."""
    make: Any = fixed.make
    while not isinstance(getattr(make, "change", None), _Correction):
        if not hasattr(make, "make"):
            return None
        make = make.make
    return make


def correct_rows(rows: Rows, width: int, feature: Feature, mode: Mode, spurs: Spurs) -> Rows:
    """One layer corrected as packed rows: (H, words) → (H, words)."""
    _check_mode(mode)
    found = corrected_columns(rows, feature, spurs, mode == "add_only", Room())
    out = np.zeros_like(rows)
    if found is not None:
        to_rows(found.printed, found.outer, width, out)
    return out


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
