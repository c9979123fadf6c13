"""All shipped printers: what their files say is sane, the index is of them, and each slices a part."""

from __future__ import annotations

import re
import resource
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix import LayerfixError, LayerStack, Printer, correct, load_printer, slice_mesh, write
from layerfix.cli.shared import with_codes
from layerfix.commands.check import check
from layerfix.commands.fix import fix
from layerfix.commands.options import options_of
from layerfix.errors import InputError
from layerfix.printers import entries, find_by_host, find_printers, printer_folder, printer_names
from layerfix.printers.index import INDEX
from tests.making import box, environment, joined, run_layerfix, thin_part, write_stl
from tests.printer_files import entry_of, write_index

ALL = [load_printer(name) for name in printer_names()]
FORMATS = re.compile(r"\.(sl1s?|m1|ctb|goo|photon|nanodlp|zip|cws|phz|prz|n[47]|svgx|cxdlp(v4)?|p[wmpx]\w+|m5sp|"
                     r"dl2?p|lgs\d*|qdt|osf|fdg|jxs|zcodex?|gcode)|")  # fmt: skip


def of(process: str) -> list[Printer]:
    """All of a process, at least as many as there were facts for."""
    return [p for p in ALL if p.process == process]


def test_there_are_as_many_as_promised():
    """Resin printers, FDM machines with their nozzles, at least twelve materials of four services."""
    assert (len(of("resin")), len(of("fdm"))) >= (140, 340)
    services = of("service")
    assert len(services) >= 12
    assert len({p.maker for p in services}) >= 4


def test_the_index_is_of_the_files():
    """What it says is what they say, one a line; else: python -m tests.printer_files sample_printers."""
    assert (printer_folder() / INDEX).read_text(encoding="utf-8") == write_index(printer_folder())
    assert [e.name for e in entries()] == list(printer_names())
    for entry, printer in zip(entries(), ALL, strict=True):
        assert entry == entry_of(printer)
        assert entry.title == printer.title


def test_names_are_plain_and_mean_one_machine():
    """Small letters, digits, hyphens and points; maker, model and nozzle are there once."""
    assert all(re.fullmatch(r"[a-z0-9]+([-.][a-z0-9]+)*", p.name) for p in ALL)
    assert len({(p.maker, p.model, p.nozzle_mm) for p in ALL}) == len(ALL)
    assert all(p.name.endswith(f"-{p.nozzle_mm:g}") for p in of("fdm"))


def test_panels_are_as_large_as_what_they_print():
    """Pixels × pitch is the build area within 0.5 % on both axes, and pixels are of a size that is made."""
    for p in of("resin"):
        assert p.pixels
        for count, pitch, size in zip(p.pixels, p.pixel_mm, p.room_mm, strict=False):
            assert count * pitch == pytest.approx(size, rel=0.005), p.name
        assert all(400 <= count <= 16000 for count in p.pixels), p.name
        assert all(0.01 <= pitch <= 0.14 for pitch in p.pixel_mm), p.name
        assert 0.5 <= p.pixel_mm[0] / p.pixel_mm[1] <= 2, p.name
        assert p.min_feature_mm == pytest.approx(max(0.15, 4 * max(p.pixel_mm)), abs=0.006), p.name
        assert p.nozzle_mm is p.gcode_flavor is None


def test_nozzles_lay_what_their_files_say():
    """Beads within what the nozzle lays, layers it can, heat of PLA, speeds and flow of a machine."""
    for p in of("fdm"):
        assert p.nozzle_mm, p.name
        assert p.nozzle_mm in (0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8), p.name
        assert p.filament_mm in (1.75, 2.85), p.name
        assert p.width_range_mm == pytest.approx((0.85 * p.nozzle_mm, 2 * p.nozzle_mm)), p.name
        for width in (p.extrusion_width_mm, p.first_layer_width_mm):
            assert width, p.name
            assert p.width_range_mm[0] - 1e-9 <= width <= p.width_range_mm[1] + 1e-9, p.name
        assert p.min_feature_mm == pytest.approx(2 * p.nozzle_mm), p.name
        assert p.layer_range_mm[0] <= p.layer_mm <= p.layer_range_mm[1] <= 0.8 * p.nozzle_mm + 1e-9, p.name
        assert (p.first_layer_mm or p.layer_mm) <= 0.8 * p.nozzle_mm + 1e-9, p.name
        assert p.max_volumetric_speed_mm3_s, p.name
        assert 1 <= p.max_volumetric_speed_mm3_s <= 60, p.name
        for key in ("external_perimeter_mm_s", "perimeter_mm_s", "infill_mm_s", "travel_mm_s", "first_layer_mm_s"):
            assert 5 <= getattr(p, key) <= 1500, (p.name, key)
        assert 180 <= (p.nozzle_c or 0) <= 250, p.name
        assert 30 <= (p.bed_c or 0) <= 80, p.name
        assert 0 <= (p.retract_mm or 0) <= 10, p.name
        assert p.pixels is p.exposure_s is None


