"""Whether the views show parallax, and whether that rests on more than a few wrong matches."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from semscape.errors import DegenerateGeometryError
from semscape.sfm.priors import MotionPrior
from semscape.types import FloatArray, Observations, TiltSeries

_LEAST_PARALLAX_PX = 0.5
_PARALLAX_OVER_NOISE = 2.0
_LEAST_SHARED = 8
_LEAST_TILT_SPAN_DEG = 0.2
# Of pairs with fewer points no absence of parallax is told.
_LEAST_TO_DENY = 20
# Tilts of the same step, as stages give them.
_SAME_STEP_RAD = np.deg2rad(0.3)
_SAME_DIRECTION_RAD, _IN_SIGMAS = np.deg2rad(15.0), 3.0


@dataclass(frozen=True)
class _Spread:
    """How far the points of two views spread about the affine map between them, px rms, along a direction and across.

    Parallax acts along one direction, noise along both.
    """

    along_px: float
    across_px: float
    direction_rad: float
    n_points: int

    @property
    def is_parallax(self) -> bool:
        beyond_noise = self.along_px**2 - self.across_px**2
        return beyond_noise >= _LEAST_PARALLAX_PX**2 and self.along_px**2 > _PARALLAX_OVER_NOISE * self.across_px**2

    @property
    def direction_sigma_rad(self) -> float:
        apart = self.along_px**2 - self.across_px**2
        return self.along_px * self.across_px / apart / float(np.sqrt(self.n_points))

    def runs_along(self, direction_rad: float) -> bool:
        """Return whether this is parallax along a direction in the image."""
        if not self.is_parallax:
            return False
        apart = abs((self.direction_rad - direction_rad + np.pi / 2) % np.pi - np.pi / 2)
        return bool(apart <= _SAME_DIRECTION_RAD + _IN_SIGMAS * self.direction_sigma_rad)


def require_parallax(series: TiltSeries, observations: Observations, prior: MotionPrior) -> list[str]:
    """Look for parallax; refuse views without it, unless the stage gives their tilts.

    Returns
    -------
    list of str
        What is doubtful: views without parallax whose tilts are told.

    Raises
    ------
    DegenerateGeometryError
        When the views differ by no more than an affine map and nothing tells their tilts, or the told ones are equal.
    """
    if not prior.self_calibrated:
        span = float(np.rad2deg(np.nanmax(prior.tilt_rad) - np.nanmin(prior.tilt_rad)))
        if span < _LEAST_TILT_SPAN_DEG:
            raise DegenerateGeometryError(
                f"the stage tilts span {span:.2f} deg, need {_LEAST_TILT_SPAN_DEG}: without a change of tilt there is "
                "no parallax, so no height"
            )
    spreads = [_spread(observations, i1, i2) for i1, i2 in combinations(range(series.n_views), 2)]
    if any(spread.is_parallax for spread in spreads):
        return []
    most = max(spreads, key=lambda spread: spread.along_px**2 - spread.across_px**2)
    finding = (
        f"no parallax: about a common affine map the points of any two of {series.n_views} views spread by at most "
        f"{most.along_px:.2f} px rms along one direction, and by {most.across_px:.2f} px of noise across it; needed "
        f"are {_LEAST_PARALLAX_PX} px beyond the noise. The images are the same picture, the specimen is flat, or the "
        "tilts are too small"
    )
    if prior.self_calibrated:
        raise DegenerateGeometryError(
            f"{finding}; from such images no tilt can be found (self-calibration is impossible): give the stage tilts "
            "(--tilts) or tilt farther"
        )
    return [finding]


def lonely_parallax(series: TiltSeries, observations: Observations, prior: MotionPrior, axis_rad: float) -> list[str]:
    """Doubt a tilt axis across which views tilted farther apart show no parallax: a few wrong matches decided it then.

    A pair with parallax across the axis is supported when so have half or more of the pairs (itself included) that are
    tilted at least as far apart and share enough points. One supported pair is enough.

    Parameters
    ----------
    series : TiltSeries
    observations : Observations
        Without outliers.
    prior : MotionPrior
    axis_rad : float
        Of the motion found, counter-clockwise from +x.

    Returns
    -------
    list of str
        What is doubtful; nothing where no tilts are told.
    """
    if not np.isfinite(prior.tilt_rad).all():
        return []
    pairs = list(combinations(range(series.n_views), 2))
    spreads = {pair: _spread(observations, *pair) for pair in pairs}
    # Rows run down.
    across_rad = np.pi / 2 - axis_rad
    step = {(i, j): abs(float(prior.tilt_rad[j] - prior.tilt_rad[i])) for i, j in pairs}
    lonely = []
    for pair in sorted(pairs, key=lambda pair: -step[pair]):
        if not spreads[pair].runs_along(across_rad):
            continue
        wider = [
            spreads[other]
            for other in pairs
            if step[other] >= step[pair] - _SAME_STEP_RAD
            and (other == pair or spreads[other].n_points >= _LEAST_TO_DENY)
        ]
        showing = sum(spread.runs_along(across_rad) for spread in wider)
        if 2 * showing >= len(wider):
            return []
        lonely.append((pair, showing, len(wider)))
    axis = f"the tilt axis ({np.rad2deg(axis_rad):.0f} deg)"
    if lonely:
        (first, second), showing, wider_count = lonely[0]
        finding = (
            f"{series.names[first]} and {series.names[second]} differ across {axis} as views of a relief do, but of "
            f"the {wider_count} pairs of views tilted at least as far apart only {showing} "
            f"{'does' if showing == 1 else 'do'}"
        )
    elif any(spread.is_parallax for spread in spreads.values()):
        finding = (
            f"no two views differ across {axis} as views of a relief do, though some differ along other directions"
        )
    else:
        return [] if prior.self_calibrated else require_parallax(series, observations, prior)
    if np.isfinite(prior.axis_sigma_rad):
        reason = "The axis given is wrong, the"
        way_out = "Leave the axis out or correct it, or tilt farther"
    else:
        reason, way_out = "The", "Tilt farther, or take sharper images"
    return [
        f"parallax without support: {finding}. {reason} specimen is nearly flat where it was matched, or matches are "
        f"wrong; the axis and all heights rest on them. {way_out}"
    ]


def _spread(observations: Observations, i1: int, i2: int) -> _Spread:
    xy1, xy2 = shared_points(observations, i1, i2)
    if len(xy1) < _LEAST_SHARED:
        return _Spread(0.0, 0.0, 0.0, len(xy1))
    design = np.column_stack([xy1 - xy1.mean(axis=0), np.ones(len(xy1))])
    solution, *_ = np.linalg.lstsq(design, xy2, rcond=None)
    residual = xy2 - design @ solution
    length = np.linalg.norm(residual, axis=1)
    residual = residual[length <= 5 * np.median(length) + 1e-12]
    power, directions = np.linalg.eigh(residual.T @ residual / len(residual))
    across, along = np.sqrt(np.maximum(power, 0.0))
    x, y = directions[:, 1]
    return _Spread(float(along), float(across), float(np.arctan2(y, x)), len(residual))


def shared_points(observations: Observations, i1: int, i2: int) -> tuple[FloatArray, FloatArray]:
    """Return the px points (S, 2) in views i1 and i2 of the tracks that both see."""
    in1, in2 = observations.view == i1, observations.view == i2
    _, at1, at2 = np.intersect1d(observations.point[in1], observations.point[in2], return_indices=True)
    return observations.xy[in1][at1], observations.xy[in2][at2]
