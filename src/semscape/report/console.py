"""What the command line shows of a run: a line per stage, the summary, and the table of `inspect`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.status import Status
from rich.text import Text

from semscape.report.json import report_to_dict
from semscape.report.wording import held_text, inline_label, is_held, number, value_text
from semscape.types import LengthUnit, Result, TiltSeries

_SHOWN_FIGURES = 4


class StageLines:
    """The progress callback of `semscape.reconstruct`: a line per stage on a console.

    On a terminal a spinner runs while a stage works and becomes a check mark with its seconds and key
    figures; elsewhere the stage's end is one plain line. To be used as a context manager, which takes the
    spinner away when a stage fails.

    Parameters
    ----------
    console : rich.console.Console
        Where the lines go.
    quiet : bool
        Show nothing.
    unit : "um" or "px"
        Unit of the lengths among the figures.
    """

    def __init__(self, console: Console, *, quiet: bool, unit: LengthUnit = "um") -> None:
        self._console = console
        self._quiet = quiet
        self._unit = unit
        self._status: Status | None = None
        self._started = time.perf_counter()

    def take_unit_of(self, series: TiltSeries) -> None:
        """Take note of the unit of the series' lengths, once it is read."""
        self._unit = series.length_unit

    def __enter__(self) -> StageLines:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def __call__(self, stage: str, figures: Mapping[str, Any] | None) -> None:
        """Show that a stage starts (`figures` is None) or has ended."""
        if self._quiet:
            return
        if figures is None:
            self._stop()
            self._started = time.perf_counter()
            if self._console.is_terminal:
                self._status = self._console.status(Text(f"{stage} …"))
                self._status.start()
            return
        self._stop()
        seconds = time.perf_counter() - self._started
        shown = [(key, value) for key, value in figures.items() if _is_short(value)][:_SHOWN_FIGURES]
        text = ", ".join(f"{inline_label(key)} {value_text(key, value, self._unit)}" for key, value in shown)
        if self._console.is_terminal:
            line = Text.assemble(("✓ ", "bold green"), f"{stage:<12}", (f"{seconds:7.1f} s  ", "dim"), text)
            self._console.print(_writable(line, self._console), no_wrap=True, overflow="ellipsis")
        else:
            plain = Text(f"{stage}: {seconds:.1f} s" + (f"; {text}" if text else ""))
            self._console.print(_writable(plain, self._console), soft_wrap=True)

    def _stop(self) -> None:
        if self._status is not None:
            self._status.stop()
            self._status = None


def print_summary(result: Result, console: Console) -> None:
    """Print what a run found, in three lines."""
    report = report_to_dict(result)
    views, unit = report["views"], result.reconstruction.length_unit
    tilts = ", ".join(
        held_text(view["tilt_deg"])
        if is_held(view, report)
        else f"{view['tilt_deg']:z.2f}" + ("" if view["tilt_sigma_deg"] is None else f" ± {view['tilt_sigma_deg']:.2f}")
        for view in views
    )
    metrics = {key: value for key, value in report["metrics"].items() if _is_short(value)}
    known = [f"{inline_label(key)} {value_text(key, value, unit)}" for key, value in metrics.items() if key in _SUMMARY]
    lines = [
        report["verdict"],
        f"tilts: {tilts} deg ({report['tilt_source']})",
        ", ".join([report["height_scale"], f"residual rms {number(report['metrics'].get('rms_px'), 3)} px", *known]),
    ]
    if report["ambiguity"] != "none":
        lines.append(report["ambiguity_text"])
    for line in lines:
        console.print(_writable(Text(line), console), soft_wrap=True)


def print_inspection(folder: str, series: TiltSeries, views: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print what was understood of a series, a row a view, each value with its source, then the warnings.

    `views` is what `semscape.io.inspect.describe_series` returns.
    """
    from rich import box
    from rich.table import Table

    height, width = series.shape
    print_line(f"{folder}: {series.n_views} view{'s' * (series.n_views > 1)} of {width} × {height} px", console, "bold")
    table = Table(box=box.SIMPLE_HEAD if console.is_terminal else box.ASCII2, pad_edge=False)
    for title in ("image", "vendor", "pixel size", "tilt", "axis", "data bar"):
        table.add_column(title, overflow="fold", justify="left" if title in ("image", "vendor") else "right")
    for view in views:
        cells = [view["name"], view["vendor"]]
        for key, none in (("pixel_size_um", "unknown"), ("tilt_deg", "unknown"), ("axis_deg", "estimated")):
            value, source = view.get(key), view["sources"].get(key)
            cells.append(none if value is None else f"{value_text(key, value)} ({source})")
        rows = view.get("data_bar_rows")
        cells.append(f"{rows} rows ({view['sources'].get('data_bar_rows', 'image')})" if rows else "none")
        table.add_row(*(_writable(Text(cell), console) for cell in cells))
    console.print(table)
    origins = views[0].get("origins", {})
    if origins:
        told = [f"{inline_label(key)} {value_text(key, views[0][key])} ({origin})" for key, origin in origins.items()]
        print_line(f"{views[0]['name']}: {'; '.join(told)}", console)
    if series.length_unit == "px":
        print_line("no pixel size: lengths will be in px; give --pixel-size-um for um", console)
    if series.n_views > 2 and not any(view["tilt_deg"] is not None for view in views):
        print_line("no tilts: found from the images, which tell the height scale only roughly; give --tilts", console)
    for warning in series.warnings:
        print_line(f"warning: {warning}", console, "yellow")


def print_line(text: str, console: Console, style: str = "") -> None:
    """Print one line as it is: no markup, no wrapping where nothing wraps, no character the console lacks."""
    console.print(_writable(Text(text, style=style), console), soft_wrap=True)


_SUMMARY = ("height_range", "height_range_um", "height_range_px", "completeness", "n_points")


def _is_short(value: Any) -> bool:
    """Tell whether a figure fits a line: a number, a text or a short list of them."""
    if isinstance(value, list | tuple):
        return len(value) <= 8 and not any(isinstance(item, list | tuple | Mapping) for item in value)
    return not isinstance(value, Mapping)


def _writable(text: Text, console: Console) -> Text:
    """Return the text with "?" for characters that the console's encoding lacks (Windows code pages)."""
    encoding = console.encoding or "utf-8"
    plain = text.plain.encode(encoding, "replace").decode(encoding)
    if plain == text.plain:
        return text
    return Text(plain)
