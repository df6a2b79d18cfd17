"""Meshes as other programs read them, with the unit that was asked for and stated."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import lib3mf
import meshio
import numpy as np
import pytest
import trimesh
from PIL import Image
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOGeometry import vtkGLTFReader

from semscape.errors import BadInputError
from semscape.io.mesh_files import encode_3mf, encode_obj, encode_off, encode_stl
from semscape.io.surfaces import encode_mesh_glb, encode_mesh_ply
from semscape.types import LengthUnit, SurfaceMesh

FACTOR = {None: 1.0, "um": 1.0, "mm": 1e-3, "nm": 1e3}
ENCODERS = {
    "ply": encode_mesh_ply,
    "stl": encode_stl,
    "off": encode_off,
    "3mf": encode_3mf,
    "glb": encode_mesh_glb,
}


def make_mesh(unit: LengthUnit = "um") -> SurfaceMesh:
    rng = np.random.default_rng(3)
    row, col = (axis.ravel() for axis in np.mgrid[:4, :5])
    index = np.arange(20).reshape(4, 5)
    faces = np.stack([index[:-1, :-1], index[1:, :-1], index[:-1, 1:]], axis=-1).reshape(-1, 3)
    vertices = np.column_stack([col * 11.0 - 20, 18 - row * 12.0, rng.uniform(-5, 5, 20)])
    used, faces = np.unique(faces, return_inverse=True)
    color = rng.integers(0, 255, (len(used), 3)).astype(np.uint8)
    return SurfaceMesh(vertices[used], faces.reshape(-1, 3), color, unit)


MESH = make_mesh()


@pytest.mark.parametrize("unit", [None, "mm", "nm"])
@pytest.mark.parametrize("suffix", ["ply", "stl", "off", "obj"])
def test_meshio_reads_the_same_triangles(suffix: str, unit, tmp_path: Path) -> None:
    path = tmp_path / f"mesh.{suffix}"
    if suffix == "obj":
        uv = np.linspace(0, 1, 2 * len(MESH.vertices_um)).reshape(-1, 2)
        content = encode_obj(MESH, uv, np.zeros((4, 5, 3), np.uint8), "mesh", unit)["mesh.obj"]
    else:
        content = ENCODERS[suffix](MESH, unit)
    path.write_bytes(content)
    found = meshio.read(path)
    (cells,) = found.cells
    triangles = found.points[cells.data]
    expected = MESH.vertices_um[MESH.faces] * FACTOR[unit]
    # Within 1e-9 m = 1e-3 um.
    np.testing.assert_allclose(triangles, expected, rtol=0, atol=1e-3 * FACTOR[unit])
    assert {None: b"um", "mm": b"mm", "nm": b"nm"}[unit] in content[:200]
    if suffix == "ply":
        # meshio takes uchar for signed.
        np.testing.assert_array_equal(found.point_data["green"].view(np.uint8), MESH.color[:, 1])


def test_stl_is_not_taken_for_text() -> None:
    header = encode_stl(MESH, "mm", "print 100:1")[:80]
    assert header.rstrip() == b"semscape surface UNITS=mm print 100:1"


@pytest.mark.parametrize(("unit", "theirs"), [("um", lib3mf.ModelUnit.MicroMeter), ("mm", lib3mf.ModelUnit.MilliMeter)])
def test_lib3mf_accepts_the_3mf_strictly_and_reads_its_unit(unit, theirs) -> None:
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromBuffer(encode_3mf(MESH, unit))
    assert reader.GetWarningCount() == 0
    assert model.GetUnit() == theirs
    meshes = model.GetMeshObjects()
    meshes.MoveNext()
    mesh = meshes.GetCurrentMeshObject()
    vertices = np.array([list(vertex.Coordinates) for vertex in mesh.GetVertices()])
    np.testing.assert_allclose(vertices, MESH.vertices_um * FACTOR[unit], atol=1e-3 * FACTOR[unit])
    assert [list(face.Indices) for face in mesh.GetTriangleIndices()] == MESH.faces.tolist()


def test_trimesh_reads_the_unit_of_a_3mf() -> None:
    scene = trimesh.load_scene(io.BytesIO(encode_3mf(MESH, "mm")), file_type="3mf")
    assert scene.units == "millimeter"


def test_3mf_needs_a_unit_that_it_knows() -> None:
    with pytest.raises(BadInputError, match="no nanometre"):
        encode_3mf(MESH, "nm")
    with pytest.raises(BadInputError, match="no pixel size"):
        encode_3mf(make_mesh("px"))


def test_vtk_reads_the_glb(tmp_path: Path) -> None:
    path = tmp_path / "mesh.glb"
    path.write_bytes(encode_mesh_glb(MESH, "mm"))
    assert b'"length_unit":"mm"' in path.read_bytes()
    reader = vtkGLTFReader()
    reader.SetFileName(str(path))
    reader.Update()
    blocks = reader.GetOutput()
    while not hasattr(blocks, "GetPoints"):
        blocks = blocks.GetBlock(0)
    np.testing.assert_allclose(vtk_to_numpy(blocks.GetPoints().GetData()), MESH.vertices_um * 1e-3, atol=1e-6)
    assert blocks.GetNumberOfCells() == len(MESH.faces)


def test_obj_brings_its_material_and_picture(tmp_path: Path) -> None:
    picture = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    uv = np.random.default_rng(0).uniform(0, 1, (len(MESH.vertices_um), 2))
    files = encode_obj(MESH, uv, picture, "my quartz", "um")
    assert set(files) == {"my quartz.obj", "my_quartz.mtl", "my_quartz.png"}
    assert b"mtllib my_quartz.mtl\n" in files["my quartz.obj"]
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    mesh = trimesh.load_mesh(tmp_path / "my quartz.obj", process=False)
    np.testing.assert_allclose(mesh.visual.uv, uv, atol=1e-6)
    np.testing.assert_array_equal(np.asarray(mesh.visual.material.image.convert("RGB")), picture)
    with Image.open(tmp_path / "my_quartz.png") as image:
        np.testing.assert_array_equal(np.asarray(image), picture)


@pytest.mark.parametrize("suffix", ENCODERS)
def test_px_has_no_mm(suffix: str) -> None:
    with pytest.raises(BadInputError, match=r"cannot be written in mm.*--pixel-size-um"):
        ENCODERS[suffix](make_mesh("px"), "mm")


@pytest.mark.parametrize("suffix", ENCODERS)
def test_the_same_mesh_gives_the_same_bytes(suffix: str) -> None:
    assert ENCODERS[suffix](MESH) == ENCODERS[suffix](MESH)


def test_3mf_entries_carry_no_date() -> None:
    with zipfile.ZipFile(io.BytesIO(encode_3mf(MESH))) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
