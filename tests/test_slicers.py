"""Beads read from G-code, what they cover of a part, and real slicers before and after correction."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapely

from layerfix.mesh.triangles import Mesh, save_stl
from tests.making import box, cylinder, inside_out, joined
from tests.slicers.gcode import Bead, bead_width, beads_of
from tests.slicers.metric import measure, outlines
from tests.slicers.models import fins_and_pins, placed
from tests.slicers.programs import MODES, Mode, offset_mm, why_not
from tests.slicers.runs import Part, prepare, run_mode
from tests.slicers.sections import components, layer_planes

FILAMENT_MM2 = math.pi * 1.75**2 / 4
# A bead 0.4 wide and 0.2 high with round sides, 10 mm long: mm of filament.
ROUND_E = 10 * 0.2 * (0.4 - 0.2 * (1 - math.pi / 4)) / FILAMENT_MM2
SUB_NOZZLE_MM = (0.2, 0.3, 0.35)


def read(text: str, *, rectangular: bool = False) -> list[Bead]:
    """The beads of G-code with layers of 0.2 mm."""
    return beads_of(text.splitlines(), height_mm=0.2, rectangular=rectangular)


def test_a_line_covers_a_rectangle_as_wide_as_its_filament_makes_it() -> None:
    (bead,) = read(f"G1 X5 Y3 Z0.2\nG1 X15 E{ROUND_E:.5f}")
    assert bead.width_mm == pytest.approx(0.4, abs=1e-4)
    assert bead.volume_mm3 == pytest.approx(ROUND_E * FILAMENT_MM2, rel=1e-4)
    (outline,) = outlines([bead])
    assert outline.symmetric_difference(shapely.box(5, 2.8, 15, 3.2)).area < 2e-3


def test_cura_counts_a_bead_as_a_rectangle() -> None:
    (bead,) = read(f"G1 X10 Y0 Z0.2 E{10 * 0.2 * 0.4 / FILAMENT_MM2:.5f}", rectangular=True)
    assert bead.width_mm == pytest.approx(0.4, abs=1e-4)
    assert bead_width(0.08, 0.2, rectangular=False) > 0.44


@pytest.mark.parametrize(
    "text",
    [
        "M82\nG92 E100\nG1 X10 E{0}\nG92 E0\nG1 X10 Y5\nG1 X0 E{1}",
        "M83\nG1 X10 E{1}\nG1 X10 Y5\nG1 X0 E{1}",
        "M82\nG1 X10 E{1}\nG1 E-1\nG1 X10 Y5\nG1 E{1}\nG1 X0 E{2}",
    ],
    ids=["absolute with G92", "relative", "absolute with retraction"],
)
def test_absolute_and_relative_filament(text: str) -> None:
    beads = read("G1 Z0.2\n" + text.format(100 + ROUND_E, ROUND_E, 2 * ROUND_E))
    assert [bead.points for bead in beads] == [[(0, 0), (10, 0)], [(10, 5), (0, 5)]]
    assert [bead.width_mm for bead in beads] == pytest.approx([0.4, 0.4])


def test_relative_coordinates_and_a_new_origin() -> None:
    (bead,) = read(f"G1 X5 Z0.2\nG92 X1\nG91\nM83\nG1 X10 E{ROUND_E}")
    assert bead.points == [(1, 0), (11, 0)]
    assert bead.z_mm == 0.2


def test_a_stated_width_counts_and_parts_beads() -> None:
    beads = read("M83\n;WIDTH:0.5\nG1 X10 Z0.2 E1\nG1 X10 Y10 E2\n;WIDTH:0.3\nG1 X0 E1")
    assert [bead.width_mm for bead in beads] == [0.5, 0.3]
    assert beads[0].points == [(0, 0), (10, 0), (10, 10)]
    assert beads[0].volume_mm3 == pytest.approx(3 * FILAMENT_MM2)


def test_a_width_recovered_from_filament_parts_beads_only_where_it_changes() -> None:
    e = ROUND_E
    beads = read(f"M83\nG1 X10 Z0.2 E{e:.5f}\nG1 X20 E{1.02 * e:.5f}\nG1 X30 E{2 * e:.5f}\nG1 X30.02 E{0.02 * e:.5f}")
    assert [len(bead.points) for bead in beads] == [3, 3]


def test_what_is_no_part_of_the_model_is_skipped() -> None:
    kinds = ["Custom", "Skirt/Brim", "SKIRT", "SUPPORT", "Support material", "PRIME-TOWER"]
    text = "M83\nG1 Z0.2\n" + "\n".join(f";TYPE:{kind}\nG1 X{k + 1} E1" for k, kind in enumerate(kinds))
    assert read(text) == []
    assert read("M83\nG1 X10 E1 ; skirt\nG1 X20 E1 ; brim\nG0 X30\nG1 E2 ; unretract") == []
    assert len(read(text + "\n;TYPE:Perimeter\nG1 X20 E1")) == 1


def test_measures_of_hand_laid_beads() -> None:
    first = np.array([shapely.box(0, 0, 10, 0.4), shapely.box(0, 5, 1, 6)])
    beads = [
        Bead(0.2, 0.4, 3.0, [(100.0, 50.2), (105.0, 50.2)]),
        Bead(0.4, 0.2, 1.0, [(100.0, 50.2), (110.0, 50.2)]),
    ]
    found = measure(beads, [first, first[:1], first[:1], first[:0]], layer_mm=0.2, offset_mm=(100.0, 50.0, 0.0))
    assert (found.components, found.dropped, found.layers, found.missing) == (4, 2, 3, 1)
    assert found.coverage_percent == pytest.approx(100 * (2 + 2) / (5 + 4 + 4))
    assert found.narrow_percent == pytest.approx(25.0)
    assert not found.complete


def test_the_largest_beads_need_not_be_the_ones_that_cover() -> None:
    part = np.array([shapely.box(0, 0, 100, 1)])
    wide = [Bead(0.2, 5.0, 1.0, [(x, 3.49), (x + 20.0, 3.49)]) for x in range(0, 80, 4)]
    thin = [Bead(0.2, 0.1, 1.0, [(0.0, 0.5), (100.0, 0.5)])]
    assert measure(wide, [part], layer_mm=0.2).dropped == 1
    assert measure(wide + thin, [part], layer_mm=0.2).dropped == 0


def test_sections_unite_bodies_keep_hollows_and_close_gaps() -> None:
    block, other = box([0, 0, 0], [4, 4, 4]), box([3, 1, 0], [6, 2, 4])
    (united,) = components(joined(block, other), 1.0)
    assert united.area == pytest.approx(18)
    (hollow,) = components(joined(block, inside_out(box([1, 1, 1], [2, 2, 3]))), 2.0)
    assert hollow.area == pytest.approx(15)
    assert len(components(joined(block, inside_out(box([1, 1, 1], [2, 2, 3]))), 4.5)) == 0
    tube = cylinder(2, 4, sides=90)
    open_tube = Mesh(tube.vertices, np.delete(tube.faces, [0, 1], axis=0))  # one strip of its wall
    (whole,) = components(tube, 2.0)
    (closed,) = components(open_tube, 2.0)
    assert closed.area == pytest.approx(whole.area)


def test_planes_lie_in_the_middle_of_the_layers_below_the_top() -> None:
    assert layer_planes(box([0, 0, 0], [1, 1, 0.6]), 0.2) == pytest.approx([0.1, 0.3, 0.5])
    assert layer_planes(box([0, 0, 0], [1, 1, 0.71]), 0.2) == pytest.approx([0.1, 0.3, 0.5, 0.7])
    assert layer_planes(box([0, 0, 0], [1, 1, 0.69]), 0.2) == pytest.approx([0.1, 0.3, 0.5])


@pytest.fixture(scope="module")
def small_part(tmp_path_factory: pytest.TempPathFactory) -> Part:
    """Six features too thin for the nozzle, on a plate, in eight layers; corrected."""
    part = prepare("small", fins_and_pins(SUB_NOZZLE_MM, top_mm=1.6), tmp_path_factory.mktemp("slicers"))
    assert not part.trouble
    return part


every_mode = pytest.mark.parametrize(
    "mode",
    [
        pytest.param(m, id=m.name, marks=pytest.mark.skipif(bool(why_not(m)), reason=why_not(m)))
        for m in MODES.values()
    ],
)


@every_mode
def test_correction_keeps_what_the_slicer_drops(small_part: Part, mode: Mode) -> None:
    before, after = (run_mode(small_part, mode, corrected) for corrected in (False, True))
    assert not before.refused
    assert not after.refused
    assert before.measures.dropped
    assert after.measures.complete
    assert after.measures.coverage_percent > 97


@every_mode
def test_the_offset_holds_for_a_part_that_grew_to_one_side(mode: Mode, tmp_path: Path) -> None:
    drawn = placed(box([0, 0, 0], [12, 9, 1]))
    sections = [components(drawn, z) for z in layer_planes(drawn, 0.2)]
    low, high = drawn.bounds_mm
    for sliced in (
        drawn,
        Mesh(np.where(drawn.vertices == high, high + np.array([5, 3, 0]), drawn.vertices), drawn.faces),
    ):
        file = tmp_path / f"{len(list(tmp_path.iterdir()))}.stl"
        save_stl(file, sliced)
        found = run_mode(Part("block", file, sections), mode, corrected=False).measures
        assert found.complete
        # The wall of a solid block is covered up to the rounding of its corners, wherever it is printed.
        assert found.coverage_percent > 98
    assert offset_mm(mode, sliced)[2] == low[2] == 0
