"""Where the true cameras and heights put the match of a keypoint: the judge of every matcher."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from semscape.geometry.cameras import cameras_of
from semscape.types import FloatArray, IntArray, SimulationTruth

# A visible node of the true surface must lie this close to the keypoint, else what it shows is not known.
_NEAREST_NODE_PX = 1.5
_STEPS = 8


def true_match_px(truth: SimulationTruth, pair: tuple[int, int], xy1: FloatArray) -> FloatArray:
    """Return where view i2 sees what lies under the points `xy1` of view i1.

    The ray of each point is cut with the true surface, beginning at the nearest visible node of its grid, so that
    of several layers the one in sight is taken.

    Parameters
    ----------
    truth : SimulationTruth
        Of the simulated series.
    pair : (int, int)
        View indices.
    xy1 : (M, 2) float array
        Points of view i1 in px.

    Returns
    -------
    (M, 2) float array
        Points of view i2 in px; NaN where view i1 shows no known surface, or view i2 does not see it.
    """
    i1, i2 = pair
    world, node = true_points_um(truth, i1, xy1)
    seen = np.isfinite(world[:, 2]) & truth.visible[i2][node[:, 0], node[:, 1]]
    matched: FloatArray = np.where(seen[:, None], cameras_of(truth.motion)[i2].project(world), np.nan)
    return matched


def true_points_um(truth: SimulationTruth, view: int, xy: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the true points (M, 3) that a view shows at places (M, 2), NaN where that is not known, and their nodes.

    The nodes (M, 2) are row and column of the truth's grid.
    """
    camera = cameras_of(truth.motion)[view]
    height = truth.height_um
    row, col = np.nonzero(truth.visible[view] & np.isfinite(height))
    nodes = np.column_stack([col, row, height[row, col], np.ones(len(col))]) @ truth.world_from_grid[:3].T
    if len(nodes) == 0 or len(xy) == 0:
        return np.full((len(xy), 3), np.nan), np.zeros((len(xy), 2), np.int64)
    distance, nearest = cKDTree(camera.project(nodes)).query(xy)

    # All points of a ray: the least-norm one plus any multiple of the direction that the camera does not see.
    matrix = camera.matrix
    along = np.cross(matrix[0], matrix[1])
    along = along / along[2]
    foot = (xy - camera.translation_px) @ np.linalg.pinv(matrix).T
    grid_from_world = np.linalg.inv(truth.world_from_grid)
    z = nodes[nearest, 2]
    for _ in range(_STEPS):
        world = foot + (z - foot[:, 2])[:, None] * along
        grid = world @ grid_from_world[:2, :3].T + grid_from_world[:2, 3]
        # Half steps converge on slopes up to three times those that full steps can take.
        z = 0.5 * (z + map_coordinates(height, grid[:, ::-1].T, order=1, mode="nearest"))
    node = np.rint(grid[:, ::-1]).astype(np.int64)
    inside = ((node >= 0) & (node < height.shape)).all(axis=1)
    on_ray = np.abs(map_coordinates(height, grid[:, ::-1].T, order=1, mode="nearest") - world[:, 2])
    good = inside & (distance < _NEAREST_NODE_PX) & (on_ray < truth.pixel_size_um)
    return np.where(good[:, None], world, np.nan), np.clip(node, 0, np.array(height.shape) - 1)
