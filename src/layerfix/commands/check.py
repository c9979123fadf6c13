"""The verdict before printing: what a printer would lose of a mesh, a job or images, and where."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.commands.axes import AxisVerdict, check_axes, judge_across, line_of
from layerfix.commands.fix import as_asked, opened, usual_mode
from layerfix.commands.machines import hint_of, job_printers
from layerfix.commands.notes import is_sheet, thinner_than_layers, told_of_joined, within_mm
from layerfix.commands.options import min_feature_of
from layerfix.commands.pages import check_page, report_on
from layerfix.errors import InputError
from layerfix.files import check_input
from layerfix.layers.verdict import judge, narrowest_place
from layerfix.mesh.slicing import sliced_mesh
from layerfix.units import counted, format_mm

if TYPE_CHECKING:
    from layerfix.commands.options import Options
    from layerfix.layers.topology import TopologyChange
    from layerfix.layers.verdict import LayerVerdict, Place

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Verdict:
    """What `layerfix check --json` prints: docs/check.md says it key by key. ok: nothing would be lost."""

    schema_version: int
    source: str
    ok: bool
    layers: int
    size_px: tuple[int, int]
    pixel_mm: tuple[float, float]
    min_feature_mm: float
    features_lost: int
    features_left: int
    parts_lost: int
    layers_with_loss: int
    lost_mm3: float
    thinnest_mm: float | None
    thinnest_z_mm: float | None
    thinnest_at: Place | None
    thinnest_gap_mm: float | None
    thinnest_gap_z_mm: float | None
    thinnest_gap_at: Place | None
    within_mm: float
    merged: int
    closed: int
    islands: tuple[Place, ...]
    specks: tuple[Place, ...]
    lost: tuple[Place, ...]
    topology: tuple[TopologyChange, ...]
    hairline_layers: int
    sheet_layers: int
    joined: tuple[TopologyChange, ...]
    sheets_lost: int
    layers_with_gaps: int
    longest_gap_mm: float
    notes: tuple[str, ...]
    by_layer: tuple[LayerVerdict, ...]
    across: tuple[AxisVerdict, ...] = ()


def check(
    source: Path,
    options: Options,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    axes: str = "z",
) -> Verdict:
    """Judge `source` at the minimum feature. Raises InputError as `fix` does; nothing is written but a report.

    axes  along which a mesh is sliced: "z", or "xyz" for what layers cannot see
    """
    across = check_axes(axes)
    check_input(source)
    page = options.run.report
    if page is not None:
        check_page(page, source, None, force=options.run.force)
    stack, placed = opened(source, options)
    stack = stack.with_workers(options.run.workers)
    min_feature_mm = min_feature_of(options, lambda: hint_of(source, job_printers(stack)))
    mode = options.correction.mode or usual_mode(options.printer, stack)
    spurs = options.correction.spurs or "metric"
    layers = []
    for verdict in judge(stack, min_feature_mm=min_feature_mm, add_only=mode == "add_only", spurs=spurs):
        layers.append(verdict)
        progress(len(layers), len(stack))
    if page is not None:
        after = as_asked(stack, placed, mode, options)
        report_on(source, stack, after, page, options, mode, verdicts=layers, progress=progress)
    others = []
    if across:
        mesh = sliced_mesh(stack)
        if mesh is None:
            raise InputError(f"{source}: layers are seen along z alone; --axes goes with meshes")
        pitch_mm, workers = min(stack.pixel_mm), options.run.workers
        others = [judge_across(mesh, axis, pitch_mm, min_feature_mm, spurs, workers, progress) for axis in across]
    thin = [one for one in layers if one.thinnest_mm is not None]
    narrow = min(thin, key=lambda one: one.thinnest_mm or 0.0, default=None)
    gaps = [one for one in layers if one.thinnest_gap_mm is not None]
    gap = min(gaps, key=lambda one: one.thinnest_gap_mm or 0.0, default=None)

    def place(of: LayerVerdict | None, of_void: bool) -> Place | None:
        if of is None:
            return None
        return narrowest_place(stack, layers.index(of), min_feature_mm=min_feature_mm, of_void=of_void, spurs=spurs)

    topology = sorted((change for one in layers for change in one.topology), key=lambda change: -change.area_mm2)
    lost = sorted((place for one in layers for place in one.lost), key=lambda place: -place.area_mm2)
    return Verdict(
        schema_version=SCHEMA_VERSION,
        source=str(source),
        ok=not any(one.features_lost or one.lost or one.sheets_lost for one in layers)
        and not any(one.features_lost for one in others),
        layers=len(layers),
        size_px=(stack.width, stack.height),
        pixel_mm=stack.pixel_mm,
        min_feature_mm=min_feature_mm,
        features_lost=sum(one.features_lost for one in layers),
        features_left=sum(one.features_left for one in layers),
        parts_lost=len(lost),
        layers_with_loss=sum(bool(one.features_lost or one.lost) for one in layers),
        lost_mm3=sum(one.lost_mm2 * (one.z_mm[1] - one.z_mm[0]) for one in layers),
        thinnest_mm=narrow.thinnest_mm if narrow else None,
        thinnest_z_mm=narrow.z_mm[0] if narrow else None,
        thinnest_at=place(narrow, False),
        thinnest_gap_mm=gap.thinnest_gap_mm if gap else None,
        thinnest_gap_z_mm=gap.z_mm[0] if gap else None,
        thinnest_gap_at=place(gap, True),
        within_mm=within_mm(stack),
        merged=sum(change.count for change in topology if change.kind == "merged"),
        closed=sum(change.kind == "closed" for change in topology),
        islands=tuple(place for one in layers for place in one.islands),
        specks=tuple(place for one in layers for place in one.alone),
        lost=tuple(lost),
        topology=tuple(topology),
        hairline_layers=sum(one.hairline_px > 0 for one in layers),
        sheet_layers=sum(one.sheet_px > 0 for one in layers),
        joined=tuple(change for one in layers for change in one.joined),
        sheets_lost=sum(one.sheets_lost for one in layers),
        layers_with_gaps=sum(one.gaps is not None for one in layers),
        longest_gap_mm=max((one.gaps.longest_mm for one in layers if one.gaps is not None), default=0.0),
        notes=tuple(stack.notes),
        by_layer=tuple(layers),
        across=tuple(others),
    )


def lines_of(v: Verdict) -> list[tuple[str, str]]:
    """The few lines a user wants to see."""
    feature = format_mm(v.min_feature_mm)
    rows = [("layers", f"{v.layers} of {v.size_px[0]} × {v.size_px[1]} px")]
    if v.layers_with_gaps:
        closed = f"gaps closed in {counted(v.layers_with_gaps, 'layer')}, the longest {format_mm(v.longest_gap_mm)}"
        rows.append(("open mesh", closed))
    if not v.features_lost and not v.parts_lost and not v.sheets_lost:
        rows.append(("verdict", f"nothing is narrower than {feature}: nothing would be lost"))
    else:
        rows.append(
            (
                "verdict",
                f"{counted(v.features_lost, 'feature')} narrower than {feature} would be lost,"
                f" in {counted(v.layers_with_loss, 'layer')}; after correction {v.features_left}",
            )
        )
        rows.append(("lost", f"{v.lost_mm3:.4g} mm³; {counted(v.parts_lost, 'part')} of layers as a whole"))
    precision = format_mm(v.within_mm)
    for name, width, z_mm, at in (
        ("thinnest", v.thinnest_mm, v.thinnest_z_mm, v.thinnest_at),
        ("thinnest gap", v.thinnest_gap_mm, v.thinnest_gap_z_mm, v.thinnest_gap_at),
    ):
        if width is not None:
            where = f"in {_box(at)}" if at is not None else f"at z = {z_mm:.3f} mm"
            rows.append((name, f"{format_mm(round(width, 4))} (± {precision}) {where}"))
    rows += [("lost at", _where(place)) for place in v.lost[:3]]
    if v.hairline_layers:
        rows.append(("hairlines", f"thinner than a pixel in {counted(v.hairline_layers, 'layer')}"))
    rows += [("joined", word) for word in told_of_joined(v.joined)]
    rows += _of_sheets(v)
    if v.sheets_lost:
        rows.append(("sheets", f"{counted(v.sheets_lost, 'part')} thinner than a quarter of a layer, in no layer"))
    if v.merged or v.closed:
        rows.append(
            ("corrected", f"{counted(v.merged, 'part')} would grow together, {counted(v.closed, 'hole')} close")
        )
    if v.islands:
        rows.append(("islands", f"{counted(len(v.islands), 'part')} on nothing below, as at {_where(v.islands[0])}"))
    if v.specks:
        rows.append(
            ("specks", f"{counted(len(v.specks), 'part')} with nothing below and above, as at {_where(v.specks[0])}")
        )
    rows += [line_of(one, v.min_feature_mm) for one in v.across]
    return rows + [("note", note) for note in v.notes]


def _of_sheets(v: Verdict) -> list[tuple[str, str]]:
    """A word about what no mid-plane meets: slicers leave it out. Feather edges of slopes are none."""
    area_mm2 = v.pixel_mm[0] * v.pixel_mm[1]
    thin = [one.z_mm for one in v.by_layer if is_sheet(one.sheet_px * area_mm2, one.solid_mm2)]
    return [("sheets", f"{thinner_than_layers(thin)}; fix draws them one layer thick")] if thin else []


def markdown_of(v: Verdict) -> str:
    """The same as a table, for a pull request."""
    sign = ":white_check_mark:" if v.ok else ":warning:"
    rows = [f"| {name or 'at'} | {value} |" for name, value in lines_of(v)]
    name = Path(v.source).name.replace("|", "\\|").replace("`", "'")
    return "\n".join([f"### {sign} layerfix check: `{name}`", "", "| | |", "|---|---|", *rows])


def _where(place: Place) -> str:
    return f"{_box(place)} ({place.area_mm2:.3g} mm²)"


def _box(place: Place) -> str:
    left, bottom, right, top = (f"{value:.2f}" for value in place.box_mm)
    return f"x {left} to {right}, y {bottom} to {top}, z = {place.z_mm[0]:.3f} mm"
