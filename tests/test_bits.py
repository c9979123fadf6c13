"""Packed rows: pixel x is bit x % 64 of word x // 64, and nothing lies past the width."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix.bits import lowest_bit, pack, popcount, unpack, words_for
from layerfix.errors import InputError
from tests.pictures_as_text import WIDTHS, images

words = st.integers(0, 2**64 - 1)


@given(images())
def test_unpack_gives_back_what_was_packed(image):
    """Packing and unpacking is the identity at every width."""
    rows = pack(image)
    assert rows.dtype == np.uint64
    assert rows.shape == (image.shape[0], words_for(image.shape[1]))
    assert np.array_equal(unpack(rows, image.shape[1]), image)


@pytest.mark.parametrize("width", WIDTHS)
def test_pixel_x_is_bit_x_modulo_64_of_word_x_over_64(width):
    """One solid pixel sets exactly the bit that the contract names."""
    for x in {0, width // 2, width - 1}:
        image = np.zeros((2, width), bool)
        image[1, x] = True
        expected = np.zeros((2, words_for(width)), np.uint64)
        expected[1, x // 64] = np.uint64(1) << np.uint64(x % 64)
        assert np.array_equal(pack(image), expected)


@pytest.mark.parametrize("width", WIDTHS)
def test_bits_past_the_width_are_0(width):
    """A solid image fills its width and not a bit more."""
    assert int(np.bitwise_count(pack(np.ones((3, width), bool))).sum()) == 3 * width


@pytest.mark.parametrize(
    ("width", "words"), [(1, 1), (63, 1), (64, 1), (65, 2), (128, 2), (129, 3), (4096, 64), (4097, 65)]
)
def test_a_row_has_as_few_words_as_hold_it(width, words):
    """64 pixels a word, the last one perhaps in part."""
    assert words_for(width) == words


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.int16, np.float32, np.float64])
def test_whatever_is_not_0_is_solid(dtype):
    """Grey values, negative numbers and fractions count as solid."""
    values = np.array([[0, 1, 255, 0.5, -3]])
    values = values.clip(0) if dtype == np.uint8 else values
    image = values.astype(dtype)
    assert np.array_equal(unpack(pack(image), 5), image != 0)


def test_lists_and_strided_arrays_can_be_packed():
    """pack takes nested lists, transposed and stepped arrays."""
    image = np.arange(70 * 3).reshape(3, 70) % 3 == 0
    assert np.array_equal(unpack(pack(image.tolist()), 70), image)
    assert np.array_equal(unpack(pack(image.T), 3), image.T)
    assert np.array_equal(unpack(pack(image[::2, ::3]), 24), image[::2, ::3])


def test_packing_leaves_the_image_alone_and_shares_nothing_with_it():
    """Changing the image later does not change the rows."""
    image = np.ones((2, 70), bool)
    rows = pack(image)
    assert image.all()
    image[:] = False
    assert unpack(rows, 70).all()


@pytest.mark.parametrize("shape", [(), (5,), (2, 3, 4)])
def test_an_image_has_two_dimensions(shape):
    """Anything else is refused, and the message says what came."""
    with pytest.raises(InputError, match=rf"two dimensions.*shape \({', '.join(map(str, shape))},?\)"):
        pack(np.ones(shape))


@pytest.mark.parametrize(
    ("rows", "width"),
    [
        (np.zeros((3, 2), np.uint64), 64),
        (np.zeros((3, 1), np.uint64), 65),
        (np.zeros((3, 1), np.int64), 64),
        (np.zeros(3, np.uint64), 64),
    ],
)
def test_rows_of_another_width_or_type_are_refused(rows, width):
    """unpack names the width, the shape and the type that do not go together."""
    with pytest.raises(InputError, match=rf"width {width} are .*; got \(.*\) {rows.dtype}"):
        unpack(rows, width)


@given(words)
def test_popcount_counts_the_set_bits(word):
    """popcount agrees with Python's own."""
    assert popcount(np.uint64(word)) == word.bit_count()


@given(words.filter(bool))
def test_lowest_bit_is_the_number_of_trailing_zeros(word):
    """lowest_bit is the index of the last 1 in binary."""
    assert lowest_bit(np.uint64(word)) == len(bin(word)) - 1 - bin(word).rindex("1")
