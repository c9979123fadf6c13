"""How much material lies where: beads painted from their volume alone, against the area that they are to fill.

A piece of a bead is a strip as wide as its cross-section over the layer's height, so that strips side by side tile;
it is painted with exactly its volume. Nothing here knows how the paths were found.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from layerfix import Layer, LayerStack
from layerfix.fdm import Path
from tests.beads import section_mm2

FINE = 2  # painted pixels for each of the layer's
PAD_MM = 1.0
BLUR_MM = 0.3  # what the nozzle evens out, and the checkers of others blur by
TWO_BEADS_MM = 0.9


@njit
def _paint(heights: np.ndarray, pieces: np.ndarray) -> None:
    """Add to (H, W) heights each piece: (n, 6) x0, y0, x1, y1, half width in px, volume in px · height."""
    high, wide = heights.shape
    for k in range(pieces.shape[0]):
        x0, y0, x1, y1, half, volume = pieces[k]
        length = math.hypot(x1 - x0, y1 - y0)
        if length == 0:
            continue
        ux, uy = (x1 - x0) / length, (y1 - y0) / length
        left, right = max(int(min(x0, x1) - half - 1), 0), min(int(max(x0, x1) + half + 2), wide - 1)
        top, bottom = max(int(min(y0, y1) - half - 1), 0), min(int(max(y0, y1) + half + 2), high - 1)
        count = 0
        for adding in range(2):
            for j in range(top, bottom + 1):
                for i in range(left, right + 1):
                    along, across = (i - x0) * ux + (j - y0) * uy, abs((j - y0) * ux - (i - x0) * uy)
                    if 0 <= along < length and across <= half:
                        if adding:
                            heights[j, i] += volume / count
                        count += not adding
            if not count:
                heights[int((y0 + y1) / 2 + 0.5), int((x0 + x1) / 2 + 0.5)] += volume
                break


@dataclass(frozen=True)
class Laid:
    """What a layer gets.

    ratios       (components,) material over area × height; `thickness_mm` and `area_mm2` likewise
    least, most  of it in any 1 mm × 1 mm that is all inside (nan if there is none)
    least_edge, most_edge   in any 1 mm × 1 mm of which at least a half is inside, over what is inside
    over         share of the area with more than 1.2 × the height, blurred by BLUR_MM
    heights      (H, W) over the layer's height, FINE pixels for one, PAD_MM round; `solid` (H, W) bool
    """

    ratios: np.ndarray
    thickness_mm: np.ndarray
    area_mm2: np.ndarray
    least: float
    most: float
    least_edge: float
    most_edge: float
    over: float
    whole: float
    heights: np.ndarray
    solid: np.ndarray

    @property
    def outside_law(self) -> np.ndarray:
        """(components,) bool: not 90 to 110 % of the material, 85 to 115 % where it is under two beads."""
        slack = np.where(self.thickness_mm < TWO_BEADS_MM, 0.15, 0.10)
        return np.abs(self.ratios - 1) > slack

    def __str__(self) -> str:
        low, high = self.ratios.min(initial=9), self.ratios.max(initial=0)
        return (
            f"parts {len(self.ratios)} ratio {low:.2f}-{high:.2f} bad {int(self.outside_law.sum())}"
            f" mm2 {self.least:.2f}-{self.most:.2f} edge {self.least_edge:.2f}-{self.most_edge:.2f}"
            f" over {100 * self.over:.2f}% whole {self.whole:.3f}"
        )


def material(paths: Iterable[Path], stack: LayerStack, layer: Layer) -> Laid:
    """Paint the beads and measure."""
    layer_mm, pixel_mm = layer.z_mm[1] - layer.z_mm[0], stack.pixel_mm[0] / FINE
    pad = round(PAD_MM / pixel_mm)
    image = np.pad(np.kron(layer.image(), np.ones((FINE, FINE), bool)), pad)
    heights = np.zeros(image.shape)
    corner = np.array(stack.origin_mm) + np.array([-pad, pad]) * pixel_mm
    parts = []
    for path in paths:
        points = (path.points_mm - corner) * [1, -1] / pixel_mm - 0.5
        section = section_mm2(path.width_mm, layer_mm) / layer_mm
        parts.append(np.column_stack([points[:-1], points[1:], section / 2 / pixel_mm,
                                      path.lengths_mm * section / pixel_mm**2]))  # fmt: skip
    pieces = np.concatenate(parts) if parts else np.zeros((0, 6))
    _paint(heights, pieces)
    return _measured(heights, image, pieces, pixel_mm)


def _measured(heights: np.ndarray, solid: np.ndarray, pieces: np.ndarray, pixel_mm: float) -> Laid:
    grey = solid.astype(np.uint8)
    count, labels = cv2.connectedComponents(grey, connectivity=8)
    area = np.bincount(labels.ravel(), minlength=count)[1:]
    _, nearest = cv2.distanceTransformWithLabels(1 - grey, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    of_seed = np.zeros(nearest.max() + 1, np.int64)
    of_seed[nearest[solid]] = labels[solid]
    middle = np.rint((pieces[:, :2] + pieces[:, 2:4]) / 2).astype(int)
    owner = of_seed[nearest[middle[:, 1], middle[:, 0]]]
    volume = np.bincount(owner, pieces[:, 5], minlength=count)[1:]
    depth = cv2.distanceTransform(np.pad(grey, 1), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    thickness = np.zeros(count)
    np.maximum.at(thickness, labels.ravel(), 2 * depth.ravel() * pixel_mm)
    side = round(1 / pixel_mm)
    box = {"ksize": (side, side), "normalize": True, "borderType": cv2.BORDER_CONSTANT}
    inside, laid = (cv2.boxFilter(x, cv2.CV_64F, **box) for x in (solid.astype(float), heights))
    full, half = inside > 1 - 1e-6, inside >= 0.5
    share = laid[half] / inside[half]
    blurred = cv2.GaussianBlur(heights, (0, 0), BLUR_MM / pixel_mm)
    return Laid(
        ratios=volume / np.maximum(area, 1),
        thickness_mm=thickness[1:],
        area_mm2=area * pixel_mm**2,
        least=float(laid[full].min()) if full.any() else math.nan,
        most=float(laid[full].max()) if full.any() else math.nan,
        least_edge=float(share.min()) if half.any() else math.nan,
        most_edge=float(share.max()) if half.any() else math.nan,
        over=float((blurred[solid] > 1.2).mean()) if solid.any() else 0.0,
        whole=float(pieces[:, 5].sum() / max(area.sum(), 1)),
        heights=heights,
        solid=solid,
    )
