"""The layerfix command, as a process of its own: found, asked for its version, run with progress, and stopped.

Needs neither Cura nor layerfix. Written for every Python that Cura 4.4 and later come with (3.5 on).
"""

import json
import os
import re
import shutil
import subprocess
import tempfile
import threading
import time

NAME = "layerfix"
VERSION = (0, 1)  # of layerfix, that this goes with
POLL_S = 0.1
# What AppImages set for themselves, and a program of another Python must not see.
NOT_FOR_OTHERS = (
    "LD_LIBRARY_PATH", "PYTHONHOME", "PYTHONPATH", "QT_PLUGIN_PATH", "QML2_IMPORT_PATH", "QT_QPA_PLATFORM"
)  # fmt: skip
_PROGRESS = re.compile(r"^layerfix: (\d+) %$")


class Missing(Exception):
    """There is no layerfix command, or it is of another version: what to do is in the text."""


class Failed(Exception):
    """The command refused; its own words."""


class Cancelled(Exception):
    """Somebody pressed cancel."""


def environment():
    """The environment for another program, with progress as lines."""
    mine = {name: value for name, value in os.environ.items() if name not in NOT_FOR_OTHERS}
    mine.update(LAYERFIX_PROGRESS="lines", PYTHONUTF8="1")
    return mine


def hidden():
    """On Windows a console program would open a window."""
    return {"creationflags": 0x08000000} if os.name == "nt" else {}


def find(given):
    """The command: what was given, or what PATH has. Raises Missing, saying how to get it."""
    given = (given or "").strip()
    found = shutil.which(given or NAME)
    if found is None and given and os.path.isfile(given):
        found = given
    if found is None:
        where = "'{}' is no program".format(given) if given else "This computer's PATH has no program 'layerfix'"
        raise Missing(
            "{}. It does the work: install it with 'pip install layerfix' (Python 3.11 or newer), or give its"
            " place under Extensions, Thin features, Correct thin features….".format(where)
        )
    return found


