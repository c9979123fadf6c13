"""What one bead is: a strip with half-round sides, and the path that lays it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# What a path is, in the words of PrusaSlicer's `;TYPE:` comments, which the viewers know.
EXTERNAL, PERIMETER, GAP_FILL = "External perimeter", "Perimeter", "Gap fill"
SOLID, TOP, SPARSE, SKIRT = "Solid infill", "Top solid infill", "Internal infill", "Skirt/Brim"
BRIDGE = "Bridge infill"
KINDS = (EXTERNAL, PERIMETER, GAP_FILL, SOLID, TOP, SPARSE, SKIRT, BRIDGE)


def overlap_mm(layer_mm: float) -> float:
    """How far two beads side by side reach into each other, h (1 − π/4), so that round sides leave no gap."""
    return layer_mm * (1 - math.pi / 4)


def spacing_mm(width_mm: float, layer_mm: float) -> float:
    """From the middle of a bead to that of the next one beside it."""
    return width_mm - overlap_mm(layer_mm)


def section_mm2(width_mm: Floats | float, layer_mm: float) -> Floats | float:
    """Cross-section of a bead: (w − h)·h + π (h / 2)², which is its spacing times its height."""
    return (width_mm - layer_mm) * layer_mm + math.pi * layer_mm**2 / 4


@dataclass(frozen=True, eq=False)
class Path:
    """One bead laid without a stop.

    points_mm  (n, 2) x, y of the nozzle; a closed path ends where it begins
    width_mm   (n − 1,) of each piece
    kind       one of KINDS
    """

    points_mm: Floats
    width_mm: Floats
    kind: str

    @property
    def closed(self) -> bool:
        return bool((self.points_mm[0] == self.points_mm[-1]).all())

    @cached_property
    def lengths_mm(self) -> Floats:
        """(n − 1,) of each piece."""
        along = np.diff(self.points_mm, axis=0)
        return np.hypot(along[:, 0], along[:, 1])

    def stretches(self) -> list[tuple[int, int]]:
        """(first, past the last) piece of each stretch of one width."""
        changes = self.width_mm[1:] != self.width_mm[:-1]
        starts = [0, *(np.flatnonzero(changes) + 1).tolist()] if changes.any() else [0]
        return list(zip(starts, [*starts[1:], len(self.width_mm)], strict=True))

    def reversed(self) -> Path:
        """The same bead laid from its end."""
        return Path(self.points_mm[::-1], self.width_mm[::-1], self.kind)

    def starting_at(self, k: int) -> Path:
        """A closed path begun at its point k."""
        points = np.concatenate([self.points_mm[k:-1], self.points_mm[: k + 1]])
        return Path(points, np.concatenate([self.width_mm[k:], self.width_mm[:k]]), self.kind)


@dataclass(frozen=True)
class Hanging:
    """A place where a layer lies over air: an "island" that nothing carries, a "bridge" held at both ends, or a
    "ledge" held at one.

    x_mm, y_mm  its middle, in the stack's own mm
    length_mm   the island's longer side, the bridge's span, or how far the ledge reaches out
    """

    kind: str
    x_mm: float
    y_mm: float
    length_mm: float


@dataclass(frozen=True, eq=False)
class LayerPaths:
    """The beads of one layer in the order they are laid; z_mm is (bottom, top).

    small_parts  how many separate parts of the layer are smaller than a bead, so that they come out larger
    ways         for each path after the first: (m, 2) points on the way to its start that stays inside the solid, or
                 None if it has to leave it (see `travel`); empty where that is not known
    hanging      what lies over air (see `bridges`)
    """

    z_mm: tuple[float, float]
    paths: tuple[Path, ...]
    small_parts: int = 0
    ways: tuple[Floats | None, ...] = ()
    hanging: tuple[Hanging, ...] = ()

    @property
    def layer_mm(self) -> float:
        return self.z_mm[1] - self.z_mm[0]

    def volume_mm3(self) -> float:
        """Of all beads."""
        return float(sum((p.lengths_mm * section_mm2(p.width_mm, self.layer_mm)).sum() for p in self.paths))

    def travels_mm(self) -> list[float]:
        """From the end of each path to the start of the next."""
        ends = [(a.points_mm[-1], b.points_mm[0]) for a, b in zip(self.paths[:-1], self.paths[1:], strict=True)]
        return [float(np.hypot(*(b - a))) for a, b in ends]
