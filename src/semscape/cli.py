"""The command line: `semscape reconstruct`, `batch`, `inspect`, `measure`, `simulate` and `demo`.

Exit codes: 0 done, 1 a fault of semscape itself, 2 bad input or usage, 3 the data give no answer, 130
interrupted. What a command needs is imported when it runs, so that `semscape --help` is quick. No flag has
a default of its own: a flag that is not given leaves the value to the options file, then to options.py.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from semscape.exit_codes import exit_codes as _exit_codes
from semscape.flags import effective_options, simulation_options

if TYPE_CHECKING:
    from rich.console import Console

    from semscape.options import Options
    from semscape.simulate import SimulationOptions
    from semscape.types import TiltSeries

app = typer.Typer(
    name="semscape",
    help="Metric 3D surfaces with a stated uncertainty from SEM images of one specimen at several tilts.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # its boxes cut the very words one has to type
)

FolderArgument = Annotated[Path, typer.Argument(help="Folder with the tilted images.", metavar="FOLDER")]
TiltsOption = Annotated[
    str | None, typer.Option(help="Stage tilts in deg, in the order of the file names, like -7,0,7.", metavar="LIST")
]
PixelSizeOption = Annotated[float | None, typer.Option(help="Pixel size in um.", metavar="UM")]
ScaleBarOption = Annotated[
    float | None, typer.Option("--scale-bar-um", help="Length in um that the burnt-in scale bar says.", metavar="UM")
]
AxisOption = Annotated[
    float | None,
    typer.Option(metavar="DEG", help="Tilt axis in deg from +x, counter-clockwise: 0 horizontal, 90 vertical."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="STAGE.KEY=VALUE", help="An option, like sfm.prior_tilt_deg=0.2; may be repeated."),
]
OptionsOption = Annotated[
    Path | None, typer.Option("--options", metavar="FILE", help="Options file (TOML), as a run folder holds it.")
]
SeedOption = Annotated[int | None, typer.Option(min=0, metavar="N", help="Seed of every random choice.")]
WorkersOption = Annotated[int | None, typer.Option(min=1, metavar="N", help="Number of threads; it changes no result.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show log and traceback.")]
LogJsonOption = Annotated[bool, typer.Option("--log-json", help="Log as lines of JSON on stderr, and no other lines.")]
_PLACE = " In px, or 1.5,2,40,2um."


def main() -> None:
    """Run the command line."""
    app()


def _print_version(wanted: bool) -> None:
    if wanted:
        from semscape import __version__

        typer.echo(f"semscape {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Metric 3D surfaces with a stated uncertainty from SEM images of one specimen at several tilts."""


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
    invert_relief: Annotated[
        bool | None,
        typer.Option("--invert-relief/--keep-relief", help="Mirror a relief whose sign nothing but shading fixed."),
    ] = None,
    quiet: QuietOption = False,
    log_json: LogJsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Reconstruct the surface from a folder of tilted images and write a run folder."""
    with _exit_codes(debug=debug, quiet=quiet, log_json=log_json):
        options = effective_options(
            options_file, settings, tilts, pixel_size_um, axis_deg, seed, invert_relief, scale_bar_um
        )
        _run(folder, output, options, workers=workers, quiet=quiet, lines=not (quiet or log_json))


@app.command(short_help="Reconstruct many specimens, and go on where it was interrupted.")
def batch(
    manifest: Annotated[
        Path, typer.Argument(help="CSV with a row per specimen, or a folder of folders.", metavar="MANIFEST")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for runs and summary.", metavar="OUT")],
    settings: SetOption = None,
    options_file: OptionsOption = None,
    workers: Annotated[int | None, typer.Option(min=0, metavar="N", help="Processes; 0: in this one.")] = None,
    threads: Annotated[int | None, typer.Option(min=1, metavar="N", help="Most threads of each.")] = None,
    memory_mb: Annotated[int, typer.Option(min=0, metavar="MB", help="Most memory of each; 0: no limit.")] = 0,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler, tcp://...")] = None,
    slurm: Annotated[str | None, typer.Option(metavar="LIST", help="partition=...,cores=...,memory=...")] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run failed ones again.")] = False,
    verify: Annotated[bool, typer.Option("--verify", help="Read all files again to see what is done.")] = False,
    spread: Annotated[bool, typer.Option("--spread", help="One by one, each over all workers.")] = False,
    quiet: QuietOption = False,
    log_json: LogJsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Reconstruct many specimens. Exit code 0: all are done, 1: some failed, 2: wrong usage."""
    with _exit_codes(debug=debug, quiet=quiet, log_json=log_json):
        from semscape.batch.command import run_command
        from semscape.cluster import Placement

        options = effective_options(options_file, settings, None, None, None, None, None)
        placement = Placement(workers, threads, memory_mb, scheduler, slurm)
        how = {"retry_failed": retry_failed, "verify": verify, "spread": spread}
        raise typer.Exit(run_command(manifest, output, options, placement, _console(), quiet or log_json, **how))


