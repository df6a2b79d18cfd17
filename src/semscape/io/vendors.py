"""Put together what an image file, the text beside it and its plain tags say of the acquisition.

Order: the microscope's tags in the file, its sidecar, ImageJ and OME, bare resolution last. What an earlier one
says is not changed by a later one; fields that it leaves open are filled in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields as dataclass_fields
from dataclasses import replace
from pathlib import Path

from semscape.io import hitachi, jeol, phenom, tescan, thermo_fisher, thermo_fisher_xml, zeiss
from semscape.io.plain_tags import PlainTags, parse_plain_tags
from semscape.io.vendor_text import MAX_TEXT_BYTES, decode_text, is_broken
from semscape.types import SemMetadata

# In the order in which they are believed.
VENDOR_TAGS = (zeiss.TAG, *thermo_fisher.TAGS, thermo_fisher_xml.TAG, tescan.TAG)

_Parsed = tuple[SemMetadata, tuple[str, ...]]
_COMPLETED = [
    spec.name
    for spec in dataclass_fields(SemMetadata)
    if spec.name not in {"vendor", "model", "source", "origin", "raw"}
]


def read_vendor_metadata(
    path: Path, vendor_tags: dict[int, bytes], plain: PlainTags, image_shape: tuple[int, int]
) -> _Parsed:
    """Return all that is known of an image's acquisition, and a warning for each value that cannot be read.

    Parameters
    ----------
    path : Path
        The image, beside which sidecars are looked for.
    vendor_tags : dict of int to bytes
        Content of the vendors' tags as stored.
    plain : PlainTags
        What the file says without any vendor.
    image_shape : (int, int)
        Height and width of the stored image in px.
    """
    metadata, warnings = SemMetadata(), list[str]()
    for found, notes in _sources(path, vendor_tags, plain, image_shape):
        if not (found.source.get("pixel_size_um") == "doubtful" and "pixel_size_um" in metadata.source):
            warnings += notes  # no matter how doubtful, if it is not taken
        if found.raw or found.source:
            metadata = _completed(metadata, found)
    return metadata, tuple(dict.fromkeys(warnings))


def _sources(path: Path, tags: dict[int, bytes], plain: PlainTags, shape: tuple[int, int]) -> Iterator[_Parsed]:
    for tag in VENDOR_TAGS:
        if tag in tags:
            found, notes = _parse_tag(tag, tags[tag], shape)
            unread = () if found.raw else (f"tag {tag} holds nothing that can be read; nothing is taken from it",)
            yield found, (*notes, *unread)
    for sidecar in _sidecars(path):
        yield _parse_sidecar(sidecar, shape)
    yield parse_plain_tags(plain)


def _parse_tag(tag: int, data: bytes, shape: tuple[int, int]) -> _Parsed:
    if tag == tescan.TAG:
        return tescan.parse_tescan(tescan.tescan_tag_text(data), shape)
    text = decode_text(data)
    if phenom.is_phenom(text):
        return phenom.parse_phenom(text, shape[0], f"tag {tag}")
    if tag == zeiss.TAG:
        return zeiss.parse_zeiss(text, shape[1])
    if tag == thermo_fisher_xml.TAG or text.lstrip().startswith("<"):
        return thermo_fisher_xml.parse_thermo_fisher_xml(text, shape)
    return thermo_fisher.parse_thermo_fisher(text, shape, tag)


def _sidecars(path: Path) -> list[Path]:
    """Return the texts beside an image, whatever the case of their names."""
    stem, suffix = path.stem.lower(), path.suffix.lower()
    wanted = [f"{stem}.txt", f"{stem}{suffix}.txt", f"{stem}-{suffix[1:]}.hdr", f"{stem}.hdr", f"{stem}{suffix}.hdr"]
    try:
        found = {entry.name.lower(): entry for entry in path.parent.iterdir() if entry.name.lower() in wanted}
    except OSError:
        return []
    return [found[name] for name in wanted if name in found and found[name].is_file()]


def _parse_sidecar(path: Path, shape: tuple[int, int]) -> _Parsed:
    try:
        with path.open("rb") as file:
            text = decode_text(file.read(MAX_TEXT_BYTES))
    except OSError as error:
        return SemMetadata(), (f"{path.name} cannot be read ({error.strerror or error}); nothing is taken from it",)
    broken = is_broken(text)
    damage = f"the {path.suffix} file beside the image is damaged: what cannot be read there is unknown"
    if hitachi.is_hitachi(text):
        found, notes = hitachi.parse_hitachi(text, shape, path.name)
    elif jeol.is_jeol(text):
        found, notes = jeol.parse_jeol(text, shape, path.name)
    elif path.suffix.lower() == ".hdr" and "PixelSizeX" in text:
        found, notes = tescan.parse_tescan(text, shape, path.name)
    else:
        why = "its text is not whole" if broken else "neither JEOL's nor Hitachi's nor TESCAN's"
        return SemMetadata(), (f"nothing is taken from the {path.suffix} file beside the image: {why}",)
    return found, (*([damage] if broken else []), *notes)


def _completed(first: SemMetadata, second: SemMetadata) -> SemMetadata:
    """Return the first metadata with what only the second knows put in."""
    new = [name for name in second.source if name in _COMPLETED and name not in first.source]
    return replace(
        first,
        **{name: getattr(second, name) for name in new},
        vendor=second.vendor if first.vendor == "unknown" else first.vendor,
        model=first.model or second.model,
        source={**first.source, **{name: second.source[name] for name in new}},
        origin={**first.origin, **{name: second.origin[name] for name in new}},
        raw={**second.raw, **first.raw},
    )
