"""The conventions of the whole library, one executable test per sentence."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import logging
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

import semscape
from semscape import options, pipeline, types
from semscape.dense.stereo import RectifiedView, _pyramid
from semscape.errors import BadInputError, NoAnswerError, SemscapeError, TooFewMatchesError
from semscape.features.match import match
from semscape.geometry.cameras import camera_matrices
from semscape.geometry.rotations import axis_rotation, tilted_cam_from_world, wrap_axis_angle
from semscape.io.micrograph import read_micrograph
from semscape.options import Options
from semscape.report import report_to_dict
from semscape.robust.acransac import ac_ransac
from semscape.robust.models import AFFINE
from semscape.robust.pair_geometry import two_view_geometry
from semscape.simulate import PRESETS, simulate
from semscape.types import Keypoints, Motion
from synthetic_result import make_result

PACKAGE = Path(semscape.__file__).parent
SOURCES = {path.relative_to(PACKAGE): ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.py")}
RNG = np.random.default_rng(3)


def motion(axis_deg: float, tilts_deg: list[float]) -> Motion:
    zero = np.zeros(len(tilts_deg))
    return Motion(np.deg2rad(axis_deg), np.deg2rad(tilts_deg), zero, zero + 1, zero, np.zeros((len(tilts_deg), 2)))


def blob(shape: tuple[int, int], x: float, y: float, sigma: float) -> np.ndarray:
    rows, cols = np.indices(shape)
    return np.exp(-((cols - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))


def centroid(image: np.ndarray) -> tuple[float, float]:
    rows, cols = np.indices(image.shape)
    return float((cols * image).sum() / image.sum()), float((rows * image).sum() / image.sum())


# 1. Images


def test_images_are_indexed_row_col_and_keep_their_values(tmp_path: Path) -> None:
    stored = np.arange(12 * 20, dtype=np.uint16).reshape(12, 20) * 17  # 12 bits in a file of 16
    tifffile.imwrite(tmp_path / "a.tif", stored)
    image = read_micrograph(tmp_path / "a.tif").image
    assert (image.shape, image.dtype) == ((12, 20), np.float32)
    np.testing.assert_array_equal(image, stored)


# 2. Points


def test_points_are_xy_and_the_centre_of_the_first_pixel_is_the_origin() -> None:
    """In the simulator, which shares no code with the pipeline, the image's middle is ((W - 1) / 2, (H - 1) / 2)."""
    _, truth = simulate("spheres", dataclasses.replace(PRESETS["ideal"], tilts_deg=(0.0,), width_px=40, height_px=30))
    np.testing.assert_allclose(truth.motion.translation_px, [[19.5, 14.5]])
    np.testing.assert_allclose((truth.world_from_grid @ [19.5, 14.5, 0, 1])[:2], 0, atol=1e-12)


def test_resizing_by_s_maps_xy_to_xy_plus_half_times_s_minus_half() -> None:
    image = (100 * blob((640, 640), 300.0, 351.0, 6.0)).astype(np.float32)
    levels = _pyramid(RectifiedView(image, np.ones(image.shape, bool), 0.0), range_px=60.0)
    assert len(levels) >= 3
    for level, (resized, _) in enumerate(levels):
        s = 0.5**level
        assert centroid(resized) == pytest.approx(((300.5 * s) - 0.5, (351.5 * s) - 0.5), abs=1e-3)
    # OpenCV's own resize, which the library relies on, has this convention when it enlarges, too.
    twice = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
    assert centroid(twice) == pytest.approx((600.5, 702.5), abs=1e-2)


# 3. World


