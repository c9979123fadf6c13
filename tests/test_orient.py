"""The search for a build direction: methods and their laws, aims, the log, engines of one machine, pictures."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import layerfix as lf
from layerfix.commands.orient import lines_of
from layerfix.draw.sphere import sphere_map
from layerfix.mesh.triangles import Mesh
from layerfix.orientation.aims import AIMS, Shape, aims_for, check_weights
from layerfix.orientation.anneal import COLD, COOLINGS, HOT, REACH, Annealing, accepted, anneal, temperature
from layerfix.orientation.candidates import structured
from layerfix.orientation.directions import AS_GIVEN, Pose, axis_angle, fibonacci, pose_of
from layerfix.orientation.objective import CLOSE, Counts, Objective, Printing
from layerfix.orientation.outcome import non_dominated
from layerfix.orientation.search import Search, State
from layerfix.samples import sample
from tests.making import box, joined, thin_part, turned

HOW = {"pixel_mm": 0.25, "layer_mm": 0.25, "min_feature_mm": 0.75}


def leaning_fins() -> Mesh:
    """Three plates of 0.3 mm on a foot, all leaning by 25°: upright, or along them, nothing is too thin but edges."""
    fins = [box([-2 + 0.8 * k, -2, 0], [-1.7 + 0.8 * k, 2, 4]) for k in range(3)]
    return turned(joined(*fins, box([-2, -2, -0.8], [1, 2, 0.2])), "x", 25)


@pytest.fixture(scope="module")
def quick() -> lf.Orientation:
    """One search, looked at from many sides."""
    return lf.orient(leaning_fins(), method="quick", **HOW)


# What is found ------------------------------------------------------------------------------------------------


def test_the_best_is_what_correct_changes(quick):
    """C of the best pose is that of its mesh, sliced and corrected by the public functions."""
    stack = lf.slice_mesh(quick.mesh(), pixel_mm=0.25, layer_mm=0.25, margin_mm=0.75, z_sampling="middle")
    changes = [layer.change for layer in lf.correct(stack, min_feature_mm=0.75)]
    assert sum(c.added_px for c in changes) == quick.best.added_px
    assert sum(c.removed_px for c in changes) == quick.best.removed_px
    assert quick.reduction_percent == 100 * (1 - quick.best.changed_px / quick.initial.changed_px)


def test_it_finds_the_way_the_fins_stand(quick):
    """Where the fins' plane is level, as plates lying on their sides: every layer has their full area, or nothing."""
    assert quick.reduction_percent > 90
    assert axis_angle(quick.best.direction, [1, 0, 0]) < 0.02


def test_the_list_begins_with_the_best_and_has_distinct_directions(quick):
    """At least 5° apart, opposite directions being one."""
    assert quick.candidates[0] == quick.best
    for k, one in enumerate(quick.candidates):
        assert all(axis_angle(one.direction, two.direction) > math.radians(4.9) for two in quick.candidates[:k])
    assert len(quick.candidates) == 10


@pytest.mark.parametrize("method", ["quick", "race"])
def test_of_a_tall_part_what_is_listed_is_counted_in_full(method):
    """Most poses are looked at on some of the layers; no figure that is shown is an estimate."""
    found = lf.orient(leaning_fins(), method=method, **{**HOW, "layer_mm": 0.0025})
    assert min(one.layers for one in found.candidates) > 2 * CLOSE
    assert len(found.candidates) == 10
    for one in found.candidates:
        counts = found.objective.count(one.pose)
        assert found.seen[one.pose].whole
        assert (one.added_px, one.removed_px) == (counts.added, counts.removed)
    assert sum(counts.whole for counts in found.seen.values()) < 40
    assert found.reduction_percent > 90


def test_a_pose_that_no_layer_meets_is_not_a_good_one():
    """It needs no correction, for nothing of it would be printed: that is said, and written as no number."""
    found = lf.orient(box([0, 0, 0], [4, 4, 0.1]), method="quick", **HOW)
    assert not found.initial.printed
    assert found.best.printed
    assert all(one.printed for one in found.candidates)
    assert "nothing of the part would be printed" in found.notes[0]
    assert "Infinity" not in json.dumps(found.summary())
    assert lines_of(found, [])[0][1].startswith("in no layer")
    between = Counts(3, 9, 0, 0, 0, (0, 0, 0), 1.0)
    assert between.empty
    assert not between._replace(solid=1).empty


