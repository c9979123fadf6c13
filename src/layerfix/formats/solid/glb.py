"""glTF 2.0 in one file (GLB): a node for each body, a primitive and a material for each of its colours.

Specification: Khronos glTF 2.0, sections 3.6, 3.7, 3.9 and 4. In metres, y up; colours are linear.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.mesh.bodies import NO_COLOUR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.formats.solid.package_3mf import Body

FLOAT, UINT32, VEC3 = 5126, 5125, "VEC3"
VERTICES, INDICES = 34962, 34963  # what a view of the buffer is for


def glb_of(bodies: Sequence[Body]) -> bytes:
    """The file's bytes. Positions are 32-bit floats: to a ten-millionth of the part's size."""
    binary = bytearray()
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    palette: dict[int, int] = {}
    meshes, nodes = [], []

    def added(values: NDArray[Any], target: int, **about: Any) -> int:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes, "target": target})
        binary.extend(values.tobytes())
        accessors.append({"bufferView": len(views) - 1, "count": len(values), **about})
        return len(accessors) - 1

    for body in bodies:
        x, y, z = (body.vertices.T / 1000).astype("<f4")
        points = np.stack([x, z, -y], axis=1)
        ends = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
        at = added(points, VERTICES, componentType=FLOAT, type=VEC3, **ends)
        primitives = []
        for colour in np.unique(body.colours).tolist():
            corners = body.faces[body.colours == colour].astype("<u4").reshape(-1)
            primitive = {
                "attributes": {"POSITION": at},
                "indices": added(corners, INDICES, componentType=UINT32, type="SCALAR"),
            }
            if colour != NO_COLOUR:
                primitive["material"] = palette.setdefault(colour, len(palette))
            primitives.append(primitive)
        meshes.append({"name": body.name, "primitives": primitives})
        nodes.append({"name": body.name, "mesh": len(meshes) - 1})
    document = {
        "asset": {"version": "2.0", "generator": "layerfix"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    if palette:
        document["materials"] = [_material(colour) for colour in palette]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
    return b"".join([head, text, struct.pack("<II", len(binary), 0x004E4942), binary])


def _material(colour: int) -> dict[str, Any]:
    """A matt one. Colours are written as they look, and are linear in the file (IEC 61966-2-1)."""
    written = np.array([colour >> 16, colour >> 8 & 255, colour & 255]) / 255
    linear = np.where(written <= 0.04045, written / 12.92, ((written + 0.055) / 1.055) ** 2.4)
    surface = {"baseColorFactor": [*linear.tolist(), 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9}
    return {"name": f"#{colour:06X}", "pbrMetallicRoughness": surface}
