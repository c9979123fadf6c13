"""What the page knows of a search for a build direction: every pose that was looked at, for the map to click on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from layerfix.orientation.outcome import candidate_of

if TYPE_CHECKING:
    from layerfix.orientation.outcome import Candidate, Orientation

MOST_POSES = 4000  # of more, those that were counted in full, and the best of the others


def directions_of(found: Orientation) -> dict[str, Any]:
    """JSON of the map: docs/report.md, `orientation`. Poses turned over are there, too, if aims tell them apart."""
    both = bool(found.aims.of_shape)
    poses = [pose for pose, counts in found.seen.items() if not counts.empty]
    rows = []
    for pose in poses:
        counts = found.seen[pose]
        turns = (pose, pose.flipped()) if both else (pose,)
        rows += [_row(found, candidate_of(found.aims, found.objective, one, counts), counts.whole) for one in turns]
    rows.sort(key=lambda row: (not row["whole"], row["value"]))
    best, given = (
        {"direction": _rounded(one.direction), "changed_px": one.changed_px} for one in (found.best, found.initial)
    )
    return {
        "both": both,
        "unit": "weighted sum" if both else "px corrected",
        "best": best,
        "given": given,
        "reduction_percent": round(found.reduction_percent, 3),
        "method": found.method,
        "candidates": [_row(found, one, True) for one in found.candidates],
        "poses": rows[:MOST_POSES],
    }


def _row(found: Orientation, one: Candidate, whole: bool) -> dict[str, Any]:
    return {
        "direction": _rounded(one.direction),
        "theta_rad": _rounded(one.theta_rad),
        "value": float(f"{one.value if found.aims.of_shape else one.changed_px:.6g}"),
        "added_px": one.added_px,
        "removed_px": one.removed_px,
        "height_mm": round(one.height_mm, 3),
        "whole": whole,
    }


def _rounded(values: tuple[float, ...]) -> list[float]:
    return [round(value, 5) for value in values]
