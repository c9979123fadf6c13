#!/usr/bin/env python3
"""Check the models of a repository, or those that a pull request adds or changes, and write a table for each.

Settings come from the environment, as action.yml sets it. The tables go to GITHUB_STEP_SUMMARY (or to standard
output), `ok=true` or `ok=false` to GITHUB_OUTPUT. Ends with 1 if LAYERFIX_FAIL is true and something would be lost,
with 2 if a model could not be looked at.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path


def main() -> int:
    """Check and report."""
    env = os.environ
    names = models(env.get("LAYERFIX_BASE", ""), env.get("LAYERFIX_MODELS", "*.stl *.3mf *.obj *.ply").split())
    own = shlex.split(env.get("LAYERFIX_OPTIONS", ""))
    if env.get("LAYERFIX_PRINTER"):
        own += ["--printer", env["LAYERFIX_PRINTER"]]
    tables, codes = [], []
    for name in names:
        code, table = checked(name, own)
        codes.append(code)
        tables.append(table)
    write(env.get("GITHUB_STEP_SUMMARY"), "\n\n".join(tables or ["No models changed."]) + "\n")
    ok = not any(codes)
    write(env.get("GITHUB_OUTPUT"), f"ok={'true' if ok else 'false'}\n")
    if any(code > 1 for code in codes):
        return 2
    return int(not ok and env.get("LAYERFIX_FAIL", "false").lower() == "true")


def models(base: str, patterns: list[str]) -> list[str]:
    """Paths of the models, sorted: of all, or of those added or changed since a commit."""
    if base:
        command = ["git", "diff", "--name-only", "-z", "--diff-filter=AMR", f"{base}...HEAD", "--", *patterns]
    else:
        command = ["git", "ls-files", "-z", "--", *patterns]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)
    if done.returncode:
        print(f"layerfix: {done.stderr.strip()} (actions/checkout needs fetch-depth: 0)", file=sys.stderr)
        sys.exit(2)
    return sorted(name for name in done.stdout.split("\0") if name)


def checked(name: str, own: list[str]) -> tuple[int, str]:
    """(exit code of `layerfix check`, its table, or what is wrong with the file)."""
    command = shlex.split(os.environ.get("LAYERFIX", "layerfix"))
    done = subprocess.run([*command, "check", f"./{name}", "--markdown", *own], capture_output=True, text=True,
                          encoding="utf-8", check=False)  # fmt: skip
    if done.returncode > 1:
        said = done.stderr.strip().removeprefix("layerfix: ").replace("|", "\\|")
        shown = name.replace("`", "'")
        return done.returncode, f"### :x: layerfix check: `{shown}`\n\n{said}"
    return done.returncode, done.stdout.strip()


def write(path: str | None, text: str) -> None:
    """To the file that a workflow names, else to standard output."""
    if not path:
        print(text, end="")
        return
    with Path(path).open("a", encoding="utf-8") as file:
        file.write(text)


if __name__ == "__main__":
    sys.exit(main())
