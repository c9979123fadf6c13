"""How long it takes to begin: import, --version, and the kernels' one compilation."""

import os
import subprocess
import sys
import tempfile

from tests.benchmarks.measuring import best_of, table

KERNELS = "import layerfix.commands.fix, layerfix.commands.demo"


def run() -> None:
    python = sys.executable

    def start(*args: str, **environment: str) -> None:
        subprocess.run([python, *args], check=True, capture_output=True, env={**os.environ, **environment})

    bare = best_of(5, lambda: start("-c", "pass"))
    rows = [
        ["python -c pass", bare],
        ["python -c 'import layerfix'", best_of(5, lambda: start("-c", "import layerfix"))],
        ["layerfix --version", best_of(5, lambda: start("-m", "layerfix", "--version"))],
        ["all modules, kernels cached", best_of(3, lambda: start("-c", KERNELS))],
    ]
    with tempfile.TemporaryDirectory() as cache:
        rows.append(
            ["all modules, kernels compiled", best_of(1, lambda: start("-c", KERNELS, NUMBA_CACHE_DIR=cache))]
        )
    table(("command", "seconds"), [[name, t] for name, t in rows])
    print(f"\n`import layerfix` adds {1e3 * (rows[1][1] - bare):.0f} ms to the interpreter's own start.")
