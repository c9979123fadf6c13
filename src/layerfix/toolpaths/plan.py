"""One layer → its beads.

The nozzle's centre may be where the meso-skeleton is, so the paths come from it, ring by ring from the outline
inwards. `remaining` is the distance from the edge of what has no bead yet. A ring is planned on what remains:

  1. Thin it around its erosion by the largest thickness that two or three beads fill. Two-dimensional parts of the
     result are thick; its one-pixel lines are thin places, of known thickness E.
  2. The half spacing q of the ring's bead: half of the usual one where it is thick; E / 4 where two beads fill a
     thin place, E / 6 where three do. The ring is the level set `remaining` = q: closed loops.
  3. Where E is less than two of the narrowest beads, the line itself is one bead, as wide as the place. It ends where
     the loop's bead begins, so nothing is laid twice and no gap is left.
  4. Twice q is taken off `remaining`.

Thicknesses are "effective": a bead's spacing instead of its width, so that beads tile (see `beads.overlap_mm`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import pack, unpack
from layerfix.contours import solid_part
from layerfix.morphology import dilate, opened
from layerfix.skeleton import thinned_rows
from layerfix.toolpaths.beads import EXTERNAL, GAP_FILL, PERIMETER, SOLID, SPARSE, TOP, Path, overlap_mm
from layerfix.toolpaths.fields import level_loops, needed_points, paint_balls, trace_lines
from layerfix.toolpaths.infill import rectilinear
from layerfix.toolpaths.lines import bead_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from layerfix.stack import Layer
    from layerfix.toolpaths.settings import PathSettings

    Field = NDArray[np.float32]
    Mask = NDArray[np.bool_]
    Floats = NDArray[np.float64]

TOLERANCE_PX = 0.25  # of simplification, in place and in width: 12 µm on the usual raster of an eighth of a nozzle
INFILL_OVERLAP = 0.1  # of a spacing, by which infill reaches into the innermost perimeter
LEAST_GAP = 0.7  # of the narrowest spacing: what is thinner is left open
THICK = np.float32(1e9)


@dataclass(frozen=True)
class Beads:
    """The spacings of a layer in mm: usual, narrowest, widest, and what is added to a spacing for a width."""

    usual: float
    narrowest: float
    widest: float
    overlap: float

    @property
    def one(self) -> float:
        """Thinner places get one bead."""
        return min(2 * self.narrowest, self.widest)

    @property
    def thick(self) -> float:
        """From this thickness on, two usual beads leave room for another."""
        return 2 * self.usual + self.narrowest


@dataclass(frozen=True)
class Ring:
    """What one round of planning found: loops (n, 3) and chains (n, 3) of x, y, spacing in px and mm, where beads of
    the usual width go on, and the half spacings to take off."""

    loops: list[Floats]
    chains: list[Floats]
    thick: Mask
    half: Field


def plan_layer(
    below: Sequence[Layer],
    layer: Layer,
    above: Sequence[Layer],
    *,
    settings: PathSettings,
    pixel_mm: float,
    origin_mm: tuple[float, float],
    width_mm: float,
    index: int,
) -> list[Path]:
    """The paths of a layer, in no order; `below` and `above` are its nearest neighbours (`each_with_neighbours`)."""
    import cv2

    image, left, top = solid_part(layer)
    if not image.size:
        return []
    image = np.pad(image, 1)
    layer_mm = layer.z_mm[1] - layer.z_mm[0]
    extra = overlap_mm(layer_mm)
    low, high = settings.range_mm
    beads = Beads(width_mm - extra, low - extra, high - extra, extra)
    distance = cv2.distanceTransform(image, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    remaining = (distance - np.float32(0.5)) * np.float32(pixel_mm) - np.float32(extra / 2)

    def in_mm(points: Floats) -> Floats:
        corner = np.array([left - 0.5, top - 0.5])  # the padding moves pixel (0, 0) to (1, 1)
        scaled: Floats = (points + corner) * np.array([pixel_mm, -pixel_mm]) + np.array(origin_mm)
        return scaled

    paths: list[Path] = []

    def add(points: Floats, kind: str) -> None:
        """A polyline of x, y in px and spacing in mm, simplified."""
        flat = points * np.array([1, 1, 1 / pixel_mm])
        kept = points[needed_points(np.ascontiguousarray(flat), TOLERANCE_PX)]
        widths = np.round((kept[1:, 2] + kept[:-1, 2]) / 2 + extra, 2)
        paths.append(Path(in_mm(kept[:, :2]), np.clip(widths, low, high), kind))

    for level in range(settings.perimeters):
        ring = plan_ring(remaining, beads, pixel_mm, loops=True, feature=level == 0)
        for loop in ring.loops:
            add(loop, EXTERNAL if level == 0 else PERIMETER)
        for chain in ring.chains:
            add(chain, EXTERNAL if level == 0 else GAP_FILL)
        remaining = remaining - 2 * ring.half
    body = np.zeros(remaining.shape, np.bool_)
    for _ in range(2):  # three beads in a thin place are two rounds
        ring = plan_ring(remaining, beads, pixel_mm, loops=False, feature=False)
        for line in ring.loops + ring.chains:
            add(line, GAP_FILL)
        body |= ring.thick
        if not ring.loops:
            break
        remaining = np.where(ring.thick, remaining, remaining - 2 * ring.half)
    if not body.any():
        return paths
    solid, bare = _open_parts(below, layer, above, settings, beads.usual / pixel_mm, (left, top), image.shape)
    field = np.where(body, remaining - np.float32((0.5 - INFILL_OVERLAP) * beads.usual), np.float32(-1))
    if settings.density > 1 - 1e-9:
        solid = np.ones_like(solid)
    turn = math.pi / 4 if index % 2 else -math.pi / 4
    regions = [(solid & ~bare, SOLID, 1.0), (solid & bare, TOP, 1.0), (~solid, SPARSE, settings.density)]
    for where, kind, density in regions:
        if density > 0 and (where & body).any():
            chosen = np.where(where, field, np.float32(-1))
            least = -0.3 * beads.usual
            for points in rectilinear(chosen, turn, beads.usual / density / pixel_mm, least):
                spaced = np.column_stack([points, np.full(len(points), beads.usual)])
                if np.hypot(*np.diff(points, axis=0).T).sum() * pixel_mm > width_mm / 2:
                    add(spaced, kind)
    return paths


def plan_ring(remaining: Field, beads: Beads, pixel_mm: float, *, loops: bool, feature: bool) -> Ring:
    """One round (see the module). loops: False leaves thick parts to infill; feature: nothing is too thin to lay."""
    shape = remaining.shape
    half = np.full(shape, np.float32(beads.usual / 2 if loops else THICK), np.float32)
    region = remaining > 0
    if not region.any():
        return Ring([], [], np.zeros(shape, np.bool_), half)
    width, limit = shape[1], beads.thick
    anchor = pack(remaining >= limit / 2)
    skeleton = thinned_rows(pack(region), anchor, width, limit / 2 / pixel_mm)
    lines = unpack(skeleton & ~anchor, width)
    radius_px = limit / 2 / pixel_mm
    thick = unpack(dilate(anchor, width, (radius_px, radius_px)), width) & region
    chains: list[Floats] = []
    rows, columns = np.nonzero(lines)
    if len(rows):
        thickness = _thickness(remaining, unpack(skeleton, width), rows, columns, pixel_mm)
        local = np.zeros(shape, np.float32)
        paint_balls(local, rows, columns, thickness / 2 / np.float32(pixel_mm), thickness)
        thin = (local > 0) & ~thick
        several = np.where(local[thin] <= 2 * beads.widest, local[thin] / 4, local[thin] / 6)
        half[thin] = np.where(local[thin] < beads.one, THICK, several)
        single = np.zeros(shape, np.float32)
        chosen = thickness < beads.one
        if not feature:
            chosen &= thickness >= LEAST_GAP * beads.narrowest
        single[rows[chosen], columns[chosen]] = thickness[chosen]
        inside = remaining > half
        reach = beads.usual / 2 / pixel_mm
        covered = unpack(dilate(pack(inside), width, (reach, reach)), width) if inside.any() else inside
        single[covered] = 0
        if single.any():
            points, starts = trace_lines((single > 0).astype(np.uint8))
            chains = bead_lines(points, starts, single, remaining, pixel_mm)
    points, starts = level_loops(remaining - half, np.minimum(2 * half, np.float32(4 * beads.widest)))
    found = [
        np.concatenate([points[a:b], points[a : a + 1]])
        for a, b in pairwise(starts)
        if _length(points[a:b]) * pixel_mm > 0.6 * beads.narrowest
    ]
    return Ring(found, chains, thick, half)


def _length(points: Floats) -> float:
    return float(np.hypot(*np.diff(points[:, :2], axis=0).T).sum())


def _thickness(
    remaining: Field, skeleton: Mask, rows: NDArray[np.int64], columns: NDArray[np.int64], pixel_mm: float
) -> Field:
    """(n,) thickness in mm at pixels of the skeleton.

    Twice the distance to the edge, but where the middle lies between two pixels: then the two distances and the step
    between them. Only neighbours off the skeleton can be across, those on it are along.
    """
    here = remaining[rows, columns]
    best = 2 * here
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            beside = np.where(skeleton[rows + dy, columns + dx], np.float32(-1), remaining[rows + dy, columns + dx])
            np.maximum(best, here + beside + np.float32(math.hypot(dx, dy) * pixel_mm), out=best, where=beside > 0)
    return best


def _open_parts(
    below: Sequence[Layer],
    layer: Layer,
    above: Sequence[Layer],
    settings: PathSettings,
    bead_px: float,
    corner: tuple[int, int],
    shape: tuple[int, ...],
) -> tuple[Mask, Mask]:
    """(where the infill is solid, where it is seen from above) on the padded crop of the layer.

    Solid is what is not solid in all of the next top_layers above or bottom_layers below. Slivers narrower than a
    bead are left out, and what is left reaches a bead further, to hold on to something.
    """

    def uncovered(neighbours: Sequence[Layer], wanted: int) -> NDArray[np.uint64]:
        if len(neighbours) < wanted:
            return layer.rows
        covered = layer.rows
        for other in neighbours:
            covered = covered & other.rows
        return layer.rows & ~covered

    def crop(rows: NDArray[np.uint64]) -> Mask:
        left, top = corner
        whole = unpack(rows, layer.width)
        part = whole[top : top + shape[0] - 2, left : left + shape[1] - 2]
        return np.pad(part, 1)

    roof = uncovered(above[:1], 1) if settings.top_layers else np.zeros_like(layer.rows)
    rows = uncovered(above[: settings.top_layers], settings.top_layers) | uncovered(
        below[len(below) - settings.bottom_layers :] if settings.bottom_layers else (), settings.bottom_layers
    )
    if not np.array_equal(rows, layer.rows):
        rows = dilate(opened(rows, layer.width, (bead_px / 2, bead_px / 2)), layer.width, (bead_px, bead_px))
        roof = opened(roof, layer.width, (bead_px, bead_px))
    return crop(rows), crop(roof)
