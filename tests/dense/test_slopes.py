"""What is seen beside heights, as a linear term of their slopes: its adjoint, its band, its precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semscape.dense.posterior import DataTerm, LatticeTable, Smoothness, height_variance, most_probable, smoothness_cut
from semscape.dense.slopes import SlopeTerm, halved, response, slope_term

SHAPE = 97, 130


def some_term(shape: tuple[int, int] = SHAPE) -> SlopeTerm:
    rng = np.random.default_rng(0)
    planes = [rng.standard_normal(shape).astype(np.float32) for _ in range(4)]
    return slope_term(planes[0], np.ones(shape, np.float32), *planes[1:])[0]


def test_the_product_is_symmetric_and_not_negative() -> None:
    rng = np.random.default_rng(1)
    one, other = (rng.standard_normal(SHAPE).astype(np.float32) for _ in range(2))
    term = some_term()
    assert np.vdot(one, term.product(other)) == pytest.approx(np.vdot(other, term.product(one)), rel=1e-3)
    assert np.vdot(one, term.product(one)) > 0


def test_the_pull_is_that_of_what_is_left() -> None:
    """A change that explains all that is left is pulled for with just the force that it needs."""
    rng = np.random.default_rng(2)
    change = rng.standard_normal(SHAPE).astype(np.float32)
    term = some_term()
    down, along = np.gradient(change)
    for plane in (down, along):
        plane[[0, -1]] = plane[:, [0, -1]] = 0
    along[[0, -1]], down[:, [0, -1]] = np.gradient(change, axis=1)[[0, -1]], np.gradient(change, axis=0)[:, [0, -1]]
    along[:, [0, -1]], down[[0, -1]] = 0, 0
    explained = term.by_height * change + term.by_column * along + term.by_row * down
    left = replace(term, left=-term.band.of(halved(explained)))
    assert left.pull() == pytest.approx(term.product(change), abs=1e-4 * float(np.abs(term.product(change)).max()))
    assert not left.at_rest().pull().any()


def test_what_is_unseen_tells_nothing() -> None:
    seen = np.ones(SHAPE, np.float32)
    seen[:, :60] = 0
    rng = np.random.default_rng(3)
    field, slope = (rng.standard_normal(SHAPE).astype(np.float32) for _ in range(2))
    term, variance = slope_term(field, seen, np.zeros_like(field), slope, slope)
    assert not term.precision[:, :31].any()
    assert (term.precision[10:-10, 45:-10] > 0).all()
    assert np.isfinite(variance).all()
    doubled, _ = slope_term(field, seen, np.zeros_like(field), slope, slope, 2 * variance)
    assert doubled.precision[10:-10, 45:-10] == pytest.approx(term.precision[10:-10, 45:-10] / 2)


def test_slopes_alone_find_the_waves_of_the_band() -> None:
    """Of a surface whose slopes are told, a wave of the band is found; the table knows that they help."""
    rng = np.random.default_rng(4)
    shape = 128, 128
    column = np.arange(shape[1]) * np.ones((shape[0], 1))
    true = np.sin(2 * np.pi * column / 24)
    sigma = 0.02
    nothing, stiffness = np.zeros(shape), np.full(shape, 1e-4)
    ones, still = np.ones(shape, np.float32), np.zeros(shape, np.float32)
    prior = Smoothness(np.full(shape, 0.1**2), np.ones(shape))
    seen = np.gradient(true, axis=1) + sigma * rng.standard_normal(shape)
    made, _ = slope_term(-seen.astype(np.float32), ones, still, ones, still)
    term = replace(made, precision=np.full_like(made.precision, 1 / sigma**2))
    cut = smoothness_cut(nothing, 1.0)
    found = most_probable(nothing, DataTerm(stiffness, nothing), cut, prior, [term], steps=200)
    assert np.std((found - true)[16:-16, 16:-16]) < 0.1 * np.std(true)
    told = np.asarray(term.slope_precision(), np.float64)
    with_slopes, without = (
        height_variance(stiffness, ones > 0, prior, LatticeTable(), slopes)[64, 64] for slopes in (told, None)
    )
    assert with_slopes < without
    assert LatticeTable().half_passing(np.array([1e-3]), np.array([10.0])) < LatticeTable().half_passing(
        np.array([1e-3]), np.array([1e-6])
    )


def test_without_slopes_both_tables_agree() -> None:
    table = LatticeTable()
    x = np.exp(np.linspace(-8, 10, 19))
    none = np.full(x.shape, 1e-9)
    assert table.spread(x, none) == pytest.approx(table.spread(x), rel=0.02)
    assert table.determined(x, none) == pytest.approx(table.determined(x), rel=0.02)
    waves = np.exp(np.linspace(-11, 0, 12))
    assert table.half_passing(waves, waves * 1e-9) == pytest.approx(2 * np.pi * waves**-0.25, rel=0.05)


def test_the_response_is_that_of_the_term() -> None:
    """Waves of one direction get through halving, banding and back as the response says, but for the coarser pixels."""
    shape = 256, 256
    ones, still = np.ones(shape, np.float32), np.zeros(shape, np.float32)
    noise = np.random.default_rng(5).standard_normal(shape).astype(np.float32)
    made, _ = slope_term(noise, ones, still, ones, still)
    term = replace(made, precision=np.full_like(made.precision, 4))
    for period in (12.0, 24.0, 48.0):
        frequency = 2 * np.pi / period
        wave = np.sin(frequency * np.arange(shape[1])).astype(np.float32) * ones
        inner = np.s_[64:-64, 64 : 64 + 96]
        share = np.vdot(wave[inner], term.product(wave)[inner]) / np.vdot(wave[inner], wave[inner])
        # The response is of slopes of any direction: half of it is this one's.
        expected = 2 * response(np.array([1e-3, frequency]))[0, 1]
        assert share == pytest.approx(expected, rel=0.15)
