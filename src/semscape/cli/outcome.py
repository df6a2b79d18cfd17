"""What every command does about what goes wrong: one message, one exit code, the log where it is wanted."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

from semscape.errors import verdict_of

if TYPE_CHECKING:
    from rich.console import Console

_INTERRUPTED, _TERMINATED = 130, 143


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
    _start_log(debug=debug, quiet=quiet, log_json=log_json)
    before = _on_termination()
    try:
        yield
    except typer.Exit:
        raise
    except KeyboardInterrupt as stop:
        typer.echo("interrupted; what is finished is kept: run the same command again to go on", err=True)
        raise typer.Exit(_TERMINATED if isinstance(stop, Terminated) else _INTERRUPTED) from None
    except Exception as error:  # noqa: BLE001 (the last resort: a message and an exit code for whatever it is)
        if debug:
            import traceback

            traceback.print_exc()
        code, message = verdict_of(error)
        typer.echo(f"semscape: error: {message}", err=True)
        raise typer.Exit(code) from None
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)


def _start_log(*, debug: bool, quiet: bool, log_json: bool) -> None:
    level = logging.DEBUG if debug else logging.INFO if log_json else logging.ERROR if quiet else logging.WARNING
    handler = logging.StreamHandler()
    handler.setLevel(level)  # its own, for the log that a run keeps lets more through than is shown
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    if log_json:
        from semscape.log_lines import JsonLines

        handler.setFormatter(JsonLines())
    logging.basicConfig(level=level, handlers=[handler], force=log_json)
    for talkative in ("matplotlib", "PIL", "numba", "trimesh", "tifffile"):
        logging.getLogger(talkative).setLevel(logging.ERROR)


def _on_termination() -> Any:
    """Make SIGTERM end the process as Ctrl-C does; return what was there before, None outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        return None

    def stop(*_: object) -> None:
        raise Terminated

    return signal.signal(signal.SIGTERM, stop)
