"""From images to a measured surface, through the addresses that the page uses."""

from __future__ import annotations

import io
import json
import time
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from held_jobs import Jobs
from PIL import Image

from semscape.app.workspace import Workspace
from semscape.batch.folder_run import finished_stage, reconstruct_folder
from semscape.cluster.executor import WorkerLostError
from semscape.errors import NoAnswerError
from semscape.io.finished_run import read_finished_run
from semscape.io.run_folder import WORK_NAME
from semscape.options import Options
from semscape.report.conversion import FORMATS
from semscape.report.measurement import measure_run
from semscape.report.surface_file import decode_surface


def wait_for(client: TestClient, name: str, state: str) -> dict[str, object]:
    until = time.monotonic() + 20
    while (run := client.get(f"/api/runs/{name}").json())["state"] != state:
        assert time.monotonic() < until, run
        time.sleep(0.02)
    return run


def test_files_become_a_table_of_what_was_understood(client: TestClient, uploaded: str) -> None:
    table = client.get(f"/api/runs/{uploaded}/series").json()
    assert [row["understood"]["vendor"] for row in table["rows"]] == ["Zeiss"] * 3
    assert [row["understood"]["tilt_deg"] for row in table["rows"]] == [-6.0, 0.0, 6.0]
    assert table["width"] == 128
    assert table["problem"] == ""
    picture = client.get(f"/api/runs/{uploaded}/images/{table['rows'][0]['image']}")
    assert Image.open(io.BytesIO(picture.content)).size == (128, 128)


def test_an_edit_is_written_to_series_toml_and_can_be_undone(
    client: TestClient, uploaded: str, workspace: Workspace
) -> None:
    address = f"/api/runs/{uploaded}"
    image = client.get(f"{address}/series").json()["rows"][1]["image"]
    edited = client.put(f"{address}/cells", json={"image": image, "key": "tilt_deg", "value": 1.5}).json()
    assert [row["understood"]["tilt_deg"] for row in edited["rows"]] == [-6.0, 1.5, 6.0]
    assert edited["rows"][1]["told"] == {"tilt_deg": 1.5}
    client.put(f"{address}/cells", json={"key": "pixel_size_um", "value": 0.25})
    sidecar = workspace.folder / "images" / uploaded / "series.toml"
    told = tomllib.loads(sidecar.read_text())
    assert told == {"pixel_size_um": 0.25, "images": {image: {"tilt_deg": 1.5}}}
    once = client.post(f"{address}/undo").json()
    twice = client.post(f"{address}/undo").json()
    assert once["rows"][1]["understood"]["pixel_size_um"] != 0.25
    assert twice["rows"][1]["understood"]["tilt_deg"] == 0.0
    assert not twice["can_undo"]
    assert client.post(f"{address}/undo").status_code == 400
    assert client.post(f"{address}/redo").json()["rows"][1]["understood"]["tilt_deg"] == 1.5


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("tilt_deg", 90.0, "within"),
        ("pixel_size_um", -1.0, "positive"),
        ("magic", 1.0, "no cell"),
        ("axis_deg", 10.0, "no cell of an image"),
    ],
)
def test_a_cell_refuses_what_it_cannot_hold(
    client: TestClient, uploaded: str, key: str, value: float, words: str
) -> None:
    image = client.get(f"/api/runs/{uploaded}/series").json()["rows"][0]["image"]
    answer = client.put(f"/api/runs/{uploaded}/cells", json={"image": image, "key": key, "value": value})
    assert answer.status_code == 400
    assert words in answer.json()["detail"]


def test_a_series_toml_that_is_dropped_speaks_of_the_original_names(client: TestClient, master_images: Path) -> None:
    name = client.post("/api/runs", json={"title": "ä"}).json()["name"]
    originals = ["ö 2.tif", "ö 10.tif"]  # natural order, not that of the alphabet
    for original, path in zip(originals, sorted(master_images.glob("*.tif")), strict=False):
        client.put(f"/api/runs/{name}/files", params={"filename": original}, content=path.read_bytes())
    toml = 'tilts_deg = [-2.5, 4.5]\n[images."ö 10.tif"]\npixel_size_um = 0.5\n'.encode()
    assert client.put(f"/api/runs/{name}/files", params={"filename": "series.toml"}, content=toml).status_code == 200
    rows = {row["original"]: row for row in client.get(f"/api/runs/{name}/series").json()["rows"]}
    assert rows["ö 2.tif"]["understood"]["tilt_deg"] == -2.5
    assert rows["ö 10.tif"]["told"] == {"pixel_size_um": 0.5, "tilt_deg": 4.5}
    assert {row["image"] for row in rows.values()} == {"o-2.tif", "o-10.tif"}


