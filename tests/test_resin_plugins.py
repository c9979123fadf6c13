"""The scripts for resin hosts, run as the hosts run them: programs with arguments, in processes of their own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Pictures

from layerfix import LayerStack, load_printer, read, write
from layerfix.commands.fix import fix
from layerfix.commands.options import options_of
from layerfix.formats.png.encode import encode_grey_png
from tests.making import environment

PLUGINS = Path(__file__).parents[1] / "plugin"
COMMAND = f"{sys.executable} -m layerfix"


def layers() -> list[np.ndarray]:
    """(3, H, W) uint8: a wall of 2 px with a soft edge, a wide one, nothing."""
    thin, wide, empty = (np.zeros((80, 120), np.uint8) for _ in range(3))
    thin[10:60, 30:32] = 255
    thin[10:60, 32] = 120
    wide[10:60, 30:70] = 255
    wide[10:60, 70] = 77
    return [thin, wide, empty]


def run(command: list[object], cwd: Path, **env: str) -> subprocess.CompletedProcess[str]:
    """A program, from another folder than its own."""
    return subprocess.run(list(map(str, command)), cwd=cwd, env=environment(LAYERFIX=COMMAND, **env), text=True,
                          capture_output=True, check=False, timeout=120)  # fmt: skip


@pytest.fixture
def chitubox(tmp_path) -> tuple[list[Path], Path]:
    """(the program that the installed archive names, Chitubox's temporary folder)."""
    home, folder = tmp_path / "plug ins", tmp_path / "temp folder"
    home.mkdir()
    folder.mkdir()
    made = run([sys.executable, PLUGINS / "chitubox" / "make.py", home], tmp_path)
    assert made.returncode == 0, made.stderr
    with zipfile.ZipFile(home / "layerfix.CHplugin") as archive:
        archive.extractall(home)
        modes = {entry.filename: entry.external_attr >> 16 for entry in archive.infolist()}
    info = json.loads((home / "plugin.json").read_text())["info"]
    assert (info["type"], info["inputSuffix"]) == ("outputSlicer", "zip_raw_png")
    assert modes[info["linuxExecPath"].removeprefix("./")] & 0o111
    assert (home / info["winExecPath"]).is_file()
    for number, image in enumerate(layers(), 1):
        (folder / f"{number}.png").write_bytes(encode_grey_png(image))
    (folder / "preview.png").write_bytes(encode_grey_png(np.zeros((10, 20), np.uint8)))
    (folder / "run.gcode").write_text(
        ";layerHeight:0.05\n;machineX:6\n;machineY:4\n;resolutionX:120\n;resolutionY:80\n;machineType:ELEGOO Mars\n"
        ";totalLayer:3\n;volume:0.5\nG28\n"
    )
    return [Path(sys.executable), home / info["linuxExecPath"]], folder


def test_chitubox_finds_corrected_images_in_its_folder(chitubox, tmp_path):
    """The thin wall is as wide as options.txt says, greys are kept, and all else is to the byte as it was."""
    program, folder = chitubox
    (program[1].parent / "options.txt").write_text("# mine\n--min-feature 0.3mm\n")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    done = run([*program, folder, tmp_path / "my part.zip"], tmp_path)
    assert done.returncode == 0, done.stderr
    after = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert before.keys() == after.keys()
    assert {name for name in after if after[name] != before[name]} == {"1.png", "run.gcode"}  # its volume
    fixed = np.array(Pictures.open(folder / "1.png"))
    assert (fixed[30] >= 128).sum() == 6
    assert (fixed >= layers()[0]).all()
    assert "changed   1" in (tmp_path / "layerfix.log").read_text(encoding="utf-8")


def test_chitubox_keeps_its_images_when_something_fails(chitubox, tmp_path):
    """A word in the log, exit code 1, and every byte as it was."""
    program, folder = chitubox
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    for options, command, why in (
        ("--min-feature 1", COMMAND, "has no unit"), ("", "no-such-command", "not on PATH"),
    ):  # fmt: skip
        (program[1].parent / "options.txt").write_text(options)
        env = environment(LAYERFIX=command)
        done = subprocess.run([*program, folder, tmp_path / "a.zip"], env=env, capture_output=True, check=False)
        assert done.returncode == 1
        assert why in (tmp_path / "layerfix.log").read_text(encoding="utf-8")
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert run([*program, tmp_path], tmp_path).returncode == 1
    assert "no run.gcode" in (tmp_path / "layerfix.log").read_text(encoding="utf-8")


def test_chitubox_a_log_that_cannot_be_written_is_no_failure(chitubox, tmp_path):
    """The images are corrected; a line says that there is no log."""
    program, folder = chitubox
    (program[1].parent / "options.txt").write_text("--min-feature 0.3mm\n")
    before = (folder / "1.png").read_bytes()
    done = run([*program, folder, tmp_path / "nowhere" / "part.zip"], tmp_path)
    assert done.returncode == 0
    assert "the log could not be written" in done.stderr
    assert "Traceback" not in done.stderr
    assert (folder / "1.png").read_bytes() != before


def test_a_program_that_cannot_be_started_is_said_and_all_jobs_are_corrected(tmp_path):
    """LAYERFIX_THEN names none: one line for each, exit code 1."""
    image = np.zeros((2560, 1440), bool)
    image[100:200, 50:52] = True
    stack = LayerStack.from_images([image], pixel_mm=0.04725, layer_mm=0.05)
    jobs = [tmp_path / f"{name}.sl1" for name in "ab"]
    for job in jobs:
        write(job, stack, load_printer("prusa-sl1"))
    env = {"LAYERFIX_OPTIONS": "-p prusa-sl1", "LAYERFIX_THEN": str(tmp_path / "no such program")}
    done = run([sys.executable, PLUGINS / "dragonfruit" / "layerfix_send.py", *jobs], tmp_path, **env)
    assert done.returncode == 1
    assert done.stderr.count("LAYERFIX_THEN: ") == 2
    assert "Traceback" not in done.stderr
    assert all(job.with_name(f"{job.stem}_fixed.sl1").exists() for job in jobs)


def test_a_host_that_sends_its_job_gets_a_corrected_one(tmp_path):
    """Beside it, opened by the next program; what cannot be corrected is passed on as it was, with exit code 1."""
    job, broken, seen = tmp_path / "my job.sl1", tmp_path / "broken.sl1", tmp_path / "seen"
    image = np.zeros((2560, 1440), bool)
    image[100:200, 50:52] = True
    stack = LayerStack.from_images([image], pixel_mm=0.04725, layer_mm=0.05)
    write(job, stack, load_printer("prusa-sl1"))
    broken.write_bytes(b"PK")
    opener = tmp_path / "open.py"
    opener.write_text(f"import sys; open({str(seen)!r}, 'a').write(sys.argv[1] + '\\n')")
    env = {"LAYERFIX_OPTIONS": "-p prusa-sl1", "LAYERFIX_THEN": f"{sys.executable} {opener}"}
    done = run([sys.executable, PLUGINS / "dragonfruit" / "layerfix_send.py", job, broken], tmp_path, **env)
    assert done.returncode == 1
    fixed = tmp_path / "my job_fixed.sl1"
    assert read(fixed)[0].count_px() > read(job)[0].count_px()
    for _ in range(200):
        if seen.is_file() and len(seen.read_text().splitlines()) == 2:
            break
        subprocess.run([sys.executable, "-c", "import time; time.sleep(0.05)"], check=True)
    assert sorted(seen.read_text().splitlines()) == sorted([str(fixed), str(broken)])


# UVtools: its script in C#, against a stand-in of the calls that it makes -------------------------------------

PNG = """
import sys
import numpy as np
from PIL import Image
Image.fromarray(np.array(Image.open(sys.argv[1]))).save(sys.argv[2], "PNG" if sys.argv[2].endswith("png") else "PPM")
"""


@pytest.fixture(scope="module")
def uvtools(tmp_path_factory) -> list[object]:
    """The script, compiled together with the stand-in."""
    if not (shutil.which("mcs") and shutil.which("mono")):
        pytest.skip("no C# compiler (mono-mcs) here")
    folder = tmp_path_factory.mktemp("uvtools")
    target, stand_in = folder / "script.exe", Path(__file__).parent / "stand_ins" / "uvtools.cs"
    built = run(["mcs", "-warnaserror", f"-out:{target}", PLUGINS / "uvtools" / "layerfix.cs", stand_in], folder)
    assert built.returncode == 0, built.stdout + built.stderr
    (folder / "png.py").write_text(PNG)
    return ["mono", target]


def uvtools_run(program: list[object], folder: Path, feature_um: int) -> subprocess.CompletedProcess[str]:
    """Run it on the layers of a folder."""
    for number, image in enumerate(layers()):
        Pictures.fromarray(image).save(folder / f"{number}.pgm")
    env = {"PNG": f"{sys.executable}|{Path(str(program[1])).parent / 'png.py'}", "TMPDIR": str(folder / "tmp")}
    os.makedirs(folder / "tmp", exist_ok=True)
    return run([*program, folder, "0.05", "0.05", "0.05", feature_um], folder, **env)


def test_the_script_for_uvtools_sets_the_layers_that_changed(uvtools, tmp_path):
    """Those alone, as `layerfix fix` makes them, greys kept; its temporary folder is gone."""
    done = uvtools_run(uvtools, tmp_path, 300)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "set: 0.pgm"), done.stdout + done.stderr
    images = tmp_path / "images"
    images.mkdir()
    for number, image in enumerate(layers()):
        (images / f"{number:05}.png").write_bytes(encode_grey_png(image))
    options = {"min_feature_mm": 0.3, "mode": "add_only", "pixel_mm": (0.05, 0.05), "layer_mm": 0.05}
    fix(images, tmp_path / "fixed", options_of(None, options))
    for number in range(3):
        expected = np.array(Pictures.open(sorted((tmp_path / "fixed").glob("*.png"))[number]))
        assert np.array_equal(np.array(Pictures.open(tmp_path / f"{number}.pgm")), expected)
    assert list((tmp_path / "tmp").iterdir()) == []


def test_the_script_for_uvtools_says_what_is_wrong(uvtools, tmp_path):
    """A feature below the pixels, before anything is done; nothing is set."""
    done = uvtools_run(uvtools, tmp_path, 40)
    assert (done.returncode, done.stdout.startswith("invalid: The minimum feature")) == (3, True)
