"""What a file holds decides how it is read; units and scales; places that are no files."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from layerfix import load_mesh
from layerfix.errors import InputError
from layerfix.mesh.load import KINDS, SUFFIXES, recognised
from layerfix.units import parse_scale
from tests.making import box, write_stl
from tests.test_mesh import model_xml
from tests.test_read_3mf import obj, zipped
from tests.test_read_gltf import plain
from tests.test_read_stl import ascii_stl, binary
from tests.test_read_text_meshes import OBJ, QUADS, ply

CONTENTS = {
    "STL": lambda: binary(),
    "ASCII": lambda: ascii_stl().encode(),
    "OBJ": lambda: OBJ.encode(),
    "glTF": lambda: plain().glb(),
    "PLY": lambda: ply("ascii", QUADS),
    "OFF": lambda: b"OFF 3 1 0 0 0 0 9 0 0 0 9 1 3 0 1 2",
}


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".zip", ".txt", ""])
@pytest.mark.parametrize("kind", CONTENTS)
def test_the_content_decides(tmp_path, kind, suffix):
    """Whatever it is called: a binary STL called .obj is an STL, an OBJ called .stl an OBJ."""
    path = tmp_path / f"part{suffix}"
    path.write_bytes(CONTENTS[kind]())
    assert recognised(path).name == kind.replace("ASCII", "STL")
    assert load_mesh(path).name == path.name


def test_a_3mf_by_any_name(tmp_path):
    """It is a zip with a model in it."""
    path = zipped(tmp_path / "part.stl", model_xml(obj(1, box([0, 0, 0], [5, 5, 5])), '<item objectid="1"/>'))
    assert recognised(path).name == "3MF"
    assert load_mesh(path).volume_mm3 == pytest.approx(125)


def test_every_suffix_belongs_to_a_kind():
    """And to one only."""
    assert sorted(SUFFIXES) == sorted(suffix for kind in KINDS for suffix in kind.suffixes)


def test_what_is_no_file_is_said(tmp_path):
    """A folder, a pipe, a device, nothing: without opening any of them."""
    os.mkfifo(tmp_path / "pipe.stl")
    for path, words in (
        (tmp_path, "is a folder"),
        (tmp_path / "pipe.stl", "a device or a pipe"),
        (tmp_path / "none.stl", "no such file"),
        (Path("/dev/zero"), "a device or a pipe"),
    ):
        with pytest.raises(InputError, match=words):
            load_mesh(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1:87", 1 / 87),
        ("50%", 0.5),
        ("2", 2.0),
        ("0.5", 0.5),
        (" 1 : 2.5 ", 0.4),
        ("10:1", 10.0),
        (".5", 0.5),
        ("120 %", 1.2),
    ],
)
def test_scales(text, value):
    """As model makers, programs and people write them."""
    assert parse_scale(text) == pytest.approx(value)


@pytest.mark.parametrize(
    "text", ["", "0", "0%", "1:0", "-1", "half", "1:2:3", "50%%", "1e3", "1/87", "nan", "9" * 400, "1:"]
)
def test_what_is_no_scale(text):
    """The message repeats it and says what would do."""
    with pytest.raises(InputError, match=r"is not a (usable )?scale"):
        parse_scale(text)


def test_a_scale_makes_the_part_larger_or_smaller(tmp_path):
    """After the unit, before it is asked whether the size can be."""
    house = write_stl(tmp_path / "house.stl", box([0, 0, 0], [8700, 5000, 4000]))
    with pytest.raises(InputError, match="huge"):
        load_mesh(house)
    assert load_mesh(house, scale=parse_scale("1:87")).size_mm[0] == pytest.approx(100)
    assert load_mesh(house, unit="um", scale=10).size_mm[0] == pytest.approx(87)
    with pytest.raises(InputError, match="at 100 times its size"):
        load_mesh(house, scale=100)
    for wrong in (0, -1, float("nan"), float("inf")):
        with pytest.raises(InputError, match="scale"):
            load_mesh(house, scale=wrong)
