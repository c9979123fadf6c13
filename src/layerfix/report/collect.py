"""What the page says: gathered in one pass over the layers before and after, a layer at a time."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix import __version__
from layerfix.errors import InputError
from layerfix.layers.topology import changes_of_rows, check_same_heights
from layerfix.mesh.empty import empty_between, told_of_gaps
from layerfix.mesh.slicing import plate_mm, sliced_mesh
from layerfix.report.bodies import MOST_TRIANGLES, body, reduced_body
from layerfix.report.places import LayersSeen, places_of
from layerfix.report.spans import CHUNK_LAYERS, Window, encoded, spans_of, window_of
from layerfix.units import format_mm

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.layers.topology import TopologyChange
    from layerfix.layers.verdict import LayerVerdict
    from layerfix.report.spans import Spans
    from layerfix.stack import Change, Layer, LayerStack

VERSION = 1
MOST_LAYERS = 1500  # shown; of more, every second, third, …
MOST_PX = 4_000_000  # of a shown layer: a screen has two million
MOST_SPANS = 30_000_000  # kept in memory, 12 bytes each; beyond it fewer layers are shown
AIR_PX = 12
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class About:
    """What is said of the input beside its layers.

    title     of the page
    input     name, bytes and sha256 of files that were read
    settings  (name, value) of what was asked for
    feature_mm  the minimum feature, if it is known
    verdicts  of `judge`, a layer each, if it was asked
    widths_mm  suggested extrusion widths, a layer each, for printers with a nozzle
    notes     what was left out, and the like
    orientation  the search for the build direction, as `layerfix.report.directions` has it
    """

    title: str
    inputs: tuple[Mapping[str, Any], ...] = ()
    settings: tuple[tuple[str, str], ...] = ()
    feature_mm: float | None = None
    verdicts: tuple[LayerVerdict, ...] = ()
    widths_mm: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()
    orientation: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class Report:
    """The page's data: what is described in docs/report.md. blobs: by name, deflated."""

    meta: dict[str, Any]
    blobs: dict[str, bytes]


@dataclass(eq=False)
class _Seen:
    """What is kept of the layers."""

    shown: list[int] = field(default_factory=list)
    before: list[Spans] = field(default_factory=list)
    changed: list[Spans] = field(default_factory=list)
    paths: list[Spans] = field(default_factory=list)
    added: list[Spans] = field(default_factory=list)
    removed: list[Spans] = field(default_factory=list)
    added_px: list[int] = field(default_factory=list)
    removed_px: list[int] = field(default_factory=list)
    solid_px: list[int] = field(default_factory=list)
    bare: list[Layer] = field(default_factory=list)
    topology: list[tuple[TopologyChange, ...]] = field(default_factory=list)

    def lists(self) -> tuple[list[Spans], ...]:
        return self.before, self.changed, self.paths, self.added, self.removed

    def thin_out(self) -> None:
        """Keep every second of the layers that are shown."""
        del self.shown[1::2]
        for spans in self.lists():
            del spans[1::2]


def file_facts(path: Path) -> dict[str, Any]:
    """Name, size and SHA-256 of a file; of a folder its name."""
    if path.is_dir():
        return {"name": path.name}
    digest = hashlib.sha256()
    size = 0
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
            size += len(block)
    return {"name": path.name, "bytes": size, "sha256": digest.hexdigest()}


def check_alike(before: LayerStack, after: LayerStack, names: tuple[str, str]) -> None:
    """Raises InputError unless two stacks have the same pixels and layers, naming both."""
    if (before.width, before.height, len(before)) != (after.width, after.height, len(after)):
        sizes = [f"{n} has {len(s)} layers of {s.width} × {s.height} px" for n, s in zip(names, (before, after),
                                                                                       strict=True)]  # fmt: skip
        raise InputError(f"{sizes[0]}, and {sizes[1]}: they are not the same layers before and after")
    check_same_heights(before, after, names)


