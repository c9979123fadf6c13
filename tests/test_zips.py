"""Zip archives: what is not replaced stays byte for byte, what is replaced is sound, and traps are refused."""

from __future__ import annotations

import io
import lzma
import struct
import tracemalloc
import zipfile
import zlib
from itertools import pairwise
from pathlib import Path

import pytest

from layerfix.errors import InputError
from layerfix.formats.jobs.zips import Archive
from tests import independent_readers as plain

WHEN = (2021, 5, 6, 7, 8, 10)
FILES = {
    "config.ini": b"jobDir = part\n" * 20,
    "thumbnail/": b"",
    "thumbnail/a.png": bytes(range(256)) * 3,
    "part00000.png": bytes(5000),
    "naïve ☃.txt": b"snow",
    "empty": b"",
}


def entry(name: str, method: int, **attributes: object) -> zipfile.ZipInfo:
    """An entry's record with a fixed time."""
    info = zipfile.ZipInfo(name, WHEN)
    info.compress_type = method
    for key, value in attributes.items():
        setattr(info, key, value)
    return info


def plain_zip(method: int) -> bytes:
    """Files as zipfile writes them."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in FILES.items():
            archive.writestr(entry(name, method), data)
    return buffer.getvalue()


def commented_zip() -> bytes:
    """A comment, comments and extra fields at every entry, permissions, stored and deflated in turn."""
    extra = struct.pack("<HH5s", 0x7075, 5, b"12345") + struct.pack("<HHI", 0xCAFE, 4, 7)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for k, (name, data) in enumerate(FILES.items()):
            about = {"comment": f"about {name}".encode(), "extra": extra, "external_attr": 0o640 << 16}
            archive.writestr(entry(name, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)[k % 2], **about), data)
        archive.comment = b"a comment\nof two lines"
    return buffer.getvalue()


def streamed_zip() -> bytes:
    """Written to a pipe: sizes and checksums follow the data (flag bit 3)."""

    class Pipe(io.BytesIO):
        def seekable(self) -> bool:
            return False

        def tell(self) -> int:
            raise OSError("not seekable")

        def seek(self, *_: int) -> int:
            raise OSError("not seekable")

    pipe = Pipe()
    with zipfile.ZipFile(pipe, "w") as archive:
        for k, (name, data) in enumerate(FILES.items()):
            archive.writestr(entry(name, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)[k % 2]), data)
    data = pipe.getvalue()
    assert struct.unpack_from("<H", data, 6)[0] & 8
    return data


def gapped_zip() -> bytes:
    """Bytes between the entries that belong to none, and before the directory."""
    data, parts, moved = plain_zip(zipfile.ZIP_DEFLATED), [], {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        starts = [info.header_offset for info in archive.infolist()] + [archive.start_dir]
        at = 0
        for a, b in pairwise(starts):
            moved[a] = at
            parts.append(data[a:b] + b"gap")
            at += b - a + 3
        directory = bytearray(data[archive.start_dir :])
    position = 0
    for _ in FILES:
        name, extra, remark = struct.unpack_from("<HHH", directory, position + 28)
        struct.pack_into("<I", directory, position + 42, moved[struct.unpack_from("<I", directory, position + 42)[0]])
        position += 46 + name + extra + remark
    struct.pack_into("<I", directory, position + 16, at)
    return b"".join(parts) + bytes(directory)


def shuffled_zip() -> bytes:
    """The directory in another order than the entries."""
    data = plain_zip(zipfile.ZIP_DEFLATED)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        start = archive.start_dir
    records, position = [], start
    for _ in FILES:
        size = 46 + sum(struct.unpack_from("<HHH", data, position + 28))
        records.append(data[position : position + size])
        position += size
    return data[:start] + b"".join(reversed(records)) + data[position:]


def prefixed_zip() -> bytes:
    """A program in front, as self-extractors have; the offsets count from the start of the file."""
    buffer = io.BytesIO(b"#!/bin/program\n" * 9)
    buffer.seek(0, 2)
    with zipfile.ZipFile(buffer, "a") as archive:
        for name, data in FILES.items():
            archive.writestr(entry(name, zipfile.ZIP_DEFLATED), data)
    return buffer.getvalue()


def zip64_entry_zip() -> bytes:
    """Local headers that have their sizes in a zip64 field although they are small, as streaming writers do."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in FILES.items():
            with archive.open(entry(name, zipfile.ZIP_DEFLATED), "w", force_zip64=True) as file:
                file.write(data)
    return buffer.getvalue()


ZIPS = {
    "stored": lambda: plain_zip(zipfile.ZIP_STORED),
    "deflated": lambda: plain_zip(zipfile.ZIP_DEFLATED),
    "bzip2": lambda: plain_zip(zipfile.ZIP_BZIP2),
    "lzma": lambda: plain_zip(zipfile.ZIP_LZMA),
    "comments": commented_zip,
    "streamed": streamed_zip,
    "gaps": gapped_zip,
    "shuffled": shuffled_zip,
    "prefix": prefixed_zip,
    "zip64 entries": zip64_entry_zip,
    "nothing in it": lambda: b"PK\5\6" + bytes(18),
}
every_zip = pytest.mark.parametrize("kind", ZIPS)


