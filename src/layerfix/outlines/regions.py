"""Outlines corrected in place: polygons in, polygons out, for a host that has already cut the part into layers.

A layer's regions (of several materials or settings) are corrected as one solid. Pixels decide where something is too
thin and what it becomes; polygons carry the result: around the pixels that changed, and one pixel further, the host's
outlines are united with (or cut to) the corrected ones. Everything else stays as it was, bit for bit: polygons that
were not touched are the same arrays, and regions that were not touched the same lists.

Only windows around places that are narrow (`layerfix.outlines.narrow`) are ever drawn as pixels. Their correction is
that of the whole layer: what F draws, and how far thinning reaches, ends within some widths of F. (Save for one
thing, to the better: parts closer together than two pixels hang together as pixels, and such a neck, which is none,
is not thickened.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.bits import pack, unpack, words_for
from layerfix.errors import InputError
from layerfix.layers.correction import MODES, Mode, correct
from layerfix.layers.feature import check_feature_mm
from layerfix.mesh.fill import NONZERO, fill
from layerfix.mesh.pieces import small_pieces
from layerfix.outlines.contours import outline
from layerfix.outlines.narrow import narrow_places
from layerfix.outlines.windows import Window, windows_of
from layerfix.stack import Layer, LayerStack
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from shapely import Geometry, MultiPolygon

    from layerfix.bits import Image, Rows

    Floats = NDArray[np.float64]

Outline = Sequence["NDArray[Any]"]  # a polygon: its outer ring, then its holes, (n, 2) int64 or float64
Region = Sequence[Outline]

SNAP_PER_PX = 1 << 20
MAX_FEATURE_PX, MAX_EDGES_PX = 1 << 13, 1 << 28
MAX_WINDOW_PX = 1 << 28  # pixels drawn at once: 32 MB an image


@dataclass(frozen=True)
class CorrectedRegions:
    """A layer's regions after correction.

    regions      as many as were given; the same list where a region did not change, and the same rings where a
                 polygon did not
    added_mm2    what came to them in all
    removed_mm2  what went (nothing in mode "add_only")
    """

    regions: list[Region]
    added_mm2: float = 0.0
    removed_mm2: float = 0.0

    @property
    def changed(self) -> bool:
        """Whether any region is another than before."""
        return self.added_mm2 > 0 or self.removed_mm2 > 0


def correct_regions(
    regions: Sequence[Region],
    *,
    min_feature_mm: float,
    pixel_mm: float | None = None,
    unit_mm: float = 1.0,
    mode: Mode = "add_only",
    keep_gaps_mm: float | None = None,
) -> CorrectedRegions:
    """One layer's polygons with everything narrower than `min_feature_mm` thickened to it.

    regions         one or more lists of polygons that do not overlap; a polygon is a list of rings, (n, 2) int64 or
                    float64 x, y: the outer one counter-clockwise, then its holes, clockwise. They are corrected as
                    one solid; what is added goes to the region whose solid is nearest, and no two overlap
    min_feature_mm  diameter of F, as in `correct`
    pixel_mm        how finely the layer is looked at (default: an eighth of F, at most 0.05 mm)
    unit_mm         size of the coordinates' unit: 1e-6 for slicers that count in nanometres
    mode            "add_only": nothing is taken away; "as_printed": corners are rounded as the tool rounds them, too
    keep_gaps_mm    what is to stay free between parts, and in holes
    returns         a `CorrectedRegions`. Farther than a pixel from what changed, corners are what they were, bit for
                    bit, and no others come (an edge that meets what changed gets a corner there); integers stay
                    integers
    raises          InputError for a feature, a pixel, a unit or a gap that cannot be, for rings that are no (n, 2)
                    arrays of at least three points, and for layers too large for the pixel
    """
    if not 0 < min_feature_mm < math.inf:
        raise InputError(f"minimum feature {min_feature_mm} mm: it must be above 0")
    pixel = pixel_mm if pixel_mm is not None else min(0.05, min_feature_mm / 8)
    _check(regions, min_feature_mm, pixel, unit_mm, mode)
    scale = unit_mm / pixel
    of_region = [_segments(region, scale) for region in regions]
    segments = np.concatenate([np.empty((0, 4)), *of_region])
    if not len(segments):
        return CorrectedRegions(list(regions))
    feature_px = min_feature_mm / pixel
    _check_size(segments, feature_px, pixel)
    # A wall of F_px + 1 pixels is whole, whatever its angle and wherever it lies between the pixels.
    places = narrow_places(segments, feature_px + 2.0) if mode == "add_only" else None
    patches: list[_Patch] = []
    for window in windows_of(places, segments, feature_px):
        if window.width * window.height > MAX_WINDOW_PX:
            raise InputError(
                f"a layer of {window.width} × {window.height} pixels of {format_mm(pixel)} is above the limit of"
                f" {MAX_WINDOW_PX}; use larger pixels"
            )
        found = change_in(window, segments, min_feature_mm, pixel, mode, keep_gaps_mm)
        if found is not None:
            patches.append(_patch(window, *found))
    if not patches:
        return CorrectedRegions(list(regions))
    return _applied(list(regions), patches, of_region, scale, unit_mm)


def _check(regions: Sequence[Region], min_feature_mm: float, pixel_mm: float, unit_mm: float, mode: str) -> None:
    if not 0 < pixel_mm < math.inf:
        raise InputError(f"pixel {pixel_mm} mm: it must be above 0")
    if not 0 < unit_mm < math.inf:
        raise InputError(f"unit {unit_mm} mm: it must be above 0")
    check_feature_mm(min_feature_mm, (pixel_mm, pixel_mm))
    if mode not in MODES:
        raise InputError(f"mode='{mode}' is not known; choose from {', '.join(MODES)}")
    for region in regions:
        for polygon in region:
            for ring in polygon:
                shape = getattr(ring, "shape", None)
                if shape is None or len(shape) != 2 or shape[1] != 2 or shape[0] < 3:
                    raise InputError(f"a ring is an (n, 2) array of three points or more, not {shape or type(ring)}")
                if not np.isfinite(ring).all():
                    raise InputError("a ring has coordinates that are no finite numbers")


def _check_size(segments: Floats, feature_px: float, pixel_mm: float) -> None:
    """Raises InputError for what no memory holds: a feature, or edges, of too many pixels."""
    if feature_px > MAX_FEATURE_PX:
        raise InputError(
            f"a minimum feature of {format_mm(feature_px * pixel_mm)} is {feature_px:.0f} pixels of"
            f" {format_mm(pixel_mm)}; at most {MAX_FEATURE_PX}: use larger pixels"
        )
    length_px = float(np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]).sum())
    if length_px > MAX_EDGES_PX:
        raise InputError(
            f"outlines of {format_mm(length_px * pixel_mm)} are {length_px:.3g} pixels of {format_mm(pixel_mm)} long;"
            f" at most {MAX_EDGES_PX}: use larger pixels"
        )


def _segments(region: Region, scale: float) -> Floats:
    """All edges as `layerfix.mesh.fill` takes them: in px from the origin, y down, centres at whole numbers."""
    rings = [ring for polygon in region for ring in polygon]
    if not rings:
        return np.empty((0, 4))
    points = np.concatenate(rings).astype(np.float64) * (scale, -scale) - 0.5
    # An edge at 45° passes exactly through centres: in every window, whose corner is taken off, on the same side.
    points = np.rint(points * SNAP_PER_PX) / SNAP_PER_PX
    stops = np.cumsum([len(ring) for ring in rings])
    following = np.arange(1, len(points) + 1)
    following[stops - 1] = np.concatenate([[0], stops[:-1]])
    segments = np.concatenate([points, points[following]], axis=1)
    edges: Floats = segments[(points != points[following]).any(axis=1)]
    return edges


@dataclass(frozen=True, eq=False)
class _Patch:
    """What changed in a window. Images are (h, w) bool of pixels from column `left`, row `top` of the grid."""

    left: int
    top: int
    after: Image  # the corrected layer
    grown: Image  # what was added, and the pixels beside it
    cut: Image  # what was taken away, and the pixels beside it


def _drawn(segments: Floats, window: Window) -> tuple[Rows, NDArray[np.int64]]:
    """(packed rows of a window; the middles of small pieces in it)."""
    low, high = np.minimum(segments[:, 1], segments[:, 3]), np.maximum(segments[:, 1], segments[:, 3])
    near = segments[(high >= window.top - 1) & (low < window.top + window.height)]  # to the right: spans end there
    near = np.ascontiguousarray(near - (window.left, window.top, window.left, window.top))
    rows = np.zeros((window.height, words_for(window.width)), np.uint64)
    fill(near, window.width, NONZERO, True, rows)
    middles = small_pieces(near, rows)
    inside = (middles >= 0).all(axis=1) & (middles < (window.height, window.width)).all(axis=1)
    return rows, middles[inside]


def change_in(
    window: Window, segments: Floats, min_feature_mm: float, pixel_mm: float, mode: Mode, keep_gaps_mm: float | None
) -> tuple[Image, Image] | None:
    """(what is solid in a window, which pixels a correction changes where changes count); None if none change."""
    rows, middles = _drawn(segments, window)
    if not rows.any():
        return None
    before = Layer(rows, window.width, (0.0, 1.0), small=middles if len(middles) else None)
    stack = LayerStack(
        window.width, window.height, (pixel_mm, pixel_mm), np.array([[0.0, 1.0]]), lambda _: before, workers=1
    )
    fixed = correct(stack, min_feature_mm=min_feature_mm, mode=mode, keep_gaps_mm=keep_gaps_mm)[0]
    change = fixed.rows ^ rows
    if window.inner is not None:
        change &= pack(window.inner)
    return (unpack(rows, window.width), unpack(change, window.width)) if change.any() else None


def _patch(window: Window, before: Image, change: Image) -> _Patch:
    """The part of a window around what changed."""
    import cv2

    def and_beside(image: Image) -> Image:
        return cv2.dilate(image.view(np.uint8), np.ones((3, 3), np.uint8)).view(np.bool_)

    ys, xs = np.flatnonzero(change.any(axis=1)), np.flatnonzero(change.any(axis=0))
    top, bottom, left, right = int(ys[0]) - 4, int(ys[-1]) + 5, int(xs[0]) - 4, int(xs[-1]) + 5
    room = max(0, -top, -left, bottom - before.shape[0], right - before.shape[1])
    box = np.s_[top + room : bottom + room, left + room : right + room]
    before, change = np.pad(before, room)[box], np.pad(change, room)[box]
    grown, cut = and_beside(change & ~before), and_beside(change & before)
    return _Patch(window.left + left, window.top + top, before ^ change, grown, cut)


def _polygons(image: Image, patch: _Patch, scale: float, tolerance_px: float) -> MultiPolygon:
    """The outlines of an image of a patch in the host's units."""
    import shapely

    layer = Layer(pack(image), image.shape[1], (0.0, 1.0))
    in_px = outline(layer, (1.0, 1.0), (patch.left, -patch.top), tolerance_px)
    return shapely.transform(in_px, lambda points: points / scale)


