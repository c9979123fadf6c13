"""Small files of every kind to start from, and what is done with a mutated one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

import layerfix as lf
from layerfix.formats.png.encode import encode_png
from layerfix.formats.vector.gcode_reader import read_gcode
from layerfix.printers import printer_folder
from tests.independent_readers import (
    CTB,
    CTB_V4,
    block,
    png_bytes,
    thin_bar,
    write_chitu,
    write_goo,
    write_sl1,
    write_zip,
)
from tests.making import box

LAYERS = [block(24, 42), thin_bar(24, 42), thin_bar(24, 42, 90)]
GCODE = """; filament_diameter = 1.75
;LAYER_CHANGE
;Z:0.2
;HEIGHT:0.2
G90
M83
G1 Z0.2 F600
;TYPE:Perimeter
;WIDTH:0.45
G1 X10 Y10 F9000
G1 X20 Y10 E0.35
G2 X30 Y20 I10 J0 E.5
G3 X20 Y30 R10 E.5
G92 E0
G91
G1 X5 Y5 E.2
G90
M82
G1 X1 Y1 E1
;LAYER:1
G0 Z0.4
G1 X4 Y4 E2
"""


def write(kind: str, folder: Path) -> Path:
    """A new folder with the seeds of a kind."""
    folder.mkdir(parents=True, exist_ok=True)
    SEEDS[kind](folder)
    return folder


def _jobs(folder: Path) -> None:
    write_sl1(folder / "a.sl1", LAYERS)
    write_goo(folder / "a.goo", LAYERS, differences=True)
    write_chitu(folder / "a.cbddlp", LAYERS, version=2, planes=4)
    write_chitu(folder / "a.ctb", LAYERS, magic=CTB, version=3, key=77)
    write_chitu(folder / "b.ctb", LAYERS, magic=CTB_V4, version=4)
    images = {f"{i + 1}.png": png_bytes(layer) for i, layer in enumerate(LAYERS)}
    write_zip(folder / "chitubox.zip", {"run.gcode": b";machineX:2\n;machineY:1\n;layerHeight:0.05\n;volume:1\n",
                                        **images})  # fmt: skip
    write_zip(folder / "a.nanodlp", {
        "plate.json": b'{"TotalSolidArea": 1}', "profile.json": b'{"Depth": 50}', "info.json": b'[{"MinX": 1}]',
        "slicer.json": b'{"XPixelSize": 50, "YPixelSize": 50, "ImageMirror": 1}', **images,
    })  # fmt: skip
    write_zip(folder / "a.cws", {"slice.conf": b"xppm 20\nyppm 20\nthickness 0.05\n", **images})
    notes = {"pixel_mm": [0.05, 0.05], "origin_mm": [0, 1.2], "z_mm": [0, 0.05]}
    own = encode_png(np.full((24, 1), 7, np.uint64), 42, pixel_mm=(0.05, 0.05), text={"layerfix": json.dumps(notes)})
    write_zip(folder / "own.zip", {"0.png": own})


def _meshes(folder: Path) -> None:
    import trimesh

    mesh = box([0, 0, 0], [12, 7, 3.5])
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    coloured = body.copy()
    coloured.visual.vertex_colors = [9, 9, 9, 255]
    scene = trimesh.Scene([body, coloured])
    scene.add_geometry(body, transform=np.diag([1.0, 2.0, 1.0, 1.0]))
    for kind in ("stl", "stl_ascii", "obj", "ply", "off", "3mf", "glb"):
        source = scene if kind in ("glb", "3mf") else body
        data = source.export(file_type=kind)
        (folder / f"a.{kind}").write_bytes(data.encode() if isinstance(data, str) else data)


def _gcode(folder: Path) -> None:
    (folder / "a.gcode").write_text(GCODE)
    (folder / "b.gcode").write_text(GCODE.replace(";WIDTH:0.45\n", "").replace(";HEIGHT:0.2\n", ""))


def _printers(folder: Path) -> None:
    for name in ("prusa-sl1s", "prusa-mk3s-0.4", "elegoo-mars-4-ultra"):
        (folder / f"{name}.toml").write_bytes((printer_folder() / f"{name}.toml").read_bytes())


def _use_job(path: Path) -> None:
    stack = lf.read(path, pixel_mm=0.05, layer_mm=0.05).with_workers(1)
    for layer in stack:
        layer.count_px()
    lf.read(path)
    suffixes = stack.container.suffixes if stack.container is not None else (".zip",)
    target = path.with_name(f"out{suffixes[0]}")
    if stack.width * stack.height < 1 << 16 and len(stack) < 20:
        lf.write(target, lf.correct(stack, min_feature_mm=0.3, mode="add_only"), force=True)


def _use_mesh(path: Path) -> None:
    mesh = lf.load_mesh(path)
    if max(mesh.size_mm) < 100:
        stack = lf.slice_mesh(mesh, pixel_mm=1.0, layer_mm=max(1.0, mesh.size_mm[2] / 20))
        stack.with_workers(1).volume_mm3()


def _use_gcode(path: Path) -> None:
    from layerfix.draw.plots import draw_paths

    for layer in read_gcode(path)[:3]:
        draw_paths(layer, title="x").save(path.with_name("out.svg"), force=True)


def _use_printer(path: Path) -> None:
    printer = lf.load_printer(path)
    stack = lf.LayerStack.from_images([np.ones((9, 9), bool)], pixel_mm=printer.pixel_mm, layer_mm=printer.layer_mm)
    if printer.pixels and printer.pixels[0] * printer.pixels[1] > 1 << 16:
        return
    lf.write(path.with_name("out.goo"), stack, printer, force=True)


def _mesh_suffix(data: bytes) -> str:
    for head, suffix in ((b"glTF", ".glb"), (b"PK", ".3mf"), (b"ply", ".ply"), (b"OFF", ".off"), (b"solid", ".stl")):
        if data.startswith(head):
            return suffix
    return ".obj" if data[:1] in (b"#", b"v", b"o", b"f", b"m") else ".stl"


SEEDS = {"jobs": _jobs, "meshes": _meshes, "gcode": _gcode, "printers": _printers}
USES: dict[str, Callable[[Path], None]] = {
    "jobs": _use_job, "meshes": _use_mesh, "gcode": _use_gcode, "printers": _use_printer,
}  # fmt: skip
SUFFIX_OF: dict[str, Callable[[bytes], str]] = {
    "jobs": lambda data: ".job",
    "meshes": _mesh_suffix,
    "gcode": lambda data: ".gcode",
    "printers": lambda data: ".toml",
}
