"""Pieces of a mesh that are one part of a layer: they are within two pixels of one another, and counted."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.measure import label

from layerfix import slice_mesh
from layerfix.bits import unpack
from layerfix.mesh.fill import EVEN_ODD, NONZERO, POSITIVE
from layerfix.mesh.joined import joined_pieces
from layerfix.mesh.pieces import contours_and_edges, fill_pieces
from layerfix.mesh.triangles import Clip, Mesh, Part
from tests.making import box, joined, run_layerfix, write_stl
from tests.test_coverage import segments_of

SIZE = 48


def some_polygon(rng: np.random.Generator) -> shapely.Polygon:
    """A wall, a pin, a ring, a frame: often thinner than a pixel, anywhere."""
    x, y = rng.uniform(4, SIZE - 4, 2)
    kind = rng.integers(4)
    if kind == 0:
        wall = shapely.box(-rng.uniform(0.5, 12), -rng.choice([0.05, 0.4, 1.2]), rng.uniform(0.5, 12), 0)
        wall = shapely.affinity.rotate(wall, rng.uniform(0, 360))
        return shapely.affinity.translate(wall, x, y)
    disc = shapely.Point(x, y).buffer(rng.choice([0.1, 0.6, 2.0, 6.0]), quad_segs=int(rng.integers(1, 5)))
    return disc if kind == 1 else disc.difference(disc.buffer(-rng.choice([0.05, 0.5])))


def joined_by_hand(shape: shapely.Geometry, rows: np.ndarray) -> int:
    """Each piece is in the raster, in one component of it."""
    return len(shapely.get_parts(shape)) - int(label(unpack(rows, SIZE), connectivity=2).max())


@settings(max_examples=400, deadline=None)
@given(st.integers(0, 10**9))
def test_as_many_as_shapely_says(seed):
    """Drawn one over another or apart, by the rules that unite what overlaps: pieces, less components."""
    rng = np.random.default_rng(seed)
    shapes = [shapely.intersection(some_polygon(rng), shapely.box(1, 1, SIZE - 2, SIZE - 2))
              for _ in range(rng.integers(1, 14))]  # fmt: skip
    shapes = [part for shape in shapes for part in shapely.get_parts(shape) if part.area > 1e-6]
    whole = shapely.union_all(shapes)
    segments = np.concatenate([segments_of(shapely.MultiPolygon([shape])) for shape in shapes])
    for rule, cut, pieces in (
        (NONZERO, segments, whole),
        (POSITIVE, segments, whole),
        (EVEN_ODD, segments_of(shapely.MultiPolygon([*shapely.get_parts(whole)])), whole),
    ):
        rows = np.zeros((SIZE, 1), np.uint64)
        cut = np.ascontiguousarray(rng.permutation(cut))
        more, contours = fill_pieces(cut, SIZE, rule, rows)[2:]
        expected = joined_by_hand(pieces, rows)
        found = joined_pieces(cut, contours_and_edges(cut, rows), rule)
        assert int((found[:, 0] - 1).sum()) == expected
        assert more or not expected
        if more:
            assert np.array_equal(found, joined_pieces(cut, contours, rule))


@pytest.mark.parametrize(
    "boxes",
    [
        [(5, 5, 15.2, 15.2), (15.5, 15.5, 15.7, 15.7)],
        [(10.6, 5, 20, 10.2), (5, 10.6, 10.2, 20)],
        [(5, 5, 10.2, 10.2), (10.6, 10.6, 20, 20)],
        [(2, 2, 5.2, 20), (5.5, 9.4, 5.6, 10.6)],
        [(2, 2, 20, 5.2), (9.4, 5.5, 10.6, 5.6)],
        [*((4 * k + 2, y, 4 * k + 3, y + 1) for k in range(11) for y in (24, 28, 32, 36, 40, 44)), (2, 2, 9, 9.2),
         (2, 9.6, 9, 15)],
    ],
    ids=["in a cell", "corner", "other corner", "along a row", "along a column", "more than are compared"],
)  # fmt: skip
@pytest.mark.parametrize("reversed_", [False, True])
def test_how_pieces_come_together(boxes, reversed_):
    """Two pieces are one; also if one of them, which is solid by the nonzero rule, is inside out."""
    cuts = [segments_of(shapely.box(*corners)) for corners in boxes]
    if reversed_:
        cuts[-1] = np.ascontiguousarray(cuts[-1][:, [2, 3, 0, 1]])
    rows = np.zeros((SIZE, 1), np.uint64)
    cut = np.concatenate(cuts)
    more, contours = fill_pieces(cut, SIZE, NONZERO, rows)[2:]
    assert more
    assert joined_pieces(cut, contours, NONZERO)[:, 0].tolist() == [2]


def two_fins(apart_mm: float) -> tuple:
    """Two walls that are far apart but for their ends, which come as near as that."""
    return box([0, 0, 0], [10, 1, 1]), box([9.5, 1 + apart_mm, 0], [10, 6, 1])


def test_where_they_are():
    """What grew together is told once a layer, at the smaller piece."""
    near, apart = (slice_mesh(joined(*two_fins(gap)), pixel_mm=0.1, layer_mm=0.2) for gap in (0.04, 0.3))
    assert [layer.joined for layer in apart] == [()] * 5
    for layer in near:
        (one,) = layer.joined
        assert (one.kind, one.count, one.z_mm) == ("merged", 2, layer.z_mm)
        assert one.box_mm == pytest.approx((9.5, 1.04, 10, 6), abs=1e-3)
        assert one.area_mm2 == pytest.approx(0.5 * 4.96, rel=1e-3)


def test_bodies_that_touch_or_overlap_are_one():
    """Nothing is joined by the raster where the surfaces say it is one piece, or a piece lies in another's solid."""
    for bodies in (
        (box([0, 0, 0], [2, 2, 1]), box([2, 0, 0], [4, 2, 1])),
        (box([0, 0, 0], [2, 2, 1]), box([1.95, 0.5, 0], [4, 1, 1])),
        (box([0, 0, 0], [4, 4, 1]), box([1, 1, 0.1], [2, 2, 0.9]), box([1.5, 1.5, 0.1], [3, 3, 0.9])),
    ):
        assert all(layer.joined == () for layer in slice_mesh(joined(*bodies), pixel_mm=0.1, layer_mm=0.2))


