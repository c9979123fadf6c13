"""layerfix inside OrcaSlicer: thin features are thickened in the slices, before perimeters are made of them.

Everything is imported and every kernel ready when the plugin is loaded: while a slice is made, the host lets no
plugin open files or start processes. What is not OrcaSlicer's stands in the modules beside this one and in layerfix.
"""

from __future__ import annotations

import os

# Kernels are compiled in this process: sys.executable is the slicer here.
os.environ.setdefault("LAYERFIX_COMPILES_AHEAD", "1")

from typing import Any

import numpy as np
import orca

from layerfix import LayerfixError
from layerfix_orca.memory import Memory
from layerfix_orca.page import ObjectDone, body, whole_page
from layerfix_orca.settings import DEFAULTS, settings_of
from layerfix_orca.warm import warm

warm()
MEMORY = Memory()
DONE: dict[Any, ObjectDone] = {}  # of the last slices, by the host's id of the object
MOST_OBJECTS = 100


class ThickenThinFeatures(orca.slicing.SlicingPipelineCapabilityBase):
    """The step of the slicing pipeline. Presets know it by its name, which never changes."""

    def get_name(self) -> str:
        return "Thicken thin features"

    def get_default_config(self) -> dict[str, Any]:
        return dict(DEFAULTS)

    def execute(self, ctx: Any) -> Any:
        if ctx.step != orca.slicing.Step.posSlice or ctx.object is None:
            return orca.ExecutionResult.success()
        try:
            settings = settings_of(self.get_config(), lambda key: host_value(ctx, key))
            return thicken(ctx, settings)
        except LayerfixError as problem:
            return orca.ExecutionResult.failure(orca.PluginResult.FatalError, f"layerfix: {problem}")


def host_value(ctx: Any, key: str) -> str | None:
    """An option as the object has it, or the print."""
    value = ctx.object.config_value(key)
    return ctx.config_value(key) if value is None else value


def thicken(ctx: Any, settings: Any) -> Any:
    """All layers of an object corrected first, then handed back: cancelled in between, nothing has changed."""
    unit_mm = orca.slicing.unscale(1)
    layers = ctx.object.layers()
    done = ObjectDone(name_of(ctx.object), len(layers), settings.min_feature_mm, unit_mm=unit_mm)
    found = []
    for layer in layers:
        if ctx.cancelled():
            return orca.ExecutionResult.skipped("layerfix: cancelled")
        before = outlines(layer)
        on_plate = layer.print_z - layer.height < 1e-3  # on a raft, no layer is the first
        fixed = MEMORY.corrected(before, settings, on_plate, unit_mm)
        if fixed.changed:
            found.append((layer, before, fixed.regions))
            done.note(before, fixed, layer.print_z, layer.height)
    for layer, before, after in found:
        hand_back(layer, before, after)
    DONE.pop(ctx.object.id(), None)
    DONE[ctx.object.id()] = done
    while len(DONE) > MOST_OBJECTS:
        del DONE[next(iter(DONE))]
    return orca.ExecutionResult.success(f"layerfix: {done.message}")


def name_of(thing: Any) -> str:
    return str(getattr(thing.model_object(), "name", "") or f"object {thing.id()}")


def outlines(layer: Any) -> list[list[list[np.ndarray]]]:
    """Copies of a layer's outlines: regions of polygons of rings. The host's own die when slices are set."""
    return [
        [
            [np.array(ring.as_array()) for ring in (surface.expolygon.contour, *surface.expolygon.holes)]
            for surface in region.slices.surfaces
        ]
        for region in layer.regions()
    ]


def hand_back(layer: Any, before: Any, after: Any) -> None:
    """Set the slices of the regions that changed, and what the host derives from them."""
    for region, old, new in zip(layer.regions(), before, after, strict=True):
        if new is not old:
            polygons = [orca.host.ExPolygon(rings[0], list(rings[1:])) for rings in new]
            region.slices.set(polygons, orca.host.SurfaceType.stInternal)
    layer.make_slices()


CAPABILITIES: list[type] = [ThickenThinFeatures]

if hasattr(orca, "pages"):  # from 2.5 on

    class ThinFeaturesPage(orca.pages.PagesPluginCapabilityBase):
        """A tab of the main window: what the last slice changed."""

        def get_name(self) -> str:
            return "Thin features"

        def get_ui(self) -> str:
            return whole_page(list(DONE.values()))

        def on_message(self, message: Any) -> None:
            if isinstance(message, dict) and message.get("cmd") == "refresh":
                self.post_message({"cmd": "page", "html": body(list(DONE.values()))})

    CAPABILITIES.append(ThinFeaturesPage)


@orca.plugin
class LayerfixPlugin(orca.base):
    """What the host asks for the capabilities."""

    def register_capabilities(self) -> None:
        for capability in CAPABILITIES:
            orca.register_capability(capability)
