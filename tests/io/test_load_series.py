from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from sem_files import ZEISS_TAG, draw_bar, noise, write_image, write_tiff, write_tilted, zeiss_text

from semscape.errors import BadInputError
from semscape.io.inspect import describe_series
from semscape.io.series import load_series
from semscape.options import InputOptions


def write_plain(folder: Path, n_images: int = 3) -> list[Path]:
    return [write_image(folder / f"img{i + 1}.png", noise(i)) for i in range(n_images)]


def tilts_deg(folder: Path, options: InputOptions | None = None) -> list[float]:
    series = load_series(folder, options or InputOptions())
    return [float(round(tilt, 6)) for tilt in np.rad2deg(series.tilt_rad)]


def test_natural_order_without_tilts(tmp_path: Path) -> None:
    for seed, name in enumerate(("img10.png", "img2.png", "IMG1.png")):
        write_image(tmp_path / name, noise(seed))
    series = load_series(tmp_path)
    assert series.names == ("IMG1.png", "img2.png", "img10.png")
    assert np.isnan(series.tilt_rad).all()
    assert series.length_unit == "px"
    assert series.warnings == ()


def test_other_files_are_ignored(tmp_path: Path) -> None:
    write_plain(tmp_path, 2)
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / ".img3.png").write_bytes(b"hidden")
    (tmp_path / "old.png").mkdir()
    assert load_series(tmp_path).n_views == 2


def test_ordered_by_tilt_from_the_files(tmp_path: Path) -> None:
    write_tilted(tmp_path, [0.0, 5.0, -5.0])
    series = load_series(tmp_path)
    assert series.names == ("img2.tif", "img1.tif", "img3.tif")
    np.testing.assert_allclose(np.rad2deg(series.tilt_rad), [-5, 0, 5], atol=1e-9)
    assert all(view.metadata.source["tilt_rad"] == "file" for view in series.views)
    assert series.length_unit == "um"
    assert series.warnings == ()


def test_user_before_sidecar_before_file(tmp_path: Path) -> None:
    write_tilted(tmp_path, [0.0, 5.0, 10.0])
    (tmp_path / "series.toml").write_text("tilts_deg = [4, 3, 2]\npixel_size_um = 0.2\naxis_deg = 90\n")
    series = load_series(tmp_path)
    assert series.names == ("img3.tif", "img2.tif", "img1.tif")
    source = series.views[0].metadata.source
    assert (source["tilt_rad"], source["pixel_size_um"], source["tilt_axis_angle_rad"]) == ("sidecar",) * 3
    assert series.views[0].metadata.tilt_axis_angle_rad == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(series.pixel_size_um, 0.2)

    series = load_series(tmp_path, InputOptions(tilts_deg=(-1, 0, 1), pixel_size_um=0.3, axis_deg=10))
    np.testing.assert_allclose(np.rad2deg(series.tilt_rad), [-1, 0, 1])
    np.testing.assert_allclose(series.pixel_size_um, 0.3)
    source = series.views[0].metadata.source
    assert (source["tilt_rad"], source["pixel_size_um"], source["tilt_axis_angle_rad"]) == ("user",) * 3

    series = load_series(tmp_path, InputOptions(axis_deg=10))
    source = series.views[0].metadata.source
    assert (source["tilt_rad"], source["tilt_axis_angle_rad"]) == ("sidecar", "user")


def test_equal_tilts_in_the_headers_are_not_believed(tmp_path: Path) -> None:
    write_tilted(tmp_path, [27.0, 27.0, 27.02])
    series = load_series(tmp_path)
    assert np.isnan(series.tilt_rad).all()
    assert all("tilt_rad" not in view.metadata.source for view in series.views)
    assert any("27 deg" in text and "unknown" in text for text in series.warnings)
    assert tilts_deg(tmp_path, InputOptions(tilts_deg=(1, 2, 3))) == [1, 2, 3]


def test_tilts_known_for_some_views(tmp_path: Path) -> None:
    write_tilted(tmp_path, [5.0, 0.0])
    write_tiff(tmp_path / "img3.tif", noise(9))
    series = load_series(tmp_path)
    assert series.names == ("img1.tif", "img2.tif", "img3.tif")
    assert np.isnan(series.tilt_rad).tolist() == [False, False, True]
    assert any("no tilt" in text and "img3.tif" in text for text in series.warnings)
    assert series.views[2].metadata.source["pixel_size_um"] == "assumed"
    assert series.pixel_size_um[2] == pytest.approx(0.05)
    assert any("median" in text for text in series.warnings)


