"""What became of the layer before: upright walls make layers that are alike, which need be worked on only once."""

from __future__ import annotations

from threading import local
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Layer

Result = TypeVar("Result")


class Latest(Generic[Result]):
    """Each thread's last layer (its pixels and small pieces, not its greys) and what became of it."""

    def __init__(self) -> None:
        self._local = local()

    def __reduce__(self) -> tuple[type[Latest[Result]], tuple[()]]:
        """A pickled one is empty."""
        return Latest, ()

    def of(self, layer: Layer) -> Result | None:
        """What `keep` was told of a layer with the same pixels and small pieces, if it was the last."""
        kept: tuple[Rows, NDArray[np.int64] | None, Result] | None = getattr(self._local, "kept", None)
        if kept is None:
            return None
        rows, small, result = kept
        if rows.shape != layer.rows.shape or not same_rows(rows, layer.rows):
            return None
        alike = small is layer.small if small is None or layer.small is None else np.array_equal(small, layer.small)
        return result if alike else None

    def keep(self, layer: Layer, result: Result) -> None:
        """Remember it instead of the one before."""
        self._local.kept = layer.rows, layer.small, result


@njit(types.boolean(ROWS, ROWS), cache=True, nogil=True)
def same_rows(rows, other):  # type: ignore[no-untyped-def]  # numba types it
    """Whether two layers of one size are alike; it stops at the first row that is not."""
    for y in range(rows.shape[0]):
        here, there, differs = rows[y], other[y], U0
        for w in range(here.shape[0]):
            differs |= here[w] ^ there[w]
        if differs != U0:
            return False
    return True
