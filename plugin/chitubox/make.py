#!/usr/bin/env python3
"""Make layerfix.CHplugin, the archive that Chitubox installs: ``python plugin/chitubox/make.py [FOLDER]``."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).parent
EXECUTABLE = ("layerfix_chitubox.py", "layerfix_chitubox.bat")
NAMES = ("plugin.json", *EXECUTABLE, "options.txt", "README.md")


def make(folder: Path) -> Path:
    """The archive, written into a folder: the same bytes from the same files."""
    target = folder / "layerfix.CHplugin"
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in NAMES:
            entry = zipfile.ZipInfo(name)
            entry.external_attr = (0o755 if name in EXECUTABLE else 0o644) << 16
            archive.writestr(entry, (HERE / name).read_bytes(), zipfile.ZIP_DEFLATED)
    return target


if __name__ == "__main__":
    print(make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path()))
