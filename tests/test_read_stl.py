"""STL as programs write it: wrong counts, bytes after the end, several solids, odd line ends, files cut short."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix import load_mesh
from layerfix.errors import InputError
from layerfix.mesh import read_stl
from layerfix.mesh.triangles import Mesh, stl_header, stl_triangles
from layerfix.mesh.weld import Welder
from tests.making import box, environment, joined, sphere

BOX = box([0, 0, 0], [20, 10, 5])
VOLUME = 1000.0


def binary(mesh: Mesh = BOX, count: int | None = None) -> bytes:
    """A binary STL that says it has so many triangles."""
    head = stl_header("a part", len(mesh.faces) if count is None else count)
    return head + stl_triangles(mesh.vertices[mesh.faces]).tobytes()


def ascii_stl(mesh: Mesh = BOX, name: str = "a part", newline: str = "\n") -> str:
    """An ASCII STL with one solid."""
    lines = [f"solid {name}"]
    for corners in mesh.vertices[mesh.faces]:
        vertices = [f"      vertex {x:g} {y:g} {z:g}" for x, y, z in corners]
        lines += ["  facet normal 0 0 0", "    outer loop", *vertices, "    endloop", "  endfacet"]
    return newline.join([*lines, f"endsolid {name}", ""])


def loaded(path: Path, data: bytes | str) -> Mesh:
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return load_mesh(path)


# Binary ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "note"),
    [(12, None), (99, "the file says 99 triangles and has 12: it may have been cut short"),
     (5, "the file says 5 triangles and has 12: all of them were read"),
     (0, "the file says 0 triangles and has 12: all of them were read"),
     (2**32 - 1, "the file says 4294967295 triangles and has 12: it may have been cut short")],
)  # fmt: skip
def test_a_wrong_count_is_told_and_all_triangles_are_read(tmp_path, count, note):
    """As PrusaSlicer reads it: whole triangles that fill the file all count."""
    mesh = loaded(tmp_path / "part.stl", binary(count=count))
    assert mesh.volume_mm3 == pytest.approx(VOLUME)
    assert mesh.notes == ((note,) if note else ())


@pytest.mark.parametrize("extra", [b"x", b"made by a program\r\n", bytes(49), bytes(51), bytes(1000 + 17)])
def test_bytes_after_the_last_triangle_are_counted(tmp_path, extra):
    """They are not read, and the note says how many there are."""
    mesh = loaded(tmp_path / "part.stl", binary() + extra)
    assert (len(mesh.faces), mesh.volume_mm3) == (12, pytest.approx(VOLUME))
    assert mesh.notes == (f"{len(extra)} byte{'s' * (len(extra) > 1)} after the last triangle left out",)


@pytest.mark.parametrize("solids", [2, 3])
def test_binary_solids_one_after_the_other_all_count(tmp_path, solids):
    """Each with a header and a count of its own."""
    data = b"".join(binary(BOX.moved([30 * k, 0, 0])) for k in range(solids))
    mesh = loaded(tmp_path / "part.stl", data)
    assert mesh.volume_mm3 == pytest.approx(solids * VOLUME)
    assert mesh.notes == ()


@pytest.mark.parametrize("lost", [1, 7, 49, 51, 99, 549])
def test_a_binary_file_cut_within_a_triangle_is_refused(tmp_path, lost):
    """The message says how many triangles were promised and how many are whole."""
    whole = (600 - lost) // 50
    with pytest.raises(InputError, match=rf"part\.stl: .*cut short: it says 12 triangles, and {whole} are whole"):
        loaded(tmp_path / "part.stl", binary()[:-lost])


@pytest.mark.parametrize(
    "data", [stl_header("nothing", 0), stl_header("nothing", 7), b"x" * 83, b"solid", b"solid\nfacet"]
)
def test_a_file_without_a_triangle(tmp_path, data):
    """84 bytes and fewer, with a count of none or of seven."""
    with pytest.raises(InputError, match=r"part\.stl"):
        loaded(tmp_path / "part.stl", data)


@pytest.mark.parametrize("header", [b"solid made by a program", b"facet normal", b"  SOLID ", bytes(80)])
def test_a_header_that_reads_like_text(tmp_path, header):
    """A count that fits the size decides, whatever the header says; without one, zero bytes do."""
    for count in (12, 99):
        data = header.ljust(80)[:80] + binary(count=count)[80:]
        assert loaded(tmp_path / "part.stl", data).volume_mm3 == pytest.approx(VOLUME)


def test_equal_corners_become_one_vertex_and_nothing_moves(tmp_path):
    """A closed mesh of m triangles has m / 2 + 2 vertices; 0.0 and -0.0 are the same; every corner keeps its bits."""
    mesh = sphere(7, 60, 30)
    read = loaded(tmp_path / "part.stl", binary(mesh))
    corners = mesh.vertices[mesh.faces].astype(np.float32)
    assert np.array_equal(read.vertices[read.faces], corners)
    assert len(read.vertices) == len(np.unique(corners.reshape(-1, 3) + 0.0, axis=0))


@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.integers(1, 400))
def test_welding_is_what_a_dictionary_does(seed, expected, count):
    """In pieces, with tables that grow: the numbers a dictionary would give, the vertices in their order."""
    rng = np.random.default_rng(seed)
    corners = rng.integers(-3, 3, (count, 3)).astype(np.float32) * np.float32(0.1)
    corners[rng.random(corners.shape) < 0.1] = np.float32(-0.0)
    welder = Welder(expected)
    welder._vertices = welder._vertices[:4].copy()  # so that everything grows
    welder._table = welder._empty_table()
    found = np.concatenate([welder.add(piece) for piece in np.array_split(corners, 3)])
    numbers: dict[tuple[float, ...], int] = {}
    for corner in corners.tolist():
        numbers.setdefault(tuple(c + 0.0 for c in corner), len(numbers))
    assert found.tolist() == [numbers[tuple(c + 0.0 for c in corner)] for corner in corners.tolist()]
    assert welder.vertices().tolist() == [list(key) for key in numbers]


def test_an_stl_needs_no_other_reader(tmp_path):
    """The commonest start loads neither trimesh nor what it brings along, nor an XML parser."""
    (tmp_path / "part.stl").write_bytes(binary())
    code = (
        "import sys; from layerfix import load_mesh, slice_mesh; from pathlib import Path;"
        "slice_mesh(load_mesh('part.stl'), pixel_mm=1, layer_mm=1)[0];"
        "print(*[m for m in ('trimesh', 'networkx', 'lxml', 'xml', 'shapely', 'cv2') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment(), capture_output=True, text=True
    )
    assert (done.stdout.strip(), done.stderr) == ("", "")


# ASCII -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [lambda t: t.replace("\n", "\r"), lambda t: t.replace("\n", "\r\n"), lambda t: t.replace("\n", " "), str.upper,
     lambda t: t.replace("  ", "\t"), lambda t: "\n\n  " + t, lambda t: "\ufeff" + t,
     lambda t: t.replace("facet", "Facet"),
     lambda t: t.replace("solid a part", "solid vertex 1 2 3"), lambda t: t.replace("a part", ""),
     lambda t: t.replace("20 ", "2e+01 ")],
    ids=["cr", "crlf", "one-line", "capitals", "tabs", "space-first", "bom", "Facet", "name", "no-name", "exponents"],
)  # fmt: skip
def test_ascii_in_any_layout(tmp_path, change):
    """White space is white space, words may be in capitals, the name may be anything."""
    mesh = loaded(tmp_path / "part.stl", change(ascii_stl()))
    assert mesh.volume_mm3 == pytest.approx(VOLUME)
    assert mesh.notes == ()


def test_several_ascii_solids_in_one_file(tmp_path):
    """All facets count, whatever the solids are called."""
    text = ascii_stl() + ascii_stl(BOX.moved([30, 0, 0]), "another")
    assert loaded(tmp_path / "part.stl", text).volume_mm3 == pytest.approx(2 * VOLUME)


def test_ascii_longer_than_one_piece(tmp_path, monkeypatch):
    """Facets that lie across the borders of what is read at once are whole."""
    monkeypatch.setattr(read_stl, "TEXT_BYTES", 700)
    mesh = sphere(9, 30, 14)
    assert loaded(tmp_path / "part.stl", ascii_stl(mesh)).volume_mm3 == pytest.approx(mesh.volume_mm3, rel=1e-4)


@pytest.mark.parametrize("cut", ["  facet normal 0 0 0\n    outer loop\n      vertex 1 2", "face", ""])
def test_ascii_without_its_end_is_told(tmp_path, cut):
    """Whole facets are read, as PrusaSlicer does; the note counts them and says what was left out."""
    text = ascii_stl(joined(BOX, BOX.moved([30, 0, 0])))
    whole = text[: text.rindex("endsolid")]
    mesh = loaded(tmp_path / "part.stl", whole + cut)
    assert len(mesh.faces) == 24
    lost = " and what follows was left out" if cut else ""
    assert mesh.notes == (f"the file ends without 'endsolid' after 24 facets{lost}: it may have been cut short",)


def test_a_second_solid_that_is_cut_is_told(tmp_path):
    """The first one ended well, the second did not."""
    mesh = loaded(tmp_path / "part.stl", ascii_stl() + ascii_stl()[:100])
    assert len(mesh.faces) == 12
    assert "cut short" in mesh.notes[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [(ascii_stl().replace("20 0 0", "20 x 0", 1), r"facet \d+ has a coordinate 'x', which is no number"),
     (ascii_stl().replace("20 0 0", "20,5 0 0", 1), r"a coordinate '20,5'"),
     (ascii_stl().replace("20 0 0", "9" * 5000 + " 0 0", 1), r"a coordinate '99999999999999999999…'"),
     (ascii_stl().replace("      vertex 20 10 5\n", "", 1), r"facet \d+ has 2 vertices instead of 3"),
     (ascii_stl().replace("    endloop", "      vertex 1 2 3\n    endloop", 1), "facet 0 has 4 vertices"),
     (ascii_stl()[:100], "cut short within its first facet"), ("solid x\nendsolid x\n", "no triangles"),
     ("hello, this is not a mesh\n" * 20, "neither ASCII, which begins with 'solid', nor binary")],
    ids=["word", "comma", "digits", "two", "four", "first-facet", "none", "letter"],
)  # fmt: skip
def test_what_is_wrong_with_a_text_is_said(tmp_path, text, words):
    """Which facet, and what is the matter with it."""
    with pytest.raises(InputError, match=words):
        loaded(tmp_path / "part.stl", text)


def test_a_count_is_read_as_written():
    """`recognises` holds a count against the size, and takes text with facets."""
    assert read_stl.recognises(binary()[:200], 84 + 600)
    assert not read_stl.recognises(binary()[:200], 84 + 601)
    assert read_stl.recognises(ascii_stl().encode()[:200], 9999)
    assert not read_stl.recognises(b"solid ground\n", 13)
    assert struct.unpack("<I", binary()[80:84])[0] == 12
