"""A small app without a network: its calculations run in this process, its runs are made by hand."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from held_jobs import InlineDesk, Jobs

from semscape.app.app_options import AppOptions
from semscape.app.routes import Parts
from semscape.app.run_queue import RunQueue
from semscape.app.security import Access
from semscape.app.server import build_app
from semscape.app.workspace import Workspace
from semscape.report.run import write_run
from synthetic_result import make_result

PORT = 8765
ORIGIN = f"http://127.0.0.1:{PORT}"


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(make_result(), tmp_path_factory.mktemp("finished") / "run")


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    return Workspace(tmp_path / "workspace")


@pytest.fixture
def jobs(finished_run: Path) -> Jobs:
    return Jobs(finished_run)


@pytest.fixture
def parts(workspace: Workspace, jobs: Jobs) -> Parts:
    limits = AppOptions(max_file_mb=1, max_files=6, max_run_mb=2)
    return Parts(workspace, RunQueue(workspace, jobs), InlineDesk(), limits)  # type: ignore[arg-type]


@pytest.fixture
def access() -> Access:
    return Access(PORT)


@pytest.fixture
def stranger(parts: Parts, access: Access) -> Iterator[TestClient]:
    """Return a client that has reached the server, but holds no token."""
    app = build_app(parts, access)
    with TestClient(app, base_url=ORIGIN, headers={"Origin": ORIGIN}, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def client(stranger: TestClient, access: Access) -> TestClient:
    """Return a client that was opened by the address with the token."""
    answer = stranger.get("/", params={"token": access.token}, follow_redirects=False)
    assert answer.status_code == 303
    assert answer.headers["location"] == "/"
    return stranger


@pytest.fixture
def uploaded(client: TestClient, master_images: Path) -> str:
    """Return the name of a run whose three images have been sent."""
    name: str = client.post("/api/runs", json={"title": "fracture"}).json()["name"]
    for path in sorted(master_images.glob("*.tif")):
        answer = client.put(f"/api/runs/{name}/files", params={"filename": path.name}, content=path.read_bytes())
        assert answer.status_code == 200, answer.text
    return name


@pytest.fixture
def finished(workspace: Workspace, finished_run: Path) -> str:
    """Return the name of a run that was made elsewhere."""
    shutil.copytree(finished_run, workspace.folder / "by hand")
    return "by hand"
