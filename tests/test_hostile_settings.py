"""Jobs whose text is made to hurt: numbers, names, nesting and patterns without end. Each is refused in one line that
names the file and what is wrong, or read as what it is, in time and memory that follow its size.
"""

from __future__ import annotations

import json
import os
import random
import struct
import tracemalloc
import warnings
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import layerfix as lf
from layerfix.errors import InputError, LayerfixError
from layerfix.formats.jobs.zips import LARGEST_DIRECTORY, Archive
from layerfix.formats.png.encode import encode_png
from layerfix.formats.png.series import numeric_order
from layerfix.formats.text_values import abridged, keyed_numbers, number_above_0, parse_json
from tests.independent_readers import block, png_bytes, sl1_entries, thin_bar, write_zip

IMAGE = png_bytes(thin_bar(24, 42))
DEEP = b"[" * 100_000
LONG = b"9" * 5000  # more digits than int() takes


def job(folder: Path, kind: str, **changed: bytes) -> Path:
    """A job of three layers, with some of its settings files replaced (a dot in a name is written as __)."""
    layers = {f"{i + 1}.png": IMAGE for i in range(3)}
    settings = {
        "cws": {"slice.conf": b"xppm 20\nyppm 20\nthickness 0.05\n"},
        "zip": {"run.gcode": b";machineX:2.1\n;machineY:1.2\n;layerHeight:0.05\n;volume:1\n;weight:1\n;price:1\n"},
        "nanodlp": {"plate.json": b'{"TotalSolidArea": 1}', "profile.json": b'{"Depth": 50}',
                    "slicer.json": b'{"XPixelSize": 50, "YPixelSize": 50}', "info.json": b'[{"MinX": 1}]'},
        "sl1": {k: v for k, v in sl1_entries([block(24, 42)]).items() if k.endswith(".ini")},
    }[kind]  # fmt: skip
    if kind == "sl1":
        layers = {f"part{i:05}.png": IMAGE for i in range(3)}
    settings |= {name.replace("__", "."): data for name, data in changed.items()}
    return write_zip(folder / f"job.{kind}", {**settings, **layers})


def fixed(path: Path) -> Path:
    """Read, corrected and written in place."""
    target = path.with_name(f"out{path.suffix}")
    stack = lf.read(path, pixel_mm=0.05, layer_mm=0.05)
    lf.write(target, lf.correct(stack, min_feature_mm=0.3, mode="add_only"), force=True)
    return target


