"""Is the motion plausible? What refuses a series, and what contradicts what was known of it."""

from __future__ import annotations

import numpy as np

from semscape.errors import BadInputError, DegenerateGeometryError
from semscape.sfm.eliminated import PatternScatters, eliminated_cost, projection_matrices
from semscape.sfm.priors import MotionPrior
from semscape.types import FloatArray, Observations, TiltSeries

_LEAST_PARALLAX_PX = 0.5
_PARALLAX_OVER_NOISE = 2.0
_LEAST_SHARED = 8
_LEAST_TILT_SPAN_DEG = 0.2
_WIDE_HEIGHT_SCALE = 0.05
_CONTRADICTION_IN_SIGMAS = 3.0
_WORSE_THAN_FREE = 1.4
_WIDEST_FIELD = 0.05
_HIGHEST_RELIEF = 0.005


def require_tilts(series: TiltSeries) -> None:
    """Refuse two views without tilts, which no method can turn into heights.

    Raises
    ------
    BadInputError
        For two views of which not both have a tilt.

    References
    ----------
    Koenderink & van Doorn 1991, doi:10.1364/JOSAA.8.000377.
    """
    if series.n_views == 2 and not np.isfinite(series.tilt_rad).all():
        raise BadInputError(
            f"two views ({', '.join(series.names)}) without stage tilts: two parallel projections show the same "
            "pictures for a low relief tilted far and a high relief tilted little (bas-relief ambiguity), so no "
            "height can be computed. Give the tilts (--tilts -3,3, or tilts_deg in series.toml), or add a third view"
        )


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
    largest = 0.0
    for i1 in range(series.n_views):
        for i2 in range(i1 + 1, series.n_views):
            largest = max(largest, _parallax_px(observations, i1, i2))
    if largest >= _LEAST_PARALLAX_PX:
        return []
    finding = (
        f"no parallax: between any two of {series.n_views} views the points move by at most {largest:.2f} px rms "
        f"along one direction against a common affine map, need {_LEAST_PARALLAX_PX} px. The images are the same "
        "picture, the specimen is flat, or the tilts are too small"
    )
    if prior.self_calibrated:
        raise DegenerateGeometryError(f"{finding}; give the stage tilts (--tilts) or tilt farther")
    return [finding]


def _parallax_px(observations: Observations, i1: int, i2: int) -> float:
    """Return how far the points of two views spread along their parallax, beyond noise, in px rms.

    About the affine map between the views, parallax acts along one direction and noise along both.
    """
    xy1, xy2 = shared_points(observations, i1, i2)
    if len(xy1) < _LEAST_SHARED:
        return 0.0
    design = np.column_stack([xy1 - xy1.mean(axis=0), np.ones(len(xy1))])
    solution, *_ = np.linalg.lstsq(design, xy2, rcond=None)
    residual = xy2 - design @ solution
    length = np.linalg.norm(residual, axis=1)
    residual = residual[length <= 5 * np.median(length) + 1e-12]
    across, along = np.linalg.eigvalsh(residual.T @ residual / len(residual))
    return float(np.sqrt(along - across)) if along > _PARALLAX_OVER_NOISE * across else 0.0


def shared_points(observations: Observations, i1: int, i2: int) -> tuple[FloatArray, FloatArray]:
    """Return the px points (S, 2) in views i1 and i2 of the tracks that both see."""
    in1, in2 = observations.view == i1, observations.view == i2
    _, at1, at2 = np.intersect1d(observations.point[in1], observations.point[in2], return_indices=True)
    return observations.xy[in1][at1], observations.xy[in2][at2]


def height_scale_warnings(height_scale_sigma: float, prior: MotionPrior) -> list[str]:
    """Warn of a height scale known to worse than 5 % (1 sigma), with the reason and the way out."""
    if height_scale_sigma <= _WIDE_HEIGHT_SCALE:
        return []
    reason = (
        "the tilts come from the images alone, where a scan anisotropy of 0.05 % already moves them; give the "
        "stage tilts (--tilts) or take more views over a wider range"
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


def prior_contradictions(names: tuple[str, ...], parameters: FloatArray, prior: MotionPrior) -> list[str]:
    """Name what the images found more than 3 sigma away from what was told or is usual.

    Wrong or swapped tilts and a wrong axis leave a low residual: the motion bends to them. It shows in tilts, rolls,
    scales and anisotropies that no stage and no scan has.

    Parameters
    ----------
    names : V file names
    parameters : (1 + 6 V,) float array
        In the order of `Adjustment.parameters`, before any choice of sign.
    prior : MotionPrior
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
    if prior.self_calibrated:
        deviation[:, 0] = 0.0
    for view, (name, row) in enumerate(zip(names, deviation, strict=True)):
        if abs(row[0]) > _CONTRADICTION_IN_SIGMAS:
            found.append(
                f"{name}: the stage says {np.rad2deg(prior.tilt_rad[view]):.2f} deg, the images say "
                f"{np.rad2deg(per_view[view, 0]):.2f} deg; mistyped tilt, wrong sign or swapped files?"
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


def stage_contradictions(
    patterns: PatternScatters, found: FloatArray, unbound: FloatArray, n_free: int, prior: MotionPrior
) -> list[str]:
    """Compare the best motion near the stage's tilts with the best of all, both (1 + 4 V,) as searched.

    Tilts in the wrong order, or about a wrong axis, explain the images clearly worse than the images' own. `n_free` is
    the number of residuals that the points leave free.
    """
    parameters = np.stack([found, unbound])
    error = eliminated_cost(projection_matrices(parameters, prior.scale_px_per_um), patterns)
    bound_px, free_px = np.sqrt(error / max(n_free, 1))
    if bound_px < _WORSE_THAN_FREE * free_px:
        return []
    told = ", ".join(f"{tilt:.1f}" for tilt in np.rad2deg(prior.tilt_rad))
    own = ", ".join(f"{tilt:.1f}" for tilt in np.rad2deg(unbound[1::4]))
    return [
        f"the tilts {told} deg leave {bound_px:.2f} px of residual, where the images alone fit to {free_px:.2f} px "
        f"with about {own} deg (or the opposite signs): tilts in the wrong order, swapped files or a wrong axis?"
    ]


def _turn(angle_rad: float) -> float:
    """Return an angle between directions of an axis, in (-90, 90] deg."""
    return float(angle_rad - np.pi * np.ceil(angle_rad / np.pi - 0.5)) if np.isfinite(angle_rad) else 0.0
