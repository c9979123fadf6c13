"""The objective C(θ) = Σ |Ŝ - S| (paper, equation 5): what correction adds and removes, for one pose of a part.

Layers are cut at their mid-planes alone. What `slice_mesh` rescues besides, sheets between mid-planes, changed C by
0.0 to 1.5 % in 90 poses of four parts, and never which of them was best.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from layerfix.errors import InputError
from layerfix.layers.correction import correct
from layerfix.layers.feature import feature_of_mm
from layerfix.layers.print_paths import Tool, tool_of
from layerfix.mesh.closing import edges_balance, keys_balance, orient
from layerfix.mesh.cutter import pixels_and_planes
from layerfix.mesh.doubles import any_doubles, without_doubles
from layerfix.mesh.slicing import FILLS, slice_mesh
from layerfix.mesh.triangles import Mesh
from layerfix.orientation.counting import count_layers, snap, stand
from layerfix.orientation.directions import AS_GIVEN, Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.layers.correction import Mode
    from layerfix.layers.skeleton import Spurs
    from layerfix.mesh.slicing import Fill
    from layerfix.stack import LayerStack

CHUNK_PX = 1 << 26  # of layers, between two looks at whether to stop: half a second or less
CHUNK_LAYERS = 4, 128  # at least and at most
FULL = 1 << 40  # more layers than any part has
CLOSE = 512  # evenly spread layers: C of six parts with more came out 0.05 to 1.1 % off (rms)


class Counts(NamedTuple):
    """What correction changes in some layers of a pose, in pixels: whole numbers, so that no order matters.

    seen, layers           how many layers were looked at, and how many there are; 0 of a part too low for any
    solid, added, removed  sums over the layers seen
    first                  the same three of the first layer, which may be of another height; zeros if it was not seen
    height_mm              of the part in this pose
    """

    seen: int
    layers: int
    solid: int
    added: int
    removed: int
    first: tuple[int, int, int]
    height_mm: float

    @property
    def whole(self) -> bool:
        """Whether all layers were seen."""
        return self.seen == self.layers

    @property
    def empty(self) -> bool:
        """Whether nothing of the part is in the layers: it is lower than one, or none meets it."""
        return not self.layers or (self.seen > 0 and not self.solid)

    @property
    def close(self) -> bool:
        """Whether all layers were seen, or CLOSE."""
        return self.whole or self.seen >= CLOSE

    def estimate(self) -> Counts:
        """Scaled up to all layers: what is seen in evenly spread layers goes for those between."""
        if self.whole:
            return self
        k = self.layers / max(self.seen, 1)
        return Counts(self.layers, self.layers, round(self.solid * k), round(self.added * k), round(self.removed * k),
                      self.first, self.height_mm)  # fmt: skip

    def with_more(self, more: Counts) -> Counts:
        """Together with other layers of the same pose."""
        return Counts(
            self.seen + more.seen, self.layers, self.solid + more.solid, self.added + more.added,
            self.removed + more.removed,
            (self.first[0] + more.first[0], self.first[1] + more.first[1], self.first[2] + more.first[2]),
            self.height_mm,
        )  # fmt: skip


@dataclass(frozen=True)
class Printing:
    """How a part would be printed and corrected: what C depends on besides the pose.

    pixel_mm, layer_mm, first_layer_mm  as `slice_mesh` takes them
    min_feature_mm, mode, spurs         as `correct` takes them
    fill                                as `slice_mesh` takes it
    rescue                              thin sheets are looked for, too, layer by layer as in `slice_mesh`: slow
    """

    pixel_mm: tuple[float, float]
    layer_mm: float
    min_feature_mm: float
    first_layer_mm: float | None = None
    mode: Mode = "as_printed"
    spurs: Spurs = "metric"
    fill: Fill = "nonzero"
    rescue: bool = False


@dataclass(frozen=True, eq=False)
class Objective:
    """C of one part, a pose at a time. Poses turn it about the middle of its bounding box; its lowest point is z = 0.

    Threads share one. What is pickled is the part and how it is printed.
    """

    mesh: Mesh
    printing: Printing
    _sound: bool = field(init=False)
    _tool: Tool = field(init=False)

    def __post_init__(self) -> None:
        """Raises InputError for a part without thickness and what `slice_mesh` and `correct` refuse."""
        mesh, printing = self.mesh, self.printing
        if not isinstance(mesh, Mesh):
            object.__setattr__(self, "mesh", mesh := Mesh(mesh.vertices, mesh.faces))  # a trimesh.Trimesh, say
        if thickness_mm(mesh) < 1e-7 * max(mesh.size_mm):
            raise InputError(f"{mesh.name}: the part is flat; it has no thickness in any direction")
        # As it stands: whatever is refused is refused before any work.
        stack = slice_mesh(mesh, pixel_mm=printing.pixel_mm, layer_mm=min(printing.layer_mm, mesh.size_mm[2]),
                           margin_mm=printing.min_feature_mm, fill=printing.fill, z_sampling="middle")  # fmt: skip
        correct(stack, min_feature_mm=printing.min_feature_mm, mode=printing.mode, spurs=printing.spurs)
        feature = feature_of_mm(printing.min_feature_mm, printing.pixel_mm)
        object.__setattr__(self, "_tool", tool_of(feature, printing.spurs))
        mesh, sound = welded(mesh)
        object.__setattr__(self, "mesh", mesh)
        object.__setattr__(self, "_sound", sound)

    def __reduce__(self) -> tuple[type[Objective], tuple[Mesh, Printing]]:
        """The part and how it is printed."""
        return Objective, (self.mesh, self.printing)

    @cached_property
    def middle_mm(self) -> NDArray[np.float64]:
        """(3,) what poses turn the part about."""
        middle: NDArray[np.float64] = self.mesh.bounds_mm.mean(axis=0)
        return middle

    @cached_property
    def corners_mm(self) -> NDArray[np.float64]:
        """(n, 3): the corners of the convex hull, which are all that the size of a pose depends on."""
        from scipy.spatial import ConvexHull

        corners: NDArray[np.float64] = self.mesh.vertices[ConvexHull(self.mesh.vertices).vertices]
        return corners

    def size_mm(self, pose: Pose) -> tuple[float, float, float]:
        """Extents along x, y, z in a pose (of clipped parts, before they are clipped)."""
        x, y, z = np.ptp(self.corners_mm @ pose.matrix.T, axis=0).tolist()
        return x, y, z

    def height_mm(self, pose: Pose) -> float:
        """Extent along z in a pose."""
        return float(np.ptp(self.corners_mm @ pose.direction))

    @cached_property
    def token(self) -> str:
        """Digest of the part and of how it is printed: of all that C depends on."""
        digest = hashlib.blake2b(digest_size=16)
        _add_mesh(digest.update, self.mesh)
        digest.update(repr(self.printing).encode())
        return digest.hexdigest()

    def placement(self, pose: Pose) -> NDArray[np.float64]:
        """(4, 4): takes the part as it is given to its pose on the plate, its lowest point at z = 0."""
        matrix = np.eye(4)
        matrix[:3, :3] = pose.matrix
        matrix[:2, 3] = (self.middle_mm - pose.matrix @ self.middle_mm)[:2]
        matrix[2, 3] = -float(self._turned(pose).bounds_mm[0, 2])
        return matrix

    def placed(self, pose: Pose) -> Mesh:
        """The part in its pose on the plate."""
        turned = self._turned(pose)
        return turned.moved([0.0, 0.0, -float(turned.bounds_mm[0, 2])])

    def _turned(self, pose: Pose) -> Mesh:
        if pose == AS_GIVEN:
            return self.mesh
        shift = self.middle_mm - pose.matrix @ self.middle_mm
        turned = self.mesh.transformed(pose.matrix)
        return turned.moved([shift[0], shift[1], 0.0])

    def count(
        self, pose: Pose, first: int = 0, stop: int = FULL, stopped: Callable[[], bool] | None = None
    ) -> Counts:
        """What correction changes in layers first … stop - 1 of the order in which layers are looked at.

        The order spreads the first n layers evenly over the part, whatever n is. stopped: asked now and then; once it
        says so, KeyboardInterrupt is raised. A part too low for a layer in this pose has 0 layers.
        """
        found = self.stand(pose)
        if found.height_mm <= (self.printing.first_layer_mm or self.printing.layer_mm) / 2:
            return Counts(0, 0, 0, 0, 0, (0, 0, 0), found.height_mm)
        cut = self.cut(pose, found)
        z_mm, counted = self._one_by_one(pose) if cut is None else (cut.z_mm, self._kernel(cut))
        chosen = spread_order(len(z_mm))[first:stop]
        sums, lowest = np.zeros(3, np.int64), np.zeros(3, np.int64)
        step = CHUNK_LAYERS[0] if cut is None else CHUNK_PX // (cut.size_px[0] * cut.size_px[1])
        step = min(max(step, CHUNK_LAYERS[0]), CHUNK_LAYERS[1])
        for k in range(0, len(chosen), step):
            if stopped is not None and stopped():
                raise KeyboardInterrupt
            some = np.sort(chosen[k : k + step])
            counts = counted(some)
            sums += counts.sum(axis=0)
            lowest += counts[some == 0].sum(axis=0)
        a, b, c = lowest.tolist()
        solid, added, removed = sums.tolist()
        return Counts(len(chosen), len(z_mm), solid, added, removed, (a, b, c), found.height_mm)

    def volumes_mm3(self, counts: Counts) -> tuple[float, float, float]:
        """(solid, added, removed) of what was counted."""
        printing = self.printing
        area_mm2 = printing.pixel_mm[0] * printing.pixel_mm[1]
        more_mm = (printing.first_layer_mm or printing.layer_mm) - printing.layer_mm
        sums = (counts.solid, counts.added, counts.removed)
        solid, added, removed = (
            (n * printing.layer_mm + of_first * more_mm) * area_mm2
            for n, of_first in zip(sums, counts.first, strict=True)
        )
        return solid, added, removed

    def stand(self, pose: Pose) -> Standing:
        """The vertices in a pose."""
        if self.mesh.parts:
            turned = self._turned(pose)
            return Standing(turned.vertices, turned.bounds_mm)
        points, bounds = np.empty_like(self.mesh.vertices), np.empty((2, 3))
        matrix = pose.matrix
        shift = self.middle_mm - matrix @ self.middle_mm
        shift[2] = 0.0
        stand(self.mesh.vertices, matrix, shift, points, bounds)
        return Standing(points, bounds)

    def cut(self, pose: Pose, found: Standing) -> Cut | None:
        """The part on pixels and layers, ready for the kernel, which takes the vertices; None if it cannot be."""
        printing, faces = self.printing, self.mesh.faces
        if self.mesh.parts or printing.rescue:
            return None
        width, height, origin, z_mm, quantum, planes = pixels_and_planes(
            found.box(self.mesh.name),
            pixel_mm=printing.pixel_mm,
            layer_mm=printing.layer_mm,
            first_layer_mm=printing.first_layer_mm,
            margin_mm=printing.min_feature_mm,
        )
        points = found.points
        snap(points, np.array(origin), *printing.pixel_mm, float(found.bounds[0, 2]), quantum)
        if not self._sound:
            faces = without_doubles(points, faces)
            if not edges_balance(points, faces):
                faces = orient(points, faces)
                if not edges_balance(points, faces):
                    return None
        return Cut(points, faces, planes, (width, height), z_mm)

    def _kernel(self, cut: Cut) -> Callable[[NDArray[np.int64]], NDArray[np.int64]]:
        how = FILLS[self.printing.fill], self._tool, self.printing.mode == "add_only"
        return lambda chosen: count_layers(cut.points, cut.faces, cut.planes[chosen], cut.size_px, *how)

    def _one_by_one(self, pose: Pose) -> tuple[NDArray[np.float64], Callable[[NDArray[np.int64]], NDArray[np.int64]]]:
        """(bounds of the layers; what counts chosen ones) by way of the public functions."""
        fixed = self.corrected(pose)

        def counted(chosen: NDArray[np.int64]) -> NDArray[np.int64]:
            changes = [fixed[int(k)].change for k in chosen]
            return np.array([(c.solid_px, c.added_px, c.removed_px) for c in changes if c is not None], np.int64)

        return fixed.z_mm, counted

    def corrected(self, pose: Pose) -> LayerStack:
        """The corrected layers of a pose, whose changes are what `count` counts: for meshes that are not closed."""
        printing = self.printing
        stack = slice_mesh(self._turned(pose), pixel_mm=printing.pixel_mm, layer_mm=printing.layer_mm,
                           first_layer_mm=printing.first_layer_mm, margin_mm=printing.min_feature_mm,
                           fill=printing.fill, z_sampling="rescue" if printing.rescue else "middle")  # fmt: skip
        return correct(stack, min_feature_mm=printing.min_feature_mm, mode=printing.mode, spurs=printing.spurs)


class Standing(NamedTuple):
    """The vertices in a pose, and the lowest and the highest corner."""

    points: NDArray[np.float64]
    bounds: NDArray[np.float64]

    @property
    def height_mm(self) -> float:
        return float(self.bounds[1, 2] - self.bounds[0, 2])

    def box(self, name: str) -> Mesh:
        """The smallest mesh with these bounds: all that pixels and layers depend on."""
        low, high = self.bounds
        return Mesh(np.array([low, high, low]), np.array([[0, 1, 2]], np.int32), name)


class Cut(NamedTuple):
    """A closed mesh as `count_layers` takes it, and the bounds of its layers."""

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    planes: NDArray[np.float64]
    size_px: tuple[int, int]
    z_mm: NDArray[np.float64]


@lru_cache(maxsize=4096)
def spread_order(layers: int) -> NDArray[np.int64]:
    """(layers,) all of them, in an order whose first n are spread evenly, for every n: van der Corput's sequence."""
    if layers < 1:
        return np.zeros(0, np.int64)
    bits = max(layers - 1, 1).bit_length() + 1  # twice as many places as layers at least: none is left out
    places = np.arange(1 << bits)
    reversed_bits = np.zeros_like(places)
    for k in range(bits):
        reversed_bits |= ((places >> k) & 1) << (bits - 1 - k)
    # Half a step of 32 on, so that the first ones are the middles of their stretches.
    at = (((reversed_bits / (1 << bits)) + 1 / 64) % 1.0 * layers).astype(np.int64)
    _, first = np.unique(at, return_index=True)
    order: NDArray[np.int64] = at[np.sort(first)]
    order.flags.writeable = False
    return order


