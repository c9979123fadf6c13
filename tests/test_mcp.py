"""`layerfix mcp` by a real client of the SDK, over the pipes of a real process."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from layerfix.commands.serve import Confined, fix_within
from layerfix.errors import InputError
from tests.making import SOURCE, environment, run_layerfix, thin_part, write_stl

pytest.importorskip("mcp.server.mcpserver", reason="the SDK (mcp 2) is not installed")
from mcp import Client, StdioServerParameters


def talk(folder: Path, work: Callable[[Client], Awaitable[Any]]) -> Any:
    """What comes of talking to `layerfix mcp FOLDER`."""
    server = StdioServerParameters(
        command=sys.executable, args=["-m", "layerfix", "mcp", str(folder)], env=environment(PYTHONPATH=str(SOURCE))
    )

    async def session() -> Any:
        async with Client(server) as client:
            return await work(client)

    return asyncio.run(asyncio.wait_for(session(), 110))


def data(result: Any) -> Any:
    """The JSON of a tool's answer."""
    assert not result.is_error, result.content
    structured = result.structured_content
    return structured.get("result", structured) if structured is not None else json.loads(result.content[0].text)


def test_a_client_checks_fixes_and_checks_again(tmp_path):
    """It finds the tools, a printer by a misspelt name, what is too thin, and nothing after correction; what leads
    out of the folder is refused, and says nothing of where the folder is.
    """
    folder = tmp_path / "prints"
    folder.mkdir()
    write_stl(folder / "part.stl", thin_part())
    write_stl(tmp_path / "secret.stl", thin_part())
    (folder / "link.stl").symlink_to(tmp_path / "secret.stl")

    async def work(client: Client) -> dict[str, Any]:
        found: dict[str, Any] = {"tools": [tool.name for tool in (await client.list_tools()).tools]}
        found["printers"] = data(await client.call_tool("printers", {"search": "elego satrun 4 ultra 16k"}))
        how = {"min_feature": "0.4mm", "pixel": "50um", "layer": "0.1mm"}
        found["before"] = data(await client.call_tool("check", {"file": "part.stl", **how}))
        found["fixed"] = data(await client.call_tool("fix", {"file": "part.stl", "output": "fixed.stl", **how}))
        found["after"] = data(await client.call_tool("check", {"file": "fixed.stl", **how}))
        wrong = [
            ("check", {"file": "../secret.stl", **how}), ("check", {"file": str(tmp_path / "secret.stl"), **how}),
            ("check", {"file": "link.stl", **how}), ("fix", {"file": "part.stl", "output": "../out.stl", **how}),
            ("fix", {"file": "part.stl", "output": "fixed.stl", **how}), ("check", {"file": "none.stl", **how}),
            ("check", {"file": "part.stl", "printer": "../p.toml"}),
            ("check", {"file": "part.stl", "min_feature": "4"}),
        ]  # fmt: skip
        results = [await client.call_tool(name, arguments) for name, arguments in wrong]
        assert all(result.is_error for result in results)
        found["errors"] = [result.content[0].text for result in results]
        return found

    found = talk(folder, work)
    assert sorted(found["tools"]) == ["check", "fix", "printers"]
    assert [one["name"] for one in found["printers"]] == ["elegoo-saturn-4-ultra-16k"]
    assert (found["before"]["ok"], found["after"]["ok"]) == (False, True)
    assert found["before"]["features_lost"] > 0
    assert found["fixed"]["target"] == "fixed.stl"
    assert found["fixed"]["added_mm3"] > 0
    assert {path.name for path in folder.iterdir()} == {"part.stl", "link.stl", "fixed.stl"}
    assert {path.name for path in tmp_path.iterdir()} == {"prints", "secret.stl"}
    whys = ("outside", "outside", "outside", "outside", "exists already", "no such file", "outside", "has no unit")
    for why, said in zip(whys, found["errors"], strict=True):
        assert why in said, said
        assert str(folder) not in said


@pytest.mark.parametrize("name", ["..", "../x", "/etc/passwd", "a/../../x", ".", "", "a\0b", "sub/../.."])
def test_no_name_leads_out(tmp_path, name):
    """However it is written."""
    with pytest.raises(InputError):
        Confined(tmp_path).inside(name)
    assert Confined(tmp_path).inside("sub/../a.stl") == tmp_path.resolve() / "a.stl"


def test_an_output_through_a_link_out_of_the_folder_is_refused(tmp_path):
    """A folder in it that is a link to elsewhere."""
    folder, other = tmp_path / "in", tmp_path / "other"
    folder.mkdir()
    other.mkdir()
    (folder / "link").symlink_to(other)
    write_stl(folder / "part.stl", thin_part())
    with pytest.raises(InputError, match="outside"):
        fix_within(Confined(folder), "part.stl", "link/out.stl", "", "0.4mm", "50um", "0.1mm")
    assert not list(other.iterdir())


def test_answers_have_the_names_that_the_tools_have(tmp_path):
    """Not those of the command line; and a pixel may have two sides."""
    said = Confined(tmp_path).said
    assert said(f"{tmp_path.resolve()}/a.zip: exists already; use --force to replace it") == (
        "a.zip: exists already; use overwrite to replace it"
    )
    assert said("give --printer, or --pixel (such as --pixel 50um); (--first-layer) a--b --") == (
        "give printer, or pixel (such as pixel 50um); (first_layer) a--b --"
    )
    write_stl(tmp_path / "part.stl", thin_part())
    found = fix_within(Confined(tmp_path), "part.stl", "a.zip", "", "0.4mm", "50umx60um", "0.1mm")
    assert found["pixel_mm"] == (0.05, 0.06)
    with pytest.raises(InputError, match="'1umx2umx3um' is not a pitch"):
        fix_within(Confined(tmp_path), "part.stl", "b.zip", "", "0.4mm", "1umx2umx3um", "0.1mm")


def test_a_folder_that_is_not_there(tmp_path):
    """Said at the start."""
    done = run_layerfix("mcp", tmp_path / "none")
    assert (done.code, "no such folder" in done.err) == (2, True)
