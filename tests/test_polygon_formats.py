"""SVG, GeoJSON and CLI files, read again by readers that know nothing of the writers."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

from layerfix.errors import InputError, OutputError
from layerfix.formats.options import CliOptions, OutlineOptions
from layerfix.formats.vector import common_layer, geojson, svg
from layerfix.layers.correction import correct
from layerfix.mesh.slicing import slice_mesh
from layerfix.outlines.contours import trace_contours
from layerfix.stack import LayerStack
from tests.making import contents, thin_part
from tests.pictures_as_text import picture

SVG = "{http://www.w3.org/2000/svg}"
INKSCAPE = "{http://www.inkscape.org/namespaces/inkscape}"
PLAIN = OutlineOptions()
BINARY = CliOptions()
READABLE = CliOptions(ascii=True)


class Drawn(NamedTuple):
    """One layer as a file has it: rings of x, y in mm, y to the back, whichever way they turn."""

    bottom_mm: float
    top_mm: float
    polygons: list[list[np.ndarray]]

    def shape(self) -> shapely.MultiPolygon:
        return shapely.MultiPolygon([(rings[0], rings[1:]) for rings in self.polygons])


def read_svg(path: Path) -> list[Drawn]:
    layers = []
    for group in ElementTree.parse(path).getroot().findall(f"{SVG}g"):
        assert group.get(f"{INKSCAPE}groupmode") == "layer"
        polygons = []
        for drawn in group.findall(f"{SVG}path"):
            assert drawn.get("fill-rule") == "evenodd"
            rings = re.findall(r"M([^MZ]*)Z", drawn.get("d", ""))
            assert "".join(f"M{ring}Z" for ring in rings) == drawn.get("d")
            points = [np.array([pair.split(",") for pair in ring.split()], float) * (1, -1) for ring in rings]
            polygons.append([np.concatenate([ring, ring[:1]]) for ring in points])
        layers.append(Drawn(float(group.attrib["data-bottom-mm"]), float(group.attrib["data-top-mm"]), polygons))
    return layers


def read_geojson(path: Path) -> list[Drawn]:
    data = json.loads(path.read_text("utf-8"))
    assert data["type"] == "FeatureCollection"
    assert data["units"] == "mm"
    layers = []
    for index, feature in enumerate(data["features"]):
        about, geometry = feature["properties"], feature["geometry"]
        assert (feature["type"], geometry["type"], about["layer"]) == ("Feature", "MultiPolygon", index)
        polygons = [[np.array(ring) for ring in rings] for rings in geometry["coordinates"]]
        layers.append(Drawn(about["bottom_mm"], about["top_mm"], polygons))
    return layers


def cli_header(data: bytes) -> tuple[dict[str, str], bytes]:
    """(its commands and what they say, what follows)."""
    head, _, rest = data.partition(b"$$HEADEREND")
    lines = head.decode("ascii").splitlines()
    assert lines[0] == "$$HEADERSTART"
    return dict(line.removeprefix("$$").partition("/")[::2] for line in lines[1:]), rest


def read_cli(path: Path) -> list[Drawn]:
    """A CLI file of either kind; a layer begins where the one before ends."""
    header, rest = cli_header(path.read_bytes())
    assert header["VERSION"] == "200"
    unit = float(header["UNITS"])
    commands = list(binary_commands(rest) if "BINARY" in header else ascii_commands(rest.decode("ascii")))
    assert int(header["LAYERS"]) == sum(len(command) == 1 for command in commands)
    tops = [command[0] * unit for command in commands if len(command) == 1]
    layers: list[Drawn] = []
    for command in commands:
        if len(command) == 1:
            top_mm = command[0] * unit
            layers.append(Drawn(tops[len(layers) - 1] if layers else np.nan, top_mm, []))
        else:
            identity, turn, points = command
            assert header["LABEL"].partition(",")[0] == str(identity)
            ring = points * unit
            assert shapely.LinearRing(ring).is_ccw == (turn == 1)
            assert (ring[0] == ring[-1]).all()
            if turn == 1:
                layers[-1].polygons.append([])
            layers[-1].polygons[-1].append(ring)
    return layers


def binary_commands(data: bytes) -> Any:
    at = 0
    while at < len(data):
        (code,) = struct.unpack_from("<H", data, at)
        if code == 127:
            yield struct.unpack_from("<f", data, at + 2)
            at += 6
        else:
            assert code == 130
            identity, turn, count = struct.unpack_from("<iii", data, at + 2)
            yield identity, turn, np.frombuffer(data, "<f4", 2 * count, at + 14).astype(float).reshape(-1, 2)
            at += 14 + 8 * count


def ascii_commands(text: str) -> Any:
    lines = text.split("\n")
    assert (lines[0], lines[1], lines[-2], lines[-1]) == ("", "$$GEOMETRYSTART", "$$GEOMETRYEND", "")
    for line in lines[2:-2]:
        name, _, numbers = line.partition("/")
        if name == "$$LAYER":
            yield (float(numbers),)
        else:
            assert name == "$$POLYLINE"
            identity, turn, count, *points = numbers.split(",")
            assert len(points) == 2 * int(count)
            yield int(identity), int(turn), np.array(points, float).reshape(-1, 2)


class Kind(NamedTuple):
    """A writer and the reader for it; first: how many layers come before the stack's own."""

    name: str
    write: Callable[[Path, LayerStack, OutlineOptions], None]
    read: Callable[[Path], list[Drawn]]
    options: OutlineOptions
    first: int = 0


