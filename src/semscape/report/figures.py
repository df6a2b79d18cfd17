"""The report's pictures as PNG, drawn with matplotlib's object-oriented interface.

Text and lines are a mid grey on a transparent ground, so that one picture reads well on a light and on a
dark page. matplotlib is imported inside the functions: it is slow to load and only the report needs it.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from semscape.report.hillshade import hillshade
from semscape.report.wording import UNIT_SIGNS, Z_95
from semscape.types import FloatArray, HeightMap, Reconstruction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#808a96"
ACCENT = "#2f81d6"
WARM = "#e0812b"
NO_DATA = (0.35, 0.55, 0.80, 0.22)
GREY_NO_DATA = (0.5, 0.5, 0.5, 0.45)  # beside colours that are bluish themselves
_DPI = 150
_LONGEST_SIDE_PX = 1100


@contextmanager
def _style() -> Iterator[None]:
    """Draw with the report's own settings, whatever the user's matplotlibrc says."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(
            {
                "font.size": 9,
                "axes.edgecolor": INK,
                "axes.labelcolor": INK,
                "axes.linewidth": 0.7,
                "text.color": INK,
                "xtick.color": INK,
                "ytick.color": INK,
                "axes.facecolor": "none",
                "legend.frameon": False,
                "axes.unicode_minus": True,
            }
        )
        yield


def drawn_png(size_in: tuple[float, float], draw: Callable[[Figure], None], dpi: int = _DPI, colours: int = 0) -> bytes:
    """Return the PNG of a figure that `draw` fills, in the report's style: grey ink on a transparent ground.

    With `colours` (2 to 256) it is reduced to so many, a third of the bytes: for shaded surfaces.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with _style():
        figure = Figure(figsize=size_in, dpi=dpi, layout=ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02))
        FigureCanvasAgg(figure)
        draw(figure)
        buffer = io.BytesIO()
        # "tight", because the constrained layout cuts labels of axes whose aspect is fixed.
        figure.savefig(
            buffer, format="png", facecolor="none", bbox_inches="tight", pad_inches=0.04, metadata={"Software": None}
        )
    return _with_few_colours(buffer, colours) if colours else buffer.getvalue()


def _with_few_colours(png: io.BytesIO, colours: int) -> bytes:
    from PIL import Image

    with Image.open(png) as image:
        # The one method that keeps the transparent ground.
        reduced = image.convert("RGBA").quantize(colours, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    reduced.save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def height_picture(height_map: HeightMap) -> bytes:
    """Return the height map with its colour bar, axes in the map's unit."""
    sign = UNIT_SIGNS[height_map.length_unit]
    return _map_picture(height_map, height_map.height_um, "viridis", f"Height ({sign})")


def uncertainty_picture(height_map: HeightMap) -> bytes:
    """Return the map of the heights' 1-sigma uncertainty with its colour bar."""
    sign = UNIT_SIGNS[height_map.length_unit]
    return _map_picture(height_map, height_map.uncertainty_um, "magma", f"Uncertainty, 1 σ ({sign})", half=True)


def hillshade_picture(height_map: HeightMap) -> bytes:
    """Return the shaded relief, lit from the upper left."""
    shade = hillshade(height_map.height_um, height_map.pixel_size_um)
    return _map_picture(height_map, shade, "gray", None, limits=(0.0, 1.0), half=True)


def error_picture(height_map: HeightMap, error_um: FloatArray) -> bytes:
    """Return the map of signed height errors (H, W) in the map's unit, blue too low and red too high, with its bar.

    Grey is unknown.
    """
    sign = UNIT_SIGNS[height_map.length_unit]
    known = np.abs(error_um[np.isfinite(error_um)])
    # Symmetric, so that white is no error; false heights shall not wash out the rest.
    largest = max(float(np.percentile(known, 98)), 1e-12) if known.size else 1.0
    limits = -largest, largest
    label = f"Height error, found − true ({sign})"
    return _map_picture(height_map, error_um, "RdBu_r", label, limits=limits, no_data=GREY_NO_DATA)


