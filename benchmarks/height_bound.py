"""How well any matching could know the heights of the nominal simulated series: `python benchmarks/height_bound.py`.

The views are rendered without noise and linearized at the true surface: a height that is off by dh shifts what view i
shows of a point by g_i dh, so each pixel tells its own height with the precision

    k = (sum_i w_i a_i^2) - (sum_i w_i a_i)^2 / sum_i w_i

where a_i is what the blurred view gains per px of height, 1 / w_i the noise variance of the electrons counted there,
and the last term what goes to the unknown brightness of the point. All that an estimator is told of a surface by such
images is y = h + noise of variance 1 / k. Three of them are asked, all at the truth, where nothing can be mismatched:

- `windows`: heights constant over square windows, no prior; sigma by the bound of Cramer and Rao, and what the surface
  departs from its window's plane;
- `best_window`: at every pixel the window whose error, known from the truth, is least;
- `oracle`: the most probable surface under a prior of second differences whose variance at every place is told by the
  truth, times the factor of 1, 4 and 16 that errs least, and which is cut at the true jumps: what `dense.posterior`
  would say if it knew all that it has to find out.

The oracle is asked with the noise alone, with the drift and jitter of the series' scans, with shading that changes with
the tilt, and with all. Drift is added as it is: the part of five shifts of a row that looks like a height is a shape.
Shading is what the views show of the same points beside their mean, less gain and offset over 2.5 px.

`noise-NAME` needs no linear model: the dense stage itself, on images of 0 to 2 times the noise, without other faults.

References: Cramer 1946, "Mathematical methods of statistics", ch. 32; Rao 1945, Bull. Calcutta Math. Soc. 37.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from isolated import Case, run_cases

if TYPE_CHECKING:
    from collections.abc import Callable

    from scipy import sparse

    from semscape.types import BoolArray, FloatArray

_SPECIMENS = ("fracture", "spheres", "vickers", "grating", "pollen")
_SEED = 0
_TRIM = 0.95
_WINDOWS_PX = (1, 3, 5, 7, 9, 11, 15, 21)
_LOCAL_PX = 4.0
_NORMALIZING_PX = 2.5
_JUMP_DISPARITY_PX = 1.0
_COLUMNS = 192
_PRIOR_FACTORS = (1.0, 4.0, 16.0)
_TOLERANCE = 1e-3
_MOST_STEPS = 1000
_NOISE = (0.0, 0.5, 1.0, 2.0)
# Sixth order: images of a beam of 1 px hold frequencies for which plain differences are too flat.
_DERIVATIVE = (-1 / 60, 3 / 20, -3 / 4, 0.0, 3 / 4, -3 / 20, 1 / 60)


@dataclass(frozen=True, eq=False)
class Told:
    """What the views tell of each pixel's height, and what disturbs it; (H, W), heights in px.

    `precision` is k, `judged` where two views or more see the surface; `drift`, `jitter` and `shading` are the heights
    that these faults feign.
    """

    height: FloatArray
    normals: FloatArray
    precision: FloatArray
    judged: BoolArray
    drift: FloatArray
    jitter: FloatArray
    shading: FloatArray
    baseline: float

    def columns(self, kept: slice) -> Told:
        """Return some columns alone, of all rows: drift goes along these."""
        return replace(self, **{k: v[:, kept] for k, v in vars(self).items() if k != "baseline"})


def measure_bound(specimen: str) -> dict[str, Any]:
    """Return the least errors of heights and normals, by what the images suffer from."""
    import numpy as np

    told = told_by(specimen)
    noise = np.random.default_rng(_SEED).standard_normal(told.height.shape) / np.sqrt(told.precision)
    row = {"specimen": specimen} | _windows(told, noise)
    still = np.zeros_like(noise)
    tried = {}
    for factor in _PRIOR_FACTORS:
        smoothed = oracle(told, factor)
        error = smoothed(told.height + noise, told.height) - told.height
        tried[factor] = _figures(error, told)["median_px"], error, smoothed
    factor = min(tried, key=lambda each: tried[each][0])
    _, error, smoothed = tried[factor]
    row["prior_factor"] = {f"{each:g}": tried[each][0] for each in tried}
    # The oracle is linear: what it makes of a sum is the sum of what it makes of each.
    drift, jitter, shading = (smoothed(values, still) for values in (told.drift, told.jitter, told.shading))
    errors = {
        "noise": error,
        "noise_drift_jitter": error + drift + jitter,
        "noise_shading": error + shading,
        "all": error + drift + jitter + shading,
        "drift_alone": drift,
        "jitter_alone": jitter,
        "shading_alone": shading,
    }
    return row | {"oracle": {name: _figures(each, told) for name, each in errors.items()}}


def measure_noise(specimen: str) -> dict[str, Any]:
    """Return the errors of the dense stage with true cameras, of images with no fault but blur and so much noise."""
    from accuracy_dense import calibrated, surface_errors
    from semscape.dense.surface import dense_surface
    from semscape.options import DenseOptions
    from semscape.simulate import PRESETS, simulate

    nominal = PRESETS["nominal"]
    quiet = replace(nominal, drift_px=0.0, jitter_px=0.0, line_noise=0.0, charging=0.0, brightness=0.0, contrast=0.0)
    cameras = None
    levels = {}
    for level in sorted(_NOISE, reverse=True):
        dose = nominal.dose / level**2 if level else 0.0
        series, truth = simulate(specimen, replace(quiet, dose=dose), rng=_SEED)
        if cameras is None:
            cameras = replace(calibrated(series), motion=truth.motion)
        found = dense_surface(series, cameras, DenseOptions()).height_map
        levels[f"{level:g}"] = surface_errors(specimen, found, cameras, truth)
    return {"levels": dict(sorted(levels.items()))}


def told_by(specimen: str) -> Told:
    """Render the nominal series of a specimen without faults but blur, and say what its pixels tell."""
    import numpy as np
    from scipy import ndimage

    from semscape.simulate import PRESETS, SPECIMENS, faults
    from semscape.simulate.camera import scan_cameras
    from semscape.simulate.render import Scene, render_signal, truth_grid, visible_points
    from semscape.simulate.series import draw_motion, specimen_size

    options = PRESETS["nominal"]
    motion, _, skew = draw_motion(options, _SEED)
    cameras = scan_cameras(motion, skew, math.inf)
    made = SPECIMENS[specimen](specimen_size(options, cameras), faults.stream(_SEED, "specimen"))
    scene = Scene(made, options, 2)
    height_um, normals, world_from_grid = truth_grid(scene)
    shape = height_um.shape
    row, col = np.indices(shape)
    grid = np.column_stack([col.ravel(), row.ravel(), height_um.ravel(), np.ones(row.size)])
    points = np.asarray(grid @ world_from_grid[:3].T, np.float64)
    still = np.zeros((options.height_px, 2))
    quiet = replace(options, jitter_px=0.0)
    weight, gain, looks, drift, jitter = (np.zeros((len(cameras), *shape)) for _ in range(5))
    for i, camera in enumerate(cameras):
        signal, depth = render_signal(scene, camera, (motion.axis_angle_rad, float(motion.tilt_rad[i])), still)
        blurred = faults.blur_beam(signal[0], depth / options.pixel_size_um, options)
        blurred /= blurred[blurred > 0].mean()
        up = camera.scan @ camera.rotation[:2, 2] * options.pixel_size_um
        along_y, along_x = (ndimage.correlate1d(blurred, _DERIVATIVE, axis, mode="nearest") for axis in (0, 1))
        at = camera.project(points).T[::-1]

        def seen(image: FloatArray, at: FloatArray = at, order: int = 1) -> FloatArray:
            return np.asarray(ndimage.map_coordinates(image, at, order=order, mode="nearest").reshape(shape))

        looks[i] = seen(blurred, order=3)
        gain[i] = seen(along_x * up[0] + along_y * up[1])
        visible = visible_points(scene, points, camera).reshape(shape)
        weight[i] = np.where(visible, options.dose / np.maximum(looks[i], 0.01), 0.0)
        smooth, whole = (faults.scan_offsets(each, _SEED, i) for each in (quiet, options))
        drift[i] = seen(along_x * smooth[:, :1] + along_y * smooth[:, 1:])
        jitter[i] = seen(along_x * (whole - smooth)[:, :1])
    total = np.maximum(weight.sum(axis=0), 1e-9)
    lever = gain - (weight * gain).sum(axis=0) / total
    precision = (weight * lever**2).sum(axis=0)

    def feigned(values: FloatArray) -> FloatArray:
        return np.asarray((weight * lever * values).sum(axis=0) / np.maximum(precision, 1e-9))

    common = (weight * looks).sum(axis=0) / total
    change = np.stack([_beside_gain(look, common) for look in looks])
    parallax = np.tan(motion.tilt_rad)
    middle = slice((shape[1] - _COLUMNS) // 2, (shape[1] + _COLUMNS) // 2)
    fields = Told(
        height=height_um / options.pixel_size_um,
        normals=normals,
        precision=np.maximum(precision, 1e-9),
        judged=(weight > 0).sum(axis=0) >= 2,
        drift=feigned(drift),
        jitter=feigned(jitter),
        shading=feigned(change),
        baseline=float(np.ptp(parallax)),
    )
    return fields.columns(middle)


def _beside_gain(look: FloatArray, common: FloatArray) -> FloatArray:
    """Return what a look differs by from the common one, once its local mean and contrast are made equal."""
    from scipy import ndimage

    def centred(image: FloatArray) -> tuple[FloatArray, FloatArray]:
        rest = image - ndimage.gaussian_filter(image, _NORMALIZING_PX)
        return rest, ndimage.gaussian_filter(rest**2, _NORMALIZING_PX)

    (own, power), (other, common_power) = centred(look), centred(common)
    difference: FloatArray = own * (common_power / (power + 1e-12)) ** 0.5 - other
    return difference


def oracle(told: Told, factor: float) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return the most probable surface of told heights, as a function of them and a start, for the truth's smoothness.

    The prior's variance is `factor` times that of the truth's second differences in the neighbourhood.
    """
    import numpy as np
    from scipy import ndimage, sparse
    from scipy.sparse.linalg import cg

    from semscape.dense.posterior import second_differences, smoothness_cut

    cut = smoothness_cut(told.height, _JUMP_DISPARITY_PX / told.baseline)
    weight = cut[0], cut[1], 2 * cut[2]
    curvature = np.sum([w * d * d for w, d in zip(weight, second_differences(told.height), strict=True)], axis=0)
    total, share = (ndimage.gaussian_filter(each, _LOCAL_PX) for each in (curvature, np.sum(weight, axis=0)))
    variance = factor * np.maximum(total / np.maximum(share, 1e-3), 1e-8)
    rows, cols = told.height.shape
    down, right = _second(rows), _second(cols)
    operators = (
        sparse.kron(sparse.eye_array(rows), right),
        sparse.kron(down, sparse.eye_array(cols)),
        sparse.kron(_first(rows), _first(cols)),
    )
    system = sparse.diags_array(told.precision.ravel()).tocsr()
    for operator, each in zip(operators, weight, strict=True):
        system = system + operator.T @ sparse.diags_array((each / variance).ravel()) @ operator
    system = system.tocsr()
    diagonal = sparse.diags_array(1 / system.diagonal())

    def smoothed(values: FloatArray, start: FloatArray) -> FloatArray:
        right_side = (told.precision * values).ravel() - system @ start.ravel()
        change, _ = cg(system, right_side, rtol=_TOLERANCE, maxiter=_MOST_STEPS, M=diagonal)
        return start + change.reshape(start.shape)

    return smoothed


