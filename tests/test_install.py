"""What an installed package needs: its data, a quick start, and a place to keep the compiled kernels."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import layerfix
from layerfix.printers import printer_folder
from tests.making import SOURCE, environment, give_up_override

PACKAGE = Path(layerfix.__file__).parent
HEAVY = {"numpy", "numba", "cv2", "trimesh", "shapely", "skimage", "PIL", "isal", "scipy", "networkx", "lxml"}
# As small as a use of the kernels can be; counts what numba had to compile and what it could load.
CORRECT_ONE_IMAGE = """
import numpy as np
from layerfix import correct_image
image = np.zeros((40, 40), bool)
image[20, 5:35] = True
assert correct_image(image, 3).sum() > image.sum()
from layerfix.kernels import kernels_of
names = ("correction", "morphology", "thinning", "columns", "skeleton")
stats = [kernel.stats for kernel in kernels_of(*(f"layerfix.layers.{name}" for name in names))]
print(sum(sum(s.cache_hits.values()) for s in stats), sum(sum(s.cache_misses.values()) for s in stats))
"""


def python(code: str, **more: object) -> subprocess.CompletedProcess[str]:
    options = {"env": environment(), "capture_output": True, "text": True, "timeout": 120, "check": False, **more}
    return subprocess.run([sys.executable, "-c", code], **options)


def imported_by(code: str) -> set[str]:
    """Top-level packages that are loaded after running `code` in a new Python."""
    done = python(code + "\nimport sys; print(*sorted({name.split('.')[0] for name in sys.modules}))")
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split("\n")[-2].split())


@pytest.mark.parametrize(
    "code",
    ["import layerfix", "import layerfix.cli", "import layerfix.errors, layerfix.units, layerfix.printers",
     "from click.testing import CliRunner; from layerfix.cli import layerfix as l\n"
     "for args in (['--version'], ['--help'], ['fix', '--help'], ['printers']):\n"
     "    assert CliRunner().invoke(l, args).exit_code == 0"],
    ids=["layerfix", "cli", "printers", "commands"],
)  # fmt: skip
def test_what_needs_no_kernels_loads_none(code):
    """`import layerfix`, --version, --help and `layerfix printers` pull in no numpy, numba, cv2 or trimesh."""
    assert imported_by(code) & HEAVY == set()


def test_the_version_comes_at_once():
    """`layerfix --version` in well under a second, by the best of three."""
    times = []
    for _ in range(3):
        started = time.monotonic()
        subprocess.run(
            [sys.executable, "-m", "layerfix", "--version"], env=environment(), check=True, capture_output=True
        )
        times.append(time.monotonic() - started)
    assert min(times) < 0.5


def test_the_printers_are_package_data():
    """The folder exists, has printers in it, and the wheel puts it where the installed package looks."""
    assert list(printer_folder().glob("*.toml"))
    pyproject = Path(__file__).parents[1] / "pyproject.toml"
    assert '"sample_printers" = "layerfix/sample_printers"' in pyproject.read_text()


def test_printers_inside_the_package_are_found(tmp_path):
    """As a wheel installs it: the printers lie inside the package, and there is no checkout around it."""
    installed = tmp_path / "site" / "layerfix"
    shutil.copytree(PACKAGE, installed, ignore=shutil.ignore_patterns("__pycache__", "sample_printers"))
    shutil.copytree(printer_folder(), installed / "sample_printers")
    done = python(
        "from layerfix import printers as p; print(p.printer_folder()); print(*p.printer_names())",
        env=environment(PYTHONPATH=str(tmp_path / "site")),
        cwd=tmp_path,
    )
    folder, names = done.stdout.splitlines()
    assert folder == str(installed / "sample_printers")
    assert set(names.split()) == {path.stem for path in printer_folder().glob("*.toml")}


def test_the_package_says_that_it_is_typed():
    """py.typed is beside the source, so that type checkers read the hints."""
    assert (PACKAGE / "py.typed").is_file()


def test_every_public_name_can_be_loaded_and_a_wrong_one_says_so():
    """The lazy names all lead somewhere."""
    for name in layerfix.__all__:
        assert getattr(layerfix, name) is not None
    assert set(layerfix.__all__) <= set(dir(layerfix))
    with pytest.raises(AttributeError, match="module 'layerfix' has no attribute 'corect'"):
        _ = layerfix.corect


def test_kernels_are_kept_when_the_package_cannot_be_written_to(tmp_path):
    """A package that an administrator installed: the kernels are kept under the user's cache folder, the second
    run loads every one of them, and nothing is written into the package.
    """
    site, home = tmp_path / "site", tmp_path / "home"
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(SOURCE / "layerfix", site / "layerfix", ignore=ignore)
    home.mkdir()
    for path in [*site.rglob("*"), site]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    env = environment(PYTHONPATH=str(site), HOME=str(home), PYTHONDONTWRITEBYTECODE="1")
    env = {k: v for k, v in env.items() if k not in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    try:
        first = python(CORRECT_ONE_IMAGE, env=env, cwd=home, preexec_fn=give_up_override)
        assert first.returncode == 0, first.stderr
        assert len(list(home.rglob("*.kernel"))) >= 5
        again = python(CORRECT_ONE_IMAGE, env=env, cwd=home, preexec_fn=give_up_override)
        assert again.returncode == 0, again.stderr
        hits, misses = map(int, again.stdout.split())
        assert (hits > 8, misses) == (True, 0)
        assert not list(site.rglob("*.kernel"))
    finally:
        for path in [site, *site.rglob("*")]:
            if path.is_dir():
                path.chmod(0o755)
