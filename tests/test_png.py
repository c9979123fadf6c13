"""One layer as a PNG: our deflate stream, read back by two other programs' readers and by the standard."""

from __future__ import annotations

import contextlib
import io
import itertools
import struct
import zlib
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from layerfix.bits import pack, unpack
from layerfix.errors import InputError
from layerfix.formats.png import decode
from layerfix.formats.png.decode import decode_png
from layerfix.formats.png.encode import encode_png

WIDTHS = [1, 2, 7, 8, 9, 63, 64, 65, 127, 128, 129, 130, 257, 258, 259, 260, 261, 300]
both_depths = pytest.mark.parametrize("bits", [1, 8])


def chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    """(kind, body) of every chunk, after checking the signature, each CRC and the end."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    found, at = [], 8
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + size]
        assert struct.unpack(">I", data[at + 8 + size : at + 12 + size])[0] == zlib.crc32(kind + body)
        found.append((kind, body))
        at += 12 + size
    assert (found[0][0], found[-1]) == (b"IHDR", (b"IEND", b""))
    return found


def pixels_by_the_standard(data: bytes) -> np.ndarray:
    """(H, W) grey values, decoded here: inflate (which checks the Adler-32), unfilter None and Up, unpack."""
    found = chunks(data)
    width, height, depth, colour, *rest = struct.unpack(">IIBBBBB", found[0][1])
    assert (colour, rest) == (0, [0, 0, 0])
    inflater = zlib.decompressobj()
    raw = inflater.decompress(b"".join(body for kind, body in found if kind == b"IDAT"))
    assert inflater.eof
    assert not inflater.unused_data
    row_bytes = (width * depth + 7) // 8
    assert len(raw) == height * (1 + row_bytes)
    lines = np.frombuffer(raw, np.uint8).reshape(height, 1 + row_bytes)
    assert set(lines[:, 0]) <= {0, 2}
    out = np.zeros((height, row_bytes), np.uint8)
    above = np.zeros(row_bytes, np.uint8)
    for y, line in enumerate(lines):
        above = line[1:] + above if line[0] == 2 else line[1:]
        out[y] = above
    return out if depth == 8 else 255 * np.unpackbits(out, axis=1, count=width)


def check(image: np.ndarray, bits: int) -> bytes:
    """The PNG of a picture, after three readers have found that picture in it."""
    width = image.shape[1]
    data = encode_png(pack(image), width, bits=bits)
    expected = np.where(image, 255, 0)
    assert np.array_equal(pixels_by_the_standard(data), expected)
    assert np.array_equal(np.array(Image.open(io.BytesIO(data)).convert("L")), expected)
    assert np.array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE), expected)
    size = (width, len(image))
    assert np.array_equal(unpack(decode_png(data, "here", size).rows, width), image)
    return data


@both_depths
@pytest.mark.parametrize("width", WIDTHS)
def test_every_width_at_the_edges_of_words_and_matches(width, bits):
    """All white, all black, noise of three densities, stripes, one pixel in each corner."""
    rng = np.random.default_rng(width)
    height = 5
    pictures = [np.ones((height, width)), np.zeros((height, width))]
    pictures += [rng.random((height, width)) < density for density in (0.02, 0.5, 0.98)]
    pictures += [np.indices((height, width))[axis] % 2 for axis in range(2)]
    corners = np.zeros((height, width))
    corners[[0, 0, -1, -1], [0, -1, 0, -1]] = 1
    for picture in [*pictures, corners]:
        check(picture.astype(bool), bits)


@both_depths
@pytest.mark.parametrize("shape", [(1, 1), (1, 64), (64, 1), (200, 1), (1, 70_000), (3, 12_000)])
def test_extreme_shapes(shape, bits):
    """One pixel, one row, one column, and rows longer than the Adler-32's modulus."""
    rng = np.random.default_rng(3)
    for density in (0, 0.001, 0.5, 1):
        check(rng.random(shape) < density, bits)


