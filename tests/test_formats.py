"""The table of formats: content decides what is read, the suffix what is written, and options have owners."""

from __future__ import annotations

import dataclasses
import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import layerfix as lf
from layerfix.errors import InputError, LayerfixWarning, OutputError
from layerfix.formats import find_format, find_writer, table
from layerfix.formats.options import COMMON, Own, WriteOptions, own_options
from tests.independent_readers import png_bytes, write_chitu, write_goo, write_sl1, write_zip
from tests.making import box, contents, run_layerfix, write_stl

PRINTER = "prusa-mk3s-0.4"


def square() -> np.ndarray:
    image = np.zeros((80, 120), bool)
    image[20:60, 30:90] = True
    return image


def stack(count: int = 3) -> lf.LayerStack:
    """A block of 3 × 2 mm."""
    return lf.LayerStack.from_images([square()] * count, pixel_mm=0.05, layer_mm=0.2)


# The rows


def test_every_function_that_a_row_names_is_there():
    """No row leads nowhere, and no kernel module is missing."""
    for row in table.FORMATS:
        for named in (row.layers, row.mesh, *(writer.function for writer in row.writers.values())):
            assert named is None or callable(table.function(named)), row.name
        for writer in row.writers.values():
            for module in writer.kernels:
                assert __import__(module)


def test_every_kind_of_value_that_a_row_writes_is_one():
    """`writers` has no misspelt key, and every class of KINDS exists under its name."""
    for row in table.FORMATS:
        assert set(row.writers) <= {"layers", "mesh", "widths"}
    for name in table.KINDS:
        module, _, cls = name.rpartition(".")
        assert getattr(__import__(module, fromlist=[cls]), cls)
    assert set(table.AS_LAYERS) | {"layers", "mesh"} == set(table.KINDS.values())


def test_type_checkers_know_every_option():
    """`Own` has the names of all writers' own options, and no other."""
    taken = {name for row in table.FORMATS for w in row.writers.values() for name in own_options(w.options)}
    assert set(Own.__annotations__) == taken
    assert not taken & COMMON


def test_looking_at_the_table_loads_nothing_heavy():
    """The command line lists formats at once: no format's module is loaded for it."""
    done = run_python(
        "import sys; import layerfix.formats.table; print(*[m for m in sys.modules if 'layerfix' in m])"
    )
    heavy = ("layerfix.formats.jobs", "layerfix.formats.png", "layerfix.mesh")
    assert not [module for module in done.split() if module.startswith(heavy)]


def run_python(code: str) -> str:
    import subprocess

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    return done.stdout


# Content decides what is read


def made(folder: Path) -> dict[str, Path]:
    """One file of each kind that can be made here, by the name of its row."""
    layers = [square().astype(np.uint8) * 255] * 2
    lf.write(folder / "images.zip", stack())
    lf.write(folder / "images", stack())
    lf.write(folder / "image.png", stack(1))
    lf.write(folder / "box.3mf", box([0, 0, 0], [5, 5, 5]))
    return {
        "GOO jobs (Elegoo)": write_goo(folder / "a.goo", layers),
        "Photon and CBDDLP jobs": write_chitu(folder / "a.photon", layers),
        "CTB jobs": write_chitu(folder / "a.ctb", layers, magic=0x12FD0086, version=2),
        "SL1, SL1S and M1 jobs (Prusa)": write_sl1(folder / "a.sl1", layers),
        "CWS jobs": write_zip(folder / "a.cws", {"Slice.conf": b"xppm 20\n", "a0.png": png_bytes(layers[0])}),
        "Chitubox zips (run.gcode)": write_zip(
            folder / "c.zip", {"run.gcode": b"G28", "1.png": png_bytes(layers[0])}
        ),
        "NanoDLP plates": write_zip(folder / "a.nanodlp", {"plate.json": b"{}", "profile.json": b"{}"}),
        "3MF": folder / "box.3mf",
        "zips of PNG images": folder / "images.zip",
        "folders of PNG images": folder / "images",
        "PNG images": folder / "image.png",
        "STL": write_stl(folder / "box.stl", box([0, 0, 0], [5, 5, 5])),
    }


