"""The truth on disk explains the images on disk: projection written out anew, from docs/simulator.md alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from scipy.ndimage import map_coordinates

from semscape.io.simulated import write_simulated_series
from semscape.simulate import PRESETS, simulate

# Texture alone, for shading moves with the tilt; every fault of the motion, and large.
OPTIONS = replace(
    PRESETS["ideal"],
    tilts_deg=(-12.0, 0.0, 12.0),
    width_px=144,
    height_px=128,
    texture=0.3,
    texture_px=24.0,
    texture_bump=0.0,
    detector_asymmetry=0.0,
    cavity=0.0,
    edge_gain=0.0,
    yield_saturation=1000.0,
    roll_deg=5.0,
    anisotropy=0.03,
    skew=0.03,
    scale_drift=0.03,
    stage_error_deg=2.0,
    shift_px=5.0,
)


def project(points_um: np.ndarray, told: dict[str, Any], view: dict[str, Any]) -> np.ndarray:
    """Image points (N, 3): x = s [[1, k], [0, 1]] diag(1 + a/2, 1 - a/2) p(R X) + t."""
    axis, tilt, roll = np.deg2rad([told["axis_deg"], view["true_tilt_deg"], view["roll_deg"]])
    along = np.array([np.cos(axis), np.sin(axis), 0.0])
    # Rodrigues' rotation of the points, then y and z down, then the roll of x towards y.
    turned = (
        points_um * np.cos(tilt)
        + np.cross(along, points_um) * np.sin(tilt)
        + np.outer(points_um @ along, along) * (1 - np.cos(tilt))
    )
    x, y, depth = turned[:, 0], -turned[:, 1], -turned[:, 2]
    x, y = x * np.cos(roll) - y * np.sin(roll), x * np.sin(roll) + y * np.cos(roll)
    if told["working_distance_um"] is not None:
        nearer = told["working_distance_um"] / (told["working_distance_um"] + depth)
        x, y = x * nearer, y * nearer
    x, y = (1 + view["anisotropy"] / 2) * x, (1 - view["anisotropy"] / 2) * y
    imaged: np.ndarray = view["scale_px_per_um"] * np.column_stack([x + view["skew"] * y, y])
    return imaged + view["translation_px"]


def misfit(folder: Path, told: dict[str, Any], view: dict[str, Any]) -> float:
    """Median difference of grey levels between a view and the middle one, over the points that both show."""
    with np.load(folder / "truth.npz") as truth:
        height, visible, world_from_grid = (truth[key] for key in ("height_um", "visible", "world_from_grid"))
    rows, cols = np.indices(height.shape)
    grid = np.stack([cols, rows, height, np.ones(height.shape)], axis=-1)
    index = [each["name"] for each in told["views"]].index(view["name"])
    both = visible[1] & visible[index]
    assert both.mean() > 0.5
    points = grid[both] @ world_from_grid[:3].T
    grey = []
    for each in (told["views"][1], view):
        x, y = project(points, told, each).T
        grey.append(map_coordinates(tifffile.imread(folder / each["name"]).astype(float), [y, x], order=3))
    return float(np.median(np.abs(grey[0] - grey[1])))


@pytest.mark.parametrize(
    "changes",
    [
        {"axis_deg": 90.0},
        {"axis_deg": 30.0, "scan_rotation_deg": 47.0},
        {"axis_deg": 0.0, "scan_rotation_deg": 200.0, "working_distance_um": 36.0},
    ],
    ids=["parallel, usual axis", "oblique axis", "perspective, scan turned over"],
)
def test_the_truth_on_disk_explains_the_images_on_disk(tmp_path: Path, changes: dict[str, float]) -> None:
    options = replace(OPTIONS, **changes)
    folder = write_simulated_series(tmp_path / "series", *simulate("fracture", options, rng=8))
    told = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    for view in (told["views"][0], told["views"][2]):
        found = misfit(folder, told, view)
        assert found < 1.0
        # Each number matters, and so does its sign.
        for key in ("true_tilt_deg", "roll_deg", "anisotropy", "skew"):
            if abs(view[key]) > 0.01:
                assert misfit(folder, told, view | {key: -view[key]}) > 2 * found, key
        if told["working_distance_um"] is not None:
            assert misfit(folder, told | {"working_distance_um": None}, view) > 2 * found
