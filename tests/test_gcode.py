"""G-code: written by the library and by real processes, and read again by an interpreter that knows only G-code."""

from __future__ import annotations

import json
import math
import re
import runpy
import shutil
import subprocess
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely import Point, box

import layerfix as lf
from layerfix import LayerStack, settings_for
from layerfix.errors import InputError, OutputError
from layerfix.fdm import KINDS
from layerfix.fdm.moves import LIFT, RETRACT, TRAVEL
from layerfix.fdm.toolpaths import plan_toolpaths
from layerfix.formats import read as read_layers
from layerfix.formats.vector.gcode_lines import lines_of_moves
from layerfix.formats.vector.gcode_reader import read_gcode
from layerfix.printers import Printer
from tests.beads import drawn, main_width, section_mm2, shape_of, stack_of
from tests.making import SHARED, contents, joined, run_layerfix, thin_part, write_stl
from tests.making import box as block
from tests.moving import LIMITS, timed
from tests.slicers.programs import MODES, why_not

MK3S, TAZ, KLIPPER, MARLIN2 = "prusa-mk3s-0.4", "lulzbot-taz6-0.5", "ratrig-v-core-4-400-0.6", "prusa-mini-0.4"


# Lines


FORMATS = {0: "G1 X%.3f Y%.3f E%.5f\n", TRAVEL: "G1 X%.3f Y%.3f F%.0f\n", LIFT: "G1 Z%.6g F%.0f\n",
           RETRACT: "G1 E%.5f F%.0f\n"}  # fmt: skip
places = st.floats(-2000, 2000).map(lambda value: value + 0.0)  # there is no -0
# What lies at a half of the last digit, or next to it, is rounded by the value itself and not by a product of it.
halves = st.tuples(st.integers(-(10**6), 10**6), st.sampled_from([-1, 0, 1])).map(
    lambda found: (
        math.nextafter((found[0] + 0.5) / 1000, found[1] * math.inf) if found[1] else (found[0] + 0.5) / 1000
    )
)


@given(st.lists(st.tuples(st.sampled_from([0, 3, TRAVEL, LIFT, RETRACT]), st.one_of(places, halves),
                          st.one_of(places, halves), st.floats(1e-3, 900), st.floats(-99, 99).map(lambda e: e + 0.0),
                          st.integers(1, 60000)), min_size=1, max_size=8))  # fmt: skip
def test_lines_are_what_python_writes(moves):
    """To the byte, but for the sign of a zero."""
    kind, x, y, z, e, feedrate = (np.array(column, np.float64) for column in zip(*moves, strict=True))
    data, starts = lines_of_moves(kind.astype(np.int64), np.column_stack([x, y, z]), e, feedrate)
    lines = data.tobytes().decode().splitlines(keepends=True)
    numbers = {0: lambda m: (m[1], m[2], m[4]), TRAVEL: lambda m: (m[1], m[2], m[5]),
               LIFT: lambda m: (m[3], m[5]), RETRACT: lambda m: (m[4], m[5])}  # fmt: skip
    assert lines == [FORMATS[min(m[0], 0)] % numbers[min(m[0], 0)](m) for m in moves]
    assert starts.tolist() == np.cumsum([0, *map(len, lines[:-1])]).tolist()


# An interpreter of its own


@dataclass
class Move:
    """One G1: from, to, filament, speed and what the comments before it said."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    e_mm: float
    mm_min: float
    layer: int
    kind: str
    width: float
    height: float

    @property
    def length(self) -> float:
        return math.dist(self.start[:2], self.end[:2])

    @property
    def lays(self) -> bool:
        return self.e_mm > 0 and self.length > 0


def moves_of(text: str) -> list[Move]:
    """Every G1 in order. layer is -1 in the start code; a word or command that it does not know is an error."""
    at = {"X": 0.0, "Y": 0.0, "Z": 0.0, "E": 0.0, "F": 0.0}
    absolute, absolute_e = True, True
    layer, kind, width, height = -1, "", 0.0, 0.0
    moves = []
    for line in text.splitlines():
        code, _, comment = line.partition(";")
        layer += comment == "LAYER_CHANGE"
        key, _, value = comment.partition(":")
        kind = value if key == "TYPE" else kind
        width = float(value) if key == "WIDTH" else width
        height = float(value) if key == "HEIGHT" else height
        words = code.split()
        if not words:
            continue
        command = words[0]
        assert re.fullmatch(r"[GM]\d+", command), line
        if command in ("M82", "M83"):
            absolute_e = command == "M82"
        elif command in ("G90", "G91"):
            absolute = command == "G90"
        elif command == "G92":
            assert [w[0] for w in words[1:]] == ["E"], line
            at["E"] = float(words[1][1:])
        elif command == "G1":
            given = {w[0]: float(w[1:]) for w in words[1:]}
            assert set(given) <= set("XYZEF"), line
            before = dict(at)
            for axis, number in given.items():
                counts = (axis == "E" and absolute_e) or axis == "F" or (axis in "XYZ" and absolute)
                at[axis] = number if counts else at[axis] + number
            moves.append(Move((before["X"], before["Y"], before["Z"]), (at["X"], at["Y"], at["Z"]),
                              at["E"] - before["E"], at["F"], layer, kind, width, height))  # fmt: skip
        else:
            known = ("G21", "G28", "G80", "G29", "M84", "M104", "M109", "M140", "M190", "M106", "M107", "M204")
            assert command in known, line
    return moves


def printed(text: str) -> list[Move]:
    """The moves between the first layer's mark and the end code."""
    found = moves_of(text)
    last = max(k for k, move in enumerate(found) if move.lays and move.layer >= 0)
    return [move for move in found[: last + 1] if move.layer >= 0]


def a_part() -> LayerStack:
    """Seven layers: a plate with a hole, two pillars and a thin wall on it, far apart."""
    plate = drawn((34, 24), shapely.difference(box(2, 2, 32, 22), Point(10, 12).buffer(3)))
    top = drawn((34, 24), shapely.union_all([box(4, 4, 6, 20), Point(26, 8).buffer(2), box(18, 16, 30, 16.8)]))
    return stack_of(*[plate] * 4, *[top] * 3)


@pytest.fixture(scope="module")
def part() -> LayerStack:
    return a_part()


def written(path: Path, stack: LayerStack, printer: Printer | str, **options) -> str:
    """The text of a file written for a printer."""
    lf.write(path, stack, lf.load_printer(printer) if isinstance(printer, str) else printer, force=True, **options)
    return path.read_text()


