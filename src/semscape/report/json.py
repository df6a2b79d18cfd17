"""The report as plain JSON values: what report.json holds."""

from __future__ import annotations

from typing import Any

from semscape.io.run_folder import RUN_FORMAT, plain_json, reconstruction_to_dict
from semscape.report.wording import ambiguity_text, height_scale_text
from semscape.types import Result

_MOTION = ("height_scale_relative_sigma_of_images", "mirror_margin", "camera", "camera_margin")


def report_to_dict(result: Result) -> dict[str, Any]:
    """Return the report of a run with the tilts and scales of its views, ready for `json.dumps`.

    NaN and infinity are None. Angles are in deg; lengths are in the unit that `length_unit` names.
    """
    report, reconstruction = result.report, result.reconstruction
    calibration = reconstruction_to_dict(reconstruction, result.series.names)
    # The matrices stand in reconstruction.json; the report is the readable part.
    views = [{key: value for key, value in view.items() if key not in ("R", "t_px")} for view in calibration["views"]]
    values: dict[str, Any] = {
        "format": RUN_FORMAT,
        "verdict": report.verdict,
        "warnings": report.warnings,
        "failures": report.failures,
        "length_unit": reconstruction.length_unit,
        "metrics": report.metrics,
        "height_scale": height_scale_text(reconstruction),
        "height_scale_relative_sigma": reconstruction.height_scale_relative_sigma,
        "tilt_source": reconstruction.tilt_source,
        "ambiguity": reconstruction.ambiguity,
        "ambiguity_text": ambiguity_text(reconstruction),
        "relief_confidence": reconstruction.relief_confidence,
        "axis_deg": calibration["axis_deg"],
        "axis_sigma_deg": calibration["axis_sigma_deg"],
        "reference_view": calibration["reference_view"],
        **{key: calibration[key] for key in calibration if key in _MOTION or key.startswith("inverse_distance")},
        "views": views,
        "pairs": report.pairs,
        "stages": [
            {
                "name": s.name,
                "seconds": s.seconds,
                "peak_memory_mb": s.peak_memory_mb,
                "earlier": s.earlier,
                "figures": s.figures,
            }
            for s in report.stages
        ],
        "peak_memory_mb": report.peak_memory_mb,
        "inputs": report.inputs,
        "options": report.options,
        "seed": report.seed,
        "versions": report.versions,
    }
    plain: dict[str, Any] = plain_json(values)
    return plain
