"""A folder imports only from floors below its own, or from its own floor where that makes no circle."""

from __future__ import annotations

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import layerfix

ROOT = Path(layerfix.__file__).parent

# Folders and the few modules outside them, from the ground up. A folder imports only from floors below, and from
# its own floor where that makes no circle of folders.
KERNELS = "kernels", "kernel_cache", "kernels_ahead"
FLOORS = {
    0: ("errors", "units", "bits", "files", "console", "processors", "threads", *KERNELS),
    1: ("stack", "printers"),
    2: ("layers", "mesh"),
    3: ("outlines", "fdm", "surface", "draw", "samples", "orientation"),
    4: ("formats",),
    5: ("report",),
    6: ("commands",),
    7: ("cli", "__main__"),
}
FLOOR_OF = {name: floor for floor, names in FLOORS.items() for name in names}

MODULES = {
    ".".join(("layerfix", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in sorted(ROOT.rglob("*.py"))
}


def part_of(module: str) -> str:
    """The entry of FLOORS that a module belongs to: `layerfix.formats.png` to `formats`."""
    return module.split(".")[1]


def imported_by(source: str, module: str, is_package: bool, modules: set[str]) -> set[str]:
    """Modules of the package that `source` imports when it runs, also inside functions."""
    package = module if is_package else module.rpartition(".")[0]
    found: set[str] = set()
    for node in _nodes_that_run(ast.parse(source)):
        if isinstance(node, ast.Import):
            found.update(name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            submodules = {f"{base}.{name.name}" for name in node.names} & modules
            # `from layerfix.formats import png_stack` imports the module, not the package's own names.
            found |= submodules
            if len(submodules) < len(node.names):
                found.add(base)
    return {name for name in found if name == "layerfix" or name.startswith("layerfix.")}


def _nodes_that_run(tree: ast.AST) -> list[ast.AST]:
    """All nodes but those in `if TYPE_CHECKING:` blocks."""
    nodes = [tree]
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            for other in node.orelse:
                nodes += _nodes_that_run(other)
        else:
            nodes += _nodes_that_run(node)
    return nodes


@cache
def imports() -> dict[str, set[str]]:
    """Each module of the package and those of its modules that it imports."""
    return {
        module: imported_by(path.read_text(encoding="utf-8"), module, path.name == "__init__.py", set(MODULES))
        for module, path in MODULES.items()
    }


@pytest.mark.parametrize("module", [name for name in MODULES if name != "layerfix"])
def test_every_module_is_on_a_floor(module):
    """A new module is entered in FLOORS, so that its imports are looked at."""
    assert part_of(module) in FLOOR_OF, (
        f"{module} is on no floor: enter '{part_of(module)}' in FLOORS, above everything that it imports"
    )


def test_every_floor_is_of_a_module():
    """No entry is left behind when a module goes."""
    assert set(FLOOR_OF) == {part_of(module) for module in MODULES if module != "layerfix"}


@pytest.mark.parametrize("module", [name for name in MODULES if name != "layerfix"])
def test_a_module_imports_only_from_its_floor_or_below(module):
    """Imports point downwards."""
    floor = FLOOR_OF.get(part_of(module), -1)
    upwards = {
        name: FLOOR_OF.get(part_of(name))
        for name in imports()[module] - {"layerfix"}
        if FLOOR_OF.get(part_of(name), 99) > floor
    }
    assert not upwards, f"{module} (floor {floor}) imports from above: {upwards}"


def test_no_circle_of_folders():
    """Drawn folder by folder, no arrow leads back up."""
    graph: dict[str, set[str]] = {}
    for module, names in imports().items():
        if module != "layerfix":
            below = {part_of(name) for name in names if name != "layerfix"}
            graph.setdefault(part_of(module), set()).update(below - {part_of(module)})
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(f"folders import each other: {' → '.join(circle.args[1])}")


def test_no_circle_of_imports():
    """Within a folder, too, one can begin at a module that needs no other."""
    graph = {module: names - {module, "layerfix"} for module, names in imports().items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(f"modules import each other: {' → '.join(circle.args[1])}")


def test_the_package_itself_imports_none_of_its_modules():
    """`import layerfix` is instant: names are found when they are first used."""
    assert imports()["layerfix"] == set()


def test_imports_of_every_form_are_seen():
    """The reader of imports sees those in functions and relative ones, and leaves out those for type checkers."""
    source = """
import layerfix.bits
from layerfix import stack, __version__
from layerfix.formats import png, read
from . import units
from .errors import InputError
import numpy
if TYPE_CHECKING:
    from layerfix.cli import fix
else:
    from layerfix.mesh import Mesh
def lazily():
    from layerfix.job import run
"""
    known = {"layerfix.stack", "layerfix.formats.png", "layerfix.units"}
    assert imported_by(source, "layerfix.thing", is_package=False, modules=known) == {
        "layerfix",
        "layerfix.bits",
        "layerfix.stack",
        "layerfix.formats",
        "layerfix.formats.png",
        "layerfix.units",
        "layerfix.errors",
        "layerfix.mesh",
        "layerfix.job",
    }
    assert imported_by("from ..bits import pack", "layerfix.formats.png", False, set()) == {"layerfix.bits"}
    known = {"layerfix.formats.png"}
    assert imported_by("from . import png", "layerfix.formats", True, known) == known
