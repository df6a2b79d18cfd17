"""Detectors of the simulated microscope: one for secondary electrons, or segments for backscattered ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from semscape.types import FloatArray

DETECTORS = {"se": 0, "bse-3": 3, "bse-4": 4}  # kind: number of segments

# Middle of the first segment in the image at scan rotation 0, from +x counter-clockwise.
_FIRST_AZIMUTH_DEG = {3: 90.0, 4: 45.0}


@dataclass(frozen=True)
class Segment:
    """One segment of a ring of backscatter detectors around the beam.

    `azimuth_deg` is its middle in the image, from +x counter-clockwise; it spans 360 / count degrees at the elevation
    `elevation_deg` above the horizontal.
    """

    name: str
    azimuth_deg: float
    span_deg: float
    elevation_deg: float

    @property
    def mean_direction(self) -> FloatArray:
        """Mean (3,) over the segment of the unit vectors towards it, in the frame of the lab: x right, y down, z down.

        The mean over a span of 2 b shortens the horizontal part by sin(b) / b.
        """
        half = math.radians(self.span_deg) / 2
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        level = math.cos(elevation) * math.sin(half) / half
        return np.array([level * math.cos(azimuth), -level * math.sin(azimuth), -math.sin(elevation)])


def segments_of(detector: str, scan_rotation_deg: float, elevation_deg: float) -> tuple[Segment, ...]:
    """Return the segments of a detector, none for secondary electrons.

    Examples
    --------
    >>> [(segment.name, segment.azimuth_deg) for segment in segments_of("bse-3", 0.0, 50.0)]
    [('A', 90.0), ('B', 210.0), ('C', 330.0)]
    """
    count = DETECTORS[detector]
    return tuple(
        Segment(
            "ABCD"[k],
            (_FIRST_AZIMUTH_DEG[count] + scan_rotation_deg + 360.0 * k / count) % 360.0,
            360.0 / count,
            elevation_deg,
        )
        for k in range(count)
    )


def se_direction(azimuth_deg: float, elevation_deg: float) -> FloatArray:
    """Return the unit vector (3,) towards the secondary electron detector, x right, y down, z down."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), -level * math.sin(azimuth), -math.sin(elevation)])
