"""Run a folder again and again, each time in a process that is killed: a program of its own for `test_faults`.

It runs once to have all code loaded, on one thread, and then forks: starting Python anew takes longer than a run. After
each kill the run goes on and must come to the bytes of the first, undisturbed one.
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

from run_products import QUICK, products, undrawn
from semscape.batch.folder_run import reconstruct_folder
from semscape.io.run_folder import RUN_FILES
from semscape.io.work_folder import LOG_NAME
from semscape.report import figures

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


def require_the_same(expected: dict[str, bytes], moment: str) -> None:
    """Go on with the run that was killed, compare what it makes with an undisturbed run, and clear it away."""
    assert ended(in_child()) == 0, moment
    different = [name for name, content in products(OUTPUT).items() if content != expected[name]]
    assert not different, f"killed {moment}: {different}"
    left = {path.name for path in OUTPUT.iterdir()} - {*RUN_FILES, LOG_NAME}
    assert not left, f"killed {moment}: {left}"
    shutil.rmtree(OUTPUT)


def main() -> None:
    figures.drawn_png = undrawn
    reconstruct_folder(FOLDER, OUTPUT, QUICK, workers=1)
    expected = products(OUTPUT)
    shutil.rmtree(OUTPUT)
    for stage in ("detect", "match", "calibrate", "surface", "mesh", "report"):
        assert ended(in_child(stage)) == -signal.SIGKILL, stage
        require_the_same(expected, f"before {stage}")
    for count in (1, 4, len(RUN_FILES) - 1):
        assert ended(in_child(renames=count)) == -signal.SIGKILL, count
        require_the_same(expected, f"with {count} files in place")

    start = time.perf_counter()
    require_the_same(expected, "not at all")
    seconds = time.perf_counter() - start
    moments = random.Random(5)
    n_killed = 0
    for _ in range(30):
        share = moments.uniform(0.0, 0.8)
        child = in_child()
        time.sleep(share * seconds)
        os.kill(child, signal.SIGKILL)
        if ended(child) == -signal.SIGKILL:
            n_killed += 1
        else:
            seconds *= 0.7  # it had ended before: the machine has less else to do than when the time was taken
        require_the_same(expected, f"after {share:.2f} of its time")
        if n_killed == 10:
            break
    assert n_killed == 10, n_killed

    for _ in range(5):  # again and again in one run, which gets on all the same
        child = in_child()
        time.sleep(moments.uniform(0.1, 0.4) * seconds)
        os.kill(child, signal.SIGKILL)
        ended(child)
    require_the_same(expected, "five times")


if __name__ == "__main__":
    main()
