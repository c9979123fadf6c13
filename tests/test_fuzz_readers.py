"""Hypothesis against every reader of jobs: whatever happens to a file, only LayerfixError comes out."""

from __future__ import annotations

import random
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import layerfix as lf
from layerfix.errors import LayerfixError
from tests.fuzz import seeds, structure
from tests.independent_readers import CTB, block, png_bytes, thin_bar, write_chitu, write_goo, write_sl1, write_zip

LAYERS = [block(24, 42), thin_bar(24, 42), thin_bar(24, 42, 90)]
IMAGES = {f"{i + 1}.png": png_bytes(layer) for i, layer in enumerate(LAYERS)}
GCODE = b";machineX:2\n;machineY:1\n;layerHeight:0.05\n"
MAKERS = {
    "sl1": lambda path: write_sl1(path, LAYERS),
    "goo": lambda path: write_goo(path, LAYERS),
    "cbddlp": lambda path: write_chitu(path, LAYERS, version=2, planes=4),
    "ctb": lambda path: write_chitu(path, LAYERS, magic=CTB, version=3, key=77),
    "zip": lambda path: write_zip(path, IMAGES),
    "chitubox.zip": lambda path: write_zip(path, {"run.gcode": GCODE, **IMAGES}),
    "nanodlp": lambda path: write_zip(path, {"plate.json": b'{"TotalSolidArea": 1}', "profile.json": b'{"Depth": 50}',
                                             "slicer.json": b'{"XPixelSize": 50, "YPixelSize": 50}', **IMAGES}),
    "cws": lambda path: write_zip(path, {"slice.conf": b"xppm 20\nyppm 20\nthickness 0.05\n", **IMAGES}),
}  # fmt: skip


@cache
def original(kind: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return MAKERS[kind](Path(folder, f"job.{kind}")).read_bytes()


def use(folder: Path, kind: str, data: bytes) -> None:
    """Read, correct and rewrite a file; LayerfixError is an answer."""
    path = folder / f"job.{kind}"
    path.write_bytes(data)
    try:
        stack = lf.read(path, pixel_mm=0.05, layer_mm=0.05).with_workers(1)
        lf.write(folder / f"out.{kind}", lf.correct(stack, min_feature_mm=0.3, mode="add_only"), force=True)
    except LayerfixError:
        pass


@pytest.mark.parametrize("kind", MAKERS)
def test_an_unharmed_file_is_read_and_rewritten(tmp_path, kind):
    """The starting point of the fuzzing is sound: nothing is refused."""
    path = tmp_path / f"job.{kind}"
    path.write_bytes(original(kind))
    stack = lf.read(path, pixel_mm=0.05, layer_mm=0.05)
    lf.write(tmp_path / f"out.{kind}", lf.correct(stack, min_feature_mm=0.3, mode="add_only"))
    assert len(lf.read(tmp_path / f"out.{kind}", pixel_mm=0.05, layer_mm=0.05)) == 3


@pytest.mark.parametrize("kind", MAKERS)
@settings(max_examples=60, derandomize=True, deadline=None)
@given(data=st.data())
def test_bytes_that_were_changed_anywhere(kind, data):
    """Up to four places overwritten, with anything or with numbers that are large, and the end cut off."""
    raw = bytearray(original(kind))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw) - 1))
        new = data.draw(
            st.one_of(st.binary(min_size=1, max_size=4), st.sampled_from([b"\xff" * 4, bytes(4), b"\x7f"]))
        )
        raw[at : at + len(new)] = new
    cut = data.draw(st.one_of(st.none(), st.integers(0, len(raw))))
    with tempfile.TemporaryDirectory() as folder:
        use(Path(folder), kind, bytes(raw[:cut]))


@pytest.mark.parametrize("kind", ["jobs", "meshes", "printers", "gcode"])
def test_files_changed_where_it_matters(tmp_path, kind):
    """Entries, chunks, numbers, words replaced by such as hurt, in every kind of file: LayerfixError or a result."""
    seeds.write(kind, tmp_path / "seeds")
    originals = [(path.suffix, path.read_bytes()) for path in sorted((tmp_path / "seeds").iterdir())]
    for number in range(120):
        rng = random.Random(number)
        suffix, data = rng.choice(originals)
        for _ in range(rng.choice([1, 1, 2, 4])):
            data = structure.changed(data, rng)
        kept = suffix.removesuffix("_ascii") if kind == "meshes" else seeds.SUFFIX_OF[kind](data)
        path = tmp_path / f"input{kept}"
        path.write_bytes(data[:300_000])
        with suppress(LayerfixError):
            seeds.USES[kind](path)


@settings(max_examples=100, derandomize=True, deadline=None)
@given(
    head=st.sampled_from([original("goo")[:200], original("ctb")[:112], b"PK\3\4", b""]), rest=st.binary(max_size=300)
)
def test_a_good_beginning_and_anything_after_it(head, rest):
    """A magic number alone makes no job."""
    with tempfile.TemporaryDirectory() as folder:
        use(Path(folder), "goo", head + rest)
