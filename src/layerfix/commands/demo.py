"""`layerfix demo`: the built-in test part, corrected for a stated printer, with something to look at."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from layerfix.commands.fix import fix
from layerfix.commands.options import Frame, Options, Run
from layerfix.commands.summary import Summary
from layerfix.files import whole_folder
from layerfix.formats import write
from layerfix.mesh.slicing import slice_mesh
from layerfix.mesh.triangles import save_stl
from layerfix.printers import load_printer
from layerfix.samples import sample

PRINTER = "prusa-mk3s-0.4"
PART, BEFORE, AFTER, PICTURE = "test_part.stl", "before", "after", "before_after.png"


def run_demo(
    folder: Path, *, force: bool, progress: Callable[[int, int], None] = lambda done, total: None
) -> Summary:
    """Write the test part, its layers before and after, and a picture into `folder`.

    Raises OutputError if `folder` holds anything and `force` is not given, or anything but a demo.
    """
    started = time.perf_counter()
    printer = load_printer(PRINTER)
    part = sample("test-part")
    mesh = part.mesh()
    with whole_folder(folder, force=force, ours=lambda path: path.name in (PART, BEFORE, AFTER, PICTURE)) as work:
        save_stl(work / PART, mesh)
        # The part's own layer height, so that the file, the images and the picture agree.
        options = Options(printer, Frame(layer_mm=part.layer_mm), run=Run(picture=work / PICTURE))
        summary = fix(work / PART, work / AFTER, options, progress)
        before = slice_mesh(mesh, pixel_mm=printer.pixel_mm, layer_mm=part.layer_mm, margin_mm=printer.min_feature_mm)
        write(work / BEFORE, before)
    return replace(
        summary, source=str(folder / PART), target=str(folder / AFTER), seconds=time.perf_counter() - started
    )


def what_to_look_at(folder: Path) -> str:
    """A few lines that point at the results."""
    return (
        f"Open {folder / PICTURE}: on the left the layer as sliced, on the right corrected for {PRINTER}.\n"
        "Red is added: fins and pins narrower than the nozzle's dot are thickened to it.\n"
        "Blue is removed: corners come out as round as the nozzle. Everything else is untouched.\n"
        f"All layers are in {folder / BEFORE} and {folder / AFTER}, the part itself in {folder / PART}."
    )
