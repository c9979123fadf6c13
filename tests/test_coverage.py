"""Greys of meshes: how much of each pixel is covered, against polygons cut by shapely; what is written of them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from layerfix import correct, load_printer, read, slice_mesh, write
from layerfix.errors import InputError
from layerfix.layers.grey_image import GreyImage
from layerfix.mesh.coverage import coverage, coverage_in_words
from layerfix.mesh.fill import EVEN_ODD, NONZERO, POSITIVE
from tests.making import box, cylinder, joined, run_layerfix, save_stl, turned
from tests.test_new_jobs import OWN

RULES = {EVEN_ODD: "even_odd", NONZERO: "nonzero", POSITIVE: "positive"}


def segments_of(polygon: shapely.Polygon) -> np.ndarray:
    """Edges with the solid on the left (x right, y up; rows run down, so the other way in columns and rows)."""
    parts = []
    for part in shapely.get_parts(shapely.normalize(polygon)):
        oriented = shapely.geometry.polygon.orient(part, -1)
        for ring in (oriented.exterior, *oriented.interiors):
            points = np.asarray(ring.coords)
            parts.append(np.concatenate([points[:-1], points[1:]], axis=1))
    return np.concatenate(parts) if parts else np.empty((0, 4))


def areas(polygon: shapely.Polygon, width: int, height: int) -> np.ndarray:
    """(H, W): the area of the polygon in each pixel, whose centre is at whole numbers."""
    x, y = np.meshgrid(np.arange(width) - 0.5, np.arange(height) - 0.5)
    return shapely.area(shapely.intersection(polygon, shapely.box(x, y, x + 1, y + 1)))


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**6))
def test_as_shapely_cuts_them(seed):
    """Random polygons with holes, some of them past the frame."""
    rng = np.random.default_rng(seed)
    width, height = rng.integers(5, 24, 2)
    middle, turns = rng.uniform(0, [width, height]), np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 9)))
    reach = rng.uniform(0.3, 12, len(turns))
    star = shapely.Polygon(middle + np.stack([np.cos(turns), np.sin(turns)], axis=1) * reach[:, None])
    hole = shapely.Point(*rng.uniform(0, [width, height])).buffer(rng.uniform(0.2, 3), quad_segs=2)
    polygon = shapely.make_valid(star).difference(hole)
    polygon = shapely.MultiPolygon([p for p in shapely.get_parts(polygon) if isinstance(p, shapely.Polygon)])
    expected = areas(polygon, width, height)
    for rule in (NONZERO, EVEN_ODD, POSITIVE):
        found = coverage(segments_of(polygon), width, height, rule)
        assert np.abs(found - 255 * expected).max() <= 0.51, rule


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([NONZERO, EVEN_ODD, POSITIVE]))
def test_in_words_it_is_the_same(seed, rule):
    """Loops of any kind, across each other, past the frame, along its edges: pixel by pixel what `coverage` says."""
    rng = np.random.default_rng(seed)
    width, height = int(rng.integers(1, 300)), int(rng.integers(1, 40))
    loops = []
    for _ in range(rng.integers(1, 5)):
        corners = rng.uniform([-30, -10], [width + 30, height + 10], (rng.integers(3, 8), 2))
        corners = np.round(corners * 2) / 2 if rng.random() < 0.3 else corners
        loops.append(np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1))
    segments = np.ascontiguousarray(np.concatenate(loops))
    words = GreyImage(width, *coverage_in_words(segments, width, height, rule))
    assert np.array_equal(np.asarray(words), coverage(segments, width, height, rule))
    again = GreyImage.of(coverage(segments, width, height, rule))
    assert all(np.array_equal(getattr(words, name), getattr(again, name)) for name in ("firsts", "at", "values"))


@pytest.mark.parametrize("degrees", [3, 10, 25, 40])
def test_a_slanted_wall_has_its_area(degrees):
    """At least ten times nearer than with black and white, layer by layer, on average over places."""
    errors = []
    for place in np.linspace(0, 0.9, 7):
        wall = turned(box([0, 0, 0], [6, 1.03, 0.3]), "z", degrees).moved([place * 0.1, place * 0.07, 0])
        for antialias in (False, True):
            layer = slice_mesh(wall, pixel_mm=0.1, layer_mm=0.1, antialias=antialias)[1]
            px = layer.source.grey.sum() / 255 if antialias else layer.count_px()
            errors.append(abs(px * 0.01 - 6 * 1.03))
    plain, soft = np.mean(errors[::2]), np.mean(errors[1::2])
    assert soft <= plain / 10 + 1e-4


def test_what_is_solid_stays_what_it_was_but_for_half_pixels():
    """A ring: its rows with and without greys differ only where a pixel is about half covered."""
    ring = joined(cylinder(3, 1), cylinder(0.5, 1).moved([5, 0, 0]))
    how = {"pixel_mm": 0.1, "layer_mm": 0.2}
    for plain, soft in zip(slice_mesh(ring, **how), slice_mesh(ring, **how, antialias=True), strict=True):
        grey = soft.source.grey
        assert (np.abs(grey[plain.image() != soft.image()].astype(int) - 128) < 45).all()
        assert np.array_equal(soft.image(), grey >= 128)


def test_what_is_thinner_than_a_pixel_or_a_layer_is_there_too():
    """A fin of 10 µm, whose greys are under the floor, and a foil between two mid-planes."""
    part = joined(
        box([0, 0, 0], [4, 4, 1]), turned(box([6, 0, 0], [6.01, 4, 1]), "z", 20), box([8, 0, 0.62], [9, 4, 0.68])
    )
    how = {"pixel_mm": 0.1, "layer_mm": 0.2}
    plain, soft = slice_mesh(part, **how), slice_mesh(part, **how, antialias=True)
    assert [layer.hairline_px for layer in plain] == [layer.hairline_px for layer in soft]
    for one, other in zip(plain, soft, strict=True):
        assert (one.image() & ~other.image()).sum() <= 0.02 * one.count_px()
        kept = correct(soft, min_feature_mm=0.4, mode="add_only")
    assert all((np.asarray(layer.source.from_above(layer)) >= 128)[layer.image()].all() for layer in kept)


def panel(suffix: str, bits: int) -> str:
    """The printer's file of a panel that shows so many bits of grey."""
    return OWN.format(suffix=suffix, mirror="x") + f"antialias_bits = {bits}\n"


