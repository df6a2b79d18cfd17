"""What two views of one scene may have in common: four models over one small protocol.

All models are 3 x 3 matrices. Inside this package points are centred and divided by the images' longest side; a
`Frame` takes matrices there and back.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from semscape.robust import refit
from semscape.robust.five_point import solve_essential
from semscape.robust.minimal import solve_affine, solve_fundamental, solve_homography
from semscape.robust.score import AFFINE_LINE, LINE, POINT, squared_residuals
from semscape.types import FloatArray, IntArray

Shape = tuple[int, int]


@dataclass(frozen=True)
class Frame:
    """Centred coordinates of about unit size for two images: x' = (x - centre) / unit."""

    centre1: FloatArray
    centre2: FloatArray
    unit_px: float

    @classmethod
    def of(cls, shapes: tuple[Shape, Shape]) -> Frame:
        """Return the frame of two images of shapes (H, W)."""
        centre1, centre2 = (np.array([(width - 1) / 2, (height - 1) / 2]) for height, width in shapes)
        return cls(centre1, centre2, float(max(max(shape) for shape in shapes)))

    def normalized(self, x1: FloatArray, x2: FloatArray) -> FloatArray:
        """Return matches (n, 4) in this frame."""
        w = np.empty((len(x1), 4))
        np.subtract(x1, self.centre1, out=w[:, :2])
        np.subtract(x2, self.centre2, out=w[:, 2:])
        w /= self.unit_px
        return w

    @property
    def from_pixels(self) -> tuple[FloatArray, FloatArray]:
        """The two 3 x 3 matrices that take homogeneous px points to this frame."""
        return _similarity(self.centre1, self.unit_px), _similarity(self.centre2, self.unit_px)


def _similarity(centre: FloatArray, unit_px: float) -> FloatArray:
    x, y = centre / unit_px
    return np.array([[1 / unit_px, 0, -x], [0, 1 / unit_px, -y], [0, 0, 1.0]])


@dataclass(frozen=True)
class Model:
    """One kind of two-view model.

    Parameters
    ----------
    kind : str
        "affine", "fundamental", "homography" or "essential".
    sample_size, max_solutions : int
        Matches of a minimal sample (Ns), and the most models that one can give.
    dimension : int
        1 where the residual is a distance to a line, 2 to a point.
    residual : int
        Which residual `semscape.robust.score` computes.
    solve : compiled function
        Turns samples into matrices, see `semscape.robust.minimal`.
    fit : function
        Least squares (n, 4) -> (3, 3); None where the matches do not determine the model.
    calibration : (3, 3) arrays, optional
        Of both cameras, for the essential matrix.
    settle : function, optional
        The last fit, as `fit`, where least squares leaves the model to a few matches.
    """

    kind: str
    sample_size: int
    max_solutions: int
    dimension: int
    residual: int
    solve: Callable[..., None]
    fit: Callable[[FloatArray], FloatArray | None]
    calibration: tuple[FloatArray, FloatArray] | None = None
    settle: Callable[[FloatArray], FloatArray | None] | None = None

    def log10_alpha0(self, shapes: tuple[Shape, Shape]) -> float:
        """Return log10 of the chance that a wrong match has a residual below 1 px.

        The residual is the larger of those in the two images, so the smaller chance of the two holds.
        """
        if self.dimension == 1:
            return math.log10(min(2 * math.hypot(*shape) / math.prod(shape) for shape in shapes))
        return math.log10(math.pi / max(math.prod(shape) for shape in shapes))

    def solve_samples(self, w: FloatArray, samples: IntArray, frame: Frame) -> tuple[FloatArray, IntArray]:
        """Return matrices (B, S, 3, 3) in the frame, and how many of each row count (B,)."""
        matrices = np.zeros((len(samples), self.max_solutions, 3, 3))
        count = np.zeros(len(samples), dtype=np.int64)
        if self.calibration is None:
            self.solve(w, samples, matrices, count)
            return matrices, count
        to_rays1, to_rays2 = self._rays_from(frame)
        rays = np.hstack([_transformed(to_rays1, w[:, :2]), _transformed(to_rays2, w[:, 2:])])
        self.solve(rays, samples, matrices, count)
        return to_rays2.T @ matrices @ to_rays1, count

    def fit_matches(self, w: FloatArray, frame: Frame) -> FloatArray | None:
        """Return the least-squares model (3, 3) in the frame of matches (n, 4) in it."""
        if self.calibration is None:
            return self.fit(w)
        to_rays1, to_rays2 = self._rays_from(frame)
        matrix = self.fit(np.hstack([_transformed(to_rays1, w[:, :2]), _transformed(to_rays2, w[:, 2:])]))
        return None if matrix is None else np.asarray(to_rays2.T @ matrix @ to_rays1)

    def residuals_px(self, matrix: FloatArray, points: FloatArray, frame: Frame) -> FloatArray:
        """Return the residual (n,) in px of matches whose coordinates are the rows of `points` (4, n)."""
        squared = np.empty(points.shape[1])
        squared_residuals(self.residual, np.ascontiguousarray(matrix), points, 0, len(squared), squared)
        return np.sqrt(squared) * frame.unit_px

    def in_pixels(self, matrix: FloatArray, frame: Frame) -> FloatArray:
        """Return a matrix of the frame for homogeneous px points, of Frobenius norm 1."""
        from_pixels1, from_pixels2 = frame.from_pixels
        if self.dimension == 2:
            pixels = np.linalg.solve(from_pixels2, matrix @ from_pixels1)
        else:
            pixels = from_pixels2.T @ matrix @ from_pixels1
        if self.kind == "affine":
            pixels[:2, :2] = 0.0  # exactly: what is left there is rounding
        return np.asarray(pixels / np.linalg.norm(pixels))

    def _rays_from(self, frame: Frame) -> tuple[FloatArray, FloatArray]:
        assert self.calibration is not None
        from_pixels1, from_pixels2 = frame.from_pixels
        calibration1, calibration2 = self.calibration
        return _inverse(from_pixels1 @ calibration1), _inverse(from_pixels2 @ calibration2)


def essential(calibration1: FloatArray, calibration2: FloatArray) -> Model:
    """Return the model of two calibrated perspective cameras, from their upper triangular 3 x 3 matrices in px.

    The matrix that comes out is the fundamental one, for px points; K2^T F K1 is the essential matrix.
    """
    return Model("essential", 5, 10, 1, LINE, solve_essential, refit.fit_essential, (calibration1, calibration2))


def _inverse(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _transformed(matrix: FloatArray, xy: FloatArray) -> FloatArray:
    return np.asarray(xy @ matrix[:2, :2].T + matrix[:2, 2])


AFFINE = Model("affine", 4, 1, 1, AFFINE_LINE, solve_affine, refit.fit_affine, settle=refit.fit_affine_bounded)
FUNDAMENTAL = Model("fundamental", 7, 3, 1, LINE, solve_fundamental, refit.fit_fundamental)
HOMOGRAPHY = Model("homography", 4, 1, 2, POINT, solve_homography, refit.fit_homography)
