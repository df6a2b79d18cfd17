"""The body of `semscape batch`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rich.console import Console

from semscape.batch.manifest import find_specimens
from semscape.batch.record import RECORDS_NAME
from semscape.batch.run import run_batch
from semscape.batch.table import BatchTable
from semscape.cluster import Placement, open_executor
from semscape.errors import BadInputError
from semscape.options import Options
from semscape.report.console import print_line

_SOME_FAILED = 1


def run_command(
    manifest: Path,
    output: Path,
    options: Options,
    placement: Placement,
    console: Console,
    quiet: bool,
    *,
    retry_failed: bool,
    verify: bool,
    spread: bool,
) -> int:
    """Run a batch as the command line asks for it and return the exit code.

    Raises
    ------
    BadInputError
        If the manifest, the folder or the cluster cannot be used.
    """
    specimens = find_specimens(manifest, output)
    if spread and placement.workers == 0:
        raise BadInputError("--spread needs workers to spread over; leave out --workers 0")
    table = BatchTable(console, len(specimens), quiet=quiet)
    with open_executor(replace(placement, logs=output / RECORDS_NAME)) as executor, table:
        endings = run_batch(
            specimens,
            output,
            options,
            executor,
            table,
            retry_failed=retry_failed,
            verify=verify,
            spread=spread,
        )
    failed = [ending.record for ending in endings if ending.record.state == "failed"]
    if not quiet:
        print_line(table.closing_line(), console)
        for record in failed:
            print_line(f"failed: {record.name}: {record.reason}", console, "red")
        print_line(f"summary: {output / 'summary.html'}", console)
    return _SOME_FAILED if failed else 0
