"""Compile all kernels of the checkout, in as many processes as there are processors, each of which takes what no
other compiles: tests would do it one by one."""

import os
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src"
MODULES = [
    ".".join(path.relative_to(SOURCE).with_suffix("").parts)
    for path in sorted(SOURCE.rglob("*.py"))
    if "import njit" in path.read_text(encoding="utf-8") and path.name != "kernels.py"
]

count = os.cpu_count() or 1
code = f"import os; from layerfix.kernels import ready_beside; ready_beside(os.getppid(), *{MODULES!r})"
running = [
    subprocess.Popen([sys.executable, "-c", code], env={**os.environ, "LAYERFIX_COMPILES_AHEAD": "1"})
    for _ in range(count)
]
sys.exit(max(process.wait() for process in running))
