"""What lies over air: directions of bridges, their speed, flow and fan, and what is told of them."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import Point, affinity, box

import layerfix as lf
from layerfix import LayerStack, settings_for
from layerfix.fdm.bridges import over_air
from layerfix.fdm.toolpaths import plan_toolpaths
from tests.beads import NO_SKIRT, drawn, stack_of
from tests.test_gcode import printed, written

MK3S = "prusa-mk3s-0.4"
SIZE = (50, 40)


def a_bridge(angle: float = 0.0, span: float = 22.0, deep: float = 8.0) -> LayerStack:
    """Two pillars, `deep` wide, and a deck from one to the other, turned."""
    middle = Point(25, 20)

    def turned(shape):
        return drawn(SIZE, affinity.rotate(shape, angle, middle))

    deck = box(25 - span / 2 - 4, 20 - deep / 2, 25 + span / 2 + 4, 20 + deep / 2)
    pillars = deck - box(25 - span / 2, 0, 25 + span / 2, 40)
    return stack_of(*[turned(pillars)] * 5, *[turned(deck)] * 5)


def directions(paths) -> tuple[float, float]:
    """(angle from x to y in degrees of the longest pieces of bridges, their length in all)."""
    steps = np.concatenate([np.diff(p.points_mm, axis=0) for p in paths if p.kind == "Bridge infill"])
    long = steps[np.hypot(*steps.T) > 3]
    angles = np.degrees(np.arctan2(long[:, 1], long[:, 0])) % 180
    return float(np.median(angles)), float(np.hypot(*steps.T).sum())


@pytest.mark.parametrize("angle", [0, 15, 40, 90, 120])
def test_a_bridge_is_laid_from_pillar_to_pillar(angle):
    """Within half a step of 5°; on the layer that lies on air and on no other; its ends lie on the pillars."""
    planned = list(plan_toolpaths(a_bridge(angle), NO_SKIRT))
    assert [any(p.kind == "Bridge infill" for p in layer.paths) for layer in planned] == [False] * 5 + [True] + [
        False
    ] * 4
    found, length = directions(planned[5].paths)
    assert min(abs(found - angle), 180 - abs(found - angle)) <= 2.6
    assert length > 22 * 10  # 8 mm less two walls of two beads, at 0.41 mm
    (place,) = planned[5].hanging
    assert (place.kind, place.length_mm) == ("bridge", pytest.approx(22, abs=0.6))
    assert (place.x_mm, place.y_mm) == (pytest.approx(25, abs=0.1), pytest.approx(20, abs=0.1))
    gap = affinity.rotate(box(14, 16, 36, 24), angle, Point(25, 20))
    for path in planned[5].paths:
        if path.kind == "Bridge infill":
            steps = np.diff(path.points_mm, axis=0)
            ends = path.points_mm[1:][np.hypot(*steps.T) > 3]
            assert not shapely.contains_xy(gap, ends).any()


@pytest.mark.parametrize(("wide", "deep", "expected"), [(30, 8, 90), (8, 25, 0)])
def test_over_a_pit_along_the_short_side(wide, deep, expected):
    """All round it is held, so the shorter span is taken."""
    plate = box(2, 2, 48, 38)
    pit = plate - box(25 - wide / 2, 20 - deep / 2, 25 + wide / 2, 20 + deep / 2)
    stack = stack_of(*[drawn(SIZE, pit)] * 4, *[drawn(SIZE, plate)] * 3)
    found, _ = directions(plan_toolpaths(stack, NO_SKIRT)[4].paths)
    assert found == expected


def test_islands_bridges_and_ledges_are_told_apart():
    """With their middle in the stack's own mm, and their size; a short bridge and a short ledge are not told."""
    base = drawn(SIZE, box(2, 2, 10, 38))
    kinds = {
        "island": box(30, 20, 33, 24),
        "ledge": box(10, 10, 16, 30),
        "short ledge": box(10, 10, 11.5, 30),
    }
    found = {}
    for name, more in kinds.items():
        stack = stack_of(base, base, drawn(SIZE, box(2, 2, 10, 38) | more))
        found[name] = over_air(stack[1], stack[2], stack, 0.45).hanging
    (island,) = found["island"]
    assert (island.kind, island.x_mm, island.y_mm) == ("island", pytest.approx(31.5), pytest.approx(22))
    assert island.length_mm == pytest.approx(4)
    (ledge,) = found["ledge"]
    assert (ledge.kind, ledge.length_mm) == ("ledge", pytest.approx(6, abs=0.3))
    assert (ledge.x_mm, ledge.y_mm) == (pytest.approx(13, abs=0.3), pytest.approx(20, abs=0.3))
    assert found["short ledge"] == ()
    assert over_air(*(a_bridge(span=8)[k] for k in (4, 5)), a_bridge(span=8), 0.45).hanging == ()


