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
from semscape.dense.sampling import gaussian_window
from semscape.dense.slopes import SlopeTerm, slope_term
from semscape.types import FloatArray, ImageArray

# The waves on which laws are learnt: parallax knows heights there, and does not mistake brightness for them.
_LEARNT_PX = (8.0, 32.0)
# Coefficients are of the order of one: brightness about doubles where a surface is steep.
_EXPECTED = 1.0
# A law that explains less than this is none.
_LEAST_EXPLAINED = 0.05
_LEAST_SAMPLE = 1000
_WHOLLY_COVERED = 0.9
_MOSTLY_COVERED = 0.6
# Dark pixels are divided by no less than this share of the median.
_DARKEST = 0.25
_MEAN_PX = 1.0


@dataclass(frozen=True, eq=False)
class Brightness:
    """What all views together show through one height map, (H, W) each, where `seen` is 1.

    `mean` is the mean brightness over its median; `change` is by how much of itself it changes per unit of parallax,
    and `by_height` what that changes by per px of height. `levers` and `gains` (V,) are each view's parallax against
    the mean one, and the contrast by which its grey values, less some offset, are made alike.
    """

    seen: ImageArray
    mean: ImageArray
    change: ImageArray
    by_height: ImageArray
    levers: FloatArray
    gains: FloatArray
    median: float


def brightness_of(looks: Sequence[Look], parallax: FloatArray, free: ImageArray) -> Brightness | None:
    """Return what views (V of values, slopes along the parallax, validity) show, None where too little.

    Parameters
    ----------
    looks : sequence of V times three (H, W) float32 arrays
    parallax : (V,) float array
    free : (H, W) float32 array
        1 where heights may follow brightness.
    """
    seen = np.asarray(np.min([inside for _, _, inside in looks], axis=0) * free, np.float32)
    used = seen > 0
    if used.sum() < _LEAST_SAMPLE:
        return None
    medians = np.array([np.median(value[used]) for value, _, _ in looks])
    spreads = np.array(
        [np.median(np.abs(value[used] - median)) for (value, _, _), median in zip(looks, medians, strict=True)]
    )
    median = float(medians.mean())
    if spreads.min() <= 0 or median <= 0:
        return None
    gains = spreads.mean() / spreads
    levers = parallax - parallax.mean()
    mean, change, by_height = (np.zeros(seen.shape, np.float32) for _ in range(3))
    for (value, slope, _), own, gain, lever in zip(looks, medians, gains, levers, strict=True):
        alike = (value - np.float32(own)) * np.float32(gain / median)
        mean += alike / np.float32(len(looks))
        change += alike * np.float32(lever / (levers @ levers))
        by_height += slope * np.float32(gain / median / len(looks))
    mean = np.asarray(mean + np.float32(1), np.float32)
    divisor = _divisor(mean, seen)
    return Brightness(seen, mean, change / divisor, by_height / divisor, levers, gains, median)


class ShadingLaws:
    """How the brightness of a series, and its change with tilt, follow the normals of its surface."""

    def __init__(self, brightness: Brightness, height: FloatArray) -> None:
        """Learn both laws from what is seen at heights (H, W), in px."""
        normals = _normals(height)
        self._of_mean = _learnt(brightness.mean, brightness.seen, normals)
        self._of_change = _learnt(brightness.change, brightness.seen, normals)
        self._texture: ImageArray | None = None

    def terms(self, brightness: Brightness, height: FloatArray) -> list[SlopeTerm]:
        """Return what brightness seen at heights (H, W) says about their slopes.

        As heights come to follow brightness, less of it is left unexplained than the law explains: the noise of the
        mean brightness is taken no smaller than at first. What it changes by is noisier at first, for there shading
        has passed for heights.
        """
        normals = _normals(height)
        terms = []
        if self._of_mean is not None:
            field, by_column, by_row = self._left(brightness.mean, self._of_mean, normals)
            still = np.zeros_like(field)
            term, variance = slope_term(field, brightness.seen, still, by_column, by_row, self._texture)
            self._texture = variance if self._texture is None else self._texture
            terms.append(term)
        if self._of_change is not None:
            field, by_column, by_row = self._left(brightness.change, self._of_change, normals)
            terms.append(slope_term(field, brightness.seen, brightness.by_height, by_column, by_row)[0])
        return terms

    def corrected(self, looks: Sequence[Look], brightness: Brightness, height: FloatArray) -> list[Look]:
        """Return the views' looks without the change of brightness that the law expects at heights (H, W)."""
        if self._of_change is None:
            return list(looks)
        expected, _, _ = _expected(self._of_change, _normals(height))
        expected = expected * _divisor(brightness.mean, brightness.seen) * brightness.seen
        return [
            (np.asarray(value - expected * np.float32(lever * brightness.median / gain), np.float32), slope, inside)
            for (value, slope, inside), lever, gain in zip(looks, brightness.levers, brightness.gains, strict=True)
        ]

    @staticmethod
    def _left(field: ImageArray, law: FloatArray, normals: _Normals) -> tuple[ImageArray, ImageArray, ImageArray]:
        value, by_column, by_row = _expected(law, normals)
        return np.asarray(field - value, np.float32), -by_column, -by_row


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


def _learnt(field: ImageArray, seen: ImageArray, normals: _Normals) -> FloatArray | None:
    """Regress a field on functions of the normals, (3,), None where they explain next to nothing of it."""
    fine, coarse = _LEARNT_PX
    near, far = (np.maximum(gaussian_window(seen, sigma), np.float32(0.05)) for sigma in _LEARNT_PX)
    inside = (seen > 0) & (near > _WHOLLY_COVERED) & (far > _MOSTLY_COVERED)
    if inside.sum() < _LEAST_SAMPLE:
        return None

    def waves(values: ImageArray) -> FloatArray:
        known = np.asarray((values - np.median(values[seen > 0])) * seen, np.float32)
        return np.asarray((gaussian_window(known, fine) - gaussian_window(known, coarse))[inside], np.float64)

    told = waves(field)
    design = np.column_stack([waves(each) for each in normals.values])
    square, answer = design.T @ design, design.T @ told
    law = np.linalg.lstsq(square, answer, rcond=None)[0]
    left = float(np.mean((told - design @ law) ** 2))
    # As many pixels as a window holds err alike.
    ridge = left * 4 * np.pi * fine**2 / _EXPECTED**2
    law = np.linalg.solve(square + ridge * np.eye(len(law)), answer)
    explained = 1 - float(np.mean((told - design @ law) ** 2)) / max(float(np.mean(told**2)), 1e-30)
    return np.asarray(law, np.float64) if explained > _LEAST_EXPLAINED else None


def _divisor(mean: ImageArray, seen: ImageArray) -> ImageArray:
    share = np.maximum(gaussian_window(seen, _MEAN_PX), np.float32(0.05))
    return np.maximum(gaussian_window(mean * seen, _MEAN_PX) / share, np.float32(_DARKEST))
