#!/usr/bin/env python3
"""For hosts that send a sliced file to a program (DragonFruit's "Send to UVtools", a slicer's "open with"):

    layerfix_send.py FILE …

corrects each into FILE's folder as NAME_fixed.SUFFIX and then opens that with the program in LAYERFIX_THEN (the real
UVtools, say), if there is one. LAYERFIX_OPTIONS holds options of `layerfix fix` (default: --min-feature 0.15mm);
LAYERFIX the command, if `layerfix` is not on PATH. Ends with 1 if a file could not be corrected; then it is opened
as it is, so that nothing is lost on the way.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path


def main(files: list[str]) -> int:
    """Correct and pass on. 0 if all were corrected."""
    if not files:
        print("usage: layerfix_send.py FILE …", file=sys.stderr)
        return 2
    failed = False
    for name in files:
        source = Path(name)
        target = source.with_name(f"{source.stem}_fixed{source.suffix}")
        command = shlex.split(os.environ.get("LAYERFIX", "layerfix"))
        own = shlex.split(os.environ.get("LAYERFIX_OPTIONS", "--min-feature 0.15mm"))
        try:
            done = subprocess.run([*command, "fix", str(source), str(target), "--force", *own], check=False)
            wrong = done.returncode != 0
        except FileNotFoundError:
            print("layerfix is not installed, or not on PATH: pip install layerfix", file=sys.stderr)
            wrong = True
        failed |= wrong
        then = os.environ.get("LAYERFIX_THEN")
        if then:
            try:
                subprocess.Popen([*shlex.split(then), str(source if wrong else target)])
            except OSError as problem:
                print(f"LAYERFIX_THEN: {then}: {problem.strerror or problem}", file=sys.stderr)
                failed = True
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
