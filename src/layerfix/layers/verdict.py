"""What a printer would make of layers as they are: what is lost, what is thinnest, what begins on nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ALL, ROWS, U0, WORK, popcount
from layerfix.kernels import njit
from layerfix.layers.columns import Room, bounding_box, fill_columns, to_columns, with_border
from layerfix.layers.components import has_bit, label_runs, root_of
from layerfix.layers.drawing import anchor_columns, box_with_reach, draw_paths, find_paths, open_columns
from layerfix.layers.feature import Feature, feature_of_mm
from layerfix.layers.skeleton import Spurs, check_spurs, scratch_images, skeleton_columns
from layerfix.layers.thickness import narrowest
from layerfix.layers.topology import AREA, BECOMES, BOTTOM, LEFT, PARTS, RIGHT, TOP, TopologyChange, changes_of, told

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Layer, LayerStack


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
    features_lost   connected stretches of what is narrower than F: fins, pins, necks, thin walls
    lost            parts of which nothing would be printed
    lost_mm2        area of S that S ∘ F misses where something is too thin (not at corners, which the tool rounds)
    thinnest_mm     width at the narrowest of them, None if there is none
    topology        what would merge and close if it were corrected
    islands         parts with nothing below, not even beside a pixel; none in the first layer
    alone           those with nothing above either: specks
    hairline_px     pixels that stand for what is thinner than one
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


@njit(types.Tuple((PARTS, types.int64, types.int64))(WORK, WORK, WORK, WORK), cache=True, nogil=True)
def _lost(solid, opened, paths, drawn):  # type: ignore[no-untyped-def]
    """(parts of S: area, box, whether S ∘ F has a pixel of them; stretches of the paths; pixels of S that S ∘ F
    misses and what is drawn holds)."""
    runs, parent, count = label_runs(solid, False)
    number = np.zeros(parent.shape[0], np.int64)
    out = np.zeros((count, 6), np.int64)
    n = 0
    for k in range(parent.shape[0]):
        if parent[k] == k:
            number[k] = n
            n += 1
        i = number[root_of(parent, k)]
        y, first, stop = runs[k]
        fresh = out[i, AREA] == 0
        out[i, LEFT] = first if fresh else min(out[i, LEFT], first)
        out[i, TOP] = y if fresh else min(out[i, TOP], y)
        out[i, RIGHT] = stop if fresh else max(out[i, RIGHT], stop)
        out[i, BOTTOM] = y + 1
        out[i, AREA] += stop - first
        if not out[i, BECOMES]:
            out[i, BECOMES] = np.int64(has_bit(opened, False, y, first, stop))
    lost_px = 0
    for w in range(solid.shape[0]):
        for y in range(solid.shape[1]):
            lost_px += popcount(solid[w, y] & ~opened[w, y] & drawn[w, y])
    return out, label_runs(paths, False)[2], lost_px


@njit
def _touches(rows, y, first, stop):  # type: ignore[no-untyped-def]
    """Whether packed rows have a bit in columns first - 1 … stop of rows y - 1 … y + 1."""
    width = 64 * rows.shape[1]
    a, b = max(first - 1, 0), min(stop, width - 1)
    for v in range(max(y - 1, 0), min(y + 2, rows.shape[0])):
        for w in range(a >> 6, (b >> 6) + 1):
            word = rows[v, w]
            if w == a >> 6:
                word &= ALL << np.uint64(a & 63)
            if w == b >> 6:
                word &= ALL >> np.uint64(63 - (b & 63))
            if word != U0:
                return True
    return False


@njit(PARTS(ROWS, ROWS), cache=True, nogil=True)
def _without_contact(rows, other):  # type: ignore[no-untyped-def]
    """Parts of a layer that touch nothing of another: area and box, in the frame's pixels."""
    outer = with_border(bounding_box(rows), 0, 0)
    runs, parent, count = label_runs(to_columns(rows, outer), False)
    number = np.zeros(parent.shape[0], np.int64)
    out = np.zeros((count, 6), np.int64)
    n = 0
    for k in range(parent.shape[0]):
        if parent[k] == k:
            number[k] = n
            n += 1
        i = number[root_of(parent, k)]
        y, first, stop = runs[k, 0] + outer[0], runs[k, 1] + 64 * outer[2], runs[k, 2] + 64 * outer[2]
        fresh = out[i, AREA] == 0
        out[i, LEFT] = first if fresh else min(out[i, LEFT], first)
        out[i, TOP] = y if fresh else min(out[i, TOP], y)
        out[i, RIGHT] = stop if fresh else max(out[i, RIGHT], stop)
        out[i, BOTTOM] = y + 1
        out[i, AREA] += stop - first
        if not out[i, BECOMES]:
            out[i, BECOMES] = np.int64(_touches(other, y, first, stop))
    kept = 0
    for i in range(count):
        if not out[i, BECOMES]:
            for c in range(6):
                out[kept, c] = out[i, c]
            kept += 1
    return out[:kept].copy()


