"""Levelling, the F-operation of ISO 25178-3: fit a form and take it off.

Least squares weighs every known height alike. Robust fits are iteratively reweighted: two rounds of least absolute
values to come near the majority, then Tukey's biweight (constant 4.685, scale 1.4826 MAD), which gives weight zero to
what stands out, so that particles and holes do not tilt the reference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from semscape.errors import NoAnswerError
from semscape.metrology.grid import Spacing, spacing_xy
from semscape.types import BoolArray, FloatArray

FormName = Literal["none", "plane", "poly2", "poly3", "poly4", "sphere"]

_DEGREES: dict[str, int] = {"plane": 1, "poly2": 2, "poly3": 3, "poly4": 4}
_L1_ROUNDS, _BIWEIGHT_ROUNDS = 2, 20
_TUKEY, _MAD = 4.685, 1.4826
_CONVERGED = 1e-4  # of the scale: what the form may still move is a tenth of a permille of the roughness
_SPHERE_POINTS = 50_000
_FIRST_DAMPING, _SMALLEST_STEP, _MOST_STEPS = 1e-4, 1e-13, 100
Fit = Callable[[FloatArray | None], FloatArray]


@dataclass(frozen=True, eq=False)
class Levelled:
    """A height map without its form.

    `height` and `form` (H, W): their sum is the map that was given; `height` is NaN where that is NaN, or where the
    form does not reach (beside a sphere). `radius` is a sphere's, positive for a cap, negative for a cup, else NaN.
    """

    height: FloatArray
    form: FloatArray
    radius: float = np.nan


def level(
    height: FloatArray,
    spacing: Spacing,
    form: FormName = "plane",
    *,
    robust: bool = False,
    region: BoolArray | None = None,
) -> Levelled:
    """Fit a form to the known heights and subtract it.

    Parameters
    ----------
    height : (H, W) float array
        Heights, NaN = unknown.
    spacing : float or (dx, dy)
        Grid spacing, in the heights' unit.
    form : "none", "plane", "poly2", "poly3", "poly4" or "sphere"
        poly2 holds all terms x^i y^j with i + j <= 2, and so on. Polynomials minimize the vertical residuals, the
        sphere those along its normals (to first order; over at most 50,000 pixels, evenly spread).
    robust : bool
        Reweight, so that up to about a third of outliers does not count.
    region : (H, W) bool array, optional
        Where the form is fitted; it is subtracted everywhere.

    Raises
    ------
    NoAnswerError
        If too few heights are known for the form.

    References
    ----------
    ISO 25178-3; Holland & Welsch 1977, doi:10.1080/03610927708827533 (reweighting).

    Examples
    --------
    >>> rows, cols = np.indices((20, 30))
    >>> bool(np.abs(level(0.3 * cols - 0.1 * rows + 5, 0.5).height).max() < 1e-12)
    True
    """
    if form not in get_args(FormName):
        raise ValueError(f"form {form!r} is not one of {', '.join(get_args(FormName))}")
    if form == "none":
        return Levelled(height, np.zeros_like(height))
    used = np.isfinite(height) if region is None else np.isfinite(height) & region
    if form == "sphere":
        return _without_sphere(height, used, spacing_xy(spacing), robust=robust)
    fitted = _polynomial(height, used, _DEGREES[form], robust=robust)
    return Levelled(height - fitted, fitted)


def majority(levelled: FloatArray) -> BoolArray:
    """Return where a robustly levelled map has weight in its fit: known, and within the reach of Tukey's biweight."""
    size = np.abs(levelled)
    known: BoolArray = np.isfinite(levelled)
    if known.any():
        known &= np.nan_to_num(size, nan=np.inf) <= _TUKEY * _MAD * float(np.median(size[known]))
    return known


