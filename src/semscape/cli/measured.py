"""What becomes of a surface: `measure` and `convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from semscape.cli.application import DebugOption, QuietOption, SeedOption, app
from semscape.cli.outcome import console, exit_codes

_PLACE = " In px, or 1.5,2,40,2um."


@app.command(short_help="Measure a surface: ISO 25178 parameters, profiles, steps, volumes, wear.")
def measure(
    run: Annotated[Path, typer.Argument(help="Run folder of semscape reconstruct.", metavar="RUN")],
    level: Annotated[
        str | None, typer.Option(metavar="FORM", help="Form to take off: plane, poly2, poly3, poly4, sphere or none.")
    ] = None,
    robust: Annotated[bool | None, typer.Option("--robust", help="Level on the majority of the heights.")] = None,
    s_filter_um: Annotated[float | None, typer.Option(metavar="UM", help="S-filter: shorter waves go.")] = None,
    l_filter_um: Annotated[float | None, typer.Option(metavar="UM", help="L-filter: longer waves go.")] = None,
    outliers: Annotated[float | None, typer.Option(metavar="N", help="Set heights beyond N sigmas unknown.")] = None,
    region: Annotated[
        str | None, typer.Option(metavar="X0,Y0,X1,Y1", help="Part to measure; more corners: a polygon." + _PLACE)
    ] = None,
    profile: Annotated[str | None, typer.Option(metavar="X0,Y0,X1,Y1", help="Line of a profile." + _PLACE)] = None,
    edges: Annotated[str | None, typer.Option(metavar="D[,D]", help="Step or groove along the profile.")] = None,
    step: Annotated[str | None, typer.Option(metavar="REGION;REGION", help="Step between regions." + _PLACE)] = None,
    angle: Annotated[str | None, typer.Option(metavar="REGION;REGION", help="Angle between planes." + _PLACE)] = None,
    distance: Annotated[str | None, typer.Option(metavar="X0,Y0,X1,Y1", help="Between two points." + _PLACE)] = None,
    volume_level_um: Annotated[float | None, typer.Option(metavar="UM", help="Level of the volumes.")] = None,
    since: Annotated[Path | None, typer.Option(metavar="RUN", help="Earlier run of the same place: wear.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="Write JSON and CSV.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    seed: SeedOption = None,
    debug: DebugOption = False,
) -> None:
    """Measure a surface. Places are in px of the image, x right, y down from the top-left pixel, or end in um."""
    with exit_codes(debug=debug, quiet=False):
        from semscape.flags import measure_request
        from semscape.io.finished_run import read_finished_run
        from semscape.report.measurement import measure_run, print_measurement, write_measurement

        finished = read_finished_run(run)
        settings = {"level": level, "robust": robust, "s_filter_um": s_filter_um, "l_filter_um": l_filter_um}
        settings |= {"outlier_sigmas": outliers, "volume_level_um": volume_level_um, "seed": seed}
        places = {"region": region, "profile": profile, "edges": edges, "step": step, "angle": angle}
        request = measure_request(finished.height_map, places | {"distance": distance}, settings)
        measured = measure_run(finished, request, None if since is None else read_finished_run(since))
        if output is not None:
            write_measurement(measured, output)
        if as_json:
            typer.echo(measured.json(), nl=False)
        else:
            print_measurement(measured, console())


@app.command(short_help="Write the surface in other programs' formats.")
def convert(
    run: Annotated[Path, typer.Argument(help="Run folder of semscape reconstruct.", metavar="RUN")],
    to: Annotated[str, typer.Option("--to", metavar="LIST", help="Formats, like x3p,stl; see docs/files.md.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PATH", help="Folder, or a file for one format; else RUN/converted."),
    ] = None,
    unit: Annotated[str | None, typer.Option(metavar="UNIT", help="Unit of meshes: um, mm or nm.")] = None,
    color: Annotated[str | None, typer.Option(metavar="MAP", help="micrograph, or by height: viridis, ...")] = None,
    max_vertices: Annotated[int | None, typer.Option(metavar="N", help="Largest number of a mesh's vertices.")] = None,
    print_scale: Annotated[float | None, typer.Option(metavar="N", help="Magnification of the print.")] = None,
    print_size_mm: Annotated[float | None, typer.Option(metavar="MM", help="Longest side of the plate.")] = None,
    base_mm: Annotated[float | None, typer.Option(metavar="MM", help="Thickness of the print's plate.")] = None,
    images: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Images of the run, for stereo.")] = None,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> None:
    """Write the surface of a run for other programs: meshes, height maps, a 3D print, stereo pictures."""
    with exit_codes(debug=debug, quiet=quiet):
        from semscape.options import ConvertOptions
        from semscape.report.conversion import convert as convert_run

        given: dict[str, Any] = {"unit": unit, "color": color, "max_vertices": max_vertices, "print_scale": print_scale}
        given |= {"print_size_mm": print_size_mm, "base_mm": base_mm}
        options = ConvertOptions(**{name: value for name, value in given.items() if value is not None})
        formats = [name.strip().lower() for name in to.split(",") if name.strip()]
        for path in convert_run(run, formats, output, options, images=images):
            if not quiet:
                typer.echo(path)
