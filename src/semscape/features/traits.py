"""Traits of SIFT keypoints: what tells, before any matching, whether a keypoint is likely to find its partner.

All come from one image and its keypoints and are cheap beside matching: grey levels are looked at once, in
blocks, and descriptors are summed up in one pass. None depends on the brightness or contrast of the file. They
are computed in groups, so that a model pays for those alone that it uses.
"""

# Every group takes the view and its keypoints; some need the keypoints alone.
# ruff: noqa: ARG001

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.compiled import njit
from semscape.features.nearest import two_nearest
from semscape.features.sift import DESCRIPTOR_LEVELS
from semscape.types import BoolArray, FloatArray, ImageArray, Keypoints, Micrograph

_BLOCK_PX = 8
_FINE_BLOCKS, _COARSE_BLOCKS = 1.0, 4.0
_CELLS_PX = (16, 64)
_SAMPLE = 512
_LEVELS = np.arange(DESCRIPTOR_LEVELS + 2, dtype=np.float64) / DESCRIPTOR_LEVELS
# A descriptor is the square root of shares; these are the shares, and what each adds to their entropy.
_SHARE = _LEVELS**2
_ENTROPY = -_SHARE * np.log(np.maximum(_SHARE, 1e-12))
_ANGLE = np.arange(8) * (np.pi / 4)
_WAVES = np.stack([np.cos(_ANGLE), np.sin(_ANGLE), np.cos(2 * _ANGLE), np.sin(2 * _ANGLE)])
_FAINT_LEVEL = 20  # of 1023: a direction that holds less than half a permille of the gradient
_AT_TWO_SCALES = ("snr", "large_gradient", "small_gradient", "coherence", "contrast")
_LOCAL = tuple(f"{name}_{scale}" for scale in ("fine", "coarse") for name in _AT_TWO_SCALES)


def keypoint_traits(view: Micrograph, keypoints: Keypoints, groups: Sequence[str]) -> NDArray[np.float32]:
    """Return the traits of a view's keypoints, group by group as `trait_names` lists them.

    Parameters
    ----------
    view : Micrograph
        Image (H, W) and mask; its metadata may tell the tilt axis.
    keypoints : Keypoints
        SIFT, of this view, as `semscape.features.detect` sorts them.
    groups : sequence of str
        Keys of `TRAITS`.

    Returns
    -------
    (N, F) float32 array
        NaN where a trait is unknown: the orientation to the tilt axis where nobody told the axis.

    Raises
    ------
    ValueError
        For keypoints other than SIFT's.
    """
    if keypoints.kind != "sift":
        raise ValueError(f"traits are known for SIFT keypoints, got {keypoints.kind!r}")
    columns = [_COMPUTE[group](view, keypoints) for group in groups]
    return np.concatenate(columns, axis=1, dtype=np.float32)


