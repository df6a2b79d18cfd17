from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from semscape.report.console import StageLines, print_line, print_summary
from synthetic_result import make_result, with_reconstruction

RESULT = make_result()


def plain() -> tuple[Console, io.StringIO]:
    stream = io.StringIO()
    return Console(file=stream, highlight=False), stream


def test_a_plain_line_per_stage() -> None:
    console, stream = plain()
    with StageLines(console, quiet=False) as progress:
        progress("detect", None)
        progress("detect", {"keypoints": [10, 12], "per_view": {"a": 1}})
        progress("dense", None)
        progress("dense", {})
    lines = stream.getvalue().splitlines()
    assert lines == ["detect: 0.0 s; keypoints 10, 12", "dense: 0.0 s"]


def test_lengths_are_in_the_series_unit() -> None:
    console, stream = plain()
    with StageLines(console, quiet=False, unit="px") as progress:
        progress("dense", None)
        progress("dense", {"height_range": [1.0, 2.5]})
    assert "height range 1 to 2.5 px" in stream.getvalue()


def test_quiet_shows_nothing() -> None:
    console, stream = plain()
    with StageLines(console, quiet=True) as progress:
        progress("detect", None)
        progress("detect", {})
    assert stream.getvalue() == ""


def test_a_terminal_gets_a_check_mark_and_loses_the_spinner_on_failure() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=80)
    with StageLines(console, quiet=False) as progress:
        progress("detect", None)
        progress("detect", {"keypoints": 12})
    assert "✓" in stream.getvalue()

    def fail() -> None:
        with StageLines(console, quiet=False) as progress:
            progress("match", None)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert not console._live_stack


def test_the_summary_says_tilts_scale_and_residual() -> None:
    console, stream = plain()
    print_summary(RESULT, console)
    text = stream.getvalue()
    assert "tilts: -3.02 ± 0.02, 0.01 ± 0.02, 2.99 ± 0.02 deg (metadata)" in text
    assert "height scale ±1.1 % (95 %), residual rms 0.214 px" in text


def test_a_sigma_that_is_unknown_is_not_zero() -> None:
    console, stream = plain()
    unknown = np.full(3, np.nan)
    print_summary(
        with_reconstruction(RESULT, tilt_sigma_rad=unknown, height_scale_relative_sigma=np.nan, tilt_source="thesis"),
        console,
    )
    assert "tilts: -3.02, 0.01, 2.99 deg (thesis)" in stream.getvalue()
    assert "height scale: uncertainty unknown" in stream.getvalue()


def test_the_summary_says_what_is_assumed() -> None:
    console, stream = plain()
    print_summary(with_reconstruction(RESULT, ambiguity="reflection", relief_confidence=0.7), console)
    assert "run again with --invert-relief" in " ".join(stream.getvalue().split())
    console, stream = plain()
    print_summary(with_reconstruction(RESULT, ambiguity="reflection", relief_confidence=0.3), console)
    assert "against the vote of its shading (--invert-relief; confidence of that vote 70 %)" in " ".join(
        stream.getvalue().split()
    )


def test_file_names_are_no_markup_and_no_console_is_asked_for_characters_it_lacks() -> None:
    buffer = io.BytesIO()
    console = Console(file=io.TextIOWrapper(buffer, encoding="cp1252", write_through=True), highlight=False)
    print_line("[bold]grün ✓.tif", console)
    assert buffer.getvalue().decode("cp1252").strip() == "[bold]grün ?.tif"
