"""Messages of the command line in the words of the page: what is a flag there is a cell or a button here."""

from __future__ import annotations

import re

from semscape.app.workspace import Run

_WORDS = {
    r"\(--tilts( -?[\d.,-]+\d)?": "(column Tilt",
    r"give --tilts with": "give the tilts with",
    r"--tilts": "the column Tilt",
    r"--pixel-size-um": "the column Pixel size",
    r"--scale-bar-um( \d+)?": "the cell Scale bar length",
    r"run again with --invert-relief": "reconstruct again with Mirror the relief",
    r"--invert-relief": "Mirror the relief",
    r"--axis-deg": "the cell Tilt axis",
    r"--camera (\w+)": r"sfm.camera=\1 under More settings",
    r"--full-object": "the command semscape reconstruct --full-object",
    r"--(region|profile|level) ": r"\1 ",
    r"--set ([a-z_]+\.[a-z_.]+=\S+?)(?=[,;.]?(\s|$))": r"\1 under More settings",
    r"--set (?=')": "the setting ",
    r"fewer --workers, more --memory-mb, or ": "",
    r"fewer --workers, ": "",
    r"; run again with --debug": "; what happened is in its log",
    r"\+-(?=\s?\d)": "±",
    r"(?<=\d )um\b": "µm",
    r"--s-filter-um": "an S-filter of",
    r"--l-filter-um": "the L-filter",
}


def plain_words(text: str, run: Run | None = None) -> str:
    """Return a message as the page shows it: its own words for flags, original names, no paths of this machine.

    Examples
    --------
    >>> plain_words("tilts unknown; give the stage tilts (--tilts), or --set dense.max_pairs=2, or run again")
    'tilts unknown; give the stage tilts (column Tilt), or dense.max_pairs=2 under More settings, or run again'
    >>> plain_words("Give the tilts (--tilts -3,3, or tilts_deg in series.toml); or run with --camera auto")
    'Give the tilts (column Tilt, or tilts_deg in series.toml); or run with sfm.camera=auto under More settings'
    """
    if run is not None:
        for folder, words in ((run.images, "the images"), (run.folder, run.name)):
            if folder is not None:
                text = text.replace(f"{folder}/", "").replace(f"{folder}\\", "").replace(str(folder), words)
        for stored, original in run.originals().items():
            if stored != original:
                shown = original.replace("\\", "\\\\")
                text = re.sub(rf"(?<![\w.-]){re.escape(stored)}(?![\w-])", shown, text)
    for pattern, words in _WORDS.items():
        text = re.sub(pattern, words, text)
    return text
