"""Zeiss SmartSEM metadata: the text of TIFF tag 34118, which also survives in the EXIF block of edited JPEGs.

After a head of bare numbers the text holds pairs of lines: a key (`AP_WD`) and `label = value unit`
(`WD = 5.2 mm`). The traps:

- values switch between nm and um, and magnifications between `105 X` and `1.50 K X`;
- `AP_IMAGE_PIXEL_SIZE` belongs to the stored image, `AP_PIXEL_SIZE` to a display 1024 px wide;
- `AP_TILT_ANGLE` is the angle of the tilt *correction*, `AP_STAGE_AT_T` the tilt of the stage;
- `AP_SCANROTATION` and `AP_TILT_ANGLE` keep their last value while `DP_SCAN_ROT`, `DP_TILT_CORRECTION` are off.

`AP_TILT_AXIS` is the direction of the stage's tilt axis in the image at scan rotation 0, and the axis across which
tilt correction stretches: 0 deg is horizontal (beside it stands `Stage Tilt = In Y`), 90 deg vertical (`in X`). A
measured series of an Auriga whose header says 90 deg has its axis at 90.4 +- 0.3 deg, from the images alone. Headers
without `AP_TILT_AXIS` say `In Y` or `in X`, or nothing: then the axis is taken as horizontal.

About a horizontal axis a positive reading turns the surface's normal towards the top of the image (pillars lean
upwards). About a vertical one it is assumed to turn it to the left, as if image and stage were turned together by a
quarter; no file says so.
"""

from __future__ import annotations

import math
import re

from semscape.io.metadata_fields import TILT_SIGN, MetadataFields
from semscape.io.quantities import RAD_PER_ANGLE, UM_PER_LENGTH, repair_units
from semscape.types import SemMetadata

__all__ = ["TAG", "TILT_SIGN", "parse_zeiss"]

TAG = 34118

_DISPLAY_WIDTH_PX = 1024
_KEY = re.compile(r"(?:AP|DP|SV)_[A-Z0-9_]+")
_HORIZONTAL, _VERTICAL = 0.0, math.pi / 2
_AXIS_OF_STAGE = {"in y": _HORIZONTAL, "in x": _VERTICAL}


def parse_zeiss(text: str, image_width: int) -> tuple[SemMetadata, tuple[str, ...]]:
    r"""Return what a SmartSEM text says, and a warning for each value that cannot be read.

    Parameters
    ----------
    text : str
        Content of tag 34118.
    image_width : int
        Width of the image in px, for files that only give the pixel size of the display.

    Examples
    --------
    >>> metadata, _ = parse_zeiss("AP_IMAGE_PIXEL_SIZE\r\nImage Pixel Size = 74.43 nm\r\n", 1024)
    >>> round(metadata.pixel_size_um, 5), metadata.origin["pixel_size_um"]
    (0.07443, 'tag 34118, AP_IMAGE_PIXEL_SIZE')
    """
    raw = _key_lines(repair_units(text))
    values = {key: line.partition("=")[2].strip() for key, line in raw.items()}
    fields = MetadataFields("Zeiss", raw, f"tag {TAG}", values)

    store_width = _store_width(fields.text("DP_IMAGE_STORE"))
    pixel_size, key = fields.read("AP_IMAGE_PIXEL_SIZE", UM_PER_LENGTH)
    if math.isnan(pixel_size):
        pixel_size, key = fields.read("AP_PIXEL_SIZE", UM_PER_LENGTH)
        pixel_size *= _DISPLAY_WIDTH_PX / (store_width or image_width)
    fields.set("pixel_size_um", pixel_size, key)
    fields.warn_if_resized(store_width, image_width)
    tilt_axis, axis_key = _tilt_axis(fields)
    fields.take_stage_tilt(
        "AP_STAGE_AT_T",
        "deg",
        sign_is_known=math.isnan(tilt_axis) or tilt_axis == _HORIZONTAL,
        leans="to the left" if tilt_axis == _VERTICAL else "up",
    )
    fields.take("stage_rotation_rad", "AP_STAGE_AT_R", "deg")
    fields.take("working_distance_um", "AP_WD")
    fields.take("accelerating_voltage_kv", ("AP_ACTUALKV", "AP_MANUALKV"))
    fields.take("magnification", "AP_MAG")
    if fields.is_on("DP_SCAN_ROT"):
        fields.take("scan_rotation_rad", "AP_SCANROTATION", "deg")
    elif fields.text("DP_SCAN_ROT"):
        fields.set("scan_rotation_rad", 0.0, "DP_SCAN_ROT")
    if fields.is_on("DP_TILT_CORRECTION"):
        fields.set_tilt_correction(*fields.read("AP_TILT_ANGLE", RAD_PER_ANGLE, "deg"))
        if tilt_axis in (_HORIZONTAL, _VERTICAL):
            fields.set("tilt_correction_axis_rad", tilt_axis, axis_key)
    if fields.is_on("DP_DYNFOCUS"):
        fields.set_dynamic_focus("DP_DYNFOCUS")
    return fields.metadata(model=fields.text("DP_SEM")), tuple(fields.warnings)


def _tilt_axis(fields: MetadataFields) -> tuple[float, str]:
    """Return the direction of the tilt axis in rad and the tag that says so; NaN where none does."""
    axis, key = fields.read("AP_TILT_AXIS", RAD_PER_ANGLE, "deg")
    if math.isnan(axis):
        axis, key = _AXIS_OF_STAGE.get(fields.text("DP_STAGE_TILTED").lower(), math.nan), "DP_STAGE_TILTED"
    return axis, key


def _key_lines(text: str) -> dict[str, str]:
    """Return {key: the whole line under it}, and the numbers above the first key as "header"."""
    lines = [line.strip("\0 \t") for line in text.splitlines()]
    raw: dict[str, str] = {}
    header = []
    i = 0
    while i < len(lines):
        if _KEY.fullmatch(lines[i]):
            follows = i + 1 < len(lines) and not _KEY.fullmatch(lines[i + 1])
            raw[lines[i]] = lines[i + 1] if follows else ""
            i += 1 + follows
        else:
            if not raw:
                header.append(lines[i])
            i += 1
    return {"header": " ".join(header), **raw} if raw else {}


def _store_width(store: str) -> int:
    match = re.match(r"(\d{1,6})\s*\*\s*\d+", store)
    return int(match.group(1)) if match else 0
