from __future__ import annotations

import numpy as np
import pytest

from semscape.report import hillshade


def test_a_slope_that_faces_the_light_is_brighter_than_one_that_turns_away() -> None:
    # Light from the left (270): a ramp that rises to the right faces it.
    ramp = np.tile(np.arange(5.0), (5, 1))
    towards = hillshade(ramp, 1.0, azimuth_deg=270.0)
    away = hillshade(-ramp, 1.0, azimuth_deg=270.0)
    np.testing.assert_allclose(towards, 1.0)
    np.testing.assert_allclose(away, 0.0, atol=1e-12)


def test_the_first_row_is_north() -> None:
    # Rows count downwards, so heights that grow with the row rise to the south and face the north.
    ramp = np.tile(np.arange(5.0)[:, None], (1, 5))
    np.testing.assert_allclose(hillshade(ramp, 1.0, azimuth_deg=0.0), 1.0)


def test_only_unknown_pixels_are_unknown() -> None:
    height = np.zeros((5, 5))
    height[2, 2] = np.nan
    height[0, :2] = np.nan
    height[1, :] = np.nan  # (0, 2) keeps its neighbour, row 2 loses the one above
    shade = hillshade(height, 0.5)
    np.testing.assert_array_equal(np.isnan(shade), np.isnan(height))
    np.testing.assert_allclose(shade[np.isfinite(shade)], np.sqrt(0.5))


def test_one_pixel_has_no_slope() -> None:
    np.testing.assert_allclose(hillshade(np.full((1, 1), 3.0), 1.0), np.sqrt(0.5))


@pytest.mark.parametrize("pixel_size", [0.0, -1.0, np.nan])
def test_a_pixel_size_must_be_positive(pixel_size) -> None:
    with pytest.raises(ValueError, match="positive"):
        hillshade(np.zeros((3, 3)), pixel_size)
