"""The page of the last slice: what was thickened, by object, and a picture of the layer that changed most."""

from __future__ import annotations

import html
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

try:
    from layerfix import report
except ImportError:  # a version of layerfix without reports
    report = None

PICTURE_PX = 720
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em; color: #222; background: #fff; max-width: 60em }
table { border-collapse: collapse } td, th { padding: .25em .9em .25em 0; text-align: left }
td.n, th.n { text-align: right } figure { margin: 1.5em 0 } figcaption { color: #555 } svg { border: 1px solid #ddd }
.a { fill: #d9480f } .b { fill: #adb5bd } button { font: inherit; padding: .3em 1em }
@media (prefers-color-scheme: dark) { body { color: #ddd; background: #1b1b1b } svg { border-color: #444 } }
"""
SCRIPT = """
function ask() { orca.postMessage({ cmd: "refresh" }); }
orca.onMessage(function (message) {
  if (message && message.cmd === "page") document.getElementById("page").innerHTML = message.html;
});
document.addEventListener("visibilitychange", function () { if (!document.hidden) ask(); });
window.addEventListener("focus", ask);
"""


@dataclass
class ObjectDone:
    """What was done to one object: lengths in mm, outlines in the host's units."""

    name: str
    layers: int
    min_feature_mm: float
    changed: int = 0
    added_mm3: float = 0.0
    unit_mm: float = 1e-6
    most_mm2: float = 0.0
    most_z_mm: float = 0.0
    most: tuple[Any, Any] | None = field(default=None, repr=False)  # regions before and after

    def note(self, before: Any, done: Any, z_mm: float, height_mm: float) -> None:
        """Add up one changed layer."""
        self.changed += 1
        self.added_mm3 += done.added_mm2 * height_mm
        if done.added_mm2 > self.most_mm2:
            self.most_mm2, self.most_z_mm, self.most = done.added_mm2, z_mm, (before, done.regions)

    @property
    def message(self) -> str:
        """One line for the log."""
        if not self.changed:
            return f"{self.name}: nothing is thinner than {self.min_feature_mm:.3g} mm"
        return (
            f"{self.name}: {self.changed} of {self.layers} layers thickened to {self.min_feature_mm:.3g} mm,"
            f" {short(self.added_mm3)} mm³ added"
        )


def short(value: float) -> str:
    """Three digits, or all before the point."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def whole_page(done: Iterable[ObjectDone]) -> str:
    """The page with its style and script, as the host's tab shows it."""
    return (
        f"<!doctype html><html><head><meta charset='utf-8'><title>layerfix</title><style>{STYLE}</style></head><body>"
        f"<h1>Thin features in the last slice</h1><p><button onclick='ask()'>Refresh</button></p>"
        f"<div id='page'>{body(done)}</div><script>{SCRIPT}</script></body></html>"
    )


def body(done: Iterable[ObjectDone]) -> str:
    """What changes from slice to slice. The library's own report of the outlines, where it has one."""
    done = list(done)
    of_outlines = getattr(report, "page_of_outlines", None)
    if of_outlines is not None and done:
        return str(of_outlines(done))
    if not done:
        return (
            "<p>Nothing was sliced yet with <i>Thicken thin features</i> as the Slicing Pipeline Plugin"
            " (process settings, Others).</p>"
        )
    rows = "".join(
        f"<tr><td>{html.escape(one.name)}</td><td class='n'>{one.layers}</td><td class='n'>{one.changed}</td>"
        f"<td class='n'>{one.min_feature_mm:.3g} mm</td><td class='n'>{short(one.added_mm3)} mm³</td></tr>"
        for one in done
    )
    table = (
        "<table><tr><th>object</th><th class='n'>layers</th><th class='n'>thickened</th>"
        f"<th class='n'>minimum feature</th><th class='n'>added</th></tr>{rows}</table>"
    )
    return table + "".join(_figure(one) for one in done if one.most is not None)


def _figure(one: ObjectDone) -> str:
    before, after = one.most or ([], [])
    points = np.concatenate([ring for region in after for polygon in region for ring in polygon])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = PICTURE_PX / max(1.0, float((high - low).max()))
    width, height = ((high - low) * scale + 20).tolist()

    def path(regions: Any) -> str:
        rings = (ring for region in regions for polygon in region for ring in polygon)
        return "".join(
            "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in ((ring - low) * scale + 10).tolist()) + "Z"
            for ring in rings
        )

    return (
        f"<figure><svg width='{width:.0f}' height='{height:.0f}'><g transform='matrix(1 0 0 -1 0 {height:.0f})'>"
        f"<path class='a' fill-rule='evenodd' d='{path(after)}'/><path class='b' fill-rule='evenodd'"
        f" d='{path(before)}'/></g></svg><figcaption>{html.escape(one.name)}, layer at z ="
        f" {one.most_z_mm:.2f} mm: what was added is orange ({short(one.most_mm2)} mm²)</figcaption></figure>"
    )