def test_impossible_tilt_in_a_header_is_unknown(tmp_path: Path) -> None:
    write_tilted(tmp_path, [0.0, 5.0, 120.0])
    series = load_series(tmp_path)
    assert np.isnan(series.tilt_rad).tolist() == [False, False, True]
    assert any("img3.tif" in text and "120" in text for text in series.warnings)


def test_copied_header_makes_the_pixel_size_doubtful(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[ZEISS_TAG] = zeiss_text(
        AP_IMAGE_PIXEL_SIZE="Image Pixel Size = 74.43 nm", AP_STAGE_AT_T="Stage at T =  27.0 °"
    )
    exif[305] = "GIMP 2.10.8"
    for i in range(3):
        write_image(tmp_path / f"pot{i}.jpg", noise(i), exif=exif)
    series = load_series(tmp_path)
    np.testing.assert_allclose(series.pixel_size_um, 0.07443)
    assert any("GIMP" in text and "doubtful" in text for text in series.warnings)
    assert {row["sources"]["pixel_size_um"] for row in describe_series(series)} == {"doubtful"}
    assert not any("sign of this" in text for text in series.warnings)  # no tilt is taken from the headers
    given = load_series(tmp_path, InputOptions(tilts_deg=(0, 3, 6), pixel_size_um=0.07))
    assert given.warnings == ()


def test_a_sign_that_is_assumed_is_said_where_the_tilt_is_used(tmp_path: Path) -> None:
    for i, tilt in enumerate((0.0, 5.0, 10.0)):
        write_tiff(
            tmp_path / f"img{i}.tif",
            noise(i),
            zeiss=zeiss_text(
                AP_IMAGE_PIXEL_SIZE="Image Pixel Size = 50 nm",
                AP_STAGE_AT_T=f"Stage at T = {tilt} °",
                AP_TILT_AXIS="Tilt Axis = 90",
            ),
        )
    used = [text for text in load_series(tmp_path).warnings if "sign of this" in text]
    assert len(used) == 1
    assert used[0].startswith("img1.tif, img2.tif: ")  # zero has no sign
    assert not any("sign of" in text for text in load_series(tmp_path, InputOptions(tilts_deg=(0, 5, 10))).warnings)


def test_spread_of_pixel_sizes(tmp_path: Path) -> None:
    for i, size in enumerate((50, 50.5, 54)):
        text = zeiss_text(AP_IMAGE_PIXEL_SIZE=f"Image Pixel Size = {size} nm")
        write_tiff(tmp_path / f"img{i}.tif", noise(i), zeiss=text)
    series = load_series(tmp_path)
    np.testing.assert_allclose(series.pixel_size_um, [0.05, 0.0505, 0.054])
    assert len(series.warnings) == 1
    assert "8.0 %" in series.warnings[0]
    (tmp_path / "img2.tif").unlink()
    assert load_series(tmp_path).warnings == ()


def test_scan_settings_are_noted(tmp_path: Path) -> None:
    for i in range(3):
        text = zeiss_text(
            DP_TILT_CORRECTION="Tilt Corrn. = On",
            AP_TILT_ANGLE="Tilt Angle = 30.0 °",
            DP_SCAN_ROT="Scan Rot = On",
            AP_SCANROTATION=f"Scan Rotation = {10 * i} °",
        )
        write_tiff(tmp_path / f"img{i}.tif", noise(i), zeiss=text)
    warnings = load_series(tmp_path).warnings
    assert any("tilt correction was on" in text for text in warnings)
    assert any("scan rotation differs" in text for text in warnings)


def test_notes_of_several_files_are_said_once(tmp_path: Path) -> None:
    for i in range(3):
        write_tiff(tmp_path / f"img{i}.tif", np.stack([noise(i), noise(9)]), photometric="minisblack")
    assert load_series(tmp_path).warnings == (
        "img0.tif, img1.tif, img2.tif: the TIFF holds 2 pages; the first one is used",
    )


def test_bar_of_most_views_is_masked_in_all(tmp_path: Path) -> None:
    for i in range(3):
        write_image(tmp_path / f"img{i}.png", draw_bar(noise(i, (300, 320)), 40))
    blurred = draw_bar(noise(5, (300, 320)), 40)
    blurred[-40:] = np.clip(blurred[-40:] + 0.3 * noise(6, (40, 320)), 0, 255)
    write_image(tmp_path / "img3.png", blurred)
    series = load_series(tmp_path)
    assert all(not view.mask[-40:].any() and view.mask[:-40].all() for view in series.views)
    assert len(series.warnings) == 1
    assert "img3.png" in series.warnings[0]


class TestRefused:
    def test_missing_folder(self, tmp_path: Path) -> None:
        with pytest.raises(BadInputError, match="nowhere: there is no such folder"):
            load_series(tmp_path / "nowhere")

    def test_file_as_folder(self, tmp_path: Path) -> None:
        (path,) = write_plain(tmp_path, 1)
        with pytest.raises(BadInputError, match=r"img1\.png: this is a file"):
            load_series(path)

    def test_empty_folder(self, tmp_path: Path) -> None:
        (tmp_path / "notes.txt").write_text("hello")
        with pytest.raises(BadInputError, match=r"no images.*1 other files.*\.tif"):
            load_series(tmp_path)

    def test_one_image(self, tmp_path: Path) -> None:
        write_plain(tmp_path, 1)
        with pytest.raises(BadInputError, match=r"only one image \(img1\.png\)"):
            load_series(tmp_path)

    def test_different_sizes(self, tmp_path: Path) -> None:
        write_plain(tmp_path, 3)
        write_image(tmp_path / "odd.png", noise(9, (80, 128)))
        with pytest.raises(BadInputError, match=r"odd\.png is 128 x 80, but 3 like img1\.png are 128 x 96"):
            load_series(tmp_path)

    def test_unreadable_file(self, tmp_path: Path) -> None:
        write_plain(tmp_path, 2)
        (tmp_path / "text.tif").write_text("this is text")
        with pytest.raises(BadInputError, match=r"text\.tif: not an image"):
            load_series(tmp_path)

    @pytest.mark.parametrize("value", [0, 255])
    def test_constant_image(self, tmp_path: Path, value: int) -> None:
        write_plain(tmp_path, 2)
        write_image(tmp_path / "dark.png", np.full((96, 128), value, dtype=np.uint8))
        with pytest.raises(BadInputError, match=rf"dark\.png: the image holds one single value \({value}\)"):
            load_series(tmp_path)

    def test_black_image_with_a_data_bar(self, tmp_path: Path) -> None:
        for i in range(2):
            write_image(tmp_path / f"img{i}.png", noise(i, (300, 320)))
        write_image(tmp_path / "img2.png", draw_bar(np.zeros((300, 320), dtype=np.uint8), 40))
        with pytest.raises(BadInputError, match=r"img2\.png: the image holds one single value \(0\)"):
            load_series(tmp_path)

    def test_the_same_image_twice(self, tmp_path: Path) -> None:
        paths = write_plain(tmp_path, 2)
        write_tiff(tmp_path / "img3.tif", noise(1))
        with pytest.raises(BadInputError, match=r"img2\.png and img3\.tif hold the very same image"):
            load_series(tmp_path)
        for path in (*paths, tmp_path / "img3.tif"):
            path.unlink()
        for name in ("a.png", "b.png", "c.png"):
            write_image(tmp_path / name, noise(0))
        with pytest.raises(BadInputError, match=r"a\.png and b\.png"):
            load_series(tmp_path)

    def test_wrong_number_of_tilts(self, tmp_path: Path) -> None:
        write_plain(tmp_path, 3)
        with pytest.raises(BadInputError, match=r"2 tilts for 3 images.*img1\.png, img2\.png, img3\.png"):
            load_series(tmp_path, InputOptions(tilts_deg=(-5, 5)))

    @pytest.mark.parametrize("tilts", [(0, 5, 86), (0, 5, math.nan), (0, math.inf, 5)])
    def test_impossible_tilts(self, tmp_path: Path, tilts: tuple[float, ...]) -> None:
        write_plain(tmp_path, 3)
        with pytest.raises(BadInputError, match=r"img\d\.png; a tilt must lie within"):
            load_series(tmp_path, InputOptions(tilts_deg=tilts))

    def test_one_tilt_twice(self, tmp_path: Path) -> None:
        write_plain(tmp_path, 3)
        with pytest.raises(BadInputError, match=r"img1\.png and img3\.png are both at 5 deg"):
            load_series(tmp_path, InputOptions(tilts_deg=(5, 0, 5.01)))

    def test_one_tilt_at_two_rotations_of_the_stage(self, tmp_path: Path) -> None:
        write_plain(tmp_path, 2)
        text = '[images."img1.png"]\ntilt_deg = 40\nstage_rotation_deg = {}\n[images."img2.png"]\ntilt_deg = 40\n'
        (tmp_path / "series.toml").write_text(text.format(60), encoding="utf-8")
        turned = [np.rad2deg(view.metadata.stage_rotation_rad) for view in load_series(tmp_path).views]
        np.testing.assert_allclose(turned, [60, np.nan])
        (tmp_path / "series.toml").write_text(text.format(0), encoding="utf-8")
        with pytest.raises(BadInputError, match="both at 40 deg"):
            load_series(tmp_path)

    @pytest.mark.parametrize("size", [0.0, -0.05, math.inf])
    def test_impossible_pixel_size(self, tmp_path: Path, size: float) -> None:
        write_plain(tmp_path, 2)
        with pytest.raises(BadInputError, match="pixel size given is"):
            load_series(tmp_path, InputOptions(pixel_size_um=size))

    @pytest.mark.parametrize("axis", [-45.0, 180.0, math.inf])
    def test_axis_out_of_range(self, tmp_path: Path, axis: float) -> None:
        write_plain(tmp_path, 2)
        with pytest.raises(BadInputError, match=r"\(-45, 135\]"):
            load_series(tmp_path, InputOptions(axis_deg=axis))

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("tilt_deg = [1, 2]", r"unknown key 'tilt_deg'; the nearest one is 'tilts_deg'"),
            ("tilts_deg = 3", "must be a list of numbers"),
            ("tilts_deg = [1, true]", "must be a list of numbers"),
            ("tilts_deg = [1, nan]", "a tilt must lie within"),
            ("tilts_deg = [1]", "1 tilts for 2 images"),
            ("tilts_deg = [1, 1.01]", "both at 1 deg"),
            ("pixel_size_um = nan", "pixel_size_um is nan um; it must be a positive number"),
            ("pixel_size_um = -1", "positive"),
            ('pixel_size_um = "50 nm"', "must be a number"),
            ("axis_deg = nan", "axis_deg is nan deg"),
            ("axis_deg = [0]", "must be a number"),
            ("tilts_deg = [1, 2", "cannot be read as TOML"),
        ],
    )
    def test_bad_sidecar(self, tmp_path: Path, text: str, message: str) -> None:
        write_plain(tmp_path, 2)
        (tmp_path / "series.toml").write_text(text)
        with pytest.raises(BadInputError, match=message) as caught:
            load_series(tmp_path)
        assert "series.toml" in str(caught.value)


