"""What goes wrong on the way from the signal to the file: beam, scan, charging, noise, gain, data bar."""

from __future__ import annotations

import math
import zlib

import numpy as np
from scipy import ndimage

from semscape.simulate.presets import SimulationOptions
from semscape.types import FloatArray, ImageArray

_BLUR_STEP_PX = 0.25


def stream(seed: int, stage: str, view: int = 0) -> np.random.Generator:
    """Return the random stream of one stage of one view, independent of every other and of their order."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(stage.encode()), view]))


def scan_offsets(options: SimulationOptions, seed: int, view: int) -> FloatArray:
    """Return how far the beam lands from the pixel it belongs to, (height_px, 2) px, per scan line.

    Line jitter is white along x. The slow drift is a sum of a few sines whose straight-line part is taken out: a
    linear drift is a scan anisotropy or a shear, and the true motion must hold all of it.
    """
    rows = options.height_px
    rng = stream(seed, "scan", view)
    jitter = rng.standard_normal(rows)
    time = np.arange(rows) / rows
    offsets = np.zeros((rows, 2))
    for axis in range(2):
        drift = np.zeros(rows)
        for k in range(1, 5):
            drift += rng.standard_normal() / k * np.sin(np.pi * k * time + rng.uniform(0, 2 * np.pi))
        drift -= np.polynomial.Polynomial.fit(time, drift, 1)(time)
        offsets[:, axis] = options.drift_px * drift / max(float(drift.std()), 1e-12)
    offsets[:, 0] += options.jitter_px * jitter
    return offsets


def blur_beam(signal: FloatArray, depth_px: FloatArray, options: SimulationOptions) -> FloatArray:
    """Blur a signal (H, W) by the beam, wider where the surface is out of focus.

    `depth_px` (H, W) is the distance from the focal plane, NaN where there is no surface: the beam is taken as focused
    there. Between a few fixed sigmas the image is interpolated.
    """
    if options.blur_px <= 0 and options.defocus <= 0:
        return signal
    sigma = np.hypot(options.blur_px, options.defocus * np.nan_to_num(depth_px))
    steps = max(1, math.ceil((float(sigma.max()) - float(sigma.min())) / _BLUR_STEP_PX))
    levels = np.linspace(float(sigma.min()), float(sigma.max()), steps + 1)
    if levels[-1] - levels[0] < 1e-9:
        return _gaussian(signal, float(levels[0]))
    position = (sigma - levels[0]) / (levels[1] - levels[0])
    blurred = np.zeros(signal.shape)
    for step, level in enumerate(levels):
        blurred += np.clip(1.0 - np.abs(position - step), 0.0, None) * _gaussian(signal, float(level))
    return blurred


def _gaussian(signal: FloatArray, sigma_px: float) -> FloatArray:
    smooth: FloatArray = signal if sigma_px <= 0 else ndimage.gaussian_filter(signal, sigma_px, mode="nearest")
    return smooth


def charging_streaks(signal: FloatArray, options: SimulationOptions, seed: int, view: int) -> FloatArray:
    """Return the charging (H, W) to add to a signal of the same unit: tails behind bright points along the scan.

    A point that emits much charges; until it has discharged, the rest of its line is too bright or too dark.
    """
    out = np.zeros_like(signal)
    if options.charging <= 0:
        return out
    rng = stream(seed, "charging", view)
    height, width = signal.shape
    for _ in range(rng.poisson(height / 6)):
        rows, cols = rng.integers(0, height, 16), rng.integers(0, width, 16)
        brightest = int(np.argmax(signal[rows, cols]))
        row, col = int(rows[brightest]), int(cols[brightest])
        decay = rng.uniform(0.02, 0.3) * width
        tail = np.exp(-np.arange(width - col) / decay)
        out[row, col:] += rng.normal() * options.charging * tail
    return out * float(signal.mean())


def detect(
    signal: FloatArray, options: SimulationOptions, seed: int, view: int, channel: int = 0, share: float = 1.0
) -> FloatArray:
    """Count electrons: Poisson noise at `dose` electrons per pixel of mean signal, and the line-to-line noise.

    `signal` (H, W) is in units of the series' mean signal, and so is the result. Of several channels each counts its
    `share` of the electrons; the line noise is the beam's, so it is the same in all.
    """
    lines = 1.0 + options.line_noise * stream(seed, "lines", view).standard_normal(len(signal))
    expected: FloatArray = np.maximum(signal, 0.0) * lines[:, None]
    if options.dose <= 0:
        return expected
    electrons = options.dose * share
    return stream(seed, f"dose{channel or ''}", view).poisson(expected * electrons) / electrons


def digitize(
    signal: FloatArray, black: float, white: float, options: SimulationOptions, seed: int, view: int
) -> ImageArray:
    """Map `black` to 0 and `white` to 255 with the view's own brightness and contrast, and round to 8 bits.

    Returns
    -------
    (H, W) float32 array
        Whole numbers 0 to 255.
    """
    rng = stream(seed, "gain", view)
    brightness = options.brightness * rng.standard_normal()
    contrast = np.exp(options.contrast * rng.standard_normal())
    level = (signal - black) / (white - black)
    # Contrast turns about mid grey, as the operator's knob does.
    level = (level - 0.4) * contrast + 0.4 + brightness
    image: ImageArray = np.clip(np.rint(255.0 * level), 0, 255).astype(np.float32)
    return image


_GLYPHS = {  # 3 x 5 bitmaps, one row of three bits per digit
    "0": "75557", "1": "26227", "2": "71747", "3": "71717", "4": "55711", "5": "74717", "6": "74757",
    "7": "71222", "8": "75757", "9": "75717", ".": "00002", "-": "00700", "+": "02720", "=": "07070",
    "T": "72222", "M": "57755", "A": "25755", "G": "74557", "W": "55775", "D": "65556", "k": "45655",
    "V": "55552", "m": "00677", "u": "00557", "x": "00525", " ": "00000",
}  # fmt: skip


def burn_data_bar(image: ImageArray, rows: int, text: str, scale_bar_px: int) -> ImageArray:
    """Return the image (H, W) with its last `rows` rows replaced by a black bar with a frame, text and a scale bar."""
    out = image.copy()
    bar = out[len(out) - rows :]
    bar[:] = 0.0
    if rows < 12:
        return out
    bar[[0, -1]] = 255.0
    bar[:, [0, -1]] = 255.0
    zoom = max(1, (rows - 6) // 12)
    top, left = (rows - 5 * zoom) // 2, 8
    for character in text:
        bits = np.array([[int(d) >> (2 - i) & 1 for i in range(3)] for d in _GLYPHS[character]])
        glyph = np.kron(bits, np.ones((zoom, zoom))) * 255.0
        if left + 3 * zoom + 8 >= bar.shape[1]:
            break
        bar[top : top + 5 * zoom, left : left + 3 * zoom] = glyph
        left += 4 * zoom
    right = bar.shape[1] - 8
    bar[rows // 2 - 1 : rows // 2 + 1, max(left, right - scale_bar_px) : right] = 255.0
    return out
