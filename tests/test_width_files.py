"""Files of widths: 3MF with settings by height, CSV, JSON; what PrusaSlicer makes of them; and times."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from collections import defaultdict
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import layerfix as lf
from layerfix import WidthPlan, load_mesh, load_printer, settings_for, slice_mesh
from layerfix.commands.options import Options, Run
from layerfix.commands.widths import SUFFIXES, WidthOptions, lines_of, suggest
from layerfix.errors import InputError, OutputError
from layerfix.fdm.speeds import Speeds
from layerfix.formats.vector.gcode_reader import read_gcode
from layerfix.layers.widths import Widths, suggest_widths
from layerfix.mesh.triangles import Mesh
from tests.beads import main_width
from tests.making import box, chosen_faces, contents, joined, run_layerfix, thin_part, turned, write_stl

MK3S = load_printer("prusa-mk3s-0.6")
RANGES = {"prusa": "Metadata/Prusa_Slicer_layer_config_ranges.xml", "orca": "Metadata/layer_config_ranges.xml"}
OBJECT = {"prusa": "Metadata/Slic3r_PE_model.config", "orca": "Metadata/model_settings.config"}
KEYS = {
    "prusa": {
        *("external_perimeter_extrusion_width", "perimeter_extrusion_width", "infill_extrusion_width"),
        *("solid_infill_extrusion_width", "top_infill_extrusion_width"),
    },
    "orca": {
        *("outer_wall_line_width", "inner_wall_line_width", "sparse_infill_line_width"),
        *("internal_solid_infill_line_width", "top_surface_line_width"),
    },
}
TYPES = "{http://schemas.openxmlformats.org/package/2006/content-types}"
each_slicer = pytest.mark.parametrize("slicer", ["prusa", "orca"])


def widths_of(width_mm: list[float], layer_mm: float = 0.3, first_mm: float | None = None) -> Widths:
    """Widths for layers of one height, with a first layer of its own."""
    n = len(width_mm)
    tops = (first_mm or layer_mm) + layer_mm * np.arange(n)
    z_mm = np.column_stack([np.concatenate([[0.0], tops[:-1]]), tops])
    thin = np.array(width_mm) <= 0.6
    return Widths(z_mm, np.array(width_mm), thin, np.linspace(100, 10, n), np.full(n, 40.0), (0.6, 1.2), 0.05)


def finned() -> Mesh:
    """A plate of 20 × 20 × 3 mm with three fins of 0.8 mm, 5 mm high."""
    fins = [box([x, 2, 2.9], [x + 0.8, 18, 8]) for x in (3, 8, 13)]
    return joined(box([0, 0, 0], [20, 20, 3]), *fins)


def plan(suggested: Widths, chosen: Widths, mesh: Mesh | None = None, **summary: object) -> WidthPlan:
    """Widths of a part on the MK3S, 250 × 210 mm."""
    part = mesh or box([0, 0, 0], [20, 20, 4])
    stack = slice_mesh(part, pixel_mm=0.1, layer_mm=0.3)
    return WidthPlan(part, stack, suggested, chosen, MK3S, settings_for(MK3S), summary)


def write(path: Path, widths: Widths, slicer: str, mesh: Mesh | None = None, **how: object) -> dict[str, str]:
    """Write a 3MF; gives the text of its entries."""
    lf.write(path, plan(widths, widths, mesh), slicer=slicer, **how)
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name).decode() for name in archive.namelist()}


def ranges_in(xml: str) -> list[tuple[float, float, dict[str, str]]]:
    """(bottom, top, options) of the ranges of object 1, the only one."""
    root = ET.fromstring(xml.encode())
    (thing,) = root
    assert (root.tag, thing.tag, thing.attrib) == ("objects", "object", {"id": "1"})
    return [
        (float(r.attrib["min_z"]), float(r.attrib["max_z"]), {o.attrib["opt_key"]: o.text or "" for o in r})
        for r in thing
    ]


# 3MF


@each_slicer
def test_every_entry_parses_and_has_a_content_type(tmp_path, slicer):
    """A sound zip of five files: types, relations, model, ranges, and the settings of the object."""
    entries = write(tmp_path / "part.3mf", widths_of([0.6, 1.2]), slicer)
    assert [*entries] == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model", RANGES[slicer], OBJECT[slicer]]
    for text in entries.values():
        ET.fromstring(text.encode())
    types = ET.fromstring(entries["[Content_Types].xml"].encode())
    known = {entry.attrib["Extension"] for entry in types.iter(f"{TYPES}Default")}
    assert {name.rpartition(".")[2] for name in entries} <= known
    target = next(iter(ET.fromstring(entries["_rels/.rels"].encode()))).attrib["Target"]
    assert target.lstrip("/") in entries


@each_slicer
def test_the_mesh_comes_back(tmp_path, slicer):
    """The same triangles, in the middle of the bed and standing on it."""
    mesh = turned(finned(), "y", 20)
    write(tmp_path / "part.3mf", widths_of([0.6, 1.2]), slicer, mesh)
    back = load_mesh(tmp_path / "part.3mf")
    assert np.array_equal(back.faces, mesh.faces)
    low, high = back.bounds_mm
    assert ((low + high) / 2)[:2] == pytest.approx((125, 105), abs=1e-3)
    assert low[2] == pytest.approx(0, abs=1e-4)
    moved = back.vertices - mesh.vertices
    assert np.ptp(moved, axis=0) == pytest.approx(0, abs=3e-6)


@each_slicer
@given(st.lists(st.sampled_from([0.6, 0.75, 0.9, 1.2]), min_size=1, max_size=30), st.sampled_from([0.1, 0.2, 0.3]),
       st.sampled_from([None, 0.2, 0.35]))  # fmt: skip
def test_ranges_cover_all_layers(tmp_path_factory, slicer, width_mm, layer_mm, first_mm):
    """Contiguous from bottom to top; the middle of every layer lies in a range with its width; all keys in each."""
    widths = widths_of(width_mm, layer_mm, first_mm)
    ranges = ranges_in(write(tmp_path_factory.mktemp("r") / "part.3mf", widths, slicer)[RANGES[slicer]])
    assert ranges[0][0] == 0
    assert ranges[-1][1] == pytest.approx(widths.z_mm[-1, 1])
    assert all(a[1] == b[0] for a, b in pairwise(ranges))
    for (bottom, top), width in zip(widths.z_mm, width_mm, strict=True):
        (options,) = [o for low, high, o in ranges if low < (bottom + top) / 2 < high]
        assert {*options} == {"layer_height", *KEYS[slicer]}
        assert {float(options[key]) for key in KEYS[slicer]} == {width}
        if len(width_mm) > 2:
            assert float(options["layer_height"]) == pytest.approx(layer_mm)


def test_the_layer_height_is_that_of_the_print_however_few_layers(tmp_path):
    """0.2 and 0.3 mm make layers of 0.3 mm, not of 0.25: slicers refuse ranges of another height."""
    (said,) = ranges_in(write(tmp_path / "a.3mf", widths_of([0.6, 0.6], 0.3, 0.2), "prusa")[RANGES["prusa"]])
    assert float(said[2]["layer_height"]) == pytest.approx(0.3)


@pytest.mark.parametrize(("slicer", "value"), [("prusa", "1"), ("orca", "ensure_all")])
def test_the_object_keeps_its_shells(tmp_path, slicer, value):
    """Solid layers would end at every border; the object is named, and is one volume of all triangles."""
    path = write_stl(tmp_path / "a & <b>.stl", finned())
    text = write(tmp_path / "part.3mf", widths_of([0.6, 1.2]), slicer, load_mesh(path))[OBJECT[slicer]]
    (thing,) = ET.fromstring(text.encode())
    assert thing.attrib["id"] == "1"
    settings = {m.attrib["key"]: m.attrib["value"] for m in thing.findall("metadata")}
    assert settings["ensure_vertical_shell_thickness"] == value
    assert settings["name"] == "a  b.stl"
    if slicer == "prusa":
        assert {m.attrib["type"] for m in thing.findall("metadata")} == {"object"}
        (volume,) = thing.findall("volume")
        assert (volume.attrib["firstid"], volume.attrib["lastid"]) == ("0", str(len(finned().faces) - 1))


@each_slicer
def test_the_same_part_makes_the_same_bytes(tmp_path, slicer):
    """No times, no random names."""
    for name in ("a.3mf", "b.3mf"):
        write(tmp_path / name, widths_of([0.6, 1.2]), slicer)
    assert (tmp_path / "a.3mf").read_bytes() == (tmp_path / "b.3mf").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.3mf") as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_nothing_is_replaced_without_force(tmp_path):
    """The file stays as it was; with force it is new."""
    path = tmp_path / "part.3mf"
    path.write_bytes(b"mine")
    with pytest.raises(OutputError, match="exists already; use --force"):
        write(path, widths_of([0.6]), "prusa")
    assert contents(tmp_path) == {"part.3mf": b"mine"}
    assert RANGES["prusa"] in write(path, widths_of([0.6]), "prusa", force=True)


# Tables


def test_tables_agree_with_the_arrays(tmp_path):
    """CSV and JSON have a row for each layer, with the same numbers."""
    before = widths_of([1.2, 0.9, 0.6, 0.6, 0.9, 1.2], first_mm=0.2)
    after = replace(before, width_mm=np.array([0.9, 0.9, 0.6, 0.6, 0.6, 0.6]))
    for name in ("w.csv", "w.json"):
        lf.write(tmp_path / name, plan(before, after, source="part.stl"))
    with (tmp_path / "w.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    stored = json.loads((tmp_path / "w.json").read_text())
    assert stored["source"] == "part.stl"
    assert len(lines) == len(stored["table"]) == 6
    for k, (line, row) in enumerate(zip(lines, stored["table"], strict=True)):
        assert {key: float(value or "nan") for key, value in line.items()} == pytest.approx(
            {key: np.nan if v is None else float(v) for key, v in row.items()}, nan_ok=True
        )
        assert row["layer"] == k
        assert (row["bottom_mm"], row["top_mm"]) == pytest.approx(tuple(before.z_mm[k]))
        laid = after.width_mm[k] if k else MK3S.first_layer_width_mm  # a slicer does the same
        assert (row["suggested_mm"], row["width_mm"]) == (before.width_mm[k], laid)
        assert row["too_thin"] is bool(before.too_thin[k])
        assert row["area_mm2"] == pytest.approx(before.area_mm2[k], abs=1e-4)


def test_a_job_writes_all_its_files(tmp_path):
    """One command, every suffix; the tables hold what the library finds, and the summary is printed as JSON."""
    part = write_stl(tmp_path / "part.stl", finned())
    targets = [tmp_path / f"out{suffix}" for suffix in SUFFIXES]
    outputs = [word for target in targets for word in ("-o", target)]
    done = run_layerfix("widths", part, "-p", MK3S.name, "--min", "0.6mm", "--max", "1.2mm", "--json", *outputs)
    assert (done.code, done.err) == (0, "")
    summary = json.loads(done.out)
    stored = json.loads((tmp_path / "out.json").read_text())
    assert {*contents(tmp_path)} == {"part.stl", *(target.name for target in targets)}
    stack = slice_mesh(load_mesh(part), pixel_mm=MK3S.pixel_mm, layer_mm=0.3, first_layer_mm=0.2, margin_mm=0.6)
    expected = suggest_widths(stack, min_mm=0.6, max_mm=1.2)
    assert [row["suggested_mm"] for row in stored["table"]] == expected.width_mm.tolist()
    assert summary["ranges"] == stored["ranges"] == [[0, pytest.approx(2.9), 1.2], [pytest.approx(2.9), 8, 0.75]]
    assert summary["too_thin"] == 0
    with zipfile.ZipFile(tmp_path / "out.3mf") as archive:
        ranges = ranges_in(archive.read(RANGES["prusa"]).decode())
    assert [(a, b, float(o["perimeter_extrusion_width"])) for a, b, o in ranges] == [(0, 2.9, 1.2), (2.9, 8, 0.75)]
    beads = [float(w) for w in re.findall(r"^;WIDTH:([\d.]+)", (tmp_path / "out.gcode").read_text(), re.MULTILINE)]
    assert max(beads) <= 1.2 + 1e-6


def test_what_is_told_is_in_the_table_too(tmp_path):
    """Notes of the part and of every file that is written, wherever the table stands among them."""
    part = write_stl(tmp_path / "part.stl", finned())
    part.write_bytes(part.read_bytes() + b"rest")
    outputs = [word for name in ("out.json", "out.gcode") for word in ("-o", tmp_path / name)]
    done = run_layerfix("widths", part, "-p", MK3S.name, "--min", "0.6mm", "--json", *outputs)
    notes = json.loads(done.out)["notes"]
    assert notes == json.loads((tmp_path / "out.json").read_text())["notes"]
    assert [note.split()[0] for note in notes] == ["4", "printing"]


def test_what_is_missing_or_merged_is_told(tmp_path):
    """An open mesh, layers without anything between others, bodies that a .3mf holds as one, a step too large."""
    tall = box([0, 0, 0], [4, 4, 1])
    opened = write_stl(tmp_path / "open.stl", chosen_faces(tall, np.arange(len(tall.faces)) != 0))
    assert "open mesh: gaps closed in 4 layers, the longest 3.8 mm" in told(opened)[0]
    apart = write_stl(tmp_path / "apart.stl", joined(tall, box([0, 0, 2], [4, 4, 3])))
    assert re.match(r"[23] layers are empty in the middle", told(apart)[0])
    fin = box([1, 1, 1], [3, 3, 2])
    bodies = {"base": tall, "fin": fin}
    scene = trimesh.Scene({name: trimesh.Trimesh(one.vertices, one.faces) for name, one in bodies.items()})
    scene.export(tmp_path / "two.3mf")
    assert told(tmp_path / "two.3mf") == []
    assert told(tmp_path / "two.3mf", tmp_path / "out.3mf") == ["two.3mf: its 2 bodies become one object of the .3mf"]
    write_stl(tmp_path / "tall.stl", tall)
    assert told(tmp_path / "tall.stl") == []
    assert told(tmp_path / "tall.stl", step_mm=3.0) == [
        "a step of 3 mm is more than the range: only 0.6 mm and 1.2 mm are tried"
    ]


def told(part: Path, *targets: Path, **wanted: float) -> list[str]:
    """The notes of a command."""
    asked = WidthOptions(min_mm=0.6, max_mm=1.2, **wanted)
    return [*suggest(part, targets, Options(printer=MK3S), asked).notes]


def test_heights_are_counted_from_the_part_s_lowest_point(tmp_path):
    """A part that floats at z = 5 is put on the bed, and its ranges begin there."""
    part = write_stl(tmp_path / "part.stl", Mesh(finned().vertices + np.array([50, 50, 5]), finned().faces))
    suggest(part, [tmp_path / "out.3mf"], Options(printer=MK3S), WidthOptions(min_mm=0.6, max_mm=1.2))
    with zipfile.ZipFile(tmp_path / "out.3mf") as archive:
        ranges = ranges_in(archive.read(RANGES["prusa"]).decode())
    assert [(a, b) for a, b, _ in ranges] == [(0, 2.9), (2.9, 8)]
    assert load_mesh(tmp_path / "out.3mf").bounds_mm[0] == pytest.approx((115, 95, 0))


@pytest.mark.parametrize(
    ("target", "words"),
    [("out.pdf", "widths are written as .3mf .gcode"), ("nowhere/out.csv", "there is no folder"),
     ("part.stl", "widths are written as"), ("there.csv", "exists already; use --force")],
)  # fmt: skip
def test_targets_are_refused_before_any_work(tmp_path, target, words):
    """Exit code 2 and one line; nothing is written."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    (tmp_path / "there.csv").write_text("mine")
    before = contents(tmp_path)
    done = run_layerfix("widths", part, "-p", MK3S.name, "-o", tmp_path / "good.csv", "-o", tmp_path / target)
    assert done.code == 2
    assert re.fullmatch(f"layerfix: .*{re.escape(words)}.*\n", done.err)
    assert contents(tmp_path) == before


