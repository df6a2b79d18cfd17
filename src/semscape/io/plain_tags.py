"""Pixel sizes that no microscope wrote: ImageJ's and OME's descriptions, and bare resolution tags.

A bare resolution (TIFF, JPEG, PNG or EXIF) is nearly always that of a screen or a printer. It is taken last, only
where it means a pixel of a few um at most, and marked as doubtful.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from semscape.io.metadata_fields import MetadataFields
from semscape.io.quantities import UM_PER_LENGTH
from semscape.io.vendor_text import xml_values
from semscape.types import SemMetadata

# Coarser than this, 1270 px per inch, are screens, printers and scanners.
_LARGEST_DOUBTFUL_UM = 20.0
_UM_PER_UNIT = UM_PER_LENGTH | {"micron": 1.0, "microns": 1.0, "inch": 25_400.0, "in": 25_400.0}


@dataclass(frozen=True)
class PlainTags:
    """What an image file itself says: its description, and its resolution in px per `resolution_unit_um`.

    `resolution_unit_um` is NaN where the resolution has no unit of its own, 0 px per unit means that none is told.
    """

    description: str = ""
    px_per_unit_x: float = 0.0
    px_per_unit_y: float = 0.0
    resolution_unit_um: float = math.nan
    resolution_origin: str = "resolution tags"


def parse_plain_tags(tags: PlainTags) -> tuple[SemMetadata, tuple[str, ...]]:
    r"""Return the pixel size of a file without any microscope's header, and warnings.

    Examples
    --------
    >>> tags = PlainTags("ImageJ=1.53t\nunit=micron\n", px_per_unit_x=20.0, px_per_unit_y=20.0)
    >>> metadata, _ = parse_plain_tags(tags)
    >>> metadata.pixel_size_um, metadata.vendor, metadata.source["pixel_size_um"]
    (0.05, 'unknown', 'file')
    """
    for parse in (_parse_image_j, _parse_ome):
        fields = parse(tags)
        if fields is not None:
            return fields.metadata(), tuple(fields.warnings)
    fields = MetadataFields("unknown", {}, tags.resolution_origin)
    size_um = _pixel_um(tags.px_per_unit_x, tags.resolution_unit_um)
    if not 0 < size_um <= _LARGEST_DOUBTFUL_UM:
        return fields.metadata(), ()
    fields.raw["XResolution"] = f"{tags.px_per_unit_x:.9g} px per {tags.resolution_unit_um:g} um"
    fields.take_square_pixel(size_um, _pixel_um(tags.px_per_unit_y, tags.resolution_unit_um), "XResolution")
    fields.warn(
        f"the pixel size of {size_um:.6g} um comes from its bare {tags.resolution_origin}, which seldom hold a "
        "microscope's: it is doubtful; give the true one if you know it"
    )
    return fields.metadata(source="doubtful"), tuple(fields.warnings)


def _pixel_um(px_per_unit: float, unit_um: float) -> float:
    return unit_um / px_per_unit if px_per_unit > 0 else math.nan


def _parse_image_j(tags: PlainTags) -> MetadataFields | None:
    if not tags.description.startswith("ImageJ="):
        return None
    raw = {}
    for line in tags.description.splitlines():
        key, equals, value = line.partition("=")
        if equals:
            raw[f"ImageJ.{key.strip()}"] = value.strip()
    fields = MetadataFields("unknown", raw, "ImageJ description")
    unit = fields.text("ImageJ.unit").replace("\\u00B5", "µ").lower()
    if unit in _UM_PER_UNIT:
        width_um = _pixel_um(tags.px_per_unit_x, _UM_PER_UNIT[unit])
        fields.take_square_pixel(width_um, _pixel_um(tags.px_per_unit_y, _UM_PER_UNIT[unit]), "unit and XResolution")
    elif unit and unit not in {"pixel", "pixels", "px"}:
        fields.warn(f"ImageJ's unit {unit[:40]!r} is not known; the pixel size is taken as unknown")
    return fields


def _parse_ome(tags: PlainTags) -> MetadataFields | None:
    if not re.search(r"<(?:\w+:)?OME[\s>]", tags.description[:2000]):
        return None
    values = xml_values(tags.description)
    raw = {key: value for key, value in values.items() if ".Pixels@" in key or ".Description" in key}
    fields = MetadataFields("unknown", raw, "OME description")
    if not values:
        fields.warn("the OME description is no XML that can be read; the pixel size is taken as unknown")
    sides = [_ome_side(fields, side) for side in "XY"]
    fields.take_square_pixel(sides[0][0], sides[1][0], sides[0][1])
    return fields


def _ome_side(fields: MetadataFields, side: str) -> tuple[float, str]:
    key = f"OME.Image.Pixels@PhysicalSize{side}"
    return fields.read(key, UM_PER_LENGTH, (fields.text(key + "Unit") or "um").replace("μ", "µ").lower())
