"""The slicers, in the modes that treat thin parts differently, by their command lines."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from layerfix.mesh.triangles import Mesh

NOZZLE_MM, LAYER_MM = 0.4, 0.2
CENTRE_MM = 100.0  # of the bed, in x and y
TIMEOUT_S = 600
CURA_FOLDER = Path("/usr/share/cura/resources/definitions")
# Solid throughout, so that what is left uncovered was left out. Booleans are flags to both of these.
SLIC3R_LIKE = [
    *("--nozzle-diameter", "0.4", "--layer-height", "0.2", "--first-layer-height", "0.2", "--skirts", "0"),
    *("--filament-diameter", "1.75", "--fill-density", "100%", "--fill-pattern", "rectilinear"),
]
# CuraEngine works no formulas out: every value that follows from another is given too.
CURA_SETTINGS = {
    **{"layer_height": 0.2, "layer_height_0": 0.2, "material_diameter": 1.75, "adhesion_type": "none"},
    **{"machine_width": 2 * CENTRE_MM, "machine_depth": 2 * CENTRE_MM, "machine_nozzle_size": 0.4},
    **{"wall_line_width_0": 0.4, "wall_line_width_x": 0.4, "skin_line_width": 0.4, "infill_line_width": 0.4},
    **{"wall_line_count": 2, "initial_layer_line_width_factor": 100, "top_layers": 4, "bottom_layers": 4},
    **{"infill_line_distance": 0.4, "infill_pattern": "lines", "retraction_enable": "false"},
}


@dataclass(frozen=True)
class Sliced:
    """How a slicer's run went; `refused` is what it said if it wrote no G-code."""

    seconds: float
    refused: str = ""


@dataclass(frozen=True)
class Mode:
    """A slicer with the settings that matter here."""

    name: str
    program: str
    command: Callable[[Path, Path], list[str | Path]]  # of the part and the G-code
    reads_3mf: bool = True
    rectangular: bool = False  # its idea of a bead's section
    centres: bool = True  # the middle of the part's box, and its lowest point onto the bed


def _prusa(*options: str) -> Callable[[Path, Path], list[str | Path]]:
    """PrusaSlicer with these options."""
    fixed = ["prusa-slicer", "--loglevel", "1", "-g", "--gcode-flavor", "marlin2", "--center", "100,100"]
    return lambda part, gcode: [*fixed, *SLIC3R_LIKE, *options, "-o", gcode, part]


def _slic3r(part: Path, gcode: Path) -> list[str | Path]:
    """Slic3r as it comes, which is with thin walls."""
    fixed = ["slic3r", "--no-gui", "--print-center", "100,100", "--gcode-comments"]
    return [*fixed, *SLIC3R_LIKE, "-o", gcode, part]


def _cura(part: Path, gcode: Path) -> list[str | Path]:
    """CuraEngine; settings count for the machine before -e0 and for the extruder after it."""
    settings = [word for key, value in CURA_SETTINGS.items() for word in ("-s", f"{key}={value}")]
    definition = (cura_definitions() or CURA_FOLDER) / "fdmprinter.def.json"
    return ["CuraEngine", "slice", "-j", definition, "-o", gcode, *settings, "-e0", *settings, "-l", part]


MODES = {
    mode.name: mode
    for mode in (
        Mode("prusa-classic", "prusa-slicer", _prusa("--perimeter-generator", "classic", "--no-thin-walls")),
        Mode("prusa-thin-walls", "prusa-slicer", _prusa("--perimeter-generator", "classic", "--thin-walls")),
        Mode("prusa-arachne", "prusa-slicer", _prusa("--perimeter-generator", "arachne")),
        Mode("slic3r", "slic3r", _slic3r),
        Mode("cura", "CuraEngine", _cura, reads_3mf=False, rectangular=True, centres=False),
    )
}


def cura_definitions() -> Path | None:
    """The folder with fdmprinter.def.json: CURA_DEFINITIONS, else where the package cura puts it."""
    folder = Path(os.environ.get("CURA_DEFINITIONS") or CURA_FOLDER)
    return folder if (folder / "fdmprinter.def.json").is_file() else None


def why_not(mode: Mode) -> str:
    """Why a mode cannot be run here; empty if it can."""
    if not shutil.which(mode.program):
        return f"{mode.program} is not installed"
    if mode.program == "CuraEngine" and not cura_definitions():
        return "CuraEngine has no definitions: set CURA_DEFINITIONS to the folder of fdmprinter.def.json"
    return ""


def version(program: str) -> str:
    """The program's own word for its version."""
    option = {"slic3r": "--version", "CuraEngine": "help"}.get(program, "--help")
    ran = subprocess.run([program, option], capture_output=True, text=True, timeout=60, check=False)
    found = re.search(r"(?:PrusaSlicer-|version )?(\d+\.\d+\.\d+)(?!\d*\])", ran.stdout + ran.stderr)
    return f"{program} {found[1] if found else 'of unknown version'}"


def slice_part(mode: Mode, part: Path, gcode: Path) -> Sliced:
    """Run the slicer."""
    started = time.perf_counter()
    try:
        ran = subprocess.run(
            mode.command(part, gcode),
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Sliced(TIMEOUT_S, f"gave up after {TIMEOUT_S} s")
    seconds = time.perf_counter() - started
    if gcode.is_file() and ran.returncode == 0:
        return Sliced(seconds)
    said = [line.strip() for line in (ran.stdout + ran.stderr).splitlines() if line.strip()]
    return Sliced(seconds, f"exit code {ran.returncode}: {said[-1][:200] if said else 'no word'}")


def offset_mm(mode: Mode, sliced: Mesh) -> tuple[float, float, float]:
    """Where the slicer puts the origin of the mesh's coordinates."""
    if not mode.centres:
        return CENTRE_MM, CENTRE_MM, 0.0
    low, high = sliced.bounds_mm
    x, y = (CENTRE_MM - (low + high)[:2] / 2).tolist()
    return x, y, -float(low[2])