@pytest.mark.parametrize(
    ("kind", "entry", "data", "words"),
    [
        ("cws", "slice.conf", b"xppm 20\n" + b"1" * 100_000, "slice.conf unpacks to 100008 bytes"),
        ("cws", "slice.conf", b"\n" * 300_000, "slice.conf unpacks to 300000 bytes"),
        ("nanodlp", "plate.json", b'{"TotalSolidArea": 1.2.3}', r"plate.json is not valid JSON"),
        ("nanodlp", "plate.json", b'{"TotalSolidArea": ' + LONG + b"}", r"plate.json is not valid JSON .*digits"),
        ("nanodlp", "plate.json", DEEP, "plate.json is not valid JSON .it is nested too deeply"),
        ("nanodlp", "slicer.json", DEEP, "slicer.json is not valid JSON .it is nested too deeply"),
        ("nanodlp", "profile.json", b'{"a":' * 50_000, "profile.json is not valid JSON .it is nested too deeply"),
        ("nanodlp", "profile.json", b'{"Depth": ' + LONG + b"}", "profile.json is not valid JSON"),
        ("nanodlp", "info.json", DEEP, "info.json is not valid JSON .it is nested too deeply"),
        ("nanodlp", "info.json", b"[1, 2", "info.json is not valid JSON"),
        ("nanodlp", "info.json", b"[]" + b" " * (17 << 20), "info.json unpacks to 17825794 bytes"),
        ("nanodlp", "plate.json", b" " * (2 << 20), "plate.json unpacks to 2097152 bytes"),
        ("sl1", "config.ini", b"jobDir = part\nlayerHeight = " + LONG, r"layerHeight = 9{40}… \(5000 characters\)"),
        ("sl1", "config.ini", b"jobDir = part\nlayerHeight = 1e400", "layerHeight = 1e400; it is above 0"),
        ("sl1", "config.ini", b"jobDir = part\nlayerHeight = 1e300", "layerHeight = 1e300; it is above 0"),
        ("sl1", "config.ini", b"jobDir = part\n" * 100_000, "config.ini unpacks to 1400000 bytes"),
        ("sl1", "prusaslicer.ini", b"display_width = 1\ndisplay_height = 1\ndisplay_pixels_x = 1" + b"0" * 400 +
         b"\ndisplay_pixels_y = 1\n", "the job does not say its pixel pitch"),
        ("zip", "run.gcode", b";machineX:" + LONG + b"\n;machineY:1\n;layerHeight:1\n", "does not say machineX"),
    ],
)  # fmt: skip
def test_settings_that_are_refused(tmp_path, kind, entry, data, words):
    """Before anything is decoded, with the file, the entry and what is wrong with it; nothing is written."""
    path = job(tmp_path, kind, **{entry.replace(".", "__"): data})
    with pytest.raises(InputError, match=rf"job\.{kind}: .*{words}") as caught:
        lf.read(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("kind", "entry", "data"),
    [
        ("cws", "slice.conf", b"1" * 60_000), ("cws", "slice.conf", b"\n" * 60_000),
        ("cws", "slice.conf", b"a" * 30_000 + b"1" * 30_000), ("cws", "slice.conf", b"a=" * 30_000),
        ("cws", "slice.conf", b"a" + b" " * 60_000 + b"1.1.1"), ("cws", "slice.conf", b"\x85" * 60_000),
        ("zip", "run.gcode", b";a:1" + b" " * 70_000 + b"x"), ("zip", "run.gcode", b";" * 70_000),
        ("zip", "run.gcode", b";a:" + b"1" * 70_000), ("zip", "run.gcode", b";volume:1" + b"\n" * 70_000),
        ("zip", "run.gcode", b";volume:0." + b"0" * 300 + b"1\n;weight:5\n;price:1e8\n"),
        ("nanodlp", "plate.json", b'{"TotalSolidArea": 1e400}'), ("nanodlp", "plate.json", b'{"TotalSolidArea":"1"}'),
        ("nanodlp", "plate.json", b'{"TotalSolidArea"' + b" " * 90_000 + b":1}"), ("nanodlp", "plate.json", b"[]"),
        ("nanodlp", "info.json", b'[{"MinX": NaN, "AreaCount": 1e999}]'), ("nanodlp", "info.json", b'{"a": 1}'),
        ("nanodlp", "info.json", b"[" * 300 + b"]" * 300), ("nanodlp", "slicer.json", b'{"ImageMirror": [[]]}'),
        ("sl1", "prusaslicer.ini", b"display_pixels_x = 1" + b"0" * 400 + b"\ndisplay_pixels_y=1\ndisplay_width=1\n"
         b"display_height = 1\n"),
        ("sl1", "config.ini", b"jobDir = part\nlayerHeight = 1\nusedMaterial = " + LONG),
        ("sl1", "config.ini", b"jobDir = part\nlayerHeight = 1\nusedMaterial = 1e999\n" + b"usedMaterial" * 50_000),
    ],
)  # fmt: skip
def test_settings_that_are_odd_but_lie_about_nothing(tmp_path, kind, entry, data):
    """With pitch and height given, the layers are read and corrected; what makes no sense stays as it is."""
    path = job(tmp_path, kind, **{entry.replace(".", "__"): data})
    target = fixed(path)
    stack = lf.read(target, pixel_mm=0.05, layer_mm=0.05)
    assert len(stack) == 3
    assert np.array_equal(stack[1].rows, lf.correct(lf.read(path, pixel_mm=0.05, layer_mm=0.05),
                                                     min_feature_mm=0.3, mode="add_only")[1].rows)  # fmt: skip


@pytest.mark.parametrize("area", ["12.5", "1e3", "1.5E+1", "25e-1", "-1", "0", " 7"])
def test_areas_in_every_notation_of_json(tmp_path, area):
    """The number is replaced whole: 1e3 does not become 1.0000e3 with what was added lost."""
    path = job(tmp_path, "nanodlp", plate__json=f'{{"Path": "x", "TotalSolidArea":{area}, "After": 1}}'.encode())
    before = lf.read(path, pixel_mm=0.05, layer_mm=0.05)
    with zipfile.ZipFile(fixed(path)) as archive:
        text = archive.read("plate.json").decode()
    after = lf.read(path.with_name("out.nanodlp"), pixel_mm=0.05, layer_mm=0.05)
    added = sum(b.count_px() - a.count_px() for a, b in zip(before, after, strict=True)) * 0.05**2
    assert added > 0
    plate = json.loads(text)
    assert plate["TotalSolidArea"] == pytest.approx(max(float(area) + added, 0), abs=1e-3)
    assert text.startswith('{"Path": "x", "TotalSolidArea":')
    assert text.endswith(', "After": 1}')


