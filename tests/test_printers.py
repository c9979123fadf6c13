"""Printers from TOML: those shipped are sound, and a wrong word in one's own is named."""

from __future__ import annotations

import json
import math
import re
import struct
import zipfile
from dataclasses import asdict, fields
from pathlib import Path

import pytest

from layerfix import Printer, load_printer
from layerfix.errors import InputError
from layerfix.printers import (
    GCODE_PLACEHOLDERS,
    KEYS,
    description,
    find_printers,
    listing,
    printer_folder,
    printer_names,
)
from tests.making import SHARED, Run, run_layerfix

# Written by hand, with all that a new job needs; tests/test_printer_files.py tests those made of tables, too.
ALL = [load_printer(name) for name in printer_names()]
RESIN = [p.name for p in ALL if p.process == "resin" and p.exposure_s]
FDM = [p.name for p in ALL if p.start_gcode]
every_printer = pytest.mark.parametrize("name", [*RESIN, *FDM])

# Machines that must be there: name, columns × rows, pitch in µm, format.
EXPECTED_RESIN = """
prusa-sl1                     1440x2560   47.25x47.25    .sl1
prusa-sl1s                    1620x2560   50x50          .sl1s
elegoo-mars                   1440x2560   47.25x47.25    .ctb
elegoo-mars-2-pro             1620x2560   51x51          .ctb
elegoo-mars-3                 4098x2560   35x35          .ctb
elegoo-mars-4-ultra           8520x4320   18x18          .goo
elegoo-mars-5-ultra           8520x4320   18x18          .ctb
elegoo-mars-4-dlp             2560x1440   51.875x51.875  .goo
elegoo-saturn-3-ultra         11520x5120  19x24          .goo
elegoo-saturn-4-ultra-12k     11520x5120  19x24          .ctb
elegoo-saturn-4-ultra-16k     15120x6230  14x19          .ctb
anycubic-photon-mono          1620x2560   51x51          .pwmo
anycubic-photon-mono-m5s      11520x5120  19x24          .pm5s
anycubic-photon-mono-m7       13312x5120  16.8x24.8      .pm7
anycubic-photon-mono-m7-pro   13312x5120  16.8x24.8      .pwsz
anycubic-photon-d2            2560x1440   51x51          .dl2p
phrozen-sonic-mini-8k         7500x3240   22x22          .ctb
phrozen-sonic-mega-8k         7680x4320   43x43          .ctb
concepts3d-athena-12k         11520x5120  19x24          .nanodlp
flashforge-hunter             1920x1080   62.5x62.5      .svgx
"""

# The same: name, layer height, first layer, outer wall, dialect, relative E.
EXPECTED_FDM = """
prusa-mk3s-0.25          0.10  0.20  0.25  marlin   True
prusa-mk3s-0.4           0.15  0.20  0.45  marlin   True
prusa-mk3s-0.6           0.30  0.20  0.65  marlin   True
prusa-mk3s-0.8           0.40  0.30  0.90  marlin   True
prusa-mini-0.4           0.15  0.20  0.45  marlin2  True
prusa-mk4-0.6            0.25  0.20  0.65  marlin2  True
prusa-xl-0.8             0.40  0.20  0.90  marlin2  True
ender-3-0.4              0.16  0.20  0.42  marlin   True
ender-3-0.6              0.24  0.30  0.63  marlin   True
ratrig-v-core-4-400-0.6  0.25  0.35  0.65  klipper  True
ultimaker-s5-0.4         0.20  0.20  0.40  griffin  False
lulzbot-taz6-0.5         0.25  0.30  0.56  marlin   False
"""

# What writing G-code needs. The S5's profile leaves acceleration to the printer's own.
SPEEDS = (
    "external_perimeter_mm_s", "perimeter_mm_s", "infill_mm_s", "solid_infill_mm_s", "top_infill_mm_s",
    "gap_fill_mm_s", "first_layer_mm_s", "travel_mm_s",
)  # fmt: skip
FOR_GCODE = (
    *SPEEDS, "acceleration_mm_s2", "retract_mm", "retract_mm_s", "retract_lift_mm", "retract_before_travel_mm",
    "nozzle_c", "first_layer_nozzle_c", "bed_c", "first_layer_bed_c", "fan_percent", "start_gcode", "end_gcode",
)  # fmt: skip
UNKNOWN = {("ultimaker-s5-0.4", "acceleration_mm_s2")}

# The same profiles' machine limits (X, Z and E; Y is as X): mm/s, mm/s2, jerk in mm/s; speed and flow of bridges.
EXPECTED_LIMITS = """
prusa-mk3s-0.25          200 12 120   1000  200 5000  8 0.4 4.5  20 1
prusa-mk3s-0.4           200 12 120   1000  200 5000  8 0.4 4.5  25 1
prusa-mk3s-0.6           200 12 120   1000  200 5000  8 0.4 4.5  25 1
prusa-mk3s-0.8           200 12 120   1000  200 5000  8 0.4 4.5  22 0.9
prusa-mini-0.4           180 12  80   2500  400 5000  8 2   10   25 1
prusa-mk4-0.6            200 40 100   2500  200 2500  8 2   10   25 1
prusa-xl-0.8             400 12 100   5000  200 2500  8 2   10   22 0.9
ender-3-0.4              500 10  60    500  100 5000  8 0.4 5    25 0.85
ender-3-0.6              500 10  60    500  100 5000  8 0.4 5    25 0.95
ratrig-v-core-4-400-0.6  400 50 120  10000  200 5000  5 0.4 5    50 0.85
lulzbot-taz6-0.5         300  3  40   9000  100 1000  8 0.4 10   30 1
"""

