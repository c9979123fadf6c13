"""What a printer would make of layers as they are: what is lost, what is thinnest, what begins on nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import WORK, popcount
from layerfix.kernels import njit
from layerfix.layers.columns import Room, fill_columns
from layerfix.layers.components import (
    AREA,
    RUNS,
    has_bit,
    label_runs,
    measured_parts,
    parts_apart,
)
from layerfix.layers.drawing import (
    box_with_reach,
    draw_paths,
    missing_places,
)
from layerfix.layers.feature import Feature, feature_of_mm
from layerfix.layers.gaps import one_by_one
from layerfix.layers.latest import Latest
from layerfix.layers.print_paths import IMAGES_OF_LAYER, PATHS, SOLID, printed_and_paths, tool_of
from layerfix.layers.skeleton import Spurs, check_spurs
from layerfix.layers.thickness import narrowest
from layerfix.layers.topology import TopologyChange, box_of, changes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Gaps, Layer, LayerStack

    Columns = NDArray[np.uint64]


FLAGS = types.Array(types.boolean, 1, "C")


@dataclass(frozen=True)
class Place:
    """One part of a layer: z_mm (bottom, top), box_mm (left, bottom, right, top), area_mm2."""

    z_mm: tuple[float, float]
    box_mm: tuple[float, float, float, float]
    area_mm2: float


@dataclass(frozen=True)
class LayerVerdict:
    """One layer at a minimum feature F.

    z_mm            (bottom, top)
    parts           components (8-connected)
    features_left   those that would be lost of the layer after correction
    features_lost   connected stretches of what is narrower than F: fins, pins, necks, thin walls
    lost            parts of which nothing would be printed
    lost_mm2        area of S that S ∘ F misses where something is too thin (not at corners, which the tool rounds)
    thinnest_mm     width at the narrowest of them, None if there is none
    thinnest_gap_mm the same of the void: gaps, slots, holes and channels narrower than F
    topology        what would merge and close if it were corrected
    islands         parts with nothing below, not even beside a pixel; none in the first layer
    alone           parts with nothing below and nothing above: specks; in a single layer none
    hairline_px     pixels that stand for what is thinner than one
    sheet_px        pixels of what is thinner than a layer and was met by no mid-plane
    sheets_lost     parts of such, too thin to be kept
    joined          pieces of a mesh that are one part, since they are within two pixels of one another
    solid_mm2       area of the layer
    gaps            of an open mesh, closed in this layer
    """

    z_mm: tuple[float, float]
    parts: int
    features_lost: int = 0
    lost: tuple[Place, ...] = ()
    lost_mm2: float = 0.0
    thinnest_mm: float | None = None
    topology: tuple[TopologyChange, ...] = ()
    islands: tuple[Place, ...] = ()
    alone: tuple[Place, ...] = ()
    hairline_px: int = 0
    sheet_px: int = 0
    sheets_lost: int = 0
    features_left: int = 0
    thinnest_gap_mm: float | None = None
    solid_mm2: float = 0.0
    gaps: Gaps | None = None
    joined: tuple[TopologyChange, ...] = ()


@njit(types.Tuple((RUNS, FLAGS, types.int64, types.int64))(WORK, WORK, WORK, WORK), cache=True, nogil=True)
def _lost(solid, opened, paths, drawn):  # type: ignore[no-untyped-def]  # numba types it
    """(parts of S; which of them S ∘ F has a pixel of; stretches of the paths; pixels of S that S ∘ F misses and what
    is drawn holds)."""
    runs, parent, _ = label_runs(solid, False)
    number, parts = measured_parts(runs, parent)
    kept = np.zeros(parts.shape[0], np.bool_)
    for k in range(runs.shape[0]):
        if not kept[number[k]]:
            kept[number[k]] = has_bit(opened, False, runs[k, 0], runs[k, 1], runs[k, 2])
    lost_px = 0
    for w in range(solid.shape[0]):
        for y in range(solid.shape[1]):
            lost_px += popcount(solid[w, y] & ~opened[w, y] & drawn[w, y])
    return parts, kept, label_runs(paths, False)[2], lost_px


@dataclass(frozen=True, eq=False)
class _Judge:
    """The verdict on one layer alone."""

    feature: Feature
    spurs: Spurs
    add_only: bool
    pixel_mm: tuple[float, float]
    origin_mm: tuple[float, float]
    room: Room = field(default_factory=Room)
    latest: Latest[LayerVerdict] = field(default_factory=Latest)

    def __call__(self, layer: Layer) -> tuple[Rows, LayerVerdict]:
        known = self.latest.of(layer)
        verdict = self._judged(layer) if known is None else _at_height(known, layer)
        self.latest.keep(layer, verdict)
        return layer.rows, verdict

    def _judged(self, layer: Layer) -> LayerVerdict:
        feature, pixel_mm = self.feature, self.pixel_mm
        outer = box_with_reach(layer.rows, *feature.reach_px)
        if outer[1] == 0:
            return LayerVerdict(layer.z_mm, 0, gaps=layer.gaps)
        gap_mm = min((width for _, width in self.narrow(layer.rows, True, each=False)), default=None)
        images = self.room.columns(outer, IMAGES_OF_LAYER + 1)
        solid, _, _, opened, paths, spare, dots = images[:7]
        drawn = images[-1]
        fill_columns(layer.rows, outer, solid)
        any_path = self._find(images)
        parts, kept, features, lost_px = _lost(solid, opened, paths, drawn)
        corner_px, area_mm2 = (64 * outer[2], outer[0]), pixel_mm[0] * pixel_mm[1]
        if layer.small is not None:  # separate pieces that the raster joins with others
            np.bitwise_or(opened, drawn, out=spare)
            features += missing_places(spare, layer.small, outer[0], 64 * outer[2], dots)
            any_path = any_path or bool(dots.any())
            paths |= dots & solid
            draw_paths(dots, drawn, feature.half_widths, *feature.block, spare)
        verdict = LayerVerdict(
            layer.z_mm,
            len(parts),
            features,
            self.places(parts[~kept], layer.z_mm, corner_px),
            lost_px * area_mm2,
            hairline_px=layer.hairline_px,
            sheet_px=layer.sheet_px,
            sheets_lost=layer.sheets_lost,
            thinnest_gap_mm=gap_mm,
            solid_mm2=float(parts[:, AREA].sum() * area_mm2),
            gaps=layer.gaps,
            joined=layer.joined,
        )
        if not any_path:
            return verdict
        feature_mm = max(2 * r * p for r, p in zip(feature.radius_px, pixel_mm, strict=True))
        thinnest_mm = float(narrowest(solid, paths, feature_mm, *pixel_mm, False))
        np.bitwise_or(drawn, solid if self.add_only else opened, out=drawn)
        topology = changes_of(solid, drawn, corner_px, pixel_mm, self.origin_mm, layer.z_mm)
        solid[:] = drawn
        left = label_runs(paths, False)[2] if self._find(images) else 0
        return replace(verdict, thinnest_mm=thinnest_mm, topology=topology, features_left=left)

    def narrow(self, rows: Rows, of_void: bool, *, each: bool) -> list[tuple[NDArray[np.int64], float]]:
        """(box, width in mm) of the stretches of a layer, or of its void, that are narrower than F: of each, or of
        all of them together.
        """
        outer = box_with_reach(rows, *(3 * reach + 3 for reach in self.feature.reach_px))
        images = self.room.columns(outer, IMAGES_OF_LAYER + 1)
        solid, paths = images[SOLID], images[PATHS]
        fill_columns(rows, outer, solid)
        if of_void:  # what is outside the box is void, too, but far away: its border stays empty, as kernels need it
            np.bitwise_not(solid[1:-1, 1:-1], out=solid[1:-1, 1:-1])
        if not self._find(images):
            return []
        limit_mm = max(2 * r * p for r, p in zip(self.feature.radius_px, self.pixel_mm, strict=True))
        found = (
            [(part, only.copy()) for part, only in one_by_one(paths)] if each else [(np.zeros(5, np.int64), paths)]
        )
        corner = np.array([0, 64 * outer[2], outer[0], 64 * outer[2], outer[0]])
        return [
            (part + corner, float(narrowest(solid, only, limit_mm, *self.pixel_mm, of_void))) for part, only in found
        ]

    def _find(self, images: Columns) -> bool:
        """`printed_and_paths` of the first image, S, and what F draws along the paths, in the last; whether there are
        any."""
        drawn, feature = images[-1], self.feature
        found = printed_and_paths(images[:-1], tool_of(feature, self.spurs), self.room)
        drawn[:] = 0
        if found:
            draw_paths(images[PATHS], drawn, feature.half_widths, *feature.block, images[PATHS + 1])
        return found

    def places(
        self, table: NDArray[np.int64], z_mm: tuple[float, float], corner_px: tuple[int, int] = (0, 0)
    ) -> tuple[Place, ...]:
        """Rows of a kernel's table as places on the frame."""
        return tuple(
            Place(
                z_mm,
                box_of(row, corner_px, self.pixel_mm, self.origin_mm),
                float(row[AREA] * self.pixel_mm[0] * self.pixel_mm[1]),
            )
            for row in table
        )


