"""A server of the Model Context Protocol on standard input and output: check, fix and printers, within one folder.

Sources: the protocol's specification (modelcontextprotocol.io) through its official SDK for Python, `mcp` 2.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from layerfix import __version__
from layerfix.commands.options import Options, options_of
from layerfix.errors import InputError, LayerfixError, OutputError
from layerfix.units import parse_length_mm, parse_pitch_mm

if TYPE_CHECKING:
    from mcp.server import MCPServer

Result = TypeVar("Result")
OPTION, OTHER_NAMES = re.compile(r"(?<![\w-])--([a-z][a-z-]*)"), {"force": "overwrite"}
MOST_PLACES = 20  # of each kind, in an answer
INSTRUCTIONS = (
    "layerfix finds what is too thin for a 3D printer in a mesh, a resin job or layer images, and thickens that."
    " Paths are relative to the folder that this server was started for; nothing outside of it is read or written."
    " Lengths have a unit: 0.4mm, 50um. Name a printer (see the tool printers), or give min_feature, and for a mesh"
    " pixel and layer too."
)


@dataclass(frozen=True)
class Confined:
    """Paths within a folder, links followed."""

    folder: Path

    def inside(self, name: str) -> Path:
        """The path that a name means. Raises InputError for one that leads out of the folder."""
        root = self.folder.resolve()
        try:
            path = (root / name).resolve()
        except (OSError, ValueError, RuntimeError) as problem:  # a null character, links in a circle
            raise InputError(f"'{name}' is no path: {problem}") from problem
        if path != root and root not in path.parents:
            raise InputError(
                f"'{name}' is outside of the folder of this server; only what is in it is read and written"
            )
        if path == root:
            raise InputError(f"'{name}' is the folder of this server itself; name a file in it")
        return path

    def said(self, text: str) -> str:
        """A message without where the folder is, and with the tools' own names for what the command line has."""
        text = text.replace(f"{self.folder.resolve()}/", "")
        return OPTION.sub(lambda found: OTHER_NAMES.get(found[1], found[1].replace("-", "_")), text)


def server_for(folder: Path) -> MCPServer[Any]:
    """The server, not yet running. Raises InputError if the SDK or the folder is not there."""
    try:
        from mcp.server import MCPServer
        from mcp.server.mcpserver.exceptions import ToolError
    except ImportError as problem:
        raise InputError("the MCP server needs the SDK (mcp 2): pip install 'layerfix[mcp]'") from problem
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; the server reads and writes in one")
    confined = Confined(folder)
    server: MCPServer[Any] = MCPServer("layerfix", version=__version__, instructions=INSTRUCTIONS, log_level="ERROR")

    def answered(work: Callable[[], Result]) -> Result:
        try:
            return work()
        except LayerfixError as problem:
            raise ToolError(confined.said(str(problem))) from problem

    @server.tool()
    def printers(search: str = "", process: str = "") -> list[dict[str, Any]]:
        """List the printers and print services that are known by name: name, title, process (resin, fdm, powder,
        service), minimum printable feature in mm. search: words of maker and model; spelling is forgiven.
        """
        return answered(lambda: list_printers(search, process))

    @server.tool()
    def check(
        file: str, printer: str = "", min_feature: str = "", pixel: str = "", layer: str = ""
    ) -> dict[str, Any]:
        """Say what a printer would lose of a mesh (.stl .3mf .obj .ply .glb), a resin job or layer images, and where;
        nothing is written. ok: nothing would be lost. Coordinates and sizes in mm.
        """
        return answered(lambda: check_within(confined, file, printer, min_feature, pixel, layer))

    @server.tool()
    def fix(
        file: str,
        output: str,
        printer: str = "",
        min_feature: str = "",
        pixel: str = "",
        layer: str = "",
        mode: str = "",
        overwrite: bool = False,
    ) -> dict[str, Any]:
        """Thicken what is too thin in file and write output. The suffix of output says what is written: a mesh
        (.stl .3mf .obj .ply .glb), .gcode, layer images (.zip, or none for a folder), outlines (.svg), or a job of
        the same kind as file. mode: add_only never removes anything, as_printed rounds corners as the tool does.
        """
        given = (printer, min_feature, pixel, layer)
        return answered(lambda: fix_within(confined, file, output, *given, mode=mode, overwrite=overwrite))

    return server


def list_printers(search: str, process: str) -> list[dict[str, Any]]:
    """Known printers, as JSON."""
    from layerfix.printers import PROCESSES, find_printers

    if process and process not in PROCESSES:
        raise InputError(f"process '{process}' is not known; choose from {', '.join(PROCESSES)}")
    found = find_printers(process or None, search)
    return [
        {"name": e.name, "title": e.title, "process": e.process, "min_feature_mm": e.min_feature_mm} for e in found
    ]


def check_within(
    confined: Confined, file: str, printer: str, min_feature: str, pixel: str, layer: str
) -> dict[str, Any]:
    """`check` on a file of the folder: the verdict without its layers, and the worst places."""
    from layerfix.commands.check import check

    verdict = check(confined.inside(file), _options(confined, printer, min_feature, pixel, layer))
    found = asdict(verdict)
    del found["by_layer"]
    for key in ("lost", "islands", "specks", "topology"):
        found[key] = found[key][:MOST_PLACES]
    found["source"] = file
    return found


def fix_within(
    confined: Confined, file: str, output: str, printer: str, min_feature: str, pixel: str, layer: str, *,
    mode: str = "", overwrite: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """`fix` from a file of the folder to another: the summary, with the worst places."""
    from layerfix.commands.project import fix_file

    if mode not in ("", "add_only", "as_printed"):
        raise InputError(f"mode '{mode}' is not known; choose from add_only, as_printed")
    target = confined.inside(output)
    if not target.parent.is_dir():
        raise OutputError(f"{output}: there is no folder for it")
    options = _options(confined, printer, min_feature, pixel, layer, mode=mode or None, force=overwrite)
    found = asdict(fix_file(confined.inside(file), target, options))
    for key in ("topology", "conflicts"):
        found[key] = found[key][:MOST_PLACES]
    return {**found, "source": file, "target": output}


def _options(confined: Confined, printer: str, min_feature: str, pixel: str, layer: str, **more: object) -> Options:
    from layerfix.printers import load_printer

    known = None
    if printer:
        known = load_printer(confined.inside(printer) if printer.lower().endswith(".toml") else printer)
    given: dict[str, Any] = dict(more)
    for name, text in (("min_feature_mm", min_feature), ("layer_mm", layer)):
        if text:
            given[name] = parse_length_mm(text)
    if pixel:
        given["pixel_mm"] = parse_pitch_mm(pixel)
    return options_of(known, given)