@pytest.mark.parametrize(
    "run", [*range(1, 12), 34, 35, 66, 67, 130, 131, 226, 227, *range(256, 264), *range(513, 523), 774, 775]
)
def test_runs_of_every_length_code(run):
    """A run of each length that deflate writes differently, solid and empty, first in a row and last."""
    for start in (0, 1, 63, 64, 100):
        for after in (0, 1, 2, 300):
            image = np.zeros((3, start + run + after), bool)
            image[1:, start : start + run] = True
            check(image, 8)
            check(~image, 8)


@both_depths
def test_a_12k_layer(bits):
    """11520 × 5120 px of discs, bars and specks: read back whole, and small."""
    image = np.zeros((5120, 11520), np.uint8)
    rng = np.random.default_rng(0)
    for x, y, r in rng.integers([0, 0, 3], [11520, 5120, 400], (150, 3)).tolist():
        cv2.circle(image, (x, y), r, 255, -1 if r % 2 else 3)
    image[::700] = 255
    data = check(image > 0, bits)
    assert len(data) < 600_000


@given(st.integers(1, 300), st.integers(1, 24), st.integers(0, 2**32 - 1), st.sampled_from([0, 0.003, 0.05, 0.5, 1]),
       st.sampled_from([1, 8]))  # fmt: skip
@settings(deadline=None, max_examples=300)
def test_any_image_comes_back(width, height, seed, density, bits):
    """Random runs of random lengths, rows that repeat the one above or invert it."""
    rng = np.random.default_rng(seed)
    image = np.logical_xor.accumulate(rng.random((height, width)) < density, axis=1)
    if rng.random() < 0.5:
        image = np.logical_xor.accumulate(image, axis=0)
    check(image, bits)


@both_depths
def test_the_chunks_are_those_asked_for(bits):
    """IHDR with the depth, pHYs in pixels a metre, tEXt with our text, then the data."""
    data = encode_png(pack(np.ones((2, 3))), 3, bits=bits, pixel_mm=(0.019, 0.024), text={"layerfix": "{}"})
    found = chunks(data)
    assert [kind for kind, _ in found] == [b"IHDR", b"pHYs", b"tEXt", b"IDAT", b"IEND"]
    assert struct.unpack(">IIBBBBB", found[0][1]) == (3, 2, bits, 0, 0, 0, 0)
    assert struct.unpack(">IIB", found[1][1]) == (52632, 41667, 1)
    assert found[2][1] == b"layerfix\0{}"
    assert Image.open(io.BytesIO(data)).info["dpi"] == pytest.approx((25.4 / 0.019, 25.4 / 0.024), rel=1e-4)


def test_the_same_picture_gives_the_same_bytes():
    """Nothing of the time or the machine is in a PNG; our one pass is as small as zlib's best effort."""
    image = np.zeros((300, 500), bool)
    image[40:200, 100:400] = True
    data = [encode_png(pack(image), 500) for _ in range(2)]
    assert data[0] == data[1]
    assert len(data[0]) < 2 * len(zlib.compress((255 * image.astype(np.uint8)).tobytes(), 9)) + 500


@pytest.mark.parametrize("bits", [0, 2, 4, 16, -1])
def test_other_depths_are_refused(bits):
    """Layers have 1 or 8 bits a pixel."""
    with pytest.raises(InputError, match=f"{bits}-bit PNG: layers are written with 1 or 8 bits"):
        encode_png(pack([[1]]), 1, bits=bits)


# Reading what others write ----------------------------------------------------------------------------------

FILTERS = {
    "None": [0],
    "Sub": [1],
    "Up": [2],
    "Average": [3],
    "Paeth": [4],
    "binary": [0, 1, 2],
    "all": [0, 1, 2, 3, 4],
}
every_filter = pytest.mark.parametrize("filters", FILTERS)


