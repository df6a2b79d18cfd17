"""Names for files and folders, made from what a browser says they are called.

What a browser says is never joined to a path. A new name is made from its letters and digits, so that a person
recognizes it, and from nothing that any system gives a meaning to.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Mapping
from pathlib import PurePosixPath

from semscape.errors import BadInputError
from semscape.io.image_file import IMAGE_SUFFIXES

SIDECAR_SUFFIXES = (".txt", ".hdr")
_MOST_CHARACTERS = 60
_MOST_TITLE = 120
_NO_END = "-_.+"
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)([.-].*)?")


def stored_name(original: str, stored: Mapping[str, str]) -> str:
    """Return the name under which a file of a series is kept.

    A file of the same original name is replaced; one with the same stem (a microscope's text beside its image) gets the
    same stem; no other shares it.

    Parameters
    ----------
    original : str
        The name as the browser gives it; folders before it are dropped.
    stored : mapping
        Original name of every file that is there already, by its stored name.

    Raises
    ------
    BadInputError
        For a file that is neither an image nor a microscope's text beside one.

    Examples
    --------
    >>> stored_name("../Pollen (3).TIF", {})
    'Pollen-3.tif'
    >>> stored_name("view+3.5deg.tif", {})
    'view+3.5deg.tif'
    >>> stored_name("pollen 3.tif", {"pollen-3.tif": "pollen#3.tif"})
    'pollen-3-2.tif'
    """
    name = displayed_name(original)
    stem, suffix = _split(name)
    if suffix not in (*IMAGE_SUFFIXES, *SIDECAR_SUFFIXES):
        kinds = ", ".join((*IMAGE_SUFFIXES, *SIDECAR_SUFFIXES))
        raise BadInputError(f"{name}: neither an image nor a microscope's text beside one ({kinds}); leave it out")
    stems = {_split(theirs)[0]: _split(kept)[0] for kept, theirs in stored.items()}
    if stem in stems:
        return stems[stem] + suffix
    return _unused(_plain(stem, "image"), stems.values()) + suffix


def run_name(title: str, taken: Collection[str]) -> str:
    """Return a folder's name for a run that a person gave a title.

    Examples
    --------
    >>> run_name("Pollen, 5 kV", ["images"]), run_name("", ["run"])
    ('Pollen-5-kV', 'run-2')
    """
    return _unused(_plain(title, "run"), taken)


def run_title(title: str, taken: Collection[str]) -> str:
    """Return a title as it is shown, with a number behind it where another run has it, so that both are told apart.

    Examples
    --------
    >>> run_title("view", ["view"])
    'view (2)'
    """
    return _unused(displayed_name(title), taken, "{} ({})")


def displayed_name(original: str) -> str:
    """Return a name as it is shown: its last part, without characters that cannot be seen."""
    last = re.split(r"[/\\]", original)[-1]
    return "".join(letter for letter in last if letter.isprintable()).strip()[-_MOST_TITLE:]


def _split(name: str) -> tuple[str, str]:
    """Return stem and suffix; of `a.tif.txt` and `a-tif.hdr`, which lie beside `a.tif`, its stem."""
    suffix = PurePosixPath(name).suffix.lower()
    stem = name[: len(name) - len(suffix)] if suffix else name
    if suffix in SIDECAR_SUFFIXES:
        for image in IMAGE_SUFFIXES:
            for end in (image, f"-{image[1:]}"):
                if stem.lower().endswith(end) and len(stem) > len(end):
                    return stem[: -len(end)], suffix
    return stem, suffix


def _plain(text: str, instead: str) -> str:
    letters = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    plain = re.sub(r"\.{2,}", "-", re.sub(r"[^A-Za-z0-9_.+-]+", "-", letters))
    plain = plain.strip(_NO_END)[:_MOST_CHARACTERS].strip(_NO_END)
    return f"{instead}-{plain}" if _RESERVED.fullmatch(plain) else plain or instead


def _unused(name: str, taken: Collection[str], numbered: str = "{}-{}") -> str:
    """Return the name, with a number behind it where it is taken, be it in other capitals."""
    used = {item.casefold() for item in taken}
    number, candidate = 1, name
    while candidate.casefold() in used:
        number += 1
        candidate = numbered.format(name, number)
    return candidate
