"""The run-length codes of resin jobs against plain encoders and decoders written from the specifications."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix.bits import pack, unpack, words_for
from layerfix.formats.jobs import runs
from layerfix.layers.grey_image import GreyImage, Greys
from layerfix.layers.greys import pack_from
from tests import independent_readers as plain

WIDTHS = (1, 63, 64, 65, 127, 128, 129, 130)
LONG = 1 << 20


def empty(height: int, width: int) -> np.ndarray:
    return np.zeros((height, words_for(width)), np.uint64)


def as_data(data: bytes) -> np.ndarray:
    return np.frombuffer(bytearray(data), np.uint8)


@st.composite
def greys(draw: st.DrawFn) -> np.ndarray:
    """Pictures of one value, of noise, of runs that cross rows, of gentle slopes, and black and white ones."""
    shape = draw(st.integers(1, 7)), draw(st.sampled_from(WIDTHS))
    size = shape[0] * shape[1]
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["flat", "noise", "runs", "slope", "binary", "sparse"]))
    if kind == "flat":
        flat = np.full(size, draw(st.sampled_from([0, 1, 2, 127, 128, 254, 255])))
    elif kind == "noise":
        flat = rng.integers(0, 256, size)
    elif kind == "runs":
        flat = np.repeat(rng.choice([0, 0, 255, 255, 60, 200], size), rng.integers(1, 200, size))[:size]
    elif kind == "slope":
        flat = np.clip(np.cumsum(np.repeat(rng.integers(-17, 18, size), rng.integers(1, 5, size)))[:size], 0, 255)
    elif kind == "binary":
        flat = 255 * rng.integers(0, 2, size)
    else:
        flat = 255 * (rng.random(size) < 0.01)
    return flat.astype(np.uint8).reshape(shape)


def decoded(name: str, data: bytes, shape: tuple[int, int], threshold: int = 128) -> tuple[int, bool, np.ndarray]:
    """(pixels covered, whether there are greys, what is solid) by the package."""
    rows = empty(*shape)
    decode = {"ctb": runs.decode_ctb, "goo": runs.decode_goo}[name]
    covered, has_greys = decode(as_data(data), shape[1], threshold, rows)
    return covered, bool(has_greys), unpack(rows, shape[1])


@given(greys())
def test_photon_is_what_the_plain_decoder_and_encoder_make_of_it(image):
    """The same bytes as the plain encoder, the same pixels as the plain decoder, nothing past the width."""
    solid = image >= 128
    data = runs.encode_photon(pack(solid), image.shape[1]).tobytes()
    assert data == plain.photon_runs(solid)
    assert np.array_equal(plain.photon_pixels(data).reshape(image.shape), solid)
    rows = empty(*image.shape)
    assert runs.decode_photon(as_data(data), image.shape[1], rows) == image.size
    assert np.array_equal(rows, pack(solid))


@given(greys(), st.integers(1, 255))
def test_goo_greys(image, threshold):
    """Encoded: read back exactly by the plain decoder. Plain chunks, differences too: read exactly."""
    data = runs.encode_greys(image, True).tobytes()
    assert np.array_equal(plain.goo_pixels(data).reshape(image.shape), image)
    assert all(head >> 6 != 2 for head in heads(data))
    for differences in (False, True):
        data = plain.goo_runs(image, differences=differences)
        covered, has_greys, solid = decoded("goo", data, image.shape, threshold)
        assert covered == image.size
        assert has_greys == bool(((image > 0) & (image < 255)).any())
        assert np.array_equal(solid, image >= threshold)
        again = np.zeros_like(image)
        runs.decode_goo_greys(as_data(data), again)
        assert np.array_equal(again, image)


@given(greys(), st.booleans(), st.sampled_from(["", "x", "y", "xy"]), st.integers(1, 5))
def test_greys_in_bands_are_the_same_runs(image, goo, axes, step):
    """Runs go on from band to band; mirrored as numpy mirrors."""
    bands = Greys(image.shape, lambda: (image[y : y + step] for y in range(0, len(image), step)))
    across, down = -1 if "x" in axes else 1, -1 if "y" in axes else 1
    expected = runs.encode_greys(np.ascontiguousarray(image[::down, ::across]), goo)
    assert runs.encode_greys(bands.mirrored(axes), goo).tobytes() == expected.tobytes()
    assert np.array_equal(np.asarray(GreyImage.of(image).mirrored(axes)), image[::down, ::across])


def heads(data: bytes) -> list[int]:
    """The first bytes of GOO chunks without differences."""
    found, i = [], 0
    while i < len(data):
        found.append(data[i])
        i += 1 + (data[i] >> 4 & 3) + (data[i] >> 6 == 1)
    return found


@given(greys(), st.integers(1, 255))
def test_ctb_greys(image, threshold):
    """As the plain encoder writes them; seven bits come back, and what is solid follows from those."""
    data = runs.encode_greys(image, False).tobytes()
    assert data == plain.ctb_runs(image)
    seven = np.where(image > 1, image | 1, 0)
    assert np.array_equal(plain.ctb_pixels(data).reshape(image.shape), seven)
    covered, has_greys, solid = decoded("ctb", data, image.shape, threshold)
    assert covered == image.size
    assert has_greys == bool(((seven > 0) & (seven < 255)).any())
    assert np.array_equal(solid, seven >= threshold)
    again = np.zeros_like(image)
    runs.decode_ctb_greys(as_data(data), again)
    assert np.array_equal(again, seven)


@given(greys())
def test_black_and_white_layers_as_goo_and_ctb(image):
    """The packed way gives the bytes of the grey way."""
    solid = image >= 128
    white = np.where(solid, 255, 0).astype(np.uint8)
    for goo, code in ((True, plain.goo_runs), (False, plain.ctb_runs)):
        data = runs.encode_runs(pack(solid), image.shape[1], goo).tobytes()
        assert data == code(white) == runs.encode_greys(white, goo).tobytes()


@pytest.mark.parametrize(
    "length", [1, 15, 16, 127, 128, 4095, 4096, 16383, 16384, LONG - 1, LONG, 2 * LONG, 5 * LONG]
)
@pytest.mark.parametrize("value", [0, 77, 255])
def test_runs_at_every_length_where_the_code_grows(length, value):
    """4, 12, 20 and 28 bits of GOO, 7, 14, 21 and 28 of CTB: a run of each, then one pixel of another value."""
    image = np.full((1, length + 1), value, np.uint8)
    image[0, -1] = 200
    goo, ctb = (runs.encode_greys(image, kind).tobytes() for kind in (True, False))
    assert goo == plain.goo_runs(image)
    assert ctb == plain.ctb_runs(image)
    for name, data in (("goo", goo), ("ctb", ctb)):
        covered, _, solid = decoded(name, data, image.shape)
        assert covered == image.size
        assert np.array_equal(solid, image >= 128)


@pytest.mark.parametrize("width", [1000, 1024])
def test_a_long_run_on_a_large_layer(width):
    """More than 2²⁰ pixels in one run over a thousand rows, by all three codes."""
    solid = np.ones((1200, width), bool)
    solid[0, 0] = solid[-1, -3:] = False
    rows = pack(solid)
    again = empty(*solid.shape)
    assert runs.decode_photon(runs.encode_photon(rows, width), width, again) == solid.size
    assert np.array_equal(again, rows)
    for goo, decode in ((True, runs.decode_goo), (False, runs.decode_ctb)):
        again = empty(*solid.shape)
        assert decode(runs.encode_runs(rows, width, goo), width, 128, again) == (solid.size, 0)
        assert np.array_equal(again, rows)


def test_the_examples_of_the_goo_specification():
    """Black of 0x555657f pixels, grey 0xaa of 0xbbcc155, black of 5; differences of +1, +2, -1, -2."""
    rows = empty(1, 64)
    for data, length in (("3f555657", 0x555657F), ("75aabbcc15", 0xBBCC155), ("05", 5), ("f1ccbbaa", 0xCCBBAA1)):
        assert runs.decode_goo(as_data(bytes.fromhex(data)), 64, 128, rows)[0] == length
    line = np.zeros((1, 1 + 1 + 255 + 1 + 238), np.uint8)
    runs.decode_goo_greys(as_data(bytes.fromhex("4164 81 92ff a1 b2ee")), line)
    expected = [100] + [101] + [103] * 255 + [102] + [100] * 238
    assert line[0].tolist() == expected


@pytest.mark.parametrize("first", [0, 255])
def test_differences_start_from_black_and_from_white(first):
    """A difference refers to the pixel before, whatever kind of chunk that was; the first one to black."""
    down = first == 255
    data = (goo_white(3) if down else b"") + bytes([0x80 | 0x20 * down | 7, 0x90 | 0x20 * down | 8, 5])
    image = np.zeros((1, 6 + 3 * down), np.uint8)
    runs.decode_goo_greys(as_data(data), image)
    assert np.array_equal(image[0], plain.goo_pixels(data))
    assert image[0].tolist() == ([255] * 3 + [248] + [240] * 5 if down else [7] + [15] * 5)


def goo_white(length: int) -> bytes:
    return plain.goo_chunk(3, length)


@given(greys(), st.data())
def test_data_that_end_within_a_chunk(image, data):
    """Never a crash: -1, or fewer pixels than the layer has, exactly as many as the whole chunks hold."""
    for name, coded in (("goo", plain.goo_runs(image, differences=True)), ("ctb", plain.ctb_runs(image))):
        short = coded[: data.draw(st.integers(0, len(coded) - 1))]
        covered, _, _ = decoded(name, short, image.shape)
        try:
            pixels = {"goo": plain.goo_pixels, "ctb": plain.ctb_pixels}[name](short)
        except (IndexError, AssertionError):
            assert covered == -1
        else:
            assert covered == len(pixels) < image.size


@given(st.binary(max_size=200), st.sampled_from(WIDTHS), st.integers(1, 4))
def test_any_bytes_stay_within_the_layer(data, width, height):
    """Noise may cover too much or break off: no pixel past the width is set, and all within are as they should."""
    for name, pixels_of in (("goo", plain.goo_pixels), ("ctb", plain.ctb_pixels), ("photon", plain.photon_pixels)):
        rows = empty(height, width)
        if name == "photon":
            covered = runs.decode_photon(as_data(data), width, rows)
        else:
            covered, _ = {"goo": runs.decode_goo, "ctb": runs.decode_ctb}[name](as_data(data), width, 128, rows)
        assert np.array_equal(pack(unpack(rows, width)), rows)
        if 0 <= covered <= 1 << 20:
            line = pixels_of(data)
            assert len(line) == covered
            solid = np.zeros(width * height, bool)
            known = line[: width * height] >= (1 if name == "photon" else 128)
            solid[: len(known)] = known
            assert np.array_equal(unpack(rows, width), solid.reshape(height, width))


@given(greys(), st.integers(1, 255))
def test_packing_greys(image, threshold):
    """Solid from the threshold on, at every width."""
    assert np.array_equal(pack_from(image, threshold), pack(image >= threshold))


@given(st.integers(1, 2**32 - 1), st.integers(0, 5000), st.integers(0, 50))
def test_the_key_stream(seed, layer, size):
    """The words of the plain cipher, for sizes that are no multiple of four too."""
    assert runs.key_stream(seed, layer, size).tobytes() == plain.ctb_cipher(bytes(size), seed, layer)
