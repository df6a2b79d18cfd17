"""The one folder that the app sees: run folders in it, and the images of runs under `images`.

    WORKSPACE/pollen/           a run folder, made by the app or by `semscape reconstruct -o WORKSPACE/pollen`
    WORKSPACE/images/pollen/    its micrographs, with series.toml
    WORKSPACE/.semscape-app/    pictures and files that can be made again

A name from outside is looked up among what is there; no path is ever made of it. Links are not followed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from semscape.app.names import run_name, run_title
from semscape.app.run_state import RunState, read_state, write_state
from semscape.errors import BadInputError
from semscape.io.image_file import IMAGE_SUFFIXES
from semscape.io.run_folder import RUN_FORMAT, WORK_NAME, make_folder
from semscape.io.series import natural_key
from semscape.io.series_toml import SIDECAR_NAME

IMAGES_NAME, APP_NAME, REMOVED_NAME = "images", ".semscape-app", "removed"
_MOST_REPORT_BYTES = 64_000_000


class UnknownRunError(BadInputError):
    """There is no such run, or nothing of what is asked for."""


class BusyRunError(BadInputError):
    """The run waits or is being made; it must be cancelled first."""


@dataclass(frozen=True)
class Run:
    """A run of the workspace: its folder, which may not be there yet, its images, None where it has none, its state."""

    name: str
    folder: Path
    images: Path | None
    state: RunState

    @property
    def work(self) -> Path:
        """Where what is finished of a run that goes on lies."""
        return self.folder / WORK_NAME

    @property
    def has_result(self) -> bool:
        """Whether the run folder is complete."""
        return (self.folder / "report.json").is_file() and (self.folder / "height_map.npz").is_file()

    def image_names(self) -> list[str]:
        """Return the images' stored names in natural order."""
        if self.images is None:
            return []
        found = [name for name in _plain_files(self.images) if Path(name).suffix.lower() in IMAGE_SUFFIXES]
        return sorted(found, key=natural_key)

    def originals(self) -> dict[str, str]:
        """Return what each file among the images was called before it came here, by its stored name."""
        if self.images is None:
            return {}
        files = [name for name in _plain_files(self.images) if name != SIDECAR_NAME]
        return {name: self.state.originals.get(name, name) for name in files}

    def require_idle(self) -> None:
        """Raise `BusyRunError` where the images must stay as they are."""
        if self.state.is_busy:
            raise BusyRunError("this run waits or is being made; cancel it before you change its images")

    def require_images(self) -> Path:
        """Return the folder of the images; `UnknownRunError` where there is none."""
        if self.images is None:
            reason = self.state.message or "its images are not in this workspace"
            raise UnknownRunError(f"{self.name} was made elsewhere: {reason}")
        return self.images


