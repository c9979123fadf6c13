"""The beads of a layer → everything the printer does to lay them: move by move, with travels, retractions and lifts.

One table a layer, so that what is written and what is timed are the same numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from layerfix.fdm.beads import KINDS, LayerPaths, section_mm2
from layerfix.fdm.motion import Limits, limits_of, move_seconds
from layerfix.fdm.speeds import Speeds

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from layerfix.printers import Printer

    Floats = NDArray[np.float64]

# A layer that is done sooner is still soft under the next one, so it is laid slower, but not slower than this.
LEAST_LAYER_S, LEAST_MM_S = 8.0, 10.0
NOWHERE_MM = 5e-4  # what is nearer is the same place in G-code's three digits
TRAVEL, LIFT, RETRACT = -1, -2, -3  # kinds of moves that lay nothing: sideways, up and down, of the filament alone


@dataclass(frozen=True, eq=False)
class Moves:
    """What the printer does in a row.

    from_mm    (3,) where it is before
    to_mm      (n, 3) where each move ends; a move that ends where it began is of the filament alone
    e_mm       (n,) filament pushed by each, below 0 where it is drawn back
    mm_s       (n,) feedrate
    mm_s2      (n,) acceleration
    kind       (n,) number in KINDS of what is laid, or TRAVEL, LIFT, RETRACT
    width_mm   (n,) of the bead; 0 where nothing is laid
    mm3        (n,) material laid
    """

    from_mm: Floats
    to_mm: Floats
    e_mm: Floats
    mm_s: Floats
    mm_s2: Floats
    kind: NDArray[np.int64]
    width_mm: Floats
    mm3: Floats

    def __len__(self) -> int:
        return len(self.e_mm)

    @property
    def lays(self) -> NDArray[np.bool_]:
        return self.kind >= 0

    @cached_property
    def delta_mm(self) -> Floats:
        """(n, 4) X, Y, Z and E of each."""
        return np.column_stack([np.diff(self.to_mm, axis=0, prepend=self.from_mm[None]), self.e_mm])

    def seconds(self, limits: Limits) -> Floats:
        """(n,) of each (`motion`)."""
        return move_seconds(self.delta_mm, self.mm_s, self.mm_s2, limits)

    def slowed(self, factor: float) -> Moves:
        """Beads at this share of their speed, but none that was faster below LEAST_MM_S; travels as they are."""
        slow = np.maximum(self.mm_s * factor, np.minimum(self.mm_s, LEAST_MM_S))
        return replace(self, mm_s=np.where(self.lays, slow, self.mm_s))


@dataclass
class Nozzle:
    """The printer's nozzle on its way through the layers.

    at_mm  (3,) where it is, at first where the start code left it
    """

    printer: Printer
    offset_mm: Floats
    at_mm: Floats = field(default_factory=lambda: np.zeros(3))
    first: bool = True

    def __post_init__(self) -> None:
        self.speeds = Speeds(self.printer)
        self.limits = limits_of(self.printer)
        self.filament_mm2 = math.pi * self.speeds.value("filament_mm") ** 2 / 4

    def moves(self, layer: LayerPaths) -> tuple[Moves, float]:
        """(all of a layer, in how many seconds), slow enough to take LEAST_LAYER_S; the nozzle is at its end then."""
        moves = self._moves(layer)
        seconds = moves.seconds(self.limits)
        total, laying = float(seconds.sum()), float(seconds[moves.lays].sum())
        factor, fast = 1.0, moves
        for _ in range(2):  # where corners set the pace a slower feedrate changes less, so once is a little short
            if total >= LEAST_LAYER_S or not laying:
                break
            factor *= laying / max(LEAST_LAYER_S - (total - laying), laying)
            moves = fast.slowed(factor)
            seconds = moves.seconds(self.limits)
            total, laying = float(seconds.sum()), float(seconds[moves.lays].sum())
        self.at_mm, self.first = moves.to_mm[-1], False
        return moves, total

    def _moves(self, layer: LayerPaths) -> Moves:
        beads = self._beads(layer)
        ways: Sequence[Floats | None] = layer.ways or [None] * (len(layer.paths) - 1)
        pieces, stop, at = [], 0, self.at_mm
        for path, way in zip(layer.paths, (None, *ways), strict=True):
            to = np.array([*(path.points_mm[0] + self.offset_mm), layer.z_mm[1]])
            rows = self._travel(at, to, way) if stop else self._begin(at, to)
            if rows:
                pieces.append(np.array(rows))
            first, stop = stop, stop + len(path.width_mm)
            pieces.append(beads[first:stop])
            at = beads[stop - 1, :3]
        table = np.concatenate(pieces)
        e_mm, mm_s, mm_s2, kind, width, mm3 = table[:, 3:].T
        return Moves(self.at_mm, table[:, :3], e_mm, mm_s, mm_s2, kind.astype(np.int64), width, mm3)

    def _beads(self, layer: LayerPaths) -> Floats:
        """(n, 9) rows of all beads, with no travel between them: the columns of `Moves` in order."""
        paths, height = layer.paths, layer.layer_mm
        counts = [len(path.width_mm) for path in paths]
        kinds = [KINDS.index(path.kind) for path in paths]
        kind = np.repeat(kinds, counts)
        flow = np.repeat([self.speeds.flow(path.kind) for path in paths], counts)
        width = np.concatenate([path.width_mm for path in paths])
        section = np.asarray(section_mm2(width, height)) * flow
        mm3 = np.concatenate([path.lengths_mm for path in paths]) * section
        out = np.empty((len(kind), 9))
        out[:, :2] = np.concatenate([path.points_mm[1:] for path in paths]) + self.offset_mm
        out[:, 2] = layer.z_mm[1]
        out[:, 3] = mm3 / self.filament_mm2
        out[:, 4] = self.speeds.bead_mm_s(kind, section, first_layer=self.first)
        out[:, 5] = self.speeds.value("acceleration_mm_s2")
        out[:, 6], out[:, 7], out[:, 8] = kind, width, mm3
        return out

    def _row(self, kind: int, at: Sequence[float], e: float = 0.0) -> list[float]:
        speed = self.speeds.value("retract_mm_s" if kind == RETRACT else "travel_mm_s")
        steep = self.speeds.value("acceleration_mm_s2") if kind == RETRACT else self.speeds.travel_mm_s2
        return [*at, e, speed, steep, kind, 0.0, 0.0]

    def _drawn_back(self, start: Sequence[float], rows: list[list[float]]) -> list[list[float]]:
        """The rows of a way between a retraction at its start and the return of the filament at its end."""
        back = self.speeds.value("retract_mm")
        return [self._row(RETRACT, start, -back), *rows, self._row(RETRACT, rows[-1][:3], back)] if back else rows

    def _begin(self, start: Floats, to: Floats) -> list[list[float]]:
        """To the first bead of a layer: from the layer below, or from where the start code has left the nozzle above
        the bed, so that it goes sideways first. Always with a retraction, for a new height takes its time."""
        (x0, y0, z0), (x, y, z) = start.tolist(), to.tolist()
        way = math.hypot(x - x0, y - y0)
        if self.first:
            rows = [self._row(TRAVEL, (x, y, z0))]
        elif way > self.speeds.value("retract_before_travel_mm"):
            above = z + self.speeds.value("retract_lift_mm")
            rows = [self._row(LIFT, (x0, y0, above)), self._row(TRAVEL, (x, y, above))]
        else:
            rows = [self._row(LIFT, (x0, y0, z)), *([self._row(TRAVEL, (x, y, z))] if way > NOWHERE_MM else [])]
        if rows[-1][2] != z:
            rows.append(self._row(LIFT, (x, y, z)))
        return self._drawn_back((x0, y0, z0), rows)

    def _travel(self, start: Floats, to: Floats, via: Floats | None) -> list[list[float]]:
        """To the next bead of a layer: through `via` if the way stays in the solid, else drawn back and lifted."""
        (x0, y0, z), (x, y, _) = start.tolist(), to.tolist()
        way = math.hypot(x - x0, y - y0)
        if way <= NOWHERE_MM:
            return []
        if via is not None:
            return [*(self._row(TRAVEL, (*xy, z)) for xy in (via + self.offset_mm).tolist()),
                    self._row(TRAVEL, (x, y, z))]  # fmt: skip
        if way <= self.speeds.value("retract_before_travel_mm"):
            return [self._row(TRAVEL, (x, y, z))]
        lift = self.speeds.value("retract_lift_mm")
        rows = [self._row(TRAVEL, (x, y, z + lift))]
        if lift:
            rows = [self._row(LIFT, (x0, y0, z + lift)), *rows, self._row(LIFT, (x, y, z))]
        return self._drawn_back((x0, y0, z), rows)
