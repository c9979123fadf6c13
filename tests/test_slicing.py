"""Mesh to layers: exact on the grid, within 0.2 % of the formula off it, and sane on broken meshes.

A pixel is solid where its centre is, so a circle of R px anywhere on the grid is off by about 0.8 √R px by
luck alone (twice that where it is centred on a pixel or a corner, and all quadrants share their luck).
0.2 % of its area is four times the luck from 130 px across on; smaller sections are held to four times the
luck instead, and one test counts the centres themselves, which leaves nothing to luck.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from layerfix.errors import InputError
from layerfix.mesh import slicing
from layerfix.mesh.load import load_mesh
from layerfix.mesh.triangles import Mesh
from tests.making import (
    box,
    chosen_faces,
    cone,
    cylinder,
    inside_out,
    joined,
    revolved,
    soup,
    sphere,
    thin_part,
    torus,
    turned,
    write_stl,
)

# What mid-planes meet, and no more; the rest is in tests/test_sheets.py.
slice_mesh = partial(slicing.slice_mesh, z_sampling="middle")

LUCK = 0.82  # px per root of a px of radius: standard deviation of a circle's pixel count
ANYWHERE = (0.0137, 0.0291, 0.0)  # mm: no symmetry with any of the grids


def images(mesh: Mesh, **options) -> np.ndarray:
    """(layers, H, W) bool of the whole stack."""
    return np.array([layer.image() for layer in slice_mesh(mesh, **options)])


def areas_px(mesh: Mesh, **options) -> tuple[np.ndarray, np.ndarray]:
    """Solid pixels of each layer, and each layer's mid-plane in mm above the lowest point."""
    stack = slice_mesh(mesh, **options)
    return np.array([layer.count_px() for layer in stack]), stack.z_mm.mean(axis=1)


def check_areas(counted: np.ndarray, true_px: np.ndarray, radius_px: np.ndarray) -> None:
    """Every layer within 0.2 % (or four times its luck, see above), the sum of all within 0.05 %."""
    allowed = np.maximum(0.002 * true_px, 4 * LUCK * np.sqrt(radius_px) + 1)
    off = np.abs(counted - true_px)
    worst = int(np.argmax(off / allowed))
    assert off[worst] <= allowed[worst], f"layer {worst}: {counted[worst]} px, truly {true_px[worst]:.1f}"
    large = radius_px >= 65  # 130 px across: 0.2 % is four times the luck
    assert (off[large] <= 0.002 * true_px[large]).all()
    assert counted.sum() == pytest.approx(true_px.sum(), rel=5e-4)


# Area against the formula ------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [(0, 0), (0.31, 0.77), (0.4, 0.15), (0.123, 0.042)])
@pytest.mark.parametrize("turn", [0, 0.1, 1])
def test_a_cylinder_has_the_area_of_its_circle(turn, place):
    """100 px across: every layer within 0.2 %, wherever it stands on the grid and however it is tessellated."""
    counted, _ = areas_px(cylinder(5, 3, turn=turn).moved([*np.multiply(place, 0.1), 0]), pixel_mm=0.1, layer_mm=0.1)
    assert len(counted) == 30
    assert counted == pytest.approx(np.pi * 50**2, rel=0.002)


@pytest.mark.parametrize("turn", [0, 0.002, 0.7])
@pytest.mark.parametrize(("pixel_mm", "layer_mm"), [(0.05, 0.05), ((0.019, 0.024), 0.05), (0.03, 0.2)])
def test_a_sphere_has_the_area_of_its_circles(pixel_mm, layer_mm, turn):
    """Every layer of a 12 mm sphere, on square and oblong pixels, from pole to pole."""
    radius = 6
    counted, z = areas_px(sphere(radius, turn=turn).moved(ANYWHERE), pixel_mm=pixel_mm, layer_mm=layer_mm)
    area_mm2 = np.pi * (radius**2 - (z - radius) ** 2)
    px = np.multiply(pixel_mm, 1)
    check_areas(counted, area_mm2 / np.prod([px, px] if px.ndim == 0 else px), np.sqrt(area_mm2 / np.pi) / px.max())


@pytest.mark.parametrize("turn", [0, 0.001, 2])
def test_a_cone_has_the_area_of_its_circles(turn):
    """Every layer of a cone, down to the tip."""
    counted, z = areas_px(cone(10, 12, turn=turn).moved(ANYWHERE), pixel_mm=0.05, layer_mm=0.1)
    radius_px = 10 * (1 - z / 12) / 0.05
    check_areas(counted, np.pi * radius_px**2, radius_px)


