"""A real server on a real port: opened by its address, killed without warning, started again."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2
import pytest
from run_products import products

SETTINGS = ["sfm.de_generations=10", "dense.max_pairs=1", "dense.mesh_max_vertices=2000"]
WAIT_S = 120


@contextmanager
def served(workspace: Path) -> Iterator[tuple[subprocess.Popen[str], httpx2.Client]]:
    """Serve a workspace; give the process, and a client that has opened its address."""
    command = [sys.executable, "-m", "semscape", "app", "--no-browser", "--workspace", str(workspace)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = next(found[0] for line in process.stdout if (found := re.search(r"http://\S+", line)))
        origin = address.partition("/?")[0]
        with httpx2.Client(base_url=origin, headers={"Origin": origin}, timeout=30) as client:
            until = time.monotonic() + WAIT_S
            while True:
                try:
                    assert client.get(address).status_code == 303
                    break
                except httpx2.TransportError:
                    assert time.monotonic() < until
                    time.sleep(0.05)
            yield process, client
    finally:
        process.terminate()
        process.communicate(timeout=20)


def wait_for(path: Path) -> None:
    until = time.monotonic() + WAIT_S
    while not path.exists():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_a_server_that_is_killed_loses_no_run(
    master_images: Path, undisturbed: dict[str, bytes], tmp_path: Path
) -> None:
    workspace = tmp_path / "workspace"
    with served(workspace) as (process, client):
        for title in ("first", "second"):
            client.post("/api/runs", json={"title": title})
            for path in sorted(master_images.glob("*.tif")):
                sent = client.put(
                    f"/api/runs/{title}/files", params={"filename": path.name}, content=path.read_bytes()
                )
                assert sent.status_code == 200
            client.post(f"/api/runs/{title}/reconstruct", json={"settings": SETTINGS})
        wait_for(workspace / "first" / ".semscape-work" / "detect.value")
        process.send_signal(signal.SIGKILL)
        process.wait(20)
    time.sleep(0.3)  # the worker ends with its server
    assert not (workspace / "first" / "report.json").exists()
    with served(workspace) as (_, client):
        until = time.monotonic() + WAIT_S
        while [run["state"] for run in client.get("/api/runs").json()] != ["done", "done"]:
            assert time.monotonic() < until, client.get("/api/runs").json()
            time.sleep(0.1)
        with client.stream("GET", "/api/events") as events:
            assert next(line for line in events.iter_lines() if line) == "event: runs"
    assert products(workspace / "first") == undisturbed
    assert products(workspace / "second") == undisturbed
    assert "taken from the interrupted run" in (workspace / "first" / "run.log").read_text()


def test_a_workspace_is_served_once_and_on_this_machine_alone(tmp_path: Path) -> None:
    with served(tmp_path) as (_, client):
        second = subprocess.run(
            [sys.executable, "-m", "semscape", "app", "--no-browser", "--workspace", str(tmp_path)],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert second.returncode == 2
        assert "another process" in second.stderr
        taken = subprocess.run(
            [sys.executable, "-m", "semscape", "app", "--port", str(client.base_url.port), "--no-browser",
             "--workspace", str(tmp_path / "other")],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )  # fmt: skip
        assert taken.returncode == 2
        assert "--port" in taken.stderr
        sockets = Path("/proc/net/tcp")
        if sockets.exists():
            port = f"{client.base_url.port:04X}"
            listening = [line.split()[1] for line in sockets.read_text().splitlines()[1:] if line.split()[3] == "0A"]
            assert [address for address in listening if address.endswith(f":{port}")] == [f"0100007F:{port}"]
