"""A measured figure with its unit, uncertainty and meaning, and the warnings that belong to a measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from semscape.metrology.resolution import LateralResolution
from semscape.metrology.uncertainty import Estimate
from semscape.options import MeasureOptions
from semscape.types import BoolArray, FloatArray, LengthUnit

# Dimension and meaning of every figure; "L" is the map's unit of length.
_FIGURES: dict[str, tuple[str, str]] = {
    "Sa": ("L", "arithmetic mean height"),
    "Sq": ("L", "root mean square height"),
    "Ssk": ("", "skewness"),
    "Sku": ("", "kurtosis"),
    "Sp": ("L", "highest peak"),
    "Sv": ("L", "deepest pit"),
    "Sz": ("L", "peak to pit"),
    "Sdq": ("", "rms slope, differences of neighbours"),
    "Sdr": ("%", "developed area ratio, triangles both ways"),
    "Sal": ("L", "autocorrelation length to 0.2"),
    "Str": ("", "texture aspect ratio"),
    "Sk": ("L", "core height"),
    "Spk": ("L", "reduced peak height"),
    "Svk": ("L", "reduced dale height"),
    "Smr1": ("%", "material ratio above the core"),
    "Smr2": ("%", "material ratio down to the dales"),
    "Sxp": ("L", "peak extreme height, 2.5 to 50 %"),
    "Vmp": ("L3/L2", "peak material volume, to 10 %"),
    "Vmc": ("L3/L2", "core material volume, 10 to 80 %"),
    "Vvv": ("L3/L2", "dale void volume, from 80 %"),
    "Vvc": ("L3/L2", "core void volume, 10 to 80 %"),
    "projected area": ("L2", "of the cells whose corners are known"),
    "developed area": ("L2", "of the same cells"),
    "volume above": ("L3", "material above the level"),
    "volume below": ("L3", "voids below the level"),
    "unknown area": ("L2", "counts in no volume"),
    "length": ("L", "of the profile"),
    "Pa": ("L", "arithmetic mean height, P-profile"),
    "Pq": ("L", "root mean square height, P-profile"),
    "Pt": ("L", "total height, P-profile"),
    "Ra": ("L", "arithmetic mean height, R-profile"),
    "Rq": ("L", "root mean square height, R-profile"),
    "Rz": ("L", "mean peak to pit per section length"),
    "Rt": ("L", "total height, R-profile"),
    "sections": ("", "section lengths behind Rz"),
    "height": ("L", "second part less first, along z"),
    "perpendicular": ("L", "along the normal of the parallel fits"),
    "residual rms": ("L", "of the parallel fits"),
    "angle between planes": ("deg", "between the normals"),
    "tilt of plane 1": ("deg", "from the image plane"),
    "tilt of plane 2": ("deg", "from the image plane"),
    "lateral": ("L", "in the image plane"),
    "vertical": ("L", "second point less first"),
    "spatial": ("L", "straight through space"),
    "overlap": ("%", "of the known heights, after registration"),
    "residual sigma": ("L", "robust spread of the difference"),
    "volume lost": ("L3", "lower than before by more than 3 residual sigma"),
    "volume gained": ("L3", "higher than before by more than 3 residual sigma"),
    "deepest loss": ("L", "99.9th percentile"),
    "lateral shift": ("L", "of the other map's middle"),
    "turn": ("deg", "in the image plane"),
}
_NOTABLE_NOISE = 0.1
_NOTABLE_UNKNOWN = 0.05
_LENGTHS_PER_FIELD = 5


@dataclass(frozen=True)
class Figure:
    """One measured value. `unit` is "" for a plain number; `sigma` and `noise_bias` are NaN where they are unknown.

    `noise_bias` is by how much the noise of the heights has made the value larger, about.
    """

    group: str
    name: str
    value: float
    unit: str
    meaning: str
    sigma: float = math.nan
    noise_bias: float = math.nan


def figures_of(
    group: str, values: Mapping[str, float], unit: LengthUnit, estimates: Mapping[str, Estimate] | None = None
) -> tuple[Figure, ...]:
    """Return named values as figures, with the uncertainty of those of which `estimates` knows "group/name"."""
    figures = []
    for name, value in values.items():
        dimension, meaning = _FIGURES[name]
        known = (estimates or {}).get(f"{group}/{name}", Estimate(value))
        written = dimension.replace("L3", f"{unit}³").replace("L2", f"{unit}²").replace("L", unit)
        figures.append(Figure(group, name, float(value), written, meaning, known.sigma, known.noise_bias))
    return tuple(figures)


def surface_warnings(
    figures: tuple[Figure, ...],
    matched: FloatArray,
    inside: BoolArray,
    resolution: LateralResolution,
    options: MeasureOptions,
    *,
    pixel: float,
    unit: LengthUnit,
    n_outliers: int,
) -> tuple[str, ...]:
    """Return what limits the figures of a surface, each with its numbers."""
    value = {figure.name: figure for figure in figures}
    warnings = []
    if unit == "px":
        warnings.append("the run has no pixel size: all lengths, filters too, are in px")
    limit = f"{resolution.period:.4g} {unit}"
    if not options.s_filter_um >= resolution.period:
        what = (
            "there is no S-filter"
            if math.isnan(options.s_filter_um)
            else f"the S-filter of {options.s_filter_um:g} {unit} is finer than the lateral resolution"
        )
        warnings.append(
            f"{what}: the matching passes half the height at {limit} and less below, so Sa, Sq, Sdq and Sdr lack "
            f"finer relief and hold noise instead; give --s-filter-um {_rounded_up(resolution.period)} or more"
        )
    noise = value["Sq"].noise_bias
    if noise > _NOTABLE_NOISE * value["Sq"].value:
        warnings.append(
            f"the noise of the heights makes Sq larger by about {noise:.2g} {unit} of {value['Sq'].value:.3g} {unit}, "
            "and Sa, Sdq and Sdr too; a wider S-filter lowers that"
        )
    if math.isnan(value["Sq"].sigma):
        warnings.append("no uncertainties: the run does not state that of its heights or of its height scale")
    unknown = 1 - float(np.isfinite(matched[inside]).mean())
    if unknown > _NOTABLE_UNKNOWN:
        warnings.append(
            f"{unknown:.0%} of the field is unknown and left out; what is hidden there is not in the figures"
        )
    if n_outliers:
        warnings.append(
            f"{n_outliers} outliers ({n_outliers / np.count_nonzero(inside):.2%} of the field) were set unknown"
        )
    shorter = (min(matched.shape) - 1) * pixel
    if math.isnan(value["Str"].value):
        warnings.append("no Str: in some direction the autocorrelation stays above 0.2 over half the field")
    if math.isnan(value["Sal"].value) or value["Sal"].value * _LENGTHS_PER_FIELD > shorter:
        warnings.append(
            f"the field of {shorter:.4g} {unit} is short for its texture: the parameters stand for it alone"
        )
    if options.l_filter_um > shorter:
        warnings.append(
            f"the L-filter of {options.l_filter_um:g} {unit} is longer than the field of {shorter:.4g} {unit}: it does "
            "little"
        )
    if "vertical" in value and math.isnan(value["vertical"].value):
        warnings.append(
            "no vertical and spatial distance: an end of --distance lies on an unknown height, or outside of what is "
            "measured"
        )
    return (*warnings, *_profile_warnings(value, options.l_filter_um, unit))


def _profile_warnings(value: dict[str, Figure], nesting_index: float, unit: LengthUnit) -> list[str]:
    if "sections" not in value or value["sections"].value >= _LENGTHS_PER_FIELD:
        return []
    if value["sections"].value > 0:
        return [f"Rz comes from {value['sections'].value:.0f} section lengths; ISO 21920-3 asks for 5"]
    return [
        f"no Ra, Rq, Rz and Rt: of a profile of {value['length'].value:.4g} {unit}, half the L-filter of "
        f"{nesting_index:.4g} {unit} falls away at each end, and no section length is left that is known; draw a line "
        f"of {2 * nesting_index:.4g} {unit} at least ({(1 + _LENGTHS_PER_FIELD) * nesting_index:.4g} for the five of "
        "ISO 21920-3), or give a smaller --l-filter-um"
    ]


def _rounded_up(length: float) -> str:
    """Return a length with two digits, not below it."""
    digits = 1 - math.floor(math.log10(length))
    return f"{math.ceil(length * 10**digits) / 10**digits:g}"
