"""Simulated series beside measured ones, figure by figure (`make simulator-realism`).

Every figure of a simulated series is measured as that of a measured one: by the same reconstruction, without any
option, over the specimen's area in the reference view. That holds for the roughness too, for a reconstructed surface
holds stereo noise that the true one does not. Without names on the command line the table goes into
docs/simulator.md.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

import semscape
from accuracy import specimen_mask
from isolated import REAL_SETS, REPOSITORY, absent, real_set_folder
from semscape.simulate import PRESETS, SPECIMENS, simulate
from semscape.types import BoolArray, FloatArray, ImageArray, Result

PAGE = REPOSITORY / "docs" / "simulator.md"
BEGIN, END = "<!-- realism: begin -->", "<!-- realism: end -->"
# Two of the three measured sets have these tilts.
TILTS_DEG = (-5.0, 0.0, 5.0)
SCALES_PX = (1, 2, 4, 8, 16)
_PATCH_RADIUS = 7
_MAX_PATCHES = 1200
_MAD = 1.4826

_ROWS = {
    "median_grey": "median grey level",
    "grey_spread": "grey levels, 5 to 95 %",
    "saturated_percent": "black or white (%)",
    "sift_per_megapixel": "SIFT keypoints per megapixel",
    "match_percent": "matched keypoints, neighbouring views (%)",
    "inlier_percent": "inliers among them (%)",
    "threshold_px": "threshold chosen a contrario (px)",
    "rms_px": "residual rms (px)",
    "fine_noise_percent": "finest noise (% of the grey levels' std)",
    "misfit_percent": "misfit of registered patches (% of their std)",
    "gain_spread_percent": "local contrast from view to view, spread (%)",
    "completeness_percent": "completeness (%)",
} | {f"roughness_{scale}_px": f"roughness at {scale} px (px), reconstructed" for scale in SCALES_PX}
_TRUE_ROWS = {f"true_roughness_{scale}_px": f"roughness at {scale} px (px), true" for scale in SCALES_PX}


def measure(name: str) -> dict[str, float]:
    """Return the figures of a measured series, or of a specimen under nominal settings."""
    if name in REAL_SETS:
        series, truth = semscape.load_series(real_set_folder(name)), None
    else:
        series, truth = simulate(name, replace(PRESETS["nominal"], tilts_deg=TILTS_DEG), rng=0)
    result = semscape.reconstruct(series, rng=0)
    image = series.views[result.reconstruction.reference].image
    area = specimen_mask(name, image) if name in REAL_SETS else np.ones(image.shape, dtype=np.bool_)
    grey = image[area]
    height = result.height_map.height_um / result.height_map.pixel_size_um
    figures = {
        "median_grey": float(np.median(grey)),
        "grey_spread": float(np.subtract(*np.percentile(grey, [95, 5]))),
        "saturated_percent": 100 * float(((grey <= 0) | (grey >= 255)).mean()),
        "sift_per_megapixel": 1e6 * _sift_count(image, area) / int(area.sum()),
        **_matching(result, area),
        "rms_px": result.reconstruction.rms_px,
        "fine_noise_percent": 100 * fine_noise(image, area) / float(grey.std()),
        **_patches(result),
        "completeness_percent": 100 * float(np.isfinite(height[area]).mean()),
    }
    figures |= {f"roughness_{scale}_px": roughness(height, area, scale) for scale in SCALES_PX}
    if truth is not None:
        true_height = truth.height_um / truth.pixel_size_um
        figures |= {f"true_roughness_{scale}_px": roughness(true_height, area, scale) for scale in SCALES_PX}
    return {key: float(f"{value:.4g}") for key, value in figures.items()}


def roughness(height_px: FloatArray, area: BoolArray, scale_px: float) -> float:
    """Return the robust rms of a height map between Gaussians of `scale_px` and twice that, in px.

    Only places count where nearly all of the wider Gaussian's weight is known.
    """
    known = area & np.isfinite(height_px)
    filled = np.where(known, height_px, 0.0)
    smooth = []
    for sigma in (scale_px, 2 * scale_px):
        weight = ndimage.gaussian_filter(known.astype(np.float64), sigma)
        smooth.append(ndimage.gaussian_filter(filled, sigma) / np.maximum(weight, 1e-9))
    band = (smooth[0] - smooth[1])[known & (weight > 0.98)]
    return _MAD * float(np.median(np.abs(band))) if band.size else math.nan


def fine_noise(image: ImageArray, area: BoolArray) -> float:
    """Return the noise of an image in grey levels, from its second mixed differences (Immerkaer 1996).

    J. Immerkaer, "Fast noise variance estimation", CVIU 64 (1996) 300, doi:10.1006/cviu.1996.0060. Fine texture counts
    as noise, and noise that a file's compression took away does not.
    """
    kernel = np.outer([1, -2, 1], [1, -2, 1]) / 6.0
    mixed = ndimage.convolve(image.astype(np.float64), kernel)
    return _MAD * float(np.median(np.abs(mixed[area])))


def _sift_count(image: ImageArray, area: BoolArray) -> int:
    return len(cv2.SIFT_create().detect(np.clip(image, 0, 255).astype(np.uint8), area.astype(np.uint8)))


def _matching(result: Result, area: BoolArray) -> dict[str, float]:
    """Return how many keypoints on the specimen match between neighbouring views, and how well."""
    rates, inliers, thresholds = [], [], []
    for matches, geometry in zip(result.matches, result.geometries, strict=True):
        first, second = matches.pair
        if second != first + 1:
            continue
        row_col = np.rint(result.keypoints[first].xy[:, ::-1]).astype(int)
        on = area[np.clip(row_col[:, 0], 0, len(area) - 1), np.clip(row_col[:, 1], 0, area.shape[1] - 1)]
        matched = on[matches.indices[:, 0]]
        rates.append(matched.sum() / on.sum())
        inliers.append(geometry.inliers[matched].mean())
        thresholds.append(geometry.threshold_px)
    return {
        "match_percent": 100 * float(np.mean(rates)),
        "inlier_percent": 100 * float(np.mean(inliers)),
        "threshold_px": float(np.mean(thresholds)),
    }


def _patches(result: Result) -> dict[str, float]:
    """Compare patches around tracks in the reference view with the neighbouring view's, registered by an affine map.

    What is left holds the noise of two views and every change of the signal that no gain, offset or affine map
    explains; it is told per view.
    """
    reference = result.reconstruction.reference
    other = reference - 1 if reference > 0 else reference + 1
    at = _shared_places(result, reference, other)
    image = result.series.views[reference].image.astype(np.float64)
    spline = ndimage.spline_filter(result.series.views[other].image.astype(np.float64), 3)
    step = np.arange(-_PATCH_RADIUS, _PATCH_RADIUS + 1)
    dx, dy = np.meshgrid(step, step)
    misfit, gains = [], []
    for x, y, u, v in at:
        patch = image[int(y) - _PATCH_RADIUS : int(y) + _PATCH_RADIUS + 1, int(x) - _PATCH_RADIUS :][:, : len(step)]
        if patch.shape != dx.shape or min(x, y) < _PATCH_RADIUS:
            continue
        gain, left = _register(patch, spline, u, v, dx, dy)
        misfit.append(left / patch.std())
        gains.append(gain)
    low, high = np.percentile(gains, [16, 84])
    return {
        "misfit_percent": 100 * float(np.median(misfit)),
        "gain_spread_percent": 100 * float(high - low) / 2,
    }


def _shared_places(result: Result, reference: int, other: int) -> FloatArray:
    """Return (N, 4): whole px in the reference view, and where the other view shows the same places."""
    observations, weights = result.reconstruction.observations, result.reconstruction.weights
    used = weights > 0
    places = []
    for view in (reference, other):
        mine = used & (observations.view == view)
        places.append(dict(zip(observations.point[mine].tolist(), observations.xy[mine], strict=True)))
    common = sorted(places[0].keys() & places[1].keys())
    common = common[:: max(1, len(common) // _MAX_PATCHES)]
    whole = np.array([np.rint(places[0][point]) for point in common])
    moved = np.array([places[1][point] - places[0][point] for point in common])
    return np.hstack([whole, whole + moved])


def _register(
    patch: FloatArray, spline: FloatArray, u: float, v: float, dx: FloatArray, dy: FloatArray
) -> tuple[float, float]:
    """Return gain and misfit per view of a patch against the best affine map, gain and offset of the other image."""
    warp = np.zeros(6)
    for _ in range(4):
        there_x = u + warp[0] + (1 + warp[1]) * dx + warp[2] * dy
        there_y = v + warp[3] + warp[4] * dx + (1 + warp[5]) * dy
        seen = ndimage.map_coordinates(spline, [there_y, there_x], order=3, prefilter=False, mode="nearest")
        along_y, along_x = np.gradient(seen)
        columns = [seen, np.ones_like(seen), along_x, along_x * dx, along_x * dy, along_y, along_y * dx, along_y * dy]
        design = np.stack(columns, axis=-1).reshape(-1, 8)
        fit, *_ = np.linalg.lstsq(design, patch.ravel(), rcond=None)
        if abs(fit[0]) < 0.05:
            break
        warp = warp + np.clip(fit[2:] / fit[0], -0.3, 0.3)
    left = patch.ravel() - design @ fit
    return float(fit[0]), float(np.sqrt((left @ left) / (left.size - 8) / (1 + fit[0] ** 2)))


def table(figures: Mapping[str, Mapping[str, float]]) -> str:
    """Return the table in Markdown; simulated figures within the range of the measured sets are bold."""
    real, made = [*REAL_SETS], [*SPECIMENS]
    lines = [f"| | {' | '.join((*real, *made))} |", f"|---|{'---|' * len((*real, *made))}"]
    for key, label in (_ROWS | _TRUE_ROWS).items():
        measured = [figures[name][key] for name in real if key in figures[name]]
        cells = [_cell(figures[name][key]) if key in figures[name] else "" for name in real]
        for name in made:
            value = figures[name][key]
            within = bool(measured) and min(measured) <= value <= max(measured)
            cells.append(f"**{_cell(value)}**" if within else _cell(value))
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:.3g}"


def write_page(figures: Mapping[str, Mapping[str, float]]) -> None:
    """Put the table between its marks in docs/simulator.md."""
    missing = [name for name in (*REAL_SETS, *SPECIMENS) if name not in figures]
    if missing:
        raise SystemExit(f"the table needs all series; there are no figures of {', '.join(missing)}")
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(f"{before}{BEGIN}\n{table(figures)}\n{END}{after}", encoding="utf-8")


def main(arguments: list[str]) -> None:
    """Print the figures of the cases that are named; without names measure all and write the table into the page.

    `--page FILE...` writes the table from what earlier calls printed.
    """
    figures: dict[str, dict[str, float]] = {}
    if arguments[:1] == ["--page"]:
        for file in arguments[1:]:
            figures |= json.loads(Path(file).read_text(encoding="utf-8"))
        write_page(figures)
        return
    for name in arguments or (*REAL_SETS, *SPECIMENS):
        reason = absent(name) if name in REAL_SETS else None
        print(f"{name}: {reason or 'measuring'}", file=sys.stderr)
        if reason is None:
            figures[name] = measure(name)
    print(json.dumps(figures, indent=1))
    if not arguments:
        write_page(figures)


if __name__ == "__main__":
    main(sys.argv[1:])
