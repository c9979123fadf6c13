"""Panels whose three sub-pixels are pixels of their own: three LCD pixels in each RGB pixel of the image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import unpack
from layerfix.errors import InputError
from layerfix.formats.png.decode import Decoded

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.layers.grey_image import Greys


def rgb_unpacker(size: tuple[int, int], threshold: int, *, bgr: bool) -> Callable[[bytes, str], Decoded]:
    """A decoder of RGB images (width / 3) as layers of `size` (width, height). bgr: blue is the leftmost."""

    def decode(data: bytes, where: str) -> Decoded:
        import cv2

        from layerfix.layers.greys import pack_from

        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)  # blue, green, red
        if image is None:
            raise InputError(f"{where}: not a readable PNG image")
        if (image.shape[1] * 3, image.shape[0]) != size:
            raise InputError(f"{where}: {image.shape[1]} × {image.shape[0]} RGB px, not {size[0] // 3} × {size[1]}")
        ordered = image if bgr else image[:, :, ::-1]
        grey = np.ascontiguousarray(ordered, np.uint8).reshape(size[1], size[0])
        has_greys = bool(((grey != 0) & (grey != 255)).any())
        return Decoded(pack_from(grey, threshold), grey if has_greys else None)

    return decode


def rgb_packer(size: tuple[int, int], *, bgr: bool) -> Callable[[Rows, NDArray[np.uint8] | Greys | None], bytes]:
    """The encoder that `rgb_unpacker` undoes."""

    def encode(rows: Rows, grey: NDArray[np.uint8] | Greys | None) -> bytes:
        import cv2

        flat = np.where(unpack(rows, size[0]), np.uint8(255), np.uint8(0)) if grey is None else np.asarray(grey)
        image = flat.reshape(size[1], size[0] // 3, 3)
        ordered = image if bgr else np.ascontiguousarray(image[:, :, ::-1])
        data: bytes = cv2.imencode(".png", ordered)[1].tobytes()
        return data

    return encode
