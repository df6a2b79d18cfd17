"""Measuring a whole map: the right surface for each figure, units, sigmas and warnings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import ndimage

from semscape.errors import BadInputError, NoAnswerError
from semscape.metrology.areal import height_parameters
from semscape.metrology.grid import Polygon, Region
from semscape.metrology.measure import measure, measure_change
from semscape.metrology.prepare import prepared_surfaces
from semscape.metrology.request import MeasureRequest, parse_edges, parse_line, parse_region, parse_two_regions
from semscape.metrology.resolution import PERIOD_PER_SIGMA
from semscape.metrology.uncertainty import correlated_noise
from semscape.options import MeasureOptions
from semscape.types import HeightMap


def height_map(
    z: np.ndarray, pixel: float = 0.1, unit: str = "um", sigma: float = 0.01, window_px: float = np.nan
) -> HeightMap:
    """A map that states the lateral period of a window of that sigma, NaN: none."""
    grid, period = np.diag([pixel, -pixel, 1, 1]), np.full(z.shape, PERIOD_PER_SIGMA * window_px * pixel, np.float32)
    return HeightMap(
        z, np.full(z.shape, sigma), np.full(z.shape, 3, np.uint8), np.zeros(z.shape, np.float32), pixel, grid, unit,
        lateral_period_um=period,
    )  # fmt: skip


def terrain(n: int = 160) -> np.ndarray:
    rng = np.random.default_rng(0)
    rows, cols = np.indices((n, n))
    waves = 0.4 * np.sin(2 * np.pi * cols / 20) + 0.8 * np.sin(2 * np.pi * rows / 80)
    step = np.where(cols >= 80, 1.5, 0.0)
    return waves + step + 0.02 * cols + ndimage.gaussian_filter(rng.normal(0, 0.1, (n, n)), 2)


def ramp_with_step(n: int = 160) -> np.ndarray:
    cols = np.indices((n, n))[1]
    noise = np.random.default_rng(1).normal(0, 0.02, (n, n))
    return 0.02 * cols + np.where(cols >= 80, 1.5, 0.0) + ndimage.gaussian_filter(noise, 1)


def run(z: np.ndarray, *, draws: int = 6, **kwargs):
    request_keys = {spec.name for spec in dataclasses.fields(MeasureRequest)}
    request = {key: value for key, value in kwargs.items() if key in request_keys}
    options = {key: value for key, value in kwargs.items() if key not in request_keys}
    given = height_map(z, window_px=2.0)
    return measure(
        given,
        MeasureRequest(MeasureOptions(draws=draws, **options), **request),
        height_scale_relative_sigma=0.01,
        rng=np.random.default_rng(0),
    )


def values(measured) -> dict[str, float]:
    return {f"{figure.group}/{figure.name}": figure.value for figure in measured.figures}


def test_every_parameter_of_the_standard_is_there_with_its_unit() -> None:
    figures = {figure.name: figure for figure in run(terrain()).figures}
    text = "Sa Sq Ssk Sku Sp Sv Sz Sdq Sdr Sal Str Sk Spk Svk Smr1 Smr2 Sxp Vmp Vmc Vvv Vvc"
    names = text.split(" ")
    assert set(names) <= set(figures)
    units = {name: figures[name].unit for name in names}
    assert units["Sa"] == units["Sal"] == units["Sxp"] == "um"
    assert units["Vmp"] == "um³/um²"
    assert units["Smr1"] == units["Sdr"] == "%"
    assert units["Ssk"] == units["Sdq"] == ""
    assert figures["volume above"].unit == "um³"
    for name in ("Sa", "Sq", "volume above", "volume below"):
        assert figures[name].sigma > 0, name


def test_filters_apply_to_the_surface_and_steps_are_of_the_heights_as_matched() -> None:
    regions = Region(22, 0, 61, 159), Region(102, 0, 141, 159)
    plain = values(run(terrain(), level="none", step=regions))
    filtered = values(run(terrain(), level="none", s_filter_um=1.0, l_filter_um=4.0, step=regions))
    assert filtered["height/Sq"] < 0.5 * plain["height/Sq"]  # the wave of 8 um, the step and the slope are gone
    assert filtered["slope/Sdq"] < plain["slope/Sdq"]
    assert filtered["step/height"] == plain["step/height"]
    flat = values(run(ramp_with_step(), level="poly3", s_filter_um=1.0, step=regions))
    assert flat["step/height"] == pytest.approx(1.5, abs=0.005)


def test_places_are_those_of_the_whole_map_whatever_the_region() -> None:
    line, regions = (85.0, 50.0, 150.0, 90.0), (Region(82, 5, 110, 150), Region(120, 5, 155, 150))
    whole = values(run(terrain(), distance=line, angle=regions))
    part = run(terrain(), distance=line, angle=regions, region=Region(81, 0, 159, 159))
    assert part.origin_px == (81, 0)
    assert part.surface.shape == (160, 79)
    for name in ("distance/vertical", "angle/angle between planes"):
        assert values(part)[name] == pytest.approx(whole[name])
    assert values(part)["height/Sq"] < whole["height/Sq"]  # the step is outside
    assert not any("no vertical" in text for text in part.warnings)
    beside = run(terrain(), distance=line, region=Region(90, 0, 159, 159))
    assert np.isnan(values(beside)["distance/vertical"])
    assert any("an end of --distance lies on an unknown height" in text for text in beside.warnings)
    with pytest.raises(NoAnswerError, match="the map, which is 160 x 160"):
        run(terrain(), region=Region(500, 500, 600, 600))


def test_a_step_along_a_profile_and_roughness_with_an_l_filter() -> None:
    line = (0.0, 80.0, 159.0, 80.0)
    found = values(run(ramp_with_step(), profile=line, edges=(7.95,), l_filter_um=3.0))
    assert found["profile/length"] == pytest.approx(15.9)
    assert found["step along the profile/height"] == pytest.approx(1.5, abs=0.02)
    assert found["profile/Ra"] < found["profile/Pa"]
    assert "profile/Ra" not in values(run(terrain(), profile=line))


def test_a_profile_too_short_for_its_filter_has_no_ra_and_says_so() -> None:
    line = (0.0, 80.0, 55.0, 80.0)  # 5.5 um
    short = run(terrain(), profile=line, l_filter_um=3.0)
    assert values(short)["profile/sections"] == 0
    assert np.isnan([values(short)[f"profile/{name}"] for name in ("Ra", "Rq", "Rz", "Rt")]).all()
    assert "draw a line of 6 um at least (18 for the five" in " ".join(short.warnings)
    assert values(short)["profile/Pa"] > 0
    long = run(terrain(), profile=line, l_filter_um=2.5)
    assert values(long)["profile/sections"] == 1
    assert values(long)["profile/Ra"] > 0
    assert "Rz comes from 1 section lengths" in " ".join(long.warnings)


@pytest.mark.parametrize("window", [0.0, 2.0])
def test_the_sigma_of_a_large_map_is_that_of_theory_thinned_or_not(window: float) -> None:
    """White noise draws every pixel, noise of a window of 2 px every second; relief ends at the window, as matched."""
    rng = np.random.default_rng(0)
    z = rng.normal(size=(700, 700))
    if window:
        z = ndimage.gaussian_filter(z, window)
    z /= z.std()
    measured = measure(
        height_map(z, sigma=0.3, window_px=window or np.nan), MeasureRequest(MeasureOptions(draws=60)),
        height_scale_relative_sigma=0.0, rng=np.random.default_rng(1),
    )  # fmt: skip
    figure = next(figure for figure in measured.figures if figure.name == "Sq")
    # Both relief and noise are correlated as exp(-d² / 4 s²): the sum of the product over all lags is 2 pi s² px.
    area = 2 * np.pi * window**2 if window else 1.0
    random = np.sqrt(figure.sigma**2 - figure.noise_bias**2)
    assert random == pytest.approx(0.3 * np.sqrt(area) / 700, rel=0.3)
    assert figure.noise_bias == pytest.approx(np.sqrt(1 + 0.09) - 1, rel=0.1)


@pytest.mark.parametrize("window", [0.0, 3.0])
def test_the_sigma_behind_filters_is_the_scatter_of_maps_that_were_filtered(window: float) -> None:
    """The draws know the S-filter from its formula, and every other pixel; here all of it is done to whole maps."""
    rng = np.random.default_rng(0)
    z, pixel = 2 * ndimage.gaussian_filter(rng.normal(size=(400, 400)), 6) * 20, 0.1
    options = MeasureOptions(draws=60, s_filter_um=1.0, l_filter_um=12.0)
    prepare = prepared_surfaces(z, pixel, options)
    whole = [
        height_parameters(prepare(z + 0.4 * correlated_noise(z.shape, window, rng=rng))[1])["Sq"] for _ in range(20)
    ]
    given = height_map(z, pixel, sigma=0.4, window_px=window or 0.01)
    measured = measure(given, MeasureRequest(options), height_scale_relative_sigma=0.0, rng=np.random.default_rng(1))
    figure = next(figure for figure in measured.figures if figure.name == "Sq")
    assert figure.noise_bias == pytest.approx(np.mean(whole) - figure.value, rel=0.3)
    assert np.sqrt(figure.sigma**2 - figure.noise_bias**2) == pytest.approx(np.std(whole, ddof=1), rel=0.5)


@pytest.mark.parametrize(("window", "n"), [(0.0, 700), (2.0, 700), (0.0, 90)])
def test_the_sigma_of_a_step_is_that_of_least_squares(window: float, n: int) -> None:
    """Of two planes of one slope; white noise and noise of a window, on large regions and on small ones."""
    regions = Region(0, 0, 0.4 * n, 0.4 * n), Region(0.55 * n, 0.1 * n, 0.95 * n, 0.5 * n)
    given = height_map(np.zeros((n, n)), 0.1, sigma=0.3, window_px=window or 0.01)
    request = MeasureRequest(MeasureOptions(draws=60), step=regions, profile=(0, 5, n - 1, 5), edges=(0.05 * n,))
    measured = measure(given, request, height_scale_relative_sigma=0.0, rng=np.random.default_rng(0))
    sigma = {figure.group: figure.sigma for figure in measured.figures if figure.name == "height"}
    masks = [region.mask((n, n)) for region in regions]
    rows, cols = np.nonzero(masks[0] | masks[1])
    design = np.column_stack([cols, rows, np.ones(len(cols)), masks[1][rows, cols]])
    independent = 0.3 * np.sqrt(np.linalg.inv(design.T @ design)[3, 3])
    alike = max(4 * np.pi * window**2, 1.0)
    assert sigma["step"] == pytest.approx(independent * np.sqrt(alike), rel=0.35)
    assert sigma["step along the profile"] > 0.3 * np.sqrt(2 / n)


def test_robust_levelling_holds_for_the_sigmas_too() -> None:
    """A particle on a tilted plane: with a robust fit neither the value nor its sigma knows the plane's tilt."""
    rows, cols = np.indices((120, 120))
    noise = ndimage.gaussian_filter(np.random.default_rng(0).normal(0, 0.1, rows.shape), 2)
    dirty = 0.05 * cols + noise + np.where((rows < 40) & (cols > 85), 4.0, 0.0)
    clean = np.where((rows < 40) & (cols > 85), 4.0, 0.0) + noise
    robust, plain = ({f.name: f for f in run(dirty, robust=flag, draws=20).figures} for flag in (True, False))
    truth = {f.name: f for f in run(clean, level="none", draws=20).figures}
    assert robust["Sq"].value == pytest.approx(truth["Sq"].value, rel=0.01)
    assert robust["Sq"].sigma == pytest.approx(truth["Sq"].sigma, rel=0.3)
    assert abs(plain["Sq"].value / truth["Sq"].value - 1) > 0.1


