"""SL1, SL1S and M1 jobs: made-up ones and other people's, read, corrected, and read by zipfile and Pillow."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

from layerfix import correct, load_printer, read, write
from layerfix.bits import pack, unpack
from layerfix.errors import InputError
from layerfix.layers.morphology import dilate
from layerfix.stack import Layer, LayerStack
from tests import independent_readers as plain
from tests.making import SHARED, contents, corrected_on_panel
from tests.slow_greys import solid_in

SAMPLES = SHARED / "samples"
FEATURE_MM = 0.3
SIZE = 40, 90
# Layers, image size and pitch by name.
JOBS = {
    "UVtools_demo_file.sl1s": (10, (1620, 2560), 0.05),
    "layer_change.sl1": (32, (1440, 2560), 0.04725),
    "Resin_calibration_linear_object.sl1": (20, (1440, 2560), 0.04725),
    "numbers.sl1": (2, (1440, 2560), 0.04725),
    "numbers.sl1s": (2, (1440, 2560), 0.04725),
    "numbers.m1": (2, (1440, 2560), 0.04725),
    "pyphotonfile_reference.sl1": (10, (1440, 2560), 0.04725),
    "pyphotonfile_reference_AA.sl1": (10, (1440, 2560), 0.04725),
}


class Corrected(NamedTuple):
    """A job, its layers by an independent reader, and a corrected copy of it."""

    source: Path
    target: Path
    before: list[np.ndarray]
    stack: LayerStack


def check(job: Corrected) -> int:
    """Assert what a correction may do to a job, pixel by pixel and byte by byte; how many layers it changed."""
    names, after = plain.sl1_names(job.source), plain.sl1_layers(job.target)
    assert plain.sl1_names(job.target) == names
    old_entries, new_entries = plain.raw_entries(job.source), plain.raw_entries(job.target)
    assert list(old_entries) == list(new_entries)
    assert old_entries.keys() - set(names) - {"config.ini"} == {
        name for name in old_entries if name not in names and old_entries[name] == new_entries[name]
    } - {"config.ini"}
    radius_px = tuple(FEATURE_MM / 2 / pitch for pitch in job.stack.pixel_mm)
    changed, added_px, known = 0, 0.0, {}
    for i, (name, old, new) in enumerate(zip(names, job.before, after, strict=True)):
        key = old.tobytes()
        if key not in known:
            solid = solid_in(old)
            known[key] = solid, corrected_on_panel(solid, radius_px, "add_only")
        solid, expected = known[key]
        added = expected & ~solid
        added_px += added.sum()
        if not added.any():
            assert new_entries[name] == old_entries[name], f"{name} needed nothing"
            continue
        changed += 1
        raised = expected & (old < 128)
        drawn = dilate(pack(raised), raised.shape[1], tuple(2 * r + 2 for r in radius_px))  # F around what it reaches
        rim = unpack(drawn, raised.shape[1])
        assert np.array_equal(new >= 128, expected), f"layer {i}"
        assert (new >= old).all(), f"layer {i} got darker"
        assert np.array_equal(new[~rim], old[~rim]), f"layer {i} changed elsewhere"
        if set(np.unique(old)) <= {0, 255}:
            assert set(np.unique(new)) <= {0, 255}, f"layer {i} has greys now"
    with zipfile.ZipFile(job.source) as old_zip, zipfile.ZipFile(job.target) as new_zip:
        assert new_zip.testzip() is None
        assert new_zip.comment == old_zip.comment
        configs = [archive.read("config.ini").decode() for archive in (old_zip, new_zip)]
    material = [float(plain.ini(text)["usedMaterial"]) for text in configs]
    lines = [[line for line in text.splitlines(True) if not line.startswith("usedMaterial")] for text in configs]
    assert lines[0] == lines[1]
    height_mm = job.stack.z_mm[0, 1]
    per_px = job.stack.pixel_mm[0] * job.stack.pixel_mm[1] * height_mm / 1000
    assert material[1] - material[0] == pytest.approx(added_px * per_px, abs=2e-6)
    return changed


@pytest.fixture(params=JOBS, scope="module")
def sample(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Corrected]:
    """Each of the sound samples and its correction at 0.3 mm."""
    source = SAMPLES / request.param
    if not source.exists():
        pytest.skip("other people's files are not here")
    target = tmp_path_factory.mktemp("corrected") / request.param
    stack = read(source)
    write(target, correct(stack, min_feature_mm=FEATURE_MM, mode="add_only"))
    yield Corrected(source, target, plain.sl1_layers(source), stack)
    target.unlink()


def test_samples_are_read(sample):
    """Number and size of layers, pitch, heights from 0 up, and every pixel that is solid."""
    count, size, pitch = JOBS[sample.source.name]
    assert len(sample.stack) == len(sample.before) == count
    assert (sample.stack.width, sample.stack.height) == size
    assert sample.stack.pixel_mm == pytest.approx((pitch, pitch), abs=1e-6)
    assert sample.stack.z_mm[0, 0] == 0
    for layer, grey in zip(sample.stack, sample.before, strict=True):
        assert np.array_equal(layer.image(), solid_in(grey)[:, ::-1])


def test_corrected_samples(sample):
    """Only what was too thin is different, everything else is the file it was."""
    changed = check(sample)
    if sample.source.name == "layer_change.sl1":
        assert changed == 0
        assert sample.target.read_bytes() == sample.source.read_bytes()


def test_samples_written_without_a_correction_are_copies(sample, tmp_path):
    """Byte for byte."""
    write(tmp_path / sample.source.name, sample.stack)
    assert (tmp_path / sample.source.name).read_bytes() == sample.source.read_bytes()


@pytest.mark.parametrize("name", ["test_corrupted.sl1", "test_nolayer.sl1", "test_truncated.sl1"])
def test_broken_samples(name):
    """RGBA layers, no layers, no zip: an error that names the file."""
    if not (SAMPLES / name).exists():
        pytest.skip("other people's files are not here")
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        read(SAMPLES / name)


def test_a_folder_of_rgba_layers():
    """The layers of a UVJ job, which are RGBA, as a folder of images."""
    folder = SAMPLES / "uv3dp_reference.uvd" / "uvj" / "reference.uvd" / "slice"
    if not folder.exists():
        pytest.skip("other people's files are not here")
    stack = read(folder, pixel_mm=0.04725, layer_mm=0.05)
    assert (len(stack), stack.width, stack.height) == (4, 1440, 2560)
    assert stack[0].count_px() > 0


# --------------------------------------------------------------------------------------------- made-up jobs


def drawn(level: int = 255) -> list[np.ndarray]:
    """Nothing to do, something to do twice, nothing at all, something."""
    thin = plain.thin_bar(*SIZE, level)
    return [plain.block(*SIZE, level), thin, thin, np.zeros(SIZE, np.uint8), plain.thin_bar(*SIZE, level, row=6)]


def corrected_copy(source: Path, mode: str = "add_only") -> Path:
    target = source.with_name("fixed" + source.suffix)
    write(target, correct(read(source), min_feature_mm=FEATURE_MM, mode=mode))
    return target


@pytest.mark.parametrize("suffix", [".sl1", ".sl1s", ".m1"])
@pytest.mark.parametrize("level", [255, 200, 60])
def test_a_corrected_job(tmp_path, suffix, level):
    """The bars become bars of F; the layers without one, and all other entries, keep their bytes."""
    source = plain.write_sl1(tmp_path / f"part{suffix}", drawn(level))
    assert check(Corrected(source, corrected_copy(source), plain.sl1_layers(source), read(source))) == 3


def test_a_faint_stroke_becomes_a_wall(tmp_path):
    """A hairline that is grey all along is a feature: it is made as wide as F, and solid."""
    grey = plain.block(*SIZE)
    grey[5, 20:60] = 70
    source = plain.write_sl1(tmp_path / "part.sl1", [grey])
    job = Corrected(source, corrected_copy(source), plain.sl1_layers(source), read(source))
    assert check(job) == 1
    assert (plain.sl1_layers(job.target)[0][4:7, 25:55] == 255).all()


def test_a_portrait_panel(tmp_path):
    """The image is the panel turned by 90°: the pitches swap."""
    entries = plain.sl1_entries(drawn())
    entries["prusaslicer.ini"] = (
        f"display_width = {SIZE[0] * 0.06}\ndisplay_height = {SIZE[1] * 0.04}\n"
        f"display_pixels_x = {SIZE[0]}\ndisplay_pixels_y = {SIZE[1]}\ninitial_layer_height = 0.1\n"
        "display_orientation = portrait\n"
    ).encode()
    stack = read(plain.write_zip(tmp_path / "part.sl1", entries))
    assert stack.pixel_mm == pytest.approx((0.04, 0.06))
    assert stack.z_mm[:2].ravel() == pytest.approx([0, 0.1, 0.1, 0.15])


def test_images_that_are_no_layers(tmp_path):
    """mask.png and thumbnails do not begin with jobDir; they are left alone, whatever is in them."""
    entries = {"mask.png": b"no image at all", **plain.sl1_entries(drawn())}
    source = plain.write_zip(tmp_path / "part.sl1", entries)
    assert len(read(source)) == 5
    assert plain.raw_entries(corrected_copy(source))["mask.png"] == plain.raw_entries(source)["mask.png"]


@pytest.mark.parametrize("job", ["t", "thumb", "thumbnail"])
def test_a_job_whose_name_begins_like_the_thumbnails_folder(tmp_path, job):
    """thumbnail/thumbnail400x400.png is no layer of the job "t"."""
    assert len(read(plain.write_sl1(tmp_path / "part.sl1", drawn(), job=job))) == 5


def test_the_pitch_comes_from_the_job_the_user_or_the_printer(tmp_path):
    """A job without prusaslicer.ini, of no known panel: given, or the printer's, or an error that says so."""
    entries = plain.sl1_entries(drawn())
    assert read(plain.write_zip(tmp_path / "said.sl1", entries), pixel_mm=0.1).pixel_mm == (0.1, 0.1)
    del entries["prusaslicer.ini"]
    source = plain.write_zip(tmp_path / "part.sl1", entries)
    with pytest.raises(InputError, match=r"part\.sl1: the job does not say its pixel pitch; give --printer"):
        read(source)
    printer = load_printer("elegoo-saturn-3-ultra")
    assert read(source, printer=printer).pixel_mm == printer.pixel_mm
    assert np.allclose(np.diff(read(source, pixel_mm=0.1, layer_mm=0.2).z_mm), 0.2)


