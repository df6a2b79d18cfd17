"""Oriented points of a surface on a regular grid: what is known there of the gradient of a body's indicator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.sparse import csr_array

from semscape.types import FloatArray

_SMOOTHING_CELLS = 0.7


@dataclass(frozen=True, eq=False)
class OrientedPoints:
    """Points (N, 3) with unit normals (N, 3) to the outside, and the area (N,) of the surface that each stands for."""

    points: FloatArray
    normals: FloatArray
    area: FloatArray

    def with_others(self, other: OrientedPoints) -> OrientedPoints:
        """Return these points and the others."""
        return OrientedPoints(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.normals, other.normals]),
            np.concatenate([self.area, other.area]),
        )


def node_weights(places: FloatArray, shape: tuple[int, ...]) -> csr_array:
    """Return the sparse matrix (N, nodes) that interpolates a grid at places (N, 3), in nodes."""
    base = np.floor(places).astype(np.int64)
    part = places - base
    columns, weights = [], []
    for corner in np.ndindex(2, 2, 2):
        columns.append(np.ravel_multi_index(tuple((base + corner).T), shape))
        weights.append(np.where(corner, part, 1 - part).prod(axis=1))
    rows = np.repeat(np.arange(len(places)), 8)
    data = np.stack(weights, axis=1).ravel()
    return csr_array((data, (rows, np.stack(columns, axis=1).ravel())), shape=(len(places), int(np.prod(shape))))


def gradient_source(
    at_points: csr_array, samples: OrientedPoints, shape: tuple[int, ...], cell: float
) -> tuple[NDArray[np.complex128], FloatArray]:
    """Return what -laplace(indicator) is by the gradient at the points, and the squared frequencies, both transformed.

    -laplace(indicator) = -div(gradient), with the gradient = -normal at the surface; lengths are in cells.
    """
    area = samples.area / cell**2
    frequency = np.meshgrid(
        *(2 * np.pi * fft.fftfreq(size) for size in shape[:2]), 2 * np.pi * fft.rfftfreq(shape[2]), indexing="ij"
    )
    squared = np.asarray(sum(axis * axis for axis in frequency), np.float64)
    smoothing = np.exp(-0.5 * _SMOOTHING_CELLS**2 * squared)
    source = np.zeros(squared.shape, np.complex128)
    for k, axis in enumerate(frequency):
        field = (at_points.T @ (area * samples.normals[:, k])).reshape(shape)
        source += 1j * axis * fft.rfftn(field) * smoothing
    return source, squared
