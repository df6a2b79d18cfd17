"""Many specimens, and the installation itself: `batch` and `doctor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semscape.cli.application import DebugOption, LogJsonOption, OptionsOption, QuietOption, SetOption, app
from semscape.cli.outcome import console, exit_codes
from semscape.flags import effective_options


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
    memory_mb: Annotated[
        int | None, typer.Option(min=0, metavar="MB", help="Most memory of each; no limit if left out.")
    ] = None,
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
    with exit_codes(debug=debug, quiet=quiet, log_json=log_json):
        from semscape.batch.command import run_command
        from semscape.cluster import Placement

        options = effective_options(options_file, settings, None, None, None, None, None)
        placement = Placement(workers, threads, memory_mb or 0, scheduler, slurm)
        how = {"retry_failed": retry_failed, "verify": verify, "spread": spread}
        raise typer.Exit(run_command(manifest, output, options, placement, console(), quiet or log_json, **how))


@app.command("app", short_help="Open the page on this machine: drop images, see and measure the surface.")
def page(
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, metavar="N", help="Any that is free if left out.")
    ] = None,
    workspace: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of the runs; ~/semscape-runs if left out.")
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
    debug: DebugOption = False,
) -> None:
    """Serve the page of semscape to this machine's browser until Ctrl-C."""
    with exit_codes(debug=debug, quiet=False):
        from semscape.app.command import run_app

        run_app(workspace, port, open_browser=not no_browser, say=typer.echo, debug=debug)


@app.command(short_help="Show versions and resources, and test this installation.")
def doctor() -> None:
    """Print versions, cores, memory, BLAS and optional extras, and reconstruct a small simulated series."""
    from semscape.doctor import examine

    raise typer.Exit(examine(console()))
