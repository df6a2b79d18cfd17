"""The true transmission against windows that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from semscape.evaluate.transmission import wave_transmission
from semscape.metrology.resolution import PERIOD_PER_SIGMA


def relief(n: int = 400, falling: float = 3.0, seed: int = 0) -> np.ndarray:
    frequency = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None])
    frequency[0, 0] = 1
    noise = np.random.default_rng(seed).normal(size=(n, n))
    z = np.fft.irfft2(np.fft.rfft2(noise) * frequency ** (-falling / 2), (n, n))
    return (2.0 if falling > 2 else 0.3) * z / z.std()  # not steep


@pytest.mark.parametrize("sigma", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("falling", [1.5, 3.0])
def test_half_of_a_wave_passes_a_gaussian_at_its_period(sigma: float, falling: float) -> None:
    true = relief(falling=falling)
    found = wave_transmission(ndimage.gaussian_filter(true, sigma), true)
    assert found.half_px == pytest.approx(PERIOD_PER_SIGMA * sigma, rel=0.08)


def test_holes_jumps_and_a_lean_do_not_count() -> None:
    true = relief()
    smooth = ndimage.gaussian_filter(true, 3.0)
    step = np.where(np.arange(400) < 200, 0.0, 10.0)
    smooth, true = smooth + step, true + step  # the map keeps the jump crisp
    smooth[100:110, 50:80] = true[300:305, 300:340] = np.nan
    plain = wave_transmission(ndimage.gaussian_filter(relief(), 3.0), relief())
    assert wave_transmission(smooth + 0.02 * np.arange(400), true).half_px == pytest.approx(plain.half_px, rel=0.12)


def test_noise_lowers_the_coherence_and_not_the_share() -> None:
    true = relief(falling=1.5)
    noisy = ndimage.gaussian_filter(true + np.random.default_rng(1).normal(0, 1.0, true.shape), 3.0)
    quiet = wave_transmission(ndimage.gaussian_filter(true, 3.0), true)
    found = wave_transmission(noisy, true)
    assert found.half_px == pytest.approx(quiet.half_px, rel=0.15)
    assert np.nanmax(found.coherence[found.period_px < 20]) < 0.8 < np.nanmin(quiet.coherence[quiet.period_px > 12])


def test_where_nothing_is_known_nothing_is_told() -> None:
    nothing = np.full((60, 60), np.nan)
    found = wave_transmission(nothing, nothing)
    assert np.isnan([found.half_px, found.coherent_px]).all()
    assert np.isnan(wave_transmission(np.zeros((20, 20)), np.zeros((20, 20))).half_px)
