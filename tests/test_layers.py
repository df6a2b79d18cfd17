"""The walls of the house: which module may import which, who opens files, what an import costs."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import semscape

PACKAGE = Path(semscape.__file__).parent
MODULES = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))

LAYERS = {
    "types": 0,
    "errors": 0,
    "options": 0,
    "geometry": 1,
    "io": 1,
    "simulate": 1,
    "robust": 2,
    "features": 2,
    "sfm": 3,
    "dense": 4,
    "metrology": 4,
    "evaluate": 5,
    "report": 5,
    "learning": 5,
    "cluster": 5,
    "pipeline": 6,
    "experiments": 7,
    "flags": 8,
    "log_lines": 0,
    "compiled": 0,
    "exit_codes": 8,
    "batch": 8,
    "doctor": 8,
    "cli": 8,
    "app": 8,
    "__main__": 9,
    "__init__": 9,
}
# Beside its own layer's own package, and all layers below.
SIDEWAYS = {
    ("io", "geometry"),  # the run folder states each view's rotation matrix, in the one convention there is
    ("simulate", "geometry"),
    ("cli", "flags"),
    ("cli", "exit_codes"),
    ("cli", "batch"),
    ("cli", "doctor"),
    ("batch", "flags"),
    ("app", "batch"),
    ("cli", "app"),
    ("options", "errors"),
}
# A renderer that shares matching or triangulation code with the pipeline cannot falsify it.
SIMULATE_MAY_IMPORT = {"types", "errors", "compiled", "geometry", "simulate"}
OPENS_FILES = {"io", "report", "experiments", "app", "cli", "flags", "batch"}
IMPORTS_CV2 = {"features", "dense"}
FORBIDDEN_NAMES = {"utils", "util", "helpers", "helper", "common", "base", "manager", "misc"}
FILE_CALLS = {
    "open", "read_text", "read_bytes", "write_text", "write_bytes", "imread", "imwrite", "mkdir", "unlink", "load",
    "save", "savez", "savez_compressed", "savetxt", "loadtxt", "tofile", "fromfile",
}  # fmt: skip
HEAVY = ("numba", "cv2", "scipy", "matplotlib", "sklearn", "trimesh", "tifffile", "PIL", "dask")
MOST_MODULES_LOADED = 120


def part(module: Path) -> str:
    """Return the part of the package that a file belongs to: its folder, or its own name."""
    return module.parts[0].removesuffix(".py")


def tree(module: Path) -> ast.Module:
    return ast.parse((PACKAGE / module).read_text(encoding="utf-8"))


def imported(module: Path) -> Iterator[str]:
    """Yield the dotted name of everything a file imports, wherever in it the import stands."""
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            yield node.module or ""
            if node.module == "semscape":
                yield from (f"semscape.{alias.name}" for alias in node.names)


def imported_parts(module: Path) -> set[str]:
    names = {name.split(".")[1] for name in imported(module) if name.startswith("semscape.")}
    return {name for name in names if name in LAYERS}


def calls(module: Path) -> Iterator[tuple[str, int]]:
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name):
                yield node.func.id, node.lineno
            elif isinstance(node.func, ast.Attribute):
                yield node.func.attr, node.lineno


def test_every_part_has_a_layer() -> None:
    assert len(MODULES) > 30
    assert {part(module) for module in MODULES} <= set(LAYERS)


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_imports_point_down(module: Path) -> None:
    own = part(module)
    if own == "__init__":
        return  # the door: it names what users call
    for other in imported_parts(module) - {own}:
        assert LAYERS[other] < LAYERS[own] or (own, other) in SIDEWAYS, f"{module} imports semscape.{other}"


def test_the_renderer_shares_nothing_with_what_it_tests() -> None:
    for module in MODULES:
        if part(module) == "simulate":
            assert imported_parts(module) <= SIMULATE_MAY_IMPORT, module


def test_reading_files_needs_no_stage() -> None:
    for module in MODULES:
        if part(module) == "io":
            assert imported_parts(module) <= {"types", "errors", "options", "io", "geometry"}, module


def test_only_the_pipeline_knows_the_order() -> None:
    """Detection and the dense stage meet in no other module."""
    meet = [module for module in MODULES if {"features", "dense"} <= imported_parts(module)]
    assert meet == [Path("pipeline.py")]


def test_opencv_is_in_features_and_dense_alone() -> None:
    users = {part(module) for module in MODULES if any(name.split(".")[0] == "cv2" for name in imported(module))}
    assert users == IMPORTS_CV2


def test_opencv_random_state_and_ransac_are_not_used() -> None:
    banned = {"setRNGSeed", "findFundamentalMat", "findEssentialMat", "findHomography", "recoverPose", "kmeans"}
    for module in MODULES:
        used = {name for name, _ in calls(module)} & banned
        assert not used, f"{module}: cv2.{used}"


def test_only_the_outer_parts_open_files() -> None:
    for module in MODULES:
        if part(module) not in OPENS_FILES:
            opened = [(name, line) for name, line in calls(module) if name in FILE_CALLS]
            assert not opened, f"{module}: {opened}"


def test_nothing_prints() -> None:
    for module in MODULES:
        assert not [line for node in ast.walk(tree(module)) for line in _print_lines(node)], module


def _print_lines(node: ast.AST) -> list[int]:
    # rich's console.print is the console's own business, and lives in report and cli.
    is_print = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in {"print", "pprint"}
    return [node.lineno] if is_print else []  # type: ignore[attr-defined]


def test_no_module_has_a_name_that_means_nothing() -> None:
    names = {name.removesuffix(".py") for module in MODULES for name in module.parts}
    assert not names & FORBIDDEN_NAMES
    assert not [name for name in names if name.endswith(("_utils", "_helpers", "_manager", "_base"))]


def test_modules_read_in_one_sitting() -> None:
    """About 100 to 300 lines; 420 is where a reader gives up."""
    long = {str(m): n for m in MODULES if (n := len((PACKAGE / m).read_text(encoding="utf-8").splitlines())) > 420}
    assert not long


def test_there_are_no_import_cycles() -> None:
    graph = {
        ".".join(["semscape", *module.with_suffix("").parts]).removesuffix(".__init__"): {
            name for name in imported(module) if name.startswith("semscape.")
        }
        for module in MODULES
        if module != Path("__init__.py")
    }
    # A package's own __init__ only gathers names of its modules; what counts are cycles between modules.
    graph = {name: {other for other in others if other in graph} for name, others in graph.items()}
    packages = {name for name in graph if any(other.startswith(name + ".") for other in graph)}
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, f"import cycle: {' -> '.join((*path, name))}"
        if name in done:
            return
        for other in graph[name] - packages:
            visit(other, (*path, name))
        done.add(name)

    for name in sorted(graph):
        visit(name, ())


def test_importing_semscape_is_cheap() -> None:
    code = (
        "import sys; before = set(sys.modules); import semscape; loaded = set(sys.modules) - before\n"
        f"print(sorted(loaded & set({HEAVY!r})), len(loaded))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy, count = done.stdout.rsplit(" ", 1)
    assert heavy == "[]"
    assert int(count) <= MOST_MODULES_LOADED
