"""The run folder: the contract of docs/run-folder.md, written so that no half-written file is ever trusted."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from semscape.errors import BadInputError, StorageError
from semscape.geometry.rotations import tilted_cam_from_world
from semscape.io.surfaces import (
    encode_height_map_npz,
    encode_height_map_tif,
    encode_mesh_glb,
    encode_mesh_ply,
    encode_points_ply,
)
from semscape.options import Options
from semscape.types import Motion, Reconstruction, Result

RUN_FILES = (
    "points.ply",
    "mesh.ply",
    "mesh.glb",
    "height_map.npz",
    "height_map.tif",
    "options.toml",
    "reconstruction.json",
    "report.html",
    "report.json",
)
"""Every file of a run folder, in the order they are put in place; report.json is the last."""

WORK_NAME = ".semscape-work"
"""Hidden folder in a run folder: what an interrupted run has finished (see `semscape.io.work_folder`)."""

RUN_FORMAT = 1
"""Version of the run folder's contract; it grows where a reader of the version before would misread a folder."""

_PARTIAL_PREFIX = ".semscape-partial-"
_OWN_FILES = re.compile("|".join([*map(re.escape, RUN_FILES), r"merged\.(ply|glb)", r"height_map_\d+\.npz"]))


def prepare_run_folder(folder: Path | str) -> Path:
    """Make sure that a run can be written to a folder, before the long computation starts.

    The folder is created where it does not exist. An empty folder and an earlier run folder are accepted.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    StorageError
        If the folder is a file, holds something else than a run, or cannot be written.
    """
    path = make_folder(folder)
    try:
        entries = {entry.name for entry in path.iterdir()}
        visible = {name for name in entries if not name.startswith(".")}
        complete = {"report.json", "reconstruction.json", "options.toml"} <= visible
        foreign = {name for name in visible if not (WORK_NAME in entries and _OWN_FILES.fullmatch(name))}
        if foreign and not complete:
            raise StorageError(
                f"the output folder {path} is not empty and is not an earlier run of semscape (it holds "
                f"{min(foreign)!r}); give a new or empty folder"
            )
        refuse_newer_format(path)
        for name in RUN_FILES:
            if (path / name).is_dir():
                raise StorageError(f"the output folder {path} cannot be written: {name} in it is a folder")
        shutil.rmtree(_make_partial(path))
    except OSError as error:
        raise StorageError(f"the output folder {path} cannot be written: {error.strerror or error}") from error
    return path


def make_folder(folder: Path | str) -> Path:
    """Make an output folder with its parents, where it does not exist.

    Raises
    ------
    StorageError
        If a file stands in its place, or nothing can be written there.
    """
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise StorageError(f"the output folder {path} cannot be made: a file stands in its place") from error
    except (OSError, ValueError) as error:
        reason = error.strerror or error if isinstance(error, OSError) else error
        raise StorageError(f"the output folder {path} cannot be written: {reason}") from error
    return path


def refuse_newer_format(folder: Path) -> None:
    """Raise `StorageError` for a run folder that a newer semscape wrote, whose files this one would misread."""
    try:
        report = json.loads((folder / "report.json").read_bytes())
        told = report.get("format", RUN_FORMAT)
    except (OSError, ValueError, AttributeError, RecursionError):
        return
    if isinstance(told, int) and told > RUN_FORMAT:
        raise StorageError(
            f"{folder} was written by a newer semscape (format {told}; this one knows {RUN_FORMAT}): update "
            "semscape, or give another folder"
        )


def encode_run(result: Result) -> dict[str, bytes]:
    """Return the files of a run by name, all but the two reports, which `semscape.report.write_run` adds."""
    reconstruction = result.reconstruction
    return {
        "points.ply": encode_points_ply(
            reconstruction.points_um, reconstruction.points_sigma_um, reconstruction.length_unit
        ),
        "mesh.ply": encode_mesh_ply(result.mesh),
        "mesh.glb": encode_mesh_glb(result.mesh),
        "height_map.npz": encode_height_map_npz(result.height_map),
        "height_map.tif": encode_height_map_tif(result.height_map),
        "options.toml": options_toml(result.report.options).encode(),
        "reconstruction.json": json_text(reconstruction_to_dict(reconstruction, result.series.names)).encode(),
    }


