"""The before and after picture: the right colours in the right places, at the right scale."""

from __future__ import annotations

import numpy as np
import pytest

from layerfix.bits import pack
from layerfix.draw.before_after import ADDED, CAPTION_PX, PANEL_PX, REMOVED, SOLID, WHITE, before_after
from layerfix.errors import InputError
from layerfix.stack import Layer

GAP = 24


def layer(image: np.ndarray) -> Layer:
    return Layer(pack(image), image.shape[1], (0, 0.1))


def panels(before: np.ndarray, after: np.ndarray, pixel_mm=(0.1, 0.1)) -> tuple[np.ndarray, np.ndarray]:
    """The two drawings inside the picture, without frame and caption: (H, W, 3) each."""
    picture = np.array(before_after(layer(before), layer(after), pixel_mm))
    width = (picture.shape[1] - 3 * GAP) // 2
    rows = slice(CAPTION_PX + GAP, picture.shape[0] - GAP)
    left, right = (picture[rows, x : x + width] for x in (GAP, 2 * GAP + width))
    return left[1:-1, 1:-1], right[1:-1, 1:-1]


def colours(panel: np.ndarray) -> set[tuple[int, ...]]:
    return set(map(tuple, panel.reshape(-1, 3).tolist()))


def share(panel: np.ndarray, colour: tuple[int, int, int]) -> float:
    return float((panel == colour).all(axis=2).mean())


@pytest.fixture
def square() -> np.ndarray:
    image = np.zeros((60, 80), bool)
    image[20:40, 20:60] = True
    return image


def test_what_is_kept_added_and_removed(square):
    """Grey, red and blue on the right; the left shows the layer as it was, in grey."""
    after = square.copy()
    after[40:45, 20:60] = True
    after[20:22] = False
    left, right = panels(square, after)
    assert colours(left) == {WHITE, SOLID}
    assert colours(right) == {WHITE, SOLID, ADDED, REMOVED}
    assert share(left, SOLID) == pytest.approx(share(right, SOLID) + share(right, REMOVED), rel=0.01)
    assert share(right, ADDED) / share(right, REMOVED) == pytest.approx(5 / 2, rel=0.02)


def test_red_is_below_where_rows_were_added_below(square):
    """Row 0 of the layer is the top of the picture, column 0 its left."""
    after = square.copy()
    after[40:45] = square[39]
    after[20:40, 60:70] = True
    _, right = panels(square, after)
    rows, columns = np.nonzero((right == ADDED).all(axis=2))
    grey = np.nonzero((right == SOLID).all(axis=2))
    assert rows.max() > grey[0].max()
    assert columns.max() > grey[1].max()
    assert rows.min() >= grey[0].min()


def test_both_panels_show_the_same_crop(square):
    """Cut to what is solid in either, with a little air, not the whole empty plate."""
    far = np.zeros((1000, 1000), bool)
    far[500:560, 500:580] = square
    left, right = panels(far, far)
    assert np.array_equal(left, right)
    assert share(left, SOLID) > 0.7


@pytest.mark.parametrize("pixel_mm", [(0.05, 0.05), (0.019, 0.024), (0.1, 0.05)])
def test_the_scale_is_in_mm(pixel_mm):
    """A square of the part is a square of the picture, on oblong pixels too; the longest side has its length."""
    image = np.zeros((400, 400), bool)
    image[50 : 50 + round(5 / pixel_mm[1]), 50 : 50 + round(5 / pixel_mm[0])] = True
    left, _ = panels(image, image, pixel_mm)
    rows, columns = np.nonzero((left == SOLID).all(axis=2))
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), rel=0.03)
    assert max(left.shape[:2]) == PANEL_PX - 2


def test_thin_things_in_a_large_layer_do_not_vanish():
    """A line of one pixel in 5,000 is averaged, not dropped."""
    image = np.zeros((5000, 5000), bool)
    image[10:4990, 10] = image[10:4990, 4990] = True
    left, _ = panels(image, image)
    assert (left < 255).any()
    red = image.copy()
    red[10:4990, 2500] = True
    _, right = panels(image, red)
    middle = right[:, right.shape[1] // 2 - 4 : right.shape[1] // 2 + 4].astype(int)
    assert (middle[..., 0] > middle[..., 1]).any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 500), (500, 1), (3, 3)])
def test_layers_of_any_shape_can_be_drawn(shape):
    """Empty, full, one pixel wide."""
    for before, after in ((0, 0), (1, 1), (0, 1), (1, 0)):
        picture = before_after(layer(np.full(shape, before)), layer(np.full(shape, after)), (0.05, 0.05))
        assert max(picture.size) <= 2 * PANEL_PX + 200
        assert picture.mode == "RGB"


def test_the_title_is_in_the_caption(square):
    """The text changes the caption and nothing below it."""
    plain = np.array(before_after(layer(square), layer(square), (0.1, 0.1)))
    titled = np.array(before_after(layer(square), layer(square), (0.1, 0.1), title=", z = 3.00 mm"))
    assert not np.array_equal(plain[:CAPTION_PX], titled[:CAPTION_PX])
    assert np.array_equal(plain[CAPTION_PX + GAP :], titled[CAPTION_PX + GAP :])


def test_captions_fit_over_narrow_layers():
    """A tall, narrow layer leaves little room: the captions of the two panels must not run into each other."""
    image = np.ones((500, 20), bool)
    picture = np.array(before_after(layer(image), layer(image), (0.1, 0.1), title=", z = 12.34 mm"))
    width = (picture.shape[1] - 3 * GAP) // 2
    between = picture[:CAPTION_PX, GAP + width + 2 : 2 * GAP + width - 2]
    assert (between == 255).all()


def test_layers_of_two_sizes_are_refused():
    """They cannot be the same layer."""
    with pytest.raises(InputError, match="layers of 3 × 2 and 4 × 2 px"):
        before_after(layer(np.ones((2, 3))), layer(np.ones((2, 4))), (0.1, 0.1))
