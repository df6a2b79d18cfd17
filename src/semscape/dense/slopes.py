"""A linear term for the most probable surface: something seen on it that its slopes and heights explain, in a band.

Of a field r that is left over at the present heights, a change x of the heights explains a x + bx dx/dcolumn +
by dx/drow. Both are compared in a band of wavelengths alone: the difference of two Gaussians, on pixels of twice the
size, for it holds nothing finer. What is left there is taken for noise that is white but for the finer Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.dense.sampling import gaussian_window
from semscape.types import BoolArray, FloatArray, ImageArray

Plane = NDArray[np.float32]

# Finer is the noise of electrons, coarser is better known from parallax.
_FINE_PX, _COARSE_PX = 1.5, 7.0
# The mean of 2 x 2 px widens a Gaussian's variance by a quarter.
_CORRELATED_PX2 = 4 * np.pi * (_FINE_PX**2 + 0.25)
_LOCAL_PX = 4.0
_NOISE_PX = 12.0
_LEAST_VARIANCE = 1e-9
# Of the windows of both Gaussians, so much must be seen.
_WHOLLY_COVERED, _HALF_COVERED = 0.9, 0.5


@dataclass(frozen=True, eq=False)
class Band:
    """The band of wavelengths that count, of what is seen of a field: one over the shares (H / 2, W / 2) of that."""

    fine: Plane
    coarse: Plane

    def of(self, values: Plane) -> Plane:
        """Return the difference of two Gaussian means of values, 0 where nothing is seen."""
        return np.asarray(self.fine * _blurred(values, _FINE_PX) - self.coarse * _blurred(values, _COARSE_PX))

    def transposed(self, values: Plane) -> Plane:
        """Return the transpose of `of`."""
        return np.asarray(_blurred(self.fine * values, _FINE_PX) - _blurred(self.coarse * values, _COARSE_PX))


def band_of(seen: Plane) -> tuple[Band, BoolArray]:
    """Return the band where so much (H / 2, W / 2) is seen, and where enough is seen for it."""
    fine, coarse = (_blurred(seen, sigma) for sigma in (_FINE_PX, _COARSE_PX))
    enough = (seen == 1) & (fine > _WHOLLY_COVERED) & (coarse > _HALF_COVERED)
    one_over = (1 / np.maximum(share, np.float32(_HALF_COVERED / 2)) for share in (fine, coarse))
    return Band(*(np.asarray(each, np.float32) for each in one_over)), enough


@dataclass(frozen=True, eq=False)
class SlopeTerm:
    """How a field that is left over changes with heights (H, W), and how sure it is, on pixels of twice the size.

    `by_height`, `by_column` and `by_row` (H, W) are what it changes by per px of height and per unit of slope along
    columns' and rows' numbers, 0 where it is not seen; `precision` (H / 2, W / 2) is that of the banded field per pixel
    there, `left` the banded field itself, and `band` how it is banded.
    """

    by_height: Plane
    by_column: Plane
    by_row: Plane
    precision: Plane
    left: Plane
    band: Band

    def product(self, change: Plane) -> Plane:
        """Return A' P A x for a change x (H, W) of the heights."""
        return self._back(self.precision * self.band.of(self._gathered(change)))

    def pull(self) -> Plane:
        """Return -A' P times what is left: how hard it pulls the heights (H, W)."""
        return -self._back(self.precision * self.left)

    def at_rest(self) -> SlopeTerm:
        """Return the same term with nothing left over."""
        return replace(self, left=np.zeros_like(self.left))

    def slope_precision(self) -> Plane:
        """Return how precisely slopes (H, W) are told, per px, beside the band's response."""
        shape = self.by_column.shape
        squared = gaussian_window(self.by_column**2 + self.by_row**2, _LOCAL_PX)
        local = gaussian_window(self.precision, _LOCAL_PX / 2) / np.float32(4)
        resized = cv2.resize(local, shape[::-1], interpolation=cv2.INTER_LINEAR)
        return np.asarray(squared * resized, np.float32)

    def _gathered(self, change: Plane) -> Plane:
        rows, cols = change.shape
        out = np.zeros((rows // 2, cols // 2), np.float32)
        _explain(change, self.by_height, self.by_column, self.by_row, out)
        return out

    def _back(self, values: Plane) -> Plane:
        out = np.zeros(self.by_height.shape, np.float32)
        _explain_transposed(self.band.transposed(values), self.by_height, self.by_column, self.by_row, out)
        return out


def slope_term(
    field: ImageArray,
    seen: ImageArray,
    by_height: ImageArray,
    by_column: ImageArray,
    by_row: ImageArray,
    least_variance: ImageArray | None = None,
) -> tuple[SlopeTerm, ImageArray]:
    """Make the term of a field that is left over, and return it with the variance of the banded field.

    Parameters
    ----------
    field : (H, W) float32 array
    seen : (H, W) float32 array
        1 where it is known.
    by_height, by_column, by_row : (H, W) float32 arrays
    least_variance : (H / 2, W / 2) float32 array
        Below it no variance is believed.
    """
    # At the border there is no slope.
    seen = np.pad(seen[1:-1, 1:-1], 1)
    band, inside = band_of(halved(seen))
    middle = np.median(field[seen > 0]) if seen.any() else 0.0
    left = band.of(halved(np.asarray((field - middle) * seen, np.float32)))
    counted = inside.astype(np.float32)
    share = np.maximum(gaussian_window(counted, _NOISE_PX / 2), np.float32(1e-2))
    variance = np.maximum(gaussian_window(left * left * counted, _NOISE_PX / 2) / share, np.float32(_LEAST_VARIANCE))
    believed = variance if least_variance is None else np.maximum(variance, least_variance)
    precision = np.asarray(counted * np.float32(4 / _CORRELATED_PX2) / believed, np.float32)
    height, column, row = (np.asarray(plane * seen, np.float32) for plane in (by_height, by_column, by_row))
    return SlopeTerm(height, column, row, precision, left, band), variance


def _blurred(values: Plane, sigma_px: float) -> Plane:
    blurred: Plane = cv2.GaussianBlur(values, (0, 0), sigma_px / 2, borderType=cv2.BORDER_CONSTANT)
    return blurred


def halved(values: ImageArray) -> Plane:
    """Return the means of 2 x 2 px of values (H, W); of an odd last row or column nothing is kept."""
    rows, cols = (size // 2 * 2 for size in values.shape)
    even = np.asarray(values[:rows, :cols], np.float32)
    return np.asarray((even[::2, ::2] + even[::2, 1::2] + even[1::2, ::2] + even[1::2, 1::2]) / 4, np.float32)


def response(frequency: FloatArray) -> FloatArray:
    """Return the squared response (N, N) of a term to waves of height, for slopes of any direction.

    `frequency` (N,) is that of rows and of columns, in rad per px.

    Examples
    --------
    What is even, and what is finer than the beam, tells no slopes:

    >>> squared = response(np.linspace(0.01, 3.0, 30))
    >>> bool(squared[0, 0] < 1e-3 * squared.max() and squared[-1, -1] < 1e-3 * squared.max())
    True
    """
    distance = frequency[:, None] ** 2 + frequency[None, :] ** 2
    fine, coarse = (np.exp(-distance * sigma**2 / 2) for sigma in (_FINE_PX, _COARSE_PX))
    slope = np.sin(frequency) ** 2
    return np.asarray((slope[:, None] + slope[None, :]) / 2 * (fine - coarse) ** 2, np.float64)


@njit(cache=True, nogil=True, fastmath=True)
def _explain(
    change: Plane, by_height: Plane, by_column: Plane, by_row: Plane, out: Plane
) -> None:  # pragma: no cover - compiled
    """Add to pixels of twice the size the mean of what a change of the heights explains."""
    rows, cols = change.shape
    quarter, half, zero = np.float32(0.25), np.float32(0.5), np.float32(0)
    for r in range(2 * len(out)):
        own = out[r // 2]
        for c in range(2 * out.shape[1]):
            along = half * (change[r, c + 1] - change[r, c - 1]) if 0 < c < cols - 1 else zero
            down = half * (change[r + 1, c] - change[r - 1, c]) if 0 < r < rows - 1 else zero
            value = by_height[r, c] * change[r, c] + by_column[r, c] * along + by_row[r, c] * down
            own[c // 2] += quarter * value


@njit(cache=True, nogil=True, fastmath=True)
def _explain_transposed(
    values: Plane, by_height: Plane, by_column: Plane, by_row: Plane, out: Plane
) -> None:  # pragma: no cover - compiled
    rows, cols = out.shape
    quarter, half = np.float32(0.25), np.float32(0.5)
    for r in range(2 * len(values)):
        for c in range(2 * values.shape[1]):
            value = quarter * values[r // 2, c // 2]
            out[r, c] += by_height[r, c] * value
            if 0 < c < cols - 1:
                along = half * by_column[r, c] * value
                out[r, c + 1] += along
                out[r, c - 1] -= along
            if 0 < r < rows - 1:
                down = half * by_row[r, c] * value
                out[r + 1, c] += down
                out[r - 1, c] -= down
