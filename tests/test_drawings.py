"""Drawings of layers and widths: as SVG, as PNG to the pixel, and `layerfix draw`."""

from __future__ import annotations

import json
import math
import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageColor

from layerfix import LayerStack
from layerfix.draw.canvas import Drawing
from layerfix.draw.plots import COLOURS, INK, OTHER, draw_paths, draw_widths
from layerfix.errors import OutputError
from layerfix.fdm.beads import EXTERNAL, SOLID, LayerPaths
from layerfix.fdm.beads import Path as BeadPath
from layerfix.layers.widths import suggest_widths
from tests.making import contents, run_layerfix
from tests.pictures_as_text import block

SVG = "{http://www.w3.org/2000/svg}"
RED, BLUE, GREEN = "#d62728", "#1f5fd6", "#3f8f6b"
TRAVEL = "#5aa7ff"
# Two layers: a square of outer wall and a line of infill beside it; then one line of another kind.
GCODE = """
M83
G92 E0
G1 X0 Y-50 Z0.3 F600
G1 X90 Y-50 E12 ; priming line
;LAYER_CHANGE
;Z:0.3
;HEIGHT:0.3
G1 Z0.3
G1 X0 Y0
;TYPE:External perimeter
;WIDTH:0.6
G1 X10 Y0 E0.8
G1 X10 Y10 E0.8
G1 X0 Y10 E0.8
G1 X0 Y0 E0.8
G1 X2 Y5
;TYPE:Solid infill
;WIDTH:1.2
G1 X8 Y5 E1
;LAYER_CHANGE
;Z:0.6
;HEIGHT:0.3
G1 Z0.6
G1 X0 Y0
;TYPE:Bridge <&> infill
;WIDTH:0.5
G1 X10 Y10 E0.5
"""


def colour_at(picture: Image.Image, x: float, y: float) -> tuple[int, ...]:
    """The pixel that holds this point."""
    return picture.getpixel((math.floor(x), math.floor(y)))


def rgb(colour: str) -> tuple[int, ...]:
    """A colour as PNG has it."""
    return ImageColor.getrgb(colour)


def elements(drawing: Drawing, name: str) -> list[ET.Element]:
    """All of one kind in the SVG, in order."""
    return ET.fromstring(drawing.svg().encode()).findall(f"{SVG}{name}")


def points_of(element: ET.Element) -> np.ndarray:
    """(n, 2) of a polygon or polyline."""
    return np.array([pair.split(",") for pair in element.attrib["points"].split()], float)


def something() -> Drawing:
    """A red box, a green triangle, a thick blue line, words."""
    drawing = Drawing(120, 80, "#eeeeee")
    drawing.box(10, 20, 30, 40, RED)
    drawing.area([(60, 70), (110, 70), (110, 40)], GREEN)
    drawing.line(np.array([[50.0, 12.0], [110.0, 12.0]]), 10, BLUE)
    drawing.text(12, 75, "words", 12, INK)
    return drawing


# Drawing


def test_svg_holds_what_was_drawn():
    """Sizes, points, colours, widths and words, in the order they were drawn."""
    root = ET.fromstring(something().svg().encode())
    assert root.tag == f"{SVG}svg"
    assert [root.attrib[k] for k in ("width", "height", "viewBox")] == ["120", "80", "0 0 120 80"]
    background, box, triangle, line, words = root
    assert background.attrib["fill"] == "#eeeeee"
    assert points_of(box).tolist() == [[10, 20], [40, 20], [40, 60], [10, 60]]
    assert (box.attrib["fill"], triangle.attrib["fill"]) == (RED, GREEN)
    assert points_of(line).tolist() == [[50, 12], [110, 12]]
    assert (line.attrib["stroke"], float(line.attrib["stroke-width"]), line.attrib["fill"]) == (BLUE, 10, "none")
    assert (words.text, words.attrib["x"], words.attrib["y"]) == ("words", "12.00", "75.00")


