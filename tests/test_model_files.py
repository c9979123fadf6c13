"""STL and 3MF of corrected layers: closed bodies that give the layers back, whatever slices them."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import ndimage
from shapely import Point, box, union_all

import layerfix as lf
from layerfix import LayerStack
from layerfix.errors import InputError, OutputError
from tests.beads import drawn, stack_of
from tests.making import box as block
from tests.making import contents, run_layerfix, thin_part, write_stl

SUFFIXES = (".stl", ".3mf")
PRINTER = "prusa-mk3s-0.4"
each_suffix = pytest.mark.parametrize("suffix", SUFFIXES)
EXACT = 1e-9  # mm of tolerance: nothing is simplified


def corrected() -> LayerStack:
    """The thin part, first layer 0.2 mm, then 0.15 mm."""
    sliced = lf.slice_mesh(thin_part(), pixel_mm=0.05, layer_mm=0.15, first_layer_mm=0.2, margin_mm=0.8)
    return lf.correct(sliced, min_feature_mm=0.8, mode="as_printed")


@pytest.fixture(scope="module")
def stack() -> LayerStack:
    return corrected()


def curved() -> LayerStack:
    """Layers that all differ, with a hole, an island in it, and parts that touch at a corner."""
    return stack_of(*[
        drawn((16, 14), union_all([Point(6, 6).buffer(4 + 0.1 * k) - Point(6, 6).buffer(2), Point(6, 6).buffer(0.6),
                                   box(11, 11, 12, 12), box(12, 12, 13, 13)])) for k in range(6)])  # fmt: skip


def bodies(path: Path) -> list[trimesh.Trimesh]:
    """The separate bodies of a file, equal corners merged. A slab is where z does not go on."""
    mesh = trimesh.load(path, force="mesh")
    mesh.merge_vertices()
    # Slabs touch: faces of one slab lie between its two heights.
    low, high = (mesh.triangles[:, :, 2].min(1), mesh.triangles[:, :, 2].max(1))
    tops = np.unique(high[high > low].round(5))
    found = []
    for top in tops:
        walls = (high > low) & (abs(high - top) < 1e-5)
        bottom = low[walls].min()
        flat = high == low
        down = mesh.face_normals[:, 2] < 0
        mine = walls | (flat & down & (abs(low - bottom) < 1e-5)) | (flat & ~down & (abs(high - top) < 1e-5))
        found.append(mesh.submesh([np.flatnonzero(mine)], append=True))
    return found


def boundary_px(image: np.ndarray) -> int:
    """Pixels on either side of the outline."""
    return int((ndimage.binary_dilation(image) ^ ndimage.binary_erosion(image)).sum())


def sliced_again(path: Path, stack: LayerStack) -> np.ndarray:
    """The file's layers on the pixels of a stack that begins at z = 0."""
    heights = stack.z_mm[:, 1] - stack.z_mm[:, 0]
    again = lf.slice_mesh(lf.load_mesh(path), pixel_mm=stack.pixel_mm[0], layer_mm=float(heights[-1]),
                          first_layer_mm=float(heights[0]), margin_mm=0.5)  # fmt: skip
    assert len(again) == len(stack)
    steps = (np.array(again.origin_mm) - stack.origin_mm) / stack.pixel_mm[0] * [1, -1]
    columns, rows = np.round(steps).astype(int)
    assert steps == pytest.approx([columns, rows], abs=0.52)  # simplified edges may begin between pixels
    found = np.zeros((len(stack), stack.height, stack.width), bool)
    for k, layer in enumerate(again):
        y, x = np.nonzero(layer.image())
        found[k, y + rows, x + columns] = True
    return found


@each_suffix
def test_slabs_are_closed_and_wound_outwards(tmp_path, stack, suffix):
    """Each slab is watertight, its faces all turn the same way, and its volume is above 0."""
    for name, layers in (("thin", stack), ("curved", curved())):
        path = tmp_path / f"{name}{suffix}"
        lf.write(path, layers)
        found = bodies(path)
        assert len(found) > 1
        for body in found:
            assert body.is_watertight
            assert body.is_winding_consistent
            assert body.volume > 0


