"""Pixel sizes from the scale bar burnt into the images, whose length in um a person reads off and gives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from semscape.errors import BadInputError
from semscape.io.acquisition import GivenAcquisition
from semscape.io.scale_bar import ScaleBar, find_scale_bar
from semscape.types import Micrograph

_READING_PX = 1.5  # the ends of a drawn bar are known to about this
_CONTRADICTION = 0.03  # of the header's pixel size, beside the reading of the ends


def scale_by_bar(
    folder: Path, views: Sequence[Micrograph], given: GivenAcquisition
) -> tuple[list[Micrograph], list[str]]:
    """Return views with the pixel size of their scale bar, where its length is given, and warnings.

    Without a pixel size and without that length a warning says how long the bar is.

    Raises
    ------
    BadInputError
        Where the length is given and an image shows no scale bar, or bars of different lengths.
    """
    if not math.isfinite(given.scale_bar_um):
        if any(math.isfinite(view.metadata.pixel_size_um) for view in views):
            return list(views), []
        bar = find_scale_bar(views[0].image, views[0].mask)
        return list(views), [] if bar is None else [_advice(views[0].name, bar)]
    bars = []
    for view in views:
        found = find_scale_bar(view.image, view.mask)
        if found is None:
            raise BadInputError(
                f"{folder / view.name}: no scale bar is found in the image; give the pixel size instead"
            )
        bars.append(found)
    lengths = np.array([bar.length_px for bar in bars])
    if np.ptp(lengths) > 2 * _READING_PX:
        listed = ", ".join(f"{length:g} px in {view.name}" for length, view in zip(lengths, views, strict=True))
        raise BadInputError(f"{folder}: the scale bars differ ({listed}); give the pixel size instead")
    length_px = float(np.median(lengths))
    size_um = given.scale_bar_um / length_px
    warnings = [
        f"the pixel size of {size_um:.6g} um comes from a scale bar of {given.scale_bar_um:g} um that is "
        f"{length_px:g} px long ({_place(bars[0])}): it is good to about {100 * _READING_PX / length_px:.1f} %"
    ]
    told = [view.metadata.pixel_size_um for view in views if math.isfinite(view.metadata.pixel_size_um)]
    if told and abs(told[0] / size_um - 1) > _CONTRADICTION + _READING_PX / length_px:
        warnings.append(f"the headers give a pixel size of {told[0]:.6g} um, the scale bar {size_um:.6g} um")
    origin = f"scale bar of {given.scale_bar_um:g} um, {length_px:g} px"
    return [_with_size(view, size_um, given, origin) for view in views], warnings


def _with_size(view: Micrograph, size_um: float, given: GivenAcquisition, origin: str) -> Micrograph:
    metadata = view.metadata
    return replace(
        view,
        metadata=replace(
            metadata,
            pixel_size_um=size_um,
            source={**metadata.source, "pixel_size_um": given.scale_bar_source},
            origin={**metadata.origin, "pixel_size_um": origin},
        ),
    )


def _advice(name: str, bar: ScaleBar) -> str:
    return (
        f"no pixel size is known, but {name} shows a scale bar {bar.length_px:g} px long ({_place(bar)}): read the "
        "length written beside it, and if that is 40 um, give --scale-bar-um 40"
    )


def _place(bar: ScaleBar) -> str:
    return f"row {bar.row}, columns {bar.first_column} to {bar.last_column}"
