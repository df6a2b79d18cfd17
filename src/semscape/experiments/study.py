"""The values of an experiment: what was asked for, and the tables and figures that came out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Setting:
    """What an experiment is run with.

    Parameters
    ----------
    seed : int
        Every random choice derives from it.
    data : Path or None
        Folder with the measured sets (`tilt_series`, `meshes`, ...); an experiment says in a note what it left out
        where they are absent.
    workers : int or None
        Threads, one per core where None; no result depends on it.
    quick : bool
        Fewer repetitions and smaller images, for tests; the figures of a quick run are marked as such.
    """

    seed: int = 0
    data: Path | None = None
    workers: int | None = None
    quick: bool = False


@dataclass(frozen=True)
class Table:
    """A table: one row per case, numbers as numbers (None where there is none), units in the column names."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"table {self.name}: a row has {len(row)} cells, the table {len(self.columns)} columns"
                )


@dataclass(frozen=True)
class Figure:
    """A figure as PNG bytes; `alt` says in a sentence what is to be seen."""

    name: str
    title: str
    png: bytes
    alt: str


@dataclass(frozen=True)
class Experiment:
    """What one experiment gave.

    Parameters
    ----------
    name : str
        As typed after `semscape experiments`.
    title : str
        Heading on the page.
    question : str
        What it asks, and how it is measured, in a few sentences.
    thesis : str
        Section of the thesis and its figure where that is known, else "not published here".
    tables, figures : tuple
        In the order of the page.
    notes : tuple of str
        What was left out, what failed, what to conclude.
    """

    name: str
    title: str
    question: str
    thesis: str
    tables: tuple[Table, ...]
    figures: tuple[Figure, ...] = ()
    notes: tuple[str, ...] = ()