@pytest.mark.parametrize("turn", [0, 0.004, 1.1])
def test_a_torus_has_the_area_of_its_rings(turn):
    """Every layer of a torus: two circles, one of them a hole; their luck adds up."""
    counted, z = areas_px(torus(10, 4, turn=turn).moved(ANYWHERE), pixel_mm=0.05, layer_mm=0.1)
    half = np.sqrt(16 - (z - 4) ** 2)
    outer, inner = (10 + half) / 0.05, (10 - half) / 0.05
    check_areas(counted, np.pi * (outer**2 - inner**2), outer + inner)


@pytest.mark.parametrize("pitch", [(0.05, 0.05), (0.019, 0.024)])
def test_every_pixel_of_a_sphere_is_the_one_its_centre_says(pitch):
    """Each pixel centre inside the ball is solid, each outside is not; only the facets' 10 nm leave a doubt."""
    layers = slice_mesh(sphere(4, 1500, 750).moved(ANYWHERE), pixel_mm=pitch, layer_mm=0.1)
    x = layers.origin_mm[0] + (np.arange(layers.width) + 0.5) * pitch[0] - ANYWHERE[0]
    y = layers.origin_mm[1] - (np.arange(layers.height) + 0.5) * pitch[1] - ANYWHERE[1]
    doubtful = 0.6 * max(pitch) / 1024  # x and y are rounded to 1/1024 px
    for layer in layers[::9]:
        section = np.sqrt(max(16 - (sum(layer.z_mm) / 2 - 4) ** 2, 0))
        outside = np.hypot(x[None], y[:, None]) - section
        sure = np.abs(outside) > doubtful + 1e-5 * 4 / max(section, 0.1)
        assert np.array_equal(layer.image() & sure, (outside < 0) & sure)
        assert sure.mean() > 0.99


@pytest.mark.parametrize("degrees", [10, 37, 60])
def test_a_leaning_cylinder_has_the_area_of_its_ellipse(degrees):
    """Away from its ends, a cylinder that leans by an angle is cut in ellipses of area πR² / cos."""
    counted, z = areas_px(turned(cylinder(5, 60), "x", degrees), pixel_mm=0.05, layer_mm=0.2)
    lean = np.radians(degrees)
    ends = 10 * np.sin(lean)
    middle = (z > ends) & (z < 60 * np.cos(lean) - ends * 0.01)
    assert middle.sum() > 100
    assert counted[middle] == pytest.approx(np.pi * 100**2 / np.cos(lean), rel=0.002)


# Exact on the grid -------------------------------------------------------------------------------------

GRIDS = [
    ((0.05, 0.05), 0.05),
    ((0.019, 0.024), 0.05),
    ((0.1, 0.1), 0.1),
    ((0.1, 0.3), 0.03),
    ((0.035, 0.035), 0.025),
    ((0.0725, 0.0725), 0.15),
]


@pytest.mark.parametrize("in_a_file", [False, True])
@pytest.mark.parametrize("shift", [(0, 0, 0), (700, -333, 19), (-1234, 37, -411), (3, 3, 100_000)])
@pytest.mark.parametrize(("pitch", "layer_mm"), GRIDS)
def test_a_box_on_the_grid_is_exact(tmp_path, pitch, layer_mm, shift, in_a_file):
    """Decimals that have no exact binary form, shifted, in doubles or in an STL: exactly its pixels, every layer."""
    size, step = np.array([57, 131, 23]), np.array([*pitch, layer_mm])
    if in_a_file and shift[2] > 1000:
        shift = (3, 3, 1000)  # beyond, the 32-bit floats of STL are coarser than the grid
    low, high = np.round(shift * step, 6), np.round((shift + size) * step, 6)
    mesh = box(low, high)
    if in_a_file:
        mesh = load_mesh(write_stl(tmp_path / "box.stl", mesh), unit="mm")
    stack = slice_mesh(mesh, pixel_mm=pitch, layer_mm=layer_mm, margin_mm=3 * max(pitch))
    assert len(stack) == 23
    column = round((low[0] - stack.origin_mm[0]) / pitch[0])
    row = round((stack.origin_mm[1] - high[1]) / pitch[1])
    expected = np.zeros((stack.height, stack.width), bool)
    expected[row : row + 131, column : column + 57] = True
    assert expected.sum() == 57 * 131
    assert all(np.array_equal(layer.image(), expected) for layer in stack)


