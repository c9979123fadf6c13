"""What slicing leaves to be told: layers without anything, below, above and in between, and gaps that it closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from layerfix.errors import InputError
from layerfix.mesh.reading import several
from layerfix.units import counted, format_mm

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh
    from layerfix.stack import Gaps, LayerStack

SHOWN = 5  # heights that a note lists


class Ends(NamedTuple):
    """The first and the last layer that show something."""

    first: int
    last: int

    def notes(self, z_mm: NDArray[np.float64]) -> tuple[str, ...]:
        """A word about empty layers below and above; z_mm is (layers, 2)."""
        below, above = self.first, len(z_mm) - 1 - self.last
        notes = []
        if below:
            notes.append(f"{_layers(below)} empty at the bottom, up to z = {z_mm[self.first, 0]:.3f} mm:"
                         " the print would begin in the air")  # fmt: skip
        if above:
            notes.append(f"{_layers(above)} empty at the top, from z = {z_mm[self.last, 1]:.3f} mm on:"
                         " nothing there reaches a pixel's centre")  # fmt: skip
        return tuple(notes)


def told_of_ends(stack: LayerStack, mesh: Mesh) -> LayerStack:
    """The layers of a mesh with a note on those that are empty at the bottom and the top. Makes two, as a rule.

    Raises InputError, with the part's size, the pixels' and the layers', if nothing is solid anywhere.
    """
    ends = empty_ends(stack)
    if ends is None:
        layer_mm = float((stack.z_mm[:, 1] - stack.z_mm[:, 0]).min())
        size = " × ".join(f"{s:.4g}" for s in mesh.size_mm)
        raise InputError(
            f"{mesh.name}: nothing is solid in any layer: the part is {size} mm,"
            f" cut into {several(len(stack), 'layer')} of {format_mm(layer_mm)} with pixels of"
            f" {' × '.join(format_mm(p) for p in sorted(set(stack.pixel_mm)))}; its walls are thinner than a pixel,"
            f" or its surface encloses nothing{''.join(f'; {note}' for note in stack.notes)}"
        )
    return replace(stack, notes=(*stack.notes, *ends.notes(stack.z_mm)))


def empty_ends(stack: LayerStack) -> Ends | None:
    """Where the layers begin and end to show something, None if none does."""
    count = len(stack)
    first = next((k for k in range(count) if stack[k].rows.any()), None)
    if first is None:
        return None
    return Ends(first, next(k for k in range(count - 1, first - 1, -1) if k == first or stack[k].rows.any()))


def empty_between(solid: Sequence[bool], z_mm: Sequence[tuple[float, float]]) -> list[str]:
    """A word about layers without anything between others that show something: nothing holds what is above.

    solid  of each layer, whether it shows something
    z_mm   (bottom, top) of each
    """
    if True not in solid:
        return []
    first, last = solid.index(True), len(solid) - 1 - list(reversed(solid)).index(True)
    empty = [z[0] for z, full in zip(z_mm[first:last], solid[first:last], strict=True) if not full]
    if not empty:
        return []
    shown = ", ".join(f"{z:.3f}" for z in empty[:SHOWN])
    more = f" and {len(empty) - SHOWN} more" if len(empty) > SHOWN else ""
    return [f"{_layers(len(empty))} empty in the middle, at z = {shown}{more} mm: what is above hangs in the air"]


def told_of_gaps(gaps: Sequence[Gaps | None]) -> list[str]:
    """A word about an open mesh, by what was closed in each of its layers."""
    longest = [one.longest_mm for one in gaps if one is not None]
    if not longest:
        return []
    return [f"open mesh: gaps closed in {counted(len(longest), 'layer')}, the longest {format_mm(max(longest))}"]


def _layers(count: int) -> str:
    return f"{count} layer is" if count == 1 else f"{count} layers are"
