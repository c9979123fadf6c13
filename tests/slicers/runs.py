"""A part through the slicers, as it was drawn and as `layerfix fix` corrects it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from layerfix.mesh.load import load_mesh
from layerfix.mesh.triangles import Mesh, save_stl
from tests.making import run_layerfix
from tests.slicers.gcode import read_beads
from tests.slicers.metric import Measures, measure
from tests.slicers.models import placed
from tests.slicers.programs import LAYER_MM, NOZZLE_MM, Mode, offset_mm, slice_part
from tests.slicers.sections import components, layer_planes

FIX_OPTIONS = ("--printer", "prusa-mk3s-0.4", "--layer", "0.2mm", "--first-layer", "0.2mm")
# A dot of 0.035 mm, under a hundredth of what the nozzle dabs: too little to be a feature.
SPECK_MM2 = 1e-3
Sections = list[NDArray[np.object_]]


@dataclass(frozen=True)
class Part:
    """One model's files; a file that could not be made is None and `trouble` says why."""

    name: str
    original: Path
    sections: Sections = field(repr=False)
    specks: int = 0  # components of the sections that are too small to count
    fixed_3mf: Path | None = None
    fixed_stl: Path | None = None
    fix_seconds: float = 0.0
    trouble: str = ""

    def file(self, mode: Mode, corrected: bool) -> Path | None:
        """What this slicer is given."""
        if not corrected:
            return self.original
        return (self.fixed_3mf if mode.reads_3mf else None) or self.fixed_stl


@dataclass(frozen=True)
class Outcome:
    """One run of a slicer."""

    model: str
    mode: str
    corrected: bool
    seconds: float
    measures: Measures
    refused: str = ""


def prepare(name: str, mesh: Mesh, folder: Path, surface: str | None = None) -> Part:
    """Place a mesh, write it, take its sections and correct it."""
    folder.mkdir(parents=True, exist_ok=True)
    original = folder / "original.stl"
    save_stl(original, placed(mesh), force=True)
    # The file's rounded corners are what layerfix and the slicers read.
    written = load_mesh(original, unit="mm")
    sections = [components(written, z) for z in layer_planes(written, LAYER_MM)]
    large = [parts[shapely.area(parts) >= SPECK_MM2] for parts in sections]
    return fixed(Part(name, original, large, specks=sum(map(len, sections)) - sum(map(len, large))), surface)


def fixed(part: Part, surface: str | None = None) -> Part:
    """Correct the part's file, as 3MF and as STL, in the surface that `fix` takes or in another."""
    options = (*FIX_OPTIONS, "--surface", surface) if surface else FIX_OPTIONS
    made: dict[str, Path | None] = {}
    seconds, trouble = [], []
    for suffix in ("3mf", "stl"):
        target = part.original.with_name(f"fixed.{suffix}")
        started = time.perf_counter()
        run = run_layerfix("fix", part.original, target, *options, "--force")
        seconds.append(time.perf_counter() - started)
        made[suffix] = target if run.code == 0 and target.is_file() else None
        if made[suffix] is None:
            trouble.append(f"no {suffix}: {(run.err or run.out).strip() or run.code}")
    return replace(
        part, fixed_3mf=made["3mf"], fixed_stl=made["stl"], fix_seconds=seconds[0], trouble="; ".join(trouble)
    )


def run_mode(part: Part, mode: Mode, corrected: bool) -> Outcome:
    """Slice the part and compare the beads with what was drawn, never with what correction made of it."""
    file = part.file(mode, corrected)
    if file is None:
        raise FileNotFoundError(part.trouble)
    gcode = part.original.with_name(f"{mode.name}-{'fixed' if corrected else 'original'}.gcode")
    gcode.unlink(missing_ok=True)
    run = slice_part(mode, file, gcode)
    beads = [] if run.refused else read_beads(gcode, height_mm=LAYER_MM, rectangular=mode.rectangular)
    offset = offset_mm(mode, load_mesh(file, unit=None if file.suffix == ".3mf" else "mm"))
    measures = measure(beads, part.sections, layer_mm=LAYER_MM, offset_mm=offset, nozzle_mm=NOZZLE_MM)
    return Outcome(part.name, mode.name, corrected, run.seconds, measures, run.refused)


def run_all(parts: Sequence[Part], modes: Sequence[Mode], workers: int = 2) -> list[Outcome]:
    """Every part in every mode, original and, where there is one, corrected; so many runs at a time."""
    jobs: list[Future[Outcome]] = []
    with ProcessPoolExecutor(workers) as pool:
        for part in parts:
            for mode in modes:
                jobs += [
                    pool.submit(_job, part, mode.name, corrected)
                    for corrected in (False, True)
                    if part.file(mode, corrected)
                ]
        return [job.result() for job in jobs]


def _job(part: Part, mode: str, corrected: bool) -> Outcome:
    """`run_mode` by names that another process knows too."""
    from tests.slicers.programs import MODES

    return run_mode(part, MODES[mode], corrected)
