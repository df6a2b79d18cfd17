"""Settings of the simulated microscope and its presets: `ideal`, `nominal`, `hard`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType

import numpy as np

from semscape.simulate.detectors import DETECTORS

MAX_TILT_DEG = 75.0
# A specimen under more pixels than these takes some 16 GB; more rays than these per pixel show nothing more.
MAX_PIXELS, MAX_SAMPLES = 36_000_000, 16
# From a picometre to a metre.
_PIXEL_SIZES_UM = 1e-6, 1e6


@dataclass(frozen=True)
class SimulationOptions:
    """One simulated acquisition; the defaults are the preset `nominal`.

    A strength of 0 switches its effect off. Sigmas are those of independent normal draws per view.

    Parameters
    ----------
    tilts_deg : tuple of float
        Tilts as set at the stage, in degrees.
    axis_deg, scan_rotation_deg : float
        Direction of the tilt axis in the image at scan rotation 0, from +x, counter-clockwise seen from the electron
        source; and the scan rotation, which turns the image of axis and detectors by so much, counter-clockwise.
    width_px, height_px : int
        Size of the image, the data bar included.
    pixel_size_um : float
        Nominal pixel size.
    working_distance_um : float
        Distance of the beam's pivot for perspective, 0 for parallel projection.
    samples : int
        Rays per pixel along each image axis.
    detector : str
        "se", "bse-3" or "bse-4": secondary electrons, or a backscatter detector of so many segments.
    segment_elevation_deg, atomic_number : float
        Elevation of the backscatter segments, and mean atomic number of the material.
    yield_saturation : float
        eps of the yield (1 + eps) / (cos(theta) + eps); 0 is the pure secant law.
    edge_gain, edge_px : float
        Edge brightening at full thinness, and the escape depth in px.
    detector_asymmetry, detector_azimuth_deg, detector_elevation_deg : float
        Share of the signal that depends on facing the detector, and where it stands in the lab (azimuth as the axis).
    cavity : float
        0 no shadowing in cavities; 1: signal proportional to the solid angle of open sky, and none in a segment's
        shadow.
    texture, texture_px, texture_bump : float
        Material texture fixed to the surface: relative rms of the yield, coarsest wavelength in px, and rms slope of
        the fine bumps that only tilt the local normal.
    blur_px, defocus : float
        Sigma of the beam in focus, and the sigma that each px of height off the focal plane adds in quadrature, in px:
        half of the beam's half-angle, for that is the sigma of a disc. The focal plane is the eucentric one. An
        aperture of 30 um at 8 mm, 2 mrad, gives 0.001.
    dose : float
        Electrons detected in a pixel of mean signal; 0 is noiseless.
    line_noise : float
        Relative rms brightness change from scan line to scan line.
    jitter_px : float
        Sigma of each scan line's shift along x.
    drift_px : float
        Rms of the slow, smooth drift of the beam over the frame, its linear part removed.
    charging : float
        Amplitude of the charging streaks relative to the mean signal.
    brightness, contrast : float
        Sigma of the brightness (in units of white) and relative sigma of the contrast between views.
    scale_drift, anisotropy, skew : float
        Sigma of the relative magnification, of the scan anisotropy, and of the shift along x per px of y.
    roll_deg, stage_error_deg : float
        Sigma of the in-plane rotation and of the stage's tilt error.
    shift_px : float
        Sigma of each component of a view's shift.
    data_bar_rows : int
        Height of a data bar burnt into the bottom of the image, 0 for none.

    Examples
    --------
    >>> PRESETS["ideal"].dose
    0.0
    """

    tilts_deg: tuple[float, ...] = (-6.0, -3.0, 0.0, 3.0, 6.0)
    axis_deg: float = 90.0
    scan_rotation_deg: float = 0.0
    width_px: int = 768
    height_px: int = 768
    pixel_size_um: float = 0.1
    working_distance_um: float = 0.0
    samples: int = 2
    detector: str = "se"
    segment_elevation_deg: float = 50.0
    atomic_number: float = 14.0
    yield_saturation: float = 0.3
    edge_gain: float = 0.35
    edge_px: float = 1.5
    detector_asymmetry: float = 0.5
    detector_azimuth_deg: float = 70.0
    detector_elevation_deg: float = 30.0
    cavity: float = 0.7
    texture: float = 0.08
    texture_px: float = 16.0
    texture_bump: float = 0.12
    blur_px: float = 1.0
    defocus: float = 0.001
    dose: float = 400.0
    line_noise: float = 0.004
    jitter_px: float = 0.08
    drift_px: float = 0.1
    charging: float = 0.04
    brightness: float = 0.015
    contrast: float = 0.05
    scale_drift: float = 0.001
    anisotropy: float = 0.0005
    skew: float = 0.0005
    roll_deg: float = 0.2
    stage_error_deg: float = 0.1
    shift_px: float = 8.0
    data_bar_rows: int = 0

    def __post_init__(self) -> None:
        if not self.tilts_deg or not all(abs(tilt) <= MAX_TILT_DEG for tilt in self.tilts_deg):
            raise ValueError(f"tilts_deg must be within +-{MAX_TILT_DEG:g} degrees, got {self.tilts_deg}")
        if min(self.width_px, self.height_px - self.data_bar_rows) < 16 or self.width_px * self.height_px > MAX_PIXELS:
            raise ValueError(
                f"the image needs at least 16 x 16 px above its data bar, and at most {MAX_PIXELS / 1e6:g} megapixels, "
                f"got {self.width_px} x {self.height_px} px with a bar of {self.data_bar_rows}"
            )
        if not 1 <= self.samples <= MAX_SAMPLES:
            raise ValueError(f"samples must be within 1 and {MAX_SAMPLES}, got {self.samples}")
        least, most = _PIXEL_SIZES_UM
        if not least <= self.pixel_size_um <= most:  # NaN is not either
            raise ValueError(f"pixel_size_um must be within {least:g} and {most:g} um, got {self.pixel_size_um:g}")
        if self.detector not in DETECTORS:
            raise ValueError(f"detector must be one of {', '.join(DETECTORS)}, got {self.detector!r}")
        for name in ("segment_elevation_deg", "atomic_number"):
            if not 0 < getattr(self, name) <= 120:
                raise ValueError(f"{name} must be above 0 and not absurd, got {getattr(self, name)}")
        field_um = max(self.width_px, self.height_px) * self.pixel_size_um
        if 0 < self.working_distance_um < 2 * field_um:
            raise ValueError(
                f"working_distance_um must be 0 (parallel) or at least twice the field of view of {field_um:g} um, "
                f"got {self.working_distance_um}"
            )
        free = {
            "tilts_deg",
            "detector",
            "axis_deg",
            "scan_rotation_deg",
            "detector_azimuth_deg",
            "detector_elevation_deg",
        }
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name != "detector" and not np.isfinite(value).all():
                raise ValueError(f"{item.name} must be finite, got {value}")
            if item.name not in free and value < 0:
                raise ValueError(f"{item.name} must not be negative, got {value}")


_NO_FAULTS = {
    "blur_px": 0.0,
    "defocus": 0.0,
    "dose": 0.0,
    "line_noise": 0.0,
    "jitter_px": 0.0,
    "drift_px": 0.0,
    "charging": 0.0,
    "brightness": 0.0,
    "contrast": 0.0,
    "scale_drift": 0.0,
    "anisotropy": 0.0,
    "skew": 0.0,
    "roll_deg": 0.0,
    "stage_error_deg": 0.0,
    "shift_px": 0.0,
}

PRESETS: Mapping[str, SimulationOptions] = MappingProxyType(
    {
        "ideal": replace(SimulationOptions(), **_NO_FAULTS),  # type: ignore[arg-type]
        "nominal": SimulationOptions(),
        "hard": replace(
            SimulationOptions(),
            blur_px=1.3,
            defocus=0.004,
            dose=80.0,
            line_noise=0.015,
            jitter_px=0.2,
            drift_px=0.4,
            charging=0.2,
            brightness=0.06,
            contrast=0.2,
            scale_drift=0.003,
            anisotropy=0.001,
            skew=0.001,
            roll_deg=0.6,
            stage_error_deg=0.3,
            shift_px=25.0,
            texture=0.03,
            texture_bump=0.05,
            data_bar_rows=48,
        ),
    }
)
