from __future__ import annotations

import contextlib
import hashlib
import logging
import struct
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from sem_files import ZEISS_TAG, noise, write_image, write_tiff, zeiss_text

from semscape.errors import BadInputError
from semscape.io.micrograph import read_micrograph, read_micrograph_and_warnings


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "lzw", "predictor": True},
        {"compression": "zlib"},
        {"byteorder": ">"},
        {"tile": (32, 32)},
        {"rowsperstrip": 7},
        {"bigtiff": True},
        {"compression": "lzw", "predictor": True, "byteorder": ">", "tile": (64, 64)},
    ],
)
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_tiff_values_as_stored(tmp_path: Path, dtype: str, options: dict[str, object]) -> None:
    image = noise(0, dtype=dtype)
    path = write_tiff(tmp_path / "a.tif", image, **options)
    micrograph = read_micrograph(path)
    assert micrograph.image.dtype == np.float32
    np.testing.assert_array_equal(micrograph.image, image)
    assert micrograph.name == "a.tif"
    assert micrograph.mask.all()
    assert micrograph.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert micrograph.metadata.raw["file.bits_per_sample"] == str(np.iinfo(dtype).bits)
    assert micrograph.metadata.vendor == "unknown"


@pytest.mark.parametrize("name", ["a.png", "a.bmp"])
def test_lossless_8_bit(tmp_path: Path, name: str) -> None:
    image = noise(1)
    np.testing.assert_array_equal(read_micrograph(write_image(tmp_path / name, image)).image, image)


def test_png_keeps_16_bits(tmp_path: Path) -> None:
    image = noise(2, dtype="uint16")
    np.testing.assert_array_equal(read_micrograph(write_image(tmp_path / "a.png", image)).image, image)


def test_content_counts_not_the_name(tmp_path: Path) -> None:
    image = noise(1)
    path = write_image(tmp_path / "a.png", image).rename(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_micrograph(path).image, image)


def test_white_is_zero_is_turned(tmp_path: Path) -> None:
    image = noise(3)
    path = write_tiff(tmp_path / "a.tif", image, photometric="miniswhite")
    np.testing.assert_array_equal(read_micrograph(path).image, 255 - image.astype(np.float32))


@pytest.mark.parametrize("inverted", [False, True])
def test_palette(tmp_path: Path, inverted: bool) -> None:
    image = noise(4)
    ramp = np.arange(256, dtype=np.uint16)[:: -1 if inverted else 1] * 257
    path = write_tiff(tmp_path / "a.tif", image, photometric="palette", colormap=np.stack([ramp] * 3))
    np.testing.assert_array_equal(read_micrograph(path).image, 255.0 - image if inverted else image)


def test_rgb_that_is_grey_inside(tmp_path: Path) -> None:
    image = noise(5)
    rgb = np.stack([image] * 3, axis=-1)
    for path in (
        write_image(tmp_path / "a.png", rgb),
        write_tiff(tmp_path / "a.tif", rgb, photometric="rgb"),
        write_tiff(tmp_path / "b.tif", np.stack([image] * 3), photometric="rgb", planarconfig="separate"),
    ):
        np.testing.assert_array_equal(read_micrograph(path).image, image)


def test_transparent_pixels_are_masked(tmp_path: Path) -> None:
    image = noise(6)
    rgba = np.stack([image, image, image, np.full_like(image, 255)], axis=-1)
    rgba[:, :10, 3] = 0
    mask = read_micrograph(write_image(tmp_path / "a.png", rgba)).mask
    assert not mask[:, :10].any()
    assert mask[:, 10:].all()


def test_jpeg_chroma_is_tolerated(tmp_path: Path) -> None:
    smooth = np.add.outer(np.arange(96.0), np.arange(128.0)).astype(np.uint8)
    rgb = np.stack([smooth, smooth, smooth + (np.indices(smooth.shape).sum(axis=0) % 3).astype(np.uint8)], axis=-1)
    path = write_image(tmp_path / "a.jpg", rgb, quality=95)
    assert np.abs(read_micrograph(path).image - smooth).max() < 12


def test_coloured_image_is_refused(tmp_path: Path) -> None:
    rgb = np.stack([noise(1), noise(2), noise(3)], axis=-1)
    with pytest.raises(BadInputError, match=r"tinted\.png.*colour"):
        read_micrograph(write_image(tmp_path / "tinted.png", rgb))


def test_coloured_marks_are_noted(tmp_path: Path) -> None:
    rgb = np.stack([noise(1)] * 3, axis=-1)
    rgb[50, 20:60] = (0, 255, 0)
    _, warnings = read_micrograph_and_warnings(write_image(tmp_path / "a.png", rgb))
    assert len(warnings) == 1
    assert "coloured" in warnings[0]


