"""How much of a part's layers a print job's beads cover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray

from tests.slicers.gcode import Bead

DROPPED = 0.05  # a component with less than this share of its area under beads is not there
NARROW = 0.6  # of the nozzle: a bead that no nozzle lays
COVERED_LAYERS = 40  # so many layers, evenly spread, are measured for coverage
FIRST_LOOK = 4  # beads that are tried first to show that a component is there


@dataclass(frozen=True)
class Place:
    """Where a component lies in the part, and how large it is."""

    layer: int
    x_mm: float
    y_mm: float
    area_mm2: float


@dataclass(frozen=True)
class Measures:
    """What a print job makes of a part."""

    components: int  # of the part's sections, over all layers
    dropped: int
    layers: int  # in which the part has a section
    missing: int
    coverage_percent: float
    narrow_percent: float  # of the pushed out volume
    dropped_at: tuple[Place, ...] = field(default=(), repr=False)

    @property
    def complete(self) -> bool:
        """Whether nothing of the part is gone."""
        return not self.dropped and not self.missing


def measure(
    beads: Sequence[Bead],
    sections: Sequence[NDArray[np.object_]],
    *,
    layer_mm: float,
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    nozzle_mm: float = 0.4,
) -> Measures:
    """Compare beads with a part's sections, of all layers from z = 0.

    sections   for each layer the polygons of the part
    offset_mm  the G-code's coordinates less the part's
    """
    by_layer: list[list[Bead]] = [[] for _ in sections]
    for bead in beads:
        # The nozzle is at the top of the layer that it lays.
        layer = round((bead.z_mm - offset_mm[2]) / layer_mm) - 1
        if 0 <= layer < len(by_layer):
            by_layer[layer].append(bead)
    step = max(1, round(len(sections) / COVERED_LAYERS))
    dropped: list[Place] = []
    missing = 0
    covered = solid = 0.0
    for k, (parts, laid) in enumerate(zip(sections, by_layer, strict=True)):
        if not len(parts):
            continue
        missing += not laid
        shapes = outlines(laid, offset_mm[:2])
        dropped += [
            Place(k, part.centroid.x, part.centroid.y, part.area)
            for part, near in zip(parts, _near(parts, shapes), strict=True)
            if _is_dropped(part, near)
        ]
        if k % step == step // 2:
            solid += float(shapely.area(parts).sum())
            covered += float(shapely.area(shapely.intersection(shapely.union_all(shapes), parts)).sum())
    volumes, widths = (np.array([getattr(b, name) for b in beads]) for name in ("volume_mm3", "width_mm"))
    narrow = volumes[widths < NARROW * nozzle_mm].sum() / volumes.sum() if len(beads) else 0.0
    return Measures(
        components=sum(map(len, sections)),
        dropped=len(dropped),
        layers=sum(len(parts) > 0 for parts in sections),
        missing=missing,
        coverage_percent=100 * covered / solid if solid else 0.0,
        narrow_percent=100 * float(narrow),
        dropped_at=tuple(dropped),
    )


def outlines(beads: Sequence[Bead], offset_mm: tuple[float, ...] = (0.0, 0.0)) -> NDArray[np.object_]:
    """One polygon for each bead in the part's coordinates, as wide as the bead and with flat ends."""
    if not beads:
        return np.empty(0, np.object_)
    counts = [len(bead.points) for bead in beads]
    points = np.concatenate([bead.points for bead in beads]) - np.array(offset_mm)
    lines = shapely.linestrings(points, indices=np.repeat(np.arange(len(beads)), counts))
    radii = np.array([bead.width_mm for bead in beads]) / 2
    shapes: NDArray[np.object_] = shapely.buffer(lines, radii, quad_segs=4, cap_style="flat")
    return shapes


def _near(parts: NDArray[np.object_], shapes: NDArray[np.object_]) -> list[NDArray[np.object_]]:
    """For each part the shapes that meet it."""
    which, hits = shapely.STRtree(shapes).query(parts, "intersects")
    return [shapes[hits[which == k]] for k in range(len(parts))]


def _is_dropped(part: shapely.Polygon, shapes: NDArray[np.object_]) -> bool:
    """Whether the shapes cover almost nothing of the part; looks at more of them until it is sure."""
    shapes = shapes[np.argsort(-shapely.area(shapes), kind="stable")]
    look = FIRST_LOOK
    while True:
        covered = shapely.area(shapely.intersection(shapely.union_all(shapes[:look]), part))
        if covered >= DROPPED * part.area:
            return False
        if look >= len(shapes):
            return True
        look *= 4
