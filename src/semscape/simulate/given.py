"""Specimens from surfaces of the user's: where they stand under the beam, and how large they are imaged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semscape.errors import BadInputError
from semscape.simulate.mesh import MeshSpecimen
from semscape.simulate.presets import SimulationOptions
from semscape.simulate.specimens import Specimen
from semscape.types import HeightMap, SurfaceMesh

# A mesh leaves a margin around it; a height map fills the view beyond its borders.
_MESH_SHARE, _RELIEF_SHARE = 0.9, 1.1


def specimen_from_surface(
    name: str, surface: SurfaceMesh | HeightMap, *, texture_seed: int = 0
) -> Specimen | MeshSpecimen:
    """Put a surface under the beam: the middle of its bounding box in the middle of the image, at the eucentric plane.

    Parameters
    ----------
    name : str
        Its name in the truth.
    surface : SurfaceMesh or HeightMap
        In um, z towards the electron source.
    texture_seed : int
        Seed of the material texture.

    Raises
    ------
    BadInputError
        Where the surface has no unit of length, or no extent.

    Examples
    --------
    >>> corners = np.array([[0.0, 0, 7], [4, 0, 7], [0, 2, 9]])
    >>> triangle = SurfaceMesh(corners, np.array([[0, 1, 2]]), np.zeros((3, 3), dtype=np.uint8), "um")
    >>> specimen_from_surface("triangle", triangle).vertices_um.tolist()
    [[-2.0, -1.0, -1.0], [2.0, -1.0, -1.0], [-2.0, 1.0, 1.0]]
    """
    if surface.length_unit != "um":
        raise BadInputError(f"the surface {name} is in {surface.length_unit}; a specimen needs lengths in um")
    if isinstance(surface, HeightMap):
        height = surface.height_um
        middle = (np.nanmin(height) + np.nanmax(height)) / 2
        relief = np.ascontiguousarray(height - middle, dtype=np.float32)
        return Specimen(name, relief, surface.pixel_size_um, texture_seed)
    vertices = surface.vertices_um
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return MeshSpecimen(name, vertices - centre, surface.faces, texture_seed)


def fit_pixel_size(options: SimulationOptions, specimen: Specimen | MeshSpecimen) -> SimulationOptions:
    """Return the options with the pixel size at which a specimen fills the image.

    A mesh is seen whole, with a margin; of a height map a part is seen that fills the image at zero tilt.
    """
    frame_px = np.array([options.width_px, options.height_px - options.data_bar_rows])
    if isinstance(specimen, MeshSpecimen):
        extent = np.ptp(specimen.vertices_um[:, :2], axis=0)
        pixel = float((extent / frame_px).max()) / _MESH_SHARE
    else:
        extent = (np.array(specimen.height_um.shape[::-1]) - 1) * specimen.pitch_um
        pixel = float((extent / frame_px).min()) / _RELIEF_SHARE
    return replace(options, pixel_size_um=pixel)
