"""Weighted local planes: the least-squares fit of a plane around every pixel at once."""

from __future__ import annotations

import cv2
import numpy as np

from semscape.types import FloatArray, ImageArray

_KERNEL_REACH = 3.0
_RIDGE = 0.05


def local_plane_heights(weight: ImageArray, weighted: ImageArray, sigma_px: float) -> FloatArray:
    """Fit a plane around every pixel and return its height there.

    Parameters
    ----------
    weight : (H, W) float32 array
        Weight of every pixel's value, not negative.
    weighted : (H, W) float32 array
        Weight times value. The values should be of the order of their scatter: single precision is used.
    sigma_px : float
        Width of the Gaussian neighbourhood.

    Returns
    -------
    (H, W) float array
        Height of the plane at the pixel. A slope that the weights do not fix is held near zero.

    Examples
    --------
    A plane is its own local plane, whatever the weights:

    >>> ramp = np.add.outer(np.zeros(20), 0.5 * np.arange(20)).astype(np.float32)
    >>> weight = np.random.default_rng(0).uniform(0.1, 1, ramp.shape).astype(np.float32)
    >>> fitted = local_plane_heights(weight, weight * ramp, 2.0)
    >>> bool(np.abs(fitted - ramp)[7:13, 7:13].max() < 0.1)
    True
    """
    reach = int(np.ceil(_KERNEL_REACH * sigma_px))
    x = np.arange(-reach, reach + 1, dtype=np.float64)
    g0 = np.exp(-0.5 * (x / sigma_px) ** 2)
    g0 /= g0.sum()
    g1, g2 = x * g0, x * x * g0

    def moment(image: ImageArray, along_x: FloatArray, along_y: FloatArray) -> ImageArray:
        filtered: ImageArray = cv2.sepFilter2D(image, cv2.CV_32F, along_x, along_y, borderType=cv2.BORDER_CONSTANT)
        return filtered

    m00, m10, m01 = moment(weight, g0, g0), moment(weight, g1, g0), moment(weight, g0, g1)
    m20, m11, m02 = moment(weight, g2, g0), moment(weight, g1, g1), moment(weight, g0, g2)
    h00, h10, h01 = moment(weighted, g0, g0), moment(weighted, g1, g0), moment(weighted, g0, g1)
    # Solve [m00 m10 m01; m10 m20 m11; m01 m11 m02] (c, a, b) = (h00, h10, h01) for c, by cofactors.
    ridge = np.float32(_RIDGE * sigma_px**2) * m00 + np.float32(1e-12)
    m20, m02 = m20 + ridge, m02 + ridge
    c00, c01, c02 = m20 * m02 - m11 * m11, m01 * m11 - m10 * m02, m10 * m11 - m01 * m20
    determinant = np.maximum(m00 * c00 + m10 * c01 + m01 * c02, 1e-30)
    height: FloatArray = ((c00 * h00 + c01 * h10 + c02 * h01) / determinant).astype(np.float64)
    return height
