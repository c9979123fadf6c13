"""The built-in parts: closed, outward, exactly as large as promised, and the same every time."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from layerfix.errors import InputError
from layerfix.samples import SAMPLES, sample
from layerfix.samples.shapes import boxes, cavity, join, mirrored, prism, rods, sheet, tube

if TYPE_CHECKING:
    from layerfix.mesh.triangles import Mesh

# Name, slices and image size in px: Table 1 of the paper.
TABLE = {
    "test-part": (65, (583, 597)),
    "molecule": (383, (513, 462)),
    "threaded-cylinder": (421, (623, 632)),
    "spherical-shell": (712, (795, 795)),
    "playground": (555, (1417, 1479)),
    "dragon": (687, (284, 253)),
    "helical-tower": (1472, (376, 382)),
}
every_sample = pytest.mark.parametrize("name", TABLE)


@cache
def drawn(name: str) -> Mesh:
    return sample(name).mesh()


def directed_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every edge of every triangle as one number, and the number of the same edge walked backwards."""
    start, end = faces.T.ravel().astype(np.int64), np.roll(faces, -1, axis=1).T.ravel().astype(np.int64)
    count = int(faces.max()) + 1
    return start * count + end, end * count + start


def body_volumes(mesh: Mesh) -> np.ndarray:
    """Signed volume in mm³ of each body, a body being what hangs together by its triangles."""
    a, b, c = mesh.faces.T
    count = len(mesh.vertices)
    links = coo_array((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, c]))), (count, count))
    _, body = connected_components(links, directed=False)
    x, y, z = (mesh.vertices[corner] for corner in (a, b, c))
    return np.bincount(body[a], np.einsum("ij,ij->i", x, np.cross(y, z)) / 6)


def winding_numbers(mesh: Mesh, x_mm: np.ndarray, y_mm: float, z_mm: float) -> np.ndarray:
    """How often the surface winds round each point of a row: signed crossings of upright rays above them."""
    triangles = mesh.vertices[mesh.faces] - [0.0, y_mm, z_mm]
    rows = triangles[(triangles[..., 1].min(axis=1) < 0) & (triangles[..., 1].max(axis=1) > 0)]
    a, b, c = ((rows[:, k, :2][:, None] - np.stack([x_mm, 0 * x_mm], axis=1)) for k in range(3))
    u, v, w = (p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0] for p, q in ((b, c), (c, a), (a, b)))
    area = u + v + w
    hit = (np.minimum(np.minimum(u, v), w) > 0) | (np.maximum(np.maximum(u, v), w) < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (u * rows[:, None, 0, 2] + v * rows[:, None, 1, 2] + w * rows[:, None, 2, 2]) / area
    return np.where(hit & (z > 0), np.sign(area), 0).sum(axis=0)


def test_the_samples_are_those_of_table_1():
    assert {each.name: (each.slices, each.image_px) for each in SAMPLES.values()} == TABLE
    assert all(each.name == name for name, each in SAMPLES.items())


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(InputError, match=r"no sample named 'benchy'; known are test-part, .*helical-tower"):
        sample("benchy")


@every_sample
def test_the_box_is_the_frame_without_its_margin(name):
    each = sample(name)
    width, height = each.image_px
    high = [
        (width - 2 * each.margin_px) * each.pixel_mm,
        (height - 2 * each.margin_px) * each.pixel_mm,
        each.slices * each.layer_mm,
    ]
    assert drawn(name).bounds_mm == pytest.approx(np.array([[0, 0, 0], high]), abs=1e-9)
    assert drawn(name).name == name


@every_sample
def test_the_raw_shape_is_stretched_by_less_than_2_percent(name):
    stretch = np.array(sample(name).size_mm) / sample(name).build().size_mm
    assert np.abs(stretch - 1).max() < 0.02


@every_sample
def test_every_body_is_closed_and_consistently_oriented(name):
    forwards, backwards = directed_edges(drawn(name).faces)
    assert len(np.unique(forwards)) == len(forwards)
    assert np.array_equal(np.sort(forwards), np.sort(backwards))


@every_sample
def test_the_mesh_is_closed_when_equal_vertices_are_one(name):
    _, place = np.unique(drawn(name).vertices, axis=0, return_inverse=True)
    forwards, backwards = directed_edges(place[drawn(name).faces])
    assert np.array_equal(np.sort(forwards), np.sort(backwards))


@every_sample
def test_bodies_face_outwards_but_for_the_hollows(name):
    volumes = body_volumes(drawn(name))
    hollows = {"spherical-shell": 1, "helical-tower": 1}.get(name, 0)
    assert np.count_nonzero(volumes < 0) == hollows
    assert np.abs(volumes).min() > 0
    assert drawn(name).volume_mm3 > 0


@every_sample
def test_no_point_is_inside_out(name):
    mesh = drawn(name)
    size = np.array(mesh.size_mm)
    x = np.linspace(0.003, 0.997, 120) * size[0]
    places = [(0.37, 0.04), (0.52, 0.31), (0.63, 0.72)]
    rows = [winding_numbers(mesh, x, y * size[1], z * size[2]) for y, z in places]
    assert np.min(rows) >= 0
    assert np.max(rows) > 0


@every_sample
def test_no_triangle_is_without_area_and_no_vertex_without_a_triangle(name):
    mesh = drawn(name)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-6
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)


@every_sample
def test_two_builds_are_equal_bit_by_bit(name):
    again = sample(name).mesh()
    assert again.vertices.tobytes() == drawn(name).vertices.tobytes()
    assert again.faces.tobytes() == drawn(name).faces.tobytes()


def test_the_shell_is_as_thin_as_it_says_and_round():
    mesh = drawn("spherical-shell")
    radius = np.linalg.norm(mesh.vertices - np.array(mesh.size_mm) / 2, axis=1)
    inner, outer = radius[radius < radius.mean()], radius[radius > radius.mean()]
    assert np.ptp(inner) < 0.06
    assert outer.mean() - inner.mean() == pytest.approx(0.35, abs=0.01)


def test_shapes_have_the_volume_of_their_formula():
    assert boxes([[0, 0, 0]], [[1, 2, 3]]).volume_mm3 == pytest.approx(6)
    assert prism([(0, 0), (2, 0), (2, 1), (0, 1)], -1, 1).volume_mm3 == pytest.approx(4)
    cross = rods((0, 0, 0), [(0, 0, 5), (5, 0, 0)], 1, 256)
    assert cross.volume_mm3 == pytest.approx(2 * 5 * np.pi, rel=1e-3)
    cone = tube([(0, 0, 0), (1, 1, 1)], 3, 256, pointed=True)
    assert cone.volume_mm3 == pytest.approx(np.pi * 9 * np.sqrt(3) / 3, rel=1e-3)
    flat = np.stack(np.meshgrid([0, 1, 2], [0, 1, 2, 3], [0], indexing="ij"), axis=-1)[:, :, 0]
    assert sheet(flat, 0.5).volume_mm3 == pytest.approx(3)


def test_mirroring_keeps_the_volume_and_a_cavity_takes_it_away():
    box = boxes([1, 0, 0], [2, 2, 3])
    assert mirrored(box).volume_mm3 == pytest.approx(6)
    assert mirrored(box).bounds_mm[0, 0] == -2
    assert join([boxes([0, -1, -1], [3, 3, 4]), cavity(box)]).volume_mm3 == pytest.approx(60 - 6)
