"""The build direction as one call: open the part, search, and write every file asked for."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.commands.mesh_file import mesh_in
from layerfix.commands.options import Options
from layerfix.commands.pages import report_on
from layerfix.commands.part import Placing
from layerfix.commands.standing import printing_of
from layerfix.draw.canvas import SUFFIXES as DRAWINGS
from layerfix.draw.sphere import scatter, sphere_map
from layerfix.errors import InputError, OutputError
from layerfix.files import already_written, check_apart, check_input, check_target, whole_file
from layerfix.formats import find_format, write
from layerfix.layers.correction import before
from layerfix.orientation.aims import UNITS
from layerfix.orientation.find import Options as SearchOptions
from layerfix.orientation.find import find
from layerfix.orientation.objective import Objective
from layerfix.orientation.outcome import Orientation, candidate_of, chosen_aims, written

if TYPE_CHECKING:
    from layerfix.mesh.triangles import Mesh
    from layerfix.orientation.outcome import Candidate
    from layerfix.orientation.search import State

MODELS = (".stl", ".3mf", ".obj")
PAGES = (".html", ".htm")
SUFFIXES = (*MODELS, ".json", *DRAWINGS, *PAGES)
FRONTS = (".csv", ".json", *DRAWINGS)


@dataclass(frozen=True)
class OrientOptions:
    """What the user asked for.

    search  as the library takes it; fit: only poses that fit the printer
    fronts  where the front of several aims goes
    """

    search: SearchOptions = field(default_factory=SearchOptions)
    fit: bool = False
    fronts: tuple[Path, ...] = ()
    log: Path | None = None
    resume: bool = False
    scheduler: str | None = None
    processes: int | None = None

    @property
    def executor(self) -> object:
        """What computes."""
        if self.scheduler is not None and self.processes is not None:
            raise InputError("--scheduler and --processes: one of the two")
        return self.scheduler if self.scheduler is not None else self.processes


def orient(
    source: Path,
    targets: Sequence[Path],
    options: Options,
    wanted: OrientOptions,
    progress: Callable[[State], None] | None = None,
) -> Orientation:
    """Search for the pose of a mesh that needs the least correction and write each of `targets`, by suffix: the part
    in that pose, all figures as JSON, the map of directions, or the page of its layers with that map to click on.

    Raises InputError and OutputError before any work where it can.
    """
    check_input(source, folders=False)
    paths = [*targets, *wanted.fronts]
    for path in paths:
        _check(path, source, FRONTS if path in wanted.fronts else SUFFIXES, options.run.force)
        if paths.count(path) > 1:
            raise OutputError(f"{path}: is named twice; every output needs a name of its own")
    if wanted.log is not None and wanted.log in paths:
        raise OutputError(f"{wanted.log}: is where the log goes; every output needs a name of its own")
    if wanted.resume and wanted.log is None:
        raise InputError("--resume: goes on from a log; give --log, too")
    search = wanted.search
    if wanted.fronts and search.front is None:
        search = replace(search, front=())
    mesh = _mesh(source, options)
    objective = Objective(mesh, printing_of(mesh, options))
    _check_models(targets, mesh)
    search = replace(search, room_mm=room_of(options, wanted.fit))
    found = find(objective, search, wanted.executor, options.run.workers, wanted.log, wanted.resume, progress)
    found = replace(found, notes=(*found.notes, *_fits(found, options, wanted.fit)))
    for k, path in enumerate(paths):
        with already_written(*paths[:k]):
            if path in wanted.fronts:
                write_front(path, found, search.front or (), force=options.run.force)
            else:
                write_found(path, found, source, options)
    return found


def _mesh(source: Path, options: Options) -> Mesh:
    if find_format(source)[0].mesh is None:
        raise InputError(f"{source}: holds layers, which are sliced already; a build direction is that of a mesh")
    return mesh_in(source, options.slicing)


def room_of(options: Options, fit: bool) -> tuple[float, float, float] | None:
    """The printer's, if poses are to fit. Raises InputError for a printer that was not given."""
    if not fit:
        return None
    if options.printer is None:
        raise InputError("--fit: to what? give --printer")
    return options.printer.build_mm


def _fits(found: Orientation, options: Options, asked: bool) -> list[str]:
    if options.printer is None or asked:
        return []
    room, (x, y, z) = options.printer.room_mm, found.objective.size_mm(found.best.pose)
    if sorted((x, y)) <= sorted(room[:2]) and max(x, y) <= max(room[:2]) and z <= room[2]:
        return []
    size = f"{x:.4g} × {y:.4g} × {z:.4g} mm"
    return [f"in this pose the part is {size} and does not fit {options.printer.name}; --fit finds one that does"]


def _check(path: Path, source: Path, suffixes: Sequence[str], force: bool) -> None:
    if path.suffix.lower() not in suffixes:
        what = "a front is written as" if suffixes is FRONTS else "a build direction is written as"
        raise OutputError(f"{path}: {what} {' '.join(suffixes)}")
    check_apart(path, source)
    check_target(path, force=force)


def _check_models(targets: Sequence[Path], mesh: Mesh) -> None:
    from layerfix.formats.solid.model import check_whole

    for path in targets:
        if path.suffix.lower() in MODELS:
            check_whole(path, mesh)


