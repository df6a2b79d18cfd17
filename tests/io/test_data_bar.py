from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from sem_files import draw_bar, noise

from semscape.io.data_bar import data_bar_rows, find_data_bar
from semscape.io.micrograph import read_micrograph


def found_rows(image: np.ndarray, header_rows: int = -1) -> int:
    return data_bar_rows(find_data_bar(image.astype(np.float32), header_rows))


@pytest.fixture
def plain() -> np.ndarray:
    return noise(0, (300, 320))


@pytest.mark.parametrize(("background", "ink"), [(0, 255), (255, 0), (96, 255)])
@pytest.mark.parametrize("frame", [True, False])
@pytest.mark.parametrize("rows", [20, 60])
def test_bar_at_the_bottom(plain: np.ndarray, background: int, ink: int, frame: bool, rows: int) -> None:
    image = draw_bar(plain, rows, background, ink, frame)
    mask = find_data_bar(image.astype(np.float32))
    assert not mask[-rows:].any()
    assert mask[:-rows].all()


def test_bar_at_the_top(plain: np.ndarray) -> None:
    mask = find_data_bar(draw_bar(plain, 40)[::-1].astype(np.float32))
    assert not mask[:40].any()
    assert mask[40:].all()


def test_bar_after_jpeg_and_resampling(plain: np.ndarray) -> None:
    picture = Image.fromarray(draw_bar(plain, 40))
    stream = io.BytesIO()
    picture.save(stream, "JPEG", quality=85)
    assert abs(found_rows(np.asarray(Image.open(stream))) - 40) <= 1
    half = picture.resize((240, 225), Image.Resampling.BICUBIC)
    assert abs(found_rows(np.asarray(half)) - 30) <= 2


def test_bar_under_a_black_image(plain: np.ndarray) -> None:
    black = np.zeros_like(plain)
    black[40:90, 50:120] = plain[40:90, 50:120]
    assert found_rows(draw_bar(black, 40)) == 40


def test_constant_strip_is_no_image(plain: np.ndarray) -> None:
    plain[-12:] = 0
    assert found_rows(plain) == 12


def test_header_goes_first(plain: np.ndarray) -> None:
    image = draw_bar(plain, 40)
    assert found_rows(image, header_rows=50) == 50
    assert found_rows(image, header_rows=0) == 40
    assert found_rows(image, header_rows=299) == 40


def test_images_without_a_bar(plain: np.ndarray) -> None:
    faded = plain * np.clip(np.linspace(1.6, -0.3, 300), 0, 1)[:, None]
    clipped = np.clip(plain.astype(np.float32), 128, 140)
    edge = plain.copy()
    edge[200:] //= 4
    for image in (plain, faded, clipped, edge, np.zeros_like(plain), plain[:20]):
        assert found_rows(np.asarray(image)) == 0


@pytest.mark.real_data
@pytest.mark.parametrize("series", ["potamogeton1", "quartz", "dsa"])
def test_no_bar_in_the_tilt_series(shared_data: Path, series: str) -> None:
    for path in sorted((shared_data / "tilt_series" / series).iterdir()):
        assert read_micrograph(path).mask.all(), path.name


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("zeiss_example_sem.tif", 60),
        ("zeiss_merlin_1k.tif", 77),
        ("tfs_example.tif", 68),
        ("fei_helios_8bit.tif", 29),
        ("tescan_example_sem1.tif", 120),
        ("sample1_x600.tif", 59),
        ("jeol_example_sem.tif", 0),
    ],
)
def test_bars_of_five_vendors(shared_data: Path, name: str, rows: int) -> None:
    micrograph = read_micrograph(shared_data / "vendor_metadata" / name)
    assert data_bar_rows(micrograph.mask) == rows
    # What the header says of Thermo Fisher's bars is also seen in the pixels.
    assert found_rows(micrograph.image) == rows
