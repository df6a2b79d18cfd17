"""From calibrated views all around to one watertight mesh: a height map per group of views, merged."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from semscape.dense.groups import PlacedMap, ViewGroup, group_views, view_group
from semscape.dense.merge import MergedSurface, merge_maps
from semscape.dense.register import register_maps
from semscape.dense.side_by_side import Mapper
from semscape.dense.tiles import surface_in_tiles
from semscape.errors import DegenerateGeometryError
from semscape.options import DenseOptions
from semscape.sfm.full_object import FullObjectMotion
from semscape.types import TiltSeries


@dataclass(frozen=True, eq=False)
class FullObject:
    """A body seen from all around: the views' motion, the height map of each group, and what they merge into."""

    series: TiltSeries
    motion: FullObjectMotion
    maps: tuple[PlacedMap, ...]
    merged: MergedSurface

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was doubtful in the files, what the images contradict, and what they leave open."""
        return (*self.series.warnings, *self.motion.doubts)


def full_object_surface(
    series: TiltSeries,
    motion: FullObjectMotion,
    options: DenseOptions,
    *,
    mapper: Mapper = map,
) -> FullObject:
    """Compute the height maps of all groups of views and merge them.

    Parameters
    ----------
    series : TiltSeries
    motion : FullObjectMotion
    options : DenseOptions
    mapper : callable
        `map`, or one that runs groups side by side; the result does not depend on it.

    Raises
    ------
    DegenerateGeometryError
        If no two views of one stage rotation differ in tilt.
    NoAnswerError
        If the height maps do not agree.
    """
    found = [view_group(views, series, motion) for views in group_views(motion)]
    groups = [group for group in found if group is not None]
    if not groups:
        raise DegenerateGeometryError(
            "no two views of one stage rotation differ in tilt and share points: take two or three tilts, some deg "
            "apart, at every rotation"
        )
    maps = register_maps(list(mapper(partial(_placed_map, options), groups)))
    return FullObject(series, motion, tuple(maps), merge_maps(maps))


def _placed_map(options: DenseOptions, group: ViewGroup) -> PlacedMap:
    found = surface_in_tiles(group.series, group.reconstruction, options)
    return PlacedMap(group.views, found.height_map, group.world_from_group)
