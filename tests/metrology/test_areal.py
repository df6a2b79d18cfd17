"""Areal parameters against closed forms, and against independent codes on measured surfaces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from semscape.errors import NoAnswerError
from semscape.metrology.areal import (
    developed_area_ratio,
    developed_areas,
    height_parameters,
    root_mean_square_slope,
)
from semscape.metrology.level import level
from semscape.metrology.material_ratio import material_ratio_parameters
from semscape.metrology.spatial import autocorrelation, spatial_parameters

SURFACES = ("afm_rough_10um", "milled_profilometer", "gelsight_dime_coin", "grating_x3p")
SLOPE_SCHEME_BOUND = 0.005


def sine(n: int = 1000, waves: int = 10, spacing: float = 0.1) -> np.ndarray:
    # Offset by a fraction of a sample, so that no sample is special.
    return np.tile(np.sin(2 * np.pi * waves * (np.arange(n) + 0.37) / n), (40, 1))


def test_a_sine() -> None:
    found = height_parameters(3 * sine())
    assert found["Sa"] == pytest.approx(3 * 2 / np.pi, rel=1e-3)
    assert found["Sq"] == pytest.approx(3 / np.sqrt(2), rel=1e-6)
    assert found["Ssk"] == pytest.approx(0, abs=1e-6)
    assert found["Sku"] == pytest.approx(1.5, rel=1e-6)
    assert found["Sp"] == pytest.approx(3, rel=1e-3)
    assert found["Sz"] == pytest.approx(6, rel=1e-3)
    # rms slope of A sin(2 pi x / l): sqrt(2) pi A / l
    fine = 3 * sine(20000, 10)
    assert root_mean_square_slope(fine, 100 / 20000) == pytest.approx(np.sqrt(2) * np.pi * 3 / 10, rel=1e-4)


def test_crossed_sines() -> None:
    x = 2 * np.pi * (np.arange(600) + 0.2) / 60
    z = np.add.outer(np.sin(x), np.sin(x))
    found = height_parameters(z)
    assert found["Sq"] == pytest.approx(1.0, rel=1e-6)
    assert found["Sku"] == pytest.approx(2.25, rel=1e-6)  # of the sum of two independent sines
    assert found["Sa"] == pytest.approx(8 / np.pi**2, rel=1e-3)
    # Autocorrelation (cos a + cos b) / 2: fastest down along the diagonals, slowest along the axes. The pairs at a lag
    # do not cover whole waves: 1 % from ten of them.
    spatial = spatial_parameters(z, 1.0)
    assert spatial["Sal"] == pytest.approx(np.sqrt(2) * 60 * np.arccos(0.2) / (2 * np.pi), rel=0.015)
    assert spatial["Str"] == pytest.approx(np.sqrt(2) * np.arccos(0.2) / np.arccos(-0.6), rel=0.02)


def test_a_tilted_plane_is_nothing_once_it_is_levelled_and_has_its_slope_before() -> None:
    rows, cols = np.indices((50, 80))
    z = 0.3 * 0.5 * cols - 0.4 * 0.5 * rows
    for scheme in ("forward", "central", "seven-point"):
        assert root_mean_square_slope(z, 0.5, scheme) == pytest.approx(0.5)
    assert developed_area_ratio(z, 0.5) == pytest.approx(100 * (np.sqrt(1.25) - 1))
    assert height_parameters(level(z, 0.5).height)["Sz"] < 1e-12


def test_a_sphere_cap() -> None:
    """The area of a cap is 2 pi R h."""
    radius, opening = 500.0, 400.0
    rows, cols = np.indices((901, 901)) - 450.0
    squared = rows**2 + cols**2
    z = np.where(squared <= opening**2, np.sqrt(np.maximum(radius**2 - squared, 0.0)), np.nan)
    rise = radius - np.sqrt(radius**2 - opening**2)
    developed, projected = developed_areas(z, 1.0)
    assert projected == pytest.approx(np.pi * opening**2, rel=5e-3)
    assert developed / projected == pytest.approx(2 * radius * rise / opening**2, rel=3e-3)
    # Archimedes: the area above each height grows evenly on the sphere; over the plane the density is (R - d).
    depth = np.linspace(0, rise, 20001)
    density = radius - depth
    mean = np.trapezoid(depth * density, depth) / np.trapezoid(density, depth)
    sq = np.sqrt(np.trapezoid((depth - mean) ** 2 * density, depth) / np.trapezoid(density, depth))
    assert height_parameters(z)["Sq"] == pytest.approx(sq, rel=1e-3)


def test_two_levels() -> None:
    z = np.where(np.arange(200) < 60, 4.0, 0.0) * np.ones((50, 1))  # 30 % up, 4 high
    found = height_parameters(z)
    p = 0.3
    assert found["Sa"] == pytest.approx(4 * 2 * p * (1 - p))
    assert found["Sq"] == pytest.approx(4 * np.sqrt(p * (1 - p)))
    assert found["Ssk"] == pytest.approx((1 - 2 * p) / np.sqrt(p * (1 - p)))
    assert found["Sku"] == pytest.approx(1 / (p * (1 - p)) - 3)
    ratio = material_ratio_parameters(z)
    assert ratio["Sxp"] == pytest.approx(4.0)  # 2.5 % lies on the upper level, 50 % on the lower
    assert ratio["Vmp"] == pytest.approx(0.0)  # 10 % of the material lies at the very top
    assert ratio["Vmc"] == pytest.approx(4 * p)
    assert ratio["Vvc"] == pytest.approx(4 * (1 - p))


def test_gaussian_noise() -> None:
    z = np.random.default_rng(0).normal(0, 2.0, (800, 800))
    found = height_parameters(z)
    assert found["Sa"] == pytest.approx(2 * np.sqrt(2 / np.pi), rel=3e-3)
    assert found["Sq"] == pytest.approx(2, rel=3e-3)
    assert found["Ssk"] == pytest.approx(0, abs=0.02)
    assert found["Sku"] == pytest.approx(3, abs=0.05)
    # Quantiles and partial moments of the normal distribution.
    ratio = material_ratio_parameters(z)
    assert ratio["Sxp"] == pytest.approx(2 * 1.959964, rel=0.01)
    assert ratio["Vmp"] == pytest.approx(2 * (0.1754983 - 0.1 * 1.2815516), rel=0.02)  # phi(q) - p q
    # The flattest 40 % is the middle one, 30 to 70 %.
    share = np.linspace(0.3, 0.7, 4001)
    from scipy.stats import norm

    slope = np.polynomial.polynomial.polyfit(share, norm.isf(share), 1)[1]
    assert ratio["Sk"] == pytest.approx(-2 * slope, rel=0.01)
    assert ratio["Smr1"] + ratio["Smr2"] == pytest.approx(100, abs=1)
    assert ratio["Spk"] == pytest.approx(ratio["Svk"], rel=0.03)


def test_sdq_of_white_noise_differs_by_two_between_schemes() -> None:
    """Forward sqrt(2) / dx per direction, central 1 / (sqrt(2) dx): the scheme is part of the value."""
    z = np.random.default_rng(1).normal(0, 1, (500, 500))
    forward, central = (root_mean_square_slope(z, 0.5, scheme) for scheme in ("forward", "central"))
    assert forward == pytest.approx(2 / 0.5, rel=0.01)
    assert forward / central == pytest.approx(2, rel=0.01)


def test_gaussian_texture_has_its_correlation_length() -> None:
    from semscape.metrology.uncertainty import correlated_noise

    z = correlated_noise((700, 700), 5.0, rng=np.random.default_rng(2))
    expected = 0.5 * np.sqrt(4 * 25 * np.log(5))  # exp(-d² / 4 s²) = 0.2, at half a unit of length per px
    found = spatial_parameters(z, 0.5)
    assert found["Sal"] == pytest.approx(expected, rel=0.05)
    assert 0.85 < found["Str"] <= 1
    stretched = spatial_parameters(z, (1.5, 0.5))  # the same heights on wider columns
    assert stretched["Str"] == pytest.approx(1 / 3, rel=0.1)


def test_a_lay_that_runs_through_the_field_has_no_str() -> None:
    z = sine() + 1e-3 * np.random.default_rng(0).normal(size=(40, 1000))
    found = spatial_parameters(z, 0.1)
    assert np.isnan(found["Str"])
    # The field is 40 rows high: half of it is 2 um. cos(2 pi d / 10 um) = 0.2 at 2.18 um lies beyond.
    tall = np.tile(z[:1], (400, 1))
    assert spatial_parameters(tall, 0.1)["Sal"] == pytest.approx(10 * np.arccos(0.2) / (2 * np.pi), rel=0.015)


def test_a_surface_without_any_relief_has_no_texture() -> None:
    found = spatial_parameters(np.zeros((30, 40)), 1.0)
    assert np.isnan([found["Sal"], found["Str"]]).all()


def test_unknown_heights_are_left_out_and_not_taken_for_zero() -> None:
    rng = np.random.default_rng(3)
    z = rng.normal(0, 1, (300, 300)) + 100
    holed = z.copy()
    holed[rng.random((30, 30)).repeat(10, 0).repeat(10, 1) < 0.3] = np.nan
    full, part = height_parameters(z), height_parameters(holed)
    assert part["Sq"] == pytest.approx(full["Sq"], rel=0.01)
    assert root_mean_square_slope(holed, 1.0) == pytest.approx(root_mean_square_slope(z, 1.0), rel=0.01)
    assert developed_area_ratio(holed, 1.0) == pytest.approx(developed_area_ratio(z, 1.0), rel=0.01)
    smooth = np.tile(sine(400, 10)[:1], (400, 1))
    gaps = np.where(rng.random((40, 40)).repeat(10, 0).repeat(10, 1) < 0.3, np.nan, smooth)
    assert spatial_parameters(gaps, 1.0)["Sal"] == pytest.approx(spatial_parameters(smooth, 1.0)["Sal"], rel=0.02)
    assert autocorrelation(gaps)[200, 200] == pytest.approx(1, abs=1e-5)


def test_nothing_known_is_no_answer() -> None:
    unknown = np.full((20, 20), np.nan)
    for function in (height_parameters, material_ratio_parameters, autocorrelation):
        with pytest.raises(NoAnswerError, match="0 of 400"):
            function(unknown)
    with pytest.raises(NoAnswerError, match="four neighbouring"):
        developed_areas(unknown, 1.0)
    with pytest.raises(NoAnswerError, match="no slope"):
        root_mean_square_slope(unknown, 1.0)


def test_misuse() -> None:
    with pytest.raises(ValueError, match="spacing"):
        developed_areas(np.zeros((3, 3)), 0.0)
    with pytest.raises(ValueError, match="scheme"):
        root_mean_square_slope(np.zeros((9, 9)), 1.0, "backward")  # type: ignore[arg-type]


@pytest.mark.real_data
@pytest.mark.parametrize("name", SURFACES)
def test_parameters_agree_with_independent_codes_on_measured_surfaces(shared_data: Path, name: str) -> None:
    """Within 0.5 %, but for one value of the reference that is itself off, as is shown below."""
    folder = shared_data / "surfaces"
    reference = json.loads((folder / "iso25178_reference.json").read_text())[name]
    with np.load(folder / f"{name}.npz") as arrays:
        z = np.where(arrays["valid"], arrays["z_um"].astype(float), np.nan)
        spacing = float(arrays["dx_um"]), float(arrays["dy_um"])
    ours = height_parameters(z) | material_ratio_parameters(z) | spatial_parameters(z, spacing)
    ours |= {"Sdq": root_mean_square_slope(z, spacing), "Sdr": developed_area_ratio(z, spacing)}
    for key, value in reference["numpy"].items():
        assert ours[key] == pytest.approx(value, rel=1e-5), key
    for key, value in reference["surfalize"].items():
        if np.isnan(value):
            assert np.isnan(ours[key]), key
        elif (name, key) != ("milled_profilometer", "Svk"):
            assert ours[key] == pytest.approx(value, rel=0.005), key
    # SurfaceTopography averages the slopes in its own way; the codes differ from each other by up to 0.17 %.
    assert ours["Sdq"] == pytest.approx(reference["SurfaceTopography"]["Sdq"], rel=SLOPE_SCHEME_BOUND)
    if name == "milled_profilometer":
        assert ours["Svk"] == pytest.approx(reference["surfalize"]["Svk"], rel=0.011)
        # The reference's Svk is the trapezoid rule over a table of 10,000 quantiles; a finer table comes to ours.
        tabulated = {n: svk_of_a_table(z, ours["Smr2"] / 100, n) for n in (10_000, 1_000_000)}
        assert tabulated[10_000] == pytest.approx(reference["surfalize"]["Svk"], rel=0.002)
        assert tabulated[1_000_000] == pytest.approx(ours["Svk"], rel=0.001)


def svk_of_a_table(z: np.ndarray, smr2: float, n: int) -> float:
    """Svk by the trapezoid rule over n intervals of the material ratio curve."""
    share = np.linspace(0, 1, n + 1)
    # np.quantile, but in a second: that partitions once for each of the many shares.
    table = np.interp(1 - share, np.linspace(0, 1, z.size), np.sort(z, axis=None))
    dales = np.maximum(np.interp(smr2, share, table) - table, 0) * (share > smr2)
    return float(2 * np.trapezoid(dales, share) / (1 - smr2))


def test_a_few_deep_pits_have_their_exact_svk_and_a_table_does_not() -> None:
    """A ramp from 1 to 0 with a share f of pits of the depth D under it: dales of the area f D, so that Svk = 2 D."""
    ramp, n_pits, depth = np.linspace(1.0, 0.0, 1_000_000), 20, 50.0
    z = np.concatenate([ramp, np.full(n_pits, -depth)]).reshape(4, -1)
    found = material_ratio_parameters(z)
    assert found["Svk"] == pytest.approx(2 * depth, rel=0.005)
    assert 100 - found["Smr2"] == pytest.approx(100 * n_pits / z.size, rel=0.05)
    assert abs(svk_of_a_table(z, found["Smr2"] / 100, 10_000) / (2 * depth) - 1) > 0.3
