"""Learning which keypoints are worth matching: `dataset`, `train` and `validate`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from semscape.cli.application import DebugOption, SeedOption, app
from semscape.cli.outcome import exit_codes
from semscape.flags import effective_options

DatasetArguments = Annotated[list[Path], typer.Argument(help="Files of semscape dataset.", metavar="DATASET...")]
TraitsOption = Annotated[
    str | None, typer.Option(metavar="LIST", help="Groups of traits, like detector,local,margin; sift: the descriptor.")
]
RowsOption = Annotated[int | None, typer.Option(min=100, metavar="N", help="Most keypoints of a group, drawn.")]
OutputOption = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="File to write.")]


@app.command(short_help="Label the keypoints of groups of images, to learn from.")
def dataset(
    output: OutputOption,
    folders: Annotated[
        list[Path] | None, typer.Argument(help="Folders, one per specimen.", metavar="GROUP_FOLDER...")
    ] = None,
    every_image: Annotated[
        bool, typer.Option("--every-image", help="Label every image of a group, not one drawn at random.")
    ] = False,
    simulated: Annotated[int | None, typer.Option(min=0, metavar="N", help="Add N simulated groups.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", metavar="STAGE.KEY=VALUE", help="Option.")] = None,
    seed: SeedOption = None,
    debug: DebugOption = False,
) -> None:
    """Label keypoints: significant is what has a verified correspondence in another image of its group."""
    with exit_codes(debug=debug, quiet=False):
        from semscape.learning.run import counts_text, make_dataset

        options = effective_options(None, settings, None, None, None, seed, None)
        made = make_dataset(
            folders or [], output, options, every_image=every_image, n_simulated=simulated or 0,
            progress=lambda name: typer.echo(f"{name} ...", err=True),
        )  # fmt: skip
        typer.echo(counts_text(made), nl=False)


@app.command(short_help="Train a model that tells which keypoints are worth matching.")
def train(
    datasets: DatasetArguments,
    output: OutputOption,
    classifier: Annotated[str | None, typer.Option(metavar="NAME", help="blend if left out.")] = None,
    traits: TraitsOption = None,
    rows: RowsOption = None,
    seed: SeedOption = None,
    debug: DebugOption = False,
) -> None:
    """Train on datasets, and write a model for --set features.significance.model=FILE."""
    with exit_codes(debug=debug, quiet=False):
        from semscape.learning.run import read_datasets, train_model, write_model

        given: dict[str, Any] = {"classifier": classifier, "traits": _names(traits), "rows_per_group": rows}
        known = {key: value for key, value in given.items() if value is not None}
        model = train_model(read_datasets(datasets), seed=seed or 0, **known)
        size = write_model(model, output)
        typer.echo(f"{output}: {size / 1000:.0f} kB, trained on {model.origin['keypoints']} keypoints")


@app.command("validate", short_help="Validate classifiers of keypoints on specimens left out of training.")
def validate_classifiers(
    datasets: DatasetArguments,
    classifier: Annotated[str | None, typer.Option(metavar="LIST", help="All six if left out.")] = None,
    traits: TraitsOption = None,
    rows: RowsOption = None,
    seed: SeedOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    debug: DebugOption = False,
) -> None:
    """Print the validation summary: pooled ten folds, which leak, and each specimen left out, which is honest."""
    with exit_codes(debug=debug, quiet=False):
        from semscape.io.run_folder import json_text
        from semscape.learning.run import read_datasets, validation_rows, validation_text

        given: dict[str, Any] = {"classifiers": _names(classifier), "traits": _names(traits)}
        known = {key: value for key, value in (given | {"rows_per_group": rows}).items() if value is not None}
        found = validation_rows(read_datasets(datasets), seed=seed or 0, **known)
        text = json_text({"rows": [asdict(row) for row in found]}) if as_json else validation_text(found)
        typer.echo(text, nl=False)


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(name.strip() for name in text.split(","))