# PrusaSlicer's profiles: name, outer and inner walls, sparse, solid and top infill, first layer, nozzle and bed (°C)
EXPECTED_SPEEDS = """
prusa-mk3s-0.25          20   30   45   45     30     20    215  60
prusa-mk3s-0.4           25   45   80   80     40     20    215  60
prusa-mk3s-0.6           35   45   70   70     45     20    215  60
prusa-mk3s-0.8           25   35   50   45     35     20    225  60
prusa-mini-0.4           30   40   80   80     40     20    215  60
prusa-mk4-0.6            35   60   200  80     40     20    215  60
prusa-xl-0.8             40   45   70   45     35     25    220  60
ender-3-0.4              25   40   50   40     30     20    205  60
ender-3-0.6              25   40   50   40     30     20    205  60
ratrig-v-core-4-400-0.6  250  350  400  400    160    50    210  70
ultimaker-s5-0.4         25   50   70   52.5   26.25  12.5  210  60
lulzbot-taz6-0.5         35   45   60   60     40     15    220  60
"""

FORMATS = {
    *(".sl1", ".sl1s", ".m1", ".ctb", ".goo", ".photon", ".nanodlp", ".svgx", ".cxdlp", ".cxdlpv4", ".gcode"),
    *(".pws", ".pwmo", ".pwmx", ".pm3", ".pm4n", ".pm5s", ".pm7", ".pwsz", ".dl2p"),  # Anycubic
}
SOURCES = ("UVtools", "PrusaSlicer", "OrcaSlicer", "sla-fw")

GOOD = {
    "maker": '"Me"', "model": '"One"', "process": '"resin"', "build_mm": "[100.0, 50.0, 150]",
    "layer_mm": "0.05", "layer_range_mm": "[0.02, 0.1]", "min_feature_mm": "0.2", "pixel_mm": "[0.05, 0.05]",
}  # fmt: skip


def own(folder: Path, **changes: str | None) -> Path:
    """A printer file like GOOD, with some keys changed, added, or left out (None)."""
    keys = {k: v for k, v in {**GOOD, **changes}.items() if v is not None}
    path = folder / "mine.toml"
    path.write_text("".join(f"{k} = {v}\n" for k, v in keys.items()))
    return path