def _at_height(known: LayerVerdict, layer: Layer) -> LayerVerdict:
    """The verdict on a layer whose pixels are those of another."""
    return replace(
        known,
        z_mm=layer.z_mm,
        lost=tuple(replace(place, z_mm=layer.z_mm) for place in known.lost),
        topology=tuple(replace(one, z_mm=layer.z_mm) for one in known.topology),
        hairline_px=layer.hairline_px,
        sheet_px=layer.sheet_px,
        sheets_lost=layer.sheets_lost,
        gaps=layer.gaps,
        joined=layer.joined,
    )


def narrowest_place(
    stack: LayerStack, index: int, *, min_feature_mm: float, of_void: bool, spurs: Spurs = "metric"
) -> Place | None:
    """Where a layer, or its void, is narrowest: the box of that stretch's middle line, with the line's length in
    pixels as its area. None if nothing is narrower than F.
    """
    one = _Judge(feature_of_mm(min_feature_mm, stack.pixel_mm), spurs, False, stack.pixel_mm, stack.origin_mm)
    layer = stack[index]
    found = one.narrow(layer.rows, of_void, each=True) if layer.rows.any() else []
    if not found:
        return None
    part, _ = min(found, key=lambda pair: pair[1])
    return one.places(part[None], layer.z_mm)[0]


