"""Numbers with units as microscopes write them: `593.3 nm`, `1.50 K X`, `2.5012e-6`, `7892.3 um`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

_DEG = math.pi / 180

# What one of each unit is in semscape's own; keys are lower case without blanks.
UM_PER_LENGTH = {"fm": 1e-9, "pm": 1e-6, "nm": 1e-3, "um": 1.0, "µm": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6}
RAD_PER_ANGLE = {
    "°": _DEG,
    "deg": _DEG,
    "degree": _DEG,
    "degrees": _DEG,
    "?": _DEG,  # a degree sign that an encoding lost
    "\ufffd": _DEG,
    "rad": 1.0,
    "mrad": 1e-3,
}
KV_PER_VOLTAGE = {"v": 1e-3, "volt": 1e-3, "kv": 1.0, "mv": 1e3}
TIMES = {"x": 1.0, "kx": 1e3, "mx": 1e6, "": 1.0}
PLAIN = {"": 1.0}
PIXEL_SIZES = "from 1e-07 to 1000"
"""Pixel sizes in um that a microscope of any kind may have; what is beyond is a mistake, or overflows later."""

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?$")
_PIXEL_SIZE_LIMITS_UM = (1e-7, 1000.0)
_LONGEST = 100  # characters of a text that can still be a number with its unit


def is_pixel_size(value_um: float) -> bool:
    """Tell whether a pixel may have this size.

    Examples
    --------
    >>> is_pixel_size(0.05), is_pixel_size(5e-324)
    (True, False)
    """
    low, high = _PIXEL_SIZE_LIMITS_UM
    return low <= value_um <= high


def parse_quantity(text: str, units: Mapping[str, float], bare: str = "") -> float:
    """Return a text's number in the unit that `units` converts to.

    Parameters
    ----------
    text : str
        A number and its unit; the decimal sign may be a comma.
    units : mapping of str to float
        Factor of each unit that may follow.
    bare : str
        The unit of a number that stands alone.

    Raises
    ------
    ValueError
        For a text that is no finite number with a known unit.

    Examples
    --------
    >>> parse_quantity("500 nm", UM_PER_LENGTH), parse_quantity("2,5", UM_PER_LENGTH, bare="mm")
    (0.5, 2500.0)
    """
    match = _QUANTITY.match(repair_units(text)) if len(text) <= _LONGEST else None
    if match is None:
        raise ValueError(f"{text[:_LONGEST]!r} is no number")
    unit = (match.group(2) or bare).replace(" ", "").lower()
    value = float(match.group(1).replace(",", ".")) * units.get(unit, math.nan)
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is no finite number with a known unit")
    return value


def repair_units(text: str) -> str:
    """Undo the ways in which editors and encodings mangle the micro and degree signs."""
    repaired = text.replace("ƒÊ", "µ").replace("Â", "").replace("\u03bc", "µ").replace("\u00ba", "°")
    return repaired.strip().strip("\0")
