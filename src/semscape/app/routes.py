"""The addresses of the app: each a few lines about values that the other modules make."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from anyio import sleep, to_thread
from fastapi import APIRouter, Query, Request
from fastapi.responses import FileResponse, Response, StreamingResponse
from pydantic import BaseModel, Field
from starlette.background import BackgroundTask

from semscape.app.app_options import AppOptions
from semscape.app.desk import Desk
from semscape.app.exports import FORMAT_NAMES
from semscape.app.names import displayed_name
from semscape.app.plain_words import plain_words
from semscape.app.removed import RemovedRun, remove_run, removed_runs, restore_run
from semscape.app.requests import CellEdit, MeasureQuestion, NewRun, ReconstructRequest, convert_settings
from semscape.app.run_queue import RunQueue
from semscape.app.security import REPORT_POLICY
from semscape.app.series_table import SeriesTable, Understanding, edit_cell, redo, undo
from semscape.app.snapshots import Snapshots
from semscape.app.summary import Summary, summarize
from semscape.app.uploads import remove_file, take_file
from semscape.app.workspace import Run, UnknownRunError, Workspace, read_plain_file
from semscape.io.work_folder import LOG_NAME

_MOST_REPORT_BYTES = 200_000_000
_SMALL_PX = 240
_EVENT_INTERVAL_S = 0.5
_EVENT_LIFE = 20  # silent intervals between signs of life


class Problem(BaseModel):
    """What went wrong, and what to do."""

    detail: str


class AppState(BaseModel):
    """What a page needs to begin."""

    version: str
    workspace: str = Field(description="Folder of the runs")
    max_file_mb: int
    max_files: int
    max_run_mb: int
    formats: list[str] = Field(description="Of the exports")
    runs: list[Summary]


class Removed(BaseModel):
    """A run that was put aside."""

    key: str = Field(description="Name of its folder in `removed`")
    title: str
    removed_s: float = Field(description="When that was, in s since 1970")

    @classmethod
    def of(cls, run: RemovedRun) -> Removed:
        """Describe one."""
        return cls(key=run.folder.name, title=run.title, removed_s=run.removed_s)


@dataclass(frozen=True)
class Parts:
    """All that the routes work on."""

    workspace: Workspace
    queue: RunQueue
    desk: Desk
    limits: AppOptions
    is_ending: Callable[[], bool] = lambda: False
    understanding: Understanding = field(init=False)
    snapshots: Snapshots = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "understanding", Understanding(self.desk))
        object.__setattr__(self, "snapshots", Snapshots(self.workspace, self.queue))

    def summary(self, run: Run) -> Summary:
        """Return a run as the list shows it."""
        return summarize(self.workspace, run, self.queue.waiting())

    def made(self, make: Callable[[Path], None], *key: str) -> Path:
        """Return a file of the cache, made if it is not there."""
        path = self.workspace.cached(*key)
        if not path.is_file():
            make(path)
        return path


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return FastAPI's description of refusals: every one of them has a `detail` in words."""
    return {status: {"model": Problem} for status in (401, 403, 413, 422, *statuses)}


def _binary(kind: str) -> dict[int | str, dict[str, Any]]:
    return {200: {"content": {kind: {"schema": {"type": "string", "format": "binary"}}}}}


