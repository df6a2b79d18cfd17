"""From tracks to a calibrated motion with its uncertainty: search, refine, reject, refine, state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from semscape.errors import TooFewMatchesError
from semscape.geometry.cameras import (
    PerspectiveCamera,
    ScaledOrthographicCamera,
    camera_matrices,
    cameras_of,
    perspective_cameras_of,
)
from semscape.geometry.rotations import wrap_axis_angle
from semscape.options import SfmOptions
from semscape.sfm.adjust import Adjustment, adjust, points_covariance, with_translations
from semscape.sfm.ambiguity import height_scale_relative_sigma, images_height_scale_sigma, mirror_margin
from semscape.sfm.anisotropy import adjust_learning_anisotropy
from semscape.sfm.drift import ScanDrift, fit_drift
from semscape.sfm.evolve import Evolution, evolve, search
from semscape.sfm.models import PARAMETERS_PER_VIEW, TiltSeriesModel
from semscape.sfm.noise import residual_overdispersion, without_outliers
from semscape.sfm.parallax import lonely_parallax, require_parallax
from semscape.sfm.perspective import PerspectiveFit, fit_perspective
from semscape.sfm.plausibility import (
    height_scale_warnings,
    perspective_warnings,
    prior_contradictions,
    require_one_axis,
    require_tilts,
    stage_contradictions,
)
from semscape.sfm.priors import MotionPrior, motion_prior
from semscape.sfm.relief import ReliefSign, relief_sign
from semscape.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Motion,
    Observations,
    Reconstruction,
    TiltSeries,
    TiltSource,
)

_LEAST_TRACKS = 24
# Neighbouring residuals that move together this much, as a variance against independent ones, show scan drift.
_SHARED_ERRORS = 1.5
# Measured series have other distortions too: where rows do not explain them, polynomials of the rows do harm.
_CLEARLY_LESS = 0.5


@dataclass(frozen=True)
class Calibration:
    """A reconstruction with the record of its search, the noise, its overdispersion, and the scan drift (V,) px rms."""

    reconstruction: Reconstruction
    evolution: Evolution
    sigma_px: float
    overdispersion: float
    drift_px: FloatArray


def calibrate(
    series: TiltSeries, observations: Observations, options: SfmOptions, *, rng: np.random.Generator
) -> Calibration:
    """Calibrate the motion of a tilt series and triangulate its tracks.

    Parameters
    ----------
    series : TiltSeries
        Its tilts and pixel sizes are priors; its reference view serves the vote on the relief's sign.
    observations : Observations
        The tracks.
    options : SfmOptions
        Priors, search and refinement.
    rng : numpy.random.Generator
        For Differential Evolution.

    Raises
    ------
    BadInputError
        For two views without tilts, or views between which the stage was rotated.
    TooFewMatchesError
        With fewer than 24 tracks.
    DegenerateGeometryError
        Without parallax, where nothing but the images could give the tilts.
    """
    require_tilts(series)
    require_one_axis(series)
    if observations.n_points < _LEAST_TRACKS:
        raise TooFewMatchesError(
            f"{observations.n_points} tracks over {series.n_views} views, need {_LEAST_TRACKS}: "
            "check that all images show the same field of the specimen, or tilt in smaller steps"
        )
    prior = motion_prior(series, options)
    no_parallax = require_parallax(series, observations, prior)
    doubts: list[str] = []

    found = search(observations, prior, options, rng=rng)
    if not prior.self_calibrated and series.n_views > 2:
        unbound = evolve(found.patterns, prior.without_stage(), found.sigma_px, options, rng=rng)
        n_free = 2 * len(observations.view) - 3 * observations.n_points
        doubts += stage_contradictions(
            series.names, found.patterns, found.evolution.parameters, unbound.parameters, n_free, prior
        )
    start = with_translations(found.evolution.parameters, observations, series.n_views)
    first = adjust(start, observations, prior, max_iterations=options.max_iterations)
    axis, turned_over = wrap_axis_angle(first.parameters[0])
    if turned_over and not np.isfinite(prior.axis_sigma_rad):
        # A view that fits badly may push a free axis round, which reverses what a tilt means. The mirror image, with
        # the told tilts about the axis in its half turn, fits as well.
        start = np.concatenate([[axis], first.parameters[1:]])
        first = adjust(start, observations, prior, max_iterations=options.max_iterations)
    kept, keep, overdispersion = _kept(observations, first, series.n_views)
    drift_px = np.zeros(series.n_views)
    if overdispersion > _SHARED_ERRORS and options.scan_drift_degree >= 2:
        drift, steady = _drift(series, observations, first, prior, options)
        still = replace(observations, xy=observations.xy - drift.at(observations))
        without = _kept(still, steady, series.n_views)
        if without[2] < _CLEARLY_LESS * overdispersion:
            (kept, keep, overdispersion), first, drift_px = without, steady, drift.rms_px
    as_seen = observations.xy[keep]
    learnt, final = adjust_learning_anisotropy(
        first, kept, prior, max_iterations=options.max_iterations, overdispersion=overdispersion
    )
    relief = relief_sign(series, replace(kept, xy=as_seen), final.points_um, prior, options)
    perspective = None
    if options.camera != "orthographic":
        perspective = _perspective(series, kept, final, learnt, options, overdispersion)
        if _is_taken(perspective, relief.sign, options):
            # Parallel projection has made the noise look larger, and shared by neighbours: outliers are judged again.
            left, again, overdispersion = _kept(perspective.observations, perspective.adjustment, series.n_views)
            kept, as_seen = replace(left, xy=kept.xy[again]), as_seen[again]
            final = adjust(
                final.parameters,
                kept,
                learnt,
                max_iterations=options.max_iterations,
                overdispersion=overdispersion,
            )
            perspective = _perspective(series, kept, final, learnt, options, overdispersion)
        if _is_taken(perspective, relief.sign, options):
            kept, final = perspective.observations, perspective.adjustment
            no_parallax = require_parallax(series, kept, prior)  # perspective had spread the points both ways
    # Wrong tilts turn the axis as well: what the images say of the tilts is told before what they say of the axis.
    doubts = no_parallax + doubts + ([] if no_parallax else lonely_parallax(series, kept, prior, final.parameters[0]))

    def found_without(views: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the tilts and their covariance as found without the stage's readings of some views."""
        told_sigma = learnt.tilt_sigma_rad.copy()
        told_sigma[views] = np.inf
        untold = replace(learnt, tilt_sigma_rad=told_sigma)
        again = adjust(
            final.parameters, kept, untold, max_iterations=options.max_iterations, overdispersion=overdispersion
        )
        tilts = slice(1, None, PARAMETERS_PER_VIEW)
        return again.parameters[tilts], again.covariance[tilts, tilts]

    points_variance_um2 = np.einsum("pii->pi", points_covariance(final, kept, TiltSeriesModel(prior), overdispersion))
    reconstruction = replace(
        _reconstruction(
            series, replace(kept, xy=as_seen), final, points_variance_um2, prior, relief, options, doubts, found_without
        ),
        prior_mean=prior.centre_and_sigma()[0],
        prior_sigma=replace(learnt, anisotropy_sigma=learnt.expected_anisotropy).centre_and_sigma()[1],
        mirror_margin=mirror_margin(kept, final, learnt, options, overdispersion),
        height_scale_relative_sigma_of_images=images_height_scale_sigma(kept, final, learnt, overdispersion),
    )
    if perspective is not None:
        reconstruction = _with_camera(series, reconstruction, perspective, relief.sign, final, options)
    return Calibration(reconstruction, found.evolution, final.sigma_px, overdispersion, drift_px)


