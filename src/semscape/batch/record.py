"""What a batch remembers of a specimen: a small file, written when all else is in place."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from semscape.batch.input_files import FileStates
from semscape.errors import StorageError
from semscape.io.run_folder import RUN_FILES, json_text, put_files

RECORD_FORMAT = 1
RECORDS_NAME = "records"
State = Literal["done", "failed"]


@dataclass(frozen=True)
class Record:
    """How a specimen ended.

    `key` is the digest of inputs, options and code version; `inputs` holds per file its size, its time of change and
    its SHA-256; `products` per file of the run folder its size and SHA-256. `reason` says why it failed.
    """

    name: str
    state: State
    key: str
    inputs: Mapping[str, tuple[int, int, str]]
    products: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    reason: str = ""
    exit_code: int = 0
    seconds: float = 0.0
    peak_memory_mb: float | None = None
    report: Mapping[str, Any] = field(default_factory=dict)
    format: int = RECORD_FORMAT


@dataclass(frozen=True)
class Ending:
    """How a specimen ended in this start of the batch: its record, whether it was kept, and the bytes sent for it."""

    record: Record
    kept: bool
    n_bytes: int


def read_record(output: Path, name: str) -> Record | None:
    """Return a specimen's record; None where there is none, or one that cannot be read.

    Raises
    ------
    StorageError
        For a record that a newer semscape wrote.
    """
    path = output / RECORDS_NAME / f"{name}.json"
    try:
        values = json.loads(path.read_bytes())
        if values["format"] > RECORD_FORMAT:
            raise StorageError(
                f"{path} was written by a newer semscape (format {values['format']}; this one knows {RECORD_FORMAT}): "
                "update semscape, or give another output folder"
            )
        values["inputs"] = {key: tuple(value) for key, value in values["inputs"].items()}
        values["products"] = {key: tuple(value) for key, value in values["products"].items()}
        return Record(**values)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def write_record(output: Path, record: Record, thumbnail: bytes = b"") -> None:
    """Put a specimen's record in place, with its thumbnail."""
    files = {f"{record.name}.png": thumbnail} if thumbnail else {}
    files[f"{record.name}.json"] = json_text(asdict(record)).encode()
    put_files(files, output / RECORDS_NAME, owner=record.name)  # beside those that other workers write now


def input_digests(
    folder: Path, states: FileStates, known: Mapping[str, tuple[int, int, str]]
) -> dict[str, tuple[int, int, str]]:
    """Return size, time of change and SHA-256 of each file; files whose size and time are as known are not read."""
    found = {}
    for name, (size, changed_ns) in sorted(states.items()):
        before = known.get(name)
        digest = before[2] if before and before[:2] == (size, changed_ns) else _file_digest(folder / name)
        found[name] = (size, changed_ns, digest)
    return found


def product_digests(run: Path) -> dict[str, tuple[int, str]]:
    """Return size and SHA-256 of each file of a run folder."""
    return {name: ((run / name).stat().st_size, _file_digest(run / name)) for name in RUN_FILES}


def products_are_whole(run: Path, record: Record, *, read: bool) -> bool:
    """Tell whether a run folder holds what its record says: by size, and with `read` by every byte."""
    try:
        sizes = all((run / name).stat().st_size == size for name, (size, _) in record.products.items())
        return sizes and (
            not read or all(_file_digest(run / name) == digest for name, (_, digest) in record.products.items())
        )
    except (OSError, StorageError):
        return False


def _file_digest(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise StorageError(f"{path}: cannot be read ({error.strerror or error})") from error
