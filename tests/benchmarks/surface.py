"""The boundary of the voxels of a hollow ball, 795 × 795 px and 712 layers, beside scikit-image's marching cubes."""

import subprocess
import sys
import time

import numpy as np
from skimage.measure import marching_cubes

import layerfix as lf
from layerfix.surface.solids import simplified, solid_of, triangles_of
from layerfix.surface.voxels import LOSSLESS_PX, voxel_surface
from tests.benchmarks.measuring import table

SIDE, LAYERS, RADIUS_PX, WALL_PX = 795, 712, 356, 20


def shell(layers: int) -> lf.LayerStack:
    """The lowest layers of the ball, held packed."""
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    flat = x * x + y * y

    def layer(k: int) -> np.ndarray:
        distance = flat + (k - (LAYERS - 1) / 2) ** 2
        return (distance < RADIUS_PX**2) & (distance >= (RADIUS_PX - WALL_PX) ** 2)

    return lf.LayerStack.from_images((layer(k) for k in range(layers)), pixel_mm=0.05, layer_mm=0.05)


def peak_gb(code: str) -> str:
    """The most memory that a fresh process held, after it made the stack and after it ran `code`."""
    script = (
        "from tests.benchmarks import measuring; from tests.benchmarks.surface import *\n"
        f"stack = shell({LAYERS})\nbefore = measuring.peak_gb()\n{code}\nprint(before, measuring.peak_gb())"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    before, after = map(float, done.stdout.split())
    return f"{before:.2f} → {after:.2f}"


def run() -> None:
    print(f"memory, GB: stack → surface {peak_gb('voxel_surface(stack)')};", end=" ")
    print(f"with simplification {peak_gb('lf.surface_mesh(stack)')}\n")
    rows = []
    for layers in (LAYERS // 4, LAYERS // 2, LAYERS):
        stack = shell(layers)
        voxel_surface(stack[:2])
        started = time.perf_counter()
        surface = voxel_surface(stack)
        seconds = time.perf_counter() - started
        rows.append([f"voxel_surface, {layers} layers", len(surface.faces), seconds, 1e3 * seconds / layers])
    started = time.perf_counter()
    solid = solid_of(surface.vertices_mm(), surface.faces)
    assert solid is not None
    few = triangles_of(simplified(solid, LOSSLESS_PX * 0.05))[1]
    rows.append(["… simplified without loss", len(few), time.perf_counter() - started, ""])
    volume = np.pad(np.asarray(stack), 1).astype(np.float32)
    started = time.perf_counter()
    faces = marching_cubes(volume, 0.5, method="lorensen")[1]
    rows.append(["skimage, lorensen", len(faces), time.perf_counter() - started, ""])
    table(("a shell of 20 px", "triangles", "s", "ms a layer"), rows)
