"""From images to a surface: `reconstruct` and `inspect`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semscape.cli.application import (
    AxisOption,
    DebugOption,
    FolderArgument,
    LogJsonOption,
    OptionsOption,
    PixelSizeOption,
    QuietOption,
    ScaleBarOption,
    SeedOption,
    SetOption,
    TiltsOption,
    WorkersOption,
    app,
)
from semscape.cli.outcome import console, exit_codes
from semscape.flags import effective_options

if TYPE_CHECKING:
    from semscape.options import Options
    from semscape.types import TiltSeries


@app.command(short_help="Reconstruct the surface from a folder of images.")
def reconstruct(
    folder: FolderArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Run folder to write.", metavar="RUN")],
    tilts: TiltsOption = None,
    pixel_size_um: PixelSizeOption = None,
    scale_bar_um: ScaleBarOption = None,
    axis_deg: AxisOption = None,
    settings: SetOption = None,
    options_file: OptionsOption = None,
    seed: SeedOption = None,
    workers: WorkersOption = None,
    camera: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="Camera: orthographic, perspective, or auto, which fits both and chooses."),
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="thesis: the textbook route to the tilts, a baseline and no measurement."),
    ] = None,
    invert_relief: Annotated[
        bool | None,
        typer.Option("--invert-relief/--keep-relief", help="Mirror a relief whose sign nothing but shading fixed."),
    ] = None,
    keep: Annotated[
        str | None, typer.Option(help="all, or specimen: leave out the background stub.", metavar="WHAT")
    ] = None,
    full_object: Annotated[
        bool, typer.Option("--full-object", help="Views all around, by tilt and rotation: one watertight mesh.")
    ] = False,
    quiet: QuietOption = False,
    log_json: LogJsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Reconstruct the surface from a folder of tilted images and write a run folder."""
    with exit_codes(debug=debug, quiet=quiet, log_json=log_json):
        options = effective_options(
            options_file,
            settings,
            tilts,
            pixel_size_um,
            axis_deg,
            seed,
            invert_relief,
            scale_bar_um,
            keep,
            camera,
            preset,
        )
        run = run_object_into if full_object else run_into
        run(folder, output, options, workers=workers, quiet=quiet, lines=not (quiet or log_json))


@app.command(short_help="Show what is understood of a folder of images.")
def inspect(
    folder: FolderArgument,
    tilts: TiltsOption = None,
    pixel_size_um: PixelSizeOption = None,
    scale_bar_um: ScaleBarOption = None,
    axis_deg: AxisOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    write: Annotated[bool, typer.Option("--write", help="Write series.toml into FOLDER, for you to edit.")] = False,
    debug: DebugOption = False,
) -> None:
    """Show what is understood of a folder of images, or of one: vendor, pixel size, tilt, each with its source."""
    with exit_codes(debug=debug, quiet=False):
        from semscape.errors import BadInputError
        from semscape.io.inspect import describe_series
        from semscape.io.run_folder import json_text
        from semscape.io.series import load_image, load_series
        from semscape.io.series_template import write_series_toml
        from semscape.report.console import print_inspection

        options = effective_options(None, None, tilts, pixel_size_um, axis_deg, None, None, scale_bar_um)
        if write and folder.is_file():
            raise BadInputError(f"{folder}: a series.toml belongs to a folder of images; give the folder")
        series = load_image(folder, options.input) if folder.is_file() else load_series(folder, options.input)
        series = _with_refusal(series)
        views = describe_series(series)
        if as_json:
            typer.echo(json_text({"views": views, "warnings": series.warnings}), nl=False)
        else:
            print_inspection(str(folder), series, views, console())
        if write:
            path = write_series_toml(folder, views, series.warnings)
            typer.echo(f"{path} holds what was understood, as comments; edit it to override anything", err=True)


def _with_refusal(series: TiltSeries) -> TiltSeries:
    """Return the series with a warning of what `reconstruct` refuses: who still sits at the microscope can help it."""
    from semscape.errors import BadInputError
    from semscape.sfm.plausibility import require_tilts

    try:
        require_tilts(series)
    except BadInputError as refusal:
        return replace(series, warnings=(*series.warnings, str(refusal)))
    return series


def run_into(folder: Path, output: Path, options: Options, *, workers: int | None, quiet: bool, lines: bool) -> None:
    """Reconstruct a folder of images into a run folder, with progress on stderr and the summary on stdout."""
    from semscape.batch.folder_run import reconstruct_folder
    from semscape.report.console import StageLines, print_line, print_summary

    warn = _warner(lines=lines)

    def on_series(series: TiltSeries) -> None:
        progress.take_unit_of(series)
        warn(series.warnings)  # before the work, which may take long and may have no answer

    with StageLines(console(err=True), quiet=not lines) as progress:
        result = reconstruct_folder(folder, output, options, workers=workers, progress=progress, on_series=on_series)
    if quiet:
        return
    warn((*result.report.failures, *result.report.warnings))
    print_summary(result, console())
    print_line(f"report: {output / 'report.html'}", console())


def run_object_into(
    folder: Path, output: Path, options: Options, *, workers: int | None, quiet: bool, lines: bool
) -> None:
    """Reconstruct a full object into a run folder, with progress on stderr and the report's place on stdout."""
    from semscape.batch.full_object_run import reconstruct_object_folder
    from semscape.report.console import StageLines, print_line
    from semscape.report.full_object import object_verdict

    warn = _warner(lines=lines)

    def on_series(series: TiltSeries) -> None:
        progress.take_unit_of(series)
        warn(series.warnings)

    with StageLines(console(err=True), quiet=not lines) as progress:
        found = reconstruct_object_folder(
            folder, output, options, workers=workers, progress=progress, on_series=on_series
        )
    if quiet:
        return
    warn(found.warnings)
    mesh, measured = found.merged.mesh, found.merged.measured
    print_line(object_verdict(found), console())
    print_line(f"{len(mesh.faces):,} triangles from {len(found.maps)} groups of views", console())
    print_line(f"{measured:.0%} of the surface is seen by views, the rest closes the body", console())
    print_line(f"report: {output / 'report.html'}", console())


def _warner(*, lines: bool) -> Callable[[Iterable[str]], None]:
    """Return what prints warnings on stderr, each once; nothing where no lines are wanted."""
    from semscape.report.console import print_line

    told: list[str] = []

    def warn(texts: Iterable[str]) -> None:
        for text in texts if lines else ():
            if text not in told:
                print_line(f"warning: {text}", console(err=True), "yellow")
                told.append(text)

    return warn
