"""Surfaces of the user's for the simulated microscope: meshes and height maps of other programs.

Coordinates are taken as they stand: in um, z towards the electron source; of a height map the first row has the
largest y.
"""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semscape.errors import BadInputError
from semscape.io.mesh_file import MESH_SUFFIXES, read_mesh
from semscape.types import FloatArray, HeightMap, SurfaceMesh

HEIGHT_MAP_SUFFIXES = (".npz", ".tif", ".tiff")

# Keys of the heights, and of the distance of the nodes along x and y, in the order in which they are looked for.
_HEIGHT_KEYS = ("height_um", "z_um")
_SPACING_KEYS = (("pixel_size_um", "pixel_size_um"), ("dx_um", "dy_um"), ("dx_um", "dx_um"))
_UM_PER_RESOLUTION_UNIT = {2: 25_400.0, 3: 10_000.0}  # inch, centimetre


def read_surface(path: Path | str) -> SurfaceMesh | HeightMap:
    """Read a mesh (PLY, OBJ, STL, OFF, GLB) or a height map (npz, float TIFF).

    An npz holds `height_um` or `z_um` (rows, cols) and `pixel_size_um`, or `dx_um` and `dy_um`; points that are NaN,
    or False in `valid`, are holes. A TIFF holds heights in um as floating-point numbers, and the distance of its
    pixels as its resolution. Where the distances along x and y differ, the coarser axis is interpolated linearly.

    Raises
    ------
    BadInputError
        If the file is missing, of another kind, damaged, or holds no surface.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES + HEIGHT_MAP_SUFFIXES:
        kinds = ", ".join(MESH_SUFFIXES + HEIGHT_MAP_SUFFIXES)
        raise BadInputError(f"{path}: a specimen of your own is a mesh or a height map, one of {kinds}")
    if not path.is_file():
        raise BadInputError(f"{path}: there is no such file")
    if suffix in MESH_SUFFIXES:
        return read_mesh(path)
    height, dx, dy = _read_npz(path) if suffix == ".npz" else _read_tiff(path)
    if height.ndim != 2 or min(height.shape) < 2:
        raise BadInputError(f"{path}: a height map needs rows and columns of heights, got the shape {height.shape}")
    if not np.isfinite(height).any():
        raise BadInputError(f"{path}: none of the {height.size} heights is a number")
    if not (0 < dx < math.inf and 0 < dy < math.inf):
        raise BadInputError(f"{path}: the distance of the nodes must be positive, got {dx:g} and {dy:g} um")
    height = np.where(np.isfinite(height), height, np.nan)
    pitch = min(dx, dy)
    height = _denser(_denser(height, dy / pitch).T, dx / pitch).T
    rows, cols = height.shape
    world_from_grid = np.diag([pitch, -pitch, 1.0, 1.0])
    world_from_grid[:2, 3] = -pitch * (cols - 1) / 2, pitch * (rows - 1) / 2
    return HeightMap(
        height_um=height,
        uncertainty_um=np.full(height.shape, np.nan),
        n_views=np.isfinite(height).astype(np.uint8),
        texture=np.full(height.shape, np.nan, dtype=np.float32),
        pixel_size_um=pitch,
        world_from_grid=world_from_grid,
        length_unit="um",
    )


def _read_npz(path: Path) -> tuple[FloatArray, float, float]:
    """Return heights in um with NaN for holes, and the distances of the nodes along x and y in um."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            keys = [key for key in _HEIGHT_KEYS if key in archive.files]
            spacings = [pair for pair in _SPACING_KEYS if set(pair) <= set(archive.files)]
            if not keys or not spacings:
                raise BadInputError(
                    f"{path} holds {', '.join(archive.files)}; a height map needs height_um (or z_um) and "
                    "pixel_size_um (or dx_um and dy_um)"
                )
            height = archive[keys[0]].astype(np.float64)
            if "valid" in archive.files:
                height = np.where(archive["valid"], height, np.nan)
            return height, float(archive[spacings[0][0]]), float(archive[spacings[0][1]])
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise BadInputError(f"{path} cannot be read as a height map: {error}") from error


def _read_tiff(path: Path) -> tuple[FloatArray, float, float]:
    """Return what `_read_npz` does, the distances from the file's resolution."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as tif:
            page: Any = tif.pages[0]
            height: NDArray[Any] = page.asarray()
            tags = {name: page.tags[name].value for name in ("XResolution", "YResolution") if name in page.tags}
            unit = int(page.tags["ResolutionUnit"].value) if "ResolutionUnit" in page.tags else 2
    except Exception as error:  # damaged files raise whatever their contents provoke
        raise BadInputError(f"{path} cannot be read as a TIFF: {type(error).__name__}: {error}") from error
    if not np.issubdtype(height.dtype, np.floating):
        raise BadInputError(f"{path} holds {height.dtype}; heights in um are floating-point numbers")
    if unit not in _UM_PER_RESOLUTION_UNIT or len(tags) < 2 or not all(map(all, tags.values())):
        raise BadInputError(
            f"{path} does not say how far its pixels lie apart (resolution in px per cm); save it as npz with "
            "height_um and pixel_size_um"
        )
    dx, dy = (_UM_PER_RESOLUTION_UNIT[unit] * part / whole for whole, part in tags.values())
    return height.astype(np.float64), dx, dy


def _denser(height: FloatArray, factor: float) -> FloatArray:
    """Interpolate linearly along the rows' axis 0 to nodes `factor` times as dense."""
    if math.isclose(factor, 1.0, rel_tol=1e-9):
        return height
    at = np.arange(0.0, len(height) - 1 + 1e-9, 1.0 / factor)
    below = np.minimum(at.astype(np.int64), len(height) - 2)
    share = (at - below)[:, None]
    low, high = height[below], height[below + 1]
    # A node of the file itself is no less known for a hole beside it.
    between: FloatArray = np.where(share == 0, low, np.where(share == 1, high, (1.0 - share) * low + share * high))
    return between
