"""`semscape convert` on a run folder: names, units, what is refused, and that nothing is half-written."""

from __future__ import annotations

import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import Image
from typer.testing import CliRunner

from semscape.cli import app
from semscape.errors import BadInputError
from semscape.io.run_folder import json_text
from semscape.io.series import load_series
from semscape.io.surfaces import read_height_map
from semscape.options import ConvertOptions, InputOptions
from semscape.report import conversion
from semscape.report.conversion import FORMATS, convert
from semscape.report.json import report_to_dict
from semscape.report.run import write_run
from synthetic_result import make_result

STEREO = {"anaglyph", "side-by-side"}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Run folders in um and in px, and beside them the images of the first."""
    folder = tmp_path_factory.mktemp("runs")
    patch = pytest.MonkeyPatch()
    patch.setattr("semscape.report.run.render_html", lambda _: "<!DOCTYPE html>")
    images = folder / "images"
    images.mkdir()
    results = {unit: make_result(unit) for unit in ("um", "px")}
    for view in results["um"].series.views:
        tifffile.imwrite(images / view.name, np.clip(view.image, 0, 255).astype(np.uint8))
    digests = {view.name: view.digest for view in load_series(images, InputOptions(pixel_size_um=0.05)).views}
    series = replace(
        results["um"].series,
        views=tuple(replace(view, digest=digests[view.name]) for view in results["um"].series.views),
    )
    inputs = tuple({**item, "digest": digests[str(item["name"])]} for item in results["um"].report.inputs)
    results["um"] = replace(results["um"], series=series, report=replace(results["um"].report, inputs=inputs))
    for unit, result in results.items():
        write_run(result, folder / f"grain-{unit}")
        (folder / f"grain-{unit}" / "report.json").write_text(json_text(report_to_dict(result)))
    patch.undo()
    return {"um": folder / "grain-um", "px": folder / "grain-px", "images": images}


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_every_format_at_once_named_after_the_run(runs: dict[str, Path], tmp_path: Path) -> None:
    done = run("convert", runs["um"], "--to", ",".join(FORMATS), "-o", tmp_path / "out", "--images", runs["images"])
    assert done.exit_code == 0, done.output
    names = {path.name for path in (tmp_path / "out").iterdir()}
    singles = set(FORMATS) - STEREO - {"print"}
    assert names == {f"grain-um.{suffix}" for suffix in singles} | {
        "grain-um.mtl", "grain-um.png", "grain-um-print.stl", "grain-um-anaglyph.png", "grain-um-side-by-side.png",
    }  # fmt: skip
    assert {Path(line).name for line in done.output.splitlines()} == names
    # A second time it replaces its own files, with the same bytes.
    before = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    convert(runs["um"], list(FORMATS), tmp_path / "out", images=runs["images"])
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


def test_one_format_into_a_file(runs: dict[str, Path], tmp_path: Path) -> None:
    (path,) = convert(runs["um"], ["npz"], tmp_path / "new" / "map.npz")
    assert path == tmp_path / "new" / "map.npz"
    np.testing.assert_array_equal(
        read_height_map(path).height_um, read_height_map(runs["um"] / "height_map.npz").height_um
    )
    with np.load(path) as arrays:
        np.testing.assert_array_equal(arrays["height_um"], read_height_map(path).height_um)
    assert convert(path, ["tif"], tmp_path / "map.tiff") == (tmp_path / "map.tiff",)
    assert (tmp_path / "map.tiff").is_file()
    # A height map that lies alone is enough.
    assert convert(path, ["stl"], tmp_path / "solid.stl") == (tmp_path / "solid.stl",)
    assert {p.name for p in convert(path, ["obj"], tmp_path / "m.obj")} == {"m.obj", "m.mtl", "m.png"}


def test_without_an_output_files_go_into_the_run(runs: dict[str, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(runs["um"], tmp_path / "grain"))
    done = run("convert", folder, "--to", "x3p")
    assert (done.exit_code, done.output.strip()) == (0, str(folder / "converted" / "grain.x3p"))
    assert convert(folder / "height_map.npz", ["off"])[0].parent == folder / "converted"
    assert run("measure", folder, "--json").exit_code == 0  # it is still a run


def test_px_is_said_or_refused(runs: dict[str, Path], tmp_path: Path) -> None:
    written = convert(runs["px"], ["ply", "stl", "csv", "print"], tmp_path / "out")
    assert len(written) == 4
    assert b"UNITS=px" in (tmp_path / "out" / "grain-px.stl").read_bytes()[:80]
    done = run("convert", runs["px"], "--to", "csv,x3p", "-o", tmp_path / "none")
    assert done.exit_code == 2
    assert "has no pixel size" in done.output
    assert not (tmp_path / "none").exists()
    with pytest.raises(BadInputError, match="--print-scale means nothing"):
        convert(runs["px"], ["print"], tmp_path / "none", ConvertOptions(print_scale=100))


@pytest.mark.parametrize(("unit", "factor"), [("um", 1.0), ("mm", 1e-3), ("nm", 1e3)])
def test_the_unit_of_meshes(runs: dict[str, Path], tmp_path: Path, unit: str, factor: float) -> None:
    (path,) = convert(runs["um"], ["stl"], tmp_path, ConvertOptions(unit=unit))
    mesh = trimesh.load_mesh(path)
    heights = read_height_map(runs["um"] / "height_map.npz").height_um
    assert mesh.bounds[1, 2] - mesh.bounds[0, 2] == pytest.approx(
        np.ptp(heights[np.isfinite(heights)]) * factor, rel=0.3
    )
    assert mesh.extents[0] == pytest.approx(79 * 0.05 * factor, rel=1e-3)


def test_the_print_has_its_scale_and_is_closed(runs: dict[str, Path], tmp_path: Path) -> None:
    (path,) = convert(runs["um"], ["print"], tmp_path, ConvertOptions(print_size_mm=60, base_mm=3))
    by_size = trimesh.load_mesh(path)
    assert by_size.is_watertight
    assert by_size.extents[0] == pytest.approx(60, rel=1e-6)  # the plate has the size that was asked for
    thinned = ConvertOptions(print_size_mm=60, max_vertices=900)
    (path,) = convert(runs["um"], ["print"], tmp_path, thinned)
    assert trimesh.load_mesh(path).extents[0] == pytest.approx(60, rel=1e-6)
    (path,) = convert(runs["um"], ["print"], tmp_path, ConvertOptions(print_scale=15_000, base_mm=3))
    by_scale = trimesh.load_mesh(path)
    assert by_scale.extents[0] == pytest.approx(79 * 0.05 * 15, rel=1e-6)
    heights = read_height_map(runs["um"] / "height_map.npz").height_um
    assert by_scale.extents[2] == pytest.approx(3 + np.ptp(heights[np.isfinite(heights)]) * 15, rel=1e-5)
    assert path.read_bytes()[:80].rstrip() == b"semscape surface UNITS=mm print 15000:1"


@pytest.mark.parametrize("suffix", ["ply", "glb"])
def test_colour_by_height(runs: dict[str, Path], tmp_path: Path, suffix: str) -> None:
    (path,) = convert(runs["um"], [suffix], tmp_path, ConvertOptions(color="viridis"))
    scene = trimesh.load_scene(path, process=False)
    (mesh,) = scene.geometry.values()
    color = mesh.visual.vertex_colors if suffix == "ply" else mesh.visual.vertex_attributes["color"]
    z = mesh.vertices[:, 2]
    # viridis goes from dark violet to yellow.
    np.testing.assert_array_equal(color[np.argmin(z)][:3], [68, 1, 84])
    np.testing.assert_array_equal(color[np.argmax(z)][:3], [253, 231, 36])


def test_what_a_format_does_not_hold_is_said(
    runs: dict[str, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    convert(runs["um"], ["stl", "ply"], tmp_path / "plain")
    assert caplog.messages == [
        "the micrograph is left out of stl: no colours are written there; ply, obj and glb have them"
    ]
    caplog.clear()
    convert(runs["um"], ["ply", "x3p", "print"], tmp_path / "mm", ConvertOptions(unit="mm"))
    assert caplog.messages == [
        "--unit mm is that of the meshes alone (x3p in metres, as the format has it; the print is in mm)"
    ]
    caplog.clear()
    convert(runs["um"], ["ply", "x3p"], tmp_path / "quiet")
    assert not caplog.messages


def test_stereo_pictures(runs: dict[str, Path], tmp_path: Path) -> None:
    paths = convert(runs["um"], ["anaglyph", "side-by-side"], tmp_path, images=runs["images"])
    with Image.open(paths[0]) as anaglyph, Image.open(paths[1]) as both:
        red, green, blue = np.moveaxis(np.asarray(anaglyph), -1, 0)
        assert "left grain_c.tif (2.99 deg), right grain_a.tif (-3.02 deg)" in anaglyph.info["Description"]
        np.testing.assert_array_equal(green, blue)
        np.testing.assert_array_equal(np.asarray(both), np.concatenate([red, green], axis=1))
        assert (red != green).any()
    with pytest.raises(BadInputError, match="--images"):
        convert(runs["um"], ["anaglyph"], tmp_path)
    image = runs["images"] / "grain_b.tif"
    content = image.read_bytes()
    try:
        tifffile.imwrite(image, np.random.default_rng(0).integers(0, 255, (60, 80), dtype=np.uint8))
        with pytest.raises(BadInputError, match=r"holds another grain_b\.tif"):
            convert(runs["um"], ["anaglyph"], tmp_path, images=runs["images"])
    finally:
        image.write_bytes(content)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--to", "x3p,wrl"], "--to wrl is not known; there are: ply, stl"),
        (["--to", ""], "is not known"),
        (["--to", "stl", "--unit", "inch"], "--unit 'inch' is not known"),
        (["--to", "3mf", "--unit", "nm"], "no nanometre"),
        (["--to", "ply", "--color", "mauve"], "--color 'mauve'"),
        (["--to", "print", "--base-mm", "0"], "--base-mm must be"),
        (["--to", "x3p,csv", "--unit", "mm"], "changes nothing for x3p, csv (x3p in metres, as the format has it; csv"),
        (["--to", "stl", "--color", "viridis"], "leave it out, or ask for ply or obj or glb"),
        (["--to", "stl", "--base-mm", "3"], "--base-mm 3.0 changes nothing for stl"),
    ],
)
def test_bad_requests_end_with_2_and_write_nothing(
    runs: dict[str, Path], tmp_path: Path, arguments: list[str], message: str
) -> None:
    done = run("convert", runs["um"], *arguments, "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert message in done.output
    assert not (tmp_path / "out").exists()


def test_outputs_that_cannot_be_meant(runs: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"is one \.stl file"):
        convert(runs["um"], ["x3p"], tmp_path / "a.stl")
    with pytest.raises(BadInputError, match="give a folder"):
        convert(runs["um"], ["x3p", "stl"], tmp_path / "a.stl")
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match="a file stands in its place"):
        convert(runs["um"], ["x3p"], tmp_path / "file")
    with pytest.raises(BadInputError, match="does not exist"):
        convert(tmp_path / "nowhere", ["x3p"], tmp_path / "out")


def test_foreign_files_are_kept(runs: dict[str, Path], tmp_path: Path) -> None:
    foreign = tmp_path / "grain-um.stl"
    foreign.write_bytes(b"solid mine")
    with pytest.raises(BadInputError, match="was not written by semscape"):
        convert(runs["um"], ["csv", "stl"], tmp_path)
    assert foreign.read_bytes() == b"solid mine"
    assert [path.name for path in tmp_path.iterdir()] == ["grain-um.stl"]


def test_nothing_is_half_written(runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    convert(runs["um"], ["csv"], tmp_path)
    before = (tmp_path / "grain-um.csv").read_bytes()

    def fail(_source: object) -> dict[str, bytes]:
        raise BadInputError("no")

    monkeypatch.setitem(conversion.FORMATS, "ply", fail)
    with pytest.raises(BadInputError):
        convert(runs["um"], ["csv", "ply"], tmp_path, ConvertOptions())
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"grain-um.csv": before}
    assert io.BytesIO(before).readline().startswith(b"# semscape")