def test_png_has_its_colours_where_they_belong():
    """Inside and just outside every shape; the line has round ends."""
    picture = something().png()
    assert picture.size == (120, 80)
    ground = rgb("#eeeeee")
    for x, y, colour in [
        (12, 22, RED), (38, 58, RED), (7, 40, None), (43, 40, None),
        (105, 60, GREEN), (65, 50, None),
        (80, 12, BLUE), (80, 8, BLUE), (80, 15, BLUE), (80, 5, None), (80, 19, None),
        (47, 12, BLUE), (45, 7, None), (113, 12, BLUE), (118, 12, None),
    ]:  # fmt: skip
        assert colour_at(picture, x, y) == (rgb(colour) if colour else ground), (x, y)
    words = np.asarray(picture)[62:79, 10:60]
    assert (words != ground).any()


def test_later_shapes_cover_earlier_ones():
    """The order of drawing is that of painting, also where a line covers an area."""
    drawing = Drawing(40, 40)
    drawing.box(0, 0, 40, 40, RED)
    drawing.line([(0, 20), (40, 20)], 10, BLUE)
    drawing.box(10, 10, 10, 20, GREEN)
    picture = drawing.png()
    assert [colour_at(picture, x, y) for x, y in ((30, 5), (30, 20), (15, 20))] == [rgb(RED), rgb(BLUE), rgb(GREEN)]


@given(st.text(max_size=30))
def test_any_words_make_a_valid_svg(words):
    """Whatever a file is called: marks of XML come out as they were, what XML has no place for does not break it."""
    drawing = Drawing(100, 50)
    drawing.text(5, 20, f'<a>&amp;{words}"]]>', 12, INK)
    (text,) = elements(drawing, "text")
    assert (text.text or "").startswith("<a>&amp;")
    assert (text.text or "").endswith('"]]>')


def test_anchors_place_words():
    """Left of, round and right of the point."""
    found = {}
    for anchor in ("start", "middle", "end"):
        drawing = Drawing(200, 40)
        drawing.text(100, 30, "mmmm", 20, "#000000", anchor)
        assert elements(drawing, "text")[0].attrib["text-anchor"] == anchor
        dark = np.flatnonzero((np.asarray(drawing.png()) < 128).any(axis=(0, 2)))
        found[anchor] = (dark[0] + dark[-1]) / 2
    assert found["end"] < 95 < found["middle"] < 105 < found["start"]


@pytest.mark.parametrize("suffix", [".png", ".svg", ".PNG"])
def test_files_are_written_by_their_suffix_and_not_replaced(tmp_path, suffix):
    """PNG opens with the same pixels, SVG is the text; an existing file stays without force."""
    path = tmp_path / f"a{suffix}"
    something().save(path, force=False)
    if suffix == ".svg":
        assert path.read_text(encoding="utf-8") == something().svg()
    else:
        assert np.array_equal(np.asarray(Image.open(path)), np.asarray(something().png()))
    path.write_bytes(b"mine")
    with pytest.raises(OutputError, match="exists already; use --force"):
        something().save(path, force=False)
    assert contents(tmp_path) == {path.name: b"mine"}
    something().save(path, force=True)
    assert path.read_bytes() != b"mine"


def test_another_suffix_is_refused(tmp_path):
    """The choices are named; nothing is written."""
    with pytest.raises(OutputError, match=r"a\.pdf: a drawing is written as \.png or \.svg"):
        something().save(tmp_path / "a.pdf", force=True)
    assert contents(tmp_path) == {}


# Beads of a layer


def bead(points: list[tuple[float, float]], width: float | list[float], kind: str) -> BeadPath:
    """A path of one width, or of one for each piece."""
    pieces = len(points) - 1
    return BeadPath(np.array(points, float), np.array(width if isinstance(width, list) else [width] * pieces), kind)


