"""Makes printer files of tables of facts: ``python -m tests.printer_files FOLDER`` makes the index anew, and
``python -m tests.printer_files FOLDER --resin resin.tsv --fdm fdm.tsv --services services.tsv`` writes the files that
are not there yet before. Files that exist are never touched: what was put into them by hand stays.

The tables have a line a machine (and nozzle) with a source each. Rows that contradict themselves are put right here,
with a word in the file, or left out, with a word below.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import textwrap
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from layerfix.printers import Entry, Printer, load_printer
from layerfix.printers.index import INDEX

Row = dict[str, str]

# Left out. Of resin printers: pixels and size that contradict each other or every other source, panels that do not
# exist, active areas of unknown offset.
UNSOUND_RESIN = {
    "Anycubic Photon Mono X 6K", "FlashForge Focus 13.3", "FlashForge Foto 13.3", "FlashForge Foto 6.0",
    "Longer Orange 4K", "Nova3D Bene4", "Nova3D Bene4 Mono", "Nova3D Bene5", "Nova3D Elfin", "Nova3D Elfin2",
    "Nova3D Elfin2 Mono SE", "Nova3D Elfin3 Mini", "Wanhao CGR Mono", "Wanhao D7",
}  # fmt: skip
# Machines whose files were written by hand, (maker, model): nozzles; and models that are the same machine again.
BY_HAND = {
    ("Prusa Research", "i3 MK3S+"): "0.25 0.4 0.6 0.8", ("Prusa Research", "MINI+"): "0.4",
    ("Prusa Research", "MK4"): "0.6", ("Prusa Research", "XL (1 tool)"): "0.8", ("Creality", "Ender-3"): "0.4 0.6",
    ("RatRig", "V-Core 4 400"): "0.6", ("UltiMaker", "Ultimaker S5/S7"): "0.4", ("LulzBot", "Taz 6"): "0.5",
}  # fmt: skip
AGAIN = re.compile(r"V-Core 4\.0 \d+x\d+ CoreXY|Trident 300mm|V2 300mm|Zero \(PrusaSlicer\)|^Ultimaker 2$")
# FDM rows that are left out: no flow limit is known, or the wall is half a nozzle wide.
UNSOUND_FDM = ("no PLA limit found", "no volumetric limit", "outer width 0.4 is 0.50 x nozzle")
PUT_RIGHT: dict[tuple[str, str], dict[str, str]] = {  # the smaller of two sizes: what fits it fits the other
    ("Artillery", "M1 Pro"): {"build_x_mm": "260", "build_y_mm": "260", "build_z_mm": "260"},
    ("Elegoo", "Centauri"): {"build_x_mm": "256", "build_y_mm": "256", "build_z_mm": "256"},
    ("Elegoo", "Centauri Carbon"): {"build_x_mm": "256", "build_y_mm": "256", "build_z_mm": "256"},
    ("Flashforge", "Guider4"): {"build_z_mm": "300"},
    ("RatRig", "V-Core 4 500"): {"build_z_mm": "300"},
}
LOW_SHARE = 0.8  # of the nozzle: the highest layer that is laid well
SHORT_MAKERS = {"Prusa Research": "prusa", "UltiMaker": "ultimaker"}
# Services that say so themselves, by row: the file's name, and the model as the list shows it.
FIRST_HAND = "service page"


def slug(text: str) -> str:
    """A file's name: small letters, digits and points with hyphens between."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower().replace("+", "-plus")).strip("-")


