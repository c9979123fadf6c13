"""What a printer's file may say: each key with its kind, limits, unit and meaning."""

from __future__ import annotations

import sys
from dataclasses import dataclass

PROCESSES = ("resin", "fdm", "powder", "service")
MIRRORS = ("", "x", "y", "xy")
GCODE_FLAVORS = ("marlin", "marlin2", "klipper", "reprap", "griffin")
GCODE_PLACEHOLDERS = ("{nozzle_c}", "{bed_c}", "{first_layer_nozzle_c}", "{first_layer_bed_c}")


@dataclass(frozen=True)
class Key:
    """What a value in a printer's file must be, and means."""

    kind: type
    count: int  # how many in brackets; 1 is a plain value, 0 is as many as there are
    least: float | None  # None: above 0, for there is no length of 0
    unit: str
    meaning: str
    choices: tuple[str, ...] = ()
    most: float = sys.float_info.max  # neither inf nor nan is a measure

    def allows(self, number: float) -> bool:
        return (number > 0 if self.least is None else number >= self.least) and number <= self.most

    @property
    def limits(self) -> str:
        if self.least is None:
            return "above 0"
        return f"{self.least:g} or more" if self.most == sys.float_info.max else f"{self.least:g} to {self.most:g}"


# fmt: off
KEYS: dict[str, Key] = {
    # every process             kind, how many, least, unit, meaning
    "maker":                      Key(str,   1, None, "",       "as on its plate"),
    "model":                      Key(str,   1, None, "",       "as on its plate"),
    "process":                    Key(str,   1, None, "",       "panel, nozzle, beam, or a service", PROCESSES),
    "build_mm":                   Key(float, 3, None, "mm",     "(x, y, z) it can print"),
    "layer_mm":                   Key(float, 1, None, "mm",     "usual layer height"),
    "first_layer_mm":             Key(float, 1, None, "mm",     "of the first layer, if it differs"),
    "layer_range_mm":             Key(float, 2, None, "mm",     "lowest and highest layer"),
    "min_feature_mm":             Key(float, 1, None, "mm",     "default minimum printable feature"),
    "pixel_mm":                   Key(float, 2, None, "mm",     "(x, y) pitch of the layer image"),
    "format":                     Key(str,   1, None, "",       "suffix of its own job files"),
    "slicer_names":               Key(str,   0, None, "",       "what slicers call it"),
    # resin
    "pixels":                     Key(int,   2, None, "px",     "(columns, rows) of the layer image in a job file"),
    "mirror":                     Key(str,   1, None, "",       "axes the panel shows mirrored", MIRRORS),
    "antialias_bits":             Key(int,   1, 1,    "",       "bits of grey that job file and panel hold", most=8),
    "exposure_s":                 Key(float, 1, None, "s",      "light on, each layer"),
    "bottom_exposure_s":          Key(float, 1, None, "s",      "light on, each bottom layer"),
    "bottom_layers":              Key(int,   1, 0,    "",       "how many layers are bottom layers"),
    "transition_layers":          Key(int,   1, 0,    "",       "layers from bottom exposure to the usual one"),
    "light_off_s":                Key(float, 1, 0,    "s",      "wait before the light, each layer"),
    "lift_mm":                    Key(float, 1, 0,    "mm",     "lift after a layer"),
    "lift_mm_min":                Key(float, 1, None, "mm/min", "its speed"),
    "bottom_lift_mm":             Key(float, 1, 0,    "mm",     "lift after a bottom layer"),
    "bottom_lift_mm_min":         Key(float, 1, None, "mm/min", "its speed"),
    "retract_mm_min":             Key(float, 1, None, "mm/min", "speed of the way back"),
    "light_pwm":                  Key(int,   1, 0,    "of 255", "brightness of the light", most=255),
    "bottom_light_pwm":           Key(int,   1, 0,    "of 255", "brightness for bottom layers", most=255),
    # fdm
    "nozzle_mm":                  Key(float, 1, None, "mm",     "bore of the nozzle"),
    "filament_mm":                Key(float, 1, None, "mm",     "diameter of the filament"),
    "extrusion_width_mm":         Key(float, 1, None, "mm",     "usual bead of an outer wall"),
    "first_layer_width_mm":       Key(float, 1, None, "mm",     "bead of the first layer"),
    "width_range_mm":             Key(float, 2, None, "mm",     "narrowest and widest bead"),
    "max_volumetric_speed_mm3_s": Key(float, 1, None, "mm³/s",  "most it can melt"),
    "gcode_flavor":               Key(str,   1, None, "",       "dialect of its G-code", GCODE_FLAVORS),
    "relative_extrusion":         Key(bool,  1, None, "",       "E counts from the last move (M83)"),
    "external_perimeter_mm_s":    Key(float, 1, None, "mm/s",   "speed of the outer walls"),
    "perimeter_mm_s":             Key(float, 1, None, "mm/s",   "of the walls inside them"),
    "infill_mm_s":                Key(float, 1, None, "mm/s",   "of sparse infill"),
    "solid_infill_mm_s":          Key(float, 1, None, "mm/s",   "of solid infill"),
    "top_infill_mm_s":            Key(float, 1, None, "mm/s",   "of the solid infill that shows on top"),
    "gap_fill_mm_s":              Key(float, 1, None, "mm/s",   "of beads that fill gaps between walls"),
    "first_layer_mm_s":           Key(float, 1, None, "mm/s",   "of all beads of the first layer"),
    "travel_mm_s":                Key(float, 1, None, "mm/s",   "of moves that print nothing"),
    "bridge_mm_s":                Key(float, 1, None, "mm/s",   "of beads laid over air"),
    "bridge_flow":                Key(float, 1, None, "",       "their material, as a share of the usual", most=2),
    "acceleration_mm_s2":         Key(float, 1, None, "mm/s²",  "usual acceleration"),
    "travel_acceleration_mm_s2":  Key(float, 1, None, "mm/s²",  "of travels, if it differs"),
    "axis_mm_s":                  Key(float, 4, None, "mm/s",   "fastest X, Y, Z, E"),
    "axis_mm_s2":                 Key(float, 4, None, "mm/s²",  "most of X, Y, Z, E"),
    "axis_jerk_mm_s":             Key(float, 4, None, "mm/s",   "what they may change at once"),
    "junction_deviation_mm":      Key(float, 1, None, "mm",     "of corners, instead of jerk"),
    "retract_mm":                 Key(float, 1, 0,    "mm",     "filament drawn back before a travel"),
    "retract_mm_s":               Key(float, 1, None, "mm/s",   "its speed"),
    "retract_lift_mm":            Key(float, 1, 0,    "mm",     "lift of the nozzle meanwhile"),
    "retract_before_travel_mm":   Key(float, 1, 0,    "mm",     "shortest travel with a retraction"),
    "nozzle_c":                   Key(float, 1, 0,    "°C",     "heat of the nozzle", most=500),
    "first_layer_nozzle_c":       Key(float, 1, 0,    "°C",     "the same for the first layer", most=500),
    "bed_c":                      Key(float, 1, 0,    "°C",     "heat of the bed", most=200),
    "first_layer_bed_c":          Key(float, 1, 0,    "°C",     "the same for the first layer", most=200),
    "fan_percent":                Key(float, 1, 0,    "%",      "part cooling from the second layer on", most=100),
    "bed_origin_mm":              Key(float, 2, -1e4, "mm",     "(x, y) of the bed's corner, if not 0", most=1e4),
    "round_bed":                  Key(bool,  1, None, "",       "the bed is a disc"),
    "start_gcode":                Key(str,   1, None, "",       "what comes before the first layer"),
    "end_gcode":                  Key(str,   1, None, "",       "what comes after the last layer"),
    # service
    "min_wall_mm":                Key(float, 1, None, "mm",     "thinnest wall with others on both sides"),
    "min_free_wall_mm":           Key(float, 1, None, "mm",     "thinnest wall that stands free"),
    "min_wire_mm":                Key(float, 1, None, "mm",     "thinnest wire that is held at both ends"),
    "min_free_wire_mm":           Key(float, 1, None, "mm",     "thinnest wire or pin that stands free"),
    "min_detail_mm":              Key(float, 1, None, "mm",     "narrowest raised detail"),
    "min_engraving_mm":           Key(float, 1, None, "mm",     "narrowest engraved detail"),
    "min_gap_mm":                 Key(float, 1, None, "mm",     "narrowest gap that stays open between parts"),
    "source":                     Key(str,   1, None, "",       "where these figures are from"),
}
# fmt: on
