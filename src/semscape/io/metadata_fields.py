"""Collect the fields that one vendor's text yields, each with its origin, and a warning for each unusable value."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from semscape.io.quantities import KV_PER_VOLTAGE, RAD_PER_ANGLE, TIMES, UM_PER_LENGTH, is_pixel_size, parse_quantity
from semscape.types import FieldSource, SemMetadata

# Keys of `SemMetadata.raw` for what semscape notes of the image file; all others are the vendor's.
FILE_KEY_PREFIX = "file."
STAGE_TILT_KEY = FILE_KEY_PREFIX + "stage_tilt_deg"
# Of an image that was squeezed after it was read: what only shows in the image as it was stored.
DATA_BAR_KEY, SCALE_BAR_KEY = FILE_KEY_PREFIX + "data_bar_rows", FILE_KEY_PREFIX + "scale_bar_px"
# At scan rotation 0 a positive stage tilt turns the surface's normal towards the top of the image: a negative
# rotation about +x in semscape's convention.
TILT_SIGN = -1.0

_UNITS: dict[str, Mapping[str, float]] = {
    "pixel_size_um": UM_PER_LENGTH,
    "working_distance_um": UM_PER_LENGTH,
    "accelerating_voltage_kv": KV_PER_VOLTAGE,
    "magnification": TIMES,
    "stage_rotation_rad": RAD_PER_ANGLE,
    "scan_rotation_rad": RAD_PER_ANGLE,
}
_SIGN_IS_ASSUMED = "stage's tilt is assumed"
_DOUBTS_OF_PIXEL_SIZE = (
    "after resizing the pixel size",
    "the pixel size follows from",
    "which seldom hold a microscope's",
)
_POSITIVE = ("pixel_size_um", "working_distance_um", "accelerating_voltage_kv", "magnification")
_MAX_BAR_SHARE = 0.4
_ANISOTROPY_LIMIT = 1e-3
_ON = {"on", "yes", "true", "1"}


def is_moot(note: str, source: Mapping[str, FieldSource]) -> bool:
    """Tell whether a note is about a value of the file that is not used, by where the fields come from in the end."""
    about_tilt, about_size = _SIGN_IS_ASSUMED in note, any(words in note for words in _DOUBTS_OF_PIXEL_SIZE)
    return (about_tilt and source.get("tilt_rad") != "file") or (
        about_size and source.get("pixel_size_um") in ("user", "sidecar")
    )


class MetadataFields:
    """The fields of a `SemMetadata` in the making.

    Parameters
    ----------
    vendor : str
        Name of the vendor whose text is read.
    raw : mapping of str to str
        The vendor's own tags, kept whole.
    place : str
        Where the text stands, like "tag 34118"; it begins every field's origin.
    values : mapping of str to str
        The texts to read values from, where they are not those of `raw`.
    """

    def __init__(
        self, vendor: str, raw: Mapping[str, str], place: str, values: Mapping[str, str] | None = None
    ) -> None:
        self.vendor = vendor
        self.raw = dict(raw)
        self.warnings: list[str] = []
        self._place = place
        self._texts = self.raw if values is None else values
        self._doubtful: set[str] = set()
        self._values: dict[str, Any] = {}
        self._origin: dict[str, str] = {}

    def warn(self, text: str) -> None:
        """Note a warning, each one once."""
        if text not in self.warnings:
            self.warnings.append(text)

    def text(self, key: str) -> str:
        """Return a tag's value as text, "" where there is none."""
        return self._texts.get(key, "").strip()

    def is_on(self, key: str) -> bool:
        """Tell whether a switch is on."""
        return self.text(key).lower() in _ON

    def read(self, keys: str | Iterable[str], units: Mapping[str, float], bare: str = "") -> tuple[float, str]:
        """Return the first of some tags that holds a number with one of `units`, and its key; NaN without any."""
        for key in [keys] if isinstance(keys, str) else keys:
            if not self.text(key):
                continue
            try:
                return parse_quantity(self.text(key), units, bare), key
            except ValueError:
                self.warn(
                    f"{key} holds {self.raw.get(key, self.text(key))[:100]!r}, which is no number with a known unit; "
                    "it is taken as unknown"
                )
        return math.nan, ""

    def take(self, name: str, keys: str | Iterable[str], bare: str = "") -> None:
        """Set a field from the first of some tags that holds a number with a unit of the field's kind."""
        value, key = self.read(keys, _UNITS[name], bare)
        self.set(name, value, key)

    def take_stage_tilt(self, keys: str | Iterable[str], bare: str, *, sign_is_known: bool, leans: str = "up") -> None:
        """Set the tilt from the stage's reading, turned into semscape's sign."""
        self.set_stage_tilt(*self.read(keys, RAD_PER_ANGLE, bare), sign_is_known=sign_is_known, leans=leans)

    def set_stage_tilt(self, value: float, key: str, *, sign_is_known: bool, leans: str = "up") -> None:
        """Set the tilt from the stage's reading in rad; a positive one is taken to lean structures that way."""
        if math.isnan(value):
            return
        self.set("tilt_rad", TILT_SIGN * value, key)
        self.raw[STAGE_TILT_KEY] = f"{math.degrees(value) + 0.0:.9g}"
        if not sign_is_known and value != 0:
            self.warn(
                f"the sign of this {self.vendor} {_SIGN_IS_ASSUMED} (positive leans structures {leans} in the image); "
                "if hills come out as pits, give the tilts with the other sign"
            )

    def take_square_pixel(self, width_um: float, height_um: float, key: str) -> None:
        """Set the pixel size from a pixel's width, with a warning where the height differs."""
        self.set("pixel_size_um", width_um, key)
        if abs(height_um - width_um) > _ANISOTROPY_LIMIT * abs(width_um):
            self.warn(f"pixels are {width_um:.6g} um wide but {height_um:.6g} um high; the width is used")

    def take_pixel_size_of_photograph(self, key: str, photograph_um: float, columns: int) -> None:
        """Set the pixel size from the magnification, which counts on a photograph of that width, with a warning."""
        magnification, found = self.read(key, TIMES)
        if magnification > 0:
            width = f"{photograph_um / 1000:g} mm"
            self.set("pixel_size_um", photograph_um / magnification / columns, f"{width} / {found} / width")
            self.warn(
                f"the pixel size follows from the magnification on a photograph {width} wide; check the scale bar"
            )

    def set(self, name: str, value: float, key: str) -> None:
        """Set a field that is known, with the tag it came from; NaN leaves it unknown, an absurd value as well."""
        if math.isnan(value):
            return
        absurd = value <= 0 if name in _POSITIVE else False
        if absurd or not math.isfinite(value) or (name == "pixel_size_um" and not is_pixel_size(value)):
            self.warn(f"{name} of the {self.vendor} header is {value:g}; it is taken as unknown")
            return
        self._values[name] = value + 0.0  # -0 becomes 0
        self._origin[name] = f"{self._place}, {key}" if key else self._place

    def set_tilt_correction(self, value_rad: float, key: str) -> None:
        """Note that tilt correction was on; the angle may be NaN, which means unknown."""
        self._values["tilt_correction_rad"] = value_rad + 0.0
        self._origin["tilt_correction_rad"] = f"{self._place}, {key}"

    def set_dynamic_focus(self, key: str) -> None:
        """Note that dynamic focus was on."""
        self._values["dynamic_focus"] = True
        self._origin["dynamic_focus"] = f"{self._place}, {key}"

    def set_data_bar_rows(self, rows: float, image_height: int, key: str) -> None:
        """Set the height of the data bar, where it is credible."""
        if 0 <= rows < _MAX_BAR_SHARE * image_height:
            self._values["data_bar_rows"] = int(rows)
            self._origin["data_bar_rows"] = f"{self._place}, {key}"

    def warn_if_resized(self, stored_width: float, image_width: int) -> None:
        """Warn where the image is not as wide as the microscope stored it."""
        if stored_width > 0 and stored_width != image_width:
            self._doubtful.add("pixel_size_um")
            self.warn(
                f"the image is {image_width} px wide, but the microscope stored {stored_width:.0f} px: it was cropped "
                "or resized, and after resizing the pixel size in its header is wrong; give the true one if so"
            )

    def metadata(self, model: str = "", source: FieldSource = "file") -> SemMetadata:
        """Return the fields as metadata whose every known field comes from `source`."""
        sources: dict[str, FieldSource] = {
            name: "doubtful" if name in self._doubtful else source for name in self._values
        }
        return SemMetadata(
            vendor=self.vendor, model=model, source=sources, origin=self._origin, raw=self.raw, **self._values
        )
