"""What the page's 3D view shows: the part, what was added, what was removed, each a small triangle mesh.

Coordinates are steps of 1/8191 of the body's box; vertices come in the order in which triangles first name them, as
differences, and a corner of a triangle as how far it is below the next new number. In byte planes and deflated that
is a seventh of the same as 32-bit floats (docs/report.md has the format).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.bits import pack
from layerfix.report.spans import deflated
from layerfix.surface.voxels import smoothed, voxel_surface

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from layerfix.report.spans import Spans
    from layerfix.stack import LayerStack

STEPS = 8191
MOST_TRIANGLES = 250_000  # of one body: under a megabyte in the page
MOST_SIDE = 220  # voxels of a reduced body along an axis: its surface stays under MOST_TRIANGLES on usual parts


def body(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[bytes, dict[str, Any]]:
    """A triangle mesh, coded, and what the page has to know of it."""
    named, first = np.unique(faces.ravel(), return_index=True)
    order = named[np.argsort(first)]
    number = np.empty(len(vertices), np.int64)
    number[order] = np.arange(len(order))
    corners = number[faces.ravel()]
    vertices = vertices[order]
    low = vertices.min(axis=0)
    step = np.maximum((vertices.max(axis=0) - low) / STEPS, 1e-9)
    places = np.round((vertices - low) / step).astype(np.int64)
    moves = np.diff(places, axis=0, prepend=0)
    moves = (moves << 1) ^ (moves >> 63)
    newest = np.maximum.accumulate(np.concatenate([[-1], corners[:-1]])) + 1
    data = [_planes(moves[:, axis].astype("<u2")) for axis in range(3)] + [_planes((newest - corners).astype("<u4"))]
    known = {"vertices": len(vertices), "faces": len(faces), "low_mm": low.tolist(), "step_mm": step.tolist()}
    return deflated(b"".join(data)), known


def _planes(values: NDArray[Any]) -> bytes:
    """All first bytes, all second ones, and so on."""
    return values.view(np.uint8).reshape(len(values), -1).T.tobytes()


def reduced_body(
    layers: Sequence[Spans], bounds_mm: NDArray[np.float64], stack: LayerStack
) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """(vertices in mm, faces) of layers, in blocks of voxels that are solid if any of them is; None if all are empty.

    bounds_mm  (layers, 2) bottoms and tops
    """
    solid = [spans for spans in layers if len(spans)]
    if not solid:
        return None
    low = np.min([(s[:, 1].min(), s[:, 0].min()) for s in solid], axis=0)
    high = np.max([(s[:, 2].max(), s[:, 0].max() + 1) for s in solid], axis=0)
    step = max(1, -(-int((high - low).max()) // MOST_SIDE))
    slabs = max(1, -(-len(layers) // MOST_SIDE))
    width, height = (-(-(high - low) // step)).tolist()
    images, z_mm = [], []
    for start in range(0, len(layers), slabs):
        image = np.zeros((height + 1, width + 1), np.int32)
        for spans in layers[start : start + slabs]:
            # Ends of runs as changes along a row, summed up.
            y = (spans[:, 0] - low[1]) // step
            np.add.at(image, (y, (spans[:, 1] - low[0]) // step), 1)
            np.add.at(image, (y, (spans[:, 2] - low[0] - 1) // step + 1), -1)
        images.append(pack(np.cumsum(image, axis=1)[:height, :width] > 0))
        z_mm.append((bounds_mm[start, 0], bounds_mm[min(start + slabs, len(layers)) - 1, 1]))
    from layerfix.stack import LayerStack, layer_maker

    heights = np.array(z_mm)
    corner = (stack.origin_mm[0] + low[0] * stack.pixel_mm[0], stack.origin_mm[1] - low[1] * stack.pixel_mm[1])
    blocks = LayerStack(
        width, height, (stack.pixel_mm[0] * step, stack.pixel_mm[1] * step), heights,
        layer_maker(images.__getitem__, width, heights), corner,
    )  # fmt: skip
    surface = smoothed(voxel_surface(replace(blocks, workers=1)))
    return surface.vertices_mm(), surface.faces.astype(np.int64)
