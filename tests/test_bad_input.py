"""Everything a user can get wrong, one row each: exit code 2, one line that names it, and nothing touched.

The rows run as real processes, two at a time.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

from layerfix.formats.png.encode import encode_png
from layerfix.printers import printer_folder
from tests.making import Run, box, contents, joined, run_layerfix, thin_part, write_stl

PITCH = ("--pixel", "50um", "--layer", "0.1mm")
FIX = (*PITCH, "--min-feature", "0.4mm")
FDM = ("-p", "prusa-mk3s-0.4")
HUGE = np.float32(3e38)


# What is in the folder before -----------------------------------------------------------------------------


def part(folder: Path) -> None:
    write_stl(folder / "part.stl", thin_part())


def nothing(folder: Path) -> None:
    pass


def sized(scale: float) -> Callable[[Path], None]:
    """A part of 12 × 7 × 3.5, times `scale`."""
    return lambda folder: write_stl(folder / "part.stl", box([0, 0, 0], np.multiply([12, 7, 3.5], scale))) and None


def file(name: str, data: bytes) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)

    return make


def cut_short(name: str, data: bytes) -> Callable[[Path], None]:
    return file(name, data[: len(data) // 2])


def stl_bytes(triangles: np.ndarray) -> bytes:
    """A binary STL of (n, 3, 3) corners, whatever their values."""
    body = b"".join(bytes(12) + t.astype("<f4").tobytes() + bytes(2) for t in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + body


CORNERS = (lambda mesh: mesh.vertices[mesh.faces])(box([0, 0, 0], [12, 7, 3.5]))


def with_value(value: float) -> bytes:
    corners = CORNERS.copy()
    corners[5, 1, 2] = value
    return stl_bytes(corners)


def image(shape: tuple[int, int] = (40, 60)) -> bytes:
    """A PNG of noise, as layerfix writes it but without pitch and heights."""
    from layerfix.bits import pack

    return encode_png(pack(np.random.default_rng(0).random(shape) < 0.5), shape[1])


def layers(*files: tuple[str, bytes]) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / "layers").mkdir()
        for name, data in files:
            (folder / "layers" / name).write_bytes(data)

    return make


def written_layers(name: str) -> Callable[[Path], None]:
    """Layers of the thin part that layerfix itself has written."""

    def make(folder: Path) -> None:
        from layerfix import slice_mesh, write

        write(folder / name, slice_mesh(thin_part(), pixel_mm=0.05, layer_mm=0.1))

    return make


def zip_cut_short(folder: Path) -> None:
    written_layers("layers.zip")(folder)
    data = (folder / "layers.zip").read_bytes()
    (folder / "layers.zip").write_bytes(data[: len(data) // 2])


def jpeg_called_png(folder: Path) -> None:
    (folder / "layers").mkdir()
    Image.new("L", (60, 40)).save(folder / "layers" / "1.png", "JPEG")


def printer(**changes: str) -> Callable[[Path], None]:
    """The thin part, and a printer file with some lines changed or added."""

    def make(folder: Path) -> None:
        part(folder)
        lines = (printer_folder() / "prusa-sl1s.toml").read_text(encoding="utf-8").splitlines()
        kept = [line for line in lines if line.split(" = ")[0] not in changes]
        (folder / "mine.toml").write_text("\n".join([*kept, *(f"{k} = {v}" for k, v in changes.items())]))

    return make


def existing(*more: tuple[str, bytes]) -> Callable[[Path], None]:
    """The thin part, and files of somebody's."""

    def make(folder: Path) -> None:
        part(folder)
        for name, data in more:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)

    return make


def link_to_part(folder: Path) -> None:
    part(folder)
    (folder / "link.zip").symlink_to("part.stl")


# The table --------------------------------------------------------------------------------------------------


class Case(NamedTuple):
    """Files to make, arguments after `fix`, words that the one line must have."""

    files: Callable[[Path], None]
    args: tuple[object, ...]
    words: tuple[str, ...]


