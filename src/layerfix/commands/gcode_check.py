"""What a finished G-code leaves out of a model: parts of its layers without beads, and layers that are not there.

It comes too late to change anything: it is for whoever wants to know before printing (`layerfix check --gcode`), and
for slicers' post-processing scripts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import words_for
from layerfix.commands.mesh_file import mesh_in
from layerfix.errors import InputError
from layerfix.fdm.covering import finely, lay
from layerfix.files import check_input
from layerfix.formats import find_format
from layerfix.formats.vector.gcode_reader import read_gcode
from layerfix.layers.verdict import Place
from layerfix.mesh.slicing import slice_like
from layerfix.stack import Layer, LayerStack
from layerfix.units import counted, format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.commands.options import Options
    from layerfix.fdm import LayerPaths
    from layerfix.fdm.beads import Path as Bead
    from layerfix.mesh.triangles import Mesh

    Floats = NDArray[np.float64]
    Mask = NDArray[np.uint8]

SCHEMA_VERSION = 1
NO_PART = (
    "skirt",
    "brim",
    "support",
    "prime",
    "wipe",
    "custom",
    "raft",
)  # as slicers' `;TYPE:` begins, in small letters
DROPPED = 0.05  # a part of a layer of which less is under beads is not there
USUAL_PIXEL_MM, MARGIN_MM = 0.05, 1.0
COARSE_MM, LOOKS = 0.25, 9  # of the search for the place: its grid, and how many layers are compared
MOST_PX = 40_000_000


@dataclass(frozen=True)
class GcodeVerdict:
    """What `layerfix check --gcode --json` prints.

    ok          every part of every layer is there
    components  separate parts of the model's layers, all layers together; dropped: those without beads
    missing     layers of the model that the G-code does not have
    coverage_percent  of the model's area, layer by layer, that is under beads (sparse infill leaves some free)
    moved_mm    what was added to the model's x and y to lie where the G-code prints it
    lost        the dropped parts, in the model's coordinates, the largest first
    """

    schema_version: int
    source: str
    gcode: str
    ok: bool
    layers: int
    missing: int
    components: int
    dropped: int
    layers_with_loss: int
    coverage_percent: float
    moved_mm: tuple[float, float]
    lost: tuple[Place, ...]
    notes: tuple[str, ...] = ()


def check_gcode(
    source: Path, gcode: Path, options: Options, progress: Callable[[int, int], None] = lambda done, total: None
) -> GcodeVerdict:
    """Compare a G-code with the mesh or project that it was made of.

    Raises InputError for what cannot be read, and for a G-code in which the model cannot be found.
    """
    check_input(source)
    if find_format(source)[0].mesh is None:
        raise InputError(f"{source}: --gcode compares G-code with a mesh or a project (.3mf)")
    mesh = mesh_in(source, options.slicing)
    mesh = mesh.moved((0.0, 0.0, -float(mesh.bounds_mm[0][2])))
    layers = _layers(read_gcode(gcode), float(mesh.bounds_mm[1][2]))
    if not any(beads for _, beads in layers):
        raise InputError(f"{gcode}: lays no beads of a part, only of skirts and supports")
    pitch = options.frame.pixel_mm or (options.printer.pixel_mm if options.printer else None)
    stack = _frame(mesh, layers, pitch or (USUAL_PIXEL_MM, USUAL_PIXEL_MM))
    sections = slice_like(mesh, stack, hairlines=True, z_sampling="rescue")
    moved, share = _place(mesh, sections, layers)
    if share < DROPPED:
        raise InputError(
            f"{gcode}: the model is not where this G-code prints; was it made of {source.name}, and not turned or"
            " scaled since?"
        )
    return _compared(source, gcode, sections, layers, moved, progress)


def _layers(read: Sequence[LayerPaths], height_mm: float) -> list[tuple[tuple[float, float], list[Bead]]]:
    """((bottom, top), beads of the part) of every layer up to the model's height, also where there are no beads."""
    found: list[tuple[tuple[float, float], list[Bead]]] = []
    heights = [layer.layer_mm for layer in read]
    usual = float(np.median(heights))

    def fill(bottom: float, top: float) -> None:
        count = round((top - bottom) / usual)
        edges = np.linspace(bottom, top, count + 1).round(6).tolist() if count else []
        found.extend(((a, b), []) for a, b in pairwise(edges))

    below = 0.0
    for layer in read:
        beads = [path for path in layer.paths if not path.kind.lower().startswith(NO_PART)]
        bottom, top = layer.z_mm
        if not beads and top > below:
            continue
        if bottom > below + usual / 2:
            fill(below, bottom)
        start = max(bottom, below) if abs(bottom - below) > 1e-6 else below
        if top > start + 1e-6:
            found.append(((round(start, 6), round(top, 6)), beads))
            below = top
    if height_mm - below > 0.55 * usual:  # half a layer is none: its middle is above the model
        fill(below, height_mm)
    return found