def run_routes(parts: Parts) -> APIRouter:
    """Return the routes of the list, of the images, and of making a run."""
    router = APIRouter(prefix="/api", responses=problems())
    workspace, queue = parts.workspace, parts.queue
    of_a_run = problems(400, 404)
    changing = problems(400, 404, 409)

    @router.get("/state")
    def state() -> AppState:
        """Return what a page needs to begin."""
        from semscape import __version__

        limits = parts.limits
        return AppState(
            version=__version__,
            workspace=str(workspace.folder),
            max_file_mb=limits.max_file_mb,
            max_files=limits.max_files,
            max_run_mb=limits.max_run_mb,
            formats=list(FORMAT_NAMES),
            runs=parts.snapshots.runs(),
        )

    @router.get("/runs")
    def runs() -> list[Summary]:
        """Return all runs."""
        return parts.snapshots.runs()

    @router.get("/events", responses=_binary("text/event-stream"), response_class=StreamingResponse)
    async def events() -> StreamingResponse:
        """Send all runs whenever one of them has changed (server-sent events)."""

        async def lines() -> AsyncIterator[str]:
            sent, silent = "", 0
            while not parts.is_ending():
                text = await to_thread.run_sync(parts.snapshots.text)
                silent = 0 if text != sent else silent + 1
                if text != sent:
                    yield f"event: runs\ndata: {text}\n\n"
                    sent = text
                elif silent % _EVENT_LIFE == 0:
                    yield ": alive\n\n"
                await sleep(_EVENT_INTERVAL_S)

        return StreamingResponse(lines(), media_type="text/event-stream")

    @router.post("/runs", status_code=201, responses=problems(400))
    def create(body: NewRun) -> Summary:
        """Make a run without images."""
        with queue.lock:
            return parts.summary(workspace.create(body.title))

    @router.get("/runs/{name}", responses=of_a_run)
    def one(name: str) -> Summary:
        """Return one run."""
        return parts.summary(workspace.run(name))

    @router.put("/runs/{name}", responses=of_a_run)
    def rename(name: str, body: NewRun) -> Summary:
        """Give a run another title; its folders keep their name."""
        with queue.lock:
            run = workspace.run(name)
            title = displayed_name(body.title) or run.name
            return parts.summary(workspace.put_state(run, replace(run.state, title=title)))

    @router.delete("/runs/{name}", responses=changing)
    def remove(name: str) -> Removed:
        """Move a run to the folder `removed` of the workspace."""
        with queue.lock:
            return Removed.of(remove_run(workspace, workspace.run(name)))

    @router.get("/removed")
    def removed() -> list[Removed]:
        """Return the runs in the folder `removed`, the last one first."""
        return [Removed.of(run) for run in removed_runs(workspace)]

    @router.post("/removed/{key}/restore", responses=of_a_run)
    def restore(key: str) -> Summary:
        """Bring a removed run back."""
        with queue.lock:
            return parts.summary(restore_run(workspace, key))

    @router.put(
        "/runs/{name}/files",
        responses=changing,
        openapi_extra={"requestBody": {"content": {"application/octet-stream": {"schema": {"type": "string"}}}}},
    )
    async def put_file(
        name: str, request: Request, filename: Annotated[str, Query(min_length=1, max_length=300)]
    ) -> Summary:
        """Take one file of a series: an image, a microscope's text beside it, or a series.toml."""
        told = request.headers.get("content-length", "0")
        size = int(told) if told.isdecimal() else 0
        run = await take_file(workspace, queue, name, filename, size, request.stream(), parts.limits)
        return await to_thread.run_sync(parts.summary, run)

    @router.delete("/runs/{name}/files/{image}", responses=changing)
    def delete_file(name: str, image: str) -> Summary:
        """Take an image out of a series."""
        return parts.summary(remove_file(workspace, queue, name, image))

    @router.get("/runs/{name}/images/{image}", responses=of_a_run | _binary("image/png"), response_class=FileResponse)
    def picture(name: str, image: str) -> FileResponse:
        """Return a small picture of a micrograph."""
        run = workspace.run(name)
        images = run.require_images()
        found = next((known for known in run.image_names() if known == image), None)
        if found is None:
            raise UnknownRunError("there is no such image in this run")
        changed = (images / found).stat().st_mtime_ns
        draw = partial(parts.desk.do, "draw_image", images / found, _SMALL_PX)
        path = parts.made(draw, "image", run.name, found, str(changed))
        return FileResponse(path, media_type="image/png", headers={"Cache-Control": "private, max-age=3600"})

    @router.get("/runs/{name}/series", responses=of_a_run)
    def series(name: str) -> SeriesTable:
        """Return what was understood of a run's images, and what was told of them."""
        return parts.understanding.table(workspace.run(name))

    @router.put("/runs/{name}/cells", responses=changing)
    def cell(name: str, body: CellEdit) -> SeriesTable:
        """Fill or empty a cell of the table; it is written into series.toml."""
        return parts.understanding.table(edit_cell(workspace, queue, name, body.image, body.key, body.value))

    @router.post("/runs/{name}/undo", responses=changing)
    def undo_edit(name: str) -> SeriesTable:
        """Take the last edit back."""
        return parts.understanding.table(undo(workspace, queue, name))

    @router.post("/runs/{name}/redo", responses=changing)
    def redo_edit(name: str) -> SeriesTable:
        """Make the edit that was undone last once more."""
        return parts.understanding.table(redo(workspace, queue, name))

    @router.post("/runs/{name}/reconstruct", responses=changing)
    def reconstruct(name: str, body: ReconstructRequest) -> Summary:
        """Let the run wait for its turn."""
        return parts.summary(queue.submit(name, body.settings))

    @router.post("/runs/{name}/cancel", responses=changing)
    def cancel(name: str) -> Summary:
        """Stop the run, or take it out of the queue."""
        return parts.summary(queue.cancel(name))

    return router


