"""Slicers' projects: parts are corrected where they stand, every other byte stays, and the slicer prints it all."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from layerfix import load_printer
from layerfix.commands.check import check
from layerfix.commands.options import Options, options_of
from layerfix.commands.project import fix_file
from layerfix.errors import InputError
from layerfix.formats.solid.project_3mf import Project, machine_of
from tests.making import box, run_layerfix
from tests.projects import FIN_AT, entries_of, mesh_xml, orca_project, prusa_project, volume_mm3, write_zip
from tests.slicers.gcode import beads_of

PRINTER = load_printer("prusa-mk3s-0.4")
MODEL, CONFIG = "3D/3dmodel.model", "Metadata/Slic3r_PE_model.config"


def options(**given: object) -> Options:
    return options_of(PRINTER, {"layer_mm": 0.2, "force": True, **given})


@pytest.fixture(scope="module")
def prusa(tmp_path_factory) -> tuple[Path, Path, tuple[str, ...]]:
    """(a project as it was, corrected, what was told)."""
    folder = tmp_path_factory.mktemp("prusa")
    project, fixed = prusa_project(folder / "in.3mf"), folder / "fixed.3mf"
    return project, fixed, fix_file(project, fixed, options()).notes


@pytest.fixture(scope="module")
def orca(tmp_path_factory) -> tuple[Path, Path, tuple[str, ...]]:
    folder = tmp_path_factory.mktemp("orca")
    project, fixed = orca_project(folder / "in.3mf"), folder / "fixed.3mf"
    return project, fixed, fix_file(project, fixed, options()).notes


def outside_meshes(model: bytes) -> bytes:
    """A model without what is between vertices and triangles."""
    return re.sub(rb"<vertices>.*?</triangles>", b"...", model, flags=re.S)


def faces_by_part(path: Path) -> dict[str, np.ndarray]:
    """(n, 3, 3) corners of each piece by its name."""
    project = Project(path)
    pieces = {placed.piece.name: placed.piece for one in project.objects for placed in one.parts}
    meshes = {name: project.mesh_of(piece) for name, piece in pieces.items()}
    return {name: vertices[faces] for name, (vertices, faces) in meshes.items()}


# PrusaSlicer's -------------------------------------------------------------------------------------------------


def test_everything_but_the_part_stays_to_the_byte(prusa):
    """All other files, the model outside of the changed mesh, the settings but for the numbers of triangles."""
    project, fixed, _ = prusa
    before, after = entries_of(project), entries_of(fixed)
    assert list(before) == list(after)
    assert {name for name in before if before[name] != after[name]} == {MODEL, CONFIG}
    assert outside_meshes(before[MODEL]) == outside_meshes(after[MODEL])
    numbers = rb'(firstid|lastid)="\d+"'
    assert re.sub(numbers, b"", before[CONFIG]) == re.sub(numbers, b"", after[CONFIG])
    second = before[MODEL].index(b'<object id="2"')
    assert after[MODEL].endswith(before[MODEL][second:])  # the other object needed nothing


def test_the_numbers_name_every_triangle_once(prusa):
    """Volumes follow each other, the modifier and the hole are the boxes that they were."""
    _, fixed, _ = prusa
    config = entries_of(fixed)[CONFIG].decode()
    ranges = [(int(a), int(b)) for a, b in re.findall(r'firstid="(\d+)" lastid="(\d+)"', config)]
    count = entries_of(fixed)[MODEL].split(b"</mesh>")[0].count(b"<triangle ")
    (_, last), modifier, hole, block = ranges
    assert last > 40
    assert modifier == (last + 1, last + 12)
    assert hole == (last + 13, count - 1)
    assert block == (0, 11)


def test_the_thin_fin_is_as_wide_as_the_feature_and_the_rest_is_as_it_was(prusa):
    """Facets of what is wide enough are those of the input, corner by corner; nothing is missing."""
    project, fixed, _ = prusa
    before, after = faces_by_part(project)["fins.stl"], faces_by_part(fixed)["fins.stl"]
    high = after[(after[:, :, 2] > 7.9).all(axis=1)]
    fin = high[(high[:, :, 0] < 8).all(axis=1)]
    assert np.ptp(fin[:, :, 0]) == pytest.approx(0.8, abs=0.06)
    assert fin[:, :, 0].mean() == pytest.approx(sum(FIN_AT) / 2, abs=0.05)
    kept = {triangle.tobytes() for triangle in before[(before[:, :, 0] >= 10).all(axis=1)]}
    rolled = {np.roll(triangle, k, axis=0).tobytes() for triangle in after for k in range(3)}
    assert len(kept & rolled) >= 4
    verdict = check(fixed, options())
    assert verdict.features_lost == 0


def test_painting_stays_where_the_triangle_does_and_is_told_of_where_not(prusa):
    """The modifier's seam stays; of the part's two, the one of the block does."""
    _, fixed, notes = prusa
    model = entries_of(fixed)[MODEL]
    assert model.count(b"custom_seam") == 1
    assert model.count(b"custom_supports") == 1
    assert any(re.search(r"painting .* of 1 triangle that had to change is lost, 1 stayed", note) for note in notes)
    assert any("negative volume" in note and "not corrected" in note for note in notes)


def test_a_project_that_needs_nothing_comes_out_to_the_byte(tmp_path):
    """The file is the same file."""
    project = prusa_project(tmp_path / "in.3mf")
    fix_file(project, tmp_path / "fixed.3mf", options(min_feature_mm=0.15, pixel_mm=(0.05, 0.05)))
    assert (tmp_path / "fixed.3mf").read_bytes() == project.read_bytes()


def test_a_project_of_one_dot_is_refused(tmp_path):
    """Narrower than the minimum feature both ways, as a mesh is: it would be another part."""
    project = prusa_project(tmp_path / "in.3mf")
    with pytest.raises(InputError, match="all of it would be one dot"):
        fix_file(project, tmp_path / "fixed.3mf", options(min_feature_mm=60.0, pixel_mm=(0.5, 0.5)))


def test_a_turned_and_scaled_object_is_corrected_as_it_stands(tmp_path):
    """On its side the fin is a plate of 0.2 mm, one layer: nothing is too thin in a layer. Twice as large, 0.4 mm."""
    turned = prusa_project(tmp_path / "turned.3mf", place="0 0 1 0 1 0 -1 0 0 100 90 20")
    fix_file(turned, tmp_path / "a.3mf", options())
    large = prusa_project(tmp_path / "large.3mf", place="2 0 0 0 2 0 0 0 2 100 60 0")
    fix_file(large, tmp_path / "b.3mf", options())
    after = faces_by_part(tmp_path / "b.3mf")["fins.stl"]
    high = after[(after[:, :, 2] > 7.9).all(axis=1) & (after[:, :, 0] < 8).all(axis=1)]
    assert np.ptp(high[:, :, 0]) == pytest.approx(0.4, abs=0.03)  # 0.8 on the plate
    assert faces_by_part(tmp_path / "a.3mf")["fins.stl"][:, :, 0].max() == pytest.approx(20, abs=1e-6)


# OrcaSlicer's and Bambu Studio's -------------------------------------------------------------------------------


def test_parts_in_files_of_their_own_are_replaced_there(orca):
    """The root and the plate's picture stay; face counts of the changed parts are those of their meshes."""
    project, fixed, notes = orca
    before, after = entries_of(project), entries_of(fixed)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"3D/Objects/object_1.model", "3D/Objects/object_2.model", "Metadata/model_settings.config"}
    for name in changed - {"Metadata/model_settings.config"}:
        assert outside_meshes(before[name]) == outside_meshes(after[name])
    settings = after["Metadata/model_settings.config"].decode()
    counts = dict(re.findall(r'value="(\w+)"/><mesh_stat face_count="(\d+)"', settings))
    assert counts["slow"] == "12"
    assert counts["half"] == "12"
    parts = faces_by_part(fixed)
    assert int(counts["pin"]) == len(parts["pin"]) > 24
    assert int(counts["wide"]) == len(parts["wide"]) > 36
    assert not any("lost" in note for note in notes)


