"""A slicer's project (3MF) with other meshes for some of its parts, and every other byte as it was.

PrusaSlicer, SuperSlicer: all volumes of an object share one mesh, and `Metadata/Slic3r_PE_model.config` says which
triangles are whose (firstid to lastid, both included). OrcaSlicer, Bambu Studio: a part is an object of its own,
mostly in a file of its own (`3D/Objects/…`), and a component of the object that the root model builds;
`Metadata/model_settings.config` says by its id what it is. Names found in files of theirs. Stale numbers print a part
of the part, without a word: they are written anew.

Only the text of a changed mesh is new, and the numbers. What hangs on triangles (painted supports, seams, colours)
stays with those whose corners are the same.
"""

from __future__ import annotations

import json
import re
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.files import whole_file
from layerfix.formats.jobs.zips import Archive
from layerfix.formats.solid.project_model import MeshText, Model, parsed, written
from layerfix.mesh.package import Package
from layerfix.mesh.settings_3mf import SOLID, kind_of_part
from layerfix.units import mm_per_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.formats.probe import Probe

    Floats = NDArray[np.float64]
    Faces = NDArray[np.int32]

PAINTED = re.compile(r" (?!(?:pid|p1|p2|p3)=)[\w:]+=")  # beyond colours of a whole object: painting
SETTINGS = re.compile(
    r"^metadata/(slic3r_pe|superslicer|slic3r|prusa_slicer|.*_model|model_settings|project_settings)[a-z_]*\.config$"
)
DEEPEST = 10


@dataclass(frozen=True, eq=False)
class Piece:
    """Triangles `first` to before `stop` of one mesh element, and what they are. name: as the slicer shows it."""

    file: str
    object_id: str
    first: int
    stop: int
    kind: str
    name: str

    @property
    def key(self) -> tuple[str, str, int]:
        return self.file, self.object_id, self.first


@dataclass(frozen=True, eq=False)
class Placed:
    """A piece where the build has it: (4, 3) for row vectors, in the unit of the file."""

    piece: Piece
    matrix: Floats


@dataclass(frozen=True, eq=False)
class ProjectObject:
    """One object that is printed: its solid parts, how many others it has by kind, and in how many places it is."""

    name: str
    parts: tuple[Placed, ...]
    others: tuple[str, ...]
    copies: int
    tilted: bool  # other copies are turned or scaled otherwise than the first


@dataclass(frozen=True)
class _Volume:
    """One line of a slicer's settings of an object's parts."""

    kind: str
    name: str
    component: str  # id of the component that it is, of OrcaSlicer; "" of PrusaSlicer
    first: int
    stop: int


def is_project(probe: Probe) -> bool:
    """Whether a 3MF holds settings of a slicer."""
    return not probe.is_folder and any(SETTINGS.match(name.lower()) for name in probe.entries)


