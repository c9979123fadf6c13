"""How long it takes to begin: import, --version, a small part, and the kernels' one compilation.

Seconds of the processor, not of the clock: they do not depend on what else the machine does.
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from layerfix.kernels import kernels_of
from layerfix.mesh.triangles import save_stl
from tests.benchmarks.measuring import table
from tests.making import box

FIX = ("-m", "layerfix", "fix", "box.stl", "--force")
TO_IMAGES = (*FIX, "a.zip", "--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.4mm")
TO_GCODE = (*FIX, "a.gcode", "--printer", "prusa-mk3s-0.4")
COMMANDS = {
    "python -c pass": ("-c", "pass"),
    "python -c 'import numba'": ("-c", "import numba"),
    "python -c 'import layerfix'": ("-c", "import layerfix"),
    "layerfix --version": ("-m", "layerfix", "--version"),
    "layerfix fix box.stl a.zip": TO_IMAGES,
    "layerfix fix box.stl a.gcode": TO_GCODE,
}
FIRST = {"layerfix demo": ("-m", "layerfix", "demo", "--force"), "… fix box.stl a.zip": TO_IMAGES,
         "… fix box.stl a.gcode": TO_GCODE}  # fmt: skip


def processor_seconds(folder: Path, args: tuple[str, ...], **environment: str) -> float:
    """User and system time of one process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    env = {**os.environ, **environment}
    subprocess.run([sys.executable, *args], check=True, capture_output=True, cwd=folder, env=env)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def slowest_kernels(count: int) -> list[list[object]]:
    """The kernels of a correction to images that take longest to compile, without what they call."""
    from numba.core import event

    modules = [f"layerfix.layers.{name}" for name in ("columns", "morphology", "thinning", "skeleton", "thickness",
                                                       "correction")]  # fmt: skip
    with event.install_recorder("numba:compile") as recorder:
        for kernel in kernels_of(*modules, "layerfix.mesh.cutter", "layerfix.formats.png.encode"):
            kernel.ready()
    spent: dict[str, float] = {}
    starts: list[tuple[float, str, float]] = []
    for when, happened in recorder.buffer:
        function = happened.data["dispatcher"].py_func
        if happened.is_start:
            starts.append((when, f"{function.__module__}.{function.__name__}", 0.0))
        else:
            began, name, inside = starts.pop()
            spent[name] = spent.get(name, 0.0) + when - began - inside
            if starts:
                starts[-1] = (*starts[-1][:2], starts[-1][2] + when - began)
    return [[name, seconds] for name, seconds in sorted(spent.items(), key=lambda item: -item[1])[:count]]


def run() -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        save_stl(folder / "box.stl", box((0, 0, 0), (20, 20, 20)))
        for args in (TO_IMAGES, TO_GCODE):
            processor_seconds(folder, args)
        rows = [[name, min(processor_seconds(folder, args) for _ in range(5))] for name, args in COMMANDS.items()]
        table(("command, kernels compiled before", "processor seconds"), rows)
        rows = []
        for name, args in FIRST.items():
            with tempfile.TemporaryDirectory() as cache:
                rows.append([name, processor_seconds(folder, args, NUMBA_CACHE_DIR=cache)])
        print("\nThe first run, which compiles; each begins with no kernels.\n")
        table(("command", "processor seconds"), rows)
        print("\nThe slowest kernels and helpers of `fix box.stl a.zip`, without what they call.\n")
        os.environ["NUMBA_CACHE_DIR"] = f"{place}/kernels"
        table(("function", "seconds"), slowest_kernels(12))