def test_warnings_say_what_limits() -> None:
    text = " ".join(run(terrain()).warnings)
    assert "there is no S-filter" in text
    assert "--s-filter-um 1.1" in text  # 5.34 x 2 px x 0.1 um
    assert "finer than the lateral resolution" in " ".join(run(terrain(), s_filter_um=0.5).warnings)
    good = run(terrain(), s_filter_um=3.0)
    assert not [warning for warning in good.warnings if "lateral" in warning or "S-filter" in warning]
    holed = terrain()
    holed[:40] = np.nan
    assert "25% of the field is unknown" in " ".join(run(holed).warnings)
    spiked = terrain()
    spiked[50, 50] += 50
    cleaned = run(spiked, outlier_sigmas=10.0)
    assert "1 outliers" in " ".join(cleaned.warnings)
    assert values(cleaned)["height/Sz"] < 10
    unsure = measure(height_map(terrain()), MeasureRequest(), rng=np.random.default_rng(0))
    assert "no uncertainties" in " ".join(unsure.warnings)
    pixels = measure(height_map(terrain(), unit="px"), MeasureRequest(), rng=np.random.default_rng(0))
    assert "no pixel size" in " ".join(pixels.warnings)
    assert {figure.unit for figure in pixels.figures} <= {"px", "px²", "px³", "px³/px²", "%", ""}


