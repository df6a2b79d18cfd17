"""Accuracy of the dense surface alone: simulated truths, disjoint pairs, and the matcher on a perspective pair.

Each function is a row of `make accuracy`; rivals run on the same cameras in the same run.
"""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from accuracy_shapes import shape_figures, step_specimen
from isolated import SHARED_DATA_VARIABLE, real_set_folder, timed

if TYPE_CHECKING:
    from collections.abc import Callable

    from semscape.evaluate.height_errors import HeightError
    from semscape.types import BoolArray, FloatArray, HeightMap, Reconstruction, SimulationTruth, TiltSeries

_BINS = 5
_TRIM = 0.95
_WRONG_PX = 1.0
_FEW_PX = 200
_SMALL_GAP_PX = 3


def measure_surface(specimen: str, seed: int) -> dict[str, Any]:
    """Heights, normals, sigmas, shapes and time of a nominal series, with the true and with the estimated cameras."""
    from dataclasses import replace

    from semscape.dense.rival import dis_height_map, sgbm_height_map
    from semscape.dense.surface import dense_surface
    from semscape.options import DenseOptions

    series, truth = _nominal(specimen, seed)
    estimated = calibrated(series)
    dense_surface(series, estimated, DenseOptions())  # compiled, or loaded, before anything is timed
    row: dict[str, Any] = {"specimen": specimen, "seed": seed}
    for name, cameras in (("true_cameras", replace(estimated, motion=truth.motion)), ("estimated_cameras", estimated)):
        found, seconds = timed(dense_surface, series, cameras, DenseOptions())
        ours = found.height_map
        given: Any = SimpleNamespace(series=series, reconstruction=cameras, height_map=ours)
        sgbm, sgbm_seconds = timed(sgbm_height_map, given)
        flow, flow_seconds = timed(dis_height_map, given)
        row[name] = {
            "semscape": surface_errors(specimen, ours, cameras, truth),
            "opencv_sgbm": surface_errors(specimen, sgbm, cameras, truth),
            "opencv_dis": surface_errors(specimen, flow, cameras, truth),
            "seconds": round(seconds, 2),
            "opencv_sgbm_seconds": round(sgbm_seconds, 2),
            "opencv_dis_seconds": round(flow_seconds, 2),
            "times_opencv_sgbm": round(seconds / sgbm_seconds, 1),
        }
    return row


class _CalibratedError(Exception):
    """Raised to stop a reconstruction before its surface, which is not asked for."""


def calibrated(series: TiltSeries) -> Reconstruction:
    """Return a series' cameras and sparse points, as the whole line finds them before the surface."""
    import semscape

    values: dict[str, Any] = {}

    def keep(stage: str, make: Callable[[], Any]) -> Any:
        values[stage] = make()
        if stage == "calibrate":
            raise _CalibratedError
        return values[stage]

    with contextlib.suppress(_CalibratedError):
        semscape.reconstruct(series, rng=0, keep=keep)
    cameras: Reconstruction = values["calibrate"][0].reconstruction
    return cameras


def _nominal(specimen: str, seed: int) -> tuple[TiltSeries, SimulationTruth]:
    """Simulate a nominal series of a specimen of `SPECIMENS`, or of the step."""
    import math

    from semscape.simulate import PRESETS, faults, simulate
    from semscape.simulate.camera import scan_cameras
    from semscape.simulate.series import draw_motion, specimen_size

    options = PRESETS["nominal"]
    if specimen != "step":
        return simulate(specimen, options, rng=seed)
    motion, _, skew = draw_motion(options, seed)
    size = specimen_size(options, scan_cameras(motion, skew, math.inf))
    return simulate(step_specimen(size, faults.stream(seed, "specimen")), options, rng=seed)