KINDS = (
    Kind("part.svg", svg.write, read_svg, PLAIN),
    Kind("part.geojson", geojson.write, read_geojson, PLAIN),
    Kind("part.cli", common_layer.write, read_cli, BINARY, first=1),
    Kind("ascii.cli", common_layer.write, read_cli, READABLE, first=1),
)
every_kind = pytest.mark.parametrize("kind", KINDS, ids=[kind.name for kind in KINDS])


def part() -> LayerStack:
    """A corrected part on oblong pixels, its first layer higher, partly left of and before the origin."""
    sliced = slice_mesh(thin_part().moved([-3, -1, 0]), pixel_mm=(0.05, 0.07), layer_mm=0.1, first_layer_mm=0.3)
    return correct(sliced, min_feature_mm=0.4)


def drawn_layers() -> LayerStack:
    """Holes, islands in them, corners that meet, nothing, and one pixel; not at the origin."""
    nest = """
        . . . . . . . .
        . # # # # # # .
        . # . . . . # .
        . # . # # . # .
        . # . . . . # .
        . # # # # # # .
    """
    corners = """
        # . . . . . . #
        . # . . . . # .
        . . # # # # . .
        . . # . . # . .
        . . # # # # . .
        # # # # . . # #
    """
    nothing = np.zeros((6, 8), bool)
    pixel = nothing.copy()
    pixel[2, 2] = True
    pictures = [picture(nest), picture(corners), nothing, pixel]
    plain = LayerStack.from_images(pictures, pixel_mm=(0.019, 0.024), layer_mm=0.05)
    return replace(plain, origin_mm=(-0.05, 12.0))


@every_kind
@pytest.mark.parametrize("make", [part, drawn_layers])
@pytest.mark.parametrize("tolerance_mm", [None, 0, 0.03])
def test_what_is_written_comes_back(tmp_path, kind, make, tolerance_mm):
    """Every ring of every layer to 0.1 µm, and every z."""
    stack = make()
    kind.write(tmp_path / kind.name, stack, replace(kind.options, tolerance_mm=tolerance_mm))
    found = kind.read(tmp_path / kind.name)[kind.first :]
    assert len(found) == len(stack)
    for layer, outlines in zip(found, trace_contours(stack, tolerance_mm=tolerance_mm), strict=True):
        assert len(layer.polygons) == len(outlines.geoms)
        for rings, polygon in zip(layer.polygons, outlines.geoms, strict=True):
            expected = [polygon.exterior, *polygon.interiors]
            assert len(rings) == len(expected)
            for ring, line in zip(rings, expected, strict=True):
                assert ring == pytest.approx(np.array(line.coords), abs=6e-5)
        assert layer.shape().area == pytest.approx(outlines.area, abs=1e-4 * outlines.length)
    assert np.array([(a.bottom_mm, a.top_mm) for a in found]) == pytest.approx(stack.z_mm, abs=1e-6)


@every_kind
@pytest.mark.parametrize("workers", [1, 8])
def test_the_same_layers_give_the_same_bytes(tmp_path, kind, workers):
    """Twice the same stack, by any number of threads."""
    kind.write(tmp_path / "first", part(), kind.options)
    kind.write(tmp_path / "again", part().with_workers(workers), kind.options)
    assert (tmp_path / "first").read_bytes() == (tmp_path / "again").read_bytes()