def problem(path: Path | str) -> str:
    with pytest.raises(InputError) as caught:
        load_printer(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def succeeds(done: Run) -> str:
    """Exit code 0 and nothing on stderr; gives stdout."""
    assert (done.code, done.err) == (0, "")
    return done.out


def code(text: str) -> list[str]:
    """The commands of some G-code, without its comments."""
    return [command for line in text.splitlines() if (command := line.partition(";")[0].strip())]


def words(command: str) -> dict[str, float]:
    """Of a move: ``{"X": 10, "F": 6000}``."""
    return {word[0]: float(word[1:]) for word in command.split()[1:]}


def comments(name: str) -> dict[str, str]:
    """The comment lines right above each key of a shipped printer."""
    above, found = "", {}
    for line in (printer_folder() / f"{name}.toml").read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            above += line
        else:
            found[line.split(" = ")[0]] = above
            above = ""
    return found


# those shipped --------------------------------------------------------------------------------------------


def test_there_are_printers():
    """At least 30, found beside the source or inside the package, under the names of their files."""
    assert len(printer_names()) >= 30
    assert set(printer_names()) == {path.stem for path in printer_folder().glob("*.toml")}
    assert {path.suffix for path in printer_folder().iterdir()} == {".toml", ".json"}


def test_no_printer_is_there_twice():
    """Maker, model and nozzle tell them apart."""
    plates = [(p.maker, p.model, p.nozzle_mm) for p in ALL]
    assert len(set(plates)) == len(plates)


@pytest.mark.parametrize("line", EXPECTED_RESIN.strip().splitlines())
def test_the_resin_printers_people_have(line):
    """Image size, pitch and format are those of the machine's own job files."""
    name, pixels, pitch_um, suffix = line.split()
    printer = load_printer(name)
    assert printer.process == "resin"
    assert printer.pixels == tuple(map(int, pixels.split("x")))
    assert printer.pixel_mm == pytest.approx([float(um) / 1000 for um in pitch_um.split("x")])
    assert printer.format == suffix


@pytest.mark.parametrize(
    ("name", "job", "layer"),
    [("prusa-sl1", "layer_change.sl1", "layer_change00000.png"),
     ("prusa-sl1s", "UVtools_demo_file.sl1s", "UVtools_demo_file00000.png")],
)  # fmt: skip
def test_the_images_of_a_real_job_have_the_printers_pixels(name, job, layer):
    """Columns and rows of the PNG, also where the profile calls the panel 2560 wide and turns it."""
    if not (SHARED / "samples" / job).is_file():
        pytest.skip("other people's job files are not here")
    with zipfile.ZipFile(SHARED / "samples" / job) as file:
        assert struct.unpack(">II", file.read(layer)[16:24]) == load_printer(name).pixels


@pytest.mark.parametrize("line", EXPECTED_FDM.strip().splitlines())
def test_the_fdm_printers_people_have(line):
    """Heights, bead and G-code dialect are those of PrusaSlicer's profiles."""
    name, layer, first, width, flavor, relative = line.split()
    printer = load_printer(name)
    assert (printer.layer_mm, printer.first_layer_mm) == (float(layer), float(first))
    assert printer.extrusion_width_mm == float(width)
    assert (printer.gcode_flavor, str(printer.relative_extrusion)) == (flavor, relative)
    assert printer.nozzle_mm == float(name.rpartition("-")[2])


@every_printer
def test_every_shipped_printer_is_sound(name):
    """It loads under its name, its layer height is in its range, and its feature is larger than a pixel."""
    printer = load_printer(name)
    assert printer.name == name
    assert printer.maker
    assert printer.model
    assert printer.layer_range_mm[0] <= printer.layer_mm <= printer.layer_range_mm[1]
    assert 2 * max(printer.pixel_mm) <= printer.min_feature_mm < 2
    assert all(50 < side < 2000 for side in printer.build_mm)
    assert printer.mirror in ("", "x", "y", "xy")
    assert printer.format in FORMATS
    assert printer.process in ("resin", "fdm")


@pytest.mark.parametrize("name", RESIN)
def test_every_resin_printer_can_expose(name):
    """Enough to write a job file: exposure, bottom layers, grey; a lift, unless the vat tilts or nothing is known."""
    printer = load_printer(name)
    assert 0.5 <= printer.exposure_s <= 20
    assert 3 * printer.exposure_s <= printer.bottom_exposure_s <= 120
    assert 1 <= printer.bottom_layers <= 10
    assert 0 <= printer.transition_layers <= 10
    assert 1 <= printer.antialias_bits <= 8
    assert printer.min_feature_mm == pytest.approx(max(0.15, 4 * max(printer.pixel_mm)), abs=0.006)
    lifts = (printer.lift_mm, printer.lift_mm_min, printer.bottom_lift_mm, printer.bottom_lift_mm_min)
    assert all(lifts) == any(lifts) == bool(printer.retract_mm_min)
    assert printer.nozzle_mm is printer.gcode_flavor is printer.filament_mm is None


@pytest.mark.parametrize("name", FDM)
def test_every_fdm_printer_can_extrude(name):
    """Enough to write G-code: filament, beads that its nozzle can lay, flow, dialect."""
    printer = load_printer(name)
    assert printer.filament_mm in (1.75, 2.85)
    assert printer.width_range_mm == pytest.approx((0.85 * printer.nozzle_mm, 2 * printer.nozzle_mm))
    assert printer.min_feature_mm == pytest.approx(2 * printer.nozzle_mm)
    for width in (printer.extrusion_width_mm, printer.first_layer_width_mm):
        assert printer.width_range_mm[0] <= width <= printer.width_range_mm[1]
    assert 5 <= printer.max_volumetric_speed_mm3_s <= 40
    assert printer.gcode_flavor in ("marlin", "marlin2", "klipper", "reprap", "griffin")
    assert printer.relative_extrusion in (True, False)
    assert printer.format == ".gcode"
    assert printer.pixels is printer.exposure_s is printer.light_pwm is None


@pytest.mark.parametrize("name", FDM)
def test_every_fdm_printer_can_be_driven(name):
    """Enough to write G-code: speeds that suit each other, retraction, heat for PLA, start and end."""
    printer = load_printer(name)
    assert {key for key in FOR_GCODE if getattr(printer, key) is None} == {k for n, k in UNKNOWN if n == name}
    assert printer.external_perimeter_mm_s <= printer.perimeter_mm_s <= printer.infill_mm_s
    assert printer.top_infill_mm_s <= printer.solid_infill_mm_s <= printer.infill_mm_s
    assert printer.first_layer_mm_s <= printer.external_perimeter_mm_s
    assert max(getattr(printer, key) for key in SPEEDS) == printer.travel_mm_s <= 500
    assert 500 <= (printer.acceleration_mm_s2 or 500) <= 10000
    assert 0.5 <= printer.retract_mm <= 7
    assert 20 <= printer.retract_mm_s <= 120
    assert 0 <= printer.retract_lift_mm <= 0.5
    assert 1 <= printer.retract_before_travel_mm <= 2
    assert all(200 <= heat <= 230 for heat in (printer.nozzle_c, printer.first_layer_nozzle_c))
    assert all(55 <= heat <= 70 for heat in (printer.bed_c, printer.first_layer_bed_c))
    assert 40 <= printer.fan_percent <= 100


def test_only_fdm_printers_say_what_g_code_needs():
    """A panel has no nozzle to heat or to move."""
    assert all(getattr(p, key) is None for p in ALL if p.process != "fdm" for key in FOR_GCODE)


@pytest.mark.parametrize("line", EXPECTED_SPEEDS.strip().splitlines())
def test_the_speeds_are_those_of_the_profiles(line):
    """In mm/s, where the profile says percent too."""
    name, *numbers = line.split()
    p = load_printer(name)
    speeds = [p.external_perimeter_mm_s, p.perimeter_mm_s, p.infill_mm_s, p.solid_infill_mm_s, p.top_infill_mm_s]
    assert [*speeds, p.first_layer_mm_s, p.nozzle_c, p.bed_c] == list(map(float, numbers))


@pytest.mark.parametrize("line", EXPECTED_LIMITS.strip().splitlines())
def test_the_limits_are_those_of_the_profiles(line):
    """Every FDM printer whose G-code is written has them."""
    name, *numbers = line.split()
    p = load_printer(name)
    limits = [axis[k] for axis in (p.axis_mm_s, p.axis_mm_s2, p.axis_jerk_mm_s) for k in (0, 2, 3)]
    assert [*limits, p.bridge_mm_s, p.bridge_flow] == list(map(float, numbers))
    assert all(axis[0] == axis[1] for axis in (p.axis_mm_s, p.axis_mm_s2, p.axis_jerk_mm_s))
    assert len(EXPECTED_LIMITS.strip().splitlines()) == sum(load_printer(n).gcode_flavor != "griffin" for n in FDM)


@pytest.mark.parametrize("name", FDM)
def test_the_start_heats_homes_and_primes_within_the_bed(name):
    """In that order, with the first layer's heat; one line along the front, all of it where the nozzle can reach."""
    printer = load_printer(name)
    lines = code(printer.start_gcode)
    order = ["G21", "G90", "M83", "M140 S{first_layer_bed_c}", "M190 S{first_layer_bed_c}", "G28"]
    where = [next(n for n, line in enumerate(lines) if line.startswith(command)) for command in order]
    assert where == sorted(where)
    hot = lines.index("M109 S{first_layer_nozzle_c}")
    assert [line[:3] for line in lines[hot + 1 :]].count("G1 ") >= 3
    assert lines[-1] == "G92 E0"
    assert {"M82", "M84"}.isdisjoint(lines)

    at, primed = {"X": 0.0, "Y": 0.0, "Z": 0.0}, []
    width, depth, height = printer.build_mm
    for n, line in enumerate(lines):
        if not line.startswith("G1 "):
            continue
        before, move = dict(at), words(line)
        at |= {axis: move[axis] for axis in "XYZ" if axis in move}
        assert 0 < at["X"] < width or "X" not in move
        assert 0 < at["Y"] < depth or "Y" not in move
        assert 0 < at["Z"] < height
        if "E" in move:
            primed.append((before, dict(at), move))
            assert n > hot
    ((begin, end, move),) = primed
    assert (begin["Y"], begin["Z"]) == (end["Y"], end["Z"])
    assert 0 < end["Y"] <= 5
    assert 0.2 <= end["Z"] <= 0.8 * printer.nozzle_mm
    length = end["X"] - begin["X"]
    bead_mm2 = move["E"] * math.pi * printer.filament_mm**2 / 4 / length
    assert length >= 50
    assert bead_mm2 / end["Z"] <= 2.3 * printer.nozzle_mm  # about as wide as such a nozzle lays it
    assert bead_mm2 * move["F"] / 60 <= printer.max_volumetric_speed_mm3_s
    assert end["Z"] < at["Z"]  # it leaves the line before it travels


@pytest.mark.parametrize("name", FDM)
def test_the_end_turns_everything_off(name):
    """Heat and fan before it moves; a retraction and a lift, both relative; the head within the bed; motors last."""
    printer = load_printer(name)
    lines = code(printer.end_gcode)
    assert lines[:3] == ["M104 S0", "M140 S0", "M107"]
    assert lines[-1] == "M84"
    retract = next(line for line in lines if " E-" in line)
    assert 0 < -words(retract)["E"] <= 2
    assert lines.index("M83") < lines.index(retract) < lines.index("G91") < lines.index("G90")
    (lift,) = lines[lines.index("G91") + 1 : lines.index("G90")]
    assert words(lift)["Z"] > 0
    (park,) = (words(line) for line in lines[lines.index("G90") + 1 :] if line.startswith("G1 "))
    assert 0 < park["X"] < printer.build_mm[0]
    assert 0.9 * printer.build_mm[1] < park["Y"] < printer.build_mm[1]
    assert "{" not in printer.end_gcode


@pytest.mark.parametrize("name", FDM)
def test_start_and_end_are_plain(name):
    """No progress, no messages, no macros of one slicer; Prusa's level, the others only home."""
    lines = code(load_printer(name).start_gcode) + code(load_printer(name).end_gcode)
    assert all(re.fullmatch(r"[GM]\d+( [A-Z](-?[\d.]+|\{\w+\})?)*", line) for line in lines), lines
    commands = {line.split()[0] for line in lines}
    assert commands.isdisjoint({"M73", "M117", "M82", "M862.3"})
    level = "G80" if "mk3s" in name else "G29" if name.startswith("prusa") else None
    assert commands & {"G29", "G80"} == ({level} if level else set())


@every_printer
def test_the_panel_is_as_large_as_what_it_prints(name):
    """Pixels times pitch is the build area, within 0.5 %; a nozzle has no panel."""
    printer = load_printer(name)
    if printer.pixels is None:
        assert printer.nozzle_mm
        return
    for count, pitch, size in zip(printer.pixels, printer.pixel_mm, printer.build_mm[:2], strict=True):
        assert count * pitch == pytest.approx(size, rel=0.005)


@every_printer
def test_every_shipped_printer_states_its_source(name):
    """It begins with which machine this is and where the numbers are from; the minimum feature has its own reason."""
    above = comments(name)
    assert load_printer(name).model.split()[0] in above["maker"]
    assert any(source in above["maker"] for source in SOURCES)
    assert "resin and exposure" in above["min_feature_mm"] or "measured" in above["min_feature_mm"]


@pytest.mark.parametrize("name", RESIN)
def test_every_exposure_states_its_source(name):
    """A profile, a job, or that it is typical and not the maker's."""
    assert re.search(r"profiles|job|Anycubic's|typical.*not", comments(name)["exposure_s"])


@every_printer
def test_every_file_says_only_what_is_asked_in_plain_lines(name):
    """One `key = value` a line, only G-code in several, and no line too long to read."""
    text = (printer_folder() / f"{name}.toml").read_text(encoding="utf-8")
    lines = re.sub(r'(?m)^(start|end)_gcode = """\n(.+\n)+?"""$', "# G-code", text).splitlines()
    assert all(line.startswith("# ") or re.fullmatch(r"\w+ = \S.*", line) for line in lines)
    assert max(map(len, lines)) <= 118


# one's own ------------------------------------------------------------------------------------------------


def test_every_value_has_its_line_in_the_table():
    """The table of keys and the class are the same list, and the named units are those of the table."""
    assert {f.name for f in fields(Printer)} == {"name", *KEYS}
    ends = {
        "_mm3_s": "mm³/s", "_mm_s2": "mm/s²", "_mm_s": "mm/s", "_mm_min": "mm/min", "_mm": "mm", "_s": "s",
        "_c": "°C", "_percent": "%", "_pwm": "of 255",
    }  # fmt: skip
    for key, wanted in KEYS.items():
        assert wanted.meaning
        unit = next((unit for end, unit in ends.items() if key.endswith(end)), None)
        assert wanted.unit == (unit or ("px" if key == "pixels" else "")), key


@pytest.mark.parametrize(
    ("process", "mode"),
    [("resin", "add_only"), ("fdm", "as_printed"), ("powder", "as_printed"), ("service", "add_only")],
)
def test_the_process_decides_the_mode(tmp_path, process, mode):
    """A mask can draw corners, a nozzle and a beam cannot."""
    assert load_printer(own(tmp_path, process=f'"{process}"')).mode == mode


def test_ones_own_printer_by_path(tmp_path):
    """Every key arrives, whole numbers count as numbers, and the name is the file's."""
    path = own(
        tmp_path, pixels="[2000, 1000]", mirror='"xy"', format='".sl1"', first_layer_mm="0.1", nozzle_mm="1",
        exposure_s="2", bottom_exposure_s="30.5", bottom_layers="0", transition_layers="0", light_off_s="0",
        lift_mm="0.0", lift_mm_min="60", bottom_lift_mm="7", bottom_lift_mm_min="30", retract_mm_min="150",
        light_pwm="0", bottom_light_pwm="255", antialias_bits="7", filament_mm="1.75", extrusion_width_mm="0.45",
        first_layer_width_mm="0.5", width_range_mm="[0.34, 1]", max_volumetric_speed_mm3_s="11.5",
        gcode_flavor='"klipper"', relative_extrusion="false", external_perimeter_mm_s="25", perimeter_mm_s="45",
        infill_mm_s="80", solid_infill_mm_s="79.5", top_infill_mm_s="40", gap_fill_mm_s="30", first_layer_mm_s="20",
        travel_mm_s="180", acceleration_mm_s2="1000", retract_mm="0", retract_mm_s="35", retract_lift_mm="0",
        retract_before_travel_mm="0", nozzle_c="215", first_layer_nozzle_c="0", bed_c="60", first_layer_bed_c="65.5",
        fan_percent="0", start_gcode='"""\nG28\nM104 S{nozzle_c}\n"""', end_gcode='"M84"',
    )  # fmt: skip
    for given in (path, str(path)):
        assert load_printer(given) == Printer(
            name="mine", maker="Me", model="One", process="resin", build_mm=(100, 50, 150), layer_mm=0.05,
            min_feature_mm=0.2, pixel_mm=(0.05, 0.05), layer_range_mm=(0.02, 0.1), pixels=(2000, 1000),
            mirror="xy", format=".sl1", nozzle_mm=1, first_layer_mm=0.1, exposure_s=2, bottom_exposure_s=30.5,
            bottom_layers=0, transition_layers=0, light_off_s=0, lift_mm=0, lift_mm_min=60, bottom_lift_mm=7,
            bottom_lift_mm_min=30, retract_mm_min=150, light_pwm=0, bottom_light_pwm=255, antialias_bits=7,
            filament_mm=1.75, extrusion_width_mm=0.45, first_layer_width_mm=0.5, width_range_mm=(0.34, 1),
            max_volumetric_speed_mm3_s=11.5, gcode_flavor="klipper", relative_extrusion=False,
            external_perimeter_mm_s=25, perimeter_mm_s=45, infill_mm_s=80, solid_infill_mm_s=79.5,
            top_infill_mm_s=40, gap_fill_mm_s=30, first_layer_mm_s=20, travel_mm_s=180, acceleration_mm_s2=1000,
            retract_mm=0, retract_mm_s=35, retract_lift_mm=0, retract_before_travel_mm=0, nozzle_c=215,
            first_layer_nozzle_c=0, bed_c=60, first_layer_bed_c=65.5, fan_percent=0,
            start_gcode="G28\nM104 S{nozzle_c}\n", end_gcode="M84",
        )  # fmt: skip


def test_values_have_the_kinds_of_the_table(tmp_path):
    """A whole number where a length is asked becomes a float; counts stay whole; what is not given is None."""
    printer = load_printer(own(tmp_path, lift_mm="5", bottom_layers="4", relative_extrusion="true"))
    assert (type(printer.lift_mm), type(printer.bottom_layers)) == (float, int)
    assert printer.relative_extrusion is True
    assert [printer.exposure_s, printer.light_pwm, printer.gcode_flavor, printer.width_range_mm] == [None] * 4
    assert [getattr(printer, key) for key in FOR_GCODE] == [None] * len(FOR_GCODE)


def test_a_path_is_relative_to_where_one_is(tmp_path, monkeypatch):
    """`mine.toml` is a file here, `mine` is a name."""
    own(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert load_printer("mine.toml").name == "mine"
    assert "no printer 'mine'" in problem("mine")


def test_the_pitch_may_follow_from_panel_or_nozzle(tmp_path):
    """A panel's size over its pixels, an eighth of a nozzle; neither is an error that says what is missing."""
    path = own(tmp_path, pixel_mm=None, pixels="[2000, 500]")
    assert load_printer(path).pixel_mm == pytest.approx((0.05, 0.1))
    assert load_printer(own(tmp_path, pixel_mm=None, nozzle_mm="0.4")).pixel_mm == pytest.approx((0.05, 0.05))
    assert "missing pixel_mm (or pixels, or nozzle_mm" in problem(own(tmp_path, pixel_mm=None))


@pytest.mark.parametrize(
    ("name", "near"),
    [("prusa-sl2", "prusa-sl1"), ("PRUSA-SL1S", "prusa-sl1s"), ("mk3s", "prusa-mk3s-0.4"),
     ("saturn-3-ultra", "elegoo-saturn-3-ultra"), ("mini-8k", "phrozen-sonic-mini-8k"), ("ender-3", "ender-3-0.6"),
     ("elegoo-mars-3-max", "elegoo-mars-3-pro"), ("elego-satrun-3", "elegoo-saturn-3")],
)  # fmt: skip
def test_an_unknown_name_proposes_the_nearest(name, near):
    """A typing error is answered with what was probably meant."""
    assert near in problem(name)
    assert f"no printer '{name}'" in problem(name)


def test_a_name_like_none_says_where_the_list_is():
    """Nothing near: the message says how to see them all."""
    assert problem("zzz") == "no printer 'zzz': `layerfix printers` lists them, or give your own .toml file"


def test_a_missing_file_and_a_folder(tmp_path):
    """A path to nothing, and to a folder that is called .toml."""
    assert problem(tmp_path / "none.toml") == f"{tmp_path / 'none.toml'}: no such file"
    (tmp_path / "folder.toml").mkdir()
    assert "folder.toml" in problem(tmp_path / "folder.toml")


@pytest.mark.parametrize("text", ["maker = ", "= 3", "[printer", "maker = 'a'\nmaker = 'b'", "\x00", "just words"])
def test_what_is_no_toml(tmp_path, text):
    """The file is named, with what the TOML reader says."""
    (tmp_path / "mine.toml").write_text(text)
    assert "mine.toml: not a valid TOML file" in problem(tmp_path / "mine.toml")


def test_bytes_that_are_no_text(tmp_path):
    """A file that is not UTF-8."""
    (tmp_path / "mine.toml").write_bytes(b"maker = '\xff\xfe'")
    assert "mine.toml: not a valid TOML file" in problem(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("key", "near"),
    [("layer_hight", "layer_mm"), ("pixel", "pixel_mm"), ("min_feature", "min_feature_mm"), ("proces", "process"),
     ("exposure", "exposure_s"), ("exposure_time_s", "exposure_s"), ("lift_speed_mm_min", "lift_mm_min"),
     ("light_pmw", "light_pwm"), ("start_code", "start_gcode"), ("nozzle_temp_c", "nozzle_c"),
     ("gcode_flavour", "gcode_flavor"), ("extrusion_width", "extrusion_width_mm")],
)  # fmt: skip
def test_a_wrong_key_names_the_near_ones(tmp_path, key, near):
    """A typing error in a key."""
    message = problem(own(tmp_path, **{key: "1"}))
    assert f"mine.toml: unknown key '{key}': did you mean " in message
    assert near in message


def test_a_strange_key_lists_the_known_ones(tmp_path):
    """Nothing near: all of them; a table is a key too."""
    assert "unknown key 'zzz': known are maker, model, process" in problem(own(tmp_path, zzz="1"))
    assert "unknown key 'zzz'" in problem(own(tmp_path, zzz="{a = 1}"))


@pytest.mark.parametrize(
    "key", ["maker", "model", "process", "build_mm", "layer_mm", "layer_range_mm", "min_feature_mm"]
)
def test_a_missing_key_is_named(tmp_path, key):
    """Each of those that nothing else can stand in for."""
    assert problem(own(tmp_path, **{key: None})) == f"{tmp_path / 'mine.toml'}: missing {key}"


@pytest.mark.parametrize(
    ("key", "value"),
    [("maker", "3"), ("layer_mm", '"0.05mm"'), ("layer_mm", "true"), ("layer_mm", "[0.05]"), ("build_mm", "[1, 2]"),
     ("build_mm", "[1, 2, 3, 4]"), ("build_mm", "[1, 2, '3']"), ("pixel_mm", "0.05"), ("pixels", "[100.5, 50]"),
     ("process", "1"), ("process", '"laser"'), ("mirror", "true"), ("layer_mm", "1979-05-27"),
     ("relative_extrusion", "1"), ("relative_extrusion", '"yes"'), ("bottom_layers", "5.0"), ("light_pwm", "true"),
     ("exposure_s", '"2.5"'), ("exposure_s", "false"), ("gcode_flavor", '"mach3"'), ("gcode_flavor", '""'),
     ("nozzle_c", '"215"'), ("fan_percent", "true"), ("travel_mm_s", "[180]"), ("start_gcode", "28"),
     ("end_gcode", '["G28", "M84"]'), ("width_range_mm", "0.4"), ("width_range_mm", "[0.4, true]"),
     ("transition_layers", "[1]")],
)  # fmt: skip
def test_a_value_of_the_wrong_kind_is_named(tmp_path, key, value):
    """Key and value, and what it should be."""
    message = problem(own(tmp_path, **{key: value}))
    assert message.startswith(f"{tmp_path / 'mine.toml'}: {key} = ")
    assert "it is" in message or "choose from" in message


@pytest.mark.parametrize("value", ["0", "-0.05", "nan", "inf", "-inf"])
@pytest.mark.parametrize(
    "key",
    ["layer_mm", "min_feature_mm", "first_layer_mm", "nozzle_mm", "exposure_s", "lift_mm_min", "filament_mm",
     *SPEEDS, "acceleration_mm_s2", "retract_mm_s"],
)  # fmt: skip
def test_a_length_that_is_not_above_0_is_named(tmp_path, key, value):
    """Zero, negative, infinite, not a number."""
    assert f"{key} = " in problem(own(tmp_path, **{key: value}))
    assert "must be above 0" in problem(own(tmp_path, **{key: value}))


def test_a_side_of_the_build_volume_that_is_not_above_0(tmp_path):
    """One of three."""
    assert "build_mm = [100, 0, 150]; it must be above 0" in problem(own(tmp_path, build_mm="[100, 0, 150]"))


@pytest.mark.parametrize(
    ("key", "value", "limits"),
    [("bottom_layers", "-1", "0 or more"), ("transition_layers", "-5", "0 or more"), ("lift_mm", "nan", "0 or more"),
     ("light_off_s", "-0.5", "0 or more"), ("lift_mm", "inf", "0 or more"), ("light_pwm", "256", "0 to 255"),
     ("bottom_light_pwm", "-1", "0 to 255"), ("antialias_bits", "0", "1 to 8"), ("antialias_bits", "16", "1 to 8"),
     ("retract_mm", "-0.1", "0 or more"), ("retract_lift_mm", "-0.1", "0 or more"),
     ("retract_before_travel_mm", "nan", "0 or more"), ("nozzle_c", "501", "0 to 500"),
     ("first_layer_nozzle_c", "-1", "0 to 500"), ("bed_c", "200.5", "0 to 200"),
     ("first_layer_bed_c", "inf", "0 to 200"), ("fan_percent", "101", "0 to 100"), ("fan_percent", "-1", "0 to 100"),
     ("layer_mm", "1" + 400 * "0", "above 0")],
)  # fmt: skip
def test_a_number_out_of_its_limits_is_named(tmp_path, key, value, limits):
    """Some may be 0, some have a highest value, and none is without end."""
    message = problem(own(tmp_path, **{key: value}))
    assert f"mine.toml: {key} = " in message
    assert message.endswith(f"it must be {limits}")


def test_a_choice_names_the_choices(tmp_path):
    """Process, mirror, dialect."""
    assert problem(own(tmp_path, process='"laser"')).endswith("choose from resin, fdm, powder, service")
    assert problem(own(tmp_path, mirror='"z"')).endswith("choose from '', x, y, xy")
    dialects = "marlin, marlin2, klipper, reprap, griffin"
    assert problem(own(tmp_path, gcode_flavor='"x"')).endswith(f"choose from {dialects}")


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 5000], ids=["digits", "brackets"])
def test_a_value_without_end_is_no_toml(tmp_path, value):
    """Neither Python's limit of digits nor that of its stack shows as a traceback."""
    assert "mine.toml: not a valid TOML file" in problem(own(tmp_path, layer_mm=value))


