"""Widths by layer for slicers and tables: 3MF with settings by height, CSV, JSON.

PrusaSlicer (and SuperSlicer) read `Metadata/Prusa_Slicer_layer_config_ranges.xml`, OrcaSlicer and Bambu Studio
`Metadata/layer_config_ranges.xml`: for each stretch of heights a few settings of their own. Found out by trying and
in their sources:
  - every range needs `layer_height`, the print's own, or PrusaSlicer 2.5 crashes;
  - `object id` is the number of the object from 1, not the 3MF's id;
  - a layer belongs to the range that holds its middle;
  - solid shells end at every border of ranges unless "ensure vertical shell thickness" is on: so it is turned on for
    the object, and borders should be few (`bands`);
  - layer 0 takes its width from "first layer extrusion width".
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.errors import OutputError
from layerfix.files import whole_file
from layerfix.formats.solid.model import check_whole
from layerfix.formats.solid.package_3mf import write_3mf

if TYPE_CHECKING:
    from layerfix.fdm.width_plan import WidthPlan
    from layerfix.formats.options import WidthModelOptions, WriteOptions
    from layerfix.layers.widths import Widths
    from layerfix.mesh.triangles import Mesh

PRUSA_KEYS = (
    "external_perimeter_extrusion_width",
    "perimeter_extrusion_width",
    "infill_extrusion_width",
    "solid_infill_extrusion_width",
    "top_infill_extrusion_width",
)
ORCA_KEYS = (
    "outer_wall_line_width",
    "inner_wall_line_width",
    "sparse_infill_line_width",
    "internal_solid_infill_line_width",
    "top_surface_line_width",
)
SLICERS = ("prusa", "orca")


def write_width_3mf(path: Path, plan: WidthPlan, options: WidthModelOptions) -> None:
    """The part in the middle of the bed, with one range of settings for each stretch of one width.

    Raises OutputError for a slicer that is not one of SLICERS.
    """
    check_whole(path, plan.part)
    slicer, mesh, widths = options.slicer, plan.part, plan.chosen
    if slicer not in SLICERS:
        raise OutputError(f"{path}: slicer '{slicer}' is not known; choose from {', '.join(SLICERS)}")
    low, high = mesh.bounds_mm
    middle = np.array(plan.printer.room_mm[:2]) / 2 - (low[:2] + high[:2]) / 2
    place = float(middle[0]), float(middle[1]), float(-low[2])
    ranges = _ranges_xml(widths, PRUSA_KEYS if slicer == "prusa" else ORCA_KEYS)
    settings = {"ensure_vertical_shell_thickness": "1" if slicer == "prusa" else "ensure_all"}
    attachments = {
        "prusa": {
            "Metadata/Prusa_Slicer_layer_config_ranges.xml": ranges,
            "Metadata/Slic3r_PE_model.config": _object_xml(mesh, settings, 'type="object" '),
        },
        "orca": {
            "Metadata/layer_config_ranges.xml": ranges,
            "Metadata/model_settings.config": _object_xml(mesh, settings, ""),
        },
    }[slicer]
    parts = [(mesh.vertices, mesh.faces.astype(np.int64))]
    write_3mf(path, parts, force=options.force, place_mm=place, attachments=attachments)


def _ranges_xml(widths: Widths, keys: tuple[str, ...]) -> str:
    lines = ['<?xml version="1.0" encoding="utf-8"?>', "<objects>", ' <object id="1">']
    heights = np.round(widths.z_mm[:, 1] - widths.z_mm[:, 0], 6)
    usual = heights[1:] if len(heights) > 1 else heights  # the first layer may have its own
    layer_mm = float(np.median(usual))
    for bottom, top, width in widths.ranges():
        lines.append(f'  <range min_z="{bottom:.6g}" max_z="{top:.6g}">')
        lines.append(f'   <option opt_key="layer_height">{layer_mm:.6g}</option>')
        lines += [f'   <option opt_key="{key}">{width:.6g}</option>' for key in keys]
        lines.append("  </range>")
    return "\n".join([*lines, " </object>", "</objects>\n"])


def _object_xml(mesh: Mesh, settings: dict[str, str], kind: str) -> str:
    """Settings of the object, and the one volume that it is (PrusaSlicer wants its triangles named)."""
    name = "".join(c for c in mesh.name if c.isalnum() or c in " ._-")
    last = len(mesh.faces) - 1
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<config>", ' <object id="1" instances_count="1">']
    lines.append(f'  <metadata {kind}key="name" value="{name}"/>')
    lines += [f'  <metadata {kind}key="{key}" value="{value}"/>' for key, value in settings.items()]
    if kind:
        lines.append(f'  <volume firstid="0" lastid="{last}">')
        lines.append(f'   <metadata type="volume" key="name" value="{name}"/>')
        lines.append("  </volume>")
    return "\n".join([*lines, " </object>", "</config>\n"])


def table(suggested: Widths, chosen: Widths) -> list[dict[str, Any]]:
    """A row for each layer."""
    thinning = suggested.thinning_mm
    return [
        {
            "layer": k,
            "bottom_mm": round(float(z[0]), 6),
            "top_mm": round(float(z[1]), 6),
            "suggested_mm": round(float(suggested.width_mm[k]), 6),
            "thinning_mm": None if thinning is None else round(float(thinning[k]), 6),
            "width_mm": round(float(chosen.width_mm[k]), 6),
            "too_thin": bool(suggested.too_thin[k]),
            "area_mm2": round(float(suggested.area_mm2[k]), 4),
        }
        for k, z in enumerate(chosen.z_mm)
    ]


def write_csv(path: Path, plan: WidthPlan, options: WriteOptions) -> None:
    """The table with a line of names."""
    rows = table(plan.suggested, plan.laid)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: int(v) if isinstance(v, bool) else v for k, v in row.items()} for row in rows)
    with whole_file(path, force=options.force) as file:
        file.write(text.getvalue().encode())


def write_json(path: Path, plan: WidthPlan, options: WriteOptions) -> None:
    """The summary, and the table under "table"."""
    rows = table(plan.suggested, plan.laid)
    with whole_file(path, force=options.force) as file:
        file.write((json.dumps({**plan.summary, "table": rows}, indent=1) + "\n").encode())


def draw_width_plan(path: Path, plan: WidthPlan, options: WriteOptions) -> None:
    """Widths by height beside the part's silhouette, .png or .svg."""
    from layerfix.draw.plots import draw_widths

    title = f"{plan.part.name}: extrusion widths for {plan.printer.title}"
    draw_widths(plan.stack, plan.suggested, plan.chosen, title=title).save(path, force=options.force)
