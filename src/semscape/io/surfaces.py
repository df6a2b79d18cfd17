"""Surfaces in and out: sparse points, meshes and height maps, each file saying its unit of length.

Every writer returns the file's bytes, so that the run folder can put them in place in one step, and the
same values give the same bytes on every run: no dates, no names of machines.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from semscape.errors import BadInputError
from semscape.types import FloatArray, HeightMap, LengthUnit, SurfaceMesh

NEEDS_PIXEL_SIZE = "run semscape reconstruct again with --pixel-size-um or --scale-bar-um"
"""The way out of every refusal to state a length of a run that is in px."""

MeshUnit = Literal["um", "mm", "nm"]

_UNIT_NAMES: dict[LengthUnit | MeshUnit, str] = {
    "um": "micrometre (um)",
    "mm": "millimetre (mm)",
    "nm": "nanometre (nm)",
    "px": "pixel (px): the series has no pixel size",
}
_PER_UM: dict[MeshUnit, float] = {"um": 1.0, "mm": 1e-3, "nm": 1e3}
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


def encode_points_ply(points_um: FloatArray, sigma_um: FloatArray, unit: LengthUnit) -> bytes:
    """Return sparse points as a binary PLY.

    Parameters
    ----------
    points_um : (P, 3) float array
        Points in the world frame, z up, in `unit`.
    sigma_um : (P,) or (P, 3) float array
        1-sigma uncertainty of each point in `unit`, written as sigma or as sigma_x, sigma_y, sigma_z.
    unit : "um" or "px"
        Unit of length, stated in the header.

    Returns
    -------
    bytes
        The file: x, y, z in float64, sigmas in float32.
    """
    sigma = np.asarray(sigma_um, dtype=np.float64).reshape(len(points_um), -1)
    sigma_names = ["sigma"] if sigma.shape[1] == 1 else ["sigma_x", "sigma_y", "sigma_z"]
    layout = [(name, "<f8") for name in "xyz"] + [(name, "<f4") for name in sigma_names]
    vertices = np.empty(len(points_um), dtype=layout)
    for axis, name in enumerate("xyz"):
        vertices[name] = points_um[:, axis]
    for axis, name in enumerate(sigma_names):
        vertices[name] = sigma[:, axis]
    return _ply_header("sparse points", unit, vertices, 0) + vertices.tobytes()


def vertices_in(mesh: SurfaceMesh, unit: MeshUnit | None) -> tuple[FloatArray, LengthUnit | MeshUnit]:
    """Return a mesh's vertices (P, 3) in a unit, None for the mesh's own, and that unit.

    Raises
    ------
    BadInputError
        If the mesh is in px: nothing tells its size.

    Examples
    --------
    >>> corner = np.array([[2000.0, 0.0, 500.0]])
    >>> mesh = SurfaceMesh(corner, np.empty((0, 3), np.int64), np.zeros((1, 3), np.uint8), "um")
    >>> vertices_in(mesh, "mm")
    (array([[2. , 0. , 0.5]]), 'mm')
    """
    if unit is None:
        return mesh.vertices_um, mesh.length_unit
    if mesh.length_unit == "px":
        raise BadInputError(f"the run has no pixel size, so its mesh cannot be written in {unit}; {NEEDS_PIXEL_SIZE}")
    return mesh.vertices_um * _PER_UM[unit], unit


def encode_mesh_ply(mesh: SurfaceMesh, unit: MeshUnit | None = None) -> bytes:
    """Return a mesh as a binary PLY with a colour per vertex and its unit in the header; None keeps the mesh's own."""
    positions, length_unit = vertices_in(mesh, unit)
    vertices = np.empty(
        len(mesh.vertices_um), dtype=[(name, "<f4") for name in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")]
    )
    for axis, (name, channel) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        vertices[name] = positions[:, axis]
        vertices[channel] = mesh.color[:, axis]
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("indices", "<i4", (3,))])
    faces["count"] = 3
    faces["indices"] = mesh.faces
    return _ply_header("surface", length_unit, vertices, len(faces)) + vertices.tobytes() + faces.tobytes()


