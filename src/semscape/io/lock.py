"""A lock on a folder that no crash leaves behind: the system holds it, not the file's existence."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

from semscape.errors import StorageError

LOCK_NAME = ".semscape-lock"
_POLL_S = 0.2


class FolderLock:
    """The right to write into a folder, for one process at a time; to be used as a context manager.

    The system gives the lock back when its process ends, however it ends. Between the nodes of a cluster it holds
    where the shared file system passes locks on (NFS from version 4, Lustre with `flock`, GPFS).

    Parameters
    ----------
    folder : Path
        An existing folder.
    wait_s : float
        How long to wait for another process to finish.
    name : str
        Name of the lock's file, where a folder has several.

    Raises
    ------
    StorageError
        On entering: if another process still holds the lock, or the folder cannot be written.
    """

    def __init__(self, folder: Path, wait_s: float = 0.0, name: str = LOCK_NAME) -> None:
        self._path = folder / name
        self._wait_s = wait_s
        self._descriptor = -1

    def __enter__(self) -> FolderLock:
        until = time.monotonic() + self._wait_s
        while not self._take():
            if time.monotonic() >= until:
                raise StorageError(
                    f"another process works on {self._path.parent}; wait for it to end, or give another folder"
                )
            time.sleep(_POLL_S)
        return self

    def __exit__(self, *_: object) -> None:
        # Removed while it is held: who waits for it finds out that its file is gone and takes a new one.
        self._path.unlink(missing_ok=True)
        os.close(self._descriptor)

    def _take(self) -> bool:
        try:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise StorageError(
                f"the output folder {self._path.parent} cannot be written: {error.strerror or error}"
            ) from error
        if _try_lock(descriptor) and _is_the_file(descriptor, self._path):
            self._descriptor = descriptor
            return True
        os.close(descriptor)
        return False


def is_locked(folder: Path, name: str = LOCK_NAME) -> bool:
    """Tell whether a process holds the lock on a folder at this moment; nothing is made where there is none."""
    try:
        descriptor = os.open(folder / name, os.O_RDWR)
    except OSError:
        return False
    try:
        return not _try_lock(descriptor)
    finally:
        os.close(descriptor)


def _is_the_file(descriptor: int, path: Path) -> bool:
    """Tell whether a path still leads to the open file: the one before may have removed it."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:
        return False


def _try_lock(descriptor: int) -> bool:
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
