"""One specimen of a batch, from looking up whether it is done to its record: what a worker is asked for."""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from semscape.batch.folder_run import reconstruct_folder
from semscape.batch.input_files import file_states
from semscape.batch.record import (
    RECORDS_NAME,
    Record,
    input_digests,
    product_digests,
    products_are_whole,
    read_record,
    write_record,
)
from semscape.cluster import Mapper, tell
from semscape.errors import BadInputError, PassingError, verdict_of
from semscape.io.code_version import code_digest
from semscape.io.lock import FolderLock
from semscape.io.run_folder import make_folder
from semscape.options import Options
from semscape.report.thumbnail import thumbnail_png
from semscape.types import Result

THUMBNAIL_PX = 160
_LOCK_WAIT_S = 3600.0
How = Literal["ran", "kept"]


@dataclass(frozen=True)
class SpecimenTask:
    """What a worker must know: where the images lie, where results go, and with which options."""

    name: str
    folder: str
    output: str
    options: Options
    threads: int
    retry_failed: bool = False
    verify: bool = False


def run_specimen(task: SpecimenTask, mapper: Mapper | None = None) -> tuple[How, Record]:
    """Run one specimen, or find that it is done; data that fail end in a record of the failure.

    Only what is small comes back; images are read here, results are written here.
    """
    output, folder = Path(task.output), Path(task.folder)
    # Held by a worker that was given up as lost but is not, or by the Dask worker that has the task as well.
    with FolderLock(make_folder(output / RECORDS_NAME), _LOCK_WAIT_S, f".{task.name}.lock"):
        before = read_record(output, task.name)
        start = time.perf_counter()
        inputs: dict[str, tuple[int, int, str]] = {}
        key = ""
        tell("load")
        try:
            known = before.inputs if before and not task.verify else {}
            inputs = input_digests(folder, file_states(folder), known)
            key = _key(inputs, task.options)
            if before and before.key == key and _may_be_kept(task, before):
                return "kept", before
            result = reconstruct_folder(
                folder,
                output / task.name,
                task.options,
                workers=task.threads,
                mapper=mapper,
                progress=lambda stage, figures: tell(stage) if figures is None else None,
            )
        except Exception as error:  # noqa: BLE001 (one specimen's failure, whatever it is, must not stop the others)
            record = _failure(task, key, inputs, error, time.perf_counter() - start)
            write_record(output, record)
            return "ran", record
        seconds = time.perf_counter() - start
        record = _success(task, key, inputs, output / task.name, result, seconds)
        write_record(output, record, thumbnail_png(result.height_map, THUMBNAIL_PX))
        return "ran", record


def _key(inputs: dict[str, tuple[int, int, str]], options: Options) -> str:
    told = [sorted((name, digest) for name, (_, _, digest) in inputs.items()), options.to_dict(), code_digest()]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def _may_be_kept(task: SpecimenTask, before: Record) -> bool:
    if before.state == "failed":
        return not task.retry_failed
    return products_are_whole(Path(task.output) / task.name, before, read=task.verify)


def _success(
    task: SpecimenTask,
    key: str,
    inputs: dict[str, tuple[int, int, str]],
    run: Path,
    result: Result,
    seconds: float,
) -> Record:
    report = result.report
    seconds += sum(stage.seconds for stage in report.stages if stage.earlier)
    figures: dict[str, Any] = {
        "verdict": report.verdict,
        "length_unit": result.reconstruction.length_unit,
        "tilt_source": result.reconstruction.tilt_source,
        "metrics": dict(report.metrics),
        "warnings": list(report.warnings),
        "pair_failures": list(report.failures),
        "stages": {stage.name: stage.seconds for stage in report.stages},
    }
    return Record(
        name=task.name,
        state="done",
        key=key,
        inputs=inputs,
        products=product_digests(run),
        seconds=seconds,
        peak_memory_mb=report.peak_memory_mb,
        report=figures,
    )


def _failure(
    task: SpecimenTask, key: str, inputs: dict[str, tuple[int, int, str]], error: Exception, seconds: float
) -> Record:
    code, message = verdict_of(error)
    # What the next try may well survive is not remembered as an answer about the data: no key fits "".
    passing = isinstance(error, PassingError | OSError | MemoryError) or _have_changed(Path(task.folder), inputs)
    return Record(task.name, "failed", "" if passing else key, inputs, reason=message, exit_code=code, seconds=seconds)


def _have_changed(folder: Path, inputs: dict[str, tuple[int, int, str]]) -> bool:
    """Tell whether files came, went or changed since their digests were taken: a copy that still goes on."""
    try:
        return file_states(folder) != {name: state[:2] for name, state in inputs.items()}
    except BadInputError:
        return True