def result_routes(parts: Parts) -> APIRouter:
    """Return the routes of what came out of a run."""
    router = APIRouter(prefix="/api/runs/{name}", responses=problems(400, 404))
    workspace, desk = parts.workspace, parts.desk

    def finished(name: str) -> tuple[Run, str]:
        run = workspace.run(name)
        if not run.has_result:
            raise UnknownRunError("this run has no result yet")
        return run, parts.summary(run).revision

    @router.get("/preview", responses=_binary("application/octet-stream"), response_class=Response)
    def preview(name: str) -> Response:
        """Return the sparse points of a run that goes on: float32 x, y, z, little-endian, um or px."""
        points = desk.do("sparse_points", workspace.run(name).work)
        return Response(points, media_type="application/octet-stream")

    @router.get("/thumbnail", responses=_binary("image/png"), response_class=FileResponse)
    def thumbnail(name: str) -> FileResponse:
        """Return a small picture of the surface."""
        run, revision = finished(name)
        draw = partial(desk.do, "draw_thumbnail", run.folder)
        path = parts.made(draw, "thumbnail", run.name, revision)
        return FileResponse(path, media_type="image/png", headers={"Cache-Control": "private, max-age=3600"})

    @router.get("/surface", responses=_binary("application/octet-stream"), response_class=FileResponse)
    def surface(name: str) -> FileResponse:
        """Return what the viewer shows (docs/viewer.md)."""
        run, revision = finished(name)
        path = parts.made(partial(desk.do, "write_surface", run.folder), "surface", run.name, revision)
        return FileResponse(path, media_type="application/octet-stream")

    @router.get("/result")
    def result(name: str) -> dict[str, Any]:
        """Return report.json, its warnings in the page's words."""
        run, _ = finished(name)
        report = workspace.report(run)
        told = report.get("warnings")
        return report | {"warnings": [plain_words(str(text), run) for text in told] if isinstance(told, list) else []}

    @router.get("/log", responses=_binary("text/plain"), response_class=Response)
    def log(name: str) -> Response:
        """Return what happened in a run, a line of JSON for each event."""
        run = workspace.run(name)
        path = run.work / LOG_NAME if (run.work / LOG_NAME).is_file() else run.folder / LOG_NAME
        text = read_plain_file(path, _MOST_REPORT_BYTES)
        return Response(text, media_type="text/plain; charset=utf-8")

    @router.get("/report", responses=_binary("text/html"), response_class=Response)
    def report(name: str) -> Response:
        """Return report.html, in an origin of its own that reaches nothing of this app."""
        run, _ = finished(name)
        page = read_plain_file(run.folder / "report.html", _MOST_REPORT_BYTES)
        return Response(page, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})

    @router.get("/export/{format_name}", responses=_binary("application/octet-stream"), response_class=FileResponse)
    def export(
        name: str,
        format_name: str,
        unit: Annotated[str | None, Query(max_length=10)] = None,
        color: Annotated[str | None, Query(max_length=40)] = None,
    ) -> FileResponse:
        """Return the surface in a format of `semscape convert`."""
        run, _ = finished(name)
        if format_name not in FORMAT_NAMES:
            raise UnknownRunError(f"there is no such format; there are {', '.join(FORMAT_NAMES)}")
        folder = Path(tempfile.mkdtemp(prefix="export-", dir=workspace.cache))
        try:
            settings = convert_settings(unit, color)
            path = desk.do("exported", run.folder, format_name, settings, run.images, folder)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        clear = BackgroundTask(shutil.rmtree, folder, ignore_errors=True)
        return FileResponse(path, media_type="application/octet-stream", filename=path.name, background=clear)

    @router.post("/measure")
    def measure(name: str, body: MeasureQuestion) -> dict[str, Any]:
        """Measure the surface: ISO 25178 parameters of the whole or a region, profile, step, angle, distance."""
        run, _ = finished(name)
        answer: dict[str, Any] = desk.do("measured", run.folder, body.settings(), body.places())
        return answer | {"warnings": [plain_words(text) for text in answer["warnings"]]}

    return router
