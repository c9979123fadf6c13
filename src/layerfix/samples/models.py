"""The five smaller parts of `layerfix.samples`, each near its final size in mm, z up.

Every one has what the method is about: features below the usual minimum of 0.8 mm beside ample ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.samples.shapes import (
    TURN,
    UP,
    around,
    balls,
    bars,
    boxes,
    cavity,
    cones,
    fence,
    join,
    letters,
    loft,
    mirrored,
    point,
    polar,
    posts,
    prism,
    rods,
    rounded,
    sheet,
    tube,
    wall,
)

if TYPE_CHECKING:
    from layerfix.mesh.triangles import Mesh
    from layerfix.samples.shapes import Floats

# --- test part -------------------------------------------------------------------------------------------

PLATE_TOP_MM, FEATURES_FROM_MM, FEATURES_TO_MM = 1.5, 1.0, 6.5
WIDTHS_MM = np.arange(1, 11) / 10
# Widths of 1, 3, 5 … pixels stand on a pixel's middle and the others between two pixels, so that with the
# sample's pitch of 0.1 mm each is drawn exactly as wide as it is.
OFF_GRID_MM = 0.05 * (np.arange(1, 11) % 2)
COLUMNS_MM = 4.2 + 3.6 * np.arange(10) + OFF_GRID_MM
UPRIGHT = (FEATURES_FROM_MM, FEATURES_TO_MM)


def feature_plate() -> Mesh:
    """56.3 × 57.7 × 6.5 mm: fins, pins and slots of 0.1 … 1.0 mm, rings, a star, a lattice, a gear, text."""
    low, high = (0.0, 0.0), (56.3, 57.7)
    plate = prism(rounded(low, high, 4), 0, PLATE_TOP_MM)
    rim = fence(rounded(low, high, 4, 0.7), rounded(low, high, 4, 1.1), *UPRIGHT)
    title = letters("LAYERFIX", (3.35, 48.05), 6.6, 0.3, *UPRIGHT)
    return join(
        [
            plate,
            rim,
            title,
            *_ladder_of_widths(),
            _slotted_block(),
            *_wedges(),
            *_rings(),
            _star(),
            *_lattice(),
            *_gear(),
        ]
    )


def _ladder_of_widths() -> list[Mesh]:
    """One column for each width: a fin, its label, two round pins and a square one."""
    at = COLUMNS_MM
    rows = np.array([29.6, 27.0])[:, None] + OFF_GRID_MM
    low, high = 24.4 + OFF_GRID_MM - WIDTHS_MM / 2, 24.4 + OFF_GRID_MM + WIDTHS_MM / 2
    pins = posts(np.stack(np.broadcast_arrays(at, rows), axis=-1), WIDTHS_MM / 2, *UPRIGHT, 24)
    half = WIDTHS_MM / 2
    return [
        _uprights(at - half, 35.6, at + half, 46.2),
        pins,
        _uprights(at - half, low, at + half, high),
        *(_label(f"{width:.1f}".lstrip("0").removesuffix(".0"), x) for width, x in zip(WIDTHS_MM, at, strict=True)),
    ]


def _uprights(x0: Floats, y0: Floats | float, x1: Floats, y1: Floats | float) -> Mesh:
    low = np.stack(np.broadcast_arrays(x0, y0, FEATURES_FROM_MM), axis=-1)
    return boxes(low, np.stack(np.broadcast_arrays(x1, y1, FEATURES_TO_MM), axis=-1))


def _label(text: str, middle_mm: float) -> Mesh:
    mark = letters(text, (0, 32.2), 2.1, 0.24, *UPRIGHT)
    return mark.moved([middle_mm - mark.bounds_mm[:, 0].mean(), 0, 0])


def _slotted_block() -> Mesh:
    edges_low = np.append(2.2, COLUMNS_MM + WIDTHS_MM / 2)
    edges_high = np.append(COLUMNS_MM - WIDTHS_MM / 2, 38.8)
    return join(
        [
            _uprights(edges_low, 12.0, edges_high, 22.4),
            boxes((2.2, 11.2, FEATURES_FROM_MM), (38.8, 13.2, FEATURES_TO_MM)),
        ]
    )


def _wedges() -> list[Mesh]:
    x = np.linspace(2.6, 38.4, 200)
    waves = np.stack([x, 3.8 + 1.3 * np.sin((x - x[0]) * TURN / 7.16)], axis=1)
    needle = prism([(2.4, 6.8), (38.6, 8.2), (2.4, 9.6)], *UPRIGHT)
    return [needle, wall(waves, np.linspace(0.1, 1.1, 200), *UPRIGHT)]


def _rings() -> list[Mesh]:
    angles = around(128)
    walls = [
        fence(polar(r + w / 2, angles), polar(r - w / 2, angles), *UPRIGHT)
        for r, w in ((6.3, 0.2), (5.0, 0.4), (3.5, 0.9), (1.6, 0.3))
    ]
    return [ring.moved([47.6, 40.6, 0]) for ring in walls]


def _star() -> Mesh:
    outline = polar(np.tile([5.2, 1.3], 9), around(18, TURN / 4))
    return prism(outline + point(47.6, 28.2), *UPRIGHT)


def _lattice() -> list[Mesh]:
    low, high = np.array([41.6, 11.4]), np.array([53.6, 22.2])
    frame = fence(rounded(low, high, 0.6), rounded(low, high, 0.6, 0.5), *UPRIGHT)
    # Each bar leaves the lower or an upright side at 45° and ends where it meets the frame again.
    start = np.array([(low[0] + c, low[1]) for c in np.arange(-8.4, 12, 2.4)])
    reach_low = np.maximum(0, low[0] - start[:, 0])
    reach_high = np.minimum(high[1] - low[1], high[0] - start[:, 0])
    rising = [start + np.stack([reach, reach], axis=1) for reach in (reach_low + 0.2, reach_high - 0.2)]
    across = bars(rising[0], rising[1], 0.3, *UPRIGHT)
    middle = (low[0] + high[0]) / 2
    back = mirrored(across.moved([-middle, 0, 0])).moved([middle, 0, 0])
    return [frame, across, back]


def _gear() -> list[Mesh]:
    teeth = around(20)[:, None] + np.array([-0.11, -0.06, 0.06, 0.11])
    outline = polar(np.array([3.5, 4.4, 4.4, 3.5]), teeth).reshape(-1, 3)
    wheel = fence(outline, polar(2.8, teeth).reshape(-1, 3), *UPRIGHT)
    spokes = bars(polar(0.5, around(5))[:, :2], polar(3.2, around(5))[:, :2], 0.3, *UPRIGHT)
    hub = prism(polar(1.0, around(32)), *UPRIGHT)
    return [part.moved([47.6, 6.25, 0]) for part in (wheel, spokes, hub)]


# --- molecule --------------------------------------------------------------------------------------------

# Bond directions of tetrahedral carbon; a chair ring walks along three of them and back.
TETRAHEDRON = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) / np.sqrt(3)
BOND_A = {"CC": 1.54, "CO": 1.43, "CH": 1.09, "OH": 0.96}
ATOM_MM = {"C": 3.1, "O": 2.7, "H": 1.7}
STICK_MM = {"CC": 0.65, "CO": 0.45, "CH": 0.3, "OH": 0.25}
MM_PER_ANGSTROM = 7.1
# Turned so that the box round the atoms has nearly the proportions of the table's image.
MOLECULE_TURN = (1.8, 1.32, -2.5)


def molecule() -> Mesh:
    """49 × 44 × 38 mm: glucose as balls and sticks, C6H12O6 with its ring in the chair form."""
    atoms, bonds = _glucose()
    kinds = np.array([kind for kind, _ in atoms])
    places = np.array([place for _, place in atoms]) @ _rotation(*MOLECULE_TURN).T * MM_PER_ANGSTROM
    radii = np.array([ATOM_MM[kind] for kind in kinds])
    pairs = ["".join(sorted(kinds[list(bond)], key="COH".index)) for bond in bonds]
    ends = places[np.array(bonds)]
    sticks = rods(ends[:, 0], ends[:, 1], np.array([STICK_MM[pair] for pair in pairs]), 24)
    return join([balls(places, radii[:, None], 48), sticks])


def _glucose() -> tuple[list[tuple[str, Floats]], list[tuple[int, int]]]:
    """Atoms (element, position in Å) and the pairs of them that are bonded.

    Neighbours in a chair point along opposite tetrahedra, so every place follows from a sign and an index.
    """
    atoms: list[tuple[str, Floats]] = []
    bonds: list[tuple[int, int]] = []

    def attach(kind: str, to: int, direction: Floats) -> int:
        element, place = atoms[to]
        length = BOND_A["".join(sorted(element + kind, key="COH".index))]
        atoms.append((kind, place + direction * length))
        bonds.append((to, len(atoms) - 1))
        return len(atoms) - 1

    steps = np.array([(-1) ** i * TETRAHEDRON[i % 3] for i in range(6)]) * BOND_A["CC"]
    atoms += zip("OCCCCC", np.cumsum(steps, axis=0) - steps, strict=True)
    bonds += [(i, (i + 1) % 6) for i in range(6)]
    for i in range(1, 6):
        out = (-1) ** i * TETRAHEDRON
        side, other, last = (i + 1) % 3, (i + 2) % 3, i % 3
        attach("H", i, out[3])
        if i < 5:
            attach("H", attach("O", i, out[side]), -out[other])
            continue
        carbon = attach("C", i, out[side])
        attach("H", carbon, -out[3])
        attach("H", carbon, -out[last])
        attach("H", attach("O", carbon, -out[other]), out[side])
    return atoms, bonds


def _rotation(about_x: float, about_y: float, about_z: float) -> Floats:
    """(3, 3): turned about z, then y, then x, in radians."""
    turned = np.eye(3)
    for axis, angle in enumerate((about_x, about_y, about_z)):
        step = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
        turned = turned @ step
    return turned


# --- threaded cylinder -----------------------------------------------------------------------------------

HEAD_MM, BOLT_MM, PITCH_MM = 12.0, 42.1, 3.4
ROOT_MM, CREST_MM, HEAD_RADIUS_MM = 21.6, 24.4, 31.46


def threaded_cylinder() -> Mesh:
    """60.3 × 61.2 × 42.1 mm: a bolt standing on its hexagonal head, with a hexagonal socket in its end."""
    return join([_bolt_head(), _bolt_core(), _thread()])


def _bolt_head() -> Mesh:
    """A hexagon whose corners a 30° cone cuts off at both ends. Turned, so that it fills the image."""
    turned = np.radians(16.6)
    angles = around(360, turned)
    hexagon = HEAD_RADIUS_MM * np.cos(TURN / 12) / np.cos((angles - turned) % (TURN / 6) - TURN / 12)
    flat = HEAD_RADIUS_MM * np.cos(TURN / 12) - 0.3
    cut = (hexagon - flat) / np.sqrt(3)
    rings = [(flat, 0.0), (hexagon, cut), (hexagon, HEAD_MM - cut), (flat, HEAD_MM)]
    return loft([polar(radius, angles, z) for radius, z in rings])


def _bolt_core() -> Mesh:
    """The shaft inside the thread; its profile goes up outside and down again inside the socket."""
    angles = around(288)
    socket = 9.5 * np.cos(TURN / 12) / np.cos(angles % (TURN / 6) - TURN / 12)
    profile = [(HEAD_MM - 3, ROOT_MM), (BOLT_MM - 0.8, ROOT_MM), (BOLT_MM, ROOT_MM - 0.8)]
    rings = [polar(radius, angles, z) for z, radius in profile]
    rings += [polar(socket + edge, angles, z) for z, edge in ((BOLT_MM, 0.8), (BOLT_MM - 0.8, 0), (30.0, 0))]
    return loft(rings)


def _thread() -> Mesh:
    """One sharp ridge wound round the shaft, growing out of it and fading into it again."""
    turns = (BOLT_MM - HEAD_MM - 0.6) / PITCH_MM - 1
    angle = np.linspace(0, turns * TURN, round(turns * 360))
    fade = np.minimum(1, np.minimum(angle, angle[::-1]) / (0.4 * TURN))
    # The ridge is rooted 0.4 mm inside the shaft, so that neighbouring turns share no edge with it.
    foot = ROOT_MM - 0.4
    z = HEAD_MM + PITCH_MM / 2 + PITCH_MM * angle / TURN
    corners = [
        polar(foot, angle, z - PITCH_MM / 2),
        polar(foot, angle, z + PITCH_MM / 2),
        polar(foot + 0.05 + (CREST_MM - foot) * fade, angle, z),
    ]
    return loft(np.stack(corners, axis=1))


# --- spherical shell -------------------------------------------------------------------------------------

SHELL_RADIUS_MM, SHELL_WALL_MM = 35.6, 0.35


def spherical_shell() -> Mesh:
    """71.2 mm across with a wall of 0.35 mm: a 0.8 mm feature fits only into the layers near the poles."""
    centre = np.zeros(3)
    outer = balls(centre, [SHELL_RADIUS_MM], 256)
    return join([outer, cavity(balls(centre, [SHELL_RADIUS_MM - SHELL_WALL_MM], 256))])


# --- helical tower ---------------------------------------------------------------------------------------

TOWER_MM, STOREY_MM = 147.2, 13.0


def _tower_radius(z_mm: Floats | float) -> Floats:
    """Where the columns stand at a height: the tower is slender, with a slight waist."""
    z = np.asarray(z_mm) / TOWER_MM
    radius: Floats = 15.6 - 9.6 * z + 2.4 * z**2 - 1.2 * np.sin(z * TURN * 0.9)
    return radius


def helical_tower() -> Mesh:
    """35.6 × 36.2 × 147.2 mm: twisted columns round a fluted hollow core, floors, thin vanes, a ramp."""
    shaft_mm = 122.0
    steps = [prism(polar(17.9 - 1.1 * i, around(96)), 1.2 * i, 1.2 * i + 1.4) for i in range(3)]
    z = np.linspace(2.0, shaft_mm, 180)
    rising, falling = (
        tube(polar(_tower_radius(z), around(12)[:, None] + turns * TURN * z / shaft_mm, z), radius, 10)
        for turns, radius in ((1.25, 0.5), (-1.25, 0.3))
    )
    return join(
        [
            *steps,
            rising,
            falling,
            *_tower_floors(shaft_mm),
            *_tower_core(shaft_mm),
            *_tower_vanes(shaft_mm),
            *_tower_top(shaft_mm),
        ]
    )


def _tower_floors(shaft_mm: float) -> list[Mesh]:
    """A thin floor a storey, with a parapet of balusters so thin that each is one pin of 0.4 mm."""
    parts = []
    for z in np.arange(STOREY_MM, shaft_mm, STOREY_MM):
        edge = float(_tower_radius(z)) + 1.2
        parts += [
            prism(polar(edge, around(96)), z, z + 0.6),
            posts(polar(edge - 0.4, around(48)), 0.2, z, z + 2.2, 6),
            fence(polar(edge - 0.2, around(96)), polar(edge - 0.6, around(96)), z + 2.0, z + 2.4),
        ]
    return parts


def _tower_core(shaft_mm: float) -> list[Mesh]:
    """A fluted tube that twists three times, wall about 0.5 mm, and a ramp winding round it."""
    angles = around(96)
    rings = []
    for wall_mm, z in ((0.0, np.linspace(1.0, shaft_mm, 240)), (0.5, np.linspace(3.0, shaft_mm - 0.6, 240))):
        heights = z[:, None]
        flutes = 3.4 - 1.0 * heights / shaft_mm + 0.7 * np.cos(8 * angles) - wall_mm
        rings.append(polar(flutes, angles + 3 * TURN * heights / shaft_mm, heights))
    turn = np.linspace(0, 8 * TURN, 8 * 72)[:, None]
    level = 4.0 + (shaft_mm - 8.0) * turn / turn.max()
    across = np.linspace(0, 1, 5)
    width = (_tower_radius(level) - 3.2) * 0.55
    return [loft(rings[0]), cavity(loft(rings[1])), sheet(polar(2.6 + width * across, -turn, level), 0.35)]


def _tower_vanes(shaft_mm: float) -> list[Mesh]:
    """Three spiral walls of 0.3 mm from the core to the rising columns."""
    z = np.linspace(2.2, shaft_mm - 1.0, 160)[:, None]
    across = np.linspace(0, 1, 8)
    radius = 2.4 + (_tower_radius(z) - 2.4) * across
    curl = 0.5 * across**2 - 0.5
    return [sheet(polar(radius, start + curl + 1.25 * TURN * z / shaft_mm, z), 0.3) for start in around(3)]


def _tower_top(shaft_mm: float) -> list[Mesh]:
    """A crown of prongs, a spire wound with a thin rib, and its finial."""
    edge = float(_tower_radius(shaft_mm))
    deck = prism(polar(edge + 1.2, around(96)), shaft_mm - 0.6, shaft_mm + 0.6)
    base = polar(edge + 0.7, around(24), shaft_mm)
    prongs = cones(base, base * [0.86, 0.86, 1] + 6.0 * UP, 0.45, 10)
    spire = cones((0, 0, shaft_mm), (0, 0, TOWER_MM - 0.9), 2.6, 48)
    turn = np.linspace(0, 5 * TURN, 360)
    climb = turn / turn.max()
    rise = shaft_mm + 0.4 + 0.8 * (TOWER_MM - shaft_mm) * climb
    rib = tube(polar(2.6 * (1 - 0.8 * climb), turn, rise), 0.35 - 0.2 * climb, 8)
    return [deck, prongs, spire, rib, balls((0, 0, TOWER_MM - 0.9), [0.9], 24)]