@pytest.mark.parametrize(
    "changes",
    [{"mirror": '"z"'}, {"mirror": '"left"'}, {"layer_range_mm": "[0.1, 0.02]"}, {"format": '"sl1"'},
     {"width_range_mm": "[0.8, 0.4]"}, {"pixels": "[100, 100]"}],
    ids=lambda c: "-".join(c),
)  # fmt: skip
def test_values_that_contradict_are_named(tmp_path, changes):
    """An axis that does not exist, a range upside down, a suffix without its dot, a panel of another size."""
    (key,) = changes
    assert key in problem(own(tmp_path, **changes))


@pytest.mark.parametrize("key", ["start_gcode", "end_gcode"])
@pytest.mark.parametrize(
    ("text", "found"),
    [("M104 S{temp}", "{temp}"), ("G28\\nM140 S{bed_c}\\nM190 S{BED_C}", "{BED_C}"), ("M104 S{nozzle_c:.0f}",
     "{nozzle_c:.0f}"), ("M104 S{first_layer_temperature[0]}", "{first_layer_temperature[0]}"), ("{}", "{}"),
     ("M104 S{ nozzle_c }", "{ nozzle_c }"), ("M104 S{nozzle_c\\nG28", "{nozzle_c"), ("M104 Snozzle_c}", "}"),
     ("M104 S{{nozzle_c}}", "{"), ("; {if layer_z < 3}", "{if layer_z < 3}")],
)  # fmt: skip
def test_another_placeholder_is_named(tmp_path, key, text, found):
    """Nothing would fill it; those that are filled are listed. Also a brace without its partner."""
    message = problem(own(tmp_path, **{key: f'"{text}"'}))
    accepted = "{nozzle_c}, {bed_c}, {first_layer_nozzle_c}, {first_layer_bed_c}"
    assert message == f"{tmp_path / 'mine.toml'}: {key} has {found}; it may have {accepted}"