def _second(size: int) -> sparse.csr_array:
    """Return second differences at their middle, 0 at both ends."""
    return _differences(size, (1.0, -2.0, 1.0), -1, slice(1, -1))


def _first(size: int) -> sparse.csr_array:
    """Return differences to the next, 0 at the end."""
    return _differences(size, (-1.0, 1.0), 0, slice(0, -1))


def _differences(size: int, taps: tuple[float, ...], first: int, kept: slice) -> sparse.csr_array:
    from scipy import sparse

    inside = [0.0] * size
    inside[kept] = [1.0] * len(range(size)[kept])
    band = sparse.diags_array(taps, offsets=range(first, first + len(taps)), shape=(size, size))
    return (sparse.diags_array(inside) @ band).tocsr()


def _windows(told: Told, noise: FloatArray) -> dict[str, Any]:
    """Return the bounds without prior: window by window, and for the best window of every pixel."""
    import numpy as np
    from scipy import ndimage

    rows = []
    expected = np.full((len(_WINDOWS_PX), *told.height.shape), np.inf)
    errors = np.zeros_like(expected)
    for n, side in enumerate(_WINDOWS_PX):
        total = ndimage.uniform_filter(told.precision, side)
        sigma = 1 / np.sqrt(total * side**2)
        bias = ndimage.uniform_filter(told.height, side) - told.height
        errors[n] = ndimage.uniform_filter(told.precision * noise, side) / total + bias
        expected[n] = np.hypot(sigma, bias)
        rows.append(
            {
                "side_px": side,
                "sigma_px": round(float(np.median(sigma[told.judged])), 3),
                "departs_px": round(float(np.median(np.abs(bias[told.judged]))), 3),
                "median_px": round(float(np.median(np.abs(errors[n][told.judged]))), 3),
            }
        )
    best = np.take_along_axis(errors, expected.argmin(axis=0)[None], axis=0)[0]
    return {"windows": rows, "best_window": _figures(best, told)}


