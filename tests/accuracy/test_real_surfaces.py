"""Dense heights of the measured series, with no option: complete on the specimen, the right way up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import semscape
from accuracy import specimen_mask

pytestmark = pytest.mark.real_data


@pytest.mark.parametrize("name", ["potamogeton1", "quartz", "dsa"])
def test_heights_cover_the_specimen(name: str, shared_data: Path) -> None:
    series = semscape.load_series(shared_data / "tilt_series" / name)
    result = semscape.reconstruct(series, rng=0)
    height = result.height_map.height_um
    specimen = specimen_mask(name, series.views[result.reconstruction.reference].image)
    assert 0.85 <= np.isfinite(height[specimen]).mean() < 0.999
    around = np.isfinite(height) & ~specimen
    assert np.nanmedian(height[specimen]) > np.median(height[around])