def test_a_missing_part_is_said_so(tmp_path):
    """Also where the output exists and may be replaced."""
    (tmp_path / "there.csv").write_text("mine")
    for target, force in ((tmp_path / "new.csv", False), (tmp_path / "there.csv", True)):
        with pytest.raises(InputError, match=r"missing\.stl: no such file"):
            suggest(tmp_path / "missing.stl", [target], Options(printer=MK3S, run=Run(force=force)), WidthOptions())


def test_the_input_is_never_written_over(tmp_path):
    """A 3MF goes in and must not come out under its own name, not even by force."""
    part = tmp_path / "part.3mf"
    write(part, widths_of([0.6]), "prusa")
    before = part.read_bytes()
    with pytest.raises(OutputError, match="is the input"):
        suggest(part, [part], Options(printer=MK3S, run=Run(force=True)), WidthOptions())
    assert part.read_bytes() == before


# What PrusaSlicer makes of it


needs_prusa = pytest.mark.skipif(not shutil.which("prusa-slicer"), reason="prusa-slicer is not installed")


def sliced(part: Path, first_layer_mm: float) -> dict[float, dict[str, set[float]]]:
    """The widths of each kind of bead by the z of their layer, in PrusaSlicer's G-code with layers of 0.3 mm."""
    gcode = part.with_suffix(".gcode")
    command = [
        *("prusa-slicer", "--loglevel", "1", "-g", "--gcode-flavor", "marlin2", "--nozzle-diameter", "0.6"),
        *("--layer-height", "0.3", "--first-layer-height", f"{first_layer_mm}", "--filament-diameter", "1.75"),
        *("--skirts", "0", "--center", "100,100", "--perimeter-generator", "classic", "--no-thin-walls"),
        *("--no-gap-fill-enabled", "--bottom-solid-layers", "3", "-o", str(gcode), str(part)),
    ]
    ran = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=120, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    found: dict[float, dict[str, set[float]]] = defaultdict(lambda: defaultdict(set))
    z, kind, width = 0.0, "", 0.0
    for line in gcode.read_text().splitlines():
        key, _, value = line.partition(":")
        if key == ";Z":
            z = float(value)
        elif key == ";TYPE":
            kind = value
        elif key == ";WIDTH":
            width = float(value)
        elif re.match(r"G1 X\S+ Y\S+ E(?!-)", line):
            found[z][kind].add(round(width, 3))
    return found


