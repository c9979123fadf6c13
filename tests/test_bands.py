"""Bands: never above the suggestion, few, high enough, and the best of all such."""

from __future__ import annotations

import math
import time
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from layerfix.errors import InputError
from layerfix.fdm.bands import banded
from layerfix.layers.widths import Widths


def widths_of(
    width_mm: list[float], *, heights: list[float] | None = None, area: list[float] | None = None
) -> Widths:
    """Suggestions for layers of these heights (0.2 mm) and areas (1 mm²)."""
    n = len(width_mm)
    tops = np.cumsum(heights or [0.2] * n)
    z_mm = np.column_stack([np.concatenate([[0.0], tops[:-1]]), tops]) if n else np.empty((0, 2))
    return Widths(
        z_mm,
        np.array(width_mm, float),
        np.array(width_mm) <= 0.4,
        np.array(area or [1.0] * n),
        np.full(n, 4.0),
        (0.4, 1.2),
        0.05,
    )


@st.composite
def suggestions(draw: st.DrawFn, most: int = 9) -> Widths:
    """Up to `most` layers of few widths, of several heights and areas, empty ones among them."""
    n = draw(st.integers(1, most))
    return widths_of(
        draw(st.lists(st.sampled_from([0.4, 0.5, 0.65, 0.8, 1.2]), min_size=n, max_size=n)),
        heights=draw(st.lists(st.sampled_from([0.1, 0.2, 0.3]), min_size=n, max_size=n)),
        area=draw(st.lists(st.sampled_from([0.0, 1.0, 5.0, 30.0]), min_size=n, max_size=n)),
    )


counts = st.integers(1, 5)
heights_mm = st.sampled_from([0.0, 0.05, 0.3, 0.5, 0.9, 5.0])


def bead_mm(widths: Widths, width_mm: np.ndarray) -> float:
    """What is made as short as can be: volume over width, summed over the layers."""
    return float((widths.area_mm2 * np.diff(widths.z_mm, axis=1)[:, 0] / width_mm).sum())


def best_of_all(widths: Widths, count: int, min_height_mm: float) -> float:
    """The least `bead_mm` of all ways to part the layers into bands; the narrowest everywhere if there is none."""
    n, best = len(widths), math.inf
    for bands in range(1, min(count, n) + 1):
        for cuts in combinations(range(1, n), bands - 1):
            parts = list(zip([0, *cuts], [*cuts, n], strict=True))
            if any(widths.z_mm[b - 1, 1] - widths.z_mm[a, 0] < min_height_mm - 1e-9 for a, b in parts):
                continue
            chosen = np.concatenate([np.full(b - a, widths.width_mm[a:b].min()) for a, b in parts])
            best = min(best, bead_mm(widths, chosen))
    return best if best < math.inf else bead_mm(widths, np.full(n, widths.width_mm.min()))


@settings(max_examples=300)
@given(suggestions(), counts, heights_mm)
def test_bands_keep_to_what_was_asked_for(widths, count, height):
    """No layer above its own suggestion, at most `count` bands, none lower than asked for unless the part is."""
    chosen = banded(widths, count, min_height_mm=height)
    assert (chosen.width_mm <= widths.width_mm).all()
    assert set(chosen.width_mm) <= set(widths.width_mm)
    bands = chosen.ranges()
    assert len(bands) <= count
    whole = widths.z_mm[-1, 1] - widths.z_mm[0, 0]
    assert all(top - bottom >= min(height, whole) - 1e-9 for bottom, top, _ in bands)
    assert (bands[0][0], bands[-1][1]) == (widths.z_mm[0, 0], widths.z_mm[-1, 1])
    assert all(a[1] == b[0] for a, b in pairwise(bands))


@settings(max_examples=300)
@given(suggestions(), counts, heights_mm)
def test_no_other_bands_are_better(widths, count, height):
    """The beads are as short as those of the best of all partitions, tried one by one."""
    chosen = banded(widths, count, min_height_mm=height)
    assert bead_mm(widths, chosen.width_mm) == pytest.approx(best_of_all(widths, count, height))


@given(suggestions(30))
def test_one_band_is_the_narrowest(widths):
    """A single band has the least of all suggestions."""
    assert (banded(widths, 1).width_mm == widths.width_mm.min()).all()


@given(suggestions(30), st.integers(30, 99))
def test_with_enough_bands_each_layer_keeps_its_own(widths, count):
    """As many bands as layers and no least height: as suggested, but where there is nothing to print."""
    chosen = banded(widths, count)
    solid = widths.area_mm2 > 0
    assert np.array_equal(chosen.width_mm[solid], widths.width_mm[solid])


