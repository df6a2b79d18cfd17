"""Look at every view through a height map: grey values and slopes at the pixels where its heights project."""

from __future__ import annotations

import cv2
import numpy as np

from semscape.types import FloatArray, ImageArray, Micrograph

_FULL_RESOLUTION_SIGMA_PX = 4.0


class ViewSampler:
    """Samples a view, and its slope along the parallax, at the pixels where a grid's heights project."""

    def __init__(
        self,
        view: Micrograph,
        view_from_grid: FloatArray,
        px_per_height: FloatArray,
        direction: FloatArray,
        shape: tuple[int, int],
        presmooth_px: float,
    ) -> None:
        smooth = cv2.GaussianBlur(view.image, (0, 0), presmooth_px)
        along = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1 / 32) * np.float32(direction[0])
        along += cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1 / 32) * np.float32(direction[1])
        self.image, self.along = smooth, along
        self.mask = view.mask.astype(np.float32)
        self.view_from_grid = view_from_grid
        self.x0, self.y0 = grid_in_view(view_from_grid, shape)
        self.px_per_height = px_per_height

    def sample(self, height: FloatArray) -> tuple[ImageArray, ImageArray, ImageArray]:
        """Return grey values, their slope along the parallax per px, and validity, each (H, W) float32."""
        x, y = self._places(height)
        slope = cv2.remap(self.along, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        value, inside = self._look(x, y)
        return value, slope, inside

    def look(self, height: FloatArray) -> tuple[ImageArray, ImageArray]:
        """Return grey values and validity, each (H, W) float32."""
        return self._look(*self._places(height))

    def _places(self, height: FloatArray) -> tuple[ImageArray, ImageArray]:
        h = height.astype(np.float32)
        return self.x0 + h * np.float32(self.px_per_height[0]), self.y0 + h * np.float32(self.px_per_height[1])

    def _look(self, x: ImageArray, y: ImageArray) -> tuple[ImageArray, ImageArray]:
        value = cv2.remap(self.image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        inside = cv2.remap(self.mask, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return value, (inside > 0.99).astype(np.float32)


def grid_in_view(view_from_grid: FloatArray, shape: tuple[int, int]) -> tuple[ImageArray, ImageArray]:
    """Return where the pixels of a grid of height zero lie in a view, x and y (H, W) px, by its (2, 3) map."""
    rows, cols = np.indices(shape, dtype=np.float32)
    x, y = (row[0] * cols + row[1] * rows + row[2] for row in view_from_grid.astype(np.float32))
    return x, y


def common_parallax(px_per_height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the common direction (2,) of the views' parallax and each view's amount (V,) along it."""
    centred = px_per_height - px_per_height.mean(axis=0)
    _, _, directions = np.linalg.svd(centred)
    return directions[0], px_per_height @ directions[0]


def gaussian_window(values: ImageArray, sigma_px: float) -> ImageArray:
    """Return the Gaussian mean of values (H, W) float32, zero beyond the border."""
    blurred: ImageArray
    if sigma_px <= _FULL_RESOLUTION_SIGMA_PX:
        blurred = cv2.GaussianBlur(values, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)
        return blurred
    # A wide Gaussian holds no fine detail: blur the image at half its size.
    height, width = values.shape
    half = cv2.resize(values, ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)
    blurred = cv2.resize(gaussian_window(half, sigma_px / 2), (width, height), interpolation=cv2.INTER_LINEAR)
    return blurred