def test_three_tenths_over_a_tenth_is_three():
    """0.3 / 0.1 is 2.9999999999999996 in floats, and still three layers of three pixels."""
    assert images(box([0, 0, 0], [0.3, 0.3, 0.3]), pixel_mm=0.1, layer_mm=0.1, margin_mm=0).all()
    assert images(box([0, 0, 0], [0.3, 0.3, 0.3]), pixel_mm=0.1, layer_mm=0.1, margin_mm=0).shape == (3, 3, 3)
    step = 0.1 + 0.2  # 0.30000000000000004
    assert images(box([0, 0, 0], [step] * 3), pixel_mm=0.1, layer_mm=0.1, margin_mm=0).shape == (3, 3, 3)


@given(
    st.lists(
        st.tuples(*[st.tuples(st.integers(0, 15), st.integers(1, 8))] * 3, st.booleans()), min_size=1, max_size=6
    ),
    st.sampled_from([(0.05, 0.05, 0.05), (0.019, 0.024, 0.05), (0.1, 0.1, 0.3), (0.3, 0.7, 0.1)]),
    st.sampled_from(["nonzero", "even_odd", "positive"]),
)
@settings(deadline=None, max_examples=200)
def test_unions_of_boxes_are_what_their_voxels_are(blocks, step, fill):
    """Boxes on half pixels and half layers, overlapping, touching, some inside out: the winding number of each
    pixel's centre, counted in numpy, decides. A side that passes through centres belongs to one pixel only.
    """
    if any((*b[:3], not b[3]) in blocks for b in blocks):
        return  # a box and the same box inside out are a box drawn on both sides, see test_doubles.py
    corners = [(np.array([s for s, _ in b[:3]]), np.array([s + n for s, n in b[:3]]), b[3]) for b in blocks]
    bodies = [box(low * step / 2, high * step / 2) for low, high, _ in corners]
    mesh = joined(*(inside_out(m) if flip else m for m, (_, _, flip) in zip(bodies, corners, strict=True)))
    lowest = min(low[2] for low, _, _ in corners)
    if max(high[2] for _, high, _ in corners) - lowest < 2:
        return  # not as high as half a layer: refused, see below
    stack = slice_mesh(mesh, pixel_mm=step[:2], layer_mm=step[2], margin_mm=0, fill=fill, hairlines=False)
    left, top = round(stack.origin_mm[0] / step[0]), round(stack.origin_mm[1] / step[1])
    x = 2 * (left + np.arange(stack.width)) + 1
    y = 2 * (top - np.arange(stack.height)) - 1
    for k, layer in enumerate(stack):
        z = lowest + 2 * k + 1
        winding, crossed = np.zeros((2, stack.height, stack.width), int)
        for low, high, flip in corners:
            if not low[2] <= z < high[2]:
                continue
            inside = np.outer((low[1] < y) & (y <= high[1]), (low[0] <= x) & (x < high[0]))
            winding += np.where(inside, -1 if flip else 1, 0)
            crossed += inside
        expected = {"nonzero": winding != 0, "even_odd": crossed % 2 == 1, "positive": winding > 0}[fill]
        assert np.array_equal(layer.image(), expected)
        assert layer.gaps is None


