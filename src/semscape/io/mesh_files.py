"""Meshes as STL, OBJ with its texture, OFF and 3MF; PLY and GLB are in `surfaces`, for every run writes them.

Each file says its unit of length, in the way its format knows, else in a comment.
"""

from __future__ import annotations

import io
import zipfile
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from semscape.errors import BadInputError
from semscape.io.png import encode_png
from semscape.io.surfaces import NEEDS_PIXEL_SIZE, MeshUnit, describe_mesh, vertices_in
from semscape.types import FloatArray, LengthUnit, SurfaceMesh

if TYPE_CHECKING:
    import trimesh

_STL_HEADER_BYTES = 80
_3MF_UNITS: dict[MeshUnit, str] = {"um": "micron", "mm": "millimeter"}
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)
_3MF_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_3MF_RELATIONS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""


def encode_stl(mesh: SurfaceMesh, unit: MeshUnit | None = None, note: str = "") -> bytes:
    """Return a mesh as binary STL; its 80 bytes of header say the unit, and `note`, for the format knows none."""
    from trimesh.exchange.stl import export_stl

    surface, length_unit = _trimesh(mesh, unit)
    header = f"semscape surface UNITS={length_unit} {note}".rstrip().encode("ascii")
    content: bytes = export_stl(surface)
    return header[:_STL_HEADER_BYTES].ljust(_STL_HEADER_BYTES) + content[_STL_HEADER_BYTES:]


def encode_off(mesh: SurfaceMesh, unit: MeshUnit | None = None) -> bytes:
    """Return a mesh as OFF, the unit in a comment."""
    from trimesh.exchange.off import export_off

    surface, length_unit = _trimesh(mesh, unit)
    keyword, _, rest = export_off(surface).partition("\n")
    return f"{keyword}\n# {describe_mesh('surface', length_unit)}\n{rest}".encode("ascii")


def encode_obj(
    mesh: SurfaceMesh, uv: FloatArray, picture: NDArray[np.uint8], name: str, unit: MeshUnit | None = None
) -> dict[str, bytes]:
    """Return a mesh as OBJ with its material and picture: the files by name.

    Parameters
    ----------
    mesh : SurfaceMesh
        P vertices.
    uv : (P, 2) float array
        Place of each vertex in the picture: u right, v up, 0 to 1 between the outer edges.
    picture : (H, W, 3) uint8 array
        Colours.
    name : str
        Name of the files without suffix.
    unit : "um", "mm", "nm" or None
        Unit of length, stated in a comment; None keeps the mesh's own.
    """
    from PIL import Image
    from trimesh.exchange.obj import export_obj
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import SimpleMaterial

    surface, length_unit = _trimesh(mesh, unit)
    companion = "_".join(name.split())  # names inside an OBJ end at a space
    # White, for viewers multiply the picture by it.
    material = SimpleMaterial(image=Image.fromarray(picture), diffuse=(255, 255, 255, 255))  # type: ignore[no-untyped-call]
    surface.visual = TextureVisuals(uv=uv, material=material)  # type: ignore[no-untyped-call]
    text, files = export_obj(  # type: ignore[no-untyped-call]
        surface,
        include_normals=False,
        return_texture=True,
        mtl_name=f"{companion}.mtl",
        header=describe_mesh("surface", length_unit),
    )
    material_text = files.pop(f"{companion}.mtl").decode()
    (picture_name,) = files
    return {
        f"{companion}.png": encode_png(picture, f"colours of {name}.obj"),
        f"{companion}.mtl": material_text.replace(picture_name, f"{companion}.png").encode(),
        f"{name}.obj": text.encode(),
    }


def encode_3mf(mesh: SurfaceMesh, unit: MeshUnit | None = None) -> bytes:
    """Return a mesh as 3MF.

    Own writer: trimesh's says millimetre whatever the numbers mean, and numbers its objects at random.

    Raises
    ------
    BadInputError
        If the mesh is in px or is wanted in nm: a 3MF must state its unit, and knows no nanometre.

    References
    ----------
    3MF Consortium, "3D Manufacturing Format: Core Specification", version 1.3.
    """
    vertices, length_unit = vertices_in(mesh, unit)
    if length_unit == "px":
        raise BadInputError(f"3MF must state a unit of length, but the run has no pixel size; {NEEDS_PIXEL_SIZE}")
    if length_unit == "nm":
        raise BadInputError("3MF knows no nanometre; give --unit um or --unit mm")
    body = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<model unit="{_3MF_UNITS[length_unit]}" xml:lang="en-US" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">',
        '<metadata name="Application">semscape</metadata>',
        '<resources><object id="1" type="model"><mesh><vertices>',
        _rows('<vertex x="%.9g" y="%.9g" z="%.9g"/>', vertices),
        "</vertices><triangles>",
        _rows('<triangle v1="%d" v2="%d" v3="%d"/>', mesh.faces),
        "</triangles></mesh></object></resources>",
        '<build><item objectid="1"/></build>',
        "</model>",
        "",
    ]
    files = {"[Content_Types].xml": _3MF_TYPES, "_rels/.rels": _3MF_RELATIONS, "3D/3dmodel.model": "\n".join(body)}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, text in files.items():
            entry = zipfile.ZipInfo(name, _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            archive.writestr(entry, text)
    return buffer.getvalue()


def _rows(pattern: str, table: NDArray[np.floating] | NDArray[np.integer]) -> str:
    buffer = io.BytesIO()
    np.savetxt(buffer, table, fmt=pattern)
    return buffer.getvalue().decode("ascii")


def _trimesh(mesh: SurfaceMesh, unit: MeshUnit | None) -> tuple[trimesh.Trimesh, LengthUnit | MeshUnit]:
    import trimesh

    vertices, length_unit = vertices_in(mesh, unit)
    # process=False: trimesh would merge vertices, and the files would no longer hold the same mesh.
    return trimesh.Trimesh(vertices=vertices, faces=mesh.faces, process=False, validate=False), length_unit
