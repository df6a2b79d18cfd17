"""JEOL metadata: the `.txt` file beside the image, lines of `$CM_MAG 50` or `$$SM_WD 9.07`.

Values are in kV, mm and deg. JEOL states no pixel size: `$$SM_MICRON_BAR` (px) and `$$SM_MICRON_MARKER` (its
length) give it where both are there, else `$CM_FIELD_OF_VIEW` (um), else the magnification, which counts on a
photograph 128 mm wide. `$CM_STAGE_POS` ends in rotation and tilt, in an order that differs between sources, so
they are read only where both are 0, or where a series shows which of the two changes. `$$SM_PNU_HEIGHT` is the
height of a data bar that newer microscopes add.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from semscape.io.metadata_fields import MetadataFields
from semscape.io.quantities import PLAIN, UM_PER_LENGTH, repair_units
from semscape.types import SemMetadata

_PHOTOGRAPH_UM = 128e3
_STAGE_KEYS = ("$CM_STAGE_POS", "$CM_STAGE_POSITION")
_SIZE_KEYS = ("$CM_IMAGE_SIZE", "$CM_FULL_SIZE")
_MOST_LINES = 10_000


def is_jeol(text: str) -> bool:
    """Tell whether a text is a JEOL sidecar."""
    return "$CM_" in text or "$$SM_" in text


def parse_jeol(text: str, image_shape: tuple[int, int], place: str = "sidecar") -> tuple[SemMetadata, tuple[str, ...]]:
    r"""Return what a JEOL sidecar says, and a warning for each value that cannot be read.

    Parameters
    ----------
    text : str
        Content of the sidecar.
    image_shape : (int, int)
        Height and width of the stored image in px, data bar included.
    place : str
        Name of the sidecar, for the fields' origin.

    Examples
    --------
    >>> metadata, _ = parse_jeol("$$SM_MICRON_BAR 160\n$$SM_MICRON_MARKER 8um\n", (960, 1280))
    >>> metadata.pixel_size_um, metadata.origin["pixel_size_um"]
    (0.05, 'sidecar, $$SM_MICRON_MARKER / $$SM_MICRON_BAR')
    """
    raw: dict[str, str] = {}
    for line in repair_units(text).splitlines()[:_MOST_LINES]:
        key, _, value = line.replace("\0", "").strip().partition(" ")
        if key.startswith("$"):
            raw.setdefault(key, value.strip())
    # The same key comes with one dollar or with two.
    values = {key.replace("$$", "$", 1): value for key, value in raw.items()}
    values |= {f"${key}": value for key, value in values.items()}
    fields = MetadataFields("JEOL", raw, place, values)
    height, width = image_shape
    _take_pixel_size(fields, width)
    fields.take("working_distance_um", "$$SM_WD", "mm")
    fields.take("accelerating_voltage_kv", "$CM_ACCEL_VOLT", "kv")
    fields.take("magnification", "$CM_MAG")
    fields.take("scan_rotation_rad", "$$SM_SCAN_ROTATION", "deg")
    _take_stage(fields)
    rows, key = fields.read("$$SM_PNU_HEIGHT", PLAIN)
    stored_height = _size(fields)[1]
    if math.isfinite(rows) and stored_height + rows == height:
        fields.set_data_bar_rows(rows, height, key)
    return fields.metadata(model=fields.text("$CM_INSTRUMENT")), tuple(fields.warnings)


def _take_pixel_size(fields: MetadataFields, width: int) -> None:
    stored_width = _size(fields)[0]
    fields.warn_if_resized(stored_width, width)
    bar_px, _ = fields.read("$$SM_MICRON_BAR", PLAIN)
    marker_um, _ = fields.read("$$SM_MICRON_MARKER", UM_PER_LENGTH)
    field_um = _first_length(fields, "$CM_FIELD_OF_VIEW")
    columns = stored_width or width
    if bar_px > 0 and marker_um > 0:
        fields.set("pixel_size_um", marker_um / bar_px, "$$SM_MICRON_MARKER / $$SM_MICRON_BAR")
    elif field_um > 0:
        fields.set("pixel_size_um", field_um / columns, "$CM_FIELD_OF_VIEW / width")
    else:
        fields.take_pixel_size_of_photograph("$CM_MAG", _PHOTOGRAPH_UM, columns)


def _first_length(fields: MetadataFields, key: str) -> float:
    """Return the first of "128.0 96.0" or "128.0µm 96.0µm" in um."""
    words = fields.text(key).split()
    if not words:
        return math.nan
    word = words[0] + (words[1] if len(words) == 4 else "")  # "128.0 µm 96.0 µm"
    part = MetadataFields("JEOL", {key: word}, "")
    value, _ = part.read(key, UM_PER_LENGTH, "um")
    for warning in part.warnings:
        fields.warn(warning)
    return value


def _size(fields: MetadataFields) -> tuple[int, int]:
    """Return the width and height that the microscope stored, zeros where it says nothing."""
    for key in _SIZE_KEYS:
        words = fields.text(key).split()
        if len(words) >= 2 and all(word.isdecimal() and len(word) < 7 for word in words[:2]):
            return int(words[0]), int(words[1])
    return 0, 0


def stage_angles(raw: Mapping[str, str]) -> tuple[float, float] | None:
    """Return the two angles in deg that end a JEOL stage position, tilt and rotation in either order."""
    for key in _STAGE_KEYS:
        words = raw.get(key, "").split()
        if len(words) >= 5:
            try:
                first, second = float(words[3]), float(words[4])
            except ValueError:
                return None
            return (first, second) if math.isfinite(first) and math.isfinite(second) else None
    return None


def _take_stage(fields: MetadataFields) -> None:
    key = next((key for key in _STAGE_KEYS if len(fields.text(key).split()) >= 5), None)
    if key is None:
        return
    angles = stage_angles(fields.raw)
    if angles is None:
        fields.warn(f"{key} holds {fields.text(key)[:100]!r}, which are no numbers; tilt and rotation are unknown")
    elif angles == (0.0, 0.0):
        fields.set_stage_tilt(0.0, key, sign_is_known=False)
        fields.set("stage_rotation_rad", 0.0, key)
    else:
        fields.warn(
            f"{key} ends in {angles[0]:g} and {angles[1]:g} deg: one is the stage tilt, one its rotation, in an order "
            "that differs between microscopes; this file alone does not tell the tilt"
        )
