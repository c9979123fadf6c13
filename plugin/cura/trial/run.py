"""Starts a real Cura without a screen, with the plugin in it, and presses its menus: ``python run.py FOLDER``.

Needs Debian's packages cura, xvfb, xauth, dbus and imagemagick, and layerfix on PATH. All of Cura's files are kept
under FOLDER, which also gets the screenshots; the machine's own Cura is not touched. Prints a line for every fact,
and ends with 1 if one did not hold. With ``--time MODEL.stl``, that model's round trip is timed against the command
alone.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import stat
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
PLUGIN = HERE.parent / "Layerfix"
sys.path[:0] = [str(PLUGIN), str(HERE.parents[1])]
import build  # noqa: E402  # found by the line above
from frames import write_stl  # noqa: E402  # found by the line above the one before

MACHINE = "creality_ender3"
VERSION = "4.13"
CONFIG = f"""[general]
version = 7
last_run_version = {VERSION}.0
accepted_user_agreement = True
window_width = 1560
window_height = 900
window_left = 20
window_top = 40
auto_slice = False

[cura]
active_machine = Trial

[info]
send_slice_info = False
automatic_update_check = False

[metadata]
setting_version = 19
"""
# Plugins that look for networks and updates, or need what is not installed.
SWITCHED_OFF = ["UM3NetworkPrinting", "TrimeshReader", "AMFReader", "CuraDrive", "DigitalLibrary", "SentryLogger",
                "SliceInfoPlugin", "FirmwareUpdateChecker", "UpdateChecker", "Toolbox", "USBPrinting",
                "RemovableDriveOutputDevice"]  # fmt: skip


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> np.ndarray:
    """(12, 3, 3) corners of a block's triangles, counter-clockwise from outside."""
    p = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)], float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return np.array([p[[q[a], q[b], q[c]]] for q in quads for a, b, c in ((0, 1, 2), (0, 2, 3))])


def made(folder: Path) -> None:
    """The models, and programs that are not layerfix or slow."""
    block, fin = box((0, 0, 0), (20, 20, 4)), box((10, 4, 2), (10.2, 16, 14))
    write_stl(folder / "fin.stl", np.concatenate([block, fin]))
    write_stl(folder / "overlapping.stl", np.concatenate([block, block + 3.0, fin + np.array([5, 0, 0])]))
    write_stl(folder / "open.stl", np.concatenate([block[:-2], fin]))
    program(folder / "of_another_version", "echo 'layerfix, version 9.7.0'")
    program(folder / "slow", 'case "$1" in --version) echo "layerfix, version 0.1.0";; *) touch "$0.running";'
            ' trap "rm -f $0.running; exit 1" TERM; for k in 1 2 3 4 5 6; do echo "layerfix: ${k}0 %" >&2;'
            " sleep 5 & wait $!; done;; esac")  # fmt: skip


def program(path: Path, body: str) -> None:
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


def machine(data: Path) -> None:
    """A printer in Cura's own files: its definitions and its usual profiles."""
    settings = {
        "machine_instances/Trial.global.cfg": _stack("Trial", "machine", [
            "Trial_user", "empty_quality_changes", "empty_intent", "base_global_standard", "empty_material",
            "empty_variant", "Trial_settings", MACHINE], group_id="4b7ddcb3-1e8d-48ed-a1d3-3428b3ded017"),
        "extruders/Trial_extruder.extruder.cfg": _stack("Trial_extruder", "extruder_train", [
            "Trial_extruder_user", "empty_quality_changes", "empty_intent", "base_0.4_PLA_standard",
            f"generic_pla_175_{MACHINE}", f"{MACHINE}_0.4", "Trial_extruder_settings", "creality_base_extruder_0"],
            position="0", machine="Trial", label="Extruder 1"),
        "user/Trial_user.inst.cfg": _changes("Trial_user", MACHINE, type="user", machine="Trial"),
        "user/Trial_extruder_user.inst.cfg": _changes("Trial_extruder_user", MACHINE, type="user",
                                                      extruder="Trial_extruder"),
        "definition_changes/Trial_settings.inst.cfg": _changes("Trial_settings", MACHINE, type="definition_changes"),
        "definition_changes/Trial_extruder_settings.inst.cfg": _changes(
            "Trial_extruder_settings", "creality_base_extruder_0", type="definition_changes"),
    }  # fmt: skip
    for name, text in settings.items():
        path = data / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def _stack(name: str, kind: str, containers: list[str], label: str = "", **metadata: str) -> str:
    listed = "".join(f"{k} = {one}\n" for k, one in enumerate(containers))
    more = "".join(f"{key} = {value}\n" for key, value in metadata.items())
    return (f"[general]\nversion = 5\nname = {label or name}\nid = {name}\n\n[metadata]\nsetting_version = 19\n"
            f"type = {kind}\n{more}\n[containers]\n{listed}")  # fmt: skip


def _changes(name: str, definition: str, **metadata: str) -> str:
    more = "".join(f"{key} = {value}\n" for key, value in metadata.items())
    return (f"[general]\nversion = 4\nname = {name}\ndefinition = {definition}\n\n[metadata]\nsetting_version = 19\n"
            f"{more}\n[values]\n")  # fmt: skip