def saved(folder: Path, kind: str) -> Path:
    path = folder / "job.zip"
    path.write_bytes(ZIPS[kind]())
    return path


def rewritten(path: Path, replaced: dict[str, bytes]) -> Path:
    target = path.with_name("rewritten.zip")
    with target.open("wb") as file:
        Archive(path).rewrite(file, replaced)
    return target


@every_zip
def test_nothing_replaced_is_the_same_file(tmp_path, kind):
    """Byte for byte."""
    path = saved(tmp_path, kind)
    assert rewritten(path, {}).read_bytes() == path.read_bytes()


def facts(info: zipfile.ZipInfo) -> tuple[object, ...]:
    """What of an entry has nothing to do with its data or its place."""
    return (info.filename, info.date_time, info.comment, info.extra, info.external_attr, info.internal_attr,
            info.create_system, info.create_version, info.flag_bits & ~8)  # fmt: skip


@every_zip
def test_replaced_entries(tmp_path, kind):
    """zipfile finds nothing wrong; order, names, times, comments and extra fields stay; others byte for byte."""
    path = saved(tmp_path, kind)
    new = {"config.ini": b"another", "part00000.png": bytes(range(256)) * 99, "empty": b"no more"}
    if kind == "nothing in it":
        new = {}
    target = rewritten(path, new)
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target) as again:
        assert again.testzip() is None
        assert again.namelist() == old.namelist()
        assert again.comment == old.comment
        for a, b in zip(old.infolist(), again.infolist(), strict=True):
            assert facts(a) == facts(b)
            assert again.read(b.filename) == new.get(b.filename, FILES[b.filename])
            if a.filename in new:
                assert b.flag_bits & 8 == 0
                assert b.compress_type == (zipfile.ZIP_STORED if a.compress_type == 0 else zipfile.ZIP_DEFLATED)
    before, after = plain.raw_entries(path), plain.raw_entries(target)
    assert {n: d for n, d in before.items() if n not in new} == {n: d for n, d in after.items() if n not in new}


@pytest.mark.parametrize("kind", ZIPS)
def test_local_headers_agree_with_the_directory(tmp_path, kind):
    """Readers that go by local headers see the sizes, checksums and methods that the directory says."""
    if kind == "nothing in it":
        return
    target = rewritten(saved(tmp_path, kind), {"part00000.png": b"x" * 1000})
    data = target.read_bytes()
    with zipfile.ZipFile(target) as archive:
        info = archive.getinfo("part00000.png")
    flags, method = struct.unpack_from("<HH", data, info.header_offset + 6)
    sizes = struct.unpack_from("<III", data, info.header_offset + 14)
    assert (flags, method) == (info.flag_bits, info.compress_type)
    assert sizes == (info.CRC, info.compress_size, info.file_size)
    name, extra = struct.unpack_from("<HH", data, info.header_offset + 26)
    start = info.header_offset + 30 + name
    assert b"\1\0\x10\0" not in data[start : start + extra], "a zip64 field with the old sizes"


def test_a_prefix_that_the_offsets_do_not_count(tmp_path):
    """A zip with something put in front afterwards: readers allow for it, and so it must stay readable."""
    path = tmp_path / "job.zip"
    path.write_bytes(b"in front" * 9 + plain_zip(zipfile.ZIP_DEFLATED))
    target = rewritten(path, {"config.ini": b"another"})
    assert target.read_bytes().startswith(b"in front" * 9)
    with zipfile.ZipFile(target) as archive:
        assert archive.testzip() is None
        assert archive.read("config.ini") == b"another"
        assert archive.read("part00000.png") == FILES["part00000.png"]


@pytest.mark.parametrize(
    "name", ["../x.png", "a/../../x.png", "/etc/x.png", "..\\x.png", "a\\..\\..\\x", "\\x", "C:/x", "c:x", ".."]
)
def test_names_that_point_outside(tmp_path, name):
    """Refused when opened, with the name."""
    with zipfile.ZipFile(tmp_path / "job.zip", "w") as archive:
        info = zipfile.ZipInfo("x")
        info.filename = name
        archive.writestr(info, b"")
    with pytest.raises(InputError, match=r"job\.zip: holds the entry '.*', which points outside the archive"):
        Archive(tmp_path / "job.zip")


@pytest.mark.parametrize("name", ["a..b.png", "...", "a/..b/c"])
def test_names_that_only_look_so(tmp_path, name):
    """Two dots within a name are no way out."""
    plain.write_zip(tmp_path / "job.zip", {name: b"fine"})
    assert Archive(tmp_path / "job.zip").read(name) == b"fine"


