"""Simulated tilt series on disk: micrographs as a Zeiss microscope writes them, beside the exact truth.

    FOLDER/view_00_-06.00deg.tif ...   8-bit TIFF with the SmartSEM text in tag 34118
    FOLDER/segments/view_00_-06.00deg_A.tif ...   the same for each segment of a backscatter detector
    FOLDER/truth.json                  motion, per view as set and as true, options, seed
    FOLDER/truth.npz                   height_um, normals, visible, world_from_grid, pixel_size_um
    FOLDER/truth_mesh.ply              the surface in um, z up

File names and truth.json tell tilts in semscape's sign; the header tells them in the vendor's, see `io.zeiss`.
The simulated stage tilts about the image's vertical axis (90 deg) by default; a real Zeiss stage at scan rotation 0
tilts about the horizontal one, which is `axis_deg` 0 here.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import shutil
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from semscape.errors import BadInputError
from semscape.io.run_folder import json_text, put_files
from semscape.io.surfaces import encode_mesh_ply
from semscape.io.zeiss import TAG, TILT_SIGN
from semscape.types import Micrograph, Motion, SimulationTruth, SurfaceMesh, TiltSeries

TRUTH_JSON, TRUTH_NPZ, TRUTH_MESH = "truth.json", "truth.npz", "truth_mesh.ply"
FORMAT = "semscape-simulation-1"

SEGMENTS = "segments"

_OWN_NAME = re.compile(
    r"view_\d+_[-+][\d.]+deg(_[A-D])?\.tif|segments|truth\.json|truth\.npz|truth_mesh\.ply|\.semscape-partial-.*"
)
_MESH_MAX_VERTICES = 160_000
_PALETTE_INDEX = np.arange(256, dtype=np.uint16) * 257


def write_simulated_series(
    folder: Path | str, series: TiltSeries, truth: SimulationTruth, segments: Sequence[TiltSeries] = ()
) -> Path:
    """Write a simulated series and its truth; a new folder appears whole or not at all.

    A folder that exists is kept, for a shell may stand in it, and filled: truth.json comes last.

    Parameters
    ----------
    folder : path
        A new or empty folder, or one that an earlier simulation wrote: that one is replaced.
    series : TiltSeries
        8-bit views, as `semscape.simulate.simulate` makes them.
    truth : SimulationTruth
        The truth of the same simulation.
    segments : sequence of TiltSeries
        The series of each segment of a backscatter detector, whose mean `series` is.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    BadInputError
        If the folder is a file, holds other files, or cannot be written.
    """
    path = Path(folder).resolve()
    require_own(path)
    views = {view.name: _encode_view(view) for view in series.views}
    parts = {view.name: _encode_view(view) for each in segments for view in each.views}
    told = {
        TRUTH_NPZ: _encode_truth_arrays(truth),
        TRUTH_MESH: encode_mesh_ply(truth.mesh or _truth_mesh(truth)),
        TRUTH_JSON: json_text(_truth_to_dict(truth, series.names)).encode(),
    }
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        if path.exists():
            (path / TRUTH_JSON).unlink(missing_ok=True)  # no truth stands beside images that are not its own
            for old in {*path.glob("view_*.tif"), *path.glob(f"{SEGMENTS}/*")}:
                old.unlink()
            _put(path, views | told, parts)
            return path
        partial.mkdir(parents=True)
        try:
            _put(partial, views | told, parts)
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise BadInputError(f"the simulation cannot be written to {path}: {error.strerror or error}") from error
    return path


def _put(folder: Path, files: dict[str, bytes], parts: dict[str, bytes]) -> None:
    """Put the files into a folder, those of the segments first, for truth.json comes last."""
    if parts:
        (folder / SEGMENTS).mkdir(exist_ok=True)
        put_files(parts, folder / SEGMENTS)
    elif (folder / SEGMENTS).is_dir():
        (folder / SEGMENTS).rmdir()
    put_files(files, folder)


def read_truth(folder: Path | str) -> SimulationTruth:
    """Read the truth of a simulated series back.

    Raises
    ------
    BadInputError
        If the folder holds no truth that `write_simulated_series` wrote, or a damaged one.
    """
    path = Path(folder)
    try:
        told = json.loads((path / TRUTH_JSON).read_text(encoding="utf-8"))
        views, distance = told["views"], told["working_distance_um"]

        def column(key: str) -> Any:
            return np.array([view[key] for view in views], dtype=np.float64)

        with np.load(path / TRUTH_NPZ, allow_pickle=False) as arrays:
            return SimulationTruth(
                motion=Motion(
                    axis_angle_rad=math.radians(told["axis_deg"]),
                    tilt_rad=np.deg2rad(column("true_tilt_deg")),
                    roll_rad=np.deg2rad(column("roll_deg")),
                    scale_px_per_um=column("scale_px_per_um"),
                    anisotropy=column("anisotropy"),
                    translation_px=column("translation_px"),
                ),
                stage_tilt_rad=np.deg2rad(column("stage_tilt_deg")),
                pixel_size_um=float(told["pixel_size_um"]),
                height_um=arrays["height_um"],
                normals=arrays["normals"].astype(np.float64),
                visible=arrays["visible"],
                world_from_grid=arrays["world_from_grid"],
                seed=int(told["seed"]),
                settings=told["settings"],
                skew=tuple(view["skew"] for view in views),
                working_distance_um=math.inf if distance is None else float(distance),
            )
    except (OSError, KeyError, TypeError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise BadInputError(
            f"{path} holds no readable truth of a simulated series ({TRUTH_JSON}, {TRUTH_NPZ}): {error}"
        ) from error


def truth_of_views(folder: Path | str, names: tuple[str, ...]) -> SimulationTruth:
    """Read the truth of the views that a result has, in its order: it may have left some out.

    Raises
    ------
    BadInputError
        If there is no readable truth, or a view is not one of the simulated series.
    """
    truth = read_truth(folder)
    told = json.loads((Path(folder) / TRUTH_JSON).read_text(encoding="utf-8"))
    known = [str(view["name"]) for view in told["views"]]
    foreign = [name for name in names if name not in known]
    if foreign:
        raise BadInputError(
            f"the result's view {foreign[0]!r} is not one of the series whose truth {folder} holds "
            f"({known[0]} ... {known[-1]}); give the folder that was reconstructed"
        )
    return truth.select(tuple(known.index(name) for name in names))


def require_own(folder: Path | str) -> None:
    """Refuse a folder that holds anything but an earlier simulation, or that this process may not write.

    Raises
    ------
    BadInputError
        With what stands in the way.
    """
    path = Path(folder).resolve()
    there = next(place for place in (path, *path.parents) if place.exists())
    if there.is_dir() and not os.access(there, os.W_OK | os.X_OK):
        raise BadInputError(f"the simulation cannot be written to {path}: no permission to write in {there}")
    try:
        if path.exists() and not path.is_dir():
            raise BadInputError(f"the output folder {path} cannot be made: a file stands in its place")
        entries = [*path.iterdir(), *path.glob(f"{SEGMENTS}/*")] if path.is_dir() else []
        foreign = sorted(entry.name for entry in entries if not _OWN_NAME.fullmatch(entry.name))
    except OSError as error:
        raise BadInputError(f"the output folder {path} cannot be read: {error.strerror or error}") from error
    if foreign:
        raise BadInputError(
            f"the output folder {path} holds {len(foreign)} other file(s) ({foreign[0]!r}); give a new or empty folder"
        )


def _truth_to_dict(truth: SimulationTruth, names: tuple[str, ...]) -> dict[str, Any]:
    """Return truth.json's content: everything but the arrays over the grid, angles in degrees."""
    motion = truth.motion
    rows, cols = truth.height_um.shape
    centre = np.array([cols - 1, rows - 1]) / 2
    return {
        "format": FORMAT,
        "seed": truth.seed,
        "pixel_size_um": truth.pixel_size_um,
        "axis_deg": math.degrees(motion.axis_angle_rad),
        "working_distance_um": truth.working_distance_um if math.isfinite(truth.working_distance_um) else None,
        "views": [
            {
                "name": name,
                "stage_tilt_deg": math.degrees(truth.stage_tilt_rad[i]),
                "true_tilt_deg": math.degrees(motion.tilt_rad[i]),
                "roll_deg": math.degrees(motion.roll_rad[i]),
                "scale_px_per_um": motion.scale_px_per_um[i],
                "anisotropy": motion.anisotropy[i],
                "skew": truth.skew[i] if truth.skew else 0.0,
                "translation_px": motion.translation_px[i],
                "shift_px": motion.translation_px[i] - centre,
            }
            for i, name in enumerate(names)
        ],
        "settings": truth.settings,
    }


