"""What a person says about a series: `series.toml` in its folder, and the options of the call."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from semscape.errors import BadInputError
from semscape.io.quantities import PIXEL_SIZES, is_pixel_size
from semscape.io.series_toml import SIDECAR_NAME, read_series_toml
from semscape.options import InputOptions
from semscape.types import FieldSource

MAX_TILT_DEG = 85.0

_DUPLICATE_TILT_DEG = 0.05
_LONGEST_BAR_UM = 1e6


@dataclass(frozen=True)
class GivenAcquisition:
    """What a person gives; empty and NaN: not given.

    `tilts_deg` belong to the naturally sorted files and may be NaN for some. `fields` holds per file name what
    `series.toml` says of the fields of `SemMetadata`.
    """

    tilts_deg: tuple[float, ...] = ()
    pixel_size_um: float = math.nan
    scale_bar_um: float = math.nan
    axis_deg: float = math.nan
    tilts_source: FieldSource = "user"
    scale_bar_source: FieldSource = "user"
    axis_source: FieldSource = "user"
    fields: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def read_given_acquisition(folder: Path, options: InputOptions, names: Sequence[str]) -> GivenAcquisition:
    """Return what the user and `series.toml` give for the files `names`; the user goes before the sidecar.

    Raises
    ------
    BadInputError
        For a sidecar that is not TOML, an unknown key, a value out of range, or the wrong number of tilts.
    """
    path = folder / SIDECAR_NAME
    sidecar = read_series_toml(path, names)
    tilts, what = options.tilts_deg, "the tilts given"
    if not tilts and sidecar.tilts_deg:
        tilts, what = sidecar.tilts_deg, f"tilts_deg in {path}"
    rotations = [sidecar.fields.get(name, {}).get("stage_rotation_rad", 0.0) for name in names]
    if tilts:
        _check_tilts(tilts, rotations, names, what)
    elif sidecar.image_tilts_deg:
        tilts = sidecar.image_tilts_deg
        _check_tilts(tilts, rotations, names, f"tilt_deg of the images in {path}", some_are_open=True)
    _check_length(options.pixel_size_um, "the pixel size given")
    if not (math.isnan(options.pixel_size_um) or is_pixel_size(options.pixel_size_um)):
        raise BadInputError(f"the pixel size given is {options.pixel_size_um:g} um; it must be a number {PIXEL_SIZES}")
    _check_axis(options.axis_deg, "the axis given")
    _check_axis(sidecar.axis_deg, f"{path}: axis_deg")
    _check_length(options.scale_bar_um, "the scale bar's length given")
    _check_length(sidecar.scale_bar_um, f"{path}: scale_bar_um")
    for bar_um in (options.scale_bar_um, sidecar.scale_bar_um):
        if bar_um > _LONGEST_BAR_UM or 0 < bar_um < 1 / _LONGEST_BAR_UM:
            raise BadInputError(f"a scale bar of {bar_um:g} um: its length must be given in um")
    bar_from_user = not math.isnan(options.scale_bar_um)
    size_from_user = not math.isnan(options.pixel_size_um)
    if bar_from_user and size_from_user:
        raise BadInputError("a pixel size and a scale bar's length are given; give one of the two")
    axis_from_user = not math.isnan(options.axis_deg)
    return GivenAcquisition(
        tilts_deg=tuple(tilts),
        pixel_size_um=options.pixel_size_um,
        scale_bar_um=options.scale_bar_um if bar_from_user or size_from_user else sidecar.scale_bar_um,
        axis_deg=options.axis_deg if axis_from_user else sidecar.axis_deg,
        tilts_source="user" if options.tilts_deg else "sidecar",
        scale_bar_source="user" if bar_from_user else "sidecar",
        axis_source="user" if axis_from_user else "sidecar",
        fields=sidecar.fields,
    )


def _check_tilts(
    tilts_deg: Sequence[float],
    rotations_rad: Sequence[float],
    names: Sequence[str],
    what: str,
    *,
    some_are_open: bool = False,
) -> None:
    """Refuse tilts that are too many or too few, out of range, or the same for two images of one stage rotation."""
    if len(tilts_deg) != len(names):
        raise BadInputError(
            f"{what}: {len(tilts_deg)} tilts for {len(names)} images; give one for each, in this order: "
            f"{', '.join(names)}"
        )
    for name, tilt in zip(names, tilts_deg, strict=True):
        if not (abs(tilt) <= MAX_TILT_DEG or (math.isnan(tilt) and some_are_open)):
            raise BadInputError(f"{what}: {tilt:g} deg for {name}; a tilt must lie within +-{MAX_TILT_DEG:g} deg")
    every = zip(rotations_rad, tilts_deg, names, strict=True)
    in_order = sorted((rotation, tilt, name) for rotation, tilt, name in every if not math.isnan(tilt))
    for (rotation1, tilt1, name1), (rotation2, tilt2, name2) in pairwise(in_order):
        if rotation1 == rotation2 and tilt2 - tilt1 < _DUPLICATE_TILT_DEG:
            raise BadInputError(
                f"{what}: {name1} and {name2} are both at {tilt1:g} deg; each image needs its own tilt: "
                "correct the list or remove one of the two"
            )


def _check_length(size_um: float, what: str) -> None:
    if not math.isnan(size_um) and not (math.isfinite(size_um) and size_um > 0):
        raise BadInputError(f"{what} is {size_um:g} um; it must be a positive number, or be left out if unknown")


def _check_axis(axis_deg: float, what: str) -> None:
    if not math.isnan(axis_deg) and not -45.0 < axis_deg <= 135.0:
        raise BadInputError(
            f"{what} is {axis_deg:g} deg; the tilt axis is given within (-45, 135] deg, counter-clockwise from the "
            "image's horizontal: add or subtract 180 deg and change the sign of every tilt"
        )
