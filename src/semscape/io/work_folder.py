"""Where a run keeps what its finished stages made, until it is complete: a killed run goes on from there.

The folder lies hidden in the run folder. Each stage's value is a file that holds the digest of everything that it
depends on, and of itself: what does not fit is made again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from semscape.errors import StorageError
from semscape.io.code_version import code_digest
from semscape.io.run_folder import WORK_NAME
from semscape.io.value_file import decode_value, encode_value
from semscape.options import Options
from semscape.types import TiltSeries

LOG_NAME = "run.log"

_log = logging.getLogger(__name__)
Value = TypeVar("Value")


class WorkFolder:
    """The stages of one run that are done; made where it does not exist.

    Parameters
    ----------
    run : Path
        The run folder, which exists and is this process's own (see `semscape.io.lock`).
    key : str
        Digest of what the stages depend on, from `run_key`.

    Raises
    ------
    StorageError
        If the folder cannot be made.
    """

    def __init__(self, run: Path, key: str) -> None:
        self.path = run / WORK_NAME
        self._key = key
        try:
            self.path.mkdir(exist_ok=True)
        except OSError as error:
            raise self._refused(error) from error

    @property
    def log_path(self) -> Path:
        """Where the run's log is written while it goes on."""
        return self.path / LOG_NAME

    def keep(self, stage: str, make: Callable[[], Value]) -> Value:
        """Return the stage's value: as it was kept, or else made now and kept.

        Raises
        ------
        StorageError
            If the value cannot be written: a disk that is full now will not hold the results either.
        """
        path = self.path / f"{stage}.value"
        if path.exists():
            try:
                key, value = decode_value(path.read_bytes())
                if key == self._key:
                    _log.info("stage %s: taken from the interrupted run", stage)
                    kept: Value = value
                    return kept
                _log.info("stage %s: inputs, options or code have changed since the interrupted run", stage)
            except (OSError, ValueError, KeyError, TypeError) as error:
                _log.warning(
                    "stage %s is computed again: what the interrupted run left is not usable: %s", stage, error
                )
        content = encode_value((self._key, make()))
        self._write(path, content)
        # Decoded in every case, so that a run that goes on sees the very values of one that was not disturbed.
        made: Value = decode_value(content)[1]
        return made

    def remove(self) -> None:
        """Remove the folder: the run is complete, or its data give no answer."""
        shutil.rmtree(self.path, ignore_errors=True)

    def _write(self, path: Path, content: bytes) -> None:
        partial = path.with_suffix(".partial")
        try:
            with partial.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> StorageError:
        return StorageError(f"the output folder {self.path.parent} cannot be written: {error.strerror or error}")


def kept_value(work: Path, stage: str) -> Any:
    """Return what a stage of an unfinished run has kept, whatever it depended on.

    Parameters
    ----------
    work : Path
        The work folder.
    stage : str

    Raises
    ------
    OSError, ValueError, KeyError, TypeError
        If the stage has not ended, or its file is no value of this semscape.
    """
    try:
        _, value = decode_value((work / f"{stage}.value").read_bytes())
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error
    return value


def run_key(series: TiltSeries, options: Options) -> str:
    """Return the digest of all that a run's results depend on: images, what is known of them, options, code."""
    views = [
        (view.name, view.digest or hashlib.sha256(view.image.tobytes()).hexdigest(), view.mask, view.metadata)
        for view in series.views
    ]
    told = encode_value([views, series.warnings, options.to_dict(), code_digest()])
    return hashlib.sha256(told).hexdigest()
