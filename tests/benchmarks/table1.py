"""The paper's Table 1: mesh in memory → corrected stack in memory, beside the paper's seconds."""

import os
import time

import layerfix as lf
from layerfix.samples import SAMPLES, Sample
from tests.benchmarks.measuring import table

# Seconds of Table 1, on 8 cores at 3.7 GHz, of the models that ours stand in for.
PAPER_S = {
    "test-part": 3.44,
    "molecule": 11.22,
    "threaded-cylinder": 44.78,
    "spherical-shell": 67.96,
    "playground": 187.57,
    "dragon": 4.86,
    "helical-tower": 27.75,
}


def sliced(sample: Sample, mesh: lf.Mesh) -> lf.LayerStack:
    return lf.slice_mesh(
        mesh, pixel_mm=sample.pixel_mm, layer_mm=sample.layer_mm, margin_mm=sample.margin_px * sample.pixel_mm
    )


def plain(sample: Sample, mesh: lf.Mesh) -> lf.LayerStack:
    """As the paper has it: centres of pixels at mid-planes, and its rule for spurs."""
    stack = lf.slice_mesh(
        mesh, pixel_mm=sample.pixel_mm, layer_mm=sample.layer_mm, margin_mm=sample.margin_px * sample.pixel_mm,
        hairlines=False, z_sampling="middle",
    )  # fmt: skip
    return lf.correct(stack, min_feature_mm=sample.min_feature_mm, spurs="paper")


def run() -> None:
    rows, sums = [], [0.0, 0.0, 0.0]
    for name, paper_s in PAPER_S.items():
        sample = SAMPLES[name]
        mesh = sample.mesh()
        slicing, total, papers = [], [], []
        for _ in range(3):
            started = time.perf_counter()
            layers = list(sliced(sample, mesh))
            slicing.append(time.perf_counter() - started)
            started = time.perf_counter()
            layers = list(lf.correct(sliced(sample, mesh), min_feature_mm=sample.min_feature_mm))
            total.append(time.perf_counter() - started)
            started = time.perf_counter()
            for _ in plain(sample, mesh):
                pass
            papers.append(time.perf_counter() - started)
        assert (len(layers), layers[0].width, layers[0].height) == (sample.slices, *sample.image_px)
        a, b, c = min(slicing), min(total), min(papers)
        sums = [sums[0] + a, sums[1] + b, sums[2] + c]
        rows.append([name, sample.slices, "{} × {}".format(*sample.image_px), len(mesh.faces), a, b - a, b,
                     f"{b / c:.2f} ×", paper_s, f"{paper_s / b:.0f} ×"])  # fmt: skip
    paper = sum(PAPER_S.values())
    rows.append(["all", "", "", "", sums[0], sums[1] - sums[0], sums[1], f"{sums[1] / sums[2]:.2f} ×", paper,
                 f"{paper / sums[1]:.0f} ×"])  # fmt: skip
    print(
        f"Minimum feature 8 px (0.8 mm at 0.1 mm pixels); {len(os.sched_getaffinity(0))} cores, seconds, best of 3.\n"
    )
    table(
        (
            "model",
            "slices",
            "image px",
            "triangles",
            "slicing",
            "correction",
            "total",
            "of the paper's rules",
            "paper, 8 cores",
            "ratio",
        ),
        rows,
    )
