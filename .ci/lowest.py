"""The lowest versions that pyproject.toml admits, one a line, as constraints for pip."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
# Programs that look at the code; what it runs with is not theirs to say.
TOOLS = ("ruff", "mypy")


def constraints(pyproject: str) -> list[str]:
    """``numpy>=2.0`` becomes ``numpy==2.0``. Raises ValueError for a dependency without a lower bound."""
    project = tomllib.loads(pyproject)["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    found = []
    for requirement in wanted:
        match = re.fullmatch(r"([A-Za-z0-9._-]+)>=([0-9][0-9A-Za-z.]*)", requirement)
        if match is None:
            raise ValueError(f"pyproject.toml: '{requirement}' is not name>=version")
        if match[1] not in TOOLS:
            found.append(f"{match[1]}=={match[2]}")
    return found


if __name__ == "__main__":
    print("\n".join(constraints(PYPROJECT.read_text(encoding="utf-8"))))
