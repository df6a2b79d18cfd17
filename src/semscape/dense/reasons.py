"""Why heights are unknown: what each view shows of the place, as far as the surface around it tells.

An unknown place has no height to look at. It is taken to lie as low as its neighbourhood: what hides a place stands
above it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from semscape.compiled import njit
from semscape.dense.blank import blank
from semscape.dense.sampling import gaussian_window
from semscape.dense.stereo import filled_from_nearest
from semscape.geometry.cameras import camera_matrices
from semscape.types import (
    BoolArray,
    FloatArray,
    HeightMap,
    IntArray,
    Micrograph,
    Reason,
    Reconstruction,
    TiltSeries,
)

_LEAST_VIEWS = 2
_NEIGHBOURHOOD_PX = 31
# More than half of a window at the highest value of the whole image: with noise that is no chance.
_SATURATION_WINDOW_PX = 7
# Texture too weak to be told from noise: over the middle one of the windows that heights are fitted to, two views would
# place it worse than to this.
_WINDOW_PX = 5.4
_SHARP_PX = 0.5
_PRESMOOTH_PX = 1.6
# A 3 x 3 filter that cancels all smooth shape, and by how much it amplifies white noise.
_NOISE_FILTER = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_NOISE_GAIN = 6.0
_MAD_PER_SIGMA = 0.6745


class _Places(NamedTuple):
    """Unknown places: column and row (N, 2) and the height that their surroundings suggest (N,)."""

    col_row: IntArray
    height_um: FloatArray


def unknown_reasons(series: TiltSeries, reconstruction: Reconstruction, height_map: HeightMap) -> NDArray[np.uint8]:
    """Tell for each pixel of a height map why its height is not known.

    Parameters
    ----------
    series : TiltSeries
    reconstruction : Reconstruction
        Of the same views.
    height_map : HeightMap
        Made from them.

    Returns
    -------
    (H, W) uint8 array
        Values of `Reason`: the first that holds of outside, masked, occluded, saturated, no texture; else the views do
        not agree on any height.

    References
    ----------
    Noise: Immerkaer 1996, doi:10.1006/cviu.1996.0060.
    """
    height = height_map.height_um
    unknown = np.isnan(height)
    reason = np.zeros(height.shape, np.uint8)
    if not unknown.any():
        return reason
    lowest = minimum_filter(filled_from_nearest(height), _NEIGHBOURHOOD_PX)
    row, col = np.nonzero(unknown)
    places = _Places(np.column_stack([col, row]), lowest[unknown])
    projection = camera_matrices(reconstruction.motion) @ height_map.world_from_grid[:3]
    projection[:, :, 3] += reconstruction.motion.translation_px
    inside, imaged, seen, exposed, textured = (np.zeros(len(row), np.uint8) for _ in range(5))
    for view, view_from_grid in zip(series.views, projection, strict=True):
        xy = np.rint(
            places.col_row @ view_from_grid[:, :2].T
            + places.height_um[:, None] * view_from_grid[:, 2]
            + view_from_grid[:, 3]
        ).astype(np.int64)
        within = ((xy >= 0) & (xy < view.image.shape[::-1])).all(axis=1)
        x, y = np.clip(xy.T, 0, np.array(view.image.shape[::-1])[:, None] - 1)
        shown = within & view.mask[y, x]
        open_to_view = shown & ~_hidden(height, places, view_from_grid)
        unsaturated = open_to_view & ~_saturated(view)[y, x]
        for count, holds in (
            (inside, within),
            (imaged, shown),
            (seen, open_to_view),
            (exposed, unsaturated),
            (textured, unsaturated & (_textured(view, view_from_grid[:, 2]) & ~blank(view))[y, x]),
        ):
            count += holds
    reason[unknown] = np.select(
        [count < _LEAST_VIEWS for count in (inside, imaged, seen, exposed, textured)],
        [Reason.OUTSIDE, Reason.MASKED, Reason.OCCLUDED, Reason.SATURATED, Reason.NO_TEXTURE],
        Reason.INCONSISTENT,
    )
    return reason


def _hidden(height: FloatArray, places: _Places, view_from_grid: FloatArray) -> BoolArray:
    """Tell which places the known surface hides from a view."""
    # Along a beam the place in the grid moves with height such that its image stays.
    moves = -np.linalg.solve(view_from_grid[:, :2], view_from_grid[:, 2])
    length = float(np.hypot(*moves))
    known = height[np.isfinite(height)]
    if not known.size or length * float(known.max() - places.height_um.min()) < 1:
        return np.zeros(len(places.height_um), np.bool_)
    step = np.asarray(moves / length, np.float64)
    hidden: BoolArray = _meets(height, places.col_row, places.height_um, step, 1 / length, float(known.max()))
    return hidden


@njit(cache=True, nogil=True)
def _meets(
    height: FloatArray, col_row: IntArray, start: FloatArray, step: FloatArray, rise: float, highest: float
) -> BoolArray:  # pragma: no cover - compiled
    rows, columns = height.shape
    hidden = np.zeros(len(start), np.bool_)
    for n in range(len(start)):
        k = 1
        while start[n] + k * rise < highest:
            col, row = int(np.rint(col_row[n, 0] + k * step[0])), int(np.rint(col_row[n, 1] + k * step[1]))
            if not (0 <= col < columns and 0 <= row < rows):
                break
            if height[row, col] > start[n] + (k + 0.5) * rise:
                hidden[n] = True
                break
            k += 1
    return hidden


def _saturated(view: Micrograph) -> BoolArray:
    """Return where most of the neighbourhood has the highest value of the image."""
    if not view.mask.any():
        return np.zeros(view.image.shape, np.bool_)
    at_top = (view.image >= view.image[view.mask].max()).astype(np.float32)
    side = _SATURATION_WINDOW_PX
    saturated: BoolArray = cv2.blur(at_top, (side, side)) > 0.5
    return saturated


def _textured(view: Micrograph, px_per_height: FloatArray) -> BoolArray:
    """Return where texture across the tilt axis stands out of the noise."""
    image = view.image
    # What is clipped to black or white has no noise, and would hide that of the rest.
    counted = view.mask & (image > image.min()) & (image < image.max())
    filtered = np.abs(cv2.filter2D(image, cv2.CV_32F, _NOISE_FILTER))[counted]
    noise = float(np.median(filtered)) / _MAD_PER_SIGMA / _NOISE_GAIN if filtered.size else 0.0
    length = float(np.hypot(*px_per_height))
    # A view without tilt has no parallax of its own; its texture counts along both axes then.
    directions = [px_per_height / length] if length > 0 else [np.array([1.0, 0.0]), np.array([0.0, 1.0])]
    smooth = cv2.GaussianBlur(image, (0, 0), _PRESMOOTH_PX)
    energy = np.zeros_like(image)
    for direction in directions:
        slope = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=direction[0] / 32)
        slope += cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=direction[1] / 32)
        energy += slope * slope
    # Of white noise after the smoothing; the derivative of a Gaussian of width s has a power of 1 / (8 pi s^4).
    of_noise = noise**2 / (8 * np.pi * _PRESMOOTH_PX**4)
    energy = gaussian_window(np.asarray(energy, np.float32), _WINDOW_PX) - np.float32(of_noise)
    least = 2 * noise**2 / (4 * np.pi * _WINDOW_PX**2 * _SHARP_PX**2)
    textured: BoolArray = energy > max(least, 1e-9)
    return textured
