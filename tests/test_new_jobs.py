"""Jobs made from meshes, and jobs turned into other jobs: what the printer and an independent reader find in them."""

from __future__ import annotations

import io
import json
import struct
import zipfile

import numpy as np
import pytest
from PIL import Image

import layerfix as lf
from layerfix.errors import OutputError
from layerfix.formats.jobs import goo
from layerfix.stack import LayerStack
from tests.independent_readers import ini, read_goo, sl1_layers
from tests.making import box, run_layerfix, write_stl

OWN = """
maker = "Me"
model = "Test SL1S"
process = "resin"
pixels = [200, 120]
pixel_mm = [0.05, 0.05]
build_mm = [10.0, 6.0, 20.0]
mirror = "{mirror}"
format = "{suffix}"
layer_mm = 0.1
layer_range_mm = [0.02, 0.2]
min_feature_mm = 0.2
exposure_s = 2.5
bottom_exposure_s = 30.0
bottom_layers = 3
transition_layers = 4
lift_mm = 6.0
lift_mm_min = 60.0
retract_mm_min = 120.0
light_pwm = 200
"""


def own(folder, suffix: str, mirror: str = ""):
    """A small printer of one's own."""
    path = folder / f"own-{suffix[1:]}-{mirror or 'plain'}.toml"
    path.write_text(OWN.format(suffix=suffix, mirror=mirror))
    return lf.load_printer(path)


def stack(printer) -> LayerStack:
    """Seven layers of an L that fills a corner: every mirroring looks different."""
    image = np.zeros((120, 200), bool)
    image[10:100, 20:40] = True
    image[80:100, 20:150] = True
    return LayerStack.from_images([image] * 7, pixel_mm=printer.pixel_mm, layer_mm=0.1)


def turned(image: np.ndarray, axes: str) -> np.ndarray:
    image = image[:, ::-1] if "x" in axes else image
    return image[::-1] if "y" in axes else image


@pytest.mark.parametrize("mirror", ["", "x", "y", "xy"])
def test_a_new_sl1_job_has_what_the_firmware_reads(tmp_path, mirror):
    """Layers as the panel shows them, exposure from the printer's file, the material used, previews."""
    printer = own(tmp_path, ".sl1s", mirror)
    layers = stack(printer)
    lf.write(tmp_path / "part.sl1s", layers, printer)
    images = sl1_layers(tmp_path / "part.sl1s")
    assert len(images) == 7
    for image in images:
        assert np.array_equal(image, turned(layers[0].image(), mirror) * np.uint8(255))
    with zipfile.ZipFile(tmp_path / "part.sl1s") as job:
        assert job.testzip() is None
        config = ini(job.read("config.ini").decode())
        for size in ((400, 400), (800, 480)):
            with Image.open(io.BytesIO(job.read(f"thumbnail/thumbnail{size[0]}x{size[1]}.png"))) as picture:
                assert picture.size == size
                assert len(picture.convert("RGB").getcolors(100_000)) > 2
    assert config["action"] == "print"
    assert (config["expTime"], config["expTimeFirst"], config["numFade"]) == ("2.5", "30", "4")
    assert (config["layerHeight"], config["printerModel"], config["jobDir"]) == ("0.1", "SL1S", "part")
    assert float(config["usedMaterial"]) == pytest.approx(layers.volume_mm3() / 1000, abs=1e-6)


def test_a_new_goo_job_has_what_the_specification_says(tmp_path):
    """Checked by a reader written from the specification."""
    printer = own(tmp_path, ".goo", "x")
    layers = stack(printer)
    lf.write(tmp_path / "part.goo", layers, printer)
    job = read_goo(tmp_path / "part.goo")
    assert len(job.layers) == 7
    for image in job.layers:
        assert np.array_equal(image, turned(layers[0].image(), "x") * np.uint8(255))
    data = (tmp_path / "part.goo").read_bytes()
    assert data[:12] == b"V3.0" + bytes([7, 0, 0, 0]) + b"DLP\0"
    assert data.endswith(bytes([0, 0, 0, 7, 0, 0, 0]) + b"DLP\0")
    at = 195310
    count, width, height, mirror_x, mirror_y = struct.unpack_from(">IHH??", data, at)
    assert (count, width, height, mirror_x, mirror_y) == (7, 200, 120, True, False)
    assert struct.unpack_from(">5f", data, at + 10) == pytest.approx((10, 6, 20, 0.1, 2.5))


