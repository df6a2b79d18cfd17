"""The height parameters of ISO 25178-2 of a run's surface, as a section of its report."""

from __future__ import annotations

import numpy as np

from semscape.errors import NoAnswerError
from semscape.metrology.areal import developed_area_ratio, height_parameters, root_mean_square_slope
from semscape.metrology.level import level
from semscape.report.markup import table, with_sigma
from semscape.report.wording import UNIT_SIGNS, number
from semscape.types import Result

_MEANINGS = {
    "Sa": "mean height",
    "Sq": "root mean square height",
    "Ssk": "skewness",
    "Sku": "kurtosis",
    "Sp": "highest peak",
    "Sv": "deepest pit",
    "Sz": "from pit to peak",
    "Sdq": "root mean square slope",
    "Sdr": "developed beyond projected area",
}
_WITHOUT_LENGTH = {"Ssk": "", "Sku": "", "Sdq": "", "Sdr": "%"}


def texture_section(result: Result) -> str:
    """Return the parameters of the whole surface with a least-squares plane taken off; "" where no height is known.

    The stated sigma is the height scale's alone; `semscape measure` states the whole.
    """
    height_map, relative = result.height_map, result.reconstruction.height_scale_relative_sigma
    try:
        levelled = level(height_map.height_um, height_map.pixel_size_um).height
        values = height_parameters(levelled)
        values["Sdq"] = root_mean_square_slope(levelled, height_map.pixel_size_um)
        values["Sdr"] = developed_area_ratio(levelled, height_map.pixel_size_um)
    except NoAnswerError:
        return ""
    sign = UNIT_SIGNS[height_map.length_unit]
    rows = []
    for name, value in values.items():
        is_length = name not in _WITHOUT_LENGTH
        sigma = abs(value) * relative if is_length and np.isfinite(relative) else None
        known = value if np.isfinite(value) else None
        text = with_sigma(known, sigma) if sigma else number(known)
        rows.append([f"{name}, {_MEANINGS[name]}", text, sign if is_length else _WITHOUT_LENGTH[name]])
    return (
        f"<section><h2>Surface texture (ISO 25178-2)</h2>{table(['Parameter', 'Value', 'Unit'], rows)}"
        '<p class="quiet">Of all known heights, a least-squares plane taken off, no filter. ± is the 1 σ of the height '
        "scale alone; <code>semscape measure RUN</code> filters, and states the whole uncertainty.</p></section>"
    )
