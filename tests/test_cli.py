"""The command line as its users meet it: real processes, files, pipes and a terminal."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import layerfix
from layerfix import correct, load_mesh, load_printer, read, slice_mesh
from layerfix.commands.summary import Summary
from layerfix.formats.table import FORMATS
from layerfix.printers import printer_names
from tests.making import (
    Run,
    box,
    chosen_faces,
    contents,
    environment,
    inside_out,
    joined,
    run_layerfix,
    start_layerfix,
    thin_part,
    write_stl,
)

COMMANDS = ["fix", "demo", "printers", "completion"]
FIX = ("--pixel", "50um", "--layer", "0.1mm", "--min-feature", "0.4mm")


@pytest.fixture
def part(tmp_path) -> Path:
    return write_stl(tmp_path / "part.stl", thin_part())


def succeeds(done: Run) -> str:
    """Exit code 0 and nothing on stderr, which in a pipe is all there should be; gives stdout."""
    assert done.err == ""
    assert done.code == 0
    return done.out


def images(path: Path) -> np.ndarray:
    return np.array([layer.image() for layer in read(path)])


def rows_of(table: str) -> dict[str, str]:
    """The printed table by its first words."""
    return {line[:10].strip(): line[10:] for line in table.strip().splitlines()}


# fix ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", ["out", "out.zip"])
def test_a_mesh_into_layers(tmp_path, part, target):
    """The files hold what the library gives for the same numbers; the mesh is untouched, and nothing else is made."""
    before = part.read_bytes()
    succeeds(run_layerfix("fix", part, tmp_path / target, *FIX))
    stack = slice_mesh(load_mesh(part), pixel_mm=0.05, layer_mm=0.1, margin_mm=0.4)
    expected = correct(stack, min_feature_mm=0.4)
    assert np.array_equal(images(tmp_path / target), np.array([layer.image() for layer in expected]))
    assert read(tmp_path / target).origin_mm == stack.origin_mm
    assert part.read_bytes() == before
    assert set(os.listdir(tmp_path)) == {"part.stl", target}


def test_layers_into_layers(tmp_path, part):
    """A zip or folder of images is corrected with its own pitch and heights, no other option needed."""
    stack = slice_mesh(load_mesh(part), pixel_mm=0.05, layer_mm=0.1, margin_mm=0.4)
    layerfix.write(tmp_path / "sliced.zip", stack)
    layerfix.write(tmp_path / "sliced", stack)
    succeeds(run_layerfix("fix", part, tmp_path / "direct.zip", *FIX))
    for source, target in (("sliced.zip", "from_zip.zip"), ("sliced", "folder")):
        succeeds(run_layerfix("fix", tmp_path / source, tmp_path / target, "--min-feature", "0.4mm"))
        assert np.array_equal(images(tmp_path / target), images(tmp_path / "direct.zip"))
    assert (tmp_path / "from_zip.zip").read_bytes() == (tmp_path / "direct.zip").read_bytes()


def test_a_printer_gives_the_numbers(tmp_path, part):
    """Pitch, layer height, panel, minimum feature and mode come from the printer; options go before it."""
    printer = load_printer("prusa-sl1s")
    done = json.loads(succeeds(run_layerfix("fix", part, tmp_path / "a.zip", "-p", "prusa-sl1s", "--json")))
    assert done["size_px"] == list(printer.pixels)
    assert done["pixel_mm"] == list(printer.pixel_mm)
    assert (done["mode"], done["min_feature_mm"]) == ("add_only", printer.min_feature_mm)
    assert done["layers"] == round(2 / printer.layer_mm)
    assert done["removed_mm3"] == 0
    done = json.loads(
        succeeds(run_layerfix("fix", part, tmp_path / "b.zip", "-p", "prusa-sl1s", "--json", "--layer", "0.1mm",
                              "--mode", "as_printed", "--min-feature", "300um", "--pixel", "47umx0.05mm"))
    )  # fmt: skip
    assert (done["layers"], done["mode"], done["min_feature_mm"]) == (20, "as_printed", 0.3)
    assert done["pixel_mm"] == [0.047, 0.05]
    assert done["size_px"][0] < 500


def test_the_first_layer_of_a_printer_and_of_an_option(tmp_path, part):
    """z in the written layers: the printer's first layer, or the one asked for."""
    succeeds(run_layerfix("fix", part, tmp_path / "a.zip", "-p", "prusa-mk3s-0.4"))
    assert read(tmp_path / "a.zip").z_mm[:2].tolist() == [[0, 0.2], [0.2, 0.35]]
    succeeds(run_layerfix("fix", part, tmp_path / "b.zip", *FIX, "--first-layer", "0.25mm"))
    assert read(tmp_path / "b.zip").z_mm[:2].tolist() == [[0, 0.25], [0.25, 0.35]]


