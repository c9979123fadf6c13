"""Timing, tables and the machine's name."""

import importlib.metadata
import os
import platform
import resource
import time
from collections.abc import Callable, Sequence
from pathlib import Path

PACKAGES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "isal")


def best_of(runs: int, work: Callable[[], object]) -> float:
    """Seconds of the fastest of so many runs."""
    times = []
    for _ in range(runs):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return min(times)


def peak_gb() -> float:
    """Most memory that this process has held, in GB. (getrusage counts what its parent held when it began, too.)"""
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM")) / 1e6


def machine() -> str:
    """One line: processor, cores, Python and package versions."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        mhz = [float(line.partition(":")[2]) for line in info.read_text().splitlines() if line.startswith("cpu MHz")]
        cpu = f"{names[0]} at {max(mhz) / 1000:.1f} GHz" if names and mhz else cpu
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)
    return f"{len(os.sched_getaffinity(0))} cores, {cpu}; Python {platform.python_version()}, {versions}"


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a Markdown table: text left, numbers right."""
    cells = [[f"{c:.3g}" if isinstance(c, float) else str(c) for c in row] for row in rows]
    widths = [max(len(row[k]) for row in [list(head), *cells]) for k in range(len(head))]
    print("| " + " | ".join(h.ljust(w) for h, w in zip(head, widths, strict=True)) + " |")
    print("|" + "|".join("-" * (w + 2) for w in widths) + "|")
    for row in cells:
        print(
            "| "
            + " | ".join(
                c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))
            )
            + " |"
        )