def test_ones_own_g_code_may_say_anything_else(tmp_path):
    """All placeholders, also twice; messages, macros, comments; nothing at all."""
    text = "PRINT_START T={nozzle_c} {nozzle_c}\nM140 S{bed_c} ; [x] (y) %\nM73 P0\nM117 hello\n"
    text += "M109 S{first_layer_nozzle_c}\nM190 S{first_layer_bed_c}\n"
    assert all(placeholder in text for placeholder in GCODE_PLACEHOLDERS)
    printer = load_printer(own(tmp_path, start_gcode=f'"""\n{text}"""', end_gcode='""'))
    assert (printer.start_gcode, printer.end_gcode) == (text, "")


# list, find, show -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("process", "text", "some"),
    [(None, "", {"prusa-sl1s", "ender-3-0.6"}), ("fdm", "prusa", {"prusa-xl-0.8"}), ("resin", "PRUSA", {"prusa-sl1"}),
     (None, "saturn elegoo", {"elegoo-saturn-4-ultra-16k"}), (None, "prusa research", {"prusa-m1", "prusa-mk4-0.6"}), 
     ("service", "pa12", {"materialise-pa12-mjf"}),
     (None, "Halot", {"creality-halot-one"}), (None, "v-core", {"ratrig-v-core-4-400-0.6"})],
)  # fmt: skip
def test_printers_are_found_by_process_and_words(process, text, some):
    """In maker, model or name, in any order and case."""
    found = find_printers(process, text)
    assert some <= {p.name for p in found} <= set(printer_names())
    assert [p.name for p in found] == sorted(p.name for p in found)
    for p in found:
        assert process in (None, p.process)
        assert all(word in f"{p.name} {p.maker} {p.model}".lower() for word in text.lower().split())


