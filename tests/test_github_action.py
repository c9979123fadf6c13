"""The GitHub Action: its steps run by bash, on a repository with a pull request."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.making import box, environment, thin_part, write_stl

ACTION = Path(__file__).parents[1] / "plugin" / "github-action"
TEXT = (ACTION / "action.yml").read_text(encoding="utf-8")


def steps() -> list[str]:
    """The `run` blocks of action.yml."""
    blocks = re.findall(r"\n      run: \|\n((?:        .*\n)+)", TEXT)
    return [re.sub(r"(?m)^ {8}", "", block) for block in blocks]


def git(folder: Path, *args: str) -> str:
    """A git command by nobody in particular."""
    who = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *who, *args], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path) -> tuple[Path, str]:
    """(a checkout of a pull request, its base): it adds a part with a thin fin, and one that is sound."""
    folder = tmp_path / "models"
    folder.mkdir()
    git(folder, "init", "-q", "-b", "main")
    write_stl(folder / "old part.stl", thin_part())
    git(folder, "add", ".")
    git(folder, "commit", "-qm", "models")
    base = git(folder, "rev-parse", "HEAD")
    (folder / "new").mkdir()
    write_stl(folder / "new" / "thin fin.stl", thin_part())
    write_stl(folder / "new" / "sound.stl", box([0, 0, 0], [6, 4, 1]))
    (folder / "notes.txt").write_text("no model")
    git(folder, "add", ".")
    git(folder, "commit", "-qm", "two more")
    return folder, base


def run_check(folder: Path, **own: str) -> tuple[int, str, str, str]:
    """(exit code, summary, outputs, stderr) of the step that checks."""
    summary, output = folder.parent / "summary.md", folder.parent / "output"
    summary.unlink(missing_ok=True)
    output.unlink(missing_ok=True)
    bin_folder = folder.parent / "bin"
    bin_folder.mkdir(exist_ok=True)
    (bin_folder / "python3").unlink(missing_ok=True)
    (bin_folder / "python3").symlink_to(sys.executable)
    env = environment(
        GITHUB_ACTION_PATH=str(ACTION), GITHUB_STEP_SUMMARY=str(summary), GITHUB_OUTPUT=str(output),
        LAYERFIX=f"{sys.executable} -m layerfix", **{"LAYERFIX_MODELS": "*.stl *.3mf *.obj *.ply", **own},
    )  # fmt: skip
    env["PATH"] = f"{bin_folder}:{env['PATH']}"
    done = subprocess.run(["bash", "-eo", "pipefail", "-c", steps()[1]], cwd=folder, env=env, text=True,
                          capture_output=True, check=False)  # fmt: skip
    return done.returncode, summary.read_text() if summary.exists() else "", (
        output.read_text() if output.exists() else ""
    ), done.stderr  # fmt: skip


def test_a_pull_request_gets_a_table_for_each_of_its_models(repository):
    """Those that it adds, not those that were there; the job fails only if it is asked to."""
    folder, base = repository
    options = "--min-feature 0.4mm --pixel 50um --layer 0.2mm"
    code, summary, output, error = run_check(folder, LAYERFIX_BASE=base, LAYERFIX_OPTIONS=options)
    assert (code, output) == (0, "ok=false\n"), error
    assert ":white_check_mark: layerfix check: `sound.stl`" in summary
    assert ":warning: layerfix check: `thin fin.stl`" in summary
    assert "would be lost" in summary
    assert "old part" not in summary
    assert run_check(folder, LAYERFIX_BASE=base, LAYERFIX_OPTIONS=options, LAYERFIX_FAIL="true")[0] == 1


def test_what_cannot_be_read_is_an_error_and_no_change_is_none(repository):
    """A broken model fails the job and is named; an unknown base says what checkout needs; nothing changed: ok."""
    folder, base = repository
    (folder / "broken.stl").write_bytes(b"solid nothing")
    git(folder, "add", ".")
    git(folder, "commit", "-qm", "broken")
    code, summary, output, _ = run_check(folder, LAYERFIX_BASE=base, LAYERFIX_PRINTER="prusa-mk3s-0.4",
                                         LAYERFIX_MODELS="broken.stl")  # fmt: skip
    assert (code, output) == (2, "ok=false\n")
    assert ":x: layerfix check: `broken.stl`" in summary
    head = git(folder, "rev-parse", "HEAD")
    assert run_check(folder, LAYERFIX_BASE=head)[:3] == (0, "No models changed.\n", "ok=true\n")
    code, _, _, error = run_check(folder, LAYERFIX_BASE="0" * 40)
    assert (code, "fetch-depth: 0" in error) == (2, True)


def test_the_action_is_of_two_steps_and_its_settings_reach_the_script():
    """It installs what lies two folders above it, and every input is used."""
    install, check = steps()
    assert install.split() == ["python3", "-m", "pip", "install", "--quiet", '"$GITHUB_ACTION_PATH/../.."']
    assert (ACTION / ".." / ".." / "pyproject.toml").is_file()
    assert "check_models.py" in check
    inputs = re.findall(r"(?m)^  (\w+):$", TEXT.partition("inputs:")[2].partition("outputs:")[0])
    assert all(f"inputs.{name}" in TEXT for name in inputs)
    script = (ACTION / "check_models.py").read_text(encoding="utf-8")
    assert all(name in script for name in re.findall(r"LAYERFIX_\w+", TEXT))
