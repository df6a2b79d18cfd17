"""Undo what the scan did to the image, or warn: tilt correction, dynamic focus, scan rotation.

Tilt correction stretches the image across its axis by 1 / cos of its angle, so that a flat specimen at that tilt
looks as if seen from above. semscape wants the projection as it is; the image is squeezed back by the cosine, where
angle and axis are told.

Scan rotation turns the image, and the stage's tilt axis with it. Header tilts are converted for the axis' direction
at scan rotation 0. Turned by 180 deg the same axis points the other way, so every tilt changes its sign: that is sure,
and done. Microscopes differ in the direction in which they count, so at other angles the axis has two places. Neither
is told to the calibration: the images tell the axis within a fraction of a degree, better than a header, which knows
neither the direction of counting nor on every microscope the axis at rotation 0. From 45 to 135 deg the two places
are axes with opposite signs, and where the images put it tells which sign is right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from semscape.geometry.rotations import wrap_axis_angle
from semscape.io.data_bar import data_bar_rows
from semscape.io.metadata_fields import DATA_BAR_KEY, SCALE_BAR_KEY
from semscape.io.scale_bar import find_scale_bar
from semscape.types import BoolArray, ImageArray, Micrograph, SemMetadata

_STRAIGHT_DEG = 0.5  # a scan rotation this close to 0 or 180 deg turns nothing
_LARGEST_CORRECTION_DEG = 75.0
_TOLD_APART_DEG = 10.0  # the images tell two axes apart that are so far from each other


def undo_scan_settings(views: Sequence[Micrograph]) -> tuple[list[Micrograph], list[str]]:
    """Return views in plain projection with the tilts' sign as scanned, and warnings with their evidence."""
    notes: dict[str, list[str]] = {}
    corrected = [_undo_tilt_correction(view, notes) for view in views]
    warnings = [f"{', '.join(names)}: {text}" for text, names in notes.items()]
    focused = [view for view in corrected if view.metadata.dynamic_focus]
    if focused:
        evidence = focused[0].metadata.origin.get("dynamic_focus", "series.toml")
        warnings.append(
            f"dynamic focus was on for {_names(focused)} ({evidence}): the magnification then changes from the first "
            "to the last line, which semscape does not undo; switch it off for tilt series"
        )
    turned = [replace(view, metadata=_turn_tilt(view.metadata)) for view in corrected]
    _warn_of_rotation(turned, corrected, warnings)
    return turned, warnings


def squeeze_rows(image: ImageArray, mask: BoolArray, factor: float) -> tuple[ImageArray, BoolArray]:
    """Return an image whose rows are `factor` (below 1) times as far apart, about its middle row; the rest is masked.

    Parameters
    ----------
    image : (H, W) float32 array
        Values as stored.
    mask : (H, W) bool array
        False on the data bar, whose rows stay where they are.
    factor : float
        Cosine of the tilt correction's angle.
    """
    from scipy.ndimage import affine_transform

    imaged = np.flatnonzero(mask.any(axis=1))
    if len(imaged) == 0:
        return image, mask
    first, last = int(imaged[0]), int(imaged[-1])
    middle = (last - first) / 2
    offset = middle - middle / factor

    def squeezed(values: np.ndarray, order: int) -> np.ndarray:
        part = values[first : last + 1]
        return np.asarray(affine_transform(part, (1 / factor, 1.0), (offset, 0.0), order=order, mode="nearest"))

    rows = np.arange(last - first + 1) / factor + offset
    inside = (rows >= 0) & (rows <= last - first)
    new_image, new_mask = image.copy(), np.zeros_like(mask)
    new_image[first : last + 1] = squeezed(image, 3)
    new_mask[first : last + 1] = (squeezed(mask.astype(np.float32), 1) > 0.999) & inside[:, None]
    return new_image, new_mask


