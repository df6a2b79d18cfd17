"""Pairs of micrographs for `matching`: a simulated one with truth and its picture, and measured ones."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from semscape.experiments.study import Figure, Setting, Table
from semscape.experiments.true_matches import true_match_px
from semscape.features.detect import detect
from semscape.features.match import match
from semscape.io.series import load_series
from semscape.options import FeaturesOptions
from semscape.report.figures import drawn_png
from semscape.robust.acransac import ac_ransac
from semscape.robust.models import AFFINE, FUNDAMENTAL, HOMOGRAPHY
from semscape.robust.ransac import ransac
from semscape.robust.search import RobustFit
from semscape.simulate import PRESETS, simulate
from semscape.types import BoolArray, FloatArray, ImageArray, TiltSeries

if TYPE_CHECKING:
    import matplotlib.figure

_MEASURED = ("dsa", "quartz")
_SPECIMEN = "fracture"
_TRIALS = 10_000
_RIGHT_WITHIN_PX = 3.0
_DRAWN_LINES = 150
_RIGHT, _WRONG = "#2f81d6", "#e0512b"


def simulated_pair(setting: Setting, thresholds_px: tuple[float, ...]) -> tuple[Table, Figure]:
    """Match the two outermost views of a simulated series without a ratio test, and judge by its truth."""
    series, truth = simulate(_SPECIMEN, PRESETS["nominal"], rng=setting.seed, workers=setting.workers)
    pair = (0, series.n_views - 1)
    x1, x2 = _putative(series, pair, ratio=1.0)
    expected = true_match_px(truth, pair, x1)
    known: BoolArray = np.asarray(np.isfinite(expected).all(axis=1))
    right: BoolArray = np.asarray(known & (np.hypot(*(x2 - expected).T) < _RIGHT_WITHIN_PX))
    common: dict[str, Any] = {"shapes": (series.shape, series.shape), "max_trials": _TRIALS}
    fits = [
        (f"fixed, {limit:g} px", ransac(AFFINE, x1, x2, threshold_px=limit, rng=_rng(setting), **common))
        for limit in thresholds_px
    ]
    fits.append(("a contrario", ac_ransac(AFFINE, x1, x2, rng=_rng(setting), **common)))
    rows = tuple(_judged(name, fit, known, right) for name, fit in fits)
    table = Table(
        "simulated_pair",
        f"A simulated pair ({_SPECIMEN}, {_spread_deg(series):.0f} deg apart), {len(x1)} matches without ratio test",
        ("threshold", "inliers", "right", "precision", "recall", "threshold (px)", "log10 NFA"),
        rows,
        f"Right: within {_RIGHT_WITHIN_PX:g} px of where the true cameras and heights put the match; precision and "
        f"recall over the {int(known.sum())} matches whose truth is known.",
    )
    images = series.views[pair[0]].image, series.views[pair[1]].image
    shown = [(f"{name}: {fit.inliers.sum()} inliers", fit.inliers) for name, fit in (fits[0], fits[-1])]
    picture = drawn_png(
        (10.0, 10.0), lambda figure: _draw(figure, images, x1, x2, known, right, shown), dpi=100, colours=128
    )
    return table, Figure(
        "matching_thresholds",
        "The same pair with a fixed threshold and a contrario",
        picture,
        f"Two simulated micrographs side by side, twice, with lines between {_DRAWN_LINES} of the inliers: blue where "
        f"right, orange where wrong. {shown[0][0]}; {shown[1][0]}.",
    )


def measured_pairs(setting: Setting) -> tuple[tuple[Table, ...], tuple[str, ...]]:
    """Match measured pairs with and without the ratio test, and by every model."""
    folder = None if setting.data is None else setting.data / "tilt_series"
    names = [name for name in _MEASURED if folder is not None and (folder / name).is_dir()]
    missing = [name for name in _MEASURED if name not in names]
    notes = (f"Left out, because the measured series are absent: {', '.join(missing)}.",) if missing else ()
    if folder is None or not names:
        return (), notes
    agreement, models = [], []
    for name in names:
        series = load_series(folder / name)
        for pair in list(combinations(range(series.n_views), 2))[: 1 if setting.quick else None]:
            label = f"{name} {series.names[pair[0]]} – {series.names[pair[1]]}"
            common: dict[str, Any] = {"shapes": (series.shape, series.shape), "max_trials": _TRIALS}
            everything, strict = (_putative(series, pair, ratio=ratio) for ratio in (1.0, FeaturesOptions().ratio))
            free = ac_ransac(AFFINE, *everything, rng=_rng(setting), **common)
            tested = ac_ransac(AFFINE, *strict, rng=_rng(setting), **common)
            fixed = ransac(AFFINE, *everything, threshold_px=1.0, rng=_rng(setting), **common)
            across = _residual_px(tested, free, strict)
            own = tested.residual_px[tested.inliers]
            agreement.append(
                (
                    label,
                    len(everything[0]),
                    int(free.inliers.sum()),
                    free.threshold_px,
                    int(fixed.inliers.sum()),
                    len(strict[0]),
                    int(tested.inliers.sum()),
                    tested.threshold_px,
                    float(np.sqrt((own**2).mean())),
                    float(np.sqrt((across**2).mean())),
                )
            )
            for model in (AFFINE, FUNDAMENTAL, HOMOGRAPHY):
                fit = ac_ransac(model, *strict, rng=_rng(setting), **common)
                share = float(fit.inliers.mean())
                models.append((label, model.kind, len(strict[0]), share, fit.threshold_px, fit.log10_nfa))
    return (
        Table(
            "measured_pairs",
            "Measured pairs without a ratio test",
            (
                "pair",
                "putative",
                "kept",
                "threshold (px)",
                "kept by fixed 1 px",
                "putative, ratio test",
                "kept, ratio test",
                "threshold (px), ratio test",
                "residual of these (px rms)",
                "residual of these to the lines found without ratio test (px rms)",
            ),
            tuple(agreement),
            "The last two columns are alike where the geometry found among all matches is that of the tested ones.",
        ),
        Table(
            "models",
            "Measured pairs, ratio-tested matches: what each model keeps",
            ("pair", "model", "putative", "share kept", "threshold (px)", "log10 NFA"),
            tuple(models),
            "The homography constrains a match twice, so its NFA is the least on low reliefs although it gives up the "
            "matches that stand out of its plane, which are the relief.",
        ),
    ), notes


def _rng(setting: Setting) -> np.random.Generator:
    return np.random.default_rng([setting.seed, 3])


def _putative(series: TiltSeries, pair: tuple[int, int], *, ratio: float) -> tuple[FloatArray, FloatArray]:
    first, second = (detect(series.views[index], FeaturesOptions()) for index in pair)
    found = match(pair, first, second, ratio=ratio)
    return first.xy[found.indices[:, 0]], second.xy[found.indices[:, 1]]


def _residual_px(tested: RobustFit, free: RobustFit, xy: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the residuals of the tested inliers under the other geometry."""
    one, two = (np.column_stack([points[tested.inliers], np.ones(tested.inliers.sum())]) for points in xy)
    lines2, lines1 = one @ free.matrix.T, two @ free.matrix
    shorter = np.minimum(np.hypot(*lines1[:, :2].T), np.hypot(*lines2[:, :2].T))
    return np.asarray(np.abs((two * lines2).sum(axis=1)) / shorter)


