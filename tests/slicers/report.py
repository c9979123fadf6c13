"""The results as Markdown and JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.slicers.models import MODELS
from tests.slicers.runs import Outcome, Part

Pair = tuple[Outcome, Outcome | None]
HEAD = ("model", "mode", "components dropped", "of", "layers missing", "of", "covered %", "narrow beads %", "seconds")
LEGEND = (
    "Nozzle 0.4 mm, layers 0.2 mm, solid infill. Original → corrected, both against the original's sections at the"
    " middle of each layer.\n"
    "Dropped: components of the sections with less than 5 % of their area under beads. Missing: layers without any"
    " bead. Covered: share of the\nsections' area under beads. Narrow beads: share of the volume pushed out in beads"
    " under 0.6 nozzles. Seconds: of the slicer, two at a time.\nComponents under 0.001 mm² count as specks, not as"
    " components."
)


def pairs(outcomes: Sequence[Outcome]) -> list[Pair]:
    """Original and corrected of the same model and mode, in the order of the originals."""
    corrected = {(o.model, o.mode): o for o in outcomes if o.corrected}
    return [(o, corrected.get((o.model, o.mode))) for o in outcomes if not o.corrected]


def results_table(outcomes: Sequence[Outcome]) -> str:
    """One row for each model and mode."""
    rows = []
    for pair in pairs(outcomes):
        m = pair[0].measures
        rows.append([
            pair[0].model,
            pair[0].mode,
            _both(pair, lambda o: f"{o.measures.dropped:,}"),
            f"{m.components:,}",
            _both(pair, lambda o: f"{o.measures.missing}" + ("*" if o.refused else "")),
            f"{m.layers}",
            _both(pair, lambda o: f"{o.measures.coverage_percent:.1f}"),
            _both(pair, lambda o: f"{o.measures.narrow_percent:.2f}"),
            _both(pair, lambda o: f"{o.seconds:.1f}"),
        ])  # fmt: skip
    refused = [
        f"\\* {o.mode} wrote no G-code of {o.model}, {'corrected' if o.corrected else 'original'}: {o.refused}"
        for o in outcomes
        if o.refused
    ]
    return "\n\n".join([markdown(HEAD, rows), *refused])


def parts_table(parts: Sequence[Part]) -> str:
    """What `layerfix fix` did with each model."""
    rows = [
        [
            part.name,
            MODELS[part.name].about,
            f"{len(part.sections)}",
            f"{part.specks}",
            f"{part.fix_seconds:.1f}" if part.fixed_3mf else "–",
            f"{_size(part.original)} → {_size(part.fixed_3mf)}",
            f"{_size(part.original)} → {_size(part.fixed_stl)}",
        ]
        for part in parts
    ]
    troubles = [f"{part.name}: {part.trouble}" for part in parts if part.trouble]
    head = ("model", "what", "layers", "specks", "fix to 3MF, s", "STL → 3MF, MB", "STL → STL, MB")
    return "\n\n".join([markdown(head, rows), *troubles])


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Whether the corrected parts are whole, and what is not."""
    corrected = [o for o in outcomes if o.corrected]
    if not corrected:
        return "Nothing was corrected."
    bad = [o for o in corrected if not o.measures.complete]
    whole = f"{len(corrected) - len(bad)} of {len(corrected)} corrected jobs drop no component and miss no layer."
    return "\n".join([whole, *map(_losses, bad)])


def _losses(outcome: Outcome) -> str:
    """The largest components that a job drops, and where they are."""
    largest = sorted(outcome.measures.dropped_at, key=lambda place: -place.area_mm2)[:5]
    places = [f"{p.area_mm2:.3g} mm² at ({p.x_mm:.1f}, {p.y_mm:.1f}) in layer {p.layer}" for p in largest]
    missing = [f"{outcome.measures.missing} layers missing"] if outcome.measures.missing else []
    return f"- {outcome.model} in {outcome.mode}: {', '.join([*missing, *places])}"


def as_json(versions: Sequence[str], machine: str, parts: Sequence[Part], outcomes: Sequence[Outcome]) -> Any:
    """Everything measured, in values JSON knows."""
    return {
        "slicers": list(versions),
        "machine": machine,
        "models": [
            {
                "name": part.name,
                "fix_seconds": part.fix_seconds,
                "specks": part.specks,
                "trouble": part.trouble,
                "bytes": {p.name: p.stat().st_size for p in (part.original, part.fixed_3mf, part.fixed_stl) if p},
            }
            for part in parts
        ],
        "runs": [asdict(outcome) for outcome in outcomes],
    }


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = [head, ["-" * width for width in widths], *rows]
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |"
        for line in lines
    )


def _both(pair: Pair, text: Callable[[Outcome], str]) -> str:
    """Original → corrected."""
    return " → ".join("–" if outcome is None else text(outcome) for outcome in pair)


def _size(path: Path | None) -> str:
    """In MB."""
    return f"{path.stat().st_size / 1e6:.2f}" if path else "–"