def judge(
    stack: LayerStack, *, min_feature_mm: float, add_only: bool = False, spurs: Spurs = "metric"
) -> Iterator[LayerVerdict]:
    """The verdict on every layer, from the bottom up, one layer behind what is read.

    Raises InputError for a feature that is not above 0 or under two pixels, and for an unknown rule.
    """
    check_spurs(spurs)
    one = _Judge(feature_of_mm(min_feature_mm, stack.pixel_mm), spurs, add_only, stack.pixel_mm, stack.origin_mm)
    below: Rows | None = None
    held: tuple[Rows, LayerVerdict] | None = None

    def alone(rows: Rows, verdict: LayerVerdict, above: Rows, first: bool) -> LayerVerdict:
        if not verdict.parts or not (first or verdict.islands):
            return verdict
        free = one.places(parts_apart(rows, above), verdict.z_mm)
        islands = {place.box_mm: place for place in verdict.islands}
        return replace(verdict, alone=tuple(place for place in free if first or islands.get(place.box_mm) == place))

    first = True
    for rows, verdict in stack.each(one):
        if below is not None and verdict.parts:
            verdict = replace(verdict, islands=one.places(parts_apart(rows, below), verdict.z_mm))
        if held is not None:
            yield alone(*held, rows, first)
            first = False
        held, below = (rows, verdict), rows
    if held is not None:
        yield held[1] if first else alone(*held, np.zeros_like(held[0]), first)
