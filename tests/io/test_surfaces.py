from __future__ import annotations

import io
import json
import struct

import numpy as np
import pytest
import tifffile
import trimesh

from semscape.errors import BadInputError
from semscape.io.surfaces import (
    encode_height_map_npz,
    encode_height_map_tif,
    encode_mesh_glb,
    encode_mesh_ply,
    encode_points_ply,
    read_height_map,
)
from synthetic_result import make_result

RESULT = make_result()
PX = make_result("px")


@pytest.mark.parametrize("kind", ["ply", "glb"])
def test_meshes_hold_the_same_um_z_up_vertices_and_colours(kind: str) -> None:
    encode = {"ply": encode_mesh_ply, "glb": encode_mesh_glb}[kind]
    scene = trimesh.load_scene(io.BytesIO(encode(RESULT.mesh)), file_type=kind, process=False)
    (mesh,) = scene.geometry.values()
    np.testing.assert_allclose(mesh.vertices, RESULT.mesh.vertices_um, rtol=1e-6)
    np.testing.assert_array_equal(mesh.faces, RESULT.mesh.faces)
    # trimesh files the colours of a mesh that has a material under its attributes.
    colours = mesh.visual.vertex_colors if kind == "ply" else mesh.visual.vertex_attributes["color"]
    np.testing.assert_array_equal(colours[:, :3], RESULT.mesh.color)


def glb_tree(content: bytes) -> dict[str, object]:
    (length,) = struct.unpack("<I", content[12:16])
    return json.loads(content[20 : 20 + length])


@pytest.mark.parametrize(("result", "unit"), [(RESULT, "um"), (PX, "px")])
def test_glb_states_its_unit_and_up_axis(result, unit) -> None:
    tree = glb_tree(encode_mesh_glb(result.mesh))
    assert tree["asset"]["extras"]["length_unit"] == unit
    assert tree["asset"]["extras"]["up_axis"] == "z"
    assert tree["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0


def test_points_ply_round_trips_and_states_the_unit() -> None:
    reconstruction = RESULT.reconstruction
    content = encode_points_ply(reconstruction.points_um, reconstruction.points_sigma_um, "um")
    assert b"unit of length: micrometre (um)" in content
    cloud = trimesh.load(io.BytesIO(content), file_type="ply")
    np.testing.assert_array_equal(cloud.vertices, reconstruction.points_um)
    three = np.repeat(reconstruction.points_sigma_um[:, None], 3, axis=1)
    assert b"property float sigma_z" in encode_points_ply(reconstruction.points_um, three, "um")


def test_glb_carries_the_micrograph_and_each_vertex_its_place_in_it() -> None:
    from dataclasses import replace

    import trimesh

    picture = np.random.default_rng(0).integers(0, 255, (24, 31), dtype=np.uint8)
    uv = np.random.default_rng(1).uniform(0, 1, (len(RESULT.mesh.vertices_um), 2))
    mesh = replace(RESULT.mesh, uv=uv, picture=picture)
    content = encode_mesh_glb(mesh)
    assert content == encode_mesh_glb(mesh)
    tree = glb_tree(content)
    assert tree["asset"]["extras"]["length_unit"] == "um"
    assert tree["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0
    back = trimesh.load(io.BytesIO(content), file_type="glb", force="mesh", process=False)
    np.testing.assert_allclose(back.visual.uv, uv, atol=1e-6)
    np.testing.assert_array_equal(np.asarray(back.visual.material.baseColorTexture.convert("L")), picture)


def test_an_older_map_tells_no_reasons(tmp_path) -> None:
    from dataclasses import fields

    from semscape.types import HeightMap, Reason

    old = {item.name: getattr(RESULT.height_map, item.name) for item in fields(HeightMap)}
    del old["reason"], old["specimen"], old["lateral_period_um"]
    height_map = HeightMap(**old)
    known = np.isfinite(height_map.height_um)
    assert (height_map.reason == np.where(known, Reason.KNOWN, Reason.NOT_TOLD)).all()
    assert height_map.specimen.all()
    assert np.isnan(height_map.lateral_period_um).all()


def test_ply_of_a_px_series_says_px() -> None:
    for content in (encode_mesh_ply(PX.mesh), encode_points_ply(PX.reconstruction.points_um, np.zeros(300), "px")):
        header = content[: content.index(b"end_header")].decode()
        assert "pixel (px)" in header
        assert "um" not in header.replace("number", "")


@pytest.mark.parametrize(("result", "unit"), [(RESULT, "um"), (PX, "px")])
def test_height_map_npz_round_trips_with_the_unit_in_its_keys(result, unit, tmp_path) -> None:
    path = tmp_path / "height_map.npz"
    path.write_bytes(encode_height_map_npz(result.height_map))
    with np.load(path) as archive:
        assert {f"height_{unit}", f"uncertainty_{unit}", f"pixel_size_{unit}", "world_from_grid"} <= set(archive.files)
        other = "px" if unit == "um" else "um"
        assert not [name for name in archive.files if name.endswith(f"_{other}")]
    back = read_height_map(path)
    np.testing.assert_allclose(back.height_um, result.height_map.height_um, rtol=1e-6)
    np.testing.assert_allclose(back.uncertainty_um, result.height_map.uncertainty_um, rtol=1e-6)
    np.testing.assert_array_equal(back.texture, result.height_map.texture)
    np.testing.assert_array_equal(back.n_views, result.height_map.n_views)
    np.testing.assert_array_equal(back.reason, result.height_map.reason)
    np.testing.assert_array_equal(back.specimen, result.height_map.specimen)
    np.testing.assert_array_equal(back.lateral_period_um, result.height_map.lateral_period_um)
    assert back.lateral_period_um.dtype == np.float32
    with np.load(path) as arrays:
        assert f"lateral_period_{unit}" in arrays.files
    np.testing.assert_array_equal(back.world_from_grid, result.height_map.world_from_grid)
    assert (back.pixel_size_um, back.length_unit) == (result.height_map.pixel_size_um, unit)


def test_reading_what_is_no_height_map_is_refused_by_name(tmp_path) -> None:
    text, other = tmp_path / "text.npz", tmp_path / "other.npz"
    text.write_text("hello")
    np.savez(other, a=np.zeros(2))
    for path in (text, other, tmp_path / "missing.npz"):
        with pytest.raises(BadInputError, match=path.name):
            read_height_map(path)


@pytest.mark.parametrize(("result", "words"), [(RESULT, "micrometre (um)"), (PX, "pixel (px)")])
def test_height_map_tif_is_plain_float32_with_nan_and_its_unit(result, words) -> None:
    with tifffile.TiffFile(io.BytesIO(encode_height_map_tif(result.height_map))) as tif:
        page = tif.pages[0]
        heights, description = page.asarray(), page.description
        assert not tif.is_imagej
        assert "DateTime" not in page.tags
        has_resolution = page.tags["ResolutionUnit"].value == 3
    assert heights.dtype == np.float32
    np.testing.assert_allclose(heights, result.height_map.height_um, rtol=1e-6)
    assert np.isnan(heights).any()
    assert words in description
    assert has_resolution == (words != "pixel (px)")


def test_a_mesh_without_faces_is_refused() -> None:
    from dataclasses import replace

    with pytest.raises(ValueError, match="without faces"):
        encode_mesh_glb(replace(RESULT.mesh, faces=np.zeros((0, 3), dtype=np.int64)))
