"""`layerfix draw`: one layer of a G-code file as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from layerfix.draw.canvas import check_drawing
from layerfix.draw.plots import draw_paths
from layerfix.errors import InputError
from layerfix.files import check_apart, check_input, check_target
from layerfix.formats.vector.gcode_reader import read_gcode


def draw_gcode(source: Path, target: Path, index: int, *, force: bool) -> dict[str, Any]:
    """Draw layer `index` (from 0) and say what is in it.

    Raises InputError for a file that is no G-code or has fewer layers, OutputError for the target.
    """
    check_input(source, folders=False)
    check_drawing(target)
    check_apart(target, source)
    check_target(target, force=force)
    layers = read_gcode(source)
    if index >= len(layers):
        raise InputError(f"{source}: there is no layer {index}; it has layers 0 to {len(layers) - 1}")
    layer = layers[index]
    widths = [float(w) for path in layer.paths for w in (path.width_mm.min(), path.width_mm.max())]
    title = f"{source.name}, layer {index}, z = {layer.z_mm[1]:.3f} mm"
    draw_paths(layer, title=title).save(target, force=force)
    return {
        "layer": index,
        "z_mm": layer.z_mm[1],
        "paths": len(layer.paths),
        "travel_mm": round(sum(layer.travels_mm()), 1),
        "narrowest_mm": round(min(widths), 4),
        "widest_mm": round(max(widths), 4),
        "written": str(target),
    }