@pytest.mark.parametrize("suffix", [".sl1s", ".goo"])
def test_a_new_job_reads_back_as_it_was(tmp_path, suffix):
    """Pixels, pitch and heights, whatever the panel mirrors."""
    printer = own(tmp_path, suffix, "x")
    layers = stack(printer)
    lf.write(tmp_path / f"part{suffix}", layers, printer)
    again = lf.read(tmp_path / f"part{suffix}")
    assert again.pixel_mm == layers.pixel_mm
    assert np.allclose(again.z_mm, layers.z_mm)
    lf.write(tmp_path / "images.zip", again)
    seen = lf.read(tmp_path / "images.zip")
    assert all(np.array_equal(a.rows, b.rows) for a, b in zip(seen, layers, strict=True))


@pytest.mark.parametrize(("source", "target"), [(".sl1s", ".goo"), (".goo", ".sl1s")])
@pytest.mark.parametrize("mirrors", [("x", ""), ("x", "x"), ("", "y")])
def test_a_job_becomes_another(tmp_path, source, target, mirrors):
    """The part comes out the right way round, though the panels mirror differently."""
    first, second = own(tmp_path, source, mirrors[0]), own(tmp_path, target, mirrors[1])
    lf.write(tmp_path / f"a{source}", stack(first), first)
    lf.write(tmp_path / f"b{target}", lf.read(tmp_path / f"a{source}"), second)
    lf.write(tmp_path / "seen.zip", lf.read(tmp_path / f"b{target}", pixel_mm=0.05))
    assert np.array_equal(lf.read(tmp_path / "seen.zip")[3].image(), stack(first)[3].image())


def test_what_a_new_job_lacks_is_named(tmp_path):
    """No printer, a printer of other jobs, no exposure, layers of another size: one error each, and no file."""
    printer = own(tmp_path, ".goo")
    with pytest.raises(OutputError, match="--printer"):
        lf.write(tmp_path / "a.goo", stack(printer))
    with pytest.raises(OutputError, match=r"takes \.goo jobs"):
        lf.write(tmp_path / "a.sl1", stack(printer), printer)
    text = (tmp_path / "own-goo-plain.toml").read_text().replace("bottom_exposure_s = 30.0\n", "")
    (tmp_path / "dark.toml").write_text(text)
    with pytest.raises(OutputError, match="lacks bottom_exposure_s"):
        lf.write(tmp_path / "a.goo", stack(printer), lf.load_printer(tmp_path / "dark.toml"))
    small = LayerStack.from_images([np.ones((9, 9), bool)], pixel_mm=0.05, layer_mm=0.1)
    with pytest.raises(OutputError, match="200 × 120"):
        lf.write(tmp_path / "a.goo", small, printer)
    assert not list(tmp_path.glob("a.*"))
    assert not list(tmp_path.glob(".*"))


def test_from_a_mesh_on_the_command_line(tmp_path):
    """A part that fits the panel only turned by 90° is turned; the job opens in the independent reader."""
    own(tmp_path, ".goo")
    write_stl(tmp_path / "part.stl", box([0, 0, 0], [5, 9, 1]))
    code, _, error = run_layerfix("fix", "part.stl", "part.goo", "-p", "own-goo-plain.toml", cwd=tmp_path)
    assert code == 0, error
    job = read_goo(tmp_path / "part.goo")
    assert len(job.layers) == 10
    assert all((image > 0).sum() == 180 * 100 for image in job.layers)


WITH_LIFTS = (
    OWN + "bottom_lift_mm = 9.0\nbottom_lift_mm_min = 40.0\nbottom_light_pwm = 255\nlight_off_s = 1.5\n"
    "first_layer_mm = 0.25\n"
)


def other_first_layer(tmp_path, suffix: str) -> tuple[LayerStack, lf.Printer]:
    """Ten layers, the first 0.25 mm high and the others 0.1 mm, and a printer that lifts bottom layers otherwise."""
    (tmp_path / "own.toml").write_text(WITH_LIFTS.format(suffix=suffix, mirror=""))
    images = np.ones((10, 120, 200), bool)
    return (
        LayerStack.from_images(images, pixel_mm=0.05, layer_mm=0.1, first_layer_mm=0.25),
        lf.load_printer(tmp_path / "own.toml"),
    )