class Project:
    """One project. Raises InputError for one that is broken or cannot be written again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._models: dict[str, Model] = {}
        self._replaced: dict[tuple[str, str, int], tuple[Floats, Faces]] = {}
        self.lost_paint = 0
        self.kept_paint = 0
        with Package(path) as package:
            self._package = package
            self.root = package.root().lstrip("/")
            self._settings_name, self._settings = self._read_settings()
            self._load(self.root)
            self.objects = self._objects()
        self.mm = mm_per_unit(self._models[self.root].unit)

    # what is there ------------------------------------------------------------------------------------------

    def mesh_of(self, piece: Piece) -> tuple[Floats, Faces]:
        """((n, 3) vertices that are used, (m, 3) faces) of a piece, in its own coordinates and the file's unit."""
        vertices, faces = self._mesh(piece.file, piece.object_id).arrays(f"{self.path}: {piece.file}")
        used, number = np.unique(faces[piece.first : piece.stop], return_inverse=True)
        return vertices[used], number.reshape(-1, 3).astype(np.int32)

    def _mesh(self, file: str, object_id: str) -> MeshText:
        return self._models[file].meshes[object_id]

    def _load(self, name: str) -> Model:
        name = name.lstrip("/")
        if name not in self._models:
            with closing(self._package.pieces(name)) as pieces:
                text = b"".join(pieces)
            self._models[name] = parsed(text, f"{self.path}: {name}", name)
        return self._models[name]

    def _objects(self) -> list[ProjectObject]:
        """Objects that are printed, each once."""
        places: dict[tuple[str, str], list[Floats]] = {}
        for file, object_id, matrix, printed in self._load(self.root).build:
            if printed:
                places.setdefault((file or self.root, object_id), []).append(matrix)
        found = []
        for (file, object_id), matrices in places.items():
            volumes = self._settings.get(object_id, ("", []))
            pieces = self._pieces(file, object_id, matrices[0], volumes[1], 0)
            parts = tuple(one for one in pieces if one.piece.kind == SOLID)
            others = tuple(one.piece.kind for one in pieces if one.piece.kind != SOLID)
            tilted = any(not np.allclose(_shape(one), _shape(matrices[0]), atol=1e-6) for one in matrices[1:])
            name = volumes[0] or (parts[0].piece.name if parts else "") or f"object {object_id}"
            found.append(ProjectObject(name, parts, others, len(matrices), tilted))
        return found

    def _pieces(
        self, file: str, object_id: str, matrix: Floats, volumes: list[_Volume], depth: int, name: str = ""
    ) -> list[Placed]:
        model = self._load(file)
        if depth > DEEPEST:
            raise InputError(f"{self.path}: components are nested over {DEEPEST} deep")
        found: list[Placed] = []
        if object_id in model.meshes:
            count = len(model.meshes[object_id].corners) // 3
            ranges = [v for v in volumes if not v.component] or [_Volume(SOLID, name, "", 0, count)]
            for volume in ranges:
                if not 0 <= volume.first < volume.stop <= count:
                    raise InputError(
                        f"{self.path}: {self._settings_name} says triangles {volume.first} to {volume.stop - 1} of"
                        f" object {object_id}, which has {count}"
                    )
                piece = Piece(file, object_id, volume.first, volume.stop, volume.kind, volume.name)
                found.append(Placed(piece, matrix))
        seen: dict[str, int] = {}
        for other, component_id, own in model.components.get(object_id, []):
            same = [v for v in volumes if v.component == component_id]
            nth = seen.get(component_id, 0)
            seen[component_id] = nth + 1
            of = same[min(nth, len(same) - 1)] if same else None
            pieces = self._pieces(other or file, component_id, _after(own, matrix), [], depth + 1,
                                  of.name if of else name)  # fmt: skip
            if of is not None and of.kind != SOLID:
                pieces = [Placed(_as(one.piece, of.kind), one.matrix) for one in pieces]
            found += pieces
        return found

    def _read_settings(self) -> tuple[str, dict[str, tuple[str, list[_Volume]]]]:
        """(file, (name, volumes) of each object of the root model by its id)."""
        found: dict[str, tuple[str, list[_Volume]]] = {}
        file = ""
        for name in self._package.names():
            if not name.startswith("metadata/") or not name.endswith(("_model.config", "model_settings.config")):
                continue
            file = name
            for element in self._package.xml(name).iter("object"):
                volumes = []
                for part in element:
                    if part.tag in ("volume", "part"):
                        said = {m.get("key"): m.get("value", "") for m in part.iter("metadata")}
                        first, last = part.get("firstid"), part.get("lastid")
                        ranged = first is not None and last is not None
                        volumes.append(
                            _Volume(
                                kind_of_part(part), said.get("name", ""), "" if ranged else part.get("id", ""),
                                int(first or 0) if ranged else 0, int(last or 0) + 1 if ranged else 0,
                            )
                        )  # fmt: skip
                own = {m.get("key"): m.get("value", "") for m in element.findall("metadata")}
                found[element.get("id", "")] = own.get("name", ""), volumes
        return file, found

    # what is written ----------------------------------------------------------------------------------------

    def replace(self, piece: Piece, vertices: Floats, faces: Faces) -> None:
        """Give a piece another mesh, in its own coordinates and the file's unit."""
        self._replaced[piece.key] = vertices, faces

    def write(self, path: Path, *, force: bool) -> None:
        """The project with what was replaced. Raises OutputError for what the system refuses."""
        archive = Archive(self.path)
        names = {name.lstrip("/").lower(): name for name in archive.entries}
        new: dict[str, bytes] = {}
        counts: dict[tuple[str, str], list[tuple[int, int]]] = {}
        for file in {key[0] for key in self._replaced}:
            new[names[file.lower()]] = self._model_text(file, counts)
        if new and self._settings_name:
            actual = names[self._settings_name]
            new[actual] = self._settings_text(archive.read(actual, 64 << 20), counts)
        with whole_file(path, force=force) as target:
            archive.rewrite(target, new)

    def _ranges(self, file: str, object_id: str) -> list[tuple[int, int]]:
        """Where the pieces of a mesh begin and end, in order; what no piece names is one, too."""
        count = len(self._mesh(file, object_id).corners) // 3
        named = sorted((v.first, v.stop) for v in self._settings.get(object_id, ("", []))[1] if not v.component)
        return named if file == self.root and named else [(0, count)]

    def _model_text(self, file: str, counts: dict[tuple[str, str], list[tuple[int, int]]]) -> bytes:
        model = self._models[file]
        out, at = [], 0
        for object_id, mesh in sorted(model.meshes.items(), key=lambda one: one[1].start):
            if not any(key[:2] == (file, object_id) for key in self._replaced):
                continue
            text, ranges = self._mesh_text(file, object_id, mesh)
            counts[file, object_id] = ranges
            out += [model.text[at : mesh.start], text]
            at = mesh.stop
        return b"".join([*out, model.text[at:]])

    def _mesh_text(self, file: str, object_id: str, mesh: MeshText) -> tuple[bytes, list[tuple[int, int]]]:
        """The text of a mesh, and where each of its pieces is now."""
        vertices, faces = mesh.arrays(f"{self.path}: {file}")
        all_vertices, all_faces, ranges = [], [], []
        paint: dict[int, str] = {}
        count = total = 0
        for first, stop in self._ranges(file, object_id):
            old = faces[first:stop]
            painted = {k - first: text for k, text in mesh.attributes.items() if first <= k < stop}
            if (file, object_id, first) in self._replaced:
                new_vertices, new_faces = self._replaced[file, object_id, first]
                painted = self._moved_paint(painted, vertices, old, new_vertices, new_faces)
            else:
                used, number = np.unique(old, return_inverse=True)
                new_vertices, new_faces = vertices[used], number.reshape(-1, 3).astype(np.int32)
            paint |= {k + total: text for k, text in painted.items()}
            all_vertices.append(new_vertices)
            all_faces.append(new_faces.astype(np.int64) + count)
            count += len(new_vertices)
            ranges.append((total, total + len(new_faces)))
            total += len(new_faces)
        return written(mesh.prefix, all_vertices, all_faces, paint), ranges

    def _moved_paint(
        self, painted: dict[int, str], vertices: Floats, old: Faces, new_vertices: Floats, new: Faces
    ) -> dict[int, str]:
        """What hangs on triangles, on those with the same corners."""
        if not painted:
            return {}
        where = {key: k for k, key in enumerate(_triangle_keys(new_vertices, new))}
        keys = _triangle_keys(vertices, old[list(painted)])
        found = {where[key]: text for key, text in zip(keys, painted.values(), strict=True) if key in where}
        kept = sum(bool(PAINTED.search(text)) for text in found.values())
        self.kept_paint += kept
        self.lost_paint += sum(bool(PAINTED.search(text)) for text in painted.values()) - kept
        return found

    def _settings_text(self, text: bytes, counts: dict[tuple[str, str], list[tuple[int, int]]]) -> bytes:
        """Settings with firstid and lastid of every volume, and face counts of parts, as they are now."""
        decoded = text.decode("utf-8")
        parts_of = {object_id: ranges for (file, object_id), ranges in counts.items() if file == self.root}
        faces_of = {key: ranges[-1][1] for key, ranges in counts.items()}

        components = self._models[self.root].components

        def in_object(match: re.Match[str]) -> str:
            ranges = parts_of.get(match[2])
            body = match[0]
            if ranges is not None:
                order = self._order(match[2])
                numbers = iter(order)

                def renumbered(tag: re.Match[str]) -> str:
                    first, stop = ranges[next(numbers)]
                    changed = re.sub(r'(firstid=")[^"]*"', rf'\g<1>{first}"', tag[0])
                    return re.sub(r'(lastid=")[^"]*"', rf'\g<1>{stop - 1}"', changed)

                body = re.sub(r"<volume\b[^>]*\bfirstid=[^>]*>", renumbered, body)

            files = {component: file or self.root for file, component, _ in components.get(match[2], [])}

            def counted(part: re.Match[str]) -> str:
                now = faces_of.get((files.get(part[1], ""), part[1]))
                return part[0] if now is None else re.sub(r'(face_count=")\d*"', rf'\g<1>{now}"', part[0])

            return re.sub(r'<part\b[^>]*\bid="([^"]*)".*?</part>', counted, body, flags=re.S)

        return re.sub(r'(<object\b[^>]*\bid="([^"]*)"[^>]*>)(.*?)</object>', in_object, decoded, flags=re.S).encode()

    def _order(self, object_id: str) -> list[int]:
        """Of the volumes of an object as its settings list them, which of the sorted ranges each is."""
        volumes = [(v.first, v.stop) for v in self._settings[object_id][1] if not v.component]
        ranks = sorted(volumes)
        return [ranks.index(one) for one in volumes]