def test_a_printers_own_file(tmp_path, part):
    """-p takes a .toml of one's own."""
    text = (Path(__file__).parents[1] / "sample_printers" / "prusa-sl1s.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace("min_feature_mm = 0.2", "min_feature_mm = 0.35"))
    done = run_layerfix("fix", "part.stl", "out", "-p", "mine.toml", "--json", cwd=tmp_path)
    assert json.loads(succeeds(done))["min_feature_mm"] == 0.35


def test_the_options_reach_the_work(tmp_path):
    """--unit, --fill, --bits, --mode each change what they say."""
    shells = Path(write_stl(tmp_path / "m.stl", box([0, 0, 0], [0.006, 0.004, 0.002])))
    done = json.loads(succeeds(run_layerfix("fix", shells, tmp_path / "m", *FIX, "--unit", "m", "--json")))
    assert done["volume_mm3"] == pytest.approx(48, rel=0.001)
    inverted = write_stl(tmp_path / "i.stl", joined(box([0, 0, 0], [6, 4, 2]), inside_out(box([8, 0, 0], [9, 4, 2]))))
    volumes = {}
    for fill in ("nonzero", "positive"):
        done = run_layerfix("fix", inverted, tmp_path / fill, *FIX, "--fill", fill, "--bits", "1", "--json")
        volumes[fill] = json.loads(succeeds(done))["volume_mm3"]
        with Image.open(tmp_path / fill / "00000.png") as image:
            assert image.mode == "1"
    assert volumes == pytest.approx({"nonzero": 56, "positive": 48})


def test_the_json_is_the_summary(tmp_path, part):
    """One line of JSON with every field of the library's Summary, its numbers consistent."""
    out = succeeds(run_layerfix("fix", part, tmp_path / "out.zip", *FIX, "--json"))
    assert out.count("\n") == 1
    done = json.loads(out)
    assert set(done) >= {field.name for field in fields(Summary)}
    assert (done["source"], done["target"]) == (str(part), str(tmp_path / "out.zip"))
    assert (done["layers"], done["mode"], done["layers_with_gaps"]) == (20, "as_printed", 0)
    assert 0 < done["layers_changed"] <= 20
    assert done["volume_mm3"] == pytest.approx(12 + 1.5 * 0.1 * 3, rel=0.02)
    assert done["thinnest_mm"] == pytest.approx(0.1, abs=0.051)
    assert done["added_percent"] == pytest.approx(100 * done["added_mm3"] / done["volume_mm3"])
    after = read(tmp_path / "out.zip").volume_mm3()
    assert after == pytest.approx(done["volume_mm3"] + done["added_mm3"] - done["removed_mm3"])
    assert done["seconds"] > 0


def test_the_table(tmp_path, part):
    """A few lines: how many layers, what changed, the thinnest place and where, what was added, where it went."""
    table = rows_of(succeeds(run_layerfix("fix", part, tmp_path / "out.zip", *FIX)))
    assert list(table) == ["layers", "changed", "thinnest", "added", "removed", "time", "written"]
    assert (
        table["layers"]
        == f"20 of {images(tmp_path / 'out.zip').shape[2]} × {images(tmp_path / 'out.zip').shape[1]} px"
    )
    assert table["changed"].endswith("(as_printed, minimum feature 0.4 mm)")
    assert re.fullmatch(r"[\d.]+ (µm|mm) \(± [\d.]+ (µm|mm)\) at z = \d\.\d{3} mm", table["thinnest"])
    assert re.fullmatch(r"[\d.]+ mm³ \([\d.]+ %\)", table["added"])
    assert re.fullmatch(r"\d+\.\d\d s", table["time"])
    assert table["written"] == str(tmp_path / "out.zip")


def test_the_table_when_nothing_is_too_thin(tmp_path):
    """It says so instead of a width."""
    thick = write_stl(tmp_path / "thick.stl", box([0, 0, 0], [9, 9, 1]))
    table = rows_of(succeeds(run_layerfix("fix", thick, tmp_path / "out", *FIX, "--mode", "add_only")))
    assert table["thinnest"] == "nothing was too thin"
    assert table["added"] == "0 mm³ (0 %)"
    assert table["changed"].startswith("0 ")


def test_the_table_tells_of_an_open_mesh(tmp_path):
    """A row more: in how many layers gaps were closed, and the longest."""
    mesh = box([0, 0, 0], [6, 4, 2])
    side = mesh.vertices[mesh.faces][:, :, 0].min(axis=1) == 6
    part = write_stl(tmp_path / "open.stl", chosen_faces(mesh, ~side))
    table = rows_of(succeeds(run_layerfix("fix", part, tmp_path / "out", *FIX)))
    assert table["open mesh"] == "gaps closed in 20 layers, the longest 4 mm"


@pytest.mark.parametrize("target", ["out", "out.zip"])
def test_force_replaces(tmp_path, part, target):
    """With --force an existing output is replaced whole, as if it had not been there."""
    layerfix.write(tmp_path / target, slice_mesh(thin_part(), pixel_mm=0.05, layer_mm=0.05))
    succeeds(run_layerfix("fix", part, tmp_path / target, *FIX, "--layer", "0.2mm", "--force"))
    assert len(read(tmp_path / target)) == 10
    assert set(os.listdir(tmp_path)) == {"part.stl", target}


def test_the_bytes_do_not_depend_on_the_workers(tmp_path, part):
    """One thread, two, eight: zips equal to the byte, and the same summary."""
    summaries = []
    for workers in (1, 2, 8):
        done = run_layerfix("fix", part, f"{workers}.zip", *FIX, "--workers", workers, "--json", cwd=tmp_path)
        summaries.append({k: v for k, v in json.loads(succeeds(done)).items() if k not in ("seconds", "target")})
    assert len({(tmp_path / f"{w}.zip").read_bytes() for w in (1, 2, 8)}) == 1
    assert summaries[0] == summaries[1] == summaries[2]


def test_a_picture_of_the_most_changed_layer(tmp_path, part):
    """--picture draws a PNG with grey for what was kept and red for what was added."""
    succeeds(run_layerfix("fix", part, tmp_path / "out", *FIX, "--picture", tmp_path / "look.png"))
    with Image.open(tmp_path / "look.png") as picture:
        assert picture.format == "PNG"
        colours = {colour for _, colour in picture.convert("RGB").getcolors(1 << 24)}
    assert {(172, 178, 186), (214, 39, 40)} <= colours


@pytest.mark.parametrize("picture", ["part.stl", "out.zip"])
def test_a_picture_never_takes_the_place_of_the_input_or_the_output(tmp_path, part, picture):
    """Not even by force: the mesh is irreplaceable, and the layers are what was asked for."""
    before = part.read_bytes()
    done = run_layerfix("fix", part, "out.zip", *FIX, "--picture", picture, "--force", cwd=tmp_path)
    assert part.read_bytes() == before
    if done.code == 0:
        assert zipfile.is_zipfile(tmp_path / "out.zip")
    else:
        assert (done.code, len(done.err.splitlines())) == (2, 1)
        assert set(os.listdir(tmp_path)) == {"part.stl"}


def test_an_existing_picture_needs_force_before_any_work(tmp_path, part):
    """It is found out at once, not after the layers are written."""
    (tmp_path / "look.png").write_text("mine")
    done = run_layerfix("fix", part, tmp_path / "out", *FIX, "--picture", tmp_path / "look.png")
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "look.png: exists already" in done.err
    assert (tmp_path / "look.png").read_text() == "mine"
    assert not (tmp_path / "out").exists()


def test_names_with_spaces_and_accents(tmp_path):
    """Paths of any language and with blanks, relative ones too."""
    write_stl(tmp_path / "mein tëil №1.stl", thin_part())
    out = succeeds(run_layerfix("fix", "mein tëil №1.stl", "schichten ü.zip", *FIX, cwd=tmp_path))
    assert rows_of(out)["written"] == "schichten ü.zip"
    assert len(read(tmp_path / "schichten ü.zip")) == 20


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_a_terminal_that_knows_few_letters(tmp_path, part, encoding):
    """× and µ and ³ must not end a run with a traceback where they cannot be shown."""
    done = subprocess.run(
        [sys.executable, "-m", "layerfix", "fix", str(part), str(tmp_path / "out"), *FIX],
        env=environment(PYTHONIOENCODING=encoding), capture_output=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0
    assert done.stderr == b""
    assert (tmp_path / "out").is_dir()


def test_a_reader_that_goes_away_is_no_traceback(part, tmp_path):
    """`layerfix fix … | true`: the layers are written, and nobody is told about the closed pipe."""
    line = f'"{sys.executable}" -m layerfix fix "{part}" "{tmp_path / "out"}" {" ".join(FIX)} | true'
    done = subprocess.run(
        ["bash", "-c", line], env=environment(), capture_output=True, text=True, timeout=60, check=False
    )
    assert "Traceback" not in done.stderr
    assert len(read(tmp_path / "out")) == 20


# On a terminal --------------------------------------------------------------------------------------------


def on_a_terminal(*args: object, wait_for: Callable[[str], bool] = lambda text: False) -> tuple[int, str]:
    """Run with a pseudo-terminal as stdin, stdout and stderr: (exit code, everything shown)."""
    import fcntl
    import pty
    import struct
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    env = {**environment(), "TERM": "xterm-256color"}
    env.pop("NO_COLOR")
    process = subprocess.Popen(
        [sys.executable, "-m", "layerfix", *map(str, args)], stdin=theirs, stdout=theirs, stderr=theirs, env=env
    )
    os.close(theirs)
    shown = b""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            piece = os.read(ours, 65536)
        except OSError:
            break
        if not piece:
            break
        shown += piece
    os.close(ours)
    return process.wait(30), shown.decode()


def test_a_bar_shows_on_a_terminal(tmp_path):
    """What is done, of how many, in a bar that is taken away at the end; then the table."""
    from layerfix.samples import sample

    part = write_stl(tmp_path / "part.stl", sample("test-part").mesh())
    code, shown = on_a_terminal(
        "fix", part, tmp_path / "out", "--pixel", "25um", "--layer", "0.1mm", "--min-feature", "0.8mm"
    )
    assert code == 0
    assert "correcting part.stl" in shown
    assert "━" in shown
    assert re.search(r"\d+/65", shown)
    assert "\x1b[?25h" in shown  # the cursor is back
    assert "written" in shown.split("\x1b[?25h")[-1]


def test_an_error_on_a_terminal_is_one_line(tmp_path):
    """A bar that was begun is taken away before it."""
    code, shown = on_a_terminal("fix", tmp_path / "none.stl", tmp_path / "out")
    assert code == 2
    assert "Traceback" not in shown
    last = shown.strip().splitlines()[-1]
    assert last.endswith(f"layerfix: {tmp_path / 'none.stl'}: no such file or folder")
    assert "\x1b[2K" in last or "correcting" not in shown  # erased


# The other commands ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("flag", ["-h", "--help"])
@pytest.mark.parametrize("command", [[], *([c] for c in COMMANDS)], ids=lambda c: " ".join(c) or "layerfix")
def test_help(command, flag):
    """Each command explains itself, on stdout, within the width of a terminal."""
    out = succeeds(run_layerfix(*command, flag))
    assert out.startswith(f"Usage: layerfix {' '.join(command)}".strip())
    assert max(map(len, out.splitlines())) <= 100


def test_the_help_names_the_programs_it_works_within():
    """Those of the table in plugin/README.md, by the first name in each row."""
    out = " ".join(succeeds(run_layerfix("--help")).split())
    table = (Path(__file__).parents[1] / "plugin" / "README.md").read_text(encoding="utf-8")
    hosts = [
        re.split(r"[],|]| and ", row.lstrip("|[ "))[0].strip() for row in table.splitlines() if row.startswith("| ")
    ]
    assert len(hosts) > 8
    assert [host for host in hosts[1:] if host not in out] == []


def test_the_help_of_fix_names_every_option_and_format():
    """Options, defaults, the formats in and out, and examples that can be copied."""
    out = succeeds(run_layerfix("fix", "--help"))
    options = "printer pixel layer first-layer min-feature mode fill unit bits picture workers force json"
    formats = [
        suffix for row in FORMATS if row.layers or row.mesh or "layers" in row.writers for suffix in row.suffixes
    ]
    for word in [*(f"--{option}" for option in options.split()), *formats, "layerfix fix part"]:
        assert word in out


def test_without_a_command_the_help_shows():
    """`layerfix` alone says what it is and where to start."""
    done = run_layerfix()
    assert done.code in (0, 2)
    assert "layerfix demo" in done.out + done.err


def test_the_version():
    """The package's, in one line."""
    assert succeeds(run_layerfix("--version")) == f"layerfix, version {layerfix.__version__}\n"


@pytest.mark.parametrize(
    ("args", "word"),
    [(["fxi"], "fxi"), (["fix"], "IN"), (["fix", "a.stl"], "OUT"), (["fix", "a", "b", "c"], "c"),
     (["fix", "a.stl", "b", "--pixl", "50um"], "--pixl"), (["completion", "tcsh"], "tcsh"),
     (["printers", "--process", "laser"], "laser"), (["fix", "a.stl", "b", "--mode", "odd"], "odd")],
)  # fmt: skip
def test_a_wrong_command_line(tmp_path, args, word):
    """Exit code 2, the word at fault in the last line, no traceback."""
    done = run_layerfix(*args, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert word in done.err.strip().splitlines()[-1]
    assert "Traceback" not in done.err


def test_the_printers():
    """Every shipped printer in a line of its own; --process picks some; --json gives their values."""
    out = succeeds(run_layerfix("printers"))
    assert [line.split()[0] for line in out.splitlines()] == list(printer_names())
    resin = json.loads(succeeds(run_layerfix("printers", "--process", "resin", "--json")))
    assert {p["name"] for p in resin} == {n for n in printer_names() if load_printer(n).process == "resin"}
    assert all(p["pixels"] for p in resin)
    assert succeeds(run_layerfix("printers", "--process", "powder", "--json")) == "[]\n"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_scripts(shell):
    """Each shell gets a script that it can parse, if it is here to try."""
    out = succeeds(run_layerfix("completion", shell))
    assert "_LAYERFIX_COMPLETE" in out
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=out, text=True, check=True, timeout=30)


def test_completion_completes():
    """What the bash script asks for is answered with the commands and options that fit."""
    env = {"_LAYERFIX_COMPLETE": "bash_complete", "COMP_WORDS": "layerfix fix --mi", "COMP_CWORD": "2"}
    assert run_layerfix(env=env).out == "plain,--min-feature\nplain,--min-layers\nplain,--min-overlap\n"
    env |= {"COMP_WORDS": "layerfix pr", "COMP_CWORD": "1"}
    assert run_layerfix(env=env).out == "plain,printers\n"


def test_the_demo(tmp_path):
    """The part, its layers before and after, a picture and where to look; a second run needs --force, which
    replaces what the demo wrote and nothing else.
    """
    out = succeeds(run_layerfix("demo", "look", cwd=tmp_path))
    for name in ("look/test_part.stl", "look/before", "look/after", "look/before_after.png"):
        assert str(Path(name)) in out
    assert set(os.listdir(tmp_path / "look")) == {"test_part.stl", "before", "after", "before_after.png"}
    before, after = read(tmp_path / "look" / "before"), read(tmp_path / "look" / "after")
    assert (before.width, before.height, before.origin_mm) == (after.width, after.height, after.origin_mm)
    assert (len(before), before.pixel_mm) == (len(after), after.pixel_mm)
    assert any(not np.array_equal(a.rows, b.rows) for a, b in zip(before, after, strict=True))
    with Image.open(tmp_path / "look" / "before_after.png") as picture:
        picture.load()
        assert picture.size[0] > 1000
    first = contents(tmp_path)
    again = run_layerfix("demo", "look", cwd=tmp_path)
    assert (again.code, again.out) == (2, "")
    assert again.err == "layerfix: look: exists already and is not empty; use --force to replace it\n"
    assert contents(tmp_path) == first
    (tmp_path / "look" / "notes.txt").write_text("mine")
    refused = run_layerfix("demo", "look", "--force", cwd=tmp_path)
    assert (refused.code, refused.out) == (2, "")
    assert "notes.txt" in refused.err
    (tmp_path / "look" / "notes.txt").unlink()
    done = json.loads(succeeds(run_layerfix("demo", "look", "--force", "--json", cwd=tmp_path)))
    assert done["layers"] == len(after)
    assert contents(tmp_path) == first


def test_the_demo_goes_to_a_folder_of_its_own(tmp_path):
    """Without a name it is layerfix-demo, here; a file of that name is in the way and stays."""
    (tmp_path / "layerfix-demo").write_text("mine")
    done = run_layerfix("demo", "--force", cwd=tmp_path)
    assert (done.code, done.err) == (2, "layerfix: layerfix-demo: is a file; a folder is to be written there\n")
    (tmp_path / "layerfix-demo").unlink()
    done = run_layerfix("demo", "none/look", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "there is no folder" in done.err
    succeeds(run_layerfix("demo", cwd=tmp_path))
    assert os.listdir(tmp_path) == ["layerfix-demo"]


def test_the_commands_import_nothing_heavy():
    """cli/ may import numpy, numba, cv2 and the like only inside its functions: --help must be quick."""
    names: set[str | None] = set()
    for path in (Path(layerfix.__file__).parent / "cli").glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names |= {alias.name for node in tree.body if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
    assert "layerfix.cli.shared" in names
    assert not names & {
        "numpy",
        "numba",
        "cv2",
        "trimesh",
        "layerfix.commands.fix",
        "layerfix.mesh.slicing",
        "layerfix.stack",
    }


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("args", [("printers",), ("printers", "--json"), ("--help",)])
def test_a_full_disk_behind_the_output_is_said_in_one_line(args):
    """No traceback, exit code 2."""
    with Path("/dev/full").open("w") as full:
        process = start_layerfix(*args, stdout=full)
        _, error = process.communicate(timeout=60)
    assert process.returncode == 2
    assert error.splitlines() == ["layerfix: the output could not be printed: no space left on device"]


def test_specks_and_the_first_layer(tmp_path):
    """What is told and drawn: a wider first layer, and specks that stay."""
    image = np.zeros((60, 90), np.uint8)
    image[20, 10:80] = image[40, 40] = 255
    folder = tmp_path / "in"
    folder.mkdir()
    for k in range(3):
        Image.fromarray(image).save(folder / f"{k}.png")
    options = ("--pixel", "0.1mm", "--layer", "0.1mm", "--min-feature", "0.4mm")
    more = ("--first-layer-min-feature", "0.9mm", "--ignore-below", "0.02mm2")
    table = rows_of(succeeds(run_layerfix("fix", folder, tmp_path / "out", *options, *more)))
    assert table["note"] == "specks left as they are in 3 layers, the first at z = 0.000 mm"
    written = images(tmp_path / "out") > 0
    assert written[:, :, 45].sum(axis=1).tolist() == [9, 4, 4]
    assert written[:, 30:, :].sum() == 3


@pytest.mark.parametrize("area", ["0.01", "0.01mm", "mm2", "-1mm2", "0mm2", "0.01kg2", "x"])
def test_an_area_has_a_unit(tmp_path, part, area):
    """Refused, with what to write."""
    run = run_layerfix("fix", part, tmp_path / "out.zip", *FIX, "--ignore-below", area)
    assert run.code == 2
    assert "is not an area: write a number and a unit, such as 0.01mm2" in run.err
