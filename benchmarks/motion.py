"""The motion stage alone: tables of accuracy and coverage, speed of search and refinement, repeatability on real sets.

`python benchmarks/motion.py [CASE ...]` prints JSON. Series are tracks of random points (see
`semscape.experiments.simulated_tracks`), so that hundreds fit into minutes. Times are of one thread.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from isolated import REAL_SETS, Case, peak_memory_mb, real_set_folder, run_cases, timed

if TYPE_CHECKING:
    import numpy as np

    from semscape.types import Observations, TiltSeries

_SERIES_FOR_ERRORS = 30
_SERIES_FOR_COVERAGE, _TRACKS_FOR_COVERAGE = 200, 400
_POPULATION = 20_000
_RUNS = 5
_BOOTSTRAPS = 10
_EXACT = 1e-6
_TOLD_AND_TRUE = (0.0, 0.0005, 0.001)
_SCALES = ("height_scale", "stage_scale")
_OVER_12_DEG = " over 12 deg"
_SEVEN_OVER_12_DEG = (-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0)


def measure_accuracy(case: str) -> dict[str, Any]:
    """Calibrate simulated series of one case: errors over some of many tracks, coverage over many of fewer tracks."""
    from dataclasses import replace

    from semscape.experiments.calibration import CASES as RECIPES
    from semscape.experiments.calibration import figures_of, recover

    recipe = RECIPES[case.replace(_OVER_12_DEG, "")]
    if _OVER_12_DEG in case:
        recipe = replace(recipe, tilts_deg=_SEVEN_OVER_12_DEG)
    few = replace(recipe, n_points=_TRACKS_FOR_COVERAGE)
    coverage = figures_of([recover(few, seed) for seed in range(_SERIES_FOR_COVERAGE)])
    return {
        **figures_of([recover(recipe, seed) for seed in range(_SERIES_FOR_ERRORS)]),
        "series_for_coverage": coverage["series"],
        "tracks_for_coverage": _TRACKS_FOR_COVERAGE,
        **{
            f"{key}_of_many": coverage[key]
            for key in ("height_scale_rms_error_percent", "stage_scale_rms_error_percent")
        },
        **{key: share for key, share in coverage.items() if key.endswith("_in_95_percent")},
    }


def measure_told_scan(views: int, told: float, true: float | None) -> dict[str, Any]:
    """Calibrate many series from their images alone, whose scans stretch as told or otherwise (1 sigma).

    Without `true` every series has a scan of its own, drawn from the prior that is weighed when that much is told.
    """
    from dataclasses import replace

    import numpy as np

    from semscape.experiments.calibration import CASES as RECIPES
    from semscape.experiments.calibration import figures_of, recover
    from semscape.options import SfmOptions
    from semscape.sfm.anisotropy import sigmas_weighed

    sigmas, log_prior = sigmas_weighed(told) if true is None else (np.array([true]), np.zeros(1))
    drawn = np.random.default_rng(36).choice(sigmas, _SERIES_FOR_COVERAGE, p=np.exp(log_prior))
    recipe = replace(RECIPES[f"{views} views, images alone"], n_points=_TRACKS_FOR_COVERAGE)
    options = SfmOptions(prior_anisotropy=told or _EXACT)
    figures = figures_of(
        [recover(replace(recipe, anisotropy_sigma=float(one)), seed, options) for seed, one in enumerate(drawn)]
    )
    return {"views": views, "anisotropy_told": told, "anisotropy_true": true, **figures}


def measure_convergence() -> dict[str, Any]:
    """Run the convergence experiment: where searches and refinements of 30 seeds end."""
    from semscape.experiments.convergence import run
    from semscape.experiments.study import Setting

    ends = run(Setting()).tables[0]
    return {"columns": list(ends.columns), "rows": [list(row) for row in ends.rows], "note": ends.note}


def measure_objective() -> dict[str, Any]:
    """Time the eliminated-structure cost of a population for 7 views, against the number of tracks."""
    import numpy as np

    from semscape.experiments.simulated_tracks import TrackRecipe, simulate_tracks
    from semscape.sfm.eliminated import eliminated_cost, pattern_scatters, projection_matrices

    tilts = tuple(np.linspace(-9.0, 9.0, 7).tolist())
    population = np.random.default_rng(0).normal(0, 0.05, (_POPULATION, 29))
    scale = np.full(7, 10.0)
    rates, preparation = {}, {}
    for tracks in (100, 1000, 10_000, 100_000, 1_000_000):
        recipe = TrackRecipe(tilts, n_points=tracks, seen_share=1.0)
        observations = simulate_tracks(recipe, rng=np.random.default_rng(0)).observations
        patterns, preparation[tracks] = _processor_seconds(pattern_scatters, observations, 7, np.ones(tracks))
        rates[tracks] = round(
            _POPULATION
            / min(
                _processor_seconds(lambda p=patterns: eliminated_cost(projection_matrices(population, scale), p))[1]
                for _ in range(_RUNS)
            )
        )
    return {
        "views": 7,
        "evaluations_per_processor_second_by_tracks": rates,
        "preparation_processor_seconds_by_tracks": {t: round(seconds, 4) for t, seconds in preparation.items()},
    }


def _processor_seconds(function: Callable[..., Any], *given: Any) -> tuple[Any, float]:
    """Return the result and the seconds of the processor, which other programs do not disturb; of one thread here."""
    start = time.process_time()
    result = function(*given)
    return result, time.process_time() - start


def measure_adjustment(views: int, points: int) -> dict[str, Any]:
    """Adjust one large problem."""

    from semscape.options import SfmOptions
    from semscape.sfm.adjust import adjust

    observations, prior, start, true = _large_problem(views, points)
    adjust(*_first_points(start, observations, 100), prior, max_iterations=2)  # compiles
    (found, seconds), processor_seconds = _processor_seconds(
        lambda: timed(adjust, start, observations, prior, max_iterations=SfmOptions().max_iterations)
    )
    return {
        "views": views,
        "points": points,
        "observations": len(observations.view),
        "seconds": round(seconds, 2),
        "processor_seconds": round(processor_seconds, 2),
        "iterations": found.n_iterations,
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "tilt_step_rms_error_deg": _step_error_deg(found.parameters[1::6], true),
    }


def measure_rivals(views: int, points: int, max_evaluations: int) -> dict[str, Any]:
    """Adjust one problem with semscape, scipy and COLMAP, one after the other.

    scipy solves the same problem, priors of the stage included. COLMAP knows no priors and no parallel projection:
    it is compared with semscape's adjustment of the images alone, with the scan taken as exact, from the same start.
    """
    from dataclasses import replace

    from adjustment_rivals import colmap_adjusted, scipy_adjusted
    from semscape.sfm.adjust import adjust

    observations, prior, start, true = _large_problem(views, points)
    adjust(*_first_points(start, observations, 100), prior, max_iterations=2)  # compiles
    ours, seconds = timed(adjust, start, observations, prior, max_iterations=50)
    exact = replace(prior.without_stage(), anisotropy_sigma=1e-9, roll_sigma_rad=0.1, scale_sigma=0.1)
    alone, alone_seconds = timed(adjust, start, observations, exact, max_iterations=50)
    row: dict[str, Any] = {
        "views": views,
        "points": points,
        "observations": len(observations.view),
        "semscape": {
            "seconds": round(seconds, 2),
            "iterations": ours.n_iterations,
            "tilt_step_rms_error_deg": _step_error_deg(ours.parameters[1::6], true),
            "peak_memory_mb": round(peak_memory_mb(), 1),
        },
        "semscape, images alone": {
            "seconds": round(alone_seconds, 2),
            "iterations": alone.n_iterations,
            "tilt_step_rms_error_deg": _step_error_deg(alone.parameters[1::6], true),
        },
    }
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
    try:
        rival = colmap_adjusted(start, observations, prior, alone.sigma_px, threads=threads)
        row[f"COLMAP, {threads} threads, images alone"] = _rival_row(rival, alone.parameters[1::6], true)
    except ImportError:
        row["COLMAP"] = {"skipped": "pycolmap is not installed"}
    rival = scipy_adjusted(start, observations, prior, ours.sigma_px, max_evaluations=max_evaluations)
    row["scipy least_squares"] = _rival_row(rival, ours.parameters[1::6], true)
    return row


def _rival_row(rival: Any, ours_rad: np.ndarray, true_rad: np.ndarray) -> dict[str, Any]:
    return {
        "seconds": round(rival.seconds, 2),
        "iterations": rival.iterations,
        "status": rival.status,
        "tilt_step_rms_error_deg": _step_error_deg(rival.tilt_rad, true_rad),
        "rms_difference_of_steps_to_semscape_deg": _step_error_deg(rival.tilt_rad, ours_rad),
        "peak_memory_mb": round(peak_memory_mb(), 1),
    }


def measure_real(name: str) -> dict[str, Any]:
    """Calibrate a measured series from its images alone, from all views, without each, and from drawn tracks."""
    import numpy as np

    from semscape.options import SfmOptions
    from semscape.sfm.calibrate import calibrate
    from semscape.sfm.misfit import without_view

    series, observations = _tracked(name)

    def tilts_deg(one: TiltSeries, tracks: Observations, seed: int = 0) -> tuple[np.ndarray, Any]:
        found = calibrate(one, tracks, SfmOptions(), rng=np.random.default_rng(seed))
        tilt = np.rad2deg(found.reconstruction.motion.tilt_rad)
        return tilt * np.sign(tilt[-1] - tilt[0]), found

    tilt, found = tilts_deg(series, observations)
    drawn = []
    for seed in range(_BOOTSTRAPS):
        rng = np.random.default_rng([seed, 8])
        drawn.append(np.diff(tilts_deg(series, _resampled(observations, rng), seed)[0]))
    left_out = {}
    if series.n_views > 3:
        for view in range(series.n_views):
            others = tuple(index for index in range(series.n_views) if index != view)
            left = tilts_deg(series.select(others, ""), without_view(observations, view))[0]
            left_out[series.names[view]] = np.diff(left).round(3).tolist()
    reconstruction = found.reconstruction
    return {
        "views": list(series.names),
        "tracks": observations.n_points,
        "tilts_deg": tilt.round(4).tolist(),
        "tilt_steps_deg": np.diff(tilt).round(4).tolist(),
        "tilt_sigmas_deg": np.rad2deg(reconstruction.tilt_sigma_rad).round(4).tolist(),
        "height_scale_relative_sigma": round(reconstruction.height_scale_relative_sigma, 4),
        "anisotropy_sigma_learnt": round(float(reconstruction.prior_sigma[4]), 6),
        "overdispersion": round(found.overdispersion, 2),
        "noise_sigma_px": round(found.sigma_px, 4),
        "steps_sd_over_bootstraps_deg": np.std(drawn, axis=0, ddof=1).round(4).tolist(),
        "steps_without_one_view_deg": left_out,
    }


def _tracked(name: str) -> tuple[TiltSeries, Observations]:
    import itertools

    import numpy as np

    import semscape
    from semscape.features.detect import detect
    from semscape.options import Options
    from semscape.sfm.tracks import build_tracks
    from semscape.sfm.two_view import match_pair

    options = Options()
    series = semscape.load_series(real_set_folder(name))
    keypoints = tuple(detect(view, options.features) for view in series.views)
    found = [
        match_pair(
            pair, keypoints, series.names, series.shape, options.features, options.robust, np.random.default_rng(pair)
        )
        for pair in itertools.combinations(range(series.n_views), 2)
    ]
    return series, build_tracks(keypoints, tuple(m for m, _ in found), tuple(g for _, g in found))


def _resampled(observations: Observations, rng: np.random.Generator) -> Observations:
    """Return as many tracks, drawn with replacement."""
    import numpy as np

    from semscape.types import Observations

    start = np.searchsorted(observations.point, np.arange(observations.n_points + 1))
    chosen = np.sort(rng.integers(0, observations.n_points, observations.n_points))
    index = np.concatenate([np.arange(start[one], start[one + 1]) for one in chosen])
    point = np.repeat(np.arange(len(chosen)), np.diff(start)[chosen])
    return Observations(observations.view[index], point, observations.xy[index])


def _large_problem(views: int, points: int) -> tuple[Any, Any, np.ndarray, np.ndarray]:
    import numpy as np

    from semscape.experiments.simulated_tracks import TrackRecipe, simulate_tracks
    from semscape.options import SfmOptions
    from semscape.sfm.adjust import with_translations
    from semscape.sfm.priors import motion_prior

    recipe = TrackRecipe(tuple(np.linspace(-13.5, 13.5, views).tolist()), 0.1, n_points=points, seen_share=1.0)
    tracks = simulate_tracks(recipe, rng=np.random.default_rng(0))
    prior = motion_prior(tracks.series, SfmOptions())
    searched = prior.centre_and_sigma()[0]
    searched[0] = np.pi / 2
    return tracks.observations, prior, with_translations(searched, tracks.observations, views), tracks.motion.tilt_rad


def _first_points(start: np.ndarray, observations: Any, count: int) -> tuple[np.ndarray, Any]:
    from semscape.types import Observations

    few = observations.point < count
    return start, Observations(observations.view[few], observations.point[few], observations.xy[few])


def _step_error_deg(tilt_rad: np.ndarray, true_rad: np.ndarray) -> float:
    import numpy as np

    return round(float(np.rad2deg(np.sqrt(np.mean((np.diff(tilt_rad) - np.diff(true_rad)) ** 2)))), 5)


_ACCURACY = (
    "7 views, stage",
    "3 views, stage",
    "7 views, stage, anisotropy",
    "3 views, stage, anisotropy",
    "7 views, images alone",
    "5 views, images alone",
    "3 views, images alone",
    "5 views, stage",
    "7 views, images alone, anisotropy",
    "5 views, images alone, anisotropy",
    "3 views, images alone, anisotropy",
    "5 views, stage, anisotropy",
    "7 views over 12 deg, stage",
    "7 views over 12 deg, stage, anisotropy",
)
CASES: dict[str, Case] = {
    "objective": (measure_objective, ()),
    "adjustment": (measure_adjustment, (10, 50_000)),
    "adjustment-rivals-5000": (measure_rivals, (10, 5_000, 100)),
    "adjustment-rivals-50000": (measure_rivals, (10, 50_000, 30)),
    **{name: (measure_real, (name,)) for name in REAL_SETS},
    "convergence": (measure_convergence, ()),
    **{case: (measure_accuracy, (case,)) for case in _ACCURACY},
    **{
        f"{views} views, told {told:g}, true {true:g}": (measure_told_scan, (views, told, true))
        for views in (3, 5, 7)
        for told in _TOLD_AND_TRUE
        for true in _TOLD_AND_TRUE
    },
    **{f"{views} views, told 0.001, drawn": (measure_told_scan, (views, 0.001, None)) for views in (3, 5, 7)},
}

if __name__ == "__main__":
    run_cases(CASES, "The motion stage: accuracy, coverage, speed and repeatability, as JSON.")
