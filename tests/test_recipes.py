"""The recipes for Python hosts run where the hosts are installed: the code of plugin/recipes/README.md as it is."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from layerfix import Layer, load_mesh
from tests.making import write_stl
from tests.projects import fin_part

RECIPES = {
    re.search(r"# (.*)", code)[1]: code
    for code in re.findall(
        r"```python\n(.*?)```",
        (Path(__file__).parents[1] / "plugin" / "recipes" / "README.md").read_text(encoding="utf-8"),
        re.DOTALL,
    )
}


def run(name: str) -> dict[str, object]:
    """The variables that a recipe leaves."""
    found: dict[str, object] = {}
    exec(compile(RECIPES[name], name, "exec"), found)
    return found


def widest_fin(vertices: np.ndarray, *, above_mm: float) -> float:
    """Along x, of all that is higher."""
    return float(np.ptp(vertices[vertices[:, 2] > above_mm, 0]))


def test_every_recipe_is_tried():
    """One of each host."""
    assert set(RECIPES) == {"Blender", "a notebook", "CadQuery", "build123d"}


def test_in_a_notebook(tmp_path, monkeypatch):
    """The last line is a layer, which shows itself as a picture."""
    write_stl(tmp_path / "part.stl", fin_part())
    monkeypatch.chdir(tmp_path)
    found = run("a notebook")
    last = RECIPES["a notebook"].strip().splitlines()[-1]
    layer = eval(last, found)
    assert isinstance(layer, Layer)
    assert layer._repr_png_()[:4] == b"\x89PNG"


@pytest.mark.parametrize(("name", "module"), [("CadQuery", "cadquery"), ("build123d", "build123d")])
def test_in_a_modeller(tmp_path, monkeypatch, name, module):
    """A fin of 0.2 mm comes out 0.8 mm wide."""
    pytest.importorskip(module, reason=f"{module} is not installed")
    monkeypatch.chdir(tmp_path)
    run(name)
    fixed = load_mesh(tmp_path / "fixed.stl").vertices
    assert widest_fin(fixed, above_mm=fixed[:, 2].max() - 0.5) == pytest.approx(0.8, abs=0.06)


def test_in_blender():
    """The active object's mesh is replaced by the corrected one."""
    bpy = pytest.importorskip("bpy", reason="Blender's Python module is not installed")
    part = fin_part()
    mesh = bpy.data.meshes.new("part")
    mesh.from_pydata(part.vertices.tolist(), [], part.faces.tolist())
    thing = bpy.data.objects.new("part", mesh)
    bpy.context.collection.objects.link(thing)
    bpy.context.view_layer.objects.active = thing
    run("Blender")
    points = np.array([v.co for v in mesh.vertices])
    fin = points[points[:, 0] < 8]
    assert widest_fin(fin, above_mm=7.5) == pytest.approx(0.8, abs=0.06)
