"""Fuzz every reader of jobs with atheris: ``python -m tests.fuzz [-max_total_time=600] [libFuzzer options]``.

Needs ``pip install atheris``. Only LayerfixError may come out of reading a file and decoding its layers;
anything else stops the run and leaves the input as a crash-… file.
"""

import sys
import tempfile
import types
from pathlib import Path

import atheris

import layerfix as lf
from layerfix import formats
from layerfix.errors import LayerfixError
from layerfix.formats.jobs import chitu, chitubox_zip, container, cws, goo, nanodlp, sl1, zip_job, zips
from layerfix.formats.png import images as png_stack
from tests.independent_readers import block, thin_bar, write_chitu, write_goo, write_sl1

FOLDER = Path(tempfile.mkdtemp(prefix="layerfix-fuzz-"))


READERS = (formats, chitu, chitubox_zip, container, cws, goo, nanodlp, png_stack, sl1, zip_job, zips)


def instrument() -> None:
    """Watch the readers' Python. (Not at import: numba compiles the kernels from bytecode, which must stay.)"""
    for module in READERS:
        for thing in list(vars(module).values()):
            if isinstance(thing, types.FunctionType) and thing.__module__ == module.__name__:
                atheris.instrument_func(thing)


def seeds() -> Path:
    """A folder with one small job of each kind."""
    folder = FOLDER / "seeds"
    folder.mkdir()
    layers = [block(24, 40), thin_bar(24, 40), thin_bar(24, 40, 90)]
    write_sl1(folder / "a.sl1", layers)
    write_goo(folder / "a.goo", layers)
    write_chitu(folder / "a.cbddlp", layers)
    return folder


def one_input(data: bytes) -> None:
    """Read the bytes as a file of any kind."""
    path = FOLDER / "input"
    path.write_bytes(data)
    try:
        for layer in lf.read(path, pixel_mm=0.05, layer_mm=0.05).with_workers(1):
            layer.count_px()
    except LayerfixError:
        pass


if __name__ == "__main__":
    instrument()
    atheris.Setup([sys.argv[0], "-rss_limit_mb=3000", "-max_len=300000", *sys.argv[1:], str(seeds())], one_input)
    atheris.Fuzz()