@dataclass(frozen=True, eq=False)
class _Judge:
    """The verdict on one layer alone."""

    feature: Feature
    spurs: Spurs
    add_only: bool
    pixel_mm: tuple[float, float]
    origin_mm: tuple[float, float]
    room: Room = field(default_factory=Room)

    def __call__(self, layer: Layer) -> tuple[Rows, LayerVerdict]:
        feature, pixel_mm = self.feature, self.pixel_mm
        half_widths, block = feature.half_widths, feature.block
        outer = box_with_reach(layer.rows, *feature.reach_px)
        if outer[1] == 0:
            return layer.rows, LayerVerdict(layer.z_mm, 0)
        solid, anchor, skeleton, opened, drawn, paths, *scratch = self.room.columns(
            outer, 6 + scratch_images(self.spurs)
        )
        fill_columns(layer.rows, outer, solid)
        anchor_columns(solid, half_widths, *block, anchor, scratch[0])
        open_columns(anchor, half_widths, opened, scratch[0])
        skeleton_columns(solid, anchor, feature, self.spurs, skeleton, scratch, self.room)
        any_path = find_paths(solid, skeleton, anchor, opened, half_widths, *block, feature.by_size, paths)
        drawn[:] = 0
        if any_path:
            draw_paths(paths, drawn, half_widths, *block, scratch[0])
        parts, features, lost_px = _lost(solid, opened, paths, drawn)
        corner_px, area_mm2 = (64 * outer[2], outer[0]), pixel_mm[0] * pixel_mm[1]
        verdict = LayerVerdict(
            layer.z_mm,
            len(parts),
            features,
            self.places(parts[parts[:, BECOMES] == 0], layer.z_mm, corner_px),
            lost_px * area_mm2,
            hairline_px=layer.hairline_px,
        )
        if not any_path:
            return layer.rows, verdict
        feature_mm = max(2 * r * p for r, p in zip(feature.radius_px, pixel_mm, strict=True))
        thinnest_mm = float(narrowest(solid, paths, feature_mm, *pixel_mm))
        np.bitwise_or(drawn, solid if self.add_only else opened, out=drawn)
        found = told(*changes_of(solid, drawn), corner_px, pixel_mm, self.origin_mm)
        topology = tuple(replace(one, z_mm=layer.z_mm) for one in found)
        return layer.rows, replace(verdict, thinnest_mm=thinnest_mm, topology=topology)

    def places(
        self, table: NDArray[np.int64], z_mm: tuple[float, float], corner_px: tuple[int, int] = (0, 0)
    ) -> tuple[Place, ...]:
        """Rows of a kernel's table as places on the frame."""
        (px, py), (x, y) = self.pixel_mm, self.origin_mm
        return tuple(
            Place(
                z_mm,
                (
                    float(x + (row[LEFT] + corner_px[0]) * px),
                    float(y - (row[BOTTOM] + corner_px[1]) * py),
                    float(x + (row[RIGHT] + corner_px[0]) * px),
                    float(y - (row[TOP] + corner_px[1]) * py),
                ),
                float(row[AREA] * px * py),
            )
            for row in table
        )


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

    def alone(rows: Rows, verdict: LayerVerdict, above: Rows) -> LayerVerdict:
        if not verdict.islands:
            return verdict
        free = {place.box_mm: place for place in one.places(_without_contact(rows, above), verdict.z_mm)}
        return replace(verdict, alone=tuple(place for place in verdict.islands if free.get(place.box_mm) == place))

    for rows, verdict in stack.each(one):
        if below is not None and verdict.parts:
            verdict = replace(verdict, islands=one.places(_without_contact(rows, below), verdict.z_mm))
        if held is not None:
            yield alone(*held, rows)
        held, below = (rows, verdict), rows
    if held is not None:
        yield alone(*held, np.zeros_like(held[0]))
