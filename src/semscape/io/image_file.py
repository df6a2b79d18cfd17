"""Decode image files (TIFF, PNG, JPEG, BMP) into grey values as stored, plus the vendors' texts they carry."""

from __future__ import annotations

import io
import logging
import math
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semscape.errors import BadInputError
from semscape.io.plain_tags import PlainTags
from semscape.io.vendors import VENDOR_TAGS
from semscape.types import BoolArray, ImageArray

IMAGE_SUFFIXES = (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp")
MAX_PIXELS = 1_000_000_000
# No micrograph is packed as tightly as this many times; nothing but a bomb, or a field of one value, is.
_MOST_TIMES_PACKED = 300
_LARGE_PIXELS = 4_000_000  # below, a bomb costs no more than a micrograph does

_SOFTWARE_TAG = 305
_ORIENTATION_TAG = 274
_UPRIGHT = 1
_UM_PER_RESOLUTION_UNIT = {2: 25_400.0, 3: 10_000.0}  # TIFF's inch and centimetre
_COLOR_TOLERANCE = 0.06  # of the brightest value: JPEG's chroma, not a tint
_MAX_COLORED_SHARE = 0.02  # of the pixels: coloured marks drawn over a grey image

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # its complaints come as errors of ours


@dataclass
class DecodedImage:
    """Grey values of an image file, `imaged` False where it is transparent, and what else the file told."""

    image: ImageArray
    imaged: BoolArray
    file_format: str
    bits: int
    software: str = ""
    vendor_tags: dict[int, bytes] = field(default_factory=dict)
    plain: PlainTags = field(default_factory=PlainTags)
    warnings: list[str] = field(default_factory=list)


def decode_image(path: Path, data: bytes) -> DecodedImage:
    """Decode the bytes of an image file.

    Parameters
    ----------
    path : Path
        Names the file in errors.
    data : bytes
        Content of the file.

    Raises
    ------
    BadInputError
        For anything but a complete grey TIFF, PNG, JPEG or BMP of at most one gigapixel.
    """
    if not data:
        raise BadInputError(f"{path}: the file is empty (0 bytes); copy it again or remove it from the folder")
    if data[:4] in {b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"}:
        return _decode_tiff(path, data)
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return _decode_raster(path, data, "PNG")
    if data[:3] == b"\xff\xd8\xff":
        return _decode_raster(path, data, "JPEG")
    if data[:2] == b"BM":
        return _decode_raster(path, data, "BMP")
    raise BadInputError(
        f"{path}: not an image that can be read: it is no TIFF, PNG, JPEG or BMP, whatever its name says "
        f"(it begins with {data[:12]!r}); export it again or remove it from the folder"
    )


@contextmanager
def _decoding(path: Path, file_format: str) -> Iterator[None]:
    """Turn whatever a decoder raises on damaged bytes into a BadInputError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (BadInputError, MemoryError):
        raise
    except Exception as error:  # decoders raise almost anything on damaged bytes
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise BadInputError(
            f"{path}: the {file_format} file is damaged, truncated or of an unsupported kind ({reason}); "
            "copy or export it again, or remove it from the folder"
        ) from error


def _require_credible_size(path: Path, width: int, height: int, n_channels: int = 1) -> None:
    n_values = width * height * n_channels
    if n_values > max(_LARGE_PIXELS, _MOST_TIMES_PACKED * path.stat().st_size):
        raise BadInputError(
            f"{path}: its header claims {width} x {height} pixels, more than {_MOST_TIMES_PACKED} for each byte of the "
            "file: no micrograph, so it is not unpacked; save it again without compression if it is one"
        )
    if width < 1 or height < 1 or n_values > MAX_PIXELS:
        raise BadInputError(
            f"{path}: its header claims {width} x {height} pixels; images between 1 pixel and "
            f"{MAX_PIXELS:,} pixels are read; the file is damaged, or must be cropped or binned first"
        )


def _decode_tiff(path: Path, data: bytes) -> DecodedImage:
    import tifffile

    with _decoding(path, "TIFF"), tifffile.TiffFile(io.BytesIO(data)) as tiff:
        page = tiff.pages.first
        _require_credible_size(path, int(page.imagewidth), int(page.imagelength), int(page.samplesperpixel))
        if page.imagedepth != 1:
            raise BadInputError(f"{path}: the TIFF holds a volume of {page.imagedepth} slices, not a micrograph")
        _require_complete_tiff(path, page, len(data))
        array = np.asarray(page.asarray(maxworkers=1))
        if page.axes == "SYX":
            array = np.moveaxis(array, 0, -1)
        elif page.axes not in {"YX", "YXS"}:
            raise BadInputError(f"{path}: the TIFF's first page has axes {page.axes}, not those of a grey image")
        photometric = getattr(page.photometric, "name", "")
        if photometric == "PALETTE":
            array = _apply_palette(array, np.asarray(page.colormap))
        elif photometric == "MINISWHITE" and array.dtype.kind == "u":
            array = np.asarray(((1 << int(page.bitspersample)) - 1) - array.astype(np.int64), dtype=array.dtype)
        notes = []
        if len(tiff.pages) > 1:
            notes.append(f"the TIFF holds {len(tiff.pages)} pages; the first one is used")
        tags = {}
        for code in VENDOR_TAGS:
            tag = page.tags.get(code)
            if tag is not None:
                # The bytes as stored: tifffile's own parse of these tags drops what it does not know.
                tags[code] = data[tag.valueoffset : tag.valueoffset + tag.valuebytecount]
        array = _upright(array, _tag_number(page, _ORIENTATION_TAG, _UPRIGHT), notes)
        decoded = _to_decoded(path, array, int(np.max(page.bitspersample)), "TIFF", notes)
        software = page.tags.get(_SOFTWARE_TAG)
        decoded.software = str(software.value).strip("\0 ") if software is not None else ""
        decoded.vendor_tags = tags
        decoded.plain = PlainTags(
            description=str(page.description),
            px_per_unit_x=_ratio(page, "XResolution"),
            px_per_unit_y=_ratio(page, "YResolution"),
            resolution_unit_um=_UM_PER_RESOLUTION_UNIT.get(_tag_number(page, "ResolutionUnit", 1), math.nan),
        )
        return decoded


def _tag_number(page: Any, tag: int | str, default: int) -> int:
    found = page.tags.get(tag)
    try:
        return default if found is None else int(found.value)
    except (TypeError, ValueError):
        return default


def _ratio(page: Any, tag: str) -> float:
    found = page.tags.get(tag)
    try:
        numerator, denominator = found.value
        return float(numerator) / float(denominator)
    except (AttributeError, TypeError, ValueError, ZeroDivisionError):
        return 0.0


def _upright(array: NDArray[Any], orientation: int, notes: list[str]) -> NDArray[Any]:
    """Return the image as its orientation tag (TIFF 6.0, EXIF) says that it is to be seen."""
    if not _UPRIGHT < orientation <= 8:
        return array
    if orientation > 4:
        array = np.swapaxes(array, 0, 1)  # rows and columns change places
    flip_rows = orientation in {3, 4, 7, 8}
    flip_columns = orientation in {2, 3, 6, 7}
    notes.append(
        f"its orientation tag ({orientation}) says that it is stored turned or mirrored; it is used as it is to be "
        "seen, and where the tag was set after the scan, the tilt axis has turned with the image"
    )
    return array[:: -1 if flip_rows else 1, :: -1 if flip_columns else 1]


def _require_complete_tiff(path: Path, page: Any, n_bytes: int) -> None:
    """Refuse a page whose strips or tiles do not lie wholly in the file: decoders fill them with zeros."""
    offsets, counts = page.dataoffsets, page.databytecounts
    end = max((offset + count for offset, count in zip(offsets, counts, strict=True)), default=0)
    missing = not counts or min(counts) == 0
    needed = int(page.imagewidth) * int(page.imagelength) * int(np.sum(page.bitspersample)) // 8
    short = int(page.compression) == 1 and page.samplesperpixel == 1 and sum(counts) < needed
    if end > n_bytes or missing or short:
        have = f"the file has {n_bytes:,} bytes, its image data {sum(counts):,} and would end at byte {end:,}"
        raise BadInputError(
            f"{path}: the TIFF file is truncated or damaged ({have}); copy or export it again, or remove it"
        )


def _decode_raster(path: Path, data: bytes, file_format: str) -> DecodedImage:
    from PIL import Image

    with _decoding(path, file_format):
        bits = 8
        if file_format == "PNG":
            width, height, bits = struct.unpack(">IIB", data[16:25])
            _require_credible_size(path, width, height)
        with Image.open(io.BytesIO(data), formats=[file_format]) as picture:
            _require_credible_size(path, *picture.size)
            exif = _read_exif(picture)
            notes = exif.warnings
            if bits == 16:
                import imagecodecs

                array = np.asarray(imagecodecs.png_decode(data))  # Pillow cuts 16-bit colour down to 8 bits
            else:
                if picture.mode == "1":
                    raise BadInputError(f"{path}: a black and white image of 1 bit; 8 or 16 bits of grey are needed")
                picture.load()
                if picture.mode in {"P", "PA"}:
                    array = np.asarray(picture.convert("RGBA" if "transparency" in picture.info else "RGB"))
                elif picture.mode in {"L", "LA", "RGB", "RGBA"}:
                    array = np.asarray(picture)
                else:
                    array = np.asarray(picture.convert("RGB"))
        decoded = _to_decoded(path, _upright(array, exif.orientation, notes), bits, file_format, notes)
        decoded.software, decoded.vendor_tags, decoded.plain = exif.software, exif.vendor_tags, exif.plain
        return decoded


@dataclass
class _Exif:
    """What an EXIF block holds, which editors copy into JPEGs, and the resolution that any picture may state."""

    vendor_tags: dict[int, bytes] = field(default_factory=dict)
    software: str = ""
    orientation: int = _UPRIGHT
    plain: PlainTags = field(default_factory=PlainTags)
    warnings: list[str] = field(default_factory=list)


def _read_exif(picture: Any) -> _Exif:
    found = _Exif()
    try:
        exif = picture.getexif()
        found.vendor_tags = {code: _stored_bytes(exif[code]) for code in VENDOR_TAGS if code in exif}
        found.software = str(exif.get(_SOFTWARE_TAG, "")).strip("\0 ")
        orientation = exif.get(_ORIENTATION_TAG, _UPRIGHT)
        found.orientation = orientation if isinstance(orientation, int) else _UPRIGHT
        per_inch = [float(value) for value in picture.info.get("dpi", (0.0, 0.0))]
        if len(per_inch) == 2 and all(math.isfinite(value) for value in per_inch):
            found.plain = PlainTags("", per_inch[0], per_inch[1], _UM_PER_RESOLUTION_UNIT[2], "EXIF or resolution tags")
    except MemoryError:
        raise
    except Exception:  # noqa: BLE001 - a damaged EXIF block must not cost the image
        found.warnings.append("its EXIF block cannot be read; nothing is taken from it")
    return found


def _stored_bytes(value: Any) -> bytes:
    return value.encode("utf-8", errors="replace") if isinstance(value, str) else bytes(value)


def _apply_palette(index: NDArray[Any], palette: NDArray[Any]) -> NDArray[Any]:
    """Return the grey index itself where the palette is the plain grey ramp, else the 8-bit colours it means."""
    colors = (palette >> 8).astype(np.uint8) if palette.max() > 255 else palette.astype(np.uint8)
    ramp = np.arange(colors.shape[1])
    if len(ramp) == 256 and bool((colors == ramp).all()):
        return index
    return np.moveaxis(colors[:, index], 0, -1)


def _to_decoded(
    path: Path,
    array: NDArray[Any],
    bits: int,
    file_format: str,
    notes: list[str],
) -> DecodedImage:
    if not (array.dtype in (np.uint8, np.uint16, np.int16) or array.dtype.kind == "f"):
        raise BadInputError(f"{path}: pixels of type {array.dtype} are not read; export 8 or 16-bit grey values")
    grey, alpha = _split_channels(path, array, notes)
    image = np.ascontiguousarray(grey, dtype=np.float32)
    if not np.isfinite(image).all():
        raise BadInputError(f"{path}: the image holds NaN or infinite values; export 8 or 16-bit grey values")
    imaged = np.ones(image.shape, dtype=np.bool_) if alpha is None else np.asarray(alpha > 0, dtype=np.bool_)
    return DecodedImage(image, imaged, file_format, bits, warnings=notes)


def _split_channels(path: Path, array: NDArray[Any], notes: list[str]) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return grey values and the alpha channel or None; refuse an image with more than traces of colour."""
    if array.ndim == 2:
        return array, None
    n_channels = array.shape[-1]
    if n_channels in (1, 2):
        return array[..., 0], array[..., 1] if n_channels == 2 else None
    if n_channels not in (3, 4):
        raise BadInputError(f"{path}: the image has {n_channels} channels; export grey values")
    alpha = array[..., 3] if n_channels == 4 else None
    rgb = array[..., :3]
    spread = rgb.max(axis=-1).astype(np.float32) - rgb.min(axis=-1)
    if not spread.any():
        return rgb[..., 0], alpha
    share = float(np.mean(spread > _COLOR_TOLERANCE * float(rgb.max())))
    if share > _MAX_COLORED_SHARE:
        raise BadInputError(
            f"{path}: a colour image ({100 * share:.0f} % of its pixels are coloured); SEM micrographs are grey: "
            "export the grey image, without false colours"
        )
    if share > 0:
        notes.append(f"{100 * share:.2g} % of its pixels are coloured (marks drawn over it?); their brightness is used")
    # Rec. 601 luma, rounded: the very values that a JPEG stores.
    return np.rint(rgb.astype(np.float32) @ np.array([0.299, 0.587, 0.114], dtype=np.float32)), alpha
