"""Builds the plugins as files that their hosts install: ``python plugin/build.py FOLDER``.

The same sources give the same bytes: files in order, without times, stored as they are (another zlib deflates
otherwise). No name has a version in it: hosts know a plugin, and the settings that people made for it, by its file.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import os
import tomllib
import zipfile
from collections.abc import Callable, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
LONG_AGO = (1980, 1, 1, 0, 0, 0)
SUFFIXES = (".py", ".toml", ".typed", ".json", ".qml", ".js", ".css", ".html", ".txt")
# What a correction of outlines imports of what layerfix depends on: the host installs these when it loads the plugin.
ORCA_NEEDS = ("numpy", "numba", "shapely", "opencv-contrib-python-headless")


def project() -> dict[str, Any]:
    """The package's entry in pyproject.toml: name, version, what it depends on."""
    found: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return found


def sources(folder: Path, under: str) -> dict[str, bytes]:
    """The files of a package by their name in the archive; text with plain line ends, wherever it was checked out."""
    return {
        f"{under}/{path.relative_to(folder).as_posix()}": path.read_bytes().replace(b"\r\n", b"\n")
        for path in sorted(folder.rglob("*"))
        if path.suffix in SUFFIXES and not {"__pycache__", "node_modules"} & set(path.parts)
    }


def wheel_sources() -> dict[str, bytes]:
    """What a wheel of layerfix has: its package without what pyproject.toml leaves out, and the printers."""
    built = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    left_out = [pattern.removeprefix("src/") for pattern in built["targets"]["wheel"]["exclude"]]
    found = sources(ROOT / "src" / "layerfix", "layerfix")
    kept = {
        name: data
        for name, data in found.items()
        if not any(fnmatch(name, pattern) or name.startswith(f"{pattern}/") for pattern in left_out)
    }
    return {**kept, **sources(ROOT / "sample_printers", "layerfix/sample_printers")}


def zipped(files: Mapping[str, bytes], target: Path) -> None:
    """A zip that appears whole or not at all, and is the same for the same files."""
    new = target.with_name(f".{target.name}.new")
    with zipfile.ZipFile(new, "w") as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, LONG_AGO)
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            archive.writestr(entry, files[name])
    os.replace(new, target)


def orca(target: Path) -> None:
    """A wheel with the plugin and layerfix itself in it."""
    about = project()
    version = about["version"]
    needs = [line for line in about["dependencies"] if line.partition(">")[0] in ORCA_NEEDS]
    info = f"layerfix_orca-{version}.dist-info"
    metadata = [
        "Metadata-Version: 2.1",
        "Name: layerfix-orca",
        f"Version: {version}",
        "Summary: Thickens what is thinner than the nozzle can print, layer by layer, before perimeters are made.",
        "Author: layerfix",
        "License: MIT",
        f"Requires-Python: {about['requires-python']}",
        *(f"Requires-Dist: {line}" for line in needs),
    ]
    files = {
        **wheel_sources(),
        **sources(HERE / "orca" / "layerfix_orca", "layerfix_orca"),
        f"{info}/METADATA": ("\n".join(metadata) + "\n").encode(),
        f"{info}/WHEEL": b"Wheel-Version: 1.0\nGenerator: layerfix\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/top_level.txt": b"layerfix_orca\n",  # the one that the host imports
        f"{info}/LICENSE": (ROOT / "LICENSE").read_bytes(),
    }
    files[f"{info}/RECORD"] = record(files, f"{info}/RECORD")
    zipped(files, target)


def record(files: Mapping[str, bytes], own_name: str) -> bytes:
    """A wheel's list of its files, with digests."""
    lines = []
    for name in sorted(files):
        digest = base64.urlsafe_b64encode(hashlib.sha256(files[name]).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(files[name])}")
    return "\n".join([*lines, f"{own_name},,", ""]).encode()


def cura(target: Path) -> None:
    """A package as Cura installs one that is dropped on its window: package.json, and the plugin's folder."""
    plugin = json.loads((HERE / "cura" / "Layerfix" / "plugin.json").read_text(encoding="utf-8"))
    package = {
        "package_id": "Layerfix",
        "package_type": "plugin",
        "display_name": plugin["name"],
        "description": plugin["description"],
        "package_version": plugin["version"],
        "sdk_version": plugin["api"],
        "sdk_version_semver": plugin["supported_sdk_versions"][0],
        "website": "",
        "author": {"author_id": "layerfix", "display_name": plugin["author"]},
    }
    files = {
        **sources(HERE / "cura" / "Layerfix", "files/plugins/Layerfix"),
        "files/plugins/Layerfix/LICENSE": (ROOT / "LICENSE").read_bytes(),
        "package.json": (json.dumps(package, indent=4) + "\n").encode(),
    }
    zipped(files, target)


PLUGINS: dict[str, Callable[[Path], None]] = {"layerfix_orca.whl": orca, "layerfix_cura.curapackage": cura}


def build(folder: Path) -> list[Path]:
    """All plugins into a folder, which is made if it is not there; files of the same name are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in PLUGINS.items():
        make(folder / name)
    return [folder / name for name in PLUGINS]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="where the files go")
    for made in build(parser.parse_args().folder):
        print(made)
