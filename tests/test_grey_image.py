"""Greys held small: the values, the cuts and the bands are those of the whole image."""

from __future__ import annotations

import numpy as np
import pytest

from layerfix.bits import pack, unpack
from layerfix.formats.png.decode import decode_png
from layerfix.formats.png.encode import encode_grey_png
from layerfix.layers import grey_image
from layerfix.layers.grey_image import GreyImage
from layerfix.layers.greys import corrected_greys, solid_rows

WIDTHS = [1, 7, 8, 63, 64, 65, 130]


def picture(width: int, height: int = 40, share: float = 0.3) -> np.ndarray:
    """(height, width) uint8: black and white runs, with a share of greys, in some rows none."""
    rng = np.random.default_rng(width)
    image = np.where(np.cumsum(rng.random((height, width)) < 0.05, axis=1) % 2, 255, 0).astype(np.uint8)
    greys = (rng.random((height, width)) < share) & (np.arange(height) % 3 > 0)[:, None]
    return np.where(greys, rng.integers(0, 256, (height, width)), image).astype(np.uint8)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("share", [0.0, 0.02, 1.0])
def test_the_values_come_back(width, share):
    image = picture(width, share=share)
    held = GreyImage.of(image)
    assert held.shape == image.shape
    assert np.array_equal(np.asarray(held), image)
    assert np.array_equal(held.rows(7, 19), image[7:19])
    for threshold in (1, 128, 255):
        assert np.array_equal(unpack(held.at_least(threshold), width), image >= threshold)
        assert np.array_equal(held.at_least(threshold, 5, 9), pack(image >= threshold)[5:9])


@pytest.mark.parametrize("axes", ["", "x", "y", "xy"])
def test_it_is_mirrored(axes):
    image = picture(130)
    whole = image[:: -1 if "y" in axes else 1, :: -1 if "x" in axes else 1]
    assert np.array_equal(np.asarray(GreyImage.of(image).mirrored(axes)), whole)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("band_bytes", [1, 300, 1 << 20])
def test_bands_make_no_difference(monkeypatch, width, band_bytes):
    """Solid pixels, a correction drawn in, and a PNG, whatever the height of the bands."""
    image = picture(width, share=0.05)
    before = solid_rows(image, 128, 32)
    paths = pack(np.random.default_rng(1).random(image.shape) < 0.01)
    after = before.rows | paths
    held = GreyImage.of(image)
    whole = np.asarray(corrected_greys(held, before.rows, after, paths, (3.0, 2.5), 128, dimmed=before.dimmed))
    monkeypatch.setattr(grey_image, "BAND_BYTES", band_bytes)
    assert np.array_equal(solid_rows(image, 128, 32).rows, before.rows)
    again = np.asarray(corrected_greys(held, before.rows, after, paths, (3.0, 2.5), 128, dimmed=before.dimmed))
    assert np.array_equal(again, whole)
    found = decode_png(encode_grey_png(GreyImage.of(image)), "image", (width, len(image)))
    assert found.grey is not None
    assert np.array_equal(np.asarray(found.grey), image)