def trait_names(groups: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the traits of some groups, in the order of the columns.

    Examples
    --------
    >>> trait_names(["detector", "margin"])
    ('log_scale', 'log_response', 'margin_x', 'margin_y')
    """
    return tuple(name for group in groups for name in TRAITS[group])


def _detector(view: Micrograph, keypoints: Keypoints) -> FloatArray:
    logarithms: FloatArray = np.log(np.column_stack([keypoints.scale_px, np.maximum(keypoints.response, 1e-9)]))
    return logarithms


def _orientation(view: Micrograph, keypoints: Keypoints) -> FloatArray:
    # Orientations turn from x towards y, which points down; the axis is told counter-clockwise. NaN stays NaN.
    angle = 2 * (keypoints.orientation_rad + view.metadata.tilt_axis_angle_rad)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _margin(view: Micrograph, keypoints: Keypoints) -> FloatArray:
    last = np.array(view.image.shape[::-1]) - 1.0
    return np.minimum(keypoints.xy, last - keypoints.xy) / last


def _local(view: Micrograph, keypoints: Keypoints) -> FloatArray:
    rows, cols = (-(-size // _BLOCK_PX) for size in view.image.shape)
    sums = np.zeros((rows, cols, 7), np.float32)
    _block_sums(view.image, view.mask, sums)
    col, row = _cells(keypoints, _BLOCK_PX)
    columns: list[NDArray[Any]] = []
    for sigma in (_FINE_BLOCKS, _COARSE_BLOCKS):
        smooth = np.asarray(cv2.GaussianBlur(sums, (0, 0), sigma))
        smooth /= np.maximum(smooth[..., :1], 1e-6)
        _, mean, square, xx, yy, xy, rough = np.moveaxis(smooth, -1, 0)
        noise = np.sqrt(np.pi / 2) / 6 * rough + 1e-6  # Immerkaer 1996
        spread = np.sqrt(np.maximum(square - mean * mean, 1e-9))
        total, split = (xx + yy) / noise**2 + 1e-6, np.hypot(xx - yy, 2 * xy) / noise**2
        contrast = np.log(spread)
        maps = (
            np.log(spread / noise),
            np.log(total + split),
            np.log(np.maximum(total - split, 1e-6)),
            split / total,
            contrast - np.median(contrast),
        )
        columns += [values[row, col] for values in maps]
    brightness = (mean - np.median(mean)) / np.median(spread)
    level = np.log(noise) - np.median(np.log(noise))
    detector = _detector(view, keypoints)
    # The response is the blob's contrast in units of the local contrast; noise falls as one over the scale.
    visibility = detector.sum(axis=1) + columns[_LOCAL.index("snr_coarse")]
    return np.column_stack([*columns, brightness[row, col], level[row, col], visibility])


def _density(view: Micrograph, keypoints: Keypoints) -> FloatArray:
    height, width = view.image.shape
    x, y = keypoints.xy.T
    columns = []
    for cell in _CELLS_PX:
        col, row = _cells(keypoints, cell)
        counts = np.zeros((height // cell + 1, width // cell + 1), np.float32)
        np.add.at(counts, (row, col), np.float32(1))
        mean = len(keypoints) * cell * cell / (height * width)
        columns.append(np.asarray(cv2.GaussianBlur(counts, (0, 0), 1.0))[row, col] / mean)
    # Sorted by place, keypoints with several orientations stand next to each other.
    again = (np.diff(x) == 0) & (np.diff(y) == 0)
    shared = np.append(again, False).astype(np.float64) + np.insert(again, 0, False)
    return np.column_stack([*columns, shared])


def _descriptor(view: Micrograph, keypoints: Keypoints) -> FloatArray:
    out = np.zeros((len(keypoints), len(TRAITS["descriptor"])))
    _sum_up(keypoints.descriptors, _SHARE, _ENTROPY, _WAVES, out)
    return out


def _distinctiveness(view: Micrograph, keypoints: Keypoints) -> FloatArray:
    """Distance to the nearest of an even sample of the other descriptors: all of them would cost as much as a pair."""
    if len(keypoints) < 2:
        return np.ones((len(keypoints), 1))
    bytes_ = np.floor(keypoints.descriptors * np.float32(255 / DESCRIPTOR_LEVELS))
    picked = np.unique(np.linspace(0, len(keypoints) - 1, _SAMPLE).astype(np.int64))
    nearest, distance, second, _ = two_nearest(bytes_, bytes_[picked])
    itself = picked[nearest] == np.arange(len(keypoints))
    return np.sqrt(np.where(itself, second, distance))[:, None] / 255


def _sift(view: Micrograph, keypoints: Keypoints) -> NDArray[np.float32]:
    return np.asarray(keypoints.descriptors, dtype=np.float32)


_COMPUTE: Mapping[str, Callable[[Micrograph, Keypoints], NDArray[Any]]] = MappingProxyType(
    {
        "detector": _detector,
        "orientation": _orientation,
        "margin": _margin,
        "local": _local,
        "density": _density,
        "descriptor": _descriptor,
        "distinctiveness": _distinctiveness,
        "sift": _sift,
    }
)
TRAITS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "detector": ("log_scale", "log_response"),
        "orientation": ("orientation_cos", "orientation_sin"),
        "margin": ("margin_x", "margin_y"),
        "local": (*_LOCAL, "brightness", "noise", "visibility"),
        "density": (*(f"density_{cell}px" for cell in _CELLS_PX), "shared_place"),
        "descriptor": ("entropy", "peak", "faint_bins", "direction", "anisotropy", "centre_share"),
        "distinctiveness": ("nearest_other",),
        "sift": tuple(f"sift_{index}" for index in range(128)),
    }
)
# The sense in which physics lets a trait act: what stands out of the noise is found again, what shares its place with
# another keypoint is mistaken for it. Of all others nobody knows beforehand.
_STANDS_OUT = tuple(f"{name}_{scale}" for scale in ("fine", "coarse") for name in _AT_TWO_SCALES if name != "coherence")
SENSE: Mapping[str, int] = MappingProxyType(
    dict.fromkeys(("log_response", "visibility", *_STANDS_OUT), 1) | {"noise": -1, "shared_place": -1}
)


def _cells(keypoints: Keypoints, size_px: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    col, row = np.maximum((keypoints.xy + 0.5) // size_px, 0).astype(np.int64).T
    return col, row


@njit(cache=True, nogil=True, fastmath=True)
def _block_sums(image: ImageArray, mask: BoolArray, sums: NDArray[np.float32]) -> None:  # pragma: no cover - compiled
    """Sum over blocks: pixels, values, squares, products of the gradient, and roughness that only noise has."""
    rows, cols = image.shape
    half, two, four = np.float32(0.5), np.float32(2), np.float32(4)
    for r in range(1, rows - 1):
        for block in range(sums.shape[1]):
            out = sums[r // _BLOCK_PX, block]
            for c in range(max(_BLOCK_PX * block, 1), min(_BLOCK_PX * (block + 1), cols - 1)):
                weight = np.float32(mask[r, c])
                value = image[r, c]
                left, right, up, down = image[r, c - 1], image[r, c + 1], image[r - 1, c], image[r + 1, c]
                gx, gy = half * (right - left), half * (down - up)
                corners = image[r - 1, c - 1] + image[r - 1, c + 1] + image[r + 1, c - 1] + image[r + 1, c + 1]
                out[0] += weight
                out[1] += weight * value
                out[2] += weight * value * value
                out[3] += weight * gx * gx
                out[4] += weight * gy * gy
                out[5] += weight * gx * gy
                out[6] += weight * abs(four * value + corners - two * (left + right + up + down))


@njit(cache=True, nogil=True)
def _sum_up(
    descriptors: NDArray[np.float32], share: FloatArray, entropy: FloatArray, waves: FloatArray, out: FloatArray
) -> None:  # pragma: no cover - compiled
    """Sum up each descriptor, 4 x 4 cells of 8 directions, as `TRAITS` names it."""
    directions = np.empty(8)
    for n in range(len(descriptors)):
        directions[:] = 0.0
        for cell in range(16):
            whole = 0.0
            for d in range(8):
                level = int(descriptors[n, 8 * cell + d])
                part = share[level]
                directions[d] += part
                whole += part
                out[n, 0] += entropy[level]
                out[n, 1] = max(out[n, 1], level)
                out[n, 2] += level < _FAINT_LEVEL
            row, col = cell // 4, cell % 4
            if 0 < row < 3 and 0 < col < 3:
                out[n, 5] += whole
        c1, s1, c2, s2 = 0.0, 0.0, 0.0, 0.0
        for d in range(8):
            c1 += directions[d] * waves[0, d]
            s1 += directions[d] * waves[1, d]
            c2 += directions[d] * waves[2, d]
            s2 += directions[d] * waves[3, d]
        out[n, 3], out[n, 4] = np.hypot(c1, s1), np.hypot(c2, s2)
