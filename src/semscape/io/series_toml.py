"""`series.toml`, in which a person overrides what the files of a folder say, for the series or for one image.

tilts_deg = [-5.0, 0.0, 5.0]       # one for each image, in natural order of the names
pixel_size_um = 0.05

[images."img3.tif"]
tilt_deg = 5.2
"""

from __future__ import annotations

import difflib
import math
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from semscape.errors import BadInputError
from semscape.io.quantities import PIXEL_SIZES, is_pixel_size

SIDECAR_NAME = "series.toml"

_RAD_PER_DEG = math.pi / 180
_MOST_BYTES = 1_000_000


@dataclass(frozen=True)
class _Key:
    """A key of series.toml: the field of `SemMetadata` it sets, its factor, and what it may hold."""

    field: str
    factor: float
    allowed: Callable[[float], bool]
    must: str


def _positive(value: float) -> bool:
    return math.isfinite(value) and value > 0


_POSITIVE = (_positive, "be a positive number")
_ANGLE = (lambda value: math.isfinite(value) and abs(value) <= 360.0, "lie within +-360 deg")
OVERRIDES = {
    "pixel_size_um": _Key("pixel_size_um", 1.0, is_pixel_size, f"be a positive number {PIXEL_SIZES}"),
    "working_distance_mm": _Key("working_distance_um", 1000.0, *_POSITIVE),
    "accelerating_voltage_kv": _Key("accelerating_voltage_kv", 1.0, *_POSITIVE),
    "magnification": _Key("magnification", 1.0, *_POSITIVE),
    "stage_rotation_deg": _Key("stage_rotation_rad", _RAD_PER_DEG, *_ANGLE),
    "scan_rotation_deg": _Key("scan_rotation_rad", _RAD_PER_DEG, *_ANGLE),
    "tilt_correction_deg": _Key(
        "tilt_correction_rad", _RAD_PER_DEG, lambda value: abs(value) < 90.0, "lie within +-90 deg, 0 for off"
    ),
    "tilt_correction_axis_deg": _Key(
        "tilt_correction_axis_rad", _RAD_PER_DEG, lambda value: value in (0.0, 90.0), "be 0 or 90"
    ),
    "dynamic_focus": _Key("dynamic_focus", 1.0, lambda value: value in (0.0, 1.0), "be true or false"),
    "data_bar_rows": _Key(
        "data_bar_rows", 1.0, lambda value: value >= 0 and value.is_integer(), "be a whole number, 0 for none"
    ),
}
_SERIES_KEYS = ("tilts_deg", "axis_deg", "scale_bar_um", *OVERRIDES, "images")
_IMAGE_KEYS = ("tilt_deg", *OVERRIDES)


@dataclass(frozen=True)
class SeriesToml:
    """What a `series.toml` says; empty and NaN: nothing.

    `tilts_deg` comes from the list, `image_tilts_deg` from the images' own tables (NaN for those without one).
    `fields` holds per image name the values of `SemMetadata`'s fields, those of the series put in.
    """

    tilts_deg: tuple[float, ...] = ()
    image_tilts_deg: tuple[float, ...] = ()
    axis_deg: float = math.nan
    scale_bar_um: float = math.nan
    fields: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def read_series_toml(path: Path, names: Sequence[str]) -> SeriesToml:
    """Return what a `series.toml` says of the images `names`; nothing where there is no such file.

    Raises
    ------
    BadInputError
        For a file that is not TOML, an unknown key or image, or a value of the wrong kind or out of range.
    """
    if not path.exists():
        return SeriesToml()
    if not path.is_file() or path.stat().st_size > _MOST_BYTES:  # a pipe or device may never end
        raise BadInputError(
            f"{path}: is not a text file below {_MOST_BYTES:,} bytes; it may hold tilts_deg = [-5, 0, 5]"
        )
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:  # ValueError: not UTF-8, not TOML, 5000 digits
        raise BadInputError(f"{path}: cannot be read as TOML ({error}); it may hold tilts_deg = [-5, 0, 5]") from error
    _require_known(path, values, _SERIES_KEYS)
    tilts = values.get("tilts_deg", [])
    if not isinstance(tilts, list) or not all(_is_number(tilt) for tilt in tilts):
        raise BadInputError(f"{path}: tilts_deg must be a list of numbers like [-5, 0, 5], got {tilts!r}")
    images = values.get("images", {})
    if not isinstance(images, dict) or not all(isinstance(table, dict) for table in images.values()):
        raise BadInputError(f'{path}: images must be tables like [images."{names[0]}"], got {images!r}')
    for name, table in images.items():
        if name not in names:
            nearest = difflib.get_close_matches(name, names, n=1, cutoff=0.0)[0]
            raise BadInputError(f"{path}: there is no image {name!r} in the folder; the nearest name is {nearest!r}")
        _require_known(path, table, _IMAGE_KEYS)
    of_series = _fields(path, values)
    return SeriesToml(
        tilts_deg=tuple(float(tilt) for tilt in tilts),
        image_tilts_deg=_image_tilts(path, tilts, images, names),
        axis_deg=_number(path, "axis_deg", values),
        scale_bar_um=_number(path, "scale_bar_um", values),
        fields={name: of_series | _fields(path, images.get(name, {})) for name in names},
    )


def _require_known(path: Path, values: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in values:
        if key not in known:
            nearest = difflib.get_close_matches(key, known, n=1, cutoff=0.0)[0]
            raise BadInputError(
                f"{path}: unknown key {key!r}; the nearest one is {nearest!r} (all: {', '.join(known)})"
            )


def _image_tilts(path: Path, tilts: list[float], images: Mapping[str, Any], names: Sequence[str]) -> tuple[float, ...]:
    of_images = {name: _number(path, "tilt_deg", table) for name, table in images.items() if "tilt_deg" in table}
    if of_images and tilts:
        raise BadInputError(f"{path}: holds tilts_deg and tilt_deg of {', '.join(of_images)}; give only one of the two")
    return tuple(of_images.get(name, math.nan) for name in names) if of_images else ()


def _fields(path: Path, values: Mapping[str, Any]) -> dict[str, float]:
    found = {}
    for key, spec in OVERRIDES.items():
        if key not in values:
            continue
        value = float(values[key]) if isinstance(values[key], bool) and key == "dynamic_focus" else None
        value = _number(path, key, values) if value is None else value
        if not spec.allowed(value):
            raise BadInputError(f"{path}: {key} is {_with_unit(key, value)}; it must {spec.must}, or be left out")
        found[spec.field] = value * spec.factor
    return found


def _number(path: Path, key: str, values: Mapping[str, Any]) -> float:
    if key not in values:
        return math.nan
    if not _is_number(values[key]):
        raise BadInputError(f"{path}: {key} must be a number, got {values[key]!r}")
    if math.isnan(values[key]):
        must = OVERRIDES[key].must if key in OVERRIDES else "be a number"
        raise BadInputError(f"{path}: {key} is {_with_unit(key, math.nan)}; it must {must}, or be left out")
    return float(values[key])


def _with_unit(key: str, value: float) -> str:
    unit = key.rpartition("_")[2]
    return f"{value:g} {unit}" if unit in {"um", "mm", "kv", "deg"} else f"{value:g}"


def _is_number(value: Any) -> bool:
    if isinstance(value, int):  # TOML's integers may be larger than any float
        return not isinstance(value, bool) and abs(value) <= sys.float_info.max
    return isinstance(value, float)
