"""What `semscape doctor` says: versions, resources, extras, and whether a small reconstruction comes out right."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from rich.console import Console

from semscape.cluster.choice import usable_cores
from semscape.options import Options
from semscape.report.console import print_line

_PACKAGES = ("semscape", "numpy", "scipy", "opencv-contrib-python-headless", "numba", "mahotas", "tifffile", "trimesh")
_EXTRAS = {"app": ("fastapi", "uvicorn"), "cluster": ("dask", "distributed", "dask-jobqueue")}
_MOST_HEIGHT_ERROR = 0.15
_SEED = 0


def examine(console: Console) -> int:
    """Print what there is and test it; return the exit code, 0 where the self-test is right, else 1."""
    for name, text in facts():
        print_line(f"{name + ':':<14} {text}", console)
    print_line(f"{'self-test:':<14} a simulated series of three views ...", console)
    start = time.perf_counter()
    error = self_test()
    seconds = time.perf_counter() - start
    good = error <= _MOST_HEIGHT_ERROR
    said = f"median height error {100 * error:.1f} % of the relief, {seconds:.1f} s"
    advice = "" if good else f" (at most {100 * _MOST_HEIGHT_ERROR:.0f} % expected): install semscape again"
    print_line(f"{'result:':<14} {'good' if good else 'WRONG'}, {said}{advice}", console, "green" if good else "red")
    return 0 if good else 1


def facts() -> Iterator[tuple[str, str]]:
    """Yield name and text of everything that is worth knowing when something does not work."""
    yield "system", f"{platform.system()} {platform.release()}, {platform.machine()}"
    yield "python", f"{platform.python_version()} ({sys.executable})"
    for package in _PACKAGES:
        yield package.partition("-")[0], _version(package)
    yield "cores", f"{usable_cores()} usable of {os.cpu_count()}"
    yield "memory", _memory()
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    yield "BLAS", f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip()
    for extra, packages in _EXTRAS.items():
        yield f"extra {extra}", ", ".join(f"{package} {_version(package)}" for package in packages)


def self_test() -> float:
    """Reconstruct a small simulated series; return the median height error over the standard deviation of the truth."""
    from semscape.pipeline import reconstruct
    from semscape.simulate import SimulationOptions, simulate

    microscope = replace(SimulationOptions(), tilts_deg=(-10.0, 0.0, 10.0), width_px=192, height_px=192)
    series, truth = simulate("pollen", microscope, rng=_SEED)
    found = reconstruct(series, Options(), rng=_SEED).height_map.height_um
    known = np.isfinite(found) & np.isfinite(truth.height_um)
    error = found[known] - truth.height_um[known]
    return float(np.median(np.abs(error - np.median(error))) / np.std(truth.height_um[known]))


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _memory() -> str:
    try:
        page = os.sysconf("SC_PAGE_SIZE")
        total, free = os.sysconf("SC_PHYS_PAGES") * page, os.sysconf("SC_AVPHYS_PAGES") * page
    except (AttributeError, ValueError, OSError):  # Windows
        return "unknown"
    return f"{total / 1e9:.1f} GB, {free / 1e9:.1f} GB of it free"
