"""Projects as slicers write them: PrusaSlicer's with all volumes in one mesh, OrcaSlicer's with a file a part."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from layerfix.mesh.triangles import Mesh
from tests.making import box, joined

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
RELATIONS = (
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="rel-1"'
    ' Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
# What PrusaSlicer needs to slice; everything else is its default.
PRINT = {
    "bed_shape": "0x0,250x0,250x210,0x210", "nozzle_diameter": "0.4", "filament_diameter": "1.75",
    "layer_height": "0.2", "first_layer_height": "0.2", "perimeters": "2", "external_perimeter_speed": "31",
    "small_perimeter_speed": "31", "perimeter_speed": "41", "skirts": "0", "gcode_flavor": "marlin",
    "perimeter_generator": "classic",
    "use_relative_e_distances": "1", "layer_gcode": "G92 E0", "cooling": "0", "gap_fill_enabled": "0",
    "thin_walls": "0", "printer_settings_id": "Original Prusa i3 MK3S & MK3S+", "printer_model": "MK3S",
    "external_perimeter_extrusion_width": "0.45", "perimeter_extrusion_width": "0.45", "fill_density": "15%",
}  # fmt: skip
FIN_MM, FIN_AT = 0.2, (4.0, 4.2)


def fin_part() -> Mesh:
    """A plate of 20 × 12 × 2 mm, a fin of 0.2 mm, 8 mm high, and a block that is wide enough; closed, one of each."""
    plate = box([0, 0, 0], [20, 12, 2])
    return joined(plate, box([FIN_AT[0], 2, 1.5], [FIN_AT[1], 10, 8]), box([10, 2, 1.5], [16, 10, 8]))


def mesh_xml(meshes: list[Mesh], painted: dict[int, str] | None = None, prefix: str = "") -> str:
    """One mesh element of several."""
    whole, p = joined(*meshes), f"{prefix}:" if prefix else ""
    vertices = "".join(f'<{p}vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in whole.vertices.tolist())
    triangles = "".join(
        f'<{p}triangle v1="{a}" v2="{b}" v3="{c}"{(painted or {}).get(k, "")}/>'
        for k, (a, b, c) in enumerate(whole.faces.tolist())
    )
    return f"<{p}mesh><{p}vertices>{vertices}</{p}vertices>\n<{p}triangles>{triangles}</{p}triangles></{p}mesh>"


def write_zip(path: Path, entries: dict[str, str | bytes]) -> Path:
    """A package of these entries."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return path


