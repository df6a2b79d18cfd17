"""Run a folder again and again, each time in a process that is killed: a program of its own for `test_faults`.

It runs once to have all code loaded, on one thread, and then forks: starting Python anew takes longer than a run.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

from run_products import QUICK
from semscape.batch.folder_run import reconstruct_folder
from semscape.io.run_folder import RUN_FILES

FOLDER, OUTPUT = (Path(argument) for argument in sys.argv[-2:])


def kill_me() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def in_child(stage: str = "", renames: int = 0) -> int:
    """Start a run in a child that kills itself where `stage` begins, or after so many files were put in place."""
    child = os.fork()
    if child:
        return child
    rename = Path.replace

    def counted(self: Path, target: Any) -> Any:
        nonlocal renames
        moved = rename(self, target)
        if Path(target).name in RUN_FILES:
            renames -= 1
            if renames == 0:
                kill_me()
        return moved

    Path.replace = counted  # type: ignore[method-assign]
    reconstruct_folder(
        FOLDER,
        OUTPUT,
        QUICK,
        workers=1,
        progress=lambda name, figures: kill_me() if name == stage and figures is None else None,
    )
    os._exit(0)


def ended(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main() -> None:
    reconstruct_folder(FOLDER, OUTPUT, QUICK, workers=1)
    shutil.rmtree(OUTPUT)
    for stage in ("detect", "match", "calibrate", "surface", "mesh", "report"):
        assert ended(in_child(stage)) == -signal.SIGKILL, stage
    for count in (1, 4, len(RUN_FILES) - 1):
        assert ended(in_child(renames=count)) == -signal.SIGKILL, count

    start = time.perf_counter()
    assert ended(in_child()) == 0
    assert ended(in_child()) == 0  # this one from the start, for the run before is complete
    seconds = time.perf_counter() - start
    moments = random.Random(5)
    n_killed = 0
    for _ in range(10):
        child = in_child()
        time.sleep(moments.uniform(0.0, 0.6 * seconds))
        os.kill(child, signal.SIGKILL)
        n_killed += ended(child) == -signal.SIGKILL
    assert n_killed >= 5, n_killed


if __name__ == "__main__":
    main()