def _applied(
    regions: list[Region], patches: list[_Patch], segments: list[Floats], scale: float, unit_mm: float
) -> CorrectedRegions:
    """The regions with the patches put in."""
    import shapely

    whole = all(ring.dtype.kind in "iu" for region in regions for polygon in region for ring in polygon)
    grid = 1.0 if whole else 0.0
    grown: list[list[MultiPolygon]] = [[] for _ in regions]
    cut = []
    for patch in patches:
        solid = _polygons(patch.after, patch, scale, 0.5)
        if patch.cut.any():
            cut.append(_areas(shapely.difference(_polygons(patch.cut, patch, scale, 0.0), solid, grid_size=grid)))
        for cells, share in zip(_cells_of(patch, segments), grown, strict=True):
            if cells.any():
                pixels = _polygons(cells, patch, scale, 0.0)
                share.append(_areas(shapely.intersection(pixels, solid, grid_size=grid)))
    touched = [_touched(region, [*share, *cut]) for region, share in zip(regions, grown, strict=True)]
    bodies = [_body([*found.values()], grid) for found in touched]
    out: list[Region] = []
    added = removed = 0.0
    for k, (region, share, body) in enumerate(zip(regions, grown, bodies, strict=True)):
        left = _areas(shapely.difference(body, shapely.union_all(cut), grid_size=grid)) if cut else body
        more = _areas(shapely.union_all(share, grid_size=grid))
        for other in (*bodies[:k], *bodies[k + 1 :]):
            more = _areas(shapely.difference(more, other, grid_size=grid))
        if not cut and shapely.difference(more, body, grid_size=grid).area == 0:
            out.append(region)
            continue
        fixed = _areas(shapely.union(left, _without_crumbs(more, left, scale), grid_size=grid))
        removed += max(0.0, body.area - left.area)
        added += max(0.0, fixed.area - left.area)
        kept = [polygon for i, polygon in enumerate(region) if i not in touched[k]]
        out.append([*kept, *_rings(fixed, whole)])
    return CorrectedRegions(out, added * unit_mm**2, removed * unit_mm**2)


