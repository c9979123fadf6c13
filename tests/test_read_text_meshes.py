"""OBJ, OFF and PLY in every layout that programs write: the same 10 mm cube, or a word about what is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from layerfix import load_mesh, slice_mesh
from layerfix.errors import InputError
from layerfix.mesh.records import walk
from layerfix.mesh.strips import fan_to_triangles, strips_to_triangles
from layerfix.mesh.triangles import Mesh
from tests.making import box

CUBE = box([0, 0, 0], [10, 10, 10])
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
POINTS = [" ".join(f"{c:g}" for c in point) for point in CUBE.vertices]
FACES = ["4 " + " ".join(map(str, quad)) for quad in QUADS]
U_POINTS = [(x, y, z) for z in (0, 5) for x, y in ((0, 0), (9, 0), (9, 9), (6, 9), (6, 3), (3, 3), (3, 9), (0, 9))]
U_FACES = [[7, 6, 5, 4, 3, 2, 1, 0], [8, 9, 10, 11, 12, 13, 14, 15]]
U_FACES += [[k, (k + 1) % 8, (k + 1) % 8 + 8, k + 8] for k in range(8)]


def loaded(path: Path, data: bytes | str, **options) -> Mesh:
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return load_mesh(path, **options)


def is_the_cube(mesh: Mesh, *notes: str) -> None:
    assert mesh.volume_mm3 == pytest.approx(1000)
    assert mesh.size_mm == pytest.approx((10, 10, 10))
    assert mesh.notes == notes


# OBJ ---------------------------------------------------------------------------------------------------------

OBJ = "\n".join([*(f"v {p}" for p in POINTS), *("f " + " ".join(str(k + 1) for k in quad) for quad in QUADS)])


@pytest.mark.parametrize(
    "text",
    [OBJ.replace(" ", "\t"), OBJ.replace("\n", "\r\n"), OBJ.replace("\n", "\r"), OBJ.replace("f 1 2", "f 1 \\\n 2"),
     OBJ.replace("f 1 2", "f 1 \\\r\n 2"), OBJ.replace("\n", "  # a comment\n"), OBJ.replace("\nf ", "\n  f  "),
     OBJ.replace("v 0 0 0", "v 0 0 0 0.5 0.5 1"), OBJ.replace("f 1 2 4 3", "f 1/1/1 2//2 4/3 3")],
    ids=["tabs", "crlf", "cr", "continued", "continued-crlf", "comments", "spaces", "colours", "slashes"],
)  # fmt: skip
def test_an_obj_in_any_layout(tmp_path, text):
    """Words and lines are separated by whatever separates them; a backslash goes on in the next line."""
    is_the_cube(loaded(tmp_path / "part.obj", text))


def test_negative_indices_count_back_from_their_own_line(tmp_path):
    """Two bodies, each with its vertices and then its faces: -1 is the last vertex so far, not the file's last."""
    one = "\n".join("f " + " ".join(str(k - 8) for k in quad) for quad in QUADS)
    points = ["\n".join(f"v {x + shift:g} {y:g} {z:g}" for x, y, z in CUBE.vertices) for shift in (0, 30)]
    mesh = loaded(tmp_path / "part.obj", "\n".join([points[0], one, "o next", points[1], one]))
    assert (mesh.volume_mm3, mesh.size_mm[0]) == (pytest.approx(2000), 40)


def test_points_and_lines_of_an_obj_are_counted(tmp_path):
    """They have no volume; the note says how many were left out."""
    is_the_cube(loaded(tmp_path / "part.obj", OBJ + "\nl 1 2 3\nl 2 3\np 1"), "2 lines left out", "1 point left out")


