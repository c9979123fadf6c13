"""Layers that were corrected before: the same outlines and settings give the same, and what came out stays so."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np

from layerfix import CorrectedRegions, correct_regions
from layerfix_orca.settings import Settings

Regions = list[list[list[np.ndarray]]]
MOST_BYTES = 256 << 20


class Memory:
    """Corrects layers, and keeps what it has done up to `most_bytes` of outlines."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self.most_bytes = most_bytes
        self.bytes = 0
        self._kept: OrderedDict[bytes, tuple[CorrectedRegions, int]] = OrderedDict()

    def corrected(self, regions: Regions, settings: Settings, first_layer: bool, unit_mm: float) -> CorrectedRegions:
        """As `layerfix.correct_regions`. A layer that came out of here goes through unchanged."""
        feature_mm = settings.feature_mm(first_layer)
        how = repr((settings, feature_mm, unit_mm)).encode()
        key = _digest(how, regions)
        found = self._kept.get(key)
        if found is not None:
            self._kept.move_to_end(key)
            return found[0]
        done = correct_regions(
            regions,
            min_feature_mm=feature_mm,
            pixel_mm=settings.pixel_mm,
            unit_mm=unit_mm,
            mode=settings.mode,
            keep_gaps_mm=settings.keep_gaps_mm,
        )
        if not done.changed:
            done = CorrectedRegions([])  # nobody asks for what did not change
        self._keep(key, done)
        if done.changed:
            self._keep(_digest(how, done.regions), CorrectedRegions([]))
        return done

    def _keep(self, key: bytes, done: CorrectedRegions) -> None:
        size = 200 + sum(ring.nbytes for region in done.regions for polygon in region for ring in polygon)
        self._kept[key] = done, size
        self.bytes += size
        while self.bytes > self.most_bytes and len(self._kept) > 1:
            self.bytes -= self._kept.popitem(last=False)[1][1]


def _digest(how: bytes, regions: Sequence[Sequence[Sequence[np.ndarray]]]) -> bytes:
    """Of the settings and the outlines. Their order within a region does not matter: the host may turn it."""
    seen = hashlib.blake2b(how, digest_size=16)
    for region in regions:
        polygons = []
        for polygon in region:
            one = hashlib.blake2b(digest_size=16)
            for ring in polygon:
                one.update(len(ring).to_bytes(8, "little"))
                one.update(np.ascontiguousarray(ring).data)
            polygons.append(one.digest())
        seen.update(len(polygons).to_bytes(8, "little"))
        seen.update(b"".join(sorted(polygons)))
    return seen.digest()