def test_images_that_cannot_be_used_are_told_in_plain_words(client: TestClient, uploaded: str) -> None:
    client.put(f"/api/runs/{uploaded}/files", params={"filename": "broken one.png"}, content=b"no picture")
    table = client.get(f"/api/runs/{uploaded}/series").json()
    assert table["problem"].startswith("broken one.png: ")
    assert "/" not in table["problem"].partition(":")[0]
    image = next(row["image"] for row in table["rows"] if row["original"] == "broken one.png")
    client.delete(f"/api/runs/{uploaded}/files/{image}")
    assert client.get(f"/api/runs/{uploaded}/series").json()["problem"] == ""


def test_a_run_waits_is_made_and_shows_its_result(client: TestClient, uploaded: str, jobs: Jobs) -> None:
    jobs.free = True
    queued = client.post(f"/api/runs/{uploaded}/reconstruct", json={"settings": ["dense.max_pairs=1"]})
    assert queued.json()["state"] in ("queued", "running", "done")
    run = wait_for(client, uploaded, "done")
    assert jobs.job(0).run.state.settings == ("dense.max_pairs=1",)
    assert run["has_result"]
    assert run["grade"] in ("good", "usable", "do not measure")
    assert not run["is_stale"]
    client.put(f"/api/runs/{uploaded}/cells", json={"key": "pixel_size_um", "value": 0.3})
    assert client.get(f"/api/runs/{uploaded}").json()["is_stale"]


def test_a_setting_that_is_none_is_refused_in_the_words_of_the_page(client: TestClient, uploaded: str) -> None:
    answer = client.post(f"/api/runs/{uploaded}/reconstruct", json={"settings": ["nonsense"]})
    assert answer.status_code == 400
    assert answer.json()["detail"].startswith("the setting 'nonsense' is not of the form")


def test_several_runs_queue_in_their_order(client: TestClient, master_images: Path, jobs: Jobs) -> None:
    names = []
    for title in ("first", "second", "third"):
        name = client.post("/api/runs", json={"title": title}).json()["name"]
        for path in sorted(master_images.glob("*.tif"))[:2]:
            client.put(f"/api/runs/{name}/files", params={"filename": path.name}, content=path.read_bytes())
        client.post(f"/api/runs/{name}/reconstruct", json={})
        names.append(name)
    wait_for(client, "first", "running")
    assert {run["name"]: run["place"] for run in client.get("/api/runs").json()} == {
        "first": 0,
        "second": 1,
        "third": 2,
    }
    assert client.post("/api/runs/second/reconstruct", json={}).status_code == 409
    assert client.post("/api/runs/second/cancel").json()["state"] == "cancelled"
    jobs.job(0).go.set()
    wait_for(client, "third", "running")
    jobs.job(1).go.set()
    wait_for(client, "third", "done")
    assert [job.run.name for job in jobs.started] == ["first", "third"]


def test_a_run_that_is_made_can_be_cancelled_and_asked_for_again(client: TestClient, uploaded: str, jobs: Jobs) -> None:
    client.post(f"/api/runs/{uploaded}/reconstruct", json={})
    wait_for(client, uploaded, "running")
    busy = client.put(f"/api/runs/{uploaded}/cells", json={"key": "pixel_size_um", "value": 0.3})
    assert busy.status_code == 409
    assert "cancel" in busy.json()["detail"]
    assert client.post(f"/api/runs/{uploaded}/cancel").json()["state"] == "cancelled"
    assert jobs.job(0).stopped
    jobs.free = True
    client.post(f"/api/runs/{uploaded}/reconstruct", json={})
    assert wait_for(client, uploaded, "done")["has_result"]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (NoAnswerError("7 matches; give the stage tilts (--tilts)"), "7 matches; give the stage tilts (column Tilt)"),
        (WorkerLostError("the worker process was ended by signal SIGSEGV"), "ended by signal SIGSEGV"),
        (RuntimeError("no idea"), "unexpected RuntimeError: no idea; what happened is in its log"),
    ],
)
def test_a_failure_is_told_with_what_to_do(
    client: TestClient, uploaded: str, jobs: Jobs, error: Exception, words: str
) -> None:
    client.post(f"/api/runs/{uploaded}/reconstruct", json={})
    wait_for(client, uploaded, "running")
    jobs.job(0).error = error
    jobs.job(0).go.set()
    assert words in str(wait_for(client, uploaded, "failed")["message"])


