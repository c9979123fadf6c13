"""C of a pose: the lean kernel counts what `correct` changes, bit for bit, in every layer."""

from __future__ import annotations

import math
import pickle
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import layerfix as lf
from layerfix.mesh.triangles import Clip, Mesh, Part
from layerfix.orientation.directions import AS_GIVEN, Pose
from layerfix.orientation.objective import Counts, Objective, Printing, spread_order, welded
from tests.making import box, chosen_faces, joined, soup, sphere, thin_part, turned

COARSE = Printing((0.1, 0.1), 0.1, 0.5)


def cage() -> Mesh:
    """Bars of 0.15 to 0.4 mm at odd angles, a ball and a thin wall: something of everything."""
    bars = [
        turned(turned(box([-0.1 * k, -0.1, -2], [0.1 * k + 0.05, 0.1, 2]), "x", 31 * k), "z", 47 * k) for k in (1, 2)
    ]
    return joined(*bars, sphere(0.9, 24, 12), box([1.0, -1.5, -1.2], [1.13, 1.5, 1.4]))


def changes_of(mesh: Mesh, printing: Printing) -> list[lf.Layer]:
    """The public way, layer by layer."""
    stack = lf.slice_mesh(mesh, pixel_mm=printing.pixel_mm, layer_mm=printing.layer_mm, z_sampling="middle",
                          first_layer_mm=printing.first_layer_mm, margin_mm=printing.min_feature_mm,
                          fill=printing.fill)  # fmt: skip
    fixed = lf.correct(stack, min_feature_mm=printing.min_feature_mm, mode=printing.mode, spurs=printing.spurs)
    return list(fixed)


def same(counts: Counts, layers: list[lf.Layer]) -> bool:
    """Whether counts are those of corrected layers."""
    rows = [(c.solid_px, c.added_px, c.removed_px) for c in (layer.change for layer in layers) if c is not None]
    return (counts.solid, counts.added, counts.removed) == tuple(np.sum(rows, axis=0)) and counts.first == rows[0]


PRINTINGS = {
    "metric": COARSE,
    "paper": Printing((0.1, 0.1), 0.1, 0.5, spurs="paper"),
    "add only": Printing((0.1, 0.1), 0.1, 0.44, mode="add_only"),
    "oblong": Printing((0.09, 0.13), 0.11, 0.62),
    "first layer": Printing((0.1, 0.1), 0.1, 0.3, first_layer_mm=0.25, fill="even_odd"),
}


@pytest.mark.parametrize("name", PRINTINGS)
@settings(max_examples=4)
@given(st.tuples(st.floats(-3, 3), st.floats(0, 3), st.floats(0, 3)))
def test_counts_are_those_of_correct(name, angles):
    """For any pose: of the part as it would be written, sliced and corrected by the public functions."""
    objective = Objective(cage(), PRINTINGS[name])
    pose = Pose(*angles)
    counts = objective.count(pose)
    layers = changes_of(objective.placed(pose), PRINTINGS[name])
    assert counts.whole
    assert counts.layers == len(layers)
    assert same(counts, layers)
    assert counts.added > 0


def test_volumes_are_those_of_correct():
    """In mm³, with a first layer of another height."""
    printing = PRINTINGS["first layer"]
    objective = Objective(cage(), printing)
    layers = changes_of(cage(), printing)
    areas = np.array([(c.solid_px, c.added_px, c.removed_px) for c in (layer.change for layer in layers)])
    heights = np.array([layer.z_mm[1] - layer.z_mm[0] for layer in layers])
    assert np.allclose(objective.volumes_mm3(objective.count(AS_GIVEN)), heights @ areas * 0.01)


@pytest.mark.parametrize("spurs", ["metric", "paper"])
def test_layers_with_nothing_lost_are_not_thinned_and_count_the_same(spurs):
    """A block on the grid loses nothing; one a little off does."""
    printing = Printing((0.1, 0.1), 0.1, 0.3, spurs=spurs)
    for part in (box([0, 0, 0], [2, 3, 1]), turned(box([0, 0, 0], [2, 3, 1]), "z", 20)):
        assert same(Objective(part, printing).count(AS_GIVEN), changes_of(part, printing))


def open_part() -> Mesh:
    """The thin part without one triangle."""
    return chosen_faces(thin_part(), np.arange(len(thin_part().faces)) != 14)


def doubled_part() -> Mesh:
    """The thin part with every triangle of its fin there twice, once each way."""
    part = thin_part()
    return Mesh(part.vertices, np.concatenate([part.faces, part.faces[12:, ::-1]]))


def clipped_part() -> Mesh:
    """A block of which a smaller one is cut out."""
    block = box([0, 0, 0], [3, 3, 2])
    hole = box([1.1, 0.3, -1], [2.6, 2.8, 3])
    return Mesh(block.vertices, block.faces, parts=(Part((0, len(block.faces)), (Clip(hole, inside=False),)),))


PARTS = {"open": open_part, "doubled": doubled_part, "clipped": clipped_part, "soup": lambda: soup(thin_part())}


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("pose", [AS_GIVEN, Pose(0.4, 1.1, 0.2)])
def test_broken_and_clipped_meshes_count_as_they_are_corrected(name, pose):
    """The kernel does not take them, or takes them as `slice_mesh` makes them whole."""
    objective = Objective(PARTS[name](), COARSE)
    assert same(objective.count(pose), changes_of(objective.placed(pose), COARSE))