def _encode_truth_arrays(truth: SimulationTruth) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        height_um=truth.height_um,
        normals=truth.normals.astype(np.float32),
        visible=truth.visible,
        world_from_grid=truth.world_from_grid,
        pixel_size_um=np.array(truth.pixel_size_um),
    )
    return buffer.getvalue()


def _truth_mesh(truth: SimulationTruth) -> SurfaceMesh:
    """Triangulate the true heights, every n-th node where they are many."""
    rows, cols = truth.height_um.shape
    stride = max(1, math.ceil(math.sqrt(rows * cols / _MESH_MAX_VERTICES)))
    row, col = np.meshgrid(np.arange(0, rows, stride), np.arange(0, cols, stride), indexing="ij")
    grid = np.stack([col, row, truth.height_um[::stride, ::stride], np.ones(col.shape)], axis=-1)
    vertices = grid.reshape(-1, 4) @ truth.world_from_grid[:3].T
    index = np.arange(len(vertices)).reshape(col.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    # Rows run along -y: counter-clockwise from above is down the column first.
    faces = np.vstack([np.column_stack([a, c, b]), np.column_stack([b, c, d])])
    known = np.isfinite(vertices[:, 2])
    faces = (np.cumsum(known) - 1)[faces[known[faces].all(axis=1)]]
    vertices = vertices[known]
    return SurfaceMesh(vertices, faces, np.full((len(vertices), 3), 200, dtype=np.uint8), "um")


def _encode_view(view: Micrograph) -> bytes:
    """Return a micrograph as the palette TIFF that SmartSEM writes, its text in tag 34118."""
    import tifffile

    text = zeiss_text(view).encode("cp1252")
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        view.image.astype(np.uint8),
        photometric="palette",
        colormap=np.stack([_PALETTE_INDEX] * 3),
        extratags=[(TAG, 2, len(text) + 1, text + b"\0", True)],
        metadata=None,
        software=False,
    )
    return buffer.getvalue()


