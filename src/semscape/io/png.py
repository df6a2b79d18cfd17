"""Pictures as PNG that say what they are and that semscape wrote them."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray


def encode_png(pixels: NDArray[np.uint8], description: str) -> bytes:
    """Return an (H, W) or (H, W, 3) picture as PNG with a description in ASCII."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    text = PngInfo()
    text.add_text("Software", "semscape")
    text.add_text("Description", description)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", pnginfo=text)
    return buffer.getvalue()
