"""A triangle mesh over a height map, cut where the height jumps, with the micrograph as colour."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from semscape.types import BoolArray, FloatArray, HeightMap, ImageArray, SurfaceMesh

_STEEPEST_SLOPE = 8.0


def height_map_mesh(
    height_map: HeightMap, *, max_vertices: int, steepest_slope: float = _STEEPEST_SLOPE
) -> SurfaceMesh:
    """Mesh a height map on its own grid, every n-th row and column such that at most `max_vertices` remain.

    Triangles that span an unknown pixel, or a slope steeper than `steepest_slope` (by default 83 deg, a
    depth jump), are left out.
    """
    stride = grid_stride(height_map, max_vertices)
    height = height_map.height_um[::stride, ::stride]
    row, col = (axis * stride for axis in np.indices(height.shape))
    known = np.isfinite(height)
    grid = np.stack([col, row, np.nan_to_num(height), np.ones_like(height)], axis=-1)
    world = (grid @ height_map.world_from_grid.T)[..., :3]

    limit = steepest_slope * stride * height_map.pixel_size_um
    index = np.arange(height.size).reshape(height.shape)
    a, b, c, d = (
        (slice(None, -1), slice(None, -1)),
        (slice(None, -1), slice(1, None)),
        (slice(1, None), slice(None, -1)),
        (slice(1, None), slice(1, None)),
    )
    upper = _smooth(height, known, limit, a, c, b)
    lower = _smooth(height, known, limit, b, c, d)
    faces = np.concatenate(
        [
            np.stack([index[a][upper], index[c][upper], index[b][upper]], axis=1),
            np.stack([index[b][lower], index[c][lower], index[d][lower]], axis=1),
        ]
    )
    used, faces = np.unique(faces, return_inverse=True)
    grey = grey_levels(height_map.texture)[::stride, ::stride].ravel()[used]
    return SurfaceMesh(
        world.reshape(-1, 3)[used],
        faces.reshape(-1, 3).astype(np.int64),
        np.repeat(grey[:, None], 3, axis=1),
        height_map.length_unit,
    )


def with_picture(mesh: SurfaceMesh, height_map: HeightMap, longest_px: int) -> SurfaceMesh:
    """Lay the micrograph, at most `longest_px` long, on a mesh of a height map."""
    grey = grey_levels(height_map.texture)
    rows, columns = grey.shape
    shrink = longest_px / max(rows, columns)
    if shrink < 1:
        grey = cv2.resize(grey, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    world = np.column_stack([mesh.vertices_um, np.ones(len(mesh.vertices_um))])
    col, row = (world @ np.linalg.inv(height_map.world_from_grid).T)[:, :2].T
    return replace(mesh, picture=grey, uv=np.column_stack([(col + 0.5) / columns, 1 - (row + 0.5) / rows]))


def grid_stride(height_map: HeightMap, max_vertices: int) -> int:
    """Return the least n such that every n-th row and column of the grid make at most `max_vertices`."""
    rows, columns = height_map.height_um.shape
    stride = max(1, int(np.sqrt(height_map.height_um.size / max_vertices)))
    while -(-rows // stride) * -(-columns // stride) > max_vertices:
        stride += 1
    return stride


def grey_levels(image: ImageArray) -> NDArray[np.uint8]:
    """Map an image (H, W) to 0 .. 255 between its 0.5 and 99.5 percentiles; NaN becomes 0."""
    known = np.isfinite(image)
    if not known.any():
        return np.zeros(image.shape, np.uint8)
    low, high = np.percentile(image[known], [0.5, 99.5])
    scaled = (np.nan_to_num(image, nan=float(low)) - low) / max(float(high - low), 1e-12)
    return np.where(known, np.clip(np.rint(255 * scaled), 0, 255), 0).astype(np.uint8)


def _smooth(
    height: FloatArray,
    known: BoolArray,
    limit: float,
    p: tuple[slice, slice],
    q: tuple[slice, slice],
    r: tuple[slice, slice],
) -> BoolArray:
    corners = np.stack([height[p], height[q], height[r]])
    all_known = known[p] & known[q] & known[r]
    spread: BoolArray = np.ptp(np.where(all_known, corners, 0.0), axis=0) <= limit
    return spread & all_known
