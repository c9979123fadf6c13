"""`layerfix check --gcode`: what a finished G-code leaves out of a model, and the script that slicers run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from layerfix import load_printer
from layerfix.commands.fix import fix
from layerfix.commands.gcode_check import GcodeVerdict, check_gcode
from layerfix.commands.options import options_of
from layerfix.errors import InputError
from layerfix.mesh.triangles import Mesh
from tests.making import box, environment, joined, run_layerfix, write_stl
from tests.projects import FIN_AT, PRINT, entries_of, fin_part, prusa_project, write_zip

SCRIPT = Path(__file__).parents[1] / "plugin" / "prusaslicer" / "layerfix_check.py"
slicer = pytest.mark.skipif(shutil.which("prusa-slicer") is None, reason="no prusa-slicer here")
NOTHING = options_of(None, {})


def lines(*rings: tuple[float, float, float, float], top: float, width: float = 0.45) -> list[str]:
    """A layer of beads along rectangles (left, bottom, right, top), and one across each."""
    out = [
        ";LAYER_CHANGE",
        f";Z:{top:g}",
        ";HEIGHT:0.2",
        f"G1 Z{top:g}",
        ";TYPE:External perimeter",
        f";WIDTH:{width}",
    ]
    for left, bottom, right, high in rings:
        out.append(f"G1 X{left} Y{bottom}")
        out += [f"G1 X{x} Y{y} E1" for x, y in ((right, bottom), (right, high), (left, high), (left, bottom))]
        out += [f"G1 X{left} Y{y:.2f}\nG1 X{right} Y{y:.2f} E1" for y in np.arange(bottom, high, 0.4)]
    return out


def two_posts(height: float = 1.0) -> Mesh:
    """Posts of 2 × 2 mm, 3 mm apart, the second one at x 5 to 7."""
    return joined(box([0, 0, 0], [2, 2, height]), box([5, 0, 0], [7, 2, height]))


def written(path: Path, mesh: Mesh) -> Path:
    """An STL, over another."""
    path.unlink(missing_ok=True)
    return write_stl(path, mesh)


def judged(folder: Path, mesh: Mesh, layers: list[list[str]], **given: object) -> GcodeVerdict:
    """The verdict on some G-code."""
    gcode = folder / "a.gcode"
    gcode.write_text("\n".join(["M83", *(line for layer in layers for line in layer)]) + "\n")
    return check_gcode(written(folder / "a.stl", mesh), gcode, options_of(None, given))


def test_all_is_there(tmp_path):
    """Each part has beads in each layer."""
    verdict = judged(tmp_path, two_posts(), [lines((0, 0, 2, 2), (5, 0, 7, 2), top=0.2 * k) for k in range(1, 6)])
    assert (verdict.ok, verdict.layers, verdict.components, verdict.dropped, verdict.missing) == (True, 5, 10, 0, 0)
    assert verdict.coverage_percent > 95
    assert verdict.moved_mm == (0, 0)


def test_a_dropped_part_is_named_with_its_place(tmp_path):
    """The second post is missing in two layers; its box is in the model's own coordinates, wherever it lies."""
    for x, y in ((0, 0), (103.2, 90.7)):
        rings = [(x, y, x + 2, y + 2), (x + 5, y, x + 7, y + 2)]
        layers = [lines(*(rings[:1] if k in (2, 3) else rings), top=0.2 * k) for k in range(1, 6)]
        verdict = judged(tmp_path, two_posts(), layers)
        assert (verdict.ok, verdict.dropped, verdict.layers_with_loss) == (False, 2, 2)
        assert verdict.moved_mm == pytest.approx((x, y), abs=0.26)
        assert [place.z_mm for place in verdict.lost] == [(0.2, 0.4), (0.4, 0.6)]
        assert verdict.lost[0].box_mm == pytest.approx((5, 0, 7, 2), abs=0.06)
        assert verdict.lost[0].area_mm2 == pytest.approx(4, rel=0.05)


def test_the_place_is_found_though_most_of_one_side_is_missing(tmp_path):
    """The middle of the beads is not the middle of the model then."""
    layers = [lines((50, 50, 52, 52), top=0.2 * k) for k in range(1, 6)]
    mesh = joined(box([0, 0, 0], [2, 2, 1]), box([5, 0, 0], [5.1, 2, 1]), box([8, 0, 0], [8.1, 2, 1]))
    verdict = judged(tmp_path, mesh, layers)
    assert (verdict.components, verdict.dropped) == (15, 10)
    assert verdict.moved_mm == pytest.approx((50, 50), abs=0.26)


def test_layers_that_are_not_there_are_counted(tmp_path):
    """In the middle, and above the last one."""
    layers = [lines((0, 0, 2, 2), (5, 0, 7, 2), top=0.2 * k) for k in (1, 2, 4)]
    verdict = judged(tmp_path, two_posts(), layers)
    assert (verdict.ok, verdict.layers, verdict.missing, verdict.dropped) == (False, 5, 2, 4)


def test_skirts_and_supports_are_no_part(tmp_path):
    """Beads of support where a post should be do not count."""
    layers = []
    for k in range(1, 6):
        layer = lines((0, 0, 2, 2), top=0.2 * k)
        layers.append([*layer, *(";TYPE:Support material" if line.startswith(";TYPE") else line
                                 for line in lines((5, 0, 7, 2), top=0.2 * k)[4:])])  # fmt: skip
    assert judged(tmp_path, two_posts(), layers).dropped == 5


