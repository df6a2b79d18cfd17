"""Height maps for Gwyddion: GWY, its own format, and GSF, its simple one. Rows go down, as in the picture."""

from __future__ import annotations

import io

import numpy as np

from semscape.io.metres import heights_in_metres
from semscape.types import HeightMap

_TITLE = "semscape height"


def encode_gwy(height_map: HeightMap) -> bytes:
    """Return a height map as GWY: float64 in metres, and a mask over the unknown heights.

    Under the mask stands the median height: Gwyddion knows no NaN, and shows what is under a mask as well.

    Raises
    ------
    BadInputError
        If the map is in px or empty.

    References
    ----------
    Gwyddion user guide, "Gwyddion native format".
    """
    from gwyfile.objects import GwyContainer, GwyDataField, GwySIUnit

    heights, pixel = heights_in_metres(height_map, "GWY")
    unknown = ~np.isfinite(heights)
    rows, columns = heights.shape
    size = {"xreal": columns * pixel, "yreal": rows * pixel, "si_unit_xy": GwySIUnit(unitstr="m")}
    container = GwyContainer()
    container["/0/data/title"] = _TITLE
    container["/0/data"] = GwyDataField(
        np.where(unknown, np.nanmedian(heights), heights), si_unit_z=GwySIUnit(unitstr="m"), **size
    )
    if unknown.any():
        container["/0/mask"] = GwyDataField(unknown.astype(np.float64), si_unit_z=GwySIUnit(unitstr=""), **size)
    buffer = io.BytesIO()
    container.tofile(buffer)
    return buffer.getvalue()


def encode_gsf(height_map: HeightMap) -> bytes:
    """Return a height map as GSF: a text header, then float32 in metres, NaN where unknown.

    Raises
    ------
    BadInputError
        If the map is in px or empty.

    References
    ----------
    Gwyddion user guide, "Gwyddion Simple Field file format".
    """
    heights, pixel = heights_in_metres(height_map, "GSF")
    rows, columns = heights.shape
    fields = {
        "XRes": columns,
        "YRes": rows,
        "XReal": repr(columns * pixel),
        "YReal": repr(rows * pixel),
        "XYUnits": "m",
        "ZUnits": "m",
        "Title": _TITLE,
    }
    header = "Gwyddion Simple Field 1.0\n" + "".join(f"{key} = {value}\n" for key, value in fields.items())
    # One to four zeros: they end the header, and put the data at a multiple of four.
    padding = b"\0" * (4 - len(header) % 4)
    return header.encode("ascii") + padding + heights.astype("<f4").tobytes()
