"""The files that a series may be read from, and whether they stay as they are."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from semscape.errors import BadInputError, StorageError

FileStates = Mapping[str, tuple[int, int]]

_READ_SUFFIXES = {".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp", ".txt", ".hdr", ".toml", ".xml"}


def file_states(folder: Path) -> FileStates:
    """Return size and time of change (ns) of every file in a folder that a series may be read from.

    Raises
    ------
    BadInputError
        If there is no such folder, or it cannot be read.
    """
    try:
        with os.scandir(folder) as entries:
            return {
                entry.name: (entry.stat().st_size, entry.stat().st_mtime_ns)
                for entry in entries
                if Path(entry.name).suffix.lower() in _READ_SUFFIXES
                and not entry.name.startswith(".")
                and entry.is_file()
            }
    except FileNotFoundError as error:
        raise BadInputError(f"{folder}: there is no such folder; give the folder that holds the images") from error
    except NotADirectoryError as error:
        raise BadInputError(f"{folder}: this is a file; give the folder that holds the images of the series") from error
    except (OSError, ValueError) as error:
        raise StorageError(f"{folder}: cannot be read ({error})") from error


def require_unchanged(folder: Path, states: FileStates) -> None:
    """Make sure that the files of a folder are those that they were.

    Raises
    ------
    StorageError
        If one has changed, vanished or appeared.
    """
    now = file_states(folder)
    changed = sorted(name for name in states.keys() | now.keys() if states.get(name) != now.get(name))
    if changed:
        how = "vanished" if changed[0] not in now else "appeared" if changed[0] not in states else "changed"
        raise StorageError(
            f"{folder / changed[0]}: {how} while the series was being reconstructed; nothing is written, for "
            "the result would not be that of the files: run again when they are complete"
        )