def test_a_file_is_what_is_in_it(tmp_path):
    """Every kind is recognised under its own name, and under any other."""
    for k, (name, path) in enumerate(made(tmp_path).items()):
        assert find_format(path)[0].name == name
        if name in ("folders of PNG images", "STL"):
            continue
        other = tmp_path / f"other{k}.{'stl' if 'GOO' in name else 'goo'}"
        shutil.copy(path, other)
        assert find_format(other)[0].name == name


def test_a_zip_in_another_s_clothes(tmp_path):
    """A config.ini alone makes no SL1, a plate.json alone no NanoDLP: they are zips of images."""
    image = png_bytes(square().astype(np.uint8) * 255)
    for name, entries in {"a.zip": {"config.ini": b"x = 1"}, "b.zip": {"plate.json": b"{}"}}.items():
        path = write_zip(tmp_path / name, {**entries, "1.png": image})
        assert find_format(path)[0].name == "zips of PNG images"


def test_a_broken_file_is_read_as_what_it_is_called(tmp_path):
    """Then its reader says what is wrong with it."""
    (tmp_path / "a.sl1").write_bytes(b"PK\3\4 cut short")
    with pytest.raises(InputError, match=r"a\.sl1: not a readable zip"):
        lf.read(tmp_path / "a.sl1")
    (tmp_path / "a.txt").write_bytes(b"words")
    with pytest.raises(InputError, match=r"a\.txt: not a file that layerfix knows; it reads meshes \(.*\.stl"):
        lf.read(tmp_path / "a.txt")


def test_kinds_that_are_not_read_say_what_to_do(tmp_path):
    """An encrypted CTB, Anycubic's, G-code, whatever they are called."""
    files = {"a.ctb": b"\x07\x01\xfd\x12" + bytes(60), "b.goo": b"ANYCUBIC" + bytes(60), "c.gcode": b"G28\n"}
    words = {"a.ctb": "an encrypted CTB.*UVtools", "b.goo": "Anycubic's.*UVtools", "c.gcode": "layerfix draw"}
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=words[name]):
            lf.read(tmp_path / name)


def test_a_mesh_is_no_stack(tmp_path):
    """`read` says which call cuts layers from it."""
    with pytest.raises(InputError, match=r"box\.stl: a mesh; layers are cut from it: slice_mesh"):
        lf.read(write_stl(tmp_path / "box.stl", box([0, 0, 0], [5, 5, 5])))


# The value and the suffix decide what is written


