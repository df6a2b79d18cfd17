"""Find text that is burnt straight into the images, without a strip under it, as JEOL does.

One view cannot tell a glyph from a bright grain. Over a series, the specimen moves and its noise changes, while
glyphs stay: a patch of the brightest (or darkest) value that has the same outline in every view is none of the
specimen's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from semscape.types import BoolArray, ImageArray

_LEAST_PATCH_PX = 12
_LARGEST_PATCH_SHARE = 0.02  # of the image
_OTHER_OUTLINE = 0.05  # of the pixels along the outline may differ
_LEAST_PATCHES = 3  # text has many
_MARGIN_PX = 3  # shadows, outlines and what smoothing and compression smear


def find_burnt_in_text(images: Sequence[ImageArray], masks: Sequence[BoolArray]) -> BoolArray:
    """Return where all views show the same saturated patches.

    Parameters
    ----------
    images : V arrays (H, W) float32
        The views of a series, values as stored.
    masks : V arrays (H, W) bool
        False on data bars, where nothing is looked for.

    Returns
    -------
    (H, W) bool array
        True on the text and a margin of 3 px about it; all False where fewer than three patches are found.
    """
    from scipy.ndimage import binary_dilation

    imaged = np.logical_and.reduce(masks)
    text = np.zeros(imaged.shape, dtype=np.bool_)
    for extreme in (np.max, np.min):
        saturated = [(image == extreme(image)) & imaged for image in images]
        text |= _same_patches(saturated)
    if not text.any():
        return text
    return cast(BoolArray, binary_dilation(text, iterations=_MARGIN_PX) & imaged)


def _same_patches(saturated: list[BoolArray]) -> BoolArray:
    from scipy.ndimage import find_objects, label

    found = np.zeros(saturated[0].shape, dtype=np.bool_)
    always = np.logical_and.reduce(saturated)
    if len(saturated) < 2 or np.count_nonzero(always) < _LEAST_PATCHES * _LEAST_PATCH_PX:
        return found
    labels: list[NDArray[np.int32]] = [label(patches, np.ones((3, 3)))[0] for patches in saturated]
    sizes = [np.bincount(view.ravel()) for view in labels]
    first, first_sizes = labels[0], sizes[0]
    kept = np.bincount(first.ravel(), weights=always.ravel())
    candidates = (kept >= (1 - _OTHER_OUTLINE) * first_sizes) & (first_sizes >= _LEAST_PATCH_PX)
    candidates &= first_sizes <= _LARGEST_PATCH_SHARE * first.size
    candidates[0] = False
    boxes = find_objects(first)
    n_patches = 0
    for number in np.flatnonzero(candidates):
        box = boxes[number - 1]
        patch = first[box] == number
        if all(_like(patch, other[box], other_sizes) for other, other_sizes in zip(labels[1:], sizes[1:], strict=True)):
            found[box] |= patch
            n_patches += 1
    return found if n_patches >= _LEAST_PATCHES else np.zeros_like(found)


def _like(patch: BoolArray, labels: NDArray[np.int32], sizes: NDArray[np.int64]) -> bool:
    """Tell whether another view has a patch of the same outline at this place.

    What differs is counted against the outline, not the area: a large patch that has moved by a pixel is no glyph.
    """
    from scipy.ndimage import binary_erosion

    counts = np.bincount(labels[patch])
    if len(counts) < 2:
        return False
    number = int(counts[1:].argmax()) + 1
    size = int(np.count_nonzero(patch))
    differing = size + int(sizes[number]) - 2 * int(counts[number])
    outline = size - int(np.count_nonzero(binary_erosion(patch)))
    return differing <= _OTHER_OUTLINE * outline
