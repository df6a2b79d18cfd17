"""How the report and the console put figures into words: labels, units, digits, and the standing sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from semscape.types import LengthUnit, Reconstruction

Z_95 = 1.959964
"""A normal distribution's 95 % interval in sigmas."""

UNIT_SIGNS: dict[str, str] = {"um": "µm", "px": "px"}

_LABELS = {
    "rms_px": "Residual rms",
    "n_kept": "Kept for matching",
    "n_points": "Points",
    "n_observations": "Observations",
    "n_tracks": "Tracks",
    "n_views": "Views",
    "mean_track_length": "Mean track length",
    "height_range": "Height range",
    "completeness": "Completeness",
    "completeness_specimen": "Completeness, specimen",
    "height_scale_relative_sigma": "Height scale (1 σ)",
    "height_scale_relative_sigma_95": "Height scale (95 %)",
    "median_uncertainty": "Median height uncertainty",
    "median_lateral_period": "Lateral resolution (half height)",
    "de_generations": "DE generations",
    "de_cost": "DE cost",
    "threshold_px": "Threshold",
    "log10_nfa": "log₁₀ NFA",
    "peak_memory_mb": "Peak memory",
    "pixel_size": "Pixel size",
    "data_bar_rows": "Data bar",
    "digest": "SHA-256",
}
_SUFFIXES = {
    "_px": " px",
    "_um": " µm",
    "_deg": "°",
    "_s": " s",
    "_rad": " rad",
    "_kv": " kV",
    "_mm": " mm",
    "_mb": " MB",
    "_rows": " rows",
    "_percent": " %",
}
_FRACTIONS = ("completeness", "relative_sigma", "fraction", "ratio", "confidence")
_LENGTHS = (
    *("height_range", "median_uncertainty", "median_lateral_period", "uncertainty", "relief", "pixel_size"),
    *("height_min", "height_max"),
)


def label(key: str) -> str:
    """Return a key's name for people.

    Examples
    --------
    >>> label("median_uncertainty_um"), label("search_seconds")
    ('Median height uncertainty', 'Search seconds')
    """
    if key in _LABELS:
        return _LABELS[key]
    stem = key
    for suffix in _SUFFIXES:
        if key.endswith(suffix):
            stem = key.removesuffix(suffix)
    if stem in _LABELS:
        return _LABELS[stem]
    words = stem.removeprefix("n_").replace("_", " ").strip()
    return words[:1].upper() + words[1:]


def number(value: Any, digits: int = 4) -> str:
    """Return a number with so many significant digits, "–" for one that is unknown.

    Examples
    --------
    >>> number(1234567), number(0.000123456), number(41.25), number(-0.0), number(float("nan"))
    ('1,234,567', '0.0001235', '41.25', '0', '–')
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    magnitude = abs(value)
    if magnitude and (magnitude < 1e-4 or magnitude >= 1e9):
        return f"{value:.{digits - 1}e}"
    decimals = max(0, digits - 1 - (math.floor(math.log10(magnitude)) if magnitude else 0))
    text = f"{value:z,.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def value_text(key: str, value: Any, unit: LengthUnit = "um") -> str:
    """Return a figure with its unit, which the end of its key tells.

    Examples
    --------
    >>> value_text("rms_px", 0.2143), value_text("completeness", 0.934), value_text("height_range", [-2.0, 39.5])
    ('0.2143 px', '93.4 %', '-2 to 39.5 µm')
    """
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return ", ".join(f"{inline_label(name)}: {value_text(name, item, unit)}" for name, item in value.items())
    sign = next((sign for suffix, sign in _SUFFIXES.items() if key.endswith(suffix)), "")
    if not sign and any(key == name or key.endswith(f"_{name}") for name in _LENGTHS):
        sign = f" {UNIT_SIGNS[unit]}"
    if isinstance(value, Sequence):
        separator = " to " if key.endswith("range") or "_range_" in key else ", "
        return separator.join(_item_text(item) for item in value) + sign
    is_fraction = any(name in key for name in _FRACTIONS) and not sign
    if is_fraction and isinstance(value, float) and math.isfinite(value):
        return f"{number(100 * value, 3)} %"
    text = number(value)
    return text if text == "–" else text + sign


def two_digits(value: float) -> str:
    """Return a positive number with two significant digits, as an uncertainty is stated.

    Examples
    --------
    >>> two_digits(2.0), two_digits(0.0123), two_digits(112.4)
    ('2.0', '0.012', '112')
    """
    decimals = max(0, 1 - math.floor(math.log10(value))) if value > 0 else 0
    return f"{value:.{decimals}f}"


def inline_label(key: str) -> str:
    """Return a key's name as it stands within a sentence: "Residual rms" becomes "residual rms", "DE cost" stays."""
    name = label(key)
    return name if name[1:2].isupper() else name[:1].lower() + name[1:]


def is_held(view: Mapping[str, Any], report: Mapping[str, Any]) -> bool:
    """Tell whether a view of a report has its tilt by choice: the reference of a self-calibrated series."""
    return bool(report["tilt_source"] == "self-calibrated" and view["name"] == report["reference_view"])


def held_text(tilt_deg: float) -> str:
    """Return a tilt that is held, which has no uncertainty.

    Examples
    --------
    >>> held_text(-1e-9)
    '0 (held)'
    """
    return f"{number(round(tilt_deg, 3) + 0.0)} (held)"


def _item_text(item: Any) -> str:
    """Return an item of a list; an inner list, like a pair of views, gets dashes."""
    if isinstance(item, str):
        return item
    return "–".join(_item_text(part) for part in item) if isinstance(item, Sequence) else number(item)


def height_scale_text(reconstruction: Reconstruction) -> str:
    """Return the sentence about the height scale, like "height scale ±1.1 % (95 %)"."""
    relative = reconstruction.height_scale_relative_sigma
    if not math.isfinite(relative):
        return "height scale: uncertainty unknown"
    return f"height scale ±{two_digits(100 * Z_95 * relative)} % (95 %)"


def ambiguity_text(reconstruction: Reconstruction) -> str:
    """Return what fixed the height scale and the sign of the relief, and how to change it."""
    source = {
        "metadata": "the stage tilts in the files",
        "user": "the tilts given by the user",
        "self-calibrated": "the images alone (self-calibration)",
        "thesis": "the textbook route (sfm.method), which does not say how well",
    }[reconstruction.tilt_source]
    if reconstruction.ambiguity == "bas_relief":
        return (
            f"Two parallel projections leave the height scale open (bas-relief ambiguity): it rests on {source} "
            "alone, and an error of the tilt difference changes every height in proportion."
        )
    if reconstruction.ambiguity == "reflection":
        confidence = reconstruction.relief_confidence
        if confidence < 0.5:
            return (
                f"The height scale comes from {source}, which leaves the relief or its mirror image: the sign of the "
                f"relief was set against the vote of its shading (--invert-relief; confidence of that vote "
                f"{100 * (1 - confidence):.0f} %) and is an assumption. If hills look like pits, run without it."
            )
        stated = f" (confidence {100 * confidence:.0f} %)" if math.isfinite(confidence) else ""
        return (
            f"The height scale comes from {source}, which leaves the relief or its mirror image: the sign of the "
            f"relief was voted by shading{stated} and is an assumption. If hills look like pits, run again with "
            "--invert-relief."
        )
    return f"The height scale and the sign of the relief are fixed by {source}."