@pytest.fixture(scope="module")
def texts(part, tmp_path_factory) -> dict[str, str]:
    """The part for one printer of each flavour and kind of E."""
    folder = tmp_path_factory.mktemp("gcode")
    return {name: written(folder / "a.gcode", part, name) for name in (MK3S, TAZ, MARLIN2)}


each_printer = pytest.mark.parametrize("name", [MK3S, TAZ, MARLIN2])


# Comments


def test_comments_as_prusaslicer_writes_them(texts, part):
    """LAYER_CHANGE, Z and HEIGHT begin every layer; TYPE and WIDTH come before the beads they tell of."""
    lines = texts[MK3S].splitlines()
    begins = [k for k, line in enumerate(lines) if line == ";LAYER_CHANGE"]
    assert len(begins) == len(part)
    for k, (bottom, top) in zip(begins, part.z_mm.tolist(), strict=True):
        assert lines[k + 1] == f";Z:{top:g}"
        assert lines[k + 2] == f";HEIGHT:{top - bottom:g}"
    kinds = {line.removeprefix(";TYPE:") for line in lines if line.startswith(";TYPE:")}
    assert kinds <= {*KINDS, "Custom"}  # the start and end code
    assert kinds >= {"Skirt/Brim", "External perimeter", "Perimeter", "Solid infill", "Top solid infill"}
    assert all(re.fullmatch(r";WIDTH:0\.\d+", line) for line in lines if line.startswith(";WIDTH"))
    for move in moves_of(texts[MK3S]):
        if move.lays and move.layer >= 0:
            assert move.kind
            assert 0.34 <= move.width <= 0.8
            assert move.height == pytest.approx(0.2)
            assert move.end[2] == pytest.approx(0.2 * (move.layer + 1))
            assert move.start[2] == move.end[2]
    for before, after in pairwise([line for line in lines if line.startswith(";TYPE:")]):
        assert before != after  # said when it changes


@each_printer
def test_neither_m73_nor_m117(texts, name):
    """Progress and messages are the host's."""
    assert not re.search(r"\bM(73|117)\b", texts[name])


@each_printer
def test_the_settings_at_the_end(texts, name):
    """As viewers look for them: filament, time, nozzle and flavour."""
    printer, text = lf.load_printer(name), texts[name]
    said = dict(re.findall(r"^; ([\w \[\]()]+?) = (.*)$", text, re.M))
    assert float(said["nozzle_diameter"]) == printer.nozzle_mm
    assert float(said["filament_diameter"]) == printer.filament_mm
    assert said["gcode_flavor"] == printer.gcode_flavor
    used = sum(move.e_mm for move in printed(text) if move.lays)
    assert float(said["filament used [mm]"]) == pytest.approx(used, abs=0.05)
    area = math.pi * printer.filament_mm**2 / 4
    assert float(said["filament used [cm3]"]) == pytest.approx(used * area / 1000, abs=1e-3)
    assert re.fullmatch(r"(\d+[dhm] )*\d+s", said["estimated printing time (normal mode)"])


# E and F


@each_printer
def test_e_is_the_cross_section_times_the_length(texts, name):
    """(w − h)·h + π(h/2)² times the length over the filament's area, to the digits written."""
    area = math.pi * lf.load_printer(name).filament_mm ** 2 / 4
    laid = [move for move in printed(texts[name]) if move.lays]
    assert len(laid) > 200
    expected = np.array([float(section_mm2(m.width, m.height)) * m.length / area for m in laid])
    got = np.array([m.e_mm for m in laid])
    # X, Y have 3 digits, E has 5; absolute E is a difference of two.
    allowed = 1.5e-5 + 2 * 0.0008 * np.array([float(section_mm2(m.width, m.height)) for m in laid]) / area
    assert (abs(got - expected) <= allowed).all()
    assert got.sum() == pytest.approx(expected.sum(), rel=5e-4)


def test_relative_and_absolute_e(texts):
    """M83 or M82 as the printer's file says; absolute E begins at 0 on every layer and falls only to retract."""
    relative, absolute = texts[MK3S], texts[TAZ]
    body = {text: text[: text.index(";LAYER_CHANGE")] for text in (relative, absolute)}
    assert re.findall(r"^M8[23]", body[relative], re.M)[-1] == "M83"
    assert re.findall(r"^M8[23]", body[absolute], re.M)[-1] == "M82"
    layers = absolute.split(";LAYER_CHANGE\n")[1:]
    assert all(re.search(r"\A;Z:.*\n;HEIGHT:.*\nG92 E0\n", layer) for layer in layers)
    retract = lf.load_printer(TAZ).retract_mm
    for layer in layers:
        layer = layer.partition("M104 S0")[0]
        values = [float(e) for e in re.findall(r"^G1 .*E(-?[\d.]+)", layer, re.M)]
        falls = [b - a for a, b in pairwise([0.0, *values]) if b < a]
        assert all(fall == pytest.approx(-retract, abs=2e-5) for fall in falls)


def test_the_printers_write_the_same_beads_but_for_their_bed(texts):
    """Nothing that differs between absolute and relative E differs in the plastic: volume follows the widths."""
    volumes = {}
    for name in (MK3S, MARLIN2):
        area = math.pi * lf.load_printer(name).filament_mm ** 2 / 4
        volumes[name] = sum(m.e_mm for m in printed(texts[name]) if m.lays) * area
    assert volumes[MK3S] == pytest.approx(volumes[MARLIN2], rel=0.02)


@pytest.mark.parametrize("cap", [2.0, 5.0, 11.0])
def test_no_more_is_melted_than_can_be(part, tmp_path, cap):
    """Section times speed is under the limit everywhere, and near it where the usual speed is above."""
    printer = replace(lf.load_printer(MK3S), max_volumetric_speed_mm3_s=cap)
    laid = [m for m in printed(written(tmp_path / "a.gcode", part, printer)) if m.lays]
    flow = np.array([float(section_mm2(m.width, m.height)) * m.mm_min / 60 for m in laid])
    assert flow.max() <= cap * 1.005
    if cap < 5:
        assert np.median(flow[[m.layer > 0 for m in laid]]) > 0.9 * cap or flow.max() > 0.9 * cap


