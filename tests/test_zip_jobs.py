"""Chitubox, NanoDLP and CWS: zips of images with three LCD pixels in each RGB pixel, or not, and their measures."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np
import pytest
from PIL import Image

import layerfix as lf
from layerfix.errors import InputError
from tests.independent_readers import png_bytes, png_pixels, raw_entries, write_zip

GCODE = b";fileName:a\n;layerHeight:0.05\n;machineX:30\n;machineY:15\n;volume:1.5\n;weight:2\n;price:0.5\nG28\n"
SLICER = {"XPixelSize": 50, "YPixelSize": 50, "ImageMirror": 0}


def drawing() -> np.ndarray:
    """A thin wall, a thin bar and a block: (300, 600) uint8."""
    image = np.zeros((300, 600), np.uint8)
    image[50:250, 100:103] = 255
    image[40:45, 200:500] = 255
    image[100:250, 300:400] = 255
    return image


def rgb_png(image: np.ndarray, *, bgr: bool) -> bytes:
    packed = image.reshape(image.shape[0], -1, 3)
    data = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(packed[:, :, ::-1] if bgr else packed)).save(data, "PNG")
    return data.getvalue()


def rgb_pixels(data: bytes, *, bgr: bool) -> np.ndarray:
    packed = np.asarray(Image.open(io.BytesIO(data)))
    return (packed[:, :, ::-1] if bgr else packed).reshape(packed.shape[0], -1)


def chitubox(folder):
    """Eleven layers, in the order of their numbers."""
    layers = {f"{i + 1}.png": png_bytes(np.roll(drawing(), i, axis=0)) for i in range(11)}
    return write_zip(folder / "job.zip", {"run.gcode": GCODE, "preview.png": b"not a layer", **layers})


def nanodlp(folder, *, rgb: bool):
    image = rgb_png(drawing(), bgr=False) if rgb else png_bytes(drawing())
    info = [{"TotalSolidArea": 1.0, "LargestArea": 1.0, "MinX": 0, "AreaCount": 9, "Other": 7}] * 3
    return write_zip(
        folder / "job.nanodlp",
        {"meta.json": b"{}", "slicer.json": json.dumps(SLICER).encode(), "profile.json": b'{"Depth": 50}',
         "plate.json": b'{"TotalSolidArea": 12.5, "Path": "x"}', "info.json": json.dumps(info).encode(),
         **{f"{i + 1}.png": image for i in range(3)}},
    )  # fmt: skip


def cws(folder, *, rgb: bool):
    image = rgb_png(drawing(), bgr=True) if rgb else png_bytes(drawing())
    conf = b"xppm 20.0\nyppm 20.0\nthickness 0.05\nlayers_num 3\n"
    return write_zip(folder / "job.cws", {"slice.conf": conf, "part.gcode": b"G28",
                                          **{f"part{i:04}.png": image for i in range(3)}})  # fmt: skip


def corrected(path, name: str):
    target = path.with_name(name)
    lf.write(target, lf.correct(lf.read(path), min_feature_mm=0.5, mode="add_only"))
    return target


def expected() -> np.ndarray:
    return lf.correct_image(drawing() > 0, mode="add_only", min_feature_px=10) * np.uint8(255)


def test_chitubox_layers_are_numbered(tmp_path):
    """10.png comes after 9.png, previews are no layers, pitch and height come from run.gcode."""
    stack = lf.read(chitubox(tmp_path))
    assert (len(stack), stack.pixel_mm, stack.z_mm[0].tolist()) == (11, (0.05, 0.05), [0.0, 0.05])
    for i, layer in enumerate(stack):
        assert np.array_equal(layer.image(), np.roll(drawing(), i, axis=0) > 0)


def test_chitubox_volume_grows_with_what_is_added(tmp_path):
    """volume, weight and price follow; every other byte of run.gcode and the preview stay."""
    target = corrected(chitubox(tmp_path), "fixed.zip")
    assert np.array_equal(png_pixels(zipfile.ZipFile(target).read("1.png")), expected())
    added = 11 * ((expected() > 0).sum() - (drawing() > 0).sum()) * 0.05**3 / 1000
    gcode = zipfile.ZipFile(target).read("run.gcode").decode()
    assert f";volume:{1.5 + added:.6f}\n" in gcode
    assert f";weight:{2 * (1 + added / 1.5):.6f}\n" in gcode
    assert gcode.endswith("G28\n")
    assert zipfile.ZipFile(target).read("preview.png") == b"not a layer"


@pytest.mark.parametrize("rgb", [False, True], ids=["grey", "rgb"])
def test_nanodlp_measures_follow(tmp_path, rgb):
    """Layers of either packing are corrected alike; areas of changed layers are taken anew, other keys stay."""
    source = nanodlp(tmp_path, rgb=rgb)
    assert np.array_equal(lf.read(source)[1].image(), drawing() > 0)
    entries = raw_entries(source), raw_entries(corrected(source, "fixed.nanodlp"))
    changed = {name for name in entries[0] if entries[0][name] != entries[1][name]}
    assert changed == {"1.png", "2.png", "3.png", "plate.json", "info.json"}
    target = zipfile.ZipFile(tmp_path / "fixed.nanodlp")
    pixels = rgb_pixels(target.read("2.png"), bgr=False) if rgb else png_pixels(target.read("2.png"))
    assert np.array_equal(pixels, expected())
    info = json.loads(target.read("info.json"))[2]
    area = (expected() > 0).sum() * 0.05**2
    assert info["TotalSolidArea"] == pytest.approx(area)
    assert set(info) == {"TotalSolidArea", "LargestArea", "MinX", "AreaCount", "Other"}
    assert (info["AreaCount"], info["Other"]) == (3, 7)
    assert info["MinX"] == np.flatnonzero(expected().any(axis=0))[0]
    grown = 3 * ((expected() > 0).sum() - (drawing() > 0).sum()) * 0.05**2
    assert json.loads(target.read("plate.json"))["TotalSolidArea"] == pytest.approx(12.5 + grown, abs=1e-3)


@pytest.mark.parametrize("rgb", [False, True], ids=["grey", "rgb"])
def test_cws_layers_of_either_packing(tmp_path, rgb):
    """Blue is leftmost in CWS; only the layers change."""
    source = cws(tmp_path, rgb=rgb)
    stack = lf.read(source)
    assert (len(stack), stack.pixel_mm) == (3, (0.05, 0.05))
    assert np.array_equal(stack[0].image(), drawing() > 0)
    target = zipfile.ZipFile(corrected(source, "fixed.cws"))
    data = target.read("part0001.png")
    assert np.array_equal(rgb_pixels(data, bgr=True) if rgb else png_pixels(data), expected())
    assert target.read("slice.conf") == zipfile.ZipFile(source).read("slice.conf")


@pytest.mark.parametrize(("x", "y"), [("20.000", "20.000"), ("0.050", "0.050")])
def test_cws_whose_values_are_in_its_gcode(tmp_path, x, y):
    """No slice.conf: pixels per mm, or the pitch by that name, and the layer height from the comments."""
    pitch = f";(Pix per mm X            = {x} )\n;(Pix per mm Y            = {y} )\n"
    gcode = f";(****Build****)\n{pitch};(Layer Thickness         = 0.050 mm )\n"
    entries = {"part.gcode": gcode.encode(), **{f"part{i:04}.png": png_bytes(drawing()) for i in range(3)}}
    source = write_zip(tmp_path / "job.cws", entries)
    stack = lf.read(source)
    assert (len(stack), stack.pixel_mm, stack.z_mm[-1].tolist()) == (3, (0.05, 0.05), [0.1, 0.15])
    target = zipfile.ZipFile(corrected(source, "fixed.cws"))
    assert np.array_equal(png_pixels(target.read("part0001.png")), expected())
    assert target.read("part.gcode") == gcode.encode()
    bare = write_zip(tmp_path / "bare.cws", {**entries, "part.gcode": b"G28"})
    with pytest.raises(InputError, match=r"neither slice\.conf nor the G-code says pixels per mm"):
        lf.read(bare)


@pytest.mark.parametrize("make", [chitubox, lambda f: nanodlp(f, rgb=True), lambda f: cws(f, rgb=True)],
                         ids=["chitubox", "nanodlp", "cws"])  # fmt: skip
def test_a_job_that_needs_nothing_comes_out_identical(tmp_path, make):
    """Byte for byte."""
    source = make(tmp_path)
    target = source.with_stem("same")
    lf.write(target, lf.correct(lf.read(source), min_feature_mm=0.11, mode="add_only"))
    assert target.read_bytes() == source.read_bytes()


def test_a_job_without_its_pitch_names_the_option(tmp_path):
    """What the file does not say can be given."""
    path = write_zip(tmp_path / "job.zip", {"run.gcode": b"G28\n", "1.png": png_bytes(drawing())})
    with pytest.raises(InputError, match="--printer"):
        lf.read(path)
    assert lf.read(path, pixel_mm=0.05, layer_mm=0.1).pixel_mm == (0.05, 0.05)


@pytest.mark.parametrize("make", [chitubox, lambda f: nanodlp(f, rgb=False), lambda f: cws(f, rgb=False)])
def test_a_layer_that_is_missing_is_told(tmp_path, make):
    """In every job that is a zip: between which images, and how many the job speaks of, where it does."""
    entries = raw_entries(make(tmp_path))
    source = tmp_path / "holed.zip"
    with zipfile.ZipFile(make(tmp_path)) as whole:
        contents = {name: whole.read(name) for name in entries}
    assert lf.read(write_zip(source, contents)).notes == ()
    names = [name for name in contents if name.endswith(".png") and name != "preview.png"]
    del contents[names[1]]
    notes = lf.read(write_zip(source, contents), layer_mm=0.05).notes
    assert notes[0].startswith(f"numbers are missing between {names[0]} and {names[2]}: ")
    said = [note for note in notes if note.startswith("the job says")]
    if "slice.conf" in contents:
        assert said == ["the job says that it has 3 layers; there are images of 2"]
    if "slice.conf" not in contents:
        contents[f"0{names[0]}"] = contents[names[0]]
        with pytest.raises(InputError, match=r"0?1.png and 0?1.png are of one number"):
            lf.read(write_zip(source, contents))