def _frame(
    mesh: Mesh, layers: Sequence[tuple[tuple[float, float], list[Bead]]], pixel_mm: tuple[float, float]
) -> LayerStack:
    """An empty frame round the model with the layers of the G-code."""
    low, high = mesh.bounds_mm[:, :2]
    while (size := [round(float(s + 2 * MARGIN_MM) / p) + 1 for s, p in zip(high - low, pixel_mm, strict=True)]) and (
        size[0] * size[1] > MOST_PX
    ):
        pixel_mm = pixel_mm[0] * 2, pixel_mm[1] * 2
    width, height = size
    empty = np.zeros((height, words_for(width)), np.uint64)
    z_mm = np.array([z for z, _ in layers])

    def make(index: int) -> Layer:
        return Layer(empty, width, (float(z_mm[index, 0]), float(z_mm[index, 1])))

    origin = float(low[0]) - MARGIN_MM, float(low[1]) - MARGIN_MM + height * pixel_mm[1]
    return LayerStack(width, height, pixel_mm, z_mm, make, origin)


def _mask(beads: Sequence[Bead], stack: LayerStack, moved: tuple[float, float]) -> Mask:
    """(H, W) uint8, 1 under beads. moved: the G-code's coordinates less the model's."""
    mask = np.zeros((stack.height, stack.width), np.uint8)
    (left, top), (px, py) = stack.origin_mm, stack.pixel_mm
    for bead in beads:
        points = bead.points_mm - np.array(moved)
        columns, rows = (points[:, 0] - left) / px - 0.5, (top - points[:, 1]) / py - 0.5
        widths = np.append(bead.width_mm, bead.width_mm[-1])
        lay(mask, finely(np.column_stack([columns, rows, widths])), px)
    return mask


def _place(
    mesh: Mesh, sections: LayerStack, layers: Sequence[tuple[tuple[float, float], list[Bead]]]
) -> tuple[tuple[float, float], float]:
    """(what to add to the model's x and y, the share of some of its layers that is under beads then).

    Tried are the model's own place (projects), the middle of the beads (a model in the middle of the bed), and the
    place where the outlines of some layers have most in common with the beads.
    """
    with_beads = [k for k, (_, beads) in enumerate(layers) if beads]
    looks = [with_beads[k] for k in np.linspace(0, len(with_beads) - 1, LOOKS).round().astype(int)]
    looks = list(dict.fromkeys(looks))
    points = np.concatenate([bead.points_mm for k in with_beads for bead in layers[k][1]])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2 - mesh.bounds_mm[:, :2].mean(axis=0)
    tried = [(0.0, 0.0), (float(middle[0]), float(middle[1])), _correlated(sections, layers, looks)]

    def share(moved: tuple[float, float]) -> float:
        under = area = 0
        for k in looks:
            solid = sections[k].image()
            area += int(solid.sum())
            under += int((solid & (_mask(layers[k][1], sections, moved) > 0)).sum())
        return under / area if area else 0.0

    shares = [share(moved) for moved in tried]
    best = int(np.argmax([s - 1e-3 * k for k, s in enumerate(shares)]))  # the plainest of those that are alike
    return tried[best], shares[best]


