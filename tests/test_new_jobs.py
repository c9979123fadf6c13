"""Jobs made from meshes, and jobs turned into other jobs: what the printer and an independent reader find in them."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np
import pytest
from PIL import Image

import layerfix as lf
from layerfix.errors import OutputError
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
