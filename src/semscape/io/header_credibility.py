"""Settle the metadata of a series' views against each other: which tilts and pixel sizes are credible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from semscape.io.acquisition import MAX_TILT_DEG, GivenAcquisition
from semscape.io.jeol import stage_angles
from semscape.io.metadata_fields import FILE_KEY_PREFIX, TILT_SIGN
from semscape.types import FieldSource, SemMetadata

_EQUAL_TILT_DEG = 0.05
_PIXEL_SIZE_SPREAD = 0.05
_EQUAL_ROTATION_DEG = 0.5


def settle_metadata(
    names: Sequence[str], metadata: Sequence[SemMetadata], given: GivenAcquisition
) -> tuple[list[SemMetadata], list[str]]:
    """Return each view's metadata with what was given put in and what is not credible taken out, and warnings.

    Parameters
    ----------
    names : sequence of str
        File names in natural order.
    metadata : sequence of SemMetadata
        As read from the files.
    given : GivenAcquisition
        What the user or the sidecar gives; it goes before the files.
    """
    settled = [_overridden(view, given.fields.get(name, {})) for name, view in zip(names, metadata, strict=True)]
    warnings: list[str] = []
    settled = _jeol_tilts(settled, warnings)
    if not given.tilts_deg or not np.isfinite(given.tilts_deg).all():
        settled = _credible_tilts(names, settled, given.tilts_deg, warnings)
    if given.tilts_deg:
        settled = [
            _with(view, "tilt_rad", np.deg2rad(tilt), given.tilts_source) if np.isfinite(tilt) else view
            for view, tilt in zip(settled, given.tilts_deg, strict=True)
        ]
    if np.isfinite(given.pixel_size_um):
        settled = [_with(view, "pixel_size_um", given.pixel_size_um, "user") for view in settled]
    if any(view.source.get("pixel_size_um") not in {"user", "sidecar"} for view in settled):
        settled = _doubted_where_copied(settled, warnings)
        settled = _complete_pixel_sizes(names, settled, warnings)
    if np.isfinite(given.axis_deg):
        axis_rad = float(np.deg2rad(given.axis_deg))
        settled = [_with(view, "tilt_axis_angle_rad", axis_rad, given.axis_source) for view in settled]
    _warn_of_differing_rotation(settled, warnings)
    return settled, warnings


def _overridden(metadata: SemMetadata, values: Mapping[str, float]) -> SemMetadata:
    for name, value in values.items():
        metadata = _with(metadata, name, value, "sidecar")
    return metadata


def _with(metadata: SemMetadata, name: str, value: float, source: FieldSource) -> SemMetadata:
    kind = {"data_bar_rows": int, "dynamic_focus": bool}.get(name, float)
    origin = {key: text for key, text in metadata.origin.items() if key != name}
    values: dict[str, Any] = {name: kind(value), "source": {**metadata.source, name: source}, "origin": origin}
    return replace(metadata, **values)


def _without_tilt(metadata: SemMetadata) -> SemMetadata:
    source = {name: origin for name, origin in metadata.source.items() if name != "tilt_rad"}
    origin = {name: text for name, text in metadata.origin.items() if name != "tilt_rad"}
    return replace(metadata, tilt_rad=np.nan, source=source, origin=origin)


def _credible_tilts(
    names: Sequence[str], metadata: list[SemMetadata], given_deg: Sequence[float], warnings: list[str]
) -> list[SemMetadata]:
    """Drop tilts out of range, and all tilts when they do not differ: no series, or a header that was copied."""
    settled = []
    for name, view in zip(names, metadata, strict=True):
        if abs(view.tilt_rad) > np.deg2rad(MAX_TILT_DEG):
            tilt_deg = np.rad2deg(view.tilt_rad)
            warnings.append(f"{name}: its header gives a tilt of {tilt_deg:g} deg; it is taken as unknown")
            view = _without_tilt(view)
        settled.append(view)
    tilts_deg = np.rad2deg([view.tilt_rad for view in settled])
    known = np.isfinite(tilts_deg)
    if np.count_nonzero(known) >= 2 and np.ptp(tilts_deg[known]) <= _EQUAL_TILT_DEG:
        warnings.append(
            f"the headers give the same stage tilt ({round(abs(tilts_deg[known][0]), 2):g} deg) for "
            f"{np.count_nonzero(known)} images: they are no tilt series, or the header was copied from one image to "
            "the others; the tilts are taken as unknown: give them if you know them"
        )
        return [_without_tilt(view) for view in settled]
    known |= np.isfinite(given_deg) if given_deg else False
    if 0 < np.count_nonzero(known) < len(names) and len(names) > 2:  # of two views nothing is estimated
        missing = [name for name, is_known in zip(names, known, strict=True) if not is_known]
        warnings.append(f"no tilt is known for {', '.join(missing)}; it is estimated from the images")
    return settled


def _jeol_tilts(metadata: list[SemMetadata], warnings: list[str]) -> list[SemMetadata]:
    """Tell tilt from rotation where every view has both: in a tilt series only the tilt changes."""
    angles = [stage_angles(view.raw) if view.vendor == "JEOL" else None for view in metadata]
    if None in angles or all("tilt_rad" in view.source for view in metadata):
        return metadata
    readings = np.array(angles)
    changing = np.flatnonzero(np.ptp(readings, axis=0) > _EQUAL_TILT_DEG)
    if len(changing) != 1:
        return metadata
    tilts_deg = readings[:, changing[0]]
    warnings.append(
        f"of the two angles of the JEOL stage only one changes, from {tilts_deg.min():g} to {tilts_deg.max():g} deg: "
        "it is taken as the tilt, with the sign of Zeiss and Thermo Fisher; if hills come out as pits, give the tilts "
        "with the other sign"
    )
    told = [
        _with(view, "tilt_rad", TILT_SIGN * np.deg2rad(tilt) + 0.0, "file")
        for view, tilt in zip(metadata, tilts_deg, strict=True)
    ]
    origin = f"angle {changing[0] + 1} of $CM_STAGE_POS, which alone changes"
    return [replace(view, origin={**view.origin, "tilt_rad": origin}) for view in told]


def _vendor_raw(metadata: SemMetadata) -> dict[str, str]:
    return {key: value for key, value in metadata.raw.items() if not key.startswith(FILE_KEY_PREFIX)}


def _doubted_where_copied(metadata: list[SemMetadata], warnings: list[str]) -> list[SemMetadata]:
    """Mark the files' pixel sizes as doubtful where all hold one header, with a warning."""
    blocks = [_vendor_raw(view) for view in metadata]
    size = metadata[0].pixel_size_um
    if len(blocks) < 2 or not blocks[0] or any(block != blocks[0] for block in blocks[1:]) or not np.isfinite(size):
        return metadata
    software = metadata[0].raw.get(FILE_KEY_PREFIX + "software", "")
    by = f" (written by {software})" if software else ""
    warnings.append(
        f"all {len(blocks)} files hold the very same microscope header{by}: it was copied, so the pixel size "
        f"({size:.6g} um) is doubtful; give the true one if you know it"
    )
    return [
        replace(view, source={**view.source, "pixel_size_um": "doubtful"})
        if view.source.get("pixel_size_um") == "file"
        else view
        for view in metadata
    ]