def test_the_stated_resolution_is_that_of_the_measured_region() -> None:
    z = terrain()
    period = np.where(np.indices(z.shape)[1] < 80, 1.2, 3.0).astype(np.float32)
    given = dataclasses.replace(height_map(z), lateral_period_um=period)
    request = MeasureRequest(MeasureOptions(draws=2), region=Region(0, 0, 79, 159))
    left = measure(given, request, rng=np.random.default_rng(0))
    assert (left.resolution.source, left.resolution.period) == ("matching", pytest.approx(1.2))
    assert "--s-filter-um 1.3" in " ".join(left.warnings)


def test_the_same_seed_gives_the_same_figures() -> None:
    assert run(terrain()).figures == run(terrain()).figures


def test_wear_between_two_maps() -> None:
    before = terrain(200) + 3 * ndimage.gaussian_filter(np.random.default_rng(3).normal(size=(200, 200)), 4)
    after = before[10:190, 5:195].copy()
    after[60:100, 60:120] -= 0.5
    rng = np.random.default_rng(4)
    after += rng.normal(0, 0.02, after.shape)
    figures, _ = measure_change(height_map(after), height_map(before))
    found = {figure.name: figure.value for figure in figures}
    assert found["volume lost"] == pytest.approx(40 * 60 * 0.1**2 * 0.5, rel=0.05)
    assert found["volume gained"] < 0.02 * found["volume lost"]
    assert found["deepest loss"] == pytest.approx(0.5, abs=0.1)
    half = {figure.name: figure.value for figure in measure_change(
        height_map(after), height_map(before), Region(0, 0, 89, 179))[0]}  # fmt: skip
    assert half["volume lost"] == pytest.approx(40 * 30 * 0.1**2 * 0.5, rel=0.05)
    assert (half["overlap"], half["residual sigma"]) == (found["overlap"], found["residual sigma"])
    before[:80, :80] = np.nan
    with pytest.raises(NoAnswerError, match="nowhere in the region"):
        measure_change(height_map(after), height_map(before), Region(5, 5, 40, 40))
    same, _ = measure_change(height_map(after), height_map(after))
    assert {figure.value for figure in same if figure.name.startswith("volume")} == {0.0}
    with pytest.raises(BadInputError, match="one pixel size"):
        measure_change(height_map(after), height_map(before, pixel=0.2))


