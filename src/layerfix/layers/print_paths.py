"""What F prints of a layer, and which paths it has to draw besides: the method in one kernel, but for the drawing."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from numba import types

from layerfix.bits import U0
from layerfix.kernels import know, njit
from layerfix.layers.drawing import anchor_columns, draw_paths, find_paths, open_columns
from layerfix.layers.metric.levels import PLAN
from layerfix.layers.metric.rule import ZEROS, zeros_needed
from layerfix.layers.metric.tiles import IMAGES
from layerfix.layers.morphology import HALF_WIDTHS
from layerfix.layers.skeleton import skeleton_columns, spur_numbers

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from layerfix.layers.columns import Room
    from layerfix.layers.feature import Feature
    from layerfix.layers.skeleton import Spurs

SOLID, ANCHOR, SKELETON, PRINTED, PATHS = range(5)  # of the images of a layer, as columns of one box
IMAGES_OF_LAYER = 9  # those, and four to work in
TOOL = types.Tuple((HALF_WIDTHS, types.int64, types.int64, types.boolean, types.boolean, types.float64))


class Tool(NamedTuple):
    """F and the spur rule, as kernels take them (TOOL and PLAN)."""

    values: tuple[Any, ...]
    plan: tuple[Any, ...]


@njit
def _misses_any(solid, printed):  # type: ignore[no-untyped-def]  # numba types it
    """Whether S has a pixel that is not printed."""
    lost = U0
    for w in range(solid.shape[0]):
        here, there = solid[w], printed[w]
        for y in range(here.shape[0]):
            lost |= here[y] & ~there[y]
    return lost != U0


@njit(types.boolean(IMAGES, TOOL, PLAN, ZEROS, types.boolean, types.boolean), cache=True, nogil=True)
def find_printed(images, tool, plan, zeros, whole, draw):  # type: ignore[no-untyped-def]  # numba types it
    """Of the first image, S: PRINTED = S ∘ F, and PATHS to draw besides; True if there are any.

    images  IMAGES_OF_LAYER of them
    zeros   `zeros_needed` words, all 0, and all 0 again afterwards
    whole   SKELETON is wanted, too: otherwise it is not made where S ∘ F misses nothing and F is by size
    draw    PRINTED gets what F draws along the paths, too
    """
    half_widths, bx, by, by_size, metric, rounds = tool
    solid, anchor, skeleton = images[SOLID], images[ANCHOR], images[SKELETON]
    printed, paths = images[PRINTED], images[PATHS]
    scratch = images[PATHS + 1 :]
    anchor_columns(solid, half_widths, bx, by, anchor, scratch[0])
    open_columns(anchor, half_widths, printed, scratch[0])
    if by_size and not whole and not _misses_any(solid, printed):
        for w in range(paths.shape[0]):
            for y in range(paths.shape[1]):
                paths[w, y] = U0
        return False
    skeleton_columns(solid, anchor, half_widths, bx, by, metric, rounds, plan, skeleton, scratch, zeros)
    found = find_paths(solid, skeleton, anchor, printed, half_widths, bx, by, by_size, paths)
    if found and draw:
        draw_paths(paths, printed, half_widths, bx, by, scratch[0])
    return found


@lru_cache(maxsize=32)
def tool_of(feature: Feature, spurs: Spurs) -> Tool:
    """What `find_printed` works with."""
    metric, rounds, plan = spur_numbers(feature, spurs)
    tool = Tool((feature.half_widths, *feature.block, feature.by_size, metric, rounds), plan)
    know(tool.values, TOOL, zeros_needed, find_printed)
    return tool


def printed_and_paths(
    images: NDArray[np.uint64], tool: Tool, room: Room, *, whole: bool = False, draw: bool = False
) -> bool:
    """`find_printed` with the working memory of a thread."""
    zeros = room.zeros(zeros_needed(tool.plan, *images.shape[1:]))
    found = bool(find_printed(images, tool.values, tool.plan, zeros, whole, draw))
    room.emptied(zeros)
    return found
