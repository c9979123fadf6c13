"""The page itself: one file that opens from disk, with the data, the viewer and its styles in it."""

from __future__ import annotations

import base64
import html
import json
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.files import whole_file

if TYPE_CHECKING:
    from layerfix.report.collect import Report
    from layerfix.stack import LayerStack


def page_of(report: Report) -> str:
    """The whole page, as HTML in ASCII. Texts of files come in it as JSON only: nothing in them is markup."""
    viewer = resources.files("layerfix.report") / "viewer"
    parts = {
        "TITLE": html.escape(report.meta["title"]),
        "STYLE": (viewer / "style.css").read_text(encoding="utf-8"),
        "DATA": _data(report),
        "SCRIPT": (viewer / "viewer.js").read_text(encoding="utf-8").replace("</script", "<\\/script"),
    }
    text = (viewer / "template.html").read_text(encoding="utf-8")
    pieces = [text]
    for name, part in parts.items():
        head, _, tail = pieces.pop().partition(f"%%{name}%%")
        pieces += [head, part, tail]
    return "".join(pieces).encode("ascii", "xmlcharrefreplace").decode("ascii")


def _data(report: Report) -> str:
    meta = json.dumps(report.meta, separators=(",", ":"), allow_nan=False)
    meta = meta.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    tags = [f'<script type="application/json" id="meta">{meta}</script>']
    tags += [
        f'<script type="text/plain" id="{name}">{base64.b64encode(blob).decode("ascii")}</script>'
        for name, blob in report.blobs.items()
    ]
    return "\n".join(tags)


def write_page(path: Path, report: Report, *, force: bool) -> None:
    """Write the page. Raises OutputError for an existing path without `force`, and what the system refuses."""
    with whole_file(path, force=force) as file:
        file.write(page_of(report).encode("ascii"))


class Shown:
    """A report in a notebook: its cell shows the page."""

    def __init__(self, report: Report, height_px: int = 900) -> None:
        self.report = report
        self.height_px = height_px

    def _repr_html_(self) -> str:
        page = html.escape(page_of(self.report), quote=True)
        return f'<iframe srcdoc="{page}" style="width:100%;height:{self.height_px}px;border:0"></iframe>'

    def save(self, path: str | Path, *, force: bool = False) -> None:
        """Write the page to a file."""
        write_page(Path(path), self.report, force=force)


def show(before: LayerStack, after: LayerStack, *, title: str = "layers", height_px: int = 900) -> Shown:
    """The report of layers before and after correction, for a notebook's cell.

    Raises InputError if they are not the same layers, or nothing is solid in them.
    """
    from layerfix.report.collect import About, check_alike, collect

    check_alike(before, after, ("before", "after"))
    change = after[0].change if len(after) else None
    feature_mm = 2 * max(r * p for r, p in zip(change.radius_px, after.pixel_mm, strict=True)) if change else None
    return Shown(collect(before, after, About(title, feature_mm=feature_mm)), height_px)
