"""Printers from TOML: those shipped are sound, and a wrong word in one's own is named."""

from __future__ import annotations

import json
import re
import struct
import zipfile
from dataclasses import asdict, fields
from pathlib import Path

import pytest

from layerfix import Printer, load_printer
from layerfix.errors import InputError
from layerfix.printers import KEYS, description, find_printers, listing, printer_folder, printer_names
from tests.making import SHARED, Run, run_layerfix

every_printer = pytest.mark.parametrize("name", printer_names())
RESIN = [name for name in printer_names() if load_printer(name).process == "resin"]
FDM = [name for name in printer_names() if load_printer(name).process == "fdm"]

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
ultimaker-s5-0.4         0.20  0.20  0.40  marlin   False
lulzbot-taz6-0.5         0.25  0.30  0.56  marlin   False
"""

FORMATS = {
    *(".sl1", ".sl1s", ".m1", ".ctb", ".goo", ".photon", ".nanodlp", ".svgx", ".cxdlp", ".cxdlpv4", ".gcode"),
    *(".pws", ".pwmo", ".pwmx", ".pm3", ".pm4n", ".pm5s", ".pm7", ".pwsz", ".dl2p"),  # Anycubic
}
SOURCES = ("UVtools", "PrusaSlicer", "sla-fw")

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
    assert set(printer_names()) == {path.stem for path in printer_folder().glob("*")}


def test_no_printer_is_there_twice():
    """Maker, model and nozzle tell them apart."""
    plates = [(p.maker, p.model, p.nozzle_mm) for p in map(load_printer, printer_names())]
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
    assert printer.gcode_flavor in ("marlin", "marlin2", "klipper", "reprap")
    assert printer.relative_extrusion in (True, False)
    assert printer.format == ".gcode"
    assert printer.pixels is printer.exposure_s is printer.light_pwm is None


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
    """One `key = value` a line, keys that end in their units, and no line too long to read."""
    lines = (printer_folder() / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    assert all(line.startswith("# ") or re.fullmatch(r"\w+ = \S.*", line) for line in lines)
    assert max(map(len, lines)) <= 118


# one's own ------------------------------------------------------------------------------------------------


def test_every_value_has_its_line_in_the_table():
    """The table of keys and the class are the same list, and the named units are those of the table."""
    assert {f.name for f in fields(Printer)} == {"name", *KEYS}
    ends = {"_mm3_s": "mm³/s", "_mm_min": "mm/min", "_mm": "mm", "_s": "s", "_pwm": "of 255"}
    for key, wanted in KEYS.items():
        assert wanted.meaning
        unit = next((unit for end, unit in ends.items() if key.endswith(end)), None)
        assert wanted.unit == (unit or ("px" if key == "pixels" else "")), key


@pytest.mark.parametrize(
    ("process", "mode"), [("resin", "add_only"), ("fdm", "as_printed"), ("powder", "as_printed")]
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
        gcode_flavor='"klipper"', relative_extrusion="false",
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
        )  # fmt: skip


def test_values_have_the_kinds_of_the_table(tmp_path):
    """A whole number where a length is asked becomes a float; counts stay whole; what is not given is None."""
    printer = load_printer(own(tmp_path, lift_mm="5", bottom_layers="4", relative_extrusion="true"))
    assert (type(printer.lift_mm), type(printer.bottom_layers)) == (float, int)
    assert printer.relative_extrusion is True
    assert [printer.exposure_s, printer.light_pwm, printer.gcode_flavor, printer.width_range_mm] == [None] * 4


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
     ("elegoo-mars-3-pro", "elegoo-mars-3")],
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
     ("light_pmw", "light_pwm"), ("gcode_flavour", "gcode_flavor"), ("extrusion_width", "extrusion_width_mm")],
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
     ("width_range_mm", "0.4"), ("width_range_mm", "[0.4, true]"), ("transition_layers", "[1]")],
)  # fmt: skip
def test_a_value_of_the_wrong_kind_is_named(tmp_path, key, value):
    """Key and value, and what it should be."""
    message = problem(own(tmp_path, **{key: value}))
    assert message.startswith(f"{tmp_path / 'mine.toml'}: {key} = ")
    assert "it is" in message or "choose from" in message


@pytest.mark.parametrize("value", ["0", "-0.05", "nan", "inf", "-inf"])
@pytest.mark.parametrize(
    "key", ["layer_mm", "min_feature_mm", "first_layer_mm", "nozzle_mm", "exposure_s", "lift_mm_min", "filament_mm"]
)
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
     ("layer_mm", "1" + 400 * "0", "above 0")],
)  # fmt: skip
def test_a_number_out_of_its_limits_is_named(tmp_path, key, value, limits):
    """Some may be 0, some have a highest value, and none is without end."""
    message = problem(own(tmp_path, **{key: value}))
    assert f"mine.toml: {key} = " in message
    assert message.endswith(f"it must be {limits}")


def test_a_choice_names_the_choices(tmp_path):
    """Process, mirror, dialect."""
    assert problem(own(tmp_path, process='"laser"')).endswith("choose from resin, fdm, powder")
    assert problem(own(tmp_path, mirror='"z"')).endswith("choose from '', x, y, xy")
    assert problem(own(tmp_path, gcode_flavor='"x"')).endswith("choose from marlin, marlin2, klipper, reprap")


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


# list, find, show -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("process", "text", "some"),
    [(None, "", {"prusa-sl1s", "ender-3-0.6"}), ("fdm", "prusa", {"prusa-xl-0.8"}), ("resin", "PRUSA", {"prusa-sl1"}),
     (None, "saturn elegoo", {"elegoo-saturn-4-ultra-16k"}), (None, "prusa research", {"prusa-m1", "prusa-mk4-0.6"}),
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


def test_nothing_is_found():
    """Neither by words that nobody has nor by a process none of them is of."""
    assert find_printers(text="prusa saturn") == []
    assert find_printers("powder") == []
    assert listing([]) == []


def test_the_list_fits_a_terminal(tmp_path):
    """Columns that begin at the same place, 100 characters at most, also with a beam that has neither."""
    lines = listing(find_printers())
    assert max(map(len, lines)) <= 100
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
    known = [key for key in KEYS if getattr(printer, key) is not None]
    assert [line.split()[0] for line in lines] == ["name", *(k for k in known if k != "mirror" or printer.pixels)]
    assert max(map(len, lines)) <= 100


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
    said = {line.split()[0]: re.split(" {2,}", line)[1] for line in description(load_printer("anycubic-photon-mono"))}
    assert said["transition_layers"] == "0"


def test_layerfix_printers_lists_and_filters():
    """The command prints what the library lists, and JSON of the same printers."""
    assert succeeds(run_layerfix("printers")).splitlines() == listing(find_printers())
    args = ("printers", "--process", "fdm", "--search", "Prusa XL")
    assert succeeds(run_layerfix(*args)).splitlines() == listing(find_printers("fdm", "prusa xl"))
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