@pytest.mark.parametrize(
    ("text", "some"),
    [("elego satrun", {"elegoo-saturn", "elegoo-saturn-4"}), ("anycubik foton mono 4", {"anycubic-photon-mono-4"}),
     ("ender3v2", {"creality-ender-3-v2-0.4"}), ("halotone", {"creality-halot-one"}), ("bamboo p1s",
     {"bambu-lab-p1s-0.4"}), ("MK4S", {"prusa-mk4s-0.4"}), ("phrosen mini 8k", {"phrozen-sonic-mini-8k"})],
)  # fmt: skip
def test_the_search_forgives_spelling(text, some):
    """Letters swapped, left out, or as they sound; words written together. Another number is another printer."""
    found = {p.name for p in find_printers(text=text)}
    assert some <= found
    assert len(found) <= 24
    assert not any(name.startswith("elegoo-saturn-5") for name in found)
    assert find_printers(text="elego satrun 7") == []


def test_nothing_is_found():
    """Neither by words that nobody has nor by a process none of them is of."""
    assert find_printers(text="prusa saturn") == []
    assert find_printers("powder") == []
    assert find_printers(text="zzzz") == []
    assert listing([]) == []


def test_the_list_fits_a_terminal(tmp_path):
    """Columns that begin at the same place, 120 characters at most, also with a beam that has neither."""
    lines = listing(find_printers())
    assert max(map(len, lines)) <= 120
    assert {line.index(" min ") for line in lines} == {lines[0].index(" min ")}
    assert re.search(
        r"^prusa-mk3s-0.4 +Original Prusa i3 MK3S\+ +fdm +0.4 mm nozzle +min 0.8 mm$", "\n".join(lines), re.M
    )
    assert re.search(r"^elegoo-mars +Elegoo Mars +resin +1440 × 2560 px +min 0.19 mm$", "\n".join(lines), re.M)
    (beam,) = listing([load_printer(own(tmp_path, process='"powder"', maker='""'))])
    assert beam == "mine  One  powder  50 µm pitch  min 0.2 mm"


