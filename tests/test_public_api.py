"""What `import layerfix` promises: a short list of names, nothing loaded before it is used, all of it explained."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import layerfix

ROOT = Path(layerfix.__file__).parent
HEAVY = (
    *("numpy", "numba", "cv2", "trimesh", "shapely", "skimage", "scipy", "PIL", "click", "rich"),
    *("isal", "zlib_ng", "networkx", "lxml"),
)
SOURCES = {str(path.relative_to(ROOT)): path for path in sorted(ROOT.rglob("*.py"))}


def python(code: str) -> str:
    """What a fresh Python prints."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT.parent)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("name", layerfix.__all__)
def test_every_public_name_is_there(name):
    """What __all__ lists can be imported, and dir() shows it."""
    value = getattr(layerfix, name)
    assert value is getattr(layerfix, name)
    assert value.__module__.startswith("layerfix.")
    assert name in dir(layerfix)


def test_star_import_gives_exactly_the_public_names():
    """`from layerfix import *` works, too."""
    names: dict[str, object] = {}
    exec("from layerfix import *", names)
    assert set(names) - {"__builtins__"} == set(layerfix.__all__)


def test_no_name_is_listed_twice():
    """The list is short and in order."""
    assert len(set(layerfix.__all__)) == len(layerfix.__all__)


def test_type_checkers_see_every_public_name():
    """The imports for type checkers are those of __all__, from the same modules."""
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    block = next(n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    seen = {name.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for name in node.names}
    assert set(seen) == set(layerfix.__all__)
    for name, module in seen.items():
        assert getattr(__import__(module, fromlist=[name]), name) is getattr(layerfix, name)


def test_import_layerfix_loads_nothing_heavy():
    """A fresh process that imports layerfix, lists its names and reads its version has loaded no big package."""
    code = "import sys, layerfix; dir(layerfix); layerfix.__version__"
    assert python(f"{code}; print(*[m for m in {HEAVY} if m in sys.modules])") == ""


def test_import_layerfix_loads_none_of_its_modules():
    """They come with the first name that needs them."""
    code = "import sys, layerfix; print(*[m for m in sys.modules if m.startswith('layerfix.')])"
    assert python(code) == ""


@pytest.mark.parametrize(
    ("name", "unneeded"),
    [("LayerfixError", HEAVY), ("LayerStack", ("cv2", "trimesh", "shapely", "skimage", "click", "rich"))],
)
def test_a_name_loads_only_what_it_needs(name, unneeded):
    """An error class needs no numpy, a stack of images no reader of meshes."""
    code = f"import sys; from layerfix import {name}; print(*[m for m in {unneeded} if m in sys.modules])"
    assert python(code) == ""


@pytest.mark.parametrize("name", ["corect", "numpy", "_nothing", "__wrapped__"])
def test_an_unknown_name_is_an_attribute_error(name):
    """As for any module: hasattr is False, and the message names the module and the name."""
    assert not hasattr(layerfix, name)
    with pytest.raises(AttributeError, match=f"module 'layerfix' has no attribute '{name}'"):
        getattr(layerfix, name)


def test_an_unknown_name_cannot_be_imported():
    """`from layerfix import corect` is an ImportError that names it."""
    with pytest.raises(ImportError, match="corect"):
        exec("from layerfix import corect", {})


def test_the_version_is_the_distributions():
    """One number, in pyproject.toml and in the package."""
    import tomllib

    project = ROOT.parents[1] / "pyproject.toml"
    if not project.is_file():
        pytest.skip("not a checkout")
    assert tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"] == layerfix.__version__


def test_every_error_on_purpose_is_a_layerfix_error():
    """One `except` catches them all."""
    from layerfix import errors

    assert issubclass(errors.InputError, layerfix.LayerfixError)
    assert issubclass(errors.OutputError, layerfix.LayerfixError)
    assert not issubclass(layerfix.LayerfixError, (ValueError, OSError))


@pytest.mark.parametrize("source", SOURCES)
def test_everything_public_says_what_it_does(source):
    """Every module, and every public function and class in it, kernels too, has a docstring."""
    tree = ast.parse(SOURCES[source].read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), f"{source} has no docstring"
    silent = [
        node.name
        for node in tree.body
        if isinstance(node, (ast.FunctionDef, ast.ClassDef))
        and not node.name.startswith("_")
        and not ast.get_docstring(node)
    ]
    assert not silent, f"{source}: no docstring for {', '.join(silent)}"


@pytest.mark.parametrize("name", layerfix.__all__)
def test_every_public_name_has_a_docstring_when_used(name):
    """`help(layerfix.correct)` shows something; a dataclass has more than its generated signature."""
    text = getattr(layerfix, name).__doc__
    assert text
    assert not text.startswith(f"{name}(")


def test_the_reference_is_that_of_the_docstrings():
    """docs/python.md is what `python -m tests.reference` writes."""
    from tests.reference import TARGET, reference

    assert TARGET.read_text(encoding="utf-8") == reference(), "run python -m tests.reference"


def test_dir_shows_the_public_names_alone():
    """Nothing of what the module uses itself leaks."""
    assert {name for name in dir(layerfix) if not name.startswith("__")} == set(layerfix.__all__)
    code = "import layerfix; layerfix.pack; layerfix.LayerStack; print(*[n for n in dir(layerfix) if n[:2] != '__'])"
    assert set(python(code).split()) == set(layerfix.__all__)
