from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sem_files import draw_bar, fei_text, noise, write_image, write_tiff

from semscape.errors import BadInputError
from semscape.io.data_bar import find_data_bar
from semscape.io.inspect import describe_series
from semscape.io.micrograph import read_micrograph
from semscape.io.scale_bar import find_scale_bar
from semscape.io.series import load_image, load_series
from semscape.options import InputOptions


def bar_image(kind: str, length: int, seed: int = 0, thickness: int = 2) -> np.ndarray:
    """Return noise over a data bar of 60 rows with text and a scale bar whose ends are `length` px apart."""
    image = draw_bar(noise(seed, (400, 640)), 60)
    strip = image[-60:]
    strip[4:56, 320:636] = 0
    left, right, row = 330, 330 + length, 20
    if kind == "ruler":
        for column in np.linspace(left, right, 11):
            strip[10:22, round(column) - 1 : round(column) + 2] = 255
        return image
    strip[row : row + thickness, left : right + 1] = 255
    if kind != "line":
        strip[row - 6 : row + 6 + thickness, [left, right]] = 255
    if kind == "split":
        strip[row - 8 : row + 10, left + length // 3 : right - length // 3] = 0
        strip[row - 5 : row + 5, left + length // 2 - 8 : left + length // 2 + 8 : 4] = 255
    return image


def found(image: np.ndarray) -> tuple[float, str] | None:
    values = image.astype(np.float32)
    bar = find_scale_bar(values, find_data_bar(values))
    return None if bar is None else (bar.length_px, bar.kind)


@pytest.mark.parametrize("length", [60, 200, 290])
@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("thickness", [1, 2, 3])
def test_lines_with_ticks(length: int, inverted: bool, thickness: int) -> None:
    for kind in ("ticked", "split"):
        image = bar_image(kind, length, thickness=thickness)
        if inverted:
            image[-60:] = 255 - image[-60:]
        assert found(image) == (length, "ticked"), kind


def test_rulers_and_plain_lines() -> None:
    assert found(bar_image("ruler", 250)) == (250, "ruler")
    assert found(bar_image("line", 250)) == (251, "line")  # a line is as long as its ink


def test_bars_without_a_scale() -> None:
    assert found(draw_bar(noise(0, (400, 640)), 60)) is None
    assert found(noise(0, (400, 640))) is None
    assert found(np.zeros((400, 640), dtype=np.uint8)) is None


def test_a_line_burnt_straight_into_the_image() -> None:
    image = np.minimum(noise(0, (400, 640)), 250)
    image[360:364, 100:350] = 255
    assert found(image) == (250, "line")
    image[:40] = 255  # a saturated sky is no bar
    assert found(image) == (250, "line")


def test_inspect_gives_advice_and_the_flag_sets_the_pixel_size(tmp_path: Path) -> None:
    for i in range(3):
        write_image(tmp_path / f"img{i}.png", bar_image("ticked", 200, seed=i))
    series = load_series(tmp_path)
    assert series.length_unit == "px"
    (advice,) = [text for text in series.warnings if "scale bar" in text]
    assert "200 px long" in advice
    assert "--scale-bar-um 40" in advice
    scaled = load_series(tmp_path, InputOptions(scale_bar_um=40.0))
    np.testing.assert_allclose(scaled.pixel_size_um, 0.2)
    assert scaled.views[0].metadata.source["pixel_size_um"] == "user"
    assert any("good to about 0.8 %" in text for text in scaled.warnings)
    (tmp_path / "series.toml").write_text("scale_bar_um = 20\n")
    series = load_series(tmp_path)
    np.testing.assert_allclose(series.pixel_size_um, 0.1)
    assert series.views[0].metadata.source["pixel_size_um"] == "sidecar"
    np.testing.assert_allclose(load_series(tmp_path, InputOptions(pixel_size_um=0.3)).pixel_size_um, 0.3)


def test_a_bar_amid_burnt_in_text_is_found_although_that_is_masked(tmp_path: Path) -> None:
    for i in range(3):
        image = np.minimum(noise(i, (400, 640)), 250)
        image[360:364, 100:350] = 255
        for column in range(380, 480, 20):
            image[354:370, column : column + 9] = 255
        write_image(tmp_path / f"img{i}.png", image)
    series = load_series(tmp_path)
    assert not series.views[0].mask[360:364, 100:350].any()
    assert any("250 px long (row 361, columns 100 to 349)" in text for text in series.warnings)
    assert [row["scale_bar_px"] for row in describe_series(series)] == [250.0] * 3
    np.testing.assert_allclose(load_series(tmp_path, InputOptions(scale_bar_um=50.0)).pixel_size_um, 0.2)


def test_a_single_image_is_inspected_like_those_of_a_folder(tmp_path: Path) -> None:
    path = write_image(tmp_path / "img.png", bar_image("ticked", 200))
    (advice,) = load_image(path).warnings
    assert "200 px long" in advice
    assert "give --scale-bar-um 40" in advice
    np.testing.assert_allclose(load_image(path, InputOptions(scale_bar_um=40.0)).pixel_size_um, 0.2)
    told = write_tiff(tmp_path / "b.tif", noise(1), fei=fei_text(Scan={"PixelWidth": 1e-7, "PixelHeight": 1e-7}))
    series = load_image(told)
    np.testing.assert_allclose(series.pixel_size_um, 0.1)
    assert series.warnings == ()  # one header cannot be a copy


def test_scale_bars_that_give_no_answer(tmp_path: Path) -> None:
    for i in range(3):
        write_image(tmp_path / f"img{i}.png", bar_image("ticked", 200 + 40 * (i == 2), seed=i))
    with pytest.raises(BadInputError, match=r"240 px in img2\.png"):
        load_series(tmp_path, InputOptions(scale_bar_um=40))
    write_image(tmp_path / "img2.png", draw_bar(noise(2, (400, 640)), 60))
    with pytest.raises(BadInputError, match=r"img2\.png: no scale bar"):
        load_series(tmp_path, InputOptions(scale_bar_um=40))
    with pytest.raises(BadInputError, match="one of the two"):
        load_series(tmp_path, InputOptions(scale_bar_um=40, pixel_size_um=0.1))
    with pytest.raises(BadInputError, match="positive"):
        load_series(tmp_path, InputOptions(scale_bar_um=-40))


def test_a_scale_bar_that_contradicts_the_header(tmp_path: Path) -> None:
    for i in range(2):
        text = fei_text(Scan={"PixelWidth": 1e-7, "PixelHeight": 1e-7})
        write_tiff(tmp_path / f"img{i}.tif", bar_image("ticked", 200, seed=i), fei=text)
    assert load_series(tmp_path).warnings == load_series(tmp_path, InputOptions(scale_bar_um=20)).warnings[:-1]
    assert "headers give" in load_series(tmp_path, InputOptions(scale_bar_um=40)).warnings[-1]


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "length_um"),
    [
        ("zeiss_example_sem.tif", 40),
        ("zeiss_merlin_1k.tif", 200),
        ("tfs_example.tif", 100),
        ("fei_helios_8bit.tif", 500),
        ("tescan_example_sem1.tif", 500),
        ("sample1_x600.tif", 50),
        ("jeol_example_sem.tif", 500),
    ],
)
def test_scale_bars_of_five_vendors_agree_with_their_headers(shared_data: Path, name: str, length_um: float) -> None:
    micrograph = read_micrograph(shared_data / "vendor_metadata" / name)
    bar = find_scale_bar(micrograph.image, micrograph.mask)
    assert bar is not None
    assert bar.length_px == pytest.approx(length_um / micrograph.metadata.pixel_size_um, abs=1.7)


@pytest.mark.real_data
@pytest.mark.parametrize("series", ["potamogeton1", "quartz", "dsa"])
def test_no_scale_bar_in_the_tilt_series(shared_data: Path, series: str) -> None:
    for path in sorted((shared_data / "tilt_series" / series).iterdir()):
        micrograph = read_micrograph(path)
        assert find_scale_bar(micrograph.image, micrograph.mask) is None
