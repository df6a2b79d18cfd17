from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.options import Options
from semscape.pipeline import pairs_to_match, reconstruct
from semscape.sfm.two_view import largest_connected_set
from semscape.simulate import SimulationOptions, simulate


def test_all_pairs_where_nothing_is_said() -> None:
    assert len(pairs_to_match(60, 0)) == 60 * 59 // 2


@pytest.mark.parametrize("n_views", [2, 3, 7, 60])
@pytest.mark.parametrize("reach", [1, 2, 4])
def test_neighbours_with_loops_connect_all_views(n_views: int, reach: int) -> None:
    pairs = pairs_to_match(n_views, reach)
    assert pairs == sorted(set(pairs))
    assert all(i1 < i2 < n_views for i1, i2 in pairs)
    assert largest_connected_set(pairs, n_views) == tuple(range(n_views))
    assert len(pairs) <= n_views * (reach + np.ceil(np.log2(n_views)))
    assert {(i, i + 1) for i in range(n_views - 1)} <= set(pairs)


def test_fewer_pairs_find_the_same_motion() -> None:
    tilts = tuple(np.linspace(-9, 9, 7))
    series, truth = simulate("fracture", SimulationOptions(tilts_deg=tilts, width_px=160, height_px=160), rng=2)
    quick = Options().with_settings(["sfm.de_generations=20", "dense.max_pairs=1"])
    found = reconstruct(series, replace(quick, features=replace(quick.features, pair_reach=1)), workers=1)
    assert len(found.geometries) <= 6 + 5 + 3
    np.testing.assert_allclose(found.reconstruction.motion.tilt_rad, truth.motion.tilt_rad, atol=np.deg2rad(0.35))