def _figures(error: FloatArray, told: Told) -> dict[str, float]:
    import numpy as np

    row, col = np.nonzero(told.judged)
    plane = np.column_stack([row, col, np.ones(len(row))])
    values = error[told.judged]
    kept = np.abs(values) <= np.quantile(np.abs(values), _TRIM)
    values = np.abs(values - plane @ np.linalg.lstsq(plane[kept], values[kept], rcond=None)[0])
    ranked = np.sort(values)
    down, right = np.gradient(told.height + error)
    normals = np.stack([-right, down, np.ones_like(down)], axis=-1)
    cosine = (normals * told.normals).sum(axis=-1) / np.linalg.norm(normals, axis=-1)
    angle = np.rad2deg(np.arccos(np.clip(cosine[told.judged], -1, 1)))
    return {
        "median_px": round(float(np.median(ranked)), 3),
        "trimmed_rmse_px": round(float(np.sqrt(np.mean(ranked[: int(_TRIM * ranked.size)] ** 2))), 3),
        "normal_median_deg": round(float(np.nanmedian(angle)), 2),
    }


CASES: dict[str, Case] = {specimen: (measure_bound, (specimen,)) for specimen in _SPECIMENS}
CASES |= {f"noise-{specimen}": (measure_noise, (specimen,)) for specimen in ("fracture", "vickers")}

if __name__ == "__main__":
    run_cases(CASES, "The least errors of heights that the nominal images allow, as JSON.")
