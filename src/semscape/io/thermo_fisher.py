"""Thermo Fisher (FEI) metadata: the INI text of TIFF tag 34682, or 34680 in older files.

The traps: `StageT`, `StageR` and `ScanRotation` are in rad, lengths (`PixelWidth`, `WorkingDistance`) in m, `HV`
in V; `DatabarHeight` may be 0 although a bar is burnt in, so the stored height less `ResolutionY` goes first;
the header states no magnification that does not depend on the size of a screen, so none is read.

Sign of the tilt: at scan rotation 0 the stage tilts about the image's horizontal axis, and a positive
reading turns the surface's normal towards the top of the image (towards the ion column of a DualBeam; pillars
lean upwards). That is assumed here; it is a negative rotation about +x in semscape's convention. The axis
itself is left unknown.
"""

from __future__ import annotations

import math

from semscape.io.metadata_fields import MetadataFields
from semscape.types import SemMetadata

TAGS = (34682, 34680)
TILT_SIGN = -1.0

_UM_PER_M = 1e6
_ANISOTROPY_LIMIT = 1e-3
_MAX_BAR_SHARE = 0.4


def parse_thermo_fisher(text: str, image_shape: tuple[int, int]) -> tuple[SemMetadata, tuple[str, ...]]:
    r"""Return what an FEI text says, and a warning for each value that cannot be read.

    Parameters
    ----------
    text : str
        Content of tag 34682.
    image_shape : (int, int)
        Height and width of the stored image in px, data bar included.

    Examples
    --------
    >>> metadata, _ = parse_thermo_fisher("[Scan]\r\nPixelWidth=2.69792e-007\r\n", (1092, 1536))
    >>> round(metadata.pixel_size_um, 6), metadata.vendor
    (0.269792, 'Thermo Fisher')
    """
    raw = _ini_values(text)
    fields = MetadataFields("Thermo Fisher", raw)
    beam = raw.get("Beam.Beam", "EBeam")
    scan = raw.get("Beam.Scan", "EScan")

    def read(*keys: str) -> float:
        return _first_number(fields, keys)

    pixel_width = read("Scan.PixelWidth", f"{scan}.PixelWidth") * _UM_PER_M
    pixel_height = read("Scan.PixelHeight", f"{scan}.PixelHeight") * _UM_PER_M
    fields.set_positive("pixel_size_um", pixel_width)
    if abs(pixel_height - pixel_width) > _ANISOTROPY_LIMIT * abs(pixel_width):
        fields.warn(f"pixels are {pixel_width:.6g} um wide but {pixel_height:.6g} um high; the width is used")
    height, width = image_shape
    stored_width = read("Image.ResolutionX")
    if stored_width > 0 and stored_width != width:
        fields.warn(
            f"the image is {width} px wide, but the microscope stored {stored_width:.0f} px: it was cropped or "
            "resized, and after resizing the pixel size in its header is wrong; give the true one if so"
        )
    fields.set("tilt_rad", TILT_SIGN * read("Stage.StageT", f"{beam}.StageTa"))
    fields.set("stage_rotation_rad", read("Stage.StageR", f"{beam}.StageR"))
    fields.set_positive("working_distance_um", read("Stage.WorkingDistance", f"{beam}.WD") * _UM_PER_M)
    fields.set_positive("accelerating_voltage_kv", read("Beam.HV", f"{beam}.HV") / 1000)
    fields.set("scan_rotation_rad", read("Beam.ScanRotation", f"{beam}.ScanRotation"))
    if raw.get(f"{beam}.TiltCorrectionIsOn", "").lower() in {"yes", "true", "on"}:
        fields.set("tilt_correction_rad", read(f"{beam}.TiltCorrectionAngle"))
    bar_rows = _bar_rows(height, read("Image.ResolutionY"), read("PrivateFei.DatabarHeight"))
    if bar_rows >= 0:
        fields.set_data_bar_rows(bar_rows)
    return fields.metadata(), tuple(fields.warnings)


def _bar_rows(height: int, resolution_y: float, databar_height: float) -> int:
    """Return the rows of the data bar, -1 where the header says nothing credible."""
    for rows in (height - resolution_y, databar_height):
        if 0 < rows < _MAX_BAR_SHARE * height:
            return int(rows)
    return 0 if height == resolution_y else -1


def _ini_values(text: str) -> dict[str, str]:
    """Return {"Section.Key": value} of an INI text, the first of a key that comes twice."""
    raw: dict[str, str] = {}
    section = ""
    for line in text.replace("\0", "").splitlines():
        stripped = line.strip()
        if stripped.startswith("[") and stripped.endswith("]"):
            section = stripped[1:-1].strip()
            continue
        key, equals, value = stripped.partition("=")
        if equals and key.strip():
            raw.setdefault(f"{section}.{key.strip()}", value.strip())
    return raw


def _first_number(fields: MetadataFields, keys: tuple[str, ...]) -> float:
    for key in keys:
        text = fields.raw.get(key, "")
        if not text:
            continue
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if math.isfinite(value):
            return value
        fields.warn(f"{key} holds {text!r}, which is no number; it is taken as unknown")
    return math.nan
