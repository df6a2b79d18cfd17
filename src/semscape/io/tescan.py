"""TESCAN metadata: TIFF tag 50431, or the `.hdr` file beside the image.

The tag holds blocks, each with its length (4 bytes, little endian), a type (2 bytes) and content: a thumbnail
(JPEG 2000), then texts of `Key=Value` lines. The sidecar of `name.tif` is `name-tif.hdr` or `name.hdr`, with the
sections `[MAIN]` and `[SEM]`. Lengths are in m, voltages in V, angles in deg. `ImageStripSize` is the height of
the data bar in rows. `TiltCorrection` is the angle of the correction, 0 while it is off.
"""

from __future__ import annotations

import math
import struct

from semscape.io.metadata_fields import MetadataFields
from semscape.io.quantities import PLAIN, RAD_PER_ANGLE, UM_PER_LENGTH
from semscape.io.vendor_text import decode_text, ini_values
from semscape.types import SemMetadata

TAG = 50431

_THUMBNAIL_BLOCK = 1
_SECTIONS = ("", "MAIN.", "SEM.", "FIB.")


def tescan_tag_text(data: bytes) -> str:
    r"""Return the texts of tag 50431, without the thumbnail.

    Examples
    --------
    >>> text = b"WD=5e-3\r\n\0"
    >>> tescan_tag_text((2 + len(text)).to_bytes(4, "little") + b"\3\0" + text)
    'WD=5e-3\r\n'
    """
    texts = []
    position = 0
    while position + 6 <= len(data):
        length, kind = struct.unpack_from("<IH", data, position)
        end = position + 4 + length
        if length < 2 or end > len(data):
            break
        if kind != _THUMBNAIL_BLOCK:
            texts.append(data[position + 6 : end])
        position = end
    if not any(b"=" in text for text in texts):
        # Not the blocks that are known: take what follows the thumbnail's end marker.
        texts = [data[data.rfind(b"\xff\xd9") + 2 :] if b"\xff\xd9" in data else data]
    return "\n".join(decode_text(text) for text in texts if b"=" in text)


def parse_tescan(
    text: str, image_shape: tuple[int, int], place: str = f"tag {TAG}"
) -> tuple[SemMetadata, tuple[str, ...]]:
    r"""Return what a TESCAN text says, and a warning for each value that cannot be read.

    Parameters
    ----------
    text : str
        The texts of the tag, or the content of the sidecar.
    image_shape : (int, int)
        Height and width of the stored image in px, data bar included.
    place : str
        Where the text stands, for the fields' origin.

    Examples
    --------
    >>> metadata, _ = parse_tescan("[MAIN]\r\nPixelSizeX=0.00000005\r\n", (768, 1024))
    >>> round(metadata.pixel_size_um, 6)
    0.05
    """
    fields = MetadataFields("TESCAN", ini_values(text), place)
    height, _ = image_shape
    width_um, key = fields.read(_keys("PixelSizeX"), UM_PER_LENGTH, "m")
    fields.take_square_pixel(width_um, fields.read(_keys("PixelSizeY"), UM_PER_LENGTH, "m")[0], key)
    fields.take_stage_tilt(_keys("StageTilt"), "deg", sign_is_known=False)
    fields.take("stage_rotation_rad", _keys("StageRotation"), "deg")
    fields.take("working_distance_um", _keys("WD"), "m")
    fields.take("accelerating_voltage_kv", _keys("HV", "AcceleratorVoltage"), "v")
    fields.take("magnification", _keys("Magnification"))
    fields.take("scan_rotation_rad", _keys("ScanRotation"), "deg")
    correction, key = fields.read(_keys("TiltCorrection"), RAD_PER_ANGLE, "deg")
    if math.isfinite(correction) and correction != 0:
        fields.set_tilt_correction(correction, key)
    for switch in _keys("DynamicFocus"):
        if fields.is_on(switch):
            fields.set_dynamic_focus(switch)
    rows, key = fields.read(_keys("ImageStripSize"), PLAIN)
    fields.set_data_bar_rows(rows, height, key)
    models = [fields.text(key) for key in _keys("Device")]
    return fields.metadata(model=next(filter(None, models), "")), tuple(fields.warnings)


def _keys(*names: str) -> list[str]:
    return [section + name for name in names for section in _SECTIONS]