def _is_taken(perspective: PerspectiveFit, sign: float, options: SfmOptions) -> bool:
    return options.camera == "perspective" or (perspective.margin > 0 and perspective.is_possible(sign))


def _kept(observations: Observations, adjustment: Adjustment, n_views: int) -> tuple[Observations, BoolArray, float]:
    """Return the observations that are no outliers, which they are, and their overdispersion."""
    kept, keep = without_outliers(observations, adjustment.residual_px, adjustment.sigma_px)
    overdispersion = residual_overdispersion(
        adjustment.residual_px[keep], kept, adjustment.weights[keep], adjustment.sigma_px, n_views
    )
    return kept, keep, overdispersion


def _drift(
    series: TiltSeries, observations: Observations, first: Adjustment, prior: MotionPrior, options: SfmOptions
) -> tuple[ScanDrift, Adjustment]:
    def refit(parameters: FloatArray, corrected: Observations) -> Adjustment:
        return adjust(parameters, corrected, prior, max_iterations=options.max_iterations)

    return fit_drift(
        first,
        observations,
        refit,
        n_views=series.n_views,
        height_px=series.shape[0],
        degree=options.scan_drift_degree,
    )


def _perspective(
    series: TiltSeries,
    observations: Observations,
    parallel: Adjustment,
    prior: MotionPrior,
    options: SfmOptions,
    overdispersion: float,
) -> PerspectiveFit:
    centre_px = np.array([(series.shape[1] - 1) / 2, (series.shape[0] - 1) / 2])

    def refit(parameters: FloatArray, corrected: Observations) -> Adjustment:
        return adjust(
            parameters, corrected, prior, max_iterations=options.max_iterations, overdispersion=overdispersion
        )

    def cameras_at(
        parameters: FloatArray, inverse_distance: float
    ) -> tuple[tuple[ScaledOrthographicCamera, ...], tuple[PerspectiveCamera, ...]]:
        motion = _motion(parameters, prior)
        return cameras_of(motion), perspective_cameras_of(motion, inverse_distance, centre_px)

    return fit_perspective(parallel, observations, prior, refit, cameras_at, overdispersion=overdispersion)


