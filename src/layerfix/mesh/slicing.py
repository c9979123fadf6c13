"""Mesh → LayerStack: cut at the layers' mid-planes, fill to pixels, exact at the pixel centres.

Grid: pixel (row j, column i) has its centre at (i, j); x and y are snapped to 1/1024 px, which closes the
hairline cracks of STL files. z is counted in quanta of a decimal fraction of a layer, so that vertices
given in decimals meet planes given in decimals exactly.

No vertex is ever "on" a plane or a pixel row: above means z > plane, and a row belongs to an edge if
y0 ≤ row < y1, a column to the solid if it is at or past the crossing (half-open everywhere). Every edge is
interpolated from its lower end, so both its triangles get the bit-identical point and closed meshes give
closed rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numba import types

from layerfix.bits import WORK, words_for
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import Room
from layerfix.layers.grey_image import GreyImage
from layerfix.layers.grey_source import GreySource
from layerfix.mesh.closing import close_gaps, edges_balance, orient
from layerfix.mesh.doubles import without_doubles
from layerfix.mesh.facet_runs import by_slabs
from layerfix.mesh.fill import EVEN_ODD, NONZERO, POSITIVE, SEGMENTS, below, fill
from layerfix.mesh.pieces import PLACES, small_pieces
from layerfix.mesh.sheets import LEAST, Sheets
from layerfix.mesh.triangles import Mesh
from layerfix.stack import Gaps, Layer, LayerStack, layer_bounds_mm, pitch_mm
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

Fill = Literal["even_odd", "nonzero", "positive"]
ZSampling = Literal["rescue", "middle", "overlap"]
Z_SAMPLINGS: tuple[ZSampling, ...] = get_args(ZSampling)
FILLS: dict[Fill, int] = {"even_odd": EVEN_ODD, "nonzero": NONZERO, "positive": POSITIVE}
SNAP_PER_PX = 1024
SLAB_LAYERS = 16  # layers that share one list of triangles: 4 % of the memory of a list per layer
MAX_FRAME_PX = 2**31
THRESHOLD, GREY_FLOOR = 128, 32  # of greys, as jobs are read
CHUNK = 1 << 20  # vertices that are put on the grid at once: 24 MB

POINTS = types.Array(types.float64, 2, "C", readonly=True)
TRIANGLES = types.Array(types.int32, 2, "C", readonly=True)
INDICES = types.Array(types.int32, 1, "C", readonly=True)
STARTS = types.Array(types.int64, 1, "C", readonly=True)
HEIGHTS = types.Array(types.float64, 1, "C", readonly=True)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Where layers and pixels are."""

    pitch: tuple[float, float]
    origin: tuple[float, float]
    shape: tuple[int, int]  # of packed rows
    width: int
    lowest_mm: float  # z of the part's lowest point, which becomes 0
    z_mm: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Cutter:
    """A mesh on the grid, with the triangles sorted into slabs of layers."""

    points: NDArray[np.float64]  # (n, 3) column, row, z quanta
    faces: NDArray[np.int32]
    planes: NDArray[np.float64]  # (layers,) z quanta of the mid-planes
    bounds: NDArray[np.float64]  # (layers, 2) of bottoms and tops
    slab_starts: NDArray[np.int64]
    slab_faces: NDArray[np.int32]
    closed: bool

    def facets(self, index: int) -> NDArray[np.int32]:
        """Those that a layer's mid-plane may cut."""
        slab = index // SLAB_LAYERS
        return self.slab_faces[self.slab_starts[slab] : self.slab_starts[slab + 1]]

    def segments(self, index: int) -> NDArray[np.float64]:
        segments: NDArray[np.float64] = cut(self.points, self.faces, self.facets(index), self.planes[index])
        return segments


@dataclass(frozen=True, eq=False)
class _Piece:
    """A surface that is filled on its own, and (surface, whether its inside is kept) of each that bounds it."""

    cutter: _Cutter
    rule: int
    hairlines: bool
    sheets: Sheets | None
    clips: tuple[tuple[_Cutter, bool], ...]


@njit(types.UniTuple(types.int64, 2)(HEIGHTS, types.float64, types.float64), cache=True, nogil=True)
def _planes_cut(planes, low, high):  # type: ignore[no-untyped-def]  # numba types it
    """Planes k with low ≤ planes[k] < high, as (first, past the last)."""
    return below(planes, low), below(planes, high)