@needs_prusa
def test_prusa_slicer_lays_what_the_ranges_say(tmp_path):
    """A plate with fins of 0.8 mm through both command lines: wide outer walls below, narrow ones above."""
    part = write_stl(tmp_path / "part.stl", finned())
    done = run_layerfix(
        "widths", part, "-p", MK3S.name, "--min", "0.6mm", "--max", "1.2mm", "-o", tmp_path / "part.3mf"
    )
    assert (done.code, done.err) == (0, "")
    with zipfile.ZipFile(tmp_path / "part.3mf") as archive:
        ranges = ranges_in(archive.read(RANGES["prusa"]).decode())
    layers = sliced(tmp_path / "part.3mf", first_layer_mm=0.2)
    assert len(layers) == 27
    for top, kinds in [*layers.items()][1:]:  # the first has a width of its own
        (said,) = [o for low, high, o in ranges if low < top - 0.15 < high]
        assert kinds["External perimeter"] == {float(said["external_perimeter_extrusion_width"])}, top
    assert {w for kinds in layers.values() for w in kinds["External perimeter"]} >= {1.2, 0.75}


@needs_prusa
@pytest.mark.parametrize(("below", "above"), [(1.2, 0.6), (0.6, 1.2), (0.7, 0.6)])
def test_prusa_slicer_keeps_solid_layers_at_a_border(tmp_path, below, above):
    """Three solid bottom layers over a border after two; without the object's settings the third is sparse."""
    path = tmp_path / "with.3mf"
    entries = write(path, widths_of([below] * 2 + [above] * 11), "prusa", box([0, 0, 0], [20, 20, 4]))
    with zipfile.ZipFile(tmp_path / "without.3mf", "w") as archive:
        for name in entries.keys() - {OBJECT["prusa"]}:
            archive.writestr(name, entries[name])

    def solid_at_the_bottom(part: Path) -> int:
        layers = sliced(part, first_layer_mm=0.3).values()
        return next(k for k, kinds in enumerate(layers) if "Internal infill" in kinds or "Solid infill" not in kinds)

    assert solid_at_the_bottom(path) == 3
    assert solid_at_the_bottom(tmp_path / "without.3mf") == 2


