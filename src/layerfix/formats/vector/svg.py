"""Layers as one SVG drawing in mm (https://www.w3.org/TR/SVG2/), a layer each for Inkscape.

x of the drawing is x of the part and y is −y, because a drawing's y points down: it looks like the part from
above. Layers are opaque, the lowest first and darkest, so that a browser shows the part from above, shaded by
height. Transparent ones would show the inside, too, but some hundred of them are one dark blot. A single layer
is black.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.files import whole_file
from layerfix.formats.vector.polygons import number, outlined

if TYPE_CHECKING:
    from layerfix.formats.options import OutlineOptions
    from layerfix.formats.vector.polygons import Polygon, Ring
    from layerfix.stack import LayerStack

LOWEST, HIGHEST = np.array([18, 36, 66]), np.array([158, 202, 238])  # red, green, blue


def write(path: Path, stack: LayerStack, options: OutlineOptions) -> None:
    """All layers into one drawing the size of the frame; `stack[5:6]` is the picture of layer 5."""
    with whole_file(path, force=options.force) as file:
        file.write(_start(stack).encode())
        for index, ((bottom, top), paths) in enumerate(outlined(stack, options, _paths)):
            file.write(
                f'<g id="layer{index}" inkscape:groupmode="layer" inkscape:label="z = {bottom:.3f} mm"'
                f' data-bottom-mm="{number(bottom)}" data-top-mm="{number(top)}"'
                f' fill="{_shade(index, len(stack))}">\n{paths}</g>\n'.encode()
            )
        file.write(b"</svg>\n")


def _start(stack: LayerStack) -> str:
    x, y = stack.origin_mm
    width, height = number(stack.width * stack.pixel_mm[0]), number(stack.height * stack.pixel_mm[1])
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"'
        f' width="{width}mm" height="{height}mm" viewBox="{number(x)} {number(-y)} {width} {height}">\n'
    )


def _shade(index: int, count: int) -> str:
    if count == 1:
        return "#000000"
    red, green, blue = np.rint(LOWEST + (HIGHEST - LOWEST) * index / (count - 1)).astype(int).tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"


def _paths(polygons: list[Polygon]) -> str:
    """One path a polygon."""
    return "".join(f'<path fill-rule="evenodd" d="{"".join(map(_ring, rings))}"/>\n' for rings in polygons)


def _ring(ring: Ring) -> str:
    # `repr` of a rounded number is short; two more digits than needed for whole ones are worth its speed.
    points = (ring[:-1] * (1, -1) + 0.0).tolist()
    return f"M{' '.join(f'{x!r},{y!r}' for x, y in points)}Z"
