"""Keypoints: `compare-features`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semscape.cli.application import DebugOption, FolderArgument, OptionsOption, SeedOption, SetOption, app
from semscape.cli.outcome import exit_codes
from semscape.flags import effective_options


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
    with exit_codes(debug=debug, quiet=False):
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