@njit(
    types.Tuple((types.Array(types.int64, 1, "C"), types.Array(types.int32, 1, "C")))(
        POINTS, TRIANGLES, HEIGHTS, types.int64
    ),
    cache=True,
    nogil=True,
)
def bucket(points, faces, planes, slab_layers):  # type: ignore[no-untyped-def]  # numba types it
    """Triangles cut by any plane of each slab: (starts, faces), CSR."""
    reach = np.zeros((faces.shape[0], 2), np.int32)
    for t in range(faces.shape[0]):
        a, b, c = points[faces[t, 0], 2], points[faces[t, 1], 2], points[faces[t, 2], 2]
        first, stop = _planes_cut(planes, min(a, b, c), max(a, b, c))
        if stop > first:
            reach[t, 0], reach[t, 1] = first // slab_layers, (stop - 1) // slab_layers + 1
    return by_slabs(reach, (planes.shape[0] + slab_layers - 1) // slab_layers)


@njit(SEGMENTS(POINTS, TRIANGLES, INDICES, types.float64), cache=True, nogil=True)
def cut(points, faces, chosen, plane):  # type: ignore[no-untyped-def]  # numba types it
    """Segments in which `plane` cuts the chosen triangles: (n, 4) x, y of start and end, solid on the left
    (of x right, y up) for triangles that face outwards."""
    out = np.empty((chosen.shape[0], 4), np.float64)
    n = 0
    for p in range(chosen.shape[0]):
        t = chosen[p]
        crossings = 0
        for e in range(3):
            a, b = faces[t, e], faces[t, 0 if e == 2 else e + 1]
            az, bz = points[a, 2], points[b, 2]
            if (az > plane) == (bz > plane):
                continue
            crossings += 1
            if bz > plane:
                s = (plane - az) / (bz - az)
                out[n, 2] = points[a, 0] + s * (points[b, 0] - points[a, 0])
                out[n, 3] = points[a, 1] + s * (points[b, 1] - points[a, 1])
            else:
                s = (plane - bz) / (az - bz)
                out[n, 0] = points[b, 0] + s * (points[a, 0] - points[b, 0])
                out[n, 1] = points[b, 1] + s * (points[a, 1] - points[b, 1])
        if crossings:
            n += 1
    return out[:n].copy()


@njit(
    types.Tuple((types.int64, types.int64, PLACES))(
        POINTS, TRIANGLES, INDICES, types.float64, types.int64, types.int64, types.boolean, WORK
    ),
    cache=True,
    nogil=True,
)
def fill_cut(points, faces, chosen, plane, width, rule, hairlines, rows):  # type: ignore[no-untyped-def]  # numba types it
    """`cut` and `fill` of a closed surface: (segments, pixels of hairlines, middles of small pieces); the last two
    only if `hairlines`."""
    segments = cut(points, faces, chosen, plane)
    if segments.shape[0] == 0 or not hairlines:
        added = fill(segments, width, rule, False, rows) if segments.shape[0] else 0
        return segments.shape[0], added, np.empty((0, 2), np.int64)
    added = fill(segments, width, rule, True, rows)
    return segments.shape[0], added, small_pieces(segments, rows)


def slice_mesh(
    mesh: Mesh,
    *,
    pixel_mm: float | tuple[float, float],
    layer_mm: float,
    first_layer_mm: float | None = None,
    margin_mm: float = 1.0,
    fill: Fill = "nonzero",
    hairlines: bool = True,
    z_sampling: ZSampling = "rescue",
    min_overlap: float = 0.5,
    antialias: bool = False,
    frame_px: tuple[int, int] | None = None,
) -> LayerStack:
    """Cut a mesh into binary layers at their mid-planes. The part's lowest point becomes z = 0.

    What is thinner than a pixel or a layer, and would be missed, is drawn one pixel and one layer thick.

    pixel_mm        pixel pitch, one number or (x, y)
    layer_mm        layer height; `first_layer_mm` if the first differs
    margin_mm       empty border around the part; correction can grow by half the minimum feature into it
    fill            "nonzero" (overlapping shells unite), "even_odd" (every second shell is a hole),
                    "positive" (only shells that face outwards are solid)
    hairlines       what is thinner than a pixel becomes a line of pixels (`layerfix.mesh.fill`), and small pieces are
                    known to be separate (`Layer.small`); False: only pixels whose centre is inside
    z_sampling      "rescue": what lies between two mid-planes and is met by none goes into the layer that holds most
                    of it, if it is a quarter of that layer high (`layerfix.mesh.sheets`; not in open meshes);
                    "middle": only what a mid-plane meets; "overlap": what fills min_overlap of the layer's height,
                    and what would fill that of no layer and is a quarter high
    min_overlap     share of a layer's height, above 0 and at most 1, for "overlap"
    antialias       layers carry greys, too, for images and jobs: how much of each pixel the cross-section covers.
                    Solid is what is covered by half, and the crest of thin strokes (`layerfix.layers.greys`)
    frame_px        (width, height) of a printer's panel, the part in its middle, instead of part + margin
    returns         a stack that cuts each layer when asked for it. Gaps of an open mesh are closed nearest
                    ends first; each layer says how many and how far (`Layer.gaps`). Its notes are the mesh's. Layers
                    may be empty, even all of them: see `empty.told_of_ends`
    raises          InputError for unusable numbers, a part without thickness, one larger than frame_px
    """
    if fill not in FILLS:
        raise InputError(f"fill='{fill}' is not known; choose from {', '.join(FILLS)}")
    if z_sampling not in Z_SAMPLINGS:
        raise InputError(f"z_sampling='{z_sampling}' is not known; choose from {', '.join(Z_SAMPLINGS)}")
    if not 0 < min_overlap <= 1:
        raise InputError(f"min_overlap {min_overlap}: above 0 and at most 1")
    if not 0 <= margin_mm < math.inf:
        raise InputError(f"margin {margin_mm} mm: it must be 0 or more")
    if not isinstance(mesh, Mesh):
        mesh = Mesh(mesh.vertices, mesh.faces)  # a trimesh.Trimesh, say
    pitch = pitch_mm(pixel_mm)
    width, height, origin = _frame(mesh, pitch, margin_mm, frame_px)
    z_mm = _layers(mesh, layer_mm, first_layer_mm, z_sampling)
    grid = _Grid(pitch, origin, (height, words_for(width)), width, float(mesh.bounds_mm[0, 2]), z_mm)
    share = min_overlap if z_sampling == "overlap" else None
    make = _sliced(mesh, grid, FILLS[fill], hairlines, z_sampling, antialias, share)
    return LayerStack(width, height, pitch, z_mm, make, origin, notes=mesh.notes)


def slice_like(
    mesh: Mesh,
    stack: LayerStack,
    *,
    fill: Fill = "nonzero",
    hairlines: bool = False,
    z_sampling: Literal["rescue", "middle"] = "middle",
) -> LayerStack:
    """Cut a mesh into the layers and pixels of another stack: a bore to be kept free, say, for `correct`.

    If that stack was sliced from a mesh, both have the same origin; otherwise z = 0 is the plate, and x and y are the
    stack's. What lies outside the frame is cut off. Other arguments as in `slice_mesh`. Raises InputError for a part
    without thickness.
    """
    if fill not in FILLS:
        raise InputError(f"fill='{fill}' is not known; choose from {', '.join(FILLS)}")
    if min(mesh.size_mm) <= 0:
        raise InputError(f"{mesh.name}: the part is {' × '.join(f'{s:.4g}' for s in mesh.size_mm)} mm; it is flat")
    lowest_mm = plate_mm(stack)
    shape = stack.height, words_for(stack.width)
    grid = _Grid(stack.pixel_mm, stack.origin_mm, shape, stack.width, lowest_mm, stack.z_mm)
    make = _sliced(mesh, grid, FILLS[fill], hairlines, z_sampling, False, None)
    return LayerStack(stack.width, stack.height, stack.pixel_mm, stack.z_mm, make, stack.origin_mm, notes=mesh.notes)


def plate_mm(stack: LayerStack) -> float:
    """The z, in the coordinates of the mesh that was sliced, that is 0 in the stack; 0 if it was not sliced."""
    sliced = _slicing_of(stack)
    return 0.0 if sliced is None else sliced.grid.lowest_mm


def sliced_mesh(stack: LayerStack) -> Mesh | None:
    """The mesh that the layers of a stack were cut from, whatever was done to them since; None if they were not."""
    sliced = _slicing_of(stack)
    mesh: Mesh | None = None if sliced is None else sliced.how[0]
    return mesh


def _slicing_of(stack: LayerStack) -> _Sliced | None:
    make: Any = stack.make
    while not isinstance(make, _Sliced) and hasattr(make, "make"):
        make = make.make
    return make if isinstance(make, _Sliced) else None


@dataclass(frozen=True, eq=False)
class _Sliced:
    """`make` of a sliced mesh. What is pickled is the mesh and how it is sliced."""

    how: tuple[Any, ...]  # what `_sliced` takes
    pieces: list[_Piece]
    grid: _Grid
    antialias: bool
    share: float | None  # of a layer's height that is to be filled, for "overlap"

    def __call__(self, index: int) -> Layer:
        found = _united(self.pieces, self.grid, index, self.share)
        bottom, top = self.grid.z_mm[index].tolist()
        rows = np.zeros(self.grid.shape, np.uint64) if found.rows is None else found.rows
        gaps = found.gaps
        whole = Gaps(sum(gap.count for gap in gaps), max(gap.longest_mm for gap in gaps)) if gaps else None
        source = self._greys(index, rows, found) if self.antialias and rows.any() else None
        return Layer(rows if source is None else source.seen, self.grid.width, (bottom, top), None, whole, source,
                     found.hairline_px, found.sheet_px, found.sheets_lost, small=found.small)  # fmt: skip

    def _greys(self, index: int, rows: NDArray[np.uint64], found: _Found) -> GreySource:
        """The layer's greys. What is thinner than a pixel or a layer stays as it is in `rows`."""
        from layerfix.layers.greys import solid_rows

        grey = GreyImage.of(_covered(self.pieces, self.grid, index))
        seen, _ = solid_rows(grey, THRESHOLD, GREY_FLOOR)
        if found.hairline_px or found.sheet_px:
            plain = [replace(piece, hairlines=False, sheets=None) for piece in self.pieces]
            whole = _united(plain, self.grid, index).rows
            seen |= rows if whole is None else rows & ~whole
        return GreySource(seen, grey, None, THRESHOLD, "")

    def __reduce__(self) -> tuple[Any, ...]:
        return _sliced, self.how


def _sliced(
    mesh: Mesh,
    grid: _Grid,
    rule: int,
    hairlines: bool,
    z_sampling: ZSampling,
    antialias: bool,
    share: float | None,
) -> _Sliced:
    pieces = _pieces(mesh, grid, rule, hairlines, z_sampling)
    how = mesh, grid, rule, hairlines, z_sampling, antialias, share
    return _Sliced(how, pieces, grid, antialias, share)


def _covered(pieces: list[_Piece], grid: _Grid, index: int) -> NDArray[np.uint8]:
    """(H, W) uint8: the greys of one layer of all pieces together."""
    from layerfix.mesh.coverage import coverage

    height, width = grid.shape[0], grid.width

    def of(cutter: _Cutter, rule: int) -> NDArray[np.uint8]:
        segments = cutter.segments(index)
        if not cutter.closed and len(segments):
            segments, _ = close_gaps(segments, grid.pitch)
        covered: NDArray[np.uint8] = coverage(segments, width, height, rule)
        return covered

    out = np.zeros((height, width), np.uint8)
    for piece in pieces:
        grey = of(piece.cutter, piece.rule)
        for cutter, inside in piece.clips:
            clip = of(cutter, NONZERO)
            np.minimum(grey, clip if inside else 255 - clip, out=grey)
        np.maximum(out, grey, out=out)
    return out


def _pieces(mesh: Mesh, grid: _Grid, rule: int, hairlines: bool, z_sampling: ZSampling) -> list[_Piece]:
    """What is sliced on its own. A clip that bounds several parts is cut once a layer.

    All pieces look for sheets on the same two images, of which each thread has its own.
    """
    room = Room()

    def piece(surface: Mesh, rule: int, clips: tuple[tuple[_Cutter, bool], ...]) -> _Piece:
        cutter = _cutter(surface, grid)
        size_px = grid.width, grid.shape[0]
        sheets = None
        if z_sampling != "middle" and cutter.closed:
            sheets = Sheets(cutter.points, cutter.faces, cutter.planes, cutter.bounds, size_px, rule, room=room)
        return _Piece(cutter, rule, hairlines, sheets, clips)

    if not mesh.parts:
        return [piece(mesh, rule, ())]
    cutters: dict[int, _Cutter] = {}
    pieces = []
    for faces, part in mesh.pieces():
        clips = part.clips if part else ()
        for clip in clips:
            if id(clip.mesh) not in cutters:
                cutters[id(clip.mesh)] = _cutter(clip.mesh, grid)
        bounds = tuple((cutters[id(clip.mesh)], clip.inside) for clip in clips)
        own = NONZERO if part and part.united else rule
        pieces.append(piece(Mesh(mesh.vertices, faces, mesh.name), own, bounds))
    return pieces


@dataclass(eq=False)
class _Found:
    """What a layer of some surfaces came to."""

    rows: NDArray[np.uint64] | None = None
    gaps: list[Gaps] = field(default_factory=list)
    hairline_px: int = 0
    sheet_px: int = 0
    sheets_lost: int = 0
    middles: list[NDArray[np.int64]] = field(default_factory=list)

    @property
    def small(self) -> NDArray[np.int64] | None:
        """Middles of small pieces, if there are any."""
        return np.concatenate(self.middles) if self.middles else None


def _united(pieces: list[_Piece], grid: _Grid, index: int, share: float | None = None) -> _Found:
    """One layer of all pieces together."""
    found = _Found()
    clips: dict[int, NDArray[np.uint64] | None] = {}
    for piece in pieces:
        solid = _filled(piece.cutter, grid, index, piece.rule, piece.hairlines, found)
        if piece.sheets is not None:
            if share is not None:
                solid = np.zeros(grid.shape, np.uint64) if solid is None else solid
                found.sheet_px += piece.sheets.cover(index, solid, piece.cutter.segments(index), share)
            else:
                solid = _rescued(piece.sheets, grid, index, solid, found)
        for cutter, inside in piece.clips if solid is not None else ():
            if id(cutter) not in clips:
                clips[id(cutter)] = _filled(cutter, grid, index, NONZERO, False, found)
            clip = clips[id(cutter)]
            if clip is not None and solid is not None:
                solid &= clip if inside else ~clip
            elif inside:
                solid = None
        if found.rows is None:
            found.rows = solid
        elif solid is not None:
            found.rows |= solid
    return found


def _filled(
    cutter: _Cutter, grid: _Grid, index: int, rule: int, hairlines: bool, found: _Found
) -> NDArray[np.uint64] | None:
    """Rows of one layer of one surface, None if the layer does not cut it. `found` gets its gaps and hairlines."""
    rows = np.zeros(grid.shape, np.uint64)
    if cutter.closed:
        chosen, plane = cutter.facets(index), cutter.planes[index]
        count, hairline_px, middles = fill_cut(
            cutter.points, cutter.faces, chosen, plane, grid.width, rule, hairlines, rows
        )
        if not count:
            return None
    else:
        segments = cutter.segments(index)
        if not len(segments):
            return None
        segments, lengths_mm = close_gaps(segments, grid.pitch)
        if len(lengths_mm):
            found.gaps.append(Gaps(len(lengths_mm), float(lengths_mm.max())))
        hairline_px = fill(segments, grid.width, rule, hairlines, rows)
        middles = small_pieces(segments, rows) if hairlines else np.empty((0, 2), np.int64)
    found.hairline_px += hairline_px
    if len(middles):
        found.middles.append(middles)
    return rows


def _rescued(
    sheets: Sheets, grid: _Grid, index: int, rows: NDArray[np.uint64] | None, found: _Found
) -> NDArray[np.uint64] | None:
    """The same rows with what the mid-plane misses."""
    if not sheets.near(index):
        return rows
    rows = np.zeros(grid.shape, np.uint64) if rows is None else rows
    added, lost = sheets.rescue(index, rows)
    found.sheet_px += added
    found.sheets_lost += lost
    return rows


def _frame(
    mesh: Mesh, pitch: tuple[float, float], margin_mm: float, frame_px: tuple[int, int] | None
) -> tuple[int, int, tuple[float, float]]:
    """(width, height, origin): pixel edges lie on whole multiples of the pitch, so boxes drawn on it stay exact."""
    (x0, y0, _), (x1, y1, _) = mesh.bounds_mm.tolist()
    if frame_px is None:
        left = _floor((x0 - margin_mm) / pitch[0])
        top = -_floor(-(y1 + margin_mm) / pitch[1])
        width = -_floor(-(x1 + margin_mm) / pitch[0]) - left
        height = top - _floor((y0 - margin_mm) / pitch[1])
    else:
        width, height = frame_px
        if x1 - x0 > width * pitch[0] * (1 + 1e-9) or y1 - y0 > height * pitch[1] * (1 + 1e-9):
            raise InputError(
                f"{mesh.name}: the part is {x1 - x0:.4g} × {y1 - y0:.4g} mm,"
                f" the printer's area {width * pitch[0]:.4g} × {height * pitch[1]:.4g} mm"
            )
        left = round((x0 + x1) / 2 / pitch[0] - width / 2)
        top = round((y0 + y1) / 2 / pitch[1] + height / 2)
    width, height = max(width, 1), max(height, 1)
    if width * height > MAX_FRAME_PX:
        raise InputError(
            f"{mesh.name}: {x1 - x0:.4g} × {y1 - y0:.4g} mm in pixels of {format_mm(min(pitch))} is a layer of"
            f" {width} × {height} px, above the limit of {MAX_FRAME_PX}; use larger pixels"
        )
    return width, height, (left * pitch[0], top * pitch[1])


def _floor(value_px: float) -> int:
    """Floor of what is snapped as the vertices are: a part read from 32-bit floats has the same frame."""
    return math.floor(round(value_px * SNAP_PER_PX) / SNAP_PER_PX)


def _layers(mesh: Mesh, layer_mm: float, first_layer_mm: float | None, z_sampling: ZSampling) -> NDArray[np.float64]:
    """Bounds of the layers whose mid-plane is inside the part; one at least."""
    layer_bounds_mm(1, layer_mm, first_layer_mm)  # checks both heights
    first = layer_mm if first_layer_mm is None else first_layer_mm
    x, y, z = mesh.size_mm
    if min(x, y, z) <= 0:
        raise InputError(f"{mesh.name}: the part is {x:.4g} × {y:.4g} × {z:.4g} mm; it has no thickness")
    share, words = (0.5, "half") if z_sampling == "middle" else (LEAST, "a quarter of")
    if z <= first * share:
        raise InputError(
            f"{mesh.name}: the part is {format_mm(z)} tall, under {words} the first layer of {format_mm(first)};"
            " use a smaller layer height"
        )
    count = 1 + max(0, math.ceil(round((z - first) / layer_mm, 4) - 0.5))
    if count > 1_000_000:
        raise InputError(f"{mesh.name}: {z:.4g} mm in layers of {format_mm(layer_mm)} is {count} layers")
    return layer_bounds_mm(count, layer_mm, first_layer_mm)


def _cutter(mesh: Mesh, grid: _Grid) -> _Cutter:
    z_mm = grid.z_mm
    quantum = _quantum(z_mm)
    points = np.empty_like(mesh.vertices)
    for start in range(0, len(points), CHUNK):
        vertices, out = mesh.vertices[start : start + CHUNK], points[start : start + CHUNK]
        out[:, 0] = (vertices[:, 0] - grid.origin[0]) / grid.pitch[0] - 0.5
        out[:, 1] = (grid.origin[1] - vertices[:, 1]) / grid.pitch[1] - 0.5
        out[:, :2] = np.round(out[:, :2] * SNAP_PER_PX) / SNAP_PER_PX
        out[:, 2] = np.round((vertices[:, 2] - grid.lowest_mm) / quantum)
    planes = np.round(z_mm.mean(axis=1) / quantum, 1)
    faces = without_doubles(points, mesh.faces)
    closed = edges_balance(points, faces)
    if not closed:
        faces = orient(points, faces)
        closed = edges_balance(points, faces)
    starts, chosen = bucket(points, faces, planes, SLAB_LAYERS)
    return _Cutter(points, faces, planes, z_mm / quantum, starts, chosen, closed)


def pixels_and_planes(
    mesh: Mesh,
    *,
    pixel_mm: tuple[float, float],
    layer_mm: float,
    first_layer_mm: float | None,
    margin_mm: float,
) -> tuple[int, int, tuple[float, float], NDArray[np.float64], float, NDArray[np.float64]]:
    """(width, height, origin, layers' bounds, z quantum, mid-planes in quanta) that `slice_mesh` takes for a mesh.

    For those who cut one thousands of times and need no Layers.
    """
    width, height, origin = _frame(mesh, pixel_mm, margin_mm, None)
    z_mm = _layers(mesh, layer_mm, first_layer_mm, "middle")
    quantum = _quantum(z_mm)
    return width, height, origin, z_mm, quantum, np.round(z_mm.mean(axis=1) / quantum, 1)


def _quantum(z_mm: NDArray[np.float64]) -> float:
    """What z is counted in: a decimal fraction of the lowest layer."""
    return float(10.0 ** (math.floor(math.log10(float((z_mm[:, 1] - z_mm[:, 0]).min()))) - 4))
