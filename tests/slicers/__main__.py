"""``python -m tests.slicers``: parts before and after correction, through five modes of three slicers."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.benchmarks.measuring import machine
from tests.slicers.models import MODELS
from tests.slicers.programs import MODES, Mode, version, why_not
from tests.slicers.report import LEGEND, as_json, parts_table, results_table, verdict
from tests.slicers.runs import Part, prepare, run_all


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.slicers", description=__doc__)
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS), metavar="NAME")
    parser.add_argument("--modes", nargs="+", choices=MODES, default=list(MODES), metavar="NAME")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all that was measured to FILE")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep meshes and G-code in DIR")
    parser.add_argument("--surface", choices=("smooth", "voxels", "layers"), help="of the corrected meshes")
    parser.epilog = f"models: {', '.join(MODELS)}; modes: {', '.join(MODES)}"
    given = parser.parse_args(arguments)
    modes = runnable([MODES[name] for name in given.modes])
    with tempfile.TemporaryDirectory() as scratch:
        report(given.models, modes, given.keep or Path(scratch), given.json, given.surface)


def report(
    names: Sequence[str], modes: Sequence[Mode], folder: Path, json_file: Path | None, surface: str | None = None
) -> None:
    """Run these models in these modes and print what came of it."""
    started = time.perf_counter()
    versions = [version(program) for program in dict.fromkeys(mode.program for mode in modes)]
    parts = present(names, folder, surface)
    outcomes = run_all(parts, modes)
    print(f"{', '.join(versions) or 'no slicer'}\n{machine()}\n\n{LEGEND}\n")
    print(f"{results_table(outcomes)}\n\n{parts_table(parts)}\n\n{verdict(outcomes)}")
    print(f"{time.perf_counter() - started:.0f} s in all.")
    if json_file:
        json_file.write_text(json.dumps(as_json(versions, machine(), parts, outcomes), indent=1), encoding="utf-8")


def runnable(modes: Sequence[Mode]) -> list[Mode]:
    """The modes whose slicer is here; says which are not."""
    for reason in dict.fromkeys(filter(None, map(why_not, modes))):
        print(f"skipped: {reason}", file=sys.stderr)
    return [mode for mode in modes if not why_not(mode)]


def present(names: Sequence[str], folder: Path, surface: str | None = None) -> list[Part]:
    """The models whose file is here, corrected; says which are not."""
    parts = []
    for name in names:
        mesh = MODELS[name].make()
        if mesh is None:
            print(f"skipped: {name}, {MODELS[name].about}: the file is not here", file=sys.stderr)
        else:
            parts.append(prepare(name, mesh, folder / name, surface))
    return parts


if __name__ == "__main__":
    main()
