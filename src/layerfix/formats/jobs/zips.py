"""Zip archives read with care and rewritten with only what changed. Specification: APPNOTE.TXT 6.3.10.

A rewritten archive keeps the order, names, comments, times, unknown entries and every untouched entry byte for
byte; only the local header, the data and the directory entry of a replaced one are new. So an archive of
which nothing is replaced comes out identical.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.formats.text_values import abridged

LOCAL, CENTRAL, END = 0x04034B50, 0x02014B50, 0x06054B50
LARGEST_TEXT = 16 << 20  # bytes of a metadata entry
LARGEST_SETTINGS = 1 << 20  # of a settings file; those of real jobs have some 20 kB
LARGEST_DIRECTORY = 32 << 20  # bytes of all entries' records: 100,000 layers need 10 MB
LONGEST_NAME = 255  # bytes of a file's or folder's name, as on every file system
MAX_32 = 0xFFFFFFFF
SMALL_READ = 4096
LOCAL_BYTES = 30 + 2 * 0xFFFF  # of a local header with its name and extra fields, at most
END_BYTES, LOCATOR_BYTES, LOCATOR_64 = 22, 20, 0x07064B50


class Archive:
    """One zip file. Raises InputError for what is no zip, for names that climb out, and for duplicates."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with reading(path):
                _check_directory(path)
                self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, ValueError, NotImplementedError, UnicodeDecodeError, struct.error) as problem:
            raise InputError(f"{path}: not a readable zip file ({problem})") from problem
        self.entries = {info.filename: info for info in self._zip.infolist()}
        if len(self.entries) != len(self._zip.infolist()):
            counts = Counter(info.filename for info in self._zip.infolist())
            twice = counts.most_common(1)[0][0]
            raise InputError(f"{path}: holds two entries called {abridged(twice)}")
        for name in self.entries:
            parts = name.replace("\\", "/").split("/")
            if max(map(len, parts)) > LONGEST_NAME:
                raise InputError(
                    f"{path}: holds an entry called {abridged(name)}; names of more than {LONGEST_NAME} bytes are no"
                    " file's"
                )
            if ".." in parts or name.startswith(("/", "\\")) or ":" in parts[0]:
                raise InputError(f"{path}: holds the entry '{abridged(name)}', which points outside the archive")

    def __contains__(self, name: str) -> bool:
        return name in self.entries

    def read(self, name: str, limit: int = LARGEST_TEXT) -> bytes:
        """All of one entry, checksum verified; refused if it says, or turns out, to be over `limit` bytes."""
        info = self.entries.get(name)
        if info is None:
            raise InputError(f"{self.path}: the entry {name} is missing")
        if info.file_size > limit:
            raise InputError(
                f"{self.path}: entry {abridged(name)} unpacks to {info.file_size} bytes; at most {limit} are expected"
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

    def text(self, name: str, limit: int = LARGEST_SETTINGS) -> str:
        """One entry as text."""
        return self.read(name, limit).decode("utf-8", "replace")

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
            if starts != sorted(starts):
                raise ValueError("an entry lies behind it")
            _copy(source, target, 0, starts[0])  # a self-extractor's program, or anything else in front
            placed: dict[str, tuple[int, bytes | None]] = {}
            for info, start, stop in zip(infos, starts, starts[1:], strict=False):
                at = target.tell()
                data = replaced.get(info.filename)
                fields = None if data is None else _sizes(data, info.compress_type)
                if fields is None:
                    _copy(source, target, start, stop)
                else:
                    source.seek(start)
                    target.write(_local(source.read(min(stop - start, LOCAL_BYTES)), fields))
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


def _check_directory(path: Path) -> None:
    """Raises InputError for a directory too large to be a job's, before zipfile makes objects of it (600 bytes each).

    What is no zip at all is left to zipfile.
    """
    with path.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(max(end - END_BYTES - 0xFFFF - LOCATOR_BYTES, 0))
        tail = file.read()
        at = tail.rfind(struct.pack("<I", END))
        if at < 0 or len(tail) - at < END_BYTES:
            return
        size = struct.unpack_from("<I", tail, at + 12)[0]
        if size == MAX_32 and tail[at - LOCATOR_BYTES : at - LOCATOR_BYTES + 4] == struct.pack("<I", LOCATOR_64):
            file.seek(min(struct.unpack_from("<Q", tail, at - LOCATOR_BYTES + 8)[0], end))
            record = file.read(56)
            size = struct.unpack_from("<Q", record, 40)[0] if len(record) == 56 else 0
    if size > LARGEST_DIRECTORY:
        raise InputError(f"{path}: its directory has {size} bytes; at most {LARGEST_DIRECTORY} are read")


def _copy(source: BinaryIO, target: BinaryIO, start: int, stop: int) -> None:
    """Bytes start … stop - 1, a block at a time."""
    source.seek(start)
    while start < stop and (block := source.read(min(stop - start, 1 << 20))):
        target.write(block)
        start += len(block)


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
