"""3MF packages, written: one object, its place on the plate, and files of slicers beside it.

Specification: 3MF core 1.3, Open Packaging Conventions. A package is a zip of three files and more.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from layerfix.files import A_LONG_TIME_AGO, whole_file

if TYPE_CHECKING:
    from numpy.typing import NDArray

TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    '<Default Extension="config" ContentType="text/xml"/><Default Extension="xml" ContentType="text/xml"/>'
    "</Types>\n"
)
RELATIONS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="rel-1"'
    ' Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>\n'
)
MODEL_HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<model unit="millimeter" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">\n'
    '<metadata name="Application">layerfix</metadata>\n<resources>'
)
AT_ONCE = 65536  # vertices or triangles turned into text together


class Body(NamedTuple):
    """A surface with a name.

    colours  0xRRGGBB of each triangle, below 0 for none
    item     bodies with the same number are parts of one object
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colours: NDArray[np.int32]
    item: int = 0


def write_3mf(
    path: Path,
    parts: Iterable[tuple[NDArray[np.float64], NDArray[np.int64]]],
    *,
    force: bool,
    place_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    attachments: Mapping[str, str] | None = None,
) -> None:
    """Write one object made of (vertices in mm, faces) parts, moved by `place_mm`, and attachments by their name.

    Vertices go to the file as they come; faces wait in memory. Raises OutputError for what the system refuses.
    """
    with _package(path, force, attachments or {}) as model:
        model.write(MODEL_HEAD.encode())
        model.write(b'<object id="1" type="model"><mesh>\n<vertices>\n')
        _write_mesh(model, parts)
        place = " ".join(f"{v:.6g}" for v in place_mm)
        model.write(b"</mesh></object></resources>\n<build>")
        model.write(f'<item objectid="1" transform="1 0 0 0 1 0 0 0 1 {place}"/></build>\n</model>\n'.encode())


def write_bodies_3mf(path: Path, bodies: Sequence[Body], *, force: bool) -> None:
    """Write objects in their places, each with its parts, their names and colours (core specification, section 5).

    Raises OutputError for what the system refuses.
    """
    palette = sorted({int(c) for body in bodies for c in np.unique(body.colours) if c >= 0})
    place = {colour: n for n, colour in enumerate(palette)}
    objects = {body.item: [n for n, b in enumerate(bodies) if b.item == body.item] for body in bodies}
    with _package(path, force, {}) as model:
        model.write(MODEL_HEAD.encode())
        if palette:
            bases = "".join(f'<base name="#{c:06X}" displaycolor="#{c:06X}"/>' for c in palette)
            model.write(f'<basematerials id="1">{bases}</basematerials>\n'.encode())
        for n, body in enumerate(bodies):
            usual = _usual(body.colours)
            looks = f' pid="1" pindex="{place[usual]}"' if usual >= 0 else ""
            head = f'<object id="{n + 2}" type="model" name={_quoted(body.name)}{looks}><mesh>\n<vertices>\n'
            model.write(head.encode())
            paint = np.array([place.get(int(c), -1) if c != usual else -1 for c in body.colours]) if palette else None
            _write_mesh(model, [(body.vertices, body.faces)], paint)
            model.write(b"</mesh></object>\n")
        items = []
        for number, parts in enumerate(objects.values(), len(bodies) + 2):
            items.append(parts[0] + 2 if len(parts) == 1 else number)
            if len(parts) > 1:
                components = "".join(f'<component objectid="{n + 2}"/>' for n in parts)
                model.write(
                    f'<object id="{number}" type="model"><components>{components}</components></object>'.encode()
                )
        build = "".join(f'<item objectid="{number}"/>' for number in items)
        model.write(f"</resources>\n<build>{build}</build>\n</model>\n".encode())


def _usual(colours: NDArray[np.int32]) -> int:
    """The commonest colour, or below 0: one with triangles that have none has no colour as a whole."""
    each, count = np.unique(colours, return_counts=True)
    return int(each[count.argmax()]) if each[0] >= 0 else -1


def _quoted(name: str) -> str:
    """As the value of an attribute: what XML cannot hold is left out."""
    return quoteattr("".join(c for c in name if c.isprintable()))


@contextmanager
def _package(path: Path, force: bool, attachments: Mapping[str, str]) -> Iterator[IO[bytes]]:
    """The model's own file within a package, which appears whole."""
    with whole_file(path, force=force) as file, zipfile.ZipFile(file, "w") as z:
        z.writestr(_entry("[Content_Types].xml"), TYPES)
        z.writestr(_entry("_rels/.rels"), RELATIONS)
        with z.open(_entry("3D/3dmodel.model"), "w", force_zip64=True) as model:
            yield model
        for name, content in attachments.items():
            z.writestr(_entry(name), content)


def _write_mesh(
    model: IO[bytes],
    parts: Iterable[tuple[NDArray[np.float64], NDArray[np.int64]]],
    paint: NDArray[np.int64] | None = None,
) -> None:
    """Vertices as they come, then the triangles; paint: which base material each has, below 0 for the object's."""
    faces: list[NDArray[np.int64]] = []
    count = 0
    for vertices, triangles in parts:
        faces.append((triangles + count).astype(np.int64))
        count += len(vertices)
        for k in range(0, len(vertices), AT_ONCE):
            text = '<vertex x="%.9g" y="%.9g" z="%.9g"/>\n' * len(vertices[k : k + AT_ONCE])
            model.write((text % tuple(vertices[k : k + AT_ONCE].round(6).ravel().tolist())).encode())
    model.write(b"</vertices>\n<triangles>\n")
    for part in faces:
        for k in range(0, len(part), AT_ONCE):
            own = None if paint is None else paint[k : k + AT_ONCE]
            if own is None or (own < 0).all():
                text = '<triangle v1="%d" v2="%d" v3="%d"/>\n' * len(part[k : k + AT_ONCE])
                model.write((text % tuple(part[k : k + AT_ONCE].ravel().tolist())).encode())
                continue
            for (a, b, c), p in zip(part[k : k + AT_ONCE].tolist(), own.tolist(), strict=True):
                looks = f' pid="1" p1="{p}"' if p >= 0 else ""
                model.write(f'<triangle v1="{a}" v2="{b}" v3="{c}"{looks}/>\n'.encode())
    model.write(b"</triangles>\n")


def _entry(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, A_LONG_TIME_AGO)
    info.compress_type = zipfile.ZIP_DEFLATED
    return info
