"""One folder of images to one run folder, in a way that survives whatever happens on the way."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from semscape.batch.input_files import FileStates, file_states, require_unchanged
from semscape.batch.memory_lack import Progress, lack_of_memory_told
from semscape.cluster import Mapper
from semscape.errors import SemscapeError, StorageError
from semscape.io.lock import FolderLock
from semscape.io.run_folder import make_folder, plain_json, prepare_run_folder
from semscape.io.series import load_series
from semscape.io.work_folder import LOG_NAME, WorkFolder, kept_value, run_key
from semscape.log_lines import JsonLines
from semscape.options import Options
from semscape.pipeline import reconstruct
from semscape.report.memory import PeakMemory
from semscape.report.run import write_run
from semscape.types import Result, StageReport, TiltSeries

_log = logging.getLogger("semscape.run")


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
        As in `semscape.reconstruct`; `progress` is told of "report" as well.
    on_series : callable, optional
        Called with the series once it is read.

    Raises
    ------
    SemscapeError
        If an input cannot be used, or changes meanwhile, if the images give no answer, if the run folder is in use or
        cannot be written, or if the memory does not suffice.
    """

    def logged(name: str, figures: dict[str, Any] | None) -> None:
        if figures is None:
            _log.info("stage %s begins", name, extra={"stage": name})
        else:
            _log.info("stage %s ended", name, extra={"stage": name, "figures": plain_json(figures)})
        if progress:
            progress(name, figures)

    with lack_of_memory_told(logged) as follow:
        states = file_states(folder)
        series = load_series(folder, options.input)
        if on_series:
            on_series(series)
        with FolderLock(make_folder(output)):
            prepare_run_folder(output)
            return _reconstruct_locked(folder, states, series, output, options, workers, mapper, follow)


def finished_stage(work: Path, stage: str) -> Any:
    """Return what a stage of an unfinished run has made, as `semscape.reconstruct` gives it to `keep`.

    Raises
    ------
    OSError, ValueError, KeyError, TypeError
        If the stage has not ended, or its file is no value of this semscape.
    """
    value, _seconds, _peak_mb = kept_value(work, stage)  # as `_MeasuredWork` keeps it
    return value


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
    work = _MeasuredWork(output, run_key(series, options))
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
                keep=work.keep_measured,
            )
            result = work.with_earlier_costs(result)
            for name, stage in ((stage.name, stage) for stage in result.report.stages):
                figures = {"seconds": round(stage.seconds, 4), "peak_memory_mb": round(stage.peak_memory_mb, 1)}
                _log.info("stage %s took %.2f s", name, stage.seconds, extra={"stage": name, **figures})
            follow("report", None)
            require_unchanged(folder, states)
            write_run(result, output)
            follow("report", {})
            _log.info("verdict: %s", result.report.verdict)
        except SemscapeError as error:
            if not isinstance(error.__cause__, OSError):  # a full disk is worth going on, these data are not
                work.remove()
            raise
    if work.log_path.exists():
        shutil.copyfile(work.log_path, output / LOG_NAME)
    work.remove()
    return result


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
        raise StorageError(f"the output folder {path.parent.parent} cannot be written: {error.strerror}") from error
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


class _MeasuredWork(WorkFolder):
    """A work folder that keeps beside each stage's value what making it took."""

    def __init__(self, run: Path, key: str) -> None:
        super().__init__(run, key)
        self._earlier: dict[str, tuple[float, float]] = {}

    def keep_measured(self, stage: str, make: Callable[[], Any]) -> Any:
        """Return the stage's value, made now or taken from the attempt before."""
        made_now = False

        def measured() -> tuple[Any, float, float]:
            nonlocal made_now
            made_now = True
            memory, start = PeakMemory(), time.perf_counter()
            value = make()
            return value, time.perf_counter() - start, memory.peak_mb()

        value, seconds, peak_mb = self.keep(stage, measured)
        if not made_now:
            self._earlier[stage] = seconds, peak_mb
        return value

    def with_earlier_costs(self, result: Result) -> Result:
        """Return the result with a report that tells of taken stages what they took when they were made."""
        stages = tuple(self._with_earlier_cost(stage) for stage in result.report.stages)
        known = [peak for peak in (stage.peak_memory_mb for stage in stages) if np.isfinite(peak)]
        peak_mb = max(known, default=result.report.peak_memory_mb)
        return replace(result, report=replace(result.report, stages=stages, peak_memory_mb=peak_mb))

    def _with_earlier_cost(self, stage: StageReport) -> StageReport:
        if stage.name not in self._earlier:
            return stage
        seconds, peak_mb = self._earlier[stage.name]
        return replace(stage, seconds=seconds, peak_memory_mb=peak_mb, earlier=True)
