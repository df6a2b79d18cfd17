"""The motion of a full-object acquisition: stage tilt combined with stage rotation, 10 to 40 views all around.

Here no axis is shared by all views in the world, and every rotation is free about what the stage says. The tilt and
the rotation of every view must be told: nothing is searched but the direction of the stage's tilt axis in the
images and the sense in which its rotation is read.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import numpy as np

from semscape.errors import BadInputError
from semscape.geometry.rotations import roll_rotation, tilted_cam_from_world
from semscape.options import SfmOptions
from semscape.sfm.adjust import Adjustment, refine, robust_cost
from semscape.sfm.ambiguity import height_scale_relative_sigma
from semscape.sfm.eliminated import eliminated_cost, pattern_scatters
from semscape.sfm.models import camera_jacobians as tilted_jacobians
from semscape.sfm.models import cross_matrix, inverted
from semscape.sfm.noise import residual_overdispersion, without_outliers
from semscape.sfm.plausibility import against_the_stage
from semscape.types import FloatArray, IntArray, Observations, TiltSeries

PARAMETERS_PER_VIEW = 7  # tilt, roll, relative scale, anisotropy, stage rotation, x and y translation
_PRIORS_PER_VIEW = 5  # all of them but the translation
_ROTATION_SIGMA_RAD = np.deg2rad(0.5)
_AXIS_STEPS = 180
# Counter-clockwise seen from the electron source, and clockwise.
_SENSES = (1.0, -1.0)
_MOST_PATTERNS = 200
# Twice a logarithm of likelihoods by which tracks must speak for the sense that is not told.
_CLEAR_MARGIN = 20.0


class FullObjectModel:
    """The stage's axis, then per view tilt, roll, relative scale, anisotropy, stage rotation and translation.

    A view has R = Rz(roll) R_0 Rot(axis, tilt) Rz(stage rotation): the specimen is first rotated about its normal,
    counter-clockwise seen from the electron source, then tilted.
    """

    def __init__(self, tilt_rad: FloatArray, rotation_rad: FloatArray, scale: FloatArray, options: SfmOptions) -> None:
        views = len(tilt_rad)
        self._scale = scale
        per_view = np.arange(views)[:, None] * PARAMETERS_PER_VIEW + 1 + np.arange(PARAMETERS_PER_VIEW)
        self.index = np.column_stack([np.zeros(views, dtype=np.int64), per_view])
        self.prior_index = per_view[:, :5].ravel()
        zeros = np.zeros(views)
        self.prior_centre = np.column_stack([tilt_rad, zeros, zeros, zeros, rotation_rad]).ravel()
        sigma = [
            np.deg2rad(options.prior_tilt_deg),
            np.deg2rad(options.prior_roll_deg),
            options.prior_scale,
            options.prior_anisotropy,
            _ROTATION_SIGMA_RAD,
        ]
        self.prior_weight = np.tile(1 / np.array(sigma), views)

    def cameras(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return matrices (V, 2, 3), derivatives by axis, tilt, roll, scale, anisotropy, rotation, and translations."""
        per_view = parameters[1:].reshape(-1, PARAMETERS_PER_VIEW)
        single_axis = np.concatenate([parameters[:1], per_view[:, [0, 1, 2, 3, 5, 6]].ravel()])
        matrices, derivatives, translations = tilted_jacobians(single_axis, self._scale)
        rotated = roll_rotation(per_view[:, 4])
        about_z = cross_matrix(np.array([0.0, 0.0, 1.0]))
        by_rotation = (matrices @ about_z @ rotated)[:, None]
        every = np.concatenate([derivatives @ rotated[:, None], by_rotation], axis=1)
        return matrices @ rotated, every, translations

    def covariance(self, hessian: FloatArray, parameters: FloatArray) -> FloatArray:  # noqa: ARG002
        """Return the inverse of the normal matrix."""
        return inverted(hessian)

    def untold(self, parameter: int, views: IntArray) -> FullObjectModel:
        """Return the same model with one parameter of some views left free: 0 is the tilt, 4 the stage's rotation."""
        other = copy(self)
        other.prior_weight = self.prior_weight.copy()
        other.prior_weight[_PRIORS_PER_VIEW * views + parameter] = 0.0
        return other


