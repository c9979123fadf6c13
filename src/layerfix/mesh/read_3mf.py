"""3MF files: every build item with its place, unit and parts. Specification: 3MF core 1.4, production 1.1.

Our own reader because trimesh's (5.2) loses objects that share a part number, the other files of the
production extension (Bambu Studio and OrcaSlicer write every object to a file of its own), repeats
objects that are used twice, and knows neither beams nor what is negative.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from layerfix.errors import InputError
from layerfix.mesh.beams import solid_beams
from layerfix.mesh.bodies import NO_COLOUR, Bodies
from layerfix.mesh.model_3mf import Model, Object, Use, extension_name, parse_model
from layerfix.mesh.package import Package
from layerfix.mesh.reading import Read, several, unreadable
from layerfix.mesh.settings_3mf import NEGATIVE, SOLID, Volumes, read_settings
from layerfix.mesh.triangles import Clip, Mesh, Part
from layerfix.units import mm_per_unit

DEEPEST = 100  # components in components
MOST_COPIED, MOST_COPIES = (
    10_000_000,
    100,
)  # triangles, and how many times those in the file, before copies are a trap
IDLE = "negative volume with nothing before it to cut", "negative volumes with nothing before them to cut"
SOLID_TYPES = ("model", "solidsupport")  # section 4.1: the others must not be filled

Points = NDArray[np.float64]
Faces = NDArray[np.int32]
Numbers = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _Shape:
    """Triangles on vertices of their own; which of the bodies called `names` each is of, and its colour."""

    points: Points
    faces: Faces
    of: Numbers
    colours: Numbers
    names: tuple[str, ...] = ("",)
    items: tuple[int, ...] = (0,)  # of each body: those of one object, in one place, have the same

    def placed(self, matrices: NDArray[np.float64]) -> _Shape:
        """A copy for each of (k, 4, 3) matrices for row vectors; those that mirror turn the triangles over."""
        k, n = len(matrices), len(self.points)
        points = (self.points @ matrices[:, :3] + matrices[:, 3:]).reshape(-1, 3)
        mirrored = np.linalg.det(matrices[:, :3]) < 0
        faces = np.where(mirrored[:, None, None], self.faces[:, ::-1], self.faces[None])
        faces = (faces + (n * np.arange(k, dtype=np.int32))[:, None, None]).reshape(-1, 3)
        of = (self.of + (len(self.names) * np.arange(k, dtype=np.int32))[:, None]).reshape(-1)
        items = tuple(copy * (max(self.items) + 1) + item for copy in range(k) for item in self.items)
        return _Shape(points, faces, of, np.tile(self.colours, k), self.names * k, items)

    def as_one(self) -> _Shape:
        """All bodies as those of one object."""
        return replace(self, items=(0,) * len(self.names))

    def chosen(self, first: int, stop: int) -> _Shape:
        return _Shape(self.points, self.faces[first:stop], self.of[first:stop], self.colours[first:stop], self.names,
                      self.items)  # fmt: skip

    def bounds(self) -> tuple[Points, Points]:
        used = self.points[self.faces.reshape(-1)]
        return used.min(axis=0), used.max(axis=0)

    def meets(self, other: _Shape) -> bool:
        (low, high), (other_low, other_high) = self.bounds(), other.bounds()
        return bool((low <= other_high).all() and (other_low <= high).all())


def _plain(points: Points, faces: Faces, name: str = "", colours: Numbers | None = None) -> _Shape:
    """A shape of one body."""
    colours = np.full(len(faces), NO_COLOUR, np.int32) if colours is None else colours
    return _Shape(points, faces, np.zeros(len(faces), np.int32), colours, (name,))


NOTHING = _plain(np.empty((0, 3)), np.empty((0, 3), np.int32))


def _joined(shapes: Iterable[_Shape]) -> _Shape:
    shapes = [shape for shape in shapes if len(shape.faces)]
    if len(shapes) < 2:
        return shapes[0] if shapes else NOTHING
    starts = np.cumsum([0, *(len(shape.points) for shape in shapes)], dtype=np.int64)
    faces = [shape.faces + np.int32(start) for shape, start in zip(shapes, starts[:-1], strict=True)]
    before = np.cumsum([0, *(len(shape.names) for shape in shapes)], dtype=np.int64)
    items = np.cumsum([0, *(max(shape.items) + 1 for shape in shapes)]).tolist()
    return _Shape(
        np.concatenate([shape.points for shape in shapes]),
        np.concatenate(faces),
        np.concatenate([shape.of + np.int32(start) for shape, start in zip(shapes, before[:-1], strict=True)]),
        np.concatenate([shape.colours for shape in shapes]),
        tuple(name for shape in shapes for name in shape.names),
        tuple(first + item for shape, first in zip(shapes, items, strict=False) for item in shape.items),
    )


@dataclass(frozen=True, eq=False)
class _Clipped:
    """A shape and what bounds it: (shape, whether what is inside of it is kept)."""

    shape: _Shape
    united: bool
    clips: tuple[tuple[_Shape, bool], ...]


@dataclass(frozen=True, eq=False)
class _Solid:
    """An object with all of its components: triangles, beams (whose shells unite), and what is clipped."""

    plain: _Shape = NOTHING
    united: _Shape = NOTHING
    clipped: tuple[_Clipped, ...] = ()

    def placed(self, matrices: NDArray[np.float64]) -> _Solid:
        clipped = tuple(
            _Clipped(c.shape.placed(m), c.united, tuple((shape.placed(m), inside) for shape, inside in c.clips))
            for c in self.clipped
            for m in matrices[:, None]
        )
        return _Solid(self.plain.placed(matrices), self.united.placed(matrices), clipped)

    def all_triangles(self) -> _Shape:
        return _joined([self.plain, self.united, *(c.shape for c in self.clipped)])

    def without(self, negative: _Shape) -> _Solid:
        """What is left outside of a negative volume."""
        if not len(negative.faces):
            return self
        clipped = [_Clipped(self.plain, False, ()), _Clipped(self.united, True, ()), *self.clipped]
        cut = [_Clipped(c.shape, c.united, (*c.clips, (negative, False))) if c.shape.meets(negative) else c
               for c in clipped if len(c.shape.faces)]  # fmt: skip
        return _Solid(
            _joined(c.shape for c in cut if not c.clips and not c.united),
            _joined(c.shape for c in cut if not c.clips and c.united),
            tuple(c for c in cut if c.clips),
        )


def _union(solids: Iterable[_Solid]) -> _Solid:
    solids = list(solids)
    return _Solid(
        _joined(s.plain for s in solids),
        _joined(s.united for s in solids),
        tuple(c for s in solids for c in s.clipped),
    )


def recognises(head: bytes, size: int) -> bool:
    """A zip that holds what only a 3MF holds at its start: its content types, a model, or relations."""
    names = (b"[Content_Types].xml", b"_rels/.rels", b"3D/", b".model", b"3d/")
    return head[:4] == b"PK\x03\x04" and any(name in head for name in names)


def read(path: Path) -> Read:
    """All that is to be printed of the build; notes say what is not. Raises InputError for what cannot be read."""
    with Package(path) as package:
        file = _File(path, package)
        solid = file.solid()
    parts: list[Part] = []
    shapes = [solid.plain]
    at = len(solid.plain.faces)
    bodies = [body for body in (_Clipped(solid.united, True, ()), *solid.clipped) if len(body.shape.faces)]
    # The same negative volume may cut many bodies: it is one mesh, and is sliced once.
    meshes = {id(shape): Mesh(shape.points, shape.faces, path.name) for body in bodies for shape, _ in body.clips}
    for body in bodies:
        clips = tuple(Clip(meshes[id(shape)], inside) for shape, inside in body.clips)
        parts.append(Part((at, at + len(body.shape.faces)), clips, body.united))
        shapes.append(body.shape)
        at += len(body.shape.faces)
    whole = _joined(shapes)
    if not len(whole.faces):
        notes = f" ({'; '.join(file.notes())})" if file.notes() else ""
        raise InputError(f"{path}: no triangles: the file has nothing to build{notes}")
    apart = _bodies(whole) if not parts else None
    return Read(Mesh(whole.points, whole.faces, path.name, tuple(file.notes()), tuple(parts), apart), file.unit)


def _bodies(whole: _Shape) -> Bodies | None:
    """The bodies that have triangles; None if there is one without colour."""
    used, of = np.unique(whole.of, return_inverse=True)
    if len(used) < 2 and (whole.colours == NO_COLOUR).all():
        return None
    names, items = ([each[k] for k in used] for each in (whole.names, whole.items))
    return Bodies(of.astype(np.int32), tuple(names), tuple(np.unique(items, return_inverse=True)[1].tolist()),
                  whole.colours)  # fmt: skip


class _File:
    """One 3MF while it is read."""

    def __init__(self, path: Path, package: Package) -> None:
        self._path, self._package = path, package
        self._encrypted = self._package.encrypted()
        self._settings = read_settings(self._package)
        self._models: dict[str, Model] = {}
        self._sizes: dict[tuple[str, str], int | None] = {}
        self._used: Counter[tuple[str, str]] = Counter()
        self._built: dict[tuple[str, str], _Solid] = {}
        self._left_out: Counter[tuple[str, str, str]] = Counter()  # (words before, one, many)
        self._root = self._package.root()
        self.unit = self._model(self._root).unit

    def solid(self) -> _Solid:
        """Everything that the build places."""
        root = self._model(self._root)
        total = sum(self._size(use, 0) for use in root.build)
        stored = sum(len(found.faces) for model in self._models.values() for found in model.objects.values())
        if total > max(MOST_COPIED, MOST_COPIES * stored):
            raise unreadable(self._path, "3MF", f"its copies come to {total} triangles, from {stored} in the file")
        return _union(self._in_place(root.build))

    def notes(self) -> list[str]:
        """What was left out, and what the file recommends in vain."""
        notes = [f"{before}{several(n, one, many)} left out" for (before, one, many), n in self._left_out.items()]
        for model in self._models.values():
            if model.hidden:
                notes.append(f"{several(model.hidden, 'item')} marked as not printable left out")
            notes += [f"the file recommends the extension {extension_name(uri)}, which is not read"
                      for uri in model.recommended]  # fmt: skip
        return notes

    def _model(self, part: str) -> Model:
        key = part.lstrip("/").lower()
        if key not in self._models:
            if key in self._encrypted:
                raise unreadable(self._path, "3MF", f"its file {part} is encrypted (secure content)")
            try:
                with closing(self._package.pieces(part)) as pieces:
                    self._models[key] = parse_model(pieces, part)
            except InputError as problem:
                text = str(problem)
                raise problem if str(self._path) in text else unreadable(self._path, "3MF", text) from problem
            except (ValueError, KeyError, OverflowError) as problem:
                reason = f"{part} has a number that is none or is missing ({' '.join(str(problem).split())[:80]})"
                raise unreadable(self._path, "3MF", reason) from problem
        return self._models[key]

    def _find(self, key: tuple[str, str]) -> Object:
        found = self._model(key[0]).objects.get(key[1])
        if found is None:
            raise unreadable(self._path, "3MF", f"object {key[1][:40]} is missing in {key[0]}")
        return found

    def _size(self, use: Use, depth: int) -> int:
        """Triangles (and beams, which become about a hundred each) of an object with its components, all copies."""
        key = (use.part, use.object_id)
        self._used[key] += 1
        if depth > DEEPEST:
            raise unreadable(self._path, "3MF", f"components are nested over {DEEPEST} deep")
        if key not in self._sizes:
            self._sizes[key] = None
            found = self._find(key)
            own = len(found.faces) + (100 * len(found.lattice.caps) if found.lattice else 0)
            self._sizes[key] = own + sum(self._size(component, depth + 1) for component in found.components)
        size = self._sizes[key]
        if size is None:
            raise unreadable(self._path, "3MF", f"object {use.object_id[:40]} is part of itself")
        return size

    def _in_place(self, uses: list[Use]) -> list[_Solid]:
        """Objects with their components, in the places that they are used in."""
        places: dict[tuple[str, str], list[tuple[float, ...]]] = {}
        for use in uses:
            places.setdefault((use.part, use.object_id), []).append(use.matrix)
        # The same object in the same place twice is there once.
        matrices = {key: np.array(list(dict.fromkeys(each))).reshape(-1, 4, 3) for key, each in places.items()}
        return [self._object(key).placed(each) for key, each in matrices.items()]

    def _object(self, key: tuple[str, str]) -> _Solid:
        """An object with its components, in its own place. Kept only if it is used again."""
        if key in self._built:
            return self._built[key]
        found = self._find(key)
        volumes = self._settings.get(key[1], Volumes()) if key[0] == self._root else Volumes()
        if found.kind in SOLID_TYPES:
            self._left_out.update((f"{extension_name(uri)} of ", "object", "objects") for uri in found.foreign)
            solid = self._combined([*self._own(key, found, volumes), *self._of_components(found, volumes)])
            solid = replace(solid, plain=solid.plain.as_one())
        else:
            self._left_out["", f"object of type '{found.kind[:40]}'", f"objects of type '{found.kind[:40]}'"] += 1
            solid = _Solid()
        if self._used[key] > 1:
            self._built[key] = solid
        return solid

    def _own(self, key: tuple[str, str], found: Object, volumes: Volumes) -> list[tuple[str, _Solid]]:
        """The object's own mesh, by its volumes, and its beams."""
        mesh = _plain(found.points, found.faces, found.name, self._model(key[0]).colours_of(found))
        pieces: list[tuple[str, _Solid]] = []
        at = 0
        for first, stop, kind in sorted(volumes.ranges, key=lambda volume: volume[0]):
            pieces.append((SOLID, _Solid(mesh.chosen(at, max(first, at)))))  # triangles of no volume
            pieces.append((kind, _Solid(mesh.chosen(max(first, at), stop))))
            at = max(at, stop)
        kind = volumes.kind_of_component(key[1], 0) if not found.components else SOLID
        pieces.append((kind, _Solid(mesh.chosen(at, len(mesh.faces)))))
        if found.lattice is not None:
            pieces.append((kind, self._beams(key, found)))
        return [(kind, solid) for kind, solid in pieces if solid.clipped or len(solid.all_triangles().faces)]

    def _beams(self, key: tuple[str, str], found: Object) -> _Solid:
        assert found.lattice is not None
        try:
            mm = mm_per_unit(self.unit)
        except InputError:
            mm = 1.0  # another one is given, or it is refused later
        try:
            shape, short = solid_beams(found.points, found.lattice, mm)
        except InputError as problem:
            raise unreadable(self._path, "3MF", str(problem)) from problem
        if short:
            self._left_out["", "beam shorter than minlength", "beams shorter than minlength"] += short
        mode, clip_id = found.lattice.clip
        if mode == "none":
            return _Solid(united=_plain(*shape, found.name))
        clip = self._model(key[0]).objects.get(clip_id)
        if mode not in ("inside", "outside") or clip is None or not len(clip.faces):
            what = f"the beams of object {key[1][:40]} are clipped '{mode[:40]}' of the object '{clip_id[:40]}'"
            raise unreadable(self._path, "3MF", f"{what}, which has no mesh")
        clips = ((_plain(clip.points, clip.faces), mode == "inside"),)
        return _Solid(clipped=(_Clipped(_plain(*shape, found.name), True, clips),) if len(shape[1]) else ())

    def _of_components(self, found: Object, volumes: Volumes) -> list[tuple[str, _Solid]]:
        if not volumes.components:
            return [(SOLID, solid) for solid in self._in_place(found.components)]
        nth: Counter[str] = Counter()
        pieces = []
        for component in found.components:
            kind = volumes.kind_of_component(component.object_id, nth[component.object_id])
            nth[component.object_id] += 1
            pieces += [(kind, solid) for solid in self._in_place([component])]
        return pieces

    def _combined(self, pieces: list[tuple[str, _Solid]]) -> _Solid:
        """The pieces of one object: what is negative is cut from all solid pieces before it.

        PrusaSlicer 2.5 cuts nothing from pieces that come later in the list (tried: 8.0 cm³ are left of a cube whose
        negative volume is listed first, 6.1 where it is listed last); its editor keeps negative volumes last.
        """
        negatives: list[_Shape] = []
        solids: list[_Solid] = []
        for k in range(len(pieces) - 1, -1, -1):
            kind, solid = pieces[k]
            if kind == NEGATIVE:
                if not any(before == SOLID for before, _ in pieces[:k]):
                    self._left_out[
                        "",
                        "negative volume with nothing before it to cut",
                        "negative volumes with nothing before them to cut",
                    ] += 1
                negatives.append(solid.all_triangles())
            elif kind == SOLID:
                solids.append(solid.without(_joined(negatives)))
            else:
                self._left_out["", kind, f"{kind}s"] += 1
        return _union(reversed(solids))