def test_the_summary_has_the_keys_that_scripts_read(quick):
    """And is JSON."""
    summary = json.loads(json.dumps(quick.summary()))
    keys = {"initial", "best", "reduction_percent", "theta_rad", "evaluations", "seconds", "candidates"}
    assert keys <= set(summary)
    assert summary["best"]["changed_px"] == quick.best.changed_px
    assert np.allclose(np.array(summary["matrix"])[:3, :3], quick.best.pose.matrix)


def test_a_part_that_needs_nothing_is_told_so():
    """A block on the grid with an F as wide as a pixel loses nothing as it stands."""
    found = lf.orient(box([0, 0, 0], [3, 2, 1]), method="quick", pixel_mm=0.2, layer_mm=0.2, min_feature_mm=0.4)
    assert found.initial.changed_px == 0
    assert found.best.pose == AS_GIVEN
    assert found.reduction_percent == 0
    assert "the part needs no correction as it stands" in found.notes


def test_the_lying_threaded_cylinder_ends_upright():
    """From horizontal it goes to θ₁ = ±π/2, and needs at least 95 % less (the paper: about 98 %)."""
    upright = sample("threaded-cylinder").mesh()
    lying = upright.transformed(Pose(math.pi / 2, 0).matrix)
    found = lf.orient(lying, pixel_mm=0.5, layer_mm=0.8, min_feature_mm=1.5, method="quick")
    assert found.reduction_percent >= 95
    assert abs(abs(found.theta_rad[0]) - math.pi / 2) < 0.03
    assert axis_angle(found.best.direction, [0, 1, 0]) < 0.03


def test_structured_directions_are_the_faces():
    """Of a leaning block: its axes come after those of the frame, the larger face first."""
    block = turned(box([0, 0, 0], [3, 2, 1]), "x", 25)
    found = structured(block)
    assert np.allclose(found[:3], np.eye(3)[[2, 0, 1]])
    assert axis_angle(found[3], Pose(math.radians(25), 0).matrix.T @ [0, 0, 1]) < 1e-3
    assert len(found) == 5  # its x axis is that of the frame


# Annealing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cooling", COOLINGS)
def test_cooling_falls_from_hot(cooling):
    """Exponential falls by the same share, linear by the same amount, logarithmic as 1 / ln."""
    heat = np.array([temperature(cooling, k, 299) for k in range(299)])
    assert math.isclose(heat[0], HOT)
    assert (np.diff(heat) < 0).all()
    if cooling == "exponential":
        assert np.allclose(heat[1:] / heat[:-1], heat[1] / heat[0])
    if cooling == "linear":
        assert np.allclose(np.diff(heat), heat[1] - heat[0])
    if cooling == "logarithmic":
        assert np.allclose(heat * np.log(2 + np.arange(299)), HOT * math.log(2))
    else:
        assert math.isclose(heat[-1], COLD)


@given(st.floats(-1, 1), st.floats(0.01, 1), st.floats(0, 1, exclude_max=True))
def test_metropolis(change, hot, chance):
    """What is better always, what is worse with exp(-ΔE / T)."""
    assert accepted(change, hot, chance) == (change <= 0 or chance < math.exp(-change / hot))
    assert accepted(-abs(change), hot, chance)


class Valley(Search):
    """A search whose values are a given function of the pose, and which notes what was asked for."""

    def __init__(self, value_of):
        self.value_of, self.asked = value_of, []
        self.total, self.doing = 1.0, ""
        self.fits = lambda pose: True

    def begin(self, doing, total=None):
        """Nothing is told."""

    def values(self, poses, layers=0):
        """At once."""
        self.asked += poses
        return [self.value_of(pose) for pose in poses]