@given(suggestions(30), st.integers(1, 6), heights_mm)
def test_more_bands_are_never_worse_and_lower_ones_neither(widths, count, height):
    """What may be chosen with less freedom may be chosen with more."""
    strict = bead_mm(widths, banded(widths, count, min_height_mm=height).width_mm)
    assert bead_mm(widths, banded(widths, count + 1, min_height_mm=height).width_mm) <= strict + 1e-9
    assert bead_mm(widths, banded(widths, count, min_height_mm=height / 2).width_mm) <= strict + 1e-9


@given(suggestions(30), counts, heights_mm)
def test_banding_twice_changes_nothing_and_the_rest_survives(widths, count, height):
    """Bands of bands are the same where anything is printed; the input and all but the widths are as they were."""
    before = widths.width_mm.copy()
    once = banded(widths, count, min_height_mm=height)
    solid = widths.area_mm2 > 0
    assert np.array_equal(banded(once, count, min_height_mm=height).width_mm[solid], once.width_mm[solid])
    assert np.array_equal(widths.width_mm, before)
    for name in ("z_mm", "too_thin", "area_mm2", "outline_mm"):
        assert np.array_equal(getattr(once, name), getattr(widths, name)), name


def test_a_border_where_the_suggestion_does_not_change():
    """Two thin layers on top of a thick part take three of its layers with them, not all."""
    chosen = banded(widths_of([1.2] * 8 + [0.5] * 2), 2, min_height_mm=1.0)
    assert chosen.width_mm.tolist() == [1.2] * 5 + [0.5] * 5


def test_a_large_layer_counts_for_more():
    """With two bands the border goes where the area is saved."""
    narrow, wide, area = [0.4], [0.8, 1.2], [1.0, 1.0, 30.0]
    assert banded(widths_of(narrow + wide, area=area), 2).width_mm.tolist() == [0.4, 0.4, 1.2]
    assert banded(widths_of(narrow + wide, area=[1.0, 30.0, 1.0]), 2).width_mm.tolist() == [0.4, 0.8, 0.8]


def test_a_part_lower_than_a_band_is_one():
    """The least height cannot be had, so it is one band."""
    assert banded(widths_of([0.5, 1.2, 0.8]), 6, min_height_mm=10).ranges() == [(0.0, pytest.approx(0.6), 0.5)]


def test_no_layers_are_no_bands():
    """Nothing in, nothing out."""
    assert len(banded(widths_of([]), 3)) == 0


@pytest.mark.parametrize(
    ("count", "height", "words"),
    [(0, 0.0, "0 bands: a whole number, at least one"),
     (-1, 0.0, "-1 bands"), (1.5, 0.0, "1.5 bands: a whole number"),
     (math.nan, 0.0, "nan bands: a whole number"), (3, -0.1, "band height -0.1 mm: it must be 0 or more"),
     (3, math.nan, "it must be 0 or more"), (3, math.inf, "it must be 0 or more")],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(count, height, words):
    """The value is named."""
    with pytest.raises(InputError, match=words):
        banded(widths_of([0.5, 0.6]), count, min_height_mm=height)


def test_a_tall_part_is_banded_in_time():
    """3,000 layers that all differ, six bands of a least height: a second, so no n³ steps."""
    random = np.random.default_rng(1)
    widths = widths_of(random.uniform(0.4, 1.2, 3000).round(2).tolist())
    started = time.process_time()
    assert len(banded(widths, 6, min_height_mm=1.0).ranges()) <= 6
    assert time.process_time() - started < 20


@pytest.mark.parametrize("seed", range(60))
def test_random_layers_by_brute_force(seed):
    """Layers that differ in width, area and height by an order of magnitude: what is chosen is the best partition, so
    neither heights nor areas are left out of what it costs.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 10))
    widths = widths_of(
        rng.uniform(0.4, 1.2, n).round(2).tolist(),
        heights=rng.choice([0.05, 0.1, 0.2, 0.4], n).tolist(),
        area=rng.choice([1.0, 3.0, 10.0, 30.0], n).tolist(),
    )
    for count in (1, 2, 3, 4):
        for height in (0.0, 0.15, 0.4):
            chosen = banded(widths, count, min_height_mm=height)
            assert bead_mm(widths, chosen.width_mm) == pytest.approx(best_of_all(widths, count, height))
