"""The run folder of a full-object series: the merged mesh, the height maps it came from, and a report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from semscape.dense.decimate import decimate
from semscape.dense.full_object import FullObject
from semscape.io.run_folder import RUN_FORMAT, json_text, make_folder, plain_json, put_files
from semscape.io.surfaces import encode_height_map_npz, encode_mesh_glb, encode_mesh_ply
from semscape.options import Options
from semscape.report.figures import drawn_png
from semscape.report.markup import figure, page, table, verdict_line
from semscape.report.summary import GOOD_HEIGHT_SCALE, USABLE_HEIGHT_SCALE
from semscape.report.wording import UNIT_SIGNS, Z_95, number
from semscape.sfm.full_object import PARAMETERS_PER_VIEW
from semscape.types import FloatArray, StageReport, SurfaceMesh

_PICTURE_PX = 360
_SIDES_DEG = (0.0, 90.0, 180.0, 270.0)
_FROM_ABOVE_DEG = 25.0
_VIEW_COLUMNS = {
    "stage_tilt_deg": "Stage tilt (°)",
    "tilt_deg": "Tilt (°)",
    "tilt_sigma_deg": "±",
    "stage_rotation_deg": "Stage rotation (°)",
    "rotation_deg": "Rotation (°)",
    "rotation_sigma_deg": "±",
}
_GROUP_COLUMNS = ["Views", "Heights known (%)", "Height scale (95 %, %)"]


def write_full_object(
    found: FullObject,
    options: Options,
    stages: Sequence[StageReport],
    failures: Sequence[str],
    folder: Path | str,
) -> Path:
    """Write the merged mesh, the groups' height maps, the views, the options and the reports, report.json last.

    With `mesh.triangles` or `mesh.error_um` the mesh is decimated, and the report tells the distance.

    Raises
    ------
    BadInputError
        If the folder cannot be written.
    """
    path = make_folder(folder)
    mesh, decimation = found.merged.mesh, None
    if options.mesh.triangles or options.mesh.error_um:
        mesh, decimation = decimate(mesh, options.mesh)
    files = {"merged.ply": encode_mesh_ply(mesh), "merged.glb": encode_mesh_glb(mesh)}
    for index, placed in enumerate(found.maps):
        files[f"height_map_{index:02d}.npz"] = encode_height_map_npz(placed.height_map)
    report = _figures(found, mesh, options, stages, failures)
    files["reconstruction.json"] = json_text(_reconstruction(found)).encode()
    if decimation is not None:
        report["decimation"] = {"largest": decimation.largest, "rms": decimation.rms}
    files["options.toml"] = options.to_toml().encode()
    files["report.html"] = _html(report, found.merged.mesh).encode()
    files["report.json"] = json_text(report).encode()
    put_files(files, path)
    return path


def object_verdict(found: FullObject) -> str:
    """Say in plain words what the body may be used for; its least known group of views decides."""
    motion, height_scale = found.motion, max(_height_scales(found))
    if motion.contradictions:
        return f"do not measure: the images contradict what was told of them. {motion.contradictions[0]}"
    if motion.sense_is_open:
        return "do not measure: the tracks leave open in which sense the stage turns, see the warning"
    grade = "good" if height_scale <= GOOD_HEIGHT_SCALE else "usable"
    if height_scale > USABLE_HEIGHT_SCALE:
        grade = "do not measure"
    return (
        f"{grade}: heights of the least known group of views to +-{height_scale:.1%} (95 %), keypoints to "
        f"{motion.adjustment.sigma_px:.2f} px"
    )


def _height_scales(found: FullObject) -> list[float]:
    """Return half the relative 95 % interval of each group's heights."""
    return [Z_95 * found.motion.height_scale_relative_sigma(placed.views) for placed in found.maps]


