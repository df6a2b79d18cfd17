"""What a person says about a series: `series.toml` in its folder, and the options of the call."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from semscape.errors import BadInputError
from semscape.options import InputOptions
from semscape.types import FieldSource

SIDECAR_NAME = "series.toml"
MAX_TILT_DEG = 85.0

_DUPLICATE_TILT_DEG = 0.05
_SIDECAR_KEYS = ("tilts_deg", "pixel_size_um", "axis_deg")


@dataclass(frozen=True)
class GivenAcquisition:
    """Tilts per naturally sorted file, pixel size and tilt axis as a person gave them; empty and NaN: not given."""

    tilts_deg: tuple[float, ...] = ()
    pixel_size_um: float = math.nan
    axis_deg: float = math.nan
    tilts_source: FieldSource = "user"
    pixel_size_source: FieldSource = "user"
    axis_source: FieldSource = "user"


def read_given_acquisition(folder: Path, options: InputOptions, names: Sequence[str]) -> GivenAcquisition:
    """Return what the user and `series.toml` give for the files `names`; the user goes before the sidecar.

    Raises
    ------
    BadInputError
        For a sidecar that is not TOML, an unknown key, a value out of range, or the wrong number of tilts.
    """
    sidecar = _read_sidecar(folder / SIDECAR_NAME)
    tilts, tilts_source = options.tilts_deg, "the tilts given"
    if not tilts and sidecar.tilts_deg:
        tilts, tilts_source = sidecar.tilts_deg, f"tilts_deg in {folder / SIDECAR_NAME}"
    if tilts:
        _check_tilts(tilts, names, tilts_source)
    _check_pixel_size(options.pixel_size_um, "the pixel size given", nan_is_unset=True)
    _check_axis(options.axis_deg, "the axis given", nan_is_unset=True)
    size_from_user = not math.isnan(options.pixel_size_um)
    axis_from_user = not math.isnan(options.axis_deg)
    return GivenAcquisition(
        tilts_deg=tuple(tilts),
        pixel_size_um=options.pixel_size_um if size_from_user else sidecar.pixel_size_um,
        axis_deg=options.axis_deg if axis_from_user else sidecar.axis_deg,
        tilts_source="user" if options.tilts_deg else "sidecar",
        pixel_size_source="user" if size_from_user else "sidecar",
        axis_source="user" if axis_from_user else "sidecar",
    )


def _read_sidecar(path: Path) -> InputOptions:
    if not path.exists():
        return InputOptions()
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadInputError(f"{path}: cannot be read as TOML ({error}); it may hold tilts_deg = [-5, 0, 5]") from error
    for key in values:
        if key not in _SIDECAR_KEYS:
            nearest = difflib.get_close_matches(key, _SIDECAR_KEYS, n=1, cutoff=0.0)[0]
            raise BadInputError(
                f"{path}: unknown key {key!r}; the nearest one is {nearest!r} (all: {', '.join(_SIDECAR_KEYS)})"
            )
    tilts = values.get("tilts_deg", [])
    if not isinstance(tilts, list) or not all(_is_number(tilt) for tilt in tilts):
        raise BadInputError(f"{path}: tilts_deg must be a list of numbers like [-5, 0, 5], got {tilts!r}")
    for key in ("pixel_size_um", "axis_deg"):
        if key in values and not _is_number(values[key]):
            raise BadInputError(f"{path}: {key} must be a number, got {values[key]!r}")
    if "pixel_size_um" in values:
        _check_pixel_size(float(values["pixel_size_um"]), f"{path}: pixel_size_um")
    if "axis_deg" in values:
        _check_axis(float(values["axis_deg"]), f"{path}: axis_deg")
    return InputOptions(
        tilts_deg=tuple(float(tilt) for tilt in tilts),
        pixel_size_um=float(values.get("pixel_size_um", math.nan)),
        axis_deg=float(values.get("axis_deg", math.nan)),
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check_tilts(tilts_deg: Sequence[float], names: Sequence[str], what: str) -> None:
    if len(tilts_deg) != len(names):
        raise BadInputError(
            f"{what}: {len(tilts_deg)} tilts for {len(names)} images; give one for each, in this order: "
            f"{', '.join(names)}"
        )
    for name, tilt in zip(names, tilts_deg, strict=True):
        if not abs(tilt) <= MAX_TILT_DEG:
            raise BadInputError(f"{what}: {tilt:g} deg for {name}; a tilt must lie within +-{MAX_TILT_DEG:g} deg")
    in_order = sorted(zip(tilts_deg, names, strict=True))
    for (tilt1, name1), (tilt2, name2) in pairwise(in_order):
        if tilt2 - tilt1 < _DUPLICATE_TILT_DEG:
            raise BadInputError(
                f"{what}: {name1} and {name2} are both at {tilt1:g} deg; each image needs its own tilt: "
                "correct the list or remove one of the two"
            )


def _check_pixel_size(size_um: float, what: str, *, nan_is_unset: bool = False) -> None:
    if nan_is_unset and math.isnan(size_um):
        return
    if not (math.isfinite(size_um) and size_um > 0):
        raise BadInputError(f"{what} is {size_um:g} um; it must be a positive number, or be left out if unknown")


def _check_axis(axis_deg: float, what: str, *, nan_is_unset: bool = False) -> None:
    if nan_is_unset and math.isnan(axis_deg):
        return
    if not -45.0 < axis_deg <= 135.0:
        raise BadInputError(
            f"{what} is {axis_deg:g} deg; the tilt axis is given within (-45, 135] deg, counter-clockwise from the "
            "image's horizontal: add or subtract 180 deg and change the sign of every tilt"
        )