@app.command(short_help="Show versions and resources, and test this installation.")
def doctor() -> None:
    """Print versions, cores, memory, BLAS and optional extras, and reconstruct a small simulated series."""
    from semscape.doctor import examine

    raise typer.Exit(examine(_console()))


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
    """Show what is understood of a folder of images: vendor, pixel size, tilt, data bar, each with its source."""
    with _exit_codes(debug=debug, quiet=False):
        from semscape.io.inspect import describe_series
        from semscape.io.run_folder import json_text
        from semscape.io.series import load_series
        from semscape.io.series_template import write_series_toml
        from semscape.report.console import print_inspection

        options = effective_options(None, None, tilts, pixel_size_um, axis_deg, None, None, scale_bar_um)
        series = load_series(folder, options.input)
        views = describe_series(series)
        if as_json:
            typer.echo(json_text({"views": views, "warnings": series.warnings}), nl=False)
        else:
            print_inspection(str(folder), series, views, _console())
        if write:
            path = write_series_toml(folder, views, series.warnings)
            typer.echo(f"{path} holds what was understood, as comments; edit it to override anything", err=True)


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
    region: Annotated[str | None, typer.Option(metavar="X0,Y0,X1,Y1", help="Part to measure." + _PLACE)] = None,
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
    with _exit_codes(debug=debug, quiet=False):
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
            print_measurement(measured, _console())


@app.command(short_help="Simulate a tilt series with its exact truth.")
def simulate(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the images.", metavar="FOLDER")],
    specimen: Annotated[
        str | None, typer.Argument(help="Built-in specimen, like fracture, pollen or vickers.", metavar="SPECIMEN")
    ] = None,
    preset: Annotated[str | None, typer.Option(metavar="NAME", help="Microscope: ideal, nominal or hard.")] = None,
    tilts: Annotated[str | None, typer.Option(help="Stage tilts in deg, like -6,-3,0,3,6.", metavar="LIST")] = None,
    views: Annotated[int | None, typer.Option(min=2, metavar="N", help="Number of views about zero tilt.")] = None,
    step: Annotated[float | None, typer.Option(metavar="DEG", help="Tilt step between views in deg.")] = None,
    size: Annotated[
        str | None, typer.Option(metavar="SIZE", help="Size of the images in px, like 512 or 640x480.")
    ] = None,
    pixel_size_um: PixelSizeOption = None,
    seed: SeedOption = None,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> None:
    """Simulate a tilt series of a built-in specimen, with its exact truth in truth.json."""
    with _exit_codes(debug=debug, quiet=quiet):
        microscope = simulation_options(preset, tilts, views, step, size, pixel_size_um)
        series = _simulate_into(output, specimen, microscope, seed)
        if not quiet:
            typer.echo(f"{series.n_views} views in {output}; try: semscape reconstruct {output} -o {output}-run")


@app.command(short_help="Compare a run with the truth of its simulated series.")
def evaluate(
    run: Annotated[Path, typer.Argument(help="Run folder.", metavar="RUN")],
    truth: Annotated[
        Path, typer.Option("--truth", help="Folder of the simulated series, or a mesh in um.", metavar="PATH")
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for the picture; RUN if left out.", metavar="FOLDER")
    ] = None,
    debug: DebugOption = False,
) -> None:
    """Print the errors of a run against the truth as JSON, and draw the signed height errors."""
    with _exit_codes(debug=debug, quiet=False):
        from semscape.experiments.run_against_truth import evaluate_run
        from semscape.io.run_folder import json_text

        figures, picture = evaluate_run(run, truth, run if output is None else output)
        typer.echo(json_text(figures), nl=False)
        if picture is not None:
            typer.echo(f"picture: {picture}", err=True)


@app.command(short_help="Run the experiments of the thesis.")
def experiments(
    name: Annotated[str, typer.Argument(help="An experiment, or all.", metavar="NAME|all")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the page.", metavar="OUT")],
    seed: SeedOption = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder with measured sets (tilt_series, meshes).", metavar="DIR")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small and few, to see that it works.")] = False,
    workers: WorkersOption = None,
    debug: DebugOption = False,
) -> None:
    """Run experiments and write experiments.html, .md and .json with a CSV per table and a PNG per figure."""
    with _exit_codes(debug=debug, quiet=False):
        from semscape.experiments.page import write_experiments
        from semscape.experiments.registry import run_experiments
        from semscape.experiments.study import Setting

        given = {} if seed is None else {"seed": seed}
        setting = Setting(data=data, workers=workers, quick=quick, **given)
        done = run_experiments(name, setting, progress=lambda text: typer.echo(text, err=True))
        typer.echo(f"page: {write_experiments(done, setting, output)}")


