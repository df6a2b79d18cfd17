"""Who is let in, and what a file that is sent, or lies in the workspace, can reach."""

from __future__ import annotations

import asyncio
import re
import shutil
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from semscape.app.security import Access
from semscape.app.workspace import Workspace
from semscape.io.value_file import encode_value

ORIGIN = "http://127.0.0.1:8765"


def test_without_the_token_nothing_is_told(stranger: TestClient) -> None:
    for path in ("/api/state", "/api/runs", "/api/events", "/api/openapi.json", "/api/docs", "/static/app.js"):
        answer = stranger.get(path)
        assert answer.status_code == 401, path
        assert "token" in answer.json()["detail"]
    page = stranger.get("/")
    assert page.status_code == 401
    assert "semscape app" in page.text
    assert stranger.post("/api/runs", json={"title": "x"}).status_code == 401


def test_a_wrong_token_opens_nothing(stranger: TestClient, access: Access) -> None:
    for token in ("", "x", access.token[:-1], access.token + "x", "%ff%00"):
        assert stranger.get(f"/?token={token}", follow_redirects=False).status_code == 401
    assert not stranger.cookies


def test_the_token_becomes_a_cookie_that_no_script_reads(stranger: TestClient, access: Access) -> None:
    answer = stranger.get(f"/?token={access.token}", follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert access.token.lower() not in cookie
    assert stranger.get("/api/runs").status_code == 200


def test_two_starts_have_nothing_in_common() -> None:
    first, second = Access(1), Access(1)
    assert first.token != second.token
    assert len(first.token) >= 40


def test_a_link_from_elsewhere_opens_the_page_by_way_of_itself(stranger: TestClient, access: Access) -> None:
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    del stranger.headers["Origin"]
    assert stranger.get(f"/?token={access.token}", headers=link, follow_redirects=False).status_code == 303
    stranger.cookies.clear()  # one of SameSite=Strict is kept, but not sent on such a way
    assert "url=/" in stranger.get("/", headers=link).text
    assert stranger.get("/", headers={"Sec-Fetch-Site": "same-origin"}).status_code == 401


@pytest.mark.parametrize("host", ["evil.example:8765", "127.0.0.1", "127.0.0.1:80", "localhost:8766", ""])
def test_a_name_that_only_leads_here_is_refused(client: TestClient, host: str) -> None:
    answer = client.get("/api/runs", headers={"Host": host})
    assert answer.status_code == 403
    assert "host" in answer.json()["detail"]


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:8766", "https://127.0.0.1:8765", "http://127.0.0.1"]
)
def test_another_page_is_refused(client: TestClient, origin: str) -> None:
    for method in ("GET", "POST"):
        answer = client.request(method, "/api/runs", headers={"Origin": origin}, json={"title": "x"})
        assert answer.status_code == 403
    assert client.get("/api/runs").json() == []


def test_what_changes_something_must_tell_its_origin(client: TestClient) -> None:
    del client.headers["Origin"]
    assert client.post("/api/runs", json={"title": "x"}).status_code == 403
    assert client.get("/api/runs").status_code == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_pictures_and_scripts_of_other_pages_are_refused(client: TestClient, finished: str, site: str) -> None:
    headers = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"}
    del client.headers["Origin"]
    assert client.get(f"/api/runs/{finished}/thumbnail", headers=headers).status_code == 403
    navigation = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate"}
    assert client.get(f"/api/runs/{finished}/report", headers=navigation).status_code == 403
    assert client.get("/", headers=navigation).status_code == 200


def test_every_answer_says_what_it_may_load(client: TestClient, finished: str) -> None:
    for path in ("/", "/api/runs", "/api/docs", f"/api/runs/{finished}/thumbnail", "/nowhere"):
        headers = client.get(path).headers
        policy = headers["content-security-policy"]
        assert policy.startswith("default-src 'none'")
        assert "unsafe" not in policy
        assert not re.search(r"https?:", policy)
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert headers["referrer-policy"] == "no-referrer"


def test_the_pages_ask_nothing_of_other_machines(client: TestClient) -> None:
    for path in ("/", "/api/docs"):
        page = client.get(path).text
        assert not re.findall(r"(?:src|href|action)=[\"']?(?:https?:)?//", page)
        assert "<script>" not in page


def test_a_report_runs_in_an_origin_of_its_own(client: TestClient, finished: str, workspace: Workspace) -> None:
    (workspace.folder / finished / "report.html").write_text("<script>fetch('/api/runs')</script>")
    policy = client.get(f"/api/runs/{finished}/report").headers["content-security-policy"]
    sandbox = re.match(r"sandbox ([^;]*);", policy)
    assert sandbox is not None
    assert "allow-same-origin" not in sandbox[1]
    assert "allow-top-navigation" not in sandbox[1]
    assert "default-src 'none'" in policy
    assert not re.search(r"'self'|https?:", policy)


