from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from sem_files import draw_bar, fei_text, noise, write_image, write_tiff, zeiss_text

from semscape.geometry.rotations import wrap_axis_angle
from semscape.io.burnt_in import find_burnt_in_text
from semscape.io.inspect import bar_rows as rows_of_bar
from semscape.io.inspect import describe_series
from semscape.io.scan_settings import squeeze_rows
from semscape.io.series import load_series


def waves(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return 100 + 60 * np.sin(0.11 * rows + 0.05 * columns) + 30 * np.cos(0.17 * columns)


@pytest.mark.parametrize("angle_deg", [5.0, 30.0, 54.0])
def test_squeezing_undoes_the_stretch(angle_deg: float) -> None:
    """A surface stretched by 1 / cos about the middle row and squeezed back is the surface again."""
    factor = math.cos(math.radians(angle_deg))
    row, column = np.mgrid[:201, :60].astype(np.float64)
    stretched = waves(100 + (row - 100) * factor, column).astype(np.float32)
    image, mask = squeeze_rows(stretched, np.ones(stretched.shape, dtype=bool), factor)
    assert np.abs(image - waves(row, column))[mask].max() < 0.5
    assert mask.any(axis=1).sum() == pytest.approx(201 * factor, abs=2)
    assert not mask[0].any()


def test_squeezing_leaves_the_data_bar_where_it_is() -> None:
    image = noise(0, (120, 64)).astype(np.float32)
    mask = np.ones(image.shape, dtype=bool)
    mask[100:] = False
    squeezed, new_mask = squeeze_rows(image, mask, 0.8)
    np.testing.assert_array_equal(squeezed[100:], image[100:])
    assert not new_mask[100:].any()
    assert new_mask.any(axis=1).sum() == pytest.approx(80, abs=2)


def zeiss_series(folder: Path, **lines: str) -> None:
    for i in range(3):
        text = zeiss_text(AP_STAGE_AT_T=f"Stage at T = {5 * i} °", **lines)
        write_tiff(folder / f"img{i}.tif", noise(i), zeiss=text)


def test_tilt_correction_is_undone_with_its_evidence(tmp_path: Path) -> None:
    lines = {"DP_TILT_CORRECTION": "T = On", "AP_TILT_ANGLE": "T = 30 °", "DP_SCAN_ROT": "S = Off"}
    zeiss_series(tmp_path, AP_TILT_AXIS="Tilt Axis = 0 °", **lines)
    series = load_series(tmp_path)
    assert all(view.mask.any(axis=1).sum() == pytest.approx(96 * math.cos(math.pi / 6), abs=2) for view in series.views)
    (said,) = [text for text in series.warnings if "30 deg (tag 34118, AP_TILT_ANGLE): undone" in text]
    assert said.startswith("img0.tif, img1.tif, img2.tif: ")  # once for all of them
    (tmp_path / "series.toml").write_text("tilt_correction_deg = 0\n")
    assert all(view.mask.all() for view in load_series(tmp_path).views)


@pytest.mark.parametrize("axis_deg", [0, 90])
@pytest.mark.parametrize("bar_rows", [0, 60])
def test_bars_are_described_as_they_were_stored(tmp_path: Path, axis_deg: int, bar_rows: int) -> None:
    for i in range(2):
        image = draw_bar(noise(i, (400, 640)), bar_rows) if bar_rows else np.minimum(noise(i, (400, 640)), 250)
        image[365:385, 80:380] = 0 if bar_rows else image[365:385, 80:380]
        image[374:378, 100:351] = 255
        write_image(tmp_path / f"img{i}.png", image)
    lines = f"tilt_correction_deg = 20\ntilt_correction_axis_deg = {axis_deg}\npixel_size_um = 0.1\n"
    (tmp_path / "series.toml").write_text(lines)
    series = load_series(tmp_path)
    assert sum("undone" in text for text in series.warnings) == 1
    for row in describe_series(series):
        assert (row["data_bar_rows"], row["scale_bar_px"]) == (bar_rows, 251.0)
    assert [rows_of_bar(view) for view in series.views] == [bar_rows] * 2  # what the report says


def test_tilt_correction_of_thermo_fisher_is_undone(tmp_path: Path) -> None:
    for i in range(2):
        beam = {"TiltCorrectionIsOn": "yes", "TiltCorrectionAngle": 0.5, "ScanRotation": math.pi * i}
        write_tiff(tmp_path / f"f{i}.tif", noise(i), fei=fei_text(EBeam=beam, Stage={"StageT": 0.1 * i}))
    series = load_series(tmp_path)
    assert all(view.mask.any(axis=1).sum() == pytest.approx(96 * math.cos(0.5), abs=2) for view in series.views)
    assert sum("EBeam.TiltCorrectionAngle): undone" in text for text in series.warnings) == 1


@pytest.mark.parametrize("told", [{"AP_TILT_AXIS": "T = 90.0 °"}, {"DP_STAGE_TILTED": "Stage Tilt = in X"}])
def test_a_correction_about_a_vertical_axis_stretches_the_columns(tmp_path: Path, told: dict[str, str]) -> None:
    lines = {"DP_TILT_CORRECTION": "T = On", "AP_TILT_ANGLE": "T = 30 °", "DP_SCAN_ROT": "S = Off"}
    zeiss_series(tmp_path, **lines, **told)
    series = load_series(tmp_path)
    for view in series.views:
        assert view.mask.any(axis=0).sum() == pytest.approx(128 * math.cos(math.pi / 6), abs=2)
        assert view.mask.any(axis=1).all()
        assert view.image.shape == (96, 128)
    assert sum("undone, the columns are squeezed" in text for text in series.warnings) == 1


def test_the_user_tells_across_which_axis_an_image_is_stretched(tmp_path: Path) -> None:
    zeiss_series(tmp_path, DP_TILT_CORRECTION="T = On", AP_TILT_ANGLE="T = 30 °", AP_TILT_AXIS="T = 45 °")
    assert any("tilt_correction_axis_deg = 0" in text for text in load_series(tmp_path).warnings)
    (tmp_path / "series.toml").write_text("tilt_correction_axis_deg = 90\n")
    for view in load_series(tmp_path).views:
        assert view.mask.any(axis=0).sum() == pytest.approx(128 * math.cos(math.pi / 6), abs=2)


def test_the_sign_of_a_stage_that_tilts_in_x_is_not_sure(tmp_path: Path) -> None:
    zeiss_series(tmp_path, AP_TILT_AXIS="Tilt Axis = 90.0 °")
    assert any("positive leans structures to the left" in text for text in load_series(tmp_path).warnings)
    for path in tmp_path.iterdir():
        path.unlink()
    zeiss_series(tmp_path, DP_STAGE_TILTED="Stage Tilt = In Y")
    assert load_series(tmp_path).warnings == ()


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ({"AP_TILT_ANGLE": "T = 30 °"}, "with an unknown scan rotation"),
        ({"AP_TILT_ANGLE": "T = 30 °", "DP_SCAN_ROT": "S = Off", "AP_TILT_AXIS": "T = 45 °"}, "is not sure"),
        ({"AP_TILT_ANGLE": "T = ### °", "DP_SCAN_ROT": "S = Off"}, "of an angle that is not told"),
        ({"AP_TILT_ANGLE": "T = 80 °", "DP_SCAN_ROT": "S = Off"}, "by 80 deg"),
        (
            {"AP_TILT_ANGLE": "T = 30 °", "DP_SCAN_ROT": "S = On", "AP_SCANROTATION": "S = 20 °"},
            "with a scan rotation of 20 deg",
        ),
    ],
)
def test_tilt_correction_that_is_not_sure_is_only_told(tmp_path: Path, lines: dict[str, str], said: str) -> None:
    zeiss_series(tmp_path, DP_TILT_CORRECTION="T = On", **lines)
    series = load_series(tmp_path)
    assert all(view.mask.all() for view in series.views)
    assert any(said in text for text in series.warnings)


