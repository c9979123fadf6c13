"""Parts with nothing below and above: which they are, and that they stay as they are."""

from __future__ import annotations

import pickle

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from layerfix import LayerStack, correct
from layerfix.bits import unpack
from layerfix.layers.specks import with_specks
from tests.independent_readers import write_sl1
from tests.making import run_layerfix

ALL_AROUND = np.ones((3, 3))


@settings(max_examples=80)
@given(st.integers(0, 10**6))
def test_as_the_labels_say(seed):
    """Against scipy's components, in any order and by several threads."""
    rng = np.random.default_rng(seed)
    solid = ndimage.gaussian_filter(rng.random((rng.integers(1, 7), 15, 70)), rng.uniform(0, 1)) > 0.56
    stack = with_specks(LayerStack.from_images(solid, pixel_mm=0.1, layer_mm=0.1))
    for k, layer in enumerate(pickle.loads(pickle.dumps(stack))):
        labels, _ = ndimage.label(solid[k], ALL_AROUND)
        around = np.zeros_like(solid[k])
        for other in (k - 1, k + 1):
            if 0 <= other < len(solid):
                around |= solid[other]
        held = np.isin(labels, labels[solid[k] & ndimage.binary_dilation(around, ALL_AROUND)])
        expected = solid[k] & ~held & (len(solid) > 1)
        found = np.zeros_like(expected) if layer.specks is None else unpack(layer.specks, 70)
        assert np.array_equal(found, expected)


def test_a_speck_in_a_job_stays_a_pixel(tmp_path):
    """One pixel in one layer: a disc by default, as it was if asked; a post of pixels is corrected."""
    layers = [np.zeros((60, 90), np.uint8) for _ in range(4)]
    for layer in layers:
        layer[20:40, 20:40] = 255
        layer[50, 50] = 255
    layers[2][10, 70] = 255
    job = write_sl1(tmp_path / "job.sl1", layers)
    how = ("--pixel", "50um", "--min-feature", "0.3mm")
    from layerfix import read

    counts = []
    for name, more in (("a.sl1", ()), ("b.sl1", ("--ignore-specks",))):
        run = run_layerfix("fix", job, tmp_path / name, *how, *more)
        assert run.code == 0, run.err
        counts.append([layer.count_px() for layer in read(tmp_path / name, pixel_mm=0.05)])
    disc = counts[0][0] - 400
    assert disc > 20
    assert counts == [
        [400 + disc, 400 + disc, 400 + 2 * disc, 400 + disc],
        [400 + disc, 400 + disc, 401 + disc, 400 + disc],
    ]
    assert "specks left as they are in 1 layer, the first at z = 0.1" in run.out


def test_a_stack_of_one_layer_has_none():
    """Nothing is known of what is above and below."""
    stack = LayerStack.from_images([np.eye(9, dtype=bool)], pixel_mm=0.1, layer_mm=0.1)
    assert with_specks(stack) is stack
    fixed = correct(stack, min_feature_mm=0.3, ignore_specks=True)
    assert fixed[0].change.added_px > 0


def test_a_speck_that_stays_is_not_raised_either():
    """It is left in its one layer; a plate of one layer becomes two."""
    solid = np.zeros((6, 30, 40), bool)
    solid[:3, 10:20, 10:20] = True
    solid[2, 10:20, 20:35] = True
    solid[4, 3, 3] = True
    stack = LayerStack.from_images(solid, pixel_mm=0.1, layer_mm=0.1)
    for ignored, layers in ((True, [4]), (False, [4, 5])):
        fixed = np.asarray(correct(stack, min_feature_mm=0.3, mode="add_only", min_layers=2, ignore_specks=ignored))
        assert np.flatnonzero(fixed[:, 3, 3]).tolist() == layers
        assert fixed[1, 12, 30]
        assert fixed[4, :8, :8].sum() == (1 if ignored else 9)
