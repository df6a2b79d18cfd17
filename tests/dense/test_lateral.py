"""The stated lateral period is the one that the most probable surface passes with half its height."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.dense.lateral import half_passing_period
from semscape.dense.posterior import (
    DataTerm,
    LatticeTable,
    Smoothness,
    averaging_width,
    most_probable,
    smoothness_cut,
)
from semscape.metrology.resolution import PERIOD_PER_SIGMA

SHAPE = (130, 130)
MIDDLE = (slice(40, -40), slice(40, -40))


class Surface:
    """The most probable surface where stiffness and prior are even, and what it states."""

    def __init__(self, stiffness: np.ndarray, variance: float) -> None:
        self.stiffness, self.prior = stiffness, Smoothness(np.full(SHAPE, variance), np.ones(SHAPE))
        self.cut = smoothness_cut(np.zeros(SHAPE), 1.0)
        width = averaging_width(stiffness, np.ones(SHAPE, bool), self.prior, LatticeTable())
        self.period_px = float(np.median(half_passing_period(width)[MIDDLE]))

    def of(self, data: np.ndarray) -> np.ndarray:
        found = np.zeros(SHAPE)
        for _ in range(5):
            found = most_probable(
                found, DataTerm(self.stiffness, self.stiffness * (data - found)), self.cut, self.prior
            )
        return found


def share_passed(surface: Surface) -> float:
    phase = 2 * np.pi * np.arange(SHAPE[1]) / surface.period_px
    waves = [np.tile(np.cos(phase - shift), (SHAPE[0], 1)) for shift in (0, np.pi / 2)]
    found = [surface.of(wave) for wave in waves]
    products = [(ours * wave)[MIDDLE].sum() for ours, wave in zip(found, waves, strict=True)]
    return sum(products) / sum((wave[MIDDLE] ** 2).sum() for wave in waves)


@pytest.mark.parametrize("x", [3e-3, 0.03, 0.1])
def test_half_of_a_wave_of_the_stated_period_is_left(x: float) -> None:
    surface = Surface(np.full(SHAPE, 0.02), x / 0.02)
    assert surface.period_px == pytest.approx(2 * np.pi * x**-0.25, rel=0.05)
    assert share_passed(surface) == pytest.approx(0.5, abs=0.05)


def test_texture_in_spots_speaks_for_its_surroundings() -> None:
    """A quarter of the pixels hold all that the data say."""
    spots = np.where(np.random.default_rng(0).random(SHAPE) < 0.25, 0.08, 1e-6)
    assert share_passed(Surface(spots, 0.5)) == pytest.approx(0.5, abs=0.08)


def test_noise_is_alike_over_a_window_of_that_period() -> None:
    """What the Monte Carlo draws: noise correlated as exp(-d² / (4 sigma²)), sigma = period / 5.34."""
    surface = Surface(np.full(SHAPE, 0.02), 0.5)
    noise = surface.of(np.random.default_rng(1).normal(0, 0.02**-0.5, SHAPE))[20:-20, 20:-20]
    sigma = surface.period_px / PERIOD_PER_SIGMA
    for lag in (2, 4, 6):
        alike = np.mean(noise[:, lag:] * noise[:, :-lag]) / np.mean(noise**2)
        assert alike == pytest.approx(np.exp(-(lag**2) / (4 * sigma**2)), abs=0.12), lag


def test_nothing_finer_than_two_pixels() -> None:
    assert half_passing_period(np.array([[0.01]])) == 2.0
    assert np.isnan(half_passing_period(np.array([[np.nan]])))
