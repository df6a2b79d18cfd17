from __future__ import annotations

import math
import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from sem_files import noise, write_tiff, write_tilted, zeiss_text

from semscape.errors import BadInputError
from semscape.io.inspect import describe_series
from semscape.io.series import load_series
from semscape.io.series_template import write_series_toml


def test_every_field_of_one_image_and_of_all(tmp_path: Path) -> None:
    write_tilted(tmp_path, [0.0, 5.0, 10.0])
    (tmp_path / "series.toml").write_text(
        "working_distance_mm = 7.5\naccelerating_voltage_kv = 3\nmagnification = 900\nstage_rotation_deg = 12\n"
        'scan_rotation_deg = 0\ndynamic_focus = true\ndata_bar_rows = 10\n[images."img2.tif"]\ntilt_deg = -5.2\n'
        "pixel_size_um = 0.051\nworking_distance_mm = 7.6\n"
    )
    series = load_series(tmp_path)
    views = {view.name: view.metadata for view in series.views}
    assert views["img1.tif"].working_distance_um == pytest.approx(7500)
    assert views["img2.tif"].working_distance_um == pytest.approx(7600)
    assert views["img1.tif"].accelerating_voltage_kv == 3
    assert views["img3.tif"].magnification == 900
    assert math.degrees(views["img3.tif"].stage_rotation_rad) == pytest.approx(12)
    assert [math.degrees(views[f"img{i}.tif"].tilt_rad) for i in (1, 2, 3)] == pytest.approx([0, -5.2, -10])
    assert [views[f"img{i}.tif"].source["tilt_rad"] for i in (1, 2, 3)] == ["file", "sidecar", "file"]
    assert views["img2.tif"].pixel_size_um == pytest.approx(0.051)
    assert views["img2.tif"].source["pixel_size_um"] == "sidecar"
    assert all(not view.mask[-10:].any() and view.mask[:-10].all() for view in series.views)
    assert any("dynamic focus" in text for text in series.warnings)
    assert describe_series(series)[0]["sources"]["data_bar_rows"] == "sidecar"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[images."img9.tif"]\ntilt_deg = 1', r"no image 'img9\.tif'.*nearest name is 'img\d\.tif'"),
        ('[images."img1.tif"]\ntilts_deg = [1]', r"unknown key 'tilts_deg'; the nearest one is 'tilt_deg'"),
        ('tilts_deg = [1, 2]\n[images."img1.tif"]\ntilt_deg = 1', "give only one of the two"),
        ('[images."img1.tif"]\ntilt_deg = 86', r"tilt_deg of the images.*86 deg for img1\.tif"),
        ('[images."img1.tif"]\ntilt_deg = nan', "tilt_deg is nan"),
        ("images = 3", "must be tables"),
        ("working_distance_mm = 0", "must be a positive number"),
        ("tilt_correction_deg = 90", r"within \+-90 deg"),
        ("dynamic_focus = 3", "true or false"),
        ("data_bar_rows = 1.5", "whole number"),
        ("data_bar_rows = 5000", "the image has 96"),
        ("scale_bar_um = -3", "positive"),
        ("magnification = inf", "positive"),
    ],
)
def test_refused(tmp_path: Path, text: str, message: str) -> None:
    write_tilted(tmp_path, [0.0, 5.0])
    (tmp_path / "series.toml").write_text(text)
    with pytest.raises(BadInputError, match=message):
        load_series(tmp_path)


def test_what_inspect_writes_changes_nothing_until_it_is_taken_up(tmp_path: Path) -> None:
    for i, tilt in enumerate((0.0, 5.0, 10.0)):
        text = zeiss_text(
            AP_IMAGE_PIXEL_SIZE=f"P = {50 + i / 10} nm",
            AP_STAGE_AT_T=f"T = {tilt} °",
            AP_WD="WD = 5 mm",
            DP_SCAN_ROT="S = Off",
            DP_DYNFOCUS="D = Off",
        )
        write_tiff(tmp_path / f"img{i}.tif", noise(i), zeiss=text)
    before = load_series(tmp_path)
    path = write_series_toml(tmp_path, describe_series(before), before.warnings)
    written = path.read_text()
    assert "# pixel_size_um = 0.0501  # from tag 34118, AP_IMAGE_PIXEL_SIZE" in written
    assert '# [images."img1.tif"]' in written
    as_comments = load_series(tmp_path)
    assert describe_series(as_comments) == describe_series(before)
    # Taking the # away before every value that is known overrides each field with the very value it had.
    taken_up = re.sub(r"^# (?=(\w+ = (?!\.\.\.)|\[images))", "", written, flags=re.MULTILINE)
    path.write_text(taken_up.replace("scale_bar_um", "# scale_bar_um"))
    after = load_series(tmp_path)
    np.testing.assert_allclose(after.tilt_rad, before.tilt_rad)
    np.testing.assert_allclose(after.pixel_size_um, before.pixel_size_um)
    assert all(view.metadata.source["working_distance_um"] == "sidecar" for view in after.views)
    with pytest.raises(BadInputError, match=r"series\.toml: exists and is not overwritten"):
        write_series_toml(tmp_path, describe_series(before), ())


def test_names_of_any_text_are_written_and_others_leave_no_file(tmp_path: Path) -> None:
    for i, name in enumerate(("a \N{GRINNING FACE}.tif", "b\n2.tif")):
        write_tiff(tmp_path / name, noise(i))
    rows = describe_series(load_series(tmp_path))
    rows[0]["magnification"] = 100.0
    text = write_series_toml(tmp_path, rows, ()).read_text(encoding="utf-8")
    tables = re.findall(r"^# (\[images.*)$", text, flags=re.MULTILINE)
    named = tomllib.loads("\n".join(f"{table}\nmagnification = 1" for table in tables))
    assert set(named["images"]) == {row["name"] for row in rows}
    assert all(not line or line.startswith("#") for line in text.splitlines())
    (tmp_path / "series.toml").unlink()
    rows[0]["name"] = "a\udcff.tif"
    with pytest.raises(BadInputError, match=r"series\.toml: cannot be written.*udcff.*rename"):
        write_series_toml(tmp_path, rows, ())
    assert not (tmp_path / "series.toml").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders on this system")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    for name in ("a.tif", "b.tif"):
        write_tiff(tmp_path / name, noise(0))
    os.mkfifo(tmp_path / "series.toml")
    with pytest.raises(BadInputError, match=r"series\.toml: is not a text file"):
        load_series(tmp_path)


def test_a_file_without_end_is_not_read(tmp_path: Path) -> None:
    for name in ("a.tif", "b.tif"):
        write_tiff(tmp_path / name, noise(0))
    (tmp_path / "series.toml").write_text("#" * 1_000_001, encoding="ascii")
    with pytest.raises(BadInputError, match="below 1,000,000 bytes"):
        load_series(tmp_path)
