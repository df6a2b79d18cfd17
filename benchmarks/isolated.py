"""Run each case of a benchmark in a process of its own, so that its peak memory is its own.

Import nothing heavy here: on Linux a process inherits the peak of the one that started it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parent.parent
SHARED_DATA_VARIABLE = "SEMSCAPE_SHARED_DATA"
REAL_SETS = ("potamogeton1", "quartz", "dsa")

Measure = Callable[..., dict[str, Any]]
Case = tuple[Measure, tuple[Any, ...]]


def real_set_folder(name: str) -> Path:
    """Return where a measured tilt series lies, whether it is there or not."""
    beside_repository = REPOSITORY.parent / "shared" / "data"
    return Path(os.environ.get(SHARED_DATA_VARIABLE, beside_repository)) / "tilt_series" / name


def absent(name: str) -> str | None:
    """Return why a real set cannot be measured, None where it can."""
    if real_set_folder(name).is_dir():
        return None
    return f"no measured series {name} beside the repository; set {SHARED_DATA_VARIABLE} to the folder of the data"


def run_cases(cases: Mapping[str, Case], description: str) -> None:
    """Print the JSON table of all cases; with `--case NAME` measure that one in this process.

    Cases named on the command line alone are measured; a case that fails is a line with its error.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"cases; all where left out: {', '.join(cases)}")
    parser.add_argument("--case", choices=cases, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(cases))
    if unknown:
        parser.error(f"no case {unknown[0]!r}; there are: {', '.join(cases)}")
    if arguments.case:
        measure, given = cases[arguments.case]
        print(json.dumps(measure(*given)))
        return
    table = {}
    for name in arguments.names or cases:
        measured = name.removeprefix("disjoint-")
        reason = absent(measured) if measured in REAL_SETS else None
        print(f"{name}: {'skipped' if reason else 'measuring'}", file=sys.stderr)
        table[name] = {"skipped": reason} if reason else _in_own_process(name)
    print(_indented(table))
    if any("error" in row for row in table.values()):
        sys.exit(1)


def peak_memory_mb() -> float:
    """Return the most memory that this process has held so far, in MB; NaN where the system does not tell."""
    from semscape.report.memory import peak_memory_mb as peak

    return peak()


def timed(function: Callable[..., Any], *given: Any, **named: Any) -> tuple[Any, float]:
    """Call a function and return its result with the wall seconds."""
    start = time.perf_counter()
    result = function(*given, **named)
    return result, time.perf_counter() - start


def _in_own_process(name: str) -> dict[str, Any]:
    ended = subprocess.run(
        [sys.executable, sys.argv[0], "--case", name], stdout=subprocess.PIPE, text=True, check=False
    )
    if ended.returncode:
        return {"error": f"exit code {ended.returncode}"}
    row: dict[str, Any] = json.loads(ended.stdout)
    return row


def _indented(value: Any, indent: str = "") -> str:
    """Return JSON with an item a line, but lists of plain values on one line."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        return (
            "{\n"
            + ",\n".join(f"{inner}{json.dumps(k)}: {_indented(v, inner)}" for k, v in value.items())
            + f"\n{indent}}}"
        )
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(f"{inner}{_indented(item, inner)}" for item in value) + f"\n{indent}]"
    return json.dumps(value)
