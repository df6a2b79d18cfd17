"""Simulated series and what they tell: `simulate`, `demo`, `evaluate` and `experiments`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from semscape.cli.application import DebugOption, PixelSizeOption, QuietOption, SeedOption, WorkersOption, app
from semscape.cli.outcome import exit_codes
from semscape.cli.surface import run_into
from semscape.flags import effective_options, simulation_options

if TYPE_CHECKING:
    from semscape.simulate import SimulationOptions
    from semscape.types import TiltSeries


@app.command(short_help="Simulate a tilt series with its exact truth.")
def simulate(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the images.", metavar="FOLDER")],
    specimen: Annotated[
        str | None,
        typer.Argument(
            help="Built in: fracture, spheres, grating, vickers, scratches, pollen or face; or a file of your own in "
            "um, z up: a mesh (ply, obj, stl, off, glb) or a height map (npz, float tif).",
            metavar="SPECIMEN",
        ),
    ] = None,
    preset: Annotated[str | None, typer.Option(metavar="NAME", help="Microscope: ideal, nominal or hard.")] = None,
    tilts: Annotated[str | None, typer.Option(help="Stage tilts in deg, like -6,-3,0,3,6.", metavar="LIST")] = None,
    views: Annotated[int | None, typer.Option(min=2, metavar="N", help="Number of views about zero tilt.")] = None,
    step: Annotated[float | None, typer.Option(metavar="DEG", help="Tilt step between views in deg.")] = None,
    size: Annotated[
        str | None, typer.Option(metavar="SIZE", help="Size of the images in px, like 512 or 640x480.")
    ] = None,
    dose: Annotated[float | None, typer.Option(min=0, metavar="N", help="Electrons per pixel, 0 for no noise.")] = None,
    detector: Annotated[str | None, typer.Option(metavar="NAME", help="Detector: se, bse-3 or bse-4.")] = None,
    pixel_size_um: PixelSizeOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="A strength, like drift_px=0.5 or charging=0; may be repeated."
        ),
    ] = None,
    seed: SeedOption = None,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> None:
    """Simulate a tilt series of a specimen, with its exact truth in truth.json.

    A specimen of your own fills the image, unless the pixel size is given.
    """
    with exit_codes(debug=debug, quiet=quiet):
        given = {"dose": dose, "detector": detector, "pixel_size_um": pixel_size_um}
        microscope = simulation_options(preset, tilts, views, step, size, settings, **given)
        fit = pixel_size_um is None and not any(item.startswith("pixel_size_um") for item in settings or [])
        series = simulate_into(output, specimen, microscope, seed, fit=fit)
        if not quiet:
            typer.echo(f"{series.n_views} views in {output}; try: semscape reconstruct {output} -o {output}-run")


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
    with exit_codes(debug=debug, quiet=quiet):
        folder = Path("semscape-demo") if output is None else output
        if not quiet:
            typer.echo(f"simulating a tilt series in {folder / 'images'}", err=True)
        simulate_into(folder / "images", None, None, seed)
        options = effective_options(None, None, None, None, None, seed, None)
        run_into(folder / "images", folder / "run", options, workers=workers, quiet=quiet, lines=not quiet)


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
    with exit_codes(debug=debug, quiet=False):
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
    with exit_codes(debug=debug, quiet=False):
        from semscape.experiments.page import write_experiments
        from semscape.experiments.registry import run_experiments
        from semscape.experiments.study import Setting

        given = {} if seed is None else {"seed": seed}
        setting = Setting(data=data, workers=workers, quick=quick, **given)
        done = run_experiments(name, setting, progress=lambda text: typer.echo(text, err=True))
        typer.echo(f"page: {write_experiments(done, setting, output)}")


def simulate_into(
    folder: Path, specimen: str | None, microscope: SimulationOptions | None, seed: int | None, *, fit: bool = False
) -> TiltSeries:
    """Simulate a series and write it to a folder that is new, empty or an earlier simulation's.

    With `fit` a specimen from a file is magnified until it fills the image.
    """
    from semscape.io.simulated import require_own, write_simulated_series
    from semscape.io.specimens import read_surface
    from semscape.simulate import acquire, fit_pixel_size, specimen_from_surface

    require_own(folder)  # before the work, not after it
    given: dict[str, Any] = {} if specimen is None else {"specimen": specimen}
    given |= {} if seed is None else {"rng": seed}
    if specimen is not None and Path(specimen).suffix:  # no built-in name has a dot
        own = specimen_from_surface(Path(specimen).name, read_surface(specimen), texture_seed=seed or 0)
        microscope = fit_pixel_size(microscope, own) if fit and microscope is not None else microscope
        given["specimen"] = own
    acquisition = acquire(options=microscope, **given)
    write_simulated_series(folder, acquisition.series, acquisition.truth, acquisition.segments)
    return acquisition.series
