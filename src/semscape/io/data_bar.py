"""Find the data bar: the strip of text that microscopes burn into the image, which must never be matched."""

from __future__ import annotations

import numpy as np

from semscape.types import BoolArray, ImageArray

# All shares are fractions of the image width, all contrasts fractions of the image's range of values.
_FLAT = 0.02  # values this close count as the same: exact bars and bars that went through JPEG
_BACKGROUND_SHARE = 0.4  # least share of background in a row of text
_LINE_SHARE = 0.9  # least share of one value in a frame line or a blank row
_EDGE_SHARE = 0.5  # least share of columns that jump where the bar begins
_TEXT_CONTRAST = 0.25  # text stands off its background by at least this
_TEXT_TRANSITIONS = 8  # a row of text crosses its background at least this often
_TEXT_ROWS = 5  # a line of readable text is at least this high
_FOREGROUND_SHARE = 0.12  # least share of one value among the pixels that are not background (noise spreads wider)
_MAX_HEIGHT = 0.3  # of the image height
_MIN_ROWS = 8
_MIN_BLANK_ROWS = 4
_SEED_ROWS = 12  # the outermost rows, in which the bar's background is looked up
_MAX_GAP_ROWS = 3  # separators inside a bar, and the row of the image that some Zeiss bars leave under their frame
_MAX_EDGE_ROWS = 2  # over which resampling smears the bar's edge


def find_data_bar(image: ImageArray, header_rows: int = -1) -> BoolArray:
    """Return the mask of what was imaged: False on the data bar, at the bottom or top of the image.

    A height that the file's header states is taken as it is. Without one, a strip counts as a bar when each
    of its rows is mostly one background value or a frame line, it begins with a jump across the image, and
    it holds text of few values: an image that merely fades to black has no such jump, a specimen on black no
    such text. A strip that is exactly constant (padding) counts as well.

    Parameters
    ----------
    image : (H, W) float32 array
        Micrograph, values as stored.
    header_rows : int
        Height of the bar at the bottom in rows as the header says, 0 or -1 where it says nothing.

    Returns
    -------
    (H, W) bool array
        False on the bar.

    Notes
    -----
    Text that is burnt straight into the image, without a strip under it, is not found.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(0).normal(100.0, 10.0, (64, 64)).astype(np.float32)
    >>> int((~find_data_bar(image, header_rows=10)).any(axis=1).sum()), bool(find_data_bar(image).all())
    (10, True)
    """
    height = image.shape[0]
    mask = np.ones(image.shape, dtype=np.bool_)
    if 0 < header_rows < height // 2:
        mask[height - header_rows :] = False
        return mask
    bottom = _bar_rows(image[::-1])
    mask[height - bottom :] = False
    if bottom == 0:
        mask[: _bar_rows(image)] = False
    return mask


def data_bar_rows(mask: BoolArray) -> int:
    """Return the number of rows of a mask that lie wholly on the data bar."""
    return int(np.count_nonzero(~mask.any(axis=1)))


def _bar_rows(from_edge: ImageArray) -> int:
    """Return the height of the bar along the image's first row, 0 without one."""
    height, width = from_edge.shape
    span = float(from_edge.max() - from_edge.min())
    if span == 0.0 or height < 4 * _MIN_ROWS or width < 4 * _MIN_ROWS:
        return 0
    flat = _FLAT * span
    strip = from_edge[: int(_MAX_HEIGHT * height) + 1]
    background = _most_common(strip[:_SEED_ROWS].ravel(), flat)
    row_median = np.median(strip, axis=1, keepdims=True)
    line = np.mean(np.abs(strip - row_median) <= flat, axis=1) >= _LINE_SHARE
    text_or_blank = np.mean(np.abs(strip - background) <= flat, axis=1) >= _BACKGROUND_SHARE
    reach = _leading_run(line | text_or_blank)
    # The outermost jump, seen from the image's middle, is the bar's edge: frame lines inside it are jumps too.
    for n_rows in range(min(reach, len(strip) - 1), 0, -1):
        if not line[n_rows - 1]:
            continue
        for margin in range(_MAX_EDGE_ROWS + 1):
            outside = strip[min(n_rows + margin, len(strip) - 1)]
            if np.mean(np.abs(outside - strip[n_rows - 1]) > 2 * flat) >= _EDGE_SHARE:
                bar = strip[:n_rows]
                return n_rows + margin if _is_blank(bar) or _holds_text(bar, background, span) else 0
    return 0


def _leading_run(bar_like: BoolArray) -> int:
    """Return where the rows end that are bar-like from the first few on, over gaps of a few rows; 0 without any."""
    rows = np.flatnonzero(bar_like)
    if len(rows) == 0 or rows[0] > _MAX_GAP_ROWS:
        return 0
    gaps = np.flatnonzero(np.diff(rows) > _MAX_GAP_ROWS + 1)
    return int(rows[gaps[0]] if len(gaps) else rows[-1]) + 1


def _is_blank(bar: ImageArray) -> bool:
    return len(bar) >= _MIN_BLANK_ROWS and bool((bar == bar[0, 0]).all())


def _holds_text(bar: ImageArray, background: float, span: float) -> bool:
    if len(bar) < _MIN_ROWS:
        return False
    ink = np.abs(bar - background) > _TEXT_CONTRAST * span
    transitions = np.count_nonzero(ink[:, 1:] != ink[:, :-1], axis=1)
    if np.count_nonzero(transitions >= _TEXT_TRANSITIONS) < _TEXT_ROWS:
        return False
    foreground = bar[np.abs(bar - background) > 2 * _FLAT * span]
    peak = _most_common(foreground, _FLAT * span)
    return float(np.mean(np.abs(foreground - peak) <= _FLAT * span)) >= _FOREGROUND_SHARE


def _most_common(values: ImageArray, width: float) -> float:
    """Return the mode of values to about `width`, as the median of the fullest bin and its neighbours."""
    low = float(values.min())
    bins = ((values - low) / width).astype(np.int64)
    fullest = int(np.bincount(bins).argmax())
    return float(np.median(values[np.abs(bins - fullest) <= 1]))