def _correlated(
    sections: LayerStack, layers: Sequence[tuple[tuple[float, float], list[Bead]]], looks: Sequence[int]
) -> tuple[float, float]:
    """Where the model's layers have most in common with the beads, on a coarse grid, by fast Fourier transform."""
    points = np.concatenate([bead.points_mm for k in looks for bead in layers[k][1]])
    low = points.min(axis=0)
    size = np.ptp(points, axis=0) + 2 * MARGIN_MM
    model = np.array([sections.width, sections.height]) * np.array(sections.pixel_mm)
    shape = tuple(int(np.ceil((a + b) / COARSE_MM)) + 2 for a, b in zip(size[::-1], model[::-1], strict=True))
    total = np.zeros((shape[0], shape[1] // 2 + 1), complex)
    columns = ((np.arange(sections.width) + 0.5) * sections.pixel_mm[0] / COARSE_MM).astype(int)
    rows = ((np.arange(sections.height)[::-1] + 0.5) * sections.pixel_mm[1] / COARSE_MM).astype(int)
    for k in looks:
        ours, theirs = np.zeros(shape), np.zeros(shape)
        r, c = np.nonzero(sections[k].image())
        np.add.at(ours, (rows[r], columns[c]), 1)
        for bead in layers[k][1]:
            fine = finely(np.column_stack([(bead.points_mm - low) / COARSE_MM, np.ones(len(bead.points_mm))]))
            at = fine[:, :2].astype(int)
            theirs[at[:, 1], at[:, 0]] = 1
        total += np.fft.rfft2(theirs) * np.conj(np.fft.rfft2(np.minimum(ours, 1)))
    best = np.unravel_index(int(np.argmax(np.fft.irfft2(total, shape))), shape)
    y, x = (k - n if k > n // 2 else k for k, n in zip(best, shape, strict=True))
    left, bottom = sections.origin_mm[0], sections.origin_mm[1] - sections.height * sections.pixel_mm[1]
    return float(low[0] + x * COARSE_MM - left), float(low[1] + y * COARSE_MM - bottom)


def _compared(
    source: Path,
    gcode: Path,
    sections: LayerStack,
    layers: Sequence[tuple[tuple[float, float], list[Bead]]],
    moved: tuple[float, float],
    progress: Callable[[int, int], None],
) -> GcodeVerdict:
    import cv2

    lost: list[Place] = []
    components = missing = with_loss = solid_px = under_px = 0
    px, py = sections.pixel_mm
    left, top = sections.origin_mm
    for index, ((bottom, upper), beads) in enumerate(layers):
        image = sections[index].image().astype(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(image, connectivity=8)
        under = np.bincount(labels[_mask(beads, sections, moved) > 0], minlength=count) if beads else np.zeros(count)
        components += count - 1
        solid_px += int(image.sum())
        under_px += int(under[1:].sum())
        missing += count > 1 and not beads
        dropped = [k for k in range(1, count) if under[k] < DROPPED * stats[k, cv2.CC_STAT_AREA]]
        with_loss += bool(dropped)
        for k in dropped:
            x, y, w, h, area = stats[k].tolist()
            box = left + x * px, top - (y + h) * py, left + (x + w) * px, top - y * py
            lost.append(Place((bottom, upper), tuple(round(v, 6) for v in box), area * px * py))
        progress(index + 1, len(layers))
    lost.sort(key=lambda place: -place.area_mm2)
    return GcodeVerdict(
        schema_version=SCHEMA_VERSION, source=str(source), gcode=str(gcode), ok=not lost and not missing,
        layers=len(layers), missing=missing, components=components, dropped=len(lost), layers_with_loss=with_loss,
        coverage_percent=100 * under_px / solid_px if solid_px else 0.0,
        moved_mm=(round(moved[0], 4), round(moved[1], 4)), lost=tuple(lost),
        notes=(*sections.notes, *_more_than(sections, layers, moved)),
    )  # fmt: skip


def _more_than(
    sections: LayerStack, layers: Sequence[tuple[tuple[float, float], list[Bead]]], moved: tuple[float, float]
) -> list[str]:
    """A word if the G-code prints beside the model, too, or above it: of that nothing is said."""
    points = np.concatenate([bead.points_mm for _, beads in layers for bead in beads]) - np.array(moved)
    low = np.array([sections.origin_mm[0], sections.origin_mm[1] - sections.height * sections.pixel_mm[1]])
    high = np.array([sections.origin_mm[0] + sections.width * sections.pixel_mm[0], sections.origin_mm[1]])
    beside = bool((points < low).any() or (points > high).any())
    empty_above = next((k for k in range(len(sections) - 1, -1, -1) if sections[k].rows.any()), -1) + 1
    above = any(beads for _, beads in layers[empty_above + 1 :])
    return (
        ["the G-code prints more than this model: other parts, copies, or another model"] if beside or above else []
    )


def lines_of(v: GcodeVerdict) -> list[tuple[str, str]]:
    """The few lines a user wants to see."""
    rows = [("layers", f"{v.layers}, {counted(v.components, 'separate part')}")]
    if v.ok:
        rows.append(("verdict", "every part of every layer is printed"))
    else:
        rows.append(
            ("verdict", f"{counted(v.dropped, 'part')} dropped, in {counted(v.layers_with_loss, 'layer')}"
                        + (f"; {counted(v.missing, 'layer')} missing" if v.missing else ""))
        )  # fmt: skip
    rows.append(("under beads", f"{v.coverage_percent:.1f} % of the model's layers"))
    for place in v.lost[:3]:
        a, b, c, d = (f"{value:.2f}" for value in place.box_mm)
        rows.append(("lost at", f"x {a} to {c}, y {b} to {d}, z = {place.z_mm[0]:.3f} mm ({place.area_mm2:.3g} mm²)"))
    if any(abs(value) > 1e-3 for value in v.moved_mm):
        rows.append(("model at", " × ".join(format_mm(value) for value in v.moved_mm) + " from its own place"))
    return rows + [("note", note) for note in v.notes]
