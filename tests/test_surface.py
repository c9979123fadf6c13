"""The corrected surface: closed whatever the voxels are, back to the same pixels, and the input's own elsewhere."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage
from skimage.measure import marching_cubes

import layerfix as lf
from layerfix import LayerStack
from layerfix.errors import InputError, OutputError
from layerfix.mesh.slicing import slice_like
from layerfix.mesh.triangles import Mesh
from layerfix.samples import SAMPLES
from layerfix.stack import layer_maker
from layerfix.surface import kinds
from layerfix.surface.cubes import cell_table
from layerfix.surface.smooth import smooth_surface
from layerfix.surface.voxels import smoothed, snapped, voxel_surface
from tests.making import box, chosen_faces, cone, joined, run_layerfix, sphere, thin_part, torus, turned, write_stl

F_MM, PIXEL_MM, LAYER_MM = 0.75, 0.05, 0.2  # fifteen pixels: F's middle is a pixel's


def stack_of(volume: np.ndarray, layer_mm: float = 1.0, **more: float) -> LayerStack:
    return LayerStack.from_images(volume, pixel_mm=(1.0, 0.5), layer_mm=layer_mm, **more)


def edges_of(faces: np.ndarray) -> np.ndarray:
    """(3 m,) directed edges as single numbers."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    return pairs[:, 0] << 32 | pairs[:, 1]


def assert_closed(faces: np.ndarray) -> None:
    """Every edge has one triangle on either side, and each vertex one fan of them."""
    edges = edges_of(faces)
    back = edges >> 32 | (edges & 0xFFFFFFFF) << 32
    assert len(np.unique(edges)) == len(edges)
    assert np.array_equal(np.sort(edges), np.sort(back))


def again(mesh: Mesh, stack: LayerStack) -> np.ndarray:
    return np.asarray(slice_like(mesh, stack, hairlines=True, z_sampling="rescue"))


VOLUMES = arrays.arrays(np.bool_, st.tuples(st.integers(1, 4), st.integers(1, 6), st.integers(1, 70)))


@settings(max_examples=60, deadline=None)
@given(VOLUMES.filter(np.any), st.floats(0.3, 3.0))
def test_any_voxels_have_a_closed_surface_that_slices_back(volume, first_mm):
    """Noise, too; first layers of another height; and where the vertices are on their edges does not matter."""
    stack = stack_of(volume, first_layer_mm=first_mm)
    surface = voxel_surface(stack)
    assert_closed(surface.faces)
    rng = np.random.default_rng(0)
    for shares in (surface.shares, np.full(len(surface.shares), 0.01), rng.uniform(0.01, 0.99, len(surface.shares))):
        moved = type(surface)(surface.edges, shares, surface.faces, surface.centres)
        mesh = Mesh(moved.vertices_mm(), surface.faces)
        assert np.array_equal(np.asarray(slice_like(mesh, stack)), volume)
        assert mesh.volume_mm3 > 0


@pytest.mark.parametrize("volume", [np.indices((5, 6, 70)).sum(0) % 2 == 0, np.ones((2, 3, 64), bool)])
def test_a_checkerboard_and_a_full_frame(volume):
    """No two solid voxels of a checkerboard hang together, nor does the surface end at the frame."""
    surface = voxel_surface(stack_of(volume))
    assert_closed(surface.faces)
    shells = trimesh.Trimesh(surface.vertices_mm(), surface.faces, process=False).split(only_watertight=False)
    assert len(shells) == ndimage.label(volume)[1]


@settings(max_examples=25, deadline=None)
@given(VOLUMES.filter(np.any))
def test_it_has_a_vertex_wherever_scikit_image_has_one(volume):
    """On every edge of the grid between solid and void, and no other."""
    surface = voxel_surface(stack_of(volume))
    vertices, *_ = marching_cubes(np.pad(volume, 1).astype(np.float32), 0.5, method="lorensen")
    places = surface.edges[:, 2::-1] + 1.0 + 0.5 * (surface.edges[:, 3:] == [2, 1, 0])
    assert set(map(tuple, places.tolist())) == set(map(tuple, vertices.tolist()))


