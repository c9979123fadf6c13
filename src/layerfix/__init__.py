"""layerfix: corrects the layers of a 3D print so that thin walls and pins survive printing."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

__version__ = "0.1.0"

# Loaded when first used: `import layerfix` pulls in no numpy, numba, cv2, trimesh or shapely.
_HOME = {
    "LayerfixError": "errors",
    "pack": "bits",
    "unpack": "bits",
    "Layer": "stack",
    "LayerStack": "stack",
    "Printer": "printers",
    "load_printer": "printers",
    "Mesh": "mesh.triangles",
    "load_mesh": "mesh.load",
    "slice_like": "mesh.slicing",
    "slice_mesh": "mesh.slicing",
    "meso_skeleton": "layers.skeleton",
    "correct": "layers.correction",
    "correct_image": "layers.correction",
    "compare_topology": "layers.topology",
    "Conflict": "layers.gaps",
    "TopologyChange": "layers.topology",
    "Contours": "outlines.contours",
    "trace_contours": "outlines.contours",
    "surface_mesh": "surface.kinds",
    "correct_regions": "outlines.regions",
    "CorrectedRegions": "outlines.regions",
    "plan_toolpaths": "fdm.toolpaths",
    "settings_for": "fdm.settings",
    "suggest_widths": "layers.widths",
    "banded": "fdm.bands",
    "Widths": "layers.widths",
    "WidthPlan": "fdm.width_plan",
    "orient": "orientation.find",
    "Orientation": "orientation.outcome",
    "Toolpaths": "fdm.toolpaths",
    "PathSettings": "fdm.settings",
    "read": "formats",
    "write": "formats",
}
__all__ = [
    "Conflict",
    "Contours",
    "CorrectedRegions",
    "Layer",
    "LayerStack",
    "LayerfixError",
    "Mesh",
    "Orientation",
    "PathSettings",
    "Printer",
    "Toolpaths",
    "TopologyChange",
    "WidthPlan",
    "Widths",
    "banded",
    "compare_topology",
    "correct",
    "correct_image",
    "correct_regions",
    "load_mesh",
    "load_printer",
    "meso_skeleton",
    "orient",
    "pack",
    "plan_toolpaths",
    "read",
    "settings_for",
    "slice_like",
    "slice_mesh",
    "suggest_widths",
    "surface_mesh",
    "trace_contours",
    "unpack",
    "write",
]

if TYPE_CHECKING:
    from layerfix.bits import pack, unpack
    from layerfix.errors import LayerfixError
    from layerfix.fdm.bands import banded
    from layerfix.fdm.settings import PathSettings, settings_for
    from layerfix.fdm.toolpaths import Toolpaths, plan_toolpaths
    from layerfix.fdm.width_plan import WidthPlan
    from layerfix.formats import read, write
    from layerfix.layers.correction import correct, correct_image
    from layerfix.layers.gaps import Conflict
    from layerfix.layers.skeleton import meso_skeleton
    from layerfix.layers.topology import TopologyChange, compare_topology
    from layerfix.layers.widths import Widths, suggest_widths
    from layerfix.mesh.load import load_mesh
    from layerfix.mesh.slicing import slice_like, slice_mesh
    from layerfix.mesh.triangles import Mesh
    from layerfix.orientation.find import orient
    from layerfix.orientation.outcome import Orientation
    from layerfix.outlines.contours import Contours, trace_contours
    from layerfix.outlines.regions import CorrectedRegions, correct_regions
    from layerfix.printers import Printer, load_printer
    from layerfix.stack import Layer, LayerStack
    from layerfix.surface.kinds import surface_mesh


else:  # hidden from type checkers, to which every name would be an attribute

    def __getattr__(name):
        if name not in _HOME:
            raise AttributeError(f"module 'layerfix' has no attribute '{name}'")
        value = getattr(importlib.import_module(f"layerfix.{_HOME[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
