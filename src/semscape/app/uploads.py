"""Files from the browser onto the disk, as they come, within limits."""

from __future__ import annotations

import os
import tempfile
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from anyio import to_thread

from semscape.app.app_options import AppOptions
from semscape.app.names import displayed_name, stored_name
from semscape.app.removed import put_aside
from semscape.app.run_queue import RunQueue
from semscape.app.told import History, for_stored_names, parse_told, read_told, write_told
from semscape.app.workspace import Run, UnknownRunError, Workspace
from semscape.errors import BadInputError
from semscape.io.series_toml import SIDECAR_NAME

_PARTIAL_PREFIX = ".semscape-upload-"
_MOST_TOML_BYTES = 1_000_000


class TooLargeError(BadInputError):
    """More was sent than the app takes."""


async def take_file(
    workspace: Workspace,
    queue: RunQueue,
    name: str,
    original: str,
    told_bytes: int,
    chunks: AsyncIterator[bytes],
    limits: AppOptions,
) -> Run:
    """Store one file of a run's images; a `series.toml` becomes what is told of them.

    Parameters
    ----------
    workspace, queue
        Where the run is.
    name : str
        Of the run.
    original : str
        The file's name as the browser gives it.
    told_bytes : int
        Its size as the browser tells it; 0 if unknown.
    chunks : async iterator of bytes
        The file.
    limits : AppOptions

    Raises
    ------
    TooLargeError
        For a file or a run beyond the limits.
    BadInputError
        For a file of another kind, or a disk that is full.
    """
    run = workspace.run(name)
    images = run.require_images()
    run.require_idle()
    is_toml = displayed_name(original).lower() == SIDECAR_NAME
    if not is_toml:
        stored_name(original, run.originals())  # refused before it is sent, where it is of no use
    held = _held_bytes(images)
    most = _MOST_TOML_BYTES if is_toml else min(limits.max_file_mb * 1_000_000, limits.max_run_mb * 1_000_000 - held)
    if not is_toml:
        _require_room(run, original, limits)
    if told_bytes > most:
        raise _too_large(original, limits)
    partial = await to_thread.run_sync(_make_partial, images)
    try:
        size = 0
        with partial.open("wb") as file:
            async for chunk in chunks:
                size += len(chunk)
                if size > most:
                    raise _too_large(original, limits)
                await to_thread.run_sync(file.write, chunk)
            await to_thread.run_sync(_flush, file.fileno())
        if size == 0:
            raise BadInputError(f"{displayed_name(original)} is empty; copy it again from the microscope")
        if told_bytes and size != told_bytes:
            raise BadInputError(f"{displayed_name(original)} came incomplete; send it again")
        return await to_thread.run_sync(_put_in_place, workspace, queue, name, original, partial, limits)
    except OSError as error:
        reason = error.strerror or error
        raise BadInputError(f"{displayed_name(original)} cannot be stored: {reason}; make room on the disk") from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def remove_file(workspace: Workspace, queue: RunQueue, name: str, stored: str) -> Run:
    """Put an image of a run aside, with the text beside it.

    Raises
    ------
    UnknownRunError
        If there is no such image.
    """
    with queue.lock:
        run = workspace.run(name)
        run.require_idle()
        images = run.require_images()
        names = run.image_names()
        if stored not in names:
            raise UnknownRunError("there is no such image in this run")
        stem = Path(stored).stem
        shared = any(Path(other).stem == stem for other in names if other != stored)
        beside = [kept for kept in run.originals() if kept != stored and Path(kept).stem == stem and not shared]
        put_aside(workspace, run, [images / kept for kept in (stored, *beside)])
        write_told(images, read_told(images).without_image(stored))
        originals = {kept: told for kept, told in run.state.originals.items() if (images / kept).exists()}
        return workspace.put_state(run, replace(run.state, originals=originals, history=History(), edited=True))


def _put_in_place(
    workspace: Workspace, queue: RunQueue, name: str, original: str, partial: Path, limits: AppOptions
) -> Run:
    with queue.lock:
        run = workspace.run(name)  # another tab may have begun to reconstruct it meanwhile
        run.require_idle()
        images = run.require_images()
        state = replace(run.state, edited=True, message="")
        if displayed_name(original).lower() == SIDECAR_NAME:
            try:
                told = parse_told(partial.read_bytes())
            except ValueError as error:
                raise BadInputError(f"{SIDECAR_NAME}: cannot be read as TOML ({error})") from error
            originals = run.originals()
            write_told(images, for_stored_names(told, {stored: originals[stored] for stored in run.image_names()}))
            return workspace.put_state(run, replace(state, history=History()))
        _require_room(run, original, limits)
        stored = stored_name(original, run.originals())
        partial.replace(images / stored)
        return workspace.put_state(run, replace(state, originals={**state.originals, stored: displayed_name(original)}))


def _require_room(run: Run, original: str, limits: AppOptions) -> None:
    held = run.originals()
    if len(held) >= limits.max_files and stored_name(original, held) not in held:
        raise TooLargeError(f"a run takes at most {limits.max_files} files; make several runs of them")


def _held_bytes(images: Path) -> int:
    with os.scandir(images) as entries:
        return sum(entry.stat(follow_symlinks=False).st_size for entry in entries)


def _make_partial(images: Path) -> Path:
    descriptor, path = tempfile.mkstemp(prefix=_PARTIAL_PREFIX, dir=images)
    os.close(descriptor)
    return Path(path)


def clear_partial_files(workspace: Workspace) -> None:
    """Remove what uploads that were cut off have left."""
    for run in workspace.runs():
        for path in run.images.glob(f"{_PARTIAL_PREFIX}*") if run.images else ():
            path.unlink(missing_ok=True)


def _flush(descriptor: int) -> None:
    os.fsync(descriptor)


def _too_large(original: str, limits: AppOptions) -> TooLargeError:
    return TooLargeError(
        f"{displayed_name(original)} is too large: the app takes {limits.max_file_mb:,} MB a file and "
        f"{limits.max_run_mb:,} MB a run; use semscape reconstruct for larger ones"
    )
