"""A whole batch: every specimen to its record, whatever becomes of the others."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Protocol

from semscape.batch.interruption import signals_held
from semscape.batch.manifest import Specimen
from semscape.batch.record import Ending, Record, write_record
from semscape.batch.specimen import SpecimenTask, run_specimen
from semscape.batch.summary import write_summary
from semscape.cluster import Counted, Executor, Outcome
from semscape.cluster.notices import listening
from semscape.errors import BadInputError, verdict_of
from semscape.flags import with_flags
from semscape.io.lock import FolderLock
from semscape.io.run_folder import make_folder
from semscape.options import Options

_log = logging.getLogger("semscape.batch")
_NUMBERS = ("pixel_size_um", "scale_bar_um", "axis_deg")
_MOST_TOLD = 10
_MOST_DIGITS = 19


class Audience(Protocol):
    """Who is shown how the batch goes on."""

    def event(self, name: str, stage: str) -> None:
        """Take note that a specimen starts ("") or begins a stage."""
        ...

    def ended(self, ending: Ending) -> None:
        """Take note that a specimen has ended."""
        ...


def run_batch(
    specimens: Sequence[Specimen],
    output: Path,
    options: Options,
    executor: Executor,
    audience: Audience,
    *,
    retry_failed: bool = False,
    verify: bool = False,
    spread: bool = False,
) -> list[Ending]:
    """Run the specimens that are not done, and write summary.csv and summary.html, also when interrupted.

    Parameters
    ----------
    specimens : sequence of Specimen
        From `find_specimens`.
    output : Path
        The batch's folder: a run folder for each specimen, `records`, and the summary.
    options : Options
        Of every specimen; what a row says comes on top.
    executor : Executor
        Where the specimens run.
    audience : Audience
        Who is shown how it goes on.
    retry_failed : bool
        Run those again that failed before with the same inputs and options.
    verify : bool
        Read all inputs and results again to find out whether a specimen is done; by default size and time decide.
    spread : bool
        One specimen after the other, each with its views and pairs spread over the executor.

    Returns
    -------
    list of Ending
        In the order of the specimens.

    Raises
    ------
    BadInputError
        If the folder cannot be written, or another process works on it.
    """
    tasks = [
        SpecimenTask(
            name=specimen.name,
            folder=str(specimen.folder.absolute()),
            output=str(output.absolute()),
            options=of_specimen,
            threads=executor.threads,
            retry_failed=retry_failed,
            verify=verify,
        )
        for specimen, of_specimen in zip(specimens, options_of_rows(specimens, options), strict=True)
    ]
    endings: dict[int, Ending] = {}
    with FolderLock(make_folder(output)):
        try:
            for outcome in _outcomes(tasks, executor, audience, spread=spread):
                ending = _ending(tasks[outcome.index], outcome)
                endings[outcome.index] = ending
                audience.ended(ending)
        finally:
            with signals_held():
                write_summary(output, [(specimen, endings.get(index)) for index, specimen in enumerate(specimens)])
    return [endings[index] for index in range(len(tasks))]


def options_of_rows(specimens: Sequence[Specimen], options: Options) -> list[Options]:
    """Return the options of each specimen: those of the batch, changed by its row.

    Raises
    ------
    BadInputError
        For rows whose values are none; the message names the lines.
    """
    found: list[Options] = []
    wrong: list[str] = []
    for specimen in specimens:
        try:
            found.append(_options_of_row(specimen.values, options))
        except BadInputError as error:
            wrong.append(f"line {specimen.line}: {error}")
    if wrong:
        more = f" (and {len(wrong) - _MOST_TOLD} more lines)" if len(wrong) > _MOST_TOLD else ""
        raise BadInputError(f"the manifest cannot be used: {'; '.join(wrong[:_MOST_TOLD])}{more}")
    return found


def _options_of_row(values: Mapping[str, str], options: Options) -> Options:
    settings = [item.strip() for item in values.get("options", "").split(";") if item.strip()]
    pixel_size_um, scale_bar_um, axis_deg = (_number(column, values.get(column)) for column in _NUMBERS)
    seed = values.get("seed")
    if seed is not None and not (seed.isascii() and seed.isdecimal() and len(seed) < _MOST_DIGITS):
        raise BadInputError(f"seed must be a whole number, got {seed!r}")
    return with_flags(
        options.with_settings(settings),
        tilts=values.get("tilts"),
        seed=None if seed is None else int(seed),
        pixel_size_um=pixel_size_um,
        scale_bar_um=scale_bar_um,
        axis_deg=axis_deg,
    )


def _number(column: str, text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        raise BadInputError(f"{column} must be a number, got {text!r}") from None


def _outcomes(
    tasks: Sequence[SpecimenTask], executor: Executor, audience: Audience, *, spread: bool
) -> Iterator[Outcome]:
    if not spread:
        yield from executor.run(run_specimen, tasks, lambda index, stage: audience.event(tasks[index].name, stage))
        return
    for index, task in enumerate(tasks):
        audience.event(task.name, "")
        spread_out = Counted(executor)
        with listening(partial(audience.event, task.name)):
            done = run_specimen(task, spread_out.map)
        yield Outcome(index, done, None, spread_out.n_bytes)


def _ending(task: SpecimenTask, outcome: Outcome) -> Ending:
    """Return how a specimen ended; a worker that died leaves it to this process to write the record."""
    if outcome.error is None:
        how, record = outcome.value
        ending = Ending(record, how == "kept", outcome.n_bytes)
    else:
        code, message = verdict_of(outcome.error)
        record = Record(task.name, "failed", "", {}, reason=message, exit_code=code)
        if not isinstance(outcome.error, BadInputError):  # a record that a newer semscape wrote is left alone
            write_record(Path(task.output), record)
        ending = Ending(record, kept=False, n_bytes=outcome.n_bytes)
    extra = {"specimen": record.name, "state": record.state, "kept": ending.kept, "seconds": round(record.seconds, 3)}
    if record.state == "failed":
        _log.info("specimen %s failed: %s", record.name, record.reason, extra=extra)
    else:
        _log.info("specimen %s is done: %s", record.name, record.report.get("verdict", ""), extra=extra)
    return ending
