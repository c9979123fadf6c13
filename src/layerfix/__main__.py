"""``layerfix`` on the command line: exit codes, signals, and errors as one line."""

from __future__ import annotations

import signal
import sys
from types import FrameType


class Terminated(BaseException):
    """SIGTERM, as an exception, so that unfinished outputs are cleared away like at Ctrl-C."""


def _terminate(signum: int, frame: FrameType | None) -> None:
    raise Terminated


def main() -> None:
    """Run the command line. Exit codes: 0 done, 2 an error that was explained, 130 Ctrl-C, 143 SIGTERM."""
    signal.signal(signal.SIGTERM, _terminate)
    try:
        code = _run()
    except (KeyboardInterrupt, Terminated) as stop:  # while still loading
        code = 143 if isinstance(stop, Terminated) else 130
    sys.exit(code if isinstance(code, int) else 0)


def _run() -> object:
    import click

    from layerfix.cli import layerfix
    from layerfix.errors import LayerfixError

    code: object
    try:
        code = layerfix.main(prog_name="layerfix", standalone_mode=False)
    except click.ClickException as problem:
        problem.show()
        code = 2
    except LayerfixError as problem:
        click.echo(f"layerfix: {problem}", err=True)
        code = 2
    except (KeyboardInterrupt, click.Abort):
        click.echo("layerfix: stopped; nothing was written", err=True)
        code = 130
    except BrokenPipeError:
        sys.stderr.close()  # the reader of a pipe has gone; there is nobody to tell
        code = 1
    return code


if __name__ == "__main__":
    main()