def put_files(files: Mapping[str, bytes], folder: Path | str, owner: str = "") -> None:
    """Write files into a folder: all under temporary names first, then each renamed into place.

    The folder is made where it does not exist. What a killed process left of its temporary names is cleared, so one
    process at a time may write to a folder; `owner` tells those apart that each have files of their own in one.

    Raises
    ------
    StorageError
        If the folder cannot be written; the files that were there before are then untouched.
    """
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
        partial = _make_partial(path, owner)
        try:
            for name, content in files.items():
                with (partial / name).open("wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
            for name in files:
                (partial / name).replace(path / name)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise StorageError(f"the output folder {path} cannot be written: {error.strerror or error}") from error


def reconstruction_to_dict(reconstruction: Reconstruction, names: Sequence[str]) -> dict[str, Any]:
    """Return the contents of reconstruction.json: angles in deg, lengths in the unit that `length_unit` names.

    Parameters
    ----------
    reconstruction : Reconstruction
        Calibrated motion and points.
    names : sequence of str
        Name of each view.
    """
    motion, unit = reconstruction.motion, reconstruction.length_unit
    rotation = tilted_cam_from_world(motion.axis_angle_rad, motion.tilt_rad, motion.roll_rad)
    sigma = _parameter_sigma(reconstruction)
    tilt_sigma_rad = reconstruction.tilt_sigma_rad.copy()
    if reconstruction.tilt_source == "self-calibrated":
        tilt_sigma_rad[reconstruction.reference] = 0.0  # held at zero by choice: there is nothing to be unsure of
    scale = motion.scale_px_per_um
    views = [
        {
            "name": name,
            "tilt_deg": math.degrees(motion.tilt_rad[i]),
            "tilt_sigma_deg": math.degrees(tilt_sigma_rad[i]),
            "stage_tilt_deg": math.degrees(reconstruction.tilt_prior_rad[i]),
            "roll_deg": math.degrees(motion.roll_rad[i]),
            "roll_sigma_deg": math.degrees(sigma[i, 1]),
            f"scale_px_per_{unit}": scale[i],
            f"scale_sigma_px_per_{unit}": scale[i] * sigma[i, 2],
            "anisotropy": motion.anisotropy[i],
            "anisotropy_sigma": sigma[i, 3],
            "prior": prior_figures(reconstruction, i),
            "R": rotation[i],
            "t_px": motion.translation_px[i],
        }
        for i, name in enumerate(names)
    ]
    return {
        "views": views,
        "axis_deg": math.degrees(motion.axis_angle_rad),
        "axis_sigma_deg": math.degrees(math.sqrt(max(reconstruction.covariance[0, 0], 0.0))),
        "reference_view": names[reconstruction.reference],
        "tilt_source": reconstruction.tilt_source,
        "height_scale_relative_sigma": reconstruction.height_scale_relative_sigma,
        "height_scale_relative_sigma_of_images": reconstruction.height_scale_relative_sigma_of_images,
        "mirror_margin": reconstruction.mirror_margin,
        "camera": reconstruction.camera,
        "camera_margin": reconstruction.camera_margin,
        f"inverse_distance_per_{unit}": reconstruction.inverse_distance_per_um,
        f"inverse_distance_sigma_per_{unit}": reconstruction.inverse_distance_sigma_per_um,
        "ambiguity": reconstruction.ambiguity,
        "relief_confidence": reconstruction.relief_confidence,
        "rms_px": reconstruction.rms_px,
        "n_tracks": len(reconstruction.points_um),
        "length_unit": unit,
    }


def read_motion(folder: Path | str) -> tuple[Motion, int, tuple[str, ...]]:
    """Read the calibrated views of a run folder back.

    Returns
    -------
    motion : Motion
        In the run's unit of length.
    reference : int
        The view whose grid the height map has.
    names : tuple of str
        Name of each view.

    Raises
    ------
    BadInputError
        If the folder holds no readable reconstruction.json.
    """
    path = Path(folder) / "reconstruction.json"
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        views, unit = told["views"], told["length_unit"]

        def column(key: str) -> Any:
            return np.array([view[key] for view in views], dtype=np.float64)

        motion = Motion(
            axis_angle_rad=math.radians(told["axis_deg"]),
            tilt_rad=np.deg2rad(column("tilt_deg")),
            roll_rad=np.deg2rad(column("roll_deg")),
            scale_px_per_um=column(f"scale_px_per_{unit}"),
            anisotropy=column("anisotropy"),
            translation_px=column("t_px"),
        )
        names = tuple(str(view["name"]) for view in views)
        return motion, names.index(told["reference_view"]), names
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise BadInputError(f"{path} is no reconstruction that semscape wrote: {error}") from error


def prior_figures(reconstruction: Reconstruction, view: int) -> dict[str, float]:
    """Return what was known of a view's motion before: 1-sigmas, and the tilt's mean; null is free."""
    if not len(reconstruction.prior_sigma):
        return {}
    first = 1 + 4 * view
    tilt, roll, scale, anisotropy = reconstruction.prior_sigma[first : first + 4]
    return {
        "tilt_deg": math.degrees(reconstruction.prior_mean[first]) if math.isfinite(tilt) else math.nan,
        "tilt_sigma_deg": math.degrees(tilt),
        "roll_sigma_deg": math.degrees(roll),
        "scale_relative_sigma": scale,
        "anisotropy_sigma": anisotropy,
    }


def options_toml(options: Mapping[str, Any]) -> str:
    """Return a report's options as the text of an options file; a null, JSON's NaN, takes the default."""
    tables = {
        stage: {key: value for key, value in values.items() if value is not None} for stage, values in options.items()
    }
    head = "# The effective options of a run: semscape reconstruct FOLDER --options options.toml -o RUN repeats it.\n\n"
    return head + Options().with_values(tables).to_toml()


def json_text(value: Any) -> str:
    """Return JSON text of nested values and arrays, keys in their order; NaN and infinity become null.

    Examples
    --------
    >>> print(json_text({"height_um": float("nan"), "t_px": np.array([1.0, 2.5])}), end="")
    {
      "height_um": null,
      "t_px": [1.0, 2.5]
    }
    """
    return _indented(plain_json(value), "") + "\n"


def plain_json(value: Any) -> Any:
    """Return nested values with arrays as lists, NumPy numbers as Python's and non-finite numbers as None."""
    if isinstance(value, Mapping):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain_json(value.tolist())
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    raise TypeError(f"{type(value).__name__} has no place in a JSON file: {value!r}")


def _indented(value: Any, indent: str) -> str:
    """Return JSON with an item a line, but lists of plain numbers and texts on one line."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        items = [
            f"{inner}{json.dumps(key, ensure_ascii=False)}: {_indented(item, inner)}" for key, item in value.items()
        ]
        return "{\n" + ",\n".join(items) + "\n" + indent + "}"
    if isinstance(value, list) and any(isinstance(item, list | dict) for item in value):
        return "[\n" + ",\n".join(inner + _indented(item, inner) for item in value) + "\n" + indent + "]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _parameter_sigma(reconstruction: Reconstruction) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the 1-sigma of each view's six parameters, (V, 6), from the covariance's diagonal."""
    variance = np.diag(reconstruction.covariance)[1:]
    return np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 6)


def _make_partial(folder: Path, owner: str = "") -> Path:
    """Make a hidden folder for files that are not complete yet, and clear what killed runs of the same owner left."""
    prefix = f"{_PARTIAL_PREFIX}{owner}." if owner else _PARTIAL_PREFIX
    ours = re.compile(re.escape(prefix) + "[^.]+")
    for leftover in [entry for entry in folder.iterdir() if ours.fullmatch(entry.name)]:
        shutil.rmtree(leftover, ignore_errors=True)
    return Path(tempfile.mkdtemp(prefix=prefix, dir=folder))