@every_printer
def test_the_description_has_every_known_value(name):
    """A line a value, in the order of the table, and none for what is not known."""
    printer = load_printer(name)
    lines = description(printer)
    known = [key for key in KEYS if getattr(printer, key) not in (None, ())]
    assert [line.split()[0] for line in lines] == ["name", *(k for k in known if k != "mirror" or printer.pixels)]
    assert max(map(len, lines)) <= 100
    assert not any(len(line.splitlines()) > 1 for line in lines)


def test_g_code_is_described_in_one_line(tmp_path):
    """Its first line, and how many there are."""
    said = {line.split()[0]: line for line in description(load_printer("ender-3-0.4"))}
    assert re.split(" {2,}", said["start_gcode"])[1] == "G21 ; mm … (14 lines)"
    assert re.split(" {2,}", said["end_gcode"])[1] == "M104 S0 … (10 lines)"
    for text, shown in (("\n\nG28\n", "G28"), ("G28", "G28"), ("G28\r\nM84", "G28 … (2 lines)"), ("\n", "none")):
        printer = load_printer(own(tmp_path, start_gcode=json.dumps(text)))
        (line,) = (line for line in description(printer) if line.startswith("start_gcode"))
        assert re.split(" {2,}", line)[1] == shown


def test_a_description_in_full():
    """Units, ranges, counts of 0, yes and no, and a panel that mirrors nothing."""
    said = {line.split()[0]: re.split(" {2,}", line)[1] for line in description(load_printer("creality-halot-one"))}
    assert said["maker"] == "Creality"
    assert said["build_mm"] == "81 × 128 × 160 mm"
    assert said["layer_range_mm"] == "0.01 to 0.2 mm"
    assert said["pixels"] == "1620 × 2560 px"
    assert (said["mirror"], said["antialias_bits"]) == ("none", "8")
    assert (said["lift_mm_min"], said["exposure_s"], said["light_pwm"]) == ("80 mm/min", "2.5 s", "255 of 255")
    said = {line.split()[0]: re.split(" {2,}", line)[1] for line in description(load_printer("ultimaker-s5-0.4"))}
    assert (said["relative_extrusion"], said["max_volumetric_speed_mm3_s"]) == ("no", "8 mm³/s")
    assert said["width_range_mm"] == "0.34 to 0.8 mm"
    assert (said["top_infill_mm_s"], said["retract_lift_mm"]) == ("26.25 mm/s", "0 mm")
    assert (said["nozzle_c"], said["fan_percent"]) == ("210 °C", "100 %")
    said = {line.split()[0]: re.split(" {2,}", line)[1] for line in description(load_printer("prusa-mk3s-0.4"))}
    assert said["acceleration_mm_s2"] == "1000 mm/s²"
    said = {line.split()[0]: re.split(" {2,}", line)[1] for line in description(load_printer("anycubic-photon-mono"))}
    assert said["transition_layers"] == "0"


