#!/usr/bin/env python3
"""Post-processing script of PrusaSlicer, SuperSlicer, OrcaSlicer: what does the G-code leave out of the model?

    layerfix_check.py [--model FILE] [--strict] GCODE

The slicer adds GCODE. The model is FILE, else the project or mesh beside the exported file whose name that begins
with (`bracket_0.2mm_PLA.gcode` is of `bracket.3mf`). What is found stands in `NAME.layerfix.txt` beside the exported
file; the G-code itself is never touched. Ends with 1, which fails the export, only with --strict: if a part is
dropped, or if it could not be looked at.

Nothing but Python's own library: `layerfix` is a command on PATH, or the environment variable LAYERFIX says which.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
from pathlib import Path

MODELS = (".3mf", ".stl", ".obj", ".amf")


def main(arguments: list[str]) -> int:
    """Look at a G-code. 0 unless --strict finds something."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("gcode", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--strict", action="store_true")
    given = parser.parse_args(arguments)
    exported = Path(os.environ.get("SLIC3R_PP_OUTPUT_NAME") or given.gcode)  # the slicer may post-process a copy
    model = given.model or model_of(exported)
    if model is None:
        code, said = 2, f"no model beside {exported.name} whose name it begins with; give --model FILE"
    else:
        code, said = looked_at(model, given.gcode)
    report = exported.with_name(f"{exported.stem}.layerfix.txt")
    try:
        report.write_text(f"{exported.name}{f' of {model.name}' if model else ''}\n\n{said}\n", encoding="utf-8")
    except OSError as problem:
        print(f"layerfix: {report}: {problem.strerror}", file=sys.stderr)
    if code:
        print(f"layerfix: {said.splitlines()[0] if code > 1 else said}", file=sys.stderr)
    return int(bool(code)) if given.strict else 0


def model_of(exported: Path) -> Path | None:
    """The project or mesh beside an exported file with the longest name that its name begins with."""
    folder = exported.parent if exported.parent.is_dir() else Path()
    found = [p for p in folder.iterdir() if p.suffix.lower() in MODELS and exported.stem.startswith(p.stem)]
    return max(found, key=lambda path: (len(path.stem), -MODELS.index(path.suffix.lower())), default=None)


def looked_at(model: Path, gcode: Path) -> tuple[int, str]:
    """(0 all there, 1 something is not, 2 it could not be looked at; what layerfix says)."""
    command = [*shlex.split(os.environ.get("LAYERFIX", "layerfix")), "check", str(model), "--gcode", str(gcode)]
    try:
        done = subprocess.run([*command, "--strict"], capture_output=True, text=True, encoding="utf-8", check=False)
    except FileNotFoundError:
        return 2, "layerfix is not installed, or not on PATH: pip install layerfix, or set LAYERFIX to the command"
    return done.returncode, (done.stdout.strip() or done.stderr.strip()).removeprefix("layerfix: ")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
