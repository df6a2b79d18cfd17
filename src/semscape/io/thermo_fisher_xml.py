"""Thermo Fisher metadata as XML: TIFF tag 34683 with the root `Metadata`, beside or instead of the INI text.

Lengths are in m, angles in rad, voltages in V. `SamplePreTiltAngle` is added to the stage tilt by the microscope's
tilt correction; it is no stage tilt.
"""

from __future__ import annotations

import math

from semscape.io.metadata_fields import MetadataFields
from semscape.io.quantities import PLAIN, RAD_PER_ANGLE, UM_PER_LENGTH
from semscape.io.vendor_text import xml_values
from semscape.types import SemMetadata

TAG = 34683

_STAGE = "Metadata.StageSettings.StagePosition."
_PIXEL = "Metadata.BinaryResult.PixelSize."
_PLAIN_PREFIX = {"", "0", "1"}


def parse_thermo_fisher_xml(text: str, image_shape: tuple[int, int]) -> tuple[SemMetadata, tuple[str, ...]]:
    """Return what Thermo Fisher's XML says, and a warning for each value that cannot be read.

    Parameters
    ----------
    text : str
        Content of tag 34683.
    image_shape : (int, int)
        Height and width of the stored image in px, data bar included.

    Examples
    --------
    >>> text = "<Metadata><Optics><WorkingDistance>0.004</WorkingDistance></Optics></Metadata>"
    >>> parse_thermo_fisher_xml(text, (884, 1024))[0].working_distance_um
    4000.0
    """
    fields = MetadataFields("Thermo Fisher", xml_values(text), f"tag {TAG}")
    width_um, key = _pixel_side(fields, "X")
    fields.take_square_pixel(width_um, _pixel_side(fields, "Y")[0], key)
    height, width = image_shape
    fields.warn_if_resized(fields.read("Metadata.BinaryResult.ImageSize.X", PLAIN)[0], width)
    fields.take_stage_tilt(_STAGE + "Tilt.Alpha", "rad", sign_is_known=True)
    fields.take("stage_rotation_rad", _STAGE + "Rotation", "rad")
    fields.take("working_distance_um", "Metadata.Optics.WorkingDistance", "m")
    fields.take("accelerating_voltage_kv", "Metadata.Optics.AccelerationVoltage", "v")
    fields.take("scan_rotation_rad", "Metadata.ScanSettings.ScanRotation", "rad")
    if fields.is_on("Metadata.Optics.SampleTiltCorrectionOn"):
        _take_tilt_correction(fields)
    stored, key = fields.read("Metadata.BinaryResult.ImageSize.Y", PLAIN)
    fields.set_data_bar_rows(height - stored, height, key)
    return fields.metadata(model=fields.text("Metadata.Instrument.InstrumentClass")), tuple(fields.warnings)


def _pixel_side(fields: MetadataFields, side: str) -> tuple[float, str]:
    key = _PIXEL + side
    power = fields.text(key + "@unitPrefixPower")
    if power not in _PLAIN_PREFIX:
        fields.warn(f"{key} has the unit prefix power {power!r}, which is not known; it is taken as unknown")
        return math.nan, ""
    return fields.read(key, UM_PER_LENGTH, fields.text(key + "@unit") or "m")


def _take_tilt_correction(fields: MetadataFields) -> None:
    """Set the angle of the correction: the pre-tilt together with the stage's."""
    tilt, _ = fields.read(_STAGE + "Tilt.Alpha", RAD_PER_ANGLE, "rad")
    pre_tilt, _ = fields.read("Metadata.Optics.SamplePreTiltAngle", RAD_PER_ANGLE, "rad")
    angle = tilt if math.isnan(pre_tilt) or pre_tilt == 0 else math.nan
    fields.set_tilt_correction(angle, "Metadata.Optics.SampleTiltCorrectionOn")
    fields.set("tilt_correction_axis_rad", 0.0, "Metadata.Optics.SampleTiltCorrectionOn")