def test_one_voxel_is_an_octahedron_at_its_place():
    """As high as its layer, as wide as its pixels, seen from above with y to the back."""
    image = np.zeros((3, 4), bool)
    image[2, 1] = True
    stack = stack_of(image[None], layer_mm=0.25)
    surface = voxel_surface(stack)
    x, y, z = surface.vertices_mm().T
    assert (len(surface.faces), x.min(), x.max(), z.min(), z.max()) == (8, 1.0, 2.0, 0.0, 0.25)
    assert (y.min(), y.max()) == (-1.5, -1.0)
    assert Mesh(surface.vertices_mm(), surface.faces).volume_mm3 == pytest.approx(1.0 * 0.5 * 0.25 / 6)


def test_the_table_covers_all_cells():
    """Mirrored signs need as many triangles or, where corners alternate, other ones; no cell needs more than five."""
    table = cell_table()
    assert (table[0, 0], table[255, 0], table[:, 0].max()) == (0, 0, 5)
    for pattern in (1, 2, 4, 128):
        assert (table[pattern, 0], table[255 - pattern, 0]) == (1, 1)


def test_several_exposures_of_a_height_are_one_layer():
    """Their union."""
    images = np.zeros((2, 3, 3), bool)
    images[0, 1, 1] = images[1, 1, 2] = True
    two = stack_of(images)
    z = np.array([[0.0, 1.0], [0.0, 1.0]])
    shared = LayerStack(3, 3, (1.0, 0.5), z, lambda k: two[k].at((0.0, 1.0)))
    one = stack_of(images.any(axis=0)[None])
    assert np.array_equal(voxel_surface(shared).vertices_mm(), voxel_surface(one).vertices_mm())


def test_nothing_solid_is_refused():
    with pytest.raises(InputError, match="every layer is empty, so there is no surface"):
        lf.surface_mesh(stack_of(np.zeros((2, 3, 3), bool)))


def ball(radius_mm: float, pixel_mm: float = 0.1) -> tuple[Mesh, LayerStack]:
    sphere = trimesh.creation.icosphere(4, radius_mm)
    mesh = Mesh(sphere.vertices, sphere.faces)
    return mesh, lf.slice_mesh(mesh, pixel_mm=pixel_mm, layer_mm=pixel_mm)


def test_smoothing_comes_nearer_to_a_ball_and_snapping_lies_on_it():
    """Without a pixel changing."""
    mesh, stack = ball(2.0)
    there = mesh.moved((0, 0, -mesh.bounds_mm[0, 2]))
    raw = voxel_surface(stack)

    def error_px(surface):
        return float(np.sqrt(np.mean((np.linalg.norm(surface.vertices_mm() - (0, 0, 2), axis=1) - 2.0) ** 2)) / 0.1)

    smooth, (snap, on_mesh) = smoothed(raw), snapped(raw, there)
    assert error_px(smooth) < 0.75 * error_px(raw)
    assert on_mesh.mean() > 0.99
    assert np.abs(np.linalg.norm(snap.vertices_mm()[on_mesh] - (0, 0, 2), axis=1) - 2).max() < 0.005
    for surface in (smooth, snap, smoothed(snap, ~on_mesh)):
        back = Mesh(surface.vertices_mm() - (0, 0, 2), surface.faces)  # the stack is on the plate
        assert np.array_equal(again(back, stack), np.asarray(stack))


@pytest.mark.parametrize("name", list(SAMPLES))
def test_the_built_in_models_slice_back_to_the_same_bits(name):
    """Corrected, snapped to the model, simplified without loss: closed, and every pixel is there."""
    mesh = SAMPLES[name].mesh()
    size = max(mesh.size_mm)
    stack = lf.slice_mesh(mesh, pixel_mm=size / 90, layer_mm=size / 60, margin_mm=size / 20)
    fixed = lf.correct(stack, min_feature_mm=size / 18, mode="as_printed")
    found = lf.surface_mesh(fixed)
    assert_closed(found.faces)
    assert np.array_equal(np.asarray(slice_like(Mesh(found.vertices, found.faces), fixed)), np.asarray(fixed))


