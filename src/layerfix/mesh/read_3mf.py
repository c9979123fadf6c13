"""3MF files: every build item with its place, unit and parts. Specification: 3MF core 1.3, production 1.1.

Our own reader because trimesh's (5.2) loses objects that share a part number, the other files of the
production extension (Bambu Studio and OrcaSlicer write every object to a file of its own), and repeats
objects that are used twice.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from layerfix.errors import InputError
from layerfix.units import mm_per_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROOT_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
USUAL_ROOT = "3D/3dmodel.model"
PATH = "{http://schemas.microsoft.com/3dmanufacturing/production/2015/06}path"
DEEPEST = 32  # components in components; a file that needs more refers to itself


@dataclass(frozen=True, eq=False)
class _Use:
    """An object in its place: the model file and id that name it, and the matrix (4, 3) for row vectors."""

    part: str
    object_id: str
    matrix: NDArray[np.float64]


@dataclass(eq=False)
class _Model:
    """One model file."""

    unit: str = "millimeter"
    meshes: dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]] = field(default_factory=dict)
    components: dict[str, list[_Use]] = field(default_factory=dict)
    build: list[_Use] = field(default_factory=list)


def read_3mf(path: Path, unit: str | None) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(vertices (n, 3) in mm, faces (m, 3)) of all printable build items; `unit` replaces that of the file.

    Raises InputError, zipfile.BadZipFile and lxml's syntax errors for what is no 3MF.
    """
    with zipfile.ZipFile(path) as archive:
        names = {name.lower(): name for name in archive.namelist()}
        models: dict[str, _Model] = {}

        def model(part: str) -> _Model:
            key = part.lstrip("/").lower()
            if key not in models:
                if key not in names:
                    raise InputError(f"{path}: not a readable .3mf mesh: its file {part} is missing")
                with archive.open(names[key]) as stream:
                    try:
                        models[key] = _parse(stream, part)
                    except InputError as problem:
                        raise InputError(f"{path}: not a readable .3mf mesh: {problem}") from problem
            return models[key]

        root = _root(archive, names)
        vertices: list[NDArray[np.float64]] = []
        faces: list[NDArray[np.int64]] = []
        for item in model(root).build:
            for points, triangles in _placed(path, model, item, 0):
                faces.append(triangles + sum(map(len, vertices)))
                vertices.append(points)
        if not faces:
            raise InputError(f"{path}: no triangles: the file has nothing to build")
        try:
            mm = mm_per_unit(unit or model(root).unit)
        except InputError as problem:
            raise InputError(f"{path}: {problem}") from problem
        return np.concatenate(vertices) * mm, np.concatenate(faces)


def _root(archive: zipfile.ZipFile, names: dict[str, str]) -> str:
    """The root model file, as the package's relationships name it."""
    from lxml import etree

    if "_rels/.rels" in names:
        for relation in etree.fromstring(archive.read(names["_rels/.rels"]), _parser()).iter("{*}Relationship"):
            if relation.get("Type") == ROOT_TYPE and relation.get("Target"):
                return str(relation.get("Target"))
    return USUAL_ROOT


def _parser() -> Any:
    from lxml import etree

    return etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=True)


def _parse(stream: IO[bytes], part: str) -> _Model:
    """Read one model file element by element; finished meshes are dropped from the tree."""
    from lxml import etree

    found = _Model()
    events = etree.iterparse(
        stream, events=("start", "end"), tag=("{*}model", "{*}mesh", "{*}object", "{*}item"),
        resolve_entities=False, no_network=True, huge_tree=True,
    )  # fmt: skip
    mesh: tuple[NDArray[np.float64], NDArray[np.int64]] | None = None
    for event, element in events:
        kind = etree.QName(element).localname
        if event == "start":
            if kind == "model":
                found.unit = element.get("unit", "millimeter")
            continue
        if kind == "mesh":
            mesh = _mesh(element)
            element.clear()
        elif kind == "object":
            object_id = element.get("id", "")
            if mesh is not None:
                found.meshes[object_id] = mesh
            found.components[object_id] = [_use(c, part) for c in element.iter("{*}component")]
            mesh = None
            element.clear()
        elif kind == "item" and element.get("printable", "1") != "0":
            found.build.append(_use(element, part))
    return found


def _mesh(element: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    points = [(float(v.get("x")), float(v.get("y")), float(v.get("z"))) for v in element.iter("{*}vertex")]
    triangles = [(int(t.get("v1")), int(t.get("v2")), int(t.get("v3"))) for t in element.iter("{*}triangle")]
    faces = np.array(triangles, np.int64).reshape(-1, 3)
    if faces.size and not (faces.min() >= 0 and faces.max() < len(points)):
        raise InputError(f"a triangle names vertex {faces.max()} of {len(points)}")
    return np.array(points, np.float64).reshape(-1, 3), faces


def _use(element: Any, part: str) -> _Use:
    text = element.get("transform")
    matrix = np.array(text.split(), np.float64).reshape(4, 3) if text else np.eye(4, 3)
    return _Use(element.get(PATH, part), element.get("objectid", ""), matrix)


def _placed(
    path: Path, model: Callable[[str], _Model], use: _Use, depth: int
) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Meshes of an object and of its components, in place; a matrix that mirrors flips the triangles."""
    if depth > DEEPEST:
        raise InputError(f"{path}: not a readable .3mf mesh: object {use.object_id} is part of itself")
    file = model(use.part)
    if use.object_id not in file.meshes and use.object_id not in file.components:
        raise InputError(f"{path}: not a readable .3mf mesh: object {use.object_id} is missing")
    inner = [file.meshes[use.object_id]] if use.object_id in file.meshes else []
    for component in file.components.get(use.object_id, []):
        inner += _placed(path, model, component, depth + 1)
    turn, shift = use.matrix[:3], use.matrix[3]
    flip = np.linalg.det(turn) < 0
    return [(points @ turn + shift, faces[:, ::-1] if flip else faces) for points, faces in inner if len(faces)]
