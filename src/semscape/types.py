"""Every value that flows between the stages: frozen dataclasses of read-only arrays.

Sizes: N keypoints, M matches, P points, K observations, V views, H x W pixels. Float64 for geometry,
float32 for images, NaN for unknown. Images are indexed [row, col]; points are (x, y) in px, x right and
y down, the centre of the top-left pixel at (0, 0). Lengths are in um; in a series without a pixel size
they are in px, and `length_unit` says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LengthUnit = Literal["um", "px"]
Ambiguity = Literal["none", "reflection", "bas_relief"]
TiltSource = Literal["metadata", "user", "self-calibrated", "thesis"]
FieldSource = Literal["file", "sidecar", "user", "assumed", "doubtful"]


@dataclass(frozen=True, eq=False)
class _Value:
    def __post_init__(self) -> None:
        """Replace each array by a read-only view of it."""
        for spec in fields(self):
            item = getattr(self, spec.name)
            if isinstance(item, np.ndarray):
                view = item.view()
                view.setflags(write=False)
                object.__setattr__(self, spec.name, view)


@dataclass(frozen=True, eq=False)
class SemMetadata(_Value):
    """What a file says about its acquisition; NaN where it says nothing.

    `source` tells for each known field where its value came from, `origin` the very tag, like "tag 34118, AP_WD";
    `raw` holds the vendor's own tags. `data_bar_rows` is the height of the strip of text under the image, -1 where
    the file does not say. `tilt_correction_rad` is NaN where the correction was on by an angle that is not told;
    `tilt_correction_axis_rad` is the direction, like the tilt axis', across which it stretches.
    """

    pixel_size_um: float = np.nan
    tilt_rad: float = np.nan
    tilt_axis_angle_rad: float = np.nan
    stage_rotation_rad: float = np.nan
    working_distance_um: float = np.nan
    accelerating_voltage_kv: float = np.nan
    magnification: float = np.nan
    scan_rotation_rad: float = np.nan
    tilt_correction_rad: float | None = None
    tilt_correction_axis_rad: float = np.nan
    dynamic_focus: bool = False
    data_bar_rows: int = -1
    vendor: str = "unknown"
    model: str = ""
    source: Mapping[str, FieldSource] = field(default_factory=dict)
    origin: Mapping[str, str] = field(default_factory=dict)
    raw: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Micrograph(_Value):
    """One image with its metadata.

    `image` (H, W) float32 holds the values as stored; `mask` (H, W) is False on the data bar and wherever
    nothing was imaged; `digest` is the SHA-256 of the file ("" for an image that came from memory).
    """

    name: str
    image: ImageArray
    mask: BoolArray
    metadata: SemMetadata = field(default_factory=SemMetadata)
    digest: str = ""


@dataclass(frozen=True, eq=False)
class TiltSeries(_Value):
    """Micrographs of one specimen, ordered by tilt where it is known; index i everywhere is this order."""

    views: tuple[Micrograph, ...]
    warnings: tuple[str, ...] = ()

    @property
    def n_views(self) -> int:
        """Number of views V."""
        return len(self.views)

    @property
    def names(self) -> tuple[str, ...]:
        """File name of each view."""
        return tuple(view.name for view in self.views)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in px, the same for all views."""
        height, width = self.views[0].image.shape
        return height, width

    @property
    def tilt_rad(self) -> FloatArray:
        """Stage tilts (V,) in rad as told by the files or the user, NaN where unknown."""
        return np.array([view.metadata.tilt_rad for view in self.views])

    @property
    def pixel_size_um(self) -> FloatArray:
        """Pixel size (V,) in um, or 1 for every view where the series has none."""
        sizes = np.array([view.metadata.pixel_size_um for view in self.views])
        return sizes if self.length_unit == "um" else np.ones(len(sizes))

    @property
    def length_unit(self) -> LengthUnit:
        """Unit of every length derived from this series: um when each view has a pixel size, else px."""
        return "um" if all(np.isfinite(view.metadata.pixel_size_um) for view in self.views) else "px"

    def select(self, indices: tuple[int, ...], warning: str) -> TiltSeries:
        """Return the series of the views `indices`, with `warning` saying why the others are left out."""
        return replace(self, views=tuple(self.views[i] for i in indices), warnings=(*self.warnings, warning))


@dataclass(frozen=True, eq=False)
class Keypoints(_Value):
    """Keypoints of one view: struct of arrays, row n is keypoint n.

    `xy` (N, 2) px; `descriptors` (N, D): uint8 words for binary kinds, else integer-valued float32;
    `significance` (N,) in [0, 1] or None where no model scored them.
    """

    xy: FloatArray
    scale_px: FloatArray
    orientation_rad: FloatArray
    response: FloatArray
    descriptors: NDArray[Any]
    kind: str
    significance: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.xy)


@dataclass(frozen=True, eq=False)
class Matches(_Value):
    """Putative matches of a pair i1 < i2: `indices` (M, 2) into the two views' keypoints, `distance` (M,)."""

    pair: tuple[int, int]
    indices: IntArray
    distance: FloatArray

    def __len__(self) -> int:
        return len(self.indices)


