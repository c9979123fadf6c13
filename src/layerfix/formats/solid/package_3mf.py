"""3MF packages, written: one object, its place on the plate, and files of slicers beside it.

Specification: 3MF core 1.3, Open Packaging Conventions. A package is a zip of three files and more.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

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
    """A closed surface of one colour, 0xRRGGBB."""

    name: str
    colour: int
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


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


def write_coloured_3mf(path: Path, bodies: Sequence[Body], *, force: bool) -> None:
    """Write objects of one colour each, in their places. Raises OutputError for what the system refuses."""
    with _package(path, force, {}) as model:
        model.write(MODEL_HEAD.encode())
        bases = "".join(f'<base name="{b.name}" displaycolor="#{b.colour:06X}"/>' for b in bodies)
        model.write(f'<basematerials id="1">{bases}</basematerials>\n'.encode())
        for n, body in enumerate(bodies):
            head = f'<object id="{n + 2}" type="model" name="{body.name}" pid="1" pindex="{n}"><mesh>\n<vertices>\n'
            model.write(head.encode())
            _write_mesh(model, [(body.vertices, body.faces)])
            model.write(b"</mesh></object>\n")
        items = "".join(f'<item objectid="{n + 2}"/>' for n in range(len(bodies)))
        model.write(f"</resources>\n<build>{items}</build>\n</model>\n".encode())


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


def _write_mesh(model: IO[bytes], parts: Iterable[tuple[NDArray[np.float64], NDArray[np.int64]]]) -> None:
    """Vertices as they come, then the triangles."""
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
            text = '<triangle v1="%d" v2="%d" v3="%d"/>\n' * len(part[k : k + AT_ONCE])
            model.write((text % tuple(part[k : k + AT_ONCE].ravel().tolist())).encode())
    model.write(b"</triangles>\n")


def _entry(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name, A_LONG_TIME_AGO)
    info.compress_type = zipfile.ZIP_DEFLATED
    return info