CASES = {
    # No such thing, or not what it says
    "no such mesh": Case(nothing, ("part.stl", "out", *FIX), ("part.stl", "no such file")),
    "no such zip": Case(nothing, ("layers.zip", "out", *FIX), ("layers.zip", "no such file")),
    "no such folder": Case(nothing, ("layers", "out", *FIX), ("layers", "no such file or folder")),
    "a folder without images": Case(
        layers(("notes.txt", b"x")), ("layers", "out", *FIX), ("layers", "no PNG images")
    ),
    "an empty folder": Case(layers(), ("layers", "out", *FIX), ("layers", "no PNG images")),
    "a folder that is called a mesh": Case(
        lambda folder: (folder / "part.stl").mkdir(), ("part.stl", "out", *FIX), ("part.stl", "folder")
    ),
    "images of several sizes": Case(
        layers(("1.png", image()), ("2.png", image((40, 61)))),
        ("layers", "out", *FIX),
        ("2.png", "61 × 40", "60 × 40"),
    ),
    "an image that is none": Case(
        layers(("1.png", image()), ("2.png", b"hello" * 20)), ("layers", "out", *FIX), ("2.png", "PNG image")
    ),
    "an empty image": Case(
        layers(("1.png", image()), ("2.png", b"")), ("layers", "out", *FIX), ("2.png", "PNG image")
    ),
    "an image that is cut short": Case(
        layers(("1.png", image()), ("2.png", image()[:-40])), ("layers", "out", *FIX), ("2.png", "PNG image")
    ),
    "an image that is cut short, to a zip": Case(
        layers(("1.png", image()), ("2.png", image()[:90])),
        ("layers", "out.zip", *FIX),
        ("2.png", "PNG image"),
    ),
    "a jpeg called png": Case(jpeg_called_png, ("layers", "out", *FIX), ("1.png", "PNG image")),
    "a zip that is cut short": Case(zip_cut_short, ("layers.zip", "out", *FIX), ("layers.zip",)),
    "a text called zip": Case(file("layers.zip", b"hello"), ("layers.zip", "out", *FIX), ("layers.zip",)),
    "images without a pitch": Case(
        layers(("1.png", image())), ("layers", "out", "--min-feature", "0.4mm"), ("layers", "--pixel", "--layer")
    ),
    "an unknown kind of input": Case(
        file("part.step", b"ISO-10303-21;"), ("part.step", "out", *FIX), ("part.step", ".stl", ".3mf", ".zip")
    ),
    "an unknown kind of output": Case(
        part, ("part.stl", "out.xyz", *FIX), ("out.xyz", "'.xyz'", "a folder", ".zip", ".gcode")
    ),
    "standard output": Case(part, ("part.stl", "-", *FIX), ("-", "name a file")),
    # FDM
    "G-code as input": Case(file("part.gcode", b"G1 X1 Y1 E1\n"), ("part.gcode", "out", *FIX), ("layerfix draw",)),
    "G-code without a printer": Case(part, ("part.stl", "out.gcode", *FIX), ("out.gcode", "--printer")),
    "G-code for a resin printer": Case(
        part, ("part.stl", "out.gcode", "-p", "prusa-sl1s"), ("prusa-sl1s", "nozzle")
    ),
    "layers above the nozzle": Case(
        part, ("part.stl", "out.gcode", *FDM, "--layer", "0.5mm"), ("0.5 mm", "0.4 mm", "0.3 mm")
    ),
    "a first layer above the nozzle": Case(
        part, ("part.stl", "out.3mf", *FDM, "--first-layer", "0.45mm"), ("0.45 mm", "0.4 mm")
    ),
    "a bead too wide for the nozzle": Case(
        part, ("part.stl", "out.gcode", *FDM, "--width", "0.9mm"), ("0.9 mm", "0.34 mm to 0.8 mm")
    ),
    "a bead too narrow for the nozzle": Case(
        part, ("part.stl", "out.gcode", *FDM, "--width", "0.3mm"), ("0.3 mm", "0.34 mm to 0.8 mm")
    ),
    "a part larger than the bed": Case(
        sized(30), ("part.stl", "out.gcode", *FDM), ("part.stl", "360 × 210 × 105", "250 × 210 × 210")
    ),
    "pixels that are not square": Case(
        part, ("part.stl", "out.gcode", *FDM, "--pixel", "50umx40um"), ("50 µm × 40 µm", "square")
    ),
    "pixels too coarse for the nozzle": Case(
        part, ("part.stl", "out.gcode", *FDM, "--pixel", "0.2mm"), ("0.2 mm", "50 µm")
    ),
    "a tolerance above the feature": Case(
        part, ("part.stl", "out.3mf", *FDM, "--tolerance", "0.9mm"), ("0.9 mm", "0.8 mm")
    ),
    "layers that are not there": Case(part, ("part.stl", "out.svg", *FDM, "--layers", "90:95"), ("part.stl", "90")),
    # Meshes
    "an empty mesh": Case(file("part.stl", b""), ("part.stl", "out", *FIX), ("part.stl",)),
    "an empty obj": Case(file("part.obj", b""), ("part.obj", "out", *FIX), ("part.obj",)),
    "a mesh of nothing": Case(
        file("part.stl", stl_bytes(CORNERS[:0])), ("part.stl", "out", *FIX), ("part.stl", "no triangles")
    ),
    "a mesh of garbage": Case(file("part.stl", bytes(range(256)) * 9), ("part.stl", "out", *FIX), ("part.stl",)),
    "a mesh of words": Case(file("part.stl", b"hello world\n" * 50), ("part.stl", "out", *FIX), ("part.stl",)),
    "a mesh cut short": Case(cut_short("part.stl", stl_bytes(CORNERS)), ("part.stl", "out", *FIX), ("part.stl",)),
    "a 3mf that is no zip": Case(file("part.3mf", b"PK not really"), ("part.3mf", "out", *FIX), ("part.3mf",)),
    "a mesh with NaN": Case(file("part.stl", with_value(np.nan)), ("part.stl", "out", *FIX), ("part.stl", "NaN")),
    "a mesh with infinity": Case(
        file("part.stl", with_value(np.inf)), ("part.stl", "out", *FIX), ("part.stl", "infinite")
    ),
    "a mesh with a wild number": Case(
        file("part.stl", with_value(HUGE)), ("part.stl", "out", *FIX), ("part.stl", "huge")
    ),
    "a wild number in a given unit": Case(
        file("part.stl", with_value(HUGE)), ("part.stl", "out", *FIX, "--unit", "mm"), ("part.stl",)
    ),
    "a mesh without thickness": Case(
        file("part.stl", stl_bytes(CORNERS * [1, 1, 0])), ("part.stl", "out", *FIX), ("part.stl", "thickness")
    ),
    "a mesh on edge without thickness": Case(
        file("part.stl", stl_bytes(CORNERS * [0, 1, 1])), ("part.stl", "out", *FIX), ("part.stl", "thickness")
    ),
    "a mesh in one point": Case(
        file("part.stl", stl_bytes(CORNERS * 0)), ("part.stl", "out", *FIX), ("part.stl", "one point")
    ),
    "a mesh in metres": Case(
        sized(0.001), ("part.stl", "out", *FIX), ("part.stl", "tiny", "--unit m (12 mm)", "--unit mm")
    ),
    "a mesh in inches": Case(sized(1 / 25.4), ("part.stl", "out", *FIX), ("part.stl", "tiny", "--unit in (12 mm)")),
    "a mesh of five metres": Case(
        sized(5000 / 12), ("part.stl", "out", *FIX), ("part.stl", "5000", "huge", "--unit")
    ),
    "a unit that is none": Case(part, ("part.stl", "out", *FIX, "--unit", "furlong"), ("furlong", "mm", "in")),
    "lower than a quarter of a layer": Case(
        part, ("part.stl", "out", *FIX, "--layer", "9mm"), ("part.stl", "2 mm tall", "9 mm")
    ),
    "layers without end": Case(part, ("part.stl", "out", *FIX, "--layer", "1nm"), ("part.stl", "2000000 layers")),
    "pixels without end": Case(part, ("part.stl", "out", *FIX, "--pixel", "10nm"), ("part.stl", "larger pixels")),
    # Printers
    "larger than the printer": Case(
        sized(20), ("part.stl", "out", "-p", "prusa-sl1s"), ("part.stl", "240 × 140 × 70", "81 × 128 × 150")
    ),
    "taller than the printer": Case(
        lambda folder: write_stl(folder / "part.stl", box([0, 0, 0], [9, 9, 151])) and None,
        ("part.stl", "out", "-p", "prusa-sl1s"), ("part.stl", "9 × 9 × 151", "81 × 128 × 150"),
    ),
    "an unknown printer": Case(
        part, ("part.stl", "out", "-p", "prusa-sl2"), ("prusa-sl2", "prusa-sl1s", "layerfix printers")
    ),
    "no such printer file": Case(part, ("part.stl", "out", "-p", "mine.toml"), ("mine.toml", "no such file")),
    "a printer that is no toml": Case(
        existing(("mine.toml", b"maker = ")),
        ("part.stl", "out", "-p", "mine.toml"),
        ("mine.toml", "not a valid TOML"),
    ),
    "a printer with a wrong key": Case(
        printer(layer_hight="1"), ("part.stl", "out", "-p", "mine.toml"), ("mine.toml", "layer_hight", "layer_mm")
    ),
    "a printer with a wrong value": Case(
        printer(layer_mm='"thin"'), ("part.stl", "out", "-p", "mine.toml"), ("mine.toml", "layer_mm = 'thin'")
    ),
    "no printer and no pitch": Case(
        part, ("part.stl", "out", "--min-feature", "0.4mm"), ("part.stl", "--printer", "--pixel")
    ),
    "no printer and no feature": Case(part, ("part.stl", "out", *PITCH), ("--min-feature", "--printer")),
    # The feature
    "a feature under a pixel": Case(part, ("part.stl", "out", *PITCH, "--min-feature", "40um"), ("40 µm", "50 µm")),
    "a feature under a pixel of images": Case(
        written_layers("layers"), ("layers", "out", "--min-feature", "40um"), ("40 µm", "50 µm")
    ),
    "a feature larger than the part": Case(
        part, ("part.stl", "out", *PITCH, "--min-feature", "9mm"), ("part.stl", "6 × 4 mm", "9 mm")
    ),
    "a feature larger than the images": Case(
        written_layers("layers.zip"), ("layers.zip", "out", "--min-feature", "20mm"), ("20 mm", "8 mm × 6 mm")
    ),
    # Outputs
    "an existing file": Case(
        existing(("out.zip", b"mine")), ("part.stl", "out.zip", *FIX), ("out.zip", "exists already", "--force")
    ),
    "an existing folder": Case(
        existing(("out/1.png", b"mine")), ("part.stl", "out", *FIX), ("out", "exists already", "--force")
    ),
    "a folder with other things, by force": Case(
        existing(("out/thesis.txt", b"mine")), ("part.stl", "out", *FIX, "--force"), ("out", "thesis.txt")
    ),
    "a file where the folder should be": Case(
        existing(("out", b"mine")), ("part.stl", "out", *FIX, "--force"), ("out", "is a file")
    ),
    "a folder where the file should be": Case(
        existing(("out.zip/1.png", b"mine")), ("part.stl", "out.zip", *FIX, "--force"), ("out.zip", "is a folder")
    ),
    "a target in a folder that is not there": Case(
        part, ("part.stl", "none/out.zip", *FIX), ("none/out.zip", "no folder")
    ),
    "a target inside a file": Case(part, ("part.stl", "part.stl/out.zip", *FIX), ("part.stl/out.zip", "no folder")),
    "an existing picture": Case(
        existing(("look.png", b"mine")), ("part.stl", "out", *FIX, "--picture", "look.png"), ("look.png", "--force")
    ),
    "a picture in a folder that is not there": Case(
        part, ("part.stl", "out", *FIX, "--picture", "none/look.png"), ("none/look.png", "no folder")
    ),
    "a picture where a folder is": Case(
        existing(("look/1.png", b"mine")), ("part.stl", "out", *FIX, "--picture", "look", "--force"), ("look",)
    ),
    "the output is the input": Case(
        written_layers("layers.zip"), ("layers.zip", "layers.zip", *FIX, "--force"), ("layers.zip", "input")
    ),
    "the output is the input folder": Case(
        written_layers("layers"), ("layers", "./layers/", *FIX, "--force"), ("layers", "input")
    ),
    "the output is a link to the input": Case(
        link_to_part, ("part.stl", "link.zip", *FIX, "--force"), ("link.zip", "input")
    ),
    "the picture is the input": Case(
        part, ("part.stl", "out", *FIX, "--picture", "part.stl", "--force"), ("part.stl", "PNG")
    ),
    "the picture is the output": Case(
        part, ("part.stl", "out.zip", *FIX, "--picture", "out.zip"), ("out.zip",)
    ),
}  # fmt: skip