def test_what_is_thin_alone_and_not_together_stays(orca):
    """The half wall leans on the other part; the fin of that part and the pin become as wide as the feature."""
    project, fixed, _ = orca
    before, after = faces_by_part(project), faces_by_part(fixed)
    assert np.array_equal(before["half"], after["half"])
    high = after["wide"][(after["wide"] > [-9, -9, 4.9]).all(axis=(1, 2)) & (after["wide"][:, :, 0] < 7).all(axis=1)]
    assert np.ptp(high[:, :, 0]) == pytest.approx(0.8, abs=0.06)
    tip = after["pin"][(after["pin"][:, :, 2] > 3.9).all(axis=1)]
    assert np.ptp(tip[:, :, 0]) == pytest.approx(0.8, abs=0.1)
    project_after = Project(fixed)
    for one in project_after.objects:
        for placed in one.parts:
            vertices, faces = project_after.mesh_of(placed.piece)
            assert volume_mm3(vertices, faces) > 0


def test_the_printer_of_a_project_is_proposed(orca, prusa, tmp_path):
    """In the error about the missing printer, by the slicer's own settings."""
    assert machine_of(orca[0]) == (["Bambu Lab P1S 0.4 nozzle"], 0.4)
    assert machine_of(prusa[0]) == (["Original Prusa i3 MK3S & MK3S+", "MK3S"], 0.4)
    for project, name in ((orca[0], "bambu-lab-p1s-0.4"), (prusa[0], "prusa-mk3s-0.4")):
        with pytest.raises(InputError, match=f"needs --printer.*--printer {name}$"):
            fix_file(project, tmp_path / "x.3mf", options_of(None, {}))


# refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given",
    [{"tolerance_mm": 0.1}, {"smooth": True}, {"layers": (0, 3)}, {"keep_gaps_mm": 0.1}, {"mode": "as_printed"}],
    ids=lambda given: next(iter(given)),
)
def test_options_of_a_new_mesh_do_not_go_with_a_project(prusa, tmp_path, given):
    """They are named, and what else to do."""
    with pytest.raises(InputError, match=r"slicer's project|only added to"):
        fix_file(prusa[0], tmp_path / "x.3mf", options(**given))
    assert not (tmp_path / "x.3mf").exists()


def test_a_surface_makes_a_mesh_of_a_project_as_before(prusa, tmp_path):
    """--surface asks for the mesh alone."""
    fix_file(prusa[0], tmp_path / "mesh.3mf", options(surface="layers"))
    assert "Metadata/thumbnail.png" not in entries_of(tmp_path / "mesh.3mf")


def test_broken_projects_are_named(prusa, tmp_path):
    """Triangles that are not there, models that are no XML, numbers that are none, documents with entities."""
    entries = entries_of(prusa[0])
    broken = {
        "says triangles 0 to 99": {CONFIG: entries[CONFIG].replace(b'lastid="35"', b'lastid="99"')},
        "is broken": {MODEL: entries[MODEL][:-20]},
        "a number that is none": {MODEL: entries[MODEL].replace(b'x="20"', b'x="wide"', 1)},
        "document type": {MODEL: entries[MODEL].replace(b"<model ", b"<!DOCTYPE a><model ", 1)},
        "a vertex that is not there": {MODEL: entries[MODEL].replace(b'v1="0"', b'v1="9999"', 1)},
    }
    for k, (why, changes) in enumerate(broken.items()):
        path = write_zip(tmp_path / f"{k}.3mf", {**entries, **changes})
        with pytest.raises(InputError, match=why):
            fix_file(path, tmp_path / "x.3mf", options())
    assert not (tmp_path / "x.3mf").exists()


def test_prefixed_elements_stay_prefixed(tmp_path):
    """A model whose core namespace has a prefix."""
    from layerfix.formats.solid.project_model import parsed, written

    element = mesh_xml([box([0, 0, 0], [1, 1, 1])], prefix="m")
    text = f'<m:model xmlns:m="u"><m:resources><m:object id="1">{element}</m:object></m:resources></m:model>'
    model = parsed(text.encode(), "a", "a")
    mesh = model.meshes["1"]
    vertices, faces = mesh.arrays("a")
    between = written(mesh.prefix, [vertices], [faces.astype(np.int64)], {})
    new = model.text[: mesh.start] + between + model.text[mesh.stop :]
    again = parsed(new, "a", "a").meshes["1"].arrays("a")
    assert np.array_equal(again[0], vertices)
    assert np.array_equal(again[1], faces)