@given(st.integers(0, 2**32 - 1), st.sampled_from(["nonzero", "even_odd", "positive"]))
@settings(deadline=None)
def test_random_tetrahedra_are_what_their_half_spaces_say(seed, fill):
    """Tetrahedra of any shape, overlapping, some inside out: pixel centres are tested against their four planes.

    Centres nearer to a plane than the rounding of the grid (1/1024 px) are left out.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 3, (rng.integers(1, 5), 4, 3))
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    mesh = joined(*(Mesh(p, faces) for p in points))
    stack = slice_mesh(mesh, pixel_mm=(0.05, 0.07), layer_mm=0.1, margin_mm=0.1, fill=fill, hairlines=False)
    x = stack.origin_mm[0] + (np.arange(stack.width) + 0.5) * 0.05
    y = stack.origin_mm[1] - (np.arange(stack.height) + 0.5) * 0.07
    z = stack.z_mm.mean(axis=1) + mesh.bounds_mm[0, 2]
    centres = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1)
    winding, crossed = np.zeros((2, *centres.shape[:3]), int)
    sure = np.ones(centres.shape[:3], bool)
    for tetrahedron in points:
        a, b, c = (tetrahedron[faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        outwards = np.sign(np.einsum("i,i", normals[0], a[0] - tetrahedron.mean(axis=0)))
        distance = centres @ normals.T - (normals * a).sum(axis=1)
        inside = (distance * outwards < 0).all(axis=-1)
        winding += np.where(inside, int(outwards), 0)
        crossed += inside
        sure &= (np.abs(distance) > 1e-4).all(axis=-1)
    expected = {"nonzero": winding != 0, "even_odd": crossed % 2 == 1, "positive": winding > 0}[fill]
    assert np.array_equal(np.array([layer.image() for layer in stack]) & sure, expected & sure)


# Vertices, edges and faces exactly on planes --------------------------------------------------------------


@pytest.mark.parametrize("step_mm", [0.05, 0.1, 0.025])
def test_stairs_that_end_on_planes(step_mm):
    """Stairs whose treads lie on layer boundaries, on every plane, or on every second plane and boundary."""
    steps = [box([k, 0, 0], [k + 1, 1, (k + 1) * step_mm]) for k in range(12)]
    stack = slice_mesh(joined(*steps), pixel_mm=0.1, layer_mm=0.05, margin_mm=0.2)
    for layer in stack:
        plane = sum(layer.z_mm) / 2
        standing = sum((k + 1) * step_mm > plane + 1e-9 for k in range(12))
        assert layer.count_px() == 100 * standing
        assert layer.gaps is None


def test_boxes_stacked_face_to_face_on_a_plane_are_one():
    """Two boxes that meet in a mid-plane, and two that meet in a boundary, leave no empty and no doubled layer."""
    for height in (0.325, 0.35):
        mesh = joined(box([0, 0, 0], [2, 2, height]), box([0.5, 0.5, height], [1.5, 1.5, 1]))
        counted, z = areas_px(mesh, pixel_mm=0.1, layer_mm=0.05)
        assert counted.tolist() == [400 if plane < height - 1e-9 else 100 for plane in z]


@pytest.mark.parametrize("apex", [1.0, 1.025, 1.05])
def test_a_double_cone_pinched_to_a_point(apex):
    """An hour-glass whose waist is a single vertex, on a boundary, on a mid-plane, on a boundary again."""
    mesh = joined(revolved([1, 0], [0, apex], 64), revolved([0, 1], [apex, 2], 64))
    stack = slice_mesh(mesh, pixel_mm=0.02, layer_mm=0.05)
    counted = np.array([layer.count_px() for layer in stack])
    assert len(counted) == 40
    z = stack.z_mm.mean(axis=1)
    radius_px = np.where(z < apex, 1 - z / apex, (z - apex) / (2 - apex)) / 0.02
    assert np.abs(counted - np.pi * radius_px**2).max() < 0.002 * np.pi * 50**2 + 8 * LUCK * np.sqrt(50)
    assert counted.min() <= 4
    assert all(layer.gaps is None for layer in stack)


def test_edges_through_pixel_centres_take_each_pixel_once():
    """Four boxes that meet in the middle of a pixel fill the square without a gap and without an overlap."""
    c = 0.55  # the centre of pixel 5
    quarters = [box([x0, y0, 0], [x1, y1, 1]) for x0, x1 in ((0, c), (c, 1)) for y0, y1 in ((0, c), (c, 1))]
    assert images(joined(*quarters), pixel_mm=0.1, layer_mm=0.1, margin_mm=0, fill="even_odd").all()
    alone = [areas_px(q, pixel_mm=0.1, layer_mm=0.1)[0][0] for q in quarters]
    assert sum(alone) == 100


def test_slopes_through_pixel_centres_take_each_pixel_once():
    """Two wedges that share a diagonal through pixel centres make up their box exactly, under every rule."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    wedges = []
    for corners in ([0, 1, 2], [0, 2, 3]):
        points = np.column_stack([np.tile(square[corners], (2, 1)), np.repeat([0, 1], 3)])
        faces = [[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]]
        wedges.append(Mesh(points, np.array(faces)))
    for fill in ("nonzero", "even_odd", "positive"):
        assert images(joined(*wedges), pixel_mm=0.05, layer_mm=0.1, margin_mm=0, fill=fill).all()