def tilt_picture(reconstruction: Reconstruction, names: tuple[str, ...], prior_sigma_deg: float) -> bytes:
    """Return the recovered tilts, and what they differ from the stage's, with 95 % bars.

    Parameters
    ----------
    reconstruction : Reconstruction
        Motion with its sigmas; without stage tilts the difference to equal steps is drawn.
    names : tuple of str
        Name of each view.
    prior_sigma_deg : float
        Trust in a stage tilt, drawn as a band.
    """
    tilt = np.rad2deg(reconstruction.motion.tilt_rad)
    bars = Z_95 * np.rad2deg(reconstruction.tilt_sigma_rad)
    prior = np.rad2deg(reconstruction.tilt_prior_rad)
    rows = np.arange(len(names))
    has_prior = bool(np.isfinite(prior).any())
    reference = prior if has_prior else np.polyval(np.polyfit(rows, tilt, 1), rows)

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, sharey=True)
        style: dict[str, Any] = {"fmt": "o", "color": ACCENT, "markersize": 5, "capsize": 3, "elinewidth": 1.4}
        left.errorbar(tilt, rows, xerr=bars, label="recovered", **style)
        if has_prior:
            left.plot(prior, rows, "|", color=WARM, markersize=15, markeredgewidth=1.6, label="stage")
        left.set(
            xlabel="Tilt (°)", yticks=rows, yticklabels=[_short(name) for name in names], ylim=(rows[-1] + 0.6, -0.6)
        )
        right.errorbar(tilt - reference, rows, xerr=bars, **style)
        right.axvline(0.0, color=WARM, linewidth=1.0)
        if has_prior:
            right.axvspan(-Z_95 * prior_sigma_deg, Z_95 * prior_sigma_deg, color=WARM, alpha=0.13, linewidth=0)
        right.set_xlabel("Recovered − stage (°)" if has_prior else "Recovered − equal steps (°)")
        for axes in (left, right):
            axes.grid(axis="x", color=INK, alpha=0.25, linewidth=0.5)
            axes.spines[["top", "right"]].set_visible(False)
        if has_prior:
            left.legend(loc="upper right", fontsize=8)

    return drawn_png((10.0, 1.1 + 0.32 * len(names)), draw)


def _map_picture(
    height_map: HeightMap,
    values: FloatArray,
    colours: str,
    bar_label: str | None,
    limits: tuple[float, float] | None = None,
    half: bool = False,
    no_data: tuple[float, float, float, float] = NO_DATA,
) -> bytes:
    """Return a map over the grid of a height map, of the page's or half the page's width.

    It gets a colour bar where that has a label; at half width the bar lies below, so that maps side by
    side have one size.
    """
    small = _shrink(values)
    low, high = limits or _limits(values, 0.5)
    rows, columns = values.shape
    corners = np.array([[-0.5, rows - 0.5, 0, 1], [columns - 0.5, -0.5, 0, 1]]) @ height_map.world_from_grid.T
    (left, bottom), (right, top) = corners[:, :2]
    sign = UNIT_SIGNS[height_map.length_unit]

    def draw(figure: Figure) -> None:
        axes: Axes = figure.add_subplot()
        axes.set_facecolor(no_data)
        picture = axes.imshow(
            np.ma.masked_invalid(small),
            cmap=colours,
            vmin=low,
            vmax=high,
            extent=(left, right, bottom, top),
            interpolation="nearest",
        )
        axes.set(xlabel=f"x ({sign})", ylabel=f"y ({sign})")
        axes.tick_params(length=3, width=0.6)
        if bar_label:
            # Values beyond the shown range are cut in colour, not in the data: the bar's points say so.
            side: dict[str, Any] = (
                {"location": "bottom", "fraction": 0.06, "aspect": 40} if half else {"fraction": 0.05}
            )
            bar = figure.colorbar(picture, ax=axes, extend="both", pad=0.02, **({"aspect": 28} | side))
            bar.set_label(bar_label)
            bar.outline.set_visible(False)

    width = 5.0 if half else 7.6
    height = (0.9 * width if half else 0.82 * width) * rows / columns + (
        0.45 if not half else 1.0 if bar_label else 0.4
    )
    return drawn_png((width, float(np.clip(height, 2.0, 9.0))), draw)


def _limits(values: FloatArray, percent: float) -> tuple[float, float]:
    """Return a colour range without the outermost percent on either side."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, [percent, 100 - percent])
    return (float(low), float(high)) if high > low else (float(low) - 0.5, float(low) + 0.5)


def _shrink(values: FloatArray) -> FloatArray:
    """Return the array with blocks averaged so that it fits a page; NaN where a block holds mostly NaN."""
    step = -(-max(values.shape) // _LONGEST_SIDE_PX)
    if step == 1:
        return values
    rows, columns = (-(-size // step) * step for size in values.shape)
    padded = np.full((rows, columns), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(rows // step, step, columns // step, step)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    total = np.nansum(blocks, axis=(1, 3))
    mean: FloatArray = np.where(2 * known >= step * step, total / np.maximum(known, 1), np.nan)
    return mean


def _short(name: str, length: int = 24) -> str:
    """Return a name cut in its middle to fit a picture."""
    half = (length - 1) // 2
    return name if len(name) <= length else f"{name[:half]}…{name[-half:]}"