# Names ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["9" * 5000 + ".png", "a/" + "x" * 300 + ".png", "ü" * 256 + ".png"])
def test_names_that_no_file_has(tmp_path, name):
    """Of more than 255 letters: refused with the beginning of the name, not a screen full of it."""
    path = write_zip(tmp_path / "job.zip", {"1.png": IMAGE, name: IMAGE})
    with pytest.raises(
        InputError, match=r"job\.zip: holds an entry called .{40}… .*names of more than 255"
    ) as caught:
        lf.read(path, pixel_mm=0.05, layer_mm=0.05)
    assert len(str(caught.value)) < 300


def test_numbers_in_names_are_compared_whatever_their_length():
    """As int() would, for as many digits as a name may have; equal numbers keep their places by the rest."""
    names = ["10.png", "9.png", "9" * 5000 + ".png", "1" + "0" * 5000 + ".png", "a1.png", "A02.png", "1.png"]
    expected = ["1.png", "9.png", "10.png", "9" * 5000 + ".png", "1" + "0" * 5000 + ".png", "a1.png", "A02.png"]
    assert sorted(names, key=numeric_order) == expected


@given(st.lists(st.integers(0, 10**30).flatmap(lambda n: st.sampled_from([str(n), f"0{n}", f"000{n}"])), max_size=9))
def test_the_order_of_numbers_is_theirs(numbers):
    """Leading zeros or not."""
    ordered = sorted((f"layer{n}.png" for n in numbers), key=numeric_order)
    assert [int(n[5:-4]) for n in ordered] == sorted(map(int, numbers))


def test_a_duplicate_among_sixty_thousand_entries(tmp_path):
    """Found in one walk; a comparison of all names with all others would take hours."""
    path = tmp_path / "dups.zip"
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(path, "w") as archive:
        for k in [*range(60_000), 59_999]:
            archive.writestr(zipfile.ZipInfo(f"{k}.png"), b"")
    with pytest.raises(InputError, match=r"dups\.zip: holds two entries called 59999\.png"):
        Archive(path)


@pytest.mark.parametrize("zip64", [False, True])
def test_a_directory_of_gigabytes_is_not_read(tmp_path, zip64):
    """By the size it says, before an object is made of each of its records."""
    size = LARGEST_DIRECTORY + 1
    path = tmp_path / "many.zip"
    with path.open("wb") as file:
        file.truncate(size)  # a hole
        file.seek(size)
        if zip64:
            file.write(struct.pack("<IQHHIIQQQQ", 0x06064B50, 44, 45, 45, 0, 0, 700_000, 700_000, size, 0))
            file.write(struct.pack("<IIQI", 0x07064B50, 0, size, 1))
        said = (0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF) if zip64 else (1, 1, size, 0)
        file.write(struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, *said, 0))
    with pytest.raises(InputError, match=rf"many\.zip: its directory has {size} bytes; at most {size - 1} are read"):
        Archive(path)


def test_every_length_of_comment_and_zip64_is_still_read(tmp_path):
    """What a look at the end of the file must find: a comment of any length, with marks in it."""
    for k, comment in enumerate((b"", b"x" * 65_535, b"PK\6\7" + bytes(40))):
        path = tmp_path / f"{k}.zip"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("1.png", IMAGE)
            archive.comment = comment
        assert list(Archive(path).entries) == ["1.png"]


def test_large_entries_are_copied_in_pieces(tmp_path):
    """An entry of 200 MB (a hole in the file) that is no layer goes to the output without being held in memory."""
    path = job(tmp_path, "cws")
    with zipfile.ZipFile(path, "a") as archive, archive.open("movie.bin", "w") as entry:
        for _ in range(200):
            entry.write(bytes(1 << 20))
    tracemalloc.start()
    try:
        target = fixed(path)
        assert tracemalloc.get_traced_memory()[1] < 50_000_000
    finally:
        tracemalloc.stop()
    with zipfile.ZipFile(target) as archive:
        assert archive.testzip() is None
        assert archive.getinfo("movie.bin").file_size == 200 << 20