# Shells --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("fill", "expected"), [("nonzero", 150), ("even_odd", 100), ("positive", 150)])
def test_overlapping_shells(fill, expected):
    """Two boxes that overlap by half unite, unless every second shell is to be a hole."""
    mesh = joined(box([0, 0, 0], [1, 1, 1]), box([0.5, 0, 0], [1.5, 1, 1]))
    assert set(areas_px(mesh, pixel_mm=0.1, layer_mm=0.1, fill=fill)[0]) == {expected}


@pytest.mark.parametrize("fill", ["nonzero", "even_odd", "positive"])
def test_a_cavity_is_hollow_under_every_rule(fill):
    """A shell that faces inwards inside one that faces outwards is a hole."""
    mesh = joined(box([0, 0, 0], [3, 3, 3]), inside_out(box([1, 1, 1], [2, 2, 2])))
    counted, z = areas_px(mesh, pixel_mm=0.1, layer_mm=0.1, fill=fill)
    assert counted.tolist() == [800 if 1 < plane < 2 else 900 for plane in z]


@pytest.mark.parametrize(("fill", "expected"), [("nonzero", 400), ("even_odd", 400), ("positive", 0)])
def test_an_inverted_mesh(fill, expected):
    """A mesh that is inside out as a whole is as solid as any, but not where only outward shells count."""
    counted, _ = areas_px(inside_out(box([0, 0, 0], [2, 2, 2])), pixel_mm=0.1, layer_mm=0.1, fill=fill)
    assert set(counted) == {expected}


# Broken meshes ---------------------------------------------------------------------------------------------

BROKEN = {
    "sphere": (sphere(10, 120, 60), 4 / 3 * np.pi * 1000),
    "torus": (torus(10, 4, 150, 60), 2 * np.pi**2 * 10 * 16),
    "cone": (revolved(np.linspace(10, 0, 40), np.linspace(0, 20, 40), 120), np.pi * 100 * 20 / 3),
    "leaning torus": (turned(torus(10, 4, 150, 60), "x", 30), 2 * np.pi**2 * 10 * 16),
}


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("share", [0.01, 0.1])
@pytest.mark.parametrize("name", BROKEN)
def test_missing_triangles_are_bridged(name, share, seed):
    """With 1 % or 10 % of the triangles gone the volume is within 0.5 %, and each layer says what it closed."""
    mesh, _ = BROKEN[name]
    options = {"pixel_mm": 0.1, "layer_mm": 0.2}
    whole = slice_mesh(mesh, **options)
    keep = np.random.default_rng(seed).random(len(mesh.faces)) >= share
    edge_mm = np.linalg.norm(np.diff(mesh.vertices[mesh.faces], axis=1), axis=2).max()
    stack = slice_mesh(chosen_faces(mesh, keep), **options)
    assert stack.volume_mm3() == pytest.approx(whole.volume_mm3(), rel=0.005)
    gaps = [layer.gaps for layer in stack if layer.gaps]
    assert len(gaps) > 0.5 * len(stack)
    assert all(g.count >= 1 for g in gaps)
    assert 0 < max(g.longest_mm for g in gaps) < 6 * edge_mm


@pytest.mark.parametrize("name", BROKEN)
def test_loose_triangles_with_noise_are_joined(name):
    """Triangles that share no vertex and miss each other by up to 20 µm still enclose the volume within 0.5 %."""
    mesh, _ = BROKEN[name]
    options = {"pixel_mm": 0.1, "layer_mm": 0.2}
    loose = soup(mesh)
    noise = np.random.default_rng(5).uniform(-0.02, 0.02, loose.vertices.shape)
    stack = slice_mesh(Mesh(loose.vertices + noise, loose.faces), **options)
    assert stack.volume_mm3() == pytest.approx(slice_mesh(mesh, **options).volume_mm3(), rel=0.005)


@pytest.mark.parametrize("name", BROKEN)
def test_flipped_triangles_are_turned_before_slicing(name):
    """5 % of the triangles the wrong way round: the same bits as the sound mesh, and no gaps."""
    mesh, _ = BROKEN[name]
    flip = np.random.default_rng(7).random(len(mesh.faces)) < 0.05
    faces = np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces)
    options = {"pixel_mm": 0.1, "layer_mm": 0.2}
    stack = slice_mesh(Mesh(mesh.vertices, faces), **options)
    for flipped, sound in zip(stack, slice_mesh(mesh, **options), strict=True):
        assert flipped.gaps is None
        assert np.array_equal(flipped.rows, sound.rows)