@pytest.mark.parametrize(
    ("line", "words"),
    [("f 0 1 2", "line 15 names vertex 0 of 8"), ("f -9 1 2", "line 15 names vertex -9 of 8"),
     ("f 1 2 9", "vertex 9 of 8"),
     ("v 1 2", "line 15 is not complete"), ("v 1 2 x", "line 15 has 'x'"), ("f 1 2 " + "9" * 30, "too large"),
     ("f 1 2 " + "9" * 5000, "line 15 has '99999999999999999999…'"), ("f a b c", "line 15 has 'a'")],
)  # fmt: skip
def test_a_wrong_line_of_an_obj_is_named(tmp_path, line, words):
    """By its number, with the word that is wrong."""
    with pytest.raises(InputError, match=rf"part\.obj: .*{words}"):
        loaded(tmp_path / "part.obj", OBJ + "\n" + line)


# OFF ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "lines",
    [["OFF", "8 6 0", *POINTS, *FACES], ["OFF 8 6 0", *POINTS, *FACES], [" ".join(["OFF 8 6 0", *POINTS, *FACES])],
     ["OFF", "8 6 0", *(" ".join(POINTS[k : k + 2]) for k in range(0, 8, 2)), *FACES],
     ["OFF", "8", "6", "0", *" ".join(POINTS + FACES).split()],
     ["# made", "OFF # by", "8 6 0", "", *POINTS, "# hand", *FACES], ["8 6 0", *POINTS, *FACES],
     ["COFF", "8 6 0", *(f"{p} 255 0 0 255" for p in POINTS), *FACES],
     ["COFF", "8 6 0", *(f"{p} 255 0 0" for p in POINTS), *FACES],
     ["NOFF", "8 6 0", *(f"{p} 0 0 1" for p in POINTS), *FACES],
     ["STOFF", "8 6 0", *(f"{p} 0.5 1" for p in POINTS), *FACES],
     ["CNOFF", "8 6 0", *(f"{p} 0 0 1 1 0 0 1" for p in POINTS), *FACES],
     ["OFF", "8 6 0", *POINTS, *(f"{f} 0.3 0.5 0.1" for f in FACES)],
     ["OFF", "8 6 0", *POINTS, *(f"{f} 3 255 0 9" for f in FACES)],
     ["OFF", "8 6 0", *(f"{p} 255 0 0" for p in POINTS), *(f"{f} 1" for f in FACES)],
     ["4OFF", "8 6 0", *(" ".join(f"{2 * float(c):g}" for c in p.split()) + " 2" for p in POINTS), *FACES]],
    ids=["lines", "counts-first", "one-line", "two-a-line", "a-word-a-line", "comments", "no-keyword", "rgba", "rgb",
         "normals", "textures", "colours-and-normals", "face-colours", "counted", "all-colours", "homogeneous"],
)  # fmt: skip
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_an_off_in_any_layout(tmp_path, lines, newline):
    """Words count, not lines; where colours follow, lines do."""
    is_the_cube(loaded(tmp_path / "part.off", newline.join(lines)))


def test_an_off_of_polygons_of_several_sizes(tmp_path):
    """Quads, triangles, and an edge, which is left out with a note."""
    mixed = [*FACES[:-1], "3 1 5 7", "3 1 7 3", "2 0 1"]
    is_the_cube(loaded(tmp_path / "part.off", "\n".join(["OFF", "8 8 0", *POINTS, *mixed])),
                "1 face of fewer than three corners left out")  # fmt: skip


@pytest.mark.parametrize(
    ("lines", "words"),
    [(["OFF", "8 6 0", *POINTS, *FACES[:-1]],
      "cut short: 8 vertices and 6 faces are promised, 13 lines"),
     (["OFF", "8 6 0", *POINTS, *FACES[:-1], "4 1 5"], "fewer corners than it says"),
     (["OFF", "999999999 999999999 0", *POINTS], "cut short"),
     (["OFF", "9" * 5000 + " 1 0"], "does not begin with the counts"),
     (["OFF", "8 6 0", *POINTS[:-1], "10 10 ten", *FACES], "line 8 after the counts"),
     (["OFF", "0 0 0"], "no triangles"),
     (["OFF", "8 6 0", *POINTS, *FACES[:-1], "4 1 5 7 8"], "a face names vertex 8 of 8"),
     (["OFF BINARY"], "binary form is not read"),
     (["nOFF", "5", "8 6 0"], "n dimensions are not read"),
     (["OFF", "some words"], "does not begin with the counts")],
)  # fmt: skip
def test_what_is_wrong_with_an_off_is_said(tmp_path, lines, words):
    """In one sentence that names the file."""
    with pytest.raises(InputError, match=rf"part\.off: .*{words}"):
        loaded(tmp_path / "part.off", "\n".join(lines))