def entries_of(path: Path) -> dict[str, bytes]:
    """All of a package."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def prusa_project(path: Path, *, place: str = "1 0 0 0 1 0 0 0 1 100 90 0") -> Path:
    """Fins, a modifier that slows z 4 to 6 down to 17 mm/s, a negative volume through the block, a range of heights
    with 23 mm/s, painted supports, and a second object that needs nothing.
    """
    part = fin_part()
    modifier, negative = box([-1, -1, 4], [21, 13, 6]), box([12, 4, 1], [14, 8, 9])
    n, m = len(part.faces), len(part.faces) + 12
    painted = {
        0: ' slic3rpe:custom_supports="4"',
        30: ' slic3rpe:custom_supports="8"',
        n: ' slic3rpe:custom_seam="4"',
    }
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xmlns="{CORE}"'
        ' xmlns:slic3rpe="http://schemas.slic3r.org/3mf/2017/06">\n'
        '<metadata name="slic3rpe:Version3mf">1</metadata><metadata name="slic3rpe:FdmSupportsPaintingVersion">1'
        '</metadata><metadata name="Title">ü &amp; more</metadata>\n<resources>'
        f'<object id="1" type="model">{mesh_xml([part, modifier, negative], painted)}</object>'
        f'<object id="2" type="model">{mesh_xml([box([0, 0, 0], [8, 8, 4])])}</object></resources>'
        f'<build><item objectid="1" transform="{place}" printable="1"/>'
        '<item objectid="2" transform="1 0 0 0 1 0 0 0 1 150 90 0" printable="1"/></build></model>'
    )

    def volume(first: int, last: int, **said: str) -> str:
        lines = "".join(f'<metadata type="volume" key="{key}" value="{value}"/>' for key, value in said.items())
        return f'<volume firstid="{first}" lastid="{last}">{lines}</volume>\n'

    config = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<config>\n<object id="1" instances_count="1">'
        '<metadata type="object" key="name" value="fins"/><metadata type="object" key="perimeters" value="2"/>\n'
        + volume(0, n - 1, name="fins.stl", volume_type="ModelPart")
        + volume(n, m - 1, name="slow", modifier="1", volume_type="ParameterModifier",
                 external_perimeter_speed="17", small_perimeter_speed="17")
        + volume(m, m + 11, name="hole", volume_type="NegativeVolume")
        + '</object>\n<object id="2" instances_count="1"><metadata type="object" key="name" value="block"/>\n'
        + volume(0, 11, name="block.stl", volume_type="ModelPart") + "</object></config>"
    )  # fmt: skip
    ranges = (
        '<?xml version="1.0" encoding="utf-8"?>\n<objects><object id="1"><range min_z="6.5" max_z="7.5">'
        '<option opt_key="layer_height">0.2</option><option opt_key="external_perimeter_speed">23</option>'
        '<option opt_key="small_perimeter_speed">23</option></range></object></objects>'
    )
    settings = "".join(f"; {key} = {value}\n" for key, value in PRINT.items())
    return write_zip(path, {
        "[Content_Types].xml": TYPES, "_rels/.rels": RELATIONS, "3D/3dmodel.model": model,
        "Metadata/Slic3r_PE_model.config": config, "Metadata/Prusa_Slicer_layer_config_ranges.xml": ranges,
        "Metadata/Slic3r_PE.config": f"; generated by PrusaSlicer 2.5.0\n\n{settings}",
        "Metadata/thumbnail.png": b"\x89PNG\r\n\x1a\nno picture",
    })  # fmt: skip


def orca_project(path: Path) -> Path:
    """Two parts of one object in a file of their own each (the fin is thin alone, and half of a wall with the other),
    a modifier, in coordinates of their own; another object with a thin pin; prefixes and painting as Bambu writes it.
    """
    head = f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xmlns="{CORE}" xmlns:p="{PRODUCTION}">'
    half = box([0, 0, 0], [0.2, 8, 6])  # beside the other half, which is wide
    wide = joined(box([0, 0, 0], [12, 8, 2]), box([2, 0, 1.5], [2.15, 8, 5]), box([8, 0, 1.5], [12, 8, 6]))
    support = {0: ' paint_supports="4"'}
    modifier, pin = box([0, 0, 0], [5, 5, 5]), joined(box([0, 0, 0], [6, 6, 1]), box([3, 3, 0.5], [3.3, 3.3, 4]))
    first = (
        f'{head}<resources><object id="1" type="model">{mesh_xml([wide], support)}'
        f'</object><object id="2" type="model">{mesh_xml([half])}</object><object id="3" type="model">'
        f"{mesh_xml([modifier])}</object></resources><build/></model>"
    )
    second = f'{head}<resources><object id="1" type="model">{mesh_xml([pin])}</object></resources><build/></model>'
    place = "1 0 0 0 1 0 0 0 1"
    root = (
        f'{head}<metadata name="Application">BambuStudio-01</metadata><resources>'
        f'<object id="8" type="model"><components>'
        f'<component p:path="/3D/Objects/object_1.model" objectid="1" transform="{place} 0 0 0"/>'
        f'<component p:path="/3D/Objects/object_1.model" objectid="2" transform="{place} 12 0 0"/>'
        f'<component p:path="/3D/Objects/object_1.model" objectid="3" transform="{place} 3 3 1"/>'
        "</components></object>"
        f'<object id="9" type="model"><components>'
        f'<component p:path="/3D/Objects/object_2.model" objectid="1" transform="0 1 0 -1 0 0 0 0 1 0 0 0"/>'
        f'</components></object></resources><build><item objectid="8" transform="{place} 100 100 0"/>'
        f'<item objectid="9" transform="{place} 60 60 0"/></build></model>'
    )

    def part(number: int, kind: str, name: str, faces: int) -> str:
        return (
            f'<part id="{number}" subtype="{kind}"><metadata key="name" value="{name}"/>'
            f'<mesh_stat face_count="{faces}" edges_fixed="0"/></part>\n'
        )

    config = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<config><object id="8"><metadata key="name" value="walls"/>\n'
        + part(1, "normal_part", "wide", 36) + part(2, "normal_part", "half", 12)
        + part(3, "modifier_part", "slow", 12) + '</object><object id="9"><metadata key="name" value="pin"/>\n'
        + part(1, "normal_part", "pin", 24) + "</object></config>"
    )  # fmt: skip
    settings = '{"printer_settings_id": "Bambu Lab P1S 0.4 nozzle", "nozzle_diameter": ["0.4"]}'
    return write_zip(path, {
        "[Content_Types].xml": TYPES, "_rels/.rels": RELATIONS, "3D/3dmodel.model": root,
        "3D/Objects/object_1.model": first, "3D/Objects/object_2.model": second,
        "Metadata/model_settings.config": config, "Metadata/project_settings.config": settings,
        "Metadata/plate_1.png": b"\x89PNG\r\n\x1a\nno picture",
    })  # fmt: skip


def volume_mm3(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Of a closed surface."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)
