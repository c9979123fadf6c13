"""The table of the page: what is worth a look, the worst first; what goes on from layer to layer is one row."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from layerfix.layers.verdict import narrowest_place
from layerfix.units import format_mm

if TYPE_CHECKING:
    from layerfix.layers.topology import TopologyChange
    from layerfix.layers.verdict import LayerVerdict
    from layerfix.stack import Layer, LayerStack

WORST = 12  # layers whose narrowest place is looked up
MOST_OF_A_KIND = 40  # rows of a kind in the table; how many more there are is said


class LayersSeen(NamedTuple):
    """What is known of every layer: the corrected one without its pixels, what merged and closed, the width at its
    narrowest place before (None: nothing was too thin), and the verdict on it if it was asked."""

    bare: Sequence[Layer]
    topology: Sequence[tuple[TopologyChange, ...]]
    thinnest_mm: Sequence[float | None]
    verdicts: Sequence[LayerVerdict]


class _Place(NamedTuple):
    kind: str
    layer: int
    box_mm: tuple[float, ...]
    text: str
    order: tuple[float, ...]


def places_of(
    stack: LayerStack, seen: LayersSeen, feature_mm: float | None
) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """(rows, the worst first: kind, layer of the worst, first and last layer, box, what to say of it; how many more
    rows of each kind there are)."""
    rows = []
    for group in _joined([*_thin(stack, seen, feature_mm), *_changed(seen), *_judged(stack, seen)]):
        worst = min(group, key=lambda one: one.order)
        layers = [one.layer for one in group]
        rows.append((worst, min(layers), max(layers)))
    rows.sort(key=lambda row: row[0].order)
    kept: list[dict[str, Any]] = []
    counts: Counter[str] = Counter()
    for worst, first, last in rows:
        counts[worst.kind] += 1
        if counts[worst.kind] <= MOST_OF_A_KIND:
            box = [round(v, 4) for v in worst.box_mm]
            kept.append({"kind": worst.kind, "layer": worst.layer, "layers": [first, last], "box_mm": box,
                         "text": worst.text})  # fmt: skip
    return kept, {kind: count - MOST_OF_A_KIND for kind, count in counts.items() if count > MOST_OF_A_KIND}


def _thin(stack: LayerStack, seen: LayersSeen, feature_mm: float | None) -> list[_Place]:
    """The narrowest place of the layers with the thinnest features."""
    if feature_mm is None:
        return []
    found = []
    for k in _apart(seen.thinnest_mm):
        spot = narrowest_place(stack, k, min_feature_mm=feature_mm, of_void=False)
        width = seen.thinnest_mm[k]
        if spot is not None and width is not None:
            found.append(_Place("thin", k, spot.box_mm, f"{format_mm(round(width, 4))} wide", (0, width)))
    return found


def _changed(seen: LayersSeen) -> list[_Place]:
    """What merged and closed, what stays thin, and what is thinner than a layer."""
    found = []
    for k, layer in enumerate(seen.bare):
        for one in seen.topology[k]:
            count = f"{one.count} parts" if one.kind == "merged" else f"{one.area_mm2:.3g} mm²"
            found.append(_Place(one.kind, k, one.box_mm, count, (1, -one.area_mm2)))
        for conflict in layer.change.conflicts if layer.change is not None else ():
            width = conflict.width_mm
            found.append(_Place("conflict", k, conflict.box_mm, f"{format_mm(round(width, 4))} wide", (2, width)))
        if layer.sheet_px:
            text = "thinner than a layer, drawn a layer thick"
            found.append(_Place("sheet", k, (), text, (4, -layer.sheet_px)))
        if layer.sheets_lost:
            text = f"{layer.sheets_lost} thinner than a quarter of a layer, left out"
            found.append(_Place("sheet", k, (), text, (3, -layer.sheets_lost)))
    return found


def _judged(stack: LayerStack, seen: LayersSeen) -> list[_Place]:
    """What would be lost, and what stands on nothing."""
    at = {z: k for k, z in enumerate(stack.z_mm[:, 0].round(6).tolist())}
    found = []
    for verdict in seen.verdicts:
        for kind, places in (("lost", verdict.lost), ("island", verdict.islands), ("speck", verdict.alone)):
            for one in places:
                layer, area = at.get(round(one.z_mm[0], 6), 0), one.area_mm2
                found.append(_Place(kind, layer, one.box_mm, f"{area:.3g} mm²", (3, -area)))
    return found


def _joined(found: Sequence[_Place]) -> list[list[_Place]]:
    """Places of one kind that go on: whose boxes meet in layers that follow one another. Those without a box stay."""
    by_layer: defaultdict[tuple[str, int], list[int]] = defaultdict(list)
    for number, place in enumerate(found):
        if place.box_mm:
            by_layer[place.kind, place.layer].append(number)
    leader = list(range(len(found)))

    def first_of(number: int) -> int:
        while leader[number] != number:
            leader[number] = leader[leader[number]]
            number = leader[number]
        return number

    for (kind, layer), above in by_layer.items():
        below = by_layer.get((kind, layer - 1))
        if not below:
            continue
        a, b = (np.array([found[n].box_mm for n in numbers]) for numbers in (above, below))
        meet = (a[:, None, :2] <= b[None, :, 2:]).all(axis=2) & (b[None, :, :2] <= a[:, None, 2:]).all(axis=2)
        for i, j in np.argwhere(meet).tolist():
            leader[first_of(above[i])] = first_of(below[j])
    groups: defaultdict[int, list[_Place]] = defaultdict(list)
    for number, place in enumerate(found):
        groups[first_of(number)].append(place)
    return list(groups.values())


def _apart(thinnest: Sequence[float | None]) -> list[int]:
    """Layers with the thinnest features, no two of them neighbours of each other."""
    thin = [(width, k) for k, width in enumerate(thinnest) if width is not None]
    apart = max(1, len(thinnest) // 50)
    chosen: list[int] = []
    for _, k in sorted(thin):
        if len(chosen) == WORST:
            break
        if all(abs(k - other) >= apart for other in chosen):
            chosen.append(k)
    return chosen