HOSTILE_NAMES = [
    "../../evil.tif",
    "..\\..\\evil.tif",
    "/etc/evil.tif",
    "C:\\Windows\\evil.tif",
    "CON.tif",
    "con.x.tif",
    ".hidden.tif",
    "a\0b.tif",
    "a\nb.tif",
    "..tif",
    "....tif",
    "x" * 290 + ".tif",
    "%2e%2e%2fevil.tif",
    "‮gpj.tif",
    "a;rm -rf ~.tif",
    "<img src=x onerror=alert(1)>.tif",
]


@pytest.mark.parametrize("original", HOSTILE_NAMES)
def test_a_name_from_the_browser_never_becomes_a_path(
    client: TestClient, workspace: Workspace, original: str, tmp_path: Path
) -> None:
    name = client.post("/api/runs", json={"title": original[:200]}).json()["name"]
    answer = client.put(f"/api/runs/{name}/files", params={"filename": original}, content=b"content")
    images = workspace.folder / "images" / name
    assert images.parent == workspace.folder / "images"
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.+-]*", name)
    assert ".." not in name
    written = [path for path in tmp_path.rglob("*") if path.is_file() and path.read_bytes() == b"content"]
    assert answer.status_code in (200, 400)
    assert len(written) == (answer.status_code == 200)
    for path in written:
        assert path.parent == images
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.+-]*\.tif", path.name)
        assert ".." not in path.name
        assert path.name.partition(".")[0].lower() != "con"


@pytest.mark.parametrize("kind", ["evil.exe", "evil", "evil.html", "evil.toml", "evil.json", ".semscape-app.json"])
def test_only_images_and_their_texts_are_taken(client: TestClient, workspace: Workspace, kind: str) -> None:
    name = client.post("/api/runs", json={"title": "x"}).json()["name"]
    answer = client.put(f"/api/runs/{name}/files", params={"filename": kind}, content=b"content")
    assert answer.status_code == 400
    assert "leave it out" in answer.json()["detail"]


def test_a_file_that_is_too_large_is_refused_before_it_is_read(client: TestClient, workspace: Workspace) -> None:
    name = client.post("/api/runs", json={"title": "x"}).json()["name"]
    answer = client.put(f"/api/runs/{name}/files", params={"filename": "a.tif"}, content=b"x" * 1_000_001)
    assert answer.status_code == 413
    assert "1 MB a file" in answer.json()["detail"]

    def pieces():  # type: ignore[no-untyped-def]  # without a length that the server could look at first
        for _ in range(1100):
            yield b"x" * 1000

    answer = client.put(f"/api/runs/{name}/files", params={"filename": "a.tif"}, content=pieces())
    assert answer.status_code == 413
    assert [path.name for path in (workspace.folder / "images" / name).iterdir()] == [".semscape-app.json"]


def test_a_run_takes_so_many_bytes_and_files_and_no_more(client: TestClient) -> None:
    name = client.post("/api/runs", json={"title": "bytes"}).json()["name"]
    sent = [
        client.put(f"/api/runs/{name}/files", params={"filename": f"{i}.tif"}, content=b"x" * 900_000) for i in range(3)
    ]
    assert [answer.status_code for answer in sent] == [200, 200, 413]
    name = client.post("/api/runs", json={"title": "files"}).json()["name"]
    sent = [client.put(f"/api/runs/{name}/files", params={"filename": f"{i}.tif"}, content=b"x") for i in range(7)]
    assert [answer.status_code for answer in sent] == [200] * 6 + [413]
    assert "at most 6 files" in sent[-1].json()["detail"]
    again = client.put(f"/api/runs/{name}/files", params={"filename": "0.tif"}, content=b"y")
    assert again.status_code == 200  # it takes the place of one that is there


def test_a_form_that_is_too_large_is_refused(client: TestClient) -> None:
    answer = client.post("/api/runs", json={"title": "x" * 1_100_000})
    assert answer.status_code == 413


def test_an_upload_that_is_cut_off_leaves_nothing(client: TestClient, workspace: Workspace) -> None:
    from semscape.app.uploads import take_file

    name = client.post("/api/runs", json={"title": "x"}).json()["name"]

    async def pieces():  # type: ignore[no-untyped-def]
        yield b"half"
        raise ConnectionError("the browser has gone")

    parts = client.app.state.parts  # type: ignore[attr-defined]
    with pytest.raises(Exception, match="browser has gone"):
        asyncio.run(take_file(parts.workspace, parts.queue, name, "a.tif", 0, pieces(), parts.limits))
    assert [path.name for path in (workspace.folder / "images" / name).iterdir()] == [".semscape-app.json"]


