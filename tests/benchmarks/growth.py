"""How the time of a correction grows with layers, pixels, feature size and workers."""

import time

import layerfix as lf
from tests.benchmarks.layers import blobs
from tests.benchmarks.measuring import table


def seconds(stack: lf.LayerStack, min_feature_px: float, workers: int = 1) -> float:
    best = float("inf")
    for _ in range(3):
        started = time.perf_counter()
        for _ in lf.correct(stack, min_feature_mm=min_feature_px * stack.pixel_mm[0]).with_workers(workers):
            pass
        best = min(best, time.perf_counter() - started)
    return best


def stack_of(count: int, width: int, height: int) -> lf.LayerStack:
    return lf.LayerStack.from_images(
        (blobs(width, height, 40, k) for k in range(count)), pixel_mm=0.05, layer_mm=0.05
    )


def run() -> None:
    base = stack_of(16, 1024, 1024)
    print("Random blobs 40 px wide, as_printed. Each table varies one thing; ms for all layers, and per unit.\n")
    rows = []
    for count in (4, 8, 16):
        t = seconds(base[:count], 20)
        rows.append([f"{count} layers", 1e3 * t, 1e3 * t / count])
    table(("1024 × 1024 px, 20 px feature", "ms", "ms a layer"), rows)
    print()
    rows = []
    for side in (512, 1024, 2048, 4096):
        t = seconds(stack_of(2, side, side), 20)
        rows.append([f"{side} × {side} px", 1e3 * t, 1e9 * t / (2 * side * side)])
    table(("2 layers, 20 px feature", "ms", "ns a pixel"), rows)
    print()
    rows = []
    for feature in (2, 5, 10, 20, 40, 60):
        t = seconds(base, feature)
        rows.append([f"{feature} px feature", 1e3 * t, 1e3 * t / feature])
    table(("16 layers of 1024 × 1024 px", "ms", "ms a px of feature"), rows)
    print()
    rows = []
    one = seconds(base, 20)
    for workers in (1, 2, 4):
        t = seconds(base, 20, workers)
        rows.append([f"{workers} workers", 1e3 * t, f"{one / t:.2f} ×"])
    table(("16 layers of 1024 × 1024 px", "ms", "speed-up"), rows)