def _judged(name: str, fit: RobustFit, known: BoolArray, right: BoolArray) -> tuple[Any, ...]:
    kept = int((fit.inliers & right).sum())
    judged = int((fit.inliers & known).sum())
    nfa = fit.log10_nfa if np.isfinite(fit.log10_nfa) else None
    precision = kept / judged if judged else None
    return name, int(fit.inliers.sum()), kept, precision, kept / max(int(right.sum()), 1), fit.threshold_px, nfa


def _spread_deg(series: TiltSeries) -> float:
    return float(np.rad2deg(np.ptp(series.tilt_rad)))


def _draw(
    figure: matplotlib.figure.Figure,
    images: tuple[ImageArray, ImageArray],
    x1: FloatArray,
    x2: FloatArray,
    known: BoolArray,
    right: BoolArray,
    shown: list[tuple[str, BoolArray]],
) -> None:
    from matplotlib.collections import LineCollection

    height, width = images[0].shape
    offset = np.array([1.02 * width, 0.0])
    # One fixed order of the matches: what both methods keep is drawn in both halves.
    order = np.random.default_rng(0).permutation(len(x1))
    for axes, (title, inliers) in zip(figure.subplots(len(shown), 1), shown, strict=True):
        for image, left in zip(images, (0.0, offset[0]), strict=True):
            low, high = np.percentile(image, [1, 99])
            extent = (left - 0.5, left + width - 0.5, height - 0.5, -0.5)
            axes.imshow(image, cmap="gray", vmin=low, vmax=high, extent=extent)
        drawn = order[inliers[order] & known[order]]
        wrong = drawn[~right[drawn]]
        for chosen, colour, strength in ((drawn[right[drawn]], _RIGHT, 0.5), (wrong, _WRONG, 0.9)):
            axes.plot(*x1[chosen].T, ".", color=colour, markersize=2)
            axes.plot(*(x2[chosen] + offset).T, ".", color=colour, markersize=2)
            lines = chosen[: max(round(_DRAWN_LINES * len(chosen) / max(len(drawn), 1)), 1)]
            segments = np.stack([x1[lines], x2[lines] + offset], axis=1)
            axes.add_collection(LineCollection(list(segments), colors=colour, linewidths=0.6, alpha=strength))
        axes.set(xlim=(-0.5, offset[0] + width - 0.5), ylim=(height - 0.5, -0.5))
        axes.set_title(f"{title}, {len(wrong)} of them wrong (orange)", fontsize=10)
        axes.set_axis_off()
