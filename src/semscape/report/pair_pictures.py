"""The matches of each pair as drawings: every view is in the page once, the pairs are lines and dots over it."""

from __future__ import annotations

import io
from html import escape

import numpy as np
from PIL import Image

from semscape.report.markup import picture_data
from semscape.types import FloatArray, Matches, Micrograph, Result, TwoViewGeometry

_VIEW_WIDTH_PX, _FULL_VIEWS = 440, 12
_JPEG_QUALITY = 68
_MOST_PAIRS = 66
_MOST_DOTS, _FEWEST_DOTS, _ALL_DOTS = 260, 30, 14_000
_LINES = 18
_COLOURS = 6


def pair_drawings(result: Result) -> str:
    """Return one drawing for each pair, the colour of an inlier being its parallax; "" where no pair was kept.

    The parallax is the displacement along the pair's main direction of motion, less its median.
    """
    matched = {found.pair: found for found in result.matches}
    kept = [geometry for geometry in result.geometries if geometry.pair in matched and geometry.inliers.any()]
    drawn = kept[:_MOST_PAIRS]
    if not drawn:
        return ""
    shown = sorted({view for geometry in drawn for view in geometry.pair})
    height, width = result.series.shape
    # Many views share the bytes that twelve may take.
    view_width = round(_VIEW_WIDTH_PX * min(1.0, np.sqrt(_FULL_VIEWS / len(shown))))
    views = "".join(
        f'<symbol id="view-{view}" viewBox="0 0 {width} {height}"><image width="{width}" height="{height}" '
        f'href="{picture_data(_view_jpeg(result.series.views[view], view_width), "jpeg")}"/></symbol>'
        for view in shown
    )
    most_dots = int(np.clip(_ALL_DOTS / len(drawn), _FEWEST_DOTS, _MOST_DOTS))
    figures = "".join(_drawing(result, geometry, matched[geometry.pair], most_dots) for geometry in drawn)
    left_out = len(kept) - len(drawn)
    note = f'<p class="quiet">{left_out} more pairs are in the table alone.</p>' if left_out else ""
    return f'<svg class="held" aria-hidden="true"><defs>{views}</defs></svg><div class="pairs">{figures}</div>{note}'


def _drawing(result: Result, geometry: TwoViewGeometry, found: Matches, most_dots: int) -> str:
    first, second = geometry.pair
    inliers = found.indices[geometry.inliers]
    xy1 = result.keypoints[first].xy[inliers[:, 0]]
    xy2 = result.keypoints[second].xy[inliers[:, 1]]
    parallax = _parallax(xy2 - xy1)
    height, width = result.series.shape
    # A fixed permutation spreads the drawn points over the image and is the same on every run.
    order = np.random.default_rng(0).permutation(len(xy1))[:most_dots]
    offset = np.array([1.03 * width, 0.0])
    low, high = np.percentile(parallax, [1, 99])
    bins = np.clip((_COLOURS * (parallax - low) / max(high - low, 1e-9)).astype(np.int64), 0, _COLOURS - 1)
    paths = ""
    for colour in range(_COLOURS):
        dots = order[bins[order] == colour]
        lines = order[:_LINES][bins[order[:_LINES]] == colour]
        share = colour / (_COLOURS - 1)
        stroke = f"rgb({round(255 * share)} {round(255 * (1 - share))} 255)"
        along = "".join(f"M{_xy(a)}L{_xy(b)}" for a, b in zip(xy1[lines], xy2[lines] + offset, strict=True))
        points = "".join(f"M{_xy(a)}h0" for part in (xy1[dots], xy2[dots] + offset) for a in part)
        lines_path = f'<path class="lines" stroke-width="{width / 400:.3g}" d="{along}"/>'
        paths += f'<g stroke="{stroke}">{lines_path}<path d="{points}"/></g>'
    names = [result.series.names[view] for view in geometry.pair]
    count = f"{int(geometry.inliers.sum()):,} inliers of {len(found):,} matches"
    total = 2.03 * width
    return (
        f"<figure><figcaption>{escape(names[0])} – {escape(names[1])}: {count}, parallax {low:.1f} to {high:.1f} px"
        f'</figcaption><svg viewBox="0 0 {total:.0f} {height}" role="img" aria-label="Matches of the pair" '
        f'stroke-width="{width / 75:.3g}"><use href="#view-{first}" width="{width}" height="{height}"/>'
        f'<use href="#view-{second}" x="{offset[0]:.0f}" width="{width}" height="{height}"/>{paths}</svg></figure>'
    )


def _xy(point: FloatArray) -> str:
    return f"{point[0]:.0f} {point[1]:.0f}"


def _view_jpeg(view: Micrograph, width: int) -> bytes:
    """Return a view, small and stretched between the 1st and 99th percentile of what was imaged."""
    known = view.image[view.mask & np.isfinite(view.image)]
    low, high = np.percentile(known, [1.0, 99.0]) if known.size else (0.0, 1.0)
    scaled = (np.nan_to_num(view.image, nan=float(low)) - low) / max(float(high - low), 1e-12)
    picture = Image.fromarray(np.rint(255 * np.clip(scaled, 0.0, 1.0)).astype(np.uint8))
    picture.thumbnail((width, 10 * width), Image.Resampling.BOX)
    stream = io.BytesIO()
    picture.save(stream, "jpeg", quality=_JPEG_QUALITY, optimize=True)
    return stream.getvalue()


def _parallax(displacement: FloatArray) -> FloatArray:
    """Return the displacement (M, 2) along its direction of largest spread, without its median."""
    centred = displacement - np.median(displacement, axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    parallax: FloatArray = centred @ vectors[:, -1]
    return parallax
