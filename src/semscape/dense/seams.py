"""Heights of neighbouring tiles faded into each other, so that no step shows where one ends."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from semscape.types import FloatArray

Place = tuple[slice, slice]

# Tiles agree to this many of their sigmas; at twice as many they show different surfaces, as beside a jump.
_SAME_IN_SIGMAS = 2.0


@dataclass(frozen=True, eq=False)
class Patch:
    """Heights and their uncertainty (rows, columns) at a place of the field, by the tile whose core is `core`."""

    core: Place
    place: Place
    height: FloatArray
    uncertainty: FloatArray


def strips_around(core: Place, shape: tuple[int, int], fade_px: int) -> list[Place]:
    """Return what of the field lies within `fade_px` around a tile's core, above, below, left and right of it.

    Examples
    --------
    >>> strips_around((slice(0, 40), slice(50, 90)), (80, 90), 8)
    [(slice(40, 48, None), slice(42, 90, None)), (slice(0, 40, None), slice(42, 50, None))]
    """
    (top, bottom), (left, right) = ((part.start, part.stop) for part in core)
    first, last = max(left - fade_px, 0), min(right + fade_px, shape[1])
    strips = [
        (slice(max(top - fade_px, 0), top), slice(first, last)),
        (slice(bottom, min(bottom + fade_px, shape[0])), slice(first, last)),
        (slice(top, bottom), slice(first, left)),
        (slice(top, bottom), slice(right, last)),
    ]
    return [strip for strip in strips if all(part.stop > part.start for part in strip)]


def faded(own: Patch, others: Iterable[Patch], shape: tuple[int, int], fade_px: int) -> tuple[FloatArray, FloatArray]:
    """Return the heights of a tile's core and their uncertainty, faded into what the tiles around say of it.

    The parts of two tiles go linearly from one to nothing over `fade_px` on both sides of the border between them.
    A tile that knows no height at a place, or another surface, has no part there: beside a jump the tile in whose core
    the place lies decides, and what is unknown to that stays unknown. Tiles see the same noise, so their sigmas are
    averaged, not lowered.

    Parameters
    ----------
    own : Patch
        The core: `place` is `core`.
    others : iterable of Patch
        What other tiles found next to their own cores; anywhere.
    shape : (int, int)
        Of the whole field, at whose border no tile fades.
    fade_px : int
        At most half of the shortest side of a core.
    """
    total = _part(own.core, own.place, shape, fade_px)
    height, uncertainty = total * own.height, total * own.uncertainty
    for other in others:
        both = tuple(
            slice(max(mine.start, theirs.start), min(mine.stop, theirs.stop))
            for mine, theirs in zip(own.place, other.place, strict=True)
        )
        if any(part.stop <= part.start for part in both):
            continue
        place = both[0], both[1]
        here, there = _within(place, own.place), _within(place, other.place)
        sigma = np.hypot(own.uncertainty[here], other.uncertainty[there])
        with np.errstate(invalid="ignore", divide="ignore"):
            apart = np.abs(own.height[here] - other.height[there]) / (_SAME_IN_SIGMAS * sigma)
        part = _part(other.core, place, shape, fade_px) * np.clip(2 - np.nan_to_num(apart, nan=2.0), 0, 1)
        total[here] += part
        height[here] += part * np.nan_to_num(other.height[there])
        uncertainty[here] += part * np.nan_to_num(other.uncertainty[there])
    return height / total, uncertainty / total


def _part(core: Place, place: Place, shape: tuple[int, int], fade_px: int) -> FloatArray:
    """Return the part of a tile in the heights at a place, before others turn out to be unknown."""
    rows, columns = (
        _ramp(along, part.start, part.stop, size, fade_px) for along, part, size in zip(place, core, shape, strict=True)
    )
    return np.asarray(rows[:, None] * columns, np.float64)


def _ramp(along: slice, start: int, stop: int, size: int, fade_px: int) -> FloatArray:
    at = np.arange(along.start, along.stop) + 0.5
    rise = (at - start) / (2 * fade_px) + 0.5 if start > 0 else np.ones(at.shape)
    fall = (stop - at) / (2 * fade_px) + 0.5 if stop < size else np.ones(at.shape)
    return np.asarray(np.clip(np.minimum(rise, fall), 0, 1), np.float64)


def _within(place: Place, whole: Place) -> Place:
    rows, columns = (
        slice(part.start - start.start, part.stop - start.start) for part, start in zip(place, whole, strict=True)
    )
    return rows, columns
