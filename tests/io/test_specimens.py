"""Surfaces of other programs: five kinds of mesh, two of height map, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh

from semscape.errors import BadInputError
from semscape.io.specimens import read_surface
from semscape.types import HeightMap, SurfaceMesh


@pytest.mark.parametrize("kind", ["ply", "obj", "stl", "off", "glb"])
def test_meshes_of_every_kind(tmp_path: Path, kind: str) -> None:
    box = trimesh.creation.box(extents=(4, 2, 1))
    box.invert()  # inside out, as some programs write them
    box.export(tmp_path / f"box.{kind}")
    mesh = read_surface(tmp_path / f"box.{kind}")
    assert isinstance(mesh, SurfaceMesh)
    assert (len(mesh.vertices_um), len(mesh.faces)) == (8, 12)
    corners = mesh.vertices_um[mesh.faces]
    volume = np.einsum("nk,nk->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(8)  # positive: the faces look outwards
    assert mesh.length_unit == "um"


def test_npz_with_either_set_of_names(tmp_path: Path) -> None:
    height = np.arange(12.0).reshape(3, 4)
    np.savez(tmp_path / "own.npz", height_um=height, pixel_size_um=0.5)
    surface = read_surface(tmp_path / "own.npz")
    assert isinstance(surface, HeightMap)
    np.testing.assert_array_equal(surface.height_um, height)
    assert surface.pixel_size_um == 0.5
    np.testing.assert_allclose(surface.world_from_grid @ [0, 0, 2.0, 1], [-0.75, 0.5, 2, 1])
    valid = np.ones((3, 4), dtype=bool)
    valid[1, 2] = False
    np.savez(tmp_path / "other.npz", z_um=height.astype(np.float32), dx_um=0.25, dy_um=0.5, valid=valid)
    surface = read_surface(tmp_path / "other.npz")
    assert isinstance(surface, HeightMap)
    assert surface.pixel_size_um == 0.25
    assert surface.height_um.shape == (5, 4)  # as dense along y as along x
    np.testing.assert_allclose(surface.height_um[:, 0], [0, 2, 4, 6, 8])
    assert np.isnan(surface.height_um[1:4, 2]).all()
    assert np.isfinite(surface.height_um).sum() == 17


def test_tiff_says_its_spacing_by_its_resolution(tmp_path: Path) -> None:
    height = np.random.default_rng(0).random((5, 6)).astype(np.float32)
    tifffile.imwrite(tmp_path / "map.tif", height, resolution=(5e3, 5e3), resolutionunit="CENTIMETER")
    surface = read_surface(tmp_path / "map.tif")
    assert isinstance(surface, HeightMap)
    assert surface.pixel_size_um == pytest.approx(2.0)
    np.testing.assert_array_equal(surface.height_um, height)


def test_what_is_no_surface_is_refused_by_name(tmp_path: Path) -> None:
    def refuses(name: str, message: str) -> None:
        with pytest.raises(BadInputError, match=rf"{name}.*{message}"):
            read_surface(tmp_path / name)

    refuses("scan.docx", "is a mesh or a height map")
    refuses("none.ply", "there is no such file")
    (tmp_path / "bad.ply").write_bytes(b"ply nonsense")
    refuses("bad.ply", "cannot be read as a mesh")
    trimesh.Trimesh(vertices=[[0, 0, 0], [1, 0, 0], [2, 0, 0]], faces=[[0, 1, 2]]).export(tmp_path / "line.ply")
    refuses("line.ply", "holds no surface")
    np.savez(tmp_path / "depth.npz", depth=np.ones((3, 3)))
    refuses("depth.npz", "holds depth; a height map needs height_um")
    np.savez(tmp_path / "pitch.npz", height_um=np.ones((3, 3)), pixel_size_um=-1.0)
    refuses("pitch.npz", "must be positive")
    np.savez(tmp_path / "empty.npz", height_um=np.full((3, 3), np.nan), pixel_size_um=1.0)
    refuses("empty.npz", "none of the 9 heights is a number")
    np.savez(tmp_path / "row.npz", height_um=np.ones((1, 3)), pixel_size_um=1.0)
    refuses("row.npz", "needs rows and columns of heights")
    (tmp_path / "zip.npz").write_bytes(b"PK")
    refuses("zip.npz", "cannot be read as a height map")
    tifffile.imwrite(tmp_path / "grey.tif", np.ones((4, 4), dtype=np.uint8))
    refuses("grey.tif", "holds uint8; heights in um are floating-point")
    tifffile.imwrite(tmp_path / "bare.tif", np.ones((4, 4), dtype=np.float32), resolutionunit="NONE")
    refuses("bare.tif", "does not say how far its pixels lie apart")
    (tmp_path / "torn.tif").write_bytes(b"II*\0")
    refuses("torn.tif", "cannot be read as a TIFF")