@each_suffix
@pytest.mark.parametrize("tolerance", [None, EXACT, 0.1])
def test_the_volume_is_the_stacks(tmp_path, stack, suffix, tolerance):
    """To a thousandth, simplified or not."""
    for layers in (stack, curved()):
        path = tmp_path / f"a{suffix}"
        lf.write(path, layers, tolerance_mm=tolerance, force=True)
        assert trimesh.load(path, force="mesh").volume == pytest.approx(layers.volume_mm3(), rel=1e-3)


@each_suffix
def test_place_and_heights_are_kept(tmp_path, stack, suffix):
    """From z = 0 to the top of the last layer, at the part's x and y; every height is a layer's."""
    path = tmp_path / f"a{suffix}"
    lf.write(path, stack)
    mesh = trimesh.load(path, force="mesh")
    shown = np.array([layer.image() for layer in stack]).any(axis=0)
    rows, columns = np.nonzero(shown)
    low = stack.origin_mm + 0.05 * np.array([columns.min(), -rows.max() - 1])
    high = stack.origin_mm + 0.05 * np.array([columns.max() + 1, -rows.min()])
    assert mesh.bounds[0] == pytest.approx([*low, 0], abs=0.026)
    assert mesh.bounds[1] == pytest.approx([*high, stack.z_mm[-1, 1]], abs=0.026)
    zs = np.unique(mesh.vertices[:, 2].round(5))
    assert set(zs.tolist()) <= set(stack.z_mm.ravel().round(5).tolist())
    assert mesh.vertices[:, 2].min() == 0


@each_suffix
def test_exact_outlines_give_the_layers_back(tmp_path, stack, suffix):
    """Sliced again with the same pitch and heights: pixel by pixel what was written."""
    for layers in (stack, curved()):
        path = tmp_path / f"a{suffix}"
        lf.write(path, layers, tolerance_mm=0, force=True)
        again = sliced_again(path, layers)
        expected = np.array([layer.image() for layer in layers])
        assert np.array_equal(again, expected)


@each_suffix
def test_simplified_outlines_give_nearly_the_layers_back(tmp_path, stack, suffix):
    """Only pixels beside the outlines differ, and few of them; no component is lost or joined."""
    for layers in (stack, curved()):
        path = tmp_path / f"a{suffix}"
        lf.write(path, layers, force=True)
        for image, layer in zip(sliced_again(path, layers), layers, strict=True):
            expected = layer.image()
            differing = image ^ expected
            assert differing.sum() < 0.03 * boundary_px(expected)
            outline = ndimage.binary_dilation(expected) ^ ndimage.binary_erosion(expected)
            assert not (differing & ~outline).any()
            eight = np.ones((3, 3))
            assert ndimage.label(image, eight)[1] == ndimage.label(expected, eight)[1]


@each_suffix
def test_equal_layers_make_one_slab(tmp_path, suffix):
    """A block of eight layers is a block of 12 triangles; another layer on it makes another slab."""
    one, two = drawn((12, 12), box(1, 1, 11, 11)), drawn((12, 12), box(3, 3, 9, 9))
    path = tmp_path / f"a{suffix}"
    lf.write(path, stack_of(*[one] * 8))
    assert len(trimesh.load(path, force="mesh").faces) == 12
    lf.write(path, stack_of(*[one] * 4, *[two] * 3, one), force=True)
    mesh = trimesh.load(path, force="mesh")
    assert len(mesh.faces) == 36
    assert np.unique(mesh.vertices[:, 2].round(5)).tolist() == pytest.approx([0, 0.8, 1.4, 1.6])


