"""The one interface of all executors, and the simplest of them."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from semscape.cluster.notices import listening
from semscape.errors import PassingError

Event = Callable[[int, str], None]
"""Called with a task's index and what it says: the name of its stage, "" when it starts."""


class WorkerLostError(PassingError):
    """The process that worked on a task has ended, again and again, before the task did."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of task `index`: a value or the error that it raised, and the bytes sent there and back.

    The bytes of the function count with the first task for which a process gets it.
    """

    index: int
    value: Any
    error: Exception | None
    n_bytes: int

    def result(self) -> Any:
        """Return the value, or raise the error."""
        if self.error is not None:
            raise self.error
        return self.value


class Executor(Protocol):
    """Runs tasks that share nothing; the outcome of each depends on its item alone.

    `workers` is how many tasks run side by side, `threads` how many threads each of them may use.
    """

    workers: int
    threads: int

    def run(
        self, function: Callable[[Any], Any], items: Iterable[Any], on_event: Event | None = None
    ) -> Iterator[Outcome]:
        """Yield the outcome of every item once, as they end, in any order."""
        ...

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        """Yield the values in the order of the items, like the built-in `map`; the first error is raised."""
        ...


class Serial:
    """One task after the other, in this process."""

    def __init__(self, threads: int = 1) -> None:
        self.workers = 1
        self.threads = threads

    def run(
        self, function: Callable[[Any], Any], items: Iterable[Any], on_event: Event | None = None
    ) -> Iterator[Outcome]:
        """Yield the outcome of every item in order."""
        shared = pack(function)
        for index, item in enumerate(items):
            request = pack(item)
            if on_event:
                on_event(index, "")
            with listening(partial(on_event, index) if on_event else None):
                reply = answer(shared, request)
            yield outcome(index, len(request) + (0 if index else len(shared)), reply)

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        """Yield the values in the order of the items."""
        return in_order(self.run(function, items))


class Counted:
    """The `map` of an executor, which counts the bytes that it sends: `n_bytes` so far."""

    def __init__(self, executor: Executor) -> None:
        self.n_bytes = 0
        self._executor = executor

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        """Yield the values in the order of the items."""
        return in_order(map(self._noted, self._executor.run(function, items)))

    def _noted(self, one: Outcome) -> Outcome:
        self.n_bytes += one.n_bytes
        return one


def pack(value: Any) -> bytes:
    """Return a value as bytes that another process of the same semscape can read."""
    return pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


def answer(shared: bytes, request: bytes) -> bytes:
    """Call the function in `shared` with the item in `request` and return what came out, packed.

    Whatever the task raises is an answer too; a worker outlives its tasks.
    """
    try:
        function = pickle.loads(shared)
        return pack((function(pickle.loads(request)), None))
    except Exception as error:  # noqa: BLE001 (the caller raises it again)
        try:
            packed = pack((None, error))
            pickle.loads(packed)  # an exception whose constructor takes other arguments packs, but does not unpack
        except Exception:  # noqa: BLE001
            packed = pack((None, RuntimeError(f"{type(error).__name__}: {error}")))
        return packed


def outcome(index: int, n_sent: int, reply: bytes) -> Outcome:
    """Return the outcome that a reply stands for, to a task for which so many bytes were sent."""
    value, error = pickle.loads(reply)
    return Outcome(index, value, error, n_sent + len(reply))


def in_order(outcomes: Iterable[Outcome]) -> Iterator[Any]:
    """Yield the values of outcomes that come in any order in the order of their items.

    Examples
    --------
    >>> list(in_order([Outcome(1, "b", None, 0), Outcome(0, "a", None, 0)]))
    ['a', 'b']
    """
    waiting: dict[int, Outcome] = {}
    following = 0
    for one in outcomes:
        waiting[one.index] = one
        while following in waiting:
            yield waiting.pop(following).result()
            following += 1
