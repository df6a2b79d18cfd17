"""Read one micrograph: grey values as stored, the vendor's metadata and the data bar's mask."""

from __future__ import annotations

import hashlib
import logging
from dataclasses import replace
from pathlib import Path

from semscape.errors import BadInputError, StorageError
from semscape.io.data_bar import find_data_bar
from semscape.io.image_file import DecodedImage, decode_image
from semscape.io.metadata_fields import FILE_KEY_PREFIX
from semscape.io.vendors import read_vendor_metadata
from semscape.types import BoolArray, Micrograph, SemMetadata

logger = logging.getLogger(__name__)


def read_micrograph(path: str | Path) -> Micrograph:
    """Read a TIFF, PNG, JPEG or BMP file with whatever metadata it or a text beside it holds.

    Values stay as stored, in float32, without any rescaling; an RGB image that is grey inside is accepted
    (its brightness is used), an image stored as white-is-zero is turned. Of a multi-page TIFF the first page is
    taken. The mask is False on the data bar and where the image is transparent.

    Parameters
    ----------
    path : str or Path
        Image file.

    Returns
    -------
    Micrograph
        With `digest`, the SHA-256 of the file's bytes.

    Raises
    ------
    BadInputError
        For a file that is missing, damaged, no image, coloured, or of more than one gigapixel.
    """
    micrograph, warnings = read_micrograph_and_warnings(path)
    for warning in warnings:
        logger.warning("%s", warning)
    return micrograph


def read_micrograph_and_warnings(
    path: str | Path, given_bar_rows: float | None = None
) -> tuple[Micrograph, tuple[str, ...]]:
    """Read as `read_micrograph` does; return the warnings, which begin with the file's name, as well.

    A height of the data bar that is given goes before the header's and before what the pixels show; 0 is no bar.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise StorageError(f"{path}: cannot be read ({error.strerror or error})") from error
    decoded = decode_image(path, data)
    metadata, metadata_warnings = _read_metadata(path, decoded)
    micrograph = Micrograph(
        name=path.name,
        image=decoded.image,
        mask=_mask(path, decoded, metadata, given_bar_rows),
        metadata=metadata,
        digest=hashlib.sha256(data).hexdigest(),
    )
    return micrograph, tuple(f"{path.name}: {text}" for text in (*decoded.warnings, *metadata_warnings))


def _mask(path: Path, decoded: DecodedImage, metadata: SemMetadata, given_bar_rows: float | None) -> BoolArray:
    if given_bar_rows is None:
        return find_data_bar(decoded.image, metadata.data_bar_rows) & decoded.imaged
    height = decoded.image.shape[0]
    if given_bar_rows >= height:
        raise BadInputError(f"{path}: a data bar of {given_bar_rows:g} rows is given, the image has {height}")
    mask = decoded.imaged.copy()
    mask[height - int(given_bar_rows) :] = False
    return mask


def _read_metadata(path: Path, decoded: DecodedImage) -> tuple[SemMetadata, tuple[str, ...]]:
    height, width = decoded.image.shape
    metadata, warnings = read_vendor_metadata(path, decoded.vendor_tags, decoded.plain, (height, width))
    of_file = {
        FILE_KEY_PREFIX + "format": decoded.file_format,
        FILE_KEY_PREFIX + "bits_per_sample": str(decoded.bits),
    }
    if decoded.software:
        of_file[FILE_KEY_PREFIX + "software"] = decoded.software
    return replace(metadata, raw={**metadata.raw, **of_file}), warnings
