"""Layers in the Common Layer Interface, which metal machines and their software read: version 2.0,
https://www.hmilch.net/downloads/cli_format.html.

A layer is named by its upper surface, and as thick as that is above the one before. So an empty layer comes first,
at the bottom, and one stands in each gap. Polylines are closed, outer ones counter-clockwise, holes clockwise. The
header's numbers have leading zeros, as machines write them: it can be completed when the last layer is written,
and readers that cut off a line's end in a fixed place lose nothing. No date: the same layers, the same bytes.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.files import whole_file
from layerfix.formats.vector.polygons import number, outlined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.formats.options import CliOptions
    from layerfix.formats.vector.polygons import Polygon, Ring
    from layerfix.stack import LayerStack

    Corners = NDArray[np.float64]  # (2, 2): lowest and highest x, y in mm

START_LAYER_LONG, START_POLYLINE_LONG = 127, 130
CLOCKWISE, COUNTER_CLOCKWISE = 0, 1
PART = 1  # the id that the label declares
GAP_MM = 1e-6  # less is none


def write(path: Path, stack: LayerStack, options: CliOptions) -> None:
    """All layers into a binary file, or a readable one with `options.ascii`."""
    start_layer = _ascii_layer if options.ascii else _binary_layer
    polyline = _ascii_polyline if options.ascii else _binary_polyline

    def encode(polygons: list[Polygon]) -> tuple[Corners, bytes]:
        turns = [COUNTER_CLOCKWISE if k == 0 else CLOCKWISE for rings in polygons for k in range(len(rings))]
        rings = [ring for rings in polygons for ring in rings]
        return _corners(rings), b"".join(map(polyline, turns, rings))

    corners, below = _corners([]), -np.inf
    with whole_file(path, force=options.force) as file:
        file.write(_header(stack, corners, options.ascii))
        for (bottom, top), (own, polylines) in outlined(stack, options, encode):
            if bottom > below + GAP_MM:
                file.write(start_layer(bottom))
            file.write(start_layer(top) + polylines)
            corners = np.stack([np.minimum(corners[0], own[0]), np.maximum(corners[1], own[1])])
            below = top
        if options.ascii:
            file.write(b"$$GEOMETRYEND\n")
        file.seek(0)
        file.write(_header(stack, corners, options.ascii))


def _header(stack: LayerStack, corners: Corners, ascii: bool) -> bytes:
    """Always as long for one stack. Where nothing is solid, the dimension is the frame's."""
    if corners[0, 0] > corners[1, 0]:
        x, y = stack.origin_mm
        corners = np.array([[x, y - stack.height * stack.pixel_mm[1]], [x + stack.width * stack.pixel_mm[0], y]])
    z = stack.z_mm
    layers = len(z) + np.count_nonzero(z[1:, 0] > z[:-1, 1] + GAP_MM) + 1 if len(z) else 0
    heights = (z[0, 0], z[-1, 1]) if len(z) else (0.0, 0.0)
    dimension = [*corners[0], heights[0], *corners[1], heights[1]]
    return "\n".join(
        [
            "$$HEADERSTART",
            "$$ASCII" if ascii else "$$BINARY",
            f"$$UNITS/{_padded(1)}",  # mm
            "$$VERSION/200",
            f"$$LABEL/{PART},part",
            f"$$DIMENSION/{','.join(map(_padded, dimension))}",
            f"$$LAYERS/{layers:06}",
            "$$HEADEREND\n$$GEOMETRYSTART\n" if ascii else "$$HEADEREND",  # its geometry follows at once
        ]
    ).encode("ascii")


def _padded(value: float) -> str:
    return f"{value:015.6f}"


def _corners(rings: list[Ring]) -> Corners:
    """Lowest and highest x, y of all rings; the other way round, and infinite, for none."""
    if not rings:
        return np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
    points = np.concatenate(rings)
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _ascii_layer(z_mm: float) -> bytes:
    return f"$$LAYER/{number(z_mm)}\n".encode()


def _binary_layer(z_mm: float) -> bytes:
    return struct.pack("<Hf", START_LAYER_LONG, z_mm)


def _ascii_polyline(turn: int, ring: Ring) -> bytes:
    return f"$$POLYLINE/{PART},{turn},{len(ring)},{','.join(map(repr, ring.ravel().tolist()))}\n".encode()


def _binary_polyline(turn: int, ring: Ring) -> bytes:
    return struct.pack("<Hiii", START_POLYLINE_LONG, PART, turn, len(ring)) + ring.astype("<f4").tobytes()
