"""Height maps as Digital Surf SUR, the format of MountainsMap: a header of 512 bytes, then the heights as integers.

Uncompressed, units in Latin-1 (the micro sign is the byte 0xB5). Rows go down, as in the picture.
"""

from __future__ import annotations

import struct
from datetime import datetime

import numpy as np

from semscape.io.metres import heights_in_metres
from semscape.types import HeightMap

_HEADER_BYTES = 512
_UNMEASURED_BELOW_LEAST = 2
_LARGEST_INTEGER = 2**31 - 8
_UNIT = "µm"
_COMMENT = b"semscape height map"


def encode_sur(height_map: HeightMap, created: datetime) -> bytes:
    """Return a height map as SUR with 32-bit heights; a point that is not measured holds the least height - 2.

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
    Digital Surf, "SUR file format", in the reference guide of MountainsMap.
    """
    heights, pixel = heights_in_metres(height_map, "SUR")
    heights_um, pixel_um = heights * 1e6, pixel * 1e6
    # The header holds the step as float32: the integers must be counted in the very step that readers will use.
    step = float(np.nextafter(np.float32(max(np.nanmax(np.abs(heights_um)), 1e-6) / _LARGEST_INTEGER), np.float32(1)))
    known = np.isfinite(heights_um)
    counts = np.rint(np.where(known, heights_um, 0.0) / step).astype(np.int64)
    least, most = int(counts[known].min()), int(counts[known].max())
    data = np.where(known, counts, least - _UNMEASURED_BELOW_LEAST).astype("<i4")
    header = _header(data.shape, least, most, pixel_um, step, has_unmeasured=not known.all(), created=created)
    return header + _COMMENT + data.tobytes()


def _header(
    shape: tuple[int, ...],
    least: int,
    most: int,
    pixel_um: float,
    step_um: float,
    *,
    has_unmeasured: bool,
    created: datetime,
) -> bytes:
    """Return the 512 bytes of the header; the offset of each group stands before it."""
    rows, columns = shape
    unit = _text(_UNIT, 16)
    weekday = created.isoweekday() % 7  # Sunday is 0
    parts = [
        # 0: signature, PC byte order, 1 object, version 1, a surface, names of object and operator
        struct.pack("<12s4h30s30s", b"DIGITAL SURF", 0, 1, 1, 2, _text("semscape height map", 30), _text("", 30)),
        # 80: material, acquisition unknown, range, unmeasured points, absolute heights, 8 reserved, bits of a point
        struct.pack("<5h8xh", 0, 0, 0, int(has_unmeasured), 1, 32),
        # 100: least and largest value, points of a line, lines, points
        struct.pack("<5i", least, most, columns, rows, rows * columns),
        # 120: spacings, names of the axes, units of the spacings, units of the axes, ratios between the two
        struct.pack("<3f", pixel_um, pixel_um, step_um),
        b"".join(_text(name, 16) for name in ("X", "Y", "Z")),
        unit * 6,
        struct.pack("<3f", 1, 1, 1),
        # 288: replica, inverted, levelled, 12 reserved, time of the measurement, its duration, 10 reserved
        struct.pack("<3h12x", 0, 0, 0),
        struct.pack("<7hf10x", created.second, created.minute, created.hour, created.day, created.month, created.year,
                    weekday, 0),
        # 334: bytes of comment and of private zone, 128 for the client, offsets, and 34 for a time axis
        struct.pack("<2h128x3f34x", len(_COMMENT), 0, 0, 0, 0),
    ]  # fmt: skip
    header = b"".join(parts)
    assert len(header) == _HEADER_BYTES
    return header


def _text(text: str, size: int) -> bytes:
    return text.encode("latin-1").ljust(size)
