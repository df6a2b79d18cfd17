"""Best cost and tilt error against the generations of Differential Evolution, and where each way of searching ends."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from semscape.cluster import Mapper, local_mapper
from semscape.errors import SemscapeError
from semscape.experiments.simulated_tracks import SimulatedTracks, TrackRecipe, simulate_tracks
from semscape.experiments.study import Experiment, Figure, Setting, Table
from semscape.options import SfmOptions
from semscape.report.figures import drawn_png
from semscape.sfm.adjust import adjust, robust_cost, with_translations
from semscape.sfm.evolve import Evolution, Search, evolve, search
from semscape.sfm.models import PARAMETERS_PER_VIEW, TiltSeriesModel
from semscape.sfm.priors import MotionPrior, motion_prior
from semscape.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

TILTS_DEG = (-6.0, -3.0, 0.0, 3.0, 6.0)
STRATEGIES = ("best1bin", "rand1bin")
_CURVES = (("cost", ""), ("tilt_error", "_deg"))
_END_FIGURES = ("tilt_step_error_deg", "evaluations", "seconds")
_SAME_TILT_DEG = 0.001
_COLOURS = ("#2f81d6", "#e0812b")


def run(setting: Setting) -> Experiment:
    """Run the searches from many seeds on one series with stage tilts and one without."""
    seeds = range(5 if setting.quick else 30)
    generations = 60 if setting.quick else 400
    curves: list[tuple[Any, ...]] = []
    ends: list[tuple[Any, ...]] = []
    for stage_sigma_deg in (0.1, None):
        tracks = _series(setting, stage_sigma_deg)
        told = "from the stage" if stage_sigma_deg else "from the images alone"
        prior = motion_prior(tracks.series, SfmOptions())
        # One search has weighted the tracks for all seeds, so that costs compare.
        weighted = search(tracks.observations, prior, SfmOptions(), rng=np.random.default_rng(0))
        with local_mapper(setting.workers) as mapper:
            for strategy in STRATEGIES:
                options = SfmOptions(de_strategy=strategy, de_generations=generations, de_tolerance=0.0)
                record = partial(_record, weighted, prior, options)
                curves += _curve_rows(told, strategy, list(mapper(record, seeds)))
            ends += _ends(told, tracks, seeds, mapper)
    curve_table = Table(
        "generations",
        "Best cost and tilt error against generations",
        (
            "tilts",
            "strategy",
            "generation",
            *(f"{what}_{band}{unit}" for what, unit in _CURVES for band in ("p10", "median", "p90")),
        ),
        tuple(curves),
        f"Bands over {len(seeds)} seeds. The tilt error is the rms error of the steps, its sign left open.",
    )
    end_table = Table(
        "ends",
        "Where each way of searching ends",
        ("tilts", "method", "runs", "failed", "at_the_optimum", *(f"{what}_median" for what in _END_FIGURES)),
        tuple(ends),
        f"At the optimum: no tilt step more than {_SAME_TILT_DEG} deg from that of the least cost of all runs, or of "
        "its mirror image where nothing tells the sign. Evaluations are of the eliminated-structure cost; refinement "
        "counts its steps. Near zero: tilts of 0.1 deg at random; equal tilts are singular.",
    )
    return Experiment(
        name="convergence",
        title="Convergence of the search",
        question="How many generations does Differential Evolution need, does every seed end at the same motion, and "
        f"what do the search and the refinement give alone? {len(TILTS_DEG)} views 3 deg apart, 2000 tracks, 0.3 px "
        "noise, 10 % wrong observations, scale drift 0.1 %, roll 0.2 deg.",
        thesis="section 3.6: best cost against the number of generations; not published here",
        tables=(end_table, curve_table),
        figures=(
            Figure(
                "convergence",
                "Convergence of Differential Evolution",
                drawn_png((9.0, 6.0), partial(_draw, curve_table)),
                "Best cost over its least value, and tilt error, fall with the generations; the band over the seeds "
                "closes.",
            ),
        ),
        notes=("Quick run: fewer seeds and generations.",) if setting.quick else (),
    )


def _series(setting: Setting, stage_sigma_deg: float | None) -> SimulatedTracks:
    recipe = TrackRecipe(TILTS_DEG, stage_sigma_deg, n_points=400 if setting.quick else 2000)
    return simulate_tracks(recipe, rng=np.random.default_rng([setting.seed, 36]))


def _search(tracks: SimulatedTracks, seed: int) -> tuple[Evolution, float]:
    """Search as the pipeline does, and return the processor seconds that it took."""
    start = time.process_time()
    options = SfmOptions()
    prior = motion_prior(tracks.series, options)
    found = search(tracks.observations, prior, options, rng=np.random.default_rng([seed, 1]))
    return found.evolution, time.process_time() - start


def _record(weighted: Search, prior: MotionPrior, options: SfmOptions, seed: int) -> Evolution:
    return evolve(weighted.patterns, prior, weighted.sigma_px, options, rng=np.random.default_rng([seed, 3]))


def _steps_deg(tilt_rad: FloatArray) -> FloatArray:
    """Return tilt steps (..., V - 1) in deg, mirrored where they fall, for the images do not tell the sign."""
    rising = np.diff(np.rad2deg(tilt_rad), axis=-1)
    steps: FloatArray = rising * np.sign(rising.sum(axis=-1, keepdims=True))
    return steps


def _error_deg(tilt_rad: FloatArray) -> FloatArray:
    error: FloatArray = np.sqrt(np.mean((_steps_deg(tilt_rad) - np.diff(TILTS_DEG)) ** 2, axis=-1))
    return error


def _curve_rows(told: str, strategy: str, records: list[Evolution]) -> list[tuple[str | int | float, ...]]:
    cost = np.array([record.best_cost for record in records])
    error = np.array([_error_deg(record.best_parameters[:, 1::4]) for record in records])
    shown = np.unique(np.geomspace(1, cost.shape[1], 40).astype(int)) - 1
    bands = [np.percentile(values, (10, 50, 90), axis=0) for values in (cost, error)]
    return [
        (
            told,
            strategy,
            int(generation) + 1,
            *(round(float(value), 5) for band in bands for value in band[:, generation]),
        )
        for generation in shown
    ]


@dataclass(frozen=True)
class _End:
    """Where one run came to rest: `tilt_rad` (V,), and all `parameters` and the noise where it was refined."""

    tilt_rad: FloatArray
    evaluations: int
    seconds: float
    parameters: FloatArray | None = None
    sigma_px: float = np.nan


def _ends(told: str, tracks: SimulatedTracks, seeds: range, mapper: Mapper) -> list[tuple[Any, ...]]:
    starts = ("near zero", "wrong sign", *(("the stage",) if np.isfinite(tracks.series.tilt_rad).all() else ()))
    outcomes: dict[str, list[_End | None]] = {
        f"refinement alone, from {start}": list(mapper(partial(_refine_from, tracks, start), seeds)) for start in starts
    }
    searched = list(mapper(partial(_search, tracks), seeds))
    outcomes["search alone"] = [_End(one.parameters[1::4], one.n_evaluations, seconds) for one, seconds in searched]
    outcomes["search and refinement"] = [
        _refine(tracks, one.parameters, one.n_evaluations, seconds) for one, seconds in searched
    ]
    best = _bottom(tracks, [one for runs in outcomes.values() for one in runs if one is not None])
    rows: list[tuple[Any, ...]] = []
    for method, runs in outcomes.items():
        ended = [one for one in runs if one is not None]
        if not ended:
            rows.append((told, method, len(runs), len(runs), 0, None, None, None))
            continue
        tilts = np.array([one.tilt_rad for one in ended])
        same = np.abs(_steps_deg(tilts) - _steps_deg(best.tilt_rad)).max(axis=1) < _SAME_TILT_DEG
        error_deg = round(float(np.median(_error_deg(tilts))), 5)
        evaluations = int(np.median([one.evaluations for one in ended]))
        seconds = round(float(np.median([one.seconds for one in ended])), 3)
        failed = len(runs) - len(ended)
        rows.append((told, method, len(runs), failed, int(same.sum()), error_deg, evaluations, seconds))
    return rows


def _bottom(tracks: SimulatedTracks, ends: list[_End]) -> _End:
    """Return the refined end of least cost, all costs taken at one noise."""
    refined = [one for one in ends if one.parameters is not None]
    sigma_px = min(one.sigma_px for one in refined)
    model = TiltSeriesModel(motion_prior(tracks.series, SfmOptions()))

    def cost(one: _End) -> float:
        assert one.parameters is not None
        return robust_cost(one.parameters, tracks.observations, model, sigma_px)

    return min(refined, key=cost)


def _refine_from(tracks: SimulatedTracks, start: str, seed: int) -> _End | None:
    """Refine from a start of tilts alone, with the axis as it is usual, vertical; None where that is singular."""
    rng = np.random.default_rng([seed, 2])
    tilt_deg = {
        "near zero": rng.normal(0, 0.1, len(TILTS_DEG)),
        "wrong sign": -np.array(TILTS_DEG) + rng.normal(0, 0.1, len(TILTS_DEG)),
        "the stage": np.rad2deg(tracks.series.tilt_rad),
    }[start]
    searched = np.zeros(1 + 4 * len(TILTS_DEG))
    searched[0] = np.pi / 2
    searched[1::4] = np.deg2rad(tilt_deg)
    try:
        return _refine(tracks, searched, 0, 0.0)
    except SemscapeError:
        return None


def _refine(tracks: SimulatedTracks, searched: FloatArray, evaluations: int, seconds: float) -> _End:
    start = time.process_time()
    options = SfmOptions()
    found = adjust(
        with_translations(searched, tracks.observations, len(TILTS_DEG)),
        tracks.observations,
        motion_prior(tracks.series, options),
        max_iterations=options.max_iterations,
    )
    return _End(
        found.parameters[1::PARAMETERS_PER_VIEW],
        evaluations + found.n_iterations,
        seconds + time.process_time() - start,
        found.parameters,
        found.sigma_px,
    )


def _draw(curves: Table, drawing: Drawing) -> None:
    panels = drawing.subplots(2, 2, sharex=True)
    for column, told in enumerate(dict.fromkeys(row[0] for row in curves.rows)):
        least = min(row[3] for row in curves.rows if row[0] == told)
        for colour, strategy in zip(_COLOURS, STRATEGIES, strict=True):
            rows = np.array([row[2:] for row in curves.rows if row[:2] == (told, strategy)])
            generation, cost, error = rows[:, 0], rows[:, 1:4] / least, rows[:, 4:7]
            for row, values in enumerate((cost, error)):
                axes = panels[row, column]
                axes.fill_between(generation, values[:, 0], values[:, 2], color=colour, alpha=0.2, linewidth=0)
                axes.plot(generation, values[:, 1], color=colour, label=strategy)
                axes.set(xscale="log", yscale="log")
                axes.grid(alpha=0.25)
        panels[0, column].set_title(f"Tilts {told}")
        panels[1, column].set_xlabel("Generation")
    panels[0, 0].set_ylabel("Best cost / least")
    panels[1, 0].set_ylabel("Tilt-step error (°)")
    panels[0, 0].legend()
