"""The verdict before printing: what would be lost, where, and how the command ends."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from scipy import ndimage

from layerfix import LayerStack, correct, load_mesh
from layerfix.commands.check import Verdict
from layerfix.layers.verdict import LayerVerdict, Place, judge, narrowest_place
from tests import slow_metric
from tests.making import box, chosen_faces, joined, run_layerfix, save_stl, turned, write_stl
from tests.pictures_as_text import block, framed, images, round_dot

ALL_AROUND = np.ones((3, 3))
DOCS = Path(__file__).parents[1] / "docs" / "check.md"


def stack_of(*layers: np.ndarray) -> LayerStack:
    return LayerStack.from_images(layers, pixel_mm=1.0, layer_mm=0.5)


def test_a_block_with_a_fin_and_a_pin():
    """One part whole, a fin on it and a pin beside it: two features, one part lost; a corner is none."""
    image = framed(np.zeros((40, 90), bool), 8)
    image[12:40, 12:40] = True
    image[20:23, 40:70] = True
    image[34, 80] = True
    (one,) = judge(stack_of(image), min_feature_mm=8)
    assert (one.parts, one.features_lost, one.thinnest_mm) == (2, 2, 1)
    (place,) = one.lost
    assert place.area_mm2 == 1
    left, bottom, right, top = place.box_mm
    assert (right - left, top - bottom) == (1, 1)
    fin_mm2 = 30 * 3
    assert fin_mm2 - 12 <= one.lost_mm2 <= fin_mm2 + 1


@settings(max_examples=100)
@given(images())
def test_what_is_lost_is_what_the_opening_misses(image):
    """Parts of S without a pixel of S ∘ F, on anything; and nothing is lost of what was corrected."""
    image = framed(image, 9)
    (one,) = judge(stack_of(image), min_feature_mm=5)
    labels, count = ndimage.label(image, ALL_AROUND)
    kept = set(labels[slow_metric.opening(image, 5, 5)])
    assert one.parts == count
    assert len(one.lost) == count - len(kept - {0})
    assert sum(place.area_mm2 for place in one.lost) == sum(
        (labels == k).sum() for k in range(1, count + 1) if k not in kept
    )
    (after,) = judge(correct(stack_of(image), min_feature_mm=5), min_feature_mm=5)
    assert after.lost == ()
    assert (one.thinnest_mm is None) == (one.features_lost == 0)


def test_islands_begin_on_nothing_and_specks_end_there_too():
    """A post that starts in the air, a speck, a bridge that leans on a neighbour, a first layer."""
    foot = block(20, 20, 20)
    with_post, with_speck = foot.copy(), foot.copy()
    with_post[45:52, 45:52] = True
    with_speck[5, 5] = True
    leaning = foot.copy()
    leaning[19, 40] = True  # beside the foot's corner
    layers = [*judge(stack_of(with_speck, with_post, with_post | with_speck, leaning), min_feature_mm=4)]
    assert [len(one.islands) for one in layers] == [0, 1, 1, 0]
    assert [len(one.alone) for one in layers] == [1, 0, 1, 0]
    (single,) = judge(stack_of(with_speck), min_feature_mm=4)
    assert (single.islands, single.alone) == ((), ())
    (island,) = layers[1].islands
    assert (island.z_mm, island.area_mm2) == ((0.5, 1.0), 49.0)


def test_layers_come_in_order_whatever_the_workers():
    """The same verdicts for 1 and 8 threads."""
    layers = [round_dot(radius, 41) for radius in (1, 9, 3, 2, 14, 5)] * 3
    one, many = ([*judge(stack_of(*layers).with_workers(n), min_feature_mm=6)] for n in (1, 8))
    assert one == many
    assert [layer.z_mm[0] for layer in one] == sorted(layer.z_mm[0] for layer in one)


def test_empty_layers_have_nothing_to_lose():
    """None at all, and one between others: what is above it begins on nothing."""
    layers = [*judge(stack_of(block(9, 9, 9), np.zeros((27, 27), bool), block(9, 9, 9)), min_feature_mm=4)]
    assert [one.parts for one in layers] == [1, 0, 1]
    assert [len(one.islands) for one in layers] == [0, 0, 1]


FIX = ("--pixel", "50um", "--layer", "0.1mm", "--min-feature", "0.4mm")


@pytest.fixture
def part(tmp_path):
    """A plate with a fin of 0.1 mm on it."""
    path = tmp_path / "part.stl"
    save_stl(path, joined(box([0, 0, 0], [6, 4, 0.5]), box([2, 0.5, 0.25], [2.1, 3.5, 2])))
    return path


def test_the_command_says_what_is_lost_and_ends_with_1(part):
    """The sentence, the thinnest place, and an exit code for scripts."""
    run = run_layerfix("check", part, *FIX)
    assert run.code == 1
    assert re.search(
        r"verdict +15 features narrower than 0\.4 mm would be lost, in 15 layers; after correction 0", run.out
    )
    assert re.search(r"thinnest +0\.1 mm \(± 50 µm\) in x \d\.\d+ to \d\.\d+, y .*, z = ", run.out)
    assert run.err == ""


def test_the_command_ends_with_0_where_nothing_is_lost(tmp_path):
    """And says so."""
    path = tmp_path / "thick.stl"
    save_stl(path, box([0, 0, 0], [6, 4, 1]))
    run = run_layerfix("check", path, *FIX)
    assert (run.code, run.err) == (0, "")
    assert "nothing is narrower than 0.4 mm: nothing would be lost" in run.out


def test_what_was_corrected_passes(part, tmp_path):
    """`fix`, then `check` of the images."""
    assert run_layerfix("fix", part, tmp_path / "fixed.zip", *FIX).code == 0
    options = ("--pixel", "50um", "--layer", "0.1mm", "--min-feature", "0.4mm")
    run = run_layerfix("check", tmp_path / "fixed.zip", *options)
    assert run.code == 0, run.out


def test_the_command_ends_with_2_where_it_cannot_read(tmp_path, part):
    """One line, no traceback."""
    path = tmp_path / "broken.stl"
    path.write_bytes(b"solid nothing")
    run = run_layerfix("check", path, *FIX)
    assert run.code == 2
    assert run.out == ""
    assert len(run.err.strip().splitlines()) == 1
    assert run_layerfix("check", part, "--json", "--markdown").code == 2


def test_json_is_what_the_docs_say(part):
    """Every key is in docs/check.md and in the object, on both levels."""
    run = run_layerfix("check", part, *FIX, "--json")
    said = json.loads(run.out)
    assert run.code == 1
    text = DOCS.read_text(encoding="utf-8")
    documented = set(re.findall(r"`(\w+)`", text.partition("| key |")[2]))
    for kind, found in ((Verdict, said), (LayerVerdict, said["by_layer"][-1]), (Place, None)):
        names = {field.name for field in dataclasses.fields(kind)}
        assert names <= documented
        assert found is None or set(found) == names
    assert said["schema_version"] == 1
    assert not said["ok"]
    assert said["features_lost"] == sum(layer["features_lost"] for layer in said["by_layer"]) == 15
    assert len(said["by_layer"]) == said["layers"] == 20


def test_markdown_is_a_table(part, tmp_path):
    """For a pull request, whatever the file is called."""
    odd = tmp_path / "a|b`c.stl"
    odd.write_bytes(part.read_bytes())
    run = run_layerfix("check", odd, *FIX, "--markdown")
    lines = run.out.splitlines()
    assert lines[0] == "### :warning: layerfix check: `a\\|b'c.stl`"
    assert all(line.startswith("|") and line.endswith("|") for line in lines[2:])


@settings(max_examples=60)
@given(images())
def test_what_is_left_is_what_is_found_in_the_corrected_layer(image):
    """In both modes; as printed, nothing."""
    stack = stack_of(framed(image, 9))
    for mode in ("as_printed", "add_only"):
        (one,) = judge(stack, min_feature_mm=5, add_only=mode == "add_only")
        (after,) = judge(correct(stack, min_feature_mm=5, mode=mode), min_feature_mm=5)
        assert one.features_left == after.features_lost
        assert mode == "add_only" or after.features_lost == 0


@pytest.mark.parametrize("gap", [1, 2, 3, 5, 7])
@pytest.mark.parametrize("degrees", [0, 25, 45])
def test_the_narrowest_gap(gap, degrees):
    """A slot through a plate, at any angle: as wide as it is, within a pixel; without it there is none."""
    y, x = np.mgrid[-60:61, -60:61] + 0.2
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    along, across = x * c + y * s, y * c - x * s
    plate = (abs(along) < 30) & (abs(across) < 25)
    slotted = plate & ~((abs(across) < gap / 2) & (along > -20))
    whole, cut = judge(stack_of(plate, slotted), min_feature_mm=9)
    assert whole.thinnest_gap_mm is None
    assert abs(cut.thinnest_gap_mm - gap) <= 1
    place = narrowest_place(stack_of(slotted), 0, min_feature_mm=9, of_void=True)
    left, bottom, right, top = place.box_mm
    assert np.hypot(right - left, top - bottom) > 30


def test_two_parts_and_what_is_between_them():
    """4 px between two blocks; the thinnest wall is elsewhere, and each has its place."""
    image = framed(np.zeros((50, 100), bool), 10)
    image[15:50, 15:50] = image[15:50, 54:90] = True
    image[20:23, 90:105] = True
    stack = stack_of(image)
    (one,) = judge(stack, min_feature_mm=8)
    assert (one.thinnest_mm, one.thinnest_gap_mm) == (3, 4)
    wall, gap = (narrowest_place(stack, 0, min_feature_mm=8, of_void=of_void) for of_void in (False, True))
    assert 85 < wall.box_mm[0] < wall.box_mm[2] < 110
    assert 49 < gap.box_mm[0] < gap.box_mm[2] < 55


def test_what_layers_cannot_see(tmp_path):
    """A plate of 0.3 mm that lies flat is thin along x and y, where it says; a cube is not."""
    plate = write_stl(tmp_path / "plate.stl", joined(box((0, 0, 0), (6, 5, 2)), box((8, 1, 0.5), (12, 4, 0.8))))
    frame = ("--pixel", "0.1mm", "--layer", "0.1mm", "--min-feature", "0.8mm")
    assert run_layerfix("check", plate, *frame).code == 0
    run = run_layerfix("check", plate, *frame, "--axes", "xyz", "--json")
    assert run.code == 1
    across = {one["axis"]: one for one in json.loads(run.out)["across"]}
    for axis, slices in (("x", 40), ("y", 30)):
        assert across[axis]["thinnest_mm"] == pytest.approx(0.3, abs=0.05)
        assert across[axis]["slices"] == pytest.approx(slices, abs=1)
        (x0, x1), (y0, y1), (z0, z1) = across[axis]["thinnest_at_mm"]
        assert x0 >= 7.9 and x1 <= 12.1 and y0 >= 0.9 and y1 <= 4.1 and z0 >= 0.4 and z1 <= 0.9  # noqa: PT018
    text = run_layerfix("check", plate, *frame, "--axes", "xyz").out
    assert "along x" in text
    assert "the thinnest 0.3 mm" in text
    run = run_layerfix("check", plate, *frame, "--axes", "xq")
    assert (run.code, "axes 'xq': z, and x or y or both" in run.err) == (2, True)


def test_fix_sees_along_other_axes_too(tmp_path):
    """A flat plate of 0.3 mm and a flat wall on a post become 0.8 mm high; the cube keeps its facets to the bit; in
    layers nothing is thin afterwards."""
    cube = box((0, 0, 0), (6, 5, 2))
    plate = write_stl(
        tmp_path / "plate.stl", joined(cube, box((8, 1, 0.5), (12, 4, 0.8)), box((1, 1, 2), (1.3, 4, 6)))
    )
    frame = ("--pixel", "0.1mm", "--layer", "0.1mm", "--min-feature", "0.8mm")
    run = run_layerfix("fix", plate, tmp_path / "fixed.stl", *frame, "--axes", "xyz", "--json")
    assert run.code == 0
    notes = json.loads(run.out)["notes"]
    assert any(note.startswith("along x: 1 body added where it was thin") for note in notes), notes
    verdict = json.loads(run_layerfix("check", tmp_path / "fixed.stl", *frame, "--axes", "xyz", "--json").out)
    assert verdict["features_lost"] == 0
    along_x = verdict["across"][0]
    assert (along_x["axis"], along_x["features_lost"]) == ("x", 0)
    before, after = (
        {tuple(sorted(map(tuple, corners))) for corners in mesh.vertices[mesh.faces].tolist()}
        for mesh in map(load_mesh, (plate, tmp_path / "fixed.stl"))
    )
    sides = {face for face in before if all(z <= 2 and x <= 6 for x, _, z in face) and min(f[2] for f in face) < 2}
    assert sides <= after
    for more, said in (
        (("--axes", "xq"), "axes 'xq': z, and x or y or both"),
        (("--axes", "xyz", "--keep-gaps", "0.1mm"), "--axes xyz: does not go with --keep-gaps"),
    ):
        refused = run_layerfix("fix", plate, tmp_path / "no.stl", *frame, *more)
        assert (refused.code, said in refused.err) == (2, True), refused.err


HOW = ("--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.8mm")


def test_a_part_that_is_one_pin_is_lost_and_no_error(tmp_path):
    """All of it would be gone: the verdict, and 1; `fix` makes no dot of it."""
    source = write_stl(tmp_path / "pin.stl", box((0, 0, 0), (0.2, 0.2, 10)))
    done = run_layerfix("check", source, *HOW)
    assert done.code == 1, done.err
    assert "50 features narrower than 0.8 mm would be lost, in 50 layers; after correction 0" in done.out
    done = run_layerfix("fix", source, tmp_path / "x.zip", *HOW)
    assert done.code == 2
    assert "all of it would be one dot" in done.err


def test_open_meshes_and_sheets_are_told(tmp_path):
    """In words as in JSON: gaps that were closed, and what no mid-plane meets."""
    block = box((0, 0, 0), (20, 20, 5))
    source = write_stl(tmp_path / "open.stl", chosen_faces(block, np.arange(12) != 3))
    done = run_layerfix("check", source, *HOW)
    assert "open mesh gaps closed in 25 layers, the longest" in done.out
    said = json.loads(run_layerfix("check", source, *HOW, "--json").out)
    assert said["layers_with_gaps"] == 25
    assert 1 < said["longest_gap_mm"] <= 20
    assert said["by_layer"][0]["gaps"]["count"] >= 1
    assert said["by_layer"][0]["solid_mm2"] == pytest.approx(400)
    sheet = joined(box((0, 0, 0), (5, 5, 2)), box((5, 0, 0.72), (25, 20, 0.86)))  # between planes at 0.7 and 0.9
    done = run_layerfix("check", write_stl(tmp_path / "sheet.stl", sheet), *HOW)
    assert "sheets    thinner than a layer of 0.2 mm in 1 layer, the first at z = " in done.out
    wedge = turned(box((0, 0, 0), (10, 10, 10)), "y", 20)  # feather edges at its corners are no sheets
    done = run_layerfix("check", write_stl(tmp_path / "wedge.stl", wedge), *HOW)
    assert "sheets" not in done.out


def test_heights_that_the_printer_does_not_make_are_told(tmp_path):
    """And a layer that is higher than the part, which becomes as high as it."""
    source = write_stl(tmp_path / "block.stl", box((0, 0, 0), (20, 20, 5)))
    for more, note in (
        (("--layer", "0.6mm"), "layers of 0.6 mm: Original Prusa SL1S SPEED makes 25 µm to 0.1 mm"),
        (("--first-layer", "9mm"), "the part is 5 mm high, and its only layer 9 mm"),
        ((), None),
    ):
        said = json.loads(run_layerfix("check", source, "--printer", "prusa-sl1s", *more, "--json").out)
        assert note in said["notes"] if note else not said["notes"]


def test_a_resin_job_is_not_for_a_nozzle(tmp_path):
    """The pixels are the job's, and the minimum feature of a nozzle is not theirs: that is said."""
    source = write_stl(tmp_path / "block.stl", box((0, 0, 0), (20, 20, 1)))
    job = tmp_path / "job.sl1s"
    assert run_layerfix("fix", source, job, "--printer", "prusa-sl1s").code == 0
    assert "resin printer" not in run_layerfix("check", job, "--printer", "prusa-sl1s").out
    out = run_layerfix("check", job, "--printer", "prusa-mk3s-0.4").out
    assert "this is a job of a resin printer; Original Prusa i3 MK3S+ is none (fdm)" in " ".join(out.split())