def _undo_tilt_correction(view: Micrograph, notes: dict[str, list[str]]) -> Micrograph:
    """Return a view in plain projection; put its name to the text that says what was done, or why nothing was."""
    angle = view.metadata.tilt_correction_rad
    if angle is None or angle == 0:
        return view
    metadata = view.metadata
    evidence = metadata.origin.get("tilt_correction_rad", "series.toml")
    axis_deg, rotation_deg = math.degrees(metadata.tilt_correction_axis_rad), math.degrees(metadata.scan_rotation_rad)
    what = "tilt correction was on"
    out = "switch it off for tilt series; tilt_correction_deg = 0 in series.toml says that it was off"
    if not abs(math.degrees(angle)) <= _LARGEST_CORRECTION_DEG:
        told = "of an angle that is not told" if math.isnan(angle) else f"by {math.degrees(angle):g} deg"
        text = f"{what} {told} ({evidence}): the image is stretched across the tilt axis; {out}"
        notes.setdefault(text, []).append(view.name)
        return view
    by_user = metadata.source.get("tilt_correction_axis_rad") == "sidecar"
    if math.isnan(axis_deg) or not (by_user or abs(math.remainder(rotation_deg, 180.0)) <= _STRAIGHT_DEG):
        scan = "an unknown scan rotation" if math.isnan(rotation_deg) else f"a scan rotation of {rotation_deg:g} deg"
        text = (
            f"{what} by {math.degrees(angle):g} deg ({evidence}) with {scan}: in which direction the image is "
            "stretched is not sure, so it stays; in series.toml, tilt_correction_axis_deg = 0 (stretched from top to "
            f"bottom) or 90 (from left to right) has it undone; {out}"
        )
        notes.setdefault(text, []).append(view.name)
        return view
    factor = math.cos(angle)
    if axis_deg == 0:
        image, mask = squeeze_rows(view.image, view.mask, factor)
    else:
        turned, turned_mask = squeeze_rows(view.image.T, view.mask.T, factor)
        image, mask = np.ascontiguousarray(turned.T), np.ascontiguousarray(turned_mask.T)
    text = (
        f"{what} by {math.degrees(angle):g} deg ({evidence}): undone, the {'rows' if axis_deg == 0 else 'columns'} are "
        f"squeezed to {factor:.4f}; {out}"
    )
    notes.setdefault(text, []).append(view.name)
    return replace(view, image=image, mask=mask, metadata=replace(metadata, raw={**metadata.raw, **_seen_in(view)}))


def _seen_in(view: Micrograph) -> dict[str, str]:
    """Return the heights and lengths that squeezing changes: masked rows look like a bar, a bar is shorter."""
    bar = find_scale_bar(view.image, view.mask)
    return {
        DATA_BAR_KEY: str(data_bar_rows(view.mask)),
        SCALE_BAR_KEY: "" if bar is None else f"{bar.length_px:.9g}",
    }


def _turn_tilt(metadata: SemMetadata) -> SemMetadata:
    """Return metadata whose header tilt has the sign of an image scanned upside down."""
    from_header = metadata.source.get("tilt_rad") == "file"
    if from_header and math.cos(metadata.scan_rotation_rad) < -math.sqrt(0.5):
        return replace(metadata, tilt_rad=-metadata.tilt_rad + 0.0)
    return metadata


def _warn_of_rotation(turned: Sequence[Micrograph], before: Sequence[Micrograph], warnings: list[str]) -> None:
    flipped = [
        view
        for view, old in zip(turned, before, strict=True)
        if view.metadata.tilt_rad not in (old.metadata.tilt_rad, 0.0) and math.isfinite(view.metadata.tilt_rad)
    ]
    if flipped:
        warnings.append(
            f"the scan was turned by about 180 deg for {_names(flipped)} "
            f"({flipped[0].metadata.origin.get('scan_rotation_rad', 'series.toml')}): the stage tilts' sign is turned"
        )
    oblique = [view for view in turned if abs(math.remainder(_rotation_deg(view), 180.0)) > _STRAIGHT_DEG]
    if not oblique:
        return
    rotation_deg = _rotation_deg(oblique[0])
    angle = abs(math.remainder(rotation_deg, 180.0))
    text = (
        f"the scan rotation of {rotation_deg:g} deg "
        f"({oblique[0].metadata.origin.get('scan_rotation_rad', 'series.toml')}) turns the tilt axis in the image by "
        f"{angle:g} or {-angle:g} deg: microscopes count in either direction, so it is estimated from the images"
    )
    if angle > 45 and any(view.metadata.source.get("tilt_rad") == "file" for view in oblique):
        text += f"; the sign of the stage tilts is not sure either: {_how_to_tell_the_sign(rotation_deg)}"
    warnings.append(text)


def _how_to_tell_the_sign(rotation_deg: float) -> str:
    """Say where the axis lies in the image if the tilts' sign is right, and where if it is not."""
    places = [wrap_axis_angle(math.radians(counted * rotation_deg)) for counted in (1, -1)]
    if abs(places[0][0] - places[1][0]) < math.radians(_TOLD_APART_DEG):
        return "if hills come out as pits, give --tilts with the other sign"
    right, wrong = (f"{math.degrees(axis):.0f} deg" for axis, _ in sorted(places, key=lambda place: place[1]))
    return (
        f"where the axis was horizontal before, it is right if the axis is found near {right}, and if near {wrong}, "
        "give --tilts with the other sign"
    )


def _rotation_deg(view: Micrograph) -> float:
    return math.degrees(view.metadata.scan_rotation_rad) if math.isfinite(view.metadata.scan_rotation_rad) else 0.0


def _names(views: Sequence[Micrograph]) -> str:
    return ", ".join(view.name for view in views)