def slab_with_fin() -> Mesh:
    """A block, and on it a wall of 0.3 mm, turned by 20°, and far from it a cube."""
    fin = box((-0.15, -2, 0.9), (0.15, 2, 3)).transformed(
        [[np.cos(0.35), -np.sin(0.35), 0], [np.sin(0.35), np.cos(0.35), 0], [0, 0, 1]]
    )
    return joined(box((-3, -3, 0), (3, 3, 1)), fin, box((6, -2, 0), (10, 2, 3)))


@pytest.fixture(scope="module")
def corrected() -> LayerStack:
    stack = lf.slice_mesh(slab_with_fin(), pixel_mm=PIXEL_MM, layer_mm=LAYER_MM, margin_mm=F_MM)
    return lf.correct(stack, min_feature_mm=F_MM, mode="add_only")


def test_a_smooth_surface_keeps_the_laws(corrected):
    """Closed; within a pixel of the layers; nothing thin in them; what is far from the fin is the input's."""
    mesh = slab_with_fin()
    found = smooth_surface(corrected, mesh)
    assert (found.closed, found.bodies) == (True, 1)
    assert_closed(found.mesh.faces)
    now, wanted = again(found.mesh, corrected), np.asarray(corrected)
    cross = ndimage.generate_binary_structure(2, 2)[None]
    assert not (now & ~ndimage.binary_dilation(wanted, cross)).any()
    assert not (wanted & ~ndimage.binary_dilation(now, cross)).any()
    for image in now:
        added = lf.correct_image(image, min_feature_px=(F_MM / PIXEL_MM) - 1, mode="add_only") & ~image
        assert not added.any()
    corners = {tuple(np.sort(t, axis=0).round(9).ravel()) for t in found.mesh.vertices[found.mesh.faces]}
    far = [t for t in mesh.vertices[mesh.faces] if t[:, 0].min() > 5]
    assert len(far) == 12
    assert all(tuple(np.sort(t, axis=0).round(9).ravel()) in corners for t in far)
    assert len(trimesh.Trimesh(found.mesh.vertices, found.mesh.faces).split()) == 2


def test_a_sheet_that_no_mid_plane_meets_is_a_layer_high():
    """So that a slicer that cuts mid-planes finds it."""
    mesh = joined(
        box((0, 0, 0), (4, 4, 1)), box((3.5, 0, 0.62), (8, 4, 0.68))
    )  # layers of 0.2: planes at 0.5 and 0.7
    stack = lf.slice_mesh(mesh, pixel_mm=PIXEL_MM, layer_mm=LAYER_MM, margin_mm=F_MM)
    fixed = lf.correct(stack, min_feature_mm=F_MM, mode="add_only")
    assert fixed[3].sheet_px > 0
    found = lf.surface_mesh(fixed, kind="smooth")
    assert_closed(found.faces)
    now = np.asarray(slice_like(Mesh(found.vertices, found.faces), fixed))
    wanted = np.asarray(fixed)
    assert (now[3] ^ wanted[3]).sum() < 0.01 * wanted[3].sum()
    assert wanted[3].sum() > 1.5 * now[0].sum()


def test_nothing_thin_is_the_input_itself():
    """Bit for bit."""
    mesh = box((0, 0, 0), (5, 5, 5))
    fixed = lf.correct(lf.slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2), min_feature_mm=0.8, mode="add_only")
    found = smooth_surface(fixed, mesh)
    assert found.mesh is mesh
    assert found.bodies == 0


