"""Where heights are known from how many views, and why they are not known elsewhere: picture and table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from semscape.report.figures import INK, drawn_png
from semscape.report.markup import figure, table
from semscape.report.summary import reason_shares
from semscape.report.wording import UNIT_SIGNS, number
from semscape.types import HeightMap, Reason

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LONGEST_SIDE_PX = 700
# Colours that people who are blind to red or green tell apart (Okabe & Ito 2008), and what each reason means.
_REASONS: dict[Reason, tuple[str, str, str]] = {
    Reason.OUTSIDE: ("#009e73", "outside", "less than two views have it in their field"),
    Reason.MASKED: ("#000000", "masked", "data bar or blank in all views but one"),
    Reason.OCCLUDED: ("#d55e00", "occluded", "hidden behind something higher from all views but one"),
    Reason.SATURATED: ("#f0e442", "saturated", "white without detail in all views but one"),
    Reason.NO_TEXTURE: ("#56b4e9", "no texture", "nothing stands out of the noise"),
    Reason.INCONSISTENT: ("#cc79a7", "inconsistent", "the views do not agree on one height"),
    Reason.BACKGROUND: ("#0072b2", "background", "not on the specimen, left out as asked"),
    Reason.NOT_TOLD: ("#bbbbbb", "not told", "an older file says no reason"),
}


def unknown_html(height_map: HeightMap) -> str:
    """Return the part of the report about known and unknown places, "" where all is known."""
    shares = reason_shares(height_map)
    if not shares:
        return ""
    rows = [
        [name, f"{number(100 * shares[reason.name.lower()], 3)} %", meaning]
        for reason, (_, name, meaning) in _REASONS.items()
        if reason.name.lower() in shares
    ]
    picture = figure(
        coverage_picture(height_map),
        "Views and gaps",
        "Grey: heights are known, the lighter the more views agree on them. Colours: why they are not known.",
    )
    shown = table(["Unknown because", "Share of the field", "Meaning"], rows)
    return f'<div class="two">{picture}<div>{shown}</div></div>'


def coverage_picture(height_map: HeightMap) -> bytes:
    """Return the map of the number of views, with the reasons of unknown heights in colours and their legend."""
    step = -(-max(height_map.height_um.shape) // _LONGEST_SIDE_PX)
    reason, views = height_map.reason[::step, ::step], height_map.n_views[::step, ::step]
    most = max(int(views.max(initial=0)), 3)
    grey = 0.35 + 0.6 * (np.clip(views, 2, most) - 2.0) / (most - 2)
    picture = np.repeat(grey[..., None], 3, axis=-1)
    shown = [item for item in _REASONS if (reason == item).any()]
    for item in shown:
        picture[reason == item] = _rgb(_REASONS[item][0])
    rows, columns = height_map.height_um.shape
    corners = np.array([[-0.5, rows - 0.5, 0, 1], [columns - 0.5, -0.5, 0, 1]]) @ height_map.world_from_grid.T
    (left, bottom), (right, top) = corners[:, :2]
    sign = UNIT_SIGNS[height_map.length_unit]

    def draw(figure: Figure) -> None:
        from matplotlib.patches import Patch

        axes: Any = figure.add_subplot()
        axes.imshow(picture, extent=(left, right, bottom, top), interpolation="nearest")
        axes.set(xlabel=f"x ({sign})", ylabel=f"y ({sign})")
        axes.tick_params(length=3, width=0.6)
        levels = [Patch(color=3 * (0.35 + 0.6 * (k - 2) / (most - 2),), label=f"{k} views") for k in range(2, most + 1)]
        patches = [Patch(color=_REASONS[item][0], label=_REASONS[item][1]) for item in shown]
        figure.legend(
            handles=[*levels, *patches], loc="outside lower center", ncols=4, fontsize=8, labelcolor=INK, frameon=False
        )

    return drawn_png((5.0, float(np.clip(4.5 * rows / columns + 0.7, 2.0, 9.0))), draw, colours=128)


def _rgb(colour: str) -> tuple[float, float, float]:
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue
