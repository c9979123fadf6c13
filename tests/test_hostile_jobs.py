"""Resin jobs that are cut short, damaged or lie: an error of ours or a result, in little time and memory."""

from __future__ import annotations

import struct
import time
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from layerfix import correct, read, write
from layerfix.errors import InputError, LayerfixError
from tests import independent_readers as plain

SIZE = 30, 70
FLIPS = 200
LONGEST_S = 10.0
LARGEST_BYTES = 1_000_000_000


def layers() -> list[np.ndarray]:
    """Black and white, greys, greys again."""
    thin = plain.thin_bar(*SIZE)
    return [thin, plain.thin_bar(*SIZE, 150), plain.block(*SIZE, 90)]


JOBS: dict[str, Callable[[Path], Path]] = {
    "sl1": lambda folder: plain.write_sl1(folder / "job.sl1", layers()),
    "png zip": lambda folder: plain.write_zip(
        folder / "job.zip", {f"{i}.png": plain.png_bytes(layer) for i, layer in enumerate(layers())}
    ),
    "photon": lambda folder: plain.write_chitu(folder / "job.photon", layers()),
    "cbddlp": lambda folder: plain.write_chitu(folder / "job.cbddlp", layers(), version=2, planes=4),
    "ctb": lambda folder: plain.write_chitu(folder / "job.ctb", layers(), magic=plain.CTB, version=2),
    "ctb 4 with a key": lambda folder: plain.write_chitu(
        folder / "job.ctb", layers(), magic=plain.CTB_V4, version=4, key=0x55AA55AA
    ),
    "goo": lambda folder: plain.write_goo(folder / "job.goo", layers(), differences=True),
}
every_job = pytest.mark.parametrize("kind", JOBS)


def use(path: Path) -> str:
    """Read a file, decode all its layers, correct and write it: what came of it, if nothing worse happened."""
    target = path.with_name("out" + path.suffix)
    target.unlink(missing_ok=True)
    started = time.perf_counter()
    try:
        stack = read(path, pixel_mm=0.05, layer_mm=0.05).with_workers(1)
        for layer in stack:
            assert layer.rows.shape == (stack.height, (stack.width + 63) // 64)
        if stack.width * stack.height < 1 << 20:
            write(target, correct(stack, min_feature_mm=0.3, mode="add_only"))
        outcome, message = "read", path.name
    except LayerfixError as problem:
        outcome, message = "refused", str(problem)
    assert time.perf_counter() - started < LONGEST_S
    assert any(known in message for known in (path.name, target.name, "minimum feature"))
    return outcome


def use_all(path: Path, versions: Iterable[bytes]) -> list[str]:
    """`use` every version of a file, and mind the memory."""
    path = path.with_name("damaged" + path.suffix)
    outcomes = []
    tracemalloc.start()
    try:
        for version in versions:
            path.write_bytes(version)
            outcomes.append(use(path))
        assert tracemalloc.get_traced_memory()[1] < LARGEST_BYTES
    finally:
        tracemalloc.stop()
    assert not list(path.parent.glob("*.part")), "a temporary file is left"
    return outcomes


@every_job
def test_files_that_are_cut_short(tmp_path, kind):
    """At every twentieth of their length: all refused, but for what is cut after the last layer."""
    path = JOBS[kind](tmp_path)
    data = path.read_bytes()
    outcomes = use_all(path, [data[: len(data) * k // 20] for k in range(20)])
    assert use(path) == "read"
    assert outcomes.count("refused") >= 19
    assert outcomes[0] == outcomes[10] == "refused"


@pytest.mark.parametrize("kind", JOBS)
def test_random_bytes_are_wrong(tmp_path, kind):
    """One byte flipped in two hundred places, header and table above all: never another error than ours."""
    path = JOBS[kind](tmp_path)
    data = path.read_bytes()
    rng = np.random.default_rng(20)
    places = rng.integers(0, len(data), FLIPS // 4)
    if kind == "goo":  # 195,112 of its bytes are two pictures
        interesting = [*range(14), *range(195_308, len(data))]
    else:
        interesting = range(len(data))
    places = [*places, *rng.choice(interesting, FLIPS - len(places))]

    def versions() -> Iterable[bytes]:
        for place in places:
            changed = bytearray(data)
            changed[place] ^= int(rng.integers(1, 256))
            yield bytes(changed)

    outcomes = use_all(path, versions())
    assert len(outcomes) == FLIPS


@pytest.mark.parametrize("kind", ["photon", "cbddlp", "ctb", "ctb 4 with a key"])
@pytest.mark.parametrize(
    ("at", "value"),
    [
        (0x44, 0), (0x44, 4), (0x44, 1_000_000), (0x44, 0xFFFFFFFF), (0x40, 0xFFFFFFFF), (0x40, 100_000),
        (0x34, 0), (0x38, 0), (0x34, 65_535), (0x34, 0xFFFFFFFF), (0x38, 1_000_000_000), (0x08, 0),
        (0x0C, 0x7F800000), (0x08, 0xBF800000), (0x20, 0), (0x20, 0x7FC00000),
    ],
)  # fmt: skip
def test_chitu_headers_that_lie(tmp_path, kind, at, value):
    """No layers, too many, a table past the end, an absurd panel, a bed or layer height that is no size."""
    path = JOBS[kind](tmp_path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, at, value)
    assert use_all(path, [bytes(data)]) == ["refused"]


@pytest.mark.parametrize("planes", [0, 17, 1000, 0xFFFFFFFF])
def test_planes_that_cannot_be(tmp_path, planes):
    """0 planes are read as one; more than any program writes are refused."""
    path = JOBS["cbddlp"](tmp_path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, 0x5C, planes)
    assert use_all(path, [bytes(data)]) == ["refused" if planes else "read"]


@pytest.mark.parametrize("kind", ["photon", "ctb", "ctb 4 with a key"])
@pytest.mark.parametrize(
    ("at", "size"), [(0xFFFFFFFF, 1), (0xFFFFFFFF, 0xFFFFFFFF), (0, 0), (200, 10**9), (10**9, 0)]
)
def test_tables_that_point_elsewhere(tmp_path, kind, at, size):
    """Past the end, or at nothing."""
    path = JOBS[kind](tmp_path)
    data = bytearray(path.read_bytes())
    table = struct.unpack_from("<I", data, 0x40)[0]
    struct.pack_into("<II", data, table + 36 + 12, at, size)
    assert use_all(path, [bytes(data)]) == ["refused"]


@pytest.mark.parametrize(("at", "size"), [(0xFFFFFFFF, 1), (200, 10**9)])
@pytest.mark.parametrize("plane", range(4))
def test_data_past_the_end_are_found_at_once(tmp_path, plane, at, size):
    """When the file is opened, in every plane, with the layer's number."""
    path = JOBS["cbddlp"](tmp_path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<II", data, 152 + 36 * (3 * plane + 1) + 12, at, size)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"job\.cbddlp: .*layer 1 ends past the end of the file"):
        read(path)


@pytest.mark.parametrize(
    "heights", [(0.05, 0.05, 0.05), (0.1, 0.05, 0.2), (0.0, float("nan"), 0.1), (0, 1, float("inf"))]
)
@pytest.mark.parametrize("kind", ["photon", "ctb"])
def test_heights_that_do_not_rise(tmp_path, kind, heights):
    """All of them equal, falling, no numbers."""
    path = JOBS[kind](tmp_path)
    data = bytearray(path.read_bytes())
    table = struct.unpack_from("<I", data, 0x40)[0]
    for i, z in enumerate(heights):
        struct.pack_into("<f", data, table + 36 * i, z)
    assert use_all(path, [bytes(data)]) == ["refused"]


def many_layers(path: Path, count: int, place: Callable[[int], int], size_px: tuple[int, int]) -> Path:
    """A photon job of `count` layers whose data are each the rest of the file from `place(i)` on."""
    end = 152 + 36 * count
    table = b"".join(
        plain.TABLE_ENTRY.pack(0.05 * i, 8, 1, place(i), end - 24_000, 0, 36, 0, 0) for i in range(count)
    )
    header = bytearray(path.read_bytes()[:152])
    struct.pack_into("<II", header, 0x34, *size_px)
    struct.pack_into("<II", header, 0x40, 152, count)
    path.write_bytes(bytes(header) + table)
    return path


@pytest.mark.parametrize("place", [lambda i: i % 2, lambda i: i], ids=["two places", "many places"])
def test_many_layers_that_are_all_the_whole_file(tmp_path, place):
    """A table of 24,000 layers whose data are each nearly the whole file opens all the same: looking for layers that
    repeat compares no more bytes than twice the file.
    """
    path = many_layers(JOBS["photon"](tmp_path), 24_000, place, (1440, 2560))
    started = time.perf_counter()
    assert len(read(path)) == 24_000
    assert time.perf_counter() - started < LONGEST_S / 2


def test_layers_with_more_data_than_pixels(tmp_path):
    """The same on a panel of 70 × 30 px is no job; decoding it would go on for hours."""
    path = many_layers(JOBS["photon"](tmp_path), 24_000, lambda i: i % 2, (70, 30))
    with pytest.raises(InputError, match=r"job\.photon: layer 0 has 840152 bytes of runs, more than its 70 × 30 px"):
        read(path)


def test_goo_chunks_without_length(tmp_path):
    """A megabyte of runs of length 0 is nothing, and found out quickly."""
    path = plain.write_goo(tmp_path / "job.goo", layers()[:1], chunks=[bytes(1_000_000)])
    assert use_all(path, [path.read_bytes()]) == ["refused"]


def test_runs_that_are_far_too_long(tmp_path):
    """A hundred thousand runs of 268 million pixels each on a layer of two thousand."""
    path = plain.write_goo(tmp_path / "job.goo", layers()[:1], chunks=[b"\xff\xff\xff\xff" * 100_000])
    assert use_all(path, [path.read_bytes()]) == ["refused"]
    image = np.zeros(SIZE, np.uint8)
    path = plain.write_chitu(tmp_path / "job.ctb", [image], magic=plain.CTB, version=2)
    data = bytearray(path.read_bytes()) + b"\xff\xef\xff\xff\xff" * 100_000
    struct.pack_into("<II", data, 152 + 12, len(data) - 500_000, 500_000)
    assert use_all(path, [bytes(data)]) == ["refused"]


@pytest.mark.parametrize("pixels", [(65_535, 65_535), (1 << 31, 1), (0, 5), (40_000, 30_000)])
@pytest.mark.parametrize("kind", ["sl1", "png zip"])
def test_images_that_claim_an_absurd_size(tmp_path, kind, pixels):
    """A billion pixels in a hundred bytes: refused before anything of that size is made."""
    path = JOBS[kind](tmp_path)
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    for name, data in entries.items():
        if name.endswith(".png") and "thumbnail" not in name:
            head = data[12:16] + struct.pack(">II", *pixels) + data[24:29]
            entries[name] = data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]
    plain.write_zip(path, entries)
    assert use_all(path, [path.read_bytes()]) == ["refused"]


def test_an_image_that_unpacks_to_far_more_than_it_says(tmp_path):
    """A PNG of 70 × 30 px with 200 MB of data."""
    path = JOBS["sl1"](tmp_path)
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    data = entries["part00001.png"]
    body = b"IDAT" + zlib.compress(bytes(200_000_000), 1)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    entries["part00001.png"] = data[:33] + chunk + data[-12:]
    plain.write_zip(path, entries)
    tracemalloc.start()
    try:
        assert use(path) == "refused"
        assert tracemalloc.get_traced_memory()[1] < 50_000_000
    finally:
        tracemalloc.stop()


def test_an_image_with_three_headers(tmp_path):
    """Several IHDR chunks of several sizes: refused, or a layer of the size that the first one says."""
    path = JOBS["sl1"](tmp_path)
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    small = struct.pack(">IIBBBBB", SIZE[1], SIZE[0], 8, 0, 0, 0, 0)
    tall = struct.pack(">IIBBBBB", SIZE[1], 3000, 8, 0, 0, 0, 0)
    deep = struct.pack(">IIBBBBB", SIZE[1], SIZE[0], 16, 0, 0, 0, 0)
    pixels = chunk(b"IDAT", zlib.compress(bytes((SIZE[1] + 1) * 3000)))
    entries["part00001.png"] = (
        plain.png_bytes(layers()[0])[:8] + chunk(b"IHDR", small) + chunk(b"IHDR", tall) + pixels
        + chunk(b"IHDR", deep) + chunk(b"IEND", b"")
    )  # fmt: skip
    use(plain.write_zip(path, entries))


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("job.ctb", plain.CTB_ENCRYPTED.to_bytes(4, "little") + bytes(500)),
        ("job.photon", plain.CTB_ENCRYPTED.to_bytes(4, "little") + bytes(500)),
        ("job.pwmo", b"ANYCUBIC\0\0\0\0" + bytes(500)),
        ("job.pm5s", b"ANYCUBIC\0\0\0\0" + bytes(500)),
        ("job.pwsz", b"PK\5\6" + bytes(18)),
        ("job.PWSZ", b"PK\5\6" + bytes(18)),
    ],
)
def test_formats_that_are_left_to_uvtools(tmp_path, name, data):
    """Encrypted CTB and Anycubic's own: refused by what is in them, with the way round."""
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=rf"{name}: .*UVtoolsCmd extract .*{name}"):
        read(tmp_path / name)


@pytest.mark.parametrize("magic", [0x12FD0018, 0x12FD0020, 0x12FD0087, 0x12FD0108, 0xFF220810, 0])
def test_unknown_magic_numbers(tmp_path, magic):
    """Neighbours of the known ones: not a file that layerfix knows."""
    (tmp_path / "job.ctb").write_bytes(magic.to_bytes(4, "little") + bytes(500))
    with pytest.raises(InputError, match=r"job\.ctb: not a file that layerfix knows"):
        read(tmp_path / "job.ctb")


@pytest.mark.parametrize("data", [b"", b"\0", b"\x19\x00\xfd", b"V3.0", b"PK", b"PK\3\4", b"PK\5\6"])
@pytest.mark.parametrize("suffix", [".sl1", ".goo", ".ctb", ".photon", ".zip"])
def test_next_to_nothing(tmp_path, data, suffix):
    """An empty file, or the first bytes of one."""
    (tmp_path / f"job{suffix}").write_bytes(data)
    with pytest.raises(InputError, match=rf"job{suffix}: "):
        read(tmp_path / f"job{suffix}")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("config.ini", b""), ("config.ini", b"\xff\xfe\0\0"), ("config.ini", b"jobDir\n"),
        ("config.ini", b"jobDir ="),
        ("config.ini", b"jobDir = other\nlayerHeight = 0.05"), ("config.ini", b"jobDir = part\n"),
        ("prusaslicer.ini", b"display_pixels_x = 0\ndisplay_width = 0"), ("prusaslicer.ini", b"display_width = nan"),
        ("prusaslicer.ini", b"display_width=nan\ndisplay_height=1\ndisplay_pixels_x=70\ndisplay_pixels_y=30"),
        ("prusaslicer.ini", b"display_width=-5\ndisplay_height=1\ndisplay_pixels_x=70\ndisplay_pixels_y=30"),
        ("prusaslicer.ini", b"display_width=5\ndisplay_height=1\ndisplay_pixels_x=9e9\ndisplay_pixels_y=1"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense(tmp_path, name, text):
    """Refused with a message that names the file, since no pitch or height is given."""
    entries = plain.sl1_entries(layers())
    entries[name] = text
    path = plain.write_zip(tmp_path / "job.sl1", entries)
    with pytest.raises(InputError, match=r"job\.sl1"):
        read(path)
