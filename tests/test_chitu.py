"""Photon, CBDDLP and CTB jobs, made-up and other people's: read, corrected, and read by an independent reader."""

from __future__ import annotations

import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from layerfix import correct, read, write
from layerfix.errors import InputError, OutputError
from layerfix.formats.jobs import chitu
from tests import independent_readers as plain
from tests.making import SHARED, contents, corrected_on_panel
from tests.slow_greys import solid_in

SAMPLES = SHARED / "samples"
SIZE = 40, 90
FEATURE_MM = 0.3  # six of the made-up pixels
KINDS = {
    "photon": {"suffix": ".photon"},
    "cbddlp with 4 planes": {"suffix": ".cbddlp", "version": 2, "planes": 4},
    "cbddlp with 8 planes": {"suffix": ".cbddlp", "version": 2, "planes": 8},
    "cbddlp with 5 planes": {"suffix": ".cbddlp", "version": 2, "planes": 5},
    "ctb 2": {"suffix": ".ctb", "magic": plain.CTB, "version": 2},
    "ctb 2 with a key": {"suffix": ".ctb", "magic": plain.CTB, "version": 2, "key": 0x1234567},
    "ctb 3": {"suffix": ".ctb", "magic": plain.CTB, "version": 3},
    "ctb 3 with a key": {"suffix": ".ctb", "magic": plain.CTB, "version": 3, "key": 0xFEDCBA98},
    "ctb 4": {"suffix": ".ctb", "magic": plain.CTB_V4, "version": 4},
    "ctb 4 with a key": {"suffix": ".ctb", "magic": plain.CTB_V4, "version": 4, "key": 3},
}
every_kind = pytest.mark.parametrize("kind", KINDS)


def made(folder: Path, kind: str, layers: list[np.ndarray], **more: object) -> Path:
    options = {**KINDS[kind], **more}
    return plain.write_chitu(folder / ("part" + options.pop("suffix")), layers, **options)


def drawn(level: int = 255) -> list[np.ndarray]:
    """Nothing to do, something to do twice, nothing at all, something."""
    thin = plain.thin_bar(*SIZE, level)
    return [plain.block(*SIZE, level), thin, thin, np.zeros(SIZE, np.uint8), plain.thin_bar(*SIZE, level, row=6)]


def corrected_copy(source: Path, mode: str = "add_only", feature_mm: float = FEATURE_MM) -> Path:
    target = source.with_name("fixed" + source.suffix)
    write(target, correct(read(source), min_feature_mm=feature_mm, mode=mode))
    return target


def near(mask: np.ndarray) -> np.ndarray:
    """What F may reach that reaches a mask."""
    return ndimage.binary_dilation(mask, np.ones((17, 17)))


def check_layers(before: plain.ChituJob, after: plain.ChituJob, radius_px: tuple[float, float]) -> int:
    """Assert what a correction may do to every layer; the number of layers it changed."""
    count, changed = len(before.layers), 0
    for i, (old, new) in enumerate(zip(before.layers, after.layers, strict=True)):
        expected = corrected_on_panel(solid_in(old), radius_px, "add_only")
        assert np.array_equal(new >= 128, expected), f"layer {i}"
        added = expected & (old < 128)
        assert (new >= old).all(), f"layer {i} got darker"
        assert np.array_equal(new[~near(added)], old[~near(added)]), f"layer {i}"
        if not added.any():
            for k in range(before.planes):
                assert after.data[i + k * count] == before.data[i + k * count], f"layer {i}"
        changed += added.any()
    return changed


