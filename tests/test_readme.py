"""Every example of the README and of the pages beside it runs."""

import re
import shlex
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import layerfix as lf
from layerfix.cli import layerfix
from layerfix.formats.png.encode import encode_png
from tests.making import run_layerfix

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [README, *(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").glob("*.md"))
                   if page.name != "python.md")]  # fmt: skip
BLOCKS = [block for page in PAGES for block in re.findall(r"```(\w+)\n(.*?)```", page, re.DOTALL)]
COMMANDS = [
    line for kind, text in BLOCKS if kind == "sh" for line in text.splitlines() if line.startswith("layerfix ")
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the part and the printer file that the examples name."""
    from layerfix.mesh.triangles import save_stl
    from layerfix.samples import sample

    small = sample("test-part").mesh().transformed(np.diag([0.4, 0.4, 1.0]))  # a sixth of the pixels
    save_stl(tmp_path / "part.stl", small)
    toml = next(text for kind, text in BLOCKS if kind == "toml")
    with zipfile.ZipFile(tmp_path / "job.sl1", "w") as job:
        job.writestr("config.ini", "jobDir = fin\nlayerHeight = 0.05\nusedMaterial = 1.0\n")
        fin = np.zeros((2560, 1440), bool)
        fin[100:900, 700:702] = True
        job.writestr("fin00000.png", encode_png(lf.pack(fin), 1440))
    (tmp_path / "my.toml").write_text(toml, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_here(*arguments: str) -> tuple[int, str]:
    """(exit code, what went wrong) of a command in this process: dozens of new ones take too long to start."""
    done = CliRunner().invoke(layerfix, arguments)
    return done.exit_code, f"{done.exception}\n{done.output}"


def test_the_commands_of_the_readme_run_one_after_the_other(folder):
    """Each `layerfix …` line works; a target written by an earlier example is cleared first."""
    assert len(COMMANDS) >= 8
    for command in COMMANDS:
        arguments = shlex.split(command)[1:]
        if arguments[0] == "check":  # 1: something would be lost
            assert run_here(*arguments)[0] in (0, 1), command
            continue
        targets = [b for a, b in pairwise(arguments) if a == "-o"] or arguments[2:3]
        if arguments[1] == "part.stl":
            for target in targets:
                (folder / target).unlink(missing_ok=True)
        code, error = run_here(*arguments)
        assert code == 0, f"{command}: {error}"
        for target in targets:
            assert (folder / target).exists()


@pytest.mark.parametrize("code", [text for kind, text in BLOCKS if kind == "python"])
def test_the_python_of_the_readme_runs(folder, code):
    """Each Python block runs in a folder with part.stl."""
    exec(compile(code, "README.md", "exec"), {})


def test_the_readme_shows_what_the_demo_prints(folder):
    """The summary shown is the demo's own."""
    shown = next(text for kind, text in BLOCKS if kind == "text")
    _, output, _ = run_layerfix("demo")
    for line in shown.splitlines():
        assert line in output


def test_the_setup_commands_are_what_they_claim():
    """Two one-liners set everything up: the demo, and the tests."""
    lines = [line for kind, text in BLOCKS if kind == "sh" for line in text.splitlines() if "venv" in line]
    assert lines[0].endswith("layerfix demo")
    assert lines[1].endswith("python -m pytest")


def test_links_lead_somewhere():
    """Pictures and pages that are named are there."""
    for base, page in ((ROOT, PAGES[0]), *((ROOT / "docs", page) for page in PAGES[1:])):
        for link in re.findall(r"\]\(((?!http)[^)#]+)\)", page):
            assert (base / link).is_file(), link
