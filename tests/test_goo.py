"""GOO jobs: made-up files, read, corrected, and read by a reader that is written from the specification."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from layerfix import correct, read, write
from layerfix.errors import InputError
from tests import independent_readers as plain
from tests.making import contents, corrected_on_panel
from tests.slow_greys import solid_in

SIZE = 40, 90
FEATURE_MM = 0.3  # six pixels
FIRST = plain.GOO_HEADER.size  # where the first layer begins
GREY = 1  # the kind of a grey chunk


def drawn(level: int = 255) -> list[np.ndarray]:
    """Nothing to do, something to do twice, nothing at all, something."""
    thin = plain.thin_bar(*SIZE, level)
    return [plain.block(*SIZE, level), thin, thin, np.zeros(SIZE, np.uint8), plain.thin_bar(*SIZE, level, row=6)]


def made(folder: Path, layers: list[np.ndarray], **options: object) -> Path:
    return plain.write_goo(folder / "part.goo", layers, **options)


def corrected_copy(source: Path, mode: str = "add_only") -> Path:
    target = source.with_name("fixed.goo")
    write(target, correct(read(source), min_feature_mm=FEATURE_MM, mode=mode))
    return target


def greys() -> list[np.ndarray]:
    """Noise, a slope with small steps, long runs."""
    rng = np.random.default_rng(5)
    noise = rng.integers(0, 256, SIZE)
    slope = np.abs(np.add.outer(np.arange(SIZE[0]) * 3, np.arange(SIZE[1])) % 510 - 255)
    steps = np.repeat(rng.choice([0, 255, 99], 60), 60).reshape(SIZE)
    return [image.astype(np.uint8) for image in (noise, slope, steps)]


@pytest.mark.parametrize("differences", [False, True])
def test_made_up_files_are_read_exactly(tmp_path, differences):
    """Size, pitch, heights and every grey, with and without difference chunks."""
    path = made(tmp_path, greys(), differences=differences)
    stack = read(path, grey_floor=0)
    assert (stack.width, stack.height) == (SIZE[1], SIZE[0])
    assert stack.pixel_mm == (0.05, 0.05)
    assert np.allclose(stack.z_mm, [[0.05 * i, 0.05 * (i + 1)] for i in range(3)])
    for i, image in enumerate(greys()):
        assert np.array_equal(stack.container.decode(i, stack.container.payload(i)).grey, image)
        assert np.array_equal(stack[i].image(), image[:, ::-1] >= 128)


def test_heights_over_the_files_own(tmp_path):
    """A layer height is taken and told, a first layer alone refused: the table says where every layer is."""
    path = made(tmp_path, drawn())
    assert read(path, first_layer_mm=0.05).notes == ()
    stack = read(path, layer_mm=0.1)
    assert stack.z_mm[-1, 1] == pytest.approx(0.1 * len(drawn()))
    assert stack.notes == ("the file says a part of 0.25 mm; counted as 0.5 mm, as asked",)
    with pytest.raises(InputError, match=r"part\.goo: a first layer of 1 mm"):
        read(path, first_layer_mm=1.0)


@pytest.mark.parametrize("differences", [False, True])
def test_greys_survive_being_written_again(tmp_path, differences):
    """Decoded and encoded without a change: every grey value is the same."""
    container = read(made(tmp_path, greys(), differences=differences)).container
    for i, image in enumerate(greys()):
        payload = container.payload(i)
        decoded = container.decode(i, payload)
        again = container.encode(i, payload, decoded.rows, decoded.grey)
        assert np.array_equal(plain.goo_pixels(again).reshape(SIZE), image)


@pytest.mark.parametrize("level", [255, 200, 60])
def test_a_corrected_file(tmp_path, level):
    """Everything as it was but the runs of changed layers, their sizes and checksums, volume, weight and price."""
    source = made(tmp_path, drawn(level), differences=True)
    before, after = plain.read_goo(source), plain.read_goo(corrected_copy(source))
    amounts = {len(before.header) + place for place in (plain.GOO_VOLUME, plain.GOO_WEIGHT, plain.GOO_PRICE)}
    for place, (old, new) in enumerate(zip(before.header, after.header, strict=True)):
        assert place in amounts or new == old, f"field {place}"
    assert after.definitions == before.definitions
    added_px = 0
    for i, (old, new) in enumerate(zip(before.layers, after.layers, strict=True)):
        solid = solid_in(old)
        expected = corrected_on_panel(solid, (3, 3), "add_only")
        added = expected & ~solid
        added_px += int(added.sum())
        assert np.array_equal(new >= 128, expected), f"layer {i}"
        assert (new >= old).all(), f"layer {i} got darker"
        near = ndimage.binary_dilation(added, np.ones((17, 17)))  # F, wherever it may have been drawn
        assert np.array_equal(new[~near], old[~near])
        if i in (0, 3):
            assert after.data[i] == before.data[i]
    volume = 120 + added_px * 0.05**3
    assert after.header[plain.GOO_VOLUME] == pytest.approx(volume, rel=1e-5)
    assert after.header[plain.GOO_WEIGHT] == pytest.approx(0.5 * volume / 120, rel=1e-5)
    assert after.header[plain.GOO_PRICE] == pytest.approx(0.25 * volume / 120, rel=1e-5)


def test_a_black_and_white_layer_stays_so(tmp_path):
    """No grey comes into a layer that had none."""
    after = plain.read_goo(corrected_copy(made(tmp_path, drawn())))
    assert all(set(np.unique(image)) <= {0, 255} for image in after.layers)


def test_a_job_that_needs_nothing_is_copied(tmp_path):
    """Not one byte differs."""
    source = made(tmp_path, [plain.block(*SIZE, 100)] * 3, differences=True)
    assert corrected_copy(source).read_bytes() == source.read_bytes()


def test_what_is_around_the_layers_is_kept(tmp_path):
    """Bytes between header and layers, and after the ending: the offset in the header counts, the rest is copied."""
    source = made(tmp_path, drawn(), **{f"fm{-plain.GOO_OFFSET}": FIRST + 10})
    data = source.read_bytes()
    source.write_bytes(data[:FIRST] + b"in between" + data[FIRST:] + b"and after")
    target = corrected_copy(source).read_bytes()
    assert target[FIRST : FIRST + 10] == b"in between"
    assert target.endswith(plain.GOO_ENDING + b"and after")


def test_amounts_that_are_not_known_stay_unknown(tmp_path):
    """A job without a volume keeps its weight and price."""
    source = made(tmp_path, drawn(), **{f"fm{-plain.GOO_VOLUME}": 0.0})
    after = plain.read_goo(corrected_copy(source))
    assert after.header[plain.GOO_VOLUME : plain.GOO_OFFSET] == plain.read_goo(source).header[-7:-3]


@pytest.mark.parametrize(
    "volume",
    [
        pytest.param(
            1e-38,
        ),
        1e38,
        float("inf"),
        float("nan"),
    ],
)
def test_absurd_amounts_do_not_stop_the_correction(tmp_path, volume):
    """The layers are what counts; a volume that cannot be scaled is left alone."""
    source = made(tmp_path, drawn(), **{f"fm{-plain.GOO_VOLUME}": volume, f"fm{-plain.GOO_WEIGHT}": 1e10})
    assert len(plain.read_goo(corrected_copy(source)).layers) == 5


def test_as_printed_removes_corners(tmp_path):
    """The other mode: what is solid afterwards is exactly the correction."""
    source = made(tmp_path, drawn(200))
    after = plain.read_goo(corrected_copy(source, "as_printed"))
    for old, new in zip(plain.read_goo(source).layers, after.layers, strict=True):
        assert np.array_equal(new >= 128, corrected_on_panel(old >= 128, (3, 3), "as_printed"))


def test_greys_of_four_bits(tmp_path):
    """The header may say that greys go to 15: then 15 is as light as 255, and the job is refused, or read so."""
    flat = np.zeros(SIZE, np.uint8)
    flat[10:30, 10:80] = 15
    source = made(tmp_path, [flat], chunks=[plain.goo_runs(flat)], **{f"fm{-plain.GOO_8_BIT}": False})
    try:
        image = read(source, grey_floor=0)[0].image()
    except InputError:
        return
    assert np.array_equal(image, flat > 0)


def test_heights_given_win_over_the_files(tmp_path):
    """What the user says comes before what the file says."""
    stack = read(made(tmp_path, drawn()), pixel_mm=0.02, layer_mm=0.1)
    assert stack.pixel_mm == (0.02, 0.02)
    assert np.allclose(stack.z_mm[:, 1] - stack.z_mm[:, 0], 0.1)


def test_pixels_that_are_not_square(tmp_path):
    """19 × 24 µm: the correction is round in millimetres."""
    changes = {f"f{plain.GOO_BED_X}": SIZE[1] * 0.019, f"f{plain.GOO_BED_Y}": SIZE[0] * 0.024}
    source = made(tmp_path, drawn(), **changes)
    assert read(source).pixel_mm == (0.019, 0.024)
    target = tmp_path / "fixed.goo"
    write(target, correct(read(source), min_feature_mm=0.1, mode="add_only"))
    expected = corrected_on_panel(drawn()[1] > 0, (0.05 / 0.019, 0.05 / 0.024), "add_only")
    assert np.array_equal(plain.read_goo(target).layers[1] > 0, expected)


def patched(path: Path, at: int, data: bytes) -> Path:
    whole = bytearray(path.read_bytes())
    whole[at : at + len(data)] = data
    path.write_bytes(whole)
    return path


@pytest.mark.parametrize(
    ("at", "data", "says"),
    [
        (FIRST + 70, b"\x54", "layer 0 does not begin as layers do"),
        (FIRST + 71, b"\x01", "layer 0 is broken: wrong checksum"),
        (FIRST + 66, b"\xff\xff\xff\xff", "layer 0 ends past the end"),
        (FIRST + 66, b"\0\0\0\1", "layer 0 ends past the end"),
        (FIRST + 6, struct.pack(">f", 9.0), "heights do not rise"),
    ],
)
def test_broken_layers_are_named(tmp_path, at, data, says):
    """The file, the layer and what is wrong with it, before anything is decoded."""
    with pytest.raises(InputError, match=rf"part\.goo: .*{says}"):
        read(patched(made(tmp_path, drawn()), at, data))


@pytest.mark.parametrize("length", [SIZE[0] * SIZE[1] - 1, SIZE[0] * SIZE[1] + 1])
def test_every_pixel_must_be_covered(tmp_path, length):
    """Runs one pixel short or long: firmware would print what was in its memory."""
    stack = read(made(tmp_path, drawn()[:1], chunks=[plain.goo_chunk(3, length)]))
    with pytest.raises(InputError, match=rf"layer 0 is broken: its runs cover {length} of 3600 px"):
        stack[0].image()


def test_a_layer_without_any_runs(tmp_path):
    """An error, and nothing is written."""
    source = made(tmp_path, drawn()[:1], chunks=[b"", plain.goo_runs(drawn()[0])])
    before = contents(tmp_path)
    with pytest.raises(InputError, match="layer 0"):
        corrected_copy(source)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("field", "value"),
    [
        (plain.GOO_COUNT, 0), (plain.GOO_COUNT, 2_000_000_000), (plain.GOO_X, 0), (plain.GOO_Y, 0),
        (plain.GOO_BED_X, 0.0), (plain.GOO_BED_Y, float("nan")), (plain.GOO_BED_X, float("inf")),
        (plain.GOO_LAYER_MM, -1.0), (plain.GOO_OFFSET, 4_000_000_000),
    ],
)  # fmt: skip
def test_headers_that_lie(tmp_path, field, value):
    """An error that names the file, for every field that is relied upon."""
    with pytest.raises(InputError, match=r"part\.goo: "):
        read(made(tmp_path, drawn(), **{f"f{field}".replace("-", "m"): value}))


def test_a_panel_of_four_billion_pixels(tmp_path):
    """Refused by its header, before any memory is taken."""
    with pytest.raises(InputError, match="65535 × 65535 px"):
        read(made(tmp_path, drawn(), **{f"f{plain.GOO_X}": 65535, f"f{plain.GOO_Y}": 65535}))
