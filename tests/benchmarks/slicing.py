"""Slicing: what looking between pixels and between planes costs, beside plain cuts in the same run."""

import os
from pathlib import Path
from typing import Any

import layerfix as lf
from layerfix.samples import SAMPLES
from tests.benchmarks.measuring import best_of, table

WAYS: tuple[dict[str, Any], ...] = (
    {"hairlines": False, "z_sampling": "middle"},
    {"z_sampling": "middle"},
    {},
    {"z_sampling": "overlap"},
)
# Other people's parts, if they are there, with pixel and layer in mm: a folder in $LAYERFIX_MESHES.
OTHERS = {
    "benchy.3mf": (0.05, 0.1),
    "dodeca_chain.3mf": (0.05, 0.1),
    "castle_cathedral.stl": (0.1, 0.2),
    "heatwave_2.stl": (0.1, 0.2),
    "dragon_bronze.stl": (0.05, 0.1),
}


def run() -> None:
    parts = {name: (sample.mesh(), sample.pixel_mm, sample.layer_mm) for name, sample in SAMPLES.items()}
    if folder := os.environ.get("LAYERFIX_MESHES"):
        parts |= {name: (lf.load_mesh(Path(folder) / name), *steps) for name, steps in OTHERS.items()}
    rows = []
    for name, (mesh, pixel_mm, layer_mm) in parts.items():
        stacks = [lf.slice_mesh(mesh, pixel_mm=pixel_mm, layer_mm=layer_mm, **way) for way in WAYS]
        joined = sum(change.count - 1 for layer in stacks[1] for change in layer.joined)

        def all_layers(
            way: dict[str, Any], mesh: Any = mesh, steps: tuple[float, float] = (pixel_mm, layer_mm)
        ) -> None:
            for _ in lf.slice_mesh(mesh, pixel_mm=steps[0], layer_mm=steps[1], **way).with_workers(1):
                pass

        plain, hairlines, rescue, overlap = (best_of(5, lambda way=way: all_layers(way)) for way in WAYS)
        rows.append([name, len(stacks[0]), f"{stacks[0].width} × {stacks[0].height}", plain, hairlines,
                     f"{hairlines / plain:.2f} ×", rescue, f"{rescue / hairlines:.2f} ×", overlap,
                     f"{overlap / hairlines:.2f} ×", joined])  # fmt: skip
    print("Seconds of one thread, best of 5.\n")
    table(
        ("part", "layers", "px", "plain", "with hairlines", "of plain", "rescue", "of that with hairlines", "overlap",
         "of the same", "pieces joined"),
        rows,
    )  # fmt: skip
