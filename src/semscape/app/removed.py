"""What was removed in the app is put aside and can be brought back: only a person deletes for good.

WORKSPACE/removed/pollen-20260131-142501-000123/run       its run folder
WORKSPACE/removed/pollen-20260131-142501-000123/images    its images
WORKSPACE/removed/pollen-20260131-142502-000456/files     an image that was taken out of it
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from semscape.app.run_state import STATE_NAME, read_state
from semscape.app.workspace import IMAGES_NAME, REMOVED_NAME, BusyRunError, Run, UnknownRunError, Workspace
from semscape.errors import BadInputError
from semscape.io.lock import LOCK_NAME, is_locked
from semscape.io.run_folder import make_folder

_RUN_NAME, _FILES_NAME = "run", "files"
_STAMPED = re.compile(r"(.+)-(\d{8}-\d{6})-\d{6}")


@dataclass(frozen=True)
class RemovedRun:
    """A run that was put aside: its folder in `removed`, its name and title, and when that was."""

    folder: Path
    name: str
    title: str
    removed_s: float


def remove_run(workspace: Workspace, run: Run) -> RemovedRun:
    """Put a run and its images aside.

    Raises
    ------
    BusyRunError
        If it waits or is being made.
    """
    run.require_idle()
    if (run.folder / LOCK_NAME).is_file() and is_locked(run.folder):
        raise BusyRunError("another program is making this run; wait for its end")
    target = _new_folder(workspace, run.name)
    try:
        for source, name in ((run.images, IMAGES_NAME), (run.folder, _RUN_NAME)):
            if source is not None and source.is_dir():
                source.rename(target / name)
    except OSError as error:
        raise BadInputError(f"{run.name} cannot be removed: {error.strerror or error}") from error
    found = _removed_run(target)
    if found is None:
        raise UnknownRunError("there was nothing of this run left to remove")
    return found


def put_aside(workspace: Workspace, run: Run, files: Iterable[Path]) -> None:
    """Put files of a run aside."""
    target = make_folder(_new_folder(workspace, run.name) / _FILES_NAME)
    for path in files:
        path.rename(target / path.name)


def removed_runs(workspace: Workspace) -> list[RemovedRun]:
    """Return the runs that were put aside, the last one first."""
    folder = workspace.folder / REMOVED_NAME
    if not _is_plain_folder(folder):
        return []
    found = [_removed_run(path) for path in folder.iterdir() if _is_plain_folder(path)]
    return sorted((run for run in found if run is not None), key=lambda run: run.folder.name[-22:], reverse=True)


def restore_run(workspace: Workspace, key: str) -> Run:
    """Bring a run back, under another name where its own has been taken since.

    Parameters
    ----------
    workspace : Workspace
    key : str
        Name of its folder in `removed`.

    Raises
    ------
    UnknownRunError
        If there is none.
    """
    found = next((run for run in removed_runs(workspace) if run.folder.name == key), None)
    if found is None:
        raise UnknownRunError("this run is not among the removed ones; it may have been restored in another tab")
    name = workspace.free_name(found.name)
    try:
        targets = {IMAGES_NAME: workspace.folder / IMAGES_NAME / name, _RUN_NAME: workspace.folder / name}
        for source, target in targets.items():
            if _is_plain_folder(found.folder / source):
                (found.folder / source).rename(target)
        if not any(found.folder.iterdir()):
            found.folder.rmdir()
    except OSError as error:
        raise BadInputError(f"{found.name} cannot be restored: {error.strerror or error}") from error
    return workspace.run(name)


def _new_folder(workspace: Workspace, name: str) -> Path:
    now_ns = time.time_ns()
    stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(now_ns // 1_000_000_000))
    return make_folder(workspace.folder / REMOVED_NAME / f"{name}-{stamp}-{now_ns // 1000 % 1_000_000:06d}")


def _removed_run(folder: Path) -> RemovedRun | None:
    """Return what a folder in `removed` holds; None where that is no run."""
    stamped = _STAMPED.fullmatch(folder.name)
    parts = [folder / name for name in (IMAGES_NAME, _RUN_NAME)]
    if stamped is None or not any(_is_plain_folder(part) for part in parts):
        return None
    try:
        is_known = _is_plain_folder(parts[0]) and (parts[0] / STATE_NAME).is_file()
        title = read_state(parts[0]).title if is_known else ""
        removed_s = time.mktime(time.strptime(stamped[2], "%Y%m%d-%H%M%S"))
    except (BadInputError, ValueError, OverflowError):
        return None
    return RemovedRun(folder, stamped[1], title or stamped[1], removed_s)


def _is_plain_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()