# Times


def layers_of(area: float, outline: float, heights: list[float]) -> Widths:
    """Equal layers of these heights."""
    n, tops = len(heights), np.cumsum(heights)
    z_mm = np.column_stack([np.concatenate([[0.0], tops[:-1]]), tops])
    return Widths(z_mm, np.full(n, 0.6), np.zeros(n, bool), np.full(n, area), np.full(n, outline), (0.6, 1.2), 0.05)


def seconds(widths: Widths, width_mm: float, most: float | None, **how: float) -> tuple[float, float]:
    """(all, melting) of the 0.6 mm printer with another limit of what it melts, without solid layers."""
    speeds = Speeds(replace(MK3S, max_volumetric_speed_mm3_s=most))
    taken = speeds.by_area(widths, np.full(len(widths), width_mm), **{"shells": (0, 0), **how})
    return taken.seconds, taken.melting_s


heights_mm = st.lists(st.floats(0.1, 0.4), min_size=1, max_size=5)
parts = st.builds(layers_of, st.floats(0, 2000), st.floats(0, 400), heights_mm)
bead_widths = st.floats(0.51, 1.2)


@given(parts, bead_widths, bead_widths, st.integers(1, 4), st.floats(0, 1))
def test_without_a_limit_wider_is_never_slower(part, a, b, perimeters, density):
    """Nothing melts too slowly, and fewer beads are laid."""
    narrow, wide = (seconds(part, w, None, perimeters=perimeters, density=density) for w in sorted((a, b)))
    assert wide[0] <= narrow[0] * (1 + 1e-9)
    assert narrow[1] == wide[1] == 0


