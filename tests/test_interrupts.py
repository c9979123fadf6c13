"""Ctrl-C, SIGTERM and SIGHUP in the middle of the work: a soon end, a clear exit code, and the disk as it was."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from layerfix.samples import sample
from tests.making import contents, environment, start_layerfix, thin_part, write_stl

FINE = ("--pixel", "40um", "--layer", "0.04mm", "--min-feature", "0.4mm", "--force")  # 1,400 layers: some ten seconds
SIGNALS = {"SIGINT": (signal.SIGINT, 130), "SIGTERM": (signal.SIGTERM, 143), "SIGHUP": (signal.SIGHUP, 129)}
every_signal = pytest.mark.parametrize("name", SIGNALS)


@pytest.fixture(scope="module")
def playground(tmp_path_factory) -> Path:
    """The largest of the built-in parts, as a file."""
    return write_stl(tmp_path_factory.mktemp("playground") / "playground.stl", sample("playground").mesh())


def wait_for_work(folder: Path, process: subprocess.Popen[str]) -> Path:
    """Until a temporary beside the target has something in it."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()
        for path in folder.glob(".*.part"):
            if (path.stat().st_size > 10_000) if path.is_file() else len(list(path.iterdir())) > 5:
                return path
        time.sleep(0.01)
    raise TimeoutError("no temporary appeared")


def interrupted(process: subprocess.Popen[str], number: int) -> tuple[int, str, float]:
    """Exit code, stderr, and how long it took to stop."""
    sent = time.monotonic()
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert out == ""
    return process.returncode, err, time.monotonic() - sent


@every_signal
@pytest.mark.parametrize("target", ["out", "out.zip"])
@pytest.mark.parametrize("existing", [False, True], ids=["new", "existing"])
def test_an_interrupted_fix_leaves_nothing_and_takes_nothing(tmp_path, playground, name, target, existing):
    """No part of an output, no temporary, and an output from before is still there, to the byte."""
    number, code = SIGNALS[name]
    if existing and target == "out":
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "old.png").write_bytes(b"old")
    elif existing:
        (tmp_path / "out.zip").write_bytes(b"old")
    before = contents(tmp_path)
    process = start_layerfix("fix", playground, target, *FINE, cwd=tmp_path)
    wait_for_work(tmp_path, process)
    done, err, seconds = interrupted(process, number)
    assert done == code
    assert "Traceback" not in err
    assert len(err.strip().splitlines()) <= 1
    assert contents(tmp_path) == before
    assert seconds < 5


def test_ctrl_c_says_that_nothing_was_written(tmp_path, playground):
    """One line, so that nobody looks for half an output."""
    process = start_layerfix("fix", playground, "out.zip", *FINE, cwd=tmp_path)
    wait_for_work(tmp_path, process)
    _, err, _ = interrupted(process, signal.SIGINT)
    assert err.strip() == "layerfix: stopped"


def test_nohup_goes_on_when_the_terminal_is_closed(tmp_path):
    """Who asked for it to go on gets the output."""
    write_stl(tmp_path / "part.stl", thin_part())

    def nohup() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    process = start_layerfix(
        "fix", "part.stl", "out.zip", "--pixel", "4um", "--layer", "0.04mm", "--min-feature", "0.4mm",
        cwd=tmp_path, preexec_fn=nohup,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob(".*.part")) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGHUP)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert set(contents(tmp_path)) == {"part.stl", "out.zip"}


def test_ctrl_c_twice_is_no_worse(tmp_path, playground):
    """Impatience must not leave a temporary or a traceback."""
    process = start_layerfix("fix", playground, "out.zip", *FINE, cwd=tmp_path)
    wait_for_work(tmp_path, process)
    process.send_signal(signal.SIGINT)
    time.sleep(0.02)
    code, err, _ = interrupted(process, signal.SIGINT)
    assert "Traceback" not in err
    assert code in (130, -signal.SIGINT)  # a shell says 130 of both
    assert contents(tmp_path) == {}


# Sends itself a signal at the first import of a module; what the signal raises comes out of that import.
STOP_AT_IMPORT = """
import os, sys

class Stop:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), {number})

sys.meta_path.insert(0, Stop())
from layerfix.__main__ import main
main()
"""


@every_signal
@pytest.mark.parametrize(
    "module", ["layerfix.commands.fix", "numba", "llvmlite", "layerfix.mesh.load", "layerfix.mesh.weld"]
)
def test_a_signal_while_the_program_is_still_loading_is_not_lost(tmp_path, name, module):
    """Loading takes longer than small parts do. Some libraries swallow whatever their imports raise: a Ctrl-C at
    that moment must still end the program, without an output and without a traceback.
    """
    number, code = SIGNALS[name]
    part = write_stl(tmp_path / "part.stl", thin_part())
    done = subprocess.run(
        [sys.executable, "-c", STOP_AT_IMPORT.format(module=module, number=int(number)), "fix", str(part), "out.zip",
         "--pixel", "50um", "--layer", "0.1mm", "--min-feature", "0.4mm"],
        cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert list(contents(tmp_path)) == ["part.stl"]
    assert done.returncode in (code, -number)  # a shell says the same of both
    assert "Traceback" not in done.stderr


def test_the_input_is_only_read(playground):
    """After all of this the part is what it was."""
    assert (
        playground.read_bytes()
        == write_stl(playground.with_name("again.stl"), sample("playground").mesh()).read_bytes()
    )


IN_A_CALLBACK = """
import ctypes, signal, sys, time
from layerfix import __main__ as program
def signalled():
    signal.raise_signal(signal.{name})
    time.sleep(0)
def run():
    ctypes.CFUNCTYPE(None)(signalled)()
    print("went on", flush=True)
    time.sleep(60)
program._run = run
program.main()
"""


@every_signal
def test_a_signal_that_comes_in_a_callback_is_not_lost(name):
    """Python drops what is raised in a function that C calls, as the compiler does; after that, the end comes."""
    command = [sys.executable, "-c", IN_A_CALLBACK.format(name=name)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=30)
    assert done.returncode == SIGNALS[name][1]
    assert done.stdout == "went on\n"
    assert done.stderr == ("layerfix: stopped\n" if name == "SIGINT" else "")