def test_every_value_goes_somewhere(tmp_path):
    """Outlines, toolpaths, a mesh, one layer's stack and a plan of widths: the same bytes as from the stack."""
    block, printer = stack(), lf.load_printer(PRINTER)
    lf.write(tmp_path / "a.svg", block, tolerance_mm=0.01)
    lf.write(tmp_path / "b.svg", lf.trace_contours(block, tolerance_mm=0.01))
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    settings = lf.settings_for(printer, perimeters=1, skirt_loops=0)
    lf.write(tmp_path / "a.gcode", block, printer, perimeters=1, skirt_loops=0)
    lf.write(tmp_path / "b.gcode", lf.plan_toolpaths(block, settings), PRINTER)
    assert (tmp_path / "a.gcode").read_bytes() == (tmp_path / "b.gcode").read_bytes()
    part = box([0, 0, 0], [5, 5, 5])
    for name in ("part.stl", "part.3mf"):
        lf.write(tmp_path / name, part)
        assert lf.load_mesh(tmp_path / name).volume_mm3 == pytest.approx(125)
    lf.write(tmp_path / "one.png", block[1:2])
    assert np.array_equal(lf.read(tmp_path / "one.png")[0].image(), square())


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("a.zip", lambda: stack()[0], "pass a stack of one: stack"),
        ("a.png", stack, "one PNG image holds one layer, not 3"),
        ("a.zip", lambda: box([0, 0, 0], [5, 5, 5]), "do not hold a Mesh; it goes to .3mf, .stl"),
        ("a.gcode", lambda: lf.trace_contours(stack()), "G-code do not hold Contours; pass its layers: .stack"),
        ("a.zip", lambda: "text", "str is not written; pass a LayerStack"),
        ("a.xyz", stack, "no writer for '.xyz'"),
        ("a.ctb", stack, "written only from jobs of the same kind"),
        ("-", stack, "nothing is written to standard output"),
    ],
)
def test_a_value_that_a_format_does_not_hold(tmp_path, monkeypatch, name, value, words):
    """One sentence says what to pass instead, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OutputError, match=words):
        lf.write(name, value())
    assert contents(tmp_path) == {}


# Options belong to someone


@pytest.mark.parametrize("row", [row for row in table.FORMATS if "layers" in row.writers], ids=lambda row: row.name)
def test_an_option_that_a_writer_does_not_take_is_refused(tmp_path, row):
    """Each writer, with each option of the others: refused before anything is written, naming whose it is."""
    values = {"bits": 1, "tolerance_mm": 0.1, "ascii": True, "width_mm": 0.5, "perimeters": 2, "density": 0.5,
              "seam": "rear", "skirt_loops": 1, "slicer": "prusa"}  # fmt: skip
    target = tmp_path / f"out{row.suffixes[0]}"
    takes = own_options(row.writers["layers"].options)
    assert find_writer(target, stack()).options is row.writers["layers"].options
    for name in values.keys() - set(takes):
        with pytest.raises(OutputError, match=rf"{name} goes with .*; .* takes"):
            lf.write(target, stack(), PRINTER, **{name: values[name]})
    assert contents(tmp_path) == {}


def test_toolpaths_have_their_widths_already(tmp_path):
    """Another is refused in words that do not contradict themselves."""
    printer = lf.load_printer("prusa-mk3s-0.4")
    layers = lf.LayerStack.from_images([np.ones((99, 99), bool)], pixel_mm=0.05, layer_mm=0.2)
    planned = lf.plan_toolpaths(layers, lf.settings_for(printer))
    with pytest.raises(OutputError, match="width_mm: Toolpaths bring their own"):
        lf.write(tmp_path / "a.gcode", planned, printer, width_mm=0.6)
    assert not list(tmp_path.iterdir())


def test_outlines_have_their_tolerance_already(tmp_path):
    """What a value brings along cannot be said again."""
    with pytest.raises(OutputError, match="tolerance_mm: Contours bring their own"):
        lf.write(tmp_path / "a.svg", lf.trace_contours(stack()), tolerance_mm=0.1)


def test_the_command_line_names_its_options(tmp_path):
    """The example of old that ended with 0 and not a word, and its kin: exit 2, one line, nothing written."""
    write_stl(tmp_path / "part.stl", box([0, 0, 0], [5, 5, 5]))
    lf.write(tmp_path / "in.zip", stack())
    before = contents(tmp_path)
    mesh = ("part.stl", "x.zip", "-p", PRINTER)
    images = ("in.zip", "x.zip", "--min-feature", "0.2mm")
    for words, said in (
        ((*mesh, "--seam", "rear", "--infill", "50%", "--ascii", "--width", "0.9mm"),
         ("--seam goes with .gcode", "--infill goes with .gcode", "--ascii goes with .cli", ".zip takes --bits")),
        ((*mesh, "--threshold", "99"), ("--threshold: goes with images and jobs",)),
        ((*images, "--unit", "in", "--fill", "positive"), ("--fill, --unit: goes with meshes",)),
        (("part.stl", "x.gcode", "-p", PRINTER, "--bits", "1"), ("--bits goes with", ".gcode takes --width")),
    ):  # fmt: skip
        done = run_layerfix("fix", *words, cwd=tmp_path)
        assert (done.code, done.out, len(done.err.splitlines())) == (2, "", 1)
        assert all(part in done.err for part in said), done.err
        assert contents(tmp_path) == before


def test_a_slicer_without_a_project_is_refused(tmp_path):
    """`widths --slicer` goes with a .3mf."""
    write_stl(tmp_path / "part.stl", box([0, 0, 0], [5, 5, 5]))
    done = run_layerfix("widths", "part.stl", "-p", PRINTER, "-o", "a.csv", "--slicer", "orca", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "--slicer orca: goes with a .3mf" in done.err


def test_formats_are_listed():
    """A line each, with their options; the same as JSON."""
    import json

    found = json.loads(run_layerfix("formats", "--json").out)
    assert [entry["name"] for entry in found] == [row.name for row in table.FORMATS]
    lines = run_layerfix("formats").out.splitlines()
    assert len(lines) == len(found) + 1
    assert any(line.startswith("G-code") and "--infill" in line for line in lines)


# Formats of other distributions


PLUGIN = """
from dataclasses import dataclass
from layerfix.formats.options import WriteOptions
from layerfix.formats.probe import starts
from layerfix.formats.table import Format, Writer
from layerfix.stack import LayerStack
import numpy as np