def test_a_box_without_its_lid_is_still_solid():
    """A whole missing face that no plane cuts leaves no trace; a missing side is closed straight across."""
    mesh = box([0, 0, 0], [2, 2, 2])
    level = mesh.vertices[mesh.faces][:, :, 2]
    assert set(areas_px(chosen_faces(mesh, level.min(axis=1) < 2), pixel_mm=0.1, layer_mm=0.1)[0]) == {400}
    side = mesh.vertices[mesh.faces][:, :, 0].min(axis=1) == 2
    stack = slice_mesh(chosen_faces(mesh, ~side), pixel_mm=0.1, layer_mm=0.1)
    assert {layer.count_px() for layer in stack} == {400}
    assert all(layer.gaps.count == 1 and layer.gaps.longest_mm == pytest.approx(2, abs=1e-3) for layer in stack)


# The frame and the layers ------------------------------------------------------------------------------------


def test_row_0_is_the_back_and_column_0_the_left():
    """An L with its foot to the right and its post on the left, seen from above: y falls with the row."""
    mesh = joined(box([0, 0, 0], [3, 1, 1]), box([0, 1, 0], [1, 4, 1]))
    stack = slice_mesh(mesh, pixel_mm=1, layer_mm=1, margin_mm=0)
    assert stack[0].image().astype(int).tolist() == [[1, 0, 0], [1, 0, 0], [1, 0, 0], [1, 1, 1]]
    assert stack.origin_mm == (0, 4)


def test_the_margin_is_empty_and_as_wide_as_asked():
    """The frame is the part plus the margin on each side, in whole pixels of each axis."""
    stack = slice_mesh(box([10, 20, 0], [12, 23, 1]), pixel_mm=(0.1, 0.2), layer_mm=0.5, margin_mm=0.6)
    assert (stack.width, stack.height) == (20 + 12, 15 + 6)
    assert stack.origin_mm == pytest.approx((9.4, 23.6))
    image = stack[0].image()
    assert image[3:-3, 6:-6].all()
    assert image.sum() == 20 * 15


@pytest.mark.parametrize("pitch", [0.05, (0.019, 0.024), 0.1])
def test_the_frame_of_a_file_is_that_of_the_part(tmp_path, pitch):
    """STL rounds to 32 bits: a part that ends on a pixel's edge must not get a row or column more for it."""
    px, py = np.multiply(pitch, [1, 1])
    for columns, rows in ((577, 1154), (1153, 577), (2001, 1999)):
        mesh = box([0, 0, 0], [round(columns * px, 6), round(rows * py, 6), 1])
        loaded = load_mesh(write_stl(tmp_path / f"{columns}.stl", mesh))
        frames = [slice_mesh(m, pixel_mm=pitch, layer_mm=0.5, margin_mm=8 * max(px, py)) for m in (mesh, loaded)]
        assert len({(s.width, s.height, *s.origin_mm) for s in frames}) == 1


def test_a_panel_is_filled_from_its_middle():
    """With frame_px the frame is the panel and the part stands in its middle, to half a pixel."""
    stack = slice_mesh(box([500, -90, 0], [502, -87, 1]), pixel_mm=0.1, layer_mm=0.5, frame_px=(101, 60))
    assert (stack.width, stack.height) == (101, 60)
    rows, columns = np.nonzero(stack[0].image())
    assert (rows.min(), rows.max()) == (15, 44)
    assert (len(set(columns)), abs(columns.mean() - 50) <= 0.5) == (20, True)


def test_a_part_as_large_as_the_panel_fits_and_a_larger_one_names_both_sizes():
    """Exactly the panel's size fills it; more is refused."""
    full = slice_mesh(box([0.3, 0.3, 0], [10.3, 6.3, 1]), pixel_mm=0.1, layer_mm=0.5, frame_px=(100, 60))
    assert full[0].count_px() == 6000
    with pytest.raises(InputError, match=r"10\.1 × 6 mm.*10 × 6 mm"):
        slice_mesh(box([0, 0, 0], [10.1, 6, 1]), pixel_mm=0.1, layer_mm=0.5, frame_px=(100, 60))


