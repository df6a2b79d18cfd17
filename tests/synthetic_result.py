"""A small result built by hand, without any stage of the pipeline."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from semscape.options import Options
from semscape.types import (
    HeightMap,
    Keypoints,
    LengthUnit,
    Matches,
    Micrograph,
    Motion,
    Observations,
    Reconstruction,
    Report,
    Result,
    SemMetadata,
    StageReport,
    SurfaceMesh,
    TiltSeries,
    TwoViewGeometry,
)

TILT_DEG = np.array([-3.02, 0.01, 2.99])


def make_result(unit: LengthUnit = "um", size: tuple[int, int] = (60, 80), n_points: int = 300) -> Result:
    """Return a result of three views of a bumpy surface; every number in it is arbitrary but consistent."""
    rng = np.random.default_rng(7)
    rows, columns = size
    pixel = 0.05 if unit == "um" else 1.0
    metadata = SemMetadata(pixel_size_um=pixel if unit == "um" else np.nan, vendor="Zeiss")
    names = ("grain_a.tif", "grain_b.tif", "grain_c.tif")

    y, x = np.mgrid[:rows, :columns].astype(float)
    centres = rng.uniform(0, 1, (12, 2)) * (columns, rows)
    heights = sum(np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * (0.08 * columns) ** 2)) for cx, cy in centres) * (
        0.2 * columns * pixel
    )
    heights = heights + rng.normal(0, 0.02 * pixel, size)
    heights[: rows // 8, -columns // 8 :] = np.nan
    texture = (90 + 120 * np.nan_to_num(heights) / np.nanmax(heights) + rng.normal(0, 9, size)).astype(np.float32)
    views = tuple(
        Micrograph(name, np.roll(texture, shift, axis=1), np.ones(size, dtype=bool), metadata, digest="ab" * 32)
        for name, shift in zip(names, (-1, 0, 1), strict=True)
    )
    series = TiltSeries(views)

    xy = rng.uniform(0, 1, (n_points, 2)) * (columns - 8, rows - 4) + (4, 2)
    z = np.nan_to_num(heights[xy[:, 1].astype(int), xy[:, 0].astype(int)])
    keypoints = []
    for tilt in np.deg2rad(TILT_DEG):
        moved = xy + np.stack([z / pixel * np.sin(tilt), np.zeros(n_points)], axis=1) + rng.normal(0, 0.1, xy.shape)
        one = np.ones(n_points)
        keypoints.append(Keypoints(moved, one, one, one, np.zeros((n_points, 4), np.float32), "sift"))
    matches, geometries = [], []
    for pair in ((0, 1), (0, 2), (1, 2)):
        index = np.arange(n_points)
        inliers = rng.uniform(size=n_points) < 0.94
        matches.append(Matches(pair, np.stack([index, index], axis=1), np.ones(n_points)))
        residual = np.abs(rng.normal(0, 0.2, n_points))
        log10_nfa = -900.0 - pair[1]
        geometries.append(TwoViewGeometry(pair, "affine", np.eye(3), inliers, residual, 0.83, log10_nfa, 500))

    motion = Motion(
        axis_angle_rad=np.deg2rad(90.2),
        tilt_rad=np.deg2rad(TILT_DEG),
        roll_rad=np.deg2rad([0.02, 0.0, -0.05]),
        scale_px_per_um=np.array([1.001, 1.0, 0.9993]) / pixel,
        anisotropy=np.array([2e-4, 0, -1e-4]),
        translation_px=np.array([[columns / 2, rows / 2]] * 3),
    )
    point = np.repeat(np.arange(n_points), 3)
    observations = Observations(
        np.tile(np.arange(3), n_points), point, np.stack([k.xy for k in keypoints], axis=1).reshape(-1, 2)
    )
    points = np.stack([(xy[:, 0] - columns / 2) * pixel, (rows / 2 - xy[:, 1]) * pixel, z], axis=1)
    sigma = np.array([3e-3] + [4e-4, 2e-4, 3e-4, 5e-4, 0.01, 0.01] * 3)
    reconstruction = Reconstruction(
        motion=motion,
        points_um=points,
        points_sigma_um=np.full(n_points, 0.3 * pixel),
        observations=observations,
        residual_px=rng.normal(0, 0.15, (3 * n_points, 2)),
        weights=np.ones(3 * n_points),
        covariance=np.diag(sigma**2),
        tilt_sigma_rad=np.full(3, 4e-4),
        tilt_prior_rad=np.deg2rad([-3.0, 0.0, 3.0]),
        tilt_source="metadata",
        height_scale_relative_sigma=0.0057,
        ambiguity="none",
        relief_confidence=np.nan,
        rms_px=0.2143,
        reference=1,
        length_unit=unit,
    )
    world_from_grid = np.diag([pixel, -pixel, 1.0, 1.0])
    world_from_grid[:2, 3] = (-columns / 2 * pixel, rows / 2 * pixel)
    uncertainty = np.where(np.isfinite(heights), 0.3 * pixel * (1 + 0.5 * np.sin(x / 9) ** 2), np.nan)
    height_map = HeightMap(
        height_um=heights,
        uncertainty_um=uncertainty,
        n_views=np.where(np.isfinite(heights), 3, 0).astype(np.uint8),
        texture=texture,
        pixel_size_um=pixel,
        world_from_grid=world_from_grid,
        length_unit=unit,
        lateral_period_um=np.where(np.isfinite(heights), 12 * pixel, np.nan).astype(np.float32),
    )
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 10.0 * pixel
    mesh = SurfaceMesh(
        vertices_um=np.column_stack([corner, [0.0, 0.1 * pixel, 0.3 * pixel, 0.2 * pixel]]),
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
        color=np.array([[10, 10, 10], [90, 90, 90], [200, 200, 200], [255, 255, 255]], dtype=np.uint8),
        length_unit=unit,
    )
    return Result(
        series, tuple(keypoints), tuple(matches), tuple(geometries), reconstruction, height_map, mesh, _report(unit)
    )


def with_report(result: Result, **changes: Any) -> Result:
    return replace(result, report=replace(result.report, **changes))


def with_reconstruction(result: Result, **changes: Any) -> Result:
    return replace(result, reconstruction=replace(result.reconstruction, **changes))


def _report(unit: LengthUnit) -> Report:
    names = ["grain_a.tif", "grain_b.tif", "grain_c.tif"]
    return Report(
        stages=(
            StageReport("detect", 1.83, {"keypoints": [11204, 11530, 10988]}),
            StageReport("match", 2.4, {"pairs": [[0, 1], [1, 2]], "matches": 21034}),
            StageReport("robust", 0.31, {"inliers": 19702, "threshold_px": 0.83}),
            StageReport("sfm", 4.2, {"n_tracks": 9004, "rms_px": 0.2143}),
            StageReport("dense", 11.6, {"completeness": 0.934}),
        ),
        options=Options().to_dict(),
        seed=0,
        versions={"semscape": "0.1.0", "numpy": "2.4.6", "python": "3.11.9"},
        inputs=tuple(
            {
                "name": name,
                "digest": "ab" * 32,
                "vendor": "Zeiss",
                "pixel_size_um": 0.05 if unit == "um" else np.nan,
                "tilt_deg": tilt,
                "data_bar_rows": 64,
                "source": {"tilt_rad": "file", "pixel_size_um": "user"},
            }
            for name, tilt in zip(names, (-3.0, 0.0, 3.0), strict=True)
        ),
        pairs=tuple(
            {
                "pair": [first, second],
                "names": [names[first], names[second]],
                "matches": 7011,
                "inliers": 6567,
                "threshold_px": 0.83,
                "log10_nfa": -9012.4,
                "tracks": 6011,
                "trials": 500,
            }
            for first, second in ((0, 1), (0, 2), (1, 2))
        ),
        metrics={
            "rms_px": 0.2143,
            "n_points": 9004,
            "mean_track_length": 2.81,
            "completeness": 0.934,
            "height_scale_relative_sigma_95": 0.0112,
            f"median_uncertainty_{unit}": 0.0151,
        },
        warnings=("grain_c.tif: multi-page TIFF, only its first page was read",),
        failures=(),
        verdict="good: heights to +-1.1% (95 %), residual 0.21 px rms",
        peak_memory_mb=812.0,
    )