def polynomial_projector(known: BoolArray, degree: int) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return a function of (values, weights) that fits a polynomial of the grid's x and y and returns it on the grid.

    The moments of a grid separate into rows and columns, so that a fit costs two thin products. They are einsum's and
    not BLAS's: its threads change the last digit with their number, and wait for each other on a busy machine.
    """
    rows, cols = known.shape
    y, x = (np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in (rows, cols))
    powers_y, powers_x = (np.vander(axis, 2 * degree + 1, increasing=True) for axis in (y, x))
    terms = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    i_of, j_of = np.array(terms).T
    low_y, low_x = powers_y[:, : degree + 1], powers_x[:, : degree + 1]

    def fit(values: FloatArray, weights: FloatArray) -> FloatArray:
        moments = np.einsum("yi,yj->ij", powers_y, np.einsum("yx,xj->yj", weights, powers_x))
        right = np.einsum("yi,yj->ij", low_y, np.einsum("yx,xj->yj", weights * values, low_x))
        normal = moments[i_of[:, None] + i_of, j_of[:, None] + j_of]
        # lstsq and not solve: on a single row or column some terms say the same, and the shortest answer serves.
        solution = np.linalg.lstsq(normal, right[i_of, j_of], rcond=1e-13)[0]
        coefficients = np.zeros((degree + 1, degree + 1))
        coefficients[i_of, j_of] = solution
        surface: FloatArray = np.einsum("yi,xi->yx", low_y, np.einsum("xj,ij->xi", low_x, coefficients))
        return surface

    return fit


def _polynomial(height: FloatArray, used: BoolArray, degree: int, *, robust: bool) -> FloatArray:
    needed = (degree + 1) * (degree + 2) // 2
    if used.sum() < needed:
        raise NoAnswerError(f"{used.sum()} heights are known, a polynomial of degree {degree} needs {needed}")
    offset = float(np.mean(height[used]))
    values = np.where(used, height - offset, 0.0)
    fit = polynomial_projector(used, degree)

    def weighted(weights: FloatArray | None) -> FloatArray:
        spread = used.astype(np.float64)
        if weights is not None:
            spread[used] = weights
        return fit(values, spread)

    fitted = _reweighted(weighted, lambda surface: (values - surface)[used]) if robust else weighted(None)
    return fitted + offset


def _without_sphere(height: FloatArray, used: BoolArray, spacing: tuple[float, float], *, robust: bool) -> Levelled:
    if used.sum() < 4:
        raise NoAnswerError(f"{used.sum()} heights are known, a sphere needs 4")
    stride = max(1, int(np.ceil(np.sqrt(used.sum() / _SPHERE_POINTS))))
    thinned = used[::stride, ::stride]
    thinned = thinned if thinned.sum() >= 4 else used
    stride = stride if thinned.shape != used.shape else 1
    rows, cols = np.nonzero(thinned)
    x, y, z = cols * stride * spacing[0], rows * stride * spacing[1], height[rows * stride, cols * stride]
    # Numbers near one: the fit then holds for any unit and size.
    middle = np.array([x.mean(), y.mean(), z.mean()])
    reach = float(max(np.ptp(x), np.ptp(y), 1e-300)) / 2
    u, v, w = ((axis - centre) / reach for axis, centre in zip((x, y, z), middle, strict=True))
    start = _start_of_sphere(u, v, w)

    def fit(weights: FloatArray | None) -> FloatArray:
        return _fitted_sphere(start, u, v, w, np.ones_like(w) if weights is None else weights)

    found = _reweighted(fit, lambda p: _along_normal(p, u, v, w)[0]) if robust else fit(None)
    y_all, x_all = np.ogrid[: height.shape[0], : height.shape[1]]
    form = _sphere_height(found, (x_all * spacing[0] - middle[0]) / reach, (y_all * spacing[1] - middle[1]) / reach)
    form = form * reach + middle[2]
    curvature = found[3] / reach
    return Levelled(height - form, form, float(1 / curvature) if curvature != 0 else np.inf)


def _start_of_sphere(u: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    """Return (apex height, x slope, y slope, curvature) from the paraboloid w = c + p u + q v - k (u² + v²) / 2."""
    design = np.column_stack([np.ones_like(u), u, v, -(u * u + v * v) / 2])
    c, p, q, k = np.linalg.lstsq(design, w, rcond=None)[0]
    # A deep cap's paraboloid is more curved than the sphere; the whole field must lie on the sphere to begin with.
    limit = 0.9 / np.sqrt(2.0)
    return np.array([c, p, q, np.clip(k, -limit, limit)])


def _sphere_height(parameters: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the sphere's height, NaN beside it: w = c + p u + q v - k r² / (1 + sqrt(1 - k² r²)) about its middle.

    This is the sphere written by its curvature, which passes through zero (a plane) without a pole. The slopes p and
    q stand for the apex's place, p = k u0: a nearly flat cap has a slope, but hardly a place of its apex.
    """
    c, p, q, k = parameters
    # |k| (u - u0) squared, kept finite for k near zero: k² r² = (k u - p)² + (k v - q)².
    squared = (k * u - p) ** 2 + (k * v - q) ** 2
    inside = 1 - squared
    flat = 1 - (p * p + q * q)
    with np.errstate(invalid="ignore"):
        # sqrt(inside) - sqrt(flat) over k, by the difference of squares.
        numerator = 2 * (p * u + q * v) - k * (u * u + v * v)
        height: FloatArray = c + numerator / (np.sqrt(inside) + np.sqrt(flat))
    return height


