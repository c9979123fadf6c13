"""Kernels compiled ahead, by other processes: numba compiles one at a time, and a first run waits for forty of them.

The first time a kernel has to be compiled, some processes begin with the kernels of all modules that are imported so
far, from the other end, and leave them in the cache on disk. Each claims what it compiles, so that no two compile the
same; what the run comes to meanwhile it waits for. Nothing depends on these processes: the claim of one that is gone
counts for nothing, and they end with the run that began them.
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
from contextlib import suppress

from layerfix import kernel_cache
from layerfix.processors import processors

MOST = 3  # processes
PROGRAM = "import sys; from layerfix.kernels import ready_beside; ready_beside(int(sys.argv[1]), *sys.argv[2:])"
MARK = "LAYERFIX_COMPILES_AHEAD"
_begun: list[subprocess.Popen[bytes]] = []
_off = False


def begin() -> None:
    """Start compiling ahead, unless that has begun, or nothing could be kept, or there is only one processor."""
    global _off
    if _off or MARK in os.environ:  # one that compiles ahead begins no others
        return
    _off = True
    modules = [name for name in sys.modules if name.startswith("layerfix.") and name != __name__]
    if processors() < 2 or not sys.executable or getattr(sys, "frozen", False) or not _can_be_kept():
        return
    count = min(processors() - 1, MOST)
    atexit.register(_end)
    for _ in range(count):
        command = [sys.executable, "-c", PROGRAM, str(os.getpid()), *reversed(modules)]
        with suppress(OSError):
            _begun.append(
                subprocess.Popen(
                    command,
                    env={**os.environ, MARK: "1"},
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )


def _can_be_kept() -> bool:
    """Whether a folder for kernels can be written to."""
    for place in kernel_cache.places():
        with suppress(OSError):
            place.mkdir(parents=True, exist_ok=True)
            if os.access(place, os.W_OK):
                return True
    return False


def _end() -> None:
    for process in _begun:
        with suppress(OSError):
            process.kill()
    for process in _begun:
        process.wait()
    kernel_cache.forget_claims([process.pid for process in _begun])