# Caught by click, which shows how to call the command first and the error in its last line.
USAGE = {
    "a negative layer": Case(
        part, ("part.stl", "out", *FIX, "--layer", "-0.05mm"), ("--layer", "-0.05mm", "above 0")
    ),
    "a negative layer after =": Case(
        part, ("part.stl", "out", *FIX, "--layer=-0.05mm"), ("--layer", "-0.05mm", "above 0")
    ),
    "no pixel": Case(part, ("part.stl", "out", *FIX, "--pixel", "0um"), ("--pixel", "0um", "above 0")),
    "no feature": Case(
        part, ("part.stl", "out", *PITCH, "--min-feature", "0mm"), ("--min-feature", "0mm", "above 0")
    ),
    "a length without a unit": Case(
        part, ("part.stl", "out", *FIX, "--layer", "0.05"), ("--layer", "0.05mm", "unit")
    ),
    "a length in furlongs": Case(part, ("part.stl", "out", *FIX, "--layer", "1furlong"), ("--layer", "furlong")),
    "a length in words": Case(part, ("part.stl", "out", *FIX, "--layer", "thin"), ("--layer", "thin", "0.3mm")),
    "an infinite length": Case(part, ("part.stl", "out", *FIX, "--layer", "1e400mm"), ("--layer", "1e400mm")),
    "a pitch of three": Case(
        part, ("part.stl", "out", *FIX, "--pixel", "1umx2umx3um"), ("--pixel", "1umx2umx3um", "50um")
    ),
    "half a pitch": Case(part, ("part.stl", "out", *FIX, "--pixel", "19umx"), ("--pixel",)),
    "no workers": Case(part, ("part.stl", "out", *FIX, "--workers", "0"), ("--workers", "0")),
    "two bits": Case(part, ("part.stl", "out", *FIX, "--bits", "2"), ("--bits", "2")),
    "an unknown mode": Case(
        part, ("part.stl", "out", *FIX, "--mode", "thicker"), ("--mode", "thicker", "as_printed")
    ),
    "an unknown fill": Case(part, ("part.stl", "out", *FIX, "--fill", "odd"), ("--fill", "odd", "even_odd")),
}


