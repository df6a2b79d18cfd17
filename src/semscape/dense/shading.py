"""What brightness says about slopes: the laws of a series, learnt where its heights are known, and used where not.

The brightness of secondary and backscattered electrons follows the surface's normal: what turns away from the beam is
brighter, what turns to the detector, too. How much so, no two microscopes and specimens share. So it is not assumed:
the mean brightness of the views, and what it changes by as the specimen tilts, are each regressed on the normals of
the heights that parallax has found, over waves long enough to be known well. Finer waves of brightness then tell
slopes that parallax alone leaves to noise, each as far as the law explains it; the rest, texture above all, is noise
by its own measure. The change with tilt would pass for heights; what the law expects of it is taken out beforehand.

References: Reimer 1998, "Scanning Electron Microscopy", doi:10.1007/978-3-540-38967-5, sections 4.1 and 6.1;
Beil & Carlsen 1991, doi:10.1007/BF01815304 (stereoscopy and shading of one series together).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semscape.dense.consistency import Look
from semscape.dense.given import JUMP_PX, near_jumps
from semscape.dense.sampling import gaussian_window
from semscape.dense.slopes import SlopeTerm, slope_term
from semscape.dense.sweep import Views
from semscape.types import BoolArray, FloatArray, ImageArray, Micrograph

# The waves on which laws are learnt: parallax knows heights there, and does not mistake brightness for them.
_LEARNT_PX = (8.0, 32.0)
# Coefficients are of the order of one: brightness about doubles where a surface is steep.
_EXPECTED = 1.0
# A law that explains less than this is none.
_LEAST_EXPLAINED = 0.05
_LEAST_SAMPLE = 1000
# Of the windows of both, so much must be seen.
_LEAST_COVERED = 0.25
# Dark pixels are divided by no less than this share of the median.
_DARKEST = 0.25
_MEAN_PX = 1.0
# No law is learnt so near to jumps.
_JUMP_REACH_PX = 6
_MOST_SAMPLES = 1_000_000


@dataclass(frozen=True, eq=False)
class GreyLevels:
    """The median grey value of each view (V,), and the median of the absolute differences from it (V,)."""

    medians: FloatArray
    spreads: FloatArray


@dataclass(frozen=True, eq=False)
class _Brightness:
    """What all views together show through one height map, (H, W) each, where `seen` is 1.

    `mean` is the mean brightness over its median, and `mean_by_height` what that changes by per px of height; `change`
    is by how much of itself it changes per unit of parallax, and `by_height` what that changes by per px of height.
    `divisor` is the mean, smooth and not too dark, `contrast` the mean beside its median over it; `grey` (V,) by how
    many grey levels a view shows a unit of change differently.
    """

    seen: ImageArray
    mean: ImageArray
    mean_by_height: ImageArray
    change: ImageArray
    by_height: ImageArray
    divisor: ImageArray
    contrast: ImageArray
    grey: FloatArray


@dataclass(frozen=True, eq=False)
class Regression:
    """Normal equations of some samples on N functions; those of parts of a field add up."""

    square: FloatArray
    answer: FloatArray
    power: float
    count: float

    def __add__(self, other: Regression) -> Regression:
        """Return the equations of all samples of both."""
        return Regression(
            self.square + other.square, self.answer + other.answer, self.power + other.power, self.count + other.count
        )

    def law(self) -> FloatArray | None:
        """Return the coefficients (N,), None where they explain next to nothing."""
        if self.count < _LEAST_SAMPLE:
            return None
        # As many pixels as a window holds err alike; what is not told stays about zero.
        left = self._left(np.linalg.lstsq(self.square, self.answer, rcond=None)[0])
        ridge = left / self.count * 4 * np.pi * _LEARNT_PX[0] ** 2 / _EXPECTED**2
        law = np.linalg.solve(self.square + max(ridge, 1e-12) * np.eye(len(self.answer)), self.answer)
        explains = self._left(law) < (1 - _LEAST_EXPLAINED) * self.power
        return np.asarray(law, np.float64) if explains else None

    def _left(self, law: NDArray[np.floating]) -> float:
        return max(float(self.power - 2 * law @ self.answer + law @ self.square @ law), 0.0)


def grey_levels(views: Sequence[Micrograph]) -> GreyLevels | None:
    """Return the grey levels of views, None where one is black or of one grey."""
    medians, spreads = [], []
    for view in views:
        shown = view.image[view.mask]
        shown = shown[:: max(len(shown) // _MOST_SAMPLES, 1)]
        if len(shown) < _LEAST_SAMPLE:
            return None
        medians.append(float(np.median(shown)))
        spreads.append(float(np.median(np.abs(shown - medians[-1]))))
    if min(medians) <= 0 or min(spreads) <= 0:
        return None
    return GreyLevels(np.array(medians), np.array(spreads))


def regressions(
    height: FloatArray, known: BoolArray, views: Views, levels: GreyLevels, core: tuple[slice, slice] | None = None
) -> list[Regression]:
    """Regress the mean brightness that views show at heights (H, W), and its change, on the heights' normals.

    The fourth function of the change is the mean brightness itself: views are made alike in contrast, which the change
    has a part in.

    Parameters
    ----------
    height : (H, W) float array
        In px, as smooth as they are known.
    known : (H, W) bool array
    views : Views
        What is seen at these heights.
    levels : GreyLevels
        Of the series' views, by which they are made alike.
    core : two slices
        What of the field counts; all where left out.

    Returns
    -------
    list of two Regressions
        Of the mean brightness and of its change.
    """
    free = np.asarray(known & ~near_jumps(height, JUMP_PX / views.baseline, _JUMP_REACH_PX), np.float32)
    looks = [sampler.sample(height) for sampler in views.samplers]
    shown = _brightness(looks, views.parallax, free, levels)
    normals = _normals(height)
    of_change = [*normals.values, shown.contrast]
    return [
        _regressed(shown.mean, list(normals.values), shown.seen, core),
        _regressed(shown.change, of_change, shown.seen, core),
    ]


class ShadingLaws:
    """How the brightness of a series, and its change with tilt, follow the normals of its surface.

    Parameters
    ----------
    levels : GreyLevels
        Of the series' views.
    told : two Regressions
        Those of the mean brightness and of its change, as `regressions` returns them; of tiles, their sums.
    """

    def __init__(self, levels: GreyLevels, told: Sequence[Regression]) -> None:
        self._levels = levels
        self._of_mean, self._of_change = (regression.law() for regression in told)

    def heard(
        self, looks: Sequence[Look], parallax: FloatArray, free: ImageArray, height: FloatArray, texture: Texture
    ) -> tuple[list[SlopeTerm], list[Look]]:
        """Return what brightness at heights (H, W) says about their slopes, and the looks without expected changes.

        Parameters
        ----------
        looks : sequence of V looks
        parallax : (V,) float array
            Of the views, px per px of height.
        free : (H, W) float32 array
            1 where heights may follow brightness.
        height : (H, W) float array
        texture : Texture
            As heights come to follow brightness, less of it is left unexplained than the law explains: what the mean
            brightness holds besides is kept here, and taken no smaller than at first. What it changes by is noisier at
            first, for there shading has passed for heights.
        """
        if self._of_mean is None and self._of_change is None:
            return [], list(looks)
        shown = _brightness(looks, parallax, free, self._levels)
        if shown.seen.sum() < _LEAST_SAMPLE:
            return [], list(looks)
        normals = _normals(height)
        terms = []
        if self._of_mean is not None:
            value, by_column, by_row = _expected(self._of_mean, normals)
            slopes = shown.mean_by_height, -by_column, -by_row
            term, variance = slope_term(shown.mean - value, shown.seen, *slopes, texture.variance)
            texture.variance = variance if texture.variance is None else texture.variance
            terms.append(term)
        if self._of_change is None:
            return terms, list(looks)
        value, by_column, by_row = _expected(self._of_change[:3], normals)
        left = np.asarray(shown.change - value - np.float32(self._of_change[3]) * shown.contrast, np.float32)
        terms.append(slope_term(left, shown.seen, shown.by_height, -by_column, -by_row)[0])
        expected = value * shown.divisor * shown.seen
        corrected = [
            (np.asarray(grey - expected * np.float32(unit), np.float32), slope, inside)
            for (grey, slope, inside), unit in zip(looks, shown.grey, strict=True)
        ]
        return terms, corrected


@dataclass
class Texture:
    """The variance (H / 2, W / 2) of the mean brightness beside its law, as it was found first."""

    variance: ImageArray | None = None


def _brightness(looks: Sequence[Look], parallax: FloatArray, free: ImageArray, levels: GreyLevels) -> _Brightness:
    seen = np.asarray(np.min([inside for _, _, inside in looks], axis=0) * free, np.float32)
    median = float(levels.medians.mean())
    gains = levels.spreads.mean() / levels.spreads
    levers = parallax - parallax.mean()
    mean, moved, change, by_height = (np.zeros(seen.shape, np.float32) for _ in range(4))
    for (value, slope, _), own, gain, lever, shift in zip(looks, levels.medians, gains, levers, parallax, strict=True):
        alike = (value - np.float32(own)) * np.float32(gain / median)
        mean += alike / np.float32(len(looks))
        change += alike * np.float32(lever / (levers @ levers))
        moved += slope * np.float32(shift * gain / median / len(looks))
        by_height += slope * np.float32(gain / median / len(looks))
    mean = np.asarray(mean + np.float32(1), np.float32)
    share = np.maximum(gaussian_window(seen, _MEAN_PX), np.float32(0.05))
    divisor = np.maximum(gaussian_window(mean * seen, _MEAN_PX) / share, np.float32(_DARKEST))
    change, by_height, contrast = (np.asarray(each / divisor, np.float32) for each in (change, by_height, mean - 1))
    return _Brightness(seen, mean, moved, change, by_height, divisor, contrast, levers * median / gains)


@dataclass(frozen=True, eq=False)
class _Normals:
    """Functions (3, H, W) of the normals: towards columns, towards rows, and -ln cos(theta); and their derivatives."""

    values: NDArray[np.float32]
    by_column: NDArray[np.float32]
    by_row: NDArray[np.float32]


def _normals(height: FloatArray) -> _Normals:
    down, along = (np.asarray(each, np.float32) for each in np.gradient(height))
    squared = 1 + along * along + down * down
    up = 1 / np.sqrt(squared)
    cubed = up / squared
    mixed = -along * down * cubed
    return _Normals(
        np.stack([along * up, down * up, np.log(squared) / 2]),
        np.stack([(1 + down * down) * cubed, mixed, along / squared]),
        np.stack([mixed, (1 + along * along) * cubed, down / squared]),
    )


def _expected(law: FloatArray, normals: _Normals) -> tuple[ImageArray, ImageArray, ImageArray]:
    """Return what a law expects, and how that changes with the slopes along columns' and rows' numbers, (H, W)."""
    value, by_column, by_row = (
        np.tensordot(law.astype(np.float32), each, 1) for each in (normals.values, normals.by_column, normals.by_row)
    )
    return value, by_column, by_row


def _regressed(
    field: ImageArray, functions: list[ImageArray], seen: ImageArray, core: tuple[slice, slice] | None
) -> Regression:
    """Regress the learnt waves of a field (H, W) on those of N functions (H, W)."""
    fine, coarse = _LEARNT_PX
    near, far = (np.maximum(gaussian_window(seen, sigma), np.float32(0.05)) for sigma in _LEARNT_PX)
    inside = (seen > 0) & (near > _LEAST_COVERED) & (far > _LEAST_COVERED)
    if core is not None:
        counted = np.zeros(seen.shape, np.bool_)
        counted[core] = True
        inside &= counted
    if not inside.any():
        count = len(functions)
        return Regression(np.zeros((count, count)), np.zeros(count), 0.0, 0.0)

    def waves(values: ImageArray) -> FloatArray:
        known = np.asarray((values - np.median(values[seen > 0])) * seen, np.float32)
        wave = gaussian_window(known, fine) / near - gaussian_window(known, coarse) / far
        # Where little is seen the band is a bad one, and counts less.
        return np.asarray((wave * far)[inside], np.float64)

    samples = np.column_stack([*(waves(each) for each in functions), waves(field)])
    # In one order: threads of a matrix product would sum in theirs.
    sums = np.einsum("ni,nj->ij", samples, samples)
    return Regression(sums[:-1, :-1], sums[:-1, -1], float(sums[-1, -1]), float(len(samples)))
