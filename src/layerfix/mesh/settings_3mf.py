"""What slicers say of the parts of an object in a 3MF project: solid, cut out, or not to be printed at all.

PrusaSlicer, SuperSlicer and Slic3r list volumes as ranges of triangles in `Metadata/Slic3r_PE_model.config` (or their
own `…_model.config`), OrcaSlicer and Bambu Studio the parts by the id of their component in
`Metadata/model_settings.config`. Names found in files of theirs and in their sources.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from layerfix.mesh.package import Package

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

SOLID, NEGATIVE = "solid", "negative volume"
KINDS = {
    "modelpart": SOLID, "normal_part": SOLID,
    "negativevolume": NEGATIVE, "negative_part": NEGATIVE,
    "parametermodifier": "modifier", "modifier_part": "modifier",
    "supportblocker": "support blocker", "support_blocker": "support blocker",
    "supportenforcer": "support enforcer", "support_enforcer": "support enforcer",
}  # fmt: skip


@dataclass
class Volumes:
    """Of one object: (first, past the last triangle, kind) in order, and kinds of components by id, in order."""

    ranges: list[tuple[int, int, str]] = field(default_factory=list)
    components: dict[str, list[str]] = field(default_factory=dict)

    def kind_of_component(self, object_id: str, nth: int) -> str:
        """What the nth component (from 0) of an object that shows object_id is."""
        kinds = self.components.get(object_id, [])
        return kinds[min(nth, len(kinds) - 1)] if kinds else SOLID

    @property
    def all_solid(self) -> bool:
        """Whether there is nothing else."""
        return all(kind == SOLID for _, _, kind in self.ranges) and all(
            kind == SOLID for kinds in self.components.values() for kind in kinds
        )


def read_settings(package: Package) -> dict[str, Volumes]:
    """Volumes of the objects of the root model, by their id."""
    found: dict[str, Volumes] = {}
    for name in package.names():
        if not name.startswith("metadata/") or not name.endswith(("_model.config", "model_settings.config")):
            continue
        for element in package.xml(name).iter("object"):
            volumes = found.setdefault(element.get("id", ""), Volumes())
            for part in element:
                if part.tag in ("volume", "part"):
                    _enter(volumes, part)
    return {object_id: volumes for object_id, volumes in found.items() if not volumes.all_solid}


def _enter(volumes: Volumes, part: Element) -> None:
    kind = kind_of_part(part)
    first, last = part.get("firstid"), part.get("lastid")
    if first is not None and last is not None:
        volumes.ranges.append((int(first), int(last) + 1, kind))
    elif part.tag == "part":
        volumes.components.setdefault(part.get("id", ""), []).append(kind)


def kind_of_part(part: Element) -> str:
    """What a `volume` or `part` of such settings is: one of the values of KINDS, or something unknown."""
    said = {item.get("key", ""): item.get("value", "") for item in part.iter("metadata")}
    name = (
        part.get("subtype") or said.get("volume_type") or ("ParameterModifier" if said.get("modifier") == "1" else "")
    )
    if not name:
        return SOLID
    return KINDS.get(name.lower(), f"part of the unknown kind '{name[:40]}'")