def thickness_mm(mesh: Mesh) -> float:
    """Spread of the vertices in the direction in which they spread least: 0 if they lie in a plane."""
    away = mesh.vertices - mesh.vertices.mean(axis=0)
    return math.sqrt(max(float(np.linalg.eigvalsh(away.T @ away / len(away))[0]), 0.0))


def _place_keys(vertices: NDArray[np.float64]) -> NDArray[np.uint64]:
    """(n,) the same number for vertices in exactly the same place, which stay together however they are turned."""
    bits = (vertices + 0.0).view(np.uint64)  # no -0
    key = np.full(len(bits), 0x9E3779B97F4A7C15, np.uint64)
    for k in range(3):
        key = (key ^ bits[:, k]) * np.uint64(0xBF58476D1CE4E5B9)
        key ^= key >> np.uint64(31)
        key *= np.uint64(0x94D049BB133111EB)
        key ^= key >> np.uint64(29)
    return key


def welded(mesh: Mesh) -> tuple[Mesh, bool]:
    """(the mesh with each place's vertices as one; whether it is closed, with no triangle twice, in every pose)."""
    if mesh.parts:
        return mesh, False
    keys = _place_keys(mesh.vertices)
    _, first, numbers = np.unique(keys, return_index=True, return_inverse=True)
    if len(first) < len(keys):
        mesh = replace(mesh, vertices=mesh.vertices[first], faces=numbers.reshape(-1).astype(np.int32)[mesh.faces])
        keys = keys[first]
    return mesh, bool(keys_balance(keys, mesh.faces)) and not any_doubles(keys, mesh.faces)


def _add_mesh(add: Callable[[bytes], None], mesh: Mesh) -> None:
    """Feed all that is sliced of a mesh to a digest."""
    add(np.ascontiguousarray(mesh.vertices, "<f8").tobytes())
    add(np.ascontiguousarray(mesh.faces, "<i4").tobytes())
    for part in mesh.parts:
        add(repr((part.faces, part.united, [clip.inside for clip in part.clips])).encode())
        for clip in part.clips:
            _add_mesh(add, clip.mesh)
