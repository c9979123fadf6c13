"""OFF, Geomview's "object file format": counts, vertices, polygons. Format: Geomview's manual, section 4.2.5.

The words of the file count, not its lines; only where colours of unknown number follow (any header may be followed by
them) do lines tell what belongs to what.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.mesh.reading import Read, fans, is_number, numbers, several, unreadable
from layerfix.mesh.triangles import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

_COMMENT = re.compile(rb"#[^\r\n]*")
_HEADER = re.compile(rb"\s*(ST)?(C)?(N)?(4)?(n)?OFF\b[ \t]*(BINARY)?")


def recognises(head: bytes, size: int) -> bool:
    """The keyword, after comments; files without it (it may be left out) are known by their name alone."""
    return bool(_HEADER.match(_COMMENT.sub(b"", head)))


def read(path: Path) -> Read:
    """Every polygon; OFF says no unit. Raises InputError for what cannot be read as such."""
    with reading(path):
        text = _COMMENT.sub(b"", path.read_bytes())
    header = _HEADER.match(text)
    st, colour, normal, four, dimension, binary = header.groups() if header else (None,) * 6
    if binary or dimension:
        raise unreadable(
            path, "OFF", "the binary form is not read" if binary else "points of n dimensions are not read"
        )
    body = text[header.end() :] if header else text
    words = body.split(None, 3)
    if len(words) < 3 or not all(word.isdigit() and len(word) < 12 for word in words[:3]):
        raise unreadable(path, "OFF", "it does not begin with the counts of vertices, faces and edges")
    points, faces = int(words[0]), int(words[1])
    if not faces or not points:
        raise InputError(f"{path}: the mesh has no triangles")
    rest = words[3] if len(words) > 3 else b""
    if 2 * (3 * points + 2 * faces) > len(rest) + 1:
        raise unreadable(path, "OFF", f"cut short: {points} vertices and {faces} faces are promised")
    widths = [3 + bool(four) + 3 * bool(normal) + colours + 2 * bool(st) for colours in ((4, 3) if colour else (0,))]
    found = next((f for w in widths if (f := _by_words(rest, points, faces, w)) is not None), None)
    vertices, counts, corners = found or _by_lines(path, rest, points, faces)
    if four:
        vertices = np.column_stack([vertices[:, :3] / vertices[:, 3:4], vertices])
    if len(corners) and not 0 <= corners.min() <= corners.max() < points:
        wrong = corners.min() if corners.min() < 0 else corners.max()
        raise unreadable(path, "OFF", f"a face names vertex {wrong} of {points}")
    few = int(np.count_nonzero(counts < 3))
    notes = (f"{several(few, 'face')} of fewer than three corners left out",) if few else ()
    return Read(Mesh(vertices[:, :3], fans(counts, corners).astype(np.int32), path.name, notes), None)


def _by_words(
    text: bytes, points: int, faces: int, width: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]] | None:
    """(vertices, corners of each face, their vertices) if the words come to exactly that, without faces' colours."""
    try:
        values = numbers(text)
    except ValueError:
        return None
    vertices, rest = values[: points * width], values[points * width :]
    if (
        len(vertices) < points * width
        or not len(rest)
        or (rest != np.floor(rest)).any()
        or np.abs(rest).max() > 2**31
    ):
        return None
    indices = rest.astype(np.int64)
    corners = int(indices[0])
    if corners > 0 and len(indices) == faces * (corners + 1) and (indices[:: corners + 1] == corners).all():
        counts = np.full(faces, corners)
    else:
        starts, at, flat = [], 0, indices.tolist()
        while at < len(flat) and flat[at] > 0:
            starts.append(at)
            at += flat[at] + 1
        if at != len(flat) or len(starts) != faces:
            return None
        counts = indices[starts]
    places = np.ones(len(indices), np.bool_)
    places[np.cumsum(counts + 1) - counts - 1] = False
    return vertices.reshape(points, width), counts, indices[places]


def _by_lines(
    path: Path, text: bytes, points: int, faces: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """The same of a file with a vertex or face in each line, and anything after it."""
    lines = [words for line in text.replace(b"\r", b"\n").split(b"\n") if (words := line.split())]
    if len(lines) < points + faces:
        raise unreadable(
            path, "OFF", f"cut short: {points} vertices and {faces} faces are promised, {len(lines)} lines are there"
        )
    try:
        width = min(4, *map(len, lines[:points]))
        vertices = np.array([line[:width] for line in lines[:points]], "S").astype(np.float64)
        polygons = [[int(word) for word in line[: int(line[0]) + 1]] for line in lines[points : points + faces]]
    except ValueError as problem:
        wrong = next((k for k, line in enumerate(lines) if not all(map(is_number, line[:3]))), points)
        raise unreadable(path, "OFF", f"line {wrong + 1} after the counts is not a vertex or a face") from problem
    if any(len(polygon) != polygon[0] + 1 for polygon in polygons):
        raise unreadable(path, "OFF", "a face has fewer corners than it says; the file may be cut short")
    corners = np.array([corner for polygon in polygons for corner in polygon[1:]], np.int64)
    return vertices, np.array([polygon[0] for polygon in polygons], np.int64), corners