def _fitted_sphere(start: FloatArray, u: FloatArray, v: FloatArray, w: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the parameters that minimize the weighted squares of the distances, by Levenberg's and Marquardt's way."""
    found, damping = start, _FIRST_DAMPING
    distance, jacobian = _along_normal(found, u, v, w)
    cost = float((weights * distance**2).sum())
    for _ in range(_MOST_STEPS):
        weighted = weights * jacobian
        normal, gradient = np.einsum("in,jn->ij", weighted, jacobian), np.einsum("in,n->i", weighted, distance)
        step = -np.linalg.lstsq(normal + damping * np.diag(np.diagonal(normal)), gradient, rcond=1e-14)[0]
        trial = found + step
        its_distance, its_jacobian = _along_normal(trial, u, v, w)
        its_cost = float((weights * its_distance**2).sum())
        if its_cost <= cost:
            found, distance, jacobian, cost = trial, its_distance, its_jacobian, its_cost
            damping *= 0.1
        else:
            damping = max(10 * damping, _FIRST_DAMPING)
        if np.abs(step).max() < _SMALLEST_STEP:
            break
    return found


def _along_normal(parameters: FloatArray, u: FloatArray, v: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distances (N,) from the sphere along its normals, and their derivatives (4, N) by the parameters.

    Points beside the sphere count from its rim. No sphere is as steep as p² + q² = 1: from there all is far.
    """
    c, p, q, k = parameters
    if p * p + q * q >= 1:
        return np.full_like(w, 1e3), np.zeros((4, len(w)))
    # Exact for a sphere: its points have sqrt((k u - p)² + (k v - q)² + (k rise + flat)²) = 1. The norm less 1, over k,
    # is excess / (1 + norm) with norm² = 1 + k excess: without a pole at k = 0.
    flat = np.sqrt(1 - p * p - q * q)
    rise = w - c
    square = u * u + v * v + rise * rise
    excess = k * square - 2 * (p * u + q * v) + 2 * flat * rise
    norm = np.sqrt(np.maximum(1 + k * excess, 1e-12))
    distance: FloatArray = excess / (1 + norm)
    slopes = [-(k * rise + flat), -(u + rise * (p / flat)), -(v + rise * (q / flat)), 0.5 * (square - distance**2)]
    return distance, np.stack(slopes) / norm


def _reweighted(fit: Fit, residuals: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return the fit with the weights of least absolute values first, then of Tukey's biweight, until they settle."""
    found = fit(None)
    last = np.inf
    for turn in range(_L1_ROUNDS + _BIWEIGHT_ROUNDS):
        size = np.abs(residuals(found))
        scale = _MAD * float(np.median(size))
        if scale <= 1e-12 * max(float(size.max()), 1e-300):
            break  # the majority lies on the form exactly
        if turn < _L1_ROUNDS:
            weights = scale / np.maximum(size, 0.1 * scale)
        else:
            weights = np.maximum(1 - (size / (_TUKEY * scale)) ** 2, 0.0) ** 2
            if abs(scale - last) <= _CONVERGED * scale:
                break
            last = scale
        found = fit(weights)
    return found
