"""Wavefront OBJ: vertices and polygons. Format: Wavefront's Appendix B1, "Object Files".

Our own reader, because trimesh's (4.12, 5.2) loses faces of blocks whose negative indices come after the next block's
vertices, and refuses tabs.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.mesh.bodies import NO_COLOUR, Bodies, bodies_of, of_corners
from layerfix.mesh.reading import Read, fans, is_number, several, shown, unreadable
from layerfix.mesh.triangles import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

LEFT_OUT = {
    b"p": "point",
    b"l": "line",
    b"curv": "curve",
    b"curv2": "curve",
    b"surf": "free-form surface",
    b"call": "other file",
}
MOST_MTL_BYTES = 1 << 20
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+[-+.\d]", re.MULTILINE)


def recognises(head: bytes, size: int) -> bool:
    """Text with a vertex line."""
    return b"\0" not in head and bool(_VERTEX.search(head.replace(b"\r", b"\n")))


def read(path: Path) -> Read:
    """Every face of every object and group; OBJ says no unit. Raises InputError for what cannot be read as such."""
    with reading(path), path.open("rb") as file:
        points, counts, corners, left_out, looks = _parse(path, file)
    if not len(counts):
        raise InputError(f"{path}: the mesh has no triangles")
    number = np.frombuffer(counts, np.int64)
    triangles = fans(number, np.frombuffer(corners, np.int64))
    vertices = np.frombuffer(points).reshape(-1, 3)
    notes = [f"{several(count, kind)} left out" for kind, count in left_out.items()]
    if len(triangles) and triangles.max() >= len(vertices):
        raise unreadable(path, "OBJ", f"a face names vertex {triangles.max() + 1} of {len(vertices)}")
    order, bodies = looks.bodies(path, number, triangles, len(vertices))
    return Read(Mesh(vertices, triangles[order].astype(np.int32), path.name, tuple(notes), bodies=bodies), None)


class _Looks:
    """Names and colours of an OBJ while it is read: from which face on an object and a material hold."""

    def __init__(self) -> None:
        self.objects: list[tuple[int, str]] = []
        self.groups: list[tuple[int, str]] = []
        self.materials: list[tuple[int, str]] = []
        self.libraries: list[str] = []
        self.colours = array("d")  # of vertices that have one
        self.coloured = array("q")  # their numbers

    def bodies(
        self, path: Path, counts: NDArray[np.int64], triangles: NDArray[np.int64], vertices: int
    ) -> tuple[NDArray[np.int64], Bodies | None]:
        """(order of the triangles in which bodies follow each other, the bodies). Objects, or groups without them."""
        each = np.maximum(counts - 2, 0)
        face = np.repeat(np.arange(len(counts)), each)
        named = self.objects if len({name for _, name in self.objects}) > 1 else self.groups
        names, of = _by_name(named, face)
        order = np.argsort(of, kind="stable")
        sizes = np.bincount(of, minlength=len(names)).tolist()
        colours = self._colours(path, face, triangles, vertices)[order]
        parts = np.split(colours, np.cumsum(sizes)[:-1])
        return order, bodies_of(sizes, names, parts)

    def _colours(
        self, path: Path, face: NDArray[np.int64], triangles: NDArray[np.int64], vertices: int
    ) -> NDArray[np.int32]:
        names, of = _by_name(self.materials, face)
        known = _materials(path, self.libraries) if self.materials else {}
        colours = np.array([known.get(name, NO_COLOUR) for name in names], np.int32)[of]
        if len(self.coloured):
            of_vertices, has = np.zeros((vertices, 3)), np.zeros(vertices, np.bool_)
            of_vertices[np.frombuffer(self.coloured, np.int64)] = np.frombuffer(self.colours).reshape(-1, 3)
            has[np.frombuffer(self.coloured, np.int64)] = True
            painted = has[triangles[:, 0]]
            colours[painted] = of_corners(of_vertices, triangles[painted])
        return colours


def _by_name(named: list[tuple[int, str]], face: NDArray[np.int64]) -> tuple[list[str], NDArray[np.int64]]:
    """(names, which of them each of `face` has): what is named twice is one; before the first, the name is ""."""
    starts = np.array([start for start, _ in named], np.int64)
    numbers: dict[str, int] = {}
    numbered = np.array([numbers.setdefault(name, len(numbers)) for _, name in [(0, ""), *named]], np.int64)
    return list(numbers), numbered[np.searchsorted(starts, face, side="right")]


def _materials(path: Path, libraries: list[str]) -> dict[str, int]:
    """Diffuse colours (Kd) by material, from files beside the OBJ; what is not there or elsewhere says nothing."""
    found: dict[str, int] = {}
    for library in libraries:
        file = path.parent / library
        if Path(library).name != library or not file.is_file() or file.stat().st_size > MOST_MTL_BYTES:
            continue
        name = ""
        for line in file.read_bytes().decode("utf-8", "replace").splitlines():
            words = line.split()
            if words[:1] == ["newmtl"]:
                name = " ".join(words[1:])
            elif words[:1] == ["Kd"] and len(words) >= 4 and all(is_number(w.encode()) for w in words[1:4]):
                rgb = [round(255 * min(max(float(w), 0.0), 1.0)) for w in words[1:4]]
                found[name] = rgb[0] << 16 | rgb[1] << 8 | rgb[2]
    return found


def _parse(path: Path, file: BinaryIO) -> tuple[array[float], array[int], array[int], Counter[str], _Looks]:
    """(x y z of all vertices, corners of each face, vertex numbers from 0 of all corners, what is no face, names)."""
    looks = _Looks()
    points, counts, corners = array("d"), array("q"), array("q")
    left_out: Counter[str] = Counter()
    for number, line in _lines(file):
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == b"v":
                x, y, z = words[1:4]
                points.extend((float(x), float(y), float(z)))
                if len(words) == 7:
                    looks.colours.extend(map(float, words[4:7]))
                    looks.coloured.append(len(points) // 3 - 1)
            elif words[0] == b"f" or words[0] == b"fo":
                vertices = len(points) // 3
                for word in words[1:]:
                    index = int(word.partition(b"/")[0])
                    if not index or index < -vertices:
                        raise unreadable(path, "OBJ", f"line {number} names vertex {index} of {vertices}, from 1")
                    corners.append(index - 1 if index > 0 else vertices + index)
                counts.append(len(words) - 1)
            elif words[0] in (b"o", b"g"):
                named = looks.objects if words[0] == b"o" else looks.groups
                named.append((len(counts), b" ".join(words[1:]).decode("utf-8", "replace")))
            elif words[0] == b"usemtl":
                looks.materials.append((len(counts), b" ".join(words[1:]).decode("utf-8", "replace")))
            elif words[0] == b"mtllib":
                looks.libraries.append(b" ".join(words[1:]).decode("utf-8", "replace"))
            elif words[0] in LEFT_OUT:
                left_out[LEFT_OUT[words[0]]] += 1
        except (ValueError, OverflowError) as problem:
            wrong = next((w for w in words[1:] if not is_number(w.partition(b"/")[0])), None)
            reason = (
                f"has '{shown(wrong)}', which is no number" if wrong else "is not complete, or a number is too large"
            )
            raise unreadable(path, "OBJ", f"line {number} {reason}") from problem
    return points, counts, corners, left_out, looks


def _lines(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """(number from 1, text) of each line without its comment; lines that end with a backslash go on in the next."""
    whole = b""
    for number, raw in enumerate(_separated(file), 1):
        line = raw.partition(b"#")[0].rstrip() if b"#" in raw else raw.rstrip()
        if line.endswith(b"\\"):
            whole += line[:-1] + b" "
            continue
        yield number, whole + line if whole else line
        whole = b""
    if whole:
        yield number, whole


def _separated(file: BinaryIO) -> Iterator[bytes]:
    """Lines ended by LF, CR LF or a lone CR."""
    for line in file:
        if b"\r" in line[:-2]:
            yield from line.rstrip(b"\r\n").split(b"\r")
        else:
            yield line