# PNG files ------------------------------------------------------------------------------------------------


def noted(**notes: object) -> bytes:
    """A PNG as layerfix writes it, with these notes in its text chunk."""
    return encode_png(np.full((24, 1), 7, np.uint64), 42, text={"layerfix": json.dumps(notes)})


@pytest.mark.parametrize("container", ["folder", "zip"])
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("origin_mm", [float("nan"), 1e308]), ("origin_mm", [0, float("inf")]), ("origin_mm", [0, 1e308]),
        ("origin_mm", [10**400, 1]), ("pixel_mm", [0.05, float("nan")]), ("z_mm", [0, float("-inf")]),
        ("z_mm", [0, 1e9]), ("pixel_mm", [-1e9, 1]),
    ],
)  # fmt: skip
def test_notes_that_are_no_numbers(tmp_path, container, key, value):
    """In our own text chunk: refused with the image, the key and the value, whatever the output would have been."""
    notes = {"pixel_mm": [0.05, 0.05], "origin_mm": [0, 1.2], "z_mm": [0, 0.05], key: value}
    if container == "folder":
        path = tmp_path / "layers"
        path.mkdir()
        (path / "1.png").write_bytes(noted(**notes))
    else:
        path = write_zip(tmp_path / "layers.zip", {"1.png": noted(**notes)})
    with pytest.raises(InputError, match=rf"layers.*1\.png: says {key} .*; its numbers are finite and below 1e"):
        lf.read(path, pixel_mm=0.05, layer_mm=0.05)


@pytest.mark.parametrize(
    "text", ["[" * 900, "[]", "1", "not ours", '{"pixel_mm": [' + "9" * 5000, "", '{"z_mm": [true, 0]}']
)
def test_text_chunks_of_others_under_our_name(tmp_path, text):
    """What is no object of ours says nothing, and hurts nobody."""
    (tmp_path / "layers").mkdir()
    data = encode_png(np.full((24, 1), 7, np.uint64), 42, text={"layerfix": text})
    (tmp_path / "layers" / "1.png").write_bytes(data)
    assert lf.read(tmp_path / "layers", pixel_mm=0.05, layer_mm=0.05)[0].count_px() == 24 * 3


def padded(data: bytes, size: int) -> bytes:
    """A PNG with a chunk of so many zeros behind its header."""
    body = b"juNk" + bytes(size)
    return data[:33] + struct.pack(">I", size) + body + struct.pack(">I", zlib.crc32(body)) + data[33:]


@pytest.mark.parametrize("container", ["folder", "zip", "cws", "sl1"])
def test_an_image_file_far_larger_than_its_image(tmp_path, container):
    """40 MB of zeros in an image of 1,008 px: refused before they are in memory; 100 kB of them do no harm."""
    for size, fine in ((100_000, True), (40_000_000, False)):
        image = padded(IMAGE, size)
        if container == "folder":
            path = tmp_path / f"layers{size}"
            path.mkdir()
            (path / "1.png").write_bytes(image)
        elif container == "zip":
            path = write_zip(tmp_path / "layers.zip", {"1.png": image})
        else:
            path = job(tmp_path, container)
            name = "part00000.png" if container == "sl1" else "1.png"
            with zipfile.ZipFile(path) as archive:
                entries = {n: archive.read(n) for n in archive.namelist()}
            write_zip(path, {**entries, name: image})
        stack = lf.read(path, pixel_mm=0.05, layer_mm=0.05)
        if fine:
            assert stack[0].count_px() > 0
            continue
        del image
        tracemalloc.start()
        try:
            with pytest.raises(InputError, match=r"png.* (over \d+ bytes|unpacks to 4\d+ bytes)"):
                stack[0]
            assert tracemalloc.get_traced_memory()[1] < 5_000_000
        finally:
            tracemalloc.stop()


def test_a_folder_with_a_pipe_or_a_dead_link_among_its_layers(tmp_path):
    """Not left out in silence: a layer is missing."""
    (tmp_path / "1.png").write_bytes(IMAGE)
    (tmp_path / "2.png").symlink_to("gone.png")
    with pytest.raises(InputError, match=r"2\.png: no such file"):
        lf.read(tmp_path, pixel_mm=0.05, layer_mm=0.05)
    (tmp_path / "2.png").unlink()
    os.mkfifo(tmp_path / "2.png")
    with pytest.raises(InputError, match=r"2\.png: is a pipe"):
        lf.read(tmp_path, pixel_mm=0.05, layer_mm=0.05)


