"""Read back what measuring and converting need of a run folder: height map, how far to trust it, and the views."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from semscape.errors import BadInputError
from semscape.io.run_folder import read_motion, refuse_newer_format
from semscape.io.surfaces import read_height_map
from semscape.options import InputOptions, read_toml
from semscape.types import HeightMap, Motion


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A height map with what its run says of it.

    `height_scale_relative_sigma` is NaN, `ambiguity` and `verdict` are empty where nothing is known: a height map that
    lies alone.
    """

    name: str
    height_map: HeightMap
    height_scale_relative_sigma: float = math.nan
    ambiguity: str = ""
    verdict: str = ""


def read_finished_run(path: Path | str) -> FinishedRun:
    """Read a run folder, or a single height_map.npz.

    Raises
    ------
    BadInputError
        If there is no height map, or a file of the run cannot be read.
    """
    path = Path(path)
    if path.is_file():
        return FinishedRun(str(path), read_height_map(path))
    if not path.is_dir():
        raise BadInputError(f"{path} does not exist; give the run folder that semscape reconstruct wrote")
    if not (path / "height_map.npz").is_file():
        raise BadInputError(f"{path} is not a run folder: it holds no height_map.npz")
    refuse_newer_format(path)
    reconstruction = _read_json(path / "reconstruction.json")
    report = _read_json(path / "report.json")
    return FinishedRun(
        name=str(path),
        height_map=read_height_map(path / "height_map.npz"),
        height_scale_relative_sigma=_number(reconstruction.get("height_scale_relative_sigma")),
        ambiguity=str(reconstruction.get("ambiguity", "")),
        verdict=str(report.get("verdict", "")),
    )


@dataclass(frozen=True, eq=False)
class FinishedViews:
    """The calibrated views of a run: `names`, their `digests`, `motion`, the index of the reference, what was told."""

    names: tuple[str, ...]
    digests: tuple[str, ...]
    motion: Motion
    reference: int
    told: InputOptions


def read_finished_views(folder: Path | str) -> FinishedViews:
    """Read the calibrated views of a run folder.

    Raises
    ------
    BadInputError
        If this is no complete run folder.
    """
    path = Path(folder)
    motion, reference, names = read_motion(path)
    try:
        digests = input_digests(path)
        return FinishedViews(
            names=names,
            digests=tuple(digests[name] for name in names),
            motion=motion,
            reference=reference,
            told=read_toml((path / "options.toml").read_text(encoding="utf-8")).input,
        )
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise BadInputError(
            f"{path} is not a complete run folder: {error!r}; run semscape reconstruct again"
        ) from error


def input_digests(folder: Path | str) -> dict[str, str]:
    """Return the SHA-256 of the files of a run's images by their names; empty where the run does not tell them.

    Raises
    ------
    BadInputError
        If report.json cannot be read.
    """
    path = Path(folder) / "report.json"
    try:
        return {image["name"]: image["digest"] for image in _read_json(path).get("inputs", [])}
    except (KeyError, TypeError) as error:
        raise BadInputError(f"{path} does not list its images: {error!r}; run semscape reconstruct again") from error


def _read_json(path: Path) -> dict[str, Any]:
    """Return a JSON file's table; empty where there is no file, for a height map may have been copied alone."""
    if not path.is_file():
        return {}
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInputError(f"{path} cannot be read: {error}; run semscape reconstruct again") from error
    if not isinstance(values, dict):
        raise BadInputError(f"{path} does not hold a table; run semscape reconstruct again")
    return values


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
