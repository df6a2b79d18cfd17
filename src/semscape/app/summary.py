"""What the page shows of a run: in the list, and in full."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Literal

from pydantic import BaseModel, Field

from semscape.app.plain_words import plain_words
from semscape.app.progress import STAGES, StageProgress, read_progress
from semscape.app.run_state import State
from semscape.app.workspace import Run, Workspace
from semscape.io.lock import LOCK_NAME, is_locked
from semscape.io.work_folder import LOG_NAME

Grade = Literal["good", "usable", "do not measure", ""]
_GRADES: tuple[Grade, ...] = ("good", "usable", "do not measure")


class Stage(BaseModel):
    """A stage of a run."""

    name: str
    state: Literal["waiting", "running", "done"]
    seconds: float | None = Field(description="How long it took, or how long it has been going on, in s")
    figures: dict[str, Any] = Field(description="What came out of it")


class Summary(BaseModel):
    """A run in the list."""

    name: str = Field(description="Its name in addresses, and of its folder in the workspace")
    title: str
    state: State
    place: int = Field(description="1 is the next one in the queue; 0 does not wait")
    n_images: int
    has_images: bool = Field(description="Whether its images are in the workspace, so that it can be made again")
    has_result: bool
    is_stale: bool = Field(description="Whether the images, or what is told of them, have changed since the result")
    grade: Grade = Field(description="How far the result may be trusted")
    verdict: str
    message: str = Field(description="Why it failed, and what to do")
    settings: list[str] = Field(description="Options that were given for it, as `--set` takes them")
    sign_is_assumed: bool = Field(description="Whether nothing but shading gives the sign of the relief")
    picture: str = Field(description="Stored name of an image that stands for it; empty if it has none")
    has_preview: bool
    stages: list[Stage] = Field(description="Of a run that is being made, or was interrupted")
    revision: str = Field(description="Changes whenever anything of the result does")


def summarize(workspace: Workspace, run: Run, waiting: Sequence[str] = ()) -> Summary:
    """Return a run as the list shows it.

    Parameters
    ----------
    workspace : Workspace
    run : Run
    waiting : sequence of str
        Names of the runs in the queue, the next one first.
    """
    report = workspace.report(run) if run.has_result else {}
    verdict, inputs = str(report.get("verdict", "")), report.get("inputs")
    state = run.state.state
    made_elsewhere = not run.state.is_busy and (run.folder / LOCK_NAME).is_file() and is_locked(run.folder)
    if made_elsewhere:
        state = "running"
    elif state == "draft" and run.has_result and not run.state.edited:
        state = "done"
    elif state == "done" and not run.has_result:
        state = "draft" if run.images else "failed"
    images = run.image_names()
    unfinished = state in ("running", "failed", "cancelled", "queued")
    progress = read_progress(run.work / LOG_NAME) if unfinished else ()
    return Summary(
        name=run.name,
        title=run.state.title or run.name,
        state=state,
        place=waiting.index(run.name) + 1 if run.name in waiting else 0,
        n_images=len(images) if run.images else len(inputs) if isinstance(inputs, list) else 0,
        has_images=run.images is not None,
        has_result=run.has_result,
        is_stale=run.has_result and run.state.edited,
        grade=next((grade for grade in _GRADES if verdict.startswith(grade)), ""),
        verdict=plain_words(verdict),
        message=_message(run, state, made_elsewhere),
        settings=list(run.state.settings),
        sign_is_assumed=report.get("ambiguity") == "reflection",
        picture=images[len(images) // 2] if images else "",
        has_preview=unfinished and (run.work / "calibrate.value").is_file(),
        stages=_stages(progress, state == "running") if unfinished and (progress or state == "running") else [],
        revision=_revision(run),
    )


def _stages(progress: Sequence[StageProgress], goes_on: bool) -> list[Stage]:
    known = {stage.name: stage for stage in progress}
    stages = []
    for name in STAGES:
        found = known.get(name)
        if found is None:
            stages.append(Stage(name=name, state="waiting", seconds=None, figures={}))
        elif found.seconds is None:
            since = round(max(0.0, time.time() - found.began_s)) if goes_on else None
            stages.append(Stage(name=name, state="running" if goes_on else "waiting", seconds=since, figures={}))
        else:
            stages.append(Stage(name=name, state="done", seconds=found.seconds, figures=found.figures))
    return stages


def _message(run: Run, state: State, made_elsewhere: bool) -> str:
    if made_elsewhere:
        return "another program is making this run"
    if state == "failed" and not run.state.message:
        return "the run folder is not complete: it was interrupted"
    return plain_words(run.state.message, run)


def _revision(run: Run) -> str:
    try:
        status = (run.folder / "height_map.npz").stat()
        return f"{status.st_mtime_ns:x}-{status.st_size:x}"
    except OSError:
        return ""
