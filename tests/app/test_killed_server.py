"""A real server on a real port: opened by its address, killed without warning, started again."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from app_server import WAIT_S, app_command, app_environment, opened, served
from run_products import products

SETTINGS = ["sfm.de_generations=10", "dense.max_pairs=1", "dense.mesh_max_vertices=2000"]


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
    with served(workspace) as (process, address), opened(address) as client:
        for title in ("first", "second"):
            client.post("/api/runs", json={"title": title})
            for path in sorted(master_images.glob("*.tif")):
                sent = client.put(f"/api/runs/{title}/files", params={"filename": path.name}, content=path.read_bytes())
                assert sent.status_code == 200
            client.post(f"/api/runs/{title}/reconstruct", json={"settings": SETTINGS})
        wait_for(workspace / "first" / ".semscape-work" / "detect.value")
        process.send_signal(signal.SIGKILL)
        process.wait(20)
    time.sleep(0.3)  # the worker ends with its server
    assert not (workspace / "first" / "report.json").exists()
    with served(workspace) as (_, address), opened(address) as client:
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
    with served(tmp_path) as (_, address), opened(address) as client:
        port = client.base_url.port
        again = app_command(tmp_path)
        elsewhere = [*app_command(tmp_path / "other"), "--port", str(port)]
        for command, words in ((again, "another process"), (elsewhere, "--port")):
            ended = subprocess.run(
                command, env=app_environment(), capture_output=True, text=True, timeout=60, check=False
            )
            assert ended.returncode == 2
            assert words in ended.stderr
        sockets = Path("/proc/net/tcp")
        if sockets.exists():
            hexadecimal = f"{port:04X}"
            listening = [line.split()[1] for line in sockets.read_text().splitlines()[1:] if line.split()[3] == "0A"]
            assert [address for address in listening if address.endswith(f":{hexadecimal}")] == [
                f"0100007F:{hexadecimal}"
            ]
