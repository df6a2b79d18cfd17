"""Stereo pictures of two views: red-cyan anaglyph, and side by side."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from semscape.dense.stereo_pair import stereo_pair, stereo_views
from semscape.errors import BadInputError
from semscape.io.finished_run import FinishedViews, read_finished_views
from semscape.io.png import encode_png
from semscape.io.series import load_series
from semscape.types import FloatArray, TiltSeries


def rectified_pair(
    run: Path, images: Path, pixel_size_um: float, angle_deg: float
) -> tuple[FloatArray, FloatArray, str]:
    """Return the pictures of the left and the right eye, and a line that says which views they are.

    Raises
    ------
    BadInputError
        If the folder does not hold the images of the run.
    """
    views = read_finished_views(run)
    series = _series_of(views, images)
    eyes = stereo_views(views.motion, math.radians(angle_deg))
    left, right = stereo_pair(series, views.motion, views.reference, pixel_size_um, eyes)
    tilts = np.round(np.rad2deg(views.motion.tilt_rad), 2) + 0.0  # no -0.00
    named = [f"{side} {views.names[i]} ({tilts[i]:.2f} deg)" for side, i in zip(("left", "right"), eyes, strict=True)]
    return left, right, f"semscape stereo pair: {named[0]}, {named[1]}"


def anaglyph_png(left: FloatArray, right: FloatArray, description: str) -> bytes:
    """Return a red-cyan anaglyph: red to the left eye, green and blue to the right one."""
    return encode_png(np.stack([left, right, right], axis=-1).astype(np.uint8), description)


def side_by_side_png(left: FloatArray, right: FloatArray, description: str) -> bytes:
    """Return both pictures in one, the left eye's at the left, for parallel viewing and for stereo displays."""
    return encode_png(np.concatenate([left, right], axis=1).astype(np.uint8), description)


def _series_of(views: FinishedViews, images: Path) -> TiltSeries:
    """Return the run's views from a folder, in the run's order, and make sure that they are the same files."""
    series = load_series(images, views.told)
    found = dict(zip(series.names, series.views, strict=True))
    for name, digest in zip(views.names, views.digests, strict=True):
        if name not in found or found[name].digest != digest:
            what = "does not hold" if name not in found else "holds another"
            raise BadInputError(f"{images} {what} {name} of the run; give the folder that was reconstructed")
    return replace(series, views=tuple(found[name] for name in views.names))