def measure_disjoint(name: str) -> dict[str, Any]:
    """Heights of a measured series from disjoint pairs of its views: median and rms of what they differ by, px."""
    import itertools

    import numpy as np

    import semscape
    from semscape.dense.rival import dis_height_map, sgbm_height_map
    from semscape.dense.surface import dense_surface
    from semscape.options import DenseOptions

    series = semscape.load_series(real_set_folder(name))
    cameras = calibrated(series)
    views = range(len(series.views))
    splits = [
        (one, other)
        for one, other in itertools.combinations(itertools.combinations(views, 2), 2)
        if not set(one) & set(other)
    ]
    if not splits:  # three views have no disjoint pairs: those that share the middle view
        order = np.argsort(cameras.motion.tilt_rad)
        splits = [((int(order[0]), int(order[1])), (int(order[1]), int(order[2])))]
    rows = []
    for pairs in splits:
        heights: dict[str, list[FloatArray]] = {"semscape": [], "opencv_sgbm": [], "opencv_dis": []}
        for pair in pairs:
            part, own = series.select(pair, "a pair"), _only(cameras, pair)
            ours = dense_surface(part, own, DenseOptions()).height_map
            given: Any = SimpleNamespace(series=part, reconstruction=own, height_map=ours)
            heights["semscape"].append(ours.height_um)
            heights["opencv_sgbm"].append(sgbm_height_map(given).height_um)
            heights["opencv_dis"].append(dis_height_map(given).height_um)
        pixel = float(series.pixel_size_um[cameras.reference])
        rows.append(
            {"pairs": [list(pair) for pair in pairs]}
            | {method: _differences((first - second) / pixel) for method, (first, second) in heights.items()}
        )
    return {"disjoint": rows}


def _differences(difference_px: FloatArray) -> dict[str, float]:
    """Return how much two height maps (H, W) differ, but for their common level, and where both are known."""
    import numpy as np

    known = difference_px[np.isfinite(difference_px)]
    ranked = np.sort(np.abs(known - np.median(known)))
    kept = ranked[: int(_TRIM * ranked.size)]
    return {
        "median_px": round(float(np.median(ranked)), 3),
        "trimmed_rms_px": round(float(np.sqrt(np.mean(kept**2))), 3),
        "rms_px": round(float(np.sqrt(np.mean(ranked**2))), 3),
        "compared": round(known.size / difference_px.size, 3),
    }


