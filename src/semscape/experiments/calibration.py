"""Tilts recovered against tilts set, with their intervals, over many simulated series."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import binom

from semscape.cluster import local_mapper
from semscape.experiments.simulated_tracks import TrackRecipe, simulate_tracks
from semscape.experiments.study import Experiment, Figure, Setting, Table
from semscape.options import SfmOptions
from semscape.report.figures import drawn_png
from semscape.sfm.calibrate import calibrate
from semscape.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

_Z_95 = 1.959964
# 200 of each, which coverage needs, take half an hour: `make motion`, docs/motion.md.
_SERIES = 30
SEVEN = (-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0)
FIVE = (-6.0, -3.0, 0.0, 3.0, 6.0)
THREE = (-6.0, 0.0, 6.0)
ANISOTROPY = SfmOptions().prior_anisotropy
CASES: dict[str, TrackRecipe] = {
    "7 views, images alone": TrackRecipe(SEVEN),
    "5 views, images alone": TrackRecipe(FIVE),
    "3 views, images alone": TrackRecipe(THREE),
    "7 views, stage": TrackRecipe(SEVEN, 0.1),
    "5 views, stage": TrackRecipe(FIVE, 0.1),
    "3 views, stage": TrackRecipe(THREE, 0.1),
    "7 views, images alone, anisotropy": TrackRecipe(SEVEN, anisotropy_sigma=ANISOTROPY),
    "5 views, images alone, anisotropy": TrackRecipe(FIVE, anisotropy_sigma=ANISOTROPY),
    "3 views, images alone, anisotropy": TrackRecipe(THREE, anisotropy_sigma=ANISOTROPY),
    "7 views, stage, anisotropy": TrackRecipe(SEVEN, 0.1, anisotropy_sigma=ANISOTROPY),
    "5 views, stage, anisotropy": TrackRecipe(FIVE, 0.1, anisotropy_sigma=ANISOTROPY),
    "3 views, stage, anisotropy": TrackRecipe(THREE, 0.1, anisotropy_sigma=ANISOTROPY),
}


@dataclass(frozen=True)
class Recovery:
    """One calibrated series against its truth; the sign of a self-calibrated one is taken as the true one.

    `tilt_error_deg`, `tilt_sigma_deg` and `stage_error_deg` are (V,), the steps' (V - 1,). The tilt of a view whose
    tilt is held has a sigma of zero. `height_scale_error` and its sigma are relative.
    """

    tilt_error_deg: FloatArray
    tilt_sigma_deg: FloatArray
    stage_error_deg: FloatArray
    step_error_deg: FloatArray
    step_sigma_deg: FloatArray
    height_scale_error: float
    height_scale_sigma: float
    stage_scale_error: float


def recover(recipe: TrackRecipe, seed: int, options: SfmOptions | None = None) -> Recovery:
    """Simulate a series of tracks, calibrate it and compare it with its truth."""
    tracks = simulate_tracks(recipe, rng=np.random.default_rng([seed, 35]))
    found = calibrate(
        tracks.series, tracks.observations, options or SfmOptions(), rng=np.random.default_rng(seed)
    ).reconstruction
    true, tilt = tracks.motion.tilt_rad, found.motion.tilt_rad
    spread = (true - true.mean()) / ((true - true.mean()) ** 2).sum()
    if found.tilt_source == "self-calibrated":  # a common turn and the sign are a matter of choice
        tilt = tilt * np.sign(tilt @ spread)
        tilt = tilt - tilt[found.reference] + true[found.reference]
    covariance = found.covariance[1::6, 1::6]
    difference = np.diff(np.eye(len(true)), axis=0)
    return Recovery(
        np.rad2deg(tilt - true),
        np.rad2deg(found.tilt_sigma_rad),
        np.rad2deg(found.tilt_prior_rad - true),
        np.rad2deg(difference @ (tilt - true)),
        np.rad2deg(np.sqrt(np.diag(difference @ covariance @ difference.T))),
        float(1 / (tilt @ spread) - 1),
        found.height_scale_relative_sigma,
        float(1 / (found.tilt_prior_rad @ spread) - 1),
    )


def figures_of(recoveries: list[Recovery]) -> dict[str, float | int | None]:
    """Return the figures of a case: rms errors, and how often the 95 % intervals hold the truth."""
    tilt, sigma = _joined(recoveries, "tilt_error_deg"), _joined(recoveries, "tilt_sigma_deg")
    free = sigma > 1e-3
    steps, step_sigma = _joined(recoveries, "step_error_deg"), _joined(recoveries, "step_sigma_deg")
    scale = np.array([one.height_scale_error for one in recoveries])
    scale_sigma = np.array([one.height_scale_sigma for one in recoveries])
    return {
        "series": len(recoveries),
        "tilt_step_rms_error_deg": _rms(steps),
        "tilt_rms_error_deg": _rms(tilt[free]),
        "stage_tilt_rms_error_deg": _rms(_joined(recoveries, "stage_error_deg")),
        "height_scale_rms_error_percent": _rms(100 * scale),
        "height_scale_median_error_percent": _plain(float(np.median(np.abs(100 * scale)))),
        "height_scale_stated_sigma_percent": _rms(100 * scale_sigma),
        "stage_scale_rms_error_percent": _rms(np.array([100 * one.stage_scale_error for one in recoveries])),
        "tilts_in_95_percent": _share(tilt[free], sigma[free]),
        "steps_in_95_percent": _share(steps, step_sigma),
        "height_scale_in_95_percent": _share(scale, scale_sigma),
    }


def _joined(recoveries: list[Recovery], name: str) -> FloatArray:
    return np.concatenate([getattr(one, name) for one in recoveries])


def _rms(values: FloatArray) -> float | None:
    return _plain(float(np.sqrt(np.mean(values**2))))


def _plain(value: float) -> float | None:
    return round(value, 4) if np.isfinite(value) else None


def _share(error: FloatArray, sigma: FloatArray) -> float:
    return round(100 * float(np.mean(np.abs(error) < _Z_95 * sigma)), 1)


def run(setting: Setting) -> Experiment:
    """Calibrate many series of each case."""
    count = 4 if setting.quick else _SERIES
    rows: list[tuple[Any, ...]] = []
    points: list[tuple[Any, ...]] = []
    with local_mapper(setting.workers) as mapper:
        for case, recipe in CASES.items():
            seeds = range(1000 * setting.seed, 1000 * setting.seed + count)
            recoveries = list(mapper(partial(recover, recipe), seeds))
            figures = figures_of(recoveries)
            rows.append((case, *figures.values()))
            points += [
                (case, seed, set_deg, round(set_deg + float(error), 5), round(float(sigma), 5))
                for seed, one in zip(seeds, recoveries, strict=True)
                for set_deg, error, sigma in zip(recipe.tilts_deg, one.tilt_error_deg, one.tilt_sigma_deg, strict=True)
            ]
    table = Table(
        "calibration",
        "Tilts recovered against tilts set",
        ("case", *figures),
        tuple(rows),
        "Step: the difference of neighbouring tilts. The height scale errs as the tilts' spread does. Of views whose "
        "tilt is held nothing is counted.",
    )
    every = Table(
        "tilts",
        "Every tilt",
        ("case", "seed", "set_deg", "recovered_deg", "sigma_deg"),
        tuple(points),
    )
    return Experiment(
        name="calibration",
        title="Tilts recovered against tilts set",
        question="How near do the recovered tilts come to the true ones, and do the stated 95 % intervals hold them? "
        f"{count} simulated series per case: 2000 tracks, 0.3 px noise, 10 % wrong observations, scale drift 0.1 %, "
        f"roll 0.2 deg; stage readings err by 0.1 deg, anisotropy is {100 * ANISOTROPY:g} % where named.",
        thesis="section 3.5: recovered tilt against the stage's; not published here",
        tables=(table, every),
        figures=(
            Figure(
                "calibration",
                "Recovered minus true tilt",
                drawn_png((9.0, 6.5), partial(_draw, every, table)),
                "The errors of the tilts of every series, by the tilt that was set, with the share of 95 % intervals "
                "that hold the truth.",
            ),
        ),
        notes=(_chance(count), *(("Quick run: four series per case.",) if setting.quick else ())),
    )


def _chance(count: int) -> str:
    """Return what chance alone does to the shares that hold the truth."""
    least = 100 * float(binom.ppf(0.025, count, 0.95)) / count
    return (
        f"Errors within a series go together, so a share counts {count} series: exact 95 % intervals would show "
        f"{least:.0f} to 100 % in 19 of 20 cases. docs/motion.md counts over 200 series."
    )


def _draw(every: Table, table: Table, drawing: Drawing) -> None:
    panels = drawing.subplots(4, 3, sharex=True).ravel()
    for axes, row in zip(panels, table.rows, strict=True):
        case = row[0]
        mine = np.array([point[2:] for point in every.rows if point[0] == case])
        jitter = np.linspace(-0.6, 0.6, len(mine))[np.random.default_rng(0).permutation(len(mine))]
        error = mine[:, 1] - mine[:, 0]
        axes.scatter(mine[:, 0] + jitter, error, s=4, color="#2f81d6", alpha=0.35, linewidth=0)
        for tilt in np.unique(mine[:, 0]):
            spread = _Z_95 * float(np.median(mine[mine[:, 0] == tilt, 2]))
            axes.hlines([-spread, spread], tilt - 0.9, tilt + 0.9, color="#e0812b")
        axes.set_title(f"{case}: {row[table.columns.index('tilts_in_95_percent')]:.0f} % hold", fontsize=7)
        axes.grid(alpha=0.25)
    for axes in panels[::3]:
        axes.set_ylabel("Error (°)")
    for axes in panels[-3:]:
        axes.set_xlabel("Tilt set (°)")
