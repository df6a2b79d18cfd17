"""The limits of the app, and where its runs are."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AppOptions:
    """`semscape app`, no stage of a run: the folder of the runs, what a browser may send, how many are made at once."""

    workspace: str = "~/semscape-runs"
    max_file_mb: int = 1_000
    max_files: int = 400
    max_run_mb: int = 20_000
    runs_at_once: int = 1
