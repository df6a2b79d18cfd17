from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from semscape.dense.print_body import print_body
from semscape.errors import NoAnswerError
from semscape.io.mesh_files import encode_stl
from synthetic_result import make_result

MAP = make_result().height_map


def as_trimesh(content: bytes) -> trimesh.Trimesh:
    return trimesh.load_mesh(io.BytesIO(content), file_type="stl")


@pytest.mark.parametrize("max_vertices", [10_000, 500])
def test_the_body_is_closed_and_turned_outwards(max_vertices: int) -> None:
    assert np.isnan(MAP.height_um).any()
    body = print_body(MAP, base=0.4, max_vertices=max_vertices)
    solid = as_trimesh(encode_stl(body))
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.is_volume
    assert solid.volume > 0
    assert solid.body_count == 1
    assert solid.bounds[0, 2] == pytest.approx(np.nanmin(MAP.height_um[::1]) - 0.4, abs=0.1)


def test_a_flat_map_is_a_box() -> None:
    flat = np.full((5, 9), 7.0)
    flat_map = replace(MAP, height_um=flat, pixel_size_um=0.5, world_from_grid=np.diag([0.5, -0.5, 1.0, 1.0]))
    solid = as_trimesh(encode_stl(print_body(flat_map, base=2.0, max_vertices=1000)))
    assert solid.volume == pytest.approx(4.0 * 2.0 * 2.0, rel=1e-6)
    np.testing.assert_allclose(solid.extents, [4.0, 2.0, 2.0], rtol=1e-6)


def test_unknown_heights_are_at_the_plate() -> None:
    height = np.full((7, 7), 5.0)
    height[0, 0] = 1.0
    height[3, 3] = np.nan
    body = print_body(replace(MAP, height_um=height), base=1.0, max_vertices=100)
    assert body.vertices_um[3 * 7 + 3, 2] == 1.0


def test_nothing_to_print() -> None:
    with pytest.raises(NoAnswerError, match="no body can be printed"):
        print_body(replace(MAP, height_um=np.full((7, 7), np.nan)), base=1.0, max_vertices=100)