def encode_mesh_glb(mesh: SurfaceMesh, unit: MeshUnit | None = None) -> bytes:
    """Return a mesh as binary glTF.

    glTF means metres and y up; the numbers here are in `unit` (None: the mesh's own) with z up, as the run folder
    promises, and `asset.extras` says so. A viewer that knows nothing of it shows the surface from above.
    """
    import trimesh

    vertices, length_unit = vertices_in(mesh, unit)

    def describe(tree: dict[str, Any]) -> None:
        tree["asset"]["extras"] = {"length_unit": length_unit, "up_axis": "z", "made_by": "semscape"}
        if mesh.uv is not None:
            return
        # Without a material glTF means polished metal, which most viewers show as black.
        tree["materials"] = [
            {"name": "micrograph", "doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0.0}},
        ]
        for item in tree["meshes"]:
            for primitive in item["primitives"]:
                primitive["material"] = 0

    if not len(mesh.faces):
        raise ValueError("a mesh without faces cannot be written as glTF")
    # process=False: trimesh would merge vertices, and the files would no longer hold the same mesh.
    surface = trimesh.Trimesh(
        vertices=vertices, faces=mesh.faces, vertex_colors=mesh.color, process=False, validate=False
    )
    if mesh.uv is not None and mesh.picture is not None:
        surface.visual = _micrograph_visual(mesh.uv, mesh.picture)
    export: Any = trimesh.Scene([surface]).export  # trimesh does not type it
    return cast("bytes", export(file_type="glb", include_normals=True, tree_postprocessor=describe))


def _micrograph_visual(uv: FloatArray, picture: NDArray[np.uint8]) -> Any:
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    make_material: Any = PBRMaterial
    make_visual: Any = TextureVisuals  # trimesh types neither
    material = make_material(
        name="micrograph",
        baseColorTexture=Image.fromarray(picture),
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
    return make_visual(uv=uv, material=material)


def encode_height_map_npz(height_map: HeightMap) -> bytes:
    """Return a height map as a compressed NumPy archive.

    The keys carry the unit: height_um, uncertainty_um and pixel_size_um, or height_px, uncertainty_px and
    pixel_size_px for a series without a pixel size; further world_from_grid, n_views, reason, specimen, texture,
    lateral_period_um or _px, length_unit.
    Heights and uncertainties are float32: seven digits, far below any uncertainty, at half the size.
    """
    unit = height_map.length_unit
    arrays: dict[str, NDArray[Any]] = {
        f"height_{unit}": np.asarray(height_map.height_um, dtype=np.float32),
        f"uncertainty_{unit}": np.asarray(height_map.uncertainty_um, dtype=np.float32),
        f"pixel_size_{unit}": np.array(float(height_map.pixel_size_um)),
        "world_from_grid": np.asarray(height_map.world_from_grid),
        "n_views": np.asarray(height_map.n_views),
        "reason": np.asarray(height_map.reason),
        "specimen": np.asarray(height_map.specimen),
        "texture": np.asarray(height_map.texture),
        f"lateral_period_{unit}": np.asarray(height_map.lateral_period_um, dtype=np.float32),
        "length_unit": np.array(unit),
    }
    # np.savez also fixes the dates, but only by a default of the zip module; here it is said.
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # else the operating system's own number stands in the bytes
            entry.external_attr = 0o644 << 16
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array, order="C"), allow_pickle=False)
            archive.writestr(entry, content.getvalue())
    return buffer.getvalue()


def read_height_map(path: Path | str) -> HeightMap:
    """Read a height map that `encode_height_map_npz` wrote.

    Raises
    ------
    BadInputError
        If the file cannot be read or is no height map.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            unit: LengthUnit = "um" if "height_um" in archive.files else "px"
            later = {"reason": "reason", "specimen": "specimen", f"lateral_period_{unit}": "lateral_period_um"}
            height = archive[f"height_{unit}"].astype(np.float64)
            return HeightMap(
                height_um=height,
                uncertainty_um=archive[f"uncertainty_{unit}"].astype(np.float64),
                n_views=archive["n_views"] if "n_views" in archive.files else np.isfinite(height).astype(np.uint8),
                texture=archive["texture"] if "texture" in archive.files else np.full(height.shape, np.nan, np.float32),
                pixel_size_um=float(archive[f"pixel_size_{unit}"]),
                world_from_grid=archive["world_from_grid"],
                length_unit=unit,
                **{field: archive[name] for name, field in later.items() if name in archive.files},
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise BadInputError(f"{path} is not a height map of semscape (height_map.npz): {error}") from error


def describe_height_map(height_map: HeightMap) -> str:
    """Return the line that says what the numbers of a height map mean, in ASCII."""
    unit, pixel = height_map.length_unit, float(height_map.pixel_size_um)
    return (
        f"semscape height map; heights in {_UNIT_NAMES[unit]}; NaN = no data; "
        f"grid spacing {pixel:.9g} {unit}; first row = largest y"
    )


def encode_height_map_tif(height_map: HeightMap) -> bytes:
    """Return the heights as a plain one-page float32 TIFF, NaN where unknown; its description states the unit."""
    import tifffile

    unit, pixel = height_map.length_unit, float(height_map.pixel_size_um)
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        np.ascontiguousarray(height_map.height_um, dtype=np.float32),
        photometric="minisblack",
        compression="zlib",
        predictor=False,
        description=describe_height_map(height_map),
        metadata=None,
        software=False,
        datetime=False,
        # TIFF knows inch and centimetre only; without a pixel size there is no resolution to state.
        resolution=(1e4 / pixel, 1e4 / pixel) if unit == "um" else (1, 1),
        resolutionunit="CENTIMETER" if unit == "um" else "NONE",
    )
    return buffer.getvalue()


def describe_mesh(what: str, unit: LengthUnit | MeshUnit) -> str:
    """Return the line that says what the numbers of a mesh or of points mean, in ASCII."""
    return f"semscape {what}; unit of length: {_UNIT_NAMES[unit]}; x right, y up, z towards the electron source"


def _ply_header(what: str, unit: LengthUnit | MeshUnit, vertices: NDArray[Any], n_faces: int) -> bytes:
    """Return the header of a binary little-endian PLY for a structured array of vertices."""
    names = {"<f8": "double", "<f4": "float", "|u1": "uchar"}
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {describe_mesh(what, unit)}",
        f"element vertex {len(vertices)}",
    ]
    assert vertices.dtype.names is not None  # a structured array has names
    lines += [f"property {names[vertices.dtype[name].str]} {name}" for name in vertices.dtype.names]
    if n_faces:
        lines += [f"element face {n_faces}", "property list uchar int vertex_indices"]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")
