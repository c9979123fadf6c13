"""A 12K resin job, mesh → corrected → PNG: layers per second, peak memory, and the PNG codec on its own."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

import layerfix as lf
from layerfix.formats.png.encode import encode_png
from layerfix.samples import sample
from tests.benchmarks.measuring import best_of, peak_gb, table

PRINTER = "elegoo-saturn-3-ultra"


def plate_of_dragons(height_mm: float) -> lf.Mesh:
    """24 dragons that fill the plate, `height_mm` tall."""
    dragon = sample("dragon").mesh()
    x, y, z = dragon.size_mm
    dragon = dragon.transformed(np.diag([26 / x, 26 / y, height_mm / z]))
    spots = [dragon.moved((34 * i, 28 * j, 0)) for i in range(6) for j in range(4)]
    count = len(dragon.vertices)
    faces = np.concatenate([dragon.faces + count * k for k in range(len(spots))])
    return lf.Mesh(np.concatenate([s.vertices for s in spots]), faces.astype(np.int32), "24 dragons")


def job(layers: int, target: Path) -> None:
    """Slice, correct and write so many layers; print seconds and peak memory as JSON."""
    printer = lf.load_printer(PRINTER)
    mesh = plate_of_dragons(layers * printer.layer_mm)
    started = time.perf_counter()
    stack = lf.slice_mesh(mesh, pixel_mm=printer.pixel_mm, layer_mm=printer.layer_mm, frame_px=printer.pixels)
    lf.write(target, lf.correct(stack, min_feature_mm=printer.min_feature_mm, mode="add_only"), printer)
    seconds = time.perf_counter() - started
    print(
        json.dumps({"layers": len(stack), "seconds": seconds, "peak_gb": peak_gb(), "bytes": target.stat().st_size})
    )


def run() -> None:
    rows = []
    for layers in (100, 300):
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "tests.benchmarks.resin_12k", str(layers), f"{folder}/job.zip"]
            done = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        rows.append([f"{done['layers']} layers", done["seconds"], done["layers"] / done["seconds"], done["peak_gb"],
                     done["bytes"] / 1e6])  # fmt: skip
    print(
        "24 dragons on 11520 × 5120 px (19 × 24 µm), minimum feature 0.15 mm, mesh → corrected → zip of 8-bit PNG.\n"
    )
    table(("job", "seconds", "layers/s", "peak GB", "MB written"), rows)

    printer = lf.load_printer(PRINTER)
    stack = lf.slice_mesh(plate_of_dragons(15), pixel_mm=printer.pixel_mm, layer_mm=0.05, frame_px=printer.pixels)
    rows = []
    for index in (10, len(stack) // 2):
        layer = stack[index]
        grey = layer.image().astype(np.uint8) * 255
        default = best_of(5, lambda grey=grey: cv2.imencode(".png", grey))
        default_size = len(cv2.imencode(".png", grey)[1])
        for bits in (8, 1):
            ours = best_of(5, lambda layer=layer, bits=bits: encode_png(layer.rows, layer.width, bits=bits))
            size = len(encode_png(layer.rows, layer.width, bits=bits))
            rows.append([f"layer {index}, {bits}-bit", 1e3 * ours, 1e3 * default, f"{default / ours:.1f} ×",
                         size / 1e3, default_size / 1e3, f"{size / default_size:.2f} ×"])  # fmt: skip
    print("\nPNG of one such layer, one thread, against cv2.imencode at its default.\n")
    table(("layer", "ms", "cv2 ms", "faster", "kB", "cv2 kB", "size"), rows)


if __name__ == "__main__":
    job(int(sys.argv[1]), Path(sys.argv[2]))
