"""One model file of a 3MF: objects with their meshes, beams and components, and what is built.

Specifications: 3MF core 1.4, production 1.1, beam lattice 1.2. Read element by element, without a tree: 225,000
triangles take 0.5 s and no more memory than their numbers.
"""

from __future__ import annotations

import math
import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np

from layerfix.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

MS, CONSORTIUM = "http://schemas.microsoft.com/3dmanufacturing/", "http://schemas.3mf.io/3dmanufacturing/"
PATH = f"{MS}production/2015/06 path"
BEAMS, BALLS = f"{MS}beamlattice/2017/02", f"{MS}beamlattice/balls/2020/07"
# What is read, and what says nothing of where the part is: colours, parts' numbers, groups of triangles.
READ = (f"{MS}core/", f"{MS}production/2015/06", f"{MS}material/", f"{MS}trianglesets/", BEAMS, BALLS)
NAMES = {
    "slice": "slices", "booleanoperations": "boolean operations", "displacement": "displacement",
    "volumetric": "volumetric data", "implicit": "implicit functions", "securecontent": "encryption (secure content)",
    "toolpath": "toolpaths", "production": "alternatives (production)",
}  # fmt: skip
MATERIALS = f"{MS}material/2015/02"
HEX_COLOUR = re.compile("[0-9A-Fa-f]{6}")
XYZ, V123 = ["x", "y", "z"], ["v1", "v2", "v3"]
LONGEST_SILENCE = 64  # pieces of a file without an element: 16 MB


@dataclass(frozen=True)
class Use:
    """An object in its place: the model file and id that name it, twelve numbers of a matrix for row vectors."""

    part: str
    object_id: str
    matrix: tuple[float, ...] = (1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0)


@dataclass
class Lattice:
    """Beams and balls on the vertices of a mesh, as written; NaN and "" stand for what is not."""

    radius: float
    min_length: float
    cap: str
    ball_mode: str
    ball_radius: float
    clip: tuple[str, str]  # mode, object id
    ends: array[int] = field(default_factory=lambda: array("q"))
    radii: array[float] = field(default_factory=lambda: array("d"))
    caps: list[tuple[str, str]] = field(default_factory=list)
    balls: list[tuple[int, float]] = field(default_factory=list)


@dataclass
class Object:
    """One object. foreign: elements of extensions that are not read, by the address of the extension."""

    kind: str
    points: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    faces: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 3), np.int32))
    lattice: Lattice | None = None
    components: list[Use] = field(default_factory=list)
    foreign: Counter[str] = field(default_factory=Counter)
    name: str = ""
    colour: tuple[str, str] = ("", "")  # group of colours or materials, and which of them
    painted: array[int] = field(default_factory=lambda: array("q"))  # triangles with one of their own,
    paints: list[tuple[str, str]] = field(default_factory=list)  # and which


@dataclass
class Model:
    """One model file. hidden: items of the build that are marked as not to be printed; colours: 0xRRGGBB by group."""

    unit: str = "millimeter"
    objects: dict[str, Object] = field(default_factory=dict)
    build: list[Use] = field(default_factory=list)
    hidden: int = 0
    recommended: list[str] = field(default_factory=list)
    colours: dict[str, list[int]] = field(default_factory=dict)

    def colours_of(self, found: Object) -> NDArray[np.int32]:
        """(m,) of the object's triangles; -1 for what has none, or one that is no plain colour."""
        colours = np.full(len(found.faces), self._colour(*found.colour), np.int32)
        if len(found.painted):
            known = {ref: self._colour(ref[0] or found.colour[0], ref[1]) for ref in set(found.paints)}
            colours[np.frombuffer(found.painted, np.int64)] = [known[ref] for ref in found.paints]
        return colours

    def _colour(self, group: str, number: str) -> int:
        colours = self.colours.get(group, [])
        return colours[int(number)] if number.isdecimal() and int(number[:9]) < len(colours) else -1


def extension_name(uri: str, prefix: str = "") -> str:
    """What people call an extension, and how it is written: ``slices (s: http://…)``."""
    word = uri.removeprefix(MS).removeprefix(CONSORTIUM).partition("/")[0]
    address = f"{prefix}: {uri}" if prefix and uri else uri or prefix
    return f"{NAMES[word]} ({address})" if word in NAMES and word != uri else address