def test_what_is_given_over_the_jobs_own_word_is_told(tmp_path):
    """Pitch, layers and the first layer: the job itself stays as it is."""
    source = plain.write_sl1(tmp_path / "part.sl1", drawn())
    own = read(source)
    first_mm, layer_mm = own.heights_mm()[:2]
    assert read(source, pixel_mm=own.pixel_mm, layer_mm=layer_mm, first_layer_mm=first_mm).notes == own.notes == ()
    given = read(source, pixel_mm=0.1, layer_mm=0.2, first_layer_mm=1.0)
    words = [note.replace(" µm", "e-3 mm").split(" of ")[1].split(" mm")[0] for note in given.notes]
    assert [float(word) for word in words] == pytest.approx([own.pixel_mm[0], layer_mm, first_mm])
    assert [note.rpartition("; ")[2] for note in given.notes] == [
        f"counted as {mm} mm, as asked" for mm in ("0.1", "0.2", "1")
    ]


def test_digits_at_the_end_of_a_jobs_name_are_no_numbers_of_layers(tmp_path):
    """part200000.png is the first layer of the job "part2"; a layer that is missing is still told."""
    entries = plain.sl1_entries(drawn(), job="part2")
    assert read(plain.write_zip(tmp_path / "part.sl1", entries)).notes == ()
    del entries["part200002.png"]
    notes = read(plain.write_zip(tmp_path / "gap.sl1", entries)).notes
    assert "between part200001.png and part200003.png" in notes[0]


