"""Height maps as X3P (ISO 25178-72) and SDF (ISO 25178-71), the exchange formats of surface metrology.

Both count rows towards larger y in a right-handed frame, so the map's first row is written last.
"""

from __future__ import annotations

from datetime import datetime

import numpy as np

from semscape import __version__
from semscape.io.metres import heights_in_metres
from semscape.types import HeightMap


def encode_x3p(height_map: HeightMap, created: datetime) -> bytes:
    """Return a height map as X3P: binary float64 in metres, revision ISO5436_2000, which every reader knows.

    Parameters
    ----------
    height_map : HeightMap
        A map with a pixel size.
    created : datetime
        When the heights were made; the format asks for it.

    Raises
    ------
    BadInputError
        If the map is in px or empty.

    References
    ----------
    ISO 25178-72:2017, "Surface texture: Areal - XML file format x3p".
    """
    import x3pio

    heights, pixel = heights_in_metres(height_map, "X3P")
    metadata = x3pio.Metadata(
        date=created,
        creator="semscape",
        # No field is empty: there are readers that stumble over that.
        instrument=x3pio.Instrument("semscape", "tilt series of a scanning electron microscope", "none", __version__),
        probing_system=x3pio.ProbingSystem(x3pio.ProbingType.NON_CONTACTING, "SEM stereo photogrammetry"),
        comment="first row = smallest y; NaN = no data",
    )
    surface = x3pio.Surface.from_array(
        np.ascontiguousarray(heights[::-1]),
        x_scale=pixel,
        y_scale=pixel,
        metadata=metadata,
        storage=x3pio.DataStorage.BINARY,
        revision=x3pio.Revision.ISO5436_2000,
    )
    content: bytes = surface.dumps()
    return content


def encode_sdf(height_map: HeightMap, created: datetime) -> bytes:
    """Return a height map as binary SDF ISO-1.0 with INT32 heights, in steps of the largest height / 2^31.

    Parameters
    ----------
    height_map : HeightMap
        A map with a pixel size.
    created : datetime
        When the heights were made.

    Raises
    ------
    BadInputError
        If the map is in px or empty.

    References
    ----------
    ISO 25178-71:2012, "Surface texture: Areal - Software measurement standards".
    """
    import sdfio

    heights, pixel = heights_in_metres(height_map, "SDF")
    metadata = sdfio.Metadata(
        revision=sdfio.Revision.ISO_1_0,
        manufacturer_id="semscape",
        create_date=created,
        mod_date=created,
        data_type=sdfio.DataType.INT32,
    )
    surface = sdfio.SdfFile.from_array(
        np.ascontiguousarray(heights[::-1]),
        x_scale=pixel,
        y_scale=pixel,
        format=sdfio.FileFormat.BINARY,
        metadata=metadata,
    )
    return surface.dumps()