def test_describe_series(tmp_path: Path) -> None:
    write_tilted(tmp_path, [0.0, 5.0])
    write_tiff(tmp_path / "img3.tif", np.stack([noise(7), noise(8)]), photometric="minisblack")
    described = describe_series(load_series(tmp_path))
    json.dumps(described, allow_nan=False)
    assert [row["name"] for row in described] == ["img1.tif", "img2.tif", "img3.tif"]
    second, third = described[1:]
    assert (second["width"], second["height"], second["bits_per_sample"], second["format"]) == (128, 96, 8, "TIFF")
    assert second["vendor"] == "Zeiss"
    assert (second["tilt_deg"], second["stage_tilt_deg"], second["pixel_size_um"]) == (-5.0, 5.0, 0.05)
    assert second["sources"] == {"pixel_size_um": "file", "tilt_deg": "file", "data_bar_rows": "image"}
    assert third["tilt_deg"] is None
    assert third["working_distance_mm"] is None
    assert third["sources"]["pixel_size_um"] == "assumed"
    assert any("2 pages" in text for text in third["warnings"])
    assert not any("2 pages" in text for text in second["warnings"])


@pytest.mark.real_data
def test_potamogeton_headers_are_not_believed(shared_data: Path) -> None:
    series = load_series(shared_data / "tilt_series" / "potamogeton1")
    assert series.shape == (715, 768)
    np.testing.assert_allclose(series.pixel_size_um, 0.07443)
    assert np.isnan(series.tilt_rad).all()
    assert any("27 deg" in text for text in series.warnings)
    assert any("GIMP" in text and "doubtful" in text for text in series.warnings)
    assert [row["stage_tilt_deg"] for row in describe_series(series)] == [27.0] * 4
    assert {row["sources"]["pixel_size_um"] for row in describe_series(series)} == {"doubtful"}
    assert any("cropped or resized" in text for text in series.warnings)
    assert not any("sign of this" in text for text in series.warnings)
    given = InputOptions(pixel_size_um=0.0744, tilts_deg=(0, 3, 6, 9))
    assert load_series(shared_data / "tilt_series" / "potamogeton1", given).warnings == ()


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "size"), [("quartz", 1200), ("dsa", 2000)])
def test_series_without_metadata(shared_data: Path, name: str, size: int) -> None:
    series = load_series(shared_data / "tilt_series" / name)
    assert series.shape == (size, size)
    assert series.n_views == 3
    assert series.length_unit == "px"
    assert series.warnings == ()


@pytest.mark.real_data
def test_one_view_by_three_detectors_is_no_tilt_series(shared_data: Path) -> None:
    series = load_series(shared_data / "multi_detector" / "surface1")
    assert np.isnan(series.tilt_rad).all()
    np.testing.assert_allclose(series.pixel_size_um, 0.325521)
    assert all(not view.mask[-79:].any() and view.mask[:-79].all() for view in series.views)
