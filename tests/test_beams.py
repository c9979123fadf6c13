"""Beams and balls as solids: volumes by their formulas, closed shells that face outwards, sizes to the micrometre."""

from __future__ import annotations

import math

import numpy as np
import pytest

from layerfix import slice_mesh
from layerfix.errors import InputError
from layerfix.mesh.beams import sides_of, solid_beams
from layerfix.mesh.closing import edges_balance
from layerfix.mesh.model_3mf import Lattice
from layerfix.mesh.triangles import Mesh, Part

POINTS = np.array([[0, 0, 0], [0, 0, 10], [10, 0, 0], [6, 8, 0.0]])


def lattice(
    *beams: tuple[int, int, float, float, str, str], min_length: float = 1e-4, balls=("none", math.nan)
) -> Lattice:
    """Beams as (vertex, vertex, radius, radius, cap, cap)."""
    found = Lattice(1.0, min_length, "sphere", balls[0], balls[1], ("none", ""))
    for v1, v2, r1, r2, c1, c2 in beams:
        found.ends.extend((v1, v2))
        found.radii.extend((r1, r2))
        found.caps.append((c1, c2))
    return found


def mesh_of(found: Lattice, points=POINTS) -> Mesh:
    (vertices, faces), short = solid_beams(points, found, 1.0)
    assert short == 0
    return Mesh(vertices, faces, parts=(Part((0, len(faces)), united=True),))


def frustum(r1: float, r2: float, length: float) -> float:
    return math.pi * length * (r1 * r1 + r1 * r2 + r2 * r2) / 3


def ball(radius: float) -> float:
    return 4 / 3 * math.pi * radius**3


@pytest.mark.parametrize("end", [1, 2, 3])
@pytest.mark.parametrize(("r1", "r2"), [(1, 1), (2, 0.5), (0.3, 1.2)])
def test_a_beam_with_flat_ends_is_a_truncated_cone(end, r1, r2):
    """Upright, level and aslant: its volume by the formula, closed, facing outwards, and exactly as long."""
    mesh = mesh_of(lattice((0, end, r1, r2, "butt", "butt")))
    assert edges_balance(mesh.vertices, mesh.faces)
    assert mesh.volume_mm3 == pytest.approx(frustum(r1, r2, 10), rel=1e-9)
    along = (POINTS[end] - POINTS[0]) / 10
    reach = mesh.vertices @ along
    assert (reach.min(), reach.max()) == pytest.approx((0, 10), abs=1e-9)


@pytest.mark.parametrize("end", [1, 2, 3])
def test_half_spheres_at_the_ends(end):
    """Each adds half a ball of its own radius, outwards."""
    mesh = mesh_of(lattice((0, end, 2, 1, "hemisphere", "hemisphere")))
    assert edges_balance(mesh.vertices, mesh.faces)
    assert mesh.volume_mm3 == pytest.approx(frustum(2, 1, 10) + (ball(2) + ball(1)) / 2, rel=0.01)
    reach = mesh.vertices @ ((POINTS[end] - POINTS[0]) / 10)
    assert (reach.min(), reach.max()) == pytest.approx((-2, 11))


def test_each_end_has_its_own_cap():
    """A half sphere at one end, flat at the other; and a sphere that stands out over a thin end."""
    mesh = mesh_of(lattice((0, 1, 1, 1, "hemisphere", "butt")))
    assert (mesh.bounds_mm[:, 2].tolist()) == pytest.approx([-1, 10])
    mesh = mesh_of(lattice((0, 1, 1, 1, "butt", "sphere")))
    assert (mesh.bounds_mm[:, 2].tolist()) == pytest.approx([0, 11])
    assert mesh.volume_mm3 == pytest.approx(frustum(1, 1, 10) + ball(1), rel=0.01)  # shells that overlap count twice