class Workspace:
    """The runs of one folder.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.

    Raises
    ------
    BadInputError
        If the folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = make_folder(folder.expanduser()).resolve()
        self.app_folder = make_folder(self.folder / APP_NAME)
        self._images = make_folder(self.folder / IMAGES_NAME)
        self._reports: dict[Path, tuple[tuple[int, int], dict[str, Any]]] = {}

    def names(self) -> list[str]:
        """Return the names of all runs, naturally sorted."""
        made = {name for name in _plain_folders(self.folder) if _is_run(self.folder / name)}
        made -= {IMAGES_NAME, REMOVED_NAME}
        with_images = {
            name
            for name in _plain_folders(self._images)
            if _has_no_links(self._images / name) and _has_no_links_or_is_absent(self.folder / name)
        }
        return sorted(made | with_images, key=natural_key)

    def runs(self) -> list[Run]:
        """Return all runs."""
        return [self._run(name) for name in self.names()]

    def run(self, name: str) -> Run:
        """Return one run.

        Raises
        ------
        UnknownRunError
            If there is none of that name.
        """
        found = next((known for known in self.names() if known == name), None)
        if found is None:
            raise UnknownRunError("there is no such run in the workspace; it may have been removed")
        return self._run(found)

    def create(self, title: str) -> Run:
        """Make a run without images."""
        name = run_name(title, self._taken_names())
        shown = run_title(title, [run.state.title for run in self.runs()]) or name
        folder = make_folder(self._images / name)
        write_state(folder, RunState(title=shown))
        return self._run(name)

    def free_name(self, name: str) -> str:
        """Return the name of a run that was here before, or one like it where it is taken by now."""
        taken = self._taken_names()
        is_free = not name.startswith(".") and name.casefold() not in {item.casefold() for item in taken}
        return name if is_free else run_name(name, taken)

    def put_state(self, run: Run, state: RunState) -> Run:
        """Remember a run's state and return the run with it."""
        write_state(run.require_images(), state)
        return self._run(run.name)

    def report(self, run: Run) -> dict[str, Any]:
        """Return a finished run's report.json; empty where there is none that can be read."""
        path = run.folder / "report.json"
        try:
            status = path.lstat()
            key = status.st_mtime_ns, status.st_size
            if not stat.S_ISREG(status.st_mode) or status.st_size > _MOST_REPORT_BYTES:
                return {}
            if path not in self._reports or self._reports[path][0] != key:
                values = json.loads(path.read_bytes())
                known = isinstance(values, dict) and values.get("format") == RUN_FORMAT
                self._reports[path] = key, values if known else {}
            return self._reports[path][1]
        except (OSError, ValueError, RecursionError):
            return {}

    @property
    def cache(self) -> Path:
        """Folder of files that can be made again."""
        return make_folder(self.app_folder / "cache")

    def cached(self, *key: str) -> Path:
        """Return where a file that can be made again is kept, by what it was made from."""
        return self.cache / hashlib.sha256("\0".join(key).encode("utf-8", "surrogateescape")).hexdigest()

    def clear_cache(self) -> None:
        """Remove everything that can be made again."""
        shutil.rmtree(self.app_folder / "cache", ignore_errors=True)

    def _taken_names(self) -> list[str]:
        return [*_entries(self.folder), *_entries(self._images), IMAGES_NAME, REMOVED_NAME]

    def _run(self, name: str) -> Run:
        images = self._images / name
        has_images = images.is_dir()
        folder = self.folder / name
        try:
            state = read_state(images) if has_images else RunState(title=name, state="done")
        except BadInputError as error:  # of a newer semscape: shown, and left as it is, beside the runs that are known
            state, has_images = RunState(title=name, state="failed", message=str(error)), False
        return Run(name, folder, images if has_images else None, state)


def read_plain_file(path: Path, most_bytes: int) -> bytes:
    """Return the bytes of a file that is no link.

    Raises
    ------
    UnknownRunError
        If there is no such file, or it is a link, or larger than allowed.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode) or status.st_size > most_bytes:
                raise UnknownRunError(f"{path.name} is no plain file, or too large to be shown")
            return file.read()
    except OSError as error:
        raise UnknownRunError(f"{path.name} cannot be read: {error.strerror or error}") from error


def _entries(folder: Path) -> list[str]:
    try:
        return [entry.name for entry in os.scandir(folder)]
    except OSError:
        return []


def _plain_folders(folder: Path) -> list[str]:
    with os.scandir(folder) as entries:
        return [e.name for e in entries if not e.name.startswith(".") and e.is_dir(follow_symlinks=False)]


def _plain_files(folder: Path) -> list[str]:
    with os.scandir(folder) as entries:
        return [e.name for e in entries if not e.name.startswith(".") and e.is_file(follow_symlinks=False)]


def _has_no_links(folder: Path) -> bool:
    try:
        with os.scandir(folder) as entries:
            return not any(entry.is_symlink() for entry in entries)
    except OSError:
        return False


def _is_run(folder: Path) -> bool:
    """Tell whether a folder is a complete run, or one that goes on; one that holds links is neither."""
    is_run = (folder / "report.json").is_file() or (folder / WORK_NAME).is_dir()
    return is_run and _has_no_links(folder) and _has_no_links_or_is_absent(folder / WORK_NAME)


def _has_no_links_or_is_absent(folder: Path) -> bool:
    return not folder.is_symlink() and (not folder.exists() or _has_no_links(folder))
