"""The stated sigma is the scatter of repeated measurements, the stated resolution the one that was put in."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from semscape.metrology.areal import height_parameters
from semscape.metrology.grid import Region
from semscape.metrology.level import level
from semscape.metrology.resolution import PERIOD_PER_SIGMA, lateral_resolution, window_in_spectrum
from semscape.metrology.step import step_between_regions
from semscape.metrology.uncertainty import correlated_noise, monte_carlo
from semscape.metrology.volume import volumes

REGIONS = Region(4, 4, 30, 76), Region(50, 4, 76, 76)


def figures(z: np.ndarray) -> dict[str, float]:
    flat = level(z, 1.0).height
    masks = [region.mask(z.shape) for region in REGIONS]
    parameters = height_parameters(flat)
    contents = volumes(flat, 1.0)
    return {
        "Sa": parameters["Sa"],
        "Sq": parameters["Sq"],
        "step": step_between_regions(z, 1.0, *masks).height,
        "volume": contents.above,
    }


def rough(n: int, falling: float, rng: np.random.Generator) -> np.ndarray:
    frequency = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None])
    frequency[0, 0] = 1
    z = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(n, n))) * frequency ** (-falling / 2), (n, n))
    return z / z.std()


def test_sigma_is_the_error_of_repeated_measurements_and_the_bias_that_of_noise() -> None:
    """100 maps of one surface, each with its own noise and height scale: one of them states the rms error of all."""
    rng = np.random.default_rng(0)
    cols = np.indices((80, 80))[1]
    surface = np.where(cols > 40, 2.0, 0.0) + 0.5 * ndimage.gaussian_filter(rng.normal(size=(80, 80)), 3) * 10
    sigma = np.where(cols > 60, 0.8, 0.4)
    truth = figures(surface)

    def taken() -> np.ndarray:
        noisy = surface + sigma * correlated_noise(surface.shape, 3.0, rng=rng)
        return noisy * (1 + 0.02 * rng.standard_normal())

    runs = [figures(taken()) for _ in range(100)]
    error = {name: np.sqrt(np.mean([(run[name] - truth[name]) ** 2 for run in runs])) for name in truth}
    bias = {name: np.mean([run[name] for run in runs]) - truth[name] for name in truth}
    stated = monte_carlo(
        taken(), sigma, figures, correlation_sigma_px=3.0, scale_relative_sigma=0.02, draws=100, rng=rng
    )
    for name in truth:
        assert 0.7 < stated[name].sigma / error[name] < 1.4, name
    for name in ("Sa", "Sq"):
        assert bias[name] > 0.02
        assert stated[name].noise_bias == pytest.approx(bias[name], rel=0.4)


def test_the_height_scale_alone_gives_its_share() -> None:
    z = rough(64, 3, np.random.default_rng(1))
    found = monte_carlo(
        z, np.zeros(z.shape), figures, correlation_sigma_px=3.0, scale_relative_sigma=0.03, draws=400,
        rng=np.random.default_rng(2),
    )  # fmt: skip
    for name in ("Sa", "Sq", "step", "volume"):
        assert found[name].sigma == pytest.approx(0.03 * abs(found[name].value), rel=0.12), name


def test_correlation_makes_a_mean_less_certain() -> None:
    flat, sigma = np.zeros((60, 60)), np.ones((60, 60))

    def mean(correlation: float) -> float:
        return monte_carlo(
            flat, sigma, lambda z: {"mean": float(z.mean())}, correlation_sigma_px=correlation,
            scale_relative_sigma=0.0, draws=300, rng=np.random.default_rng(0),
        )["mean"].sigma  # fmt: skip

    assert mean(0.0) == pytest.approx(1 / 60, rel=0.15)
    assert mean(3.0) == pytest.approx(np.sqrt(4 * np.pi * 9) / 60, rel=0.15)  # area of the correlation


def test_noise_has_unit_variance_and_the_stated_correlation() -> None:
    noise = correlated_noise((600, 600), 4.0, rng=np.random.default_rng(0))
    assert noise.std() == pytest.approx(1, rel=0.05)
    assert (noise[:, 5:] * noise[:, :-5]).mean() == pytest.approx(np.exp(-25 / 64), abs=0.05)
    assert noise[0].std() == pytest.approx(noise[300].std(), rel=0.3)


def test_wide_noise_is_the_same_noise_and_takes_no_more_memory() -> None:
    noise = correlated_noise((3000, 3000), 40.0, rng=np.random.default_rng(0))
    assert noise.std() == pytest.approx(1, rel=0.1)
    assert (noise[:, 50:] * noise[:, :-50]).mean() == pytest.approx(np.exp(-(50**2) / (4 * 40**2)), abs=0.07)
    rng = np.random.default_rng(0)
    far = np.array([correlated_noise((30, 40), 1e9, rng=rng) for _ in range(400)])
    assert np.ptp(far, axis=(1, 2)).max() < 1e-5  # one draw for all
    assert far[:, 0, 0].std() == pytest.approx(1, rel=0.15)


def test_what_is_unknown_leaves_the_sigma_unknown() -> None:
    z = rough(32, 2, np.random.default_rng(0))
    for uncertainty, scale in ((np.full(z.shape, np.nan), 0.01), (np.ones(z.shape), np.nan)):
        found = monte_carlo(
            z, uncertainty, lambda z: height_parameters(z), correlation_sigma_px=1.0, scale_relative_sigma=scale,
            draws=5, rng=np.random.default_rng(0),
        )  # fmt: skip
        assert np.isnan(found["Sa"].sigma)
        assert found["Sa"].value > 0


@pytest.mark.parametrize("sigma", [1.5, 3.0, 5.0])
@pytest.mark.parametrize("kind", ["white", "rough", "smooth", "step", "grating"])
def test_the_window_is_seen_in_the_spectrum(sigma: float, kind: str) -> None:
    """Noise, rough and smooth relief, a step, a grating, each with a tenth of noise, through a known window."""
    rng = np.random.default_rng(5)
    n = 400
    relief = {
        "white": np.zeros((n, n)),
        "rough": rough(n, 2.5, rng),
        "smooth": rough(n, 4, rng),
        "grating": np.sin(2 * np.pi * np.arange(n) / 20) * np.ones((n, 1)),
        "step": np.where(np.arange(n) > 180, 1.0, 0.0) * np.ones((n, 1)),
    }[kind]
    z = ndimage.gaussian_filter(relief + 0.1 * rng.normal(size=(n, n)), sigma)
    z[50:80, 200:230] = np.nan
    z[300:310, :60] = np.nan
    assert window_in_spectrum(z) == pytest.approx(sigma, rel=0.2 if kind == "grating" else 0.15)


def test_a_sine_of_the_stated_period_passes_with_half_its_height() -> None:
    rng = np.random.default_rng(6)
    n, sigma = 500, 3.0

    def matched(z: np.ndarray) -> np.ndarray:
        return ndimage.gaussian_filter(z, sigma)

    found = lateral_resolution(matched(rough(n, 3, rng) + 0.3 * rng.normal(size=(n, n))), 0.2)
    assert found.source == "spectrum"
    assert found.period == pytest.approx(0.2 * found.period_px)
    wave = np.tile(np.sin(2 * np.pi * np.arange(n) / found.period_px), (60, 1))
    assert matched(wave)[30, 100:400].max() == pytest.approx(0.5, abs=0.06)


def test_what_the_matching_states_goes_before_the_spectrum() -> None:
    white = np.random.default_rng(0).normal(size=(200, 200))
    assert lateral_resolution(white, 0.5).period == 1.0
    assert lateral_resolution(white, 0.5).source == "pixel"
    stated = np.full(white.shape, 8.0)
    stated[:50], stated[50:60] = 4.0, np.nan
    found = lateral_resolution(white, 0.5, stated)
    assert (found.period, found.period_px, found.source) == (8.0, 16.0, "matching")
    assert found.range_px == (8.0, 16.0)
    assert found.sigma_px == pytest.approx(16 / PERIOD_PER_SIGMA)
    assert lateral_resolution(white, 0.5, np.full(white.shape, np.nan)).source == "pixel"
    assert window_in_spectrum(np.full((50, 50), np.nan)) == 0
