"""From a calibrated series to one height map at zero tilt: pairs, fusion, multi-view refinement."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import combinations

import cv2
import numpy as np

from semscape.dense.blank import without_blank
from semscape.dense.bridge import without_specks
from semscape.dense.evidence import Begun, begin, refine_by_evidence
from semscape.dense.fuse import fuse, to_zero_tilt
from semscape.dense.given import JUMP_PX
from semscape.dense.rectify import Frame, grid_pixel_size_um, rectified_frame, warp_to_frame
from semscape.dense.sampling import ViewSampler, common_parallax, grid_in_view
from semscape.dense.shading import GreyLevels, Regression, ShadingLaws, grey_levels, regressions
from semscape.dense.side_by_side import Mapper
from semscape.dense.stereo import RectifiedView, pair_heights
from semscape.dense.sweep import Views, sharpen_jumps
from semscape.errors import DegenerateGeometryError
from semscape.geometry.cameras import camera_matrices
from semscape.options import DenseOptions
from semscape.types import FloatArray, HeightMap, ImageArray, Reconstruction, TiltSeries

_LEAST_BASELINE = 0.01
# A little more than a stage's round steps of 30 deg.
_WIDEST_TILT_RAD = np.deg2rad(32.0)
# On either side of the sparse heights; of their range or, if that is larger, of the field, for smooth things that stand
# free hold no sparse point under wide tilts. Wider ones find more false heights where texture is weak.
_RANGE_MARGIN = 0.15
_PRESMOOTH_PX = 0.5
# Whether views agree is asked of images with less noise.
_AGREEMENT_PRESMOOTH_PX = 0.7


@dataclass(frozen=True)
class DenseSurface:
    """A height map with the pairs it came from, and the part of its variances, um^2, that all of them share.

    `shared_times` (H, W) is how many times that each height holds, NaN where unknown: more than 1 where not all views
    agree.
    """

    height_map: HeightMap
    pairs: tuple[tuple[int, int], ...]
    shared_variance_um2: float
    shared_times: ImageArray


@dataclass(frozen=True, eq=False)
class Swept:
    """Heights that are crisp at jumps, smoothed as far as they tell, and what brightness says of their slopes."""

    begun: Begun
    told: list[Regression]


def dense_surface(
    series: TiltSeries,
    reconstruction: Reconstruction,
    options: DenseOptions,
    *,
    mapper: Mapper = map,
    threads: Mapper = map,
) -> DenseSurface:
    """Compute the height map of a calibrated series on the reference view's grid at zero tilt.

    Parameters
    ----------
    series : TiltSeries
    reconstruction : Reconstruction
        Of the same views.
    options : DenseOptions
    mapper : callable
        `map`, or one that runs pairs side by side, in other processes if need be; the result does not depend on it.
    threads : callable
        `map`, or one that runs smaller parts side by side in this process; nor on this.

    Raises
    ------
    DegenerateGeometryError
        When no two views differ enough in tilt.
    """
    levels = grey_levels(without_blank(series).views) if options.shading else None
    found = swept(series, reconstruction, options, levels, mapper=mapper, threads=threads)
    laws = ShadingLaws(levels, found.told) if levels is not None else None
    return refined(series, reconstruction, options, found, laws, threads=threads)


def swept(
    series: TiltSeries,
    reconstruction: Reconstruction,
    options: DenseOptions,
    levels: GreyLevels | None,
    core: tuple[slice, slice] | None = None,
    *,
    mapper: Mapper = map,
    threads: Mapper = map,
) -> Swept:
    """Compute heights that are crisp at jumps, and what they say about shading in some core of them: the first half.

    The parameters are those of `dense_surface`, which also says what is raised, and of `shading.regressions`.
    """
    series = without_blank(series)
    frame = rectified_frame(series, reconstruction)
    pairs = choose_pairs(reconstruction.motion.tilt_rad, options.max_pairs)
    if not pairs:
        span = np.rad2deg(np.ptp(reconstruction.motion.tilt_rad))
        raise DegenerateGeometryError(f"the tilts span {span:.2f} deg only, too little for heights; tilt farther")
    views = tuple(
        RectifiedView(*warp_to_frame(view, index, reconstruction.motion, frame), float(frame.parallax[index]))
        for index, view in enumerate(series.views)
    )
    height_range = height_range_px(reconstruction, frame)
    heights = list(mapper(partial(_pair_at_zero_tilt, views, height_range, options), pairs))
    fused, _ = fuse(heights, [frame.parallax[j] - frame.parallax[i] for i, j in pairs])
    del views, heights  # the sweep needs the memory
    grid = _grid(series, reconstruction)
    looked = grid.views(series, reconstruction, _PRESMOOTH_PX)
    start_px = resample(fused, frame, grid.world_from_grid, series.shape)
    sharp_px = sharpen_jumps(start_px, looked, mapper=threads)
    begun = begin(sharp_px, looked.baseline)
    if levels is None:
        return Swept(begun, [])
    return Swept(begun, regressions(np.asarray(begun.height, np.float64), begun.known, looked, levels, core))


def refined(
    series: TiltSeries,
    reconstruction: Reconstruction,
    options: DenseOptions,
    start: Swept,
    laws: ShadingLaws | None,
    *,
    threads: Mapper = map,
) -> DenseSurface:
    """Compute the most probable surface from where the first half ended: the second half of `dense_surface`.

    `start` is what `swept` returned, `laws` those of the whole field; without them shading is not asked.
    """
    series = without_blank(series)
    grid = _grid(series, reconstruction)
    looked, calm = (grid.views(series, reconstruction, sigma) for sigma in (_PRESMOOTH_PX, _AGREEMENT_PRESMOOTH_PX))
    found = refine_by_evidence(start.begun, looked, calm, laws, mapper=threads)
    heights = without_specks(found, looked.baseline)
    pixel_size = grid.pixel_size_um
    height_map = HeightMap(
        height_um=heights.height * pixel_size,
        uncertainty_um=heights.uncertainty * pixel_size,
        n_views=heights.n_views,
        texture=_texture(series, reconstruction, heights.height, grid.view_from_grid, grid.px_per_height),
        pixel_size_um=pixel_size,
        world_from_grid=grid.world_from_grid,
        length_unit=series.length_unit,
        lateral_period_um=heights.lateral_period_px * np.float32(pixel_size),
    )
    pairs = choose_pairs(reconstruction.motion.tilt_rad, options.max_pairs)
    return DenseSurface(height_map, tuple(pairs), heights.slow_variance * pixel_size**2, heights.slow_share)


def choose_pairs(tilt_rad: FloatArray, max_pairs: int) -> list[tuple[int, int]]:
    """Choose the pairs that carry the most height information: wide ones, of views that still look alike.

    The widest of all, then each view's widest, from the most level view outwards: that sees most of the grid at zero
    tilt. Of equally wide ones the more level is taken.
    """
    tilt = np.asarray(tilt_rad, np.float64)
    spread = {(i, j): abs(float(np.tan(tilt[j]) - np.tan(tilt[i]))) for i, j in combinations(range(len(tilt)), 2)}
    parallax = [pair for pair, baseline in spread.items() if baseline > _LEAST_BASELINE]
    alike = [(i, j) for i, j in parallax if abs(tilt[j] - tilt[i]) <= _WIDEST_TILT_RAD]

    def rank(pair: tuple[int, int]) -> tuple[float, float, tuple[int, int]]:
        i, j = pair
        return -round(abs(float(tilt[j] - tilt[i])), 6), round(abs(float(tilt[j] + tilt[i])), 6), pair

    ranked = sorted(alike or parallax, key=rank)
    chosen = ranked[:1]
    for view in np.argsort(np.abs(tilt), kind="stable"):
        widest = next((pair for pair in ranked if view in pair), None)
        if widest is not None and widest not in chosen:
            chosen.append(widest)
    chosen += [pair for pair in ranked if pair not in chosen]
    return sorted(chosen[: max(max_pairs, 1)])


def _pair_at_zero_tilt(
    views: tuple[RectifiedView, ...],
    height_range_px: tuple[float, float],
    options: DenseOptions,
    pair: tuple[int, int],
) -> FloatArray:
    view1, view2 = views[pair[0]], views[pair[1]]
    return to_zero_tilt(pair_heights(view1, view2, height_range_px, options), view1.parallax)


def height_range_px(reconstruction: Reconstruction, frame: Frame, *, beyond_points: bool = True) -> tuple[float, float]:
    """Return the range of the sparse heights, without their last outliers, widened by a margin on each side.

    With `beyond_points` the margin is no less than a share of the field, for things without sparse points.
    """
    low, high = np.percentile(reconstruction.points_um[:, 2], [0.2, 99.8]) / frame.pixel_size_um
    margin = _RANGE_MARGIN * max(high - low, min(frame.shape) if beyond_points else 0.0)
    return float(low - margin), float(high + margin)


@dataclass(frozen=True, eq=False)
class _Grid:
    """The output's grid in the world and in every view: `px_per_height` (V, 2) is the shift per px of height."""

    pixel_size_um: float
    world_from_grid: FloatArray
    view_from_grid: FloatArray
    px_per_height: FloatArray

    def views(self, series: TiltSeries, reconstruction: Reconstruction, presmooth_px: float) -> Views:
        direction, parallax = common_parallax(self.px_per_height)
        samplers = tuple(
            ViewSampler(view, place, shift, direction, series.shape, presmooth_px)
            for view, place, shift in zip(series.views, self.view_from_grid, self.px_per_height, strict=True)
        )
        return Views(samplers, parallax, reconstruction.reference)