# PLY ---------------------------------------------------------------------------------------------------------


def ply(kind: str, faces: list[list[int]], points=CUBE.vertices, *, count: str = "uchar", more: str = "") -> bytes:
    """A PLY of polygons; `more` is an element in front."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    head = (
        f"ply\nformat {kind} 1.0\ncomment TextureFile skin.jpg\n{more}element vertex {len(points)}\n"
        f"property float x\nproperty float y\nproperty float z\nelement face {len(faces)}\n"
        f"property list {count} int vertex_indices\nend_header\n"
    )
    if not order:
        rows = [" ".join(map(str, row)) for row in [*np.array(points).tolist(), *([len(f), *f] for f in faces)]]
        return (head + "\n".join(rows) + "\n").encode()
    size = {"uchar": "u1", "ushort": "u2", "int": "i4"}[count]
    body = b"".join(np.array([len(f)], order + size).tobytes() + np.array(f, order + "i4").tobytes() for f in faces)
    return head.encode() + np.array(points, order + "f4").tobytes() + body


KINDS = ["ascii", "binary_little_endian", "binary_big_endian"]
MIXED = [*QUADS[:-1], [1, 5, 7], [1, 7, 3]]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", ["uchar", "ushort", "int"])
@pytest.mark.parametrize("faces", [QUADS, MIXED, CUBE.faces.tolist()], ids=["quads", "mixed", "triangles"])
def test_a_ply_of_polygons(tmp_path, kind, faces, count, capfd):
    """Of one size or several, in text and both byte orders; a texture that is missing is no matter."""
    is_the_cube(loaded(tmp_path / "part.ply", ply(kind, faces, count=count)))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", KINDS)
def test_a_concave_polygon_is_filled_as_it_is(tmp_path, kind):
    """A U of 9 × 9 × 5 mm with a slot of 3 × 6: its eight-cornered ends, cut into triangles, do not fill the slot."""
    mesh = loaded(tmp_path / "part.ply", ply(kind, U_FACES, np.array(U_POINTS, float)))
    assert mesh.volume_mm3 == pytest.approx(5 * (81 - 18))
    stack = slice_mesh(mesh.transformed([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), pixel_mm=0.1, layer_mm=0.5)
    assert stack.volume_mm3() == pytest.approx(5 * (81 - 18))


@pytest.mark.parametrize("kind", KINDS)
def test_faces_of_too_few_corners_are_counted(tmp_path, kind):
    """None, one or two: no surface."""
    note = "3 faces of fewer than three corners left out"
    is_the_cube(loaded(tmp_path / "part.ply", ply(kind, [[], *QUADS, [1], [1, 2]])), note)


def test_elements_before_and_properties_beside_are_passed_over(tmp_path):
    """Cameras with lists in front of the vertices, colours beside, an element nobody knows behind."""
    text = ply("ascii", MIXED, more="element camera 2\nproperty float f\nproperty list uchar int seen\n").decode()
    head, _, body = text.partition("end_header\n")
    head = (
        head.replace("property float z\n", "property float z\nproperty uchar red\n")
        + "property uchar red\nelement q 1\nproperty int a\n"
    )
    rows = body.splitlines()
    rows = ["1.5 2 7 7", "0 0", *(f"{row} 9" for row in rows), "4"]
    is_the_cube(loaded(tmp_path / "part.ply", head + "end_header\n" + "\n".join(rows)))


def test_strips_of_a_ply(tmp_path):
    """Stanford's scans come as strips, -1 between them."""
    strips = [k for face in CUBE.faces.tolist() for k in (*face, -1)][:-1]
    text = (
        ply("ascii", [strips]).decode().replace("element face", "element tristrips").replace("list uchar", "list int")
    )
    is_the_cube(loaded(tmp_path / "part.ply", text))