def zeiss_text(view: Micrograph) -> str:
    """Return the SmartSEM text of a simulated micrograph: a head of bare numbers in SI units, then pairs of lines."""
    metadata = view.metadata
    height, width = view.image.shape
    pixel = metadata.pixel_size_um
    distance = metadata.working_distance_um
    voltage = metadata.accelerating_voltage_kv
    tilt = _decimals(math.degrees(TILT_SIGN * metadata.tilt_rad) + 0.0, 1)
    rotation = math.degrees(metadata.scan_rotation_rad)
    detector = metadata.raw.get("DP_DETECTOR_TYPE", "Detector = SE2")
    block = [
        f"{pixel * 1e-6:.6e}",
        f"{metadata.magnification:.6e}",
        "6",
        f"{voltage * 1e3:.6e}",
        "2.310000e+00",
        "2.000000e-10",
        f"{distance * 1e-6:.6e}",
    ]
    pairs = {
        "DP_STAGE_TILTED": metadata.raw.get("DP_STAGE_TILTED", "Stage Tilt = in X"),
        "DP_TILTED": f"Stage Tilted = {'No' if metadata.tilt_rad == 0 else 'Yes'}",
        "DP_IMAGE_STORE": f"Store resolution = {width} * {height}",
        "DP_DETECTOR_CHANNEL": detector.replace("Detector", "Signal A"),
        "DP_DETECTOR_TYPE": detector,
        "DP_TILT_CORRECTION": "Tilt Corrn. = Off",
        "DP_SCAN_ROT": f"Scan Rot = {'Off' if rotation == 0 else 'On'}",
        "AP_MAG": f"Mag = {metadata.magnification:6.0f} X",
        "AP_TILT_ANGLE": "Tilt Angle =  45.0 °",
        "AP_TILT_AXIS": metadata.raw.get("AP_TILT_AXIS", "Tilt Axis =  90.0 °"),
        "AP_SCANROTATION": f"Scan Rotation = {_decimals(rotation, 1):>5} °",
        "AP_MANUALKV": f"EHT Target = {voltage:5.2f} kV",
        "AP_PIXEL_SIZE": f"Pixel Size = {_length(pixel * width / 1024)}",
        "AP_IMAGE_PIXEL_SIZE": f"Image Pixel Size = {_length(pixel)}",
        "AP_WIDTH": f"Width = {_length(pixel * width)}",
        "AP_HEIGHT": f"Height = {_length(pixel * height)}",
        "AP_WD": f"WD = {distance / 1000:4.1f} mm",
        "AP_STAGE_GOTO_T": f"Stage goto T = {tilt:>5} °",
        "AP_STAGE_AT_Z": "Stage at Z = 10.000 mm",
        "AP_STAGE_AT_Y": "Stage at Y = 50.0000 mm",
        "AP_STAGE_AT_X": "Stage at X = 50.0000 mm",
        "AP_ACTUALKV": f"EHT = {voltage:5.2f} kV",
        "AP_STAGE_AT_T": f"Stage at T = {tilt:>5} °",
        "AP_STAGE_AT_R": "Stage at R =   0.0 °",
        "SV_VERSION": "Version = V07.03.00.00 : semscape simulate",
        "SV_FILE_NAME": f"File Name = {view.name}",
    }
    lines = ["0", "0"]
    for number in range(4):
        lines += [str(number), *block]
    lines.append(str(len(pairs)))
    for key, line in pairs.items():
        lines += [key, line]
    return "\r\n".join(lines) + "\r\n"


def _length(length_um: float) -> str:
    """Return a length as SmartSEM shows it, but with more digits where four are not the whole truth."""
    value, unit = (length_um * 1000, "nm") if length_um < 1 else (length_um, "µm")
    if length_um >= 1000:
        value, unit = length_um / 1000, "mm"
    short = f"{value:#.4g}"
    return f"{short if math.isclose(float(short), value, rel_tol=1e-9) else f'{value:.9g}'} {unit}"


def _decimals(value: float, digits: int) -> str:
    """Return a number with `digits` decimals, or six where these lose something."""
    short = f"{value:.{digits}f}"
    return short if abs(float(short) - value) < 1e-9 else f"{value:.6f}"
