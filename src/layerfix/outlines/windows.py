"""Windows on the pixel grid around places that may be too narrow: what has to be drawn of a layer.

Round each place lies an inner zone, in which changes count, and round that a border, wide enough that the cut through
the solid at the window's edge, which looks like an edge of the part, changes nothing in the inner zone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from layerfix.bits import Image

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

CELL = 16  # px: windows are made of such squares
# In widths of F and pixels. A path's pixel lies between the two sides, what F draws around it within half of F. (With
# 0.5 and 0 no pixel was missed on 120 random parts, with 0 on 40.) Thinning reaches half of F from an edge, retreat
# and cones 2.4 times that.
INNER_WIDTHS, INNER_PX = 1.0, 4.0
BORDER_WIDTHS, BORDER_PX = 2.5, 8.0
WORTH = 0.6  # of the layer: windows that are larger together become one


@dataclass(frozen=True, eq=False)
class Window:
    """Pixels from column `left`, row `top` of the grid; `inner` (height, width) bool: where changes count, None for
    everywhere."""

    left: int
    top: int
    width: int
    height: int
    inner: Image | None


def windows_of(places: Floats | None, segments: Floats, feature_px: float) -> Iterator[Window]:
    """Windows that do not overlap around all places; one around everything for None.

    places      (n, 4) left, top, right, bottom in px, each no larger than some F
    segments    (n, 4) the layer's edges in px
    feature_px  F
    """
    border = round(BORDER_WIDTHS * feature_px + BORDER_PX)
    x, y = segments[:, 0::2], segments[:, 1::2]
    left, top = int(np.floor(x.min())) - border, int(np.floor(y.min())) - border
    right, bottom = int(np.ceil(x.max())) + border + 1, int(np.ceil(y.max())) + border + 1
    if places is None:
        yield Window(left, top, right - left, bottom - top, None)
        return
    if not len(places):
        return
    inner = _cells(places, INNER_WIDTHS * feature_px + INNER_PX, left, top, right, bottom)
    rectangles = _rectangles(inner, -(-border // CELL))
    if (np.prod(rectangles[:, 2:] - rectangles[:, :2], axis=1)).sum() > WORTH * inner.size:
        rectangles = np.array([[0, 0, inner.shape[1], inner.shape[0]]])
    for x0, y0, x1, y1 in rectangles.tolist():
        cells = inner[y0:y1, x0:x1]
        yield Window(
            left + x0 * CELL, top + y0 * CELL, cells.shape[1] * CELL, cells.shape[0] * CELL,
            np.repeat(np.repeat(cells, CELL, axis=0), CELL, axis=1),
        )  # fmt: skip


def _cells(places: Floats, grown_px: float, left: int, top: int, right: int, bottom: int) -> Image:
    """(down, across) bool: the cells from (left, top) on that places reach into when grown by so much."""
    across, down = -(-(right - left) // CELL), -(-(bottom - top) // CELL)
    corner = np.array([left, top])
    first = np.floor((places[:, :2] - grown_px - corner) / CELL).astype(np.int64).clip(0, [across - 1, down - 1])
    last = np.floor((places[:, 2:] + grown_px - corner) / CELL).astype(np.int64).clip(0, [across - 1, down - 1]) + 1
    steps = np.zeros((down + 1, across + 1), np.int32)
    np.add.at(steps, (first[:, 1], first[:, 0]), 1)
    np.add.at(steps, (last[:, 1], last[:, 0]), 1)
    np.add.at(steps, (first[:, 1], last[:, 0]), -1)
    np.add.at(steps, (last[:, 1], first[:, 0]), -1)
    found: Image = steps.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
    return found


def _rectangles(inner: Image, border: int) -> Indices:
    """(n, 4) left, top, right, bottom, in cells, of rectangles that do not overlap and hold every cell with so many
    cells around it (as far as there are any)."""
    import cv2

    size = 2 * border + 1
    wide = cv2.dilate(inner.view(np.uint8), np.ones((size, size), np.uint8))
    count, _, stats, _ = cv2.connectedComponentsWithStats(wide, connectivity=8)
    boxes = stats[1:count, :4].astype(np.int64)
    boxes[:, 2:] += boxes[:, :2]
    again = True
    while again:
        again = False
        for k in range(len(boxes)):
            here = boxes[k]
            meets = ((boxes[:, :2] < here[2:]) & (boxes[:, 2:] > here[:2])).all(axis=1)
            if meets.sum() > 1:
                one = np.concatenate([boxes[meets, :2].min(axis=0), boxes[meets, 2:].max(axis=0)])
                boxes = np.concatenate([boxes[~meets], one[None]])
                again = True
                break
    return boxes