def test_without_hairlines_nobody_looks():
    """Only pixels whose centre is inside were asked for."""
    stack = slice_mesh(joined(*two_fins(0.04)), pixel_mm=0.1, layer_mm=0.2, hairlines=False)
    assert all(layer.joined == () for layer in stack)


def test_fix_and_check_tell(tmp_path):
    """In words with the place, and in JSON."""
    write_stl(tmp_path / "near.stl", joined(*two_fins(0.04)))
    fixed = run_layerfix(
        "fix", "near.stl", "out.zip", "--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.4mm", cwd=tmp_path
    )
    assert "pieces within two pixels of one another are" in fixed.out
    assert "x 9.50 to 10.00, y 1.04 to 6.00" in fixed.out
    checked = run_layerfix(
        "check", "near.stl", "--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.4mm", "--json", cwd=tmp_path
    )
    verdict = json.loads(checked.out)
    assert {one["count"] for one in verdict["joined"]} == {2}
    assert len(verdict["joined"]) == verdict["layers"] == len([one for one in verdict["by_layer"] if one["joined"]])


def test_parts_greys_and_clips():
    """Bodies of a file are looked at together, greys by what is solid; what is clipped is left out."""
    near, far = joined(*two_fins(0.04)), box([20, 0, 0], [21, 1, 1])
    whole = joined(near, far)
    halves = len(two_fins(0.04)[0].faces)
    parts = (Part((0, halves)), Part((halves, len(near.faces))), Part((len(near.faces), len(whole.faces))))
    as_parts = slice_mesh(Mesh(whole.vertices, whole.faces, parts=parts), pixel_mm=0.1, layer_mm=0.2)
    assert [one.count for layer in as_parts for one in layer.joined] == [2] * 5
    greys = slice_mesh(near, pixel_mm=0.1, layer_mm=0.2, antialias=True)
    assert [one.count for layer in greys for one in layer.joined] == [2] * 5
    clipped = Part(parts[2].faces, clips=(Clip(box([19, -1, -1], [20.5, 2, 2]), True),))
    with_clip = Mesh(whole.vertices, whole.faces, parts=(*parts[:2], clipped))
    assert [one.count for layer in slice_mesh(with_clip, pixel_mm=0.1, layer_mm=0.2) for one in layer.joined] == [
        2
    ] * 5


def test_a_sheet_between_joins_nothing():
    """What a mid-plane misses is put into a layer, but is none of its section."""
    walls = box([0, 0, 0], [1, 4, 1]), box([11, 0, 0], [12, 4, 1])
    plate = box([0.5, 1, 0.21], [11.5, 3, 0.28])
    whole = joined(*walls, plate)
    parts = tuple(Part((12 * k, 12 * k + 12)) for k in range(3))
    for mesh in (whole, Mesh(whole.vertices, whole.faces, parts=parts)):
        stack = slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2)
        assert any(layer.sheet_px for layer in stack)
        assert all(layer.joined == () for layer in stack)


def test_a_layer_that_is_moved_takes_its_places_along():
    """`Layer.at` moves them, too."""
    layer = slice_mesh(joined(*two_fins(0.04)), pixel_mm=0.1, layer_mm=0.2)[0]
    assert [one.z_mm for one in layer.at((3.0, 3.5)).joined] == [(3.0, 3.5)]