def test_annealing_starts_as_given_and_stays_within_bounds():
    """300 evaluations, the first of [0, 0], all within the bounds; the best is the best that was asked for."""
    valley = Valley(lambda pose: (pose.theta1 - 0.5) ** 2 + (pose.theta2 - 1) ** 2)
    best = anneal(valley, Annealing())
    assert len(valley.asked) == 300
    assert valley.asked[0] == AS_GIVEN
    assert all(abs(p.theta1) <= math.pi / 2 and 0 <= p.theta2 <= math.pi for p in valley.asked)
    assert best == min(valley.asked, key=valley.value_of)
    assert valley.value_of(best) < 0.01


def test_proposals_spread_with_the_square_root_of_the_temperature():
    """On a plane where everything is taken: the variance of the steps is proportional to T."""
    steps = []
    for seed in range(12):
        valley = Valley(lambda pose: 0.0)
        anneal(valley, Annealing(seed=seed))
        theta1 = np.array([pose.theta1 for pose in valley.asked])
        steps.append(np.diff(theta1))
    inner = np.array(steps)
    for first, stop in ((100, 150), (200, 250)):  # late enough that bounds clip nothing
        reach = np.array([REACH * math.sqrt(temperature("exponential", k, 299) / HOT) for k in range(first, stop)])
        assert 0.85 < (inner[:, first:stop] / reach).std() < 1.15


def test_what_is_worse_is_left_when_it_is_cold():
    """From a deep valley: hardly a step is taken at the end, many at the start."""
    valley = Valley(lambda pose: 0.0 if pose == AS_GIVEN else 0.1)
    anneal(valley, Annealing(seed=3))
    far = [math.hypot(p.theta1, p.theta2) for p in valley.asked]
    assert max(far[:100]) > 0.5
    other = Valley(lambda pose: 0.5 * (pose.theta1**2 + pose.theta2**2))
    anneal(other, Annealing(seed=3))
    assert max(math.hypot(p.theta1, p.theta2) for p in other.asked[-30:]) < 0.3


@pytest.mark.parametrize("method", ["anneal", "direct"])
def test_serial_methods_stay_in_the_papers_bounds_and_budget(method):
    """The same seed, the same end."""
    found = lf.orient(thin_part(), method=method, evaluations=40, seed=5, **HOW)
    again = lf.orient(thin_part(), method=method, evaluations=40, seed=5, workers=3, **HOW)
    assert found.best == again.best
    assert found.evaluations <= 40 + (8 if method == "direct" else 0)
    theta1, theta2 = found.theta_rad
    assert abs(theta1) <= math.pi / 2
    assert 0 <= theta2 <= math.pi
    assert found.best.value <= 1


# Engines and the log ------------------------------------------------------------------------------------------


def test_threads_processes_and_executors_find_the_same(quick):
    """Whoever computes, the answer is one: a search does not depend on when results come."""
    ways = [{"workers": 1}, {"workers": 5}, {"executor": 2}]
    found = [lf.orient(leaning_fins(), method="quick", **HOW, **way) for way in ways]
    with ThreadPoolExecutor(2) as pool:
        found.append(lf.orient(leaning_fins(), method="quick", executor=pool, **HOW))
    for one in found:
        assert one.best == quick.best
        assert one.candidates == quick.candidates
        assert one.equivalents == pytest.approx(quick.equivalents)
        assert (one.evaluations, one.screened) == (quick.evaluations, quick.screened)


class BrokenOffError(Exception):
    """What ends a search from outside."""


@pytest.mark.parametrize("at", [0.5, 30.0])
def test_a_search_that_was_broken_off_goes_on_to_the_same_end(tmp_path, quick, at):
    """Killed in the middle of a line, even: what is in the log is not computed again."""
    log = tmp_path / "log.jsonl"

    def stop(state: State) -> None:
        if state.done > at:
            raise BrokenOffError

    with pytest.raises(BrokenOffError):
        lf.orient(leaning_fins(), method="quick", log=log, progress=stop, **HOW)
    lines = log.read_bytes()
    log.write_bytes(lines + b'{"pose":[0.1,')
    whole = len(lines.splitlines())
    assert whole >= 2
    found = lf.orient(leaning_fins(), method="quick", log=log, resume=True, **HOW)
    assert (found.best, found.candidates) == (quick.best, quick.candidates)
    assert log.read_bytes().startswith(lines)
    entries = [json.loads(line) for line in log.read_text().splitlines()]
    keys = [(*entry["pose"], entry["first"], entry["stop"]) for entry in entries[1:]]
    assert len(keys) == len(set(keys))
    again = lf.orient(leaning_fins(), method="quick", log=log, resume=True, **HOW)
    assert again.computed_s == 0
    assert again.best == quick.best


