"""Where a command's words go, and what becomes of an error: one message and an exit code."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from semscape.errors import BadInputError, SemscapeError

if TYPE_CHECKING:
    from rich.console import Console


def console(*, err: bool = False) -> Console:
    """Return a console on stdout, or on stderr."""
    from rich.console import Console

    stream = sys.stderr if err else sys.stdout
    # Where nobody looks at a window's width, a table takes what it needs.
    return Console(stderr=err, highlight=False, width=None if stream.isatty() else 160)


@contextmanager
def exit_codes(*, debug: bool, quiet: bool) -> Iterator[None]:
    """Turn what goes wrong into one message on stderr and an exit code; with `debug` let the traceback through."""
    logging.basicConfig(
        level=logging.DEBUG if debug else logging.ERROR if quiet else logging.WARNING, format="%(name)s: %(message)s"
    )
    for talkative in ("matplotlib", "PIL", "numba", "trimesh", "tifffile"):
        logging.getLogger(talkative).setLevel(logging.ERROR)
    try:
        yield
    except typer.Exit:
        raise
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        raise typer.Exit(130) from None
    except Exception as error:  # noqa: BLE001 (the last resort: a message and an exit code for whatever it is)
        if debug:
            import traceback

            traceback.print_exc()
        code, message = _verdict(error)
        typer.echo(f"semscape: error: {message}", err=True)
        raise typer.Exit(code) from None


def _verdict(error: Exception) -> tuple[int, str]:
    """Return the exit code and the message for an exception."""
    linear_algebra = sys.modules.get("numpy.linalg")
    is_numerical = linear_algebra is not None and isinstance(error, linear_algebra.LinAlgError)
    if isinstance(error, BadInputError):
        return 2, str(error)
    if isinstance(error, SemscapeError):
        return 3, str(error)
    if isinstance(error, ValueError) and not is_numerical:
        return 2, str(error)
    detail = " ".join(str(error).split())
    return 1, f"unexpected {type(error).__name__}{': ' if detail else ''}{detail}; run again with --debug"