def _figures(
    found: FullObject, mesh: SurfaceMesh, options: Options, stages: Sequence[StageReport], failures: Sequence[str]
) -> dict[str, Any]:
    motion, names = found.motion, found.series.names
    corners = mesh.vertices_um[mesh.faces]
    height_scales = _height_scales(found)
    return {
        "format": RUN_FORMAT,
        "kind": "full object",
        "verdict": object_verdict(found),
        "length_unit": mesh.length_unit,
        "metrics": {
            "n_views": found.series.n_views,
            "n_groups": len(found.maps),
            "n_vertices": len(mesh.vertices_um),
            "n_faces": len(mesh.faces),
            "measured_fraction": found.merged.measured,
            "cell": found.merged.cell_um,
            "volume": float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6),
            "noise_sigma_px": motion.adjustment.sigma_px,
            "overdispersion": motion.overdispersion,
            "height_scale_relative_sigma_95": max(height_scales),
        },
        "views": _views(found),
        "groups": [
            {
                "views": [names[view] for view in placed.views],
                "file": f"height_map_{index:02d}.npz",
                "world_from_grid": placed.world_from_grid,
                "completeness": float(np.isfinite(placed.height_map.height_um).mean()),
                "height_scale_relative_sigma_95": height_scale,
            }
            for index, (placed, height_scale) in enumerate(zip(found.maps, height_scales, strict=True))
        ],
        "contradictions": list(motion.contradictions),
        "warnings": list(found.warnings),
        "failures": list(failures),
        "stages": [
            {"name": s.name, "seconds": s.seconds, "peak_memory_mb": s.peak_memory_mb, "figures": s.figures}
            for s in stages
        ],
        "options": plain_json(options.to_dict()),
        "seed": options.run.seed,
    }


def _views(found: FullObject) -> list[dict[str, Any]]:
    """Return for each view what the stage says of it, and what was found with its standard deviation."""
    motion = found.motion
    sigma = np.sqrt(np.diag(motion.adjustment.covariance))[1:].reshape(-1, PARAMETERS_PER_VIEW)
    sense = -1.0 if motion.clockwise else 1.0
    return [
        {
            "name": view.name,
            "stage_tilt_deg": math.degrees(view.metadata.tilt_rad),
            "tilt_deg": math.degrees(motion.tilt_rad[k]),
            "tilt_sigma_deg": math.degrees(sigma[k, 0]),
            "stage_rotation_deg": math.degrees(sense * view.metadata.stage_rotation_rad),
            "rotation_deg": math.degrees(motion.rotation_rad[k]),
            "rotation_sigma_deg": math.degrees(sigma[k, 4]),
        }
        for k, view in enumerate(found.series.views)
    ]


def _reconstruction(found: FullObject) -> dict[str, Any]:
    motion, unit = found.motion, found.merged.mesh.length_unit
    per_view = motion.adjustment.parameters[1:].reshape(-1, PARAMETERS_PER_VIEW)
    return {
        "kind": "full object",
        "length_unit": unit,
        "axis_deg": math.degrees(motion.axis_angle_rad),
        "views": [
            {
                "name": name,
                "tilt_deg": math.degrees(motion.tilt_rad[k]),
                "rotation_deg": math.degrees(motion.rotation_rad[k]),
                f"scale_px_per_{unit}": motion.scale_px_per_um[k],
                "anisotropy": per_view[k, 3],
                "R": motion.cam_from_world[k],
                "t_px": per_view[k, 5:],
            }
            for k, name in enumerate(found.series.names)
        ],
    }


