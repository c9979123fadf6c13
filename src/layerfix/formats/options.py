"""What a user may say about a file that is read or written: small values that belong to someone.

Each writer takes one of these and nothing else; an option that a file's writer does not take is refused, with what it
goes with (`layerfix.formats.write`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from layerfix.fdm import PathSettings
    from layerfix.fdm.settings import Seam
    from layerfix.printers import Printer
    from layerfix.stack import Layer
    from layerfix.surface.kinds import Kind

    # Told of each layer in order as it is written: its index, and the layer without its pixels.
    Watch = Callable[[int, Layer], None]


@dataclass(frozen=True)
class WriteOptions:
    """What every writer is told: for which printer, over an existing target or not, and who is told of what.

    watch  told of each layer in order: its index, and the layer without its pixels
    tell   told in a sentence what a user should know of what was written
    advance  told of what is to be done after the last layer: (done, in all)
    """

    printer: Printer | None = None
    force: bool = False
    watch: Watch | None = None
    tell: Callable[[str], None] | None = None
    advance: Callable[[int, int], None] | None = None


@dataclass(frozen=True)
class PngOptions(WriteOptions):
    """bits: 1 or 8 a pixel."""

    bits: int = 8


@dataclass(frozen=True)
class OutlineOptions(WriteOptions):
    """tolerance_mm: how far simplification may move an outline (`trace_contours`); None is half a pixel."""

    tolerance_mm: float | None = None


@dataclass(frozen=True)
class SurfaceOptions(OutlineOptions):
    """How layers become a mesh (`layerfix.surface`).

    surface       "layers", "voxels" or "smooth"; None: smooth where a mesh was sliced and corrected, else layers
    smooth        of voxels: without stairs
    only_changes  what was added and removed, in two colours, instead of all
    """

    surface: Kind | None = None
    smooth: bool | None = None
    only_changes: bool | None = None


@dataclass(frozen=True)
class CliOptions(OutlineOptions):
    """ascii: the readable form of Common Layer Interface instead of the binary one."""

    ascii: bool = False


@dataclass(frozen=True)
class GcodeOptions(WriteOptions):
    """How beads are laid.

    paths        instead of what the printer's file says
    width_mm     extrusion width, one or (layers,); the next change one thing of `PathSettings` each
    start_gcode  the code before the first layer, instead of the printer's; end_gcode: after the last
    """

    paths: PathSettings | None = None
    width_mm: ArrayLike | None = None
    perimeters: int | None = None
    density: float | None = None
    seam: Seam | None = None
    skirt_loops: int | None = None
    start_gcode: str | None = None
    end_gcode: str | None = None

    def machine(self) -> Printer | None:
        """The printer, with the start and end code that were given. Raises InputError for unknown placeholders."""
        from dataclasses import replace

        from layerfix.printers import check_gcode

        given = {key: code for key in ("start_gcode", "end_gcode") if (code := getattr(self, key)) is not None}
        for key, code in given.items():
            check_gcode(f"--{key.replace('_', '-')}", code)
        return self.printer and replace(self.printer, **given)

    def settings(self) -> PathSettings:
        """`paths`, or what the file of `printer` says, with the changes. Raises InputError for impossible ones."""
        from dataclasses import replace

        from layerfix.errors import InputError
        from layerfix.fdm import settings_for

        if self.paths is None and self.printer is None:
            raise InputError("G-code needs the printer's nozzle, bed and speeds; give a printer")
        known = self.paths or settings_for(self.printer)  # type: ignore[arg-type]  # one of the two is there
        names = ("perimeters", "density", "seam", "skirt_loops")
        changes = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if isinstance(self.width_mm, (int, float)):
            changes |= {"width_mm": self.width_mm, "first_layer_width_mm": self.width_mm}
        return replace(known, **changes)


@dataclass(frozen=True)
class WidthModelOptions(WriteOptions):
    """slicer: whose settings a .3mf of extrusion widths holds, "prusa" or "orca"."""

    slicer: str = "prusa"


class Own(TypedDict, total=False):
    """All that some writer takes, for type checkers; which one takes what is in the classes above."""

    bits: int
    tolerance_mm: float | None
    ascii: bool
    paths: PathSettings | None
    width_mm: ArrayLike | None
    perimeters: int | None
    density: float | None
    seam: Seam | None
    skirt_loops: int | None
    start_gcode: str | None
    end_gcode: str | None
    slicer: str
    surface: Kind | None
    smooth: bool | None
    only_changes: bool | None


COMMON = frozenset(field.name for field in fields(WriteOptions))


def own_options(options: type[WriteOptions]) -> tuple[str, ...]:
    """Names of what a writer takes beyond what every writer is told."""
    return tuple(field.name for field in fields(options) if field.name not in COMMON)