def test_speeds_are_those_of_the_printer(tmp_path):
    """A large layer is laid at the printer's speeds for each kind, the first one slower."""
    wide = stack_of(*[drawn((64, 64), box(2, 2, 62, 62))] * 9)
    printer = lf.load_printer(MK3S)
    wanted = {
        "External perimeter": printer.external_perimeter_mm_s,
        "Perimeter": printer.perimeter_mm_s,
        "Solid infill": printer.solid_infill_mm_s,
        "Top solid infill": printer.top_infill_mm_s,
        "Internal infill": printer.infill_mm_s,
    }
    laid = [m for m in printed(written(tmp_path / "a.gcode", wide, printer)) if m.lays]
    assert {m.kind for m in laid} == {*wanted, "Skirt/Brim"}
    for m in laid:
        speed = printer.first_layer_mm_s if m.layer == 0 else wanted[m.kind]
        assert m.mm_min == pytest.approx(60 * speed, abs=0.51)


def test_inches_are_read_as_inches(tmp_path):
    """G20 and back: the same beads."""
    moves = "G1 Z{0} F20\nG1 X{1} Y{1} F100\nG1 X{2} Y{1} E{0} F50\n"
    head = "G90\nM83\n;LAYER_CHANGE\n"
    metric, inches = tmp_path / "mm.gcode", tmp_path / "in.gcode"
    metric.write_text("G21\n" + head + moves.format(0.254, 25.4, 50.8))
    inches.write_text("G20\n" + head + moves.format(0.01, 1, 2) + "G21\n")
    (one,), (other,) = read_gcode(metric), read_gcode(inches)
    assert one.z_mm == pytest.approx(other.z_mm)
    np.testing.assert_allclose(one.paths[0].points_mm, other.paths[0].points_mm)
    np.testing.assert_allclose(one.paths[0].width_mm, other.paths[0].width_mm)


def test_the_layers_that_are_counted_are_those_that_are_laid(tmp_path):
    """Empty ones in the middle are none."""
    parts = joined(block([0, 0, 0], [4, 4, 1]), block([0, 0, 2], [4, 4, 3]))
    stack = lf.slice_mesh(parts, pixel_mm=0.05, layer_mm=0.2)
    lf.write(tmp_path / "a.gcode", stack, MK3S)
    text = (tmp_path / "a.gcode").read_text()
    assert text.count(";LAYER_CHANGE") == 10
    assert "\n; total layers = 10\n" in text


def test_layers_that_are_done_soon_are_laid_slower(tmp_path):
    """A pillar takes some seconds a layer, but no bead is slower than 10 mm/s; travels stay fast."""
    pillar = stack_of(*[drawn((8, 8), Point(4, 4).buffer(2))] * 4)
    printer = lf.load_printer(MK3S)
    moves = printed(written(tmp_path / "a.gcode", pillar, printer))
    laid = [m for m in moves if m.lays and m.layer == 2]
    assert all(600 <= m.mm_min < 60 * printer.external_perimeter_mm_s for m in laid)
    seconds = sum(m.length / m.mm_min * 60 for m in laid)
    fast = sum(m.length / 45 for m in laid)
    assert seconds > 1.5 * fast
    travels = [m for m in moves if not m.lays and m.length > 0]
    assert all(m.mm_min == 60 * printer.travel_mm_s for m in travels)


# Travels


def ways_of(text: str) -> Iterator[tuple[list[Move], float, bool]]:
    """(travels between two beads, filament drawn back meanwhile, whether the layer changed) for each way."""
    travels, back, changed, layer = [], 0.0, True, -1
    for move in printed(text):
        changed = changed or move.layer != layer
        layer = move.layer
        if move.lays:
            if travels:
                yield travels, back, changed
            travels, back, changed = [], 0.0, False
        elif move.length > 0:
            travels.append(move)
        back = max(back, -move.e_mm)


@each_printer
def test_retraction_where_the_way_leaves_the_part_and_nowhere_else(texts, part, name):
    """Drawn back and lifted where a straight way of some length crosses the outside; not where it stays inside."""
    printer = lf.load_printer(name)
    shift = np.array(printer.build_mm[:2]) / 2 - [17.0, 12.0]
    shapes = [shape_of(part, layer) for layer in part]
    inside, outside = 0, 0
    for travels, back, changed in ways_of(texts[name]):
        straight = math.dist(travels[0].start[:2], travels[-1].end[:2])
        line = shapely.LineString([np.array(p[:2]) - shift for p in (travels[0].start, travels[-1].end)])
        shape = shapes[travels[0].layer]
        top = 0.2 * (travels[0].layer + 1)
        if changed or straight < printer.retract_before_travel_mm + 1e-3:
            continue
        if shapely.buffer(shape, -0.05).contains(line):
            inside += 1
            assert back == 0
            assert len(travels) == 1
            assert travels[0].end[2] == pytest.approx(top)
        elif back:
            outside += 1
            assert not shape.buffer(-0.05).contains(line)
            assert back == pytest.approx(printer.retract_mm, abs=2e-5)
            assert travels[0].end[2] == pytest.approx(top + (printer.retract_lift_mm or 0))
        else:  # round a hole or a corner, never outside
            assert all(shapely.buffer(shape, 0.06).contains(shapely.LineString([np.array(p[:2]) - shift for p in
                                                            (m.start, m.end)])) for m in travels)  # fmt: skip
    assert inside > 10
    assert outside > 5


@each_printer
def test_what_is_drawn_back_is_pushed_again_before_the_next_bead(texts, name):
    """As far back as the printer says, never twice, never laid with while drawn back; once a layer and no more where
    nothing is left."""
    printer = lf.load_printer(name)
    back = 0.0
    for move in printed(texts[name]):  # the first way is retracted, too, from wherever the start code ended
        if move.length == 0 and move.e_mm < 0:
            assert back == 0
            assert move.e_mm == pytest.approx(-printer.retract_mm, abs=2e-5)
            assert move.mm_min == 60 * printer.retract_mm_s
            back = -move.e_mm
        elif move.length == 0 and move.e_mm > 0:
            assert back > 0
            assert move.e_mm == pytest.approx(back, abs=2e-5)
            back = 0.0
        elif move.lays:
            assert back == 0
        elif move.length > 0:
            assert move.e_mm == 0
    assert back == 0


def test_no_retraction_where_the_printer_has_none(part, tmp_path):
    """0 mm is no retraction at all."""
    printer = replace(lf.load_printer(MK3S), retract_mm=0.0, retract_lift_mm=0.0)
    moves = printed(written(tmp_path / "a.gcode", part, printer))
    assert all(m.length > 0 or m.e_mm == 0 for m in moves)
    assert not [m for m in moves if m.e_mm < 0]


