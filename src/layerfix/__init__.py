"""layerfix: corrects the layers of a 3D print so that thin walls and pins survive printing."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

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
    "Mesh": "mesh",
    "load_mesh": "mesh",
    "slice_mesh": "slicing",
    "meso_skeleton": "skeleton",
    "correct": "correction",
    "correct_image": "correction",
    "Contours": "contours",
    "trace_contours": "contours",
    "plan_toolpaths": "toolpaths.planner",
    "settings_for": "toolpaths.settings",
    "suggest_widths": "widths",
    "banded": "bands",
    "Widths": "widths",
    "PathSettings": "toolpaths.settings",
    "read": "formats",
    "write": "formats",
}
__all__ = [
    "Contours",
    "Layer",
    "LayerStack",
    "LayerfixError",
    "Mesh",
    "PathSettings",
    "Printer",
    "Widths",
    "banded",
    "correct",
    "correct_image",
    "load_mesh",
    "load_printer",
    "meso_skeleton",
    "pack",
    "plan_toolpaths",
    "read",
    "settings_for",
    "slice_mesh",
    "suggest_widths",
    "trace_contours",
    "unpack",
    "write",
]

if TYPE_CHECKING:
    from layerfix.bands import banded
    from layerfix.bits import pack, unpack
    from layerfix.contours import Contours, trace_contours
    from layerfix.correction import correct, correct_image
    from layerfix.errors import LayerfixError
    from layerfix.formats import read, write
    from layerfix.mesh import Mesh, load_mesh
    from layerfix.printers import Printer, load_printer
    from layerfix.skeleton import meso_skeleton
    from layerfix.slicing import slice_mesh
    from layerfix.stack import Layer, LayerStack
    from layerfix.toolpaths.planner import plan_toolpaths
    from layerfix.toolpaths.settings import PathSettings, settings_for
    from layerfix.widths import Widths, suggest_widths


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'layerfix' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"layerfix.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
