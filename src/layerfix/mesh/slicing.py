"""Mesh → LayerStack: cut at the layers' mid-planes, fill to pixels, exact at the pixel centres (`cutter`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from layerfix.bits import words_for
from layerfix.errors import InputError
from layerfix.layers.grey_image import GreyImage
from layerfix.layers.grey_source import GreySource
from layerfix.layers.topology import TopologyChange
from layerfix.mesh.closing import close_gaps
from layerfix.mesh.cutter import Cutter, Grid, cutter_of, fill_cut, frame_of, layers_of
from layerfix.mesh.fill import EVEN_ODD, NONZERO, POSITIVE
from layerfix.mesh.fill import fill as fill_pixels
from layerfix.mesh.joined import joined_pieces
from layerfix.mesh.pieces import contours_and_edges, fill_pieces
from layerfix.mesh.sheets import Sheets
from layerfix.mesh.triangles import Mesh
from layerfix.stack import Gaps, Layer, LayerStack, pitch_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

Fill = Literal["even_odd", "nonzero", "positive"]
ZSampling = Literal["rescue", "middle", "overlap"]
Z_SAMPLINGS: tuple[ZSampling, ...] = get_args(ZSampling)
FILLS: dict[Fill, int] = {"even_odd": EVEN_ODD, "nonzero": NONZERO, "positive": POSITIVE}
THRESHOLD, GREY_FLOOR = 128, 32  # of greys, as jobs are read


@dataclass(frozen=True, eq=False)
class _Piece:
    """A surface that is filled on its own, and (surface, whether its inside is kept) of each that bounds it."""

    cutter: Cutter
    rule: int
    hairlines: bool
    sheets: Sheets | None
    clips: tuple[tuple[Cutter, bool], ...]


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
    width, height, origin = frame_of(mesh, pitch, margin_mm, frame_px)
    z_mm = layers_of(mesh, layer_mm, first_layer_mm, rescued=z_sampling != "middle")
    grid = Grid(pitch, origin, (height, words_for(width)), width, float(mesh.bounds_mm[0, 2]), z_mm)
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
    grid = Grid(stack.pixel_mm, stack.origin_mm, shape, stack.width, lowest_mm, stack.z_mm)
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


def filled_as(stack: LayerStack) -> Fill:
    """The rule that a sliced stack was filled by; the usual one if it was not sliced."""
    sliced = _slicing_of(stack)
    rule = NONZERO if sliced is None else sliced.how[2]
    return next(fill for fill, number in FILLS.items() if number == rule)


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
    grid: Grid
    antialias: bool

    def __call__(self, index: int) -> Layer:
        found = _united(self.pieces, self.grid, index)
        bottom, top = self.grid.z_mm[index].tolist()
        rows = np.zeros(self.grid.shape, np.uint64) if found.rows is None else found.rows
        gaps = found.gaps
        whole = Gaps(sum(gap.count for gap in gaps), max(gap.longest_mm for gap in gaps)) if gaps else None
        source = self._greys(index, rows, found) if self.antialias and rows.any() else None
        return Layer(rows if source is None else source.seen, self.grid.width, (bottom, top), None, whole, source,
                     found.hairline_px, found.sheet_px, found.sheets_lost, small=found.small,
                     joined=self._joined(index, found, None if source is None else source.seen))  # fmt: skip

    def _joined(self, index: int, found: _Found, seen: NDArray[np.uint64] | None) -> tuple[TopologyChange, ...]:
        """Pieces of the section that are one with another in the layer (`layerfix.mesh.joined`).

        Bodies that unite are looked at together; what is clipped by another surface is not looked at.

        seen  the layer's pixels, if it has greys; else they are those of `found`
        """
        if found.rows is None:
            return ()
        suspects = found.suspects
        if seen is not None or len(self.pieces) > 1:
            rows = found.sections if seen is None else seen
            bodies = [piece for piece in self.pieces if piece.hairlines and not piece.clips]
            suspects = []
            for group in (
                [one for one in bodies if one.rule == NONZERO],
                *([o] for o in bodies if o.rule != NONZERO),
            ):
                cuts = [_segments_of(piece.cutter, self.grid, index)[0] for piece in group]
                if rows is not None and any(map(len, cuts)):
                    segments = np.concatenate(cuts)
                    suspects.append((segments, contours_and_edges(segments, rows), group[0].rule))
        (x, y), (px, py), z = self.grid.origin, self.grid.pitch, self.grid.z_mm[index].tolist()
        return tuple(
            TopologyChange(
                "merged",
                int(count),
                (x + (x0 + 0.5) * px, y - (y1 + 0.5) * py, x + (x1 + 0.5) * px, y - (y0 + 0.5) * py),
                area * px * py,
                (z[0], z[1]),
            )
            for suspect in suspects
            for count, area, x0, y0, x1, y1 in joined_pieces(*suspect).tolist()
        )

    def _greys(self, index: int, rows: NDArray[np.uint64], found: _Found) -> GreySource:
        """The layer's greys. What is thinner than a pixel or a layer stays as it is in `rows`."""
        from layerfix.layers.greys import solid_rows

        grey = _covered(self.pieces, self.grid, index)
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
    grid: Grid,
    rule: int,
    hairlines: bool,
    z_sampling: ZSampling,
    antialias: bool,
    share: float | None,  # of a layer's height that is to be filled, for "overlap"
) -> _Sliced:
    pieces = _pieces(mesh, grid, rule, hairlines, z_sampling, share)
    how = mesh, grid, rule, hairlines, z_sampling, antialias, share
    return _Sliced(how, pieces, grid, antialias)


