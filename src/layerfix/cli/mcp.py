"""``layerfix mcp``."""

from __future__ import annotations

from pathlib import Path

import cloup


@cloup.command()
@cloup.argument("folder", metavar="DIR", type=cloup.Path(path_type=Path))
def mcp(folder: Path) -> None:
    """Serve check, fix and printers to a program that speaks the Model Context Protocol, on stdin and stdout.

    Only files in DIR are read and written. Needs the extra: pip install 'layerfix[mcp]'.

    \b
    Example, in such a program's settings:
      {"mcpServers": {"layerfix": {"command": "layerfix", "args": ["mcp", "/home/me/prints"]}}}
    """
    from layerfix.commands.serve import server_for

    server_for(folder).run("stdio")
