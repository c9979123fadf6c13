"""Toolpaths: from corrected layers to the beads that an FDM printer lays.

`toolpaths` is the way in: it plans each layer (`layer_plan`, with the kernels of `fields`, `level_sets`, `chains`,
`single_beads` and `infill`) and puts its paths in order (`arrange`, `order`). What is imported here loads no kernels.
"""

from __future__ import annotations

from layerfix.fdm.beads import KINDS, LayerPaths, Path
from layerfix.fdm.settings import PathSettings, settings_for

__all__ = ["KINDS", "LayerPaths", "Path", "PathSettings", "settings_for"]