def parse_model(pieces: Iterable[bytes], part: str) -> Model:
    """The model in a file given piece by piece. Raises InputError for what is no model, or needs what is not read."""
    reader = _Reader(part)
    parser = reader.parser
    silence = 0
    try:
        for piece in pieces:
            seen = reader.elements
            parser.Parse(piece, False)
            silence = silence + 1 if reader.elements == seen else 0
            if silence > LONGEST_SILENCE:
                raise InputError(f"{part} goes on for 16 MB without an element")
        parser.Parse(b"", True)
        reader.close_object()
    except expat.ExpatError as problem:
        raise InputError(f"{part} is broken ({problem})") from problem
    if not reader.core:
        raise InputError(f"{part} is no 3D model")
    return reader.model


def _no_doctype(*_: object) -> None:
    raise InputError("a model declares a document type, which 3MF forbids")


class _Reader:
    """Handlers of the elements. Names come as "address name", attributes as [name, value, name, value …]."""

    def __init__(self, part: str) -> None:
        self.model, self.core, self.elements = Model(), "", 0
        self._part = part
        self._prefixes: dict[str, str] = {}
        self._starts: dict[str, Callable[[list[str]], None]] = {}
        self._vertex_name = self._triangle_name = ""
        self._current: Object | None = None
        self._points, self._corners = array("d"), array("q")
        self._colours: list[int] = []
        self._depth = 0  # within an element of an extension that is not read
        self.parser = expat.ParserCreate(namespace_separator=" ")
        self.parser.ordered_attributes = True
        self.parser.StartNamespaceDeclHandler = self._namespace
        self.parser.StartElementHandler = self._start
        self.parser.StartDoctypeDeclHandler = _no_doctype

    def _namespace(self, prefix: str | None, uri: str | None) -> None:
        """What a prefix stands for; `requiredextensions` speaks in prefixes."""
        self._prefixes.setdefault(prefix or "", uri or "")

    def _start(self, name: str, given: list[str]) -> None:
        """The beginning of an element. The two that come by the million are first, and are not handed on."""
        self.elements += 1
        if name == self._triangle_name and given[:6:2] == V123:
            self._corners.extend((int(given[1]), int(given[3]), int(given[5])))
            if len(given) > 6 and self._current is not None:
                self._paint(given[6:])
        elif name == self._vertex_name and given[::2] == XYZ:
            self._points.extend((float(given[1]), float(given[3]), float(given[5])))
        elif (handler := self._starts.get(name)) is not None:
            handler(given)
        elif not self.core:
            self._root(name, given)
        else:
            uri = name.rpartition(" ")[0]
            if uri != self.core and not uri.startswith(READ):
                self._enter_strange(uri)

    def _enter_strange(self, uri: str) -> None:
        """Into an element of an extension that is not read: until its end, nothing counts."""
        if self._current is not None:
            self._current.foreign[uri] += 1
        self._depth = 1
        self.parser.StartElementHandler, self.parser.EndElementHandler = self._strange_start, self._strange_end

    def _strange_start(self, name: str, given: list[str]) -> None:
        self.elements += 1
        self._depth += 1

    def _strange_end(self, name: str) -> None:
        self._depth -= 1
        if not self._depth:
            self.parser.StartElementHandler, self.parser.EndElementHandler = self._start, None

    def _root(self, name: str, attributes: list[str]) -> None:
        uri, _, local = name.rpartition(" ")
        if local != "model":
            raise InputError(f"{self._part} is no 3D model; it begins with <{local[:40]}>")
        self.core = uri or "none"
        core = f"{uri} " if uri else ""
        self._vertex_name, self._triangle_name = f"{core}vertex", f"{core}triangle"
        self._starts = {
            f"{core}object": self._open_object, f"{core}vertex": self._vertex, f"{core}triangle": self._triangle,
            f"{core}component": self._component, f"{core}item": self._item, f"{BEAMS} beamlattice": self._beamlattice,
            f"{core}basematerials": self._group, f"{core}base": self._base, f"{MATERIALS} colorgroup": self._group,
            f"{MATERIALS} color": self._base,
            f"{BEAMS} beam": self._beam, f"{BALLS} ball": self._ball, f"{BEAMS} ball": self._ball,
        }  # fmt: skip
        given = _given(attributes)
        self.model.unit = given.get("unit", "millimeter")
        for prefix in given.get("requiredextensions", "").split():
            uri = self._prefixes.get(prefix, "")
            if not uri.startswith(READ):
                extension = extension_name(uri, prefix)
                raise InputError(f"{self._part} requires the extension {extension}, which is not read")
        recommended = [
            self._prefixes.get(prefix, prefix) for prefix in given.get("recommendedextensions", "").split()
        ]
        self.model.recommended = [uri for uri in recommended if not uri.startswith(READ)]

    def _open_object(self, attributes: list[str]) -> None:
        self.close_object()
        given = _given(attributes)
        self._current = Object(
            given.get("type") or "model",
            name=given.get("name", ""),
            colour=(given.get("pid", ""), given.get("pindex", "")),
        )
        object_id = given.get("id", "")
        if object_id in self.model.objects:
            raise InputError(f"{self._part} has two objects {object_id[:40]}")
        self.model.objects[object_id] = self._current
        self._points, self._corners = array("d"), array("q")
        self._current.foreign.update(
            uri for name in given if (uri := name.rpartition(" ")[0]).startswith(f"{MS}slice/")
        )

    def close_object(self) -> None:
        """Where the next object begins, and at the end: that takes a call less for each element than its own end."""
        found, self._current = self._current, None
        if found is None:
            return
        corners = np.array(self._corners, np.int64)
        points = np.array(self._points, np.float64).reshape(-1, 3)
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
            wrong = corners.max() if corners.min() >= 0 else corners.min()
            raise InputError(f"a triangle names vertex {wrong} of {len(points)}")
        if len(corners) or found.lattice is not None:  # vertices of nothing are nothing
            found.points, found.faces = points, corners.astype(np.int32).reshape(-1, 3)

    def _vertex(self, attributes: list[str]) -> None:
        given = _given(attributes)
        self._points.extend(float(given[name]) for name in XYZ)

    def _triangle(self, attributes: list[str]) -> None:
        given = _given(attributes)
        self._corners.extend(int(given[name]) for name in V123)
        if self._current is not None:
            self._paint(attributes)

    def _paint(self, attributes: list[str]) -> None:
        """The triangle that was read last may have a colour of its own: that of its first corner."""
        given = _given(attributes)
        if "p1" in given and self._current is not None:
            self._current.painted.append(len(self._corners) // 3 - 1)
            self._current.paints.append((given.get("pid", ""), given["p1"]))

    def _group(self, attributes: list[str]) -> None:
        self._colours = self.model.colours.setdefault(_given(attributes).get("id", ""), [])

    def _base(self, attributes: list[str]) -> None:
        given = _given(attributes)
        value = (given.get("displaycolor") or given.get("color") or "")[1:7]
        self._colours.append(int(value, 16) if HEX_COLOUR.fullmatch(value) else -1)

    def _component(self, attributes: list[str]) -> None:
        if self._current is not None:
            self._current.components.append(self._use(attributes))

    def _item(self, attributes: list[str]) -> None:
        if "printable" in attributes[::2] and _given(attributes)["printable"] in ("0", "false"):
            self.model.hidden += 1
        else:
            self.model.build.append(self._use(attributes))

    def _use(self, attributes: list[str]) -> Use:
        given = _given(attributes)
        part, object_id = given.get(PATH, self._part), given.get("objectid", "")
        if not given.get("transform"):
            return Use(part, object_id)
        matrix = tuple(map(float, given["transform"].split()))
        if len(matrix) != 12 or not all(map(math.isfinite, matrix)):
            raise InputError(f"a transform is '{given['transform'][:60]}'; it is 12 numbers")
        return Use(part, object_id, matrix)

    def _beamlattice(self, attributes: list[str]) -> None:
        # Balls came with an address of their own; files use their attributes with and without it.
        given = {name.removeprefix(f"{BALLS} "): value for name, value in _given(attributes).items()}
        clip = given.get("clippingmode", "none"), given.get("clippingmesh", "")
        if self._current is not None:
            self._current.lattice = Lattice(
                float(given.get("radius", "nan")), float(given.get("minlength", "0")), given.get("cap", "sphere"),
                given.get("ballmode", "none"), float(given.get("ballradius", "nan")), clip,
            )  # fmt: skip

    def _beam(self, attributes: list[str]) -> None:
        lattice = self._current.lattice if self._current is not None else None
        if lattice is None:
            return
        given = _given(attributes)
        lattice.ends.extend((int(given["v1"]), int(given["v2"])))
        first = float(given["r1"]) if "r1" in given else lattice.radius
        second = float(given["r2"]) if "r2" in given else first
        lattice.radii.extend((first, second))
        lattice.caps.append((given.get("cap1", lattice.cap), given.get("cap2", lattice.cap)))

    def _ball(self, attributes: list[str]) -> None:
        lattice = self._current.lattice if self._current is not None else None
        if lattice is not None:
            given = _given(attributes)
            lattice.balls.append((int(given["vindex"]), float(given.get("r", lattice.ball_radius))))


def _given(attributes: list[str]) -> dict[str, str]:
    return dict(zip(attributes[::2], attributes[1::2], strict=True))
