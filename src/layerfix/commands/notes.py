"""What `fix` says beside its table: what was special about the layers, how much of it, and where."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from layerfix.mesh.empty import empty_between
from layerfix.mesh.slicing import sliced_mesh
from layerfix.units import counted, format_mm

if TYPE_CHECKING:
    from layerfix.fdm import PathSettings
    from layerfix.layers.gaps import Conflict
    from layerfix.layers.topology import TopologyChange
    from layerfix.stack import Layer, LayerStack


FEATHERS = 1000  # a sheet is more than so small a part of its layer


def doubts(tolerance_mm: float | None, paths: PathSettings | None, min_feature_mm: float) -> list[str]:
    """A word about what was asked for and is allowed, but may not be what is wanted."""
    doubts = []
    if tolerance_mm is not None and tolerance_mm > min_feature_mm / 4:
        doubts.append(
            f"a tolerance of {format_mm(tolerance_mm)} is much for a minimum feature of"
            f" {format_mm(min_feature_mm)}: outlines may come out thinner than it"
        )
    if paths is not None and min_feature_mm < paths.range_mm[0] * (1 - 1e-9):
        doubts.append(
            f"a minimum feature of {format_mm(min_feature_mm)} is below the narrowest bead of the nozzle,"
            f" {format_mm(paths.range_mm[0])}"
        )
    return doubts


def within_mm(stack: LayerStack) -> float:
    """How near a measured width is: to what the layers show within half a pixel, to a mesh, whose sides may lie
    anywhere between the centres of pixels, within a whole one."""
    return max(stack.pixel_mm) * (0.5 if sliced_mesh(stack) is None else 1.0)


def told_of_hairlines(done: list[Layer], pixel_mm: tuple[float, float]) -> list[str]:
    """A word about what is thinner than a pixel."""
    at = [layer.z_mm[0] for layer in done if layer.hairline_px]
    if not at:
        return []
    return [
        f"thinner than a pixel of {format_mm(min(pixel_mm))} in {counted(len(at), 'layer')}, the first at"
        f" z = {at[0]:.3f} mm: drawn one pixel wide, then as wide as the feature"
    ]


def told_of_joined(joined: Sequence[TopologyChange]) -> list[str]:
    """A word about pieces of a mesh that the raster joins: how many, and the three largest places."""
    if not joined:
        return []
    found = sorted(joined, key=lambda one: -one.area_mm2)
    number, heights = sum(one.count for one in found), len({one.z_mm for one in found})
    return [
        f"{number} pieces within two pixels of one another are {counted(len(found), 'part')} in the layers, in"
        f" {counted(heights, 'layer')}; the largest: {_places(found)}"
    ]


def is_sheet(sheet_px: float, solid_px: float) -> bool:
    """Whether so much of a layer is more than feather edges of slopes, which reach a quarter of a layer, too."""
    return sheet_px * FEATHERS > solid_px


def thinner_than_layers(z_mm: Sequence[tuple[float, float]]) -> str:
    """How many layers have something that is thinner than them, and where the first is."""
    bottom, top = z_mm[0]
    layers = counted(len(z_mm), "layer")
    return f"thinner than a layer of {format_mm(top - bottom)} in {layers}, the first at z = {bottom:.3f} mm"


def told_of_sheets(done: list[Layer]) -> list[str]:
    """A word about what is thinner than a layer."""
    words = []
    thin = [layer for layer in done if layer.sheet_px]
    thin = [layer for layer in thin if layer.change is None or is_sheet(layer.sheet_px, layer.change.solid_px)]
    if thin:
        words.append(f"{thinner_than_layers([layer.z_mm for layer in thin])}: drawn one layer thick")
    lost = [layer for layer in done if layer.sheets_lost]
    if lost:
        number = sum(layer.sheets_lost for layer in lost)
        words.append(
            f"{counted(number, 'part')} thinner than a quarter of a layer left out, in {counted(len(lost), 'layer')},"
            f" the first at z = {lost[0].z_mm[0]:.3f} mm"
        )
    return words


def told_of_dimmed(done: list[Layer]) -> list[str]:
    """A word about dimmed interiors, and parts."""
    at = [layer.z_mm[0] for layer in done if layer.dimmed_px]
    if not at:
        return []
    return [f"dimmed areas in {counted(len(at), 'layer')}, the first at z = {at[0]:.3f} mm: left as they are"]


def told_of_raised(done: list[Layer]) -> list[str]:
    """A word about what was of too few layers."""
    at = [layer.z_mm[0] for layer in done if layer.raised_px]
    return [f"raised to the fewest layers asked for in {counted(len(at), 'layer')}, the first at"
            f" z = {at[0]:.3f} mm"] if at else []  # fmt: skip


def told_of_specks(done: list[Layer]) -> list[str]:
    """A word about what was too small to be corrected, as asked."""
    at = [layer.z_mm[0] for layer in done if layer.change is not None and layer.change.ignored_px]
    return [f"specks left as they are in {counted(len(at), 'layer')}, the first at z = {at[0]:.3f} mm"] if at else []


def told_of_topology(topology: tuple[TopologyChange, ...]) -> list[str]:
    """What grew together, what closed, what was closed off: how much, and the three worst places."""
    words = []
    for kind, one, many in (
        ("merged", "part grew together with another", "parts grew together"),
        ("closed", "hole closed", "holes closed"),
        ("enclosed", "gap closed at its mouth or across", "gaps closed at their mouths or across"),
        ("split", "part fell apart", "parts fell apart"),
    ):
        found = [change for change in topology if change.kind == kind]
        if found:
            heights = len({change.z_mm for change in found})
            number = sum(change.count - (kind != "merged") if change.count > 1 else 1 for change in found)
            into = f" into {len(found)}" if kind == "merged" else ""
            what = f"{number} {one if number == 1 else many}{into}"
            words.append(f"{what}, in {counted(heights, 'layer')}; the largest: {_places(found)}")
    return words


def told_of_conflicts(conflicts: tuple[Conflict, ...], min_feature_mm: float) -> list[str]:
    """What stays under the feature for what is kept free: how much, and the three narrowest places."""
    thin = [one for one in conflicts if one.width_mm < min_feature_mm * 0.95]
    if not thin:
        return []
    heights = len({one.z_mm for one in thin})
    return [
        f"{counted(len(thin), 'place')} under {format_mm(min_feature_mm)} for what is kept free, in"
        f" {counted(heights, 'layer')}; the narrowest about {format_mm(round(thin[0].width_mm, 3))}: {_places(thin)}"
    ]


def _places(changes: Sequence[TopologyChange | Conflict]) -> str:
    """The three largest, in three places of the layers."""
    places: dict[tuple[float, ...], str] = {}
    for one in changes:
        left, bottom, right, top = (f"{value:.2f}" for value in one.box_mm)
        z = f"{one.z_mm[0]:.3f}"
        places.setdefault(one.box_mm, f"x {left} to {right}, y {bottom} to {top}, from z = {z} mm")
    return "; ".join([*places.values()][:3])


def told_of_empty_layers(done: list[Layer]) -> list[str]:
    """A word about layers without anything between others that have something."""
    solid = [layer.change is None or layer.change.solid_px > 0 for layer in done]
    return empty_between(solid, [layer.z_mm for layer in done])
