"""STL files, binary and ASCII, as they are rather than as they should be.

Binary: 80 bytes of header, the count of triangles, 50 bytes each. Programs write wrong counts, put "solid" into the
header, append bytes of their own or further solids. What PrusaSlicer reads is read: whatever the count says, if whole
triangles fill the file; and ASCII up to the last whole facet. The rest is told or refused.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.mesh.reading import LONGEST_NUMBER, MOST_TRIANGLES, Read, is_number, several, shown, unreadable
from layerfix.mesh.triangles import STL_RECORD, Mesh

PREAMBLE = 84  # bytes before the first triangle
RECORDS = 1 << 17  # of a binary file that are held at once: 6.5 MB
TEXT_BYTES = 8 << 20  # of an ASCII file that are held at once


_BEGINS = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:solid|facet)\b", re.IGNORECASE)
_NAMES = re.compile(rb"^[ \t]*(?:end)?solid\b[^\r\n]*", re.IGNORECASE | re.MULTILINE)
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_END = b"endfacet"


def recognises(head: bytes, size: int) -> bool:
    """A count that fits the file's size, whatever the header says; or text that begins as ASCII STL does."""
    if size >= PREAMBLE + STL_RECORD.itemsize and len(head) >= PREAMBLE:
        (count,) = struct.unpack_from("<I", head, 80)
        if size == PREAMBLE + count * STL_RECORD.itemsize:
            return True
    return _is_text(head) and b"facet" in head.lower()


def _is_text(head: bytes) -> bool:
    """ASCII STL: it begins with "solid" (or at once with "facet"), and holds no zero bytes among its first facets."""
    return bool(_BEGINS.match(head)) and b"\0" not in head[:512]


def read(path: Path) -> Read:
    """Every triangle of every solid; STL says no unit. Raises InputError for what cannot be read as such."""
    with reading(path), path.open("rb") as file:
        head = file.read(16384)
        size = path.stat().st_size
        if not head:
            raise unreadable(path, "STL", "the file is empty")
        binary = size >= PREAMBLE and size == PREAMBLE + struct.unpack_from("<I", head, 80)[0] * STL_RECORD.itemsize
        if not binary and _is_text(head):
            vertices, faces, notes = _read_text(path, file)
        else:
            vertices, faces, notes = _read_binary(path, file, size)
    if not len(faces):
        raise InputError(f"{path}: the mesh has no triangles")
    return Read(Mesh(vertices, faces, path.name, tuple(notes)), None)


def _read_binary(path: Path, file: BinaryIO, size: int) -> tuple[NDArray[np.float64], NDArray[np.int32], list[str]]:
    file.seek(0)
    from layerfix.mesh.weld import Welder  # brings numba, which to recognise a file takes not

    solids, notes = _solids(path, file, size)
    total = sum(count for _, count in solids)
    if total > MOST_TRIANGLES:
        raise unreadable(path, "STL", f"{total} triangles; at most {MOST_TRIANGLES} can be handled")
    welder, faces, done = Welder(total), np.empty((total, 3), np.int32), 0
    for start, count in solids:
        file.seek(start)
        while count:
            records = np.fromfile(file, STL_RECORD, min(count, RECORDS))
            if not len(records):
                raise unreadable(path, "STL", "the file became shorter while it was read")
            corners = np.ascontiguousarray(records["corners"]).reshape(-1, 3)
            faces[done : done + len(records)] = welder.add(corners).reshape(-1, 3)
            done += len(records)
            count -= len(records)
    return welder.vertices(), faces, notes