def test_welded_meshes_are_closed_in_every_pose():
    """Vertices in one place become one; what is open, doubled or clipped is not taken for sound."""
    mesh, sound = welded(soup(thin_part()))
    assert sound
    assert len(mesh.vertices) == 16
    assert [welded(PARTS[name]())[1] for name in ("open", "doubled", "clipped")] == [False, False, False]


@pytest.mark.parametrize("layers", [1, 2, 3, 31, 32, 33, 500, 1472])
def test_the_first_layers_looked_at_are_spread_evenly(layers):
    """All layers once each; the first n leave no gap of more than about twice the mean."""
    order = spread_order(layers)
    assert sorted(order.tolist()) == list(range(layers))
    for n in (8, 32, 48):
        if n < layers:
            gaps = np.diff(np.concatenate([[-1], np.sort(order[:n]), [layers]]))
            assert gaps.max() <= 2.1 * layers / n + 1


@given(st.lists(st.integers(0, 60), min_size=1, max_size=4))
@settings(max_examples=8)
def test_parts_of_the_layers_add_up(cuts):
    """Counts of ranges are whole numbers whose sum is that of all, in any order."""
    objective = Objective(thin_part(), COARSE)
    pose = Pose(0.9, 0.3)
    edges = [0, *sorted(cuts), 10_000]
    parts = [objective.count(pose, a, b) for a, b in pairwise(edges)]
    total = parts[-1]
    for part in parts[-2::-1]:
        total = total.with_more(part)
    assert total == objective.count(pose)


def test_estimates_are_scaled_up():
    """Half of the layers of a part that is the same at every height tell of all."""
    objective = Objective(box([0, 0, 0], [2, 0.2, 3.2]), COARSE)
    half, whole = objective.count(AS_GIVEN, 0, 16), objective.count(AS_GIVEN)
    assert (half.seen, half.layers) == (16, 32)
    assert (half.estimate().added, half.estimate().removed) == (whole.added, whole.removed)
    assert whole.estimate() is whole


def test_upside_down_needs_the_same():
    """To the pixel where the part lies as symmetrically on the pixels both ways up, and F does (it is odd)."""
    objective = Objective(joined(box([0, 0, 0], [4, 3, 1]), box([0.6, 0.5, 1], [0.8, 2.5, 3])), COARSE)
    for pose in (AS_GIVEN, Pose(math.pi / 2, 0.0), Pose(math.pi / 2, math.pi / 2)):
        one, other = objective.count(pose), objective.count(pose.flipped())
        assert (one.added, one.removed) == (other.added, other.removed)


def test_upside_down_needs_about_the_same_at_any_angle():
    """Within what the raster moves."""
    objective = Objective(cage(), COARSE)
    pose = Pose(0.7, 1.9)
    one, other = objective.count(pose), objective.count(pose.flipped())
    assert abs(one.solid - other.solid) < 0.01 * one.solid
    assert abs(one.added + one.removed - other.added - other.removed) < 0.1 * (one.added + one.removed)


def test_what_is_placed_lies_on_the_plate():
    """Turned about its middle, its lowest point at 0; the transform does the same to its vertices; as given, x and y
    stay to the bit."""
    objective = Objective(cage(), COARSE)
    for pose in (AS_GIVEN, Pose(0.3, 2.0, 1.0), Pose(2.8, 1.0)):
        placed = objective.placed(pose)
        assert placed.bounds_mm[0, 2] == 0
        matrix = objective.placement(pose)
        ones = np.column_stack([objective.mesh.vertices, np.ones(len(objective.mesh.vertices))])
        assert np.allclose((ones @ matrix.T)[:, :3], placed.vertices, atol=1e-9)
        assert np.allclose(matrix[:3, :3], pose.matrix)
        assert math.isclose(objective.count(pose).height_mm, objective.height_mm(pose), abs_tol=1e-9)
        assert np.allclose(objective.size_mm(pose), placed.size_mm, atol=1e-9)
    assert np.array_equal(objective.placed(AS_GIVEN).vertices[:, :2], objective.mesh.vertices[:, :2])


def test_a_pose_too_low_for_a_layer_has_none():
    """A sheet of 0.04 mm on layers of 0.1 mm: nothing, not an error; on edge it counts."""
    objective = Objective(box([0, 0, 0], [3, 3, 0.04]), COARSE)
    assert objective.count(AS_GIVEN)[:2] == (0, 0)
    assert objective.count(Pose(math.pi / 2, 0)).layers == 30


def test_a_flat_part_is_refused():
    """By name: it has no build direction."""
    flat = Mesh(
        np.array([[0, 0, 0], [1, 0, 1], [0, 1, 1], [1, 1, 2.0]]), np.array([[0, 1, 2], [1, 3, 2]]), "leaf.stl"
    )
    with pytest.raises(lf.LayerfixError, match=r"leaf.stl: the part is flat"):
        Objective(flat, COARSE)


def test_what_is_pickled_counts_the_same():
    """And has the same name on any machine; another pitch, another name."""
    objective = Objective(thin_part(), COARSE)
    copy = pickle.loads(pickle.dumps(objective))
    assert copy.token == objective.token
    assert copy.count(Pose(1.0, 0.2)) == objective.count(Pose(1.0, 0.2))
    assert Objective(thin_part(), PRINTINGS["paper"]).token != objective.token


def test_a_stop_is_heard():
    """Between chunks of layers."""
    with pytest.raises(KeyboardInterrupt):
        Objective(thin_part(), COARSE).count(AS_GIVEN, stopped=lambda: True)