@every_kind
@pytest.mark.parametrize("level", [255, 255 * 3 // 4, 255 // 4])
def test_made_up_files_are_read_exactly(tmp_path, kind, level):
    """Size, pitch, heights and every solid pixel, with and without greys."""
    path = made(tmp_path, kind, drawn(level))
    stack = read(path)
    assert (stack.width, stack.height) == (SIZE[1], SIZE[0])
    assert stack.pixel_mm == (0.05, 0.05)
    assert np.allclose(stack.z_mm[:, 1], 0.05 * np.arange(1, 6))
    for layer, image in zip(stack, plain.read_chitu(path).layers, strict=True):
        assert np.array_equal(layer.image(), solid_in(image)[:, ::-1])


@every_kind
def test_greys_are_read_exactly(tmp_path, kind):
    """What the package decodes is what the independent reader decodes, for any greys."""
    rng = np.random.default_rng(3)
    path = made(tmp_path, kind, [rng.integers(0, 256, (9, 70)).astype(np.uint8) for _ in range(3)])
    stack, job = read(path, grey_floor=0), plain.read_chitu(path)
    for i, image in enumerate(job.layers):
        decoded = stack.container.decode(i, stack.container.payload(i))
        if decoded.grey is not None:
            assert np.array_equal(decoded.grey, image)
        else:
            assert set(np.unique(image)) <= {0, 255}
        assert np.array_equal(stack[i].image(), image[:, ::-1] >= 128)


@every_kind
def test_greys_survive_being_written_again(tmp_path, kind):
    """Decoded and encoded without a change: every grey value is the same, above all not darker."""
    rng = np.random.default_rng(4)
    path = made(tmp_path, kind, [rng.integers(0, 256, (9, 70)).astype(np.uint8) for _ in range(3)])
    container = read(path).container
    for i in range(3):
        payload = container.payload(i)
        decoded = container.decode(i, payload)
        again = container.decode(i, container.encode(i, payload, decoded.rows, decoded.grey))
        assert np.array_equal(again.rows, decoded.rows)
        if decoded.grey is not None:
            assert again.grey is not None
            assert np.array_equal(again.grey, decoded.grey)


@every_kind
@pytest.mark.parametrize("level", [255, 255 * 3 // 4, 255 // 4])
def test_a_corrected_file(tmp_path, kind, level):
    """Header and every layer that needs nothing as they were; the others as they should be, none darker."""
    source = made(tmp_path, kind, drawn(level))
    target = corrected_copy(source)
    before, after = plain.read_chitu(source), plain.read_chitu(target)
    assert after.header == before.header
    assert check_layers(before, after, (3, 3)) == 3
    for old, new in zip(before.entries, after.entries, strict=True):
        assert new[:3] == old[:3]
        assert new[5:] == old[5:]
    assert [layer.rows.tobytes() for layer in read(target)] == [
        layer.rows.tobytes() for layer in correct(read(source), min_feature_mm=FEATURE_MM, mode="add_only")
    ]


@every_kind
def test_no_data_overlap_in_a_corrected_file(tmp_path, kind):
    """Each entry's data lie between the table and the end, apart from all others."""
    target = corrected_copy(made(tmp_path, kind, drawn(150)))
    job = plain.read_chitu(target)
    places = sorted((entry[3], entry[3] + entry[4]) for entry in job.entries)
    assert places[0][0] >= len(job.header) + 36 * len(job.entries)
    assert places[-1][1] <= target.stat().st_size
    assert all(a[1] <= b[0] for a, b in pairwise(places))


@every_kind
def test_a_job_that_needs_nothing_is_copied(tmp_path, kind):
    """Not one byte differs."""
    source = made(tmp_path, kind, [plain.block(*SIZE, 100)] * 3)
    assert corrected_copy(source).read_bytes() == source.read_bytes()


@every_kind
def test_as_printed_removes_corners(tmp_path, kind):
    """The other mode: what is solid afterwards is exactly the correction, and black where it was removed."""
    source = made(tmp_path, kind, drawn())
    after = plain.read_chitu(corrected_copy(source, "as_printed"))
    for old, new in zip(plain.read_chitu(source).layers, after.layers, strict=True):
        expected = corrected_on_panel(old >= 128, (3, 3), "as_printed")
        assert np.array_equal(new >= 128, expected)
        assert not new[(old >= 128) & ~expected].any()


@pytest.mark.parametrize("kind", ["ctb 3", "ctb 3 with a key", "ctb 4", "ctb 4 with a key"])
def test_what_stands_before_the_data_of_a_ctb_3(tmp_path, kind):
    """Since version 3, 84 bytes go before each layer's data: its table entry again, the total size, motion settings.
    Firmware and UVtools look for them at the data's offset less 84."""
    source = made(tmp_path, kind, drawn(150))
    target = corrected_copy(source)
    job, old = plain.read_chitu(target), plain.extensions(source)
    for i, (copy, total, settings) in enumerate(plain.extensions(target)):
        assert settings == old[i][2], f"layer {i}"
        assert copy == job.entries[i], f"layer {i}"
        assert total == 84 + job.entries[i][4], f"layer {i}"


def test_equal_data_that_are_stored_once(tmp_path):
    """Two layers may share a plane's data: one that changes is not written over the other's, though it would fit."""
    dots = np.zeros(SIZE, np.uint8)
    dots[12, 10:80:2] = 255  # corrected, they become one bar: fewer runs than before
    faint = np.where(dots > 0, 127, 0).astype(np.uint8)  # one plane of two: not solid
    source = plain.write_chitu(tmp_path / "part.cbddlp", [faint, dots], version=2, planes=2, shared=True)
    before = plain.read_chitu(source)
    assert before.entries[0][3] == before.entries[1][3]
    target = tmp_path / "fixed.cbddlp"
    write(target, correct(read(source, grey_floor=0), min_feature_mm=0.25, mode="add_only"))
    after = plain.read_chitu(target)
    assert after.entries[1][4] < before.entries[1][4]
    assert np.array_equal(after.layers[0], before.layers[0])
    assert np.array_equal(after.layers[1] >= 128, corrected_on_panel(dots > 0, (2.5, 2.5), "add_only"))


def test_a_layer_that_is_one_pixel_short(tmp_path):
    """Some programs leave the last pixel out: it is dark."""
    path = plain.write_chitu(tmp_path / "part.photon", [np.full(SIZE, 255, np.uint8)])
    data = bytearray(path.read_bytes())
    data[-1] -= 1
    path.write_bytes(data)
    image = read(path)[0].image()
    assert not image[-1, 0]  # the panel is mirrored
    assert image.sum() == image.size - 1


@pytest.mark.parametrize("kind", ["photon", "ctb 2"])
@pytest.mark.parametrize("more", [-200, 200])
def test_layers_that_cover_too_little_or_too_much(tmp_path, kind, more):
    """An error that names the file and the layer, when it is made."""
    layers = [np.full(SIZE, 255, np.uint8)] * 2
    path = made(tmp_path, kind, layers)
    size = SIZE[1] * SIZE[0] + more
    white = plain.photon_runs if kind == "photon" else plain.ctb_runs
    short = white(np.full(size, 255, np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[: 152 + 36 + 12] + struct.pack("<II", len(data), len(short)) + data[208:] + short)
    stack = read(path)
    assert stack[0].image().all()
    with pytest.raises(InputError, match=rf"part.*layer 1 is .*: its runs cover {size} of {SIZE[0] * SIZE[1]} px"):
        stack[1].image()


def test_heights_given_win_over_the_files(tmp_path):
    """What the user says comes before what the file says."""
    path = made(tmp_path, "ctb 2", drawn())
    stack = read(path, pixel_mm=0.02, layer_mm=0.1)
    assert stack.pixel_mm == (0.02, 0.02)
    assert np.allclose(stack.z_mm[:, 1] - stack.z_mm[:, 0], 0.1)


def test_layers_of_several_heights(tmp_path):
    """A CTB says where each layer ends: a layer reaches from the end of the one below to its own."""
    path = made(tmp_path, "ctb 2", drawn())
    data, ends = bytearray(path.read_bytes()), [0.05, 0.1, 0.2, 0.3, 0.35]
    for i, z in enumerate(ends):
        struct.pack_into("<f", data, 152 + 36 * i, z)
    path.write_bytes(data)
    assert np.allclose(read(path).z_mm, np.stack([[0, *ends[:-1]], ends], axis=1), atol=1e-6)


@every_kind
def test_another_threshold(tmp_path, kind):
    """What is solid from 200 on is corrected, and solid from 200 on in the result."""
    source = made(tmp_path, kind, drawn(150))
    target = source.with_name("fixed" + source.suffix)
    write(target, correct(read(source, threshold=200, grey_floor=0), min_feature_mm=FEATURE_MM, mode="add_only"))
    for old, new in zip(plain.read_chitu(source).layers, plain.read_chitu(target).layers, strict=True):
        assert np.array_equal(new >= 200, corrected_on_panel(old >= 200, (3, 3), "add_only"))
        assert (new >= old).all()


@pytest.mark.parametrize("first_z_mm", [0.0, 0.05])
def test_the_table_may_hold_where_layers_begin_or_where_they_end(tmp_path, first_z_mm):
    """Either way the first layer begins at the plate."""
    path = made(tmp_path, "photon", drawn(), first_z_mm=first_z_mm)
    assert np.allclose(read(path).z_mm, [[0.05 * i, 0.05 * (i + 1)] for i in range(5)], atol=1e-6)


def test_a_job_goes_to_images_and_not_to_another_kind_of_job(tmp_path):
    """A CTB can become a folder or a zip of images, and no GOO."""
    stack = read(made(tmp_path, "ctb 2", drawn()))
    write(tmp_path / "layers.zip", stack)
    assert np.array_equal(read(tmp_path / "layers.zip")[1].image(), stack[1].image())
    with pytest.raises(OutputError, match=r"part\.goo: "):
        write(tmp_path / "part.goo", stack)


def test_a_photon_is_no_ctb(tmp_path):
    """A .photon written as .ctb would be a file that CTB printers refuse."""
    stack = read(made(tmp_path, "photon", drawn()))
    with pytest.raises(OutputError):
        write(tmp_path / "part.ctb", stack)


def test_an_output_that_fails_leaves_nothing(tmp_path):
    """The second layer is broken: no output, no temporary file."""
    path = made(tmp_path, "ctb 2", drawn())
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, 152 + 36 + 16, 1)
    path.write_bytes(data)
    before = contents(tmp_path)
    with pytest.raises(InputError, match="layer 1"):
        corrected_copy(path)
    assert contents(tmp_path) == before


# --------------------------------------------------------------------------------------- other people's files


@pytest.mark.parametrize("name", ["Smilie.photon", "newfile.photon", "pyphotonfile_reference.photon"])
def test_sample_files(tmp_path, name):
    """Read as the independent reader reads them; corrected, they open in it and differ only where they should."""
    source = SAMPLES / name
    if not source.exists():
        pytest.skip("other people's files are not here")
    before = plain.read_chitu(source)
    stack = read(source)
    assert (stack.width, stack.height, len(stack)) == (1440, 2560, len(before.layers))
    assert stack.pixel_mm == pytest.approx((0.047, 0.047), abs=5e-4)
    for layer, image in zip(stack, before.layers, strict=True):
        assert np.array_equal(layer.image(), image[:, ::-1] > 0)
    target = tmp_path / name
    write(target, correct(stack, min_feature_mm=0.3, mode="add_only"))
    after = plain.read_chitu(target)
    assert after.header == before.header
    check_layers(before, after, tuple(0.15 / p for p in stack.pixel_mm))
    nothing = tmp_path / ("nothing_" + name)
    write(nothing, stack)
    assert nothing.read_bytes() == source.read_bytes()


def chitu_places(path: Path) -> list[tuple[int, int]]:
    """(offset, size) of each entry's data."""
    return [(entry[3], entry[4]) for entry in plain.read_chitu(path).entries]


@pytest.mark.parametrize("magic", [plain.PHOTON, plain.CTB], ids=["photon", "ctb"])
def test_data_that_only_touch_are_not_shared(tmp_path, magic):
    """Layers' data lie one right after the other: what got smaller is written where it was, and nothing moves.

    Only data that another layer points to as well go elsewhere.
    """
    comb = np.zeros((24, 128), np.uint8)
    comb[4:20, 10:118:4] = 255  # teeth one pixel wide: thick, they close to a block that needs fewer runs
    solid = plain.block(24, 128)
    suffix = "photon" if magic == plain.PHOTON else "ctb"
    source = plain.write_chitu(tmp_path / f"a.{suffix}", [solid, comb, solid, comb, solid], magic=magic, version=2)
    before = chitu_places(source)
    assert all(a[0] + a[1] == b[0] for a, b in pairwise(before))
    target = tmp_path / f"b.{suffix}"
    write(target, correct(read(source), min_feature_mm=0.3, mode="add_only"))
    after = chitu_places(target)
    assert [at for at, _ in after] == [at for at, _ in before]
    assert after[1][1] < before[1][1]
    assert target.stat().st_size == source.stat().st_size
    expected = corrected_on_panel(comb > 0, (3.0, 3.0), "add_only")
    for index, image in enumerate(plain.read_chitu(target).layers):
        assert np.array_equal(image > 0, expected if index % 2 else solid > 0)


def test_data_that_overlap_by_a_byte_are_shared():
    """Touching is not overlapping; equal places, and one inside another, are; chains are followed."""
    assert chitu._shared([(0, 10), (10, 5), (15, 5)]) == set()
    assert chitu._shared([(0, 10), (9, 5), (15, 5)]) == {0, 1}
    assert chitu._shared([(15, 5), (0, 100), (15, 5), (100, 1)]) == {0, 1, 2}
    assert chitu._shared([(0, 0), (0, 0), (0, 5)]) == set()
    assert chitu._shared([]) == set()


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(1, 8)), max_size=12))
def test_shared_data_by_brute_force(places):
    """An entry is shared if any of its bytes is one of another's."""
    taken = [set(range(at, at + size)) for at, size in places]
    expected = {i for i, a in enumerate(taken) for k, b in enumerate(taken) if i != k and a & b}
    assert chitu._shared(places) == expected


@every_kind
def test_several_exposures_of_one_height(tmp_path, kind):
    """They share their bounds; each is corrected; the volume is counted once."""
    layers = [image for image in drawn() for _ in range(2)]
    source = made(tmp_path, kind, layers, exposures=2)
    stack = read(source)
    assert stack.z_mm[::2].tolist() == stack.z_mm[1::2].tolist() == read(made(tmp_path, kind, drawn())).z_mm.tolist()
    source = made(tmp_path, kind, layers, exposures=2)
    fixed = read(corrected_copy(source))
    assert [layer.count_px() for layer in fixed][::2] == [layer.count_px() for layer in fixed][1::2]
    assert stack.volume_mm3() == pytest.approx(sum(layer.count_px() for layer in stack) / 2 * 0.05**3)
