"""The whole acquisition: determinism, specimens, truth, misuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.errors import BadInputError
from semscape.simulate import PRESETS, SPECIMENS, SimulationOptions, Specimen, simulate

SMALL = replace(PRESETS["nominal"], tilts_deg=(6.0, -6.0, 0.0), width_px=80, height_px=64)


def test_same_seed_gives_the_same_bytes_whatever_the_workers() -> None:
    one, truth_one = simulate("fracture", SMALL, rng=7, workers=1)
    two, truth_two = simulate("fracture", SMALL, rng=7, workers=2)
    other, _ = simulate("fracture", SMALL, rng=8)
    for a, b, c in zip(one.views, two.views, other.views, strict=True):
        assert a.image.tobytes() == b.image.tobytes() != c.image.tobytes()
    assert truth_one.height_um.tobytes() == truth_two.height_um.tobytes()
    assert truth_one.visible.tobytes() == truth_two.visible.tobytes()


def test_a_view_does_not_depend_on_the_number_of_views() -> None:
    _, few = simulate("spheres", replace(SMALL, tilts_deg=(-6.0, 0.0)), rng=1)
    _, many = simulate("spheres", SMALL, rng=1)
    np.testing.assert_array_equal(few.motion.translation_px, many.motion.translation_px[:2])


def test_series_is_ordered_by_tilt_and_says_what_the_stage_says() -> None:
    series, truth = simulate("fracture", replace(SMALL, data_bar_rows=16), rng=2)
    assert series.names == ("view_00_-06.00deg.tif", "view_01_+00.00deg.tif", "view_02_+06.00deg.tif")
    np.testing.assert_allclose(np.rad2deg(series.tilt_rad), [-6, 0, 6])
    np.testing.assert_array_equal(series.tilt_rad, truth.stage_tilt_rad)
    error_deg = np.rad2deg(series.tilt_rad - truth.motion.tilt_rad)
    assert (np.abs(error_deg) > 0.001).all()
    assert (np.abs(error_deg) < 0.5).all()
    assert series.length_unit == "um"
    for view in series.views:
        assert view.image.dtype == np.float32
        assert (view.image == np.rint(view.image)).all()
        assert view.image.min() >= 0
        assert view.image.max() <= 255
        assert view.mask[:48].all()
        assert not view.mask[48:].any()
        assert view.metadata.source["tilt_rad"] == "file"
    assert not truth.visible[:, 60:].any()


@pytest.mark.parametrize("name", sorted(SPECIMENS))
def test_specimens_fill_every_view_and_show_texture(name: str) -> None:
    # Far tilt, large shifts: the piece must still reach beyond each border.
    options = replace(SMALL, tilts_deg=(-35.0, 0.0, 35.0), shift_px=8.0, dose=0.0, axis_deg=60.0)
    series, truth = simulate(name, options, rng=3)
    relief = np.ptp(truth.height_um)
    field = options.height_px * options.pixel_size_um
    assert np.abs(truth.height_um).max() < 0.3 * field
    assert np.isfinite(truth.height_um).all()
    assert relief > 0.01 * field
    np.testing.assert_allclose(np.linalg.norm(truth.normals, axis=2), 1, atol=1e-6)
    for view in series.views:
        assert (view.image == 0).mean() < 0.01  # nothing imaged would be black
        assert view.image.std() > 5
    assert truth.visible[1].mean() > 0.4


def test_fracture_has_strong_relief_and_no_featureless_place() -> None:
    options = replace(SMALL, width_px=192, height_px=192, tilts_deg=(0.0,), dose=0.0)
    for seed in range(2):
        series, truth = simulate("fracture", options, rng=seed)
        relief = np.ptp(truth.height_um) / (192 * options.pixel_size_um)
        assert 0.13 < relief < 0.30
        blocks = series.views[0].image.reshape(12, 16, 12, 16).std(axis=(1, 3))
        assert blocks.min() > 1.5


def test_truth_grid_is_the_image_at_zero_tilt() -> None:
    def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.4 * np.sin(1.5 * x) + 0.3 * np.cos(2.0 * y) + 0.1 * x

    at = (np.arange(241) - 120) * 0.05
    specimen = Specimen("waves", surface(at[None, :], -at[:, None]).astype(np.float32), 0.05, 0)
    _, truth = simulate(specimen, replace(PRESETS["ideal"], tilts_deg=(0.0,), width_px=80, height_px=64))
    corner = truth.world_from_grid @ [0, 0, 1.5, 1]
    np.testing.assert_allclose(corner, [-39.5 * 0.1, 31.5 * 0.1, 1.5, 1])
    assert truth.visible.all()
    # x = s X + t for x right, y = -s Y + t: the grid's own columns and rows.
    motion = truth.motion
    assert motion.scale_px_per_um[0] * corner[0] + motion.translation_px[0, 0] == pytest.approx(0)
    assert -motion.scale_px_per_um[0] * corner[1] + motion.translation_px[0, 1] == pytest.approx(0)
    x, y = (np.arange(80) - 39.5)[None, :] * 0.1, (31.5 - np.arange(64))[:, None] * 0.1
    np.testing.assert_allclose(truth.height_um, surface(x, y), atol=0.001)
    normals = np.stack(np.broadcast_arrays(-0.6 * np.cos(1.5 * x) - 0.1, 0.6 * np.sin(2.0 * y), 1.0), axis=-1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    np.testing.assert_allclose(truth.normals, normals, atol=0.005)


def test_misuse_is_refused() -> None:
    with pytest.raises(BadInputError, match="did you mean 'pollen'"):
        simulate("polen", SMALL)
    with pytest.raises(ValueError, match="rng"):
        simulate("spheres", SMALL, rng=-1)
    with pytest.raises(ValueError, match="tilts_deg"):
        SimulationOptions(tilts_deg=(0.0, 90.0))
    with pytest.raises(ValueError, match="blur_px"):
        SimulationOptions(blur_px=-1.0)
    with pytest.raises(ValueError, match="pixel_size_um"):
        SimulationOptions(pixel_size_um=float("nan"))
    with pytest.raises(ValueError, match="16 x 16"):
        SimulationOptions(width_px=8)
