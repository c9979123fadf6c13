"""The OrcaSlicer plugin on the stand-in host: what a layer costs, with layers of other people's models, scaled to
200 mm across; and the same layers corrected as whole images."""

import sys
import time
from pathlib import Path

import numpy as np

import layerfix as lf
from layerfix.layers.correction import correct_rows
from layerfix.layers.feature import feature_of_mm
from tests import orca_host as host
from tests.benchmarks.measuring import table
from tests.making import SHARED
from tests.outlines_drawn import UNIT_MM, rings

MODELS = ("benchy.3mf", "castle_cathedral.stl")
ACROSS_MM, PIXEL_MM, LAYERS = 200.0, 0.05, 80


def run() -> None:
    sys.path.insert(0, str(Path(__file__).parents[2] / "plugin" / "orca"))
    step, _ = host.Host().load("layerfix_orca")
    rows = []
    for name in MODELS:
        path = SHARED / "meshes" / name
        if not path.exists():
            print(f"({name} is not there)")
            continue
        mesh = lf.load_mesh(path)
        mesh = lf.Mesh(mesh.vertices * ACROSS_MM / max(mesh.size_mm[:2]), mesh.faces)
        stack = lf.slice_mesh(mesh, pixel_mm=PIXEL_MM, layer_mm=mesh.size_mm[2] / LAYERS, z_sampling="middle")
        contours = lf.trace_contours(stack)
        outlines = [[rings(contours[k], UNIT_MM)] for k in range(len(stack))]
        rows += [[f"{name}, F = {mm} mm", *measured(step, stack, outlines, mm)] for mm in (0.4, 0.84)]
    print(f"Milliseconds a layer ({ACROSS_MM:g} mm across, pixels of {PIXEL_MM} mm), one thread.\n")
    table(
        ("model", "layers with nothing thin", "mean", "worst", "others", "mean", "worst", "as whole images, mean"),
        rows,
    )


def measured(step: host.PythonPluginBase, stack: lf.LayerStack, outlines: list, feature_mm: float) -> list[object]:
    """Of one object, layer by layer, each as an object of its own: the best of three calls."""
    step.save_config(f'{{"min_feature_mm": {feature_mm}, "pixel_mm": {PIXEL_MM}}}')
    memory = sys.modules["layerfix_orca"].MEMORY
    quiet, busy = [], []
    for regions in outlines:
        best = np.inf
        for _ in range(3):
            memory._kept.clear()
            layer = host.Layer(0.2, 0.2, regions)
            thing = host.PrintObject([layer])
            context = host.Context(host.Step.posSlice, host.Print([thing], {}), thing)
            started = time.perf_counter()
            step.execute(context)
            best = min(best, time.perf_counter() - started)
        (busy if layer.made else quiet).append(1e3 * best)
    feature = feature_of_mm(feature_mm, stack.pixel_mm)
    images = []
    for layer in stack[::8]:
        started = time.perf_counter()
        correct_rows(layer.rows, layer.width, feature, "add_only", "metric")
        images.append(1e3 * (time.perf_counter() - started))

    def two(times: list[float]) -> tuple[float | str, float | str]:
        return (float(np.mean(times)), max(times)) if times else ("–", "–")

    return [len(quiet), *two(quiet), len(busy), *two(busy), float(np.mean(images))]