def measure_stereo() -> dict[str, Any]:
    """Share of the pixels of a perspective pair whose disparity is off by more than one px, beside StereoSGBM."""
    import cv2
    import numpy as np

    from semscape.dense.stereo import RectifiedView, pair_heights
    from semscape.options import DenseOptions

    folder = real_set_folder("quartz").parent.parent / "stereo"
    left, right = (
        cv2.imread(str(folder / f"motorcycle_{side}.png"), cv2.IMREAD_GRAYSCALE) for side in ("left", "right")
    )
    if left is None or right is None:
        return {"skipped": f"no stereo pair; set {SHARED_DATA_VARIABLE}"}
    stored = np.load(folder / "motorcycle_disp.npz")
    true = np.asarray(stored[stored.files[0]], np.float64)
    true = np.where(np.isfinite(true) & (true > 0), true, np.nan)
    # Rectified frames are multiples of 64 px.
    rim = [(0, -size % 64) for size in left.shape]
    valid = np.pad(np.ones(left.shape, bool), rim)
    largest = float(np.nanmax(true))
    views = [
        RectifiedView(np.pad(image, rim, mode="edge").astype(np.float32), valid, parallax)
        for image, parallax in ((left, 0.0), (right, -1.0))
    ]
    found, seconds = timed(pair_heights, *views, (0.0, largest), DenseOptions())
    ours = found[: left.shape[0], : left.shape[1]]
    count = int(np.ceil(largest / 16 + 1)) * 16
    matcher = cv2.StereoSGBM.create(
        numDisparities=count,
        blockSize=7,
        P1=8 * 49,
        P2=32 * 49,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=60,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    sixteenths, sgbm_seconds = timed(matcher.compute, left, right)
    rival = np.where(sixteenths > 0, sixteenths / 16.0, np.nan)
    return {
        "semscape": _wrong(ours, true) | {"seconds": round(seconds, 2)},
        "opencv_sgbm": _wrong(rival, true) | {"seconds": round(sgbm_seconds, 2)},
    }


def _seen_twice(found: HeightError, truth: SimulationTruth) -> BoolArray:
    """Return which points of a result's grid the reference view and another one really see."""
    import numpy as np

    known = np.isfinite(found.true_um[..., 2]) & found.seen
    points = np.column_stack([found.true_um[known], np.ones(known.sum())])
    grid = np.rint(points @ np.linalg.inv(truth.world_from_grid)[:2].T).astype(np.int64)
    rows, cols = (np.clip(grid[:, axis], 0, truth.height_um.shape[1 - axis] - 1) for axis in (1, 0))
    seen = known.copy()
    seen[known] = truth.visible[:, rows, cols].sum(axis=0) >= 2
    return seen


def _wrong(disparity: FloatArray, true: FloatArray) -> dict[str, float]:
    import numpy as np

    asked = np.isfinite(true)
    known = asked & np.isfinite(disparity)
    wrong = np.abs(disparity - true)[known] > _WRONG_PX
    return {
        "known": round(float(known.sum() / asked.sum()), 4),
        "wrong_of_known": round(float(wrong.mean()), 4),
        "right_of_all": round(float((~wrong).sum() / asked.sum()), 4),
    }


def _only(cameras: Reconstruction, pair: tuple[int, int]) -> Reconstruction:
    """Return the calibration of two of the views; their reference is the one nearer to zero tilt."""
    from dataclasses import replace

    import numpy as np

    at = list(pair)
    motion = cameras.motion
    chosen = replace(
        motion,
        tilt_rad=motion.tilt_rad[at],
        roll_rad=motion.roll_rad[at],
        scale_px_per_um=motion.scale_px_per_um[at],
        anisotropy=motion.anisotropy[at],
        translation_px=motion.translation_px[at],
    )
    return replace(cameras, motion=chosen, reference=int(np.argmin(np.abs(chosen.tilt_rad))))


def small_gaps(height: FloatArray) -> int:
    """Return how many gaps of at most three unknown pixels a height map (H, W) has."""
    import numpy as np
    from scipy.ndimage import label

    gaps, _ = label(np.isnan(height), np.ones((3, 3)))
    return int((np.bincount(gaps.ravel())[1:] <= _SMALL_GAP_PX).sum())


def surface_errors(
    specimen: str, height_map: HeightMap, cameras: Reconstruction, truth: SimulationTruth
) -> dict[str, Any]:
    import numpy as np

    from semscape.evaluate.height_errors import height_error

    found = height_error(height_map, cameras.motion, cameras.reference, truth)
    pixel = height_map.pixel_size_um
    error = np.abs(found.error_um) / pixel
    known = np.isfinite(error)
    ranked = np.sort(error[known])
    angle = np.rad2deg(found.normal_angle_rad[np.isfinite(found.normal_angle_rad)])
    figures: dict[str, Any] = {
        "median_px": round(float(np.median(ranked)), 3),
        "trimmed_rmse_px": round(float(np.sqrt(np.mean(ranked[: int(_TRIM * ranked.size)] ** 2))), 3),
        "normal_median_deg": round(float(np.median(angle)), 2),
        "completeness": round(float(np.isfinite(height_map.height_um[_seen_twice(found, truth)]).mean()), 4),
        "small_gaps": small_gaps(height_map.height_um),
    } | shape_figures(specimen, found, truth)
    sigma = height_map.uncertainty_um / pixel
    if np.isfinite(sigma).any():
        within = (error < sigma)[known]
        edges = np.quantile(sigma[known], np.linspace(0, 1, _BINS + 1))
        bin_of = np.digitize(sigma[known], edges[1:-1])
        figures["within_1_sigma"] = round(float(within.mean()), 3)
        figures["within_1_sigma_by_bin"] = [
            round(float(within[bin_of == i].mean()), 3) for i in range(_BINS) if (bin_of == i).any()
        ]
        views = height_map.n_views[known]
        counts = zip(*np.unique(views, return_counts=True), strict=True)
        figures["within_1_sigma_by_views"] = {
            str(n): round(float(within[views == n].mean()), 3) for n, count in counts if count >= _FEW_PX
        }
    return figures
