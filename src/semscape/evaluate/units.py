"""One error in the three units in which it is told."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Units:
    """What an error is measured against: the pixel size of the grid and the relief of the truth.

    Parameters
    ----------
    pixel_size_um : float
        Length of one px.
    relief_um : float
        Height range of the truth, lowest to highest point.
    """

    pixel_size_um: float
    relief_um: float

    def told(self, name: str, length_um: float) -> dict[str, float]:
        """Return a length as `name_um`, `name_px` and `name_percent_of_relief`, rounded; NaN stays NaN.

        Examples
        --------
        >>> Units(pixel_size_um=0.1, relief_um=20.0).told("rmse", 0.05)
        {'rmse_um': 0.05, 'rmse_px': 0.5, 'rmse_percent_of_relief': 0.25}
        """
        percent = 100 * length_um / self.relief_um if self.relief_um > 0 else math.nan
        return {
            f"{name}_um": rounded(length_um, 5),
            f"{name}_px": rounded(length_um / self.pixel_size_um, 5),
            f"{name}_percent_of_relief": rounded(percent, 5),
        }


def rounded(value: float, digits: int) -> float:
    """Return a number with so many significant digits: what a table needs, and no more.

    Examples
    --------
    >>> rounded(0.0123456, 3), rounded(-1234.5678, 6), rounded(0.0, 3)
    (0.0123, -1234.57, 0.0)
    """
    return float(f"{float(value):.{digits}g}")
