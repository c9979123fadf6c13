"""Numbers of a glTF file: accessors over views of buffers. Specification: glTF 2.0, section 3.6."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from layerfix.mesh.reading import unreadable

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MOST_ZEROS = 1_000_000  # elements of an accessor that is stored nowhere


class Buffers:
    """The buffers of a document, None for those without data, and what is in them."""

    def __init__(self, path: Path, document: dict[str, Any], buffers: list[bytes | None]) -> None:
        self._path, self._document, self._buffers = path, document, buffers

    def is_stored(self, number: int) -> bool:
        """Whether an accessor has data of its own, uncompressed."""
        accessor = self._document["accessors"][number]
        return "bufferView" in accessor or "sparse" in accessor

    def values(self, number: int) -> NDArray[np.float64]:
        """(count, width) of an accessor as floats; normalized integers as the fractions they stand for."""
        accessor, raw = self._raw(number)
        values = raw.astype(np.float64)
        if accessor.get("normalized") and raw.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(raw.dtype).max, -1.0)
        return values

    def indices(self, number: int) -> NDArray[np.int64]:
        """(count,) of a scalar accessor."""
        return self._raw(number)[1].reshape(-1).astype(np.int64)

    def _raw(self, number: int) -> tuple[dict[str, Any], NDArray[Any]]:
        if number < 0:
            raise ValueError(f"accessor {number}")
        accessor = self._document["accessors"][number]
        count, width = int(accessor["count"]), WIDTHS[accessor["type"]]
        dtype = np.dtype(COMPONENTS[accessor["componentType"]])
        if "bufferView" in accessor:
            values = self._view(accessor["bufferView"], int(accessor.get("byteOffset", 0)), count, width, dtype)
        elif 0 <= count <= MOST_ZEROS:
            values = np.zeros((count, width), dtype)
        else:
            raise ValueError(f"accessor {number} has {count} elements and no data")
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            some = int(sparse["count"])
            where, what = sparse["indices"], sparse["values"]
            kind = np.dtype(COMPONENTS[where["componentType"]])
            places = self._view(where["bufferView"], int(where.get("byteOffset", 0)), some, 1, kind).reshape(-1)
            values = values.copy()
            values[places] = self._view(what["bufferView"], int(what.get("byteOffset", 0)), some, width, dtype)
        return accessor, values

    def _view(self, number: int, offset: int, count: int, width: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        """(count, width) elements of a view, from a byte of it on."""
        if number < 0 or offset < 0 or count < 0:
            raise ValueError(f"view {number}, offset {offset}, count {count}")
        view = self._document["bufferViews"][number]
        data = self._buffers[view["buffer"]]
        compressed = next((name for name in MESHOPT if name in (view.get("extensions") or {})), None)
        if data is None and compressed:
            raise unreadable(
                self._path, "glTF", f"its geometry is compressed with meshopt ({compressed}), which is not read;"
                " export it without compression"
            )  # fmt: skip
        if data is None:
            raise unreadable(self._path, "glTF", f"buffer {view['buffer']} has no data")
        start, length = int(view.get("byteOffset", 0)), int(view["byteLength"])
        size = width * dtype.itemsize
        stride = int(view.get("byteStride") or size)
        needed = offset + (count - 1) * stride + size if count else 0
        if start < 0 or needed > length or start + length > len(data) or stride < size:
            raise unreadable(
                self._path, "glTF", f"cut short: view {number} reaches past its buffer of {len(data)} bytes"
            )
        flat = np.frombuffer(data, np.uint8)[start + offset :]
        rows = np.lib.stride_tricks.as_strided(flat, (count, size), (stride, 1), writeable=False)
        return np.ascontiguousarray(rows).view(dtype).reshape(count, width)
