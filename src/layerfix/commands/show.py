"""`layerfix show`: pictures of layers, before and after correction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from layerfix.commands.fix import as_asked, opened, usual_mode
from layerfix.draw.sheet import MOST_THUMBS, Pair, contact_sheet, four_panels
from layerfix.errors import InputError, OutputError
from layerfix.files import check_apart, check_input, check_target, whole_file
from layerfix.layers.correction import telling_paths
from layerfix.mesh.empty import told_of_gaps

if TYPE_CHECKING:
    from layerfix.commands.options import Options
    from layerfix.stack import Gaps, LayerStack


@dataclass(frozen=True)
class Shown:
    """What `layerfix show --json` prints: which layers are in the picture, of how many, how many changed, and what is
    to be told of the file."""

    source: str
    target: str
    layers: tuple[int, ...]
    of: int
    changed: int | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Pairs(Sequence[Pair]):
    """Layers before and after, made when they are asked for."""

    before: LayerStack
    after: LayerStack
    numbers: Sequence[int]

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, index: Any) -> Any:
        k = self.numbers[index]
        return Pair(k, self.before[k], self.after[k])


def show(
    source: Path,
    target: Path,
    index: int | None,
    options: Options,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Shown:
    """Draw one layer from all sides, or (index None) those that changed.

    Raises InputError for a layer that is not there and a source without a change, OutputError for the target.
    """
    check_input(source)
    if target.suffix.lower() != ".png":
        raise OutputError(f"{target}: the picture is written as PNG; call it .png")
    check_apart(target, source)
    check_target(target, force=options.run.force)
    stack, placed = opened(source, options)
    if index is not None and not 0 <= index < len(stack):
        raise InputError(f"{source}: layer {index} is not there; it has layers 0 to {len(stack) - 1}")
    mode = options.correction.mode or usual_mode(options.printer, stack)
    fixed = telling_paths(as_asked(stack, placed, mode, options))
    if index is not None:
        pair = Pair(index, stack[index], fixed[index])
        chosen, changed, gaps = [index], None, [pair.before.gaps]
        picture = four_panels(pair, stack.pixel_mm)
    else:
        chosen, changed, gaps = _most_changed(fixed, progress)
        if not chosen:
            raise InputError(f"{source}: correction changes none of its {len(stack)} layers; give --layer")
        picture = contact_sheet(_Pairs(stack, fixed, chosen), stack.pixel_mm)
    with whole_file(target, force=options.run.force) as file:
        picture.save(file, "PNG")
    notes = (*stack.notes, *told_of_gaps(gaps))
    return Shown(str(source), str(target), tuple(chosen), len(stack), changed, notes)


def _most_changed(
    fixed: LayerStack, progress: Callable[[int, int], None]
) -> tuple[list[int], int, list[Gaps | None]]:
    """(layers spread over those that changed, from the bottom up; how many changed; what was closed in each)."""
    changed = []
    gaps: list[Gaps | None] = []
    for k, layer in enumerate(fixed.each(lambda layer: layer.without_pixels())):
        if layer.change is not None and layer.change.added_px + layer.change.removed_px:
            changed.append(k)
        gaps.append(layer.gaps)
        progress(k + 1, len(fixed))
    count = min(len(changed), MOST_THUMBS)
    return [changed[i * len(changed) // count] for i in range(count)] if count else [], len(changed), gaps


def lines_of(shown: Shown) -> list[tuple[str, str]]:
    """What a user wants to see."""
    layers = ", ".join(map(str, shown.layers))
    rows = [("layers", f"{layers} of {shown.of}")]
    if shown.changed is not None:
        rows.append(("changed", str(shown.changed)))
    rows += [("note", note) for note in shown.notes]
    return [*rows, ("written", shown.target)]
