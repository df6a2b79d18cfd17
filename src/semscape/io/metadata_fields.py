"""Collect the fields that one vendor's text yields, with their source and a warning for each unusable value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from semscape.types import FieldSource, SemMetadata

_MAX_PIXEL_SIZE_UM = 1000.0


class MetadataFields:
    """The fields of a `SemMetadata` in the making.

    Parameters
    ----------
    vendor : str
        Name of the vendor whose text is read.
    raw : mapping of str to str
        The vendor's own tags, kept whole.
    """

    def __init__(self, vendor: str, raw: Mapping[str, str]) -> None:
        self.vendor = vendor
        self.raw = dict(raw)
        self.warnings: list[str] = []
        self._values: dict[str, Any] = {}

    def warn(self, text: str) -> None:
        """Note a warning, each one once."""
        if text not in self.warnings:
            self.warnings.append(text)

    def set(self, name: str, value: float) -> None:
        """Set a field that is known; NaN leaves it unknown."""
        if math.isnan(value):
            return
        if not math.isfinite(value):
            self.warn(f"{name} of the {self.vendor} header is {value:g}; it is taken as unknown")
            return
        self._values[name] = value + 0.0  # -0 becomes 0

    def set_positive(self, name: str, value: float) -> None:
        """Set a field that is known and must be positive (a pixel size: below 1 mm as well)."""
        if value <= 0 or (name == "pixel_size_um" and value > _MAX_PIXEL_SIZE_UM):
            self.warn(f"{name} of the {self.vendor} header is {value:g}; it is taken as unknown")
            return
        self.set(name, value)

    def set_data_bar_rows(self, rows: int) -> None:
        """Set the height of the data bar."""
        self._values["data_bar_rows"] = rows

    def metadata(self) -> SemMetadata:
        """Return the fields as metadata whose every known field comes from the file."""
        source: dict[str, FieldSource] = dict.fromkeys(self._values, "file")
        return SemMetadata(vendor=self.vendor, source=source, raw=self.raw, **self._values)