@dataclass(frozen=True)
class FullObjectMotion:
    """The rotations (V, 3, 3) from world to camera, with the adjustment that gave them.

    `observations` are those that are no outliers, `adjustment` is to them, with the parameters of `FullObjectModel`.
    `sense_margin` is by how much the stage's rotation, read clockwise, costs more than counter-clockwise, twice a
    logarithm of likelihoods; near 0 no track tells. `overdispersion` is by how much neighbouring keypoints that err
    alike inflate the variance of the data. `contradictions` name the views whose told tilt or rotation is more than 3
    sigma from what the images say.
    """

    cam_from_world: FloatArray
    axis_angle_rad: float
    tilt_rad: FloatArray
    rotation_rad: FloatArray
    scale_px_per_um: FloatArray
    observations: Observations
    adjustment: Adjustment
    sense_margin: float = 0.0
    overdispersion: float = 1.0
    contradictions: tuple[str, ...] = ()

    @property
    def clockwise(self) -> bool:
        """Whether the tracks say clearly that the stage's rotation is told clockwise."""
        return self.sense_margin < -_CLEAR_MARGIN

    @property
    def sense_is_open(self) -> bool:
        """Whether the tracks leave open in which sense the stage's rotation is told."""
        return abs(self.sense_margin) < _CLEAR_MARGIN

    def height_scale_relative_sigma(self, views: tuple[int, ...]) -> float:
        """Return the relative sigma of the heights that some views of one stage rotation give."""
        own = 1 + PARAMETERS_PER_VIEW * np.array(views)
        return height_scale_relative_sigma(self.tilt_rad[list(views)], self.adjustment.covariance[np.ix_(own, own)])

    @property
    def doubts(self) -> tuple[str, ...]:
        """What the images contradict, and what they leave open."""
        if not self.sense_is_open:
            return self.contradictions
        return (
            *self.contradictions,
            "too few tracks tie views of different stage rotations to tell in which sense the stage turns (margin "
            f"{abs(self.sense_margin):.1f}, need {_CLEAR_MARGIN:g}): rotations are read counter-clockwise, seen from "
            "the electron source. If the sides do not fit together, give stage_rotation_deg with the opposite signs, "
            "or take more rotations with smaller steps",
        )


def require_stage(series: TiltSeries) -> None:
    """Refuse a series of which not every tilt and rotation is known.

    Raises
    ------
    BadInputError
        With the name of the first such view.
    """
    for view in series.views:
        if not np.isfinite([view.metadata.tilt_rad, view.metadata.stage_rotation_rad]).all():
            raise BadInputError(
                f"{view.name}: a full object needs the tilt and the rotation of every view; give tilt_deg and "
                f'stage_rotation_deg in series.toml, under [images."{view.name}"]'
            )


