"""How long moves take: trapezoids with look-ahead, against formulas, a slow twin, and PrusaSlicer's own estimate."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import layerfix as lf
from layerfix.fdm.motion import USUAL_JERK_MM_S, USUAL_MM_S, Limits, limits_of, move_seconds
from layerfix.samples import sample
from tests.making import box as block
from tests.making import run_layerfix, write_stl
from tests.moving import LIMITS, slow_seconds, timed

FREE = Limits((1e9,) * 4, (1e9,) * 4, (1e-9,) * 4)  # nothing limits but feedrate and acceleration; full stops
MK3S = "prusa-mk3s-0.4"


def times(moves, speed=100.0, acceleration=1000.0, limits=FREE) -> np.ndarray:
    """Of moves given as X, Y, Z, E."""
    n = len(moves)
    return move_seconds(np.array(moves, float).reshape(-1, 4), np.full(n, speed), np.full(n, acceleration), limits)


def test_one_move_is_a_trapezoid():
    """Long: way over speed and once the ramp; short: a triangle; nothing takes no time."""
    assert times([[50, 0, 0, 0]]) == pytest.approx([50 / 100 + 100 / 1000], rel=1e-6)
    assert times([[0, 3, 4, 9]]) == pytest.approx([2 * (5 / 1000) ** 0.5], rel=1e-6)
    assert times([[0, 0, 0, -0.8]], 35) == pytest.approx([2 * (0.8 / 1000) ** 0.5], rel=1e-6)
    assert times([[0, 0, 0, 0]]) == [0.0]
    assert len(times([])) == 0


def test_straight_on_is_as_one_move():
    """Cut in ten, or in pieces of different lengths, a way takes as long as whole; there and back it does not."""
    whole = times([[30, 40, 0, 5]]).sum()
    assert times([[3, 4, 0, 0.5]] * 10).sum() == pytest.approx(whole, rel=1e-6)
    assert times([[3, 4, 0, 0.5], [27, 36, 0, 4.5]]).sum() == pytest.approx(whole, rel=1e-6)
    assert times([[15, 20, 0, 2.5], [-15, -20, 0, 2.5]]).sum() > 1.1 * whole


def test_each_axis_has_its_own_limits():
    """A lift goes at the speed and slope of Z, a slanted move at those of its tightest axis."""
    slow = replace(FREE, mm_s=(500, 500, 12, 60), mm_s2=(9000, 9000, 200, 5000))
    assert times([[0, 0, 6, 0]], limits=slow) == pytest.approx([6 / 12 + 12 / 200], rel=1e-6)
    assert times([[30, 0, 40, 0]], limits=slow) == pytest.approx([50 / 15 + 15 / 250], rel=1e-6)


def test_corners_by_jerk():
    """At a right angle each axis jumps by the speed: with a jerk of 8 the corner is driven at 8 mm/s."""
    took = times([[5, 0, 0, 0], [0, 5, 0, 0]], limits=replace(FREE, jerk_mm_s=(8, 8, 1e-9, 1e-9))).sum()
    triangle = (2 * (1000 * 5 + 8**2) ** 0.5 - 16) / 1000  # from 8 mm/s, and back to them
    assert took == pytest.approx(2 * triangle, rel=1e-6)


def test_corners_by_junction_deviation():
    """v² = a·d·s / (1 − s) with s the sine of half the angle: 90° and 0.02 mm at 1000 mm/s² are 6.95 mm/s."""
    corner = (1000 * 0.02 * 0.5**0.5 / (1 - 0.5**0.5)) ** 0.5
    assert corner == pytest.approx(6.949, abs=1e-3)
    took = times([[5, 0, 0, 0], [0, 5, 0, 0]], limits=replace(FREE, junction_deviation_mm=0.02)).sum()
    peak = ((2 * 1000 * 5 + corner**2) / 2) ** 0.5
    assert took == pytest.approx(2 * (2 * peak - corner) / 1000, rel=1e-6)


def test_a_round_corner_is_faster_than_a_sharp_one():
    """A circle in 100 pieces takes little more than its way at full speed; a square of the same way more."""
    turn = np.linspace(0, 2 * np.pi, 101)
    round_ = np.column_stack([20 * np.diff(np.cos(turn)), 20 * np.diff(np.sin(turn)), 0 * turn[1:], 0 * turn[1:]])
    side = 10 * np.pi
    for limits in (Limits((500,) * 4, (1000,) * 4, (8, 8, 0.4, 5)), replace(FREE, junction_deviation_mm=0.02)):
        circle = times(round_, 40.0, limits=limits).sum()
        square = times([[side, 0, 0, 0], [0, side, 0, 0], [-side, 0, 0, 0], [0, -side, 0, 0]], 40.0, limits=limits)
        assert 40 * np.pi / 40 <= circle < 40 * np.pi / 40 + 0.06
        assert square.sum() > circle + 0.05


@settings(max_examples=200, deadline=None)
@given(data=st.data(), deviation=st.sampled_from([0.0, 0.02]))
def test_the_kernel_is_its_slow_twin(data, deviation):
    """Any moves, some of nothing, with any feedrates."""
    length = st.floats(-30, 30).map(lambda v: round(v, 2))
    moves = data.draw(st.lists(st.lists(length, min_size=4, max_size=4), min_size=1, max_size=20))
    moves += data.draw(st.sampled_from([[], [[0.0] * 4], [[0.0, 0.0, 0.0, -0.8]]]))
    speeds = data.draw(st.lists(st.floats(1, 300), min_size=len(moves), max_size=len(moves)))
    limits = Limits(junction_deviation_mm=deviation)
    got = move_seconds(np.array(moves), np.array(speeds), np.full(len(moves), 900.0), limits)
    expected = slow_seconds(
        moves, speeds, [900.0] * len(moves), limits.mm_s, limits.mm_s2, limits.jerk_mm_s, deviation
    )
    assert got == pytest.approx(expected, rel=1e-7, abs=1e-9)
    assert (got >= 0).all()


def test_limits_of_printers():
    """The file's, else usual ones."""
    printer = lf.load_printer(MK3S)
    assert limits_of(printer).mm_s2 == (1000, 1000, 200, 5000)
    bare = limits_of(replace(printer, axis_mm_s=None, axis_jerk_mm_s=None, junction_deviation_mm=0.013))
    assert (bare.mm_s, bare.jerk_mm_s, bare.junction_deviation_mm) == (USUAL_MM_S, USUAL_JERK_MM_S, 0.013)


