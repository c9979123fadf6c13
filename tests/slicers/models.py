"""The parts that are sliced: each has features narrower than a 0.4 mm nozzle lays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from layerfix.mesh.load import load_mesh
from layerfix.mesh.triangles import Mesh
from layerfix.samples import shapes
from tests.making import SHARED

WIDTHS_MM = (0.10, 0.15, 0.20, 0.25, 0.30, 0.35, 0.40, 0.45, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00)
# Fins grow to 0.8 mm, so 2.6 mm between them stay well apart.
GAP_MM, FIN_MM, PLATE_MM = 2.6, 10.0, 0.4
MIDDLE_MM = (3.5, -2.25)  # of every part, so that no place is right by accident


@dataclass(frozen=True)
class Model:
    """A part by name; `make` gives None where its file is absent."""

    name: str
    about: str
    make: Callable[[], Mesh | None]


def fins_and_pins(widths_mm: Sequence[float] = WIDTHS_MM, top_mm: float = 5.0) -> Mesh:
    """A plate with a fin and a round pin of each width."""
    width = np.array(widths_mm)
    x = np.cumsum(width + GAP_MM) - width / 2
    length, depth = float(x[-1] + width[-1] / 2 + GAP_MM), FIN_MM + 4 * GAP_MM
    low = np.stack([x - width / 2, np.full_like(x, GAP_MM), np.full_like(x, PLATE_MM / 2)], axis=1)
    size = np.stack([width, np.full_like(x, FIN_MM), np.full_like(x, top_mm - PLATE_MM / 2)], axis=1)
    pins = np.stack([x, np.full_like(x, FIN_MM + 2.5 * GAP_MM)], axis=1)
    plate = shapes.boxes([0, 0, 0], [length, depth, PLATE_MM])
    fins = shapes.boxes(low, low + size)
    return shapes.join([plate, fins, shapes.posts(pins, width / 2, PLATE_MM / 2, top_mm, sides=48)])


def shell(diameter_mm: float = 20.0, wall_mm: float = 0.3) -> Mesh:
    """A hollow sphere."""
    radii = np.array([[diameter_mm / 2], [diameter_mm / 2 - wall_mm]])
    outer, inner = (shapes.balls([0, 0, 0], radius, sides=128) for radius in radii)
    return shapes.join([outer, shapes.cavity(inner)])


def fcc_lattice(cell_mm: float = 4.0, cells: tuple[int, int, int] = (3, 3, 2), strut_mm: float = 0.3) -> Mesh:
    """A plate and on it a lattice: struts from every cell's corners to the middles of its faces."""
    starts, ends = [], []
    corners = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)], float)
    for cell in np.ndindex(cells):
        for axis in range(3):
            for side in (0.0, 1.0):
                middle = np.full(3, 0.5)
                middle[axis] = side
                own = corners[corners[:, axis] == side]
                starts.append((own + cell) * cell_mm)
                ends.append(np.tile((middle + cell) * cell_mm, (4, 1)))
    start, end = np.concatenate(starts), np.concatenate(ends)
    _, first = np.unique(np.round(np.concatenate([start, end], axis=1), 6), axis=0, return_index=True)
    size = np.array(cells) * cell_mm
    plate = shapes.boxes([-1, -1, -PLATE_MM], [size[0] + 1, size[1] + 1, 0])
    return shapes.join([plate, shapes.rods(start[first], end[first], strut_mm / 2)])


def hub() -> Mesh:
    """A wheel on three feet of half a layer of 0.2 mm: its bottom is on the first mid-plane."""
    feet = np.stack([4 * np.cos([0, 2.1, 4.2]), 4 * np.sin([0, 2.1, 4.2])], axis=1)
    wheel = shapes.posts([[0, 0]], [6.0], 0.1, 2.0, sides=96)
    spokes = shapes.bars([[6, 0], [-6, 0]], [[9, 0], [-9, 0]], [0.3, 0.3], 0.1, 2.0)
    return shapes.join([wheel, spokes, shapes.posts(feet, [1.0] * 3, 0.0, 0.1, sides=48)])


def placed(mesh: Mesh) -> Mesh:
    """On the bed, the middle of its box at MIDDLE_MM."""
    low, high = mesh.bounds_mm
    return mesh.moved([*(np.array(MIDDLE_MM) - (low + high)[:2] / 2), -low[2]])


def _shared(file: str, scale: Sequence[float]) -> Callable[[], Mesh | None]:
    """A mesh of the shared folder at another size."""

    def make() -> Mesh | None:
        path = SHARED / "meshes" / file
        return load_mesh(path, unit="mm").transformed(np.diag(scale)) if path.is_file() else None

    return make


MODELS = {
    model.name: model
    for model in (
        Model("fins-and-pins", "fins and pins 0.10 to 1.00 mm wide on a plate", fins_and_pins),
        Model("shell", "hollow sphere Ø 20 mm, wall 0.3 mm", shell),
        Model("lattice", "fcc-like lattice of Ø 0.3 mm struts on a plate", fcc_lattice),
        Model("hub", "a wheel whose bottom is on the first mid-plane, with spokes of 0.3 mm", hub),
        Model("dragon", "dragon_bronze.stl at 30 %", _shared("dragon_bronze.stl", (0.3, 0.3, 0.3))),
        Model("text", "text_uvtools.stl at 55 % in x and y", _shared("text_uvtools.stl", (0.55, 0.55, 1.0))),
        Model("castle", "castle_ruin.stl at 50 %", _shared("castle_ruin.stl", (0.5, 0.5, 0.5))),
    )
}
