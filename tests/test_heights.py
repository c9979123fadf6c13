"""Features of too few layers: column by column, and drawn."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from layerfix import LayerStack, correct
from layerfix.errors import InputError
from layerfix.layers.heights import with_min_layers
from tests.independent_readers import write_sl1
from tests.making import box, joined, run_layerfix, write_stl

CROSS = ndimage.generate_binary_structure(2, 1)


def expected(solid: np.ndarray, least: int) -> np.ndarray:
    """Each run at each pixel, one by one."""
    count, out = len(solid), solid.copy()
    for first in range(count):
        labels, _ = ndimage.label(solid[first], np.ones((3, 3)))
        below = solid[first - 1] if first else np.zeros_like(solid[0])
        standing = np.isin(labels, labels[solid[first] & ndimage.binary_dilation(below, CROSS)]) & solid[first]
        for y, x in np.argwhere(solid[first] & ~below):
            stop = first
            while stop < count and solid[stop, y, x]:
                stop += 1
            missing = least - (stop - first)
            if missing <= 0:
                continue
            if standing[y, x]:
                down = min(missing, first)
                up = missing - down
            else:
                up = min(missing, count - stop)
                down = missing - up
            out[max(first - down, 0) : stop + up, y, x] = True
    return out


@settings(max_examples=80)
@given(st.integers(0, 10**6), st.integers(2, 5), st.integers(1, 4))
def test_as_columns_say(seed, least, workers):
    """Random stacks; nothing is taken away, every run is high enough where there is room."""
    rng = np.random.default_rng(seed)
    solid = ndimage.gaussian_filter(rng.random((rng.integers(least, 12), 14, 20)), rng.uniform(0.4, 1.2)) > 0.52
    stack = LayerStack.from_images(solid, pixel_mm=0.1, layer_mm=0.1).with_workers(workers)
    raised = with_min_layers(stack, least)
    found = np.asarray(raised)
    assert np.array_equal(found, expected(solid, least))
    assert [layer.raised_px for layer in raised] == (found & ~solid).sum(axis=(1, 2)).tolist()
    assert np.array_equal(np.asarray(pickle.loads(pickle.dumps(raised))), found)
    runs = np.diff(np.pad(found, ((1, 1), (0, 0), (0, 0))).astype(int), axis=0)
    lengths = np.argwhere(runs.transpose(1, 2, 0) == -1)[:, 2] - np.argwhere(runs.transpose(1, 2, 0) == 1)[:, 2]
    assert (lengths >= least).all()


def layers_of(picture: str) -> np.ndarray:
    """A section: lines from the top layer to the lowest, as layers of one row."""
    return np.array([[c == "#" for c in line.strip()] for line in picture.split()])[::-1, None, :]


def test_a_shelf_grows_down_an_island_up():
    """A shelf on a wall gets a layer below, a first layer and what hangs in the air one above."""
    solid = layers_of("""
        ..##..........
        ..##..........
        ..######...##.
        ..##..........
        ..##..........
        ..##....###...
    """)
    raised = layers_of("""
        ..##..........
        ..##.......##.
        ..######...##.
        ..######......
        ..##....###...
        ..##....###...
    """)
    stack = LayerStack.from_images(solid, pixel_mm=0.1, layer_mm=0.1)
    assert np.array_equal(np.asarray(with_min_layers(stack, 2)), raised)
    assert with_min_layers(stack, 1) is stack
    fixed = correct(stack, min_feature_mm=0.2, min_layers=2, mode="add_only")
    assert (np.asarray(fixed) & raised).sum() == raised.sum()


def test_of_a_job_with_greys_they_are_drawn_in_full(tmp_path):
    """What is raised in a job is white, and told."""
    layers = [np.zeros((40, 60), np.uint8) for _ in range(5)]
    for layer in layers:
        layer[10:30, 10:30] = 255
        layer[9, 10:30] = 100
    layers[2][12:28, 30:50] = 255
    job = write_sl1(tmp_path / "job.sl1", layers)
    how = ("--pixel", "50um", "--min-feature", "0.2mm", "--min-layers", "2")
    run = run_layerfix("fix", job, tmp_path / "fixed.sl1", *how)
    assert "raised to the fewest layers asked for in 1 layer, the first at z = 0.0" in run.out
    run = run_layerfix("fix", tmp_path / "fixed.sl1", tmp_path / "images", "--pixel", "50um", *how[2:])
    from PIL import Image

    greys = [np.asarray(Image.open(path)) for path in sorted((tmp_path / "images").iterdir())]
    assert [int((grey[12:28, 10:30] == 255).sum()) for grey in greys] == [0, 320, 320, 0, 0]


@pytest.mark.parametrize("number", [0, -1, 101, 1.5])
def test_numbers_that_are_none(number):
    """Refused."""
    with pytest.raises(InputError, match="a whole number from 1 to 100"):
        with_min_layers(LayerStack.from_images(np.ones((2, 3, 3), bool), pixel_mm=1, layer_mm=1), number)


def test_a_stack_of_fewer_layers_is_filled():
    """As high as there is room; the summary counts what is raised, and the note says that it was not enough."""
    solid = np.zeros((3, 5, 5), np.bool_)
    solid[1, 1:4, 1:4] = True
    stack = LayerStack.from_images(solid, pixel_mm=0.1, layer_mm=0.1)
    assert np.array_equal(np.asarray(with_min_layers(stack, 7)), np.broadcast_to(solid[1], solid.shape))
    one = LayerStack.from_images(solid[1:2], pixel_mm=0.1, layer_mm=0.1)
    assert with_min_layers(one, 3) is one


def test_what_is_raised_counts_as_added(tmp_path):
    """A roof of two layers on two posts becomes ten high: by hand, 6 × 1 × 0.8 mm³ between the posts."""
    posts = joined(box((0, 0, 0), (1, 1, 3)), box((7, 0, 0), (8, 1, 3)), box((0, 0, 3), (8, 1, 3.2)))
    source = write_stl(tmp_path / "roof.stl", posts)
    how = ("--pixel", "50um", "--layer", "0.1mm", "--min-feature", "0.4mm", "--mode", "add_only", "--json")
    said = json.loads(run_layerfix("fix", source, tmp_path / "a.zip", *how, "--min-layers", "10").out)
    assert said["added_mm3"] == pytest.approx(6 * 1 * 0.8, rel=0.01)
    assert said["volume_mm3"] == pytest.approx(2 * 3 + 8 * 0.2, rel=0.01)
    assert not any("fewer than" in note for note in said["notes"])
    said = json.loads(run_layerfix("fix", source, tmp_path / "b.zip", *how, "--min-layers", "50").out)
    assert said["added_mm3"] == pytest.approx(6 * 1 * 3, rel=0.01)
    assert any(note.startswith("there are 32 layers in all, fewer than 50") for note in said["notes"]), said["notes"]