def test_an_open_mesh_gets_its_bodies_as_shells(corrected, tmp_path):
    """Said, and what slices it has the same layers."""
    mesh = slab_with_fin()
    torn = Mesh(mesh.vertices, mesh.faces[1:], "torn")
    fixed = lf.correct(
        lf.slice_mesh(torn, pixel_mm=PIXEL_MM, layer_mm=LAYER_MM, margin_mm=F_MM),
        min_feature_mm=F_MM,
        mode="add_only",
    )
    told: list[str] = []
    assert kinds.usual_kind(fixed) == "layers"
    lf.write(tmp_path / "torn.stl", fixed, tell=told.append, surface="smooth")
    assert told == [
        "torn is no closed surface: 1 body was put beside its facets as shells of their own, which slicers unite;"
        " --surface voxels makes one closed surface of all"
    ]
    back = lf.load_mesh(tmp_path / "torn.stl")
    assert len(back.faces) > len(torn.faces)
    assert np.array_equal(back.vertices[back.faces[: len(torn.faces)]], torn.vertices[torn.faces].astype(np.float32))


@pytest.mark.parametrize("given", [{"keep_gaps_mm": 0.1}, {"min_layers": 2}, {"mode": "as_printed"}])
def test_what_is_to_the_pixel_has_no_smooth_surface(given):
    """Refused by name; what is written without being told is the layers."""
    stack = lf.slice_mesh(slab_with_fin(), pixel_mm=0.1, layer_mm=0.5, margin_mm=F_MM)
    fixed = lf.correct(stack, **{"min_feature_mm": F_MM, "mode": "add_only", **given})
    with pytest.raises(InputError, match=r"as_printed|to the pixel"):
        lf.surface_mesh(fixed, kind="smooth")
    assert kinds.usual_kind(fixed) == "layers"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"kind": "round"}, "surface 'round' is not known; choose from layers, voxels, smooth"),
        ({"tolerance_mm": -1.0}, "tolerance -1.0 mm: it must be 0 or more"),
        ({"kind": "layers", "smooth": True}, "smoothing is of the surface of voxels; that of layers is as it is"),
    ],
)
def test_refusals(corrected, wrong, said):
    with pytest.raises(InputError) as problem:
        lf.surface_mesh(corrected, **wrong)
    assert str(problem.value) == said


def test_layers_of_no_mesh_have_no_smooth_surface():
    fixed = lf.correct(stack_of(np.ones((2, 9, 9), bool)), min_feature_mm=3, mode="add_only")
    with pytest.raises(InputError, match="these layers are of none; use the voxels"):
        lf.surface_mesh(fixed, kind="smooth")


@pytest.mark.parametrize("suffix", [".stl", ".3mf", ".obj", ".ply", ".glb"])
def test_every_format_holds_the_surface_at_the_place_of_the_input(tmp_path, suffix):
    """By the command; nothing is thin in what it wrote, by the command again."""
    part = write_stl(tmp_path / "part.stl", thin_part().moved((7.0, -3.0, 2.0)))
    target = tmp_path / f"fixed{suffix}"
    run = run_layerfix("fix", part, target, "-p", "prusa-mk3s-0.4")
    assert (run.code, run.err) == (0, "")
    assert "add_only" in run.out
    was, now = lf.load_mesh(part).bounds_mm, lf.load_mesh(target).bounds_mm
    assert now[0, 2] == pytest.approx(was[0, 2], abs=1e-5)
    assert np.abs(now - was).max() < 0.8
    assert run_layerfix("check", target, "-p", "prusa-mk3s-0.4").code == 0


def hexed(colour: np.ndarray) -> str:
    """RRGGBB."""
    return bytes(colour[:3].tolist()).hex().upper()