@given(parts, bead_widths, st.floats(1e-3, 100), st.integers(1, 4), st.floats(0, 1))
def test_no_printer_is_faster_than_what_it_melts(part, width, most, perimeters, density):
    """The least time is the volume of walls and infill over the limit; it is the time where only melting counts."""
    height = np.diff(part.z_mm, axis=1)[:, 0]
    spacing = width - height * (1 - math.pi / 4)
    walls = np.minimum(perimeters * part.outline_mm * spacing, part.area_mm2)
    volume = float(((walls + density * (part.area_mm2 - walls)) * height).sum())
    how = {"perimeters": perimeters, "density": density}
    total, melting = seconds(part, width, most, **how)
    assert total >= volume / most * (1 - 1e-9)
    assert 0 <= melting <= total * (1 + 1e-9)
    assert total >= seconds(part, width, None, **how)[0] * (1 - 1e-9)
    slow, all_of_it = seconds(part, width, 1e-3, **how)
    assert slow == pytest.approx(volume / 1e-3)
    assert all_of_it == pytest.approx(slow)


@given(parts, bead_widths, bead_widths)
def test_where_melting_sets_the_pace_a_solid_part_takes_as_long_with_any_bead(part, a, b):
    """A solid part is the same volume; of a sparse one wider walls are more, so that wider beads are slower."""
    assert seconds(part, a, 0.01, density=1)[0] == pytest.approx(seconds(part, b, 0.01, density=1)[0])
    narrow, wide = (seconds(part, w, 0.01)[0] for w in sorted((a, b)))
    assert wide >= narrow * (1 - 1e-9)


