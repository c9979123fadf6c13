"""The lowest versions that pyproject.toml admits are those that CI tries."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LOWEST = ROOT / ".ci" / "lowest.py"
pytestmark = pytest.mark.skipif(not LOWEST.exists(), reason="not a checkout")


def module():
    spec = importlib.util.spec_from_file_location("lowest", LOWEST)
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_every_dependency_has_its_lowest_version_as_a_constraint():
    """One line for each dependency and each package the tests need, in the words of pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    printed = subprocess.run([sys.executable, LOWEST], capture_output=True, text=True, check=True).stdout.splitlines()
    assert printed == [r.replace(">=", "==") for r in wanted if r.split(">=")[0] not in ("ruff", "mypy")]
    assert "click==8.5" in printed
    assert "shapely==2.1" in printed
    assert "trimesh==4.7" in printed


@pytest.mark.parametrize("requirement", ["numpy", "numpy>2", "numpy>=2,<3", "numpy~=2.0", "numpy==2.0", "numpy>="])
def test_a_dependency_without_a_plain_lower_bound_is_refused(requirement):
    """Or it would be tried at whatever version pip finds."""
    text = f'[project]\ndependencies = ["{requirement}"]\noptional-dependencies.test = []\n'
    with pytest.raises(ValueError, match="is not name>=version"):
        module().constraints(text)


def test_what_runs_on_the_lowest_versions_is_there():
    """A renamed test file must not fall out of the list."""
    names = [line for line in (ROOT / ".ci" / "lowest-tests").read_text().splitlines() if not line.startswith("#")]
    assert len(names) >= 4
    assert [name for name in names if not (ROOT / name).is_file()] == []
    run = (ROOT / ".ci" / "run").read_text()
    assert ".ci/lowest.py" in run
    assert ".ci/lowest-tests" in run