def test_texts_of_places() -> None:
    assert parse_line("--profile", "1,2,3,4", 0.5, "um") == (1, 2, 3, 4)
    assert parse_line("--profile", " 1,2,3,4px", 0.5, "px") == (1, 2, 3, 4)
    assert parse_edges("--edges", "10,20", 0.5, "um") == (5, 10)
    assert parse_edges("--edges", "10um", 0.5, "um") == (10,)
    first, second = parse_two_regions("--step", "0,0,1,1um;2,2,3,3", 0.5, "um")
    assert (first.x1_px, second.x1_px) == (2, 3)
    for text in ("1,2,3", "a,b,c,d", "1,2,3,nan", "1,2,3,4mm"):
        with pytest.raises(BadInputError, match="--profile"):
            parse_line("--profile", text, 0.5, "um")
    with pytest.raises(BadInputError, match="no pixel size"):
        parse_line("--profile", "1,2,3,4um", 1.0, "px")
    with pytest.raises(BadInputError, match="two regions"):
        parse_two_regions("--step", "1,2,3,4", 1.0, "px")
    with pytest.raises(BadInputError, match="one edge"):
        parse_edges("--edges", "1,2,3", 1.0, "px")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": "cone"}, "--level 'cone'"),
        ({"s_filter_um": -1.0}, "--s-filter-um"),
        ({"s_filter_um": 5.0, "l_filter_um": 4.0}, "nothing would be left"),
    ],
)
def test_requests_that_cannot_be_met(options, message) -> None:
    with pytest.raises(BadInputError, match=message):
        MeasureRequest(MeasureOptions(**options))
    with pytest.raises(BadInputError, match="give --profile"):
        MeasureRequest(edges=(1.0,))