def test_dynamic_focus_is_told(tmp_path: Path) -> None:
    zeiss_series(tmp_path, DP_DYNFOCUS="Dyn.Focus = On")
    assert any("dynamic focus" in text and "DP_DYNFOCUS" in text for text in load_series(tmp_path).warnings)
    for path in tmp_path.iterdir():
        path.unlink()
    for i in range(2):
        write_tiff(tmp_path / f"f{i}.tif", noise(i), fei=fei_text(EBeam={"DynamicFocusIsOn": "yes"}))
    assert any("EBeam.DynamicFocusIsOn" in text for text in load_series(tmp_path).warnings)


@pytest.mark.parametrize(("rotation_deg", "sign"), [(0, -1), (20, -1), (160, 1), (180, 1), (200, 1), (340, -1)])
def test_a_scan_turned_by_180_deg_turns_the_sign_of_the_tilts(tmp_path: Path, rotation_deg: float, sign: int) -> None:
    zeiss_series(tmp_path, DP_SCAN_ROT="S = On", AP_SCANROTATION=f"S = {rotation_deg} °")
    series = load_series(tmp_path)
    tilts = {view.name: math.degrees(view.metadata.tilt_rad) for view in series.views}
    assert tilts == {f"img{i}.tif": pytest.approx(sign * 5 * i) for i in range(3)}
    assert any("sign is turned" in text for text in series.warnings) == (sign > 0)
    assert any("either direction" in text for text in series.warnings) == (rotation_deg not in (0, 180))
    assert np.isnan(series.views[0].metadata.tilt_axis_angle_rad)


