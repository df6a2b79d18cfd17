"""What a person tells of a series in the app: the `series.toml` beside the images, a cell at a time, with undo."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from semscape.errors import BadInputError
from semscape.io.acquisition import MAX_TILT_DEG
from semscape.io.run_folder import put_files
from semscape.io.series import natural_key
from semscape.io.series_toml import OVERRIDES, SIDECAR_NAME

Cell = float | bool | None
_MOST_REMEMBERED = 200
_MOST_TOML_BYTES = 1_000_000


@dataclass(frozen=True)
class Told:
    """The cells that are filled: of the series, and of its images by their stored names."""

    series: Mapping[str, Any]
    images: Mapping[str, Mapping[str, Any]]

    def cell(self, image: str, key: str) -> Any:
        """Return what is told, None where nothing is; the series' own cells have an empty image."""
        return (self.images.get(image, {}) if image else self.series).get(key)

    def with_cell(self, image: str, key: str, value: Any) -> Told:
        """Return the same with one cell filled, or emptied by None."""
        if not image:
            return Told(_changed(self.series, key, value), self.images)
        table = _changed(self.images.get(image, {}), key, value)
        return Told(self.series, {name: kept for name, kept in {**self.images, image: table}.items() if kept})

    def without_image(self, image: str) -> Told:
        """Return the same without an image's cells."""
        return Told(self.series, {name: table for name, table in self.images.items() if name != image})


@dataclass(frozen=True)
class Change:
    """One edit: a cell, and what it held before and after."""

    image: str
    key: str
    before: Cell
    after: Cell


@dataclass(frozen=True)
class History:
    """The edits that were made and can be undone, and those that were undone and can be made again."""

    done: tuple[Change, ...] = ()
    undone: tuple[Change, ...] = ()

    def with_change(self, change: Change) -> History:
        """Return the history after an edit."""
        return History((*self.done, change)[-_MOST_REMEMBERED:])

    def undo(self) -> tuple[Change, History]:
        """Return the edit to take back, and the history without it.

        Raises
        ------
        BadInputError
            If there is none.
        """
        if not self.done:
            raise BadInputError("there is no edit to undo")
        return self.done[-1], History(self.done[:-1], (*self.undone, self.done[-1]))

    def redo(self) -> tuple[Change, History]:
        """Return the edit to make again, and the history with it.

        Raises
        ------
        BadInputError
            If there is none.
        """
        if not self.undone:
            raise BadInputError("there is no edit to make again")
        return self.undone[-1], History((*self.done, self.undone[-1]), self.undone[:-1])


def check_cell(image: str, key: str, value: Cell) -> None:
    """Refuse a value that a cell cannot hold.

    Raises
    ------
    BadInputError
        For an unknown cell, or a value out of its range.
    """
    own = ("tilt_deg",) if image else ("axis_deg", "scale_bar_um")
    if key not in (*own, *OVERRIDES):
        raise BadInputError(f"{key} is no cell of {'an image' if image else 'a series'}")
    if value is None:
        return
    number = float(value)
    if key == "tilt_deg":
        allowed, must = abs(number) <= MAX_TILT_DEG, f"lie within ±{MAX_TILT_DEG:g} deg"
    elif key == "axis_deg":
        allowed, must = -45 < number <= 135, "lie above -45 and up to 135 deg"
    elif key == "scale_bar_um":
        allowed, must = 0 < number < math.inf, "be a positive number"
    else:
        allowed, must = OVERRIDES[key].allowed(number), OVERRIDES[key].must
    if not allowed:
        raise BadInputError(f"{key} is {number:g}; it must {must}, or be left empty")


def read_told(folder: Path) -> Told:
    """Return what a folder's `series.toml` tells; nothing where there is none.

    Raises
    ------
    BadInputError
        For a file that is not TOML.
    """
    path = folder / SIDECAR_NAME
    if not path.is_file():
        return Told({}, {})
    try:
        if path.stat().st_size > _MOST_TOML_BYTES:
            raise ValueError("it is too large")
        return parse_told(path.read_bytes())
    except (OSError, ValueError) as error:
        raise BadInputError(f"{SIDECAR_NAME}: cannot be read ({error}); correct it or remove it") from error


def parse_told(content: bytes) -> Told:
    """Return what the bytes of a `series.toml` tell.

    Raises
    ------
    ValueError
        If they are no such text.
    """
    try:
        values = tomllib.loads(content.decode("utf-8-sig"))
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    images = values.pop("images", {})
    if not (isinstance(images, dict) and all(isinstance(table, dict) for table in images.values())):
        raise ValueError('images must be tables like [images."a.tif"]')
    return Told(values, images)


def write_told(folder: Path, told: Told) -> None:
    """Write a folder's `series.toml`, whole or not at all.

    Raises
    ------
    BadInputError
        If the folder cannot be written.
    """
    put_files({SIDECAR_NAME: told_toml(told).encode()}, folder, SIDECAR_NAME)


def told_toml(told: Told) -> str:
    """Return the text of a `series.toml`.

    Examples
    --------
    >>> print(told_toml(Told({"pixel_size_um": 0.05}, {"a.tif": {"tilt_deg": -3.0}})), end="")
    # What was told of these images; semscape reads it beside them.
    pixel_size_um = 0.05
    <BLANKLINE>
    [images."a.tif"]
    tilt_deg = -3.0
    """
    lines = ["# What was told of these images; semscape reads it beside them."]
    lines += [f"{_toml(key)} = {_toml(value)}" for key, value in told.series.items()]
    for name in sorted(told.images, key=natural_key):
        table = told.images[name]
        lines += ["", f"[images.{_quoted(name)}]"]
        lines += [f"{_toml(key)} = {_toml(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


def for_stored_names(told: Told, originals: Mapping[str, str]) -> Told:
    """Return what a `series.toml` that was written for the original names tells of the stored ones.

    Its list of tilts, which belongs to the naturally sorted names, becomes a cell of each image.

    Parameters
    ----------
    told : Told
        As the file says it.
    originals : mapping
        Original name of each image by its stored name.
    """
    stored = {original: name for name, original in originals.items()}
    images = {stored.get(name, name): dict(table) for name, table in told.images.items()}
    series = dict(told.series)
    tilts: Sequence[Any] = series["tilts_deg"] if isinstance(series.get("tilts_deg"), list) else ()
    if tilts and len(tilts) == len(stored) and not any("tilt_deg" in table for table in images.values()):
        del series["tilts_deg"]
        for original, tilt in zip(sorted(stored, key=natural_key), tilts, strict=True):
            images.setdefault(stored[original], {})["tilt_deg"] = tilt
    return Told(series, images)


def _changed(table: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    kept = {name: held for name, held in table.items() if name != key}
    return kept if value is None else {**kept, key: value}


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return value if value.replace("_", "").isalnum() and value.isascii() else _quoted(value)
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False, default=str)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
