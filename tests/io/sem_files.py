"""Write small image files with the metadata of real microscopes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

ZEISS_TAG = 34118
FEI_TAG = 34682


def noise(seed: int, shape: tuple[int, int] = (96, 128), dtype: str = "uint8") -> np.ndarray:
    """Return a grey noise image that fills about half of the type's range."""
    top = np.iinfo(dtype).max
    values = np.random.default_rng(seed).normal(0.5 * top, 0.12 * top, shape)
    return np.clip(values, 0, top).astype(dtype)


def zeiss_text(**lines: str) -> str:
    """Return a SmartSEM text: a head of numbers, then each key with its line."""
    body = "".join(f"{key}\r\n{line}\r\n" for key, line in lines.items())
    return f"0\r\n0\r\n5.932882e-07\r\n1.881884e+02\r\n{len(lines)}\r\n{body}"


def fei_text(**sections: dict[str, Any]) -> str:
    """Return the INI text of a Thermo Fisher microscope."""
    lines = []
    for section, values in sections.items():
        lines += [f"[{section}]", *(f"{key}={value}" for key, value in values.items()), ""]
    return "\r\n".join(lines)


def write_tiff(path: Path, image: np.ndarray, zeiss: str = "", fei: str = "", **options: Any) -> Path:
    """Write a TIFF with the vendor's tag."""
    tags = [(tag, "s", 0, text.encode("cp1252"), True) for tag, text in ((ZEISS_TAG, zeiss), (FEI_TAG, fei)) if text]
    tifffile.imwrite(path, image, extratags=tags, metadata=None, **options)
    return path


def write_image(path: Path, image: np.ndarray, **options: Any) -> Path:
    """Write a PNG, JPEG or BMP."""
    Image.fromarray(image).save(path, **options)
    return path


def write_tilted(folder: Path, tilts_deg: list[float], pixel_size_nm: float = 50.0) -> list[Path]:
    """Write Zeiss TIFFs img1.tif, img2.tif, ... with these stage tilts in the header."""
    return [
        write_tiff(
            folder / f"img{i + 1}.tif",
            noise(i),
            zeiss=zeiss_text(
                AP_IMAGE_PIXEL_SIZE=f"Image Pixel Size = {pixel_size_nm} nm", AP_STAGE_AT_T=f"Stage at T = {tilt} °"
            ),
        )
        for i, tilt in enumerate(tilts_deg)
    ]


def draw_bar(image: np.ndarray, rows: int, background: int = 0, ink: int = 255, frame: bool = True) -> np.ndarray:
    """Return the image with a bar of blocky letters drawn over its lowest rows."""
    out = image.copy()
    bar = np.full((rows, image.shape[1]), background, dtype=image.dtype)
    # Blocks of 4 x 4 px over the left part stand in for letters, the rest stays blank as in real bars.
    letters = np.random.default_rng(7).random(((rows - 8) // 4, image.shape[1] // 6)) < 0.35
    text = np.kron(letters, np.ones((4, 4), dtype=bool))
    bar[4 : 4 + text.shape[0], 8 : 8 + text.shape[1]][text] = ink
    if frame:
        bar[0], bar[-1] = ink, ink
    out[-rows:] = bar
    return out
