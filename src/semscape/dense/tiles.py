"""Large fields in tiles with overlap: each tile is a small series of crops, and its core goes into the whole map.

Cores are faded into each other at their borders. Time and memory of the dense stage so follow the tile, whatever the
size of the images. The tiles' places follow from the images and the options alone: nothing depends on how many are
computed side by side, or where.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import pairwise, product
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semscape.dense.blank import without_blank
from semscape.dense.evidence import without_islands
from semscape.dense.parallel import as_parallel
from semscape.dense.reasons import unknown_reasons
from semscape.dense.rectify import PHASE_PX, grid_pixel_size_um
from semscape.dense.sampling import common_parallax
from semscape.dense.seams import Patch, Place, faded, strips_around
from semscape.dense.shading import GreyLevels, ShadingLaws, grey_levels
from semscape.dense.side_by_side import Mapper
from semscape.dense.specimen import with_specimen
from semscape.dense.surface import DenseSurface, Swept, choose_pairs, dense_surface, refined, swept
from semscape.geometry.cameras import camera_matrices
from semscape.options import DenseOptions
from semscape.types import FloatArray, HeightMap, ImageArray, Reconstruction, TiltSeries

# Beyond a tile's core: the widest window of the refinement reaches 40 px, the paths of matching about as far again; and
# half of the step between the places where tiles may begin.
_OVERLAP_PX = 88
# With its overlap and the relief's parallax a tile is about as large: cut, such a field would be twice the work.
_WHOLE_IN_TILES = 4 / 3
# Over so many px on both sides of a border tiles fade into each other: far from where a tile ends.
_FADE_PX = 32

# Height, uncertainty, number of views, texture, lateral period, and how many times the shared variance each holds.
_Planes = tuple[FloatArray, FloatArray, NDArray[np.uint8], ImageArray, ImageArray, ImageArray]
# With height, uncertainty and those times in each of the strips around, and the part of all variances, um^2, that the
# tile's heights share.
_Core = tuple[_Planes, list[tuple[FloatArray, FloatArray, ImageArray]], float]


@dataclass(frozen=True, eq=False)
class _Tile:
    """A series of crops with its reconstruction; `core` are the rows and columns of its map that count.

    The `strips` around it fade into other cores.
    """

    series: TiltSeries
    reconstruction: Reconstruction
    core: Place
    strips: list[Place]


def surface_in_tiles(
    series: TiltSeries,
    reconstruction: Reconstruction,
    options: DenseOptions,
    *,
    mapper: Mapper = map,
    threads: Mapper = map,
) -> DenseSurface:
    """Compute the height map of a calibrated series, a large one in tiles.

    Parameters
    ----------
    series : TiltSeries
    reconstruction : Reconstruction
        Of the same views.
    options : DenseOptions
        No side of a tile's core is longer than `tile_px`, but a field that is no larger than a tile with its overlap
        is one piece; with 0 it is, whatever its size.
    mapper : callable
        `map`, or one that runs the tiles side by side, in other processes if need be; the result does not depend on it.
    threads : callable
        `map`, or one that runs parts of one piece side by side in this process; nor on this.

    Raises
    ------
    DegenerateGeometryError
        When no two views differ enough in tilt.
    """
    series = as_parallel(series, reconstruction)
    whole = max(series.shape) <= _WHOLE_IN_TILES * options.tile_px
    rows, columns = (_edges(size, 0 if whole else options.tile_px) for size in series.shape)
    if len(rows) == len(columns) == 2:
        found = dense_surface(series, reconstruction, options, mapper=mapper, threads=threads)
    else:
        places = [(slice(*r), slice(*c)) for r, c in product(pairwise(rows), pairwise(columns))]
        fade_px = min(_FADE_PX, *(int(np.diff(edges).min()) // 2 for edges in (rows, columns)))
        cores = _cores(series, options, _cut(series, reconstruction, places, fade_px), mapper)
        height_map, shared_um2, times = _stitched(series, reconstruction, places, fade_px, cores)
        pairs = choose_pairs(reconstruction.motion.tilt_rad, options.max_pairs)
        found = DenseSurface(height_map, tuple(pairs), shared_um2, times)
    # Of the whole field at once: a tile knows neither where the images end nor what is white in them.
    reason = unknown_reasons(series, reconstruction, found.height_map)
    return replace(found, height_map=with_specimen(replace(found.height_map, reason=reason), options.keep))


def _stitched(
    series: TiltSeries, reconstruction: Reconstruction, places: list[Place], fade_px: int, cores: Iterable[_Core]
) -> tuple[HeightMap, float, ImageArray]:
    """Put the cores of all tiles into one map; what heights share far and wide, drift, they share beyond their tile."""
    pixel_size = grid_pixel_size_um(series, reconstruction)
    height, uncertainty = np.full(series.shape, np.nan), np.full(series.shape, np.nan)
    n_views = np.zeros(series.shape, np.uint8)
    texture, period, times = (np.full(series.shape, np.nan, np.float32) for _ in range(3))
    shared_um2, n_known = np.zeros(len(places)), np.zeros(len(places))
    rims: list[list[Patch]] = []
    held: list[list[ImageArray]] = []
    for k, (place, (core, around, shared)) in enumerate(zip(places, cores, strict=True)):
        height[place], uncertainty[place], n_views[place], texture[place], period[place], times[place] = core
        strips = strips_around(place, series.shape, fade_px)
        rims.append([Patch(place, strip, *found[:2]) for strip, found in zip(strips, around, strict=True)])
        held.append([found[2] for found in around])
        shared_um2[k], n_known[k] = shared, np.isfinite(core[0]).sum()
    pooled_um2 = float(shared_um2 @ n_known / max(n_known.sum(), 1.0))
    for place, rim, shares, shared in zip(places, rims, held, shared_um2, strict=True):
        sigmas = (uncertainty[place], *(patch.uncertainty for patch in rim))
        for sigma, share in zip(sigmas, (times[place], *shares), strict=True):
            sigma[:] = np.sqrt(np.maximum(sigma**2 - shared * share, 0.0) + pooled_um2 * share)
    for k, place in enumerate(places):
        own = Patch(place, place, height[place], uncertainty[place])
        others = [patch for near in _neighbours(places, k) for patch in rims[near]]
        height[place], uncertainty[place] = faded(own, others, series.shape, fade_px)
    # What stands alone in a tile may be small against the whole field.
    _, parallax = common_parallax(camera_matrices(reconstruction.motion)[:, :, 2] * pixel_size)
    height = without_islands(height / pixel_size, float(np.ptp(parallax))) * pixel_size
    unknown = np.isnan(height)
    uncertainty[unknown], texture[unknown], period[unknown], n_views[unknown] = np.nan, np.nan, np.nan, 0
    grid = _world_from_grid(series.shape, pixel_size)
    planes = height, uncertainty, n_views, texture
    height_map = HeightMap(*planes, pixel_size, grid, series.length_unit, lateral_period_um=period)
    return height_map, pooled_um2, times


def _neighbours(places: list[Place], k: int) -> list[int]:
    """Return which places lie next to one, at its corners too; places are ordered by rows.

    Examples
    --------
    >>> grid = [(slice(row, row + 1), slice(col, col + 1)) for row in range(3) for col in range(3)]
    >>> _neighbours(grid, 1)
    [0, 2, 3, 4, 5]
    """
    columns = sum(rows == places[0][0] for rows, _ in places)
    row, column = divmod(k, columns)
    near = product((row - 1, row, row + 1), (column - 1, column, column + 1))
    inside = [r * columns + c for r, c in near if 0 <= c < columns and 0 <= r < len(places) // columns]
    return [other for other in inside if other != k]


def _edges(size: int, tile_px: int) -> list[int]:
    """Return where the fewest parts of about equal length, none longer than `tile_px`, begin and end.

    Examples
    --------
    >>> _edges(2000, 1024), _edges(2000, 0)
    ([0, 1000, 2000], [0, 2000])
    """
    count = -(-size // tile_px) if tile_px else 1
    return [size * k // count for k in range(count + 1)]


def _cut(series: TiltSeries, reconstruction: Reconstruction, places: list[Place], fade_px: int) -> list[_Tile]:
    """Cut a series into tiles; each view's crop shows the core, its overlap and the parallax of all heights there."""
    motion, pixel_size = reconstruction.motion, grid_pixel_size_um(series, reconstruction)
    matrices = camera_matrices(motion)
    world_from_grid = _world_from_grid(series.shape, pixel_size)
    low, high = np.percentile(reconstruction.points_um[:, 2], [0.2, 99.8])

    def seen(place: Place) -> tuple[FloatArray, FloatArray]:
        """Return the first and the last px (V, 2), x and y, that show a place in each view."""
        rows, columns = ((part.start - _OVERLAP_PX, part.stop - 1 + _OVERLAP_PX) for part in place)
        corners = np.array([(col, row, z, 1.0) for col, row, z in product(columns, rows, (low, high))])
        xy = np.einsum("vij,nj->vni", matrices, corners @ world_from_grid[:3].T) + motion.translation_px[:, None]
        return np.floor(xy.min(axis=1)), np.ceil(xy.max(axis=1))

    boxes = [seen(place) for place in places]
    # As even or odd as the whole: so the tiles' middles lie whole pixels from that of the whole.
    largest = np.max([last - first for first, last in boxes], axis=(0, 1))
    width, height = (
        int(size) + 1 + (int(size) + 1 - whole) % 2 for size, whole in zip(largest, series.shape[::-1], strict=True)
    )
    tiles = []
    for place, (first, last) in zip(places, boxes, strict=True):
        corner = (np.rint((first + last) / 2 - [(width - 1) / 2, (height - 1) / 2])).astype(np.int64)
        top, left = (
            _start(part, size, whole) for part, size, whole in zip(place, (height, width), series.shape, strict=True)
        )
        centre = world_from_grid @ [left + (width - 1) / 2, top + (height - 1) / 2, 0.0, 1.0]
        views = tuple(
            replace(
                view,
                image=_crop(view.image, corner[i], (height, width), "edge"),
                mask=_crop(view.mask, corner[i], (height, width), "constant"),
            )
            for i, view in enumerate(series.views)
        )
        moved = replace(motion, translation_px=motion.translation_px + matrices[:, :, :2] @ centre[:2] - corner)
        points = reconstruction.points_um - [centre[0], centre[1], 0.0]
        core, *strips = (
            (slice(part[0].start - top, part[0].stop - top), slice(part[1].start - left, part[1].stop - left))
            for part in (place, *strips_around(place, series.shape, fade_px))
        )
        crops = replace(series, views=views), replace(reconstruction, motion=moved, points_um=points)
        tiles.append(_Tile(*crops, core, strips))
    return tiles


