"""FDM: outlines, toolpaths and G-code against PrusaSlicer on the same part; widths against one correction."""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import layerfix as lf
from layerfix.mesh.triangles import save_stl
from layerfix.samples import sample
from tests.benchmarks.measuring import best_of, table
from tests.making import SHARED

PRINTER = "prusa-mk3s-0.4"
SIZE_MM, LAYER_MM = (60.0, 31.0, 48.0), 0.24
PRUSA = ("prusa-slicer --loglevel 0 -g --gcode-flavor marlin2 --nozzle-diameter 0.4 --filament-diameter 1.75"
         " --skirts 1 --perimeters 2 --top-solid-layers 4 --bottom-solid-layers 4 --fill-density 20%"
         " --fill-pattern rectilinear")  # fmt: skip


def parts() -> dict[str, lf.Mesh]:
    """Two parts of the same size: a built-in one, and the best-known test part if it is there."""
    found = {"tower": sample("helical-tower").mesh(), "dragon": sample("dragon").mesh()}
    boat = SHARED / "meshes" / "benchy.3mf"
    if boat.exists():
        found["benchy"] = lf.load_mesh(boat)
    return {name: _scaled(mesh) for name, mesh in found.items()}


def _scaled(mesh: lf.Mesh) -> lf.Mesh:
    scale = [wanted / size for wanted, size in zip(SIZE_MM, mesh.size_mm, strict=True)]
    return mesh.transformed([[scale[0], 0, 0], [0, scale[1], 0], [0, 0, scale[2]]])


def _seconds(command: list[str], folder: Path, runs: int) -> float:
    best = float("inf")
    for _ in range(runs):
        started = time.perf_counter()
        subprocess.run(command, check=True, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        best = min(best, time.perf_counter() - started)
    return best


def gcode_rows(runs: int = 3) -> list[list[object]]:
    """Whole processes, STL → G-code, ours with the correction."""
    rows = []
    for name, mesh in parts().items():
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            save_stl(folder / "part.stl", mesh)
            ours = [sys.executable, "-m", "layerfix", "fix", "part.stl", "ours.gcode", "--printer", PRINTER,
                    "--layer", f"{LAYER_MM}mm", "--force"]  # fmt: skip
            theirs = [*PRUSA.split(), "--layer-height", str(LAYER_MM), "--first-layer-height", str(LAYER_MM),
                      "-o", "theirs.gcode", "part.stl"]  # fmt: skip
            fast = _seconds(ours, folder, runs)
            slow = _seconds(theirs, folder, runs) if shutil.which("prusa-slicer") else float("nan")
            kilobytes = (folder / "ours.gcode").stat().st_size / 1e3
        rows.append([name, fast, slow, f"{fast / slow:.2f} ×", kilobytes])
    return rows


def width_rows() -> list[list[object]]:
    """All layers: the widths of a nozzle, against one correction for the widest of them."""
    rows = []
    for name, mesh in parts().items():
        stack = lf.slice_mesh(mesh, pixel_mm=0.05, layer_mm=LAYER_MM)
        for step_mm in (0.05, 0.02):
            widths = best_of(5, lambda stack=stack, step_mm=step_mm: lf.suggest_widths(
                stack, min_mm=0.34, max_mm=0.8, step_mm=step_mm))  # fmt: skip
            corrected = best_of(5, lambda stack=stack: [None for _ in lf.correct(stack, min_feature_mm=0.8)])
            rows.append([f"{name}, step {step_mm} mm", 1e3 * widths, 1e3 * corrected, f"{widths / corrected:.2f} ×"])
    return rows


def contour_row() -> list[object]:
    """A part of 10 × 10 cm, 500 layers of 2,000 × 2,000 px."""
    mesh = sample("playground").mesh()
    x, y, z = mesh.size_mm
    large = mesh.transformed([[100 / x, 0, 0], [0, 100 / y, 0], [0, 0, 100 / z]])
    stack = lf.correct(lf.slice_mesh(large, pixel_mm=0.05, layer_mm=0.2), min_feature_mm=0.8)
    started = time.perf_counter()
    count = sum(len(outline.geoms) for outline in lf.trace_contours(stack))
    seconds = time.perf_counter() - started
    return [f"{len(stack)} layers of {stack.width} × {stack.height} px", seconds, count]


def run() -> None:
    print(f"STL → G-code of {' × '.join(f'{s:g}' for s in SIZE_MM)} mm, 200 layers of {LAYER_MM} mm, whole processes;"
          " ours corrects, too. Seconds.\n")  # fmt: skip
    table(("part", "layerfix", "PrusaSlicer", "ratio", "kB"), gcode_rows())
    print("\nWidths of all its layers, and one correction, both with slicing. Milliseconds.\n")
    table(("part", "suggest_widths", "correct", "ratio"), width_rows())
    print("\nOutlines of a corrected part of 10 × 10 × 10 cm, with slicing and correction.\n")
    table(("stack", "seconds", "polygons"), [contour_row()])
