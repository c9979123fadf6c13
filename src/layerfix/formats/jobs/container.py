"""Job files as containers of layers: the stack that reads one, and the rewrite that keeps all the rest.

Round-trip rule: every byte that is not a changed layer's payload is kept. A layer that needs no correction
keeps its original bytes, so a job that needs nothing comes out byte-identical. What depends on the solid area
(used material, volume) is recomputed by the format.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from layerfix.bits import mirrored
from layerfix.errors import InputError
from layerfix.files import whole_file
from layerfix.formats.encoding import encoded
from layerfix.formats.png.decode import Decoded
from layerfix.layers.grey_source import GreySource, seen_from_above
from layerfix.stack import Layer, LayerStack

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.formats.hints import Hints
    from layerfix.formats.options import WriteOptions
    from layerfix.layers.grey_image import Greys


@dataclass(frozen=True, eq=False)
class Frame:
    """Size, pitch and heights of a job's layers."""

    width: int
    height: int
    pixel_mm: tuple[float, float]
    z_mm: NDArray[np.float64]


@dataclass(frozen=True)
class Totals:
    """What changed in a rewritten job, for the entries that depend on it."""

    changed: bool
    added_mm3: float  # net: what was added less what was removed


@dataclass(frozen=True, eq=False)
class Container:
    """A job file as it lies on disk.

    suffixes      of its format; a rewrite goes to a file with one of them
    payload       the raw bytes of a layer by index
    decode        payload → packed rows, and the grey image if there are greys; may raise InputError
    encode        rows, or a grey image → payload, like the original one (given for its parameters)
    mirror        axes along which its images are mirrored against the part seen from above; layers are un-mirrored
                  where they become a stack and mirrored again in `rewrite`, and nothing in between knows of panels
    machine       what the job calls the machine it is for; "" if it does not say
    source        the file as `reopening.Reopened`: what is pickled
    save          write the job with some payloads replaced: (target, payload by layer index, totals)
    """

    path: Path
    suffixes: tuple[str, ...]
    payload: Callable[[int], bytes]
    decode: Callable[[int, bytes], Decoded]
    encode: Callable[[int, bytes, Rows, NDArray[np.uint8] | Greys | None], bytes]
    save: Callable[[BinaryIO, Spool, Totals], None]
    threshold: int
    grey_floor: int
    mirror: str = ""
    source: Any = None
    machine: str = ""

    def __reduce__(self) -> tuple[Any, ...]:
        return _container, (self.source,)


@dataclass(frozen=True, eq=False)
class _Source(GreySource):
    """What a layer was decoded from."""

    index: int = 0
    payload: bytes = b""


def _container(source: Any) -> Container:
    """The container of a file that is read once more."""
    container: Container = source.stack.container
    return replace(container, source=source)


class Spool:
    """New payloads of changed layers, kept in a temporary file that no one sees."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  (closed by `close`)
        self._where: dict[int, tuple[int, int]] = {}

    def add(self, index: int, data: bytes) -> None:
        self._where[index] = self._file.tell(), len(data)
        self._file.write(data)

    def __contains__(self, index: int) -> bool:
        return index in self._where

    def get(self, index: int) -> bytes | None:
        """The new payload of a layer, or None if it keeps its own."""
        if index not in self._where:
            return None
        at, size = self._where[index]
        self._file.seek(at)
        return self._file.read(size)

    def __len__(self) -> int:
        return len(self._where)

    def close(self) -> None:
        self._file.close()


def _source(container: Container, index: int, width: int) -> _Source:
    """Read and decode one layer `width` pixels wide."""
    payload = container.payload(index)
    decoded = container.decode(index, payload)
    how = width, container.threshold, container.grey_floor, container.mirror
    return _Source(
        *seen_from_above(decoded.rows, decoded.grey, *how), container.threshold, container.mirror, index, payload
    )


def container_stack(
    container: Container, frame: Frame, repeats: NDArray[np.bool_] | None = None, notes: tuple[str, ...] = ()
) -> LayerStack:
    """The layers of a job, decoded when asked for. Raises InputError naming the file for an impossible frame."""

    def make(index: int) -> Layer:
        source = _source(container, index, frame.width)
        bottom, top = frame.z_mm[index].tolist()
        return Layer(source.seen, frame.width, (bottom, top), source=source, dimmed_px=source.dimmed_px)

    origin = (0.0, frame.height * frame.pixel_mm[1])
    try:
        return LayerStack(frame.width, frame.height, frame.pixel_mm, frame.z_mm, make, origin,
                          repeats=repeats, container=container, notes=notes)  # fmt: skip
    except InputError as problem:
        raise InputError(f"{container.path}: {problem}") from problem


def rewrite(path: Path, stack: LayerStack, options: WriteOptions) -> None:
    """Write a stack that came from a container to a file of the same format, keeping whatever did not change."""
    container: Container = stack.container

    def encode(layer: Layer) -> bytes | None:
        source: _Source | None = layer.source
        if source is None:  # a layer made by someone else's function: found again by its height
            index = int(np.abs(stack.z_mm[:, 0] - layer.z_mm[0]).argmin())
            source = _source(container, index, layer.width)
        if np.array_equal(layer.rows, source.seen):
            return None
        rows = mirrored(layer.rows, layer.width, container.mirror)  # as the panel shows it
        grey = source.corrected(layer)
        return container.encode(source.index, source.payload, rows, grey)

    with whole_file(path, force=options.force) as target:
        spool = Spool(path.absolute().parent)
        try:
            added = 0.0
            area_mm2 = stack.pixel_mm[0] * stack.pixel_mm[1]
            heights = stack.heights_mm()

            def watch(index: int, layer: Layer) -> None:
                nonlocal added
                if layer.change is not None:
                    added += (layer.change.added_px - layer.change.removed_px) * area_mm2 * heights[index]
                if options.watch is not None:
                    options.watch(index, layer)

            for index, data in enumerate(encoded(stack, encode, watch, once=True)):
                if data is not None:
                    spool.add(index, data)
            if len(spool):
                container.save(target, spool, Totals(True, float(added)))
            else:
                _copy(container.path, target)
        finally:
            spool.close()


def _copy(source: Path, target: BinaryIO) -> None:
    """Every byte of the original."""
    with source.open("rb") as file:
        while block := file.read(1 << 20):
            target.write(block)


def repeats_of(same: Iterator[bool]) -> NDArray[np.bool_]:
    """`LayerStack.repeats` from "this layer is the one below", asked of every layer but the first."""
    return np.array([False, *same], np.bool_)


def bounds_of_table(
    path: Path, z_mm: list[float], hints: Hints, bounds: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """(layers, 2): bounds of the layers of a job that says a height for each.

    bounds  makes (n, 2) of (n,) rising heights
    Layers of one height are exposures of the same layer. Raises InputError for heights that fall.
    """
    z = np.array(z_mm, np.float64).round(6)
    if not np.isfinite(z).all() or (np.diff(z) < 0).any():
        raise InputError(f"{path}: the layers' heights do not rise")
    at, which = np.unique(z, return_inverse=True)
    if len(at) == 1 < len(z):
        raise InputError(f"{path}: the layers' heights do not rise")
    found: NDArray[np.float64] = hints.bounds(path, bounds(at))[which]
    return found
