import numpy as np
import pytest

from semscape.dense.multilevel import answer, gathered, inverse_diagonals, spread_onto
from semscape.dense.posterior import DataTerm, Smoothness, most_probable, second_differences, smoothness_cut

SHAPES = [(20, 31), (15, 16), (7, 8)]


def onto(coarse: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    fine = np.zeros(shape, np.float32)
    spread_onto(coarse, fine)
    return fine


def nodes(shape: tuple[int, int]) -> tuple[int, int]:
    return gathered(np.zeros(shape, np.float32)).shape


@pytest.mark.parametrize("shape", SHAPES)
def test_a_plane_at_the_nodes_is_that_plane_at_the_pixels(shape: tuple[int, int]) -> None:
    node_row, node_col = (2 * (index - 1) for index in np.indices(nodes(shape)))
    row, col = np.indices(shape)
    found = onto((1 + 0.5 * node_row - 0.25 * node_col).astype(np.float32), shape)
    assert found == pytest.approx(1 + 0.5 * row - 0.25 * col, abs=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_gathering_is_the_transpose_of_spreading(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    fine = rng.standard_normal(shape).astype(np.float32)
    coarse = rng.standard_normal(nodes(shape)).astype(np.float32)
    assert np.vdot(onto(coarse, shape), fine) == pytest.approx(np.vdot(coarse, gathered(fine)), abs=1e-4)


def system(shape: tuple[int, int], k: float, tau: float) -> np.ndarray:
    """Return k + D' D / tau^2 as a matrix: a column per pixel, from the definition."""
    columns = []
    for pixel in np.eye(shape[0] * shape[1]):
        xx, yy, xy = second_differences(pixel.reshape(shape))
        columns.append(np.concatenate([xx.ravel(), yy.ravel(), np.sqrt(2) * xy.ravel()]) / tau)
    differences = np.stack(columns, axis=1)
    return k * np.eye(len(columns)) + differences.T @ differences


def test_diagonals_are_those_of_the_coarser_grids() -> None:
    shape, k, tau = (32, 32), 0.2, 0.5
    matrix = system(shape, k, tau)
    one = np.ones(shape, np.float32)
    xx, yy, xy = (w.astype(np.float32) / tau**2 for w in smoothness_cut(np.zeros(shape), 1.0))
    diagonal = np.diag(matrix).reshape(shape).astype(np.float32)
    inverse = inverse_diagonals(k * one, (xx, yy, xy), diagonal, 2)
    assert len(inverse) == 3
    unit = np.zeros(nodes(shape), np.float32)
    unit[9, 9] = 1.0
    function = onto(unit, shape).ravel().astype(np.float64)
    share = inverse[1][9, 9] * (function @ matrix @ function)
    unit = np.zeros(nodes(nodes(shape)), np.float32)
    unit[6, 6] = 1.0
    function = onto(onto(unit, nodes(shape)), shape).ravel().astype(np.float64)
    assert inverse[2][6, 6] * (function @ matrix @ function) == pytest.approx(share, rel=0.01)


def test_an_answer_is_symmetric_and_positive() -> None:
    shape = (24, 40)
    rng = np.random.default_rng(1)
    k = rng.uniform(0, 1, shape).astype(np.float32)
    weights = tuple(rng.uniform(0, 5, shape).astype(np.float32) for _ in range(3))
    inverse = inverse_diagonals(k, weights, k + np.float32(20), 5)
    one, other = (rng.standard_normal(shape).astype(np.float32) for _ in range(2))
    assert np.vdot(one, answer(other, inverse)) == pytest.approx(np.vdot(other, answer(one, inverse)), rel=1e-4)
    assert np.vdot(one, answer(one, inverse)) > 0


def test_coarser_grids_find_in_few_steps_what_is_smooth() -> None:
    """Weak data pull a flat surface to a wave: a dense solver's answer, which pixels alone do not reach."""
    shape, k, tau = (40, 40), 1e-3, 0.05
    row, col = np.indices(shape)
    wave = 3 * np.sin(2 * np.pi * col / 40) + 0.1 * row
    true = np.linalg.solve(system(shape, k, tau), k * wave.ravel()).reshape(shape)
    stiffness = np.full(shape, k)
    flat = np.zeros(shape)
    cut = smoothness_cut(flat, 1.0)
    prior = Smoothness(np.full(shape, tau**2), np.ones(shape))
    data = DataTerm(stiffness, stiffness * wave)
    by_pixels = most_probable(flat, data, cut, prior, levels=0)
    assert np.std(most_probable(flat, data, cut, prior) - true) < 0.06 * np.std(true)
    assert np.std(by_pixels - true) > 0.9 * np.std(true)


def test_what_nothing_holds_stays() -> None:
    shape = (30, 30)
    nothing = np.zeros(shape)
    height = np.full(shape, 2.0)
    cut = tuple(nothing for _ in range(3))
    found = most_probable(height, DataTerm(nothing, nothing), cut, Smoothness(np.ones(shape), np.ones(shape)))
    assert np.array_equal(found, height)
