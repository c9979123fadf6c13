"""``layerfix`` on the command line: exit codes, signals, and errors as one line."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType
from typing import TextIO

from layerfix.console import one_line, speak_plainly

AGAIN_S = 0.05  # after which a signal that was lost is sent once more: the callback is left by then
# Signals that came. Some libraries swallow whatever their imports raise, so the commands look here too.
_stopped: list[int] = []
_lost: list[int] = []  # those of them whose exception went nowhere


class Terminated(BaseException):
    """SIGTERM or SIGHUP, as an exception, so that unfinished outputs are cleared away like at Ctrl-C."""


def _stop(signum: int, frame: FrameType | None) -> None:
    _stopped.append(signum)
    if len(_stopped) == 1 or _lost:  # a second Ctrl-C must not interrupt the clearing away
        _lost.clear()
        raise KeyboardInterrupt if signum == signal.SIGINT else Terminated


def _ignored(what: sys.UnraisableHookArgs) -> None:
    """Python's hook for exceptions that cannot be raised where they are: a signal that came in a callback of the
    compiler would be lost there, so it is sent once more."""
    if _stopped and isinstance(what.exc_value, (KeyboardInterrupt, Terminated)):
        _lost.append(_stopped[0])
        again = threading.Timer(AGAIN_S, _send, (_stopped[0],))
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(what)


def _send(signum: int) -> None:
    """A signal to the main thread, which may be waiting for something."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signum)
    else:
        signal.raise_signal(signum)


def main() -> None:
    """Run the command line. Exit codes: 0 done, 2 an explained error, 129 SIGHUP, 130 Ctrl-C, 143 SIGTERM."""
    speak_plainly()
    for signum in _signals():
        signal.signal(signum, _stop)
    sys.unraisablehook = _ignored
    say_warnings()
    try:
        code = _run()
    except BaseException:
        if not _stopped:
            raise
        code = 0
    if _stopped:
        if _stopped[0] == signal.SIGINT:
            sys.stderr.write("layerfix: stopped\n")
        code = 128 + _stopped[0]
    sys.exit(code)


def _signals() -> list[signal.Signals]:
    """Those that end the program: Ctrl-C, `kill`, and a terminal that is closed, unless `nohup` says to go on."""
    found = [signal.SIGINT, signal.SIGTERM]
    hangup: signal.Signals | None = getattr(signal, "SIGHUP", None)  # Windows has none
    if hangup is not None and signal.getsignal(hangup) != signal.SIG_IGN:
        found.append(hangup)
    return found


def say_warnings() -> None:
    """From here on, what layerfix warns of is one line, as its errors are; other warnings look as they did."""
    import warnings

    before = warnings.showwarning

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if category.__module__.partition(".")[0] == "layerfix":
            sys.stderr.write(f"layerfix: {one_line(str(message))}\n")
        else:
            before(message, category, filename, lineno, file, line)

    warnings.showwarning = show


def _run() -> int:
    import click

    from layerfix.cli import layerfix
    from layerfix.errors import LayerfixError

    try:
        code = layerfix.main(prog_name="layerfix", standalone_mode=False, obj=_stopped)
        return code if isinstance(code, int) else 0  # `check` ends with 1 where something would be lost
    except click.Abort:
        return 130
    except click.ClickException as problem:
        problem.show()
    except LayerfixError as problem:
        click.echo(f"layerfix: {one_line(problem)}", err=True)
    except MemoryError:
        click.echo("layerfix: this machine has too little memory for that; nothing was left behind", err=True)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of a pipe has gone; there is nobody to tell
        return 1
    except OSError as problem:  # the library's own are LayerfixErrors; what is left is the terminal, or where it goes
        sys.stderr.write(f"layerfix: the output could not be printed: {(problem.strerror or str(problem)).lower()}\n")
        sys.stdout = None  # or Python would try again at the end
    return 2


if __name__ == "__main__":
    main()