def calibrate_full_object(series: TiltSeries, observations: Observations, options: SfmOptions) -> FullObjectMotion:
    """Calibrate views that the stage has tilted and rotated.

    Parameters
    ----------
    series : TiltSeries
        With the stage's tilt and rotation of every view.
    observations : Observations
        Tracks; no view needs to share points with all others.
    options : SfmOptions
        Priors.

    Raises
    ------
    BadInputError
        Where a tilt or a rotation is not known.
    DegenerateGeometryError
        Where the tracks do not determine the motion.
    """
    tilt = series.tilt_rad
    rotation = np.array([view.metadata.stage_rotation_rad for view in series.views])
    scale = 1.0 / series.pixel_size_um
    require_stage(series)
    axes = _axes(tilt, rotation, scale, observations)
    models = {sense: FullObjectModel(tilt, sense * rotation, scale, options) for sense in _SENSES}
    ends = {
        sense: refine(
            _start(axes[sense], model, observations), observations, model, max_iterations=options.max_iterations
        )
        for sense, model in models.items()
    }
    sigma_px = min(end.sigma_px for end in ends.values())
    cost = {sense: robust_cost(ends[sense].parameters, observations, models[sense], sigma_px) for sense in _SENSES}
    margin = cost[-1.0] - cost[1.0]
    sense = -1.0 if margin < -_CLEAR_MARGIN else 1.0  # as `FullObjectMotion.clockwise`
    first = ends[sense]
    kept, keep = without_outliers(observations, first.residual_px, first.sigma_px)
    overdispersion = residual_overdispersion(
        first.residual_px[keep], kept, first.weights[keep], first.sigma_px, len(tilt)
    )

    def refined(parameters: FloatArray, model: FullObjectModel) -> Adjustment:
        return refine(parameters, kept, model, max_iterations=options.max_iterations, overdispersion=overdispersion)

    found = refined(first.parameters, models[sense])
    per_view = found.parameters[1:].reshape(-1, PARAMETERS_PER_VIEW)
    rotations = tilted_cam_from_world(found.parameters[0], per_view[:, 0], per_view[:, 1]) @ roll_rotation(
        per_view[:, 4]
    )
    return FullObjectMotion(
        rotations,
        float(found.parameters[0]),
        per_view[:, 0].copy(),
        per_view[:, 4].copy(),
        scale * (1 + per_view[:, 2]),
        kept,
        found,
        margin,
        overdispersion,
        tuple(_against_the_stage(series.names, found, refined, models[sense])),
    )


def _against_the_stage(
    names: tuple[str, ...],
    found: Adjustment,
    refined: Callable[[FloatArray, FullObjectModel], Adjustment],
    model: FullObjectModel,
) -> list[str]:
    said = []
    for what, parameter in (("tilts", 0), ("rotations", 4)):
        own = slice(1 + parameter, None, PARAMETERS_PER_VIEW)
        told = slice(parameter, None, _PRIORS_PER_VIEW)

        def without(views: IntArray, parameter: int = parameter, own: slice = own) -> tuple[FloatArray, FloatArray]:
            again = refined(found.parameters, model.untold(parameter, views))
            return again.parameters[own], again.covariance[own, own]

        said += against_the_stage(
            names,
            what,
            model.prior_centre[told],
            1 / model.prior_weight[told],
            found.parameters[own],
            found.covariance[own, own],
            without,
        )
    return said


def _start(axis_rad: float, model: FullObjectModel, observations: Observations) -> FloatArray:
    views = len(model.index)
    start = np.zeros(1 + PARAMETERS_PER_VIEW * views)
    start[0] = axis_rad
    start[model.prior_index] = model.prior_centre
    for offset in (0, 1):
        total = np.bincount(observations.view, observations.xy[:, offset], minlength=views)
        start[model.index[:, -2 + offset]] = total / np.maximum(np.bincount(observations.view, minlength=views), 1)
    return start


def _axes(tilt: FloatArray, rotation: FloatArray, scale: FloatArray, observations: Observations) -> dict[float, float]:
    """Return for each sense of the rotation the direction of the tilt axis under which the tracks agree best."""
    patterns = pattern_scatters(observations, len(tilt), np.ones(observations.n_points)).strongest(_MOST_PATTERNS)
    # Half a turn alone, that of the conventions: with the axis reversed every tilt is, and the images of the mirrored
    # object are the same.
    axes = -np.pi / 4 + np.arange(1, _AXIS_STEPS + 1) * np.pi / _AXIS_STEPS
    turned = tilted_cam_from_world(axes[:, None], tilt, np.zeros(len(tilt)))
    best = {}
    for sense in _SENSES:
        matrices = (turned @ roll_rotation(sense * rotation))[..., :2, :] * scale[:, None, None]
        best[sense] = float(axes[np.argmin(eliminated_cost(matrices, patterns))])
    return best