def coloured_mm3(path: Path) -> dict[str, list[float]]:
    """Volumes of the bodies in a file by their colour, RRGGBB."""
    found: dict[str, list[float]] = {}
    if path.suffix == ".ply":
        for body in trimesh.load_mesh(path).split(only_watertight=False):
            found.setdefault(hexed(body.visual.vertex_colors[0]), []).append(body.volume)
    elif path.suffix == ".glb":
        for body in trimesh.load_scene(path).dump():
            linear = np.array(body.visual.material.baseColorFactor[:3]) / 255  # glTF's colours are
            colour = hexed(np.rint(255 * (1.055 * linear ** (1 / 2.4) - 0.055)).astype(int))
            colour = min(("D62728", "1F77B4"), key=lambda c: abs(int(c, 16) - int(colour, 16)))  # it keeps 8 bits
            found.setdefault(colour, []).append(body.volume * 1e9)  # glTF is in metres
    else:
        with zipfile.ZipFile(path) as package:
            model = ElementTree.fromstring(package.read("3D/3dmodel.model"))
        space = {"": "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"}
        bases = [base.get("displaycolor", "")[1:] for base in model.findall(".//base", space)]
        for thing in model.findall(".//object", space):
            vertices = [[float(v.get(axis, 0)) for axis in "xyz"] for v in thing.findall(".//vertex", space)]
            faces = [[int(t.get(f"v{k}", 0)) for k in (1, 2, 3)] for t in thing.findall(".//triangle", space)]
            volume = trimesh.Trimesh(vertices, faces, process=False).volume
            found.setdefault(bases[int(thing.get("pindex", 0))], []).append(volume)
    return found


