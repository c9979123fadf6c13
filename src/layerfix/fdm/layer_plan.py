"""One layer → its beads.

The nozzle's centre may be where the meso-skeleton is, so the paths come from it, ring by ring from the outline
inwards. `remaining` is the distance from the edge of what has no bead yet. A ring is planned on what remains:

  1. Thin it around its erosion by the largest thickness that two or three beads fill. Two-dimensional parts of the
     result are thick; its one-pixel lines are thin places, of known thickness E.
  2. The half spacing q of the ring's bead: half of the usual one where it is thick; E / 4 where two beads fill a
     thin place, E / 6 where three do. The ring is the level set `remaining` = q: closed loops.
  3. Where E is less than two of the narrowest beads, the line itself is one bead, as wide as the place. It ends where
     the loop's bead begins, so that little is laid twice (`covering`), and what is still open gets a spot of its own.
  4. Twice q is taken off `remaining`.

Thicknesses are "effective": a bead's spacing instead of its width, so that beads tile (see `beads.overlap_mm`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import pack
from layerfix.fdm.balance import CELL_MM, Room, balanced
from layerfix.fdm.beads import BRIDGE, EXTERNAL, GAP_FILL, PERIMETER, SOLID, SPARSE, TOP, Path, overlap_mm
from layerfix.fdm.chains import in_mm, simplified
from layerfix.fdm.covering import lay, lay_the_rest
from layerfix.fdm.distance import edge_distance, share_of_cells
from layerfix.fdm.fields import (
    bits_above,
    field_within,
    pixels_of,
    take_off,
)
from layerfix.fdm.infill import parted, rectilinear
from layerfix.fdm.rings import Beads, plan_ring
from layerfix.fdm.single_beads import spot_beads
from layerfix.fdm.spots import filled_spots
from layerfix.layers.columns import bounding_box
from layerfix.layers.components import components_at
from layerfix.layers.morphology import dilate, opened

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.fdm.bridges import Bridge
    from layerfix.fdm.settings import PathSettings
    from layerfix.stack import Layer

    Field = NDArray[np.float32]
    Floats = NDArray[np.float64]

TOLERANCE_PX = 0.25  # of simplification: 12 µm on the usual raster of an eighth of a nozzle
TURNS = 160  # small loops get a finer tolerance, their length over this: or round pins would shrink by a tenth
BORDER_PX = 0.95  # lines reach so far past the last pixel of their region
WIDTH_SHARE = 0.4  # a width may be off by that much more: 30 µm, in steps of WIDTH_STEP_MM
WIDTH_STEP_MM = 0.02
INFILL_OVERLAP = 0.1  # of a spacing, by which infill reaches into the innermost perimeter
SAME_MM = 1e-9
SPOT_WANTED = 0.96  # of a small part's material
DEPTH = 3  # spacings: how much deeper than the perimeters the distance to the edge is asked for
LEFT = 0.9  # of the narrowest spacing: what is open so wide, and not inside, gets a spot of its own


@dataclass(frozen=True)
class _Sheet:
    """What all paths of a layer share: its bordered box in the frame, and how a bead becomes a path in mm."""

    box: tuple[int, int, int, int]
    beads: Beads
    settings: PathSettings
    pixel_mm: float
    origin_mm: tuple[float, float]
    width_mm: float

    @cached_property
    def corner_px(self) -> Floats:
        """The middle of pixel (0, 0) of the bordered box, from the frame's corner."""
        return np.array([64 * (self.box[2] - 1) + 0.5, self.box[0] - 0.5])

    @cached_property
    def scale(self) -> Floats:
        """Of px in the frame to mm."""
        return np.array([self.pixel_mm, -self.pixel_mm])

    @cached_property
    def origin(self) -> Floats:
        """The frame's corner in mm."""
        return np.array(self.origin_mm)

    @cached_property
    def place(self) -> tuple[float, ...]:
        """As `in_mm` takes it."""
        return (*self.corner_px.tolist(), *self.scale.tolist(), *map(float, self.origin_mm))

    @cached_property
    def steps(self) -> tuple[float, ...]:
        """As `in_mm` takes them."""
        low, high = self.settings.range_mm
        return float(self.width_mm), float(self.beads.overlap), WIDTH_STEP_MM, float(low), float(high)

    def path(self, points: Floats, kind: str) -> list[Path]:
        """(n, 3) x, y in px and spacing in mm, simplified: one path, or none if nothing is left of it."""
        line = np.ascontiguousarray(points)
        kept, spacings = simplified(line, WIDTH_SHARE / self.pixel_mm, TOLERANCE_PX, TURNS)
        if len(kept) < 3 and (kept[0] == kept[-1]).all():
            return []
        points_mm, widths = in_mm(kept, spacings, self.place, self.steps)
        return [Path(points_mm, widths, kind)]