def test_a_setting_that_is_not_understood_is_refused_before_the_run(client: TestClient, uploaded: str) -> None:
    answer = client.post(f"/api/runs/{uploaded}/reconstruct", json={"settings": ["dense.max_pears=1"]})
    assert answer.status_code == 400
    assert "max_pairs" in answer.json()["detail"]


def test_one_image_is_no_series(client: TestClient, master_images: Path) -> None:
    name = client.post("/api/runs", json={"title": "one"}).json()["name"]
    path = min(master_images.glob("*.tif"))
    client.put(f"/api/runs/{name}/files", params={"filename": path.name}, content=path.read_bytes())
    assert "at least two" in client.get(f"/api/runs/{name}/series").json()["problem"]
    assert client.post(f"/api/runs/{name}/reconstruct", json={}).status_code == 400


def test_a_run_made_elsewhere_is_listed_and_shown(client: TestClient, finished: str, workspace: Workspace) -> None:
    run = client.get("/api/runs").json()[0]
    assert (run["name"], run["state"], run["n_images"], run["has_images"]) == (finished, "done", 3, False)
    assert client.get(f"/api/runs/{finished}/result").json()["verdict"].replace("+-", "±") == run["verdict"]
    picture = Image.open(io.BytesIO(client.get(f"/api/runs/{finished}/thumbnail").content))
    assert picture.size == (80, 60)
    heights = read_finished_run(workspace.folder / finished).height_map.height_um
    shown = decode_surface(client.get(f"/api/runs/{finished}/surface").content)
    np.testing.assert_allclose(shown.height_um, heights, atol=1e-2)
    assert client.get(f"/api/runs/{finished}/series").status_code == 404


def test_the_table_of_figures_is_that_of_the_library(client: TestClient, finished: str, workspace: Workspace) -> None:
    question = {"level": "poly2", "region": [5, 5, 60, 50], "step": [[5, 5, 20, 20], [30, 30, 50, 50]]}
    answer = client.post(f"/api/runs/{finished}/measure", json=question | {"profile": [5, 5, 60, 50]}).json()
    found = {(figure["group"], figure["name"]): figure for figure in answer["figures"]}
    for name in ("Sa", "Sq", "Ssk", "Sku", "Sz", "Sal", "Sdr", "Spk", "Vvc"):
        assert sum(name == key[1] for key in found) == 1
    from semscape.metrology.grid import Region
    from semscape.metrology.request import MeasureRequest
    from semscape.options import MeasureOptions

    request = MeasureRequest(
        MeasureOptions(level="poly2"), Region(5, 5, 60, 50), step=(Region(5, 5, 20, 20), Region(30, 30, 50, 50))
    )
    expected = measure_run(read_finished_run(workspace.folder / finished), request)
    for figure in expected.figures:
        assert found[figure.group, figure.name]["value"] == pytest.approx(figure.value, nan_ok=True, rel=1e-12)
    assert len(answer["profile"]["distance"]) == len(answer["profile"]["height"]) > 50


def test_a_region_without_heights_is_no_answer_but_a_reason(client: TestClient, finished: str) -> None:
    answer = client.post(f"/api/runs/{finished}/measure", json={"region": [500, 500, 600, 600]})
    assert answer.status_code == 400
    assert "choose a larger one" in answer.json()["detail"]