def test_seconds_of_a_square_by_hand():
    """10 × 10 mm, two layers of 0.3 mm: 40 mm of outer wall, 40 mm inside it, the rest at 20 %."""
    spacing = 0.6 - 0.3 * (1 - math.pi / 4)
    filling = (100 - 80 * spacing) / spacing * 0.2
    first = (80 + filling) / 20
    second = 40 / 35 + 40 / 45 + filling / 70
    assert seconds(layers_of(100, 40, [0.3, 0.3]), 0.6, None)[0] == pytest.approx(first + second)


@pytest.mark.parametrize(
    ("most", "words", "never"),
    [
        (None, "how much it can melt is not known", "reached"),
        (0.5, "melting: 0.5 mm³/s are reached in 100 %", "speeds set"),
        (1000.0, "the speeds set for the printer; melting (1000 mm³/s) limits 0 %", "reached"),
    ],
)
def test_the_summary_names_what_limits(tmp_path, most, words, never):
    """Melting, or the printer's speeds."""
    part = write_stl(tmp_path / "part.stl", box([0, 0, 0], [10, 10, 1]))
    printer = replace(MK3S, max_volumetric_speed_mm3_s=most)
    summary = suggest(part, [], Options(printer=printer), WidthOptions(min_mm=0.6, max_mm=1.2))
    assert words in summary.limit
    assert never not in summary.limit
    assert ("limit", summary.limit) in lines_of(summary)
    assert summary.melting_share == pytest.approx({None: 0, 0.5: 1, 1000.0: 0}[most])
    usual = np.array([MK3S.first_layer_width_mm, *[MK3S.extrusion_width_mm] * (summary.layers - 1)])
    expected = Speeds(printer).by_area(suggested(part), usual)
    assert summary.seconds_before == pytest.approx(expected.seconds, rel=1e-6)
    assert summary.filament_before_mm == pytest.approx(expected.filament_mm, rel=1e-6)