def test_every_goo_layer_has_its_own_exposure_and_lift(tmp_path):
    """Three bottom layers of 30 s, four of transition in equal steps, then 2.5 s; lift, speed and light of the bottom
    for the three bottom layers alone; z is each layer's top.
    """
    stack, printer = other_first_layer(tmp_path, ".goo")
    lf.write(tmp_path / "part.goo", stack, printer)
    job = read_goo(tmp_path / "part.goo")
    layers = [struct.unpack(">H15fH2s", definition) for definition in job.definitions]
    exposure_s = [30, 30, 30, 24.5, 19, 13.5, 8, 2.5, 2.5, 2.5]
    assert [layer[3] for layer in layers] == pytest.approx(exposure_s)
    assert [layer[2] for layer in layers] == pytest.approx([0.25 + 0.1 * i for i in range(10)])
    for index, layer in enumerate(layers):
        lift, speed, light = (9, 40, 255) if index < 3 else (6, 60, 200)
        # Pauses, light off before and after, lift and speed, second lift, retract and speed, second retract, light.
        assert layer[:2] == (0, 0)
        assert layer[4:] == (1.5, 0, 0, 1.5, lift, speed, 0, 0, lift, 120, 0, 0, light, b"\r\n")
    usual_s, _, *times = job.header[24:34]
    assert (usual_s, times, job.header[34]) == (2.5, [1.5, 0, 0, 1.5, 0, 0, 1.5, 30], 3)
    assert job.header[35:51] == (9, 40, 6, 60, 9, 120, 6, 120, *[0] * 8)
    assert job.header[51:53] == (255, 200)
    seconds = sum(exposure_s) + 10 * (1.5 + 60 * (6 / 60 + 6 / 120))
    assert job.header[54] == pytest.approx(seconds, abs=0.5)
    assert job.header[55] == pytest.approx(stack.volume_mm3())


def test_sl1_says_the_height_of_its_first_layer_and_of_the_others(tmp_path):
    """The firmware counts with layerHeight, that of all layers but the first."""
    stack, printer = other_first_layer(tmp_path, ".sl1s")
    lf.write(tmp_path / "part.sl1s", stack, printer)
    with zipfile.ZipFile(tmp_path / "part.sl1s") as job:
        config, slicer = (ini(job.read(name).decode()) for name in ("config.ini", "prusaslicer.ini"))
    assert config["layerHeight"] == "0.1"
    assert (slicer["initial_layer_height"], slicer["layer_height"]) == ("0.25", "0.1")
    again = lf.read(tmp_path / "part.sl1s")
    assert np.allclose(again.z_mm, stack.z_mm)


@pytest.mark.parametrize(
    ("rgb", "word"),
    [((255, 0, 0), 0xF800), ((0, 255, 0), 0x07E0), ((0, 0, 255), 0x001F), ((255, 255, 255), 0xFFFF),
     ((8, 0, 0), 0x0800), ((0, 4, 0), 0x0020), ((0, 3, 0), 0), ((0, 0, 8), 1),
     ((0, 130, 0), 0x0400), ((236, 140, 52), 0xEC66)],
)  # fmt: skip
def test_colours_of_previews_are_5_6_5_bits(rgb, word):
    """Red in the highest five bits, green in the middle six, blue in the lowest five, the high byte first."""
    assert goo._rgb565(Image.new("RGB", (2, 1), rgb)) == word.to_bytes(2, "big") * 2


@pytest.mark.parametrize("suffix", [".goo", ".sl1s"])
def test_layers_that_repeat_are_corrected_each_with_its_own_feature(tmp_path, suffix):
    """A job of equal layers, the first drawn wider; what merged there is told where it is."""
    printer = own(tmp_path, suffix)
    image = np.zeros((120, 200), bool)
    image[60, 40:160] = image[70, 40:160] = True
    job = tmp_path / f"job{suffix}"
    lf.write(job, LayerStack.from_images([image] * 4, pixel_mm=0.05, layer_mm=0.1), printer)
    assert lf.read(job).repeats.tolist() == [False, True, True, True]
    wide = ("--first-layer-min-feature", "0.8mm")
    run = run_layerfix("fix", job, tmp_path / f"fixed{suffix}", "--min-feature", "0.3mm", *wide, "--json")
    assert [layer.count_px() > 3000 for layer in lf.read(tmp_path / f"fixed{suffix}")] == [True, False, False, False]
    (merged,) = json.loads(run.out)["topology"]
    assert (merged["kind"], merged["z_mm"]) == ("merged", [0, 0.1])
    run = run_layerfix("fix", job, tmp_path / f"other{suffix}", "--min-feature", "0.8mm", "--json")
    merged = json.loads(run.out)["topology"]
    assert np.allclose([change["z_mm"] for change in merged], np.add.outer(np.arange(4) * 0.1, [0, 0.1]))