def test_nothing_is_laid_between_paths(texts, part):
    """The beads of the file are those that were planned, in order, in the middle of the bed."""
    printer = lf.load_printer(MK3S)
    planned = plan_toolpaths(part, settings_for(printer))
    shift = np.array(printer.build_mm[:2]) / 2 - [17.0, 12.0]
    expected = np.concatenate([p.points_mm[1:] + shift for layer in planned for p in layer.paths])
    laid = np.array([m.end[:2] for m in printed(texts[MK3S]) if m.e_mm > 0 and m.length > 0])
    written_once = expected[np.concatenate([p.lengths_mm > 1.5e-3 for layer in planned for p in layer.paths])]
    assert len(laid) >= len(written_once)
    assert len(laid) <= len(expected)
    assert sum(m.length for m in printed(texts[MK3S]) if m.lays) == pytest.approx(
        sum(float(p.lengths_mm.sum()) for layer in planned for p in layer.paths), rel=1e-4
    )


# Flavours, start and end


@pytest.mark.parametrize(
    ("flavor", "acceleration", "fan"),
    [
        ("marlin", "M204 S1250", "M106 S204"),
        ("marlin2", "M204 P1250 T1250", "M106 S204"),
        ("klipper", "M204 S1250", "M106 S204"),
        ("reprap", "M204 P1250 T1250", "M106 S0.80"),
    ],
)
def test_dialects(part, tmp_path, flavor, acceleration, fan):
    """Acceleration before the first layer; the fan off on it and on from the second."""
    printer = replace(lf.load_printer(MK3S), gcode_flavor=flavor, acceleration_mm_s2=1250.0, fan_percent=80.0)
    text = written(tmp_path / "a.gcode", part, printer)
    head, first, second, *_ = text.split(";LAYER_CHANGE\n")
    assert acceleration in head.splitlines()
    assert ("M106 S0" if flavor == "reprap" else "M107") in head.splitlines()
    assert fan not in head + first[: first.rindex("G1")]
    assert fan in first.splitlines()[-3:] or fan in second.splitlines()[:3]
    assert f"; gcode_flavor = {flavor}" in text.splitlines()


def test_temperatures_in_the_start_code_and_after_the_first_layer(part, tmp_path):
    """Filled in; M104 and M140 change them after layer 1 where they differ, and only there."""
    warm = {"nozzle_c": 210.0, "first_layer_nozzle_c": 225.0, "bed_c": 55.0, "first_layer_bed_c": 65.0}
    printer = replace(lf.load_printer(MK3S), **warm)
    text = written(tmp_path / "a.gcode", part, printer)
    head, first, *others = text.split(";LAYER_CHANGE\n")
    for line in ("M140 S65", "M104 S225", "M190 S65", "M109 S225"):
        assert line in head.splitlines()
    assert "{" not in text
    assert first.splitlines()[-3:] == ["M104 S210", "M140 S55", "M106 S255"]
    assert not re.search(r"^M1[0-9]{2} S(210|55)$", "".join(others), re.M)
    assert "M104 S0" in others[-1].splitlines()
    same = written(tmp_path / "b.gcode", part, replace(printer, nozzle_c=225.0, bed_c=65.0)).split(";LAYER_CHANGE\n")
    assert "M104" not in same[1]
    assert "M140" not in same[1]


def test_a_temperature_that_nobody_knows_is_left_out(part, tmp_path):
    """Its line becomes a comment: better than a printer that waits for a brace."""
    text = written(tmp_path / "a.gcode", part, replace(lf.load_printer(MK3S), bed_c=None, first_layer_bed_c=None))
    assert not re.search(r"^M1[49]0 S(?!0$)", text, re.M)
    assert "{" not in "".join(line for line in text.splitlines() if not line.startswith(";"))


def test_units_and_positions_are_set_whatever_the_start_code_does(part, tmp_path):
    """G21, G90 and M83 come after it, and the E is set to 0."""
    printer = replace(lf.load_printer(MK3S), start_gcode="G91\nM82\n", end_gcode=None)
    head = written(tmp_path / "a.gcode", part, printer).split(";LAYER_CHANGE")[0].splitlines()
    after = head[head.index("M82") + 1 :]
    assert [line for line in after if line in ("G21", "G90", "M83", "G92 E0")] == ["G21", "G90", "M83", "G92 E0"]


@each_printer
def test_the_part_lies_in_the_middle_of_the_bed(texts, name):
    """Its box's middle is the bed's, and all of it is on the bed."""
    printer = lf.load_printer(name)
    laid = [m for m in printed(texts[name]) if m.lays and m.kind != "Skirt/Brim"]
    points = np.array([p for m in laid for p in (m.start, m.end)])
    low, high = points.min(0)[:2], points.max(0)[:2]
    assert (low + high) / 2 == pytest.approx(np.array(printer.build_mm[:2]) / 2, abs=0.06)
    every = np.array([m.end for m in moves_of(texts[name])])
    assert (every[:, :2] >= 0).all()
    assert (every[:, :2] <= printer.build_mm[:2]).all()


@pytest.mark.parametrize("size", [(248, 30), (30, 209), (249, 209)])
def test_the_skirt_stays_on_the_bed_round_a_part_that_fills_it(tmp_path, size):
    """No move goes where the printer cannot, however much room the part leaves."""
    stack = stack_of(*[drawn(size, box(0, 0, *size), 0.125)] * 2, pixel_mm=0.125)
    text = written(tmp_path / "a.gcode", stack, replace(lf.load_printer(MK3S), start_gcode=None))
    points = np.array([m.end[:2] for m in moves_of(text)])
    assert (points >= 0).all()
    assert (points <= lf.load_printer(MK3S).build_mm[:2]).all()


# The command


@pytest.fixture(scope="module")
def stl(tmp_path_factory) -> Path:
    """The thin part, 6 × 4 × 2 mm."""
    return write_stl(tmp_path_factory.mktemp("stl") / "part.stl", thin_part())


def fixed(stl: Path, target: Path, *options: object, printer: str = MK3S) -> str:
    """The text that a real process writes."""
    run = run_layerfix("fix", stl, target, "--printer", printer, *options)
    assert (run.code, run.err) == (0, "")
    return target.read_text()