@pytest.mark.parametrize("kind", KINDS)
def test_a_ply_that_is_cut_short(tmp_path, kind):
    """Wherever it is cut, it says so; what is too long is told."""
    data = ply(kind, MIXED)
    body = data.index(b"end_header") + 11
    for stop in range(body, len(data) - 2, 7):
        with pytest.raises(InputError, match=r"part\.ply.*cut short"):
            loaded(tmp_path / "part.ply", data[:stop])
    more = "2 numbers" if kind == "ascii" else "4 bytes"
    is_the_cube(loaded(tmp_path / "part.ply", data + (b"1 2" if kind == "ascii" else b"junk")),
                f"{more} after the last element left out")  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [(b"element vertex 8", b"element vertex 999999999999", "cut short"),
     (b"element face 6", b"element face -6", "negative count"),
     (b"element vertex 8", b"element vertex x", "the line 'element vertex x'"),
     (b"format ascii", b"format morse", "'format morse 1.0'"),
     (b"float z", b"float w", "vertices have x, y, w, not x, y and z"), (b"float z", b"quad z", "'property quad z'"),
     (b"end_header", b"and_header", "no end"),
     (b"10 10.0", b"10 ten", "no number"),
     (b"4 0 1 3 2", b"4 0 1 3 8", "vertex 8 of 8"),
     (b"\n0.0 0.0 0.0", b"\n0.0 nan 0.0", "1 of 8 vertices are NaN")],
)  # fmt: skip
def test_what_is_wrong_with_a_ply_is_said(tmp_path, old, new, words):
    """The line of the header, the word, or the vertex."""
    data = ply("ascii", QUADS)
    data = data.replace(b"10.0 10.0 10.0", b"10 10.0 10.0") if b"ten" in new else data
    assert old in data or b"ten" in new
    with pytest.raises(InputError, match=rf"part\.ply: .*{words}"):
        loaded(tmp_path / "part.ply", data.replace(old, new.replace(b"10 ten", b"ten 10")))


def test_records_are_walked_as_python_would():
    """Lists between values, both byte orders, counts of one to four bytes; -1 as soon as one does not fit."""
    rng = np.random.default_rng(4)
    for order, big in (("<", False), (">", True)):
        for width in (1, 2, 4):
            data, expected, at = b"", [], 0
            for _ in range(20):
                n = int(rng.integers(0, 4))
                expected.append(((at, at + 2 + width), n))
                data += bytes(2) + np.array([n], f"{order}u{width}").tobytes() + bytes(4 * n)
                at = len(data)
            shape = np.array([[0, 2], [width, 4]], np.int64)
            starts, lengths, stop = walk(np.frombuffer(data, np.uint8), 0, 20, shape, big)
            assert stop == len(data)
            assert starts.tolist() == [list(s) for s, _ in expected]
            assert lengths[:, 1].tolist() == [n for _, n in expected]
            assert walk(np.frombuffer(data[:-1], np.uint8), 0, 20, shape, big)[2] in (
                -1,
                len(data) - 1 if not n else -1,
            )


def test_strips_and_fans():
    """Every second triangle of a strip turns; -1 starts a new one; a vertex twice joins two."""
    assert strips_to_triangles(np.array([0, 1, 2, 3])).tolist() == [[0, 1, 2], [2, 1, 3]]
    assert strips_to_triangles(np.array([9, 0, 1, -1, 4, 5, 6, 7])).tolist() == [[9, 0, 1], [4, 5, 6], [6, 5, 7]]
    assert strips_to_triangles(np.array([0, 1, 2, 2, 4, 4, 5, 6])).tolist() == [[0, 1, 2], [5, 4, 6]]
    assert fan_to_triangles(np.array([7, 1, 2, 3])).tolist() == [[7, 1, 2], [7, 2, 3]]
    assert len(strips_to_triangles(np.array([1, 2]))) == len(fan_to_triangles(np.array([1, 2]))) == 0
