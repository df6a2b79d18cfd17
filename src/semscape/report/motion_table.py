"""The report's page about the motion: what was known before, what the images made of it, and how far it is decided."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from semscape.report.markup import percent, table, with_sigma
from semscape.report.wording import Z_95, is_held, number, two_digits
from semscape.types import Result

_FREE = "free"


def before_and_after(report: Mapping[str, Any], result: Result) -> str:
    """Return the table of every view's prior beside its posterior, "" for a result that holds no priors."""
    if not all(view["prior"] for view in report["views"]) or len(report["inputs"]) < len(report["views"]):
        return ""
    unit = report["length_unit"]
    head = ["View"]
    for quantity in ("Tilt (°)", "Roll (°)", "Scale drift (%)", "Anisotropy (%)"):
        head += [f"{quantity} before", "after"]
    rows = []
    for view, given, pixel_size in zip(report["views"], report["inputs"], result.series.pixel_size_um, strict=True):
        prior = view["prior"]
        told = f" ({given['source'].get('tilt_rad', 'assumed')})"
        held = is_held(view, report)
        tilt = with_sigma(prior["tilt_deg"], prior["tilt_sigma_deg"]) + told
        drift = view[f"scale_px_per_{unit}"] * pixel_size - 1
        rows.append(
            [
                view["name"],
                "held" if held else _FREE if prior["tilt_deg"] is None else tilt,
                number(round(view["tilt_deg"], 3) + 0.0)
                if held
                else with_sigma(view["tilt_deg"], view["tilt_sigma_deg"]),
                _about_zero(prior["roll_sigma_deg"]),
                with_sigma(view["roll_deg"], view["roll_sigma_deg"]),
                _about_zero(percent(prior["scale_relative_sigma"])),
                with_sigma(100 * drift, 100 * view[f"scale_sigma_px_per_{unit}"] * pixel_size),
                _about_zero(percent(prior["anisotropy_sigma"])),
                with_sigma(percent(view["anisotropy"]), percent(view["anisotropy_sigma"])),
            ]
        )
    return (
        f"<h3>Before and after</h3>{table(head, rows)}"
        '<p class="quiet">± is 1 σ. Before: what files or user say of the tilts, and what is assumed of the rest, '
        "about 0 (options sfm.prior_…; of four views and more the anisotropy's σ is learnt from the series). After: "
        "with the images. "
        f"{escape(' '.join(_decided(result)))}</p>"
    )


def _about_zero(sigma: float | None) -> str:
    return f"± {number(sigma, 2)}"


def _decided(result: Result) -> list[str]:
    """Say how far mirror image, bas-relief valley and camera are decided."""
    found = result.reconstruction
    sentences = []
    if math.isfinite(found.mirror_margin):
        margin = number(round(found.mirror_margin, 1))
        sentences.append(f"The mirror image costs {margin} more (twice the log-posterior; 6 is 20 to 1).")
    images = found.height_scale_relative_sigma_of_images
    alone = f"±{two_digits(100 * Z_95 * images)} %" if np.isfinite(images) else "nothing"
    sentences.append(f"Of the height scale the images alone would tell {alone} (95 %).")
    if math.isfinite(found.camera_margin):
        verb = "better" if found.camera_margin > 0 else "worse"
        sentences.append(
            f"A perspective camera fits {verb}: its information criterion differs by "
            f"{number(round(abs(found.camera_margin), 1))}; taken: {found.camera}."
        )
    return sentences
