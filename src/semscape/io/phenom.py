"""Phenom metadata: XML with the root `FeiImage`, in TIFF tag 34683 or 34680.

Values carry their unit in an attribute: `<pixelWidth unit="nm">`. `databarHeight` is the height of the data bar, 0
without one. Most Phenoms have no tilting stage; one that has (`multiStage`) names its axes. The high voltage may be
written as negative, as it is.
"""

from __future__ import annotations

import math

from semscape.io.metadata_fields import MetadataFields
from semscape.io.quantities import KV_PER_VOLTAGE, PLAIN, RAD_PER_ANGLE, UM_PER_LENGTH
from semscape.io.vendor_text import xml_values
from semscape.types import SemMetadata

_ROOT = "FeiImage."
_SCAN = _ROOT + "acquisition.scan."
_STAGE = _ROOT + "multiStage.axis"


def is_phenom(text: str) -> bool:
    """Tell whether a text is a Phenom's."""
    return "<FeiImage" in text


def parse_phenom(text: str, image_height: int, place: str = "tag 34683") -> tuple[SemMetadata, tuple[str, ...]]:
    """Return what a Phenom's XML says, and a warning for each value that cannot be read.

    Parameters
    ----------
    text : str
        Content of the tag.
    image_height : int
        Height of the stored image in px, data bar included.
    place : str
        Where the text stands, for the fields' origin.

    Examples
    --------
    >>> text = '<FeiImage><pixelWidth unit="nm">52.1</pixelWidth></FeiImage>'
    >>> round(parse_phenom(text, 1024)[0].pixel_size_um, 6)
    0.0521
    """
    fields = MetadataFields("Phenom", xml_values(text), place)
    width_um, key = _length(fields, _ROOT + "pixelWidth")
    fields.take_square_pixel(width_um, _length(fields, _ROOT + "pixelHeight")[0], key)
    fields.set("working_distance_um", *_length(fields, _ROOT + "workingDistance", _SCAN + "workingDistance"))
    for key in (_SCAN + "highVoltage", _ROOT + "highVoltage"):
        voltage, found = fields.read(key, KV_PER_VOLTAGE, fields.text(key + "@unit").lower() or "v")
        fields.set("accelerating_voltage_kv", abs(voltage), found)
    fields.take("magnification", (_ROOT + "magnification", _SCAN + "magnification"))
    for key in (_SCAN + "scanRotation", _SCAN + "rotation"):
        rotation, found = fields.read(key, RAD_PER_ANGLE, fields.text(key + "@unit").lower() or "deg")
        fields.set("scan_rotation_rad", rotation, found)
    for axis in [_STAGE, *(f"{_STAGE}#{number}" for number in range(2, 8))]:
        unit = fields.text(axis + "@unit").lower() or "deg"
        match fields.text(axis + "@id").lower():
            case "tilt" | "t":
                fields.take_stage_tilt(axis, unit, sign_is_known=False)
            case "rotation" | "r":
                fields.take("stage_rotation_rad", axis, unit)
    rows, key = fields.read(_ROOT + "databarHeight", PLAIN)
    fields.set_data_bar_rows(rows, image_height, key)
    models = (fields.text(_ROOT + "instrument." + key) for key in ("edition", "type"))
    return fields.metadata(model=next(filter(None, models), "")), tuple(fields.warnings)


def _length(fields: MetadataFields, *keys: str) -> tuple[float, str]:
    for key in keys:
        if fields.text(key):
            unit = fields.text(key + "@unit").lower()
            if not unit:
                fields.warn(f"{key} has no unit; it is taken as unknown")
                return math.nan, ""
            return fields.read(key, UM_PER_LENGTH, unit)
    return math.nan, ""
