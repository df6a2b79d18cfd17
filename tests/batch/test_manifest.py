from __future__ import annotations

import math
from pathlib import Path

import pytest

from semscape.batch.manifest import find_specimens
from semscape.batch.run import options_of_rows
from semscape.errors import BadInputError
from semscape.options import Options


def manifest(folder: Path, text: str) -> Path:
    path = folder / "MANIFEST.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_row_for_each_specimen(tmp_path: Path) -> None:
    text = (
        "folder,name,tilts,pixel_size_um,options\n"
        'a/images,first,"-7,0,7",0.05,features.ratio=0.7; dense.max_pairs=2\n'
        "\n"
        "/data/b,,,,\n"
    )
    first, second = find_specimens(manifest(tmp_path, text), tmp_path / "out")
    assert (first.name, first.folder, first.line) == ("first", tmp_path / "a" / "images", 2)
    assert (second.name, second.folder, second.line) == ("b", Path("/data/b"), 4)
    of_first, of_second = options_of_rows([first, second], Options().with_settings(["features.ratio=0.6"]))
    assert of_first.input.tilts_deg == (-7.0, 0.0, 7.0)
    assert of_first.input.pixel_size_um == 0.05
    assert (of_first.features.ratio, of_first.dense.max_pairs) == (0.7, 2)
    assert of_second.features.ratio == 0.6
    assert math.isnan(of_second.input.pixel_size_um)


def test_a_spreadsheet_of_a_country_with_decimal_commas(tmp_path: Path) -> None:
    (found,) = find_specimens(manifest(tmp_path, "\ufefffolder;tilts\r\na;-7,0,7\r\n"), tmp_path / "out")
    assert found.values == {"tilts": "-7,0,7"}


def test_a_folder_of_folders(tmp_path: Path) -> None:
    for name in ("b", "a", "out", ".hidden", "empty"):
        (tmp_path / name).mkdir()
        if name != "empty":
            (tmp_path / name / "1.tif").touch()
    assert [specimen.name for specimen in find_specimens(tmp_path, tmp_path / "out")] == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no column 'folder'"),
        ("folder\n", "no specimens"),
        ("folder,tilt\na,3\n", "unknown column 'tilt'; the nearest one is 'tilts'"),
        ("folder,folder\na,b\n", "'folder' stands there twice"),
        ("name\na\n", "no column 'folder'"),
        ("folder,tilts\na,-7,0,7\n", 'line 2: 4 cells, but 2 columns; .*"-7,0,7"'),
        ("folder,name\na,x\nb,X\n", r"twice: 'X' \(lines 2 and 3\)"),
        ("folder\na\nother/a\n", "twice: 'a'"),
        ('folder\n"a\n', "line 2 is not CSV"),
        ("folder,name\na,../../etc\n", "line 2: the name '../../etc' cannot be that of a folder"),
        ("folder,name\na,..\n", "line 2: the name '..' cannot"),
        ("folder,name\na,b\\c\n", "cannot be that of a folder"),
        ("folder,name\na,.hidden\n", "cannot be that of a folder"),
        ("folder\na/Records\n", "the name 'Records' cannot be that of a folder; give another in the column 'name'"),
        ("folder,name\na,summary-2.html\n", "cannot be that of a folder"),
        ("folder,name\na,x\x07\n", "cannot be that of a folder"),
        ("folder,name\na," + "x" * 201 + "\n", "cannot be that of a folder"),
        ("folder,name\n,x\n", "line 2: no folder"),
        ("folder\na\0b\n", "a NUL"),
    ],
)
def test_a_manifest_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        find_specimens(manifest(tmp_path, text), tmp_path / "out")


def test_all_wrong_rows_are_told_at_once(tmp_path: Path) -> None:
    text = (
        'folder,tilts,pixel_size_um,seed,options\na,"1,x",,,\nb,,-1,,\nc,,nm,,\nd,,,1.5,\ne,,,,dense.pairs=3\nf,,,,\n'
    )
    specimens = find_specimens(manifest(tmp_path, text), tmp_path / "out")
    with pytest.raises(BadInputError) as refused:
        options_of_rows(specimens, Options())
    told = str(refused.value)
    for line in range(2, 7):
        assert f"line {line}: " in told
    assert "line 7" not in told
    assert "the nearest one is 'max_pairs'" in told


def test_what_is_no_manifest(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="no such manifest or folder"):
        find_specimens(tmp_path / "nowhere.csv", tmp_path / "out")
    with pytest.raises(BadInputError, match="none of its 0 folders holds images"):
        find_specimens(tmp_path, tmp_path / "out")
    (tmp_path / "m.csv").write_bytes(b"\xff\xfe\0f")
    with pytest.raises(BadInputError, match="cannot be read as text"):
        find_specimens(tmp_path / "m.csv", tmp_path / "out")
