"""One folder of views from all around to one run folder with a watertight mesh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from semscape.batch.input_files import file_states, require_unchanged
from semscape.batch.memory_lack import Progress, lack_of_memory_told
from semscape.dense.full_object import FullObject
from semscape.io.lock import FolderLock
from semscape.io.run_folder import make_folder, prepare_run_folder
from semscape.io.series import load_series
from semscape.io.work_folder import WorkFolder
from semscape.options import Options
from semscape.pipeline import reconstruct_full_object
from semscape.report.full_object import write_full_object
from semscape.types import TiltSeries


def reconstruct_object_folder(
    folder: Path,
    output: Path,
    options: Options,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    on_series: Callable[[TiltSeries], None] | None = None,
) -> FullObject:
    """Reconstruct a body from a folder of images, each with its stage tilt and rotation, into a run folder.

    The parameters are those of `reconstruct_folder`.

    Raises
    ------
    SemscapeError
        If an input cannot be used, or changes meanwhile, if the images give no answer, if the run folder is in use or
        cannot be written, or if the memory does not suffice.
    """
    with lack_of_memory_told(progress) as follow:
        states = file_states(folder)
        series = load_series(folder, options.input)
        if on_series:
            on_series(series)
        with FolderLock(make_folder(output)):
            prepare_run_folder(output)
            work = WorkFolder(output, "")  # which says, should this be killed, that the folder is a run's
            found, stages, failures = reconstruct_full_object(series, options, workers=workers, progress=follow)
            follow("report", None)
            require_unchanged(folder, states)
            write_full_object(found, options, stages, failures, output)
            work.remove()
            follow("report", {})
    return found