def write_found(path: Path, found: Orientation, source: Path, options: Options) -> None:
    """The part in the best pose (.stl .3mf .obj), figures and the 4 × 4 transform (.json), the map, or the page."""
    suffix, force = path.suffix.lower(), options.run.force
    if suffix in MODELS:
        write(path, found.mesh(), force=force)
    elif suffix == ".json":
        with whole_file(path, force=force) as file:
            file.write((json.dumps(found.summary(), indent=1) + "\n").encode())
    elif suffix in PAGES:
        fixed = found.objective.corrected(found.best.pose)
        report_on(source, before(fixed), fixed, path, options, found.objective.printing.mode,
                  placed=Placing(found.matrix, found))  # fmt: skip
    else:
        map_of(found).save(path, force=force)


def map_of(found: Orientation) -> Any:
    """The `Drawing` of all directions that were looked at."""
    directions, values = found.landscape()
    both = bool(found.aims.of_shape)
    name, best = found.objective.mesh.name, found.best
    title = (
        f"{name}: {found.initial.changed_px} px to correct as given, {best.changed_px} px at theta = {_theta(best)}"
    )
    unit = "weighted sum" if both else "px corrected"
    return sphere_map(directions, values, best=np.array(best.direction), given=np.array([0.0, 0.0, 1.0]), unit=unit,
                      title=title, both=both)  # fmt: skip


def write_front(path: Path, found: Orientation, names: Sequence[str], *, force: bool) -> None:
    """The non-dominated poses as a table (.csv, .json), or drawn: correction against the first other aim."""
    front, suffix = found.front(names), path.suffix.lower()
    if suffix in DRAWINGS:
        front_drawing(found, front, names).save(path, force=force)
        return
    rows = [written(one) for one in front]
    if suffix == ".json":
        text = json.dumps({"units": UNITS, "poses": rows}, indent=1) + "\n"
    else:
        lines = io.StringIO()
        flat = [_flat(row) for row in rows]
        table = csv.DictWriter(lines, list(flat[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(flat)
        text = lines.getvalue()
    with whole_file(path, force=force) as file:
        file.write(text.encode())


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    theta, direction = row.pop("theta_rad"), row.pop("direction")
    return {
        "theta1_rad": theta[0],
        "theta2_rad": theta[1],
        "x": direction[0],
        "y": direction[1],
        "z": direction[2],
        **row,
    }


def front_drawing(found: Orientation, front: Sequence[Candidate], names: Sequence[str]) -> Any:
    """Correction against the first other aim, of all poses counted in full."""
    name = chosen_aims(found.aims, names)[0]
    poses = [pose for pose, counts in found.seen.items() if counts.whole and not counts.empty]
    shown = [
        candidate_of(found.aims, found.objective, turned, found.seen[pose])
        for pose in poses
        for turned in (pose, pose.flipped())
    ]
    on_front = {(one.theta_rad, one.psi_rad) for one in front}
    dark = [k for k, one in enumerate(shown) if (one.theta_rad, one.psi_rad) in on_front]
    distance = [
        math.dist(one.direction, found.best.direction) + abs(one.psi_rad - found.best.psi_rad) for one in shown
    ]
    return scatter(
        [one.changed_px for one in shown],
        [one.terms[name] for one in shown],
        x_title="correction in px",
        y_title=f"{name} in {UNITS[name].replace('²', '2').replace('³', '3')}",
        front=dark,
        best=int(np.argmin(distance)),
        title=f"{found.objective.mesh.name}: correction against {name}",
    )


def _theta(one: Candidate) -> str:
    return f"[{', '.join(f'{angle:.2f}'.replace('-0.00', '0.00') for angle in one.theta_rad)}]"


def lines_of(found: Orientation, written_to: Sequence[Path]) -> list[tuple[str, str]]:
    """(name, value) of what a user wants to see."""
    given, best = found.initial, found.best
    before = f"{given.changed_px} px, {given.changed_mm3:.4g} mm³ to correct" if given.printed else "in no layer"
    less = f": {found.reduction_percent:.3g} % less" if given.printed else ""
    rows = [
        ("as given", f"{before}, {given.height_mm:.4g} mm high"),
        ("best", f"{best.changed_px} px, {best.changed_mm3:.4g} mm³, {best.height_mm:.4g} mm high{less}"),
        ("turned by", f"θ = {_theta(best)} rad about x and z, {math.degrees(best.psi_rad):.1f}° on the plate"),
        ("up is", "({:.3f}, {:.3f}, {:.3f}) of the part as it is given".format(*best.direction)),
    ]  # fmt: skip
    if best.mean_px is not None:
        rows.append(("", f"{best.mean_px:.0f} px on average over angles on the plate"))
    others = [one for one in found.candidates if one is not best and one.pose != best.pose][:4]
    for k, one in enumerate(others):
        more = _more(one, best)
        rows.append(("others" if not k else "", f"{more} up is ({', '.join(f'{c:.3f}' for c in one.direction)}),"
                                                f" {one.height_mm:.4g} mm high"))  # fmt: skip
    rows.append(("searched", f"{found.evaluations} poses in full of {found.screened} looked at ({found.method}),"
                             f" {found.seconds:.1f} s with {found.engine}"))  # fmt: skip
    rows += [("note", note) for note in found.notes]
    rows += [("written", str(path)) for path in written_to]
    return rows


def _more(one: Candidate, best: Candidate) -> str:
    if not best.changed_px:
        return f"{one.changed_px} px,"
    return f"{one.changed_px} px ({100 * (one.changed_px / best.changed_px - 1):+.1f} %),"
