"""Kernels whose cache on disk several processes fill at once."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba.core.caching import CompileResultCacheImpl

from semscape.cluster.processes import worker_environment
from semscape.compiled import FilePerType

_KERNEL = """
import sys
import numpy as np
from semscape.compiled import njit

@njit(cache=True)
def first(values):
    return values[0, 1]

if __name__ == "__main__":
    print(first(np.arange(6, dtype=sys.argv[1]).reshape(2, 3, order=sys.argv[2])), len(first.stats.cache_hits))
"""


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def in_another_process(path: Path, of_type: str, order: str) -> str:
    command = [sys.executable, path, of_type, order]
    return subprocess.run(command, env=worker_environment(1), check=True, capture_output=True, text=True).stdout


@pytest.fixture
def kernel_file(tmp_path: Path) -> Path:
    path = tmp_path / f"kernel_of_{tmp_path.name}.py"
    path.write_text(_KERNEL, encoding="utf-8")
    return path


def test_two_types_that_two_processes_compile_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both look, both find nothing; one has written an index, if there is one, when the other writes all of its own."""
    one, other, third = (FilePerType(str(tmp_path), "kernel", "as of today") for _ in range(3))
    mine, others = (("float64",), "x86", "code"), (("float32",), "x86", "code")
    write = one._save_data

    def late(name: str, data: object) -> None:
        other.save(others, "machine code for float32")
        write(name, data)

    monkeypatch.setattr(other, "_load_index", dict)
    monkeypatch.setattr(one, "_save_data", late)
    one.save(mine, "machine code for float64")
    assert third.load(others) == "machine code for float32"
    assert third.load(mine) == "machine code for float64"
    assert third.load((("float64",), "another processor", "code")) is None


def test_other_processes_find_what_was_compiled(kernel_file: Path) -> None:
    for hits in (0, 1):
        assert in_another_process(kernel_file, "f8", "C") == f"1.0 {hits}\n"
        assert in_another_process(kernel_file, "f8", "F") == f"2.0 {hits}\n"
        assert in_another_process(kernel_file, "f4", "C") == f"1.0 {hits}\n"


@pytest.mark.parametrize("left", [0, 10, 1000])
def test_half_a_file_is_compiled_again(kernel_file: Path, left: int) -> None:
    assert in_another_process(kernel_file, "f8", "C") == "1.0 0\n"
    (path,) = kernel_file.parent.rglob("*.nbc")
    whole = path.read_bytes()
    path.write_bytes(whole[:left])
    assert in_another_process(kernel_file, "f8", "C") == "1.0 0\n"
    assert in_another_process(kernel_file, "f8", "C") == "1.0 1\n"


def test_changed_code_is_compiled_again_into_the_same_file(kernel_file: Path) -> None:
    assert in_another_process(kernel_file, "f8", "C") == "1.0 0\n"
    kernel_file.write_text(_KERNEL.replace("[0, 1]", "[0, 2] "), encoding="utf-8")
    assert in_another_process(kernel_file, "f8", "C") == "2.0 0\n"
    assert len(list(kernel_file.parent.rglob("*.nbc"))) == 1


def test_a_cache_that_cannot_be_written_is_none(kernel_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: FilePerType, name: str, data: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(FilePerType, "_save_data", full)
    assert loaded(kernel_file).first(np.arange(6.0).reshape(2, 3)) == 1.0


def test_where_no_folder_can_be_written_there_is_no_cache(kernel_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container whose files are read-only."""
    monkeypatch.setattr(CompileResultCacheImpl, "_locator_classes", [])
    assert loaded(kernel_file).first(np.arange(6.0).reshape(2, 3)) == 1.0
    assert not list(kernel_file.parent.rglob("*.nbc"))
