"""Find the scale bar that a microscope burns into its images, for files whose header tells no pixel size.

Three kinds are found: a line with ticks at both ends, whose middle may hold the text; a ruler of equal ticks
without a line; a plain line. What it means in um stands in the text beside it, which is not read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semscape.types import BoolArray, ImageArray

_INK_CONTRASTS = (0.6, 0.3)  # of the strip's range of values; the separators of tables are fainter than the bar
_LEAST_STRIP_ROWS = 8
_LEAST_RUN_PX = 12
_LEAST_HALF_SHARE = 0.025  # of the image's width: each half of a line with text in its middle
_LEAST_SHARE = 0.04  # of the image's width: a scale bar is at least this long
_MOST_SHARE = 0.9
_MOST_THICKNESS = 0.12  # of the length
_PLAIN_SLENDERNESS = 15.0  # a line without ticks is at least this many times as long as thick
_MOST_TICK_PX = 8  # wide
_LEAST_TICKS = 5
_TICK_SPACING = 0.08  # of the spacing, within which a ruler's ticks are equally far apart
_BORDER_PX = 2


@dataclass(frozen=True)
class ScaleBar:
    """A scale bar: its length, and the rows and columns that it takes, all in px; `kind` is line, ruler or ticked."""

    length_px: float
    row: int
    first_column: int
    last_column: int
    kind: str


@dataclass(frozen=True)
class _Line:
    top: int
    bottom: int
    left: int
    right: int

    @property
    def length(self) -> int:
        return self.right - self.left + 1

    @property
    def thickness(self) -> int:
        return self.bottom - self.top + 1


def find_scale_bar(image: ImageArray, mask: BoolArray) -> ScaleBar | None:
    """Return the scale bar in the data bar, or burnt straight into an image without one; None where none is seen.

    Parameters
    ----------
    image : (H, W) float32 array
        Micrograph, values as stored.
    mask : (H, W) bool array
        False on the data bar, as `find_data_bar` returns it. Other masked places, like burnt-in text, may hold the
        bar as well.

    Returns
    -------
    ScaleBar or None
        Ticks and lines are measured from centre to centre of their ends' ticks, plain lines from end to end.

    Examples
    --------
    >>> image = np.zeros((60, 300), np.float32)
    >>> image[40, 50:151] = image[35:46, [50, 150]] = 255
    >>> bar = find_scale_bar(image, np.arange(60)[:, None] < np.full(300, 30))
    >>> bar.length_px, bar.kind
    (100.0, 'ticked')
    """
    in_image = np.asarray(mask.any(axis=1))
    rows = np.flatnonzero(~in_image)
    if len(rows) >= _LEAST_STRIP_ROWS:
        found = _in_strip(image[rows[0] : rows[-1] + 1])
        if found is not None:
            return replace(found, row=found.row + int(rows[0]))
    imaged = image[in_image]
    for level in (imaged.max(), imaged.min()) if imaged.size else ():
        found = _plain((image == level) & in_image[:, None])
        if found is not None:
            return found
    return None


def _in_strip(strip: ImageArray) -> ScaleBar | None:
    span = float(strip.max() - strip.min())
    if span == 0:
        return None
    values, counts = np.unique(np.round(strip / (0.02 * span)), return_counts=True)
    contrast = np.abs(strip - float(values[counts.argmax()]) * 0.02 * span) / span
    inks = [contrast > least for least in _INK_CONTRASTS]
    for find in (_ticked, _ruler, _plain):
        for ink in inks:
            found = find(ink)
            if found is not None:
                return found
    return None


def _ticked(ink: BoolArray) -> ScaleBar | None:
    """Return the longest line with like ticks at both ends."""
    best: ScaleBar | None = None
    for line in _candidates(_joined(_lines(ink), ink.shape[1]), ink.shape[1]):
        left, right = _tick(ink, line, line.left, 1), _tick(ink, line, line.right, -1)
        if left is None or right is None or abs(left[1] - right[1]) > 3:
            continue
        length = right[0] - left[0]
        if best is None or length > best.length_px:
            best = _bar(line, length, "ticked")
    return best


def _plain(ink: BoolArray) -> ScaleBar | None:
    """Return the longest slender line that touches nothing."""
    lines = [
        line
        for line in _candidates(_lines(ink), ink.shape[1])
        if line.thickness > 1 and line.length >= _PLAIN_SLENDERNESS * line.thickness and _stands_alone(ink, line)
    ]
    if not lines:
        return None
    line = max(lines, key=lambda item: item.length)
    return _bar(line, line.length, "line")


def _candidates(lines: list[_Line], width: int) -> list[_Line]:
    return [
        line
        for line in lines
        if _LEAST_SHARE * width <= line.length <= _MOST_SHARE * width
        and line.thickness <= _MOST_THICKNESS * line.length
        and line.left >= _BORDER_PX
        and line.right < width - _BORDER_PX
    ]


def _bar(line: _Line, length_px: float, kind: str) -> ScaleBar:
    return ScaleBar(float(length_px), (line.top + line.bottom) // 2, line.left, line.right, kind)


def _runs(row: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], row, [False])).astype(np.int8)))
    return [(int(start), int(stop) - 1) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def _lines(ink: BoolArray) -> list[_Line]:
    """Return the thin bars of ink: rows whose long runs begin and end alike."""
    found: list[_Line] = []
    open_lines: list[_Line] = []
    for row in range(ink.shape[0] + 1):
        runs = [run for run in _runs(ink[row]) if run[1] - run[0] + 1 >= _LEAST_RUN_PX] if row < len(ink) else []
        still_open = []
        for line in open_lines:
            same = next((run for run in runs if abs(run[0] - line.left) <= 1 and abs(run[1] - line.right) <= 1), None)
            if same is None:
                found.append(line)
            else:
                runs.remove(same)
                still_open.append(
                    replace(line, bottom=row, left=min(line.left, same[0]), right=max(line.right, same[1]))
                )
        open_lines = still_open + [_Line(row, row, *run) for run in runs]
    return found


def _joined(lines: list[_Line], width: int) -> list[_Line]:
    """Return the lines, and those whose two like halves leave room for the text between them."""
    pairs = [
        _Line(first.top, first.bottom, first.left, second.right)
        for first in lines
        for second in lines
        if second.left > first.right
        and abs(first.top - second.top) <= 1
        and abs(first.bottom - second.bottom) <= 1
        and 0.7 < first.length / second.length < 1.4
        and min(first.length, second.length) >= _LEAST_HALF_SHARE * width
        and second.left - first.right < 1.5 * (first.length + second.length)
    ]
    return lines + pairs


def _tick(ink: BoolArray, line: _Line, end: int, step: int) -> tuple[float, int] | None:
    """Return the column of the tick at a line's end, in parts of a px, and how far it stands out; None without one."""
    columns = end + step * np.arange(min(_MOST_TICK_PX + 2, line.length // 3))
    reach = np.array([sum(_reach(ink, line, int(column))) for column in columns])
    out = np.flatnonzero(reach > 0)
    if len(out) == 0 or out[0] > 2 or len(out) != out[-1] - out[0] + 1 or len(out) > _MOST_TICK_PX:
        return None  # nothing stands out, or more than one tick does: a glyph, a block
    return float(np.average(columns[out], weights=reach[out])), int(reach.max())


def _reach(ink: BoolArray, line: _Line, column: int) -> tuple[int, int]:
    """Return how far ink goes on above and below a line in one column."""
    above = ink[: line.top, column][::-1]
    below = ink[line.bottom + 1 :, column]
    return (
        int(len(above) if above.all() else np.argmin(above)),
        int(len(below) if below.all() else np.argmin(below)),
    )


def _stands_alone(ink: BoolArray, line: _Line) -> bool:
    """Tell whether little ink touches a line from above and below."""
    above = ink[line.top - 1, line.left : line.right + 1].mean() if line.top > 0 else 0.0
    below = ink[line.bottom + 1, line.left : line.right + 1].mean() if line.bottom + 1 < len(ink) else 0.0
    return bool(max(above, below) < 0.1)


def _ruler(ink: BoolArray) -> ScaleBar | None:
    """Return a row of equal ticks with equal gaps, and nothing between them."""
    best: ScaleBar | None = None
    for row in range(2, ink.shape[0], 3):
        strokes = [run for run in _runs(ink[row]) if run[1] - run[0] < _LEAST_RUN_PX]
        if len(strokes) < _LEAST_TICKS:
            continue
        centres = np.array([(run[0] + run[1]) / 2 for run in strokes])
        widths = np.array([run[1] - run[0] + 1 for run in strokes])
        gaps = np.diff(centres)
        like_next = np.abs(np.diff(gaps)) <= np.maximum(1.0, _TICK_SPACING * gaps[1:])
        like_next &= (np.abs(np.diff(widths)) <= 1)[1:] & (np.abs(np.diff(widths)) <= 1)[:-1]
        like_next &= gaps[1:] > 3 * np.maximum(widths[1:-1], widths[2:])
        for start, stop in _runs(like_next):
            n_ticks = stop - start + 3
            length = float(centres[stop + 2] - centres[start])
            long_enough = _LEAST_SHARE * ink.shape[1] <= length
            if n_ticks >= _LEAST_TICKS and long_enough and (best is None or length > best.length_px):
                best = ScaleBar(length, row, int(centres[start]), int(centres[stop + 2]), "ruler")
    return best