def machine_of(path: Path) -> tuple[list[str], float | None]:
    """(what a project calls its printer, its nozzle in mm), by the slicer's settings in it, if it has any."""
    names: list[str] = []
    nozzle: float | None = None
    with Package(path) as package:
        for name in package.names():
            if name not in ("metadata/slic3r_pe.config", "metadata/slic3r.config", "metadata/superslicer.config",
                            "metadata/prusa_slicer.config", "metadata/project_settings.config"):  # fmt: skip
                continue
            with closing(package.pieces(name)) as pieces:
                text = b"".join(pieces).decode("utf-8", "replace")
            if name.endswith("project_settings.config"):
                try:
                    said = json.loads(text)
                except (ValueError, RecursionError):
                    said = {}
                said = said if isinstance(said, dict) else {}
            else:
                said = dict(re.findall(r"(?m)^[ ;]*(\w+) = (.*?)\r?$", text))
            names = [str(said[key]) for key in ("printer_settings_id", "printer_model") if said.get(key)]
            value = said.get("nozzle_diameter", "")
            number = re.match(r"\d*\.?\d+", str(value[0] if isinstance(value, list) and value else value))
            nozzle = float(number[0]) if number else None
    return names, nozzle


def _shape(matrix: Floats) -> Floats:
    """What a placement does beside moving along and turning on the plate: heights and sizes."""
    linear = matrix[:3]
    return np.concatenate([linear[:, 2], [np.linalg.det(linear)], (linear[:, :2] @ linear[:, :2].T).ravel()])


def _after(first: Floats, then: Floats) -> Floats:
    """One placement after the other."""
    both = first @ then[:3]
    both[3] += then[3]
    return both


def _as(piece: Piece, kind: str) -> Piece:
    return Piece(piece.file, piece.object_id, piece.first, piece.stop, kind, piece.name)


def _triangle_keys(vertices: Floats, faces: Faces) -> list[bytes]:
    """Each triangle by its corners' coordinates as they are written, in the order they are in."""
    corners = np.char.mod("%.9g", vertices) if len(vertices) else np.empty((0, 3), str)
    lines = [" ".join(row) for row in corners.tolist()]
    keys = []
    for triangle in faces.tolist():
        least = min(range(3), key=lambda k: lines[triangle[k]])
        keys.append("/".join(lines[triangle[(least + k) % 3]] for k in range(3)).encode())
    return keys
