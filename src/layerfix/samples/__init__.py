"""Seven built-in parts for demos, tests and benchmarks, drawn by code instead of shipped as files.

They stand in for the models of the paper's Table 1: the same kind of part, the same number of layers and the
same image size. The originals are other people's files, so the shapes here are our own.

>>> sample("test-part").mesh().name
'test-part'
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.mesh.triangles import Mesh
from layerfix.samples.dragon import dragon
from layerfix.samples.models import feature_plate, helical_tower, molecule, spherical_shell, threaded_cylinder
from layerfix.samples.playground import playground

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


@dataclass(frozen=True)
class Sample:
    """A built-in part and the print it is meant for.

    slices            layers of the part, `layer_mm` each
    image_px          (width, height) of every layer image, the empty margin of `margin_px` included
    pixel_mm          pixel pitch, the same on both axes
    min_feature_mm    the printer's minimum feature; the part has features below it and above it
    build             draws the raw shape, close to its final size but anywhere in space
    """

    name: str
    title: str
    slices: int
    image_px: tuple[int, int]
    build: Callable[[], Mesh]
    pixel_mm: float = 0.1
    layer_mm: float = 0.1
    min_feature_mm: float = 0.8
    margin_px: int = 10

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Extents of the part along x, y, z: the frame without its margin."""
        width, height = self.image_px
        return (
            (width - 2 * self.margin_px) * self.pixel_mm,
            (height - 2 * self.margin_px) * self.pixel_mm,
            self.slices * self.layer_mm,
        )

    def mesh(self) -> Mesh:
        """The part, its bounding box exactly from (0, 0, 0) to `size_mm`.

        Each axis is stretched by itself, by less than 2 %, so that no layer and no pixel more is needed.
        """
        raw = self.build()
        low, high = raw.bounds_mm
        # A share of the extent first: it is exactly 0 and 1 at the ends, so the corners are exact too.
        share = (raw.vertices - low) / (high - low)
        return Mesh(share * np.array(self.size_mm), raw.faces, self.name)


_ALL = (
    Sample("test-part", "Test part", 65, (583, 597), feature_plate),
    Sample("molecule", "Molecule", 383, (513, 462), molecule),
    Sample("threaded-cylinder", "Threaded cylinder", 421, (623, 632), threaded_cylinder),
    # The table's image is wider than the sphere is tall. With this margin the sphere stays round.
    Sample("spherical-shell", "Spherical shell", 712, (795, 795), spherical_shell, margin_px=41),
    Sample("playground", "Playground", 555, (1417, 1479), playground),
    Sample("dragon", "Dragon", 687, (284, 253), dragon),
    Sample("helical-tower", "Helical tower", 1472, (376, 382), helical_tower),
)
SAMPLES: Mapping[str, Sample] = {each.name: each for each in _ALL}


def sample(name: str) -> Sample:
    """The built-in part of that name. Raises InputError that lists the names for any other."""
    if name not in SAMPLES:
        raise InputError(f"no sample named '{name}'; known are {', '.join(SAMPLES)}")
    return SAMPLES[name]
