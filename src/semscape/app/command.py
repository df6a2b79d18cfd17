"""`semscape app`: serve the page on this machine, and open it."""

from __future__ import annotations

import socket
import threading
import webbrowser
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

from semscape.app.app_options import AppOptions
from semscape.app.workspace import APP_NAME, Workspace
from semscape.errors import BadInputError
from semscape.io.lock import FolderLock
from semscape.io.run_folder import make_folder

_BACKLOG = 128


def run_app(
    workspace: Path | None, port: int | None, *, open_browser: bool, say: Callable[[str], None], debug: bool = False
) -> None:
    """Serve the app until it is interrupted.

    Parameters
    ----------
    workspace : Path, optional
        Folder of the runs; `AppOptions.workspace` where left out.
    port : int, optional
        Any that is free where left out.
    open_browser : bool
        Open the page in the system's browser.
    say : callable
        Prints a line.
    debug : bool
        Log every request.

    Raises
    ------
    BadInputError
        If the extra `app` is not installed, the workspace cannot be used or is served already, or the port is taken.
    """
    try:
        import uvicorn

        from semscape.app.desk import Desk, ReconstructionJob
        from semscape.app.pages import read_bundle
        from semscape.app.routes import Parts
        from semscape.app.run_queue import RunQueue
        from semscape.app.security import Access
        from semscape.app.server import AppServer, build_app
        from semscape.app.uploads import clear_partial_files
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.startswith("semscape"):
            raise
        raise BadInputError(
            f"the app needs {error.name}, which is not installed: pip install 'semscape[app]'"
        ) from error
    read_bundle()
    options = AppOptions()
    folder = Path(options.workspace if workspace is None else workspace).expanduser()
    with FolderLock(make_folder(make_folder(folder) / APP_NAME)):
        runs = Workspace(folder)
        runs.clear_cache()
        clear_partial_files(runs)
        with closing(_listen(port or 0)) as listener:
            access = Access(listener.getsockname()[1])
            queue = RunQueue(runs, ReconstructionJob, options.runs_at_once)
            parts = Parts(runs, queue, Desk(), options, lambda: server.should_exit)
            config = uvicorn.Config(
                build_app(parts, access),
                log_level="info" if debug else "warning",
                access_log=debug,
                server_header=False,
                timeout_graceful_shutdown=1,
                ws="none",
            )
            server = AppServer(config, parts.desk)
            say(f"runs are in {runs.folder}")
            say(f"open {access.address}")
            say("leave this window open; Ctrl-C ends the app, and runs that are not ready go on at its next start")
            if open_browser:
                threading.Timer(0.5, webbrowser.open, [access.address]).start()
            with suppress(KeyboardInterrupt):  # raised again by uvicorn, after everything was brought to an end
                server.run(sockets=[listener])
            say("the app has ended")


def _listen(port: int) -> socket.socket:
    """Return a socket on this machine's own address alone."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1", port))
    except (OSError, OverflowError) as error:
        listener.close()
        raise BadInputError(f"port {port} cannot be used ({error}); leave --port out for any that is free") from error
    listener.listen(_BACKLOG)
    return listener