# by the real slicer --------------------------------------------------------------------------------------------


def sliced(project: Path) -> str:
    """G-code of PrusaSlicer."""
    target = project.with_suffix(".gcode")
    done = subprocess.run(
        ["prusa-slicer", "--loglevel", "1", "-g", "--dont-arrange", "-o", target, project],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + done.stdout
    return target.read_text(encoding="utf-8")


def outer_walls(gcode: str) -> list[tuple[float, float, float, float]]:
    """(mm/s, z, x, y) at the middle of each outer wall of the fins' object."""
    found, z, speed, kind, at = [], 0.0, 0.0, "", {"X": 0.0, "Y": 0.0}
    for line in gcode.splitlines():
        if line.startswith(";Z:"):
            z = float(line[3:])
        elif line.startswith(";TYPE:"):
            kind = line[6:]
        elif line.startswith("G1 "):
            words = {word[0]: float(word[1:]) for word in line.partition(";")[0].split()[1:]}
            speed = words.get("F", speed)
            to = {axis: words.get(axis, at[axis]) for axis in "XY"}
            if words.get("E", 0) > 0 and to != at and kind in ("External perimeter", "Overhang perimeter"):
                found.append((speed / 60, z, (at["X"] + to["X"]) / 2, (at["Y"] + to["Y"]) / 2))
            at = to
    return found


@pytest.mark.skipif(shutil.which("prusa-slicer") is None, reason="no prusa-slicer here")
def test_prusa_slicer_prints_the_fin_and_keeps_modifier_hole_and_range(tmp_path):
    """A project that went through PrusaSlicer: before, the fin is dropped; after, it is there in every layer, and
    the modifier's speed, the range's and the hole act where they did.
    """
    made, project, fixed = prusa_project(tmp_path / "made.3mf"), tmp_path / "project.3mf", tmp_path / "fixed.3mf"
    subprocess.run(["prusa-slicer", "--loglevel", "1", "--export-3mf", "-o", project, made], check=True, timeout=120,
                   capture_output=True)  # fmt: skip
    settings = {"Metadata/Slic3r_PE.config": entries_of(made)["Metadata/Slic3r_PE.config"]}  # it drops them
    write_zip(project, {**entries_of(project), **settings})
    done = run_layerfix("fix", project, fixed, "-p", "prusa-mk3s-0.4", "--layer", "0.2mm")
    assert done.code == 0, done.err
    walls = {name: outer_walls(sliced(path)) for name, path in (("before", project), ("after", fixed))}
    left, right = 100 + FIN_AT[0] - 0.5, 100 + FIN_AT[1] + 0.5

    def fin(name: str) -> set[float]:
        return {round(z, 2) for _, z, x, y in walls[name] if left < x < right and 92.5 < y < 99.5}

    heights = {round(0.2 * k, 2) for k in range(11, 41)}  # above the plate, to z = 8
    assert not fin("before") & heights
    assert fin("after") >= heights
    for name in ("before", "after"):
        block = [one for one in walls[name] if one[2] > 109 and one[2] < 117]
        slow = {round(z, 2) for speed, z, _, _ in block if round(speed) == 17}
        ranged = {round(z, 2) for speed, z, _, _ in block if round(speed) == 23}
        assert slow == {round(0.2 * k, 2) for k in range(21, 31)}, name
        assert ranged == {round(0.2 * k, 2) for k in range(34, 38)} or len(ranged) >= 4, name
        inner = [one for one in block if 111 < one[2] < 115 and 93 < one[3] < 99 and one[1] > 2.5]
        assert inner, f"{name}: the hole has walls"
    assert beads_of(sliced(fixed).splitlines(), height_mm=0.2)
