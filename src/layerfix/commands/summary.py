"""What a correction came to, added up from its layers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.commands.notes import (
    told_of_conflicts,
    told_of_dimmed,
    told_of_empty_layers,
    told_of_hairlines,
    told_of_joined,
    told_of_raised,
    told_of_sheets,
    told_of_specks,
    told_of_topology,
    within_mm,
)

if TYPE_CHECKING:
    from layerfix.layers.gaps import Conflict
    from layerfix.layers.topology import TopologyChange
    from layerfix.stack import Layer, LayerStack


@dataclass(frozen=True)
class Summary:
    """What a correction came to. Percentages are of the volume before; z is where the thinnest thing is."""

    source: str
    target: str
    layers: int
    size_px: tuple[int, int]
    pixel_mm: tuple[float, float]
    min_feature_mm: float
    mode: str
    layers_changed: int
    thinnest_mm: float | None
    thinnest_z_mm: float | None
    volume_mm3: float
    added_mm3: float
    removed_mm3: float
    added_percent: float
    removed_percent: float
    layers_with_gaps: int
    longest_gap_mm: float
    seconds: float
    most_changed_layer: int = 0
    hairline_layers: int = 0
    joined: tuple[TopologyChange, ...] = ()
    topology: tuple[TopologyChange, ...] = ()
    conflicts: tuple[Conflict, ...] = ()
    notes: tuple[str, ...] = ()
    within_mm: float = 0.0  # of thinnest_mm


def add_up(
    source: Path,
    target: Path,
    stack: LayerStack,
    min_feature_mm: float,
    mode: str,
    done: list[Layer],
    started: float,
    told: list[str],
) -> Summary:
    """What came of the layers of `stack`, which are `done`. started: by time.perf_counter."""
    changes = [(layer, layer.change) for layer in done if layer.change is not None]
    pixel_mm2 = stack.pixel_mm[0] * stack.pixel_mm[1]
    heights_mm = stack.heights_mm().tolist()

    def volume(pick: Callable[[int], int]) -> float:
        return float(sum(pick(i) * heights_mm[i] for i in range(len(changes))) * pixel_mm2)

    raised = volume(lambda i: changes[i][0].raised_px)  # which the correction found there
    solid = volume(lambda i: changes[i][1].solid_px) - raised
    added = volume(lambda i: changes[i][1].added_px) + raised
    removed = volume(lambda i: changes[i][1].removed_px)
    thinnest = min(
        ((c.thinnest_mm, layer.z_mm[0]) for layer, c in changes if c.thinnest_mm is not None),
        default=(None, None),
    )
    gaps = [layer.gaps for layer in done if layer.gaps is not None]
    turned = [c.added_px + c.removed_px for _, c in changes]
    topology = tuple(sorted((t for _, c in changes for t in c.topology), key=lambda t: -t.area_mm2))
    conflicts = tuple(sorted((c for _, change in changes for c in change.conflicts), key=lambda c: c.width_mm))
    joined = tuple(one for layer in done for one in layer.joined)
    return Summary(
        source=str(source),
        target=str(target),
        layers=len(done),
        size_px=(stack.width, stack.height),
        pixel_mm=stack.pixel_mm,
        min_feature_mm=min_feature_mm,
        mode=mode,
        layers_changed=sum(t > 0 for t in turned),
        thinnest_mm=thinnest[0],
        thinnest_z_mm=thinnest[1],
        volume_mm3=solid,
        added_mm3=added,
        removed_mm3=removed,
        added_percent=100 * added / solid if solid else 0.0,
        removed_percent=100 * removed / solid if solid else 0.0,
        layers_with_gaps=len(gaps),
        longest_gap_mm=max((g.longest_mm for g in gaps), default=0.0),
        seconds=time.perf_counter() - started,
        most_changed_layer=turned.index(max(turned)) if turned else 0,
        hairline_layers=sum(layer.hairline_px > 0 for layer in done),
        joined=joined,
        topology=topology,
        conflicts=conflicts,
        notes=(
            *stack.notes,
            *told_of_empty_layers(done),
            *told_of_hairlines(done, stack.pixel_mm),
            *told_of_joined(joined),
            *told_of_sheets(done),
            *told_of_dimmed(done),
            *told_of_raised(done),
            *told_of_topology(topology),
            *told_of_conflicts(conflicts, min_feature_mm),
            *told_of_specks(done),
            *told,
        ),
        within_mm=within_mm(stack),
    )