@dataclass(frozen=True, eq=False)
class TwoViewGeometry(_Value):
    """Epipolar geometry of a pair: x2^T `matrix` x1 = 0 for homogeneous px points.

    `inliers` (M,) bool and `residual_px` (M,) belong to the pair's putative matches; `threshold_px` is the
    distance to the epipolar line that the a contrario method chose; `log10_nfa` is negative when the model
    is meaningful. For the kind "homography" x2 ~ `matrix` x1, and residuals are distances to points.
    `log10_nfa_by_kind` holds the figure of every kind that was tried, of which the least won; `planar` tells
    that the inliers show no parallax.
    """

    pair: tuple[int, int]
    kind: str
    matrix: FloatArray
    inliers: BoolArray
    residual_px: FloatArray
    threshold_px: float
    log10_nfa: float
    n_trials: int
    log10_nfa_by_kind: Mapping[str, float] = field(default_factory=dict)
    planar: bool = False

    @property
    def nfa_margin(self) -> float:
        """By how many powers of ten the NFA is below that of the next best kind; NaN where no other was tried."""
        others = [value for kind, value in self.log10_nfa_by_kind.items() if kind != self.kind]
        return min(others) - self.log10_nfa if others else np.nan


@dataclass(frozen=True, eq=False)
class Observations(_Value):
    """The tracks, flat and sorted by point, then view: observation k sees point `point[k]` in view `view[k]`.

    `view` (K,), `point` (K,), `xy` (K, 2) px.
    """

    view: IntArray
    point: IntArray
    xy: FloatArray

    @property
    def n_points(self) -> int:
        """Number of points P."""
        return int(self.point[-1]) + 1 if len(self.point) else 0


@dataclass(frozen=True, eq=False)
class Motion(_Value):
    """Single-axis motion of a tilt series, V views.

    View i images the specimen with R_i = Rz(roll_i) R_0 Rot(axis, tilt_i), where the axis lies in the image
    plane at `axis_angle_rad` (counter-clockwise from +x, seen from the electron source), and
    x_i = diag(1 + anisotropy_i / 2, 1 - anisotropy_i / 2) scale_i R_i[:2] X + translation_i.
    """

    axis_angle_rad: float
    tilt_rad: FloatArray
    roll_rad: FloatArray
    scale_px_per_um: FloatArray
    anisotropy: FloatArray
    translation_px: FloatArray

    @property
    def n_views(self) -> int:
        """Number of views V."""
        return len(self.tilt_rad)


@dataclass(frozen=True, eq=False)
class Reconstruction(_Value):
    """Calibrated motion and sparse points.

    Sigmas are 1-sigma. `covariance` (1 + 6 V, 1 + 6 V) belongs to the parameters axis angle, then per view
    tilt, roll, relative scale, anisotropy, x and y translation (rad, rad, 1, 1, px, px).
    `residual_px` (K, 2) and `weights` (K,) belong to the observations; an observation of weight 0 was rejected.
    `tilt_prior_rad` is the stage's tilt (NaN where unknown), `reference` the view closest to zero tilt.
    `contradictions` says where the images disagree with what was told: such a result must not be measured.
    `prior_mean` and `prior_sigma` (1 + 4 V,) are what was known before: axis, then per view tilt, roll, relative
    scale, anisotropy; an infinite sigma is free. `mirror_margin` is by how much the mirrored motion costs more (twice
    the negative log-posterior), `height_scale_relative_sigma_of_images` what the images would give without the stage.
    `camera` names the camera model, `inverse_distance_per_um` is 1 / distance of its centre (0 for parallel
    projection) with its sigma, NaN where it was not asked, `camera_margin` by how much perspective is the better one
    (difference of the Bayesian information criterion).
    """

    motion: Motion
    points_um: FloatArray
    points_sigma_um: FloatArray
    observations: Observations
    residual_px: FloatArray
    weights: FloatArray
    covariance: FloatArray
    tilt_sigma_rad: FloatArray
    tilt_prior_rad: FloatArray
    tilt_source: TiltSource
    height_scale_relative_sigma: float
    ambiguity: Ambiguity
    relief_confidence: float
    rms_px: float
    reference: int
    length_unit: LengthUnit
    warnings: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    prior_mean: FloatArray = field(default_factory=lambda: np.empty(0))
    prior_sigma: FloatArray = field(default_factory=lambda: np.empty(0))
    mirror_margin: float = np.nan
    camera: str = "orthographic"
    inverse_distance_per_um: float = 0.0
    inverse_distance_sigma_per_um: float = np.nan
    camera_margin: float = np.nan
    height_scale_relative_sigma_of_images: float = np.nan


class Reason(IntEnum):
    """Why a height is not known, 0 where it is; `docs/run-folder.md` says what each means."""

    KNOWN = 0
    OUTSIDE = 1
    MASKED = 2
    OCCLUDED = 3
    SATURATED = 4
    NO_TEXTURE = 5
    INCONSISTENT = 6
    BACKGROUND = 7
    NOT_TOLD = 255