def test_at_zero_tilt_the_rotation_is_diag_1_minus_1_minus_1() -> None:
    for axis in RNG.uniform(-np.pi, np.pi, 5):
        np.testing.assert_allclose(tilted_cam_from_world(axis, 0.0, 0.0), np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_the_world_is_right_handed_with_z_towards_the_source() -> None:
    right, down, away = tilted_cam_from_world(0.0, 0.0, 0.0)  # the camera's axes in the world
    np.testing.assert_allclose(np.cross(right, -down), -away)


def test_the_simulated_grid_has_y_up_and_z_up() -> None:
    _, truth = simulate("pollen", dataclasses.replace(PRESETS["ideal"], tilts_deg=(0.0,), width_px=64, height_px=64))
    assert truth.world_from_grid[0, 0] > 0 > truth.world_from_grid[1, 1]
    assert truth.world_from_grid[2].tolist() == [0, 0, 1, 0]
    middle, corner = truth.height_um[28:36, 28:36], truth.height_um[:4, :4]
    assert np.median(middle) > np.median(corner)  # the grain stands on its stub


# 4. Tilt


def test_tilt_is_an_active_right_handed_rotation() -> None:
    rotation = axis_rotation(0.0, np.deg2rad(90.0))  # about +x: +y goes to +z
    np.testing.assert_allclose(rotation @ [0, 1, 0], [0, 0, 1], atol=1e-15)


def test_the_axis_angle_is_counter_clockwise_from_x_seen_from_the_source() -> None:
    for angle in np.deg2rad([0.0, 30.0, 90.0, 130.0]):
        along = np.array([np.cos(angle), np.sin(angle), 0.0])
        np.testing.assert_allclose(axis_rotation(angle, 0.3) @ along, along, atol=1e-15)


@pytest.mark.parametrize(("axis_deg", "moves"), [(0.0, (0, 1)), (90.0, (1, 0))])
def test_a_positive_tilt_moves_a_peak_to_larger_y_about_x_and_to_larger_x_about_y(axis_deg, moves) -> None:
    matrix = camera_matrices(motion(axis_deg, [6.0]))[0]
    np.testing.assert_allclose(matrix @ [0, 0, 1], np.sin(np.deg2rad(6.0)) * np.array(moves), atol=1e-15)


def test_the_simulator_moves_peaks_the_same_way() -> None:
    """The convention holds in rendered pictures, not in formulae alone: the grain's top moves to larger x."""
    options = dataclasses.replace(
        PRESETS["ideal"], tilts_deg=(-8.0, 8.0), axis_deg=90.0, width_px=96, height_px=96, samples=1
    )
    series, truth = simulate("pollen", options, rng=0)
    top = np.unravel_index(np.nanargmax(truth.height_um), truth.height_um.shape)
    world = truth.world_from_grid @ [top[1], top[0], truth.height_um[top], 1]
    (x1, y1), (x2, y2) = (camera_matrices(truth.motion) @ world[:3]) + truth.motion.translation_px
    assert x2 - x1 == pytest.approx(2 * world[2] * np.sin(np.deg2rad(8.0)) / options.pixel_size_um, rel=1e-6)
    patches = [
        view.image[round(y) - 6 : round(y) + 7, round(x) - 6 : round(x) + 7]
        for view, x, y in zip(series.views, (x1, x2), (y1, y2), strict=True)
    ]
    assert np.corrcoef(patches[0].ravel(), patches[1].ravel())[0, 1] > 0.6


def test_oracle_z_is_y2_minus_y1_over_2_sin_a() -> None:
    a = np.deg2rad(7.0)
    z = RNG.normal(0, 5, 50)
    points = np.column_stack([RNG.normal(0, 20, (50, 2)), z])
    xy1, xy2 = (points @ matrix.T for matrix in camera_matrices(motion(0.0, [-7.0, 7.0])))
    np.testing.assert_allclose((xy2[:, 1] - xy1[:, 1]) / (2 * np.sin(a)), z, atol=1e-12)


def test_the_axis_lies_in_minus_45_to_135_so_that_both_usual_axes_lie_well_inside() -> None:
    for angle_deg in np.linspace(-400.0, 400.0, 321):
        wrapped, flipped = wrap_axis_angle(np.deg2rad(angle_deg))
        assert -45.0 - 1e-9 < np.rad2deg(wrapped) <= 135.0 + 1e-9
        sign = -1 if flipped else 1
        np.testing.assert_allclose(
            axis_rotation(np.deg2rad(angle_deg), 0.1), axis_rotation(wrapped, sign * 0.1), atol=1e-12
        )
    for usual in (0.0, 90.0):
        for noise in (-40.0, 40.0):
            assert not wrap_axis_angle(np.deg2rad(usual + noise))[1]
    assert wrap_axis_angle(np.deg2rad(135.0))[0] == pytest.approx(np.deg2rad(135.0))
    assert wrap_axis_angle(np.deg2rad(-45.0))[0] == pytest.approx(np.deg2rad(135.0))


def test_vendor_signs_are_known_to_io_alone() -> None:
    for name, tree in SOURCES.items():
        if name.parts[0] != "io":
            names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
            assert not [used for used in names if "TILT_SIGN" in used], name


# 5. Transforms


def test_transforms_are_named_b_from_a_and_compose_by_adjacency() -> None:
    def name_of(node: ast.AST) -> str:
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
        return name if name.count("_from_") == 1 else ""

    for path, tree in SOURCES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
                left, right = name_of(node.left), name_of(node.right)
                if left and right:
                    assert left.split("_from_")[1] == right.split("_from_")[0], f"{path}: {left} @ {right}"


# 6. Pairs


def test_x2_f_x1_is_zero_and_pairs_rise() -> None:
    points = RNG.normal(0, 100, (300, 3)) * (1, 1, 0.4)
    xy1, xy2 = (points @ matrix.T + 200 for matrix in camera_matrices(motion(70.0, [-5.0, 4.0])))
    xy2 = xy2 + np.array([3.0, 17.0])
    geometry = two_view_geometry(
        (0, 1), xy1, xy2, kind="affine", shapes=((400, 400), (400, 400)), rng=np.random.default_rng(0), max_trials=200
    )
    one = np.ones((300, 1))
    product = np.einsum("ni,ij,nj->n", np.hstack([xy2, one]), geometry.matrix, np.hstack([xy1, one]))
    np.testing.assert_allclose(product, 0, atol=1e-6)
    swapped = np.einsum("ni,ij,nj->n", np.hstack([xy1, one]), geometry.matrix, np.hstack([xy2, one]))
    assert np.abs(swapped).max() > 1e-3
    assert geometry.pair[0] < geometry.pair[1]


# 7. Units


def test_angles_are_in_radians_inside_and_in_degrees_in_options() -> None:
    for _, value in inspect.getmembers(types, dataclasses.is_dataclass):
        names = [spec.name for spec in dataclasses.fields(value)]
        assert not [name for name in names if name.endswith("_deg")], value
    for _, stage in inspect.getmembers(options, dataclasses.is_dataclass):
        names = [spec.name for spec in dataclasses.fields(stage)]
        assert not [name for name in names if name.endswith("_rad")], stage


def test_reports_speak_degrees() -> None:
    def keys(value: object) -> list[str]:
        if isinstance(value, dict):
            return [*value, *(key for item in value.values() for key in keys(item))]
        return [key for item in value for key in keys(item)] if isinstance(value, list) else []

    report = report_to_dict(make_result())
    report.pop("inputs")  # its `source` names the fields of the metadata
    assert not [key for key in keys(report) if key.endswith("_rad")]
    assert report["views"][0]["tilt_deg"] == pytest.approx(-3.02)


# 9. Randomness


def test_rng_is_keyword_only() -> None:
    for path, tree in SOURCES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and path.name != "two_view.py":
                positional = {argument.arg for argument in node.args.args}
                # The specimens are one table of functions of a size and a generator.
                assert "rng" not in positional or path.parts[0] == "simulate", f"{path}: {node.name}"


def test_child_streams_depend_on_seed_stage_and_pair_alone() -> None:
    def draw(*key: object) -> list[float]:
        return pipeline._stream(*key).random(4).tolist()  # type: ignore[arg-type]

    first = draw(0, "match", 0, 1)
    draw(0, "evolve")
    draw(0, "match", 1, 2)
    assert draw(0, "match", 0, 1) == first
    others = [draw(1, "match", 0, 1), draw(0, "evolve", 0, 1), draw(0, "match", 0, 2), draw(0, "match", 1, 0)]
    assert first not in others
    assert len({tuple(other) for other in others}) == len(others)


def test_no_global_random_state_is_used() -> None:
    for path, tree in SOURCES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("default_rng"):
                assert node.args, f"{path}:{node.lineno}: a generator without a seed"
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "np.random":
                assert node.attr in {"default_rng", "Generator", "SeedSequence"}, f"{path}:{node.lineno}"


# 10. Errors


def test_misuse_raises_value_error_and_data_a_semscape_error_with_numbers() -> None:
    empty = Keypoints(np.empty((0, 2)), *[np.empty(0)] * 3, np.empty((0, 4), np.float32), "sift")
    with pytest.raises(ValueError, match=r"ratio is 1\.5"):
        match((0, 1), empty, empty, ratio=1.5)
    with pytest.raises(TooFewMatchesError, match=r"3 matches.* at least 5"):
        ac_ransac(AFFINE, np.ones((3, 2)), np.ones((3, 2)), shapes=((9, 9), (9, 9)), rng=RNG, max_trials=9)
    assert issubclass(NoAnswerError, SemscapeError)
    assert issubclass(BadInputError, SemscapeError)
    assert not issubclass(SemscapeError, ValueError)


def test_the_pipeline_catches_semscape_errors_alone() -> None:
    for part in ("pipeline.py", "sfm/calibrate.py", "dense/surface.py", "features/detect.py"):
        handlers = [node for node in ast.walk(SOURCES[Path(part)]) if isinstance(node, ast.ExceptHandler)]
        assert {ast.unparse(handler.type) for handler in handlers if handler.type} <= {"SemscapeError"}, part
        assert all(handler.type for handler in handlers)


# 11. Options


def test_an_unknown_option_names_the_nearest_one() -> None:
    with pytest.raises(BadInputError, match="the nearest one is 'prior_tilt_deg'"):
        Options().with_settings(["sfm.prior_tlt=0.2"])
    with pytest.raises(BadInputError, match="the nearest one is 'dense'"):
        Options().with_values({"dens": {}})
    with pytest.raises(BadInputError, match="nearest one is 'ratio'"):
        options.read_toml("[features]\nratios = 0.7\n")


def test_options_survive_their_own_text() -> None:
    changed = Options().with_settings(["sfm.prior_tilt_deg=0.25", "input.tilts_deg=[-7, 0, 7]", "run.seed=4"])
    assert options.read_toml(changed.to_toml()).to_toml() == changed.to_toml()
    assert tomllib.loads(changed.to_toml())["input"]["tilts_deg"] == [-7.0, 0.0, 7.0]


def test_a_value_of_the_wrong_type_is_refused() -> None:
    for setting in ("sfm.prior_tilt_deg=wide", "run.seed=1.5", "sfm.invert_relief=1", "input.tilts_deg=3"):
        with pytest.raises(BadInputError, match=setting.partition("=")[0]):
            Options().with_settings([setting])


def test_command_line_flags_have_no_defaults_of_their_own() -> None:
    commands = [node for path, tree in SOURCES.items() if path.parts[0] == "cli" for node in tree.body]
    assert commands
    for node in commands:
        if isinstance(node, ast.FunctionDef) and node.decorator_list:
            defaults = [ast.unparse(item) for item in (*node.args.defaults, *node.args.kw_defaults) if item]
            assert set(defaults) <= {"None", "False"}, node.name


def test_effective_options_are_in_every_report() -> None:
    report = report_to_dict(make_result())
    for stage, values in Options().to_dict().items():
        assert set(report["options"][stage]) == set(values)


# 12. Log


def test_loggers_are_named_after_their_modules() -> None:
    for path, tree in SOURCES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "logging.getLogger" and path.parts[0] != "cli":
                # The root of all, a library that is to be silent, or our own: after the module, or after what is told.
                name = ast.unparse(node.args[0]) if node.args else "__name__"
                assert name in {"__name__", "'tifffile'"} or name.startswith("'semscape"), path
    assert isinstance(logging.getLogger("semscape"), logging.Logger)


# 13. Docstrings


def test_the_examples_in_docstrings_run(request: pytest.FixtureRequest) -> None:
    """`make test` collects src as doctests; this holds that door open."""
    assert "src" in request.config.getini("testpaths")
    assert "--doctest-modules" in request.config.getini("addopts")
    assert sum(">>>" in (PACKAGE / path).read_text(encoding="utf-8") for path in SOURCES) >= 15


def test_public_functions_have_docstrings() -> None:
    for path, tree in SOURCES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                nested = isinstance(node, ast.FunctionDef) and node not in tree.body
                assert nested or ast.get_docstring(node), f"{path}: {node.name}"


def test_types_stand_in_annotations_and_arrays_are_read_only() -> None:
    result = make_result()
    for value in (result.height_map, result.reconstruction, result.keypoints[0]):
        for spec in dataclasses.fields(value):
            item = getattr(value, spec.name)
            if isinstance(item, np.ndarray):
                with pytest.raises(ValueError, match="read-only"):
                    item[...] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.height_map.pixel_size_um = 2.0  # type: ignore[misc]
