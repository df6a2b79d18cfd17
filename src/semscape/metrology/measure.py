"""Measure a height map: prepare the surface, take every parameter, and say what limits each.

The order is F, S, F, L: the form is fitted and taken off (so that the S-filter's one-sided windows at edges and holes
see no slope), the S-filter smooths, a polynomial form is fitted once more to the smooth surface, as ISO 25178-3 has
it, and the L-filter takes waviness off. Parameters of the surface are of the S-L surface (S-F where there is no
L-filter); profiles, areas and volumes of the S-F surface; steps, angles and distances of the heights as they were
matched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from semscape.errors import BadInputError, NoAnswerError
from semscape.metrology.areal import developed_area_ratio, developed_areas, height_parameters, root_mean_square_slope
from semscape.metrology.findings import Figure, figures_of, surface_warnings
from semscape.metrology.grid import Polygon, Region
from semscape.metrology.material_ratio import material_ratio_parameters
from semscape.metrology.outliers import find_outliers
from semscape.metrology.planes import angle_between, fit_plane
from semscape.metrology.prepare import prepared_surfaces
from semscape.metrology.profile import Profile, extract_profile, profile_parameters
from semscape.metrology.propagate import Errors, step_estimates, step_of_profile, surface_estimates
from semscape.metrology.register import Comparison, compare
from semscape.metrology.request import MeasureRequest
from semscape.metrology.resolution import LateralResolution, lateral_resolution
from semscape.metrology.spatial import spatial_parameters
from semscape.metrology.step import Step, step_between_regions
from semscape.metrology.volume import distance, volumes
from semscape.types import BoolArray, FloatArray, HeightMap

_SAME_PIXEL_SIZE = 1e-3
_ROUNDING = 1e-6  # of a px: two maps that are the same differ by that


@dataclass(frozen=True, eq=False)
class Measurement:
    """Everything measured of a map: figures with units and sigmas, warnings, and the surfaces behind them.

    `surface` (h, w) is the S-L surface of the measured region, whose first pixel is `origin_px` (x, y) of the map.
    """

    figures: tuple[Figure, ...]
    warnings: tuple[str, ...]
    resolution: LateralResolution
    surface: FloatArray
    origin_px: tuple[int, int]
    profile: Profile | None


def measure(
    height_map: HeightMap,
    request: MeasureRequest,
    *,
    height_scale_relative_sigma: float = math.nan,
    rng: np.random.Generator,
) -> Measurement:
    """Measure a height map.

    Parameters
    ----------
    height_map : HeightMap
    request : MeasureRequest
        What to measure, and the options.
    height_scale_relative_sigma : float
        Of the reconstruction; NaN (unknown) leaves every sigma unknown.
    rng : numpy.random.Generator
        For the Monte Carlo.

    Raises
    ------
    NoAnswerError
        If too few heights are known where something is to be measured.
    """
    options, pixel = request.options, height_map.pixel_size_um
    window, inside = _window(height_map, request.region)
    matched = np.where(inside, height_map.height_um[window], np.nan)
    uncertainty = height_map.uncertainty_um[window]
    origin = int(window[1].start or 0), int(window[0].start or 0)
    stated = height_map.lateral_period_um[window][np.isfinite(matched)]
    resolution = lateral_resolution(height_map.height_um, pixel, stated)
    request = _shifted(request, origin)
    n_outliers = 0
    if not math.isnan(options.outlier_sigmas):
        outliers = find_outliers(matched, options.outlier_sigmas)
        n_outliers = int(outliers.sum())
        matched = np.where(outliers, np.nan, matched)
    smooth, rough = prepared_surfaces(matched, pixel, options)(matched)
    errors = Errors(uncertainty, resolution.sigma_px, height_scale_relative_sigma)
    estimates = surface_estimates(smooth, errors, pixel, options, rng=rng)
    estimates |= step_estimates(matched, errors, pixel, request, rng=rng)
    unit = height_map.length_unit
    developed, projected = developed_areas(smooth, pixel)
    contents = volumes(smooth, pixel, options.volume_level_um)
    slopes = {"Sdq": root_mean_square_slope(rough, pixel), "Sdr": developed_area_ratio(rough, pixel)}
    areas = {"projected area": projected, "developed area": developed}
    unknown_area = np.count_nonzero(inside & ~np.isfinite(smooth)) * pixel**2
    areas |= {"volume above": contents.above, "volume below": contents.below, "unknown area": unknown_area}
    groups: dict[str, dict[str, float]] = {
        "height": height_parameters(rough),
        "slope": slopes,
        "spatial": spatial_parameters(rough, pixel),
        "material ratio": material_ratio_parameters(rough),
        "area and volume": areas,
    }
    profile = None
    if request.profile is not None:
        line = np.array(request.profile).reshape(2, 2)
        profile = extract_profile(smooth, pixel, line[0], line[1])
        nesting_index = None if math.isnan(options.l_filter_um) else options.l_filter_um
        length = float(profile.distance[-1])
        groups["profile"] = {"length": length} | profile_parameters(profile, nesting_index)
    if request.edges:
        groups["step along the profile"] = _step_figures(step_of_profile(matched, pixel, request))
    if request.step is not None:
        masks = [region.mask(matched.shape) for region in request.step]
        groups["step"] = _step_figures(step_between_regions(matched, pixel, *masks))
    if request.angle is not None:
        planes = [fit_plane(matched, pixel, region.mask(matched.shape)) for region in request.angle]
        tilts = {f"tilt of plane {i}": math.degrees(plane.tilt_rad) for i, plane in enumerate(planes, 1)}
        groups["angle"] = {"angle between planes": math.degrees(angle_between(*planes))} | tilts
    if request.distance is not None:
        ends = np.array(request.distance).reshape(2, 2)
        apart = distance(matched, pixel, ends[0], ends[1])
        groups["distance"] = {"lateral": apart.lateral, "vertical": apart.vertical, "spatial": apart.spatial}
    figures = tuple(figure for group, values in groups.items() for figure in figures_of(group, values, unit, estimates))
    warnings = surface_warnings(
        figures, matched, inside, resolution, options, pixel=pixel, unit=unit, n_outliers=n_outliers
    )
    return Measurement(figures, warnings, resolution, rough, origin, profile)


def measure_change(
    height_map: HeightMap, earlier: HeightMap, region: Region | Polygon | None = None
) -> tuple[tuple[Figure, ...], Comparison]:
    """Register an earlier map of the same place to this one and measure what was lost and gained since.

    The registration rests on the whole maps; what was lost and gained is that of the region, if one is given. Only
    changes beyond three robust sigmas of the difference count, so that noise adds up to no volume. The two maps'
    height scales each have their own error, which shows as a difference in proportion to the relief.

    Raises
    ------
    BadInputError
        If the maps differ in unit or pixel size.
    NoAnswerError
        If they do not overlap, or not in the region.
    """
    pixel, unit = height_map.pixel_size_um, height_map.length_unit
    if earlier.length_unit != unit or abs(earlier.pixel_size_um / pixel - 1) > _SAME_PIXEL_SIZE:
        raise BadInputError(
            f"the maps have pixels of {pixel:.6g} {unit} and {earlier.pixel_size_um:.6g} {earlier.length_unit}; only "
            "maps of one pixel size can be compared: take the images at one magnification"
        )
    comparison = compare(height_map.height_um, earlier.height_um, pixel)
    change = -comparison.difference
    if region is not None:
        change = np.where(region.mask(height_map.height_um.shape), change, np.nan)
        if not np.isfinite(change).any():
            raise NoAnswerError("nowhere in the region are the heights of both maps known; choose another region")
    limit = 3 * comparison.residual_sigma + _ROUNDING * pixel
    lost, gained = np.where(change < -limit, -change, 0.0), np.where(change > limit, change, 0.0)
    matrix = comparison.first_from_second
    rows, cols = height_map.height_um.shape
    middle = np.array([(cols - 1) / 2 * pixel, (rows - 1) / 2 * pixel, 0.0])
    values = {
        "overlap": 100 * comparison.overlap,
        "residual sigma": comparison.residual_sigma,
        "volume lost": float(lost.sum()) * pixel**2,
        "volume gained": float(gained.sum()) * pixel**2,
        "deepest loss": float(np.nanpercentile(-change, 99.9)),
        "lateral shift": float(np.hypot(*(matrix[:3, :3] @ middle + matrix[:3, 3] - middle)[:2])),
        "turn": math.degrees(math.atan2(matrix[1, 0], matrix[0, 0])),
    }
    return figures_of("change", values, unit), replace(comparison, difference=change)


def _window(height_map: HeightMap, region: Region | Polygon | None) -> tuple[tuple[slice, slice], BoolArray]:
    """Return the rows and columns of the box around what is measured, and where in it that lies."""
    height, width = height_map.height_um.shape
    if region is None:
        return (slice(None), slice(None)), np.ones((height, width), dtype=bool)
    inside = region.mask((height, width))
    rows, cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if min(len(rows), len(cols)) < 2:
        raise NoAnswerError(
            f"the region covers {len(cols)} x {len(rows)} px of the map, which is {width} x {height} px; choose a "
            "larger one"
        )
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)
    return window, inside[window]


def _shifted(request: MeasureRequest, origin: tuple[int, int]) -> MeasureRequest:
    """Return the request with its places in the px of the region that starts at `origin`."""
    x, y = origin

    def line(places: tuple[float, float, float, float] | None) -> tuple[float, float, float, float] | None:
        return None if places is None else (places[0] - x, places[1] - y, places[2] - x, places[3] - y)

    def two(
        regions: tuple[Region | Polygon, Region | Polygon] | None,
    ) -> tuple[Region | Polygon, Region | Polygon] | None:
        return None if regions is None else (regions[0].shifted(x, y), regions[1].shifted(x, y))

    return replace(
        request,
        profile=line(request.profile),
        distance=line(request.distance),
        step=two(request.step),
        angle=two(request.angle),
    )


def _step_figures(step: Step) -> dict[str, float]:
    return {"height": step.height, "perpendicular": step.perpendicular, "residual rms": step.residual_rms}