@pytest.mark.parametrize(
    "path",
    [
        "/api/runs/..",
        "/api/runs/%2e%2e",
        "/api/runs/..%2f..%2fetc",
        "/api/runs/.semscape-app",
        "/api/runs/images",
        "/api/runs/removed",
        "/api/runs/%2fetc",
        "/api/runs/x/images/..%2f..%2fsecret.tif",
        "/api/runs/x/images/%2e%2e",
        "/static/../semscape/errors.py",
        "/static/..%2ferrors.py",
    ],
)
def test_no_path_leads_out_of_the_workspace(client: TestClient, workspace: Workspace, path: str) -> None:
    client.post("/api/runs", json={"title": "x"})
    (workspace.folder.parent / "secret.tif").write_text("secret")
    answer = client.get(path)
    assert answer.status_code == 404
    assert "secret" not in answer.text


def test_links_are_not_followed(
    client: TestClient, workspace: Workspace, finished: str, finished_run: Path, tmp_path: Path
) -> None:
    elsewhere = shutil.copytree(finished_run, tmp_path / "elsewhere")
    (workspace.folder / "link").symlink_to(elsewhere, target_is_directory=True)
    inside = shutil.copytree(finished_run, workspace.folder / "holds-a-link")
    (inside / "report.html").unlink()
    (inside / "report.html").symlink_to("/etc/passwd")
    (workspace.folder / "images" / "linked-images").symlink_to(elsewhere, target_is_directory=True)
    links = workspace.folder / "images" / "links"
    links.mkdir()
    (links / "a.tif").symlink_to("/etc/passwd")
    assert [run["name"] for run in client.get("/api/runs").json()] == [finished]
    for name in ("link", "holds-a-link", "linked-images", "links"):
        assert client.get(f"/api/runs/{name}").status_code == 404
        assert client.get(f"/api/runs/{name}/report").status_code == 404


def test_a_result_is_not_shown_through_a_link_beside_ones_own_images(
    client: TestClient, workspace: Workspace, uploaded: str, finished_run: Path
) -> None:
    (workspace.folder / uploaded).symlink_to(finished_run, target_is_directory=True)
    assert client.get(f"/api/runs/{uploaded}").status_code == 404


def test_what_lies_in_a_run_folder_is_never_run(client: TestClient, workspace: Workspace, finished: str) -> None:
    work = workspace.folder / finished / ".semscape-work"
    work.mkdir()
    hostile = encode_value({"a": 1}).replace(b"semscape value 1", b"semscape value 1")
    for content in (b"cos\nsystem\n(S'touch /tmp/hacked'\ntR.", hostile, b""):
        (work / "calibrate.value").write_bytes(content)
        assert client.get(f"/api/runs/{finished}/preview").status_code == 404
    (workspace.folder / finished / "height_map.npz").write_bytes(b"\x80\x04cos\nsystem\n.")
    assert client.get(f"/api/runs/{finished}/surface").status_code == 400


def test_files_of_a_run_folder_that_are_nonsense_break_no_list(
    client: TestClient, workspace: Workspace, finished: str
) -> None:
    for content in (b"[]", b"{", b'{"format": 1, "verdict": 3, "inputs": 5}', b'{"format": 99}', b"[" * 100_000):
        (workspace.folder / finished / "report.json").write_bytes(content)
        run = client.get("/api/runs").json()[0]
        assert run["name"] == finished
    images = workspace.folder / "images" / "odd"
    images.mkdir()
    for content in (b"[]", b"{", b'{"format": 1, "state": "odd"}', b"[" * 100_000):
        (images / ".semscape-app.json").write_bytes(content)
        assert {run["name"] for run in client.get("/api/runs").json()} == {finished, "odd"}


def test_a_run_of_a_newer_semscape_is_told_and_left_alone(
    client: TestClient, workspace: Workspace, finished: str
) -> None:
    state = workspace.folder / "images" / "newer" / ".semscape-app.json"
    state.parent.mkdir()
    state.write_bytes(b'{"format": 99}')
    runs = {run["name"]: run for run in client.get("/api/state").json()["runs"]}
    assert set(runs) == {finished, "newer"}
    assert runs["newer"]["state"] == "failed"
    assert "update semscape" in runs["newer"]["message"]
    assert str(workspace.folder) not in runs["newer"]["message"]
    assert client.put("/api/runs/newer", json={"title": "mine"}).status_code == 404
    assert client.post("/api/runs/newer/reconstruct", json={}).status_code == 404
    assert state.read_bytes() == b'{"format": 99}'