def suggested(part: Path) -> Widths:
    """What the library finds for a part, with the printer's layers."""
    stack = slice_mesh(load_mesh(part), pixel_mm=MK3S.pixel_mm, layer_mm=0.3, first_layer_mm=0.2, margin_mm=0.6)
    return suggest_widths(stack, min_mm=0.6, max_mm=1.2)


def test_a_block_is_as_much_faster_as_in_prusa_slicer(tmp_path):
    """40 × 40 × 10 mm with fins of 0.8 mm, 1.2 instead of 0.6 mm in the block.

    PrusaSlicer 2.5 at the same speeds: −24 % without a limit, −16 % with 15 mm³/s, and +6 % with 8 mm³/s, where the
    thicker walls are more to melt.
    """
    fins = [box([x, 5, 9.9], [x + 0.8, 35, 14]) for x in (5, 12, 19, 26, 33)]
    widths = suggested(write_stl(tmp_path / "part.stl", joined(box([0, 0, 0], [40, 40, 10]), *fins)))
    wide = np.where(widths.z_mm[:, 1] < 10.2, 1.2, 0.6)
    wide[0] = 0.65  # a slicer's first layer has a width of its own
    change = {}
    for most in (None, 15.0, 8.0):
        speeds = Speeds(replace(MK3S, max_volumetric_speed_mm3_s=most))
        before = speeds.by_area(widths, np.where(np.arange(len(widths)) == 0, 0.65, 0.6)).seconds
        change[most] = speeds.by_area(widths, wide).seconds / before - 1
    assert change[None] == pytest.approx(-0.24, abs=0.06), change  # beads alone: travels and corners save nothing
    assert change[15.0] == pytest.approx(-0.16, abs=0.06), change
    assert change[8.0] > change[15.0]


def test_filament_of_a_block_by_hand():
    """10 × 10 mm: solid where one of four layers above or below is missing, else walls and a fifth of the rest."""
    part = layers_of(100, 40, [0.3] * 20)
    spacing = 0.6 - 0.3 * (1 - math.pi / 4)
    walls = 80 * spacing
    volume = 0.3 * (8 * 100 + 12 * (walls + 0.2 * (100 - walls)))
    taken = Speeds(MK3S).by_area(part, np.full(20, 0.6))
    assert taken.volume_mm3 == pytest.approx(volume)
    assert taken.filament_mm == pytest.approx(volume / (math.pi * 1.75**2 / 4))
    roof = replace(part, area_mm2=np.where(np.arange(20) < 10, 100.0, 60.0))
    more = 0.3 * 4 * 0.8 * 40  # 40 mm² of the four layers under the step are solid, too
    smaller = 0.3 * (4 * 40 + 6 * 0.2 * 40)  # what the ten upper layers have less
    assert Speeds(MK3S).by_area(roof, np.full(20, 0.6)).volume_mm3 == pytest.approx(volume + more - smaller)


