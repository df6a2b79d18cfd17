"""Height maps as other programs read them: heights within 1e-9 m, NaN kept, units and the y direction right."""

from __future__ import annotations

import io
from datetime import UTC, datetime
from pathlib import Path

import gsffile
import numpy as np
import pandas
import pytest
import sdfio
import x3pio
from PIL import Image
from SurfaceTopography import open_topography
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter
from vtkmodules.vtkIOXML import vtkXMLStructuredGridReader

from semscape.errors import BadInputError
from semscape.io.digital_surf import encode_sur
from semscape.io.gwyddion import encode_gsf, encode_gwy
from semscape.io.height_text import encode_csv, encode_xyz
from semscape.io.iso25178_files import encode_sdf, encode_x3p
from semscape.io.paraview import encode_vts
from semscape.io.surfaces import encode_height_map_tif
from semscape.types import HeightMap, LengthUnit

ROWS, COLUMNS, PIXEL = 24, 37, 0.043
CREATED = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
METRIC = {
    "x3p": lambda made: encode_x3p(made, CREATED),
    "sdf": lambda made: encode_sdf(made, CREATED),
    "sur": lambda made: encode_sur(made, CREATED),
    "gwy": encode_gwy,
    "gsf": encode_gsf,
}
OTHERS = {"tif": encode_height_map_tif, "csv": encode_csv, "xyz": encode_xyz, "vts": encode_vts}


def make_map(unit: LengthUnit = "um", *, offset: float = 300.0) -> HeightMap:
    """A ramp that rises towards +y and less towards +x, on a high pedestal, unknown in the upper right corner."""
    row, col = np.mgrid[:ROWS, :COLUMNS]
    height = offset - 0.05 * row + 0.011 * col + 0.3 * np.sin(row * col / 40)
    height[:5, -7:] = np.nan
    world_from_grid = np.array(
        [
            [PIXEL, 0, 0, -PIXEL * (COLUMNS - 1) / 2],
            [0, -PIXEL, 0, PIXEL * (ROWS - 1) / 2],
            [0, 0, 1, 0],
            [0, 0, 0, 1.0],
        ]
    )
    views = np.full(height.shape, 3, np.uint8)
    texture = (row + 2 * col).astype(np.float32)
    return HeightMap(height, np.full_like(height, 0.01), views, texture, PIXEL, world_from_grid, unit)


TRUTH = make_map()


def assert_heights(found_um: np.ndarray) -> None:
    """`found_um` has its first row at the largest y."""
    np.testing.assert_array_equal(np.isnan(found_um), np.isnan(TRUTH.height_um))
    assert np.nanmax(np.abs(found_um - TRUTH.height_um)) < 1e-3  # 1e-9 m