@dataclass(frozen=True)
class Text(WriteOptions):
    solid: str = "#"

def read(probe, hints):
    lines = probe.path.read_text().splitlines()[1:]
    return LayerStack.from_images([[[c == "#" for c in line] for line in lines]], pixel_mm=1.0, layer_mm=1.0)

def write(path, stack, options):
    image = stack[0].image()
    path.write_text("TXT\\n" + "".join("".join(options.solid if p else "." for p in row) + "\\n" for row in image))

FORMAT = Format("text drawings", (".drawn",), starts(b"TXT"), read, writers={"layers": Writer(write, Text)})
"""


@pytest.fixture
def plugins(tmp_path, monkeypatch):
    """Two installed distributions: one with a format, one that is broken."""
    for name, target in (("good", "drawn_format:FORMAT"), ("bad", "missing_module:FORMAT")):
        folder = tmp_path / f"{name}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (folder / "entry_points.txt").write_text(f"[layerfix.formats]\n{name} = {target}\n")
    (tmp_path / "drawn_format.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    table.plugin_rows.cache_clear()
    yield tmp_path
    table.plugin_rows.cache_clear()
    sys.modules.pop("drawn_format", None)


def test_another_distribution_s_format(plugins):
    """It is written by its suffix with its own options, and read by what is in it; the broken one reports itself."""
    with pytest.warns(LayerfixWarning, match="the formats 'bad' of bad cannot be used: ModuleNotFoundError"):
        lf.write(plugins / "a.drawn", stack(1), solid="O")  # type: ignore[call-arg]
    assert "O" in (plugins / "a.drawn").read_text()
    lf.write(plugins / "b.drawn", stack(1))
    (plugins / "b.drawn").rename(plugins / "c.xyz")
    assert np.array_equal(lf.read(plugins / "c.xyz")[0].image(), square())
    with pytest.raises(OutputError, match=r"bits goes with .*; \.drawn takes solid"):
        lf.write(plugins / "d.drawn", stack(1), bits=1)


def test_a_broken_format_blocks_nothing(plugins):
    """All others work without a word of it: it is looked for only where nobody else is left."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lf.write(plugins / "a.zip", stack())
        assert zipfile.is_zipfile(plugins / "a.zip")


def test_options_are_small_frozen_values():
    """None is mutable, each says what its fields are."""
    for row in table.FORMATS:
        for writer in row.writers.values():
            assert issubclass(writer.options, WriteOptions)
            assert writer.options.__dataclass_params__.frozen
            for name in own_options(writer.options):
                text = " ".join(c.__doc__ or "" for c in writer.options.__mro__)
                assert name in text or name in {f.name for f in dataclasses.fields(lf.PathSettings)}