def test_ctrl_c_keeps_the_best_so_far():
    """It is told that it was broken off, and the best of what was counted in full is there."""

    def stop(state: State) -> None:
        if state.done > 12:
            raise KeyboardInterrupt

    found = lf.orient(leaning_fins(), method="quick", progress=stop, **HOW)
    assert found.interrupted
    assert found.best.changed_px <= found.initial.changed_px
    assert "broken off" in found.notes[0]
    assert found.best.changed_px == min(c.added + c.removed for c in found.seen.values() if c.whole)


def test_a_log_of_something_else_is_refused(tmp_path):
    """Another part, another file, one that exists and is not to be gone on from."""
    log = tmp_path / "log.jsonl"
    lf.orient(thin_part(), method="anneal", evaluations=3, log=log, **HOW)
    cases = [
        (thin_part(), {}, "exists already; use --resume"),
        (leaning_fins(), {"resume": True}, "is of another part"),
        (thin_part(), {"resume": True, "mode": "add_only"}, "or of other pixels, layers or corrections"),
    ]
    for part, more, message in cases:
        with pytest.raises(lf.LayerfixError, match=message):
            lf.orient(part, method="anneal", evaluations=3, log=log, **{**HOW, **more})
    first, rest = log.read_text().split("\n", 1)
    log.write_text(first.replace(f'"{lf.__version__}"', '"0.0.7"') + "\n" + rest)
    with pytest.raises(lf.LayerfixError, match=r"was written by layerfix 0\.0\.7"):
        lf.orient(thin_part(), log=log, resume=True, **HOW)
    log.write_text("solid part\n")
    with pytest.raises(lf.LayerfixError, match="is not of a log"):
        lf.orient(thin_part(), log=log, resume=True, **HOW)
    with pytest.raises(lf.LayerfixError, match="no such log"):
        lf.orient(thin_part(), log=tmp_path / "other", resume=True, **HOW)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"weights": {"added": 0, "removed": 0}}, "all weights are 0"),
        ({"weights": {"support": -1}}, r"weight support=-1: it must be 0 or more"),
        ({"weights": {"beauty": 1}}, "weight of 'beauty': there is no such aim; choose from added, removed, support"),
        ({"weights": {"added": math.nan}}, "it must be 0 or more"),
        ({"method": "luck"}, "method='luck' is not known; choose from race, anneal, direct, quick"),
        ({"method": "anneal", "cooling": "fast"}, "cooling='fast' is not known"),
        ({"evaluations": 50}, "the method race takes as many as it needs"),
        ({"method": "anneal", "evaluations": 1}, "at least 2"),
        ({"room_mm": (2, 2, 2)}, r"the part, 6 × 4 × 2 mm as it is given, fits 2 × 2 × 2 mm in no direction"),
        ({"room_mm": (0, 2, 2)}, "all three must be above 0"),
        ({"front": ["beauty"]}, "'beauty' is no aim of a front"),
        ({"executor": 0}, "at least one process"),
        ({"executor": 2.5}, "executor is a float"),
        ({"min_feature_mm": 0.1}, "under two pixels"),
        ({"pixel_mm": 0}, "pixel pitch"),
    ],
)
def test_what_cannot_be_used_is_refused(more, message):
    """Before any work, with what would be accepted."""
    with pytest.raises(lf.LayerfixError, match=message):
        lf.orient(thin_part(), **{**HOW, **more})


# Aims ---------------------------------------------------------------------------------------------------------


