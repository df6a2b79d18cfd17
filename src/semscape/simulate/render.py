"""Micrographs by ray casting: the signal of one view, and which points of the surface it sees."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from semscape.geometry.rotations import tilted_cam_from_world
from semscape.simulate.cast import cast_rays, rays_of_pixels, sample_bilinear
from semscape.simulate.presets import SimulationOptions
from semscape.simulate.signal import shade, strengths_of, surface_layers
from semscape.simulate.specimens import Specimen
from semscape.types import BoolArray, FloatArray, ImageArray

_BLOCK_ROWS = 32


@dataclass(frozen=True, eq=False)
class Scene:
    """A specimen under the microscope, with what its views share.

    Parameters
    ----------
    specimen : Specimen
        The surface.
    options : SimulationOptions
        Image size and signal strengths.
    workers : int
        Threads over blocks of image rows; the result does not depend on it.
    """

    specimen: Specimen
    options: SimulationOptions
    workers: int = 1

    @cached_property
    def layers(self) -> ImageArray:
        """Slopes, edges and open sky of the surface (rows, cols, 4), see `surface_layers`."""
        return surface_layers(self.specimen.height_um, self.specimen.pitch_um, self.options)

    @cached_property
    def bounds_um(self) -> tuple[float, float]:
        """Lowest and highest point."""
        return float(self.specimen.height_um.min()), float(self.specimen.height_um.max())

    def cast(self, xy_px: FloatArray, matrix: FloatArray, translation_px: FloatArray) -> FloatArray:
        """Return the first hit (N, 3) = (grid col, grid row, z in um) of the rays of pixels (N, 2); NaN for none."""
        linear, offset, slope = rays_of_pixels(matrix, translation_px, self.specimen.grid_from_world)
        origin, hit = np.empty((len(xy_px), 2)), np.empty((len(xy_px), 3))
        for i in range(2):  # a product with a 2 x 2 matrix is several times slower
            origin[:, i] = linear[i, 0] * xy_px[:, 0] + linear[i, 1] * xy_px[:, 1] + offset[i]
        bottom, top = self.bounds_um
        cast_rays(self.specimen.height_um, origin, slope[None, :], top, bottom, hit)
        return hit

    def world_of_grid(self, position: FloatArray) -> FloatArray:
        """Return world x, y (N, 2) in um of grid positions (N, 2) = (col, row)."""
        to_grid = self.specimen.grid_from_world
        xy: FloatArray = (position - to_grid[:, 2]) / np.diag(to_grid[:, :2])
        return xy

    def _by_rows(self, rows: int, work: Callable[[int, int], None]) -> None:
        blocks = [(start, min(start + _BLOCK_ROWS, rows)) for start in range(0, rows, _BLOCK_ROWS)]
        if self.workers <= 1:
            for start, stop in blocks:
                work(start, stop)
            return
        with ThreadPoolExecutor(self.workers) as pool:
            list(pool.map(lambda block: work(*block), blocks))


def render_signal(
    scene: Scene,
    matrix: FloatArray,
    translation_px: FloatArray,
    axis_tilt_rad: tuple[float, float],
    line_offsets_px: FloatArray,
) -> FloatArray:
    """Render the noise-free signal of one view.

    Parameters
    ----------
    scene : Scene
        The specimen and the options.
    matrix : (2, 3) float array
        Camera in px per um, as of `geometry.cameras.camera_matrices`.
    translation_px : (2,) float array
        Image of the world's origin.
    axis_tilt_rad : tuple of two floats
        Axis angle and tilt: they turn the beam and the detector against the specimen.
    line_offsets_px : (H, 2) float array
        Where the beam lands relative to the pixel, per scan line.

    Returns
    -------
    (H, W) float array
        Mean signal over each pixel.
    """
    options = scene.options
    height, width, samples = options.height_px, options.width_px, options.samples
    # The lab's frame is the camera's at zero roll: the detector does not follow the scan rotation.
    lab_from_world = tilted_cam_from_world(*axis_tilt_rad, 0.0)
    azimuth, elevation = np.deg2rad([options.detector_azimuth_deg, options.detector_elevation_deg])
    in_lab = np.array([np.cos(azimuth) * np.cos(elevation), -np.sin(azimuth) * np.cos(elevation), -np.sin(elevation)])
    to_source, to_detector = -lab_from_world[2], lab_from_world.T @ in_lab
    strengths = strengths_of(options)
    sub = (np.arange(samples) + 0.5) / samples - 0.5
    x = (np.arange(width)[:, None] + sub).ravel()
    image = np.empty((height, width))

    def block(start: int, stop: int) -> None:
        y = (np.arange(start, stop)[:, None] + sub).ravel()
        offset = np.repeat(line_offsets_px[start:stop], samples, axis=0)
        xy = np.empty((len(y), len(x), 2))
        xy[..., 0] = x[None, :] + offset[:, :1]
        xy[..., 1] = (y + offset[:, 1])[:, None]
        hit = scene.cast(xy.reshape(-1, 2), matrix, translation_px)
        signal = np.empty(len(hit))
        world_xy = scene.world_of_grid(hit[:, :2])
        seed = scene.specimen.texture_seed
        shade(hit, world_xy, scene.layers, to_source, to_detector, strengths, seed, signal)
        image[start:stop] = signal.reshape(stop - start, samples, width, samples).mean(axis=(1, 3))

    _ = scene.layers  # once, before the threads ask for it
    scene._by_rows(height, block)
    return image


def truth_grid(scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sample the surface in the image's grid at zero tilt.

    Returns
    -------
    height_um : (H, W) float array
        Height of the surface under the centre of each pixel.
    normals : (H, W, 3) float array
        Unit normals of the surface, without the material's bumps, to float32 precision.
    world_from_grid : (4, 4) float array
        world = world_from_grid @ (col, row, height, 1).
    """
    options = scene.options
    height_px, width_px, pixel = options.height_px, options.width_px, options.pixel_size_um
    world_from_grid = np.eye(4)
    world_from_grid[0, 0], world_from_grid[0, 3] = pixel, -pixel * (width_px - 1) / 2
    world_from_grid[1, 1], world_from_grid[1, 3] = -pixel, pixel * (height_px - 1) / 2
    col, row = np.meshgrid(np.arange(width_px), np.arange(height_px))
    xy = np.column_stack([col.ravel(), row.ravel()]) @ world_from_grid[:2, :2].T + world_from_grid[:2, 3]
    to_grid = scene.specimen.grid_from_world
    position = xy @ to_grid[:, :2].T + to_grid[:, 2]
    height = np.empty(len(xy))
    sample_bilinear(scene.specimen.height_um, position, height)
    normals = np.ones((len(xy), 3))
    for i in range(2):
        sample_bilinear(scene.layers[..., i], position, normals[:, i])
        normals[:, i] *= -1.0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals.astype(np.float32).astype(np.float64)
    shape = height_px, width_px
    return height.reshape(shape), normals.reshape(*shape, 3), world_from_grid


def visible_points(scene: Scene, points_um: FloatArray, matrix: FloatArray, translation_px: FloatArray) -> BoolArray:
    """Tell which points (N, 3) of the surface a view sees: in the frame above the data bar, and not occluded.

    A point counts as occluded when the beam towards it meets the surface more than half a pixel before it.
    """
    options = scene.options
    xy = points_um @ matrix.T + translation_px
    hit = np.empty((len(xy), 3))

    def block(start: int, stop: int) -> None:
        rows = slice(start * options.width_px, stop * options.width_px)
        hit[rows] = scene.cast(xy[rows], matrix, translation_px)

    scene._by_rows(-(-len(xy) // options.width_px), block)
    limit = np.array([options.width_px, options.height_px - options.data_bar_rows]) - 0.5
    in_frame = ((xy >= -0.5) & (xy < limit)).all(axis=1)
    seen: BoolArray = in_frame & (hit[:, 2] - points_um[:, 2] < 0.5 * options.pixel_size_um)
    return seen
