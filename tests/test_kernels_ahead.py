"""Kernels compiled ahead: one generation of processes, none of which is needed."""

from __future__ import annotations

import os
import subprocess
import sys

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
    print(command[3:6], "layerfix.layers.components" in command, kernels_ahead.MARK in how["env"])
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


def test_a_process_compiles_its_share_and_stops_without_its_parent(tmp_path):
    """It leaves kernels in the cache; for a parent that is gone none."""
    command = [sys.executable, "-c", kernels_ahead.PROGRAM, "0", "1"]
    for parent, some in ((os.getpid(), True), (1 << 22, False)):
        place = tmp_path / str(parent)
        env = environment(NUMBA_CACHE_DIR=str(place), **{kernels_ahead.MARK: "1"})
        subprocess.run([*command, str(parent), "layerfix.layers.columns"], env=env, check=True, timeout=120)
        assert any(place.rglob(f"*{kernel_cache.SUFFIX}")) == (some or sys.platform == "win32")
