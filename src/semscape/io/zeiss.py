"""Zeiss SmartSEM metadata: the text of TIFF tag 34118, which also survives in the EXIF block of edited JPEGs.

After a head of bare numbers the text holds pairs of lines: a key (`AP_WD`) and `label = value unit`
(`WD = 5.2 mm`). The traps:

- values switch between nm and um, and magnifications between `105 X` and `1.50 K X`;
- `AP_IMAGE_PIXEL_SIZE` belongs to the stored image, `AP_PIXEL_SIZE` to a display 1024 px wide;
- `AP_TILT_ANGLE` is the angle of the tilt *correction*, `AP_STAGE_AT_T` the tilt of the stage;
- `AP_SCANROTATION` and `AP_TILT_ANGLE` keep their last value while `DP_SCAN_ROT`, `DP_TILT_CORRECTION` are off.

Sign of the tilt: at scan rotation 0 a SmartSEM stage tilts about the image's horizontal axis, and a positive
reading turns the surface's normal towards the top of the image (pillars lean upwards). That is assumed here;
it is a negative rotation about +x in semscape's convention. The axis itself is left unknown.
"""

from __future__ import annotations

import math
import re

from semscape.io.metadata_fields import MetadataFields
from semscape.types import SemMetadata

TAG = 34118
TILT_SIGN = -1.0

_DISPLAY_WIDTH_PX = 1024
_KEY = re.compile(r"(?:AP|DP|SV)_[A-Z0-9_]+")
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?$")
_UM_PER = {"fm": 1e-9, "pm": 1e-6, "nm": 1e-3, "um": 1.0, "µm": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6}
_DEG = math.pi / 180
_RAD_PER = {"°": _DEG, "deg": _DEG, "degrees": _DEG, "?": _DEG, "\ufffd": _DEG, "": _DEG, "rad": 1.0}  # lost signs
_KV_PER = {"v": 1e-3, "kv": 1.0}
_TIMES_PER = {"x": 1.0, "kx": 1e3, "mx": 1e6, "": 1.0}


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
    >>> round(metadata.pixel_size_um, 5), metadata.source["pixel_size_um"]
    (0.07443, 'file')
    """
    raw = _key_lines(_repair_units(text))
    fields = MetadataFields("Zeiss", raw)

    def read(key: str, units: dict[str, float]) -> float:
        return _quantity(fields, key, units)

    store_width = _store_width(raw)
    pixel_size = read("AP_IMAGE_PIXEL_SIZE", _UM_PER)
    if math.isnan(pixel_size):
        pixel_size = read("AP_PIXEL_SIZE", _UM_PER) * _DISPLAY_WIDTH_PX / (store_width or image_width)
    fields.set_positive("pixel_size_um", pixel_size)
    if store_width and store_width != image_width:
        fields.warn(
            f"the image is {image_width} px wide, but the microscope stored {store_width} px: it was cropped or "
            "resized, and after resizing the pixel size in its header is wrong; give the true one if so"
        )
    fields.set("tilt_rad", TILT_SIGN * read("AP_STAGE_AT_T", _RAD_PER))
    fields.set("stage_rotation_rad", read("AP_STAGE_AT_R", _RAD_PER))
    fields.set_positive("working_distance_um", read("AP_WD", _UM_PER))
    voltage = read("AP_ACTUALKV", _KV_PER)
    fields.set_positive("accelerating_voltage_kv", read("AP_MANUALKV", _KV_PER) if math.isnan(voltage) else voltage)
    fields.set_positive("magnification", read("AP_MAG", _TIMES_PER))
    if "DP_SCAN_ROT" in raw:
        fields.set("scan_rotation_rad", read("AP_SCANROTATION", _RAD_PER) if _is_on(raw["DP_SCAN_ROT"]) else 0.0)
    if _is_on(raw.get("DP_TILT_CORRECTION", "")):
        fields.set("tilt_correction_rad", read("AP_TILT_ANGLE", _RAD_PER))
    return fields.metadata(), tuple(fields.warnings)


def _repair_units(text: str) -> str:
    """Undo the ways in which editors and encodings mangle the micro and degree signs."""
    return text.replace("Â", "").replace("\u03bc", "µ").replace("\u00ba", "°")


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


def _value(line: str) -> str:
    return line.partition("=")[2].strip()


def _is_on(line: str) -> bool:
    return _value(line).lower() in {"on", "yes", "true"}


def _store_width(raw: dict[str, str]) -> int:
    match = re.match(r"(\d+)\s*\*\s*\d+", _value(raw.get("DP_IMAGE_STORE", "")))
    return int(match.group(1)) if match else 0


def _quantity(fields: MetadataFields, key: str, units: dict[str, float]) -> float:
    line = fields.raw.get(key, "")
    if not _value(line):
        return math.nan
    match = _QUANTITY.match(_value(line))
    unit = (match.group(2) or "").replace(" ", "").lower() if match else ""
    if match is None or unit not in units:
        fields.warn(f"{key} holds {line!r}, which is no number with a known unit; it is taken as unknown")
        return math.nan
    return float(match.group(1).replace(",", ".")) * units[unit]