@pytest.mark.parametrize(
    ("height", "first", "layers"),
    [(1, None, 10), (1.04, None, 10), (1.05, None, 10), (1.06, None, 11), (0.06, None, 1),
     (1, 0.2, 9), (0.2, 0.3, 1), (0.34, 0.3, 1), (0.36, 0.3, 2), (0.3, None, 3), (0.7, None, 7)],
)  # fmt: skip
def test_a_layer_counts_if_its_mid_plane_is_inside(height, first, layers):
    """The last layer is there if the part reaches past its middle."""
    stack = slice_mesh(box([0, 0, 5], [1, 1, 5 + height]), pixel_mm=0.1, layer_mm=0.1, first_layer_mm=first)
    assert len(stack) == layers
    assert all(layer.count_px() == 100 for layer in stack)


def test_the_first_layer_has_its_own_height():
    """z starts at 0 at the part's lowest point; the first top is the first layer's height."""
    stack = slice_mesh(box([0, 0, -7], [1, 1, -6]), pixel_mm=0.1, layer_mm=0.1, first_layer_mm=0.25)
    assert stack.z_mm[:3].tolist() == [[0, 0.25], [0.25, 0.35], [0.35, 0.45]]
    assert stack[1].z_mm == (0.25, 0.35)
    cut = slice_mesh(joined(box([0, 0, 0], [1, 1, 0.12]), box([0, 0, 0], [0.5, 1, 1])),
                     pixel_mm=0.1, layer_mm=0.1, first_layer_mm=0.25)  # fmt: skip
    assert [layer.count_px() for layer in cut][:2] == [50, 50]


@pytest.mark.parametrize("workers", [2, 8])
def test_the_bits_do_not_depend_on_the_workers(workers):
    """One thread, two or eight: the same rows, z's and gaps."""
    mesh = chosen_faces(BROKEN["torus"][0], np.arange(18000) % 50 != 7)
    one = list(slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.1).with_workers(1))
    many = list(slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.1).with_workers(workers))
    for a, b in zip(one, many, strict=True):
        assert (a.z_mm, a.gaps) == (b.z_mm, b.gaps)
        assert np.array_equal(a.rows, b.rows)


def test_any_layer_can_be_cut_alone():
    """A layer asked for by its index is the layer the whole run gives."""
    stack = slice_mesh(thin_part(), pixel_mm=0.05, layer_mm=0.05)
    everything = list(stack)
    for index in (0, 17, len(stack) - 1):
        assert np.array_equal(stack[index].rows, everything[index].rows)


def test_a_box_on_a_corner_has_no_gaps():
    """A cube balanced on its corner meets planes in triangles and hexagons, its volume within 0.1 %."""
    mesh = turned(turned(box([0, 0, 0], [10, 10, 10]), "z", 45), "x", 54.7356)
    stack = slice_mesh(mesh, pixel_mm=0.05, layer_mm=0.05)
    assert all(layer.gaps is None for layer in stack)
    assert stack.volume_mm3() == pytest.approx(1000, rel=0.001)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fill": "odd"}, "fill='odd' is not known; choose from even_odd, nonzero, positive"),
        ({"margin_mm": -1}, "margin -1 mm"),
        ({"margin_mm": float("nan")}, "margin nan mm"),
        ({"pixel_mm": 0}, "pixel pitch"),
        ({"pixel_mm": (0.1, -0.1)}, "pixel pitch"),
        ({"layer_mm": 0}, "layer height 0 mm"),
        ({"layer_mm": 0.1, "first_layer_mm": -0.1}, "layer height -0.1 mm"),
        ({"layer_mm": 5}, "1 mm tall, under half the first layer of 5 mm"),
        ({"layer_mm": 1e-7}, "10000000 layers"),
        ({"pixel_mm": 1e-5}, "use larger pixels"),
        ({"frame_px": (20.5, 20)}, "frame of (20.5, 20) px: it is two whole numbers"),
        ({"frame_px": (20,)}, "frame of (20,) px: it is two whole numbers"),
    ],
)
def test_unusable_numbers_are_named(options, message):
    """Every number is checked before any work, and the message repeats it."""
    with pytest.raises(InputError) as caught:
        slice_mesh(box([0, 0, 0], [1, 1, 1]), **{"pixel_mm": 0.1, "layer_mm": 0.1, **options})
    assert message in str(caught.value)


@pytest.mark.parametrize("axis", range(3))
def test_a_part_without_thickness_is_refused(axis):
    """A flat sheet, along any axis, has nothing to print."""
    high = np.ones(3)
    high[axis] = 0
    with pytest.raises(InputError, match="no thickness"):
        slice_mesh(box([0, 0, 0], high), pixel_mm=0.1, layer_mm=0.1)
