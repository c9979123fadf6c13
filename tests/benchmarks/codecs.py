"""Resin jobs: a 12K layer decoded, corrected and encoded; the run-length codes; a whole job end to end."""

import json
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
from isal import isal_zlib
from zlib_ng import zlib_ng

import layerfix as lf
from layerfix.formats.jobs import runs
from layerfix.formats.png.decode import decode_png
from layerfix.formats.png.encode import encode_png
from layerfix.layers.correction import correct_rows
from layerfix.layers.feature import feature_of_mm
from tests.benchmarks.measuring import best_of, peak_gb, table
from tests.benchmarks.resin_12k import PRINTER, plate_of_dragons

FEATURE = feature_of_mm(0.15, (0.019, 0.024))


def png_rows(name: str, image: np.ndarray) -> list[object]:
    """Decode + correct + encode of one layer that cv2 wrote, against cv2's decode + encode."""
    size = image.shape[1], image.shape[0]
    data = cv2.imencode(".png", image)[1].tobytes()

    def ours() -> bytes:
        rows = decode_png(data, "layer", size).rows
        return encode_png(correct_rows(rows, size[0], FEATURE, "add_only", "metric"), size[0])

    def theirs() -> object:
        return cv2.imencode(".png", cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE))

    inflated = zlib.decompress(_idat(data))
    inflate = best_of(5, lambda: zlib_ng.decompress(_idat(data)))
    deflate = best_of(5, lambda: isal_zlib.compress(inflated, 1))
    fast, slow = best_of(5, ours), best_of(3, theirs)
    alone = inflate + deflate
    return [name, 1e3 * fast, 1e3 * slow, f"{slow / fast:.1f} ×", 1e3 * alone, f"{fast / alone:.2f} ×"]


def _idat(data: bytes) -> bytes:
    parts, at = [], 8
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"IDAT":
            parts.append(data[at + 8 : at + 8 + size])
        at += 12 + size
    return b"".join(parts)


def run_rows(layer: lf.Layer) -> list[list[object]]:
    """The three run-length codes on one layer, in Mpx/s."""
    pixels = layer.width * layer.height / 1e6
    codes = {
        "photon": (lambda: runs.encode_photon(layer.rows, layer.width),
                   lambda data, rows: runs.decode_photon(data, layer.width, rows)),
        "CTB": (lambda: runs.encode_runs(layer.rows, layer.width, False),
                lambda data, rows: runs.decode_ctb(data, layer.width, 128, rows)),
        "GOO": (lambda: runs.encode_runs(layer.rows, layer.width, True),
                lambda data, rows: runs.decode_goo(data, layer.width, 128, rows)),
    }  # fmt: skip
    rows = []
    for name, (encode, decode) in codes.items():
        data = encode()
        written = best_of(5, encode)
        read = best_of(5, lambda decode=decode, data=data: decode(data, np.zeros_like(layer.rows)))
        rows.append([name, pixels / read, pixels / written, len(data) / 1e3])
    return rows


def make_job(layers: int, target: Path) -> None:
    """An SL1-like job of 12K layers: config.ini and one PNG a layer."""
    import zipfile

    printer = lf.load_printer(PRINTER)
    mesh = plate_of_dragons(layers * 0.05)
    stack = lf.slice_mesh(mesh, pixel_mm=printer.pixel_mm, layer_mm=0.05, frame_px=printer.pixels)
    with zipfile.ZipFile(target, "w") as job:
        job.writestr("config.ini", "jobDir = dragons\nlayerHeight = 0.05\nusedMaterial = 10.0\n")
        for index, data in enumerate(stack.each(lambda layer: encode_png(layer.rows, layer.width))):
            job.writestr(f"dragons{index:05}.png", data)


def make_greys(layers: int, target: Path) -> None:
    """The same layers as a zip of PNG with greys along all edges."""
    printer = lf.load_printer(PRINTER)
    mesh = plate_of_dragons(layers * 0.05)
    lf.write(target, lf.slice_mesh(mesh, pixel_mm=printer.pixel_mm, layer_mm=0.05, frame_px=printer.pixels,
                                   antialias=True), bits=8)  # fmt: skip


def fix_job(source: Path, target: Path) -> None:
    """Correct a job; print layers, seconds and peak memory as JSON."""
    started = time.perf_counter()
    stack = lf.read(source, pixel_mm=(0.019, 0.024), layer_mm=0.05 if source.suffix == ".zip" else None)
    lf.write(target, lf.correct(stack, min_feature_mm=0.15, mode="add_only"))
    seconds = time.perf_counter() - started
    print(json.dumps({"layers": len(stack), "seconds": seconds, "peak_gb": peak_gb()}))


def run() -> None:
    printer = lf.load_printer(PRINTER)
    stack = lf.slice_mesh(plate_of_dragons(15), pixel_mm=printer.pixel_mm, layer_mm=0.05, frame_px=printer.pixels)
    layer = stack[len(stack) // 2]
    image = layer.image().astype(np.uint8) * 255
    print("One 11520 × 5120 px layer of 24 dragons, PNG as cv2 writes it, one thread, ms.\n")
    table(("layer", "decode + correct + encode", "cv2 decode + encode", "faster",
           "zlib-ng inflate + ISA-L deflate alone", "of that"), [png_rows("24 dragons", image)])  # fmt: skip
    print("\nRun-length codes on the same layer, one thread.\n")
    table(("code", "Mpx/s read", "Mpx/s written", "kB"), run_rows(layer))
    rows = []
    for layers, make, suffix in ((100, make_job, "sl1"), (300, make_job, "sl1"), (300, make_greys, "zip")):
        with tempfile.TemporaryDirectory() as folder:
            make(layers, Path(folder, f"job.{suffix}"))
            command = [
                sys.executable,
                "-m",
                "tests.benchmarks.codecs",
                *(f"{folder}/{name}.{suffix}" for name in ("job", "fixed")),
            ]
            done = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        name = f"{done['layers']} layers{', greys' if make is make_greys else ''}"
        rows.append([name, done["seconds"], done["layers"] / done["seconds"], done["peak_gb"]])
    print("\nA job like SL1 with such layers, read, corrected (add_only, 0.15 mm) and written, all cores.\n")
    table(("job", "seconds", "layers/s", "peak GB"), rows)


if __name__ == "__main__":
    fix_job(Path(sys.argv[1]), Path(sys.argv[2]))
