"""Fuzz the readers with atheris: ``python -m tests.fuzz [jobs|meshes|gcode|printers] [-max_total_time=600] …``.

Needs ``pip install atheris``. Only LayerfixError may come out of reading a file and using what is in it; anything
else, or 20 seconds, or 3 GB, stops the run and leaves the input as a crash-… (timeout-…, oom-…) file. What is
mutated is not only bytes: `structure` changes the entries of zips, the chunks of GLB and PNG, words and numbers of
texts, so that what is inside checksums and compression is reached.
"""

from __future__ import annotations

import sys
import tempfile
import types
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import atheris

from layerfix.errors import LayerfixError
from tests.fuzz import seeds, structure

FOLDER = Path(tempfile.mkdtemp(prefix="layerfix-fuzz-"))
JOBS = ("chitu", "chitubox_zip", "container", "cws", "goo", "nanodlp", "sl1", "zip_job", "zips")
MODULES = {
    "jobs": ["formats", "formats.text_values", "formats.png.images", *(f"formats.jobs.{name}" for name in JOBS)],
    "meshes": ["mesh.triangles", "mesh.read_3mf"],
    "gcode": ["formats.vector.gcode_reader"],
    "printers": ["printers"],
}


def instrument(kind: str) -> None:
    """Watch the readers' Python. (Not at import: numba compiles the kernels from bytecode, which must stay.)"""
    for name in MODULES[kind]:
        module = import_module(f"layerfix.{name}")
        for thing in list(vars(module).values()):
            if isinstance(thing, types.FunctionType) and thing.__module__ == module.__name__:
                atheris.instrument_func(thing)


def one_input(use: Callable[[Path], None], suffix_of: Callable[[bytes], str]) -> Callable[[bytes], None]:
    """What reads bytes as a file; a LayerfixError is an answer, if it is one line."""

    def run(data: bytes) -> None:
        path = FOLDER / f"input{suffix_of(data)}"
        path.write_bytes(data)
        try:
            use(path)
        except LayerfixError as problem:
            if len(str(problem)) > 4000:
                raise AssertionError("an endless message") from problem

    return run


def main() -> None:
    kind = sys.argv.pop(1) if len(sys.argv) > 1 and sys.argv[1] in MODULES else "jobs"
    instrument(kind)
    corpus = seeds.write(kind, FOLDER / "seeds")
    run = one_input(seeds.USES[kind], seeds.SUFFIX_OF[kind])
    options = ["-rss_limit_mb=3000", "-max_len=300000", "-timeout=20"]
    atheris.Setup([sys.argv[0], *options, *sys.argv[1:], str(corpus)], run, custom_mutator=structure.mutator(kind))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
