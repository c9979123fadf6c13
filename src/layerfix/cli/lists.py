"""What layerfix knows: ``layerfix printers`` and ``layerfix formats``; and ``layerfix completion``."""

from __future__ import annotations

import json
from dataclasses import asdict

import click
import cloup

from layerfix.cli.shared import JSON
from layerfix.errors import InputError


@cloup.group(invoke_without_command=True)
@cloup.option("--process", type=cloup.Choice(["resin", "fdm", "powder", "service"]), help="Only these.")
@cloup.option(
    "--search", metavar="TEXT", default="", help="Only those with TEXT in maker, model or name, or nearly so."
)
@cloup.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
@cloup.pass_context
def printers(ctx: click.Context, process: str | None, search: str, as_json: bool) -> None:
    """List the printers that --printer takes, or show one.

    A line has the name, maker and model, process, pixels or nozzle, and the minimum printable feature.

    \b
    Examples:
      layerfix printers --search "elegoo saturn"
      layerfix printers show prusa-sl1s
    """
    from layerfix.printers import find_printers, listing, load_printer

    if ctx.invoked_subcommand:
        if process or search or as_json:
            raise click.UsageError(f"options of '{ctx.invoked_subcommand}' go after it", ctx)
        return
    found = find_printers(process, search)
    if as_json:
        click.echo(json.dumps([asdict(load_printer(p.name)) for p in found]))
    else:
        click.echo("\n".join(listing(found)) or "no such printer", err=not found)


@printers.command("show")
@cloup.argument("name")
@cloup.option("--json", "as_json", is_flag=True, help="Print the values as JSON.")
def show_printer(name: str, as_json: bool) -> None:
    """Show all that is known of a printer.

    NAME is one of those that `layerfix printers` lists, or your own .toml file.
    """
    from layerfix.printers import description, load_printer

    printer = load_printer(name)
    click.echo(json.dumps(asdict(printer)) if as_json else "\n".join(description(printer)))


@cloup.command()
@JSON
def formats(as_json: bool) -> None:
    """List the kinds of files: what is read, what is written, and which options go with it."""
    from layerfix.commands.formats import lines_of, list_formats

    found = list_formats()
    click.echo(json.dumps(found) if as_json else "\n".join(lines_of(found)))


@cloup.command()
@cloup.argument("shell", type=cloup.Choice(["bash", "zsh", "fish"]))
@cloup.pass_context
def completion(ctx: click.Context, shell: str) -> None:
    """Print the completion script of a shell.

    \b
    bash:  eval "$(layerfix completion bash)"       in ~/.bashrc
    zsh:   eval "$(layerfix completion zsh)"        in ~/.zshrc
    fish:  layerfix completion fish | source        in ~/.config/fish/config.fish
    """
    from click.shell_completion import get_completion_class

    found = get_completion_class(shell)
    if found is None:
        raise InputError(f"no completion for {shell}")
    click.echo(found(ctx.find_root().command, {}, "layerfix", "_LAYERFIX_COMPLETE").source())
