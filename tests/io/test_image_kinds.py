"""The kinds of image files that microscopes and editors write, beside the plain ones."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from sem_files import noise, write_image, write_tiff

from semscape.errors import BadInputError
from semscape.io.micrograph import read_micrograph, read_micrograph_and_warnings


def write_packed_12_bit(path: Path, image: np.ndarray, byteorder: str) -> Path:
    """Write a TIFF by hand whose rows hold two samples in three bytes."""
    high, low = image[:, 0::2].astype(np.uint32), image[:, 1::2].astype(np.uint32)
    packed = (high << 12) | low
    data = np.stack([packed >> 16, packed >> 8, packed], axis=-1).astype(np.uint8).tobytes()
    height, width = image.shape
    entries = [
        (256, 3, width), (257, 3, height), (258, 3, 12), (259, 3, 1), (262, 3, 1), (273, 4, 8),
        (277, 3, 1), (278, 3, height), (279, 4, len(data)),
    ]  # fmt: skip
    directory = struct.pack(byteorder + "H", len(entries))
    for code, kind, value in entries:
        field = struct.pack(byteorder + "HH", value, 0) if kind == 3 else struct.pack(byteorder + "I", value)
        directory += struct.pack(byteorder + "HHI", code, kind, 1) + field
    magic = b"II*\0" if byteorder == "<" else b"MM\0*"
    path.write_bytes(magic + struct.pack(byteorder + "I", 8 + len(data)) + data + directory + bytes(4))
    return path


@pytest.mark.parametrize("byteorder", ["<", ">"])
def test_12_bit(tmp_path: Path, byteorder: str) -> None:
    image = np.random.default_rng(0).integers(0, 4096, (40, 64)).astype(np.uint16)
    micrograph = read_micrograph(write_packed_12_bit(tmp_path / "a.tif", image, byteorder))
    np.testing.assert_array_equal(micrograph.image, image)
    assert micrograph.metadata.raw["file.bits_per_sample"] == "12"


def test_16_bit_big_endian_tiles_with_lzw_and_predictor(tmp_path: Path) -> None:
    image = noise(0, (96, 128), "uint16")
    path = write_tiff(
        tmp_path / "a.tif", image, byteorder=">", tile=(32, 32), compression="lzw", predictor=True, bigtiff=True
    )
    np.testing.assert_array_equal(read_micrograph(path).image, image)


def test_rgb_stored_grey_in_lzw(tmp_path: Path) -> None:
    image = noise(1)
    rgb = np.stack([image] * 3, axis=-1)
    path = write_tiff(tmp_path / "a.tif", rgb, photometric="rgb", compression="lzw", predictor=True)
    np.testing.assert_array_equal(read_micrograph(path).image, image)


def test_png_palette_of_grey_tones(tmp_path: Path) -> None:
    image = noise(2) // 2
    picture = Image.fromarray(255 - image).convert("P")
    picture.putpalette([value for index in range(256) for value in [255 - index] * 3])
    picture.putdata((255 - np.asarray(Image.fromarray(255 - image))).ravel().tolist())
    picture.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_micrograph(tmp_path / "a.png").image, 255 - image)


def test_false_colours_of_a_palette_are_refused(tmp_path: Path) -> None:
    palette = np.zeros((3, 256), dtype=np.uint16)
    palette[0] = np.arange(256) * 257
    path = write_tiff(tmp_path / "a.tif", noise(3), photometric="palette", colormap=palette)
    with pytest.raises(BadInputError, match="colour"):
        read_micrograph(path)


# What each orientation does to an image that is to be seen as it is, TIFF 6.0: rows and columns as stored.
STORED = {
    1: lambda seen: seen,
    2: lambda seen: seen[:, ::-1],
    3: lambda seen: seen[::-1, ::-1],
    4: lambda seen: seen[::-1],
    5: lambda seen: seen.T,
    6: lambda seen: seen[:, :].T[::-1],
    7: lambda seen: seen[::-1, ::-1].T,
    8: lambda seen: seen.T[:, ::-1],
}


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["tif", "png", "jpg"])
def test_turned_by_exif_as_pillow_turns_it(tmp_path: Path, orientation: int, suffix: str) -> None:
    from PIL import ImageOps

    seen = np.repeat(np.repeat(noise(4, (6, 8)), 16, axis=0), 16, axis=1)
    stored = np.ascontiguousarray(STORED[orientation](seen))
    path = tmp_path / f"a.{suffix}"
    if suffix == "tif":
        tifffile.imwrite(path, stored, extratags=[(274, "H", 1, orientation, True)], metadata=None)
    else:
        exif = Image.Exif()
        exif[274] = orientation
        Image.fromarray(stored).save(path, exif=exif, **({"quality": 100} if suffix == "jpg" else {}))
    micrograph, warnings = read_micrograph_and_warnings(path)
    if suffix != "tif":
        with Image.open(path) as picture:
            np.testing.assert_array_equal(micrograph.image, np.asarray(ImageOps.exif_transpose(picture)))
    assert np.abs(micrograph.image - seen).max() <= 3
    assert len(warnings) == (orientation > 1)


def png_chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


@pytest.mark.parametrize("kind", ["tif", "bigtiff", "png", "bmp", "jpg", "rgb"])
def test_an_image_bomb_is_refused_before_memory_is_taken(tmp_path: Path, kind: str) -> None:
    import tracemalloc

    side = 65_000 if kind == "jpg" else 20_000 if kind == "rgb" else 100_000
    path = tmp_path / "bomb.bin"
    if kind in {"tif", "bigtiff", "rgb"}:
        image = noise(1) if kind != "rgb" else np.stack([noise(1)] * 3, axis=-1)
        write_tiff(path, image, bigtiff=kind == "bigtiff", **({"photometric": "rgb"} if kind == "rgb" else {}))
        with tifffile.TiffFile(path, mode="r+") as file:
            for tag in ("ImageWidth", "ImageLength"):
                file.pages[0].tags[tag].overwrite(side, dtype="I")
    elif kind == "png":
        header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
        pixels = zlib.compress(bytes(100_000))
        chunks = [(b"IHDR", header), (b"IDAT", pixels), (b"IEND", b"")]
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(name, content) for name, content in chunks))
    else:
        data = bytearray(write_image(tmp_path / f"a.{kind}", noise(1)).read_bytes())
        if kind == "bmp":
            data[18:26] = struct.pack("<ii", side, side)
        else:
            start = data.index(b"\xff\xc0")
            data[start + 5 : start + 9] = struct.pack(">HH", side, side)
        path.write_bytes(bytes(data))
    tracemalloc.start()
    with pytest.raises(BadInputError, match=f"{side} x {side}|exceeds limit"):
        read_micrograph(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6


@pytest.mark.real_data
@pytest.mark.parametrize("name", ["surface1", "vickers"])
def test_segments_of_a_bse_detector(shared_data: Path, name: str) -> None:
    paths = sorted((shared_data / "multi_detector" / name).glob("*.tif"))
    assert len(paths) == 3
    for path in paths:
        micrograph = read_micrograph(path)
        assert micrograph.metadata.data_bar_rows == 79
        assert micrograph.metadata.pixel_size_um > 0


def test_a_field_of_one_value_that_unpacks_to_81_megapixels_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.tif"
    tifffile.imwrite(path, np.zeros((9000, 9000), np.uint8), compression="zlib", metadata=None)
    with pytest.raises(BadInputError, match=r"bomb\.tif: its header claims 9000 x 9000 pixels, more than 300 for each"):
        read_micrograph(path)
