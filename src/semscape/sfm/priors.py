"""What is known about the motion before the images are looked at."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from semscape.options import SfmOptions
from semscape.types import FloatArray, TiltSeries

# An axis told by the user is trusted to this; without one the axis is free.
_AXIS_SIGMA_RAD = np.deg2rad(2.0)
# The reference's tilt is a choice, held so tightly that nothing moves it.
_HELD_DEG = 1e-4


@dataclass(frozen=True)
class MotionPrior:
    """Normal priors of a motion's parameters; an infinite sigma means free.

    `tilt_rad`, `tilt_sigma_rad`, `scale_px_per_um` are (V,). The tilt of view `reference` is always bound, for
    without any stage tilt a common turn about the axis is a matter of choice. The estimate rests on `anisotropy_sigma`;
    where it was learnt, `anisotropy_sigmas` (S,) are all that were weighed and `anisotropy_weights` (S,) their
    probabilities, over which the covariance is averaged.
    """

    tilt_rad: FloatArray
    tilt_sigma_rad: FloatArray
    axis_angle_rad: float
    axis_sigma_rad: float
    roll_sigma_rad: float
    scale_sigma: float
    anisotropy_sigma: float
    scale_px_per_um: FloatArray
    max_tilt_rad: float
    reference: int
    anisotropy_sigmas: FloatArray = field(default_factory=lambda: np.empty(0))
    anisotropy_weights: FloatArray = field(default_factory=lambda: np.empty(0))

    @property
    def expected_anisotropy(self) -> float:
        """Root mean square of the anisotropy that is to be expected, over all sigmas that were weighed."""
        if not len(self.anisotropy_sigmas):
            return self.anisotropy_sigma
        return float(np.sqrt(self.anisotropy_weights @ self.anisotropy_sigmas**2))

    @property
    def n_views(self) -> int:
        """Number of views V."""
        return len(self.tilt_rad)

    @property
    def self_calibrated(self) -> bool:
        """True when no two views have a stage tilt, so that the images alone fix the height scale."""
        return int(np.isfinite(self.tilt_sigma_rad).sum()) < 2

    def without_stage(self) -> MotionPrior:
        """Return the prior of somebody who knows neither tilts nor axis: the reference is held, the rest is free."""
        held = np.arange(self.n_views) == self.reference
        return replace(
            self,
            tilt_rad=np.where(held, self.tilt_rad, np.nan),
            tilt_sigma_rad=np.where(held, np.deg2rad(_HELD_DEG), np.inf),
            axis_angle_rad=np.nan,
            axis_sigma_rad=np.inf,
        )

    def centre_and_sigma(self) -> tuple[FloatArray, FloatArray]:
        """Return mean and sigma of the parameters [axis, (tilt, roll, relative scale, anisotropy) per view]."""
        views = self.n_views
        centre = np.zeros(1 + 4 * views)
        sigma = np.empty(1 + 4 * views)
        centre[0] = self.axis_angle_rad if np.isfinite(self.axis_angle_rad) else 0.0
        sigma[0] = self.axis_sigma_rad
        centre[1::4] = np.where(np.isfinite(self.tilt_sigma_rad), self.tilt_rad, 0.0)
        sigma[1::4], sigma[2::4] = self.tilt_sigma_rad, self.roll_sigma_rad
        sigma[3::4], sigma[4::4] = self.scale_sigma, self.anisotropy_sigma
        return centre, sigma


def motion_prior(series: TiltSeries, options: SfmOptions) -> MotionPrior:
    """Build the prior of a series from its metadata and the options.

    The reference is the view closest to zero tilt, or the middle one where no view has a tilt.
    """
    tilt = series.tilt_rad
    known = np.isfinite(tilt)
    reference = int(np.argmin(np.where(known, np.abs(tilt), np.inf))) if known.any() else (series.n_views - 1) // 2
    sigma = np.where(known, np.deg2rad(options.prior_tilt_deg), np.inf)
    if known.sum() < 2:
        tilt = np.where(np.arange(series.n_views) == reference, np.where(known, tilt, 0.0), np.nan)
        sigma = np.where(np.arange(series.n_views) == reference, np.deg2rad(_HELD_DEG), np.inf)
    axes = np.array([view.metadata.tilt_axis_angle_rad for view in series.views])
    axis = float(np.mean(axes[np.isfinite(axes)])) if np.isfinite(axes).any() else np.nan
    return MotionPrior(
        tilt_rad=tilt,
        tilt_sigma_rad=sigma,
        axis_angle_rad=axis,
        axis_sigma_rad=float(_AXIS_SIGMA_RAD) if np.isfinite(axis) else np.inf,
        roll_sigma_rad=float(np.deg2rad(options.prior_roll_deg)),
        scale_sigma=options.prior_scale,
        anisotropy_sigma=options.prior_anisotropy,
        scale_px_per_um=1.0 / series.pixel_size_um,
        max_tilt_rad=float(np.deg2rad(options.max_tilt_deg)),
        reference=reference,
    )