@pytest.mark.parametrize("suffix", [".goo", ".sl1s"])
@pytest.mark.parametrize("bits", [1, 3, 4, 8])
def test_jobs_have_the_greys_that_the_panel_shows(tmp_path, suffix, bits):
    """So many levels, where they belong; no greys for one bit or if not wanted; the job reads back as it is."""
    (tmp_path / "own.toml").write_text(panel(suffix, bits))
    save_stl(tmp_path / "part.stl", turned(box([0, 0, 0], [5, 2, 0.3]), "z", 20))
    run = run_layerfix("fix", tmp_path / "part.stl", tmp_path / f"a{suffix}", "-p", tmp_path / "own.toml")
    assert run.code == 0, run.err
    layer = read(tmp_path / f"a{suffix}")[1]
    if bits == 1:
        assert layer.source.grey is None
    else:
        levels = np.unique(layer.source.grey)
        assert 3 < len(levels) <= 2**bits
        part = turned(box([0, 0, 0], [5, 2, 0.3]), "z", 20)
        sliced = slice_mesh(part, pixel_mm=0.05, layer_mm=0.1, frame_px=(200, 120), antialias=True)[1]
        assert (
            np.abs(np.asarray(layer.source.from_above(layer)).astype(int) - sliced.source.grey).max()
            <= 128 / (2**bits - 1) + 1
        )
    how = ("-p", tmp_path / "own.toml", "--no-antialias")
    assert run_layerfix("fix", tmp_path / "part.stl", tmp_path / f"b{suffix}", *how).code == 0
    assert read(tmp_path / f"b{suffix}")[1].source.grey is None