def test_what_is_kept_free_lies_in_the_part(tmp_path):
    """A small cube is fine; one beside the part would keep nothing free, without a word."""
    source = write_stl(tmp_path / "part.stl", joined(box((0, 0, 0), (20, 20, 5)), box((9.9, 0, 5), (10.1, 20, 12))))
    near = write_stl(tmp_path / "near.stl", box((10.2, 5, 6), (11.2, 6, 7)))
    far = write_stl(tmp_path / "far.stl", box((95, 95, 1), (100, 100, 6)))
    assert run_layerfix("fix", source, tmp_path / "a.zip", *HOW, "--keep-out", near).code == 0
    done = run_layerfix("fix", source, tmp_path / "b.zip", *HOW, "--keep-out", far)
    assert done.code == 2
    assert "far.stl: lies at x = 95 to 100 mm, and the part's layers at -0.8 to 20.8 mm" in done.err


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--min-overlap", "20%"), "--min-overlap: goes with --z-sampling overlap"),
        (("--min-overlap", "20%", "--z-sampling", "middle"), "--min-overlap: goes with --z-sampling overlap"),
        (("--axes", "xyz", "--grow", "inward"), "--axes xyz: does not go with --grow"),
        (("--axes", "xyz", "--ignore-specks"), "--axes xyz: does not go with --ignore-specks"),
    ],
)
def test_options_that_nothing_takes(tmp_path, more, words):
    source = write_stl(tmp_path / "block.stl", box((0, 0, 0), (8, 8, 2)))
    done = run_layerfix("fix", source, tmp_path / "x.zip", *HOW, *more)
    assert (done.code, words in done.err) == (2, True), done.err


