#!/usr/bin/env python3
"""Chitubox runs this after slicing: it corrects the layer images in Chitubox's temporary folder, and Chitubox makes
the file that was asked for of what it then finds there.

    layerfix_chitubox.py FOLDER OUTPUT

FOLDER holds 1.png, 2.png, … and run.gcode, which says pixels and sizes; OUTPUT is where the file will be, and is not
touched here. Options of `layerfix fix` are in options.txt beside this script. The images change only when all of them
are corrected; a failure says why in layerfix.log beside OUTPUT, leaves the folder as it was, and ends with 1.

Nothing but Python's own library: `layerfix` is a command on PATH, or the environment variable LAYERFIX says which.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path


def main(arguments: list[str]) -> int:
    """Correct the images of a folder. 0 if all went well."""
    if not arguments:
        print("usage: layerfix_chitubox.py FOLDER [OUTPUT]", file=sys.stderr)
        return 2
    folder = Path(arguments[0])
    log = (Path(arguments[1]).parent if len(arguments) > 1 else folder) / "layerfix.log"
    try:
        said = correct(folder, options(Path(__file__).parent / "options.txt"))
    except (OSError, RuntimeError, zipfile.BadZipFile) as problem:
        note(log, f"{problem}\n")
        print(problem, file=sys.stderr)
        return 1
    note(log, said)
    return 0


def note(log: Path, text: str) -> None:
    """Write the log; if that cannot be, say so: what was done to the images is done."""
    try:
        log.write_text(text, encoding="utf-8")
    except OSError as problem:
        print(f"{log}: the log could not be written: {problem.strerror or problem}", file=sys.stderr)


def options(path: Path) -> list[str]:
    """The words of options.txt, without the lines that begin with #."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return [word for line in lines if not line.startswith("#") for word in shlex.split(line)]


def correct(folder: Path, own: list[str]) -> str:
    """What layerfix says of the images of a folder, once they are corrected in place. Raises RuntimeError if not."""
    if not (folder / "run.gcode").is_file():
        raise RuntimeError(f"{folder}: there is no run.gcode; is this a folder of Chitubox?")
    with tempfile.TemporaryDirectory(prefix="layerfix-") as name:
        job, fixed = Path(name) / "job.zip", Path(name) / "fixed.zip"
        with zipfile.ZipFile(job, "w", zipfile.ZIP_STORED) as file:
            for path in sorted(folder.iterdir()):
                if path.is_file():
                    file.write(path, path.name)
        command = [*shlex.split(os.environ.get("LAYERFIX", "layerfix")), "fix", str(job), str(fixed), *own]
        try:
            done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)
        except FileNotFoundError as problem:
            raise RuntimeError(
                "layerfix is not installed, or not on PATH: pip install layerfix, or set LAYERFIX to the command"
            ) from problem
        if done.returncode:
            raise RuntimeError((done.stderr or done.stdout).strip())
        new = Path(name) / "new"
        with zipfile.ZipFile(fixed) as file:
            file.extractall(new)
        for path in sorted(new.iterdir()):  # all are there; each takes its place in one step
            if path.read_bytes() != (folder / path.name).read_bytes():
                beside = folder / f".{path.name}.part"
                shutil.copyfile(path, beside)
                os.replace(beside, folder / path.name)
        return done.stdout


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
