"""The Cura extension without Cura: geometry, the command it runs, the package. `plugin/cura/trial` runs it in one."""

from __future__ import annotations

import importlib.util
import json
import stat
import sys
import time
import types
import zipfile
from pathlib import Path

import numpy as np
import pytest

import layerfix as lf
from layerfix.printers import load_printer
from tests.making import box, joined, run_layerfix, write_stl

PLUGIN = Path(__file__).parents[1] / "plugin"


def loaded(name: str) -> types.ModuleType:
    spec = importlib.util.spec_from_file_location(f"cura_{name}", PLUGIN / "cura" / "Layerfix" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


command, frames = loaded("command"), loaded("frames")
SETTINGS = {
    "maker": 'Cre"ality', "model": "Ender-3", "width": 220, "depth": 220, "height": 250, "layer": 0.2,
    "first_layer": 0.24, "nozzle": 0.4, "filament": 1.75, "line": 0.4,
    "first_line": 0.44, "feature": 0.8, "pixel": 0.05,
    "speeds": {"travel_mm_s": 150.0, "infill_mm_s": 50, "first_layer_mm_s": 0.0},
}  # fmt: skip


def program(path: Path, body: str) -> str:
    path.write_text(f"#!{sys.executable}\n{body}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_axes_go_there_and_back():
    """What is up in Cura is up in the print, triangles keep their sense, and a node that is turned, scaled and moved
    gets back the corners it had."""
    assert frames.to_print([[1, 2, 3]]).tolist() == [[1, -3, 2]]
    rng = np.random.default_rng(3)
    points = rng.normal(size=(30, 3))
    assert np.allclose(frames.from_print(frames.to_print(points)), points)
    a, b, c = np.eye(3)
    assert np.linalg.det(frames.to_print(np.array([a, b, c]))) == pytest.approx(1)
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    world = np.eye(4)
    world[:3, :3] = 1.7 * turned
    world[:3, 3] = 5, -3, 20
    placed = (np.column_stack([points, np.ones(30)]) @ world.T)[:, :3]
    corners = frames.corners(frames.to_print(placed), np.arange(30).reshape(-1, 3))
    assert np.allclose(frames.local_points(corners, world), points, atol=1e-5)
    assert np.array_equal(frames.corners(points, None), points.reshape(-1, 3, 3))


def test_stl_is_what_layerfix_reads(tmp_path):
    """Written here, read by layerfix, and the other way round; what is cut short is refused."""
    mesh = joined(box((0, 0, 0), (4, 5, 6)))
    frames.write_stl(tmp_path / "a.stl", mesh.vertices[mesh.faces])
    assert lf.load_mesh(tmp_path / "a.stl").volume_mm3 == pytest.approx(120)
    write_stl(tmp_path / "b.stl", mesh)
    assert np.allclose(frames.read_stl(tmp_path / "b.stl"), mesh.vertices[mesh.faces])
    (tmp_path / "c.stl").write_bytes((tmp_path / "b.stl").read_bytes()[:-1])
    with pytest.raises(ValueError, match="cut short"):
        frames.read_stl(tmp_path / "c.stl")


def test_cura_settings_are_a_printer(tmp_path):
    """With them `fix` and `widths` work; a speed of 0 is left out, quotes in names survive."""
    (tmp_path / "cura.toml").write_text(command.printer_file(SETTINGS), encoding="utf-8")
    printer = load_printer(tmp_path / "cura.toml")
    assert (printer.maker, printer.nozzle_mm, printer.first_layer_mm, printer.min_feature_mm) == (
        'Cre"ality', 0.4, 0.24, 0.8,
    )  # fmt: skip
    part = write_stl(tmp_path / "part.stl", joined(box((0, 0, 0), (8, 6, 2)), box((2, 1, 2), (2.2, 5, 5))))
    arguments = command.fix_arguments(
        "layerfix", str(part), str(tmp_path / "fixed.stl"), str(tmp_path / "cura.toml"), 0.8, 0.88, False
    )
    run = run_layerfix(*arguments[1:])
    assert run.code == 0, run.err
    summary = json.loads(run.out)
    assert "layers corrected, the thinnest wall was 0.2 mm" in command.told_of_fix("part", summary)
    assert summary["added_mm3"] > 3
    widths = json.loads(run_layerfix("widths", part, "-p", tmp_path / "cura.toml", "--json").out)
    assert "z 0.00 to" in command.told_of_widths("part", widths)
    assert "too thin" in command.told_of_widths("part", widths)
    assert command.fix_arguments("layerfix", "a", "b", "c", 0.8, 0.8, True)[-2:] == ["--axes", "xyz"]
    nothing = {**summary, "added_mm3": 0.0}
    assert command.told_of_fix("part", nothing) == "part: nothing is thinner than 0.8 mm."


def test_the_command_is_found_and_asked_for_its_version(tmp_path, monkeypatch):
    """Each way in which it can be missing says what to do."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(command.Missing, match="pip install layerfix"):
        command.find("")
    with pytest.raises(command.Missing, match="'/no/such' is no program"):
        command.find("/no/such")
    own = program(tmp_path / "layerfix", "print('layerfix, version 0.1.7')")
    assert command.find(" ") == own
    command.check_version(own)
    for body, said in (
        ("print('layerfix, version 2.3.0')", r"layerfix 2\.3, and this plugin goes with 0\.1"),
        ("print('hello')", "is not layerfix"),
    ):
        with pytest.raises(command.Missing, match=said):
            command.check_version(program(tmp_path / "other", body))
    monkeypatch.undo()
    real = Path(sys.executable).with_name("layerfix")
    if real.exists():
        command.check_version(str(real))  # this checkout's version goes with the plugin's


def test_progress_and_refusal_come_through(tmp_path):
    """Percents as they come; the command's own words when it refuses."""
    body = """
import sys, time
for k in (0, 40, 100):
    print(f"layerfix: {k} %", file=sys.stderr, flush=True)
    time.sleep(0.3)
print('{"answer": 42}')
"""
    seen = []
    found = command.run([program(tmp_path / "a", body)], seen.append, lambda: False)
    assert found == {"answer": 42}
    assert {0, 40, 100} <= set(seen)
    assert [s for s in seen if s is not None] == sorted(s for s in seen if s is not None)
    refuses = program(tmp_path / "b", "import sys\nsys.exit('layerfix: part.stl: has no triangles')")
    with pytest.raises(command.Failed, match=r"part\.stl: has no triangles"):
        command.run([refuses], seen.append, lambda: False)
    with pytest.raises(command.Failed, match="does not run"):
        command.run([str(tmp_path / "nothing")], seen.append, lambda: False)


def test_cancel_ends_the_process(tmp_path):
    """Within a moment, and nothing of it goes on."""
    mark = tmp_path / "alive"
    body = f"""
import pathlib, time
for k in range(300):
    pathlib.Path({str(mark)!r}).write_text(str(k))
    time.sleep(0.1)
"""
    began = time.monotonic()
    with pytest.raises(command.Cancelled):
        command.run([program(tmp_path / "slow", body)], lambda share: None, mark.exists)
    assert time.monotonic() - began < 20
    last = mark.read_text()
    time.sleep(0.4)
    assert mark.read_text() == last


def test_the_real_command_tells_its_progress(tmp_path):
    """LAYERFIX_PROGRESS=lines: whole percents up to 100, in a pipe that is quiet otherwise."""
    part = write_stl(tmp_path / "part.stl", joined(box((0, 0, 0), (8, 6, 2)), box((2, 1, 2), (2.2, 5, 5))))
    how = ("--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.8mm")
    run = run_layerfix("fix", part, tmp_path / "a.zip", *how, env={"LAYERFIX_PROGRESS": "lines"})
    assert run.code == 0
    lines = run.err.splitlines()
    assert lines[-1] == "layerfix: 100 %"
    assert all(line.startswith("layerfix: ") and line.endswith(" %") for line in lines)
    assert run_layerfix("fix", part, tmp_path / "b.zip", *how).err == ""


def test_the_package_is_as_cura_installs_it(tmp_path):
    """package.json and the plugin's folder, the same bytes each time; Python 3.5 understands all of it."""
    sys.path.insert(0, str(PLUGIN))
    try:
        import build
    finally:
        sys.path.remove(str(PLUGIN))
    for name in ("a", "b"):
        build.cura(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    with zipfile.ZipFile(tmp_path / "a") as package:
        about = json.loads(package.read("package.json"))
        inside = "files/plugins/Layerfix/"
        plugin = json.loads(package.read(inside + "plugin.json"))
        assert about["package_version"] == plugin["version"] == lf.__version__
        files = "__init__.py", "extension.py", "command.py", "frames.py", "dialog.qml", "plugin.json", "LICENSE"
        assert {inside + name for name in files} | {"package.json"} == set(package.namelist())
        for name in package.namelist():
            if name.endswith(".py"):
                text = package.read(name).decode()
                assert "import layerfix" not in text
                compile(text, name, "exec", flags=0, dont_inherit=True)
                import ast

                tree = ast.parse(text, feature_version=(3, 5))
                assert not any(isinstance(node, ast.JoinedStr) for node in ast.walk(tree)), name