def test_fix_writes_what_the_library_writes(stl, tmp_path):
    """The same bytes by process and by call, for any number of workers; nothing else is left."""
    one = fixed(stl, tmp_path / "one.gcode", "--workers", 1)
    two = fixed(stl, tmp_path / "two.gcode", "--workers", 5)
    assert one == two
    printer = lf.load_printer(MK3S)
    heights = {"layer_mm": 0.15, "first_layer_mm": 0.2}
    sliced = lf.slice_mesh(lf.load_mesh(stl), pixel_mm=printer.pixel_mm, margin_mm=0.8, **heights)
    lf.write(tmp_path / "three.gcode", lf.correct(sliced, min_feature_mm=0.8, mode="as_printed"), printer)
    assert (tmp_path / "three.gcode").read_text() == one
    assert set(contents(tmp_path)) == {"one.gcode", "two.gcode", "three.gcode"}


def test_fix_keeps_the_fin_and_says_how_long_it_takes(stl, tmp_path):
    """A fin of 0.1 mm is on every layer up to its top; the summary tells time and filament."""
    run = run_layerfix("fix", stl, tmp_path / "a.gcode", "--printer", MK3S, "--json")
    notes = " ".join(json.loads(run.out)["notes"])
    assert "filament" in notes
    assert "printing takes" in notes
    layers = read_gcode(tmp_path / "a.gcode")
    assert layers[-1].z_mm[1] == pytest.approx(2.0)
    assert len(layers) == 13
    for layer in layers[4:]:
        points = np.concatenate([p.points_mm for p in layer.paths])
        assert np.ptp(points[:, 1]) > 2.3


def test_options_of_the_command(stl, tmp_path):
    """--layers, --width, --infill, --seam, --perimeters and --skirt are heeded."""
    plain = read_gcode(write_text(tmp_path, "plain", fixed(stl, tmp_path / "1.gcode")))

    def layers(*options: object) -> list:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.gcode"
        fixed(stl, path, *options)
        return read_gcode(path)

    few = layers("--layers", "0:2")
    assert [x.z_mm for x in few] == [x.z_mm for x in plain[:2]]
    wide = layers("--width", "0.6mm", "--layers", "0:2")
    outer = [p for x in wide for p in x.paths if p.kind == "External perimeter"]
    assert [main_width(outer), main_width([p for p in plain[1].paths if p.kind == "External perimeter"])] == [
        pytest.approx(0.6, abs=0.011),
        pytest.approx(0.45, abs=0.011),
    ]  # corners are balanced: wider
    skirts = layers("--skirt", "3", "--layers", "0:2")
    assert [sum(p.kind == "Skirt/Brim" for p in x.paths) for x in skirts] == [3, 0]
    assert not [p for p in layers("--skirt", "0", "--layers", "0")[0].paths if p.kind == "Skirt/Brim"]
    assert sum(p.kind == "Perimeter" for p in layers("--perimeters", "3", "--layers", "1")[0].paths) == 2
    rear = layers("--seam", "rear", "--layers", "0:2")
    loops = [p for x in rear for p in x.paths if p.kind == "Perimeter" and p.closed]
    assert loops
    assert all(p.points_mm[0, 1] == p.points_mm[:, 1].max() for p in loops)


def write_text(folder: Path, name: str, text: str) -> Path:
    path = folder / f"{name}.txt"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("density", "kinds"), [("0%", set()), ("100%", {"Solid infill"}), ("0.3", {"Internal infill"})]
)
def test_infill_of_the_command(tmp_path, density, kinds):
    """In the middle of a block of 12 layers: nothing, solid or sparse."""
    cube = write_stl(tmp_path / "block.stl", block([0, 0, 0], [9, 9, 2.4]))
    fixed(cube, tmp_path / "a.gcode", "--infill", density, "--layer", "0.2mm")
    middle = read_gcode(tmp_path / "a.gcode")[6]
    assert {p.kind for p in middle.paths} - {"External perimeter", "Perimeter"} == kinds


def one_line(run, code: int, *words: str) -> None:
    """A refusal: exit code, nothing printed, one line that says why."""
    assert run.code == code
    assert run.out == ""
    assert len(run.err.strip().splitlines()) == 1
    assert all(word in run.err for word in words), run.err


def test_refusals(stl, tmp_path):
    """A part larger than the bed, too high layers, resin printers, no printer: exit 2, one line, nothing written."""
    large = write_stl(tmp_path / "large.stl", block([0, 0, 0], [260, 20, 2]))
    target = tmp_path / "out" / "a.gcode"
    target.parent.mkdir()
    one_line(run_layerfix("fix", large, target, "--printer", MK3S), 2, "larger", "250")
    one_line(run_layerfix("fix", stl, target, "--printer", MK3S, "--layer", "0.5mm"), 2, "layer height", "nozzle")
    one_line(run_layerfix("fix", stl, target, "--printer", MK3S, "--first-layer", "0.5mm"), 2, "layer height")
    one_line(run_layerfix("fix", stl, target, "--printer", MK3S, "--width", "0.2mm"), 2, "width")
    one_line(run_layerfix("fix", stl, target, "--printer", "prusa-sl1s"), 2, "nozzle")
    sizes = ("--pixel", "50um", "--layer", "0.2mm", "--min-feature", "0.8mm")
    one_line(run_layerfix("fix", stl, target, *sizes), 2, "--printer")
    assert list(target.parent.iterdir()) == []


def test_a_stack_larger_than_the_bed_is_refused(tmp_path):
    """Layers of images too, which nothing has measured before."""
    stack = stack_of(*[np.ones((200, 2000), bool)] * 2, pixel_mm=0.13)
    with pytest.raises((InputError, OutputError), match=r"250|bed|large"):
        lf.write(tmp_path / "a.gcode", stack, lf.load_printer(MK3S))
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_kept_without_force(stl, tmp_path):
    """And replaced with it."""
    target = tmp_path / "a.gcode"
    target.write_text("mine")
    one_line(run_layerfix("fix", stl, target, "--printer", MK3S), 2, "--force")
    assert target.read_text() == "mine"
    assert ";LAYER_CHANGE" in fixed(stl, target, "--force")


