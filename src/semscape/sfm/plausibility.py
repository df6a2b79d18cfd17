"""Is the motion plausible? What refuses a series, and what contradicts what was known of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from semscape.errors import BadInputError
from semscape.sfm.eliminated import PatternScatters, eliminated_cost, projection_matrices
from semscape.sfm.priors import MotionPrior
from semscape.types import BoolArray, FloatArray, IntArray, TiltSeries

_MOST_ROTATION_RAD = np.deg2rad(5.0)
_WIDE_HEIGHT_SCALE = 0.05
_CONTRADICTION_IN_SIGMAS = 3.0
_WORSE_THAN_FREE = 1.4
# Of the precision of a reading; less is not known to come from the images.
_LEAST_TOLD_BY_IMAGES = 0.1
# Tilts that images alone give err by so much of their range, and their scale by so much.
_OWN_TILT_ERROR = 0.07
_LARGEST_RESCALE = 1.6
_MISTYPED = "mistyped tilt, wrong sign or swapped files?"
_WIDEST_FIELD = 0.05
_HIGHEST_RELIEF = 0.005


def require_tilts(series: TiltSeries, left_out: str = "") -> None:
    """Refuse two views without tilts, which no method can turn into heights.

    Parameters
    ----------
    series : TiltSeries
    left_out : str
        Why there are no more views, where more were given: who gave three wonders what became of the third.

    Raises
    ------
    BadInputError
        For two views of which not both have a tilt.

    References
    ----------
    Koenderink & van Doorn 1991, doi:10.1364/JOSAA.8.000377.
    """
    untold = [name for name, tilt in zip(series.names, series.tilt_rad, strict=True) if not np.isfinite(tilt)]
    if series.n_views == 2 and untold:
        given = f"{left_out}; what is left are " if left_out else ""
        without = "without stage tilts" if len(untold) == 2 else f"without a stage tilt of {untold[0]}"
        raise BadInputError(
            f"{given}two views ({', '.join(series.names)}) {without}: two parallel projections show the same "
            "pictures for a low relief tilted far and a high relief tilted little (bas-relief ambiguity), so no "
            "height can be computed. Give the tilts (--tilts -3,3, or tilts_deg in series.toml), or add a third view"
        )


def require_one_axis(series: TiltSeries) -> None:
    """Refuse views between which the stage was rotated: they share no tilt axis in the images.

    Raises
    ------
    BadInputError
        For known stage rotations more than 5 deg apart.
    """
    rotation = np.array([view.metadata.stage_rotation_rad for view in series.views])
    known = np.flatnonzero(np.isfinite(rotation))
    if not len(known):
        return
    turned = np.abs(np.angle(np.exp(1j * (rotation - rotation[known[0]]))))
    if np.nanmax(turned) > _MOST_ROTATION_RAD:
        first, far = known[0], int(np.nanargmax(turned))
        raise BadInputError(
            f"the stage was rotated between {series.names[first]} ({np.rad2deg(rotation[first]):.1f} deg) and "
            f"{series.names[far]} ({np.rad2deg(rotation[far]):.1f} deg): a surface needs views that are tilted about "
            "one axis. Leave the rotated views out, or correct stage_rotation_deg in series.toml. Views all around a "
            "specimen, three tilts at each rotation, become one closed surface with --full-object"
        )


def height_scale_warnings(height_scale_sigma: float, prior: MotionPrior) -> list[str]:
    """Warn of a height scale known to worse than 5 % (1 sigma), with the reason and the way out."""
    if height_scale_sigma <= _WIDE_HEIGHT_SCALE:
        return []
    reason = (
        f"the tilts come from the images alone, and the scan's x and y scales are expected to differ by "
        f"{prior.anisotropy_sigma:.2%} between views (sfm.prior_anisotropy), which moves them; give the stage tilts "
        "(--tilts), take more views over a wider range, or tell a steadier scan if this microscope has shown one"
        if prior.self_calibrated
        else "the tilt range is small against the stage's error; tilt farther"
    )
    return [f"height scale known to +-{196 * height_scale_sigma:.0f} % (95 %) only: {reason}"]


def perspective_warnings(series: TiltSeries, tilt_rad: FloatArray, height_um: FloatArray) -> list[str]:
    """Warn where the projection is no longer parallel: a wide field or a high relief for its working distance.

    Parameters
    ----------
    series : TiltSeries
        With pixel sizes and working distances; without them nothing can be told.
    tilt_rad : (V,) float array
        Tilts: they make one side of the field the farther one.
    height_um : (P,) float array
        Heights of the points.
    """
    distances = np.array([view.metadata.working_distance_um for view in series.views])
    if series.length_unit != "um" or not np.isfinite(distances).any():
        return []
    distance_um = float(np.nanmin(distances))
    field = max(series.shape) * float(series.pixel_size_um.max()) / distance_um
    relief = float(np.ptp(np.percentile(height_um, [0.5, 99.5]))) / distance_um
    if field <= _WIDEST_FIELD and relief <= _HIGHEST_RELIEF:
        return []
    bend_px = field * max(series.shape) / 4 * float(np.sin(np.ptp(tilt_rad) / 2))
    return [
        f"perspective matters: field of view / working distance is {field:.3f} (limit {_WIDEST_FIELD}), relief "
        f"/ working distance {relief:.4f} (limit {_HIGHEST_RELIEF}); parallel projection is off by up to "
        f"{bend_px:.1f} px and bends the surface. Run again with --camera auto, or take the series at a higher "
        "magnification or a longer working distance"
    ]


def prior_contradictions(
    names: tuple[str, ...],
    parameters: FloatArray,
    tilt_covariance_rad2: FloatArray,
    prior: MotionPrior,
    *,
    tilts_doubted: bool,
    without: Callable[[IntArray], tuple[FloatArray, FloatArray]],
) -> list[str]:
    """Name what the images found more than 3 sigma away from what was told or is usual.

    Wrong or swapped tilts and a wrong axis leave a low residual: the motion bends to them. It shows in tilts, rolls,
    scales and anisotropies that no stage and no scan has.

    Parameters
    ----------
    names : V file names
    parameters : (1 + 6 V,) float array
        In the order of `Adjustment.parameters`, before any choice of sign.
    tilt_covariance_rad2 : (V, V) float array
        Of the tilts among them.
    prior : MotionPrior
    tilts_doubted : bool
        The tilts are found wrong already: then they have bent the motion, and single ones are not judged by it.
    without : callable
        The tilts (V,) and their covariance as found without the readings of the views (N,) that it is given.
    """
    found = []
    axis_change = _turn(parameters[0] - prior.axis_angle_rad)
    if np.isfinite(prior.axis_sigma_rad) and abs(axis_change) > _CONTRADICTION_IN_SIGMAS * prior.axis_sigma_rad:
        found.append(
            f"the tilt axis is said to lie at {np.rad2deg(prior.axis_angle_rad):.1f} deg, the images say "
            f"{np.rad2deg(prior.axis_angle_rad + axis_change):.1f} deg; leave it out (--axis-deg) or correct it"
        )
    centre, sigma = prior.centre_and_sigma()
    per_view = parameters[1:].reshape(prior.n_views, -1)[:, :4]
    deviation = (per_view - centre[1:].reshape(-1, 4)) / sigma[1:].reshape(-1, 4)
    if not (prior.self_calibrated or tilts_doubted):
        told = np.flatnonzero(np.isfinite(prior.tilt_sigma_rad))

        def without_told(views: IntArray) -> tuple[FloatArray, FloatArray]:
            tilt, covariance = without(told[views])
            return tilt[told], covariance[np.ix_(told, told)]

        found += against_the_stage(
            [names[view] for view in told],
            "tilts",
            prior.tilt_rad[told],
            prior.tilt_sigma_rad[told],
            per_view[told, 0],
            tilt_covariance_rad2[np.ix_(told, told)],
            without_told,
        )
    usual = [
        (1, "roll", "deg", np.rad2deg(1.0), prior.roll_sigma_rad),
        (2, "scale drift", "%", 100.0, prior.scale_sigma),
        (3, "scan anisotropy", "%", 100.0, prior.anisotropy_sigma),
    ]
    for column, what, unit, factor, expected in usual:
        worst = int(np.argmax(np.abs(deviation[:, column])))
        if abs(deviation[worst, column]) > _CONTRADICTION_IN_SIGMAS:
            found.append(
                f"{names[worst]}: a {what} of {factor * per_view[worst, column]:.2f} {unit} is "
                f"{abs(deviation[worst, column]):.1f} times what is usual ({factor * expected:.2f} {unit}); wrong or "
                "swapped tilts, a changed magnification, or a view of another stage position?"
            )
    return found


def against_the_stage(
    names: Sequence[str],
    what: str,
    reading_rad: FloatArray,
    trust_rad: FloatArray,
    found_rad: FloatArray,
    covariance_rad2: FloatArray,
    without: Callable[[IntArray], tuple[FloatArray, FloatArray]],
) -> list[str]:
    """Name the views of which a reading of the stage lies more than 3 sigma from what all else says of it.

    A posterior is the mean of the reading and all else, weighted by their precisions: so all else can be had back. A
    wrong reading bends what is found of its neighbours too, and a gross one more than that mean tells: so all is found
    anew without the worst before the others are judged.

    Parameters
    ----------
    names : V file names
    what : "tilts" or "rotations"
    reading_rad, trust_rad : (V,) float arrays
        What the stage says, and its sigma.
    found_rad, covariance_rad2 : (V,) and (V, V) float arrays
        The posterior, and its covariance.
    without : callable
        The same as found without the readings of the views (N,) that it is given.

    Examples
    --------
    Three angles that the images know to be equal; one reading bends what is found of all three:

    >>> reading = np.array([0.0, 9.0, 0.5])
    >>> def without(views):
    ...     told = np.diag(1.0 - np.isin(range(3), views))
    ...     covariance = np.linalg.inv(told + 100 * (3 * np.eye(3) - np.ones((3, 3))))
    ...     return covariance @ told @ reading, covariance
    >>> said = against_the_stage("abc", "tilts", reading, np.ones(3), *without([]), without)
    >>> [text[0] for text in said]
    ['b']
    """
    mistyped = _MISTYPED.replace("tilt", what.removesuffix("s"))
    said: dict[int, str] = {}
    while len(said) < len(names):
        variance = np.diag(covariance_rad2)
        # Where all else tells next to nothing, its precision is a difference of rounding errors.
        precision = np.maximum(1 / variance - trust_rad**-2, (_LEAST_TOLD_BY_IMAGES / trust_rad) ** 2)
        otherwise = reading_rad + (found_rad - reading_rad) * (1 + trust_rad**-2 / precision)
        in_sigmas = np.abs(otherwise - reading_rad) / np.sqrt(1 / precision + trust_rad**2)
        in_sigmas[list(said)] = 0.0
        worst = int(np.argmax(in_sigmas))
        if in_sigmas[worst] <= _CONTRADICTION_IN_SIGMAS:
            break
        found_rad, covariance_rad2 = without(np.array([*said, worst]))
        stage, rest = (
            f"{angle:.2f} +- {error:.2g} deg"
            for angle, error in np.rad2deg(
                [
                    (reading_rad[worst], trust_rad[worst]),
                    (found_rad[worst], np.sqrt(covariance_rad2[worst, worst])),
                ]
            ).tolist()
        )
        said[worst] = f"{names[worst]}: the stage says {stage}, the images and the other {what} say {rest}; {mistyped}"
    return [said[view] for view in sorted(said)]


def stage_contradictions(
    names: tuple[str, ...],
    patterns: PatternScatters,
    found: FloatArray,
    unbound: FloatArray,
    n_free: int,
    prior: MotionPrior,
) -> list[str]:
    """Compare the best motion near the stage's tilts with the best of all, both (1 + 4 V,) as searched.

    Tilts in the wrong order, or about a wrong axis, explain the images clearly worse than the images' own. Where most
    of the told ones agree with those, up to a common turn and the height scale, the others are named. `n_free` is the
    number of residuals that the points leave free.
    """
    parameters = np.stack([found, unbound])
    error = eliminated_cost(projection_matrices(parameters, prior.scale_px_per_um), patterns)
    bound_px, free_px = np.sqrt(error / max(n_free, 1))
    if bound_px < _WORSE_THAN_FREE * free_px:
        return []
    reading, own = np.rad2deg(prior.tilt_rad), np.rad2deg(unbound[1::4])
    fitted = _own_as_told(reading, own, float(np.rad2deg(np.nanmin(prior.tilt_sigma_rad))))
    named = [
        f"{name}: the stage says {said:.1f} deg, the images say about {seen:.1f} deg; {_MISTYPED}"
        for name, said, seen, agrees in zip(names, reading, *fitted, strict=True)
        if not agrees
    ]
    told_text, own_text = (", ".join(f"{tilt:.1f}" for tilt in tilts) for tilts in (reading, own))
    return [
        *named,
        f"the tilts {told_text} deg leave {bound_px:.2f} px of residual, where the images alone fit to {free_px:.2f} "
        f"px with about {own_text} deg (or the opposite signs): tilts in the wrong order, swapped files or a wrong "
        "axis?",
    ]


def _own_as_told(told_deg: FloatArray, own_deg: FloatArray, sigma_deg: float) -> tuple[FloatArray, BoolArray]:
    """Bring the images' own tilts (V,) to the told ones by the turn and the scale on which most agree.

    Returns them so, and which agree; all are said to where no majority does, for then nobody can say which ones err.
    """
    tolerance = _CONTRADICTION_IN_SIGMAS * sigma_deg + _OWN_TILT_ERROR * float(np.ptp(own_deg))
    best, agreed = told_deg, np.ones(len(told_deg), dtype=bool)
    most = max(len(told_deg) // 2, 2)
    for i1, i2 in combinations(range(len(told_deg)), 2):
        scale = (told_deg[i2] - told_deg[i1]) / (own_deg[i2] - own_deg[i1] or np.inf)
        if not 1 / _LARGEST_RESCALE < abs(scale) < _LARGEST_RESCALE:
            continue
        as_told = told_deg[i1] + scale * (own_deg - own_deg[i1])
        agree = ~(np.abs(as_told - told_deg) > tolerance)
        if agree.sum() > most:
            best, agreed, most = as_told, agree, int(agree.sum())
    return best, agreed


def _turn(angle_rad: float) -> float:
    """Return an angle between directions of an axis, in (-90, 90] deg."""
    return float(angle_rad - np.pi * np.ceil(angle_rad / np.pi - 0.5)) if np.isfinite(angle_rad) else 0.0