def test_services_say_what_they_take():
    """Walls, pixels that are a sixteenth of the feature, the page where the service says so; no machine's size."""
    for p in of("service"):
        assert p.min_wall_mm, p.name
        assert p.min_feature_mm == max(p.min_wall_mm, p.min_free_wall_mm or 0), p.name
        assert 0.3 <= p.min_feature_mm <= 3, p.name
        assert p.pixel_mm == pytest.approx((p.min_feature_mm / 16,) * 2), p.name
        assert p.layer_mm == p.pixel_mm[0], p.name
        assert re.match(r"https?://\S+$", p.source or ""), p.name
        assert p.build_mm is p.pixels is p.nozzle_mm is None
        assert p.mode == "add_only"


def test_what_all_have_in_common():
    """Sizes of machines, layers in their range, a feature of two pixels at least, a known kind of job, a source."""
    for p in ALL:
        assert p.layer_range_mm[0] <= p.layer_mm <= p.layer_range_mm[1], p.name
        assert 2 * max(p.pixel_mm) <= p.min_feature_mm <= 3, p.name
        assert p.process == "service" or all(50 < side < 1200 for side in p.room_mm), p.name
        assert FORMATS.fullmatch(p.format), p.name
        text = (printer_folder() / f"{p.name}.toml").read_text(encoding="utf-8")
        assert re.search("UVtools|PrusaSlicer|OrcaSlicer|sla-fw|own page", text), p.name
        assert max(map(len, text.splitlines())) <= 140, p.name