def test_beads_are_drawn_as_wide_as_they_are():
    """One scale for both axes, y upwards, a line as thick as its bead; a thin line where the nozzle goes."""
    layer = LayerPaths((0, 0.3), (bead([(0, 0), (20, 0)], 2.0, EXTERNAL), bead([(0, 8), (20, 8)], 1.0, SOLID)))
    lines = elements(draw_paths(layer, title="a layer"), "polyline")
    outer, inner = (next(e for e in lines if e.attrib["stroke"] == COLOURS[kind]) for kind in (EXTERNAL, SOLID))
    scale = np.ptp(points_of(outer)[:, 0]) / 20
    assert float(outer.attrib["stroke-width"]) == pytest.approx(2 * scale, rel=0.01)
    assert float(inner.attrib["stroke-width"]) == pytest.approx(1 * scale, rel=0.01)
    assert points_of(outer)[0, 1] - points_of(inner)[0, 1] == pytest.approx(8 * scale, abs=0.02)
    (travel,) = [e for e in lines if e.attrib["stroke"] == TRAVEL]
    assert points_of(travel) == pytest.approx(np.array([points_of(outer)[-1], points_of(inner)[0]]), abs=0.02)
    assert len(lines) == 5


def test_beads_in_pixels():
    """The outer wall, the infill and what is between, in a PNG; both kinds are in the legend."""
    layer = LayerPaths((0, 0.3), (bead([(0, 0), (20, 0)], 2.0, EXTERNAL), bead([(0, 8), (20, 8)], 1.0, SOLID)))
    drawing = draw_paths(layer, title="a layer")
    picture = drawing.png()
    lines = {e.attrib["stroke"]: points_of(e) for e in elements(drawing, "polyline")}
    scale = np.ptp(lines[COLOURS[EXTERNAL]][:, 0]) / 20
    for kind, half in ((EXTERNAL, 1.0), (SOLID, 0.5)):
        x, y = lines[COLOURS[kind]].mean(axis=0)
        for away in (-0.8, -0.4, 0.4, 0.8):
            assert colour_at(picture, x, y + away * half * scale) == rgb(COLOURS[kind])
        for away in (-1.2, 1.2):
            assert colour_at(picture, x, y + away * half * scale) == rgb(drawing.background)
    assert {"a layer", EXTERNAL, SOLID} == {e.text for e in elements(drawing, "text")}


def test_a_bead_of_several_widths_is_drawn_with_each():
    """Neighbouring pieces of one width are one line."""
    layer = LayerPaths((0, 0.3), (bead([(0, 0), (5, 0), (10, 0), (15, 0)], [0.5, 0.5, 1.0], EXTERNAL),))
    lines = [e for e in elements(draw_paths(layer), "polyline") if e.attrib["stroke"] == COLOURS[EXTERNAL]]
    assert [len(points_of(e)) for e in lines] == [3, 2]
    thick, thin = float(lines[1].attrib["stroke-width"]), float(lines[0].attrib["stroke-width"])
    assert thick == pytest.approx(2 * thin, rel=0.01)


@pytest.mark.parametrize("paths", [(), (bead([(3, 3), (3, 3.001)], 0.4, "What"),)], ids=["none", "a dot"])
def test_layers_with_next_to_nothing(paths):
    """No beads at all, and one that is a dot of an unknown kind, in grey."""
    drawing = draw_paths(LayerPaths((0, 0.3), paths))
    picture = drawing.png()
    assert max(picture.size) < 2000
    strokes = {e.attrib["stroke"] for e in elements(drawing, "polyline")}
    assert (OTHER in strokes) == bool(paths)


# Widths beside the part


