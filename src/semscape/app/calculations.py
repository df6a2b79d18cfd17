"""What the app asks another process to calculate. Every function takes and returns plain values and paths."""

from __future__ import annotations

import io
import os
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from semscape.app.workspace import UnknownRunError
from semscape.batch.folder_run import finished_stage, reconstruct_folder
from semscape.errors import BadInputError
from semscape.io.finished_run import FinishedRun, read_finished_run, read_finished_views
from semscape.io.inspect import describe_series
from semscape.io.micrograph import read_micrograph
from semscape.io.run_folder import plain_json
from semscape.io.series import load_series
from semscape.metrology.grid import Polygon, Region, region_of
from semscape.metrology.request import MeasureRequest
from semscape.options import ConvertOptions, MeasureOptions, Options
from semscape.report.conversion import convert
from semscape.report.measurement import measure_run, measured_to_dict
from semscape.report.surface_file import cameras_of, encode_surface
from semscape.report.thumbnail import thumbnail_png
from semscape.types import Reconstruction

THUMBNAIL_PX = 320
_MOST_PREVIEW_POINTS = 30_000
_MOST_VALUE_BYTES = 2_000_000_000


def reconstruct(images: str, output: str, settings: tuple[str, ...]) -> None:
    """Make a run of a folder of images (see `semscape.batch.folder_run`)."""
    reconstruct_folder(Path(images), Path(output), Options().with_settings(list(settings)))


def describe_images(folder: Path) -> dict[str, Any]:
    """Return what is understood of a folder of images: `views`, as `describe_series` gives them, and `warnings`.

    Raises
    ------
    BadInputError
        As `load_series` does.
    """
    series = load_series(folder)
    height, width = series.shape
    described: dict[str, Any] = plain_json(
        {
            "views": describe_series(series),
            "warnings": series.warnings,
            "width": width,
            "height": height,
            "length_unit": series.length_unit,
        }
    )
    return described


def draw_image(path: Path, longest_px: int, target: Path) -> None:
    """Write a small PNG of a micrograph, its grey values stretched between the 0.5 and 99.5 percentiles."""
    image = read_micrograph(path).image
    stride = max(1, min(image.shape) // longest_px)
    thinned = image[::stride, ::stride]
    low, high = np.percentile(thinned[np.isfinite(thinned)], [0.5, 99.5])
    grey = np.rint(255 * np.clip((np.nan_to_num(thinned) - low) / max(high - low, 1e-12), 0, 1)).astype(np.uint8)
    picture = Image.fromarray(grey)
    picture.thumbnail((longest_px, longest_px), Image.Resampling.BOX)
    stream = io.BytesIO()
    picture.save(stream, "png", optimize=True)
    _put(stream.getvalue(), target)


def draw_thumbnail(run: Path, target: Path) -> None:
    """Write a small PNG of a finished run's shaded relief."""
    height_map = _finished(run).height_map
    _put(thumbnail_png(height_map, THUMBNAIL_PX), target)


def sparse_points(work: Path) -> bytes:
    """Return the points that the calibration of an unfinished run found, as float32 x, y, z, one after the other.

    Raises
    ------
    UnknownRunError
        If the calibration has not ended yet.
    """
    path = work / "calibrate.value"
    try:
        if path.is_symlink() or path.stat().st_size > _MOST_VALUE_BYTES:
            raise UnknownRunError("there is no preview of this run")
        reconstruction = finished_stage(work, "calibrate")[0].reconstruction
        if not isinstance(reconstruction, Reconstruction):
            raise ValueError("it holds no points")
        points = np.asarray(reconstruction.points_um, dtype=np.float64)
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise UnknownRunError("the points are not there yet: they appear when the tilts have been found") from error
    thinned = points[:: max(1, -(-len(points) // _MOST_PREVIEW_POINTS))]
    return thinned[np.isfinite(thinned).all(axis=1)].astype("<f4").tobytes()


def write_surface(run: Path, target: Path) -> None:
    """Write what the viewer shows of a finished run (see `semscape.report.surface_file`)."""
    finished, views = _finished(run), read_finished_views(run)
    points = None
    if (run / "points.ply").is_file():
        points = np.asarray(trimesh.load(run / "points.ply").vertices, dtype=np.float64)  # type: ignore[attr-defined]
    surface = encode_surface(
        finished.height_map,
        name=run.name,
        cameras=cameras_of(views.motion, views.reference, views.names),
        points_um=points,
        height_scale_relative_sigma=finished.height_scale_relative_sigma,
    )
    _put(surface, target)


def measured(run: Path, settings: Mapping[str, Any], places: Mapping[str, Any]) -> dict[str, Any]:
    """Measure a finished run; return what `semscape measure --json` prints, and the profile's points.

    Parameters
    ----------
    run : Path
    settings : mapping
        Of `MeasureOptions`.
    places : mapping
        `profile`, `distance` as (x0, y0, x1, y1) px, `region` likewise or with all corners of a polygon, `step` and
        `angle` as two of these, `edges`.

    Raises
    ------
    SemscapeError
        If a setting is wrong, or too few heights are known.
    """
    request = MeasureRequest(
        options=MeasureOptions(**settings),
        region=_region(places["region"]) if places.get("region") else None,
        profile=_line(places.get("profile")),
        edges=tuple(places.get("edges") or ()),
        step=_two_regions(places.get("step")),
        angle=_two_regions(places.get("angle")),
        distance=_line(places.get("distance")),
    )
    found = measure_run(_finished(run), request)
    values = measured_to_dict(found) | {"run": run.name}
    profile = found.measurement.profile
    if profile is not None:
        values["profile"] = {"distance": profile.distance, "height": profile.height}
    plain: dict[str, Any] = plain_json(values)
    return plain


def exported(run: Path, format_name: str, settings: Mapping[str, Any], images: Path | None, folder: Path) -> Path:
    """Convert a finished run; return the file that was written into a folder, a ZIP where there are several.

    Raises
    ------
    SemscapeError
        As `convert` does.
    """
    options = ConvertOptions(**settings)
    paths = convert(run, [format_name], folder, options, images=images)
    if len(paths) == 1:
        return paths[0]
    archive = folder / f"{run.name}-{format_name}.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path in paths:
            file.write(path, path.name)
    return archive


def _put(content: bytes, target: Path) -> None:
    """Put a file of the cache in place. Others are being written beside it, by other processes: those stay alone."""
    descriptor, partial = tempfile.mkstemp(prefix=".partial-", dir=target.parent)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
    Path(partial).replace(target)


def _finished(run: Path) -> FinishedRun:
    archive = run / "height_map.npz"
    try:
        status = archive.stat()
    except OSError as error:
        raise UnknownRunError("this run has no height map yet") from error
    return _finished_at(run, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=1)
def _finished_at(run: Path, _changed_ns: int, _size: int) -> FinishedRun:
    """Read a run once for all that is asked of it while it stays the same."""
    return read_finished_run(run)


def _line(place: Sequence[float] | None) -> tuple[float, float, float, float] | None:
    if place is None:
        return None
    x0, y0, x1, y1 = (float(value) for value in place)
    return x0, y0, x1, y1


def _region(places: Sequence[float]) -> Region | Polygon:
    try:
        return region_of([float(value) for value in places])
    except ValueError as error:
        raise BadInputError(str(error)) from error


def _two_regions(places: Sequence[Sequence[float]] | None) -> tuple[Region | Polygon, Region | Polygon] | None:
    return None if places is None else (_region(places[0]), _region(places[1]))