def collect(
    before: LayerStack, after: LayerStack, about: About, progress: Progress = lambda done, total: None
) -> Report:
    """The data of a page. Raises InputError if nothing is solid in any layer.

    Memory: the runs of what is shown, and a few layers; see MOST_LAYERS, MOST_PX and MOST_SPANS.
    """
    seen = _look_at(before, after, progress)
    if not any(seen.solid_px) and not any(seen.added_px):
        raise InputError(f"{about.title}: nothing is solid in any of {len(before)} layers")
    window = window_of([*seen.before, *seen.changed], AIR_PX, MOST_PX)
    blobs, images = {}, {}
    for name, spans in (("before", seen.before), ("changed", seen.changed), ("paths", seen.paths)):
        if name != "paths" or any(map(len, spans)):
            blobs[name], offsets = encoded(spans, window)
            images[name] = {"offsets": offsets}
    bodies: dict[str, Any] = {}
    for name, mesh in _bodies(before, seen):
        blobs[f"body_{name}"], bodies[name] = body(*mesh)
    heights = before.heights_mm()
    pixel_mm2 = before.pixel_mm[0] * before.pixel_mm[1]
    added, removed = ((np.array(px) * heights * pixel_mm2) for px in (seen.added_px, seen.removed_px))
    changes = [layer.change for layer in seen.bare]
    thinnest = _thinnest(seen, about)
    layers = LayersSeen(seen.bare, seen.topology, thinnest, about.verdicts)
    places, more = places_of(before, layers, about.feature_mm)
    meta = {
        "format": "layerfix-report",
        "version": VERSION,
        "title": about.title,
        "inputs": [dict(one) for one in about.inputs],
        "made_with": {"layerfix": __version__, "Python": platform.python_version(), "numpy": np.__version__},
        "settings": [list(pair) for pair in about.settings],
        "feature_mm": about.feature_mm,
        "notes": [*_notes(before, seen), *about.notes, *_sampling_notes(before, seen, window)],
        "summary": [list(pair) for pair in _summary(before, seen, added, removed, thinnest, about)],
        "frame": _frame(before, window),
        "layers": {"count": len(before), "shown": seen.shown, "z_mm": before.z_mm.round(6).tolist()},
        "images": {"chunk_layers": CHUNK_LAYERS, **images},
        "charts": {
            "added_mm3": _rounded(added),
            "removed_mm3": _rounded(removed),
            "changed_px": [a + r for a, r in zip(seen.added_px, seen.removed_px, strict=True)],
            "thinnest_mm": thinnest,
            "width_mm": list(about.widths_mm) or None,
        },
        "places": places,
        "more_places": more,
        "looked_for": _looked_for(about, changes),
        "bodies": bodies,
        "orientation": about.orientation,
    }
    return Report(meta, blobs)


def _looked_for(about: About, changes: Sequence[Change | None]) -> str:
    """What the table says if it is empty: only what was looked for."""
    if any(change is not None for change in changes):
        return "Nothing was too thin, nothing merged or closed."
    if about.verdicts:
        return "Nothing would be lost, nothing merged or closed between the two."
    return "Nothing merged or closed between the two. What is too thin was not looked for: give --min-feature."


