"""Layers as GeoJSON (RFC 7946, https://www.rfc-editor.org/rfc/rfc7946), for GeoPandas, QGIS and scripts.

A FeatureCollection with a Feature for each layer: a MultiPolygon, outer rings counter-clockwise, holes clockwise,
and what layer it is. Coordinates are mm on the build plate. That is against the RFC, which knows only longitude
and latitude; the member "units": "mm" says so. A layer with nothing in it has no coordinates.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.files import whole_file
from layerfix.formats.vector.polygons import DIGITS, outlined

if TYPE_CHECKING:
    from layerfix.formats.options import OutlineOptions
    from layerfix.formats.vector.polygons import Polygon, Ring
    from layerfix.stack import LayerStack


def write(path: Path, stack: LayerStack, options: OutlineOptions) -> None:
    """All layers, one a line."""
    with whole_file(path, force=options.force) as file:
        file.write(b'{"type": "FeatureCollection", "units": "mm", "features": [')
        for index, ((bottom, top), (area_mm2, geometry)) in enumerate(outlined(stack, options, _geometry)):
            properties = {
                "layer": index,
                "bottom_mm": round(bottom, DIGITS),
                "top_mm": round(top, DIGITS),
                "area_mm2": round(area_mm2, 6),
            }
            feature = f'{{"type": "Feature", "properties": {json.dumps(properties)}, "geometry": {geometry}}}'
            file.write(f"{',' if index else ''}\n{feature}".encode())
        file.write(b"\n]}\n")


def _geometry(polygons: list[Polygon]) -> tuple[float, str]:
    """(area in mm², the text of a MultiPolygon)."""
    coordinates = [[ring.tolist() for ring in rings] for rings in polygons]
    area_mm2 = sum(_area_mm2(ring) for rings in polygons for ring in rings)
    text = json.dumps(coordinates, separators=(",", ":"))
    return area_mm2, f'{{"type": "MultiPolygon", "coordinates": {text}}}'


def _area_mm2(ring: Ring) -> float:
    """Area of a closed ring; that of a hole is negative."""
    x, y = (ring - ring[0]).T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