def _start(core: slice, size: int, whole: int) -> int:
    """Return where a tile begins around its core, its middle a multiple of `PHASE_PX` from that of the whole.

    Examples
    --------
    >>> _start(slice(0, 500), 660, 1000)
    -86
    >>> (-86 + 660 / 2 - 1000 / 2) / 16
    -16.0
    """
    ideal, middle = (core.start + core.stop - size) / 2, (whole - size) // 2
    return int(middle + PHASE_PX * round((ideal - middle) / PHASE_PX))


def _crop(values: NDArray[Any], corner: NDArray[np.int64], shape: tuple[int, int], beyond: Any) -> NDArray[Any]:
    """Return the part of an image that begins at `corner` (x, y); beyond the image as `np.pad` has it."""
    inside, padding = [], []
    for first, length, size in zip(corner[::-1], shape, values.shape, strict=True):
        begin, end = (int(np.clip(edge, 0, size - 1 + k)) for k, edge in enumerate((first, first + length)))
        end = max(end, begin + 1)
        inside.append(slice(begin, end))
        padding.append((max(begin - int(first), 0), max(int(first) + length - end, 0)))
    part = values[tuple(inside)]
    if not np.any(padding):
        return part
    return np.pad(part, padding, mode=beyond)[: shape[0], : shape[1]]