def filtered(lines: np.ndarray, kinds: list[int], bpp: int = 1) -> bytes:
    """(H, bytes) image lines after the filters of PNG's section 9, one kind a row, each written out slowly."""
    out = bytearray()
    above = [0] * lines.shape[1]
    for line, kind in zip(lines.tolist(), kinds, strict=True):
        out.append(kind)
        for i, value in enumerate(line):
            a = line[i - bpp] if i >= bpp else 0
            b, c = above[i], above[i - bpp] if i >= bpp else 0
            p = a + b - c
            nearest = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            out.append((value - (0, a, b, (a + b) // 2, nearest)[kind]) % 256)
        above = line
    return bytes(out)


def built(size: tuple[int, int], depth: int, colour: int, raw: bytes, *, pieces: int = 1, extra: bytes = b"",
          interlace: int = 0, adler: int = 0) -> bytes:  # fmt: skip
    """A PNG file of filtered bytes, its data in one or several chunks. adler: what its checksum is wrong by."""
    stream = zlib.compress(raw)
    stream = stream[:-4] + struct.pack(">I", (int.from_bytes(stream[-4:], "big") + adler) & 0xFFFFFFFF)
    cuts = np.linspace(0, len(stream), pieces + 1).astype(int)
    data = [stream[a:b] for a, b in itertools.pairwise(cuts)]
    parts = [(b"IHDR", struct.pack(">IIBBBBB", *size, depth, colour, 0, 0, interlace))]
    parts += [(b"PLTE", extra)] * bool(extra) + [(b"IDAT", piece) for piece in data] + [(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )


def kinds_for(filters: str, height: int, seed: int = 0) -> list[int]:
    return np.random.default_rng(seed).choice(FILTERS[filters], height).tolist()


def check_read(data: bytes, grey: np.ndarray, threshold: int = 128) -> None:
    """Decoding gives the packed picture at that threshold, and its greys if it has any."""
    height, width = grey.shape
    decoded = decode_png(data, "here", (width, height), threshold=threshold)
    assert np.array_equal(unpack(decoded.rows, width), grey >= threshold)
    if np.isin(grey, [0, 255]).all():
        assert decoded.grey is None
    else:
        assert np.array_equal(decoded.grey, grey)


@every_filter
@pytest.mark.parametrize("width", WIDTHS)
def test_black_and_white_with_any_filter(width, filters):
    """8 bits: noise, runs, rows that repeat, with each filter and with all of them mixed."""
    rng = np.random.default_rng(width)
    height = 12
    for density in (0.0, 0.03, 0.5, 1.0):
        runs = np.logical_xor.accumulate(rng.random((height, width)) < density, axis=1)
        runs[5] = runs[4]
        grey = np.where(runs, 255, 0).astype(np.uint8)
        check_read(built((width, height), 8, 0, filtered(grey, kinds_for(filters, height, width))), grey)


@every_filter
@pytest.mark.parametrize("width", [1, 7, 8, 9, 63, 64, 65, 130])
def test_one_bit_with_any_filter(width, filters):
    """1 bit: the filters act on whole bytes, and the bits past the width do not count, whatever they are."""
    rng = np.random.default_rng(width)
    solid = rng.random((9, width)) < 0.5
    lines = np.packbits(solid, axis=1)
    if width % 8:
        lines[:, -1] |= rng.integers(0, 1 << (8 - width % 8), 9, dtype=np.uint8)
    data = built((width, 9), 1, 0, filtered(lines, kinds_for(filters, 9)))
    check_read(data, np.where(solid, 255, 0).astype(np.uint8))


@every_filter
@pytest.mark.parametrize("threshold", [1, 100, 128, 255])
def test_greys_with_any_filter(filters, threshold):
    """Anti-aliased edges: cut at the threshold, and the greys are kept."""
    rng = np.random.default_rng(7)
    for width in (1, 5, 64, 71, 200):
        grey = rng.integers(0, 256, (8, width), dtype=np.uint8)
        data = built((width, 8), 8, 0, filtered(grey, kinds_for(filters, 8)))
        check_read(data, grey, threshold)


@pytest.mark.parametrize("filters", ["None", "Sub", "Up", "binary"])
@pytest.mark.parametrize("value", [1, 2, 127, 128, 254])
def test_a_single_grey_anywhere_is_found(filters, value):
    """One pixel of an otherwise black or white image is grey: in each place of a word, in any row."""
    rng = np.random.default_rng(value)
    for column in [*range(0, 72), 127, 128, 129]:
        grey = (
            np.where(rng.random((4, 130)) < 0.5, 255, 0).astype(np.uint8)
            if column % 3
            else np.full((4, 130), 255, np.uint8)
        )
        grey[column % 4, column] = value
        check_read(built((130, 4), 8, 0, filtered(grey, kinds_for(filters, 4, column))), grey)


@given(st.integers(1, 200), st.integers(1, 12), st.integers(0, 2**32 - 1), st.sampled_from(sorted(FILTERS)),
       st.sampled_from([2, 3, 5, 256]))  # fmt: skip
@settings(max_examples=200)
def test_any_levels_with_any_filters_come_back(width, height, seed, filters, levels):
    """Two, three, five or all greys in runs, whatever the filters."""
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.random((height, width)) < rng.choice([0.02, 0.3]), axis=1) + rng.integers(
        0, levels, (height, 1)
    )
    grey = (steps % levels * 255 // (levels - 1)).astype(np.uint8)
    check_read(built((width, height), 8, 0, filtered(grey, kinds_for(filters, height, seed))), grey)


@pytest.mark.parametrize("strategy", range(5))
@pytest.mark.parametrize("bilevel", [0, 1])
def test_what_opencv_writes(strategy, bilevel):
    """Every deflate strategy it has, in 8 bits and in one."""
    image = np.where(np.random.default_rng(strategy).random((50, 333)) < 0.3, 255, 0).astype(np.uint8)
    settings_ = [cv2.IMWRITE_PNG_STRATEGY, strategy, cv2.IMWRITE_PNG_BILEVEL, bilevel]
    check_read(cv2.imencode(".png", image, settings_)[1].tobytes(), image)


@pytest.mark.parametrize("mode", ["1", "L", "P", "LA", "RGB", "RGBA", "I;16"])
def test_what_pillow_writes(mode):
    """Grey, palette, colour, with alpha, 16 bits."""
    image = np.where(np.random.default_rng(1).random((30, 77)) < 0.3, 255, 0).astype(np.uint8)
    picture = (
        Image.fromarray(image.astype(np.uint16) * 257) if mode == "I;16" else Image.fromarray(image).convert(mode)
    )
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    check_read(buffer.getvalue(), image)


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
@pytest.mark.parametrize("colour", ["grey", "palette"])
def test_every_depth_of_grey_and_palette(depth, colour):
    """Two, four, sixteen or all levels, packed as PNG packs them."""
    rng = np.random.default_rng(depth)
    levels = rng.integers(0, 2**depth, (9, 37))
    bits = np.unpackbits(levels.astype(np.uint8)[..., None], axis=2)[..., 8 - depth :].reshape(9, -1)
    lines = np.packbits(bits, axis=1)
    palette = (
        b"".join(bytes([k * 255 // (2**depth - 1)] * 3) for k in range(2**depth)) if colour == "palette" else b""
    )
    data = built((37, 9), depth, 3 if palette else 0, filtered(lines, kinds_for("all", 9)), extra=palette)
    check_read(data, (levels * 255 // (2**depth - 1)).astype(np.uint8))


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (8, 8), (37, 21)])
def test_interlaced_images(size):
    """Adam7: seven small images in one file."""
    width, height = size
    grey = np.where(np.random.default_rng(2).random((height, width)) < 0.5, 255, 0).astype(np.uint8)
    raw = b""
    for y, x, dy, dx in (
        (0, 0, 8, 8),
        (0, 4, 8, 8),
        (4, 0, 8, 4),
        (0, 2, 4, 4),
        (2, 0, 4, 2),
        (0, 1, 2, 2),
        (1, 0, 2, 1),
    ):
        part = grey[y::dy, x::dx]
        if part.size:
            raw += filtered(part, kinds_for("all", len(part)))
    check_read(built(size, 8, 0, raw, interlace=1), grey)


@pytest.mark.parametrize("pieces", [1, 2, 3, 50])
def test_data_in_several_chunks(pieces):
    """The stream may be cut anywhere."""
    grey = np.where(np.random.default_rng(2).random((40, 99)) < 0.5, 255, 0).astype(np.uint8)
    check_read(built((99, 40), 8, 0, filtered(grey, [2] * 40), pieces=pieces), grey)


@contextlib.contextmanager
def inflated_by(packed: int, piece: int) -> Iterator[None]:
    """Within the block, so many bytes go in at once, and at most so many come out."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decode, "INFLATE_FROM", packed)
        patch.setattr(decode, "INFLATE_TO", piece)
        yield


@given(st.integers(1, 150), st.integers(1, 20), st.integers(0, 2**32 - 1), st.sampled_from(sorted(FILTERS)),
       st.integers(1, 40), st.integers(1, 500), st.sampled_from([1, 8]), st.sampled_from([1, 128, 255]))  # fmt: skip
@settings(max_examples=300)
def test_pieces_of_any_size_give_the_same_layer(width, height, seed, filters, packed, piece, depth, threshold):
    """Pieces that end within a row, or hold several; greys that begin, and end, in the middle of the image."""
    rng = np.random.default_rng(seed)
    solid = np.logical_xor.accumulate(rng.random((height, width)) < rng.choice([0.02, 0.3]), axis=1)
    grey = np.where(solid, np.uint8(255), np.uint8(0))
    kinds = kinds_for(filters, height, seed)
    if depth == 8 and rng.random() < 0.5:
        first, stop = sorted(rng.integers(0, height + 1, 2).tolist())
        grey[first:stop] = rng.integers(0, 256, (stop - first, width))
    lines = grey if depth == 8 else np.packbits(solid, axis=1)
    with inflated_by(packed, piece):
        check_read(built((width, height), depth, 0, filtered(lines, kinds)), grey, threshold)


@pytest.mark.parametrize("depth", [1, 8])
@pytest.mark.parametrize("piece", [1, 8, 9, 10, 17, 18, 19, 1000])
def test_guards_hold_for_pieces_of_any_size(piece, depth):
    """Two rows of eight bytes are 18: one more, one less, a wrong checksum at the end, and nothing at all."""
    size = (8, 2) if depth == 8 else (64, 2)
    with inflated_by(3, piece):
        for count, word in ((17, "too little data"), (19, "too much data"), (0, "too little data"), (99, "too much")):
            with pytest.raises(InputError, match=f"here: not a readable PNG image .{word}"):
                decode_png(built(size, depth, 0, bytes(count)), "here", size)
        with pytest.raises(InputError, match="here: not a readable PNG image"):
            decode_png(built(size, depth, 0, bytes(18), adler=1), "here", size)
        assert not decode_png(built(size, depth, 0, bytes(18)), "here", size).rows.any()


def test_no_more_is_inflated_than_the_image_holds():
    """A stream that would swell to 100 MB is left where the image is full."""
    import tracemalloc

    data = built((8, 2), 8, 0, bytes(100_000_000))
    tracemalloc.start()
    with pytest.raises(InputError, match="too much data"):
        decode_png(data, "here", (8, 2))
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("depth", [1, 8])
def test_a_filter_that_does_not_exist(depth):
    """Types are 0 to 4."""
    for kind in (5, 99, 255):
        raw = bytes([0] + [0] * 8) + bytes([kind] + [0] * 8)
        with pytest.raises(InputError, match="here: "):
            decode_png(built((8 if depth == 8 else 64, 2), depth, 0, raw), "here", (8 if depth == 8 else 64, 2))


@pytest.mark.parametrize("size", [0, 1, 17, 19, 1000, 5_000_000])
def test_more_or_less_data_than_the_header_says(size):
    """Two rows of eight pixels are 18 bytes; a stream that swells to megabytes is not swollen."""
    with pytest.raises(InputError, match=r"here: not a (readable )?PNG image"):
        decode_png(built((8, 2), 8, 0, bytes(size)), "here", (8, 2))


def test_a_palette_of_a_very_large_panel_is_read_in_silence():
    """16K panels have 94 megapixels: more than Pillow thinks a decent picture has, and no reason for a warning."""
    width, height = 15_120, 6_230
    raw = bytes(1 + (width + 7) // 8) * height
    decoded = decode_png(built((width, height), 1, 3, raw, extra=bytes(6)), "here", (width, height))
    assert not decoded.rows.any()


@pytest.mark.parametrize("seed", range(40))
def test_random_damage_is_an_error_or_a_picture_but_never_a_crash(seed):
    """Bytes changed before the checksums are made, in grey, palette and 16-bit images."""
    rng = np.random.default_rng(seed)
    depth, colour, extra = [(8, 0, b""), (1, 0, b""), (8, 3, bytes(range(30))), (16, 0, b""), (8, 2, b"")][seed % 5]
    raw = bytes(8 * (1 + 16 * depth * (3 if colour == 2 else 1) // 8))
    data = bytearray(built((16, 8), depth, colour, raw, extra=extra))
    at = 8
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        if size and rng.random() < 0.7 and not (data[at + 4 : at + 8] == b"IHDR" and seed % 2):
            place = at + 8 + int(rng.integers(8 if data[at + 4 : at + 8] == b"IHDR" else 0, size))
            data[place] = int(rng.integers(256))
        data[at + 8 + size : at + 12 + size] = struct.pack(">I", zlib.crc32(data[at + 4 : at + 8 + size]))
        at += 12 + size
    with contextlib.suppress(InputError):
        decode_png(bytes(data), "here", (16, 8))


def test_grey_of_128_and_above_is_solid():
    """Anti-aliased images are cut at half grey, or where asked."""
    buffer = io.BytesIO()
    Image.fromarray(np.array([[0, 127, 128, 255]], np.uint8)).save(buffer, "PNG")
    assert unpack(decode_png(buffer.getvalue(), "here", (4, 1)).rows, 4).tolist() == [[False, False, True, True]]
    lower = decode_png(buffer.getvalue(), "here", (4, 1), threshold=1).rows
    assert unpack(lower, 4).tolist() == [[False, True, True, True]]


def test_16_bit_grey_is_read():
    """Half of 65535 is the threshold of a 16-bit image."""
    buffer = io.BytesIO()
    Image.fromarray(np.array([[0, 32000, 34000, 65535]], np.uint16)).save(buffer, "PNG")
    assert unpack(decode_png(buffer.getvalue(), "here", (4, 1)).rows, 4).tolist() == [[False, False, True, True]]


@both_depths
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_png_that_is_cut_short_is_refused(share, bits):
    """Half a picture must not pass for a layer that is empty below the middle."""
    image = np.random.default_rng(1).random((400, 400)) < 0.5
    data = encode_png(pack(image), 400, bits=bits)
    with pytest.raises(InputError, match="here: "):
        decode_png(data[: int(share * len(data))], "here", (400, 400))


def test_a_png_with_a_wrong_byte_is_refused():
    """One bit of the data flipped: the checksums of PNG and zlib exist to be checked."""
    image = np.random.default_rng(1).random((400, 400)) < 0.5
    data = bytearray(encode_png(pack(image), 400))
    data[len(data) // 2] ^= 4
    with pytest.raises(InputError, match="here: "):
        decode_png(bytes(data), "here", (400, 400))


@pytest.mark.parametrize("data", [b"", b"GIF89a", b"\x89PNG\r\n\x1a\n", b"\x89PNG\r\n\x1a\n" + b"\0" * 50])
def test_what_is_no_png_is_refused(data):
    """Nothing, another format, a signature and nothing behind it."""
    with pytest.raises(InputError, match=r"here: not a (readable )?PNG image"):
        decode_png(data, "here", (1, 1))


def test_an_absurd_size_is_refused():
    """A header that claims four thousand million pixels is an error, not a crash or a swollen memory."""
    header = struct.pack(">IIBBBBB", 65_000, 65_000, 8, 0, 0, 0, 0)
    stream = zlib.compress(b"\0" * 1000)
    parts = [(b"IHDR", header), (b"IDAT", stream), (b"IEND", b"")]
    data = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )
    with pytest.raises(InputError, match="here: "):
        decode_png(data, "here", (65_000, 65_000))


def test_another_size_than_the_first_names_both():
    """A layer must have the size of the stack."""
    data = encode_png(pack(np.ones((2, 3))), 3)
    with pytest.raises(InputError, match="here: 3 × 2 px, not 4 × 2 px"):
        decode_png(data, "here", (4, 2))