@pytest.mark.parametrize("value", ["0", "-0.05", "nan", "inf", "thick", ""])
@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("config.ini", "layerHeight"),
        pytest.param(
            "prusaslicer.ini",
            "initial_layer_height",
        ),
    ],
)
def test_heights_that_make_no_sense(tmp_path, name, key, value):
    """An error that names the file, the entry, the key and the value."""
    entries = plain.sl1_entries(drawn())
    entries[name] = entries[name].replace(f"{key} = 0.05".encode(), f"{key} = {value}".encode())
    source = plain.write_zip(tmp_path / "part.sl1", entries)
    with pytest.raises(InputError, match=rf"part\.sl1: {name} says {key} = {value}"):
        read(source)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("usedMaterial = 1.25", 1.25),
        ("usedMaterial=0", 0.0),
        pytest.param(
            "usedMaterial = 1e-1",
            0.1,
        ),
        pytest.param(
            "usedMaterial = 1.2.3",
            None,
        ),
        pytest.param(
            "usedMaterial = .",
            None,
        ),
        ("usedMaterial = ", None),
        ("usedMaterial = much", None),
        ("", None),
    ],
)
def test_used_material(tmp_path, line, expected):
    """Grows by what was added; what is no number is left as it is. The other lines stay, Windows' line ends too."""
    entries = plain.sl1_entries(drawn())
    old = entries["config.ini"].decode().replace("usedMaterial = 1.250000", line).replace("\n", "\r\n").encode()
    entries["config.ini"] = old
    target = corrected_copy(plain.write_zip(tmp_path / "part.sl1", entries))
    with zipfile.ZipFile(target) as archive:
        new = archive.read("config.ini")
    if expected is None:
        assert new == old
        return
    added = sum(
        (corrected_on_panel(g > 0, (3, 3), "add_only").sum() - (g > 0).sum()) * 0.05**3 / 1000 for g in drawn()
    )
    assert float(plain.ini(new.decode())["usedMaterial"]) == pytest.approx(expected + added, abs=1e-6)
    assert new.replace(b" ", b"").split(b"usedMaterial=")[0] == old.replace(b" ", b"").split(b"usedMaterial=")[0]
    assert new.count(b"\r\n") == old.count(b"\r\n")