@pytest.mark.parametrize("degrees", [0, 30, 45, 60])
def test_slopes_are_no_alarm(degrees):
    """A cone that grows outwards by so much: nothing is told, nothing laid as a bridge."""
    step = 0.2 * math.tan(math.radians(degrees))
    stack = stack_of(*[drawn((30, 30), Point(15, 15).buffer(6 + step * k)) for k in range(12)])
    planned = list(plan_toolpaths(stack, NO_SKIRT))
    assert all(layer.hanging == () for layer in planned)
    assert not [p for layer in planned for p in layer.paths if p.kind == "Bridge infill"]


def test_bridges_have_a_speed_a_flow_and_the_full_fan_of_their_own(tmp_path):
    """As the printer's file says; the fan is set back for what comes next."""
    printer = replace(lf.load_printer(MK3S), bridge_mm_s=21.0, bridge_flow=0.8, fan_percent=40.0)
    text = written(tmp_path / "a.gcode", a_bridge(), printer)
    laid = [m for m in printed(text) if m.lays and m.kind == "Bridge infill" and m.length > 3]
    assert laid
    assert {m.mm_min for m in laid} == {21 * 60}
    area = math.pi * 1.75**2 / 4
    for m in laid:
        section = (m.width - m.height) * m.height + math.pi * m.height**2 / 4
        assert m.e_mm * area / m.length == pytest.approx(0.8 * section, rel=0.01)
    lines = text.splitlines()
    fans = [k for k, line in enumerate(lines) if line.startswith(("M106", "M107"))]
    begin = lines.index(";TYPE:Bridge infill")
    before, after = max(k for k in fans if k < begin), min(k for k in fans if k > begin)
    assert [lines[before], lines[after]] == ["M106 S102", "M106 S255"]
    end = next(k for k in range(begin + 1, len(lines)) if lines[k].startswith(";TYPE:"))
    assert after < next(k for k in range(begin, len(lines)) if re.match(r"G1 X.* E", lines[k]))
    assert lines[next(k for k in fans if k > end)] == "M106 S102"


def test_what_hangs_is_told_with_its_place_and_not_at_length(tmp_path):
    """Three places of a kind and how many more; nothing where nothing hangs."""
    islands = shapely.union_all([box(4 + 6 * k, 25, 6 + 6 * k, 27 + k / 4) for k in range(7)])
    base = box(2, 2, 48, 12)
    said: list[str] = []
    stack = stack_of(*[drawn(SIZE, base)] * 3, *[drawn(SIZE, base | islands)] * 3)
    lf.write(tmp_path / "a.gcode", stack, lf.load_printer(MK3S), tell=said.append)
    (line,) = [line for line in said if "mid-air" in line]
    assert line.startswith("7 islands begin in mid-air")
    assert "3.5 mm at z = 0.8, x = 41, y = 26.75 mm" in line
    assert line.endswith("; and 4 more")
    said.clear()
    lf.write(tmp_path / "b.gcode", a_bridge(), lf.load_printer(MK3S), tell=said.append)
    (line,) = [line for line in said if "air" in line]
    assert re.fullmatch(r"1 bridge spans air: 2[12](\.\d)? mm at z = 1\.2, x = 25, y = 20 mm", line)
    said.clear()
    lf.write(tmp_path / "c.gcode", stack_of(*[drawn(SIZE, base)] * 3), lf.load_printer(MK3S), tell=said.append)
    assert not [line for line in said if "air" in line]


def test_above_a_gap_everything_is_in_the_air():
    """Layers that do not touch: the lowest above a gap in z is an island."""
    plate = drawn((20, 20), box(4, 4, 16, 16))
    stack = stack_of(*[plate] * 4)
    z = np.array([[0, 0.2], [0.2, 0.4], [0.8, 1.0], [1.0, 1.2]])
    gap = replace(stack, z_mm=z, make=lambda k: replace(stack.make(k), z_mm=tuple(z[k])))
    planned = list(plan_toolpaths(gap, settings_for(lf.load_printer(MK3S))))
    assert [[place.kind for place in layer.hanging] for layer in planned] == [[], [], ["island"], []]
