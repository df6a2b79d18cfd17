"""Which specimens a batch has: the rows of a manifest, or the folders in a folder."""

from __future__ import annotations

import csv
import difflib
import io
import re
import unicodedata
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from semscape.errors import BadInputError
from semscape.io.image_file import IMAGE_SUFFIXES

COLUMNS = ("folder", "name", "tilts", "pixel_size_um", "scale_bar_um", "axis_deg", "seed", "options")
_MOST_BYTES = 100_000_000
_MOST_NAME_BYTES = 200
_MOST_TOLD = 10
_OWN_NAMES = re.compile(r"records|summary(-\d+)?\.(csv|html)", re.IGNORECASE)  # of the batch's own files


@dataclass(frozen=True)
class Specimen:
    """One specimen: its name in the batch, the folder of its images, and what its row says beside.

    `values` holds the row's other cells by column, `line` is the row's line in the manifest (0: no manifest).
    """

    name: str
    folder: Path
    values: dict[str, str] = field(default_factory=dict)
    line: int = 0


def find_specimens(path: Path, output: Path) -> tuple[Specimen, ...]:
    """Return the specimens of a manifest, or of a folder whose folders hold images.

    Parameters
    ----------
    path : Path
        A CSV file with a column `folder` and any of the others in `COLUMNS`, or a folder.
    output : Path
        The batch's own folder, which is no specimen.

    Raises
    ------
    BadInputError
        For what cannot be read, unknown columns, names that are given twice or are no file names.
    """
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
    except (OSError, ValueError) as error:
        raise BadInputError(f"{path}: cannot be read ({error})") from error
    if not (is_folder or is_file):
        raise BadInputError(f"{path}: there is no such manifest or folder")
    specimens = _in_folder(path, output) if is_folder else _in_manifest(path)
    _require_distinct_names(path, specimens)
    return specimens


def _in_folder(path: Path, output: Path) -> tuple[Specimen, ...]:
    try:
        folders = sorted(
            folder
            for folder in path.iterdir()
            if folder.is_dir() and not folder.name.startswith(".") and folder.resolve() != output.resolve()
        )
        found = [folder for folder in folders if _holds_images(folder)]
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not found:
        raise BadInputError(
            f"{path}: none of its {len(folders)} folders holds images; a batch takes a folder of folders, one for each "
            "specimen, or a manifest"
        )
    return tuple(Specimen(_checked_name(folder.name, str(path)), folder) for folder in found)


def _holds_images(folder: Path) -> bool:
    return any(file.suffix.lower() in IMAGE_SUFFIXES for file in folder.iterdir())


def _in_manifest(path: Path) -> tuple[Specimen, ...]:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise BadInputError(f"{path}: larger than {_MOST_BYTES // 1_000_000} MB; is it a manifest?")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: cannot be read as text in UTF-8 ({error})") from error
    head = text.split("\n", 1)[0]
    rows = csv.reader(io.StringIO(text), delimiter=";" if head.count(";") > head.count(",") else ",", strict=True)
    specimens: list[Specimen] = []
    try:
        columns = [cell.strip().lower() for cell in next(rows, [])]
        _require_known_columns(path, columns)
        for cells in rows:
            if any(cell.strip() for cell in cells):
                specimens.append(_specimen(path, rows.line_num, columns, cells))
    except csv.Error as error:
        raise BadInputError(f"{path}: line {rows.line_num} is not CSV ({error})") from error
    if not specimens:
        raise BadInputError(f"{path}: no specimens; under the line of column names stands one row for each specimen")
    return tuple(specimens)


def _require_known_columns(path: Path, columns: list[str]) -> None:
    for column in columns:
        if column not in COLUMNS:
            nearest = difflib.get_close_matches(column, COLUMNS, n=1, cutoff=0.0)[0]
            raise BadInputError(
                f"{path}: unknown column {column!r}; the nearest one is {nearest!r} (all: {', '.join(COLUMNS)})"
            )
        if columns.count(column) > 1:
            raise BadInputError(f"{path}: the column {column!r} stands there twice")
    if "folder" not in columns:
        raise BadInputError(f"{path}: no column 'folder'; the first line names the columns: {', '.join(COLUMNS)}")


def _specimen(path: Path, line: int, columns: list[str], cells: list[str]) -> Specimen:
    if len(cells) > len(columns) and any(cell.strip() for cell in cells[len(columns) :]):
        raise BadInputError(
            f"{path}, line {line}: {len(cells)} cells, but {len(columns)} columns; a list of tilts with commas needs "
            'quotes: "-7,0,7"'
        )
    values = {column: cell.strip() for column, cell in zip(columns, cells, strict=False) if cell.strip()}
    folder = values.pop("folder", "")
    if not folder or "\0" in folder:
        raise BadInputError(f"{path}, line {line}: no folder" if not folder else f"{path}, line {line}: a NUL in it")
    place = path.parent / folder
    name = _checked_name(values.pop("name", "") or place.resolve().name, f"{path}, line {line}")
    return Specimen(name, place, values, line)


def _checked_name(name: str, where: str) -> str:
    """Return a name that is one path component on every system, or refuse it: results go to OUT/NAME."""
    bad = (
        not name
        or name.startswith(".")
        or name != name.strip()
        or name.endswith(".")
        or any(letter in '/\\:*?"<>|' or unicodedata.category(letter).startswith("C") for letter in name)
        or len(name.encode(errors="replace")) > _MOST_NAME_BYTES
        or _OWN_NAMES.fullmatch(name)
    )
    if bad:
        raise BadInputError(f"{where}: the name {name!r} cannot be that of a folder; give another in the column 'name'")
    return name


def _require_distinct_names(path: Path, specimens: Iterable[Specimen]) -> None:
    """Refuse names that differ by case alone too, which some file systems take for one."""
    fold: Callable[[str], str] = lambda name: unicodedata.normalize("NFC", name).casefold()  # noqa: E731
    seen: dict[str, Specimen] = {}
    twice = []
    for specimen in specimens:
        first = seen.setdefault(fold(specimen.name), specimen)
        if first is not specimen:
            twice.append(f"{specimen.name!r} (lines {first.line} and {specimen.line})")
    if twice:
        more = f" and {len(twice) - _MOST_TOLD} more" if len(twice) > _MOST_TOLD else ""
        raise BadInputError(
            f"{path}: names that stand there twice: {', '.join(twice[:_MOST_TOLD])}{more}; give a column 'name'"
        )
