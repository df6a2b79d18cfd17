"""The difference of two height maps of one surface after rigid registration: wear, deposition, deformation.

The second map is moved onto the first by a turn in the image plane, a shift, a tilt and a height offset (six unknowns),
by iterated least squares on the height differences along z (point-to-plane, Chen & Medioni 1992), from coarse to fine.
Tukey's biweight keeps what has really changed, worn or added, from pulling the maps towards each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from semscape.errors import NoAnswerError
from semscape.metrology.filters import gaussian_smoother
from semscape.metrology.grid import Spacing, spacing_xy
from semscape.metrology.level import level
from semscape.types import BoolArray, FloatArray

_COARSEST_PX = 64
_TURNS_PER_LEVEL = 30
_MOVED_PX = 1e-3
_TUKEY, _MAD = 4.685, 1.4826
_LEAST_OVERLAP = 0.1
_LEAST_KNOWN = 100
_MOST_SAMPLES = 200_000


@dataclass(frozen=True, eq=False)
class Comparison:
    """Difference of two maps.

    `difference` (H, W) on the first map's grid: second less first, NaN where either is unknown. `moved` (H, W) is the
    second map in that grid. `first_from_second` (4, 4) maps points (x right, y down from the centre of the top-left
    pixel, z), in the maps' unit. `overlap` is the share of the first map's known heights that the second has, too;
    `residual_sigma` the robust (1.4826 MAD) spread of the difference.
    """

    difference: FloatArray
    moved: FloatArray
    first_from_second: FloatArray
    overlap: float
    residual_sigma: float


def compare(first: FloatArray, second: FloatArray, spacing: Spacing) -> Comparison:
    """Register the second map to the first and subtract.

    Parameters
    ----------
    first, second : (H, W) float arrays
        Heights on grids of the same spacing, of any two shapes, NaN = unknown. The maps may be shifted by up to half
        the field and turned by some degrees; it takes relief that both share.
    spacing : float or (dx, dy)
        Grid spacing, in the heights' unit.

    Raises
    ------
    NoAnswerError
        If the maps overlap by less than 10 %.

    References
    ----------
    Chen & Medioni 1992, doi:10.1016/0262-8856(92)90066-C.
    """
    dx, dy = spacing_xy(spacing)
    for name, height in (("first", first), ("second", second)):
        known = int(np.isfinite(height).sum())
        if known < _LEAST_KNOWN:
            raise NoAnswerError(f"the {name} map has {known} known heights, need {_LEAST_KNOWN}")
    smallest = min(*first.shape, *second.shape)
    strides = [s for s in (8, 4, 2, 1) if s == 1 or smallest // s >= _COARSEST_PX]
    matrix: FloatArray | None = None
    for stride in strides:
        coarse, step = (_coarser(first, stride), _coarser(second, stride)), (dx * stride, dy * stride)
        matrix = _refined(*coarse, _start(*coarse, step) if matrix is None else matrix, step, stride)
    assert matrix is not None
    moved = resample(second, matrix, first.shape, (dx, dy))
    difference = moved - first
    both = np.isfinite(difference)
    overlap = float(both.sum() / np.isfinite(first).sum())
    if overlap < _LEAST_OVERLAP:
        raise NoAnswerError(f"the two maps share {overlap:.0%} of the field only, need {_LEAST_OVERLAP:.0%}")
    spread = np.abs(difference[both] - np.median(difference[both]))
    return Comparison(difference, moved, matrix, overlap, _MAD * float(np.median(spread)))


def resample(
    second: FloatArray, first_from_second: FloatArray, shape: tuple[int, int], spacing: tuple[float, float]
) -> FloatArray:
    """Return a map as it looks in another grid after a rigid motion; NaN where nothing known comes to lie.

    The height under a pixel of the new grid depends on the place in the old one, and that on the height: three rounds
    settle it, for tilts are small.
    """
    dx, dy = spacing
    second_from_first = np.linalg.inv(first_from_second)
    rows, cols = np.indices(shape, dtype=np.float64)
    x, y = cols * dx, rows * dy
    # Start on the second map's mean plane, as the first sees it.
    z = np.full(shape, first_from_second[2, 3] + float(np.nanmean(second)))
    for _ in range(3):
        u = second_from_first[0, 0] * x + second_from_first[0, 1] * y + second_from_first[0, 2] * z
        v = second_from_first[1, 0] * x + second_from_first[1, 1] * y + second_from_first[1, 2] * z
        u, v = u + second_from_first[0, 3], v + second_from_first[1, 3]
        w = ndimage.map_coordinates(second, [v / dy, u / dx], order=1, mode="constant", cval=np.nan)
        risen = first_from_second[2, 0] * u + first_from_second[2, 1] * v + first_from_second[2, 2] * w
        risen = risen + first_from_second[2, 3]
        z = np.where(np.isfinite(risen), risen, z)
    return np.where(np.isfinite(w), z, np.nan)


def _start(first: FloatArray, second: FloatArray, spacing: tuple[float, float]) -> FloatArray:
    """Return the shift, and the tilt between the two maps' planes, that bring the reliefs together."""
    reliefs = [level(height, spacing, "plane", robust=True) for height in (first, second)]
    shape = [fft.next_fast_len(a + b, real=True) for a, b in zip(first.shape, second.shape, strict=True)]
    spectra, masks = [], []
    for relief in reliefs:
        known = np.isfinite(relief.height)
        limit = 3 * _MAD * float(np.median(np.abs(relief.height[known])))
        spectra.append(fft.rfft2(np.where(known, np.clip(relief.height, -limit, limit), 0.0), shape))
        masks.append(fft.rfft2(known.astype(np.float64), shape))
    products = fft.irfft2(spectra[0] * spectra[1].conj(), shape)
    pairs = fft.irfft2(masks[0] * masks[1].conj(), shape)
    # Mean product per pair, shrunk where few pairs are left: a corner that agrees by chance must not win.
    score = products / (pairs + 0.25 * pairs.max())
    row, col = np.unravel_index(int(np.argmax(score)), score.shape)
    shift_y = (row if row < first.shape[0] else row - shape[0]) * spacing[1]
    shift_x = (col if col < first.shape[1] else col - shape[1]) * spacing[0]
    planes = [relief.form for relief in reliefs]
    slopes = [(_slope(plane, 1) / spacing[0], _slope(plane, 0) / spacing[1]) for plane in planes]
    tilt = np.array(slopes[0]) - np.array(slopes[1])
    matrix = _rigid(np.array([tilt[1], -tilt[0], 0.0, shift_x, shift_y, 0.0]))
    moved = resample(second, matrix, first.shape, spacing)
    both = np.isfinite(moved) & np.isfinite(first)
    if both.any():
        matrix[2, 3] -= float(np.median((moved - first)[both]))
    return matrix