def _cores(series: TiltSeries, options: DenseOptions, tiles: list[_Tile], mapper: Mapper) -> Iterable[_Core]:
    """Return the cores of all tiles, which follow one law of shading: that of the whole field."""
    levels = grey_levels(without_blank(series).views) if options.shading else None
    if levels is None:
        return mapper(partial(_unshaded_core, options), tiles)
    starts = list(mapper(partial(_start_of, options, levels), tiles))
    laws = ShadingLaws(levels, [reduce(add, told) for told in zip(*(start.told for start in starts), strict=True)])
    return mapper(partial(_core, options, laws), list(zip(tiles, starts, strict=True)))


def _unshaded_core(options: DenseOptions, tile: _Tile) -> _Core:
    return _core(options, None, (tile, _start_of(options, None, tile)))


def _start_of(options: DenseOptions, levels: GreyLevels | None, tile: _Tile) -> Swept:
    return swept(tile.series, tile.reconstruction, options, levels, tile.core)


def _core(options: DenseOptions, laws: ShadingLaws | None, started: tuple[_Tile, Swept]) -> _Core:
    tile, start = started
    surface = refined(tile.series, tile.reconstruction, options, start, laws)
    found = surface.height_map
    core = tile.core
    planes = (
        found.height_um[core].copy(),
        found.uncertainty_um[core].copy(),
        found.n_views[core].copy(),
        found.texture[core].copy(),
        found.lateral_period_um[core].copy(),
        surface.shared_times[core].copy(),
    )
    around = [
        (found.height_um[strip].copy(), found.uncertainty_um[strip].copy(), surface.shared_times[strip].copy())
        for strip in tile.strips
    ]
    return planes, around, surface.shared_variance_um2


def _world_from_grid(shape: tuple[int, int], pixel_size: float) -> FloatArray:
    rows, columns = shape
    world_from_grid = np.diag([pixel_size, -pixel_size, 1.0, 1.0])
    world_from_grid[:2, 3] = -pixel_size * (columns - 1) / 2, pixel_size * (rows - 1) / 2
    return world_from_grid