def _solids(path: Path, file: BinaryIO, size: int) -> tuple[list[tuple[int, int]], list[str]]:
    """(where its triangles start, how many) of each solid in a binary file, and what does not add up."""
    if b"\0" not in file.read(512) or size < PREAMBLE:
        raise unreadable(path, "STL", "neither ASCII, which begins with 'solid', nor binary")
    solids: list[tuple[int, int]] = []
    start = 0
    while True:
        file.seek(start + 80)
        (says,) = struct.unpack("<I", file.read(4))
        there, left = divmod(size - start - PREAMBLE, STL_RECORD.itemsize)
        if says == there and not left:
            return [*solids, (start + PREAMBLE, there)], []
        if says < there or (says == there and left):  # something follows: another solid, or bytes of some program
            after = start + PREAMBLE + says * STL_RECORD.itemsize
            if says and _another(file, after, size):
                solids.append((start + PREAMBLE, says))
                start = after
                continue
            if left == 0:  # as PrusaSlicer reads it: all that is there
                note = f"the file says {says} triangles and has {there}: all of them were read"
                return [*solids, (start + PREAMBLE, there)], [note]
            if not says:
                raise unreadable(path, "STL", f"it says 0 triangles and goes on for {size - start - PREAMBLE} bytes")
            note = f"{several(size - after, 'byte')} after the last triangle left out"
            return [*solids, (start + PREAMBLE, says)], [note]
        if left or not there:
            raise unreadable(path, "STL", f"cut short: it says {says} triangles, and {there} are whole")
        note = f"the file says {says} triangles and has {there}: it may have been cut short"
        return [*solids, (start + PREAMBLE, there)], [note]


def _another(file: BinaryIO, start: int, size: int) -> bool:
    """Whether a whole solid begins here, after another one."""
    if start + PREAMBLE + STL_RECORD.itemsize > size:
        return False
    file.seek(start + 80)
    (says,) = struct.unpack("<I", file.read(4))
    stop = start + PREAMBLE + int(says) * STL_RECORD.itemsize
    return says > 0 and (stop == size or (stop < size and _another(file, stop, size)))


def _read_text(path: Path, file: BinaryIO) -> tuple[NDArray[np.float64], NDArray[np.int32], list[str]]:
    """All whole facets; white space is white space, so that lone CR and a file of one line will do."""
    file.seek(0)
    corners: list[NDArray[np.float64]] = []
    facets, rest = 0, b""
    while block := file.read(TEXT_BYTES):
        text = (rest + block).replace(b"\r", b"\n")
        stop = text.lower().rfind(_END) + len(_END)
        if stop >= len(_END):
            corners.append(_corners(path, text[:stop], facets))
            facets += len(corners[-1]) // 3
            text = text[stop:]
        if len(text) > 2 * TEXT_BYTES:
            raise unreadable(path, "STL", f"no 'endfacet' in {len(text)} bytes after facet {facets}")
        rest = text
    words = rest.lower()
    if not facets and b"vertex" in words:
        raise unreadable(path, "STL", "cut short within its first facet")
    if not facets:
        raise InputError(f"{path}: the mesh has no triangles")
    return np.concatenate(corners), np.arange(3 * facets, dtype=np.int32).reshape(-1, 3), _end_of_text(words, facets)


def _end_of_text(words: bytes, facets: int) -> list[str]:
    """What to tell of the text after the last whole facet, which should be the end of the solid and nothing more."""
    after = words[words.rfind(b"endsolid") + 8 :] if b"endsolid" in words else words
    if b"endsolid" in words and b"facet" not in after:
        return []
    lost = " and what follows was left out" if after.strip(b" \t\n\0") else ""
    return [f"the file ends without 'endsolid' after {several(facets, 'facet')}{lost}: it may have been cut short"]


def _corners(path: Path, text: bytes, before: int) -> NDArray[np.float64]:
    """(3 n, 3) corners of the n facets in a text that ends with one; `before` facets came before."""
    facets = text.lower().count(_END)
    found = _VERTEX.findall(text)
    if len(found) != 3 * facets:
        found = _VERTEX.findall(_NAMES.sub(b"", text))  # a solid called "vertex and so on"
    if len(found) != 3 * facets:
        counts = [piece.count(b"vertex") for piece in text.lower().split(_END)[:-1]]
        wrong = next((k for k, count in enumerate(counts) if count != 3), 0)
        raise unreadable(
            path, "STL", f"facet {before + wrong} has {several(counts[wrong], 'vertex', 'vertices')} instead of 3"
        )
    numbers = [number for corner in found for number in corner]
    if len(max(numbers, key=len, default=b"")) <= LONGEST_NUMBER:
        try:
            return np.array(numbers, "S").astype(np.float64).reshape(-1, 3)
        except ValueError:
            pass  # named below
    wrong = next(k for k, number in enumerate(numbers) if not is_number(number))
    raise unreadable(
        path, "STL", f"facet {before + wrong // 9} has a coordinate '{shown(numbers[wrong])}', which is no number"
    )
