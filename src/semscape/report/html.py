"""The report of a run as one self-contained HTML page with the viewer inside: no request to anywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from semscape.io.run_folder import options_toml
from semscape.report.figures import height_picture, hillshade_picture, tilt_picture, uncertainty_picture
from semscape.report.json import report_to_dict
from semscape.report.markup import figure, fixed, page, percent, plus_minus, table, verdict_line, with_sigma
from semscape.report.methods import assumptions, methods_section
from semscape.report.motion_table import before_and_after
from semscape.report.pair_pictures import pair_drawings
from semscape.report.texture_section import texture_section
from semscape.report.unknown import unknown_html
from semscape.report.viewer_page import viewer_parts, viewer_script
from semscape.report.wording import UNIT_SIGNS, Z_95, held_text, is_held, label, number, two_digits, value_text
from semscape.types import FloatArray, LengthUnit, Result

_NO_TILE = {
    "rms_px",
    "height_scale_relative_sigma",
    "height_scale_relative_sigma_95",
    "height_min",
    "height_max",
    "n_views",
    "pixel_size",
    "unknown",
}


def render_html(result: Result) -> str:
    """Return the report of a run as HTML text.

    Parameters
    ----------
    result : Result
        What `semscape.reconstruct` returned.

    Returns
    -------
    str
        A page that carries its style and its pictures and asks the network for nothing.
    """
    report = report_to_dict(result)
    unit: LengthUnit = result.reconstruction.length_unit
    sections = [
        _header(report, result),
        _notices(report),
        _tiles(report, result),
        _surface(result),
        texture_section(result),
        _views(report, result, unit),
        _pairs(report, result),
        _inputs(report, unit),
        _run(report, unit),
        methods_section(report["options"]),
        _options(report),
    ]
    return page(f"{_title(result)} · semscape", sections, viewer_script())


def _title(result: Result) -> str:
    names = result.series.names
    return f"{names[0]} … {names[-1]}"


def _header(report: Mapping[str, Any], result: Result) -> str:
    height, width = result.series.shape
    version = report["versions"].get("semscape", "")
    return (
        '<header>\n<p class="brand">semscape <span>reconstruction report</span></p>\n'
        f"<h1>{escape(_title(result))}</h1>\n"
        f'<p class="quiet">{len(report["views"])} views of {width} × {height} px · semscape {escape(str(version))} · '
        f"seed {report['seed']}</p>\n"
        f"{verdict_line(report['verdict'])}\n"
        f'<p class="basis">{escape(report["ambiguity_text"])}</p>\n</header>'
    )


def _notices(report: Mapping[str, Any]) -> str:
    parts = []
    for key, title, kind in (("failures", "Failures", "bad"), ("warnings", "Warnings", "warn")):
        if report[key]:
            items = "".join(f"<li>{escape(plus_minus(str(text)))}</li>" for text in report[key])
            parts.append(f'<section class="notice {kind}"><h2>{title}</h2><ul>{items}</ul></section>')
    return "\n".join(parts)


def _tiles(report: Mapping[str, Any], result: Result) -> str:
    unit: LengthUnit = report["length_unit"]
    metrics = dict(report["metrics"])
    tilts = [view["tilt_deg"] for view in report["views"]]
    relative = report["height_scale_relative_sigma"]
    tiles = [
        ("Height scale (95 %)", "unknown" if relative is None else f"±{two_digits(100 * Z_95 * relative)} %"),
        ("Height range", _height_range(metrics, result, unit)),
        ("Residual rms", f"{number(result.reconstruction.rms_px, 3)} px"),
        ("Tilts", f"{min(tilts):z.2f}° to {max(tilts):z.2f}°"),
    ]
    for key, value in metrics.items():
        if key not in _NO_TILE and not key.startswith("height_range"):
            tiles.append((label(key), value_text(key, value, unit)))
    items = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(text)}</dd></div>" for name, text in tiles)
    return f'<dl class="tiles">{items}</dl>'


def _height_range(metrics: Mapping[str, Any], result: Result, unit: LengthUnit) -> str:
    value = next((item for key, item in metrics.items() if key.startswith("height_range")), None)
    if isinstance(value, Sequence) and len(value) == 2 and None not in value:
        value = value[1] - value[0]
    if not isinstance(value, int | float):
        known = result.height_map.height_um[np.isfinite(result.height_map.height_um)]
        value = float(np.ptp(known)) if known.size else math.nan
    return f"{number(value, 3)} {UNIT_SIGNS[unit]}"


def _surface(result: Result) -> str:
    sign = UNIT_SIGNS[result.height_map.length_unit]
    finite = np.isfinite(result.height_map.height_um)
    empty = "" if finite.all() else " Bluish: no data."
    spacing = f"{number(result.height_map.pixel_size_um, 4)} {sign}"
    rows, columns = result.height_map.height_um.shape
    pictures = (
        figure(
            height_picture(result.height_map),
            "Height map",
            f"Heights in {sign} at zero tilt over {columns} × {rows} points, {spacing} apart.{empty}",
        ),
        figure(hillshade_picture(result.height_map), "Hillshade", f"Shaded relief, lit from the upper left.{empty}"),
        figure(
            uncertainty_picture(result.height_map),
            "Uncertainty",
            f"1 σ of each height.{empty}",
        ),
    )
    still = f'<div class="wide">{pictures[0]}</div><div class="two">{pictures[1]}{pictures[2]}</div>'
    unknown = unknown_html(result.height_map)
    gaps = f"<section><h2>Views and gaps</h2>{unknown}</section>" if unknown else ""
    if viewer_script() is None:
        note = "The 3D viewer is not built in this installation of semscape: <code>make web</code> does it."
        return f'<section><h2>Surface</h2><p class="quiet">{note}</p>{still}</section>{gaps}'
    # With scripts the viewer shows all three; the pictures are for paper, and where no script may run.
    parts = f'{viewer_parts(result)}<div class="still">{still}</div>'
    return f'<section class="surface"><h2>Surface</h2>{parts}</section>{gaps}'


def _views(report: Mapping[str, Any], result: Result, unit: LengthUnit) -> str:
    sign, reference = UNIT_SIGNS[unit], report["reference_view"]
    head = ["View", "Tilt (°)", "Stage (°)", "Roll (°)", f"Scale (px/{sign})", "Anisotropy (%)", "Residual rms (px)"]
    residual_rms_px = _residual_rms_px(result)
    rows = [
        [
            view["name"] + (" (reference)" if view["name"] == reference else ""),
            held_text(view["tilt_deg"])
            if is_held(view, report)
            else with_sigma(view["tilt_deg"], view["tilt_sigma_deg"]),
            number(view["stage_tilt_deg"]),
            with_sigma(view["roll_deg"], view["roll_sigma_deg"]),
            with_sigma(view[f"scale_px_per_{unit}"], view[f"scale_sigma_px_per_{unit}"]),
            with_sigma(percent(view["anisotropy"]), percent(view["anisotropy_sigma"])),
            number(float(rms), 3),
        ]
        for view, rms in zip(report["views"], residual_rms_px, strict=True)
    ]
    prior = report["options"].get("sfm", {}).get("prior_tilt_deg") or 0.0
    picture = figure(
        tilt_picture(result.reconstruction, result.series.names, prior),
        "Tilts",
        "Recovered tilts with 95 % bars; the band is the trust in the stage."
        if result.reconstruction.tilt_source != "self-calibrated"
        else "Recovered tilts with 95 % bars, found without the stage's tilts.",
    )
    axis = with_sigma(report["axis_deg"], report["axis_sigma_deg"])
    return (
        f"<section><h2>Tilts and scales</h2>{table(head, rows)}"
        f'<p class="quiet">± is 1 σ. Tilt axis at {axis}° from +x, counter-clockwise. '
        f"Tilts: {escape(report['tilt_source'])}. {escape(report['height_scale'].capitalize())}.</p>"
        f"{before_and_after(report, result)}"
        f'<div class="wide">{picture}</div></section>'
    )


def _residual_rms_px(result: Result) -> FloatArray:
    """Return the root mean square length of the residuals in each view (V,), of the observations that count."""
    found = result.reconstruction
    counts = found.weights > 0
    view = found.observations.view[counts]
    squares = np.bincount(view, (found.residual_px[counts] ** 2).sum(axis=1), result.series.n_views)
    number_seen = np.bincount(view, minlength=result.series.n_views)
    return np.sqrt(np.where(number_seen > 0, squares / np.maximum(number_seen, 1), np.nan))


def _pairs(report: Mapping[str, Any], result: Result) -> str:
    head = [
        "Pair",
        "Keypoints",
        "Matches",
        "Inliers",
        "Share",
        "Tracks",
        "Model",
        "Threshold (px)",
        "log₁₀ NFA",
        "Trials",
    ]
    rows = []
    for item in report["pairs"]:
        first, second = item.get("pair", (0, 0))
        counts = [len(result.keypoints[i]) if i < len(result.keypoints) else None for i in (first, second)]
        matches, inliers = item.get("matches"), item.get("inliers")
        names = item.get("names") or [result.series.names[first], result.series.names[second]]
        rows.append(
            [
                " – ".join(str(name) for name in names),
                " / ".join(number(count) for count in counts),
                number(matches),
                number(inliers),
                f"{100 * inliers / matches:.0f} %" if matches and inliers is not None else "–",
                number(item.get("tracks")),
                f"{item.get('model', '–')}{', planar' if item.get('planar') else ''}",
                fixed(item.get("threshold_px"), 2),
                fixed(item.get("log10_nfa"), 0),
                number(item.get("trials")),
            ]
        )
    body = table(head, rows) if rows else '<p class="quiet">No pair was kept.</p>'
    note = (
        '<p class="quiet">The a contrario method chose each threshold: the distance to the epipolar line at which the '
        "inliers are least likely to be chance (log₁₀ of the number of false alarms; below 0 is meaningful).</p>"
    )
    return f"<section><h2>Matches</h2>{body}{note}{pair_drawings(result)}</section>"


def _run(report: Mapping[str, Any], unit: LengthUnit) -> str:
    stages = report["stages"]
    total = sum(stage["seconds"] or 0.0 for stage in stages)
    longest = max((stage["seconds"] or 0.0 for stage in stages), default=0.0) or 1.0
    rows = ""
    for stage in stages:
        seconds = stage["seconds"] or 0.0
        figures = " · ".join(
            f"{escape(label(key))} {escape(value_text(key, value, unit))}" for key, value in stage["figures"].items()
        )
        memory = stage["peak_memory_mb"]
        rows += (
            f'<tr><th scope="row">{escape(stage["name"])}{"*" if stage["earlier"] else ""}</th>'
            f'<td class="num">{seconds:.2f}</td>'
            f'<td class="num">{"–" if memory is None else number(round(memory))}</td>'
            f'<td class="bar"><span style="width:{100 * seconds / longest:.1f}%"></span></td><td>{figures}</td></tr>'
        )
    memory = report["peak_memory_mb"]
    peak = "" if memory is None else f" · peak memory {number(round(memory))} MB"
    resumed = any(stage["earlier"] for stage in stages)
    earlier = " · * done before this run was interrupted; what it took then" if resumed else ""
    return (
        '<section><h2>Stages</h2><div class="scroll"><table><thead><tr><th>Stage</th><th class="num">Seconds</th>'
        f'<th class="num">Peak (MB)</th>'
        f"<th></th><th>Figures</th></tr></thead><tbody>{rows}</tbody></table></div>"
        f'<p class="quiet">{total:.1f} s in all{peak}{earlier}</p></section>'
    )


def _inputs(report: Mapping[str, Any], unit: LengthUnit) -> str:
    inputs = report["inputs"]
    if not inputs:
        return ""
    keys = list(dict.fromkeys(key for item in inputs for key in item if key not in ("digest", "source")))
    head = [label(key) for key in keys] + ["SHA-256"]
    rows = [[_with_source(key, item, unit) for key in keys] + [str(item.get("digest") or "–")[:16]] for item in inputs]
    sentences = [*assumptions(report), report["ambiguity_text"]]
    items = "".join(f"<li>{escape(text)}</li>" for text in sentences)
    return f"<section><h2>Inputs, and what was assumed</h2>{table(head, rows)}<ul>{items}</ul></section>"


def _with_source(key: str, item: Mapping[str, Any], unit: LengthUnit) -> str:
    """Return an input's value with where it came from, "file" or "user", where that is known."""
    value, sources = item.get(key), item.get("source") or {}
    if value is None:
        return "–"
    if key == "data_bar_rows" and not value:
        return "none"
    source = sources.get(key) or sources.get(key.replace("_deg", "_rad"))
    return value_text(key, value, unit) + (f" ({source})" if source else "")


def _options(report: Mapping[str, Any]) -> str:
    groups = "".join(
        f"<div><h3>{escape(stage)}</h3><dl>"
        + "".join(f"<dt>{escape(key)}</dt><dd>{escape(_option_text(value))}</dd>" for key, value in values.items())
        + "</dl></div>"
        for stage, values in [*report["options"].items(), ("versions", report["versions"])]
    )
    return (
        f'<section><h2>Options and versions</h2><div class="options">{groups}</div>'
        '<p class="quiet"><code>semscape reconstruct FOLDER --options options.toml</code> repeats the run, with the '
        "file from its folder or this text:</p>"
        f"<details><summary>options.toml</summary><pre>{escape(_toml(report))}</pre></details></section>"
    )


def _toml(report: Mapping[str, Any]) -> str:
    return options_toml(report["options"])


def _option_text(value: Any) -> str:
    if value is None or value == []:
        return "from the files"
    if isinstance(value, list):
        return ", ".join(_option_text(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)
