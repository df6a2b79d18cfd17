"""What every command does about what goes wrong: one message, one exit code, the log where it is wanted."""

from __future__ import annotations

import logging
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

from semscape.errors import verdict_of

if TYPE_CHECKING:
    from rich.console import Console

_INTERRUPTED, _TERMINATED = 130, 143
_log = logging.getLogger("semscape")


def console(*, err: bool = False) -> Console:
    """Return a console on stdout, or on stderr."""
    from rich.console import Console

    stream = sys.stderr if err else sys.stdout
    # Where nobody looks at a window's width, a table takes what it needs.
    return Console(stderr=err, highlight=False, width=None if stream.isatty() else 160)


class Terminated(KeyboardInterrupt):
    """The system asks the process to end (SIGTERM): it ends as with Ctrl-C."""


@contextmanager
def exit_codes(*, debug: bool, quiet: bool, log_json: bool = False) -> Iterator[None]:
    """Turn what goes wrong into one message on stderr and an exit code; with `debug` let the traceback through."""
    start_log(debug=debug, quiet=quiet, log_json=log_json)
    before = _on_first_signal()
    try:
        yield
    except typer.Exit:
        raise
    except KeyboardInterrupt as stop:
        code = _TERMINATED if isinstance(stop, Terminated) else _INTERRUPTED
        told = "interrupted; what is finished is kept: run the same command again to go on"
        if log_json:
            log_error(told, code)
        else:
            typer.echo(told, err=True)
        raise typer.Exit(code) from None
    except Exception as error:  # noqa: BLE001 (the last resort: a message and an exit code for whatever it is)
        code, message = verdict_of(error)
        if log_json:
            log_error(message, code, error if debug else None)
        else:
            if debug:
                traceback.print_exc()
            typer.echo(f"semscape: error: {message}", err=True)
        raise typer.Exit(code) from None
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is not signal.SIG_IGN:  # else one has come, and this process is about to end
                signal.signal(number, handler)


def log_error(message: str, code: int, error: Exception | None = None) -> None:
    """Log what ends the command, with its exit code and perhaps a traceback: the last line of JSON."""
    _log.error("%s", message, exc_info=error, extra={"exit_code": code})


def start_log(*, debug: bool, quiet: bool, log_json: bool) -> None:
    """Send the log to stderr: what goes wrong, with `debug` or `log_json` more; `log_json` makes every line JSON."""
    level = logging.DEBUG if debug else logging.INFO if log_json else logging.ERROR if quiet else logging.WARNING
    handler = logging.StreamHandler()
    handler.setLevel(level)  # its own, for the log that a run keeps lets more through than is shown
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    if log_json:
        from semscape.log_lines import JsonLines

        handler.setFormatter(JsonLines())
    elif not debug:
        handler.addFilter(lambda record: record.name != "semscape.run")  # the command's own lines tell the same
    logging.basicConfig(level=level, handlers=[handler], force=log_json)
    logging.captureWarnings(log_json)
    for talkative in ("matplotlib", "PIL", "numba", "trimesh", "tifffile"):
        logging.getLogger(talkative).setLevel(logging.ERROR)


def _on_first_signal() -> dict[signal.Signals, Any]:
    """Make SIGTERM end the process as Ctrl-C does, and let a second signal not disturb how it ends.

    Returns
    -------
    dict
        What was there before; empty outside the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    held = {number: handler for number, handler in before.items() if handler not in (None, signal.SIG_IGN)}

    def stop(number: int, _: object) -> None:
        for each in held:
            signal.signal(each, signal.SIG_IGN)
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    for number in held:
        signal.signal(number, stop)
    return held