def rows_of(path: Path) -> list[Row]:
    """The lines of a table by the names of its columns."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def toml(comments: dict[str, str], values: dict[str, Any]) -> str:
    """Lines `key = value`, those with a comment below it."""
    lines = []
    for key, value in values.items():
        if key in comments:
            lines += [f"# {line}" for part in comments[key].split("\n") for line in textwrap.wrap(part, 110)]
        if value is not None:
            lines.append(f"{key} = {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(lines) + "\n"


def number(text: str) -> float | None:
    """The first number of a cell."""
    found = re.match(r"-?\d*\.?\d+", text.strip())
    return float(found[0]) if found else None


# resin ----------------------------------------------------------------------------------------------------


def resin_files(rows: list[Row]) -> Iterator[tuple[str, str]]:
    """(name, text) of every sound row that has no file of its own by hand."""
    for row in rows:
        if row["name"] in UNSOUND_RESIN or row["in_layerfix_as"]:
            continue
        yield slug(re.sub(r" CL-\w+$", "", row["name"])), _resin(row)


def _resin(row: Row) -> str:
    pitch = [round(float(row[f"pitch_{axis}_um"]) / 1000, 6) for axis in "xy"]
    feature = max(0.15, round(4 * max(pitch), 2))
    kind = row["grey_bits_of_format"]
    bits = None if "?" in kind else number(kind)
    writes = row["layerfix_support"] == "write" and row["suffix"] == ".goo" and row["model"] != "Jupiter 2"
    suffix = row["suffix"] if row["model"] != "Jupiter 2" else ""
    lifts = [number(row[f"typical_{key}"]) for key in
             ("lift_mm", "lift_mm_min", "bottom_lift_mm", "bottom_lift_mm_min", "retract_mm_min")]  # fmt: skip
    lifts = lifts if all(lifts) else [None] * 5
    pixels = round(feature / max(pitch))
    where = (
        "its printer profile in UVtools (PrusaSlicer/printer)" if suffix or row["suffix"] else "UVtools' machine list"
    )
    container = {
        "uvtools_only": f"Only UVtools writes its {suffix} jobs: layerfix gives it images.",
        "rewrite": f"Its {suffix} jobs are corrected in place; new ones are written by slicers.",
    }.get(row["layerfix_support"], "")
    if "encrypted" in row["note"]:
        container = (
            "The .ctb of this machine is the encrypted kind, which only UVtools writes: layerfix gives it images."
        )
    if row["model"] == "Jupiter 2":
        container = (
            "Its .goo has another layout than all others, which is not written here: layerfix gives it images."
        )
    if not row["suffix"]:
        container = "No source says the kind of its jobs: layerfix gives it images."
    comments = {
        "maker": f"{row['maker']} {row['model']}.\nPixels, size, mirror, lift and light: {where}.",
        "format": container,
        "layer_mm": "Heights: 0.01 to 0.2 mm are those of UVtools' print profiles, 0.05 mm is the usual one.",
        "exposure_s": "Exposure at 0.05 mm: typical of a monochrome panel and standard resin, not the maker's.",
        "min_feature_mm": f"It depends on resin and exposure and is in no profile: {feature:g} mm, which is"
        f" {pixels} pixels here, to start from.",
    }
    if row["suspect"]:
        comments["build_mm"] = f"Of two sources, the printer profile: {row['suspect']}."
    values = {
        "maker": row["maker"], "model": row["model"], "process": "resin",
        "pixels": [int(row["pixels_x"]), int(row["pixels_y"])], "pixel_mm": pitch,
        "build_mm": [float(row[k]) for k in ("display_x_mm", "display_y_mm", "build_z_mm")],
        "mirror": row["mirror"], "format": suffix, "antialias_bits": int(bits) if bits else None,
        "layer_mm": 0.05, "layer_range_mm": [0.01, 0.2],
        "exposure_s": 2.5 if writes else None, "bottom_exposure_s": 30.0 if writes else None,
        "bottom_layers": 5 if writes else None, "transition_layers": 5 if writes else None,
        "light_off_s": number(row["typical_light_off_delay_s"]),
        **dict(zip(("lift_mm", "lift_mm_min", "bottom_lift_mm", "bottom_lift_mm_min", "retract_mm_min"), lifts,
                   strict=True)),
        "light_pwm": _whole(row["typical_light_pwm"]), "bottom_light_pwm": _whole(row["typical_bottom_light_pwm"]),
        "min_feature_mm": feature,
    }  # fmt: skip
    return toml({k: v for k, v in comments.items() if v and values.get(k) is not None}, values)


def _whole(text: str) -> int | None:
    found = number(text)
    return None if found is None else int(found)


# fdm ------------------------------------------------------------------------------------------------------


def fdm_files(rows: list[Row]) -> Iterator[tuple[str, str]]:
    """(name, text) of every sound row, OrcaSlicer's before PrusaSlicer's of the same machine."""
    done = {(maker, model, nozzle) for (maker, model), some in BY_HAND.items() for nozzle in some.split()}
    for row in sorted(rows, key=lambda row: "(PrusaSlicer)" in row["model"]):
        if AGAIN.search(row["model"]) or any(word in row["suspect"] for word in UNSOUND_FDM):
            continue
        row = {**row, "model": row["model"].replace(" (PrusaSlicer)", "")}
        machine = (row["maker"], row["model"], row["nozzle_mm"])
        if machine in done:
            continue
        done.add(machine)
        yield _fdm_name(row), _fdm(row)


def _plate(row: Row) -> str:
    """The model as on its plate."""
    model = (
        row["model"].replace(" (1 tool)", "").replace(" (5 tools)", ", 5 tools").replace(" HF nozzle", ", HF nozzle")
    )
    if row["maker"] == "Prusa Research":
        return f"Prusa {model}" if model.startswith("CORE") else f"Original Prusa {model}"
    return model


def _fdm_name(row: Row) -> str:
    if row["model"] == "Ender-3":  # as the files of its other nozzles
        return f"ender-3-{row['nozzle_mm']}"
    maker = SHORT_MAKERS.get(row["maker"], row["maker"])
    model = row["model"].replace("MINI+", "MINI").replace(" (1 tool)", "").replace(" Input Shaper", " IS")
    return slug(f"{maker} {model.replace(' HF nozzle', ' HF')} {row['nozzle_mm']}")


def _fdm(row: Row) -> str:
    nozzle = float(row["nozzle_mm"])
    right = PUT_RIGHT.get((row["maker"], row["model"]), {})
    row = {**row, **right}
    profile = re.search(r"/machine/(?:[A-Z]+/)?([^/;]+)\.json", row["source"])
    slicer = "OrcaSlicer's" if profile else "PrusaSlicer's"
    low, high = number(row["layer_min_mm"]), number(row["layer_max_mm"])
    assert low is not None
    top = round(LOW_SHARE * nozzle, 3)
    high = min(high or top, top)
    layer = number(row["layer_default_mm"]) or 0.2
    wrong_layer = layer > high
    layer = round(nozzle / 2, 3) if wrong_layer else layer
    first = min(number(row["first_layer_mm"]) or layer, top)
    narrow, wide = round(0.85 * nozzle, 4), round(2 * nozzle, 4)
    widths = [min(max(number(row[k]) or 1.125 * nozzle, narrow), wide) for k in ("width_outer_mm", "width_first_mm")]
    flow = min(v for k in ("filament_max_volumetric_mm3_s", "print_max_volumetric_mm3_s") if (v := number(row[k])))
    outer = number(row["speed_outer_mm_s"])
    assert outer is not None
    first_speed = number(row["speed_first_layer_mm_s"]) or 20.0
    slow_first = row["speed_first_layer_mm_s"].endswith("%")
    start = re.search(r"bed starts at \((-?[\d.]+), (-?[\d.]+)\)", row["note"])
    build = [float(row[f"build_{axis}_mm"]) for axis in "xyz"]
    comments = {
        "maker": f"{row['maker']} {_plate(row)} with a {nozzle:g} mm nozzle.\nSource: {slicer} profiles"
        + (f' "{profile[1]}"' if profile else "") + f', print profile "{row["print_profile"]}".',
        "width_range_mm": "What such a nozzle can lay: 0.85 to 2 of its widths.",
        "max_volumetric_speed_mm3_s": f'The limit of "{row["filament_profile"]}" in the same profiles.',
        "nozzle_c": "The same filament's.",
        "min_feature_mm": "Two nozzle widths: from there pins are printed by every slicer in every mode\n"
        "(measured with 0.4 mm, and with 0.6 mm in PrusaSlicer).\nNo start and end code: its maker's is not"
        " ours to write; --start-gcode and --end-gcode name yours.",
    }  # fmt: skip
    if right:
        comments["build_mm"] = "Sources differ on its size: the smaller one."
    if wrong_layer:
        comments["layer_mm"] = "The profile's own height is above what the same profile allows: half the nozzle."
    elif not row["layer_default_mm"]:
        comments["layer_mm"] = "The profile says no height: the slicer's usual one."
    if (number(row["layer_max_mm"]) or 0) > top:
        comments["layer_range_mm"] = "The profile allows more than 0.8 nozzle widths, which are the highest here."
    if slow_first:
        comments["first_layer_mm_s"] = f"{row['speed_first_layer_mm_s']} of the outer walls."
    values = {
        "maker": row["maker"], "model": _plate(row), "process": "fdm",
        "slicer_names": [profile[1]] if profile else None,
        "nozzle_mm": nozzle, "filament_mm": number(row["filament_mm"]), "build_mm": build,
        "bed_origin_mm": [float(start[1]), float(start[2])] if start else None,
        "round_bed": True if row["bed_form"] == "round" else None,
        "layer_mm": layer, "first_layer_mm": first, "layer_range_mm": [min(low, layer), high],
        "extrusion_width_mm": widths[0], "first_layer_width_mm": widths[1], "width_range_mm": [narrow, wide],
        "max_volumetric_speed_mm3_s": flow, "format": ".gcode", "gcode_flavor": row["flavour"],
        "relative_extrusion": row["relative_e"] != "no",
        "external_perimeter_mm_s": outer, "perimeter_mm_s": number(row["speed_inner_mm_s"]),
        "infill_mm_s": number(row["speed_sparse_infill_mm_s"]),
        "solid_infill_mm_s": number(row["speed_solid_infill_mm_s"]), "top_infill_mm_s": number(row["speed_top_mm_s"]),
        "gap_fill_mm_s": number(row["speed_gap_mm_s"]),
        "first_layer_mm_s": first_speed * outer / 100 if slow_first else first_speed,
        "travel_mm_s": number(row["speed_travel_mm_s"]),
        "acceleration_mm_s2": number(row["acc_default_mm_s2"]) or None,
        "travel_acceleration_mm_s2": number(row["acc_travel_mm_s2"]) or None,
        "retract_mm": number(row["retract_mm"]), "retract_mm_s": number(row["retract_mm_s"]),
        "retract_lift_mm": number(row["z_hop_mm"]),
        "retract_before_travel_mm": number(row["retract_before_travel_mm"]),
        "nozzle_c": number(row["nozzle_c"]), "first_layer_nozzle_c": number(row["first_layer_nozzle_c"]),
        "bed_c": number(row["bed_c"]), "first_layer_bed_c": number(row["first_layer_bed_c"]),
        "fan_percent": number(row["fan_max_percent"]), "min_feature_mm": 2 * nozzle,
    }  # fmt: skip
    return toml(comments, values)


# services -------------------------------------------------------------------------------------------------


def service_files(rows: list[Row]) -> Iterator[tuple[str, str]]:
    """(name, text) of the materials whose service says itself what walls it takes."""
    for row in rows:
        wall = number(row["wall_supported_mm"])
        if row["kind"] != FIRST_HAND or wall is None:
            continue
        service = row["service"].partition(" / ")[2] or row["service"]
        kind = _kind(row)
        material = re.sub(r" resins?$| photopolymer|Ultrasint |-01$", "", _material(row).replace("PA 12", "PA12"))
        material = re.sub(r"LEDO 6060.*", "Taurus", re.sub(r"white/black nylon.*", "nylon", material))
        yield slug(f"{service} {material} {'' if kind in material else kind}"), _service(row, service, wall)


def _kind(row: Row) -> str:
    return row["process"].replace("metal LPBF", "LPBF").replace("material jetting", "jetting")


def _material(row: Row) -> str:
    """Without what is in brackets, and what the list has no room for."""
    text = re.sub(
        r" ?\(.*?\)|HP High Reusability |;.*|, FS3400GF.*| medical grade.*|GP Plus 14122, ", "", row["material"]
    )
    return text + (" medical" if "medical" in row["material"] else "")


def _service(row: Row, service: str, wall: float) -> str:
    free = number(row["wall_unsupported_mm"])
    feature = max(wall, free or 0)
    pitch = round(feature / 16, 6)
    said = {k: row[k] for k in ("wall_supported_mm", "wall_unsupported_mm", "wire_unsupported_mm") if row[k]}
    several = {k: v for k, v in said.items() if number(v) is not None and not re.fullmatch(r"[\d.]+", v)}
    graded = "; ".join(f"{k.removesuffix('_mm').replace('_', ' ')} {v}" for k, v in several.items())
    stands = (
        "the one that stands free." if free and free >= wall else "the page tells no other for one that stands free."
    )
    comments = {
        "maker": f"{service}: {row['material']}, {row['process']}.\nSource: {service}'s own page (below), read"
        f" {row['date_read']}." + (f"\nIt grades them: {graded}; the first is taken." if graded else ""),
        "min_feature_mm": f"The wall that it takes anywhere, measured by no one here: {stands}",
        "pixel_mm": "No pixels of a machine: a sixteenth of the minimum feature, so that it is 16 pixels wide.",
    }  # fmt: skip
    values = {
        "maker": service, "model": f"{_material(row)}, {_kind(row)}", "process": "service",
        "min_feature_mm": feature, "pixel_mm": [pitch, pitch], "layer_mm": pitch,
        "layer_range_mm": [pitch / 4, feature],
        "min_wall_mm": wall, "min_free_wall_mm": free, "min_wire_mm": number(row["wire_supported_mm"]),
        "min_free_wire_mm": number(row["wire_unsupported_mm"]), "min_detail_mm": number(row["embossed_width_mm"]),
        "min_engraving_mm": number(row["engraved_width_mm"]), "min_gap_mm": number(row["clearance_mm"]),
        "source": row["source_address"].partition(" ;")[0],
    }  # fmt: skip
    return toml(comments, values)


# index ----------------------------------------------------------------------------------------------------


def entry_of(printer: Printer) -> Entry:
    """What the index holds of a printer."""
    return Entry(**{field.name: getattr(printer, field.name) for field in fields(Entry)})


def write_index(folder: Path) -> str:
    """The text of the index of all printers in a folder: one a line, so that changes are seen line by line."""
    printers = [load_printer(path) for path in sorted(folder.glob("*.toml"), key=lambda path: path.stem)]
    lines = [json.dumps(_without_nothing(asdict(entry_of(p))), ensure_ascii=False) for p in printers]
    return "[\n" + ",\n".join(lines) + "\n]\n"


def _without_nothing(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value not in (None, "", ())}


def main() -> None:
    """Write what is missing, then the index."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    for name in ("resin", "fdm", "services"):
        parser.add_argument(f"--{name}", type=Path)
    given = parser.parse_args()
    written = 0
    for path, make in ((given.resin, resin_files), (given.fdm, fdm_files), (given.services, service_files)):
        for name, text in make(rows_of(path)) if path else ():
            target = given.folder / f"{name}.toml"
            if not target.exists():
                target.write_text(text, encoding="utf-8")
                written += 1
    (given.folder / INDEX).write_text(write_index(given.folder), encoding="utf-8")
    print(f"{written} files written, index of {len(list(given.folder.glob('*.toml')))} printers")


if __name__ == "__main__":
    main()
