"""Say what was understood of a series: plain values per image, each with its source."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from semscape.io.data_bar import data_bar_rows
from semscape.io.metadata_fields import DATA_BAR_KEY, FILE_KEY_PREFIX, SCALE_BAR_KEY, STAGE_TILT_KEY
from semscape.io.scale_bar import find_scale_bar
from semscape.types import Micrograph, TiltSeries


def describe_series(series: TiltSeries) -> list[dict[str, Any]]:
    """Return one dict of plain JSON values per view, in the series' order; None where a value is unknown.

    Keys: name, width, height, bits_per_sample, format, vendor, model, pixel_size_um, tilt_deg (in semscape's sign: a
    positive tilt about +x moves a peak to larger image y), stage_tilt_deg (what the header says, in the
    microscope's own sign, whether it was used or not), axis_deg, stage_rotation_deg, scan_rotation_deg,
    tilt_correction_deg, tilt_correction_axis_deg, dynamic_focus, working_distance_mm, accelerating_voltage_kv,
    magnification, data_bar_rows, scale_bar_px (length of the bar that is burnt in); `sources` maps the keys that are
    known to "file", "sidecar", "user", "assumed", "doubtful" or "image" (seen in the pixels), `origins` to the very
    tag; `warnings` are those of the series that name the image.
    """
    return [_describe(view, series.warnings) for view in series.views]


def bar_rows(view: Micrograph) -> int:
    """Return the height of a view's data bar in rows of the image as it was stored, 0 for none."""
    stored = view.metadata.raw.get(DATA_BAR_KEY)
    return data_bar_rows(view.mask) if stored is None else int(stored)


def _scale_bar_px(view: Micrograph) -> float | None:
    stored = view.metadata.raw.get(SCALE_BAR_KEY)
    if stored is not None:
        return float(stored) if stored else None
    bar = find_scale_bar(view.image, view.mask)
    return None if bar is None else bar.length_px


def _describe(view: Micrograph, warnings: tuple[str, ...]) -> dict[str, Any]:
    metadata = view.metadata
    height, width = view.image.shape
    fields = {
        "pixel_size_um": ("pixel_size_um", metadata.pixel_size_um),
        "tilt_deg": ("tilt_rad", _deg(metadata.tilt_rad)),
        "axis_deg": ("tilt_axis_angle_rad", _deg(metadata.tilt_axis_angle_rad)),
        "stage_rotation_deg": ("stage_rotation_rad", _deg(metadata.stage_rotation_rad)),
        "scan_rotation_deg": ("scan_rotation_rad", _deg(metadata.scan_rotation_rad)),
        "tilt_correction_deg": ("tilt_correction_rad", _deg(metadata.tilt_correction_rad)),
        "tilt_correction_axis_deg": ("tilt_correction_axis_rad", _deg(metadata.tilt_correction_axis_rad)),
        "working_distance_mm": ("working_distance_um", metadata.working_distance_um / 1000),
        "accelerating_voltage_kv": ("accelerating_voltage_kv", metadata.accelerating_voltage_kv),
        "magnification": ("magnification", metadata.magnification),
    }
    values = {key: _known(value) for key, (_, value) in fields.items()}
    sources: dict[str, str] = {
        key: metadata.source.get(name, "assumed") for key, (name, _) in fields.items() if values[key] is not None
    }
    rows = bar_rows(view)
    told = rows and rows == metadata.data_bar_rows
    sources["data_bar_rows"] = metadata.source.get("data_bar_rows", "file") if told else "image"
    stage_tilt = metadata.raw.get(STAGE_TILT_KEY)
    bits = metadata.raw.get(FILE_KEY_PREFIX + "bits_per_sample")
    return {
        "name": view.name,
        "width": width,
        "height": height,
        "bits_per_sample": int(bits) if bits else None,
        "format": metadata.raw.get(FILE_KEY_PREFIX + "format"),
        "vendor": metadata.vendor,
        "model": metadata.model,
        **values,
        "stage_tilt_deg": float(stage_tilt) if stage_tilt else None,
        "dynamic_focus": metadata.dynamic_focus,
        "data_bar_rows": rows,
        "scale_bar_px": _scale_bar_px(view),
        "sources": sources,
        "origins": {key: metadata.origin[name] for key, (name, _) in fields.items() if name in metadata.origin},
        "warnings": [text for text in warnings if _names(text, view.name)],
    }


def _names(text: str, name: str) -> bool:
    return re.search(rf"(?<![\w.-]){re.escape(name)}(?![\w-]|\.\w)", text) is not None


def _deg(angle_rad: float | None) -> float:
    return math.nan if angle_rad is None else float(np.rad2deg(angle_rad))


def _known(value: float) -> float | None:
    return float(f"{value:.12g}") if math.isfinite(value) else None
