"""The package round a 3MF: a zip read with care. Specification: ECMA-376 part 2 (Open Packaging Conventions)."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from types import TracebackType
from xml.etree import ElementTree

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.mesh.reading import unreadable

MODEL_RELATION = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
USUAL_ROOT = "3D/3dmodel.model"
LARGEST_TEXT = 16 << 20  # bytes of a relations or settings file
PIECE = 1 << 18  # bytes unpacked at a time
# Models of vertices and triangles pack 5 to 40 times; deflate reaches 1,030 with one letter repeated.
LARGEST_RATIO, LARGE = 200, 32 << 20


class Package:
    """The files of one package, by name. Raises InputError for what is no zip, and for names that hide something."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with reading(path):
                self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, ValueError, NotImplementedError, LookupError) as problem:
            raise unreadable(path, "3MF", f"no readable zip file ({problem})") from problem
        self._entries: dict[str, zipfile.ZipInfo] = {}
        try:
            self._enter()
        except InputError:
            self._zip.close()
            raise

    def __enter__(self) -> Package:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._zip.close()

    def _enter(self) -> None:
        path = self.path
        for info in self._zip.infolist():
            key = info.filename.lstrip("/").lower()  # names of parts are the same in capitals
            if key in self._entries:
                raise InputError(f"{path}: holds two entries called {info.filename}")
            if ".." in key.replace("\\", "/").split("/"):
                raise InputError(f"{path}: holds the entry '{info.filename}', which points outside the archive")
            self._entries[key] = info

    def __contains__(self, name: str) -> bool:
        return name.lstrip("/").lower() in self._entries

    def names(self) -> list[str]:
        """All names, in small letters."""
        return list(self._entries)

    def pieces(self, name: str) -> Generator[bytes]:
        """One file, unpacked a piece at a time, its checksum verified at the end."""
        info = self._entries.get(name.lstrip("/").lower())
        if info is None:
            raise unreadable(self.path, "3MF", f"its file {name} is missing")
        if info.flag_bits & 1:
            raise unreadable(self.path, "3MF", f"its file {name} is encrypted")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise unreadable(self.path, "3MF", f"its file {name} is not packed with deflate")
        if info.file_size > max(LARGE, LARGEST_RATIO * info.compress_size):
            raise unreadable(
                self.path, "3MF", f"its file {name} unpacks from {info.compress_size} to {info.file_size} bytes"
            )
        try:
            with self._zip.open(info) as stream:
                while piece := stream.read(PIECE):
                    yield piece
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, NotImplementedError) as problem:
            raise unreadable(self.path, "3MF", f"its file {name} is damaged ({problem})") from problem

    def xml(self, name: str) -> ElementTree.Element:
        """A small file of relations or settings as a tree."""
        parts, size = [], 0
        with closing(self.pieces(name)) as pieces:
            for piece in pieces:
                parts.append(piece)
                size += len(piece)
                if size > LARGEST_TEXT:
                    raise unreadable(self.path, "3MF", f"its file {name} is over {LARGEST_TEXT} bytes")
        text = b"".join(parts)
        if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
            raise unreadable(self.path, "3MF", f"its file {name} declares a document type, which 3MF forbids")
        try:
            return ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError, LookupError) as problem:
            raise unreadable(self.path, "3MF", f"its file {name} is broken ({problem})") from problem

    def root(self) -> str:
        """The model file that is the document, as the package's relations name it."""
        if "_rels/.rels" in self:
            for relation in self.xml("_rels/.rels").iter():
                if relation.tag.endswith("Relationship") and relation.get("Type") == MODEL_RELATION:
                    return relation.get("Target") or USUAL_ROOT
        return USUAL_ROOT

    def encrypted(self) -> set[str]:
        """Files that the secure content extension keeps encrypted, in small letters, without the first slash."""
        stores = [name for name in self.names() if name.startswith("secure/") and name.endswith(".xml")]
        found = [element.get("path", "") for name in stores for element in self.xml(name).iter()
                 if element.tag.endswith(("resourcedata", "ResourceData"))]  # fmt: skip
        return {path.lstrip("/").lower() for path in found}
