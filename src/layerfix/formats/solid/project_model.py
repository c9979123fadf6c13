"""One .model file of a 3MF as text: what its meshes are, and where they stand, so that one can be put for another."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np

from layerfix.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Faces = NDArray[np.int32]

CORNERS = ("v1", "v2", "v3")
AT_ONCE = 65536  # vertices turned into text together


@dataclass
class MeshText:
    """One mesh element: its numbers, and where its text begins and ends, from vertices to triangles."""

    start: int = 0
    stop: int = 0
    prefix: str = ""
    vertices: list[float] = field(default_factory=list)
    corners: list[int] = field(default_factory=list)
    attributes: dict[int, str] = field(default_factory=dict)  # beyond the corners, by triangle, as text

    def arrays(self, where: str) -> tuple[Floats, Faces]:
        """((n, 3), (m, 3)). Raises InputError for a triangle of vertices that are not there."""
        vertices = np.array(self.vertices, float).reshape(-1, 3)
        faces = np.array(self.corners, np.int64).reshape(-1, 3)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise InputError(f"{where}: a triangle names a vertex that is not there")
        return vertices, faces.astype(np.int32)


@dataclass
class Model:
    """What one .model file says."""

    text: bytes
    unit: str = "millimeter"
    meshes: dict[str, MeshText] = field(default_factory=dict)
    components: dict[str, list[tuple[str, str, Floats]]] = field(default_factory=dict)  # (file, object, matrix)
    build: list[tuple[str, str, Floats, bool]] = field(default_factory=list)  # … and whether it is printed


def matrix_of(text: str | None) -> Floats:
    """(4, 3) for row vectors, of a transform attribute. Raises ValueError for another number of numbers."""
    if not text:
        return np.vstack([np.eye(3), np.zeros(3)])
    numbers = [float(number) for number in text.split()]
    if len(numbers) != 12:
        raise ValueError(f"a transform has {len(numbers)} numbers; it has 12")
    return np.array(numbers).reshape(4, 3)


def written(prefix: str, vertices: list[Floats], faces: list[NDArray[np.int64]], paint: dict[int, str]) -> bytes:
    """The text of a mesh, from `<vertices` to `</triangles>`. paint: attributes beyond the corners, by triangle."""
    out = [f"<{prefix}vertices>\n"]
    for part in vertices:
        for k in range(0, len(part), AT_ONCE):
            line = f'<{prefix}vertex x="%.9g" y="%.9g" z="%.9g"/>\n'
            out.append(line * len(part[k : k + AT_ONCE]) % tuple(part[k : k + AT_ONCE].ravel().tolist()))
    out.append(f"</{prefix}vertices>\n<{prefix}triangles>\n")
    for index, (a, b, c) in enumerate(np.concatenate(faces).tolist()):
        out.append(f'<{prefix}triangle v1="{a}" v2="{b}" v3="{c}"{paint.get(index, "")}/>\n')
    out.append(f"</{prefix}triangles>")
    return "".join(out).encode()


def parsed(text: bytes, where: str, name: str) -> Model:
    """A model's objects with the places of their meshes in the text. where: for messages. Raises InputError."""
    if text[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(f"{where}: is written in UTF-16; open the project in your slicer and save it anew")
    model = Model(text)
    reader = _Reader(model, name)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = lambda tag, given: reader.start(tag, given, parser.CurrentByteIndex)
    parser.EndElementHandler = lambda tag: reader.end(tag, parser.CurrentByteIndex)
    parser.StartDoctypeDeclHandler = _no_doctype
    try:
        parser.Parse(text, True)
    except expat.ExpatError as problem:
        raise InputError(f"{where}: is broken ({problem})") from problem
    except (ValueError, KeyError, OverflowError) as problem:
        raise InputError(f"{where}: has a number that is none or is missing ({problem})") from problem
    return model


def _no_doctype(*_: object) -> None:
    raise ValueError("a document type, which 3MF forbids")


class _Reader:
    """Elements of a model as they come."""

    def __init__(self, model: Model, name: str) -> None:
        self._model, self._name = model, name
        self._object = ""
        self._mesh: MeshText | None = None

    def start(self, tag: str, given: dict[str, str], at: int) -> None:
        prefix, _, local = tag.rpartition(":")
        mesh = self._mesh
        if local == "vertex" and mesh is not None:
            mesh.vertices += float(given["x"]), float(given["y"]), float(given["z"])
        elif local == "triangle" and mesh is not None:
            if len(given) > len(CORNERS):
                own = (f" {key}={_quoted(value)}" for key, value in given.items() if key not in CORNERS)
                mesh.attributes[len(mesh.corners) // 3] = "".join(own)
            mesh.corners += int(given["v1"]), int(given["v2"]), int(given["v3"])
        elif local == "vertices" and self._object:
            mesh = self._mesh = MeshText(at, at, f"{prefix}:" if prefix else "")
            self._model.meshes[self._object] = mesh
        elif local == "object":
            self._object = given.get("id", "")
        elif local == "component":
            file = next((value for key, value in given.items() if key.rpartition(":")[2] == "path"), "")
            self._model.components.setdefault(self._object, []).append(
                (file.lstrip("/"), given["objectid"], matrix_of(given.get("transform")))
            )
        elif local == "item":
            file = next((value for key, value in given.items() if key.rpartition(":")[2] == "path"), "")
            printed = given.get("printable", "1") != "0"
            self._model.build.append(
                (file.lstrip("/"), given["objectid"], matrix_of(given.get("transform")), printed)
            )
        elif local == "model":
            self._model.unit = given.get("unit", "millimeter")

    def end(self, tag: str, at: int) -> None:
        local = tag.rpartition(":")[2]
        if local == "triangles" and self._mesh is not None:
            self._mesh.stop = self._model.text.index(b">", at) + 1
            self._mesh = None
        elif local == "object":
            self._object = ""


def _quoted(value: str) -> str:
    return '"' + value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;") + '"'
