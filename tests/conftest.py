"""Fixtures that every test may use."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from semscape.simulate import SimulationOptions, simulate

# A script of its own, which runs in a child process and is no module to collect.
collect_ignore = ["batch/killed_runs.py"]
# There is one in more than one folder, which the collection of doctests would take for one module.
collect_ignore_glob = ["*conftest.py"]

TINY = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=128, height_px=128)
SHARED_DATA_VARIABLE = "SEMSCAPE_SHARED_DATA"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of measured data by others, which is no part of the repository; skips where it is absent."""
    beside_repository = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get(SHARED_DATA_VARIABLE, beside_repository))
    if not folder.is_dir():
        pytest.skip(f"no measured data in {folder}; set {SHARED_DATA_VARIABLE} to the folder that holds it")
    return folder


@pytest.fixture(scope="session")
def master_images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from semscape.io.simulated import write_simulated_series

    folder = tmp_path_factory.mktemp("batch") / "images"
    return write_simulated_series(folder, *simulate("fracture", TINY, rng=1))


@pytest.fixture(scope="session")
def undisturbed(master_images: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    from run_products import QUICK, products
    from semscape.batch.folder_run import reconstruct_folder

    run = tmp_path_factory.mktemp("undisturbed") / "run"
    reconstruct_folder(master_images, run, QUICK, workers=1)
    return products(run)


@pytest.fixture
def images(master_images: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(master_images, tmp_path / "images"))


@pytest.fixture
def specimens(master_images: Path, tmp_path: Path) -> Path:
    """Return a folder of two good specimens and one that holds text."""
    root = tmp_path / "set"
    for name in ("first", "second"):
        shutil.copytree(master_images, root / name)
    (root / "third").mkdir()
    for name in ("a.tif", "b.tif"):
        (root / "third" / name).write_text("no image")
    return root