def started(folder: Path, patience_s: float) -> int:
    """Runs Cura to its end; its exit code."""
    config, data = folder / "config", folder / "data"
    plugins = data / "cura" / VERSION / "plugins"
    (config / "cura" / VERSION).mkdir(parents=True)
    (config / "cura" / VERSION / "cura.cfg").write_text(CONFIG)
    off = json.dumps({"disabled": SWITCHED_OFF, "to_install": {}, "to_remove": []})
    (config / "cura" / VERSION / "plugins.json").write_text(off)
    # As if the package had been dropped on Cura's window: it is installed at the next start.
    package = folder / "layerfix_cura.curapackage"
    build.cura(package)
    with zipfile.ZipFile(package) as archive:
        about = json.loads(archive.read("package.json"))
    asked = {"package_info": about, "filename": str(package)}
    data_home = data / "cura" / VERSION / "packages.json"
    data_home.parent.mkdir(parents=True)
    listed = {"version": 1, "installed": {}, "to_remove": [], "to_install": {about["package_id"]: asked}}
    data_home.write_text(json.dumps(listed))
    shutil.copytree(HERE / "LayerfixTrial", plugins / "LayerfixTrial", ignore=shutil.ignore_patterns("__pycache__"))
    machine(data / "cura" / VERSION)
    for name in ("cache", "home", "run"):
        (folder / name).mkdir()
    (folder / "run").chmod(0o700)
    mine = {"HOME": "home", "XDG_CONFIG_HOME": "config", "XDG_DATA_HOME": "data", "XDG_CACHE_HOME": "cache",
            "XDG_RUNTIME_DIR": "run"}  # fmt: skip
    kernels = os.environ.get("NUMBA_CACHE_DIR") or str(Path.home() / ".cache" / "layerfix")
    env = {**os.environ, **{name: str(folder / place) for name, place in mine.items()}, "LAYERFIX_TRIAL": str(folder),
           "LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "llvmpipe", "QT_XCB_GL_INTEGRATION": "xcb_glx",
           "QT_QPA_PLATFORM": "xcb", "LC_ALL": "C.UTF-8"}  # fmt: skip
    if Path(kernels).is_dir():
        (folder / "cache" / "layerfix").symlink_to(kernels)
    with (folder / "cura.log").open("wb") as log:
        command = ["xvfb-run", "-a", "-s", "-screen 0 1600x1000x24 -nolisten tcp", "timeout", "-k", "5",
                   str(patience_s), "dbus-run-session", "--", "cura"]  # fmt: skip
        return subprocess.run(command, env=env, stdout=log, stderr=log, stdin=subprocess.DEVNULL).returncode


def beads_of_fin(gcode: Path) -> int:
    """Layers in which something is extruded above the block, where only the fin is."""
    z, layers, last = 0.0, set(), 0.0
    for line in gcode.read_text().splitlines():
        words = {word[0]: word[1:] for word in line.partition(";")[0].split() if len(word) > 1}
        if line.startswith(("G0 ", "G1 ")):
            z = float(words.get("Z", z))
            e = float(words.get("E", last))
            if e > last and "X" in words and 4.5 < z < 13.9:
                layers.add(round(z, 3))
            last = e
        elif line.startswith("G92"):
            last = float(words.get("E", last))
    return len(layers)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="empty, or not there yet")
    parser.add_argument("--time", type=Path, metavar="MODEL", help="an STL whose round trip is timed")
    parser.add_argument("--patience", type=float, default=600.0, metavar="SECONDS")
    given = parser.parse_args()
    folder = given.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        parser.error(f"{folder} is not empty")
    made(folder)
    if given.time:
        shutil.copyfile(given.time, folder / "timed.stl")
    code = started(folder, given.patience)
    told = folder / "facts.jsonl"
    facts = [json.loads(line) for line in told.read_text().splitlines()] if told.exists() else []
    if (folder / "after.gcode").exists():
        before, after = (beads_of_fin(folder / f"{name}.gcode") for name in ("before", "after"))
        facts.append({"fact": "the fin that Cura dropped is printed", "held": before < 5 and after > 40,
                      "more": f"layers with it: {before} before, {after} after"})  # fmt: skip
    facts.append({"fact": "Cura came to its end", "held": (folder / "end").exists(), "more": f"exit code {code}"})
    if given.time:
        began = time.time()
        alone = ["layerfix", "fix", folder / "timed.stl", folder / "alone.stl", "-p", "creality-ender-3-v2-0.4"]
        subprocess.run(alone, check=True, stdout=subprocess.DEVNULL)
        facts.append({"fact": "the command alone", "held": True, "more": f"{time.time() - began:.2f} s"})
    for fact in facts:
        print("held  " if fact["held"] else "BROKEN", fact["fact"], f"({fact['more']})" if fact["more"] else "")
    return 0 if all(fact["held"] for fact in facts) else 1


if __name__ == "__main__":
    sys.exit(main())
