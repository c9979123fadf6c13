"""The laws of the method on random images: ``python -m tests.laws 100000`` (a law each line, with what it cost).

The suite runs the same on fewer (`tests/test_laws.py`). Images that break a law are told by their seed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np
from scipy import ndimage

from layerfix import LayerStack, correct, correct_image, meso_skeleton
from tests import slow_metric, slow_twin
from tests.pictures_as_text import KINDS, WIDTHS, drawing, framed

Law = Callable[[np.ndarray, tuple[float, float], str, np.random.Generator], bool]


def skeleton_keeps_topology(image: np.ndarray, size: tuple[float, float], spurs: str, _: np.random.Generator) -> bool:
    """M ⊆ M̂ ⊆ S, and M̂ has S's components (8-connected) and holes (4-connected void)."""
    skeleton = meso_skeleton(image, min_feature_px=size, spurs=spurs)
    anchor = slow_metric.anchor_of(image, *size)
    return (
        not (skeleton & ~image).any()
        and not (anchor & ~skeleton).any()
        and slow_twin.topology(skeleton) == slow_twin.topology(image)
    )


def result_is_printable(image: np.ndarray, size: tuple[float, float], spurs: str, _: np.random.Generator) -> bool:
    """Ŝ ∘ F = Ŝ, and nothing that was printable is gone: S ∘ F ⊆ Ŝ."""
    fixed = correct_image(image, min_feature_px=size, spurs=spurs)
    tool = _tool(size)
    return (
        np.array_equal(ndimage.binary_opening(fixed, tool), fixed)
        and not (ndimage.binary_opening(image, tool) & ~fixed).any()
    )


def adding_only_adds(image: np.ndarray, size: tuple[float, float], spurs: str, _: np.random.Generator) -> bool:
    """In mode add_only the result is S ∪ Ŝ."""
    added = correct_image(image, mode="add_only", min_feature_px=size, spurs=spurs)
    return np.array_equal(added, image | correct_image(image, min_feature_px=size, spurs=spurs))


def moved_in_moved_out(image: np.ndarray, size: tuple[float, float], spurs: str, random: np.random.Generator) -> bool:
    """A layer that is moved by whole pixels comes out moved."""
    down, right = random.integers(0, 9), random.integers(0, 70)
    moved = np.pad(image, ((down, 0), (right, 0)))
    fixed = correct_image(image, min_feature_px=size, spurs=spurs)
    return np.array_equal(correct_image(moved, min_feature_px=size, spurs=spurs)[down:, right:], fixed)


def kept_gaps_keep_topology(
    image: np.ndarray, size: tuple[float, float], spurs: str, random: np.random.Generator
) -> bool:
    """With gaps kept Ŝ has S's components and holes, and nothing is added that the method would not add."""
    mode = random.choice(["as_printed", "add_only"])
    free, kept = (_through_stack(image, size, spurs, mode, gap) for gap in (None, float(random.integers(1, 4))))
    return slow_twin.topology(kept) == slow_twin.topology(image) and not (kept & ~free).any()


def nothing_is_added_where_it_is_kept_out(
    image: np.ndarray, size: tuple[float, float], spurs: str, random: np.random.Generator
) -> bool:
    """Whatever is kept free."""
    free = random.random(image.shape) < random.choice([0.02, 0.3])
    free = ndimage.binary_dilation(free, iterations=int(random.integers(1, 4)))
    stack = LayerStack.from_images([free], pixel_mm=1.0, layer_mm=1.0)
    kept = _through_stack(image, size, spurs, "add_only", None, stack)
    return not (kept & ~image & free).any()


LAWS: tuple[Law, ...] = (
    skeleton_keeps_topology,
    result_is_printable,
    adding_only_adds,
    moved_in_moved_out,
    kept_gaps_keep_topology,
    nothing_is_added_where_it_is_kept_out,
)


def _tool(size: tuple[float, float]) -> np.ndarray:
    offsets = np.array(list(slow_metric.feature_offsets(*size)))
    low, high = offsets.min(axis=0), offsets.max(axis=0)
    tool = np.zeros((high - low + 1)[::-1], bool)
    tool[offsets[:, 1] - low[1], offsets[:, 0] - low[0]] = True
    return tool


def _through_stack(
    image: np.ndarray, size: tuple[float, float], spurs: str, mode: str, gap: float | None, keep_out: object = None
) -> np.ndarray:
    """By `correct`, with F in mm: pixels of 1 mm, or as much longer along y as F is flatter."""
    pixel = (1.0, size[0] / size[1])
    stack = LayerStack.from_images([image], pixel_mm=pixel, layer_mm=1.0)
    if keep_out is not None:
        keep_out = LayerStack.from_images([keep_out[0].image()], pixel_mm=pixel, layer_mm=1.0)
    gap_mm = None if gap is None else gap * max(pixel)
    fixed = correct(stack, min_feature_mm=size[0], mode=mode, spurs=spurs, keep_gaps_mm=gap_mm, keep_out=keep_out)
    return fixed[0].image()


def case(seed: int) -> tuple[np.ndarray, tuple[float, float], str, np.random.Generator]:
    """An image with void around it, F's size, a rule, and what else is chosen at random."""
    random = np.random.default_rng(seed)
    kind = list(KINDS.values())[random.integers(len(KINDS))]
    image = kind(random, int(random.integers(1, 41)), int(random.choice(WIDTHS)))
    sizes = random.uniform(2, 14, 2) if random.random() < 0.5 else random.integers(2, 15, 2).astype(float)
    size = (float(sizes[0]), float(sizes[0] if random.random() < 0.7 else sizes[1]))
    margin = int(max(size)) + 3
    return framed(image, margin), size, str(random.choice(["metric", "metric", "paper"])), random


def broken(law: Law, seeds: range) -> list[int]:
    """The seeds whose image breaks the law."""
    return [seed for seed in seeds if not law(*case(seed))]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("images", type=int, nargs="?", default=2000)
    parser.add_argument("--seed", type=int, default=0, help="of the first image")
    parser.add_argument("--draw", type=int, metavar="SEED", help="only show this image")
    given = parser.parse_args()
    if given.draw is not None:
        image, size, spurs, _ = case(given.draw)
        print(f"F {size}, {spurs}\n{drawing(image)}")
        return 0
    worst = 0
    for law in LAWS:
        began = time.perf_counter()
        found = broken(law, range(given.seed, given.seed + given.images))
        took = time.perf_counter() - began
        print(f"{law.__name__:40} {len(found):6} broken of {given.images}, {1000 * took / given.images:.1f} ms each",
              flush=True)  # fmt: skip
        if found:
            print(f"  seeds {', '.join(map(str, found[:20]))} (drawn by --draw SEED)")
        worst = max(worst, len(found))
    return 1 if worst else 0


if __name__ == "__main__":
    sys.exit(main())
