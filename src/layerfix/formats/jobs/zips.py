"""Zip archives read with care and rewritten with only what changed. Specification: APPNOTE.TXT 6.3.10.

A rewritten archive keeps the order, names, comments, times, unknown entries and every untouched entry byte for
byte; only the local header, the data and the directory entry of a replaced one are new. So an archive of
which nothing is replaced comes out identical.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

from layerfix.errors import InputError
from layerfix.files import reading

LOCAL, CENTRAL, END = 0x04034B50, 0x02014B50, 0x06054B50
LARGEST_TEXT = 16 << 20  # bytes of a metadata entry
MAX_32 = 0xFFFFFFFF
SMALL_READ = 4096


class Archive:
    """One zip file. Raises InputError for what is no zip, for names that climb out, and for duplicates."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with reading(path):
                self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, ValueError, NotImplementedError, UnicodeDecodeError, struct.error) as problem:
            raise InputError(f"{path}: not a readable zip file ({problem})") from problem
        self.entries = {info.filename: info for info in self._zip.infolist()}
        if len(self.entries) != len(self._zip.infolist()):
            names = [info.filename for info in self._zip.infolist()]
            twice = next(n for n in names if names.count(n) > 1)
            raise InputError(f"{path}: holds two entries called {twice}")
        for name in self.entries:
            parts = name.replace("\\", "/").split("/")
            if ".." in parts or name.startswith(("/", "\\")) or ":" in parts[0]:
                raise InputError(f"{path}: holds the entry '{name}', which points outside the archive")

    def __contains__(self, name: str) -> bool:
        return name in self.entries

    def read(self, name: str, limit: int = LARGEST_TEXT) -> bytes:
        """All of one entry, checksum verified; refused if it says, or turns out, to be over `limit` bytes."""
        info = self.entries.get(name)
        if info is None:
            raise InputError(f"{self.path}: the entry {name} is missing")
        if info.file_size > limit:
            raise InputError(
                f"{self.path}: entry {name} unpacks to {info.file_size} bytes; at most {limit} are expected"
            )
        data = self.head(name, limit + 1)
        if len(data) > limit:
            raise InputError(f"{self.path}: entry {name} unpacks to over {limit} bytes")
        return data

    def head(self, name: str, size: int) -> bytes:
        """The first so many bytes of one entry."""
        try:
            with self._zip.open(name) as entry:
                # LZMA and BZIP2 have no bound on what one read unpacks but the bytes that go in.
                stored = self.entries[name].compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
                if stored:
                    return entry.read(size)
                parts, left = [], size
                while left > 0 and (part := entry.read(min(left, SMALL_READ))):
                    parts.append(part)
                    left -= len(part)
                return b"".join(parts)
        except Exception as problem:
            # zipfile lets through what its decompressors raise: zlib.error, LZMAError, EOFError, OSError …
            raise InputError(f"{self.path}: entry {name} cannot be read ({problem})") from problem

    def text(self, name: str) -> str:
        """One entry as text."""
        return self.read(name).decode("utf-8", "replace")

    def same(self, name: str, other: str) -> bool:
        """Whether two entries are the same bytes: same size and checksum in the directory."""
        a, b = self.entries[name], self.entries[other]
        return (a.CRC, a.file_size) == (b.CRC, b.file_size)

    def rewrite(self, target: BinaryIO, replaced: Mapping[str, bytes]) -> None:
        """Write the archive with some entries' data replaced.

        Raises InputError for zip64 archives and for directories that do not add up.
        """
        try:
            self._rewrite(target, replaced)
        except (struct.error, ValueError) as problem:
            raise InputError(f"{self.path}: a zip file whose directory does not add up ({problem})") from problem

    def _rewrite(self, target: BinaryIO, replaced: Mapping[str, bytes]) -> None:
        with self.path.open("rb") as source:
            directory_at, directory, comment = self._directory(source)
            infos = sorted(self._zip.infolist(), key=lambda info: info.header_offset)
            starts = [info.header_offset for info in infos] + [directory_at]
            if starts[0]:  # a self-extractor's program, or anything else in front
                source.seek(0)
                target.write(source.read(starts[0]))
            placed: dict[str, tuple[int, bytes | None]] = {}
            for info, start, stop in zip(infos, starts, starts[1:], strict=False):
                at = target.tell()
                data = replaced.get(info.filename)
                source.seek(start)
                raw = source.read(stop - start)
                fields = None if data is None else _sizes(data, info.compress_type)
                target.write(raw if fields is None else _local(raw, fields))
                placed[info.filename] = at, None if fields is None else fields.header
            directory_start = target.tell()
            for info, entry in zip(self._zip.infolist(), directory, strict=True):
                at, header = placed[info.filename]
                target.write(_central(entry, at, header))
            size = target.tell() - directory_start
            count = len(directory)
            if directory_start > MAX_32:
                raise InputError(f"{self.path}: over 4 GB; such archives cannot be rewritten")
            target.write(
                struct.pack("<IHHHHIIH", END, 0, 0, count, count, size, directory_start, len(comment)) + comment
            )

    def _directory(self, source: BinaryIO) -> tuple[int, list[bytes], bytes]:
        """(where the directory starts, its raw entries, the archive's comment)."""
        at = self._zip.start_dir
        source.seek(at)
        raw = source.read()
        entries, position = [], 0
        for _ in self._zip.infolist():
            name, extra, remark = struct.unpack_from("<HHH", raw, position + 28)
            size = 46 + name + extra + remark
            entries.append(raw[position : position + size])
            position += size
        if struct.unpack_from("<I", raw, position)[0] != END:
            raise InputError(f"{self.path}: a zip64 archive; such archives can be read but not rewritten")
        return at, entries, self._zip.comment


