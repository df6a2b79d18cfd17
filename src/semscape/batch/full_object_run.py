"""One folder of views from all around to one run folder with a watertight mesh."""

from __future__ import annotations

from pathlib import Path

from semscape.batch.folder_run import Progress
from semscape.dense.full_object import FullObject
from semscape.io.lock import FolderLock
from semscape.io.run_folder import make_folder, prepare_run_folder
from semscape.io.series import load_series
from semscape.options import Options


def reconstruct_object_folder(
    folder: Path, output: Path, options: Options, *, workers: int | None = None, progress: Progress | None = None
) -> FullObject:
    """Reconstruct a body from a folder of images, each with its stage tilt and rotation, into a run folder.

    Raises
    ------
    SemscapeError
        If an input cannot be used, if the images give no answer, or if the run folder cannot be written.
    """
    from semscape.pipeline import reconstruct_full_object
    from semscape.report.full_object import write_full_object

    series = load_series(folder, options.input)
    with FolderLock(make_folder(output)):
        prepare_run_folder(output)
        found, stages, failures = reconstruct_full_object(series, options, workers=workers, progress=progress)
        write_full_object(found, options, stages, failures, output)
    return found