def _html(report: dict[str, Any], mesh: SurfaceMesh) -> str:
    metrics, sign = report["metrics"], UNIT_SIGNS[mesh.length_unit]
    rows = [
        ["Views, groups of views", f"{metrics['n_views']}, {metrics['n_groups']}"],
        ["Area that views have seen", f"{number(100 * metrics['measured_fraction'], 3)} %"],
        ["Volume", f"{number(metrics['volume'], 4)} {sign}³"],
        ["Triangles", number(metrics["n_faces"])],
        ["Grid of the merging", f"{number(metrics['cell'], 3)} {sign}"],
        ["Noise of a keypoint", f"{number(metrics['noise_sigma_px'], 3)} px"],
    ]
    if "decimation" in report:
        rows.append(["Decimated mesh, largest distance", f"{number(report['decimation']['largest'], 3)} {sign}"])
    groups = [
        [
            ", ".join(item["views"]),
            number(100 * item["completeness"], 3),
            f"± {number(100 * item['height_scale_relative_sigma_95'], 2)}",
        ]
        for item in report["groups"]
    ]
    views = [[view["name"], *(number(view[key], 5) for key in _VIEW_COLUMNS)] for view in report["views"]]
    doubts = "".join(f"<p>{escape(text)}</p>" for text in report["warnings"])
    picture = figure(
        sides_picture(mesh), "Merged surface", "Seen from four sides, from 25° above. Bluish: no view has seen it."
    )
    header = (
        '<header>\n<p class="brand">semscape <span>full object</span></p>\n'
        f"<h1>{escape(report['views'][0]['name'])} … {escape(report['views'][-1]['name'])}</h1>\n"
        f"{verdict_line(report['verdict'])}</header>"
    )
    return page(
        "full object · semscape",
        [
            header,
            f'<section><h2>Surface</h2><div class="wide">{picture}</div>{table(["", ""], rows)}</section>',
            f"<section><h2>Motion</h2>{doubts}{table(['View', *_VIEW_COLUMNS.values()], views)}</section>",
            f"<section><h2>Groups</h2>{table(_GROUP_COLUMNS, groups)}</section>",
        ],
    )


def sides_picture(mesh: SurfaceMesh) -> bytes:
    """Return a mesh shaded from four sides, in a row."""
    corners = mesh.vertices_um[mesh.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(mesh.vertices_um)
    for k in range(3):
        normals += np.stack([np.bincount(mesh.faces[:, k], area[:, axis], len(normals)) for axis in range(3)], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    pictures = [_side(mesh, normals, np.deg2rad(side)) for side in _SIDES_DEG]

    def draw(figure: Any) -> None:
        for axes, picture in zip(figure.subplots(1, len(pictures)), pictures, strict=True):
            axes.imshow(picture)
            axes.set_axis_off()

    return drawn_png((10.0, 2.6), draw)


def _side(mesh: SurfaceMesh, normals: FloatArray, azimuth_rad: float) -> FloatArray:
    """Return an RGBA picture (N, N, 4) of the vertices that are foremost, lit from the viewer's upper left."""
    c, s = np.cos(azimuth_rad), np.sin(azimuth_rad)
    up, down = np.sin(np.deg2rad(_FROM_ABOVE_DEG)), np.cos(np.deg2rad(_FROM_ABOVE_DEG))
    view = np.array([[c, s, 0.0], [s * up, -c * up, down], [s * down, -c * down, -up]])  # right, up, away
    centre = (mesh.vertices_um.min(axis=0) + mesh.vertices_um.max(axis=0)) / 2
    seen = (mesh.vertices_um - centre) @ view.T
    extent = 0.52 * float(np.linalg.norm(np.ptp(mesh.vertices_um, axis=0))) / np.sqrt(3) * 1.35
    light = np.clip((normals @ view.T) @ (np.array([-0.4, 0.5, -0.77])), 0.0, 1.0)
    x, y = np.meshgrid(*2 * [np.linspace(-extent, extent, _PICTURE_PX)])
    # Of the vertices near a pixel's centre the foremost counts.
    tree = cKDTree(seen[:, :2])
    reach = 2.5 * extent / _PICTURE_PX
    distance, near = tree.query(np.column_stack([x.ravel(), -y.ravel()]), k=24, distance_upper_bound=reach)
    depth = np.where(np.isfinite(distance), np.append(seen[:, 2], np.inf)[near], np.inf)
    first = np.take_along_axis(near, depth.argmin(axis=1)[:, None], axis=1)[:, 0]
    hit = np.isfinite(depth.min(axis=1))
    picture = np.zeros((x.size, 4))
    tint = np.where(np.ptp(mesh.color.astype(int), axis=1)[:, None] > 0, [0.65, 0.78, 1.0], [1.0, 1.0, 1.0])
    picture[hit, :3] = tint[first[hit]] * (0.15 + 0.8 * light[first[hit]])[:, None]
    picture[hit, 3] = 1.0
    return picture.reshape(_PICTURE_PX, _PICTURE_PX, 4)
