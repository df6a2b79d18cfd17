"""Accuracy on measured and simulated series, as one JSON table on stdout (`make accuracy`).

Measured series have no truth: the table tells what can be checked without one (equal tilt steps, residuals,
inliers). Completeness is told over the field and over the specimen. The specimen is, in the reference view,
whose grid the height map shares:

- quartz, dsa: the largest component, holes filled, of the Gaussian-blurred (8 px) image above its Otsu threshold:
  the specimen is bright and its support dark;
- potamogeton1: a disc drawn by hand on the image, centre (412, 357) px, radius 300 px: the grain lies on a support
  that is as bright as itself. The disc leaves out the outermost rim, which curves away from the beam.

Simulated series are compared with their exact truth (see semscape.evaluate), beside OpenCV's StereoSGBM and DIS flow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from accuracy_dense import measure_disjoint, measure_stereo, measure_surface, small_gaps
from isolated import REAL_SETS, Case, peak_memory_mb, real_set_folder, run_cases, timed

if TYPE_CHECKING:
    import numpy as np

    from semscape.types import BoolArray, HeightMap, ImageArray

_BLUR_PX = 8.0
_DISCS = {"potamogeton1": ((412.0, 357.0), 300.0)}
_SURFACES = ("fracture", "spheres", "vickers", "grating", "pollen", "step")
_SIMULATED = (("fracture", 0), ("fracture", 1), ("fracture", 2), ("spheres", 0), ("pollen", 0))


def measure_real(name: str) -> dict[str, Any]:
    """Reconstruct a measured series without any option and return its row of the table."""
    import numpy as np

    import semscape

    series = semscape.load_series(real_set_folder(name))
    result, seconds = timed(semscape.reconstruct, series, rng=0)
    reconstruction, height_map = result.reconstruction, result.height_map
    tilt = np.rad2deg(reconstruction.motion.tilt_rad)
    sigma = np.rad2deg(reconstruction.tilt_sigma_rad)
    known = np.isfinite(height_map.height_um)
    specimen = specimen_mask(name, series.views[reconstruction.reference].image)
    unit = reconstruction.length_unit
    return {
        "views": list(series.names),
        "tilts_deg": tilt.round(4).tolist(),
        "tilt_sigmas_deg": sigma.round(4).tolist(),
        "tilt_steps_deg": np.abs(np.diff(tilt)).round(4).tolist(),
        "axis_deg": round(float(np.rad2deg(reconstruction.motion.axis_angle_rad)), 3),
        "tilt_source": reconstruction.tilt_source,
        "height_scale_relative_sigma": round(reconstruction.height_scale_relative_sigma, 5),
        "relief_confidence": round(reconstruction.relief_confidence, 6),
        "rms_px": round(reconstruction.rms_px, 4),
        "n_tracks": len(reconstruction.points_um),
        "pairs": [
            {key: pair[key] for key in ("pair", "matches", "inliers")}
            | {"threshold_px": round(pair["threshold_px"], 3)}
            for pair in result.report.pairs
        ],
        "completeness": round(float(known.mean()), 4),
        "completeness_specimen": round(float(known[specimen].mean()), 4),
        "specimen_share": round(float(specimen.mean()), 4),
        "small_gaps": small_gaps(height_map.height_um),
        f"height_range_{unit}": round(result.report.metrics["height_range"], 4),
        f"height_range_specimen_{unit}": _range(height_map.height_um[specimen & known]),
        f"median_uncertainty_{unit}": round(result.report.metrics["median_uncertainty"], 4),
        f"pixel_size_{unit}": round(height_map.pixel_size_um, 6),
        "seconds": round(seconds, 2),
        "peak_memory_mb": round(peak_memory_mb(), 1),
    }


def measure_simulated(specimen: str, seed: int) -> dict[str, Any]:
    """Simulate a series at nominal settings, reconstruct it and compare it with its truth."""
    import semscape
    from semscape.dense.rival import dis_height_map, sgbm_height_map
    from semscape.evaluate.height_errors import height_error, height_figures, true_units
    from semscape.evaluate.motion_errors import tilt_figures
    from semscape.simulate import PRESETS, simulate

    series, truth = simulate(specimen, PRESETS["nominal"], rng=seed)
    result, seconds = timed(semscape.reconstruct, series, rng=0)
    peak = peak_memory_mb()
    rival, rival_seconds = timed(sgbm_height_map, result)
    flow, flow_seconds = timed(dis_height_map, result)
    reconstruction = result.reconstruction
    view = reconstruction.motion, reconstruction.reference
    units = true_units(result.height_map, truth)

    def against_truth(height_map: HeightMap) -> dict[str, Any]:
        return height_figures(height_map, height_error(height_map, *view, truth), units)

    return {
        "specimen": specimen,
        "preset": "nominal",
        "seed": seed,
        "relief_px": round(units.relief_um / units.pixel_size_um, 1),
        "rms_px": round(reconstruction.rms_px, 4),
        **tilt_figures(*view, truth),
        "height_scale_relative_sigma": round(reconstruction.height_scale_relative_sigma, 5),
        "semscape": against_truth(result.height_map) | {"surface_seconds": round(_stage_seconds(result, "surface"), 2)},
        "opencv_sgbm": against_truth(rival) | {"surface_seconds": round(rival_seconds, 2)},
        "opencv_dis": against_truth(flow) | {"surface_seconds": round(flow_seconds, 2)},
        "seconds": round(seconds, 2),
        "peak_memory_mb": round(peak, 1),
    }


def specimen_mask(name: str, image: ImageArray) -> BoolArray:
    """Return where the specimen of a measured series is, (H, W) bool; the rules stand at the head of this file."""
    import cv2
    import numpy as np
    from scipy.ndimage import binary_fill_holes, label

    if name in _DISCS:
        (x, y), radius = _DISCS[name]
        rows, cols = np.indices(image.shape)
        disc: BoolArray = np.hypot(cols - x, rows - y) <= radius
        return disc
    smooth = np.clip(cv2.GaussianBlur(image, (0, 0), _BLUR_PX), 0, 255).astype(np.uint8)
    threshold, _ = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    component, _ = label(smooth > threshold)
    sizes = np.bincount(component.ravel())
    sizes[0] = 0
    filled: BoolArray = binary_fill_holes(component == sizes.argmax())
    return filled


def _range(heights: np.ndarray) -> float:
    import numpy as np

    low, high = np.percentile(heights, [0.1, 99.9])
    return round(float(high - low), 4)


def _stage_seconds(result: Any, name: str) -> float:
    return float(sum(stage.seconds for stage in result.report.stages if stage.name == name))


CASES: dict[str, Case] = {name: (measure_real, (name,)) for name in REAL_SETS} | {
    f"{specimen}-{seed}": (measure_simulated, (specimen, seed)) for specimen, seed in _SIMULATED
}
CASES |= {f"surface-{specimen}": (measure_surface, (specimen, 0)) for specimen in _SURFACES}
CASES |= {"stereo": (measure_stereo, ())}
CASES |= {f"disjoint-{name}": (measure_disjoint, (name,)) for name in REAL_SETS}

if __name__ == "__main__":
    run_cases(CASES, "Accuracy on measured and simulated series, as JSON.")
