"""Components: counted and found as scipy does, run by run."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from scipy import ndimage

from layerfix.bits import pack, unpack
from layerfix.layers.columns import bounding_box, to_columns, with_border
from layerfix.layers.components import components_at, edges_of_rows, label_runs, same_topology, smaller_than
from tests.pictures_as_text import framed, images, picture


@njit
def _count(columns, of_void):
    return label_runs(columns, of_void)[2]


@njit
def _same(solid, kept, parts, voids):
    return same_topology(solid, kept, parts, voids)


def columns_of(image: np.ndarray, like: np.ndarray | None = None) -> np.ndarray:
    """The working layout, in the box of `like`."""
    rows = pack(image)
    return to_columns(rows, with_border(bounding_box(rows if like is None else pack(like)), 0, 0))


def solids(image: np.ndarray) -> tuple[np.ndarray, int]:
    """8-connected components."""
    return ndimage.label(image, np.ones((3, 3)))


def voids(image: np.ndarray) -> tuple[np.ndarray, int]:
    """4-connected components of what is not solid, the outside among them."""
    return ndimage.label(~framed(image, 1))


@given(images(widths=st.sampled_from([1, 63, 64, 65, 128, 130]), heights=st.integers(1, 20)))
def test_edges_of_rows_are_where_pixels_turn(image):
    """Also at the borders of words and of the frame."""
    starts, edges = edges_of_rows(pack(image))
    for y, line in enumerate(np.pad(image, ((0, 0), (1, 1)))):
        assert edges[starts[y] : starts[y + 1]].tolist() == np.flatnonzero(line[1:] != line[:-1]).tolist()


@given(images())
def test_components_are_counted_as_scipy_does(image):
    """Solid by edges and corners, void by edges."""
    if image.any():
        columns = columns_of(image)
        assert _count(columns, False) == solids(image)[1]
        assert _count(columns, True) == voids(image)[1]


@given(images(), st.integers(0, 2**32 - 1))
def test_topology_is_compared_as_by_hand(image, seed):
    """Kept is any part of the solid: alike if each of its components, and each void, has exactly one partner."""
    if not image.any():
        return
    random = np.random.default_rng(seed)
    kept = image & ~(
        ndimage.binary_dilation(random.random(image.shape) < 0.02, iterations=int(random.integers(1, 3)))
    )
    parts, holes = solids(image), voids(image)
    remains, opened = solids(kept), voids(kept)
    alike = (
        remains[1] == parts[1]
        and set(np.unique(parts[0][kept])) == set(range(1, parts[1] + 1))
        and opened[1] == holes[1]
        and set(np.unique(opened[0][~framed(image, 1)])) == set(range(1, opened[1] + 1))
    )
    assert _same(columns_of(image), columns_of(kept, like=image), parts[1], holes[1]) == alike


@given(images())
def test_pixels_find_their_component(image):
    """Alike if and only if scipy gives them one label; areas are those of its labels."""
    labels, count = solids(image)
    ys, xs = np.nonzero(image)
    found, areas = components_at(pack(image), xs, ys)
    pairs = set(zip(found.tolist(), labels[ys, xs].tolist(), strict=True))
    assert len(pairs) == count == len({a for a, _ in pairs})
    assert sorted(areas.tolist()) == sorted(np.bincount(labels[image])[1:].tolist() if count else [])


def test_a_pixel_beside_a_component_belongs_to_the_nearest_in_its_row():
    """A bead may begin a little outside; outside of all rows it still finds something."""
    image = picture("""
        . . . . . . . . .
        . # # . . . . # .
        . # # . . . . # .
        . . . . . . . . .
    """)
    found, areas = components_at(pack(image), np.array([1, 3, 6, 8, 0]), np.array([1, 1, 1, 2, 2]))
    assert found[0] == found[1] == found[4] != found[2] == found[3]
    assert sorted(areas.tolist()) == [2, 4]
    assert components_at(pack(image & False), np.array([1]), np.array([1]))[1].size == 0


@given(images(), st.integers(0, 40))
def test_small_components_are_picked(image, area_px):
    """Those of fewer pixels, whole; the others not at all."""
    labels, count = solids(image)
    areas = np.bincount(labels[image], minlength=count + 1)
    assert np.array_equal(
        unpack(smaller_than(pack(image), area_px), image.shape[1]), image & (areas < area_px)[labels]
    )