@each_suffix
def test_layers_that_do_not_touch_stay_apart(tmp_path, suffix):
    """Equal layers with an empty one between are two slabs, and nothing fills the gap."""
    one, empty = drawn((12, 12), box(1, 1, 11, 11)), np.zeros((240, 240), bool)
    path = tmp_path / f"a{suffix}"
    lf.write(path, stack_of(one, one, empty, one))
    mesh = trimesh.load(path, force="mesh")
    assert len(mesh.faces) == 24
    assert mesh.volume == pytest.approx(100 * 0.6, rel=1e-6)
    apart = stack_of(one, one)
    lf.write(path, replace(apart, z_mm=np.array([[0, 0.2], [0.4, 0.6]])), force=True)
    assert trimesh.load(path, force="mesh").volume == pytest.approx(100 * 0.4, rel=1e-6)


@each_suffix
def test_what_is_refused_leaves_nothing(tmp_path, stack, suffix):
    """Nothing to write, something in the way, an error in the middle."""
    path = tmp_path / f"a{suffix}"
    with pytest.raises(OutputError, match="empty"):
        lf.write(path, stack_of(np.zeros((20, 64), bool)))
    make = stack.make

    def broken(index):
        if index == 7:
            raise InputError("layer 7 is broken")
        return make(index)

    with pytest.raises(InputError, match="layer 7"):
        lf.write(path, replace(stack, make=broken))
    assert list(tmp_path.iterdir()) == []
    path.write_text("mine")
    with pytest.raises(OutputError, match="exists"):
        lf.write(path, stack)
    assert contents(tmp_path) == {f"a{suffix}": b"mine"}


@each_suffix
def test_the_command_writes_what_the_library_writes(tmp_path, stack, suffix):
    """`fix` into a mesh: the printer's first layer and height; the same bytes for any number of workers."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    for name, workers in (("one", 1), ("two", 4)):
        run = run_layerfix(
            "fix",
            part,
            tmp_path / f"{name}{suffix}",
            "--printer",
            PRINTER,
            "--workers",
            workers,
            "--surface",
            "layers",
        )
        assert (run.code, run.err) == (0, "")
    assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()
    lf.write(tmp_path / f"three{suffix}", stack)
    assert (tmp_path / f"three{suffix}").read_bytes() == (tmp_path / f"one{suffix}").read_bytes()


@each_suffix
def test_the_fin_is_as_wide_as_the_printer_needs(tmp_path, suffix):
    """0.1 mm in the part, 0.8 mm in the file, on every height."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    run = run_layerfix("fix", part, tmp_path / f"a{suffix}", "--printer", PRINTER, "--tolerance", "0.01mm")
    assert run.code == 0
    mesh = trimesh.load(tmp_path / f"a{suffix}", force="mesh")
    for z in (0.7, 1.2, 1.9):
        section = mesh.section([0, 0, 1], [0, 0, z])
        assert np.ptp(section.vertices[:, 0]) == pytest.approx(0.8, abs=0.06)


def test_a_3mf_is_a_package_with_one_object(tmp_path, stack):
    """Millimetres, one build item, and the parts that every reader looks for."""
    lf.write(tmp_path / "a.3mf", stack)
    with zipfile.ZipFile(tmp_path / "a.3mf") as package:
        assert package.testzip() is None
        assert {"[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"} <= set(package.namelist())
        model = package.read("3D/3dmodel.model").decode()
    assert 'unit="millimeter"' in model
    assert model.count("<object ") == model.count("<item ") == 1


def test_a_block_survives_the_round_trip_of_a_mesh(tmp_path):
    """A part with nothing to correct comes back as it was, but for its corners."""
    part = write_stl(tmp_path / "part.stl", block([3, -5, 0], [13, 5, 2]))
    run = run_layerfix("fix", part, tmp_path / "a.stl", "--printer", PRINTER, "--layer", "0.2mm")
    assert run.code == 0
    mesh = lf.load_mesh(tmp_path / "a.stl")
    assert mesh.bounds_mm == pytest.approx(np.array([[3, -5, 0], [13, 5, 2]], float), abs=0.03)