class _Fields:
    """Data and header fields of a replaced entry: no descriptor follows, the method stays."""

    def __init__(self, method: int, data: bytes, packed: bytes) -> None:
        self.packed = packed
        self.header = struct.pack("<III", zlib.crc32(data), len(packed), len(data))
        self.method = method


def _sizes(data: bytes, method: int) -> _Fields:
    if method == zipfile.ZIP_STORED:
        return _Fields(method, data, data)
    packer = zlib.compressobj(6, zlib.DEFLATED, -15)
    return _Fields(zipfile.ZIP_DEFLATED, data, packer.compress(data) + packer.flush())


def _local(raw: bytes, fields: _Fields) -> bytes:
    """The local header of an entry with new sizes, and the new data."""
    name, extra = struct.unpack_from("<HH", raw, 26)
    version, flags = struct.unpack_from("<HH", raw, 4)
    kept = _without_zip64(raw[30 + name : 30 + name + extra])
    head = struct.pack("<IHHH", LOCAL, version, flags & ~8, fields.method) + raw[10:14] + fields.header
    return head + struct.pack("<HH", name, len(kept)) + raw[30 : 30 + name] + kept + fields.packed


def _without_zip64(extra: bytes) -> bytes:
    """Extra fields without 0x0001, which would give the old sizes once more."""
    kept, at = b"", 0
    while at + 4 <= len(extra):
        kind, size = struct.unpack_from("<HH", extra, at)
        if kind != 1:
            kept += extra[at : at + 4 + size]
        at += 4 + size
    return kept + extra[at:]


def _central(entry: bytes, offset: int, header: bytes | None) -> bytes:
    """A directory entry with its new place, and new sizes if it was replaced."""
    flags, method = struct.unpack_from("<HH", entry, 8)
    if header is not None:
        kept = method if method == zipfile.ZIP_STORED else zipfile.ZIP_DEFLATED
        name, extra = struct.unpack_from("<HH", entry, 28)
        fields = _without_zip64(entry[46 + name : 46 + name + extra])
        entry = (
            entry[:8] + struct.pack("<HH", flags & ~8, kept) + entry[12:16] + header
            + struct.pack("<HH", name, len(fields)) + entry[32 : 46 + name] + fields + entry[46 + name + extra :]
        )  # fmt: skip
    return entry[:42] + struct.pack("<I", offset) + entry[46:]