def test_a_scan_turned_by_90_deg_leaves_the_sign_open(tmp_path: Path) -> None:
    zeiss_series(tmp_path, DP_SCAN_ROT="S = On", AP_SCANROTATION="S = 90 °")
    assert any("sign of the stage tilts is not sure" in text for text in load_series(tmp_path).warnings)


@pytest.mark.parametrize("rotation_deg", [60, 120, 240, 300])
def test_where_the_axis_is_found_tells_the_sign(tmp_path: Path, rotation_deg: float) -> None:
    """Counted either way, the turned axis is one of two lines; in (-45, 135] deg one of them has the other sense."""
    zeiss_series(tmp_path, DP_SCAN_ROT="S = On", AP_SCANROTATION=f"S = {rotation_deg} °")
    (text,) = [text for text in load_series(tmp_path).warnings if "scan rotation" in text]
    for counted in (1, -1):
        axis, flipped = wrap_axis_angle(math.radians(counted * rotation_deg))
        said = f"if near {math.degrees(axis):.0f} deg, give" if flipped else f"found near {math.degrees(axis):.0f} deg"
        assert said in text


def test_a_scan_rotation_that_is_off_changes_nothing(tmp_path: Path) -> None:
    zeiss_series(tmp_path, DP_SCAN_ROT="S = Off", AP_SCANROTATION="S = 180 °")
    series = load_series(tmp_path)
    assert series.warnings == ()
    assert math.degrees(series.views[0].metadata.tilt_rad) == pytest.approx(-10)


def test_given_tilts_keep_their_sign_whatever_the_scan(tmp_path: Path) -> None:
    zeiss_series(tmp_path, DP_SCAN_ROT="S = On", AP_SCANROTATION="S = 180 °")
    (tmp_path / "series.toml").write_text("tilts_deg = [-5, 0, 5]\n")
    np.testing.assert_allclose(np.rad2deg(load_series(tmp_path).tilt_rad), [-5, 0, 5])


def glyphs(shape: tuple[int, int], seed: int = 3) -> np.ndarray:
    text = np.kron(np.random.default_rng(seed).random((4, 20)) < 0.4, np.ones((4, 4), dtype=bool))
    found = np.zeros(shape, dtype=bool)
    found[-30 : -30 + text.shape[0], 20 : 20 + text.shape[1]] = text
    return found


@pytest.mark.parametrize("value", [0, 255])
def test_text_without_a_strip_is_masked(tmp_path: Path, value: int) -> None:
    text = glyphs((200, 240))
    for i in range(3):
        image = np.clip(noise(i, (200, 240)), 5, 250)
        image[text] = value
        image[20 + 5 * i : 60 + 5 * i, 30:90] = value  # a saturated grain, which moves
        write_image(tmp_path / f"img{i}.png", image)
    series = load_series(tmp_path)
    mask = series.views[0].mask
    assert not mask[text].any()
    assert mask[:160].all()
    assert any("burnt into the images" in warning for warning in series.warnings)


def test_what_only_looks_like_text_stays() -> None:
    everywhere = [np.ones((200, 240), dtype=bool)] * 3
    grains = [np.roll(glyphs((200, 240)), 4 * i, axis=1) for i in range(3)]  # the specimen moves
    images = [np.where(grain, 255, np.clip(noise(i, (200, 240)), 0, 250)) for i, grain in enumerate(grains)]
    assert not find_burnt_in_text([image.astype(np.float32) for image in images], everywhere).any()
    one_spot = [np.clip(noise(i, (200, 240)), 0, 250).astype(np.float32) for i in range(3)]
    for image in one_spot:
        image[50:60, 50:60] = 255  # a single patch is no text
    assert not find_burnt_in_text(one_spot, everywhere).any()
    holes = [np.clip(noise(i, (200, 240)), 1, 250).astype(np.float32) for i in range(3)]
    for i, image in enumerate(holes):  # black holes that hardly move
        for left in (10, 90, 170):
            image[100:160, left + i : left + 60 + i] = 0
    assert not find_burnt_in_text(holes, everywhere).any()
    assert not find_burnt_in_text([np.zeros((9, 9), np.float32)] * 2, [np.ones((9, 9), dtype=bool)] * 2).any()