def test_layers_of_one_bit_stay_so(tmp_path):
    """A 1-bit PNG is read, and written as one."""
    entries = plain.sl1_entries(drawn())
    for name in [n for n in entries if n.startswith("part")]:
        buffer = io.BytesIO()
        Image.fromarray(plain.png_pixels(entries[name]) > 0).save(buffer, "PNG")
        entries[name] = buffer.getvalue()
    source = plain.write_zip(tmp_path / "part.sl1", entries)
    target = corrected_copy(source)
    expected = corrected_on_panel(drawn()[1] > 0, (3, 3), "add_only")
    assert np.array_equal(plain.sl1_layers(target)[1] > 0, expected)
    with zipfile.ZipFile(target) as archive:
        assert archive.read("part00001.png")[24] == 1


def test_as_printed_removes_corners(tmp_path):
    """The other mode: what is solid afterwards is exactly the correction."""
    source = plain.write_sl1(tmp_path / "part.sl1", drawn(200))
    for old, new in zip(drawn(200), plain.sl1_layers(corrected_copy(source, "as_printed")), strict=True):
        assert np.array_equal(new >= 128, corrected_on_panel(old >= 128, (3, 3), "as_printed"))


def test_layers_that_have_forgotten_where_they_come_from(tmp_path):
    """A stack mapped to layers made anew from their rows is written all the same: here, with holes cut into it."""
    stack = read(plain.write_sl1(tmp_path / "part.sl1", drawn(200)))
    hole = np.ones(SIZE, bool)
    hole[24:28, 30:40] = False
    cut = stack.map(lambda layer: Layer(pack(layer.image() & hole), layer.width, layer.z_mm))
    write(tmp_path / "cut.sl1", cut)
    for old, new in zip(drawn(200), plain.sl1_layers(tmp_path / "cut.sl1"), strict=True):
        assert np.array_equal(new >= 128, (old >= 128) & hole[:, ::-1])


@pytest.mark.parametrize("workers", [1, 3])
def test_any_number_of_workers_gives_the_same_bytes(tmp_path, workers):
    """The order in which layers are done is not seen in the file."""
    source = plain.write_sl1(tmp_path / "part.sl1", drawn(200) * 4)
    stack = correct(read(source), min_feature_mm=FEATURE_MM, mode="add_only")
    write(tmp_path / "a.sl1", stack)
    write(tmp_path / "b.sl1", stack.with_workers(workers))
    assert (tmp_path / "a.sl1").read_bytes() == (tmp_path / "b.sl1").read_bytes()


@pytest.mark.parametrize("damage", ["size", "colour", "text", "cut"])
def test_a_layer_with_something_wrong(tmp_path, damage):
    """Another size, RGB, no PNG, cut short: an error that names it; no output, no temporary file."""
    entries = plain.sl1_entries(drawn())
    rgb = io.BytesIO()
    Image.fromarray(drawn()[1]).convert("RGB").save(rgb, "PNG")
    entries["part00002.png"] = {
        "size": plain.png_bytes(drawn()[1][:, 1:]), "colour": rgb.getvalue(), "text": b"layer",
        "cut": entries["part00002.png"][:-30],
    }[damage]  # fmt: skip
    source = plain.write_zip(tmp_path / "part.sl1", entries)
    before = contents(tmp_path)
    with pytest.raises(InputError, match=r"part\.sl1.*part00002\.png"):
        corrected_copy(source)
    assert contents(tmp_path) == before


def test_what_is_amiss_with_the_layers_is_told(tmp_path):
    """An image that is missing, a count that differs, images of other names: the firmware says none of it either."""
    whole = plain.sl1_entries(drawn())
    assert read(plain.write_zip(tmp_path / "whole.sl1", whole)).notes == ()
    names = [name for name in whole if name.endswith(".png") and "/" not in name]
    counted = {**whole, "config.ini": whole["config.ini"] + b"\nnumFast = 3\nnumSlow = 2\n"}
    assert read(plain.write_zip(tmp_path / "counted.sl1", counted)).notes == ()
    holed = {name: data for name, data in counted.items() if name != names[2]}
    notes = read(plain.write_zip(tmp_path / "holed.sl1", holed)).notes
    assert notes[0].startswith(f"numbers are missing between {names[1]} and {names[3]}: ")
    assert notes[1:] == ("the job says that it has 5 layers; there are images of 4",)
    job = names[0][:-9]
    more = {**whole, "other00005.png": whole[names[0]], f"{job}art.png": whole[names[0]]}
    stack = read(plain.write_zip(tmp_path / "more.sl1", more))
    assert len(stack) == 6  # the firmware, too, takes every name that begins so
    assert stack.notes == (
        f"read as layers though their names are unlike the others': {job}art.png",
        f"no layers, since their names do not begin with {job} (jobDir): other00005.png",
    )
