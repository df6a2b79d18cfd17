"""A full object's run survives what a surface's run survives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from semscape.batch import full_object_run
from semscape.batch.full_object_run import reconstruct_object_folder
from semscape.errors import OutOfMemoryError, StorageError
from semscape.io.run_folder import WORK_NAME, put_files
from semscape.options import Options


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Put a quick stand-in in the place of the computation; what stands in the list is called in it."""
    calls: list[Any] = []

    def reconstruct(*_: Any, progress: Any, **__: Any) -> Any:
        progress("surface", None)
        for call in calls:
            call()
        return "found", (), ()

    def write(_: Any, __: Any, ___: Any, ____: Any, folder: Path) -> None:
        put_files(
            {"merged.ply": b"1", "height_map_00.npz": b"2", "options.toml": b"", "reconstruction.json": b"{}"}, folder
        )
        put_files({"report.html": b"", "report.json": b"{}"}, folder)

    monkeypatch.setattr(full_object_run, "reconstruct_full_object", reconstruct)
    monkeypatch.setattr(full_object_run, "write_full_object", write)
    return calls


def test_inputs_that_change_are_noticed(images: Path, tmp_path: Path, stages: list[Any]) -> None:
    stages.append(next(images.glob("*.tif")).unlink)
    with pytest.raises(StorageError, match="vanished while"):
        reconstruct_object_folder(images, tmp_path / "run", Options())
    assert not (tmp_path / "run" / "report.json").exists()


def test_a_lack_of_memory_names_the_stage(images: Path, tmp_path: Path, stages: list[Any]) -> None:
    def lack() -> None:
        raise MemoryError

    stages.append(lack)
    with pytest.raises(OutOfMemoryError, match=r"out of memory in stage surface; .*dense\.tile_px=512"):
        reconstruct_object_folder(images, tmp_path / "run", Options())


def test_killed_between_its_files_it_can_be_run_again(images: Path, tmp_path: Path, stages: list[Any]) -> None:
    output = tmp_path / "run"
    (output / WORK_NAME).mkdir(parents=True)
    (output / "merged.ply").touch()
    (output / "height_map_00.npz").touch()
    reconstruct_object_folder(images, output, Options())
    assert (output / "merged.ply").read_bytes() == b"1"
    assert not (output / WORK_NAME).exists()
    (output / "report.json").unlink()
    with pytest.raises(StorageError, match="is not an earlier run"):  # now they are somebody's
        reconstruct_object_folder(images, output, Options())
