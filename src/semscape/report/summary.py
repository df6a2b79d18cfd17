"""Assemble the report of a run from the values of its stages."""

from __future__ import annotations

import importlib.metadata
import platform
from typing import Any

import numpy as np

from semscape.io.inspect import bar_rows
from semscape.options import Options
from semscape.report.memory import peak_memory_mb
from semscape.report.wording import Z_95
from semscape.types import (
    HeightMap,
    Keypoints,
    Matches,
    Observations,
    Reason,
    Reconstruction,
    Report,
    StageReport,
    TiltSeries,
    TwoViewGeometry,
)

_PACKAGES = ("semscape", "numpy", "scipy", "opencv-contrib-python-headless", "numba", "tifffile", "trimesh")
GOOD_HEIGHT_SCALE, USABLE_HEIGHT_SCALE = 0.05, 0.25
_GOOD_RMS_PX = 0.7
_LEAST_COMPLETENESS = 0.25


def build_report(
    series: TiltSeries,
    reconstruction: Reconstruction,
    height_map: HeightMap,
    *,
    stages: tuple[StageReport, ...],
    pairs: tuple[dict[str, Any], ...],
    keypoints: tuple[Keypoints, ...],
    options: Options,
    failures: tuple[str, ...],
) -> Report:
    """Return the report of a finished run: figures, verdict, and all that is needed to repeat it."""
    metrics = _metrics(series, reconstruction, height_map, keypoints)
    return Report(
        stages=stages,
        options=options.to_dict(),
        seed=options.run.seed,
        versions=_versions(),
        inputs=_inputs(series, keypoints),
        pairs=pairs,
        metrics=metrics,
        warnings=(*series.warnings, *reconstruction.contradictions, *reconstruction.warnings),
        failures=failures,
        verdict=_verdict(reconstruction, metrics),
        peak_memory_mb=_peak_memory_mb(stages),
    )


def pair_figures(
    series: TiltSeries,
    matches: tuple[Matches, ...],
    geometries: tuple[TwoViewGeometry, ...],
    observations: Observations,
) -> tuple[dict[str, Any], ...]:
    """Return per pair: matches, inliers, the threshold that the a contrario method chose, and shared tracks."""
    seen = np.zeros((series.n_views, observations.n_points), dtype=bool)
    seen[observations.view, observations.point] = True
    return tuple(
        {
            "pair": list(found.pair),
            "names": [series.names[index] for index in found.pair],
            "matches": len(found),
            "inliers": int(geometry.inliers.sum()),
            "threshold_px": geometry.threshold_px,
            "log10_nfa": geometry.log10_nfa,
            "model": geometry.kind,
            "log10_nfa_margin": geometry.nfa_margin,
            "planar": geometry.planar,
            "tracks": int((seen[found.pair[0]] & seen[found.pair[1]]).sum()),
            "trials": geometry.n_trials,
        }
        for found, geometry in zip(matches, geometries, strict=True)
    )


def _metrics(
    series: TiltSeries, reconstruction: Reconstruction, height_map: HeightMap, keypoints: tuple[Keypoints, ...]
) -> dict[str, Any]:
    observations = reconstruction.observations
    known = np.isfinite(height_map.height_um)
    heights = height_map.height_um[known]
    low, high = np.percentile(heights, [0.1, 99.9]) if known.any() else (np.nan, np.nan)
    return {
        "n_views": series.n_views,
        "n_keypoints": sum(len(found) for found in keypoints),
        "n_points": observations.n_points,
        "n_observations": len(observations.view),
        "mean_track_length": len(observations.view) / max(observations.n_points, 1),
        "rms_px": reconstruction.rms_px,
        "height_scale_relative_sigma": reconstruction.height_scale_relative_sigma,
        "height_scale_relative_sigma_95": Z_95 * reconstruction.height_scale_relative_sigma,
        "height_range": float(high - low),
        "height_min": float(low),
        "height_max": float(high),
        "completeness": float(known.mean()),
        "completeness_specimen": float(known[height_map.specimen].mean()) if height_map.specimen.any() else np.nan,
        "unknown": reason_shares(height_map),
        "median_uncertainty": float(np.median(height_map.uncertainty_um[known])) if known.any() else np.nan,
        "median_lateral_period": float(np.median(height_map.lateral_period_um[known])) if known.any() else np.nan,
        "pixel_size": height_map.pixel_size_um,
    }


def reason_shares(height_map: HeightMap) -> dict[str, float]:
    """Return by the lower-case name of each reason the share of the field that is unknown for it, where it occurs."""
    count = np.bincount(height_map.reason.ravel(), minlength=256)
    size = max(height_map.reason.size, 1)
    return {
        reason.name.lower(): float(count[reason]) / size
        for reason in Reason
        if reason is not Reason.KNOWN and count[reason]
    }


def _verdict(reconstruction: Reconstruction, metrics: dict[str, Any]) -> str:
    """Say in plain words what the result may be used for."""
    if reconstruction.contradictions:
        return f"do not measure: the images contradict what was told of them. {reconstruction.contradictions[0]}"
    scale = Z_95 * reconstruction.height_scale_relative_sigma
    if np.isnan(scale):
        return "do not measure: nothing tells how well the tilts are known, and with them the height scale"
    if scale > USABLE_HEIGHT_SCALE:
        return (
            f"do not measure: the height scale is known to +-{scale:.0%} (95 %) only; shape and proportions in the "
            "image plane are right, heights are not"
        )
    if metrics["completeness_specimen"] < _LEAST_COMPLETENESS:
        return f"do not measure: heights are known on {metrics['completeness_specimen']:.0%} of the specimen only"
    if reconstruction.ambiguity != "none":
        return (
            f"usable: heights to +-{scale:.0%} (95 %) from self-calibrated tilts, and the sign of the relief is "
            "assumed from its shading; stage tilts would settle both"
        )
    if reconstruction.relief_confidence < 0.5:
        return (
            f"usable: heights to +-{scale:.1%} (95 %), but the shading contradicts the sign of the tilts: if hills "
            "come out as pits, give the tilts with the opposite signs"
        )
    if scale > GOOD_HEIGHT_SCALE or reconstruction.rms_px > _GOOD_RMS_PX:
        return f"usable: heights to +-{scale:.1%} (95 %), residual {reconstruction.rms_px:.2f} px rms"
    return f"good: heights to +-{scale:.1%} (95 %), residual {reconstruction.rms_px:.2f} px rms"


def _peak_memory_mb(stages: tuple[StageReport, ...]) -> float:
    """Return the most memory in any stage: a process that serves many runs has a peak of its own, not the run's."""
    known = [stage.peak_memory_mb for stage in stages if np.isfinite(stage.peak_memory_mb)]
    return max(known) if known else peak_memory_mb()


def _inputs(series: TiltSeries, keypoints: tuple[Keypoints, ...]) -> tuple[dict[str, Any], ...]:
    return tuple(
        {
            "name": view.name,
            "digest": view.digest,
            "vendor": view.metadata.vendor,
            "pixel_size_um": view.metadata.pixel_size_um,
            "tilt_deg": float(np.rad2deg(view.metadata.tilt_rad)),
            "data_bar_rows": bar_rows(view),
            "keypoints": len(found),
            "source": dict(view.metadata.source),
        }
        for view, found in zip(series.views, keypoints, strict=True)
    )


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "unknown"
    return versions
