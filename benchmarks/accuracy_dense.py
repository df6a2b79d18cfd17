"""Accuracy of the dense surface alone: simulated truths, jumps, disjoint pairs, and the matcher on a perspective pair.

Each function is a row of `make accuracy`; rivals run on the same cameras in the same run.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from isolated import SHARED_DATA_VARIABLE, real_set_folder, timed

if TYPE_CHECKING:
    from semscape.types import FloatArray, HeightMap, Reconstruction, SimulationTruth

_BINS = 5
_TRIM = 0.95
_WRONG_PX = 1.0


def measure_surface(specimen: str, seed: int) -> dict[str, Any]:
    """Heights, normals, sigmas and time of a nominal series, with the true and with the estimated cameras."""
    from dataclasses import replace

    import semscape
    from semscape.dense.rival import dis_height_map, sgbm_height_map
    from semscape.dense.surface import dense_surface
    from semscape.options import DenseOptions
    from semscape.simulate import PRESETS, simulate

    series, truth = simulate(specimen, PRESETS["nominal"], rng=seed)
    estimated = semscape.reconstruct(series, rng=0).reconstruction
    row: dict[str, Any] = {"specimen": specimen, "seed": seed}
    for name, cameras in (("true_cameras", replace(estimated, motion=truth.motion)), ("estimated_cameras", estimated)):
        found, seconds = timed(dense_surface, series, cameras, DenseOptions())
        ours = found.height_map
        given: Any = SimpleNamespace(series=series, reconstruction=cameras, height_map=ours)
        sgbm, sgbm_seconds = timed(sgbm_height_map, given)
        flow, flow_seconds = timed(dis_height_map, given)
        row[name] = {
            "semscape": _errors(ours, cameras, truth),
            "opencv_sgbm": _errors(sgbm, cameras, truth),
            "opencv_dis": _errors(flow, cameras, truth),
            "seconds": round(seconds, 2),
            "opencv_sgbm_seconds": round(sgbm_seconds, 2),
            "opencv_dis_seconds": round(flow_seconds, 2),
            "times_opencv_sgbm": round(seconds / sgbm_seconds, 1),
        }
    return row


def measure_walls(seed: int) -> dict[str, Any]:
    """Rise from 10 to 90 % of the vertical walls of a nominal grating, px across the wall, with the true cameras."""
    from dataclasses import replace

    import numpy as np

    import semscape
    from semscape.dense.surface import dense_surface
    from semscape.evaluate.height_errors import height_error
    from semscape.options import DenseOptions
    from semscape.simulate import PRESETS, simulate

    series, truth = simulate("grating", PRESETS["nominal"], rng=seed)
    cameras = replace(semscape.reconstruct(series, rng=0).reconstruction, motion=truth.motion)
    found = dense_surface(series, cameras, DenseOptions()).height_map
    error = height_error(found, cameras.motion, cameras.reference, truth)
    true = error.true_um[..., 2]
    height = error.error_um + true
    low, high = np.nanpercentile(true, [10, 90])
    rises = [
        rise
        for row, profile in zip(true, height, strict=True)
        for rise in _rises(row, profile, float(low), float(high))
    ]
    quartiles = np.percentile(rises, [25, 50, 75, 90])
    return {"walls": len(rises), "rise_px_25_50_75_90_percent": quartiles.round(2).tolist()}


def measure_disjoint(name: str) -> dict[str, Any]:
    """Heights of a measured series from disjoint pairs of its views: median and rms of what they differ by, px."""
    import itertools

    import numpy as np

    import semscape
    from semscape.dense.surface import dense_surface
    from semscape.options import DenseOptions

    series = semscape.load_series(real_set_folder(name))
    cameras = semscape.reconstruct(series, rng=0).reconstruction
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
    for one, other in splits:
        first, second = (
            dense_surface(series.select(pair, "a pair"), _only(cameras, pair), DenseOptions()).height_map.height_um
            for pair in (one, other)
        )
        difference = (first - second)[np.isfinite(first - second)] / series.pixel_size_um[cameras.reference]
        difference = np.abs(difference - np.median(difference))
        kept = np.sort(difference)[: int(_TRIM * difference.size)]
        rows.append(
            {
                "pairs": [list(one), list(other)],
                "median_px": round(float(np.median(difference)), 3),
                "trimmed_rms_px": round(float(np.sqrt(np.mean(kept**2))), 3),
                "compared": round(difference.size / first.size, 3),
            }
        )
    return {"disjoint": rows}


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


def _errors(height_map: HeightMap, cameras: Reconstruction, truth: SimulationTruth) -> dict[str, Any]:
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
        "completeness": round(float(np.isfinite(height_map.height_um[found.seen]).mean()), 4),
    }
    sigma = height_map.uncertainty_um / pixel
    if np.isfinite(sigma).any():
        within = (error < sigma)[known]
        edges = np.quantile(sigma[known], np.linspace(0, 1, _BINS + 1))
        bin_of = np.digitize(sigma[known], edges[1:-1])
        figures["within_1_sigma"] = round(float(within.mean()), 3)
        figures["within_1_sigma_by_bin"] = [
            round(float(within[bin_of == i].mean()), 3) for i in range(_BINS) if (bin_of == i).any()
        ]
    return figures


def _rises(true: FloatArray, profile: FloatArray, low: float, high: float) -> list[float]:
    """Return the widths, in px along a row, over which a profile goes from 10 to 90 % at each wall of the truth."""
    import numpy as np

    step = high - low
    at = np.flatnonzero(np.abs(np.diff(true)) > 0.5 * step)
    widths = []
    for wall in at[(at > 20) & (at < len(true) - 21)]:
        piece = (profile[wall - 15 : wall + 17] - low) / step
        if not np.isfinite(piece).all():
            continue
        piece = piece if true[wall + 1] > true[wall] else piece[::-1]
        below, above = np.flatnonzero(piece < 0.1), np.flatnonzero(piece > 0.9)
        if below.size and above.size and above.max() > below.max():
            end = int(above[above > below.max()].min())
            widths.append(float(end - below.max()))
    return widths
