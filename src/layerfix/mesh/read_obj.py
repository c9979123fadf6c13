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
from typing import BinaryIO

import numpy as np

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.mesh.reading import Read, fans, is_number, several, shown, unreadable
from layerfix.mesh.triangles import Mesh

LEFT_OUT = {
    b"p": "point",
    b"l": "line",
    b"curv": "curve",
    b"curv2": "curve",
    b"surf": "free-form surface",
    b"call": "other file",
}
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+[-+.\d]", re.MULTILINE)


def recognises(head: bytes, size: int) -> bool:
    """Text with a vertex line."""
    return b"\0" not in head and bool(_VERTEX.search(head.replace(b"\r", b"\n")))


def read(path: Path) -> Read:
    """Every face of every object and group; OBJ says no unit. Raises InputError for what cannot be read as such."""
    with reading(path), path.open("rb") as file:
        points, counts, corners, left_out = _parse(path, file)
    if not len(counts):
        raise InputError(f"{path}: the mesh has no triangles")
    triangles = fans(np.frombuffer(counts, np.int64), np.frombuffer(corners, np.int64))
    vertices = np.frombuffer(points).reshape(-1, 3)
    notes = [f"{several(count, kind)} left out" for kind, count in left_out.items()]
    if len(triangles) and triangles.max() >= len(vertices):
        raise unreadable(path, "OBJ", f"a face names vertex {triangles.max() + 1} of {len(vertices)}")
    return Read(Mesh(vertices, triangles.astype(np.int32), path.name, tuple(notes)), None)


def _parse(path: Path, file: BinaryIO) -> tuple[array[float], array[int], array[int], Counter[str]]:
    """(x y z of all vertices, corners of each face, vertex numbers from 0 of all corners, what is no face)."""
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
            elif words[0] == b"f" or words[0] == b"fo":
                vertices = len(points) // 3
                for word in words[1:]:
                    index = int(word.partition(b"/")[0])
                    if not index or index < -vertices:
                        raise unreadable(path, "OBJ", f"line {number} names vertex {index} of {vertices}, from 1")
                    corners.append(index - 1 if index > 0 else vertices + index)
                counts.append(len(words) - 1)
            elif words[0] in LEFT_OUT:
                left_out[LEFT_OUT[words[0]]] += 1
        except (ValueError, OverflowError) as problem:
            wrong = next((w for w in words[1:] if not is_number(w.partition(b"/")[0])), None)
            reason = (
                f"has '{shown(wrong)}', which is no number" if wrong else "is not complete, or a number is too large"
            )
            raise unreadable(path, "OBJ", f"line {number} {reason}") from problem
    return points, counts, corners, left_out


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
