"""PLY, the Stanford polygon format, ASCII and binary of both byte orders, with polygons of any size, and strips.

Our own reader, because trimesh's (4.12, 5.2) takes every face of a binary file to have as many corners as the first,
fills concave polygons, and looks for textures. Format: G. Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.mesh.bodies import bodies_of, of_corners
from layerfix.mesh.reading import Read, fans, numbers, several, unreadable
from layerfix.mesh.strips import strips_to_triangles
from layerfix.mesh.triangles import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
RGB = ("red", "green", "blue")
INDICES = ("vertex_indices", "vertex_index")
LONGEST_HEADER = 1 << 20


class Property(NamedTuple):
    """One property: its type, and that of the count before it where it is a list."""

    name: str
    kind: str
    counted_by: str | None


class Element(NamedTuple):
    """One kind of record and how many of them there are."""

    name: str
    number: int
    properties: list[Property]


Lists = tuple["NDArray[np.int64]", "NDArray[np.int64]"]  # how many of each record, all of them one after the other


def recognises(head: bytes, size: int) -> bool:
    """The magic word in a line of its own."""
    return head[:3] == b"ply" and head[3:4] in (b"\n", b"\r")


def read(path: Path) -> Read:
    """Every face and strip; PLY says no unit. Raises InputError for what cannot be read as such."""
    with reading(path):
        data = path.read_bytes()
    order, elements, start = _header(path, data)
    body = _Words(data[start:]) if not order else _Bytes(data, start, order)
    vertices: NDArray[np.float64] | None = None
    colours: NDArray[np.float64] | None = None
    triangles: list[NDArray[np.int64]] = []
    few = 0
    for element in elements:
        names = [p.name for p in element.properties]
        if element.name == "vertex":
            if not {"x", "y", "z"} <= set(names):
                raise unreadable(path, "PLY", f"vertices have {', '.join(names) or 'no properties'}, not x, y and z")
            coloured = set(RGB) <= set(names)
            columns = body.scalars(element, ("x", "y", "z", *(RGB if coloured else ())))
            vertices = np.ascontiguousarray(columns[:, :3])
            if coloured:
                whole = next(p.kind for p in element.properties if p.name == "red")[:1] in "iu"
                colours = columns[:, 3:] / (255 if whole else 1)
        elif element.name in ("face", "tristrips") and (
            index := next((p.name for p in element.properties if p.name in INDICES and p.counted_by), None)
        ):
            counts, corners = body.lists(element, index)
            if element.name == "tristrips":
                triangles.append(strips_to_triangles(corners))
            else:
                triangles.append(fans(counts, corners))
                few = int(np.count_nonzero(counts < 3))
        else:
            body.skip(element)
    if vertices is None or not sum(map(len, triangles)):
        raise InputError(f"{path}: the mesh has no triangles")
    faces = np.concatenate(triangles)
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise unreadable(path, "PLY", f"a face names vertex {wrong} of {len(vertices)}")
    notes = [f"{several(few, 'face')} of fewer than three corners left out"] if few else []
    if body.left():
        notes.append(f"{body.left()} after the last element left out")
    bodies = None if colours is None else bodies_of([len(faces)], [""], [of_corners(colours, faces)])
    return Read(Mesh(vertices, faces.astype(np.int32), path.name, tuple(notes), bodies=bodies), None)


def _header(path: Path, data: bytes) -> tuple[str, list[Element], int]:
    """(byte order, "" for ASCII; the elements; where the body starts)."""
    end = data.find(b"end_header", 0, LONGEST_HEADER)
    if end < 0:
        raise unreadable(path, "PLY", "its header has no end")
    order: str | None = None
    elements: list[Element] = []
    for line in data[:end].decode("latin-1").replace("\r", "\n").split("\n")[1:]:
        words = line.split()
        try:
            match words:
                case ["format", name, *_]:
                    order = ORDERS[name]
                case ["element", name, count]:
                    elements.append(Element(name, int(count[:20]), []))
                case ["property", "list", counted_by, kind, name]:
                    elements[-1].properties.append(Property(name, TYPES[kind], TYPES[counted_by]))
                case ["property", kind, name]:
                    elements[-1].properties.append(Property(name, TYPES[kind], None))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (ValueError, LookupError) as problem:
            raise unreadable(path, "PLY", f"its header has the line '{line.strip()[:60]}'") from problem
    if order is None:
        raise unreadable(path, "PLY", "its header says no format")
    if any(element.number < 0 for element in elements):
        raise unreadable(path, "PLY", "an element has a negative count")
    stop = end + len(b"end_header")
    stop = stop + 2 if data[stop : stop + 2] == b"\r\n" else stop + 1
    for element in elements:
        if element.properties and element.number > len(data) - stop:  # each takes a byte at least
            raise unreadable(path, "PLY", f"cut short: {element.number} × {element.name} are promised")
    return order, elements, stop


class _Words:
    """The body of an ASCII file: numbers one after the other."""

    def __init__(self, text: bytes) -> None:
        self._values = numbers(text)
        self._at = 0

    def _take(self, count: int) -> NDArray[np.float64]:
        if self._at + count > len(self._values):
            raise ValueError("cut short within its elements")
        self._at += count
        return self._values[self._at - count : self._at]

    def scalars(self, element: Element, names: tuple[str, ...]) -> NDArray[np.float64]:
        if any(p.counted_by for p in element.properties):
            return np.array(self._walk(element, names)[0], np.float64).reshape(-1, len(names))
        table = self._take(element.number * len(element.properties)).reshape(element.number, -1)
        return table[:, [[p.name for p in element.properties].index(name) for name in names]]

    def lists(self, element: Element, name: str) -> Lists:
        return self._alike(element, name) or self._one_by_one(element, name)

    def _alike(self, element: Element, name: str) -> Lists | None:
        """The lists if those of all records are as long as those of the first; None if they are not."""
        width, counted, place = 0, [], 0
        for p in element.properties:
            if self._at + width >= len(self._values):
                return None
            length = int(self._values[self._at + width]) if p.counted_by else 0
            if p.counted_by:
                counted.append((width, length))
            if p.name == name:
                place = width
            width += 1 + max(length, 0)
        table = self._values[self._at : self._at + element.number * width]
        if len(table) < element.number * width or any((table[k::width] != n).any() for k, n in counted):
            return None
        self._at += len(table)
        rows = table.reshape(element.number, width)
        length = dict(counted)[place]
        return np.full(element.number, length, np.int64), _whole(rows[:, place + 1 : place + 1 + length])

    def _one_by_one(self, element: Element, name: str) -> Lists:
        counts, values = self._walk(element, ())[1][name]
        return np.array(counts, np.int64), _whole(np.array(values, np.float64))

    def _walk(
        self, element: Element, names: tuple[str, ...]
    ) -> tuple[list[float], dict[str, tuple[list[int], list[float]]]]:
        """Record by record: the scalars called so, and the lists."""
        values, at = self._values[self._at :].tolist(), 0
        scalars: list[float] = []
        lists: dict[str, tuple[list[int], list[float]]] = {
            p.name: ([], []) for p in element.properties if p.counted_by
        }
        for _ in range(element.number):
            for p in element.properties:
                if at >= len(values):
                    raise ValueError("cut short within its elements")
                value = values[at]
                at += 1
                if p.counted_by is None:
                    if p.name in names:
                        scalars.append(value)
                    continue
                count = int(value)
                if count < 0 or at + count > len(values):
                    raise ValueError(f"cut short, or a list of {count} values")
                lists[p.name][0].append(count)
                lists[p.name][1].extend(values[at : at + count])
                at += count
        self._at += at
        return scalars, lists

    def skip(self, element: Element) -> None:
        if any(p.counted_by for p in element.properties):
            self._walk(element, ())
        else:
            self._take(element.number * len(element.properties))

    def left(self) -> str:
        rest = len(self._values) - self._at
        return several(rest, "number") if rest else ""


def _whole(values: NDArray[np.float64]) -> NDArray[np.int64]:
    flat = values.reshape(-1)
    if (flat != np.floor(flat)).any() or (np.abs(flat) > 2**40).any():
        raise ValueError("a face names a vertex by a number that is not whole")
    return flat.astype(np.int64)


class _Bytes:
    """The body of a binary file."""

    def __init__(self, data: bytes, start: int, order: str) -> None:
        self._data, self._at, self._order = data, start, order

    def _take(self, dtype: np.dtype[np.void], count: int) -> NDArray[np.void]:
        size = dtype.itemsize * count
        if self._at + size > len(self._data):
            raise ValueError("cut short within its elements")
        records = np.frombuffer(self._data, dtype, count, self._at)
        self._at += size
        return records

    def _dtype(self, element: Element) -> np.dtype[np.void]:
        fields = [(f"{k} {p.name}", self._order + p.kind) for k, p in enumerate(element.properties)]
        return np.dtype(fields)

    def scalars(self, element: Element, names: tuple[str, ...]) -> NDArray[np.float64]:
        places = [[p.name for p in element.properties].index(name) for name in names]
        if any(p.counted_by for p in element.properties):
            starts = self._walk(element)[0]
            kinds = [self._order + element.properties[k].kind for k in places]
            columns = [self._gather(starts[:, k], kind) for k, kind in zip(places, kinds, strict=True)]
        else:
            records = self._take(self._dtype(element), element.number)
            columns = [records[f"{k} {name}"] for k, name in zip(places, names, strict=True)]
        return np.stack(columns, axis=1).astype(np.float64)

    def lists(self, element: Element, name: str) -> Lists:
        wanted = [p.name for p in element.properties].index(name)
        prop = element.properties[wanted]
        starts, lengths = self._walk(element)
        count = lengths[:, wanted]
        size = np.dtype(prop.kind).itemsize
        first = np.repeat(starts[:, wanted], count)
        within = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
        return count, self._gather(first + within * size, self._order + prop.kind).astype(np.int64)

    def _gather(self, places: NDArray[np.int64], kind: str) -> NDArray[np.generic]:
        """Values of one type at any places of the file."""
        dtype = np.dtype(kind)
        raw = np.frombuffer(self._data, np.uint8)
        picked = raw[places[:, None] + np.arange(dtype.itemsize)]
        return np.ascontiguousarray(picked).view(dtype).reshape(-1)

    def _walk(self, element: Element) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(records, properties): where each value, or list, starts, and how many it has; moves past the element."""
        from layerfix.mesh.records import walk

        shape = [(np.dtype(p.counted_by or "V0").itemsize, np.dtype(p.kind).itemsize) for p in element.properties]
        starts, lengths, stop = walk(
            np.frombuffer(self._data, np.uint8),
            self._at,
            element.number,
            np.array(shape, np.int64),
            self._order == ">",
        )
        if stop < 0:
            raise ValueError("cut short within its elements")
        self._at = stop
        return starts, lengths

    def skip(self, element: Element) -> None:
        if any(p.counted_by for p in element.properties):
            self._walk(element)
        elif element.properties:
            self._take(self._dtype(element), element.number)

    def left(self) -> str:
        rest = len(self._data) - self._at
        return several(rest, "byte") if rest and self._data[self._at :].strip() else ""