def test_widths_are_drawn_at_the_height_of_their_layers():
    """A wide layer below, an empty one, a thin one above: the part in grey and red, the widths as steps."""
    layers = [block(30, 40, 10), np.zeros((50, 60), bool), np.pad(block(3, 20, 10), ((0, 27), (10, 10)))]
    stack = LayerStack.from_images(layers, pixel_mm=0.1, layer_mm=1)
    found = suggest_widths(stack, min_mm=0.4, max_mm=1.2, step_mm=0.1)
    assert found.too_thin.tolist() == [False, False, True]
    drawing = draw_widths(stack, found, found, title="a part")
    boxes = [(points_of(e), e.attrib["fill"]) for e in elements(drawing, "polygon")]
    (wide, grey), (thin, red), (mark, red_too) = boxes
    assert red == red_too == RED != grey
    assert np.ptp(wide[:, 0]) == pytest.approx(2 * np.ptp(thin[:, 0]), rel=0.01)
    assert (wide[:, 0].min() + wide[:, 0].max()) / 2 == pytest.approx(
        (thin[:, 0].min() + thin[:, 0].max()) / 2, abs=0.1
    )
    scale = np.ptp(wide[:, 0]) / 4  # px of a mm
    assert wide[:, 1].min() - thin[:, 1].min() == pytest.approx(2 * scale, rel=0.01)
    assert mark[:, 1].min() == thin[:, 1].min()
    (chosen,) = [points_of(e) for e in elements(drawing, "polyline") if e.attrib["stroke"] == BLUE]
    assert len(chosen) == 4  # up two layers, one step to the left, up another
    assert np.diff(chosen[:, 1]) == pytest.approx([-2 * scale, 0, -scale], abs=0.05)
    assert (chosen[0, 0] == chosen[1, 0], chosen[2, 0] == chosen[3, 0], chosen[2, 0] < chosen[1, 0]) == (True,) * 3
    words = [e.text for e in elements(drawing, "text")]
    assert {"a part", "0.4", "1.2", "0", "3"} <= {*words}
    picture = drawing.png()
    assert colour_at(picture, *wide.mean(axis=0)) == rgb(grey)
    assert colour_at(picture, *thin.mean(axis=0)) == rgb(RED)
    assert colour_at(picture, wide.mean(axis=0)[0], wide[:, 1].min() - scale / 2) == rgb(drawing.background)


@pytest.mark.parametrize("high", [0.4, 1.2])
def test_widths_of_an_empty_part_and_of_one_width(high):
    """Nothing solid, and a range that is one width: a drawing all the same."""
    stack = LayerStack.from_images([np.zeros((20, 70), bool)] * 2, pixel_mm=0.1, layer_mm=1)
    found = suggest_widths(stack, min_mm=0.4, max_mm=high)
    drawing = draw_widths(stack, found, found)
    assert elements(drawing, "polygon") == []
    (chosen,) = [points_of(e) for e in elements(drawing, "polyline") if e.attrib["stroke"] == BLUE]
    assert (np.ptp(chosen[:, 0]), np.ptp(chosen[:, 1]) > 0) == (0, True)
    assert max(drawing.png().size) < 2000


# layerfix draw


@pytest.fixture
def gcode(tmp_path) -> Path:
    path = tmp_path / "part.gcode"
    path.write_text(GCODE)
    return path


def test_draw_a_layer(tmp_path, gcode):
    """Its beads and no priming line, as SVG and PNG; what was drawn is said, in words and as JSON."""
    done = run_layerfix("draw", gcode, tmp_path / "a.svg", "--json")
    assert (done.code, done.err) == (0, "")
    said = json.loads(done.out)
    assert said["layer"] == 0
    assert (said["z_mm"], said["paths"], said["narrowest_mm"], said["widest_mm"]) == (0.3, 2, 0.6, 1.2)
    root = ET.parse(tmp_path / "a.svg").getroot()
    wall, infill = root.findall(f"{SVG}polyline")[:2]
    assert (len(points_of(wall)), wall.attrib["stroke"]) == (5, COLOURS[EXTERNAL])
    assert (len(points_of(infill)), infill.attrib["stroke"]) == (2, COLOURS[SOLID])
    assert float(infill.attrib["stroke-width"]) == pytest.approx(2 * float(wall.attrib["stroke-width"]), rel=0.01)
    assert root.findall(f"{SVG}text")[0].text == "part.gcode, layer 0, z = 0.300 mm"
    done = run_layerfix("draw", gcode, tmp_path / "a.png")
    assert (done.code, done.err) == (0, "")
    with Image.open(tmp_path / "a.png") as picture:
        x, y = points_of(infill).mean(axis=0)
        assert colour_at(picture, x, y - 10) == rgb(COLOURS[SOLID])
        assert colour_at(picture, x, y - 100) == rgb("#20242b")
    rows = [line.split() for line in done.out.splitlines()]
    assert ["layer", "0"] in rows
    assert ["widest_mm", "1.2"] in rows
    assert ["narrowest_mm", "0.6"] in rows


