"""One folder of images to one run folder, in a way that survives whatever happens on the way."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from semscape.cluster import Mapper
from semscape.errors import BadInputError, SemscapeError
from semscape.io.lock import FolderLock
from semscape.io.run_folder import make_folder, prepare_run_folder
from semscape.io.series import load_series
from semscape.io.work_folder import LOG_NAME, WorkFolder, run_key
from semscape.log_lines import JsonLines
from semscape.options import Options
from semscape.types import Result, TiltSeries

Progress = Callable[[str, dict[str, Any] | None], None]
FileStates = Mapping[str, tuple[int, int]]

_READ_SUFFIXES = {".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp", ".txt", ".hdr", ".toml", ".xml"}
_log = logging.getLogger("semscape.run")


class OutOfMemoryError(SemscapeError):
    """A stage asked for more memory than there is; the message names it and what to reduce."""


_REDUCE = {
    "load": "fewer or smaller images",
    "detect": "--set features.max_keypoints=10000, or smaller images",
    "match": "--set features.max_keypoints=10000",
    "calibrate": "--set features.max_keypoints=10000",
    "surface": "--set dense.tile_px=512, or smaller images",
    "mesh": "--set dense.mesh_max_vertices=100000",
    "report": "--set dense.mesh_max_vertices=100000",
}


def reconstruct_folder(
    folder: Path,
    output: Path,
    options: Options,
    *,
    workers: int | None = None,
    mapper: Mapper | None = None,
    progress: Progress | None = None,
    on_series: Callable[[TiltSeries], None] | None = None,
) -> Result:
    """Reconstruct a folder of images into a run folder.

    The run folder is locked meanwhile. What the stages make is kept in it until the run is complete; a run that was
    interrupted goes on behind its last finished stage, to the same bytes.

    Parameters
    ----------
    folder, output : Path
        Folder of the images, and the run folder to write.
    options : Options
        Of every stage.
    workers, mapper, progress
        As in `semscape.reconstruct`; `progress` is told of "load" and "report" as well.
    on_series : callable, optional
        Called with the series once it is read.

    Raises
    ------
    SemscapeError
        If an input cannot be used, or changes meanwhile, if the images give no answer, if the run folder is in use or
        cannot be written, or if the memory does not suffice.
    """
    stage = "load"

    def follow(name: str, figures: dict[str, Any] | None) -> None:
        nonlocal stage
        if figures is None:
            stage = name
            _log.info("stage %s begins", name, extra={"stage": name})
        else:
            _log.info("stage %s ended", name, extra={"stage": name, "figures": figures})
        if progress:
            progress(name, figures)

    try:
        states = file_states(folder)
        series = load_series(folder, options.input)
        if on_series:
            on_series(series)
        with FolderLock(make_folder(output)):
            prepare_run_folder(output)
            return _reconstruct_locked(folder, states, series, output, options, workers, mapper, follow)
    except Exception as error:
        if not _is_out_of_memory(error):
            raise
        less = _REDUCE.get(stage, "smaller images")
        raise OutOfMemoryError(
            f"out of memory in stage {stage}; fewer --workers, more --memory-mb, or {less}"
        ) from error


def _reconstruct_locked(
    folder: Path,
    states: FileStates,
    series: TiltSeries,
    output: Path,
    options: Options,
    workers: int | None,
    mapper: Mapper | None,
    follow: Progress,
) -> Result:
    from semscape.pipeline import reconstruct
    from semscape.report.run import write_run

    work = WorkFolder(output, run_key(series, options))
    with _log_file(work.log_path):
        try:
            for warning in series.warnings:
                _log.warning("%s", warning)
            result = reconstruct(
                series,
                options,
                rng=options.run.seed,
                workers=workers,
                mapper=mapper,
                progress=follow,
                keep=work.keep,
            )
            for name, stage in ((stage.name, stage) for stage in result.report.stages):
                figures = {"seconds": round(stage.seconds, 4), "peak_memory_mb": round(stage.peak_memory_mb, 1)}
                _log.info("stage %s took %.2f s", name, stage.seconds, extra={"stage": name, **figures})
            follow("report", None)
            _require_unchanged(folder, states)
            write_run(result, output)
            follow("report", {})
            _log.info("verdict: %s", result.report.verdict)
        except SemscapeError as error:
            if not isinstance(error.__cause__, OSError):  # a full disk is worth another try, these data are not
                work.remove()
            raise
    if work.log_path.exists():
        shutil.copyfile(work.log_path, output / LOG_NAME)
    work.remove()
    return result


def file_states(folder: Path) -> FileStates:
    """Return size and time of change (ns) of every file in a folder that a series may be read from.

    Raises
    ------
    BadInputError
        If the folder cannot be read.
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
        raise BadInputError(f"{folder}: cannot be read ({error})") from error


def _require_unchanged(folder: Path, states: FileStates) -> None:
    now = file_states(folder)
    changed = sorted(name for name in states.keys() | now.keys() if states.get(name) != now.get(name))
    if changed:
        how = "vanished" if changed[0] not in now else "appeared" if changed[0] not in states else "changed"
        raise BadInputError(
            f"{folder / changed[0]}: {how} while the series was being reconstructed; nothing is written, for "
            "the result would not be that of the files: run again when they are complete"
        )


class _LogFile(logging.FileHandler):
    def handleError(self, record: logging.LogRecord) -> None:
        """Stay silent: a disk that is full is told by what the results cannot be written to."""


@contextmanager
def _log_file(path: Path) -> Iterator[None]:
    """Write what semscape logs to a file, line by line, so that it tells of a crash too."""
    logger = logging.getLogger("semscape")
    try:
        handler = _LogFile(path, encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"the output folder {path.parent.parent} cannot be written: {error.strerror}") from error
    handler.setFormatter(JsonLines())
    handler.setLevel(logging.INFO)
    before = logger.level
    logger.setLevel(min(before or logging.WARNING, logging.INFO))
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        handler.close()


def _is_out_of_memory(error: BaseException) -> bool:
    # OpenCV has an error class of its own, named "error".
    return isinstance(error, MemoryError) or (type(error).__name__ == "error" and "nsufficient memory" in str(error))