def test_every_printer_slices_a_part():
    """A plate with a fin that is too thin, on each one's own pixels and layers: the fin comes out as wide as the
    feature, and nothing of a job's raster (a frame as large as the part, not the panel).
    """
    for kind in {(p.pixel_mm, p.layer_mm, p.first_layer_mm, p.min_feature_mm, p.mode) for p in ALL}:
        pixel_mm, layer_mm, first_mm, feature_mm, mode = kind
        height, thick = 2.2 * layer_mm + (first_mm or 0), feature_mm / 4
        part = joined(box([0, 0, 0], [4 * feature_mm, 3 * feature_mm, layer_mm]),
                      box([2 * feature_mm, 0, 0], [2 * feature_mm + thick, 3 * feature_mm, height]))  # fmt: skip
        stack = slice_mesh(part, pixel_mm=pixel_mm, layer_mm=layer_mm, first_layer_mm=first_mm, margin_mm=feature_mm)
        fixed = correct(stack, min_feature_mm=feature_mm, mode=mode)
        top = fixed[len(fixed) - 1].image()
        middle = top[len(top) // 2]
        assert abs(middle.sum() * pixel_mm[0] - feature_mm) <= 1.01 * pixel_mm[0], kind
        assert np.array_equal(np.flatnonzero(middle), np.arange(*np.flatnonzero(middle)[[0, -1]] + [0, 1]))


def test_a_service_by_name_corrects_a_mesh(tmp_path):
    """The mesh comes back with walls of what the service takes, nothing of it missing, and it is said how."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    options = options_of(load_printer("tempus3d-pa12-mjf"), {})
    said = fix(part, tmp_path / "fixed.stl", options)
    assert (said.mode, said.min_feature_mm, said.removed_mm3) == ("add_only", 0.5, 0)
    assert said.pixel_mm == (0.03125, 0.03125)
    assert any("walls of 0.5 mm, on pixels and layers of 31.25" in note for note in said.notes)
    assert any("--min-feature 0.9mm" in note for note in said.notes)
    assert check(tmp_path / "fixed.stl", options).features_lost == 0


def test_a_service_that_says_nothing_itself_is_not_there():
    """What is like it is proposed."""
    with pytest.raises(InputError, match=r"did you mean .*-pa12-"):
        load_printer("shapeways-pa12")


# start and end code ---------------------------------------------------------------------------------------


def test_g_code_without_start_code_is_refused_and_taken_from_files(tmp_path):
    """Both options are named; with them the code stands where it belongs, with the printer's heat in it."""
    part = write_stl(tmp_path / "part.stl", box([0, 0, 0], [6, 4, 0.6]))
    start, end = tmp_path / "start.gcode", tmp_path / "end.gcode"
    start.write_text("G28 ; mine\nM109 S{first_layer_nozzle_c}\n", encoding="utf-8")
    end.write_text("M84 ; mine too\n", encoding="utf-8")
    target = tmp_path / "part.gcode"
    refused = run_layerfix("fix", part, target, "-p", "bambu-lab-p1s-0.4")
    assert (refused.code, target.exists()) == (2, False)
    assert "no start and end code of Bambu Lab P1S is known" in refused.err
    assert "--start-gcode FILE --end-gcode FILE" in refused.err
    done = run_layerfix("fix", part, target, "-p", "bambu-lab-p1s-0.4", "--start-gcode", start, "--end-gcode", end)
    assert done.code == 0, done.err
    lines = target.read_text(encoding="utf-8").splitlines()
    heat = load_printer("bambu-lab-p1s-0.4").first_layer_nozzle_c
    assert lines.index("G28 ; mine") < lines.index(f"M109 S{heat:g}") < lines.index(";LAYER_CHANGE")
    assert lines.index("M84 ; mine too") > max(k for k, line in enumerate(lines) if line == ";LAYER_CHANGE")


@pytest.mark.parametrize(
    ("given", "target", "said"),
    [({"start_gcode": "G28"}, "part.gcode", "no end code of Bambu Lab P1S is known.*; give --end-gcode FILE"),
     ({"start_gcode": "M140 S{if x}", "end_gcode": ""}, "part.gcode", "no end code"),
     ({"start_gcode": "M140 S{if x}", "end_gcode": "M84"}, "part.gcode", r"--start-gcode has \{if x\}; it may have"),
     ({"end_gcode": "M84"}, "layers.zip", "--end-gcode goes with .gcode")],
)  # fmt: skip
def test_wrong_code_is_named(tmp_path, given, target, said):
    """Only half of it, placeholders that nothing fills, another kind of file."""
    part = write_stl(tmp_path / "part.stl", box([0, 0, 0], [6, 4, 0.6]))
    with pytest.raises(LayerfixError, match=said):
        fix(part, tmp_path / target, options_of(load_printer("bambu-lab-p1s-0.4"), given))
    assert not (tmp_path / target).exists()


def test_files_with_code_are_read_with_care(tmp_path):
    """A missing file, a folder and what is no text are named."""
    (tmp_path / "binary").write_bytes(b"G28\xff")
    for path, why in ((tmp_path / "none", "no such file"), (tmp_path, "is a folder"), (tmp_path / "binary", "UTF-8")):
        with pytest.raises(InputError, match=why):
            with_codes({"start_gcode": path, "end_gcode": None})


def test_a_bed_may_begin_elsewhere_and_be_round():
    """The middle of the part is in the middle of the bed, and a corner outside the disc is beside it."""
    from layerfix.formats.vector.gcode_bed import _lies_on, bed_offset_mm

    delta = load_printer("flsun-s1-0.4")
    assert (delta.bed_origin_mm, delta.round_bed) == ((-160, -160), True)
    stack = slice_mesh(box([5, 5, 0], [11, 9, 0.4]), pixel_mm=0.05, layer_mm=0.2, margin_mm=0.8)
    assert bed_offset_mm(stack, delta) == pytest.approx([-8, -7], abs=0.06)
    square = replace(delta, round_bed=None)
    for corner, on_disc, on_square in (([0, 0], 1, 1), ([-150, -150], 0, 1), ([159, 0], 1, 1), ([161, 0], 0, 0)):
        assert (_lies_on(np.array([corner]), delta), _lies_on(np.array([corner]), square)) == (on_disc, on_square)


def test_a_job_that_only_others_write_is_refused_by_name(tmp_path):
    """What to write instead is said before any work."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    with pytest.raises(LayerfixError, match=r"new \.pwmo jobs .* images .* UVtools"):
        fix(part, tmp_path / "a.pwmo", options_of(load_printer("anycubic-photon-mono"), {}))


# found by what hosts say ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("said", "names"),
    [("Original Prusa i3 MK3S & MK3S+", "prusa-mk3s-0.25 prusa-mk3s-0.4 prusa-mk3s-0.6 prusa-mk3s-0.8"),
     ("Original Prusa i3 MK3S & MK3S+ 0.6 nozzle", "prusa-mk3s-0.6"),
     ("Bambu Lab P1S 0.4 nozzle", "bambu-lab-p1s-0.4"),
     ("Elegoo Neptune 4 Max (0.6 nozzle)", "elegoo-neptune-4-max-0.6"), ("COREONE", "prusa-core-one-0.25"
      " prusa-core-one-0.4 prusa-core-one-0.6 prusa-core-one-0.8"),
     ("Original Prusa MK4S HF0.4 nozzle", "prusa-mk4s-hf-0.4"),
     ("Original Prusa MK4S 0.25 nozzle", "prusa-mk4s-0.25"),
     ("MK4S", "prusa-mk4s-0.25 prusa-mk4s-0.4 prusa-mk4s-0.6 prusa-mk4s-0.8"), ("SL1S", "prusa-sl1s"),
     ("Original Prusa XL Input Shaper 0.4 nozzle", "prusa-xl-0.4"),
     ("Prusa CORE One HF0.4 nozzle", "prusa-core-one-hf-0.4"),
     ("Creality Ender-3 V3 KE", "creality-ender-3-v3-ke-0.2 creality-ender-3-v3-ke-0.4 creality-ender-3-v3-ke-0.6"
      " creality-ender-3-v3-ke-0.8"), ("Ultimaker S5", "ultimaker-s5-0.4"), ("ELEGOO Mars 3", "elegoo-mars-3"),
     ("Photon Mono M7 Pro", "anycubic-photon-mono-m7-pro"), ("Nobody's 3000", ""), ("", "")],
)  # fmt: skip
def test_a_printer_by_a_hosts_own_name(said, names):
    """PrusaSlicer's, OrcaSlicer's and Cura's names of presets and machines, and those in resin jobs."""
    assert " ".join(e.name for e in find_by_host(said)) == names


def test_nozzle_and_panel_decide():
    """A given nozzle chooses among several; pixels and size find a panel either way round; a name wins over them."""
    assert [e.name for e in find_by_host("MK4S", nozzle_mm=0.6)] == ["prusa-mk4s-0.6"]
    assert [e.name for e in find_by_host(pixels=(9024, 5120), size_mm=(153.4, 87))] == [
        "anycubic-photon-mono-4", "anycubic-photon-mono-4-ultra"]  # fmt: skip
    turned = find_by_host(pixels=(2560, 1620), size_mm=(128, 81))
    assert "prusa-sl1s" in {e.name for e in turned}
    assert all(e.pixels == (1620, 2560) and e.build_mm[:2] == (81, 128) for e in turned)
    assert [e.name for e in find_by_host("ELEGOO Mars 2", pixels=(1620, 2560))] == ["elegoo-mars-2"]
    assert find_by_host(pixels=(123, 456)) == []
    assert find_by_host("ELEGOO Mars 3", pixels=(1620, 2560), size_mm=(81, 128)) == []


@given(st.sampled_from(entries()))
def test_each_is_found_by_its_own_name(entry):
    """By title with its nozzle, and by what slicers call it: it is among the found, and they are few."""
    names = [*entry.slicer_names, entry.title]
    for name in names:
        found = find_by_host(name, nozzle_mm=entry.nozzle_mm, pixels=entry.pixels)
        assert entry in found, name
        assert len(found) <= 4, name


def test_a_job_suggests_its_printer(tmp_path):
    """A note when none was given, another when it is for another, none when it fits; and in the error without F."""
    printer = load_printer("prusa-sl1s")
    image = np.zeros((2560, 1620), bool)
    image[100:140, 200:203] = True
    stack = LayerStack.from_images([image] * 2, pixel_mm=printer.pixel_mm, layer_mm=0.05)
    write(tmp_path / "job.sl1s", stack, printer)

    def notes(printer: str | None, **given: object) -> str:
        return " ".join(check(tmp_path / "job.sl1s", options_of(printer and load_printer(printer), given)).notes)

    assert "this job is for Original Prusa SL1S SPEED: --printer prusa-sl1s" in notes(None, min_feature_mm=0.2)
    assert "not for Elegoo Saturn: --printer prusa-sl1s" in notes("elegoo-saturn")
    assert "this job is for" not in notes("prusa-sl1s")
    with pytest.raises(
        InputError, match=r"--printer; job.sl1s is for Original Prusa SL1S SPEED: --printer prusa-sl1s"
    ):
        notes(None)


# speed ----------------------------------------------------------------------------------------------------


def cpu_s(*args: str) -> float:
    """Processor time of a Python process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *args], env=environment(), check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_the_list_reads_no_printer_file():
    """The list and the search come of the index alone."""
    code = (
        "import tomllib; tomllib.loads = tomllib.load = None\n"
        "from layerfix.printers import find_printers, listing\n"
        "assert len(listing(find_printers())) > 500 and find_printers(text='elego satrun')"
    )
    assert cpu_s("-c", code) < 30 * cpu_s("-c", "import json, difflib, dataclasses")
    assert find_printers(text="elego satrun")