class Outcome(NamedTuple):
    """What a row came to: the process, and the folder before and after."""

    done: Run
    before: dict[str, bytes | None]
    after: dict[str, bytes | None]


def run_case(case: Case, folder: Path) -> Outcome:
    case.files(folder)
    before = contents(folder)
    done = run_layerfix("fix", *case.args, cwd=folder, env={"OMP_NUM_THREADS": "1"})
    return Outcome(done, before, contents(folder))


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Future[Outcome]]]:
    """All rows, started in order; a test waits for its own."""
    pool = ThreadPoolExecutor(min(os.cpu_count() or 1, 4))
    yield {
        name: pool.submit(run_case, case, tmp_path_factory.mktemp("case"))
        for name, case in {**CASES, **USAGE}.items()
    }
    pool.shutdown(cancel_futures=True)


@pytest.mark.parametrize("name", CASES)
def test_bad_input_is_explained_in_one_line(name, outcomes):
    """Exit code 2, nothing on stdout, one line on stderr that names the file or the value and what would do."""
    done, before, after = outcomes[name].result()
    assert "Traceback" not in done.err
    assert (done.code, done.out) == (2, "")
    assert len(done.err.splitlines()) == 1, done.err
    assert done.err.startswith("layerfix: ")
    assert [word for word in CASES[name].words if word not in done.err] == [], done.err
    assert after == before


@pytest.mark.parametrize("name", USAGE)
def test_a_bad_option_is_explained(name, outcomes):
    """Exit code 2, how the command is called, and in the last line the option, its value and what would do."""
    done, before, after = outcomes[name].result()
    assert "Traceback" not in done.err
    assert (done.code, done.out) == (2, "")
    assert len(done.err.splitlines()) <= 4, done.err
    last = done.err.splitlines()[-1]
    assert last.startswith("Error: ")
    assert [word for word in USAGE[name].words if word not in last] == [], last
    assert after == before


def test_several_shells_far_apart_are_one_part(tmp_path):
    """The size that is checked is that of all bodies together: two boxes 200 mm apart do not fit 128 mm."""
    write_stl(tmp_path / "part.stl", joined(box([0, 0, 0], [5, 5, 5]), box([200, 0, 0], [205, 5, 5])))
    done = run_layerfix("fix", "part.stl", "out", "-p", "prusa-sl1s", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "205 × 5 × 5 mm" in done.err