@dataclass(frozen=True)
class Perimeters:
    """What of a layer's beads depends on its pixels alone, and what the rest is planned on.

    paths      perimeters, single beads and gap fill
    body       where infill goes, packed, in the bordered box
    solid      the layer's pixels there
    remaining  mm from the edge of what has no bead yet
    """

    sheet: _Sheet
    paths: tuple[Path, ...]
    body: Rows
    solid: Rows
    remaining: Field

    def are_of(self, layer: Layer, width_mm: float) -> bool:
        """Whether a layer of the same pixels, with beads of this width, has the same."""
        extra = overlap_mm(layer.z_mm[1] - layer.z_mm[0])
        return self.sheet.width_mm == width_mm and abs(self.sheet.beads.overlap - extra) < SAME_MM


def perimeters_of(
    layer: Layer, *, settings: PathSettings, pixel_mm: float, origin_mm: tuple[float, float], width_mm: float
) -> Perimeters | None:
    """The rings of a layer; None if it is empty."""
    box = bounding_box(layer.rows)
    if not box[1]:
        return None
    extra = overlap_mm(layer.z_mm[1] - layer.z_mm[0])
    low, high = settings.range_mm
    beads = Beads(width_mm - extra, low - extra, high - extra, extra)
    sheet = _Sheet(box, beads, settings, pixel_mm, origin_mm, width_mm)
    solid = bordered(layer.rows, box)
    reach_px = math.ceil((settings.perimeters + DEPTH) * beads.usual / pixel_mm)
    remaining: Field = edge_distance(solid, np.float32(reach_px), np.float32(pixel_mm), np.float32(extra / 2))
    paths, body = _rings(sheet, remaining)
    return Perimeters(sheet, tuple(paths), body, solid, remaining)


def plan_layer(
    perimeters: Perimeters,
    below: Sequence[Layer],
    layer: Layer,
    above: Sequence[Layer],
    *,
    index: int,
    bridges: Sequence[Bridge] = (),
) -> list[Path]:
    """The paths of a layer, in no order; `below` and `above` are its nearest neighbours (`each_with_neighbours`)."""
    sheet, solid, remaining = perimeters.sheet, perimeters.solid, perimeters.remaining
    settings, pixel_mm, extra = sheet.settings, sheet.pixel_mm, sheet.beads.overlap
    paths, body = [*perimeters.paths], perimeters.body.copy()
    sparse, bridged = np.zeros_like(body), np.zeros_like(body)
    crossed: list[Path] = []
    if body.any():
        open_parts = _open_parts(below, layer, above, settings, sheet.beads.usual / pixel_mm)
        crossed, bridged = _bridges(sheet, remaining, body, bridges)
        infill, sparse = _infill(sheet, remaining, body, open_parts, index)
        paths += infill
    size = max(round(CELL_MM / pixel_mm), 1)
    corner_mm = (sheet.corner_px - 0.5) * sheet.scale + sheet.origin
    room = Room(share_of_cells(solid & ~sparse & ~bridged, size), corner_mm, size * pixel_mm)
    full = [path for path in paths if path.kind != SPARSE]
    full = balanced(full, room, overlap_mm=extra, range_mm=settings.range_mm, step_mm=WIDTH_STEP_MM)
    full = filled_spots(
        full, solid & ~bridged, corner_mm, pixel_mm, overlap_mm=extra, range_mm=settings.range_mm, wanted=SPOT_WANTED
    )
    return full + crossed + [path for path in paths if path.kind == SPARSE]


