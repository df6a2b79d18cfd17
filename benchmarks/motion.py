"""The motion stage alone: tables of accuracy and coverage, speed of search and refinement, repeatability on real sets.

`python benchmarks/motion.py [CASE ...]` prints JSON. Series are tracks of random points (see
`semscape.experiments.simulated_tracks`), so that hundreds fit into minutes. Times are of one thread.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isolated import REAL_SETS, Case, peak_memory_mb, real_set_folder, run_cases, timed

if TYPE_CHECKING:
    import numpy as np

    from semscape.types import Observations, TiltSeries

_SERIES = 200
_POPULATION = 20_000
_RUNS = 5
_BOOTSTRAPS = 20


def measure_accuracy(case: str) -> dict[str, Any]:
    """Calibrate many simulated series of one case and compare them with their truth."""
    from semscape.experiments.calibration import CASES as RECIPES
    from semscape.experiments.calibration import figures_of, recover

    return dict(figures_of([recover(RECIPES[case], seed) for seed in range(_SERIES)]))


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
        patterns, preparation[tracks] = timed(pattern_scatters, observations, 7, np.ones(tracks))
        rates[tracks] = round(
            _POPULATION
            / min(
                timed(lambda p=patterns: eliminated_cost(projection_matrices(population, scale), p))[1]
                for _ in range(_RUNS)
            )
        )
    return {
        "views": 7,
        "evaluations_per_second_by_tracks": rates,
        "preparation_seconds_by_tracks": {tracks: round(seconds, 4) for tracks, seconds in preparation.items()},
    }


def measure_adjustment(views: int, points: int) -> dict[str, Any]:
    """Adjust one large problem."""

    from semscape.options import SfmOptions
    from semscape.sfm.adjust import adjust

    observations, prior, start, true = _large_problem(views, points)
    adjust(*_first_points(start, observations, 100), prior, max_iterations=2)  # compiles
    found, seconds = timed(adjust, start, observations, prior, max_iterations=SfmOptions().max_iterations)
    return {
        "views": views,
        "points": points,
        "observations": len(observations.view),
        "seconds": round(seconds, 2),
        "iterations": found.n_iterations,
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "tilt_step_rms_error_deg": _step_error_deg(found.parameters[1::6], true),
    }


def measure_scipy(views: int, points: int) -> dict[str, Any]:
    """Adjust the same problem with scipy's least_squares: sparse, Cauchy, points and cameras."""
    import numpy as np
    from scipy.optimize import least_squares
    from scipy.sparse import coo_array

    from semscape.sfm.adjust import adjust
    from semscape.sfm.models import camera_jacobians

    observations, prior, start, true = _large_problem(views, points)
    ours, our_seconds = timed(adjust, start, observations, prior, max_iterations=50)
    centre, sigma = prior.centre_and_sigma()
    view, point = observations.view, observations.point
    n_camera, n = len(start), len(view)
    prior_index = np.concatenate([[0], (1 + 6 * np.arange(views)[:, None] + np.arange(4)).ravel()])
    weight = np.where(np.isfinite(sigma), ours.sigma_px / sigma, 0.0)

    def residuals(x: np.ndarray) -> np.ndarray:
        matrices, _, translations = camera_jacobians(x[:n_camera], prior.scale_px_per_um)
        predicted = np.einsum("kij,kj->ki", matrices[view], x[n_camera:].reshape(-1, 3)[point]) + translations[view]
        return np.concatenate([(observations.xy - predicted).ravel(), (x[prior_index] - centre) * weight])

    def jacobian(x: np.ndarray) -> Any:
        matrices, derivatives, _ = camera_jacobians(x[:n_camera], prior.scale_px_per_um)
        world = x[n_camera:].reshape(-1, 3)[point]
        by_matrix = -np.einsum("kpai,ki->kap", derivatives[view], world)
        by_camera = np.concatenate([by_matrix, np.broadcast_to(-np.eye(2), (n, 2, 2))], axis=2)
        own = 1 + 6 * view[:, None] + np.arange(6)
        camera_columns = np.concatenate([np.zeros((n, 1), dtype=np.int64), own], axis=1)
        point_columns = n_camera + 3 * point[:, None] + np.arange(3)
        columns = np.concatenate([camera_columns, point_columns], axis=1)
        values = np.concatenate([by_camera, -matrices[view]], axis=2)
        rows = np.broadcast_to((2 * np.arange(n)[:, None] + np.arange(2))[:, :, None], values.shape)
        every = np.broadcast_to(columns[:, None, :], values.shape)
        prior_rows = 2 * n + np.arange(len(prior_index))
        return coo_array(
            (
                np.concatenate([values.ravel(), weight]),
                (np.concatenate([rows.ravel(), prior_rows]), np.concatenate([every.ravel(), prior_index])),
            ),
            shape=(2 * n + len(prior_index), len(x)),
        ).tocsr()

    first = np.concatenate([start, _triangulated(start, observations, prior).ravel()])
    found, seconds = timed(
        least_squares, residuals, first, jac=jacobian, loss="cauchy", f_scale=2.385 * ours.sigma_px, tr_solver="lsmr",
        x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12, max_nfev=100,
    )  # fmt: skip
    return {
        "views": views,
        "points": points,
        "seconds": round(seconds, 2),
        "our_seconds": round(our_seconds, 2),
        "evaluations": int(found.nfev),
        "status": found.message,
        "tilt_step_rms_error_deg": _step_error_deg(found.x[1:n_camera:6], true),
        "our_tilt_step_rms_error_deg": _step_error_deg(ours.parameters[1::6], true),
        "largest_tilt_difference_deg": float(np.rad2deg(np.abs(found.x[1:n_camera:6] - ours.parameters[1::6]).max())),
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


def _triangulated(parameters: np.ndarray, observations: Any, prior: Any) -> np.ndarray:
    import numpy as np

    from semscape.sfm.models import camera_jacobians
    from semscape.sfm.schur import solve_points

    matrices, _, translations = camera_jacobians(parameters, prior.scale_px_per_um)
    start = np.searchsorted(observations.point, np.arange(observations.n_points + 1))
    xy = np.ascontiguousarray(observations.xy)
    return solve_points(start, observations.view, xy, np.ones(len(xy)), matrices, translations)[0]


def _step_error_deg(tilt_rad: np.ndarray, true_rad: np.ndarray) -> float:
    import numpy as np

    return round(float(np.rad2deg(np.sqrt(np.mean((np.diff(tilt_rad) - np.diff(true_rad)) ** 2)))), 5)


_ACCURACY = (
    "7 views, images alone",
    "5 views, images alone",
    "3 views, images alone",
    "5 views, stage",
    "7 views, images alone, anisotropy",
    "5 views, images alone, anisotropy",
    "3 views, images alone, anisotropy",
    "5 views, stage, anisotropy",
)
CASES: dict[str, Case] = {
    "objective": (measure_objective, ()),
    "adjustment": (measure_adjustment, (10, 50_000)),
    "adjustment-scipy": (measure_scipy, (10, 5_000)),
    **{name: (measure_real, (name,)) for name in REAL_SETS},
    **{case: (measure_accuracy, (case,)) for case in _ACCURACY},
}

if __name__ == "__main__":
    run_cases(CASES, "The motion stage: accuracy, coverage, speed and repeatability, as JSON.")