def test_layerfix_printers_lists_and_filters():
    """The command prints what the library lists, and JSON of the same printers."""
    assert succeeds(run_layerfix("printers")).splitlines() == listing(find_printers())
    args = ("printers", "--process", "fdm", "--search", "Prusa prusa-XL-0.8")
    assert succeeds(run_layerfix(*args)).splitlines() == listing(find_printers("fdm", "prusa prusa-xl-0.8"))
    assert [p["name"] for p in json.loads(succeeds(run_layerfix(*args, "--json")))] == ["prusa-xl-0.8"]


def test_layerfix_printers_without_any():
    """The list stays empty for scripts; people are told."""
    done = run_layerfix("printers", "--search", "nobody")
    assert (done.code, done.out, done.err) == (0, "", "no such printer\n")
    assert succeeds(run_layerfix("printers", "--search", "nobody", "--json")) == "[]\n"


def test_layerfix_printers_show(tmp_path):
    """All of one, as lines or as JSON; one's own by its path."""
    printer = load_printer("elegoo-saturn-3-ultra")
    assert succeeds(run_layerfix("printers", "show", printer.name)).splitlines() == description(printer)
    shown = json.loads(succeeds(run_layerfix("printers", "show", printer.name, "--json")))
    assert shown == json.loads(json.dumps(asdict(printer)))
    mine = own(tmp_path, exposure_s="7")
    assert "7 s" in succeeds(run_layerfix("printers", "show", mine.name, cwd=tmp_path))


def test_layerfix_printers_show_of_an_unknown_one():
    """The same line as for --printer, exit code 2."""
    done = run_layerfix("printers", "show", "elegoo-saturn-9")
    assert (done.code, done.out, done.err) == (2, "", f"layerfix: {problem('elegoo-saturn-9')}\n")


@pytest.mark.parametrize(
    ("args", "word"),
    [(["show"], "NAME"), (["list"], "list"), (["--json", "show", "prusa-sl1"], "show"),
     (["--search", "x", "show", "prusa-sl1"], "show"), (["show", "prusa-sl1", "prusa-sl1s"], "prusa-sl1s")],
)  # fmt: skip
def test_layerfix_printers_wrongly_called(args, word):
    """Exit code 2, nothing printed, and the word at fault: an option in the wrong place is not ignored."""
    done = run_layerfix("printers", *args)
    assert (done.code, done.out) == (2, "")
    assert word in done.err.strip().splitlines()[-1]