def _rounded(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{v:.4g}") for v in values.tolist()]


def _frame(stack: LayerStack, window: Window) -> dict[str, Any]:
    rows, columns = window.shape
    x, y = stack.pixel_mm
    return {
        "width": columns,
        "height": rows,
        "pixel_mm": [x * window.step, y * window.step],
        "corner_mm": [stack.origin_mm[0] + window.left * x, stack.origin_mm[1] - window.top * y],
        "step": window.step,
        "left_px": window.left,
        "top_px": window.top,
        "source_px": [stack.width, stack.height],
        "source_pixel_mm": [x, y],
    }


def _look_at(before: LayerStack, after: LayerStack, progress: Progress) -> _Seen:
    """Go through the layers once."""
    seen = _Seen()
    every = -(-len(before) // MOST_LAYERS)
    kept = 0
    for k, (was, now) in enumerate(_pairs(before, after)):
        added, removed = now.rows & ~was.rows, was.rows & ~now.rows
        seen.solid_px.append(was.count_px())
        seen.added_px.append(int(np.bitwise_count(added).sum()))
        seen.removed_px.append(int(np.bitwise_count(removed).sum()))
        paths = now.change.paths if now.change is not None else None
        if now.change is not None:
            seen.topology.append(now.change.topology)
        else:  # of another file: what it did is found by comparing
            seen.topology.append(
                tuple(changes_of_rows(was.rows, now.rows, before.pixel_mm, before.origin_mm, was.z_mm))
            )
        seen.bare.append(now.without_pixels())
        if k % every == 0:
            seen.shown.append(k)
            rows: tuple[Rows | None, ...] = (was.rows, added | removed, paths, added, removed)
            for spans, one in zip(seen.lists(), rows, strict=True):
                spans.append(spans_of(one) if one is not None else np.empty((0, 3), np.int32))
                kept += len(spans[-1])
            while kept > MOST_SPANS and len(seen.shown) > 2:
                seen.thin_out()
                every *= 2
                kept = sum(len(one) for spans in seen.lists() for one in spans)
        progress(k + 1, len(before))
    return seen


def _pairs(before: LayerStack, after: LayerStack) -> Iterator[tuple[Layer, Layer]]:
    yield from zip(before, after, strict=True)


def _bodies(before: LayerStack, seen: _Seen) -> Iterator[tuple[str, tuple[NDArray[np.float64], NDArray[np.int64]]]]:
    """The part (the mesh itself if it is small enough), what was added and what was removed."""
    mesh = sliced_mesh(before)
    bounds = before.z_mm[seen.shown]
    if mesh is not None and not mesh.is_clipped and len(mesh.faces) <= MOST_TRIANGLES:
        yield "part", (mesh.vertices - (0.0, 0.0, plate_mm(before)), mesh.faces.astype(np.int64))
    else:
        made = reduced_body(seen.before, bounds, before)
        if made is not None:
            yield "part", made
    for name, layers in (("added", seen.added), ("removed", seen.removed)):
        made = reduced_body(layers, bounds, before)
        if made is not None:
            yield name, made


def _notes(stack: LayerStack, seen: _Seen) -> Iterator[str]:
    """What is to be told of the layers themselves."""
    yield from stack.notes
    yield from told_of_gaps([layer.gaps for layer in seen.bare])
    solid = [before + added > 0 for before, added in zip(seen.solid_px, seen.added_px, strict=True)]
    yield from empty_between(solid, stack.z_mm.tolist())


def _sampling_notes(stack: LayerStack, seen: _Seen, window: Window) -> Iterator[str]:
    """What of the layers the page does not hold."""
    if len(seen.shown) < len(stack):
        every = seen.shown[1] - seen.shown[0] if len(seen.shown) > 1 else len(stack)
        yield f"of {len(stack)} layers, every {_ordinal(every)} is in this page; the charts and the table are of all"
    if window.step > 1:
        yield (
            f"layers are shown at {window.step} × {window.step} pixels to one, solid where any of them is;"
            " counts and volumes are of all pixels"
        )


def _ordinal(n: int) -> str:
    return {2: "second", 3: "third"}.get(n, f"{n}th")


def _summary(
    stack: LayerStack,
    seen: _Seen,
    added: NDArray[np.float64],
    removed: NDArray[np.float64],
    thinnest: Sequence[float | None],
    about: About,
) -> Iterator[tuple[str, str]]:
    """The few figures at the head of the page."""
    changed = sum(a + r > 0 for a, r in zip(seen.added_px, seen.removed_px, strict=True))
    solid = float((np.array(seen.solid_px) * stack.heights_mm()).sum()) * stack.pixel_mm[0] * stack.pixel_mm[1]
    if about.verdicts:
        lost = sum(v.features_lost for v in about.verdicts)
        yield "would be lost", f"{lost} thin feature{'s' * (lost != 1)}"
        yield "after correction", str(sum(v.features_left for v in about.verdicts))
    thin = [width for width in thinnest if width is not None]
    if thin:
        yield "thinnest", format_mm(round(min(thin), 4))
    yield "layers changed", f"{changed} of {len(stack)}"
    share = f" ({100 * added.sum() / solid:.3g} %)" if solid else ""
    yield "added", f"{added.sum():.4g} mm³{share}"
    yield "removed", f"{removed.sum():.4g} mm³"


def _thinnest(seen: _Seen, about: About) -> list[float | None]:
    """Of every layer the width at its narrowest place before, from its correction or from the verdict on it."""
    if about.verdicts:
        return [verdict.thinnest_mm for verdict in about.verdicts]
    return [layer.change.thinnest_mm if layer.change is not None else None for layer in seen.bare]