def table_top() -> Mesh:
    """A leg of 1 × 1 × 3 mm under a plate of 3 × 3 × 1 mm."""
    return joined(box([1, 1, 0], [2, 2, 3]), box([0, 0, 3], [3, 3, 4]))


def test_aims_of_a_table():
    """Upright its plate hangs 3 mm above the ground; upside down nothing does."""
    shape = Shape(table_top(), 0.1)
    upright, upside_down = shape.terms(AS_GIVEN), shape.terms(Pose(math.pi, 0))
    assert upright == pytest.approx({"support": 27, "overhang": 9, "height": 4, "staircase": 0, "contact": 1})
    assert upside_down == pytest.approx({"support": 1, "overhang": 1, "height": 4, "staircase": 0, "contact": 9})
    leaning = shape.terms(Pose(math.radians(30), 0))
    areas = 2 * (3 * 3 * (0.5 + math.cos(math.pi / 6)) + 3 * 1 * 0.5 * 0) + 0
    assert leaning["staircase"] > 0.05 * areas * 0.5
    assert leaning["contact"] == 0


def test_staircase_of_a_leaning_block():
    """(t/2) Σ A |n·d|, by hand."""
    block = Shape(box([0, 0, 0], [1, 2, 3]), 0.2)
    a = math.radians(20)
    expected = 0.1 * 2 * (1 * 2 * math.cos(a) + 1 * 3 * math.sin(a))
    assert block.terms(Pose(a, 0))["staircase"] == pytest.approx(expected)


def counts_of(added: int, removed: int) -> Counts:
    """Of ten layers."""
    return Counts(10, 10, 1000, added, removed, (0, 0, 0), 4.0)


def test_equal_weights_are_the_papers_objective():
    """Σ |Ŝ - S| over that of the part as it is given; other weights weigh the two parts."""
    shape, initial = Shape(table_top(), 0.1), counts_of(30, 10)
    assert aims_for(shape, check_weights({}), initial).value(AS_GIVEN, counts_of(12, 8)) == 0.5
    only_added = aims_for(shape, check_weights({"removed": 0}), initial)
    assert only_added.value(AS_GIVEN, counts_of(12, 8)) == 0.3
    assert (
        aims_for(shape, check_weights({}), initial).value(AS_GIVEN, Counts(0, 0, 0, 0, 0, (0, 0, 0), 0)) == math.inf
    )


def test_weights_mean_shares_of_the_part_as_it_is_given():
    """Support twice as important as correction: upside down wins; contact counts for, not against."""
    shape, initial = Shape(table_top(), 0.1), counts_of(30, 10)
    aims = aims_for(shape, check_weights({"support": 2}), initial)
    assert aims.value(AS_GIVEN, initial) == pytest.approx(3)
    assert aims.value(Pose(math.pi, 0), initial) == pytest.approx(1 + 2 / 27)
    assert aims.upright(AS_GIVEN, initial) == Pose(math.pi, 0)
    contact = aims_for(shape, check_weights({"contact": 1}), initial)
    assert contact.value(Pose(math.pi, 0), initial) == pytest.approx(1 - 9)


def test_of_two_ways_up_that_need_the_same_the_one_with_less_support():
    """C alone cannot tell them apart."""
    aims = aims_for(Shape(table_top(), 0.1), check_weights({}), counts_of(30, 10))
    assert aims.upright(AS_GIVEN, counts_of(30, 10)) == Pose(math.pi, 0)
    assert aims.upright(Pose(math.pi, 0), counts_of(30, 10)) == Pose(math.pi, 0)


def test_support_turns_the_table_over():
    """The whole search, with a weight; both ways up are on its map."""
    found = lf.orient(table_top(), method="quick", weights={"support": 20.0}, **HOW)
    assert found.best.direction == pytest.approx((0, 0, -1), abs=0.05)
    directions, values = found.landscape()
    assert len(values) == 2 * found.screened
    assert (directions[:, 2] < -0.1).any()


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=30))
def test_the_front_is_what_nothing_beats(rows):
    """Against the definition, pair by pair; of equal ones one is there."""
    scores = np.array(rows, float)
    kept = non_dominated(scores)
    beaten = [any((b <= a).all() and (b < a).any() for b in scores) for a in scores]
    assert {tuple(scores[k]) for k in kept} == {tuple(a) for a, lost in zip(scores, beaten, strict=True) if not lost}
    assert len({tuple(scores[k]) for k in kept}) == len(kept)