def test_a_polygon_holds_what_lies_in_it_or_on_its_edges() -> None:
    corners = np.array([(2, 1), (14, 1), (9, 6), (16, 12), (5, 15), (7, 8), (-3, 9)])  # concave, one corner outside
    rows, cols = np.indices((17, 18))
    inside = np.zeros(rows.shape, dtype=bool)
    on_edge = np.zeros_like(inside)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = (cols - x0) * (y1 - y0) - (rows - y0) * (x1 - x0)  # whole numbers, and so exact
        beside = (np.minimum(x0, x1) <= cols) & (cols <= np.maximum(x0, x1))
        on_edge |= (side == 0) & beside & (np.minimum(y0, y1) <= rows) & (rows <= np.maximum(y0, y1))
        inside ^= ((y0 > rows) != (y1 > rows)) & (side * (y1 - y0) < 0)
    polygon = Polygon(tuple((float(x), float(y)) for x, y in corners))
    np.testing.assert_array_equal(polygon.mask(rows.shape), inside | on_edge)
    np.testing.assert_array_equal(polygon.shifted(2, 1).mask((16, 16)), (inside | on_edge)[1:, 2:])
    np.testing.assert_array_equal(polygon.scaled(2).mask((34, 36))[::2, ::2], inside | on_edge)


def test_a_polygon_around_a_rectangle_measures_as_the_rectangle() -> None:
    box = Region(20, 30, 70, 90)
    around = Polygon(((20.0, 30.0), (70.0, 30.0), (70.0, 90.0), (20.0, 90.0)))
    other = Region(90, 30, 130, 90)
    assert values(run(terrain(), region=around)) == pytest.approx(values(run(terrain(), region=box)), nan_ok=True)
    by_polygon = run(terrain(), step=(around, other))
    assert values(by_polygon)["step/height"] == values(run(terrain(), step=(box, other)))["step/height"]


def test_what_is_beside_a_polygon_is_not_unknown() -> None:
    z = terrain()
    z[50:52, 50:52] = np.nan
    triangle = Polygon(((20.0, 20.0), (120.0, 20.0), (20.0, 120.0)))
    found = run(z, region=triangle)
    assert values(found)["area and volume/unknown area"] == pytest.approx(4 * 0.1**2)
    assert values(found)["area and volume/projected area"] == pytest.approx(0.1**2 * (100 * 99 / 2 - 9))
    assert not [told for told in found.warnings if "unknown" in told]


def test_texts_of_polygons() -> None:
    assert parse_region("--region", "0,0,8,0,0,8", 0.5, "px") == Polygon(((0.0, 0.0), (8.0, 0.0), (0.0, 8.0)))
    assert parse_region("--region", "0,0,8,0,0,8um", 0.5, "um") == Polygon(((0.0, 0.0), (16.0, 0.0), (0.0, 16.0)))
    assert parse_region("--region", "1,2,3,4", 0.5, "px") == Region(1.0, 2.0, 3.0, 4.0)
    with pytest.raises(BadInputError, match="three corners"):
        parse_region("--region", "0,0,8,0,0,8,1", 0.5, "px")
    with pytest.raises(BadInputError, match="no pixel size"):
        parse_region("--region", "0,0,8,0,0,8um", 1.0, "px")
