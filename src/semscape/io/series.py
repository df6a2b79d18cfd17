"""Load a folder of micrographs as a tilt series."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from semscape.errors import BadInputError, StorageError
from semscape.io.acquisition import GivenAcquisition, read_given_acquisition
from semscape.io.bar_scale import scale_by_bar
from semscape.io.burnt_in import find_burnt_in_text
from semscape.io.header_credibility import settle_metadata
from semscape.io.image_file import IMAGE_SUFFIXES
from semscape.io.metadata_fields import is_moot
from semscape.io.micrograph import read_micrograph_and_warnings
from semscape.io.scan_settings import undo_scan_settings
from semscape.options import InputOptions
from semscape.types import Micrograph, TiltSeries

_DEFAULT_OPTIONS = InputOptions()
_SIDE_SUFFIXES = {".txt", ".hdr", ".json", ".toml", ".npz", ".ply", ".csv", ".md"}
_SIDE_NAMES = {"truth", "thumbs.db", "desktop.ini"}
_MOST_NAMED = 5


def load_series(folder: str | Path, options: InputOptions = _DEFAULT_OPTIONS) -> TiltSeries:
    """Load every image of a folder as one tilt series.

    Files are sorted naturally (img2 before img10); hidden files and files that are no images by name are
    ignored, the latter with a warning unless they are of a kind that lies beside images. Tilts, pixel size and
    tilt axis come from `options`, else from `series.toml` in the folder, else from the files' headers; each view's
    `metadata.source` says which. Given tilts belong to the naturally sorted files. The views are then ordered by
    tilt where every tilt is known.

    Parameters
    ----------
    folder : str or Path
        Folder with at least two images of one size.
    options : InputOptions
        What the user says about the images.

    Returns
    -------
    TiltSeries
        With a warning for everything that is doubtful.

    Raises
    ------
    BadInputError
        For a folder or file that cannot be read, fewer than two images, images of different sizes, an image
        without contrast, the same image twice, or values out of range.
    """
    folder = Path(folder)
    paths, ignored_warnings = _image_paths(folder)
    names = [path.name for path in paths]
    given = read_given_acquisition(folder, options, names)
    views: list[Micrograph] = []
    notes: list[str] = []
    for path in paths:
        view, view_notes = read_micrograph_and_warnings(path, given.fields.get(path.name, {}).get("data_bar_rows"))
        views.append(view)
        notes += view_notes
    _require_one_size(folder, views)
    for view in views:
        _require_contrast(folder, view)
    _require_distinct(folder, views)
    views, bar_warnings = _align_data_bars(views, given)
    views, text_warnings = _mask_burnt_in_text(views)
    metadata, metadata_warnings = settle_metadata(names, [view.metadata for view in views], given)
    views = [replace(view, metadata=settled) for view, settled in zip(views, metadata, strict=True)]
    views, scale_warnings = scale_by_bar(folder, views, given)
    source = {view.name: view.metadata.source for view in views}
    notes = [note for note in notes if not is_moot(note, source[note.partition(": ")[0]])]
    views, scan_warnings = undo_scan_settings(views)
    tilts = np.array([view.metadata.tilt_rad for view in views])
    if np.isfinite(tilts).all():
        views = [views[i] for i in np.argsort(tilts, kind="stable")]
    warnings = (
        *ignored_warnings,
        *_merge_notes(notes),
        *bar_warnings,
        *text_warnings,
        *metadata_warnings,
        *scale_warnings,
        *scan_warnings,
    )
    return TiltSeries(views=tuple(views), warnings=warnings)


def load_image(path: str | Path, options: InputOptions = _DEFAULT_OPTIONS) -> TiltSeries:
    """Load one image as `load_series` loads each of a folder: a series of one view, to be inspected alone.

    A `series.toml` beside it is not read, for it speaks of a whole folder. Of `options` the scale bar's length and
    the pixel size count.

    Raises
    ------
    BadInputError
        For a file that cannot be read, or an image without a scale bar where its length is given.
    """
    path = Path(path)
    view, notes = read_micrograph_and_warnings(path)
    given = GivenAcquisition(pixel_size_um=options.pixel_size_um, scale_bar_um=options.scale_bar_um)
    metadata, metadata_warnings = settle_metadata([path.name], [view.metadata], given)
    views, scale_warnings = scale_by_bar(path.parent, [replace(view, metadata=metadata[0])], given)
    notes = tuple(note for note in notes if not is_moot(note, views[0].metadata.source))
    views, scan_warnings = undo_scan_settings(views)
    return TiltSeries(tuple(views), (*_merge_notes(notes), *metadata_warnings, *scale_warnings, *scan_warnings))


def natural_key(name: str) -> tuple[tuple[tuple[int, int, str], ...], str]:
    """Return a sort key under which img2 comes before img10.

    Examples
    --------
    >>> sorted(["img10.tif", "img2.tif", "Img1.tif"], key=natural_key)
    ['Img1.tif', 'img2.tif', 'img10.tif']
    """
    parts = re.findall(r"([0-9]+)|([^0-9]+)", name)
    key = tuple((0, int(digits), "") if digits else (1, 0, text.casefold()) for digits, text in parts)
    return key, name


def _image_paths(folder: Path) -> tuple[list[Path], list[str]]:
    """Return the images of a folder, and a warning about other files that nobody would expect beside them."""
    if not folder.exists():
        raise BadInputError(f"{folder}: there is no such folder; give the folder that holds the images")
    if not folder.is_dir():
        raise BadInputError(f"{folder}: this is a file; give the folder that holds the images of the series")
    try:
        entries = [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    except OSError as error:
        raise StorageError(f"{folder}: cannot be read ({error.strerror or error})") from error
    paths = sorted(
        (path for path in entries if path.suffix.lower() in IMAGE_SUFFIXES), key=lambda path: natural_key(path.name)
    )
    kinds = ", ".join(IMAGE_SUFFIXES)
    if not paths:
        raise BadInputError(
            f"{folder}: no images in this folder ({len(entries)} other files); a tilt series needs two or more of "
            f"{kinds}, directly in the folder"
        )
    if len(paths) == 1:
        raise BadInputError(
            f"{folder}: only one image ({paths[0].name}); height needs at least two images of the specimen at "
            f"different tilts ({kinds})"
        )
    return paths, _ignored_warnings([path for path in entries if path not in paths])


def _ignored_warnings(others: Sequence[Path]) -> list[str]:
    names = sorted(
        (
            path.name
            for path in others
            if path.suffix.lower() not in _SIDE_SUFFIXES and not {path.name.lower(), path.stem.lower()} & _SIDE_NAMES
        ),
        key=natural_key,
    )
    if not names:
        return []
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return [f"ignored: {', '.join(names[:_MOST_NAMED])}{more} (read are {', '.join(IMAGE_SUFFIXES)})"]


def _require_one_size(folder: Path, views: Sequence[Micrograph]) -> None:
    counts = Counter(view.image.shape for view in views)
    if len(counts) == 1:
        return
    usual, n_usual = counts.most_common(1)[0]
    like = next(view.name for view in views if view.image.shape == usual)
    others = [view for view in views if view.image.shape != usual]
    listed = ", ".join(f"{view.name} is {view.image.shape[1]} x {view.image.shape[0]}" for view in others)
    raise BadInputError(
        f"{folder}: images of different sizes: {listed}, but {n_usual} like {like} "
        f"{'is' if n_usual == 1 else 'are'} {usual[1]} x {usual[0]} pixels; a series needs one size: remove or "
        "export again those that differ"
    )


def _require_contrast(folder: Path, view: Micrograph) -> None:
    values = view.image[view.mask]
    if values.size and float(values.min()) < float(values.max()):
        return
    held = f"holds one single value ({values[0]:g})" if values.size else "is transparent or data bar throughout"
    raise BadInputError(f"{folder / view.name}: the image {held}; nothing can be matched in it: remove it")


def _require_distinct(folder: Path, views: Sequence[Micrograph]) -> None:
    seen: dict[str, str] = {}
    for view in views:
        pixels = hashlib.sha256(np.ascontiguousarray(view.image).tobytes()).hexdigest()
        if pixels in seen:
            raise BadInputError(
                f"{folder}: {seen[pixels]} and {view.name} hold the very same image; a series needs a different tilt "
                "in each: remove one of the two"
            )
        seen[pixels] = view.name


def _mask_burnt_in_text(views: list[Micrograph]) -> tuple[list[Micrograph], list[str]]:
    text = find_burnt_in_text([view.image for view in views], [view.mask for view in views])
    if not text.any():
        return views, []
    warning = f"text that is burnt into the images is masked ({100 * float(text.mean()):.2g} % of the image)"
    return [replace(view, mask=view.mask & ~text) for view in views], [warning]


def _align_data_bars(views: list[Micrograph], given: GivenAcquisition) -> tuple[list[Micrograph], list[str]]:
    """Give the bar that at least half of the views show to all: one microscope draws one bar."""
    if any("data_bar_rows" in fields for fields in given.fields.values()):
        return views, []
    bars = Counter(tuple(np.flatnonzero(~view.mask.any(axis=1)).tolist()) for view in views)
    rows, count = max(bars.items(), key=lambda item: (item[1], len(item[0])))
    if len(bars) == 1 or not rows or 2 * count < len(views):
        return views, []
    aligned, changed = [], []
    for view in views:
        mask = view.mask.copy()
        mask[list(rows)] = False
        if not np.array_equal(mask, view.mask):
            changed.append(view.name)
        aligned.append(replace(view, mask=mask))
    if not changed:
        return views, []
    names = ", ".join(changed)
    return aligned, [
        f"{names}: the data bar of the other images ({len(rows)} rows) was not found here; it is masked as well"
    ]


def _merge_notes(notes: Sequence[str]) -> list[str]:
    """Say once what holds for several files: notes of the form "name: text"."""
    names_of: dict[str, list[str]] = {}
    for note in notes:
        name, _, text = note.partition(": ")
        names_of.setdefault(text, []).append(name)
    return [f"{', '.join(names)}: {text}" for text, names in names_of.items()]