def test_empty_layers_in_the_middle(tmp_path):
    """Warned about with their z's; the file has the other layers at their heights."""
    two = joined(block([0, 0, 0], [5, 5, 0.6]), block([0, 0, 1.0], [5, 5, 1.6]))
    run = run_layerfix("fix", write_stl(tmp_path / "two.stl", two), tmp_path / "a.gcode", "--printer", MK3S,
                       "--layer", "0.2mm", "--json")  # fmt: skip
    assert run.code == 0
    (note,) = [note for note in json.loads(run.out)["notes"] if "empty" in note]
    assert "2 layers are empty" in note
    assert "0.600" in note
    assert "0.800" in note
    layers = read_gcode(tmp_path / "a.gcode")
    assert [x.z_mm[1] for x in layers] == pytest.approx([0.2, 0.4, 0.6, 1.2, 1.4, 1.6])
    assert {p.kind for p in layers[3].paths if "infill" in p.kind} == {"Solid infill"}
    text = (tmp_path / "a.gcode").read_text()
    assert all(m.height == pytest.approx(0.2) for m in printed(text) if m.lays)


def test_nothing_is_left_after_an_error_in_the_middle(part, tmp_path):
    """A layer that cannot be made: no file, no half of one; an old one stays."""
    make = part.make

    def broken(index):
        if index == 5:
            raise InputError("layer 5 is broken")
        return make(index)

    with pytest.raises(InputError, match="layer 5"):
        lf.write(tmp_path / "a.gcode", replace(part, make=broken), lf.load_printer(MK3S))
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "a.gcode").write_text("old")
    with pytest.raises(InputError, match="layer 5"):
        lf.write(tmp_path / "a.gcode", replace(part, make=broken), lf.load_printer(MK3S), force=True)
    assert contents(tmp_path) == {"a.gcode": b"old"}


def test_what_the_writer_refuses(part, tmp_path):
    """No printer, one without a nozzle, one whose dialect is not written, nothing to print."""
    with pytest.raises(OutputError, match=r"Ultimaker S5 takes only .*Griffin.*\.3mf or \.stl"):
        lf.write(tmp_path / "a.gcode", part, lf.load_printer("ultimaker-s5-0.4"))
    with pytest.raises(OutputError, match="--printer"):
        lf.write(tmp_path / "a.gcode", part)
    with pytest.raises(InputError, match="nozzle"):
        lf.write(tmp_path / "a.gcode", part, lf.load_printer("prusa-sl1s"))
    with pytest.raises(OutputError, match="empty"):
        lf.write(tmp_path / "a.gcode", stack_of(np.zeros((20, 64), bool)), lf.load_printer(MK3S))
    assert list(tmp_path.iterdir()) == []


def test_parts_smaller_than_a_bead_are_told_of(tmp_path):
    """In a sentence, with the number and the first height."""
    stack = stack_of(*[drawn((12, 12), box(1, 1, 8, 8) | box(10, 10, 10.2, 10.2))] * 2)
    told: list[str] = []
    lf.write(tmp_path / "a.gcode", stack, lf.load_printer(MK3S), tell=told.append)
    assert any("2 parts" in line and "0.2 mm" in line for line in told), told


def test_widths_of_each_layer(part, tmp_path):
    """`width_mm` of `write` is each layer's."""
    widths = [0.4, 0.45, 0.5, 0.55, 0.6, 0.5, 0.4]
    lf.write(tmp_path / "a.gcode", part, lf.load_printer(MK3S), width_mm=widths)
    for layer, width in zip(read_gcode(tmp_path / "a.gcode"), widths, strict=True):
        assert main_width([p for p in layer.paths if p.kind == "External perimeter"]) == pytest.approx(
            width, abs=0.011
        )


# Reading


@pytest.mark.parametrize("name", [MK3S, TAZ])
def test_what_was_written_is_read_again(part, tmp_path, name):
    """Paths, widths, kinds and z's, to the digits of the file; with absolute E and thick filament too."""
    printer = lf.load_printer(name)
    lf.write(tmp_path / "a.gcode", part, printer)
    planned = list(plan_toolpaths(part, settings_for(printer)))
    layers = read_gcode(tmp_path / "a.gcode")
    shift = np.array(printer.build_mm[:2]) / 2 - [17.0, 12.0]
    assert [x.z_mm for x in layers] == [pytest.approx(x.z_mm) for x in planned]
    for got, expected in zip(layers, planned, strict=True):
        assert got.volume_mm3() == pytest.approx(expected.volume_mm3(), rel=1e-3)
        for kind in KINDS:
            mine, its = ([p for p in x.paths if p.kind == kind] for x in (got, expected))
            length = sum(float(p.lengths_mm.sum()) for p in its)
            assert sum(float(p.lengths_mm.sum()) for p in mine) == pytest.approx(length, abs=0.02 + 1e-3 * length)
            if its:
                a, b = (shapely.union_all([shapely.linestrings(p.points_mm + s) for p in x]) for x, s in
                        ((mine, 0), (its, shift)))  # fmt: skip
                assert shapely.hausdorff_distance(a, b) < 2e-3
        widths = {round(float(w), 4) for p in expected.paths for w in p.width_mm[p.lengths_mm > 2e-3]}
        assert {round(float(w), 4) for p in got.paths for w in p.width_mm} >= widths


def test_widths_from_e_where_no_comment_says_them(part, tmp_path):
    """Without ;WIDTH: the bead's section tells its width."""
    text = written(tmp_path / "a.gcode", part, MK3S)
    (tmp_path / "b.gcode").write_text("".join(x for x in text.splitlines(True) if not x.startswith(";WIDTH")))
    said, found = (read_gcode(tmp_path / f"{name}.gcode") for name in "ab")
    for one, other in zip(said, found, strict=True):
        assert other.volume_mm3() == pytest.approx(one.volume_mm3(), rel=0.002)
        long = [(w, length) for p in other.paths for w, length in zip(p.width_mm, p.lengths_mm, strict=True)]
        near = [min(abs(w - v) for p in one.paths for v in p.width_mm) for w, length in long if length > 2]
        assert max(near) < 2e-3


@pytest.mark.parametrize("text", ["", "G28\nM104 S0\n", "hello\n;LAYER_CHANGE\n", "G1 X10 Y10 F600\nG1 X20\n"])
def test_files_that_lay_nothing(tmp_path, text):
    """Are refused by name."""
    path = tmp_path / "a.gcode"
    path.write_text(text)
    with pytest.raises(InputError, match=r"a\.gcode"):
        read_gcode(path)
    with pytest.raises(InputError, match=r"none\.gcode"):
        read_gcode(tmp_path / "none.gcode")


def test_the_priming_line_is_no_part(texts, tmp_path):
    """What the start code extrudes is before the first layer."""
    (tmp_path / "a.gcode").write_text(texts[MK3S])
    layers = read_gcode(tmp_path / "a.gcode")
    assert min(float(p.points_mm[:, 1].min()) for x in layers for p in x.paths) > 50
    assert any(m.lays and m.layer < 0 for m in moves_of(texts[MK3S]))