def _slope(plane: FloatArray, axis: int) -> float:
    return float(np.mean(np.diff(plane, axis=axis))) if plane.shape[axis] > 1 else 0.0


def _coarser(height: FloatArray, stride: int) -> FloatArray:
    """Return every stride-th height of the smoothed map, its pixel (0, 0) kept in place."""
    if stride == 1:
        return height
    smooth = gaussian_smoother(np.isfinite(height), 1.0, 2.0 * stride, single=True)(height)
    thinned: FloatArray = smooth[::stride, ::stride]
    return thinned


def _refined(
    first: FloatArray, second: FloatArray, matrix: FloatArray, spacing: tuple[float, float], stride: int
) -> FloatArray:
    dx, dy = spacing
    slope_y, slope_x = np.gradient(first, dy, dx)
    rows, cols = np.nonzero(np.isfinite(second))
    thin = max(1, len(rows) // _MOST_SAMPLES)
    rows, cols = rows[::thin], cols[::thin]
    points = np.column_stack([cols * dx, rows * dy, second[rows, cols]])
    for _ in range(_TURNS_PER_LEVEL):
        x, y, z = (points @ matrix[:3, :3].T + matrix[:3, 3]).T
        at = [y / dy, x / dx]
        below, p, q = (
            ndimage.map_coordinates(a, at, order=1, mode="constant", cval=np.nan) for a in (first, slope_x, slope_y)
        )
        residual = z - below
        usable: BoolArray = np.isfinite(residual) & np.isfinite(p) & np.isfinite(q)
        if usable.sum() < _LEAST_KNOWN:
            raise NoAnswerError(
                f"the two maps share {usable.sum()} heights only; they must show the same place at the same pixel size"
            )
        x, y, z, residual, p, q = (a[usable] for a in (x, y, z, residual, p, q))
        # Never finer than rounding: a map may be compared with itself.
        scale = max(_MAD * float(np.median(np.abs(residual))), 1e-9 * float(np.ptp(z)), 1e-300)
        weight = np.maximum(1 - (residual / (_TUKEY * scale)) ** 2, 0.0) ** 2
        # Turning about the points' middle keeps the unknowns apart.
        centre = np.array([x.mean(), y.mean(), z.mean()])
        x, y, z = x - centre[0], y - centre[1], z - centre[2]
        # d residual of a small turn (a, b, c) and shift: the point moves by turn x point + shift, the surface under it
        # by its slope times that.
        jacobian = np.column_stack([y + q * z, -x - p * z, p * y - q * x, -p, -q, np.ones_like(p)])
        reach = np.array([np.hypot(np.std(x), np.std(y))] * 3 + [1.0] * 3)
        scaled = jacobian / reach
        normal = scaled.T @ (weight[:, None] * scaled)
        # A surface without relief leaves shift and turn open; the ridge holds what nothing fixes.
        normal += 1e-9 * np.trace(normal) * np.eye(6)
        change = -np.linalg.solve(normal, scaled.T @ (weight * residual)) / reach
        step = _rigid(change)
        to_centre, back = np.eye(4), np.eye(4)
        to_centre[:3, 3], back[:3, 3] = -centre, centre
        matrix = back @ step @ to_centre @ matrix
        if (np.abs(change) * reach).max() < _MOVED_PX * dx / stride:
            break
    return matrix


def _rigid(parameters: FloatArray) -> FloatArray:
    """Return the (4, 4) motion of a rotation vector and a shift."""
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(parameters[:3]).as_matrix()
    matrix[:3, 3] = parameters[3:]
    return matrix
