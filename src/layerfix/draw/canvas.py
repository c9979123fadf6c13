"""Plain drawings that come out as SVG or PNG: filled shapes, thick lines, words."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import numpy as np

from layerfix.errors import OutputError
from layerfix.files import whole_file

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from PIL.Image import Image as Picture

SUFFIXES = (".png", ".svg")
# What XML has no place for, such as control characters and the halves of bytes that are no unicode.
NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
OVERSAMPLING = 2  # of PNG, then averaged: smooth edges


@dataclass
class Drawing:
    """Shapes in the order they are drawn; x to the right and y down, in px."""

    width: float
    height: float
    background: str = "#ffffff"
    shapes: list[tuple[str, list[tuple[float, float]], float, str]] = field(default_factory=list)
    words: list[tuple[float, float, str, float, str, str]] = field(default_factory=list)

    def line(self, points: ArrayLike, width: float, colour: str) -> None:
        """A line with round ends and corners through (n, 2) points."""
        self.shapes.append(("line", _pairs(points), width, colour))

    def area(self, points: ArrayLike, colour: str) -> None:
        """A filled polygon with (n, 2) corners."""
        self.shapes.append(("area", _pairs(points), 0.0, colour))

    def box(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """A filled rectangle."""
        self.area([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], colour)

    def text(self, x: float, y: float, words: str, size: float, colour: str, anchor: str = "start") -> None:
        """Words whose baseline is at y; anchor: "start", "middle" or "end"."""
        self.words.append((x, y, NO_XML.sub("\ufffd", words), size, colour, anchor))

    def svg(self) -> str:
        """The drawing as an SVG document."""
        out = [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{self.width:g}" height="{self.height:g}"'
            f' viewBox="0 0 {self.width:g} {self.height:g}">',
            f'<rect width="100%" height="100%" fill="{self.background}"/>',
        ]
        for kind, points, width, colour in self.shapes:
            path = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
            if kind == "area":
                out.append(f'<polygon points="{path}" fill="{colour}"/>')
            else:
                out.append(
                    f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width:.3g}"'
                    ' stroke-linecap="round" stroke-linejoin="round"/>'
                )
        for x, y, words, size, colour, anchor in self.words:
            out.append(
                f'<text x="{x:.2f}" y="{y:.2f}" font-family="sans-serif" font-size="{size:g}" fill="{colour}"'
                f' text-anchor="{anchor}">{escape(words)}</text>'
            )
        return "\n".join([*out, "</svg>\n"])

    def png(self) -> Picture:
        """The drawing as a picture."""
        from PIL import Image, ImageDraw

        k = OVERSAMPLING
        size = round(self.width * k), round(self.height * k)
        canvas = Image.new("RGB", size, self.background)
        pen = ImageDraw.Draw(canvas)
        for kind, points, width, colour in self.shapes:
            scaled = [(x * k, y * k) for x, y in points]
            if kind == "area":
                pen.polygon(scaled, fill=colour)
                continue
            pen.line(scaled, fill=colour, width=max(round(width * k), 1), joint="curve")
            r = width * k / 2
            if r > 1:
                for x, y in (scaled[0], scaled[-1]):
                    pen.ellipse((x - r, y - r, x + r, y + r), fill=colour)
        picture = canvas.resize((size[0] // k, size[1] // k), Image.Resampling.BOX)
        pen = ImageDraw.Draw(picture)
        for x, y, words, points_px, colour, anchor in self.words:
            mark = {"start": "ls", "middle": "ms", "end": "rs"}[anchor]
            pen.text((x, y), words, fill=colour, font_size=points_px, anchor=mark)
        return picture

    def save(self, path: Path, *, force: bool) -> None:
        """Write .svg or .png. Raises OutputError for another suffix and whatever `whole_file` refuses."""
        check_drawing(path)
        with whole_file(path, force=force) as file:
            if path.suffix.lower() == ".svg":
                file.write(self.svg().encode())
            else:
                self.png().save(file, "PNG")


def check_drawing(path: Path) -> None:
    """Raises OutputError unless a drawing can be written to `path` by its suffix."""
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{path}: a drawing is written as {' or '.join(SUFFIXES)}")


def _pairs(points: ArrayLike) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in np.asarray(points, np.float64).reshape(-1, 2)]