def test_draw_another_layer_of_a_kind_nobody_knows(tmp_path, gcode):
    """Counted from 0; marks of XML in its name are words."""
    assert run_layerfix("draw", gcode, tmp_path / "a.svg", "--layer", 1).code == 0
    root = ET.parse(tmp_path / "a.svg").getroot()
    assert root.findall(f"{SVG}polyline")[0].attrib["stroke"] == OTHER
    assert "Bridge <&> infill" in {e.text for e in root.findall(f"{SVG}text")}


@pytest.mark.parametrize(
    ("target", "options", "words"),
    [
        ("a.png", ("--layer", 2), "part.gcode: there is no layer 2; it has layers 0 to 1"),
        ("a.pdf", (), "a.pdf: a drawing is written as .png or .svg"),
        ("there.png", (), "there.png: exists already; use --force"),
        ("nowhere/a.png", (), "there is no folder"),
    ],
)
def test_what_cannot_be_drawn_is_said_in_a_line(tmp_path, gcode, target, options, words):
    """Exit code 2; nothing is written or replaced."""
    (tmp_path / "there.png").write_text("mine")
    before = contents(tmp_path)
    done = run_layerfix("draw", gcode, tmp_path / target, *options)
    assert (done.code, done.out) == (2, "")
    assert re.fullmatch(f"layerfix: .*{re.escape(words)}.*\n", done.err)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [("missing.gcode", None, "no such file"), ("empty.gcode", "", "lays nothing; is it G-code"),
     ("words.gcode", "once upon a time", "lays nothing; is it G-code")],
)  # fmt: skip
def test_what_is_no_gcode_is_said_in_a_line(tmp_path, name, text, words):
    """Exit code 2, and no drawing."""
    if text is not None:
        (tmp_path / name).write_text(text)
    done = run_layerfix("draw", tmp_path / name, tmp_path / "a.png")
    assert done.code == 2
    assert re.fullmatch(f"layerfix: .*{re.escape(words)}.*\n", done.err)
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize("target", ["a.png", "a.svg"])
@pytest.mark.parametrize(
    "change",
    [
        pytest.param(("WIDTH:0.6", "WIDTH:nan"), id="no width"),
        pytest.param(("WIDTH:0.6", "WIDTH:inf"), id="endless width"),
        pytest.param(("WIDTH:0.6", "WIDTH:-1"), id="width below 0"),
        pytest.param(("HEIGHT:0.3", "HEIGHT:nan"), id="no height"),
        pytest.param(("HEIGHT:0.3", "HEIGHT:-0.3"), id="height below 0"),
        pytest.param(("External perimeter", "Ex\x01ternal"), id="control characters"),
        pytest.param(("X10 Y0 E0.8", f"X{'9' * 400} Y0 E0.8"), id="too far"),
    ],
)
def test_strange_gcode_is_drawn_or_refused(tmp_path, change, target):
    """A drawing that opens, or an error of one line; never a trace."""
    path = tmp_path / "part.gcode"
    path.write_text(GCODE.replace(*change))
    done = run_layerfix("draw", path, tmp_path / target)
    assert "Traceback" not in done.err
    assert "Warning" not in done.err
    assert done.code in (0, 2)
    if done.code == 0 and target == "a.svg":
        assert not re.search(r"\b(nan|inf)\b", (tmp_path / target).read_text())
        ET.parse(tmp_path / target)
    assert (tmp_path / target).exists() == (done.code == 0)


def test_a_name_that_is_no_unicode(tmp_path):
    """Linux lets file names be any bytes; the drawing's title shows what it can."""
    path = os.fsencode(tmp_path) + b"/part\xff.gcode"
    try:
        Path(os.fsdecode(path)).write_text(GCODE)
    except OSError:
        pytest.skip("this file system takes only unicode")
    for target in ("a.svg", "a.png"):
        done = run_layerfix("draw", os.fsdecode(path), tmp_path / target)
        assert (done.code, done.err) == (0, "")