@every_kind
def test_who_watches_is_told_of_each_layer(tmp_path, kind):
    """In order, with its z and what correction did, without its pixels."""
    stack, seen = part(), []
    kind.write(tmp_path / kind.name, stack, replace(kind.options, watch=lambda k, layer: seen.append((k, layer))))
    assert [k for k, _ in seen] == list(range(len(stack)))
    assert [layer.z_mm for _, layer in seen] == [tuple(z) for z in stack.z_mm]
    assert all(layer.change is not None and layer.rows.size == 0 for _, layer in seen)


@every_kind
def test_layers_that_repeat_keep_their_own_heights(tmp_path, kind):
    """Their outlines are made once, and written as often as they are there."""
    once = drawn_layers()[:1]
    z_mm = np.array([[0, 0.1], [0.1, 0.2], [0.2, 0.3]])
    stack = replace(once, z_mm=z_mm, make=lambda index: once[0], repeats=np.array([False, True, True]))
    kind.write(tmp_path / kind.name, stack, kind.options)
    found = kind.read(tmp_path / kind.name)[kind.first :]
    assert [layer.top_mm for layer in found] == pytest.approx([0.1, 0.2, 0.3])
    assert {len(layer.polygons) for layer in found} == {2}


@every_kind
def test_a_target_is_replaced_only_if_told_to(tmp_path, kind):
    """What is there stays as it is without `force`."""
    target = tmp_path / kind.name
    target.write_text("mine")
    with pytest.raises(OutputError, match=rf"{kind.name}: exists already; use --force"):
        kind.write(target, drawn_layers(), kind.options)
    assert contents(tmp_path) == {kind.name: b"mine"}
    kind.write(target, drawn_layers(), replace(kind.options, force=True))
    assert len(kind.read(target)) == 4 + kind.first


@every_kind
def test_an_error_in_a_layer_leaves_no_output(tmp_path, kind):
    """The third layer cannot be made: no half file, no temporary."""
    stack = drawn_layers()

    def broken(layer: Any) -> Any:
        if layer.z_mm[0] > 0.09:
            raise InputError("the disk is gone")
        return layer

    with pytest.raises(InputError, match="the disk is gone"):
        kind.write(tmp_path / kind.name, stack.map(broken), kind.options)
    assert contents(tmp_path) == {}


@every_kind
def test_a_tolerance_that_undoes_the_correction_leaves_no_output(tmp_path, kind):
    """It is known only when the first layer is there."""
    for tolerance_mm, word in ((0.5, "minimum feature of 0.4 mm"), (-1.0, "it must be 0 or more")):
        with pytest.raises(InputError, match=word):
            kind.write(tmp_path / kind.name, part(), replace(kind.options, tolerance_mm=tolerance_mm))
    assert contents(tmp_path) == {}


@every_kind
def test_a_stack_without_layers_or_without_solids(tmp_path, kind):
    """Files that say so, and can be read."""
    kind.write(tmp_path / "none", drawn_layers()[:0], kind.options)
    assert kind.read(tmp_path / "none") == []
    kind.write(tmp_path / "empty", drawn_layers()[2:3], kind.options)
    assert [layer.polygons for layer in kind.read(tmp_path / "empty")] == [[]] * (1 + kind.first)


# SVG


def test_an_svg_has_the_size_of_the_frame_in_mm(tmp_path):
    """One unit is 1 mm; x is the part's and y minus the part's."""
    svg.write(tmp_path / "part.svg", drawn_layers(), PLAIN)
    root = ElementTree.parse(tmp_path / "part.svg").getroot()
    assert root.tag == f"{SVG}svg"
    assert (root.get("width"), root.get("height")) == ("0.152mm", "0.144mm")
    assert root.get("viewBox") == "-0.05 -12 0.152 0.144"


def test_layers_of_an_svg_have_names(tmp_path):
    """As Inkscape shows them, and for scripts."""
    svg.write(tmp_path / "part.svg", part(), PLAIN)
    groups = ElementTree.parse(tmp_path / "part.svg").getroot().findall(f"{SVG}g")
    assert [group.get("id") for group in groups[:2]] == ["layer0", "layer1"]
    assert [group.get(f"{INKSCAPE}label") for group in groups[:2]] == ["z = 0.000 mm", "z = 0.300 mm"]
    assert groups[1].get("data-bottom-mm") == "0.3"
    assert groups[1].get("data-top-mm") == "0.4"