def check_version(program):
    """Raises Missing for a command that does not run, or whose version does not go with this plugin."""
    try:
        said = subprocess.run(
            [program, "--version"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=environment(),
            timeout=60,
            **hidden(),
        ).stdout.decode("utf-8", "replace")
    except (OSError, subprocess.SubprocessError) as problem:
        raise Missing("{} does not run: {}".format(program, problem)) from problem
    found = re.search(r"layerfix, version (\d+)\.(\d+)", said)
    if found is None:
        answer = " ".join(said.split())[:200]
        raise Missing("{} is not layerfix: asked for its version, it says '{}'".format(program, answer))
    if (int(found.group(1)), int(found.group(2))) != VERSION:
        raise Missing(
            "{} is layerfix {}.{}, and this plugin goes with {}.{}: install both of one version".format(
                program, found.group(1), found.group(2), VERSION[0], VERSION[1]
            )
        )


def run(arguments, progress, cancelled):
    """What the command printed as JSON.

    progress   called with 0 to 100, or None when nothing is known, a few times a second
    cancelled  asked as often; once it says so, the process is ended
    Raises Failed with the command's own words, and Cancelled.
    """
    share = [None]
    said = []

    def listen(stream):
        for line in iter(stream.readline, b""):
            text = line.decode("utf-8", "replace").strip()
            found = _PROGRESS.match(text)
            if found:
                share[0] = int(found.group(1))
            elif text:
                said.append(text)

    with tempfile.TemporaryFile() as out:
        try:
            process = subprocess.Popen(
                arguments, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.PIPE, env=environment(), **hidden()
            )
        except OSError as problem:
            raise Failed("{} does not run: {}".format(arguments[0], problem)) from problem
        listener = threading.Thread(target=listen, args=(process.stderr,))
        listener.daemon = True
        listener.start()
        try:
            while process.poll() is None:
                if cancelled():
                    raise Cancelled()
                progress(share[0])
                time.sleep(POLL_S)
        finally:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
            listener.join(5)
            process.stderr.close()
        out.seek(0)
        text = out.read().decode("utf-8", "replace")
    if process.returncode:
        raise Failed(" ".join(said)[-800:] or "layerfix ended with {}".format(process.returncode))
    return json.loads(text)


def number(value):
    """A number as TOML and layerfix read it."""
    return repr(round(float(value), 6))


def printer_file(settings):
    """The printer that Cura is set to, as a printer's file of layerfix.

    settings  maker, model; in mm: width, depth, height, layer, first_layer, nozzle, filament, line, first_line,
              feature, pixel; and speeds in mm/s by layerfix's names, which may be left out
    """
    line, nozzle, layer = settings["line"], settings["nozzle"], settings["layer"]
    rows = [
        ("maker", json.dumps(settings["maker"] or "unknown")),
        ("model", json.dumps(settings["model"] or "unknown")),
        ("process", '"fdm"'),
        ("format", '".gcode"'),
        ("build_mm", "[{}]".format(", ".join(number(settings[k]) for k in ("width", "depth", "height")))),
        ("layer_mm", number(layer)),
        ("first_layer_mm", number(settings["first_layer"])),
        ("layer_range_mm", "[{}, {}]".format(number(min(0.1 * nozzle, layer)), number(max(0.8 * nozzle, layer)))),
        ("nozzle_mm", number(nozzle)),
        ("filament_mm", number(settings["filament"])),
        ("extrusion_width_mm", number(line)),
        ("first_layer_width_mm", number(settings["first_line"])),
        ("width_range_mm", "[{}, {}]".format(number(min(0.85 * nozzle, line)), number(max(2 * nozzle, line)))),
        ("min_feature_mm", number(settings["feature"])),
        ("pixel_mm", "[{0}, {0}]".format(number(settings["pixel"]))),
    ]
    rows += [(name, number(value)) for name, value in sorted(settings.get("speeds", {}).items()) if value > 0]
    return "".join("{} = {}\n".format(name, value) for name, value in rows)


def fix_arguments(program, source, target, printer, feature, first_feature, axes):
    """The command line that corrects a model. first_feature: None where it is that of all layers."""
    arguments = [program, "fix", source, target, "-p", printer, "--min-feature", number(feature) + "mm", "--json"]
    if first_feature and first_feature != feature:
        arguments += ["--first-layer-min-feature", number(first_feature) + "mm"]
    return arguments + (["--axes", "xyz"] if axes else [])


def is_changed(summary):
    """Whether anything was too thin, in layers or along other axes."""
    return bool(summary["added_mm3"]) or any(note.startswith("along ") for note in summary["notes"])


def told_of_fix(name, summary):
    """What was done to a model, in a sentence or two."""
    if not is_changed(summary):
        return "{}: nothing is thinner than {:g} mm.".format(name, summary["min_feature_mm"])
    thinnest = summary["thinnest_mm"]
    return "{}: {} of {} layers corrected{}, {:.3g} mm³ added ({:.2g} %).{}".format(
        name,
        summary["layers_changed"],
        summary["layers"],
        "" if thinnest is None else ", the thinnest wall was {:.2g} mm".format(thinnest),
        summary["added_mm3"],
        summary["added_percent"],
        "".join(" Note: {}.".format(note) for note in summary["notes"][:3]),
    )


def told_of_widths(name, summary):
    """The widths that would print a model without losing or joining anything."""
    lines = ["{}: the widest lines that lose nothing".format(name)]
    for low, high, width in summary["ranges"]:
        lines.append("z {:.2f} to {:.2f} mm: {:.2f} mm".format(low, high, width))
    if summary["too_thin"]:
        thin = "{} of {} layers are too thin even for the narrowest: correct these."
        lines.append(thin.format(summary["too_thin"], summary["layers"]))
    return "\n".join(lines)