@pytest.mark.parametrize("size", [(65_535, 65_535), (1 << 31, 1), (0, 5), (16_385, 16_384)])
def test_images_that_claim_to_be_endless(tmp_path, size):
    """In a folder as in a job: over 268 million pixels, or none, refused by the header alone."""
    head = IMAGE[12:16] + struct.pack(">II", *size) + IMAGE[24:29]
    (tmp_path / "1.png").write_bytes(IMAGE[:12] + head + struct.pack(">I", zlib.crc32(head)) + IMAGE[33:])
    with pytest.raises(InputError, match=rf"1\.png: says {size[0]} × {size[1]} px; at most 268435456 are read"):
        lf.read(tmp_path, pixel_mm=0.05, layer_mm=0.05)


# The parts ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("20", 20.0), (" 0.05 ", 0.05), ("1e3", 1000.0), (".5", 0.5), ("5.", 5.0), ("+2", 2.0), ("1.2.3", None),
        ("-1", None), ("0", None), ("nan", None), ("inf", None), ("1e400", None), ("1_000", None), ("٣", None),
        ("9" * 5000, None), ("", None), ("1e9", None), ("999999999", 999999999.0), ("0x10", None), ("1 2", None),
    ],
)  # fmt: skip
def test_numbers_above_0(text, expected):
    """Plain decimal numbers below 10⁹; everything else is none."""
    assert number_above_0(text) == expected


def test_lines_of_keys_and_numbers():
    """With or without an equals sign and spaces; later ones win; other lines are skipped."""
    text = (
        "xppm 20\n YPPM=21.5 \nthickness = .05\nthickness = 1.2.3\nxppm 22\nname part one\n\na b c\n= 5\nx-y 3\nk\t7"
    )
    assert keyed_numbers(text) == {"xppm": 22.0, "yppm": 21.5, "thickness": 0.05, "k": 7.0}


@given(st.text("ab= \t\n1.0e-", max_size=200))
def test_keyed_numbers_as_the_pattern_found_them(text):
    """Every line that `key [=] number` describes, and no other."""
    import re

    expected = {}
    for line in text.split("\n"):
        found = re.fullmatch(r"[ \t]*(\w+)(?:[ \t]+=?[ \t]*|=[ \t]*)(\S+)[ \t]*", line)
        if found and "=" not in found[2] and number_above_0(found[2]) is not None:
            expected[found[1]] = number_above_0(found[2])
    assert keyed_numbers(text) == expected


def test_nesting_and_long_values():
    """RecursionError never comes out; a message shows the beginning of what is long."""
    for text in ("[" * 10**6, '{"a":' * 10**6, "[" * 2000 + "]" * 2000):
        with pytest.raises(ValueError, match="nested too deeply"):
            parse_json(text)
    assert abridged("x" * 40) == "x" * 40
    assert abridged("x" * 41) == "x" * 40 + "… (41 characters)"


@pytest.mark.parametrize("seed", range(30))
def test_settings_put_together_at_random(tmp_path, seed):
    """Pieces that hurt one at a time, in any order and any file: LayerfixError or a result, nothing else."""
    rng = random.Random(seed)
    pieces = [
        b"xppm", b" ", b"=", b"\n", b"20", b"1.2.3", b"nan", b"1e999", b"-5", b"0", b"{", b"}", b"[",
        b'"TotalSolidArea":', b";machineX:", b";volume:", b"jobDir = part\n", b"layerHeight = ", b"\xff", b"\0", b",",
        b"display_pixels_x = ", b"usedMaterial = ", b'"MinX":', b'"Depth":', LONG, b"[" * 2000, b" " * 3000,
    ]  # fmt: skip
    for kind, entries in (("cws", ["slice.conf"]), ("zip", ["run.gcode"]), ("sl1", ["config.ini", "prusaslicer.ini"]),
                          ("nanodlp", ["plate.json", "slicer.json", "profile.json", "info.json"])):  # fmt: skip
        entry = rng.choice(entries)
        data = b"".join(rng.choices(pieces, k=rng.randint(1, 30)))
        path = job(tmp_path, kind, **{entry.replace(".", "__"): data})
        for use in (lf.read, fixed):
            with suppress(LayerfixError):
                use(path)
