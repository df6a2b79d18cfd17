"""Micrographs by ray casting: the signal of one view, and which points of the surface it sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from semscape.geometry.rotations import roll_rotation, tilted_cam_from_world
from semscape.simulate.camera import ScanCamera
from semscape.simulate.detectors import Segment, se_direction, segments_of
from semscape.simulate.mesh import MeshSpecimen
from semscape.simulate.presets import SimulationOptions
from semscape.simulate.signal import apply_material, backscattered_signal, secondary_signal
from semscape.simulate.specimens import Specimen
from semscape.simulate.surface import NORMAL, MeshSurface, ReliefSurface, Surface, in_blocks
from semscape.types import BoolArray, FloatArray

_BLOCK_ROWS = 32
_GRAZING = 1e-3
_DOWN: FloatArray = np.array([[0.0, 0.0, -1.0]])


@dataclass(frozen=True, eq=False)
class Scene:
    """A specimen under the microscope, with what its views share.

    Parameters
    ----------
    specimen : Specimen or MeshSpecimen
        The surface.
    options : SimulationOptions
        Image size and signal strengths.
    workers : int
        Threads over blocks of image rows; the result does not depend on it.
    """

    specimen: Specimen | MeshSpecimen
    options: SimulationOptions
    workers: int = 1

    @cached_property
    def surface(self) -> Surface:
        """The specimen, ready for beams."""
        if isinstance(self.specimen, Specimen):
            return ReliefSurface(self.specimen, self.options)
        return MeshSurface(self.specimen, self.options)

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Segments of the backscatter detector, none for secondary electrons."""
        options = self.options
        return segments_of(options.detector, options.scan_rotation_deg, options.segment_elevation_deg)

    def by_rows(self, work: Callable[[int, int], None]) -> None:
        """Call work(start, stop) for blocks of image rows."""
        in_blocks(self.options.height_px, _BLOCK_ROWS, work, self.workers)


