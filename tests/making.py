"""Makers the tests share: meshes of known size, a real `layerfix` process, what a folder holds."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import layerfix
from layerfix.layers.correction import correct_image
from layerfix.mesh.triangles import Mesh, save_stl

SOURCE = Path(layerfix.__file__).parents[1]  # what PYTHONPATH needs so that a new process finds this package
SHARED = Path(__file__).parents[2] / "shared"  # other people's files, beside the checkout; often absent
PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 24, 1, 2  # linux/prctl.h, linux/capability.h

BOX_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


class Run(NamedTuple):
    """What a finished `layerfix` process left: exit code and both texts."""

    code: int
    out: str
    err: str


def environment(**more: str) -> dict[str, str]:
    """This process's environment, with the tested package on the path and no colours."""
    return {**os.environ, "PYTHONPATH": str(SOURCE), "NO_COLOR": "1", "COLUMNS": "100", **more}


def heed_interrupts() -> None:
    """For a new process: Ctrl-C counts, also where the tests run in the background."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start_layerfix(*args: object, cwd: Path | None = None, **options: Any) -> subprocess.Popen[str]:
    """`layerfix` with these arguments as a process of its own, not waited for."""
    return subprocess.Popen(
        [sys.executable, "-m", "layerfix", *map(str, args)],
        cwd=cwd,
        env=environment(**options.pop("env", {})),
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        **{"preexec_fn": heed_interrupts, "stdout": subprocess.PIPE, **options},
    )


def run_layerfix(*args: object, cwd: Path | None = None, env: Mapping[str, str] | None = None) -> Run:
    """`layerfix` with these arguments as a process of its own, to the end."""
    process = start_layerfix(*args, cwd=cwd, env=dict(env or {}))
    out, err = process.communicate(timeout=120)
    return Run(process.returncode, out, err)


def give_up_override() -> None:
    """For a new process: permissions bind even root, because it loses the two rights to pass over them."""
    if os.geteuid() == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        for right in (CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH):
            if libc.prctl(PR_CAPBSET_DROP, right, 0, 0, 0):
                raise OSError(ctypes.get_errno(), "prctl")


def run_without_override(*args: object, cwd: Path) -> Run:
    """`layerfix` by somebody whom the permissions of files and folders bind."""
    process = start_layerfix(*args, cwd=cwd, preexec_fn=give_up_override)
    out, err = process.communicate(timeout=120)
    return Run(process.returncode, out, err)


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything below a folder by its path, hidden files too: the bytes of files, None for folders."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


def box(low: Iterable[float], high: Iterable[float]) -> Mesh:
    """A block between two opposite corners, as 8 vertices and 12 triangles that face outwards."""
    a, b = np.array(list(low), float), np.array(list(high), float)
    return Mesh(np.where(BOX_CORNERS > 0, b, a), BOX_FACES)


def joined(*bodies: Mesh) -> Mesh:
    """All bodies as one mesh; nothing is merged."""
    starts = np.cumsum([0, *(len(body.vertices) for body in bodies)])[:-1]
    faces = [body.faces + start for body, start in zip(bodies, starts, strict=True)]
    return Mesh(np.concatenate([body.vertices for body in bodies]), np.concatenate(faces))


def inside_out(mesh: Mesh) -> Mesh:
    """The same triangles, walked the other way round."""
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def soup(mesh: Mesh) -> Mesh:
    """The same triangles with three vertices each of their own, as in an STL file."""
    return Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))


def chosen_faces(mesh: Mesh, chosen: np.ndarray) -> Mesh:
    """Only these triangles."""
    return Mesh(mesh.vertices, mesh.faces[chosen])


def grid_faces(rows: int, columns: int, *, closed: bool) -> np.ndarray:
    """Triangles between `rows` rings of `columns` points, each ring counter-clockwise seen from the next."""
    j, i = np.meshgrid(np.arange(rows if closed else rows - 1), np.arange(columns), indexing="ij")
    here, right = j * columns + i, j * columns + (i + 1) % columns
    above, across = ((k + columns) % (rows * columns) for k in (here, right))
    return np.stack([here, right, across, here, across, above], axis=-1).reshape(-1, 3)


def revolved(radii: Iterable[float], heights: Iterable[float], sides: int, turn: float = 0.0) -> Mesh:
    """A solid of revolution round the z axis, with flat ends. Heights rise; a radius of 0 is a tip."""
    r, z = np.array(list(radii), float), np.array(list(heights), float)
    angle = turn + 2 * np.pi * np.arange(sides) / sides
    rings = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle)), np.outer(z, np.ones(sides))], axis=-1)
    points = np.concatenate([rings.reshape(-1, 3), [[0, 0, z[0]], [0, 0, z[-1]]]])
    i = np.arange(sides)
    top = (len(r) - 1) * sides
    low = np.stack([np.full(sides, len(points) - 2), (i + 1) % sides, i], axis=1)
    high = np.stack([np.full(sides, len(points) - 1), top + i, top + (i + 1) % sides], axis=1)
    return Mesh(points, np.concatenate([grid_faces(len(r), sides, closed=False), low, high]))


def cylinder(radius: float, height: float, sides: int = 720, turn: float = 0.0) -> Mesh:
    """Upright, from z = 0."""
    return revolved([radius, radius], [0, height], sides, turn)


def cone(radius: float, height: float, sides: int = 720, turn: float = 0.0) -> Mesh:
    """Upright, from z = 0 to its tip."""
    return revolved([radius, 0], [0, height], sides, turn)


def sphere(radius: float, sides: int = 720, bands: int = 360, turn: float = 0.0) -> Mesh:
    """Round the origin; its poles are on the z axis."""
    tilt = np.linspace(-np.pi / 2, np.pi / 2, bands + 1)
    return revolved(radius * np.cos(tilt) * (np.abs(tilt) < 1.57), radius * np.sin(tilt), sides, turn)


def torus(radius: float, tube: float, sides: int = 720, bands: int = 360, turn: float = 0.0) -> Mesh:
    """Round the origin, its axis is z."""
    around = 2 * np.pi * np.arange(bands) / bands
    angle = turn + 2 * np.pi * np.arange(sides) / sides
    r, z = radius + tube * np.cos(around), tube * np.sin(around)
    points = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle)), np.outer(z, np.ones(sides))], axis=-1)
    return Mesh(points.reshape(-1, 3), grid_faces(bands, sides, closed=True))


def turned(mesh: Mesh, axis: str, degrees: float) -> Mesh:
    """Turned about x, y or z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return mesh.transformed(matrix)


def thin_part() -> Mesh:
    """A 6 × 4 mm plate, 0.5 mm thick, with a 1.5 mm high fin of 0.1 mm: quick to slice, and something to fix."""
    return joined(box([0, 0, 0], [6, 4, 0.5]), box([2, 0.5, 0.25], [2.1, 3.5, 2]))


def corrected_on_panel(image: np.ndarray, radius_px: tuple[float, float], mode: str) -> np.ndarray:
    """(H, W) bool: what a panel mirrored along x shows of a correction, from what it showed before."""
    return correct_image(image[:, ::-1], mode=mode, min_feature_px=(2 * radius_px[0], 2 * radius_px[1]))[:, ::-1]


def write_stl(path: Path, mesh: Mesh) -> Path:
    """A binary STL; returns its path."""
    save_stl(path, mesh)
    return path
