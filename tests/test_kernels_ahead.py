"""Kernels compiled ahead: one generation of processes, none of which is needed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from layerfix import kernel_cache, kernels_ahead
from layerfix.processors import processors
from tests.making import environment

PROGRAM = """
import sys
from layerfix import kernels_ahead
started = []
kernels_ahead.subprocess.Popen = lambda command, **how: started.append((command, how)) or Process()
class Process:
    def kill(self): pass
    def wait(self): pass
import layerfix.layers.components
kernels_ahead.begin()
kernels_ahead.begin()
for command, how in started:
    print(command[3:4], "layerfix.layers.components" in command, kernels_ahead.MARK in how["env"])
"""


def run(**more: str) -> list[str]:
    """What the program above prints."""
    env = {name: value for name, value in environment(**more).items() if name != kernels_ahead.MARK or name in more}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=env, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_they_begin_once_and_no_more_than_there_are_processors(tmp_path):
    """Each with its share; with one processor none; those that compile ahead begin no others."""
    count = min(processors() - 1, kernels_ahead.MOST)
    lines = run(NUMBA_CACHE_DIR=str(tmp_path))
    assert len(lines) == count
    assert all(line.endswith("True True") for line in lines)
    assert run(NUMBA_CACHE_DIR=str(tmp_path), **{kernels_ahead.MARK: "1"}) == []


def test_nothing_begins_where_nothing_can_be_kept(tmp_path):
    """A cache folder that is a file."""
    (tmp_path / "file").write_text("")
    assert run(NUMBA_CACHE_DIR=str(tmp_path / "file")) == []


NAMES = "layers.some.kernel", "machine", "digest"


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """An empty folder for kernels."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


def test_one_process_claims_a_kernel_and_gives_it_back(place):
    """Nobody else gets it meanwhile; another kernel is free."""
    mine = kernel_cache.claim(*NAMES)
    assert isinstance(mine, Path)
    assert kernel_cache.claimed(*NAMES)
    assert kernel_cache.claim(*NAMES) is False
    assert not kernel_cache.claimed("layers.other", *NAMES[1:])
    kernel_cache.release(mine)
    assert not kernel_cache.claimed(*NAMES)
    assert not [path for path in place.rglob("*") if path.is_file()]


@pytest.mark.skipif(os.name != "posix", reason="processes are asked for by their number")
def test_the_claim_of_a_process_that_is_gone_counts_for_nothing(place):
    """Killed while it compiled; the one that had its number is none."""
    mine = kernel_cache.claim(*NAMES)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    mine.write_text(str(gone.pid))
    assert not kernel_cache.claimed(*NAMES)
    assert kernel_cache.claim(*NAMES) == mine
    assert mine.read_text() == str(os.getpid())


def test_an_old_claim_counts_for_nothing(place):
    """Whoever made it; and those of some processes can be cleared away."""
    mine = kernel_cache.claim(*NAMES)
    os.utime(mine, (1, 1))
    assert kernel_cache.claim(*NAMES) == mine
    kernel_cache.forget_claims([1 << 22])
    assert mine.exists()
    kernel_cache.forget_claims([os.getpid()])
    assert not mine.exists()


def test_without_a_place_there_is_nothing_to_claim(tmp_path, monkeypatch):
    """Every process compiles for itself."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert kernel_cache.claim(*NAMES) is True
    kernel_cache.release(True)


COMPILING = """
import sys
from numba.core import event
from layerfix.kernels import Kernel, kernels_of, ready
import layerfix.layers.components
class Listener(event.Listener):
    def on_start(self, happened):
        if isinstance(happened.data["dispatcher"], Kernel):
            print(happened.data["dispatcher"].name)
    def on_end(self, happened): pass
sys.stdin.readline()
with event.install_listener("numba:compile", Listener()):
    ready("layerfix.layers.components")
"""


def test_two_processes_compile_each_kernel_once(tmp_path):
    """What one compiles the other waits for."""
    env = environment(NUMBA_CACHE_DIR=str(tmp_path), **{kernels_ahead.MARK: "1"})
    both = [
        subprocess.Popen([sys.executable, "-c", COMPILING], env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                         text=True)
        for _ in range(2)
    ]  # fmt: skip
    for process in both:
        process.stdin.write("\n")
        process.stdin.flush()
    printed = [name for process in both for name in process.communicate(timeout=300)[0].splitlines()]
    assert [process.returncode for process in both] == [0, 0]
    assert "layers.components.measured_parts" in printed
    assert sorted(printed) == sorted(set(printed))
    assert not [*tmp_path.rglob(f"*{kernel_cache.CLAIM}")]


def test_a_process_compiles_its_share_and_stops_without_its_parent(tmp_path):
    """It leaves kernels in the cache; for a parent that is gone none."""
    command = [sys.executable, "-c", kernels_ahead.PROGRAM]
    for parent, some in ((os.getpid(), True), (1 << 22, False)):
        place = tmp_path / str(parent)
        env = environment(NUMBA_CACHE_DIR=str(place), **{kernels_ahead.MARK: "1"})
        subprocess.run([*command, str(parent), "layerfix.layers.columns"], env=env, check=True, timeout=120)
        assert any(place.rglob(f"*{kernel_cache.SUFFIX}")) == (some or sys.platform == "win32")