def _with_camera(
    series: TiltSeries,
    reconstruction: Reconstruction,
    fit: PerspectiveFit,
    sign: float,
    final: Adjustment,
    options: SfmOptions,
) -> Reconstruction:
    """State which camera was taken and why; the sign of the distance must agree with that of the relief."""
    taken = final is fit.adjustment and fit.inverse_distance_per_um != 0
    unit = reconstruction.length_unit
    inverse_distance = sign * fit.inverse_distance_per_um
    warnings = list(reconstruction.warnings)
    if fit.margin > 0 and not fit.is_possible(sign):
        where = (
            "on the far side of the specimen, so that what is nearer looks smaller"
            if inverse_distance < 0
            else "amid the specimen's heights"
        )
        warnings.append(
            f"the images fit a perspective camera better (its information criterion by {fit.margin:.0f}), but none "
            f"that can be: its centre of projection lies {1 / abs(inverse_distance):.3g} {unit} away "
            f"({abs(inverse_distance) / fit.sigma_per_um:.1f} sigma) {where}. "
            f"{'It is taken as asked for' if taken else 'Parallel projection is kept'}: the scan's distortions may "
            "look like that, or the relief is turned inside out; check the sign of the tilts, or --invert-relief"
        )
    if taken:
        height_um = np.percentile(np.abs(reconstruction.points_um[:, 2]), 99)
        aside_px = float(height_um * abs(inverse_distance) * np.hypot(*series.shape) / 2)
        warnings.append(
            f"the perspective camera is taken{_why(fit, options)}: its centre of projection lies "
            f"{1 / abs(inverse_distance):.3g} {unit} away. Tilts, points and heights hold it; in the corners of the "
            f"dense surface what stands {height_um:.3g} {unit} high is drawn up to {aside_px:.1f} px beside its place"
        )
    return replace(
        reconstruction,
        camera="perspective" if taken else "orthographic",
        inverse_distance_per_um=inverse_distance if taken else 0.0,
        inverse_distance_sigma_per_um=fit.sigma_per_um,
        camera_margin=fit.margin,
        warnings=tuple(warnings),
    )


