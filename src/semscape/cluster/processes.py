"""Local processes: workers that stay, each with its share of the cores, replaced when they die."""

from __future__ import annotations

import logging
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any, BinaryIO, cast

from semscape.cluster.executor import Event, Outcome, WorkerLostError, in_order, outcome, pack
from semscape.cluster.worker import ANSWER, FUNCTION, NOTICE, TASK, read_frame, write_frame
from semscape.errors import OutOfMemoryError
from semscape.io.process_status import status_mb

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
_PROGRAM = "from semscape.cluster.worker import main; main()"
_MOST_ATTEMPTS = 2
_KILLED = 9  # SIGKILL, a name that Windows does not know
_WATCH_S = 0.05
_log = logging.getLogger("semscape.cluster")
_REDUCE = "fewer --workers, smaller images, or --set dense.tile_px=512 and --set features.max_keypoints=10000"


class Worker:
    """One process of `semscape.cluster.worker`, started when it is first needed and again when it has died.

    Parameters
    ----------
    threads : int
        Most threads of NumPy, Numba and OpenCV in it.
    memory_mb : int
        Most memory that it may hold, in MB (Linux only); 0 is no limit. It is watched from outside, and ended where it
        holds more: libraries that are refused memory crash, hang, or blame something else.
    """

    def __init__(self, threads: int, memory_mb: int = 0) -> None:
        self._threads, self._memory_mb = threads, memory_mb
        self.n_sent = 0
        """Bytes of functions and tasks that the process was sent so far."""
        self._held_mb = 0.0
        self._process: subprocess.Popen[bytes] | None = None
        self._function = b""
        self._stage = ""
        self._closed = False

    def ask(self, shared: bytes, request: bytes, on_notice: Callable[[str], None] | None = None) -> bytes:
        """Return the answer to one task; it is tried again in a new process where the first one dies.

        Raises
        ------
        OutOfMemoryError
            If it needs more memory than it may have; the message holds the stage and what to reduce.
        WorkerLostError
            If the process died each time; the message holds the stage.
        """
        status = 0
        for _ in range(_MOST_ATTEMPTS):
            self._held_mb = 0.0
            reply = self._try(shared, request, on_notice)
            if reply is not None:
                return reply
            status = self.stop()
            if self._closed:
                break
        stage = f" in stage {self._stage}" if self._stage else " before its first stage"
        if self._held_mb:
            raise OutOfMemoryError(
                f"out of memory{stage}: its process held {self._held_mb:.0f} MB, and --memory-mb allows "
                f"{self._memory_mb}; give more, or {_REDUCE}"
            )
        how = f"by signal {signal.Signals(-status).name}" if status < 0 else f"with exit code {status}"
        advice = f"; this is most often a lack of memory: {_REDUCE}" if status == -_KILLED else ""
        raise WorkerLostError(f"the worker process was ended {how}{stage}, {_MOST_ATTEMPTS} times{advice}")

    def stop(self) -> int:
        """End the process at once and return its exit status."""
        process, self._process, self._function = self._process, None, b""
        if process is None:
            return 0
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.05 if self._closed else 1.0)  # it may be dying by itself, which is worth knowing
        process.kill()
        status = process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()
        return status

    def close(self) -> None:
        """End the process for good."""
        self._closed = True
        if self._process is not None:
            self._process.kill()

    def _try(self, shared: bytes, request: bytes, on_notice: Callable[[str], None] | None) -> bytes | None:
        self._stage = ""
        try:
            process = self._started()
            stdin, stdout = cast(BinaryIO, process.stdin), cast(BinaryIO, process.stdout)
            if shared != self._function:
                write_frame(stdin, FUNCTION, shared)
                self._function = shared
                self.n_sent += len(shared)
            write_frame(stdin, TASK, request)
            self.n_sent += len(request)
            while (frame := read_frame(stdout)) is not None:
                kind, content = frame
                if kind == ANSWER:
                    return content
                if kind == NOTICE:
                    self._stage = content.decode()
                    if on_notice:
                        on_notice(self._stage)
        except (OSError, ValueError):  # a broken pipe, or one that `close` has shut
            pass
        return None

    def _started(self) -> subprocess.Popen[bytes]:
        if self._closed:
            raise OSError("the worker is closed")
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=worker_environment(self._threads),
                start_new_session=True,  # Ctrl-C reaches the master alone
            )
            threading.Thread(target=_relay, args=(self._process.stderr,), daemon=True).start()
            if self._memory_mb:
                threading.Thread(target=self._watch, args=(self._process,), daemon=True).start()
        return self._process

    def _watch(self, process: subprocess.Popen[bytes]) -> None:
        while process.poll() is None:
            held_mb = status_mb("VmRSS", process.pid)
            if held_mb > self._memory_mb:
                self._held_mb = held_mb
                process.kill()
            time.sleep(_WATCH_S)


def _relay(lines: BinaryIO) -> None:
    """Log what a process prints, a library's complaint or its last word: --log-json promises lines of JSON."""
    with lines:
        for line in lines:
            _log.warning("worker: %s", line.decode(errors="replace").rstrip())


def worker_environment(threads: int) -> dict[str, str]:
    """Return the environment of a worker: its number of threads, and the modules of this process."""
    path = os.pathsep.join(item for item in sys.path if item)
    return {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, str(threads)), "PYTHONPATH": path}


class LocalProcesses:
    """Tasks on processes of this machine; to be used as a context manager, which ends them.

    Parameters
    ----------
    workers : int
        Number of processes.
    threads : int
        Threads of each.
    memory_mb : int
        Most memory that each may hold, in MB; 0 is no limit.
    """

    def __init__(self, workers: int, threads: int, memory_mb: int = 0) -> None:
        self.workers, self.threads = workers, threads
        self._workers = [Worker(threads, memory_mb) for _ in range(workers)]

    def __enter__(self) -> LocalProcesses:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.close()
        for worker in self._workers:
            worker.stop()

    def run(
        self, function: Callable[[Any], Any], items: Iterable[Any], on_event: Event | None = None
    ) -> Iterator[Outcome]:
        """Yield the outcome of every item as they end."""
        shared = pack(function)
        tasks: queue.SimpleQueue[tuple[int, bytes]] = queue.SimpleQueue()
        done: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
        count = 0
        for index, item in enumerate(items):
            tasks.put((index, pack(item)))
            count += 1

        def serve(worker: Worker) -> None:
            while True:
                try:
                    index, request = tasks.get_nowait()
                except queue.Empty:
                    return
                if on_event:
                    on_event(index, "")
                try:
                    before = worker.n_sent
                    reply = worker.ask(shared, request, partial(on_event, index) if on_event else None)
                    done.put(outcome(index, worker.n_sent - before, reply))
                except Exception as error:  # noqa: BLE001 (whatever happens to one task, the others go on)
                    done.put(Outcome(index, None, error, len(request)))

        for worker in self._workers[:count]:
            threading.Thread(target=serve, args=(worker,), daemon=True).start()
        for _ in range(count):
            yield done.get()

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        """Yield the values in the order of the items."""
        return in_order(self.run(function, items))
