"""Specimen and background: what stands on a stub, and the stub that the microscopist did not come for.

A background is seen where it leaves the field: along the border. It is told by one of two signs, or both. A flat stub:
most heights along the border lie on one plane, and clearly above it stands a good part of the field, while hardly
anything lies below. An empty stub: much of the border, and of the field from there on, is without texture. Where
neither holds the whole field is specimen: a fracture, a polished section, an indent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import (
    binary_closing,
    binary_dilation,
    binary_erosion,
    binary_fill_holes,
    label,
)

from semscape.types import BoolArray, FloatArray, HeightMap, IntArray, Reason

_MOST_PIXELS = 1_000_000
_BORDER_SHARE = 0.06
_LEAST_BORDER_KNOWN = 0.2
_MAD_PER_SIGMA = 0.6745
_ROUNDS = 20
# Of the border's heights; and in sigmas of the stub's own roughness, beyond which something stands above it.
_LEAST_ON_PLANE = 0.7
_ON_PLANE, _ABOVE, _WELL_ABOVE = 3.0, 5.0, 10.0
_LEAST_AREA, _MOST_BELOW = 0.03, 0.02
_LEAST_EMPTY_BORDER, _LEAST_EMPTY_AREA = 0.3, 0.1
# Smaller things, against the largest, are debris.
_DEBRIS = 0.05
_GAP_PX = 4


def with_specimen(height_map: HeightMap, keep: str) -> HeightMap:
    """Return a height map that says which pixels are specimen; with `keep` "specimen" the others are unknown.

    Parameters
    ----------
    height_map : HeightMap
    keep : str
        "all" or "specimen".
    """
    specimen = specimen_mask(height_map)
    if keep == "all" or specimen.all():
        return replace(height_map, specimen=specimen)
    return replace(
        height_map,
        specimen=specimen,
        height_um=np.where(specimen, height_map.height_um, np.nan),
        uncertainty_um=np.where(specimen, height_map.uncertainty_um, np.nan),
        n_views=np.where(specimen, height_map.n_views, np.uint8(0)),
        texture=np.where(specimen, height_map.texture, np.float32(np.nan)),
        lateral_period_um=np.where(specimen, height_map.lateral_period_um, np.float32(np.nan)),
        reason=np.where(specimen, height_map.reason, np.uint8(Reason.BACKGROUND)),
    )


def specimen_mask(height_map: HeightMap) -> BoolArray:
    """Tell specimen (True) from background, (H, W); all True where no background shows.

    Parameters
    ----------
    height_map : HeightMap
        Heights and the reasons of unknown ones.
    """
    shape = height_map.height_um.shape
    step = int(np.ceil(np.sqrt(height_map.height_um.size / _MOST_PIXELS)))
    height = height_map.height_um[::step, ::step]
    stub = _on_stub(height)
    empty = _empty(height_map.reason[::step, ::step])
    if stub is None and empty is None:
        return np.ones(shape, np.bool_)
    thing = np.isfinite(height) if stub is None else np.isfinite(height) & ~stub
    gap = max(1, _GAP_PX // step)
    thing = binary_closing(np.pad(thing, gap), iterations=gap)[gap:-gap, gap:-gap]
    filled: BoolArray = binary_fill_holes(thing)
    filled = binary_dilation(binary_erosion(filled, iterations=gap), iterations=gap, mask=filled)  # thin fringes go
    parts, count = label(filled)
    if not count:
        return np.ones(shape, np.bool_)
    area = np.bincount(parts.ravel())
    area[0] = 0
    kept = (area >= _DEBRIS * area.max())[parts]
    mask: BoolArray = np.repeat(np.repeat(kept, step, axis=0), step, axis=1)[: shape[0], : shape[1]]
    return mask


def _on_stub(height: FloatArray) -> BoolArray | None:
    """Return which heights lie on a flat stub, or below; None where none shows along the border."""
    band = max(2, int(_BORDER_SHARE * min(height.shape)))
    border = np.ones(height.shape, np.bool_)
    border[band:-band, band:-band] = False
    known = np.isfinite(height)
    row, col = np.nonzero(border & known)
    if len(row) < _LEAST_BORDER_KNOWN * border.sum():
        return None
    plane, sigma = _plane(row, col, height[row, col])
    rows, cols = np.indices(height.shape)
    above = height - (plane[0] + plane[1] * rows + plane[2] * cols)
    total = known.sum()
    with np.errstate(invalid="ignore"):
        on_plane = np.mean(np.abs(above[row, col]) <= _ON_PLANE * sigma)
        standing = (above > _WELL_ABOVE * sigma).sum() / total
        below = (above < -_ABOVE * sigma).sum() / total
        stub: BoolArray = above <= _ABOVE * sigma
    if on_plane < _LEAST_ON_PLANE or standing < _LEAST_AREA or below > _MOST_BELOW:
        return None
    return stub


def _plane(row: IntArray, col: IntArray, height: FloatArray) -> tuple[FloatArray, float]:
    """Fit a plane to points (N,) of which some stand above it; return it (offset, by row, by column) and its sigma."""
    design = np.column_stack([np.ones(len(row)), row, col])
    used = height <= np.percentile(height, 70)
    sigma = 0.0
    for _ in range(_ROUNDS):
        plane, *_ = np.linalg.lstsq(design[used], height[used])
        rest = height - design @ plane
        sigma = float(np.median(np.abs(rest[used])) / _MAD_PER_SIGMA)
        inner = np.abs(rest) <= max(_ON_PLANE * sigma, 1e-12)
        if (inner == used).all():
            break
        used = inner
    return np.asarray(plane, np.float64), max(sigma, 1e-12)


def _empty(reason: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> BoolArray | None:
    """Return what is without texture from the border on; None where that is little."""
    blank = reason == Reason.NO_TEXTURE
    parts, _ = label(blank)
    edge = np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]])
    empty: BoolArray = np.isin(parts, np.unique(edge[edge > 0]))
    if (edge > 0).mean() < _LEAST_EMPTY_BORDER or empty.mean() < _LEAST_EMPTY_AREA:
        return None
    return empty
