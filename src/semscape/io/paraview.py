"""Height maps for ParaView: VTS, a structured grid in XML with heights, uncertainties, views and micrograph."""

from __future__ import annotations

import base64
import zlib
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from semscape.io.surfaces import describe_height_map
from semscape.types import HeightMap

# Of vtkDataSetAttributes: some filters look at hidden points, others at hidden cells.
_HIDDEN_POINT, _HIDDEN_CELL = 2, 32
_TYPES = {"<f4": "Float32", "|u1": "UInt8"}


def encode_vts(height_map: HeightMap) -> bytes:
    """Return a height map as VTS: points in the world frame and the map's unit, float32.

    The point data are height, uncertainty (named with their unit, NaN where unknown), n_views and texture. A point
    of unknown height is hidden, for VTK knows no gaps in a grid; it lies at the least height.
    Field data state the unit.

    References
    ----------
    Kitware, "VTK XML file formats", in the VTK documentation.
    """
    unit = height_map.length_unit
    # Rows towards larger y, so that the grid is right-handed and its normals point up.
    height = height_map.height_um[::-1]
    rows, columns = height.shape
    unknown = ~np.isfinite(height)
    least = height[~unknown].min() if not unknown.all() else 0.0
    row, col = np.indices(height.shape)
    grid = np.stack([col, rows - 1 - row, np.where(unknown, least, height), np.ones_like(height)], axis=-1)
    points = (grid @ height_map.world_from_grid.T)[..., :3]
    point_data = {
        f"height_{unit}": _float32(height),
        f"uncertainty_{unit}": _float32(height_map.uncertainty_um[::-1]),
        "n_views": height_map.n_views[::-1].astype("|u1"),
        "texture": _float32(height_map.texture[::-1]),
        "vtkGhostType": np.where(unknown, _HIDDEN_POINT, 0).astype("|u1"),
    }
    in_gap = unknown[:-1, :-1] | unknown[1:, :-1] | unknown[:-1, 1:] | unknown[1:, 1:]
    hidden_cells = np.where(in_gap, _HIDDEN_CELL, 0).astype("|u1")
    extent = f"0 {columns - 1} 0 {rows - 1} 0 0"
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- {describe_height_map(height_map)} -->",
        '<VTKFile type="StructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
        'compressor="vtkZLibDataCompressor">',
        f'<StructuredGrid WholeExtent="{extent}">',
        f"<FieldData>{_text_array('length_unit', unit)}{_text_array('made_by', 'semscape')}</FieldData>",
        f'<Piece Extent="{extent}">',
        f'<PointData Scalars="height_{unit}">',
        *(_data_array(name, values) for name, values in point_data.items()),
        "</PointData>",
        f"<CellData>{_data_array('vtkGhostType', hidden_cells)}</CellData>",
        f"<Points>{_data_array('Points', _float32(points), components=3)}</Points>",
        "</Piece>",
        "</StructuredGrid>",
        "</VTKFile>",
    ]
    return "\n".join([*lines, ""]).encode("ascii")


def _float32(values: NDArray[np.floating]) -> NDArray[np.float32]:
    return values.astype("<f4")


def _data_array(name: str, values: NDArray[np.generic], components: int = 1) -> str:
    """Return a DataArray element: one block, compressed, in base64 after the sizes that VTK wants before it."""
    content = values.tobytes()
    packed = zlib.compress(content)
    sizes = np.array([1, len(content), 0, len(packed)], dtype="<u8").tobytes()
    encoded = (base64.b64encode(sizes) + base64.b64encode(packed)).decode("ascii")
    kind = _TYPES[values.dtype.str]
    return (
        f'<DataArray type="{kind}" Name={quoteattr(name)} NumberOfComponents="{components}" format="binary">'
        f"{encoded}</DataArray>"
    )


def _text_array(name: str, text: str) -> str:
    codes = " ".join(str(ord(character)) for character in text)
    return f'<DataArray type="String" Name={quoteattr(name)} NumberOfTuples="1" format="ascii">{codes} 0</DataArray>'