def render_signal(
    scene: Scene,
    camera: ScanCamera,
    axis_tilt_rad: tuple[float, float],
    line_offsets_px: FloatArray,
    rotation_rad: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Render the noise-free signal of one view.

    Parameters
    ----------
    scene : Scene
        The specimen and the options.
    camera : ScanCamera
        The view's camera.
    axis_tilt_rad : tuple of two floats
        Axis angle and tilt: they turn the detector against the specimen.
    line_offsets_px : (H, 2) float array
        Where the beam lands relative to the pixel, per scan line.
    rotation_rad : float
        Rotation of the stage, before the tilt.

    Returns
    -------
    signal : (K, H, W) float array
        Mean signal over each pixel, one channel per segment, or a single one for secondary electrons.
    depth_um : (H, W) float array
        Mean depth below the eucentric plane along the optical axis, NaN where a pixel sees nothing.
    """
    options = scene.options
    height, width, samples = options.height_px, options.width_px, options.samples
    # The lab's frame is the camera's at zero roll: no detector follows a turn of the image between the views.
    world_from_lab = (tilted_cam_from_world(*axis_tilt_rad, 0.0) @ roll_rotation(rotation_rad)).T
    sub = (np.arange(samples) + 0.5) / samples - 0.5
    x = (np.arange(width)[:, None] + sub).ravel()
    surface = scene.surface  # made once, before the threads ask for it
    signal = np.empty((max(1, len(scene.segments)), height, width))
    depth = np.empty((height, width))

    def block(start: int, stop: int) -> None:
        y = (np.arange(start, stop)[:, None] + sub).ravel()
        offset = np.repeat(line_offsets_px[start:stop], samples, axis=0)
        xy = np.empty((len(y), len(x), 2))
        xy[..., 0] = x[None, :] + offset[:, :1]
        xy[..., 1] = (y + offset[:, 1])[:, None]
        points, beam = camera.rays(xy.reshape(-1, 2))
        position, place = surface.cast(points, beam)
        hit = np.flatnonzero(~np.isnan(position[:, 2]))
        position, beam = position[hit], beam if len(beam) == 1 else beam[hit]
        values = np.zeros((len(signal), len(points)))
        values[:, hit] = shade(scene, position, place[hit], beam, world_from_lab)
        shape = stop - start, samples, width, samples
        for channel, value in zip(signal, values, strict=True):
            channel[start:stop] = value.reshape(shape).mean(axis=(1, 3))
        seen, total = np.zeros(len(points)), np.zeros(len(points))
        seen[hit], total[hit] = 1.0, position @ camera.rotation[2]
        count = seen.reshape(shape).sum(axis=(1, 3))
        mean = total.reshape(shape).sum(axis=(1, 3)) / np.maximum(count, 1.0)
        depth[start:stop] = np.where(count > 0, mean, np.nan)

    scene.by_rows(block)
    return signal, depth


def shade(
    scene: Scene, position: FloatArray, place: FloatArray, beam: FloatArray, world_from_lab: FloatArray
) -> FloatArray:
    """Return the signal (K, N) of every channel at points (N, 3) of the surface and their places of `Surface.cast`."""
    options = scene.options
    attributes = scene.surface.attributes(place)
    facing = attributes[:, NORMAL].copy()
    factor = np.ones(len(position))
    if options.texture > 0 or options.texture_bump > 0:
        wavelength = max(options.texture_px, 1e-3) * options.pixel_size_um
        seed = scene.specimen.texture_seed
        apply_material(position, attributes, options.texture, wavelength, options.texture_bump, seed, factor)
    if not scene.segments:
        strengths = np.array([options.yield_saturation, options.edge_gain, options.detector_asymmetry, options.cavity])
        azimuth = options.detector_azimuth_deg + options.scan_rotation_deg
        to_detector = world_from_lab @ se_direction(azimuth, options.detector_elevation_deg)
        out = np.empty((1, len(position)))
        secondary_signal(attributes, factor, beam, to_detector, strengths, out[0])
        return out
    out = np.empty((len(scene.segments), len(position)))
    for value, segment in zip(out, scene.segments, strict=True):
        mean = segment.mean_direction
        backscattered_signal(
            attributes, factor, beam, world_from_lab @ mean, float(-mean[2]), options.atomic_number, value
        )
        if options.cavity > 0:
            middle = world_from_lab @ se_direction(segment.azimuth_deg, segment.elevation_deg)
            lifted = position + 0.25 * options.pixel_size_um * facing
            value[hidden(scene, lifted, -middle[None, :])] *= 1.0 - options.cavity
    return out


def hidden(scene: Scene, points_um: FloatArray, directions: FloatArray, least_um: float = 0.0) -> BoolArray:
    """Tell which points (N, 3) something hides from beams along `directions` (N, 3) or (1, 3), `least_um` before it."""
    if isinstance(scene.specimen, Specimen) and directions[0, 2] > -_GRAZING:
        return np.ones(len(points_um), dtype=np.bool_)  # the detector lies below the specimen's horizon
    position, _ = scene.surface.cast(points_um, directions)
    before = -np.einsum("nk,nk->n", position - points_um, np.broadcast_to(directions, position.shape))
    covered: BoolArray = np.nan_to_num(before, nan=0.0) > least_um
    return covered


def truth_grid(scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sample the surface in the image's grid at zero tilt.

    Returns
    -------
    height_um : (H, W) float array
        Height of the highest surface under the centre of each pixel, NaN where there is none.
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
    above = np.zeros((col.size, 3))
    above[:, :2] = np.column_stack([col.ravel(), row.ravel()]) @ world_from_grid[:2, :2].T + world_from_grid[:2, 3]
    position, place = scene.surface.cast(above, _DOWN)
    normals = np.full(position.shape, np.nan)
    met = ~np.isnan(position[:, 2])
    normals[met] = scene.surface.normals(place[met])
    normals = normals.astype(np.float32).astype(np.float64)
    shape = height_px, width_px
    return position[:, 2].reshape(shape), normals.reshape(*shape, 3), world_from_grid


def visible_points(scene: Scene, points_um: FloatArray, camera: ScanCamera) -> BoolArray:
    """Tell which points (H W, 3) of the surface a view sees: in the frame above the data bar, and not occluded.

    A point counts as occluded when the beam towards it meets the surface more than half a pixel before it; a point
    that is NaN is not seen.
    """
    options = scene.options
    known = np.flatnonzero(~np.isnan(points_um[:, 2]))
    points = points_um[known]
    xy = camera.project(points)
    covered = np.empty(len(points), dtype=np.bool_)

    def block(start: int, stop: int) -> None:
        _, directions = camera.rays(xy[start:stop])
        covered[start:stop] = hidden(scene, points[start:stop], directions, 0.5 * options.pixel_size_um)

    in_blocks(len(points), _BLOCK_ROWS * options.width_px, block, scene.workers)
    limit = np.array([options.width_px, options.height_px - options.data_bar_rows]) - 0.5
    seen = np.zeros(len(points_um), dtype=np.bool_)
    seen[known] = ((xy >= -0.5) & (xy < limit)).all(axis=1) & ~covered
    return seen