@dataclass(frozen=True, eq=False)
class HeightMap(_Value):
    """Heights over a regular grid at zero tilt: world_um = world_from_grid @ (col, row, height_um, 1).

    `height_um`, `uncertainty_um` (1 sigma) and `lateral_period_um` (float32, of the wave that the heights hold with
    half its height) are (H, W), NaN = unknown; `n_views` counts the views that agree on each height; `texture` float32
    is the reference micrograph in the grid; `reason` uint8 holds `Reason`s; `specimen` is False on the background.
    """

    height_um: FloatArray
    uncertainty_um: FloatArray
    n_views: NDArray[np.uint8]
    texture: ImageArray
    pixel_size_um: float
    world_from_grid: FloatArray
    length_unit: LengthUnit
    reason: NDArray[np.uint8] = field(default_factory=lambda: np.empty((0, 0), np.uint8))
    specimen: BoolArray = field(default_factory=lambda: np.empty((0, 0), np.bool_))
    lateral_period_um: ImageArray = field(default_factory=lambda: np.empty((0, 0), np.float32))

    def __post_init__(self) -> None:
        told = np.where(np.isfinite(self.height_um), np.uint8(Reason.KNOWN), np.uint8(Reason.NOT_TOLD))
        left_out = {"reason": told, "specimen": np.ones_like(told, bool), "lateral_period_um": told * np.float32("nan")}
        for name in [name for name in left_out if getattr(self, name).shape != told.shape]:
            object.__setattr__(self, name, left_out[name])
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class SurfaceMesh(_Value):
    """Triangles: `vertices_um` (P, 3), `faces` (F, 3) counter-clockwise from outside, `color` (P, 3) uint8.

    `picture` (H, W) uint8 is the micrograph on it, where there is one, and `uv` (P, 2) each vertex's place in it: u
    right, v up, 0 to 1 between the outer edges.
    """

    vertices_um: FloatArray
    faces: NDArray[np.int64]
    color: NDArray[np.uint8]
    length_unit: LengthUnit
    uv: FloatArray | None = None
    picture: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class SimulationTruth(_Value):
    """What a simulated series really is.

    `motion` is the true motion (its tilts are the true ones), `stage_tilt_rad` (V,) what the stage claims,
    `height_um` (H, W) the surface over the grid `world_from_grid` at zero tilt (highest point under each
    pixel, NaN where there is none), `normals` (H, W, 3), `visible` (V, H, W) where each view sees that point.
    `skew` is each view's shift along x per px of y, () for none; `working_distance_um` is finite for perspective.
    `mesh` is the whole surface where it is more than a height map.
    """

    motion: Motion
    stage_tilt_rad: FloatArray
    pixel_size_um: float
    height_um: FloatArray
    normals: FloatArray
    visible: BoolArray
    world_from_grid: FloatArray
    seed: int
    settings: Mapping[str, Any] = field(default_factory=dict)
    skew: tuple[float, ...] = ()
    working_distance_um: float = np.inf
    mesh: SurfaceMesh | None = None

    def select(self, indices: tuple[int, ...]) -> SimulationTruth:
        """Return the truth of the views `indices`, in that order; the surface is the same."""
        at = list(indices)
        return replace(
            self,
            motion=replace(
                self.motion,
                tilt_rad=self.motion.tilt_rad[at],
                roll_rad=self.motion.roll_rad[at],
                scale_px_per_um=self.motion.scale_px_per_um[at],
                anisotropy=self.motion.anisotropy[at],
                translation_px=self.motion.translation_px[at],
            ),
            stage_tilt_rad=self.stage_tilt_rad[at],
            visible=self.visible[at],
            skew=tuple(self.skew[i] for i in at) if self.skew else (),
        )


@dataclass(frozen=True, eq=False)
class StageReport(_Value):
    """A stage of a run: its name, wall seconds, figures, peak memory; `earlier` where an interrupted attempt did it."""

    name: str
    seconds: float
    figures: Mapping[str, Any] = field(default_factory=dict)
    peak_memory_mb: float = np.nan
    earlier: bool = False


@dataclass(frozen=True, eq=False)
class Report(_Value):
    """What a run did, in plain JSON values: see docs/run-folder.md for each key."""

    stages: tuple[StageReport, ...]
    options: Mapping[str, Any]
    seed: int
    versions: Mapping[str, str]
    inputs: tuple[Mapping[str, Any], ...]
    pairs: tuple[Mapping[str, Any], ...]
    metrics: Mapping[str, Any]
    warnings: tuple[str, ...]
    failures: tuple[str, ...]
    verdict: str
    peak_memory_mb: float = np.nan


@dataclass(frozen=True, eq=False)
class Result(_Value):
    """Everything that `semscape.reconstruct` made, stage by stage."""

    series: TiltSeries
    keypoints: tuple[Keypoints, ...]
    matches: tuple[Matches, ...]
    geometries: tuple[TwoViewGeometry, ...]
    reconstruction: Reconstruction
    height_map: HeightMap
    mesh: SurfaceMesh
    report: Report

    def _repr_html_(self) -> str:
        # For notebooks. Named, not imported: values know no reports until one is asked for.
        return str(import_module("semscape.report.notebook").notebook_html(self))
