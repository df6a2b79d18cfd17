"""Coverage-guided fuzzing of everything that reads metadata, with atheris (`pip install atheris`).

`python benchmarks/fuzz_metadata.py CORPUS -max_total_time=600` keeps what it finds interesting in the folder CORPUS and
ends with a traceback at the first input that raises anything but a SemscapeError. `--keep CORPUS` puts such a folder
(merged by `-merge=1`) into fuzz_corpus.json, where it starts from, and which a test replays.
"""

from __future__ import annotations

import base64
import json
import logging
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from semscape.batch.manifest import find_specimens
from semscape.errors import SemscapeError
from semscape.io.hitachi import parse_hitachi
from semscape.io.jeol import parse_jeol
from semscape.io.phenom import parse_phenom
from semscape.io.plain_tags import PlainTags, parse_plain_tags
from semscape.io.series_toml import read_series_toml
from semscape.io.tescan import parse_tescan, tescan_tag_text
from semscape.io.thermo_fisher import parse_thermo_fisher
from semscape.io.thermo_fisher_xml import parse_thermo_fisher_xml
from semscape.io.value_file import decode_value
from semscape.io.vendor_text import decode_text
from semscape.io.zeiss import parse_zeiss
from semscape.options import read_toml

SHAPE = (96, 128)
FOLDER = Path(tempfile.mkdtemp())
KEPT = Path(__file__).with_name("fuzz_corpus.json")


def _as_file(name: str, data: bytes) -> Path:
    path = FOLDER / name
    path.write_bytes(data)
    return path


def _value(data: bytes) -> None:
    try:
        decode_value(data)
    except ValueError:
        return


TARGETS: tuple[Callable[[bytes], object], ...] = (
    lambda data: parse_zeiss(decode_text(data), SHAPE[1]),
    lambda data: parse_thermo_fisher(decode_text(data), SHAPE),
    lambda data: parse_thermo_fisher_xml(decode_text(data), SHAPE),
    lambda data: parse_tescan(decode_text(data), SHAPE),
    lambda data: parse_tescan(tescan_tag_text(data), SHAPE),
    lambda data: parse_jeol(decode_text(data), SHAPE),
    lambda data: parse_hitachi(decode_text(data), SHAPE),
    lambda data: parse_phenom(decode_text(data), SHAPE[0]),
    lambda data: parse_plain_tags(PlainTags(decode_text(data), 3.0, 4.0, 10.0)),
    lambda data: read_series_toml(_as_file("series.toml", data), ["a.tif", "b.tif"]),
    lambda data: find_specimens(_as_file("MANIFEST.csv", data), FOLDER / "out"),
    lambda data: read_toml(data.decode("utf-8", "replace")),
    _value,
)


def run_one(data: bytes) -> None:
    """Give the input to the reader that its first byte chooses."""
    if data:
        try:
            TARGETS[data[0] % len(TARGETS)](data[1:])
        except SemscapeError:
            return


def kept_inputs() -> list[bytes]:
    """Return the inputs that earlier fuzzing found to reach something new."""
    return [base64.b64decode(text) for text in json.loads(KEPT.read_text(encoding="ascii"))]


if __name__ == "__main__":
    import atheris

    logging.disable()
    if sys.argv[1:2] == ["--keep"]:
        found = sorted(path.read_bytes() for path in Path(sys.argv[2]).iterdir())
        KEPT.write_text(
            json.dumps([base64.b64encode(one).decode() for one in found], indent=0) + "\n", encoding="ascii"
        )
        sys.exit()
    for number, one in enumerate(kept_inputs()):
        (Path(sys.argv[1]) / f"kept-{number}").write_bytes(one)
    atheris.instrument_all()
    atheris.Setup(sys.argv, run_one)
    atheris.Fuzz()