def test_first_page_of_several(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pages = np.stack([noise(1), noise(2)])
    path = write_tiff(tmp_path / "stack.tif", pages, photometric="minisblack")
    micrograph, warnings = read_micrograph_and_warnings(path)
    np.testing.assert_array_equal(micrograph.image, pages[0])
    assert warnings == ("stack.tif: the TIFF holds 2 pages; the first one is used",)
    with caplog.at_level(logging.WARNING):
        read_micrograph(path)
    assert "2 pages" in caplog.text


def test_exif_block_of_a_jpeg(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[ZEISS_TAG] = zeiss_text(AP_IMAGE_PIXEL_SIZE="Image Pixel Size = 74.43 nm", AP_WD="WD =  9.0 mm")
    exif[305] = "GIMP 2.10.8"
    metadata = read_micrograph(write_image(tmp_path / "a.jpg", noise(1), exif=exif)).metadata
    assert metadata.pixel_size_um == pytest.approx(0.07443)
    assert metadata.working_distance_um == pytest.approx(9000)
    assert metadata.raw["file.software"] == "GIMP 2.10.8"


def _truncated(path: Path, share: float = 0.6) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    return path


def _bad_file(folder: Path, kind: str) -> Path:
    image = noise(1)
    if kind == "text":
        (folder / "bad.tif").write_text("pixel size 50 nm\n")
        return folder / "bad.tif"
    if kind == "empty":
        (folder / "bad.tif").write_bytes(b"")
        return folder / "bad.tif"
    if kind == "header only":
        (folder / "bad.tif").write_bytes(b"II*\0\x08\0\0\0")
        return folder / "bad.tif"
    if kind == "garbage after the magic number":
        (folder / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(200)))
        return folder / "bad.png"
    if kind == "missing":
        return folder / "bad.tif"
    if kind == "folder":
        (folder / "bad.tif").mkdir()
        return folder / "bad.tif"
    if kind == "bilevel":
        return write_image(folder / "bad.png", image > 128)
    if kind == "32 bit":
        return write_tiff(folder / "bad.tif", image.astype(np.uint32))
    if kind == "NaN":
        return write_tiff(folder / "bad.tif", np.full((40, 40), np.nan, dtype=np.float32))
    if kind == "lzw":
        return _truncated(write_tiff(folder / "bad.tif", image, compression="lzw", predictor=True))
    if kind == "tiff":
        return _truncated(write_tiff(folder / "bad.tif", image))
    return _truncated(write_image(folder / f"bad.{kind}", image))


@pytest.mark.parametrize(
    "kind",
    [
        "text",
        "empty",
        "header only",
        "garbage after the magic number",
        "missing",
        "folder",
        "bilevel",
        "32 bit",
        "NaN",
        "lzw",
        "tiff",
        "png",
        "jpg",
        "bmp",
    ],
)
def test_bad_file_is_named(tmp_path: Path, kind: str) -> None:
    with pytest.raises(BadInputError, match=r"bad\.(tif|png|jpg|bmp): "):
        read_micrograph(_bad_file(tmp_path, kind))


@pytest.mark.parametrize("suffix", ["tif", "png", "jpg", "bmp"])
def test_damaged_bytes_never_raise_anything_else(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    if suffix == "tif":
        write_tiff(path, noise(1), zeiss=zeiss_text(AP_WD="WD = 5 mm"), compression="lzw")
    else:
        write_image(path, noise(1))
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    for trial in range(60):
        data = bytearray(whole)
        end = len(data) if trial % 2 else 400
        for position in rng.integers(4, end, size=5):
            data[position] = int(rng.integers(256))
        if trial % 3 == 0:
            data = data[: int(rng.integers(1, len(data)))]
        path.write_bytes(bytes(data))
        with contextlib.suppress(BadInputError):
            assert np.isfinite(read_micrograph(path).image).all()


def test_absurd_size_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    tiff = write_tiff(tmp_path / "huge.tif", noise(1))
    with tifffile.TiffFile(tiff, mode="r+") as file:
        file.pages[0].tags["ImageWidth"].overwrite(60_000)
        file.pages[0].tags["ImageLength"].overwrite(60_000)
    png = write_image(tmp_path / "huge.png", noise(1))
    data = bytearray(png.read_bytes())
    data[16:24] = struct.pack(">II", 60_000, 60_000)
    png.write_bytes(bytes(data))
    for path in (tiff, png):
        with pytest.raises(BadInputError, match="60000 x 60000"):
            read_micrograph(path)
