"""What the jobs that are zips of PNG images have in common: SL1, Chitubox, NanoDLP, CWS."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from layerfix.errors import InputError
from layerfix.formats.jobs.container import Container, Frame, Spool, Totals, container_stack, repeats_of
from layerfix.formats.jobs.zips import Archive
from layerfix.formats.png.decode import Decoded, decode_png
from layerfix.formats.png.encode import SIGNATURE, encode_grey_png, encode_png

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.formats.hints import Hints
    from layerfix.layers.grey_image import Greys
    from layerfix.stack import LayerStack

MAX_PANEL_PX = 1 << 28  # the largest panels have 94 million pixels
HEAD_BYTES = 33  # signature and IHDR
COLOURS = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGBA"}


def png_size(archive: Archive, name: str) -> tuple[int, int, int, int]:
    """(width, height, bit depth, colour type) from the first bytes of a PNG entry."""
    head = archive.head(name, HEAD_BYTES)
    if len(head) < HEAD_BYTES or head[:8] != SIGNATURE or head[12:16] != b"IHDR":
        raise InputError(f"{archive.path}: {name} is not a readable PNG image")
    width, height, depth, colour = struct.unpack_from(">IIBB", head, 16)
    if not 0 < width * height <= MAX_PANEL_PX:
        raise InputError(f"{archive.path}: {name} says {width} × {height} px; at most {MAX_PANEL_PX} are read")
    return width, height, depth, colour


def check_layers(archive: Archive, names: Sequence[str], colours: tuple[int, ...]) -> tuple[int, int, int]:
    """(width, height, colour type) of all layers. Raises InputError for none, several sizes, other colours."""
    if not names:
        raise InputError(f"{archive.path}: the job has no layers")
    first = png_size(archive, names[0])
    for name in names:
        width, height, _, colour = png_size(archive, name)
        if colour not in colours:
            wanted = " or ".join(COLOURS[c] for c in colours)
            raise InputError(f"{archive.path}: {name} is {COLOURS.get(colour, 'unknown')}; layers are {wanted}")
        if (width, height) != first[:2] or colour != first[3]:
            raise InputError(
                f"{archive.path}: {name} is {width} × {height} px, {names[0]} {first[0]} × {first[1]} px;"
                " all layers have one size"
            )
    return first[0], first[1], first[3]


def zip_job(
    archive: Archive,
    names: Sequence[str],
    frame: Frame,
    hints: Hints,
    suffixes: tuple[str, ...],
    metadata: Callable[[Totals, Spool], dict[str, bytes]],
    *,
    mirror: str = "",
    unpack: Callable[[bytes, str], Decoded] | None = None,
    repack: Callable[[Rows, NDArray[np.uint8] | Greys | None], bytes] | None = None,
    machine: str = "",
    notes: tuple[str, ...] = (),
) -> LayerStack:
    """The stack of a zip of PNG images.

    names     of the layers, bottom first
    metadata  entries to replace when layers have changed
    mirror    axes along which the images are mirrored against the part seen from above
    unpack, repack  for layers that are not plain grey images
    machine   that the job says it is for
    notes     what a user should know of its layers
    """
    size = frame.width, frame.height
    limit = 5 * frame.width * frame.height // 2 + (1 << 20)  # 16 bits that do not shrink, and what else there is

    def decode(index: int, payload: bytes) -> Decoded:
        where = f"{archive.path}: {names[index]}"
        return unpack(payload, where) if unpack else decode_png(payload, where, size, threshold=hints.threshold)

    def encode(index: int, payload: bytes, rows: Rows, grey: NDArray[np.uint8] | Greys | None) -> bytes:
        if repack:
            return repack(rows, grey)
        if grey is not None:
            return encode_grey_png(grey)
        return encode_png(rows, frame.width, bits=1 if payload[24] == 1 else 8)

    def save(target: BinaryIO, spool: Spool, totals: Totals) -> None:
        archive.rewrite(target, _Replaced(names, spool, metadata(totals, spool)))

    container = Container(
        archive.path, suffixes, lambda i: archive.read(names[i], limit), decode, encode, save,
        hints.threshold, hints.grey_floor, mirror, machine=machine,
    )  # fmt: skip
    same = repeats_of(archive.same(a, b) for a, b in pairwise(names))
    return container_stack(container, frame, same, notes)


class _Replaced(dict[str, bytes]):
    """Entries by name: metadata at hand, layers read from the spool when asked for."""

    def __init__(self, names: Sequence[str], spool: Spool, metadata: dict[str, bytes]) -> None:
        super().__init__(metadata)
        self._index = {name: i for i, name in enumerate(names) if i in spool}
        self._spool = spool

    def get(self, name: str, default: bytes | None = None) -> bytes | None:  # type: ignore[override]  # one form of dict.get: `Archive.rewrite` calls no other
        if name in self._index:
            return self._spool.get(self._index[name])
        return super().get(name, default)