def _complete_pixel_sizes(names: Sequence[str], metadata: list[SemMetadata], warnings: list[str]) -> list[SemMetadata]:
    """Take the median for views without a pixel size, and warn of a wide spread."""
    sizes = np.array([view.pixel_size_um for view in metadata])
    known = np.isfinite(sizes)
    if not known.any():
        return metadata
    if sizes[known].max() > (1 + _PIXEL_SIZE_SPREAD) * sizes[known].min():
        smallest, largest = int(np.nanargmin(sizes)), int(np.nanargmax(sizes))
        warnings.append(
            f"the pixel sizes differ by {100 * (sizes[largest] / sizes[smallest] - 1):.1f} %: "
            f"{sizes[smallest]:.6g} um in {names[smallest]}, {sizes[largest]:.6g} um in {names[largest]}; "
            "take a series at one magnification"
        )
    if known.all():
        return metadata
    median = float(np.median(sizes[known]))
    missing = [name for name, is_known in zip(names, known, strict=True) if not is_known]
    warnings.append(
        f"no pixel size is known for {', '.join(missing)}; {median:.6g} um, the median of the others, is assumed"
    )
    return [
        view if is_known else _with(view, "pixel_size_um", median, "assumed")
        for view, is_known in zip(metadata, known, strict=True)
    ]


def _warn_of_differing_rotation(metadata: Sequence[SemMetadata], warnings: list[str]) -> None:
    rotations = np.rad2deg([view.scan_rotation_rad for view in metadata])
    known = np.isfinite(rotations)
    if known.any() and np.ptp(rotations[known]) > _EQUAL_ROTATION_DEG:
        warnings.append(
            f"the scan rotation differs between the images, from {rotations[known].min():.1f} to "
            f"{rotations[known].max():.1f} deg: the tilt axis turns with it; keep one scan rotation"
        )