def _body(polygons: list[Geometry], grid: float) -> MultiPolygon:
    """Polygons of a region as one. They do not overlap; where they do not touch either, uniting (4 ms) is spared."""
    import shapely

    one = _areas(shapely.geometrycollections(polygons))
    return one if one.is_valid else _areas(shapely.union_all(polygons, grid_size=grid))


def _areas(shape: Geometry) -> MultiPolygon:
    """Only the polygons of what an overlay gave: where outlines touch, there may be lines and points among them."""
    import shapely

    parts = shapely.get_parts(shape)
    if len(parts) and (shapely.get_type_id(parts) > shapely.GeometryType.POLYGON).any():  # collections in collections
        parts = shapely.get_parts(shapely.union_all(parts))
    solid = (shapely.get_type_id(parts) == shapely.GeometryType.POLYGON) & ~shapely.is_empty(parts)
    return shapely.multipolygons(parts[solid])


def _cells_of(patch: _Patch, segments: list[Floats]) -> list[Image]:
    """Of the pixels of a patch in which something is added, those nearest to each region; the first of equals."""
    import cv2

    if len(segments) == 1:
        return [patch.grown]
    height, width = patch.grown.shape
    window = Window(patch.left, patch.top, width, height, None)
    whose = np.full((height, width), -1)
    for k in reversed(range(len(segments))):
        rows, _ = _drawn(segments[k], window)
        whose[unpack(rows, width)] = k
    seen = whose >= 0
    if not seen.any():
        return [patch.grown if k == 0 else np.zeros_like(patch.grown) for k in range(len(segments))]
    _, nearest = cv2.distanceTransformWithLabels(
        (~seen).view(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(nearest.max()) + 1, np.int64)
    of_label[nearest[seen]] = whose[seen]
    return [patch.grown & (of_label[nearest] == k) for k in range(len(segments))]


def _touched(region: Region, changes: list[MultiPolygon]) -> dict[int, Geometry]:
    """By number, the polygons of a region that meet one of the changes."""
    import shapely

    changes = [change for change in changes if not change.is_empty]
    found: dict[int, Geometry] = {}
    if not changes:
        return found
    bounds = shapely.bounds(changes)
    for i, polygon in enumerate(region):
        if not polygon:
            continue
        low, high = polygon[0].min(axis=0), polygon[0].max(axis=0)
        near = ((bounds[:, :2] <= high) & (bounds[:, 2:] >= low)).all(axis=1)
        if not near.any():
            continue
        shape = shapely.Polygon(polygon[0], polygon[1:])
        shape = shape if shape.is_valid else shapely.make_valid(shape)
        if any(shape.intersects(changes[k]) for k in np.flatnonzero(near)):
            found[i] = shape
    return found


def _without_crumbs(more: MultiPolygon, body: MultiPolygon, scale: float) -> MultiPolygon:
    """Only those parts that hang together with the region, or are larger than a pixel."""
    import shapely

    parts = shapely.get_parts(more)
    return shapely.multipolygons(parts[(shapely.area(parts) > scale**-2) | shapely.intersects(parts, body)])


def _rings(shapes: MultiPolygon, whole: bool) -> list[Outline]:
    """Polygons as lists of rings, the outer one counter-clockwise, holes clockwise."""
    import shapely

    out: list[Outline] = []
    for shape in shapely.get_parts(shapely.orient_polygons(shapes)):
        rings = [shapely.get_coordinates(ring)[:-1] for ring in (shape.exterior, *shape.interiors)]
        out.append([np.rint(ring).astype(np.int64) for ring in rings] if whole else rings)
    return out
