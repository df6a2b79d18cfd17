"""The table of what was understood of a run's images, with what a person told of them, cell by cell."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pydantic import BaseModel, Field

from semscape.app.desk import Desk
from semscape.app.plain_words import plain_words
from semscape.app.run_queue import RunQueue
from semscape.app.told import Cell, Change, History, check_cell, read_told, write_told
from semscape.app.workspace import Run, UnknownRunError, Workspace
from semscape.batch.input_files import file_states
from semscape.errors import BadInputError, SemscapeError


class Row(BaseModel):
    """An image: its stored name, what it was called, what was understood, and what was told."""

    image: str
    original: str
    understood: dict[str, Any] = Field(description="Keys of `semscape inspect --json`")
    told: dict[str, Any] = Field(description="Cells that were filled by hand or by series.toml")


class SeriesTable(BaseModel):
    """All images of a run."""

    rows: list[Row]
    told: dict[str, Any] = Field(description="Cells of the whole series")
    warnings: list[str]
    problem: str = Field(description="Why the images cannot be used as they are, and what to do; empty if they can")
    width: int
    height: int
    length_unit: str
    can_undo: bool
    can_redo: bool


class Understanding:
    """What was understood of folders of images, kept as long as their files stay the same."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._known: dict[str, tuple[str, dict[str, Any]]] = {}

    def table(self, run: Run) -> SeriesTable:
        """Return the table of a run; reads its images where they have changed.

        Raises
        ------
        UnknownRunError
            If the run's images are not in the workspace.
        """
        images = run.require_images()
        names = run.image_names()
        key = hashlib.sha256(repr(sorted(file_states(images).items())).encode()).hexdigest()
        problem, described = "", {}
        held = self._known.get(run.name)
        if held is not None and held[0] == key:
            described = held[1]
        elif len(names) >= 2:
            try:
                described = self._desk.do("describe_images", images)
            except SemscapeError as error:
                described = {"problem": plain_words(str(error), run)}
            self._known[run.name] = key, described
        if len(names) < 2:
            problem = "Add at least two images of the specimen, taken at different tilts." if names else ""
        problem = described.get("problem", problem)
        try:
            told = read_told(images)
        except BadInputError as error:
            return self._rows(run, names, {}, {}, str(error), described)
        return self._rows(run, names, told.series, told.images, problem, described)

    def _rows(
        self,
        run: Run,
        names: list[str],
        of_series: Mapping[str, Any],
        of_images: Mapping[str, Mapping[str, Any]],
        problem: str,
        described: Mapping[str, Any],
    ) -> SeriesTable:
        understood = {view["name"]: view for view in described.get("views", [])}
        originals = run.originals()
        rows = [
            Row(
                image=name,
                original=originals.get(name, name),
                understood=understood.get(name, {}),
                told=dict(of_images.get(name, {})),
            )
            for name in names
        ]
        return SeriesTable(
            rows=rows,
            told=dict(of_series),
            warnings=[plain_words(text, run) for text in described.get("warnings", [])],
            problem=problem,
            width=described.get("width", 0),
            height=described.get("height", 0),
            length_unit=described.get("length_unit", "um"),
            can_undo=bool(run.state.history.done),
            can_redo=bool(run.state.history.undone),
        )


def edit_cell(workspace: Workspace, queue: RunQueue, name: str, image: str, key: str, value: Cell) -> Run:
    """Fill or empty a cell, and remember what it held.

    Raises
    ------
    BadInputError
        For a value that the cell cannot hold.
    UnknownRunError
        If there is no such image.
    """
    check_cell(image, key, value)
    with queue.lock:
        run = _editable(workspace, name)
        if image and image not in run.image_names():
            raise UnknownRunError("there is no such image in this run")
        before = read_told(run.require_images()).cell(image, key)
        if before == value:
            return run
        kept = before if isinstance(before, bool | int | float) else None
        change = Change(image, key, kept, value)
        return _apply(workspace, run, change, run.state.history.with_change(change), value)


def undo(workspace: Workspace, queue: RunQueue, name: str) -> Run:
    """Take the last edit back; `BadInputError` where there is none."""
    with queue.lock:
        run = _editable(workspace, name)
        change, history = run.state.history.undo()
        return _apply(workspace, run, change, history, change.before)


def redo(workspace: Workspace, queue: RunQueue, name: str) -> Run:
    """Make the edit that was undone last once more; `BadInputError` where there is none."""
    with queue.lock:
        run = _editable(workspace, name)
        change, history = run.state.history.redo()
        return _apply(workspace, run, change, history, change.after)


def _editable(workspace: Workspace, name: str) -> Run:
    run = workspace.run(name)
    run.require_idle()
    run.require_images()
    return run


def _apply(workspace: Workspace, run: Run, change: Change, history: History, value: Cell) -> Run:
    images = run.require_images()
    write_told(images, read_told(images).with_cell(change.image, change.key, value))
    return workspace.put_state(run, replace(run.state, history=history, edited=True, message=""))