def test_gcode_is_not_read_as_layers(texts, tmp_path):
    """`read` wants layers, and names the file it refuses."""
    (tmp_path / "a.gcode").write_text(texts[MK3S])
    with pytest.raises(InputError, match=r"a\.gcode"):
        read_layers(tmp_path / "a.gcode")


@pytest.mark.skipif(not (SHARED / "tools" / "gcode_metric.py").is_file(), reason="the metric is not here")
def test_another_interpreter_reads_the_same(texts, part, tmp_path):
    """A program that knows nothing of layerfix finds the layers, heights and volume, and the part covered."""
    metric = runpy.run_path(str(SHARED / "tools" / "gcode_metric.py"))
    path = tmp_path / "a.gcode"
    path.write_text(texts[MK3S])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # it leaves the file open
        layers = metric["parse"](path, 1.75)
    layers = [layer for layer in layers if layer["z"] in [round(z, 3) for z in part.z_mm[:, 1]]]
    assert [layer["h"] for layer in layers] == pytest.approx([0.2] * 7)
    planned = plan_toolpaths(part, settings_for(lf.load_printer(MK3S), skirt_loops=0))
    for layer, expected in zip(layers, planned, strict=True):
        types = {k: v for k, v in layer["types"].items() if k in KINDS}
        assert sum(types.values()) == pytest.approx(expected.volume_mm3(), rel=0.01)


@pytest.mark.parametrize(
    "name",
    [pytest.param(m.name, marks=pytest.mark.skipif(bool(why_not(m)), reason=why_not(m))) for m in MODES.values()],
)
def test_gcode_of_slicers(name, tmp_path):
    """A block of 12 × 9 × 2 mm: ten layers 0.2 mm apart, filled with about as much plastic as it has room for."""
    mode = MODES[name]
    stl = write_stl(tmp_path / "block.stl", block([-6, -4.5, 0], [6, 4.5, 2]))
    done = subprocess.run(list(map(str, mode.command(stl, tmp_path / "a.gcode"))), capture_output=True, check=False)
    assert done.returncode == 0
    layers = read_gcode(tmp_path / "a.gcode")
    assert [x.z_mm[1] for x in layers] == pytest.approx(np.arange(1, 11) * 0.2, abs=1e-3)
    assert [x.layer_mm for x in layers] == pytest.approx([0.2] * 10, abs=1e-3)
    volume = sum(x.volume_mm3() for x in layers)
    assert volume == pytest.approx(12 * 9 * 2, rel=0.1)
    for x in layers:
        points = np.concatenate([p.points_mm for p in x.paths])
        assert np.ptp(points, axis=0) == pytest.approx([12 - 0.42, 9 - 0.42], abs=0.15)
        assert 0.2 < np.median(np.concatenate([p.width_mm for p in x.paths])) < 0.8


@pytest.mark.skipif(not shutil.which("prusa-slicer"), reason="prusa-slicer is not installed")
def test_comments_are_those_that_prusaslicer_writes(tmp_path, texts):
    """Every kind of comment line of ours is one of its own; so are the kinds of beads."""
    stl = write_stl(tmp_path / "block.stl", block([-8, -8, 0], [8, 8, 3]))
    command = ["prusa-slicer", "--loglevel", "1", "-g", "--layer-height", "0.2", "--center", "100,100",
               "--skirts", "1", "--fill-density", "20%", "-o", str(tmp_path / "a.gcode"), str(stl)]  # fmt: skip
    subprocess.run(command, capture_output=True, check=True)
    its, ours = (tmp_path / "a.gcode").read_text(), texts[MK3S]
    keys = {line[1:].partition(":")[0] for line in ours.splitlines() if re.match(r";[A-Z]", line)}
    assert keys == {"LAYER_CHANGE", "Z", "HEIGHT", "TYPE", "WIDTH"}
    assert keys <= {m[1] for m in re.finditer(r"^;([A-Z_]+)", its, re.M)}
    kinds = [set(re.findall(r"^;TYPE:(.*)$", text, re.M)) - {"Custom"} for text in (ours, its)]
    assert len(kinds[0] & kinds[1]) >= 4


def test_what_floats_is_put_on_the_bed(tmp_path):
    """Empty layers below, or only some layers: the first that has anything is laid as a first layer."""
    plate = drawn((8, 8), Point(4, 4).buffer(2))
    stack = stack_of(np.zeros_like(plate), np.zeros_like(plate), plate, plate, plate)
    said = []
    printer = lf.load_printer(MK3S)
    lf.write(tmp_path / "a.gcode", stack, printer, tell=said.append, width_mm=[0.5, 0.5, 0.4, 0.45, 0.45])
    lf.write(tmp_path / "b.gcode", stack[2:], printer, width_mm=[0.4, 0.45, 0.45])
    assert (tmp_path / "a.gcode").read_text().splitlines()[2:] == (tmp_path / "b.gcode").read_text().splitlines()[2:]
    assert [layer.z_mm[1] for layer in read_gcode(tmp_path / "a.gcode")] == pytest.approx([0.2, 0.4, 0.6])
    assert any("z = 0.4 mm" in line and "put on the bed" in line for line in said)
    seen = []
    lf.write(tmp_path / "c.gcode", stack, printer, watch=lambda index, layer: seen.append((index, layer.z_mm[0])))
    assert seen == [(k, pytest.approx(0.2 * k)) for k in range(5)]


def test_a_pin_is_slowed_but_no_bead_below_ten(tmp_path):
    """A pin of 0.8 mm cannot take eight seconds a layer at 10 mm/s: the time told is that of what is written."""
    pin = stack_of(*[drawn((6, 6), Point(3, 3).buffer(0.4))] * 20)
    text = written(tmp_path / "a.gcode", pin, MK3S)
    laid = [m.mm_min for m in printed(text) if m.lays and m.kind != "Skirt/Brim"]
    assert set(laid) == {600.0}
    ring = stack_of(*[drawn((20, 20), Point(10, 10).buffer(8) - Point(10, 10).buffer(7.2))] * 5)
    printer = lf.load_printer(MK3S)
    most = dict(zip(LIMITS, (printer.axis_mm_s, printer.axis_mm_s2, printer.axis_jerk_mm_s), strict=True))
    ringed = written(tmp_path / "b.gcode", ring, replace(printer, start_gcode="", end_gcode=""))
    layers = ringed.split(";LAYER_CHANGE")[2:]
    starts = [re.search(r"G1 (X[\d.]+ Y[\d.]+)", layer)[1] for layer in layers]
    seconds = [timed(f"M83\nG92 {at} Z0.4\n{layer}").seconds(most) for at, layer in zip(starts, layers, strict=True)]
    assert all(7.5 < s < 9 for s in seconds), seconds  # 96 mm of wall, done in less than 5 s otherwise


