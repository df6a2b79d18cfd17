"""The application itself, and the flags that several commands share."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

_UsageError: Any = typer.BadParameter.__base__

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


def main() -> None:
    """Run the command line."""
    log_json = "--log-json" in sys.argv[1:]
    try:
        sys.exit(app(standalone_mode=not log_json))
    except _UsageError as error:  # not parsed so far, but what is told must be JSON already
        from semscape.cli.outcome import log_error, start_log

        start_log(debug=False, quiet=False, log_json=True)
        log_error(error.format_message(), error.exit_code)
        sys.exit(error.exit_code)


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