def _rings(sheet: _Sheet, remaining: Field) -> tuple[list[Path], Rows]:
    """(perimeters, single beads and gap fill; where infill goes, packed). `remaining` is written."""
    paths: list[Path] = []
    half = np.empty_like(remaining)
    body = np.zeros((remaining.shape[0], remaining.shape[1] // 64), np.uint64)
    laid = np.zeros(remaining.shape, np.uint8)
    solid = bits_above(remaining, np.float32(0))
    for level in range(sheet.settings.perimeters):
        ring = plan_ring(remaining, half, sheet.beads, sheet.pixel_mm, loops=True, feature=level == 0)
        for line in ring.loops:
            paths += sheet.path(line, EXTERNAL if level == 0 else PERIMETER)
            lay(laid, line, sheet.pixel_mm)
        for line in lay_the_rest(laid, ring.chains, sheet.pixel_mm, sheet.beads.narrowest):
            paths += sheet.path(line, EXTERNAL if level == 0 else GAP_FILL)
        take_off(remaining, half, body)
    for _ in range(2):  # three beads in a thin place are two rounds
        ring = plan_ring(remaining, half, sheet.beads, sheet.pixel_mm, loops=False, feature=False)
        for line in ring.loops:
            paths += sheet.path(line, GAP_FILL)
            lay(laid, line, sheet.pixel_mm)
        for line in lay_the_rest(laid, ring.chains, sheet.pixel_mm, sheet.beads.narrowest):
            paths += sheet.path(line, GAP_FILL)
        body |= ring.thick
        if not ring.loops:
            break
        take_off(remaining, half, body)
    open_rows = solid & ~pack(laid.view(np.bool_)) & ~body
    for line in _what_is_left(open_rows, sheet.beads, remaining.shape[1], sheet.pixel_mm):
        paths += sheet.path(line, GAP_FILL)
    return paths, body


def _bridges(sheet: _Sheet, remaining: Field, body: Rows, bridges: Sequence[Bridge]) -> tuple[list[Path], Rows]:
    """(lines over air, each region in its own direction; where they are, packed, which is taken off `body`)."""
    usual = sheet.beads.usual
    paths: list[Path] = []
    bridged = np.zeros_like(body)
    inset_px = usual / 2 / sheet.pixel_mm + BORDER_PX
    for bridge in bridges:
        where = bordered(bridge.rows, sheet.box) & body
        if not (bordered(bridge.over_air, sheet.box) & body).any():  # perimeters fill it
            continue
        body &= ~where
        bridged |= where
        if body.any():
            where = where & ~dilate(body, remaining.shape[1], (inset_px, inset_px))
        field = field_within(remaining, where, np.float32((0.5 - INFILL_OVERLAP) * usual))
        for points in _lines(sheet, field, bridge.angle, usual / sheet.pixel_mm):
            paths += sheet.path(_wide(points, usual), BRIDGE)
    return paths, bridged


def _what_is_left(open_rows: Rows, beads: Beads, width: int, pixel_mm: float) -> list[Floats]:
    """A stroke or a dot in each place (packed) that is still open and takes half of the narrowest bead: lobes beyond
    necks, the middle of stars."""
    reach = LEFT * beads.narrowest / 2 / pixel_mm
    places = opened(open_rows, width, (reach, reach))
    if not places.any():
        return []
    import cv2

    rows, columns = pixels_of(places)
    component, _ = components_at(places, columns, rows)
    lines = []
    for number in np.unique(component).tolist():
        ys, xs = rows[component == number], columns[component == number]
        x, y = int(xs.min()), int(ys.min())
        part = np.zeros((int(ys.max()) - y + 5, int(xs.max()) - x + 5), np.uint8)
        part[ys - y + 2, xs - x + 2] = 1
        depth = cv2.distanceTransform(part, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * np.float32(pixel_mm)
        row, column = np.unravel_index(int(depth.argmax()), depth.shape)
        spot = np.array([column, row], np.float64), 2 * float(depth[row, column])
        found = spot_beads([spot], np.asarray(depth, np.float32), pixel_mm, beads.range)
        lines += [line + np.array([x - 2, y - 2, 0]) for line in found]
    return lines


def _infill(
    sheet: _Sheet, remaining: Field, body: Rows, open_parts: tuple[Rows, Rows], index: int
) -> tuple[list[Path], Rows]:
    """(lines where `body` (packed) is: solid in the open parts, sparse elsewhere; turned from layer to layer; where
    they are sparse, packed)."""
    density, usual = sheet.settings.density, sheet.beads.usual
    solid, bare = (bordered(rows, sheet.box) for rows in open_parts)
    if density > 1 - 1e-9:
        solid = body
    solid &= body
    width, half_px = remaining.shape[1], usual / 2 / sheet.pixel_mm
    turn = math.pi / 4 if index % 2 else -math.pi / 4
    paths: list[Path] = []
    # Solid lines turn half a bead inside their border, so that each has its own room; sparse ones hold on to it.
    for where, share, inset_px in ((solid, 1.0, half_px + BORDER_PX), (body & ~solid, density, 1.0)):
        if share == 0 or not where.any():
            continue
        rest = body & ~where
        if rest.any():
            where = where & ~dilate(rest, width, (inset_px, inset_px))
        field = field_within(remaining, where, np.float32((0.5 - INFILL_OVERLAP) * usual))
        spacing_px = usual / share / sheet.pixel_mm
        for points in _lines(sheet, field, turn, spacing_px):
            for part, on_top in _parted(points, bare) if share == 1.0 else [(points, False)]:
                kind = SPARSE if share < 1.0 else TOP if on_top else SOLID
                paths += sheet.path(_wide(part, usual), kind)
    return paths, body & ~solid


def _lines(sheet: _Sheet, field: Field, angle: float, spacing_px: float) -> list[Floats]:
    """`rectilinear` where the field is above 0, without what is shorter than half a bead is wide."""
    least, shortest_px = -0.3 * sheet.beads.usual, sheet.width_mm / 2 / sheet.pixel_mm
    return rectilinear(field, angle, spacing_px, least, sheet.corner_px, shortest_px)


def _wide(points: Floats, spacing_mm: float) -> Floats:
    """(n, 2) x, y → (n, 3) with the spacing."""
    out = np.empty((len(points), 3))
    out[:, :2], out[:, 2] = points, spacing_mm
    return out


def _parted(points: Floats, mask: Rows) -> list[tuple[Floats, bool]]:
    """A polyline (n, 2) cut where it enters or leaves a mask (packed), and whether each part lies in it."""
    cut, starts, inside = parted(np.ascontiguousarray(points), mask)
    return [(cut[a:b], within) for (a, b), within in zip(pairwise(starts.tolist()), inside.tolist(), strict=True)]


def bordered(rows: Rows, box: tuple[int, int, int, int]) -> Rows:
    """What of packed rows lies in a box of rows and words, with an empty row and word on each side."""
    y0, y1, w0, w1 = box
    out = np.zeros((y1 - y0 + 2, w1 - w0 + 2), np.uint64)
    out[1:-1, 1:-1] = rows[y0:y1, w0:w1]
    return out


def _open_parts(
    below: Sequence[Layer], layer: Layer, above: Sequence[Layer], settings: PathSettings, bead_px: float
) -> tuple[Rows, Rows]:
    """(where the infill is solid, where it is seen from above), packed.

    Solid is what is not solid in all of the next top_layers above or bottom_layers below. Slivers narrower than a
    bead are left out, and what is left reaches a bead further, to hold on to something.
    """

    def uncovered(neighbours: Sequence[Layer], wanted: int) -> Rows:
        if len(neighbours) < wanted:
            return layer.rows
        covered = layer.rows
        for other in neighbours:
            covered = covered & other.rows
        return layer.rows & ~covered

    lower = below[len(below) - settings.bottom_layers :] if settings.bottom_layers else ()
    roof = uncovered(above[:1], 1) if settings.top_layers else np.zeros_like(layer.rows)
    open_rows = uncovered(above[: settings.top_layers], settings.top_layers) | uncovered(
        lower, settings.bottom_layers
    )
    sliver, reach = (bead_px / 2, bead_px / 2), (bead_px, bead_px)
    if np.array_equal(open_rows, layer.rows):
        return open_rows, opened(roof, layer.width, reach)
    return (
        dilate(opened(open_rows, layer.width, sliver), layer.width, reach),
        opened(roof, layer.width, reach),
    )