@app.command(short_help="Simulate, reconstruct, and say where the report is.")
def demo(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FOLDER", help="Folder for images and run; ./semscape-demo if left out."
        ),
    ] = None,
    seed: SeedOption = None,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> None:
    """Simulate a specimen, reconstruct it, and say where the report is."""
    with _exit_codes(debug=debug, quiet=quiet):
        folder = Path("semscape-demo") if output is None else output
        if not quiet:
            typer.echo(f"simulating a tilt series in {folder / 'images'}", err=True)
        _simulate_into(folder / "images", None, None, seed)
        options = effective_options(None, None, None, None, None, seed, None)
        _run(folder / "images", folder / "run", options, workers=workers, quiet=quiet, lines=not quiet)


@app.command("compare-features", short_help="Compare the four keypoint detectors on a folder of images.")
def compare_features(
    folder: FolderArgument,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write, .csv or .json.", metavar="FILE")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    settings: SetOption = None,
    options_file: OptionsOption = None,
    seed: SeedOption = None,
    debug: DebugOption = False,
) -> None:
    """Compare SIFT, SURF, ORB and BRIEF: keypoints, matches, inliers, precision where there is truth, seconds."""
    with _exit_codes(debug=debug, quiet=False):
        from semscape.experiments import features_output
        from semscape.experiments.features_table import compare_features_of

        options = effective_options(options_file, settings, None, None, None, seed, None)
        if output is not None:
            features_output.require_known_suffix(output)
        rows = compare_features_of(folder, options, progress=lambda name: typer.echo(f"{name} ...", err=True))
        if output is not None:
            features_output.write_features(rows, options, output)
        text = features_output.features_json(rows, options) if as_json else features_output.features_text(rows) + "\n"
        typer.echo(text, nl=False)


def _run(folder: Path, output: Path, options: Options, *, workers: int | None, quiet: bool, lines: bool) -> None:
    """Reconstruct a folder of images into a run folder, with progress on stderr and the summary on stdout."""
    from semscape.batch.folder_run import reconstruct_folder
    from semscape.report.console import StageLines, print_line, print_summary

    with StageLines(_console(err=True), quiet=not lines) as progress:
        result = reconstruct_folder(
            folder, output, options, workers=workers, progress=progress, on_series=progress.take_unit_of
        )
    if quiet:
        return
    for warning in (*result.report.failures, *result.report.warnings) if lines else ():
        print_line(f"warning: {warning}", _console(err=True), "yellow")
    console = _console()
    print_summary(result, console)
    print_line(f"report: {output / 'report.html'}", console)


def _simulate_into(
    folder: Path, specimen: str | None, microscope: SimulationOptions | None, seed: int | None
) -> TiltSeries:
    """Simulate a series and write it to a folder that is new, empty or an earlier simulation's."""
    from semscape.io.simulated import write_simulated_series
    from semscape.simulate import simulate as simulate_series

    given: dict[str, Any] = {} if specimen is None else {"specimen": specimen}
    given |= {} if seed is None else {"rng": seed}
    series, truth = simulate_series(options=microscope, **given)
    write_simulated_series(folder, series, truth)
    return series


def _console(*, err: bool = False) -> Console:
    from rich.console import Console

    stream = sys.stderr if err else sys.stdout
    # Where nobody looks at a window's width, a table takes what it needs.
    return Console(stderr=err, highlight=False, width=None if stream.isatty() else 160)