@pytest.mark.parametrize("name", [name for name in FORMATS if name not in ("anaglyph", "side-by-side")])
def test_every_format_can_be_downloaded(client: TestClient, finished: str, workspace: Workspace, name: str) -> None:
    answer = client.get(f"/api/runs/{finished}/export/{name}")
    assert answer.status_code == 200, answer.text
    assert len(answer.content) > 500
    assert "attachment" in answer.headers["content-disposition"]
    assert answer.headers["content-type"] == "application/octet-stream"
    if name == "obj":
        assert len(zipfile.ZipFile(io.BytesIO(answer.content)).namelist()) >= 2
    assert not list(workspace.cache.glob("export-*"))


def test_every_format_of_convert_is_offered(client: TestClient) -> None:
    assert client.get("/api/state").json()["formats"] == list(FORMATS)


def test_a_stereo_picture_needs_the_images_and_says_so(client: TestClient, finished: str) -> None:
    answer = client.get(f"/api/runs/{finished}/export/anaglyph")
    assert answer.status_code == 400
    assert "images" in answer.json()["detail"]
    assert client.get(f"/api/runs/{finished}/export/docx").status_code == 404
    assert client.get(f"/api/runs/{finished}/export/stl", params={"unit": "inch"}).status_code == 400


def test_the_preview_is_there_as_soon_as_the_points_are(
    client: TestClient, uploaded: str, workspace: Workspace
) -> None:
    assert client.get(f"/api/runs/{uploaded}/preview").status_code == 404
    images, output = workspace.folder / "images" / uploaded, workspace.folder / uploaded

    def leave(stage: str, _: object) -> None:
        if stage == "surface":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct_folder(images, output, Options(), progress=leave)
    shown = np.frombuffer(client.get(f"/api/runs/{uploaded}/preview").content, "<f4").reshape(-1, 3)
    points = finished_stage(output / WORK_NAME, "calibrate")[0].reconstruction.points_um
    assert len(points) > 100
    np.testing.assert_allclose(shown, points, rtol=1e-6)


def test_a_run_that_another_program_makes_is_shown_and_left_alone(
    client: TestClient, workspace: Workspace, finished: str
) -> None:
    from semscape.io.lock import FolderLock

    folder = workspace.folder / finished
    work = folder / ".semscape-work"
    work.mkdir()
    lines = [
        {"stage": "detect", "message": "stage detect begins"},
        {"stage": "detect", "message": "stage detect ended", "figures": {"n_keypoints": 7, "margin": float("nan")}},
        {"stage": "match", "message": "stage match begins"},
    ]
    times = ("2026-01-01T00:00:00+00:00", "2026-01-01T00:00:02+00:00", "2026-01-01T00:00:02+00:00")
    text = "\n".join(
        json.dumps(line | {"logger": "semscape.run", "time": time}) for line, time in zip(lines, times, strict=True)
    )
    (work / "run.log").write_text(text + "\nno json\n")
    with FolderLock(folder):
        run = client.get(f"/api/runs/{finished}").json()
        assert run["state"] == "running"
        assert [stage["state"] for stage in run["stages"]] == ["done", "running", *["waiting"] * 4]
        assert run["stages"][0] == {
            "name": "detect", "state": "done", "seconds": 2.0, "figures": {"n_keypoints": 7, "margin": None}
        }  # fmt: skip
        assert client.delete(f"/api/runs/{finished}").status_code == 409
    assert client.get(f"/api/runs/{finished}").json()["state"] == "done"
    log = client.get(f"/api/runs/{finished}/log")
    assert log.headers["content-type"] == "text/plain; charset=utf-8"
    assert "stage detect begins" in log.text


def test_runs_of_one_title_are_told_apart(client: TestClient) -> None:
    runs = [client.post("/api/runs", json={"title": "view"}).json() for _ in range(2)]
    assert [(run["name"], run["title"]) for run in runs] == [("view", "view"), ("view-2", "view (2)")]


def test_a_title_changes_and_no_folder(client: TestClient, uploaded: str, finished: str, workspace: Workspace) -> None:
    run = client.put(f"/api/runs/{uploaded}", json={"title": "Bruch, 5 kV"}).json()
    assert (run["name"], run["title"]) == (uploaded, "Bruch, 5 kV")
    assert (workspace.folder / "images" / uploaded).is_dir()
    assert client.put(f"/api/runs/{finished}", json={"title": "x"}).status_code == 404