def stated_seconds(text: str) -> float:
    """Of the comment that PrusaSlicer and we write at the end."""
    said = re.search(r"estimated printing time \(normal mode\) = (.*)", text)[1]
    return sum(
        int(n) * {"d": 86400, "h": 3600, "m": 60, "s": 1}[unit] for n, unit in re.findall(r"(\d+)([dhms])", said)
    )


PARTS = {"tower": lambda: sample("helical-tower").mesh(), "block": lambda: block([0, 0, 0], [30, 20, 4])}
PRUSA = ("prusa-slicer --loglevel 1 -g --gcode-flavor marlin --nozzle-diameter 0.4 --filament-diameter 1.75"
         " --layer-height 0.2 --first-layer-height 0.2 --use-relative-e-distances --layer-gcode G92E0"
         " --retract-length 0.8 --retract-lift 0.4 --default-acceleration 1000 --machine-limits-usage emit_to_gcode"
         " --machine-max-acceleration-x 1000 --machine-max-acceleration-y 1000 --machine-max-acceleration-z 200"
         " --machine-max-feedrate-z 12 --machine-max-jerk-x 8 --machine-max-jerk-y 8 --machine-max-jerk-z 0.4"
         " --machine-max-jerk-e 4.5 --center 100,100")  # fmt: skip


@pytest.mark.skipif(not shutil.which("prusa-slicer"), reason="prusa-slicer is not installed")
@pytest.mark.parametrize("name", PARTS)
def test_prusaslicer_estimates_the_same_for_its_own_moves(name, tmp_path):
    """Within 5 %, with the limits that its file sets."""
    stl = write_stl(tmp_path / "part.stl", PARTS[name]())
    subprocess.run([*PRUSA.split(), "-o", tmp_path / "a.gcode", stl], capture_output=True, check=True)
    text = (tmp_path / "a.gcode").read_text()
    read = timed(text)
    limits = Limits(*(tuple(read.most[code]) for code in LIMITS))
    assert limits.mm_s2[:3] == (1000, 1000, 200)
    ours = move_seconds(np.array(read.moves), np.array(read.speeds), np.array(read.accelerations), limits).sum()
    assert ours == pytest.approx(stated_seconds(text), rel=0.05)


@pytest.mark.parametrize("name", [MK3S, "ender-3-0.4", "lulzbot-taz6-0.5"])
def test_our_files_state_the_time_of_their_moves(name, tmp_path):
    """Everything that is written, start and end code too, timed by another reader and another model."""
    stl = write_stl(tmp_path / "part.stl", PARTS["block"]())
    run = run_layerfix("fix", stl, tmp_path / "a.gcode", "-p", name)
    assert run.code == 0
    text, printer = Path(tmp_path / "a.gcode").read_text(), lf.load_printer(name)
    most = dict(zip(LIMITS, (printer.axis_mm_s, printer.axis_mm_s2, printer.axis_jerk_mm_s), strict=True))
    assert stated_seconds(text) == pytest.approx(timed(text).seconds(most), rel=0.005)
    assert re.search(r"printing takes about ([\dhms ]+?) and", run.out)[1] == re.search(r"mode\) = (.*)", text)[1]