def test_images_have_greys_if_asked(tmp_path):
    """And outlines never do."""
    save_stl(tmp_path / "part.stl", turned(box([0, 0, 0], [5, 2, 0.3]), "z", 20))
    how = ("--pixel", "0.05mm", "--layer", "0.1mm", "--min-feature", "0.2mm", "--antialias")
    assert run_layerfix("fix", tmp_path / "part.stl", tmp_path / "out", *how).code == 0
    assert len(np.unique(np.asarray(Image.open(tmp_path / "out" / "00001.png")))) > 20
    run = run_layerfix("fix", tmp_path / "part.stl", tmp_path / "out.svg", *how)
    assert run.code == 2
    assert "--antialias goes with images of 8 bits and jobs" in run.err


def test_a_job_becomes_another_with_its_greys(tmp_path):
    """SL1 to GOO: the same picture on both panels."""
    for suffix in (".sl1s", ".goo"):
        (tmp_path / f"own{suffix}.toml").write_text(panel(suffix, 8))
    part = turned(box([0, 0, 0], [5, 2, 0.3]), "z", 20)
    stack = slice_mesh(part, pixel_mm=0.05, layer_mm=0.1, frame_px=(200, 120), antialias=True)
    write(tmp_path / "a.sl1s", stack, load_printer(tmp_path / "own.sl1s.toml"))
    write(tmp_path / "b.goo", read(tmp_path / "a.sl1s"), load_printer(tmp_path / "own.goo.toml"))
    for one, other in zip(read(tmp_path / "a.sl1s"), read(tmp_path / "b.goo"), strict=True):
        assert np.array_equal(one.source.from_above(one), other.source.from_above(other))


def test_a_file_that_is_no_mesh_takes_no_antialias(tmp_path):
    """It has its greys, or none."""
    with pytest.raises(InputError, match="not known"):
        slice_mesh(box([0, 0, 0], [1, 1, 1]), pixel_mm=0.1, layer_mm=0.1, fill="all")
    Image.fromarray(np.full((20, 20), 255, np.uint8)).save(tmp_path / "a.png")
    run = run_layerfix("fix", tmp_path / "a.png", tmp_path / "b.png", "--antialias", "--min-feature", "0.2mm",
                       "--pixel", "50um", "--layer", "50um")  # fmt: skip
    assert run.code == 2
    assert "goes with meshes" in run.err


@pytest.mark.parametrize("suffix", [".goo", ".sl1s"])
def test_greys_that_a_panel_cannot_show_are_told(tmp_path, suffix):
    """A job with greys for a panel of eight bits becomes one for a panel of one: they are gone, and that is said."""
    for bits in (1, 8):
        (tmp_path / f"own{bits}.toml").write_text(panel(suffix, bits))
    save_stl(tmp_path / "part.stl", turned(box([0, 0, 0], [5, 2, 0.3]), "z", 20))
    assert run_layerfix("fix", tmp_path / "part.stl", tmp_path / f"a{suffix}", "-p", tmp_path / "own8.toml").code == 0
    for bits, told in ((8, False), (1, True)):
        other = ".goo" if suffix == ".sl1s" else ".sl1s"
        (tmp_path / f"other{bits}.toml").write_text(panel(other, bits))
        target = tmp_path / f"b{bits}{other}"
        run = run_layerfix("fix", tmp_path / f"a{suffix}", target, "-p", tmp_path / f"other{bits}.toml", "--json")
        assert run.code == 0, run.err
        notes = [note for note in json.loads(run.out)["notes"] if "black and white" in note]
        words = "greys, the first at z = 0.000 mm, are black and white now: Me Test SL1S shows no others"
        assert notes == [words] * told
