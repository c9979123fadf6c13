"""The commands. Each parses, makes one call and prints; heavy imports wait until a command needs them."""

from __future__ import annotations

import cloup

from layerfix import __version__
from layerfix.cli.check import check
from layerfix.cli.fix import fix
from layerfix.cli.lists import completion, formats, printers
from layerfix.cli.mcp import mcp
from layerfix.cli.orient import orient
from layerfix.cli.pictures import demo, draw
from layerfix.cli.report import report, show
from layerfix.cli.watch import watch
from layerfix.cli.widths import widths


@cloup.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@cloup.version_option(__version__, prog_name="layerfix")
def layerfix() -> None:
    """Correct the layers of a 3D print so that thin walls and pins survive printing.

    \b
    Start here:
      layerfix demo                                      a built-in part, before and after
      layerfix check part.stl -p prusa-mk3s-0.4          what a printer would lose
      layerfix fix part.stl layers.zip -p prusa-sl1s     a mesh into corrected layer images
      layerfix printers                                  the printers it knows

    \b
    Within other programs (plugin/ in the sources): OrcaSlicer, Cura, PrusaSlicer, Chitubox,
    UVtools, DragonFruit, any export folder (watch), Blender, GitHub, MCP clients (mcp).
    """


for command in (fix, check, report, orient, show, watch, widths, draw, demo, printers, formats, mcp, completion):
    layerfix.add_command(command)