def test_for_cylinders_spheres_and_half_spheres_are_the_same():
    """As the specification says; sliced, pixel by pixel, to the last few."""
    stacks = [
        slice_mesh(mesh_of(lattice((0, k, 1, 1, cap, cap))), pixel_mm=0.05, layer_mm=0.1)
        for cap in ("sphere", "hemisphere")
        for k in (3,)
    ]
    volumes = [stack.volume_mm3() for stack in stacks]
    assert volumes[0] == pytest.approx(volumes[1], rel=2e-3)
    assert volumes[0] == pytest.approx(frustum(1, 1, 10) + ball(1), rel=5e-3)


def test_beams_that_cross_unite():
    """Two beams from one point: its ball counts once, whatever the fill."""
    found = lattice(*[(0, k, 1, 1, "sphere", "sphere") for k in (1, 2)])
    volumes = {
        fill: slice_mesh(mesh_of(found), pixel_mm=0.05, layer_mm=0.1, fill=fill).volume_mm3()
        for fill in ("nonzero", "even_odd", "positive")
    }
    assert len(set(volumes.values())) == 1
    # Two rods that meet at a right angle share their ball and a quarter of the cylinders' common solid (16 / 3).
    shared = ball(1) + 16 / 3 / 4 - ball(1) / 4
    assert volumes["nonzero"] == pytest.approx(2 * (frustum(1, 1, 10) + ball(1)) - shared, rel=0.01)


@pytest.mark.parametrize(("mode", "count"), [("none", 0), ("mixed", 1), ("all", 2)])
def test_balls(mode, count):
    """None, those that are listed, or one at each end of a beam; a listed radius wins."""
    found = lattice((0, 1, 0.1, 0.1, "butt", "butt"), balls=(mode, 2.0))
    found.balls.append((1, 3.0))
    mesh = mesh_of(found)
    expected = frustum(0.1, 0.1, 10) + (ball(3) if count else 0) + (ball(2) if count == 2 else 0)
    assert mesh.volume_mm3 == pytest.approx(expected, rel=0.01)


def test_beams_that_are_too_short_are_counted():
    """The specification says to ignore them."""
    (_, faces), short = solid_beams(POINTS, lattice((0, 1, 1, 1, "butt", "butt"), min_length=10.5), 1.0)
    assert (len(faces), short) == (0, 1)
    (_, faces), short = solid_beams(POINTS, lattice((0, 0, 1, 1, "butt", "butt"), min_length=0), 1.0)
    assert (len(faces), short) == (0, 1)


@pytest.mark.parametrize(
    ("beam", "words"),
    [
        ((0, 4, 1, 1, "butt", "butt"), "vertex 4 of 4"),
        ((-1, 0, 1, 1, "butt", "butt"), "vertex -1"),
        ((0, 1, 0, 1, "butt", "butt"), "radius 0"),
        ((0, 1, 1, math.nan, "butt", "butt"), "radius nan"),
        ((0, 1, 1, math.inf, "butt", "butt"), "radius inf"),
        ((0, 1, 1, 1, "butt", "round"), "cap 'round'; known are sphere"),
    ],
)
def test_what_cannot_be_is_refused(beam, words):
    """Vertices, radii, caps."""
    with pytest.raises(InputError, match=words):
        solid_beams(POINTS, lattice(beam), 1.0)


def test_sides_follow_the_radius():
    """Thin beams need few; whoever prints thick ones sees more; a polygon is never further than 2 µm from its circle,
    up to 64 sides."""
    assert [sides_of(r) for r in (0.01, 0.25, 1.0, 5.0)] == [16, 28, 52, 64]
    for radius in (0.05, 0.25, 1.0):
        assert radius * (1 - math.cos(math.pi / sides_of(radius))) <= 0.002


def test_twelve_thousand_beams_are_made_at_once():
    """A random lattice: as many shells as beams and nodes, all closed."""
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 50, (4000, 3))
    pairs = rng.integers(0, 4000, (12000, 2)).tolist()
    found = lattice(*[(a, b, 0.1, 0.1, "sphere", "sphere") for a, b in pairs if a != b])
    (vertices, faces), _ = solid_beams(points, found, 1.0)
    assert len(faces) > 12000 * 16
    assert edges_balance(vertices, faces)