def _covered(pieces: list[_Piece], grid: Grid, index: int) -> GreyImage:
    """The greys of one layer of all pieces together."""
    from layerfix.mesh.coverage import coverage, coverage_in_words

    height, width = grid.shape[0], grid.width

    if len(pieces) == 1 and not pieces[0].clips:
        segments, _ = _segments_of(pieces[0].cutter, grid, index)
        return GreyImage(width, *coverage_in_words(segments, width, height, pieces[0].rule))
    out = np.zeros((height, width), np.uint8)
    for piece in pieces:
        grey = coverage(_segments_of(piece.cutter, grid, index)[0], width, height, piece.rule)
        for cutter, inside in piece.clips:
            clip = coverage(_segments_of(cutter, grid, index)[0], width, height, NONZERO)
            np.minimum(grey, clip if inside else 255 - clip, out=grey)
        np.maximum(out, grey, out=out)
    return GreyImage.of(out)


def _segments_of(cutter: Cutter, grid: Grid, index: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(segments of one layer of a surface, in closed contours; lengths of the gaps closed for that, in mm)."""
    segments = cutter.segments(index)
    return (segments, np.zeros(0)) if cutter.closed or not len(segments) else close_gaps(segments, grid.pitch)


def _pieces(
    mesh: Mesh, grid: Grid, rule: int, hairlines: bool, z_sampling: ZSampling, share: float | None
) -> list[_Piece]:
    """What is sliced on its own. A clip that bounds several parts is cut once a layer."""

    def piece(surface: Mesh, rule: int, clips: tuple[tuple[Cutter, bool], ...]) -> _Piece:
        cutter = cutter_of(surface, grid)
        size_px = grid.width, grid.shape[0]
        sheets = None
        if z_sampling != "middle" and cutter.closed:
            sheets = Sheets(cutter.points, cutter.faces, cutter.planes, cutter.bounds, size_px, rule, share=share)
        return _Piece(cutter, rule, hairlines, sheets, clips)

    if not mesh.parts:
        return [piece(mesh, rule, ())]
    cutters: dict[int, Cutter] = {}
    pieces = []
    for faces, part in mesh.pieces():
        clips = part.clips if part else ()
        for clip in clips:
            if id(clip.mesh) not in cutters:
                cutters[id(clip.mesh)] = cutter_of(clip.mesh, grid)
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
    suspects: list[tuple[NDArray[np.float64], tuple[NDArray[Any], ...], int]] = field(default_factory=list)
    sections: NDArray[np.uint64] | None = None  # of several bodies, without what mid-planes miss

    @property
    def small(self) -> NDArray[np.int64] | None:
        """Middles of small pieces, if there are any."""
        return np.concatenate(self.middles) if self.middles else None


def _united(pieces: list[_Piece], grid: Grid, index: int) -> _Found:
    """One layer of all pieces together."""
    found = _Found()
    clips: dict[int, NDArray[np.uint64] | None] = {}
    for piece in pieces:
        solid = _filled(piece.cutter, grid, index, piece.rule, piece.hairlines, found)
        if len(pieces) > 1 and solid is not None and not piece.clips:
            found.sections = solid.copy() if found.sections is None else found.sections | solid
        if piece.sheets is not None:
            if piece.sheets.share is not None:
                solid = np.zeros(grid.shape, np.uint64) if solid is None else solid
                found.sheet_px += piece.sheets.cover(index, solid, piece.cutter.segments(index))
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
    cutter: Cutter, grid: Grid, index: int, rule: int, hairlines: bool, found: _Found
) -> NDArray[np.uint64] | None:
    """Rows of one layer of one surface, None if the layer does not cut it. `found` gets its gaps and hairlines."""
    rows = np.zeros(grid.shape, np.uint64)
    if cutter.closed:
        chosen, plane = cutter.facets(index), cutter.planes[index]
        count, hairline_px, middles, may_join, segments, contours = fill_cut(
            cutter.points, cutter.faces, chosen, plane, grid.width, rule, hairlines, rows
        )
        if not count:
            return None
    else:
        segments, lengths_mm = _segments_of(cutter, grid, index)
        if not len(segments):
            return None
        if len(lengths_mm):
            found.gaps.append(Gaps(len(lengths_mm), float(lengths_mm.max())))
        if hairlines:
            hairline_px, middles, may_join, contours = fill_pieces(segments, grid.width, rule, rows)
        else:
            hairline_px, middles, may_join = fill_pixels(segments, grid.width, rule, False, rows), (), 0
    found.hairline_px += hairline_px
    if may_join:
        found.suspects.append((segments, contours, rule))
    if len(middles):
        found.middles.append(middles)
    return rows


def _rescued(
    sheets: Sheets, grid: Grid, index: int, rows: NDArray[np.uint64] | None, found: _Found
) -> NDArray[np.uint64] | None:
    """The same rows with what the mid-plane misses."""
    if not sheets.near(index):
        return rows
    rows = np.zeros(grid.shape, np.uint64) if rows is None else rows
    added, lost = sheets.rescue(index, rows)
    found.sheet_px += added
    found.sheets_lost += lost
    return rows