@pytest.mark.parametrize("suffix", ["x3p", "sdf", "gwy", "sur"])
def test_surface_topography_reads_the_heights(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"map.{suffix}"
    path.write_bytes(METRIC[suffix](TRUTH))
    with open_topography(str(path)) as reader:
        topography = reader.topography().to_unit("m")
    np.testing.assert_allclose(topography.physical_sizes, [COLUMNS * PIXEL * 1e-6, ROWS * PIXEL * 1e-6], rtol=1e-6)
    heights = np.ma.filled(topography.heights(), np.nan).T * 1e6
    # SurfaceTopography hands over the rows as stored. ISO 25178-71 and -72 count them towards larger y, the
    # formats of Gwyddion and Digital Surf down the picture.
    assert_heights(heights[::-1] if suffix in {"x3p", "sdf"} else heights)


def test_x3p_is_the_old_revision_and_binary_with_y_up() -> None:
    x3p = x3pio.read(io.BytesIO(encode_x3p(TRUTH, CREATED)))
    assert x3p.revision is x3pio.Revision.ISO5436_2000
    assert x3p.storage is x3pio.DataStorage.BINARY
    assert x3p.metadata.date == CREATED
    points = x3p.layers[0].points()
    assert_heights(points[::-1, :, 2] * 1e6)
    assert points[-1, 0, 1] == pytest.approx((ROWS - 1) * PIXEL * 1e-6)


def test_sdf_is_iso_1_0_with_int32() -> None:
    sdf = sdfio.SdfFile.loads(encode_sdf(TRUTH, CREATED))
    assert (sdf.header.revision, sdf.header.data_type) == (sdfio.Revision.ISO_1_0, sdfio.DataType.INT32)
    assert sdf.header.format is sdfio.FileFormat.BINARY
    assert_heights(sdf.data[::-1] * 1e6)


def test_gsf(tmp_path: Path) -> None:
    path = tmp_path / "map.gsf"
    path.write_bytes(encode_gsf(TRUTH))
    heights, metadata = gsffile.read_gsf(path)
    assert_heights(heights.astype(np.float64) * 1e6)
    assert (metadata["XYUnits"], metadata["ZUnits"]) == ("m", "m")
    assert metadata["XReal"] == pytest.approx(COLUMNS * PIXEL * 1e-6)
    assert metadata["YReal"] == pytest.approx(ROWS * PIXEL * 1e-6)


def test_sur_is_uncompressed_with_units_in_latin_1() -> None:
    content = encode_sur(TRUTH, CREATED)
    assert content[:12] == b"DIGITAL SURF"
    assert content[180:276] == b"\xb5m".ljust(16) * 6
    assert len(content) == 512 + len(b"semscape height map") + 4 * ROWS * COLUMNS


@pytest.mark.parametrize("offset", [0.0, -400.0, 1e-7, 1e5])
def test_sur_counts_fit_whatever_the_level(offset: float, tmp_path: Path) -> None:
    made = make_map(offset=offset)
    (tmp_path / "map.sur").write_bytes(encode_sur(made, CREATED))
    with open_topography(str(tmp_path / "map.sur")) as reader:
        heights = np.ma.filled(reader.topography().to_unit("um").heights(), np.nan).T
    np.testing.assert_array_equal(np.isnan(heights), np.isnan(made.height_um))
    np.testing.assert_allclose(heights, made.height_um, rtol=0, atol=2e-9 * max(abs(offset), 1.0))


def test_tif_states_resolution_and_meaning() -> None:
    with Image.open(io.BytesIO(encode_height_map_tif(TRUTH))) as image:
        assert_heights(np.asarray(image, dtype=np.float64))
        assert float(image.tag_v2[282]) == pytest.approx(1e4 / PIXEL, rel=1e-6)
        assert image.tag_v2[296] == 3  # per centimetre
        assert "heights in micrometre (um)" in image.tag_v2[270]


def test_csv_and_xyz_by_pandas() -> None:
    table = pandas.read_csv(io.BytesIO(encode_csv(TRUTH)), comment="#", header=None)
    assert_heights(table.to_numpy())
    points = pandas.read_csv(io.BytesIO(encode_xyz(TRUTH)), comment="#", header=None, sep=" ").to_numpy()
    assert len(points) == np.isfinite(TRUTH.height_um).sum()
    assert points[0] == pytest.approx([-PIXEL * (COLUMNS - 1) / 2, PIXEL * (ROWS - 1) / 2, TRUTH.height_um[0, 0]])
    for content in (encode_csv(TRUTH), encode_xyz(TRUTH)):
        assert b"micrometre (um)" in content.splitlines()[0]


def test_vts_by_vtk(tmp_path: Path) -> None:
    path = tmp_path / "map.vts"
    path.write_bytes(encode_vts(TRUTH))
    reader = vtkXMLStructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    data = {
        name: vtk_to_numpy(grid.GetPointData().GetArray(name)).reshape(ROWS, COLUMNS)[::-1]
        for name in ("height_um", "uncertainty_um", "n_views", "texture")
    }
    assert_heights(data["height_um"].astype(np.float64))
    np.testing.assert_array_equal(data["texture"], TRUTH.texture)
    assert data["n_views"].dtype == np.uint8
    points = vtk_to_numpy(grid.GetPoints().GetData()).reshape(ROWS, COLUMNS, 3)[::-1]
    known = np.isfinite(TRUTH.height_um)
    np.testing.assert_allclose(points[known, 2], TRUTH.height_um[known], atol=1e-3)
    assert points[0, 0, 1] == pytest.approx(PIXEL * (ROWS - 1) / 2, rel=1e-6)
    assert points[0, -1, 0] == pytest.approx(PIXEL * (COLUMNS - 1) / 2, rel=1e-6)
    assert grid.GetFieldData().GetAbstractArray("length_unit").GetValue(0) == "um"
    # A cell at an unknown point is not shown.
    surface = vtkGeometryFilter()
    surface.SetInputData(grid)
    surface.Update()
    shown = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
    assert surface.GetOutput().GetNumberOfCells() == shown.sum()


@pytest.mark.parametrize("suffix", METRIC)
def test_what_needs_metres_refuses_px_and_nothing(suffix: str) -> None:
    with pytest.raises(BadInputError, match=r"has no pixel size.*--pixel-size-um"):
        METRIC[suffix](make_map("px"))
    empty = make_map(offset=np.nan)
    with pytest.raises(BadInputError, match="no height at all"):
        METRIC[suffix](empty)


@pytest.mark.parametrize("suffix", ["tif", "csv", "xyz", "vts"])
def test_the_others_say_px(suffix: str) -> None:
    content = OTHERS[suffix](make_map("px"))
    assert b"pixel (px): the series has no pixel size" in content
    assert b"micrometre" not in content


@pytest.mark.parametrize("suffix", METRIC | OTHERS)
def test_the_same_map_gives_the_same_bytes(suffix: str) -> None:
    encode = (METRIC | OTHERS)[suffix]
    assert encode(TRUTH) == encode(TRUTH)
