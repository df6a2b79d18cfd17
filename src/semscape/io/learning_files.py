"""Files of the learning: datasets as npz and model files as bytes, the shipped one too."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semscape.errors import BadInputError
from semscape.io.run_folder import put_files


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to a compressed npz file; it appears whole or not at all."""
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)  # type: ignore[arg-type]
    put_files({path.name: packed.getvalue()}, path.parent)


def read_arrays(path: Path, wanted: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz file.

    Raises
    ------
    BadInputError
        For a file that cannot be read or lacks one of the arrays.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in wanted if name not in archive]
            if missing:
                raise BadInputError(f"{path} is not a dataset of semscape dataset: it has no {', '.join(missing)}")
            return {name: archive[name] for name in wanted}
    except OSError as error:
        raise BadInputError(f"the dataset {path} cannot be read: {error.strerror or error}") from error
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise BadInputError(f"{path} is not a dataset of semscape dataset: no npz file of plain numbers") from error


def read_model_file(path: str) -> bytes:
    """Return the bytes of a model file, or where `path` is empty those of the model that ships with semscape.

    Raises
    ------
    BadInputError
        When there is no such file.
    """
    if not path:
        return (files("semscape") / "learning" / "significance.skops").read_bytes()
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise BadInputError(f"the model {path} cannot be read: {error.strerror or error}") from error
