"""Hitachi metadata: the `.txt` file beside the image with the section `[SemImageFile]`.

New microscopes (TM4000, Regulus) write UTF-16, older ones (S-4800) plain ASCII. `PixelSize` is in nm, other
lengths carry their unit or are in um, `AcceleratingVoltage` is in V, angles are in deg. Texts without `PixelSize`
(S-4700) leave the magnification, which counts on a photograph 127 mm wide: `PixelSize` x width x `Magnification` of a
TM4000 is 127.00 mm. `RasterRotation` is stored whether it is on or off, and nothing says which, so a value other than
0 is not taken.
"""

from __future__ import annotations

import math
import re

from semscape.io.metadata_fields import MetadataFields
from semscape.io.quantities import PLAIN, RAD_PER_ANGLE
from semscape.io.vendor_text import ini_values
from semscape.types import SemMetadata

_SECTION = "SemImageFile."
_PHOTOGRAPH_UM = 127e3


def is_hitachi(text: str) -> bool:
    """Tell whether a text is a Hitachi sidecar."""
    return "[SemImageFile]" in text


def parse_hitachi(
    text: str, image_shape: tuple[int, int], place: str = "sidecar"
) -> tuple[SemMetadata, tuple[str, ...]]:
    r"""Return what a Hitachi sidecar says, and a warning for each value that cannot be read.

    Parameters
    ----------
    text : str
        Content of the sidecar.
    image_shape : (int, int)
        Height and width of the stored image in px.
    place : str
        Name of the sidecar, for the fields' origin.

    Examples
    --------
    >>> metadata, _ = parse_hitachi("[SemImageFile]\r\nPixelSize=165.3646\r\n", (960, 1280))
    >>> round(metadata.pixel_size_um, 7)
    0.1653646
    """
    fields = MetadataFields("Hitachi", ini_values(text), place)
    stored = re.match(r"(\d{1,6})\s*[xX*]\s*\d+", fields.text(_SECTION + "DataSize"))
    stored_width = int(stored.group(1)) if stored else 0
    fields.warn_if_resized(stored_width, image_shape[1])
    if fields.text(_SECTION + "PixelSize"):
        fields.take("pixel_size_um", _SECTION + "PixelSize", "nm")
    else:
        fields.take_pixel_size_of_photograph(_SECTION + "Magnification", _PHOTOGRAPH_UM, stored_width or image_shape[1])
    fields.take("working_distance_um", _SECTION + "WorkingDistance", "um")
    fields.take("accelerating_voltage_kv", _SECTION + "AcceleratingVoltage", "v")
    fields.take("magnification", _SECTION + "Magnification")
    fields.take_stage_tilt(_SECTION + "StagePositionT", "deg", sign_is_known=False)
    fields.take("stage_rotation_rad", _SECTION + "StagePositionR", "deg")
    rotation, key = fields.read(_SECTION + "RasterRotation", RAD_PER_ANGLE, "deg")
    if rotation == 0:
        fields.set("scan_rotation_rad", 0.0, key)
    elif math.isfinite(rotation):
        fields.warn(
            f"RasterRotation is {math.degrees(rotation):g} deg, but is stored even when it is off; the scan rotation "
            "is taken as unknown"
        )
    if fields.is_on(_SECTION + "DynamicFocus"):
        fields.set_dynamic_focus(_SECTION + "DynamicFocus")
    switch = _SECTION + "TiltCompensation"
    if fields.is_on(switch) or abs(fields.read(switch, PLAIN)[0]) > 0:
        fields.set_tilt_correction(math.nan, switch)
    return fields.metadata(model=fields.text(_SECTION + "InstructName")), tuple(fields.warnings)
