"""What a batch costs: specimens per hour with 1 and 2 workers, overhead per specimen, 10,000 tasks that do nothing.

And what one series of many views costs, with all pairs and with some. CPU seconds stand beside those of the clock, for
they tell something on a machine that does other work too.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from isolated import Case, run_cases
from semscape.batch.folder_run import reconstruct_folder
from semscape.batch.manifest import find_specimens
from semscape.batch.record import Ending
from semscape.batch.run import run_batch
from semscape.cluster import Placement, open_executor
from semscape.cluster.processes import worker_environment
from semscape.io.simulated import write_simulated_series
from semscape.options import Options
from semscape.pipeline import reconstruct
from semscape.simulate import SimulationOptions, simulate

_MICROSCOPE = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=256, height_px=256)
_N_SPECIMENS = 8
_N_EMPTY = 10_000
_MANY_VIEWS = (10, 20, 40, 60)
_QUICK_SEARCH = [
    *("sfm.de_generations=1", "sfm.de_population_per_variable=2", "sfm.max_iterations=5"),
    *("dense.max_pairs=1", "dense.mesh_max_vertices=2000"),
]


class _Nobody:
    def event(self, name: str, stage: str) -> None:
        pass

    def ended(self, ending: Ending) -> None:
        pass


def throughput() -> dict[str, Any]:
    """Run the same specimens with one worker and with two, each after a first round that loads the code."""
    rows: dict[str, Any] = {"cores": os.cpu_count(), "n_specimens": _N_SPECIMENS}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "set"
        for i in range(_N_SPECIMENS):
            write_simulated_series(root / f"s{i:02}", *simulate("fracture", _MICROSCOPE, rng=i))
        for workers in (1, 2):
            output = Path(folder) / f"out{workers}"
            cpu = _children_cpu_seconds()
            with open_executor(Placement(workers=workers, threads=1)) as executor:
                warm = find_specimens(root, output)[:workers]
                run_batch(warm, Path(folder) / f"warm{workers}", Options(), executor, _Nobody())
                start = time.perf_counter()
                endings = run_batch(find_specimens(root, output), output, Options(), executor, _Nobody())
                seconds = time.perf_counter() - start
                start = time.perf_counter()
                run_batch(find_specimens(root, output), output, Options(), executor, _Nobody())
                kept = time.perf_counter() - start
            cpu = _children_cpu_seconds() - cpu
            busy = sum(ending.record.seconds for ending in endings)
            staged = sum(sum(ending.record.report["stages"].values()) for ending in endings)
            rows[f"workers_{workers}"] = {
                "load_of_the_machine": round(os.getloadavg()[0], 1),
                "specimens_per_hour": round(3600 * _N_SPECIMENS / seconds),
                "seconds_per_specimen": round(busy / _N_SPECIMENS, 3),
                "cpu_seconds_per_specimen": round(cpu / (_N_SPECIMENS + workers), 3),
                "stage_seconds_per_specimen": round(staged / _N_SPECIMENS, 3),
                "executor_ms_per_specimen": round(1000 * (workers * seconds - busy) / _N_SPECIMENS, 1),
                "kept_ms_per_specimen": round(1000 * kept / _N_SPECIMENS, 1),
                "bytes_sent_per_specimen": round(sum(ending.n_bytes for ending in endings) / _N_SPECIMENS),
            }
    rows["speedup_of_2_workers"] = round(
        rows["workers_2"]["specimens_per_hour"] / rows["workers_1"]["specimens_per_hour"], 2
    )
    return rows


def _children_cpu_seconds() -> float:
    """Return the CPU time of all processes that were started here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def stage_table(width_px: int, height_px: int) -> dict[str, Any]:
    """Reconstruct one specimen on one thread, twice, and tell the CPU seconds of each stage of the second time."""
    microscope = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=width_px, height_px=height_px)
    begun: dict[str, float] = {}

    def note(stage: str, figures: Any) -> None:
        if figures is None:
            begun[stage] = time.process_time()

    with tempfile.TemporaryDirectory() as folder:
        images = write_simulated_series(Path(folder) / "images", *simulate("fracture", microscope, rng=1))
        small = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=128, height_px=128)
        warm = write_simulated_series(Path(folder) / "warm", *simulate("fracture", small, rng=1))
        reconstruct_folder(warm, Path(folder) / "run-warm", Options(), workers=1)  # loads and compiles the code
        start, clock = time.process_time(), time.perf_counter()
        found = reconstruct_folder(images, Path(folder) / "run", Options(), workers=1, progress=note)
        end, clock = time.process_time(), time.perf_counter() - clock
        bytes_read = sum(path.stat().st_size for path in images.iterdir() if path.suffix == ".tif")
        bytes_written = sum(path.stat().st_size for path in (Path(folder) / "run").iterdir())
    moments = [start, *begun.values(), end]
    seconds = [round(after - before, 2) for before, after in itertools.pairwise(moments)]
    return {
        "cpu_seconds": dict(zip(["load", *begun], seconds, strict=True)),
        "cpu_seconds_in_all": round(end - start, 2),
        "clock_seconds_in_all": round(clock, 2),
        "peak_memory_mb": round(found.report.peak_memory_mb),
        "mb_read": round(bytes_read / 1e6, 1),
        "mb_written": round(bytes_written / 1e6, 1),
    }