@pytest.mark.parametrize("name", ["fins", "block"])
def test_filament_is_about_that_of_the_g_code(tmp_path, name):
    """What is said before anything is planned, against what is laid: within 8 %."""
    mesh = {"fins": finned(), "block": box([0, 0, 0], [30, 20, 6])}[name]
    part = write_stl(tmp_path / "part.stl", mesh)
    done = run_layerfix("widths", part, "-p", MK3S.name, "-o", tmp_path / "a.gcode", "-o", tmp_path / "a.json")
    assert done.code == 0
    said = json.loads((tmp_path / "a.json").read_text())
    laid = sum(layer.volume_mm3() for layer in read_gcode(tmp_path / "a.gcode"))
    assert said["volume_mm3"] == pytest.approx(laid, rel=0.08)
    assert said["filament_after_mm"] == pytest.approx(said["volume_mm3"] / (math.pi * 1.75**2 / 4))


def test_the_first_layer_has_the_printers_own_width_everywhere(tmp_path):
    """In the G-code, in the tables and in the figures; the bands are what a slicer is told, which does the same."""
    part = write_stl(tmp_path / "part.stl", box([0, 0, 0], [20, 20, 3]))
    outputs = [word for suffix in ("gcode", "json", "3mf") for word in ("-o", tmp_path / f"a.{suffix}")]
    done = run_layerfix("widths", part, "-p", MK3S.name, "--min", "0.8mm", "--max", "1.2mm", *outputs)
    assert done.code == 0
    own = MK3S.first_layer_width_mm
    said = json.loads((tmp_path / "a.json").read_text())
    assert [row["width_mm"] for row in said["table"]] == [own, *[1.2] * (said["layers"] - 1)]
    assert said["ranges"] == [[0.0, pytest.approx(2.9), 1.2]]
    assert said["first_layer_width_mm"] == own
    assert "layer 0" in done.out
    layers = read_gcode(tmp_path / "a.gcode")
    outer = [[p for p in x.paths if p.kind == "External perimeter"] for x in layers]
    widths = [main_width(paths) for paths in outer]  # beads are balanced where it turns
    assert widths == pytest.approx([own, *[1.2] * (len(layers) - 1)], abs=0.031)


PARTS = {
    "block": lambda: box([0, 0, 0], [20, 20, 5]),
    "fin": lambda: joined(box([0, 0, 0], [20, 20, 2]), box([5, 5, 1.9], [5.65, 15, 6])),
    "hair": lambda: joined(box([0, 0, 0], [20, 20, 2]), box([5, 5, 1.9], [5.3, 15, 6])),
}


@pytest.mark.parametrize("name", PARTS)
def test_nothing_that_is_said_contradicts_itself(tmp_path, name):
    """Over ranges, bands and limits: advice, limit, percentages and figures agree."""
    part = write_stl(tmp_path / "part.stl", PARTS[name]())
    for (low, high), bands, most in product(
        [(0.6, 1.2), (0.65, 0.65), (0.51, 0.6), (0.9, 1.2)], [1, 3], [None, 4.0, 15.0]
    ):
        printer = replace(MK3S, max_volumetric_speed_mm3_s=most)
        told = suggest(part, [], Options(printer=printer), WidthOptions(min_mm=low, max_mm=high, bands=bands))
        rows = lines_of(told)
        text = "\n".join(f"{key:8} {value}" for key, value in rows)
        assert "-0.0" not in text
        assert "+0.0" not in text
        saved = 1 - told.seconds_after / told.seconds_before
        advice = [value for key, value in rows if key == "advice"]
        assert bool(advice) == (saved < 0.005), text
        if advice and "as fast" in advice[0]:
            assert abs(saved) <= 0.005
        if advice and "faster" in advice[0]:
            assert saved < -0.005
        if advice and "would lose" in advice[0]:
            assert told.finer_layers > 0
            assert any(width < told.usual_width_mm for _, _, width in told.ranges)
        else:
            assert not told.finer_layers or saved >= 0.005
        compared = [value for _, value in rows if "everywhere (" in value]
        assert len(compared) == len(set(compared)) == (1 if low == told.usual_width_mm else 2)
        percent = re.search(r"([+-][\d.]+) % against", compared[0])
        assert (float(percent[1]) < 0) == (saved > 0) if percent else abs(saved) < 0.0006
        (filament,) = [value for key, value in rows if key == "filament"]
        assert f"{told.filament_after_mm / 1000:.3g} m" in filament
        assert told.volume_mm3 == pytest.approx(told.filament_after_mm * math.pi * 1.75**2 / 4)