def test_one_report_is_of_one_part(tmp_path):
    """Several parts would write the same page, one after the other."""
    sources = [write_stl(tmp_path / f"{k}.stl", box((0, 0, 0), (8, 8, 2))) for k in range(2)]
    done = run_layerfix("fix", *sources, "--out-dir", tmp_path / "out", "--out-type", "zip", *HOW, "--report",
                        tmp_path / "r.html")  # fmt: skip
    assert (done.code, "--report: is of one part" in done.err) == (2, True), done.err
    assert not (tmp_path / "out").exists()


def test_a_bore_for_a_job_is_placed_by_its_frame(tmp_path):
    """A job does not say where the part's coordinates begin, and that is told."""
    source = write_stl(tmp_path / "block.stl", box((0, 0, 0), (20, 20, 1)))
    bore = write_stl(tmp_path / "bore.stl", box((30, 30, 0), (35, 35, 1)))
    job = tmp_path / "job.sl1s"
    assert run_layerfix("fix", source, job, "--printer", "prusa-sl1s").code == 0
    done = run_layerfix("fix", job, tmp_path / "fixed.sl1s", "--printer", "prusa-sl1s", "--keep-out", bore)
    assert "bore.stl is placed from the frame's lower left corner" in " ".join(done.out.split()), done