def test_two_entries_of_one_name(tmp_path):
    """Which of them a printer reads nobody knows: refused, with the name."""
    with zipfile.ZipFile(tmp_path / "job.zip", "w") as archive:
        archive.writestr("a.png", b"1")
        archive.writestr("b.png", b"1")
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("a.png", b"2")
    with pytest.raises(InputError, match=r"job\.zip: holds two entries called a\.png"):
        Archive(tmp_path / "job.zip")


def test_a_bomb_that_says_so(tmp_path):
    """The size in the directory is over the limit: not one byte is unpacked."""
    plain.write_zip(tmp_path / "job.zip", {"bomb": bytes(1 << 24)})
    archive = Archive(tmp_path / "job.zip")
    with pytest.raises(InputError, match=r"job\.zip: entry bomb unpacks to 16777216 bytes; at most 1000"):
        archive.read("bomb", 1000)
    assert len(archive.head("bomb", 33)) == 33


def bomb(method: int, size: int) -> bytes:
    """A zip whose one entry unpacks to `size` zeros but says that it unpacks to 100 bytes."""
    if method == zipfile.ZIP_DEFLATED:
        packer = zlib.compressobj(9, zlib.DEFLATED, -15)
        packed = packer.compress(bytes(size)) + packer.flush()
    else:
        filters = [{"id": lzma.FILTER_LZMA1, "preset": 0}]
        properties = lzma._encode_filter_properties(filters[0])
        packed = struct.pack("<BBH", 9, 4, len(properties)) + properties
        packed += lzma.compress(bytes(size), lzma.FORMAT_RAW, filters=filters)
    fields = struct.pack("<HHHHHIII", 20, 0, method, 0, 0x21, zlib.crc32(bytes(100)), len(packed), 100)
    local = b"PK\3\4" + fields + struct.pack("<HH", 4, 0) + b"bomb" + packed
    directory = b"PK\1\2" + struct.pack("<H", 20) + fields + struct.pack("<HHHHHII", 4, 0, 0, 0, 0, 0, 0) + b"bomb"
    return local + directory + struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 1, 1, len(directory), len(local), 0)


@pytest.mark.parametrize(
    "method",
    [
        zipfile.ZIP_DEFLATED,
        pytest.param(
            zipfile.ZIP_LZMA,
        ),
    ],
)
def test_a_bomb_that_says_otherwise(tmp_path, method):
    """The directory says 100 bytes, the data unpack to 300 million: never are many of them in memory."""
    (tmp_path / "job.zip").write_bytes(bomb(method, 300_000_000))
    archive = Archive(tmp_path / "job.zip")
    tracemalloc.start()
    try:
        assert len(archive.read("bomb")) <= 100
    except InputError:
        pass
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 100_000_000


def test_missing_entries_and_wrong_checksums_are_named(tmp_path):
    """The zip and the entry."""
    plain.write_zip(tmp_path / "job.zip", {"a": b"some data"}, zipfile.ZIP_STORED)
    data = (tmp_path / "job.zip").read_bytes()
    (tmp_path / "job.zip").write_bytes(data.replace(b"some data", b"none data"))
    archive = Archive(tmp_path / "job.zip")
    with pytest.raises(InputError, match=r"job\.zip: entry a cannot be read \(Bad CRC-32"):
        archive.read("a")
    with pytest.raises(InputError, match=r"job\.zip: the entry b is missing"):
        archive.read("b")


@pytest.mark.parametrize(
    ("field", "value"), [(42, b"\xff\xff"), (30, b"\xff\x7f"), (32, b"\xff\x7f"), (28, b"\xff\x7f")]
)
def test_a_directory_that_does_not_add_up(tmp_path, field, value):
    """An entry said to lie behind the directory, or longer than that: refused when opened or rewritten."""
    plain.write_zip(tmp_path / "job.zip", {"a": b"some data", "b": b"other data"})
    data = bytearray((tmp_path / "job.zip").read_bytes())
    at = data.rindex(b"PK\1\2") + field
    data[at : at + 2] = value
    (tmp_path / "job.zip").write_bytes(data)
    with pytest.raises(InputError, match=r"job\.zip"):
        rewritten(tmp_path / "job.zip", {"a": b"another"})


def test_a_zip64_archive_is_not_rewritten_wrongly(tmp_path):
    """An archive with a zip64 ending is refused, or comes out sound."""
    data = plain_zip(zipfile.ZIP_STORED)
    at = len(data) - 22
    _, _, _, _, count, size, start, _ = struct.unpack_from("<IHHHHIIH", data, at)
    ending = struct.pack("<IQHHIIQQQQ", 0x06064B50, 44, 45, 45, 0, 0, count, count, size, start)
    locator = struct.pack("<IIQI", 0x07064B50, 0, at, 1)
    (tmp_path / "job.zip").write_bytes(data[:at] + ending + locator + data[at:])
    assert Archive(tmp_path / "job.zip").read("config.ini") == FILES["config.ini"]
    with pytest.raises(InputError, match="zip64"):
        rewritten(tmp_path / "job.zip", {"config.ini": b"another"})
