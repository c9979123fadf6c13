"""Stacks that came from a file, for other processes: what is pickled is the file's place and how it was read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from layerfix.formats.probe import Probe
from layerfix.formats.table import function

if TYPE_CHECKING:
    from layerfix.formats.hints import Hints
    from layerfix.stack import Layer, LayerStack


@dataclass(frozen=True, eq=False)
class Reopened:
    """A file that is read once more where a pickle of its stack is opened."""

    reader: str | Callable[..., Any]
    path: Path
    hints: Hints

    @cached_property
    def stack(self) -> LayerStack:
        """Its layers. Raises InputError if the file is not there, or no longer what it was."""
        stack: LayerStack = function(self.reader)(Probe(self.path), self.hints)
        return stack

    def __reduce__(self) -> tuple[Any, ...]:
        return Reopened, (self.reader, self.path, self.hints)


@dataclass(frozen=True, eq=False)
class _Layers:
    """`make` of a stack from a file."""

    source: Reopened
    make: Callable[[int], Layer]

    def __call__(self, index: int) -> Layer:
        return self.make(index)

    def __reduce__(self) -> tuple[Any, ...]:
        return _layers, (self.source,)


def _layers(source: Reopened) -> _Layers:
    return _Layers(source, source.stack.make)


def reopened(stack: LayerStack, reader: str | Callable[..., Any], path: Path, hints: Hints) -> LayerStack:
    """The stack that `reader` gave for a file, so that it can be pickled."""
    source = Reopened(reader, path.absolute(), hints)
    container = None if stack.container is None else replace(stack.container, source=source)
    return replace(stack, make=_Layers(source, stack.make), container=container)