def test_a_run_that_is_removed_is_only_put_aside(client: TestClient, uploaded: str, workspace: Workspace) -> None:
    key = client.delete(f"/api/runs/{uploaded}").json()["key"]
    assert client.get(f"/api/runs/{uploaded}").status_code == 404
    assert len(list((workspace.folder / "removed" / key / "images").glob("*.tif"))) == 3


def test_a_removed_run_comes_back_as_it_was(
    client: TestClient, uploaded: str, finished: str, workspace: Workspace
) -> None:
    client.put(f"/api/runs/{uploaded}/cells", json={"key": "pixel_size_um", "value": 0.3})
    before = client.get("/api/runs").json()
    for name in (uploaded, finished):
        client.delete(f"/api/runs/{name}")
    assert client.get("/api/runs").json() == []
    removed = client.get("/api/removed").json()
    assert [run["title"] for run in removed] == [finished, "fracture"]
    for run in removed:
        assert client.post(f"/api/removed/{run['key']}/restore").status_code == 200
    assert client.get("/api/runs").json() == before
    assert client.post(f"/api/runs/{uploaded}/undo").status_code == 200  # the edit can still be undone
    assert client.get("/api/removed").json() == []
    assert client.post(f"/api/removed/{removed[0]['key']}/restore").status_code == 404


def test_a_removed_run_whose_name_was_taken_gets_another(client: TestClient, uploaded: str) -> None:
    key = client.delete(f"/api/runs/{uploaded}").json()["key"]
    assert client.post("/api/runs", json={"title": "fracture"}).json()["name"] == uploaded
    restored = client.post(f"/api/removed/{key}/restore").json()
    assert (restored["name"], restored["title"], restored["n_images"]) == (f"{uploaded}-2", "fracture", 3)


def test_an_image_that_is_taken_out_is_put_aside(client: TestClient, uploaded: str, workspace: Workspace) -> None:
    (name, *_) = sorted(path.name for path in (workspace.folder / "images" / uploaded).glob("*.tif"))
    assert client.delete(f"/api/runs/{uploaded}/files/{name}").json()["n_images"] == 2
    assert [path.name for path in (workspace.folder / "removed").glob("*/files/*")] == [name]
    assert client.get("/api/removed").json() == []  # it is no run


@pytest.mark.parametrize("name", ["..", ".semscape-app", "images", "removed"])
def test_a_folder_put_among_the_removed_ones_cannot_take_a_place_of_the_app(
    client: TestClient, workspace: Workspace, name: str
) -> None:
    made = workspace.folder / "removed" / f"{name}-20260131-142501-000123"
    (made / "images").mkdir(parents=True)
    (made / "images" / "a.tif").write_bytes(b"x")
    restored = client.post(f"/api/removed/{made.name}/restore").json()
    assert restored["name"] not in {name, "images", "removed"}
    assert (workspace.folder / "images" / restored["name"] / "a.tif").is_file()
    assert client.post(f"/api/removed/{name}/restore").status_code == 404


def test_links_among_the_removed_runs_are_not_followed(
    client: TestClient, uploaded: str, workspace: Workspace, tmp_path: Path
) -> None:
    (tmp_path / "outside" / "images").mkdir(parents=True)
    folder = workspace.folder / "removed"
    folder.mkdir()
    (folder / "a-20260131-142501-000123").symlink_to(tmp_path / "outside")
    (folder / "b-20260131-142501-000123").mkdir()
    (folder / "b-20260131-142501-000123" / "images").symlink_to(tmp_path / "outside" / "images")
    assert client.get("/api/removed").json() == []


def test_a_page_hears_of_every_change(client: TestClient, uploaded: str) -> None:
    """The same text is what the server sends as an event, and what a page that cannot listen asks for."""
    parts = client.app.state.parts  # type: ignore[attr-defined]
    before = json.loads(parts.snapshots.text())
    client.put(f"/api/runs/{uploaded}/cells", json={"key": "pixel_size_um", "value": 0.3})
    client.post("/api/runs", json={"title": "new"})
    time.sleep(0.4)
    after = json.loads(parts.snapshots.text())
    assert [run["name"] for run in before] == [uploaded]
    assert {run["name"] for run in after} == {uploaded, "new"}
    assert after == client.get("/api/runs").json()
