"""What a file keeps apart within one mesh: objects, nodes and groups by name, and the colours of triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Numbers = NDArray[np.int32]

NO_COLOUR = -1


@dataclass(frozen=True, eq=False)
class Bodies:
    """Which body each triangle of a mesh is of, and its colour.

    of       (m,) int32, a number for each triangle
    names    of bodies, by number; "" for none
    items    by number: bodies with the same one are placed together, as one object on the plate
    colours  (m,) int32, 0xRRGGBB, or NO_COLOUR
    """

    of: Numbers
    names: tuple[str, ...]
    items: tuple[int, ...]
    colours: Numbers

    @property
    def has_colours(self) -> bool:
        """Whether any triangle has one."""
        return bool((self.colours != NO_COLOUR).any())


def bodies_of(sizes: Sequence[int], names: Sequence[str], colours: Sequence[Numbers]) -> Bodies | None:
    """Bodies of so many triangles each, one after the other, all placed together; None if nothing is kept apart.

    Those without triangles are none.
    """
    kept = [k for k, size in enumerate(sizes) if size]
    if len(kept) < 2 and not any((colours[k] != NO_COLOUR).any() for k in kept):
        return None
    of = np.repeat(np.arange(len(kept), dtype=np.int32), [sizes[k] for k in kept])
    each = np.concatenate([colours[k] for k in kept]).astype(np.int32)
    return Bodies(of, tuple(names[k] for k in kept), (0,) * len(kept), each)


def of_corners(corner_colours: NDArray[np.float64], faces: NDArray[np.int64] | Numbers) -> Numbers:
    """(m,) colours of triangles from (n, 3) ones of vertices, 0 to 1: that of their first corner."""
    rgb = np.rint(255 * corner_colours[faces[:, 0], :3].clip(0, 1)).astype(np.int32)
    packed: Numbers = (rgb[:, 0] << 16) | (rgb[:, 1] << 8) | rgb[:, 2]
    return packed


def rgb_of(colours: Numbers) -> NDArray[np.uint8]:
    """(n, 3) red, green, blue of packed colours; what has none is light grey."""
    filled = np.where(colours == NO_COLOUR, 0xCCCCCC, colours)
    return np.stack([filled >> 16 & 255, filled >> 8 & 255, filled & 255], axis=1).astype(np.uint8)


def apart_by_colour(
    vertices: NDArray[np.float64], faces: Numbers, colours: Numbers
) -> tuple[NDArray[np.float64], Numbers, NDArray[np.uint8]]:
    """(vertices, faces, (n, 3) colours of vertices): a vertex where colours meet is there once for each of them."""
    keys = np.column_stack([faces.reshape(-1), np.repeat(colours, 3)])
    each, number = np.unique(keys, axis=0, return_inverse=True)
    return vertices[each[:, 0]], number.reshape(-1, 3).astype(np.int32), rgb_of(each[:, 1].astype(np.int32))