@pytest.mark.parametrize(
    ("move", "length"),
    [
        ("G3 X10 Y10 I0 J5 E2", 5 * np.pi), ("G2 X10 Y10 I0 J5 E2", 5 * np.pi), ("G3 X10 Y10 R5 E2", 5 * np.pi),
        ("G3 X10 Y0 I0 J5 E2", 10 * np.pi), ("G2 X10 Y0 I-5 J0 E2", 10 * np.pi),
        ("G3 X15 Y5 I0 J5 E2", 2.5 * np.pi), ("G2 X15 Y5 I0 J5 E2", 7.5 * np.pi), ("G3 X15 Y5 R5 E2", 2.5 * np.pi),
        ("G3 X15 Y5 R-5 E2", 7.5 * np.pi),
    ],
)  # fmt: skip
def test_arcs_are_read(tmp_path, move, length):
    """G2 clockwise, G3 the other way, by their centre or their radius; what follows goes on from their end."""
    text = f"M82\nG1 Z0.2\nG1 X0 Y0 F600\n;WIDTH:0.4\nG1 X10 Y0 E1\n{move}\nG1 X0 Y10 E3\n"
    (tmp_path / "a.gcode").write_text(text)
    (path,) = read_gcode(tmp_path / "a.gcode")[0].paths
    target = np.array([float(word[1:]) for word in move.split()[1:3]])
    assert path.lengths_mm.sum() == pytest.approx(10 + length + np.hypot(*(target - [0, 10])), rel=0.01)


def test_widths_from_e_use_the_height_of_their_layer(tmp_path):
    """Without comments the height is the step in z: a 0.4 mm bead stays one on layers of 0.1 mm."""
    section = (0.4 - 0.1) * 0.1 + np.pi * 0.1**2 / 4
    e = section * 10 / (np.pi * 1.75**2 / 4)
    lines = ["M83"]
    for k in (1, 2, 3):
        lines += [f"G1 Z{0.1 * k:.1f}", "G1 X0 Y0", f"G1 X10 Y0 E{e:.6f}"]
    (tmp_path / "a.gcode").write_text("\n".join(lines))
    for layer in read_gcode(tmp_path / "a.gcode"):
        assert layer.paths[0].width_mm == pytest.approx([0.4], abs=1e-4)


@each_printer
def test_the_first_way_goes_at_the_height_of_the_start_code(texts, name):
    """Retracted, sideways, down, and only then on: not across the bed at the height of the first layer."""
    lines = texts[name].partition(";LAYER_CHANGE")[2].splitlines()
    moves = [line for line in lines if line.startswith("G1 ")][:4]
    assert [re.sub(r"[-\d.]+", "", move) for move in moves] == ["G E F", "G X Y F", "G Z F", "G E F"]


def test_a_part_beside_the_bed_is_not_called_too_large(tmp_path):
    """It would fit, but the frame's middle is the bed's: the message says so."""
    image = np.zeros((7000, 7000), bool)
    image[:200, :200] = True
    stack = LayerStack.from_images([image], pixel_mm=0.05, layer_mm=0.2)
    with pytest.raises(InputError, match=r"9\.\d+ × 9\.\d+ mm, which fits prusa-mk3s-0\.4 .* lies beside its bed"):
        lf.write(tmp_path / "a.gcode", stack, lf.load_printer(MK3S))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("G1 X1 Y1 Z0.2\nG1 X10 Y1 E1\n; filament_diameter = 1.75.1\n", ["filament_diameter", "1.75.1"]),
        ("G1 X1 Y1 Z0.2\nG1 X10 Y1 E1\n; filament_diameter = 0\n", ["filament_diameter", "0"]),
        ("G1 X1 Y1 Z0.2\nG1 X10 Y1 E1\n; filament_diameter = " + "9" * 4000, ["filament_diameter", "999..."]),
        ("G1 X1 Y1 Z0.2\nG2 X10 Y1 R1" + "0" * 200 + " E1\n", ["line 2", "too large"]),
        ("G1 X1 Y1 Z0.2\nG1 X1" + "0" * 5000 + " E1\n", ["line 2", "too large"]),
        ("G1 X1 Y1 Z0.2\nG3 X10 Y1 I1" + "0" * 170 + " J-1 E1\n", ["line 2", "too large"]),
        ("G1 X1 Y1 Z0\nG1 X10 Y1 E1\n", ["z = 0 mm", "layer"]),
        ("G1 X1 Y1 Z-3\nG1 X10 Y1 E1\n", ["z = -3 mm", "layer"]),
        ("G1 X1 Y1 Z0.2\nG1 X1.2.3 Y1 E1\n", ["line 2", "X1.2.3"]),
        ("G1 X1 Y1 Z0.2\nG1 X1-2 Y1 E1\n", ["line 2", "X1-2"]),
    ],
)
def test_numbers_that_are_none_are_named(tmp_path, text, words):
    """One line, by the command too."""
    path = tmp_path / "a.gcode"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_gcode(path)
    assert all(word in str(refusal.value) for word in ["a.gcode", *words]), str(refusal.value)
    assert len(str(refusal.value)) < 250


def test_what_else_a_move_may_hold(tmp_path):
    """Line numbers, checksums, remarks in brackets, no blanks; the first of several filaments; beads at z 0 with a
    height of their own."""
    path = tmp_path / "a.gcode"
    path.write_text("N1 G1 X1 Y1 Z0.2*71\nN2 G1X10.Y1(to the right)E1 *33\n; filament_diameter = 2.85,1.75\n")
    (layer,) = read_gcode(path)
    assert layer.paths[0].points_mm.tolist() == [[1, 1], [10, 1]]
    section = np.pi * 2.85**2 / 4 / 9
    assert layer.paths[0].width_mm == pytest.approx(section / 0.2 + 0.2 * (1 - np.pi / 4))
    path.write_text(";HEIGHT:0.3\nG1 X1 Y1 Z0\nG1 X10 Y1 E1\n")
    assert read_gcode(path)[0].z_mm == pytest.approx((-0.3, 0.0))