@pytest.mark.parametrize("suffix", [".3mf", ".ply", ".glb"])
def test_only_what_changed_in_two_colours(tmp_path, suffix):
    """Red is what was added, blue what was removed: as much as the summary says."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    target = tmp_path / f"changes{suffix}"
    run = run_layerfix("fix", part, target, "-p", "prusa-mk3s-0.4", "--only-changes", "--tolerance", "1um", "--json")
    assert run.code == 0, run.err
    volumes = {colour: sum(volumes) for colour, volumes in coloured_mm3(target).items()}
    summary = json.loads(run.out)
    red, blue = volumes["D62728"], volumes["1F77B4"]
    assert red == pytest.approx(summary["added_mm3"], rel=0.25)  # the edges of voxels are cut off
    assert 0 < blue < summary["removed_mm3"]


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["x.stl", "--only-changes"], "x.stl: .stl holds no colours"),
        (["x.stl", "--surface", "smooth", "--mode", "as_printed"], "a smooth surface only adds to the mesh"),
        (["x.stl", "--surface", "smooth", "--keep-gaps", "0.2mm"], "to the pixel"),
        (["x.stl", "--surface", "smooth", "--layers", "0:2"], "--surface smooth is of all layers"),
        (["x.zip", "--surface", "voxels"], "--surface goes with"),
        (["x.stl", "--surface", "layers", "--smooth"], "smoothing is of the surface of voxels"),
    ],
)
def test_the_command_refuses(tmp_path, args, said):
    part = write_stl(tmp_path / "part.stl", thin_part())
    run = run_layerfix("fix", part, *args, "-p", "prusa-mk3s-0.4", cwd=tmp_path)
    assert run.code == 2
    assert said in run.err
    assert [path.name for path in tmp_path.iterdir()] == ["part.stl"]


@pytest.mark.parametrize(
    ("args", "named"),
    [
        (["--keep-gaps", "0.2mm"], "--keep-gaps"),
        (["--keep-gaps", "0.2mm", "--min-layers", "2"], "--keep-gaps and --min-layers"),
        (["--layers", "0:2"], "--layers"),
        (["--fill", "even_odd"], "--fill"),
        (["--keep-gaps", "0.2mm", "--surface", "layers"], None),
        ([], None),
    ],
)
def test_a_surface_that_is_another_because_of_an_option_is_told(tmp_path, args, named):
    """Of a closed mesh it would be smooth; what was asked for needs no word."""
    part = write_stl(tmp_path / "part.stl", thin_part())
    run = run_layerfix("fix", part, "x.stl", *args, "-p", "prusa-mk3s-0.4", "--json", cwd=tmp_path)
    notes = [note for note in json.loads(run.out)["notes"] if "the surface is that of the layers" in note]
    assert [note.partition(" the surface")[0] for note in notes] == ([f"because of {named}"] if named else [])


def test_no_note_asks_for_what_is_refused(tmp_path):
    """Bodies that become one because gaps are kept to the pixel: not `--surface smooth`, which is refused then."""
    plate, fin = box((0, 0, 0), (4, 4, 1)), box((1, 0.5, 1), (1.3, 3.5, 3))
    scene = trimesh.Scene({"plate": trimesh.Trimesh(plate.vertices, plate.faces),
                           "fin": trimesh.Trimesh(fin.vertices, fin.faces)})  # fmt: skip
    scene.export(tmp_path / "two.3mf")
    how = ["two.3mf", "x.3mf", "-p", "prusa-mk3s-0.4", "--keep-gaps", "0.2mm", "--json"]
    notes = json.loads(run_layerfix("fix", *how, cwd=tmp_path).out)["notes"]
    assert "two.3mf: its 2 bodies become one surface; only a smooth surface keeps them" in notes
    assert not any("--surface smooth" in note for note in notes)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".glb", ".3mf", ".obj"])
@pytest.mark.parametrize("kind", kinds.KINDS)
def test_a_part_too_far_away_for_32_bits_is_told(tmp_path, suffix, kind):
    """Two kilometres from the origin, and one metre: walls move by an eighth of a millimetre, or not."""
    for far_mm in (2e6, 1e3):
        mesh = box((0, 0, 0), (4, 4, 1)).moved([far_mm, 0, 0])
        fixed = lf.correct(lf.slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2), min_feature_mm=0.4, mode="add_only")
        told: list[str] = []
        lf.write(tmp_path / f"x{suffix}", fixed, surface=kind, tell=told.append, force=True)
        told = [word for word in told if "keeps coordinates" in word]
        if far_mm < 2e6 or suffix in (".3mf", ".obj"):
            assert told == []
        else:
            assert "coordinates of 2e+06 mm to 0.125 mm only; write .3mf or .obj" in told[0]


def test_nothing_changed_is_said(tmp_path):
    fixed = lf.correct(
        lf.slice_mesh(box((0, 0, 0), (5, 5, 2)), pixel_mm=0.1, layer_mm=0.2), min_feature_mm=0.4, mode="add_only"
    )
    with pytest.raises(OutputError, match="nothing was added or removed, so there are no changes to write"):
        lf.write(tmp_path / "x.ply", fixed, only_changes=True)


def test_a_mesh_goes_to_every_format(tmp_path):
    """As it is."""
    mesh = box((1, 2, 3), (4, 6, 8))
    for suffix in (".obj", ".ply", ".glb"):
        target: Path = tmp_path / f"box{suffix}"
        lf.write(target, mesh)
        back = lf.load_mesh(target)
        assert back.bounds_mm == pytest.approx(mesh.bounds_mm)
        assert back.volume_mm3 == pytest.approx(mesh.volume_mm3)


def cone_on_its_tip() -> Mesh:
    return turned(cone(3, 4, sides=90), "x", 180)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize(
    "make",
    [
        lambda: sphere(3, 60, 30),
        cone_on_its_tip,
        lambda: torus(5, 0.15, 120, 24),
        slab_with_fin,
        lambda: cone(3, 4, 90),
    ],
    ids=["ball", "cone on its tip", "wire ring", "slab", "cone"],
)
def test_a_slicer_finds_the_same_layers_in_the_voxels(make, smooth):
    """It begins at the lowest point of the file, and knows of no other plate: number, heights and every pixel."""
    stack = lf.slice_mesh(make(), pixel_mm=0.1, layer_mm=0.2, margin_mm=F_MM)
    fixed = lf.correct(stack, min_feature_mm=F_MM, mode="add_only")
    found = lf.surface_mesh(fixed, smooth=smooth)
    back = Mesh(np.asarray(found.vertices), np.asarray(found.faces))
    anew = lf.slice_mesh(back, pixel_mm=0.1, layer_mm=0.2, margin_mm=F_MM)
    assert np.allclose(anew.z_mm, fixed.z_mm)
    on_plate = back.moved((0.0, 0.0, -float(back.bounds_mm[0, 2])))
    bare = replace(fixed, make=layer_maker([layer.rows for layer in fixed].__getitem__, fixed.width, fixed.z_mm))
    assert np.array_equal(np.asarray(slice_like(on_plate, bare)), np.asarray(fixed))


@pytest.mark.parametrize("axes", [None, "xyz"])
@pytest.mark.parametrize("suffix", [".stl", ".ply", ".3mf"])
def test_files_hold_no_triangle_without_area(tmp_path, suffix, axes):
    """As 32-bit floats, which readers take: the same vertex twice is no edge, and closed without it."""
    source = write_stl(tmp_path / "part.stl", joined(box((0, 0, 0), (20, 20, 5)), box((9.9, 0, 5), (10.1, 20, 12))))
    how = ["--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.8mm"] + (["--axes", axes] if axes else [])
    done = run_layerfix("fix", source, tmp_path / f"fixed{suffix}", *how)
    assert done.code == 0, done.err
    mesh = lf.load_mesh(tmp_path / f"fixed{suffix}")
    corners = mesh.vertices.astype(np.float32)[mesh.faces]
    for k in range(3):
        assert not (corners[:, k] == corners[:, k - 1]).all(axis=1).any()
    assert_closed(mesh.faces)


def test_an_open_mesh_stays_open_and_that_is_said(tmp_path):
    """Also if nothing was thin, so that nothing was added."""
    block = box((0, 0, 0), (20, 20, 5))
    source = write_stl(tmp_path / "open.stl", chosen_faces(block, np.arange(12) != 3))
    how = ["--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.8mm", "--surface", "smooth", "--json"]
    done = run_layerfix("fix", source, tmp_path / "fixed.stl", *how)
    notes = json.loads(done.out)["notes"]
    assert any("no closed surface: it stays open; --surface voxels makes one closed surface" in n for n in notes), (
        notes
    )


def plate_with_holes() -> Mesh:
    """Holes close to an edge and to each other; the rims between them are thin where they are nearest."""
    plate = trimesh.creation.box((12, 8, 1.5))
    for x, y in ((-3, 2.9), (-0.1, 2.85), (2.75, 2.8), (-3, -2.6), (3.1, -2.87)):
        hole = trimesh.creation.cylinder(1.03, 3, sections=48)
        plate = plate.difference(hole.apply_translation((x, y, 0)))
    return Mesh(plate.vertices, plate.faces)


def nearly_thick_walls() -> Mesh:
    """Walls of a little less than F, turned by a little; one leans, and ends within a layer."""
    walls = [box((6 * k, 0, 0), (6 * k + 0.75 - 0.07 * k, 5, 2)) for k in range(3)]
    turn = [[np.cos(0.02), -np.sin(0.02), 0], [np.sin(0.02), np.cos(0.02), 0], [0, 0, 1]]
    leaning = box((0, -8, 0), (0.4, -3, 2.07)).transformed([[1, 0, 0.9], [0, 1, 0], [0, 0, 1]])
    return joined(*(wall.transformed(turn) for wall in walls), leaning)


@pytest.mark.parametrize("pixel_mm", [0.05, 0.1])
@pytest.mark.parametrize("make", [plate_with_holes, nearly_thick_walls, slab_with_fin])
def test_a_smooth_surface_is_within_a_pixel_of_the_layers(make, pixel_mm):
    """At mid-planes, as slicers cut: nothing further out than a pixel, and nothing is missing."""
    mesh = make()
    stack = lf.slice_mesh(mesh, pixel_mm=pixel_mm, layer_mm=LAYER_MM, margin_mm=0.8)
    fixed = lf.correct(stack, min_feature_mm=0.8, mode="add_only")
    found = smooth_surface(fixed, mesh)
    assert found.bodies
    around = np.ones((3, 3), np.bool_)
    for layer, sliced in zip(fixed, slice_like(found.mesh, fixed), strict=True):
        wanted, there = layer.image(), sliced.image()
        assert not (there & ~ndimage.binary_dilation(wanted, around)).any()
        assert not (wanted & ~ndimage.binary_dilation(there, around)).any()