def many_views(n_views: int) -> dict[str, Any]:
    """Match a series of many views, all pairs and neighbours with loops, and compare times and tilts."""
    tilts = tuple(np.linspace(-15.0, 15.0, n_views))
    series, truth = simulate("fracture", SimulationOptions(tilts_deg=tilts, width_px=192, height_px=192), rng=1)
    rows: dict[str, Any] = {}
    for reach in (0, 3):
        options = Options().with_settings([*_QUICK_SEARCH, f"features.pair_reach={reach}"])
        start = time.process_time()
        found = reconstruct(series, options, workers=1)
        seconds = {stage.name: stage.seconds for stage in found.report.stages}
        error = np.rad2deg(found.reconstruction.motion.tilt_rad - truth.motion.tilt_rad)
        rows["all_pairs" if reach == 0 else f"reach_{reach}"] = {
            "pairs": len(found.geometries),
            "match_s": round(seconds["match"], 2),
            "all_stages_s": round(sum(seconds.values()), 2),
            "all_stages_cpu_s": round(time.process_time() - start, 2),
            "tilt_rms_error_deg": round(float(np.sqrt(np.mean(error**2))), 3),
        }
    return rows


def empty_tasks_on_processes() -> dict[str, Any]:
    """Time 10,000 tasks that do nothing on two local processes."""
    with open_executor(Placement(workers=2, threads=1)) as executor:
        return _empty_tasks(executor)


def empty_tasks_on_dask() -> dict[str, Any]:
    """Time 10,000 tasks that do nothing on a Dask scheduler with two workers."""
    with _dask() as address, open_executor(Placement(scheduler=address)) as executor:
        return _empty_tasks(executor)


def _empty_tasks(executor: Any) -> dict[str, Any]:
    list(executor.run(abs, range(executor.workers)))
    start = time.perf_counter()
    n_done = sum(outcome.error is None for outcome in executor.run(abs, range(_N_EMPTY)))
    seconds = time.perf_counter() - start
    return {"n": n_done, "seconds": round(seconds, 2), "ms_per_task": round(1000 * seconds / _N_EMPTY, 3)}


@contextlib.contextmanager
def _dask() -> Iterator[str]:
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        information = Path(folder) / "scheduler.json"

        def start(*arguments: str) -> None:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments, "--no-dashboard", "--scheduler-file", str(information)],
                stderr=subprocess.DEVNULL,
                env=worker_environment(1),
            )
            stack.callback(process.wait)
            stack.callback(process.kill)

        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-show")
        for _ in range(2):
            start("worker", "--nthreads", "1", "--no-nanny")
        while not (information.exists() and information.stat().st_size):
            time.sleep(0.1)
        address = json.loads(information.read_text(encoding="utf-8"))["address"]
        import distributed

        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield address


CASES: dict[str, Case] = {
    "throughput": (throughput, ()),
    "empty-tasks-on-processes": (empty_tasks_on_processes, ()),
    "empty-tasks-on-dask": (empty_tasks_on_dask, ()),
    "stages-256x256": (stage_table, (256, 256)),
    "stages-1024x768": (stage_table, (1024, 768)),
    **{f"views-{n}": (many_views, (n,)) for n in _MANY_VIEWS},
}

if __name__ == "__main__":
    run_cases(CASES, __doc__ or "")