def test_the_front_of_a_search_is_counted_in_full():
    """Correction and height: from the best to one that is lower, each a trade."""
    found = lf.orient(leaning_fins(), method="quick", front=["height"], **HOW)
    front = found.front(["height"])
    changed, heights = [c.changed_px for c in front], [c.terms["height"] for c in front]
    assert changed == sorted(changed)
    assert heights == sorted(heights, reverse=True)
    assert changed[0] <= found.best.changed_px
    assert set(AIMS) - {"added", "removed"} == set(front[0].terms)


def test_only_poses_that_fit():
    """A rod of 8 mm in a room 4 mm high and 7 mm wide lies on the diagonal of the plate, or leans."""
    rod = box([0, 0, 0], [0.6, 0.6, 8])
    room = (7, 5, 4)
    found = lf.orient(rod, method="quick", room_mm=room, **HOW)
    size = found.mesh().size_mm
    assert max(size[:2]) <= 7
    assert min(size[:2]) <= 5
    assert size[2] <= 4


# Pictures -----------------------------------------------------------------------------------------------------


def test_the_map_is_dark_where_values_are_low():
    """Equal areas from the pole, x to the right and y up; the opposite of a direction is the same place."""
    directions = fibonacci(400)
    low = np.array([math.sin(1.0), 0, math.cos(1.0)])  # to the right
    values = 1 + np.arccos(np.clip(directions @ low, -1, 1))
    drawing = sphere_map(directions, values, best=low, given=np.array([0, 0, 1.0]), unit="px")
    picture = np.asarray(drawing.png().convert("L"), float)
    radius, x0, y0 = 280, 70 + 280, 70 + 280 + 20
    k = radius / math.sqrt(1 + low[2])
    right = picture[y0 + 20, round(x0 + low[0] * k)]
    left = picture[y0 + 20, round(x0 - low[0] * k)]
    assert right < 80 < left
    flipped = sphere_map(-directions, values, best=-low, given=np.array([0, 0, 1.0]), unit="px")
    assert flipped.shapes == drawing.shapes


def test_a_map_of_both_halves_has_two_discs():
    """And a flat landscape is drawn, too."""
    directions = np.concatenate([fibonacci(50), -fibonacci(50)])
    both = sphere_map(directions, np.ones(100), best=directions[0], given=directions[3], unit="px", both=True)
    assert both.width > 1.7 * sphere_map(directions, np.ones(100), best=directions[0], given=directions[3],
                                         unit="px").width  # fmt: skip
    assert "lower half" in both.svg()


def test_objectives_are_shared_by_searches():
    """`Objective.count` may be asked for more after a search: it is the same."""
    objective = Objective(thin_part(), Printing((0.2, 0.2), 0.2, 0.6))
    pose = pose_of([0.3, 0.2, 1])
    assert objective.count(pose) == objective.count(pose)


def test_the_right_way_up_is_not_bought_with_correction(monkeypatch):
    """A direction is turned over, for less support, only if it needs no more correction then."""
    part = thin_part().transformed(Pose(0.9, 0.4).matrix)
    how = {"pixel_mm": (0.1, 0.1), "layer_mm": 0.1, "min_feature_mm": 0.8}
    free = lf.orient(part, method="quick", **how).best
    up = free.pose.direction
    counted = Objective.count

    def dearer(self: Objective, pose: Pose, *some: Any, **more: Any) -> Counts:
        counts = counted(self, pose, *some, **more)
        return counts._replace(added=3 * counts.added + 100) if pose.direction @ up > 0.5 else counts

    monkeypatch.setattr(Objective, "count", dearer)
    found = lf.orient(part, method="quick", **how).best
    assert found.pose.direction @ up < 0.5
    assert found.mean_px is not None