def test_a_part_elsewhere_is_told_of_and_another_model_is_refused(tmp_path):
    """More than the model: a note. Not there at all: an error."""
    layers = [lines((0, 0, 2, 2), (5, 0, 7, 2), (30, 30, 34, 34), top=0.2 * k) for k in range(1, 6)]
    verdict = judged(tmp_path, two_posts(), layers)
    assert verdict.ok
    assert any("prints more than this model" in note for note in verdict.notes)
    with pytest.raises(InputError, match="only of skirts and supports"):
        judged(tmp_path, two_posts(), [[";TYPE:Skirt" if line.startswith(";TYPE") else line for line in layers[0]]])


def test_our_own_gcode_of_a_corrected_part_leaves_out_nothing(tmp_path):
    """A fin that is thickened has its bead in every layer, in the middle of the bed."""
    part, gcode = write_stl(tmp_path / "part.stl", fin_part()), tmp_path / "part.gcode"
    fix(part, gcode, options_of(load_printer("ender-3-0.4"), {}))
    verdict = check_gcode(part, gcode, NOTHING)
    assert (verdict.ok, verdict.dropped, verdict.missing) == (True, 0, 0), verdict.lost[:2]


def test_the_command_ends_with_1_only_when_it_is_strict(tmp_path):
    """And refuses options that have nothing to do with it."""
    part, gcode = write_stl(tmp_path / "part.stl", two_posts()), tmp_path / "a.gcode"
    gcode.write_text("\n".join(["M83", *lines((0, 0, 2, 2), top=0.2)]) + "\n")
    done = run_layerfix("check", part, "--gcode", gcode)
    assert (done.code, "parts dropped" in done.out) == (0, True), done.err
    assert run_layerfix("check", part, "--gcode", gcode, "--strict").code == 1
    wrong = run_layerfix("check", part, "--strict")
    assert (wrong.code, "--strict goes with --gcode" in wrong.err) == (2, True)


# by the real slicer --------------------------------------------------------------------------------------------


def export(project: Path, target: Path, *own: str) -> subprocess.CompletedProcess[str]:
    """PrusaSlicer with the script as its post-processing."""
    script = " ".join([sys.executable, str(SCRIPT), *own])
    command = [
        "prusa-slicer",
        "--loglevel",
        "1",
        "-g",
        "--dont-arrange",
        "--post-process",
        script,
        "-o",
        target,
        project,
    ]
    env = environment(LAYERFIX=f"{sys.executable} -m layerfix")
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=120)


@slicer
def test_prusa_slicer_runs_the_script(tmp_path):
    """The dropped fin stands in the report beside the G-code; only --strict fails the export; corrected it passes."""
    project = prusa_project(tmp_path / "fins.3mf")
    done = export(project, tmp_path / "fins_0.2mm.gcode")
    assert done.returncode == 0, done.stderr
    report = (tmp_path / "fins_0.2mm.layerfix.txt").read_text(encoding="utf-8")
    assert report.startswith("fins_0.2mm.gcode of fins.3mf")
    assert "30 parts dropped, in 30 layers" in report
    assert f"x {100 + FIN_AT[0]:.2f} to {100 + FIN_AT[1]:.2f}" in report
    before = (tmp_path / "fins_0.2mm.gcode").read_text(encoding="utf-8")
    strict = export(project, tmp_path / "strict.gcode", "--strict", "--model", str(project))
    assert strict.returncode != 0
    assert "dropped" in strict.stderr + strict.stdout
    fixed = tmp_path / "fixed.3mf"
    fix_options = options_of(load_printer("prusa-mk3s-0.4"), {"layer_mm": 0.2})
    from layerfix.commands.project import fix_file

    fix_file(project, fixed, fix_options)
    good = export(fixed, tmp_path / "fixed.gcode", "--strict")
    assert good.returncode == 0, good.stderr + (tmp_path / "fixed.layerfix.txt").read_text(encoding="utf-8")
    assert "every part of every layer is printed" in (tmp_path / "fixed.layerfix.txt").read_text(encoding="utf-8")
    assert "External perimeter" in before
    assert PRINT["nozzle_diameter"] == "0.4"


def test_the_script_says_what_it_lacks(tmp_path):
    """A model that is not there, a command that is not there: reported, and fatal only with --strict."""
    gcode = tmp_path / "alone.gcode"
    gcode.write_text("G1 X1")
    env = environment(LAYERFIX="no-such-command", SLIC3R_PP_OUTPUT_NAME=str(gcode))
    for own, code, why in (
        ([], 0, "no model beside alone.gcode"), (["--strict"], 1, "no model"),
        (["--strict", "--model", str(gcode)], 1, "not on PATH"),
    ):  # fmt: skip
        done = subprocess.run(
            [sys.executable, SCRIPT, *own, gcode], env=env, capture_output=True, text=True, check=False
        )
        assert (done.returncode, why in done.stderr) == (code, True)
        assert why in (tmp_path / "alone.layerfix.txt").read_text(encoding="utf-8")
    assert gcode.read_text() == "G1 X1"


def test_a_project_is_not_confused_by_other_files(tmp_path):
    """The model is the one with the longest name that the G-code's begins with."""
    sys.path.insert(0, str(SCRIPT.parent))
    try:
        from layerfix_check import model_of
    finally:
        sys.path.remove(str(SCRIPT.parent))
    for name in ("part.stl", "part_long.3mf", "part_long.stl", "other.3mf"):
        write_zip(tmp_path / name, {"a": b""})
    assert model_of(tmp_path / "part_long_0.2mm.gcode") == tmp_path / "part_long.3mf"
    assert model_of(tmp_path / "part_0.2mm.gcode") == tmp_path / "part.stl"
    assert model_of(tmp_path / "none.gcode") is None
    assert entries_of(tmp_path / "part.stl") == {"a": b""}
    assert os.path.exists(tmp_path)