def _grid(series: TiltSeries, reconstruction: Reconstruction) -> _Grid:
    pixel_size = grid_pixel_size_um(series, reconstruction)
    rows, columns = series.shape
    world_from_grid = np.diag([pixel_size, -pixel_size, 1.0, 1.0])
    world_from_grid[:2, 3] = -pixel_size * (columns - 1) / 2, pixel_size * (rows - 1) / 2
    matrices = camera_matrices(reconstruction.motion)
    view_from_grid = matrices[:, :, :2] @ world_from_grid[np.ix_([0, 1], [0, 1, 3])]
    view_from_grid[:, :, 2] += reconstruction.motion.translation_px
    return _Grid(pixel_size, world_from_grid, view_from_grid, matrices[:, :, 2] * pixel_size)


def resample(height_px: FloatArray, frame: Frame, world_from_grid: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Resample heights from the rectified frame into the output grid, without bridging jumps or gaps."""
    frame_from_world = np.linalg.inv(np.vstack([frame.world_from_frame, [0, 0, 1]]))
    grid_to_world = np.array(
        [
            [world_from_grid[0, 0], 0, world_from_grid[0, 3]],
            [0, world_from_grid[1, 1], world_from_grid[1, 3]],
            [0, 0, 1],
        ]
    )
    frame_from_grid = (frame_from_world @ grid_to_world)[:2]
    size = (shape[1], shape[0])
    known = np.isfinite(height_px)
    values = np.where(known, height_px, 0.0)

    def warp(image: FloatArray, interpolation: int) -> FloatArray:
        warped: FloatArray = cv2.warpAffine(image, frame_from_grid, size, flags=cv2.WARP_INVERSE_MAP | interpolation)
        return warped

    nearest = warp(values, cv2.INTER_NEAREST)
    nearest_known = warp(known.astype(np.float64), cv2.INTER_NEAREST) > 0.5
    share = warp(known.astype(np.float64), cv2.INTER_LINEAR)
    linear = warp(values, cv2.INTER_LINEAR) / np.maximum(share, 1e-6)
    smooth = (share > 0.999) & (np.abs(linear - nearest) < JUMP_PX / max(float(np.ptp(frame.parallax)), 1e-3))
    return np.where(nearest_known, np.where(smooth, linear, nearest), np.nan)


def _texture(
    series: TiltSeries,
    reconstruction: Reconstruction,
    height_px: FloatArray,
    view_from_grid: FloatArray,
    px_per_height: FloatArray,
) -> ImageArray:
    """Return the reference micrograph as seen on the surface, NaN where the surface is unknown."""
    reference = reconstruction.reference
    x, y = grid_in_view(view_from_grid[reference], height_px.shape)
    h = np.nan_to_num(height_px).astype(np.float32)
    sampled = cv2.remap(
        series.views[reference].image,
        x + h * np.float32(px_per_height[reference, 0]),
        y + h * np.float32(px_per_height[reference, 1]),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.where(np.isfinite(height_px), sampled, np.nan).astype(np.float32)