def test_the_higher_a_layer_the_lighter(tmp_path):
    """Opaque and in order, so that a browser shows the part from above; one layer is black."""
    svg.write(tmp_path / "part.svg", part(), PLAIN)
    shades = re.findall(r' fill="#([0-9a-f]{6})"', (tmp_path / "part.svg").read_text("utf-8"))
    assert len(shades) == len(part())
    assert all(int(a[:2], 16) < int(b[:2], 16) for a, b in pairwise(shades))
    svg.write(tmp_path / "one.svg", part()[3:4], PLAIN)
    assert re.findall(r' fill="(.*?)"', (tmp_path / "one.svg").read_text("utf-8")) == ["#000000"]
    assert "opacity" not in (tmp_path / "part.svg").read_text("utf-8")


# GeoJSON


def test_geojson_keeps_the_rules_of_the_rfc(tmp_path):
    """Rings are closed, outer ones counter-clockwise, holes clockwise; other programs' readers take it."""
    geojson.write(tmp_path / "part.geojson", drawn_layers(), replace(PLAIN, tolerance_mm=0))
    data = json.loads((tmp_path / "part.geojson").read_text("utf-8"))
    for feature, layer in zip(data["features"], drawn_layers(), strict=True):
        for rings in feature["geometry"]["coordinates"]:
            assert all(ring[0] == ring[-1] for ring in rings)
            assert [shapely.LinearRing(ring).is_ccw for ring in rings] == [True] + [False] * (len(rings) - 1)
        shape = shapely.from_geojson(json.dumps(feature["geometry"]))
        assert shape.is_valid
        assert shape.area == pytest.approx(layer.count_px() * 0.019 * 0.024)
        assert feature["properties"]["area_mm2"] == pytest.approx(shape.area, abs=1e-6)


# Common Layer Interface


@pytest.mark.parametrize("options", [BINARY, READABLE])
def test_the_header_of_a_cli_file(tmp_path, options):
    """What machines write, to the letter: they differ only in what kind it is."""
    common_layer.write(tmp_path / "part.cli", drawn_layers(), replace(options, tolerance_mm=0))
    head = (tmp_path / "part.cli").read_bytes().partition(b"$$HEADEREND")[0].decode("ascii")
    assert head.splitlines() == [
        "$$HEADERSTART",
        "$$ASCII" if options.ascii else "$$BINARY",
        "$$UNITS/00000001.000000",
        "$$VERSION/200",
        "$$LABEL/1,part",
        "$$DIMENSION/-0000000.050000,00000011.856000,00000000.000000,00000000.102000,00000012.000000,00000000.200000",
        "$$LAYERS/000005",
    ]


@pytest.mark.parametrize("options", [BINARY, READABLE])
def test_the_dimension_is_that_of_what_is_solid(tmp_path, options):
    """Of the frame, where nothing is."""
    for stack, box in ((drawn_layers()[3:], (-0.012, 11.928, 0.007, 11.952)), (drawn_layers()[2:3], None)):
        common_layer.write(tmp_path / "part.cli", stack, replace(options, force=True, tolerance_mm=0))
        header, _ = cli_header((tmp_path / "part.cli").read_bytes())
        x0, y0, z0, x1, y1, z1 = map(float, header["DIMENSION"].split(","))
        assert (x0, y0, x1, y1) == pytest.approx(box or (-0.05, 11.856, 0.102, 12.0))
        assert (z0, z1) == pytest.approx(stack.z_mm[[0, -1], [0, 1]])


def test_binary_geometry_follows_the_header_at_once(tmp_path):
    """No line end between them: the first command is the empty layer at the bottom."""
    common_layer.write(tmp_path / "part.cli", drawn_layers()[3:], BINARY)
    _, rest = cli_header((tmp_path / "part.cli").read_bytes())
    assert rest[:12] == struct.pack("<HfHf", 127, 0.15, 127, 0.2)
    assert struct.unpack("<Hiii", rest[12:26])[:3] == (130, 1, 1)


@pytest.mark.parametrize("options", [BINARY, READABLE])
def test_a_gap_between_layers_is_an_empty_layer(tmp_path, options):
    """A layer is as thick as it is above the one before: every second layer would be twice as thick."""
    common_layer.write(tmp_path / "part.cli", drawn_layers()[::2], options)
    found = read_cli(tmp_path / "part.cli")
    assert [layer.top_mm for layer in found] == pytest.approx([0, 0.05, 0.1, 0.15])
    assert [len(layer.polygons) for layer in found] == [0, 2, 0, 0]