def _why(fit: PerspectiveFit, options: SfmOptions) -> str:
    if options.camera == "perspective":
        return " as asked for"
    return f", for the images show it (its information criterion is better by {fit.margin:.0f})"


def _reconstruction(
    series: TiltSeries,
    observations: Observations,
    final: Adjustment,
    points_variance_um2: FloatArray,
    prior: MotionPrior,
    relief: ReliefSign,
    options: SfmOptions,
    doubts: list[str],
    without: Callable[[IntArray], tuple[FloatArray, FloatArray]],
) -> Reconstruction:
    motion = _motion(final.parameters, prior)
    points = final.points_um
    if relief.sign < 0:
        motion = replace(motion, tilt_rad=-motion.tilt_rad)
        points = points * np.array([1.0, 1.0, -1.0])
    motion, points = _centre_world(motion, points, series.shape, prior.reference)

    covariance = final.covariance.copy()
    signs = np.ones(len(covariance))
    signs[1::PARAMETERS_PER_VIEW] = relief.sign * (-1.0 if wrap_axis_angle(final.parameters[0])[1] else 1.0)
    covariance *= signs[:, None] * signs
    tilt_covariance = covariance[1::PARAMETERS_PER_VIEW, 1::PARAMETERS_PER_VIEW]
    height_scale_sigma = height_scale_relative_sigma(motion.tilt_rad, tilt_covariance)
    tilt_sigma = np.sqrt(np.diag(tilt_covariance))
    contradictions = doubts + prior_contradictions(
        series.names, final.parameters, tilt_covariance, prior, tilts_doubted=bool(doubts), without=without
    )
    warnings = [*relief.warnings, *height_scale_warnings(height_scale_sigma, prior)]
    if options.camera == "orthographic":
        warnings += perspective_warnings(series, motion.tilt_rad, points[:, 2])
    source: TiltSource = "self-calibrated" if prior.self_calibrated else _told_by(series)
    return Reconstruction(
        motion=motion,
        points_um=points,
        points_sigma_um=np.sqrt(np.maximum(points_variance_um2, 0)),
        observations=observations,
        residual_px=final.residual_px,
        weights=final.weights,
        covariance=covariance,
        tilt_sigma_rad=tilt_sigma,
        tilt_prior_rad=series.tilt_rad,
        tilt_source=source,
        height_scale_relative_sigma=height_scale_sigma,
        ambiguity=relief.ambiguity,
        relief_confidence=relief.confidence,
        rms_px=float(np.sqrt(np.mean((final.residual_px**2).sum(axis=1)))),
        reference=prior.reference,
        length_unit=series.length_unit,
        warnings=tuple(warnings),
        contradictions=tuple(contradictions),
    )


def _motion(parameters: FloatArray, prior: MotionPrior) -> Motion:
    per_view = parameters[1:].reshape(-1, PARAMETERS_PER_VIEW)
    axis, flipped = wrap_axis_angle(float(parameters[0]))
    return Motion(
        axis_angle_rad=axis,
        tilt_rad=-per_view[:, 0] if flipped else per_view[:, 0].copy(),
        roll_rad=per_view[:, 1].copy(),
        scale_px_per_um=prior.scale_px_per_um * (1 + per_view[:, 2]),
        anisotropy=per_view[:, 3].copy(),
        translation_px=per_view[:, 4:6].copy(),
    )


def _centre_world(
    motion: Motion, points: FloatArray, shape: tuple[int, int], reference: int
) -> tuple[Motion, FloatArray]:
    """Move the world's origin to the median height under the centre of the reference view."""
    matrices = camera_matrices(motion)
    z = float(np.median(points[:, 2]))
    centre_px = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    right = centre_px - motion.translation_px[reference] - matrices[reference][:, 2] * z
    origin = np.append(np.linalg.solve(matrices[reference][:, :2], right), z)
    return replace(motion, translation_px=motion.translation_px + matrices @ origin), points - origin


def _told_by(series: TiltSeries) -> TiltSource:
    sources = {view.metadata.source.get("tilt_rad") for view in series.views}
    return "metadata" if sources <= {"file", None} else "user"
