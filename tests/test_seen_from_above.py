"""A stack is always seen from above: jobs are un-mirrored when read, and mirrored when written."""

from __future__ import annotations

import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from shapely import MultiPolygon, box
from shapely.geometry import shape

import layerfix as lf
from layerfix.layers.correction import correct_image
from tests import independent_readers as plain

SIZE = (48, 70)


def part() -> np.ndarray:
    """(48, 70) uint8: an L with a thick and a thin stroke in a corner, so that every mirroring looks different."""
    image = np.zeros(SIZE, np.uint8)
    image[5:30, 6:20] = 255
    image[26:28, 20:50] = 255
    return image


def flipped(image: np.ndarray, axes: str) -> np.ndarray:
    image = image[:, ::-1] if "x" in axes else image
    return image[::-1] if "y" in axes else image


def sl1(folder: Path, panel: np.ndarray, axes: str) -> Path:
    entries = plain.sl1_entries([panel] * 3)
    mirrors = "".join(f"display_mirror_{axis} = {int(axis in axes)}\n" for axis in "xy")
    entries["prusaslicer.ini"] += mirrors.encode()
    return plain.write_zip(folder / "job.sl1", entries)


def goo(folder: Path, panel: np.ndarray, axes: str) -> Path:
    return plain.write_goo(folder / "job.goo", [panel] * 3, f18="x" in axes, f19="y" in axes)


def ctb(folder: Path, panel: np.ndarray, axes: str) -> Path:
    path = plain.write_chitu(folder / "job.ctb", [panel] * 3, magic=plain.CTB, version=2)
    data = bytearray(path.read_bytes())
    data[0x50] = int("x" in axes)
    path.write_bytes(data)
    return path


def chitubox(folder: Path, panel: np.ndarray, axes: str) -> Path:
    height, width = panel.shape
    gcode = (
        f";machineX:{width * 0.05}\n;machineY:{height * 0.05}\n;resolutionX:{width}\n;resolutionY:{height}\n"
        f";layerHeight:0.05\n;totalLayer:3\n;mirror:{int('x' in axes)}\n"
    )
    layers = {f"{i + 1}.png": plain.png_bytes(panel) for i in range(3)}
    return plain.write_zip(folder / "job.zip", {"run.gcode": gcode.encode(), **layers})


def nanodlp(folder: Path, panel: np.ndarray, axes: str) -> Path:
    slicer = {"XPixelSize": 50, "YPixelSize": 50, "XRes": panel.shape[1], "YRes": panel.shape[0],
              "ImageMirror": int("x" in axes)}  # fmt: skip
    layers = {f"{i + 1}.png": plain.png_bytes(panel) for i in range(3)}
    texts = {"meta.json": b"{}", "slicer.json": json.dumps(slicer).encode(), "profile.json": b'{"Depth": 50}',
             "plate.json": b"{}", "info.json": b"[{}, {}, {}]"}  # fmt: skip
    return plain.write_zip(folder / "job.nanodlp", {**texts, **layers})


def zip_images(path: Path) -> list[np.ndarray]:
    """Layers of a zip job as they lie in it, without thumbnails."""
    with zipfile.ZipFile(path) as job:
        names = [name for name in job.namelist() if name.endswith(".png") and "/" not in name]
        return [plain.png_pixels(job.read(name)) for name in names]


Maker = Callable[[Path, np.ndarray, str], Path]
KINDS = {
    "sl1": (sl1, zip_images, ("", "x", "y", "xy")),
    "goo": (goo, lambda path: plain.read_goo(path).layers, ("", "x", "y", "xy")),
    "ctb": (ctb, lambda path: plain.read_chitu(path).layers, ("", "x")),
    "chitubox": (chitubox, zip_images, ("", "x")),
    "nanodlp": (nanodlp, zip_images, ("", "x")),
}
every_job = pytest.mark.parametrize(
    ("make", "panels_of", "axes"),
    [pytest.param(make, panels_of, axes, id=f"{kind}-{axes or 'plain'}")
     for kind, (make, panels_of, mirrors) in KINDS.items() for axes in mirrors],
)  # fmt: skip


@every_job
def test_a_job_is_read_as_the_part_seen_from_above(tmp_path, make: Maker, panels_of, axes):
    """By index, sliced, iterated, mapped: the same pixels, whatever its panel mirrors."""
    seen = part() > 0
    stack = lf.read(make(tmp_path, flipped(part(), axes), axes), pixel_mm=0.05)
    assert np.array_equal(stack[1].image(), seen)
    assert np.array_equal(stack[:][1].image(), seen)
    assert np.array_equal(stack[1:][0].image(), seen)
    assert all(np.array_equal(layer.image(), seen) for layer in stack)
    assert all(np.array_equal(layer.image(), seen) for layer in stack.map(lambda layer: layer))


@every_job
def test_outlines_of_a_job_lie_where_the_part_does(tmp_path, make: Maker, panels_of, axes):
    """`trace_contours`, of the stack and of a slice, and the written GeoJSON agree with two drawn rectangles."""
    stack = lf.read(make(tmp_path, flipped(part(), axes), axes), pixel_mm=0.05)
    top = 48  # px: y grows upwards, rows downwards
    drawn = MultiPolygon([box(6, top - 30, 20, top - 5).union(box(20, top - 28, 50, top - 26))])
    lf.write(tmp_path / "o.geojson", stack)
    written = shape(json.loads((tmp_path / "o.geojson").read_text())["features"][1]["geometry"])
    for outline in (lf.trace_contours(stack)[1], lf.trace_contours(stack[:])[1], written):
        in_px = MultiPolygon([type(p)(np.asarray(p.exterior.coords) / 0.05) for p in outline.geoms])
        assert in_px.symmetric_difference(drawn).area < 1  # of 410 px


@every_job
def test_a_corrected_job_is_mirrored_again(tmp_path, make: Maker, panels_of, axes):
    """Written in place, the panel shows the mirrored correction of the part seen from above."""
    source = make(tmp_path, flipped(part(), axes), axes)
    target = tmp_path / f"fixed{source.suffix}"
    lf.write(target, lf.correct(lf.read(source, pixel_mm=0.05), min_feature_mm=0.3, mode="add_only"))
    expected = flipped(correct_image(part() > 0, mode="add_only", min_feature_px=6), axes)
    assert (expected != flipped(part() > 0, axes)).any()
    for panel in panels_of(target):
        assert np.array_equal(panel >= 128, expected)


@every_job
def test_a_pickled_job_is_read_again(tmp_path, make: Maker, panels_of, axes):
    """The pickle holds the file's place, not its layers; the stack that comes out of it writes the same job."""
    source = make(tmp_path, flipped(part(), axes), axes)
    stack = lf.correct(lf.read(source, pixel_mm=0.05), min_feature_mm=0.3, mode="add_only")
    pickled = pickle.dumps(stack)
    assert len(pickled) < 4000
    names = [tmp_path / f"{name}{source.suffix}" for name in ("one", "two")]
    for name, one in zip(names, (stack, pickle.loads(pickled)), strict=True):
        lf.write(name, one)
    assert names[0].read_bytes() == names[1].read_bytes()


@every_job
def test_a_job_that_needs_nothing_stays_as_it_is(tmp_path, make: Maker, panels_of, axes):
    """Un-mirrored and mirrored again, every byte is the one it was."""
    source = make(tmp_path, flipped(part(), axes), axes)
    target = tmp_path / f"same{source.suffix}"
    lf.write(target, lf.read(source, pixel_mm=0.05))
    assert target.read_bytes() == source.read_bytes()
