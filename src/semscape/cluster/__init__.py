"""Run independent tasks: on threads, on local processes, or on a Dask cluster, with the same results.

Inside one process `local_mapper` gives a `map` on threads. An `Executor` runs tasks that stand for themselves, like
whole specimens, anywhere: `open_executor` gives the one that is asked for. Tasks and replies travel as bytes that this
package pickles itself, so that every executor sends the same, and the number of bytes is known.
"""

from semscape.cluster.choice import Placement, open_executor
from semscape.cluster.executor import Counted, Executor, Outcome, Serial, WorkerLostError
from semscape.cluster.notices import tell
from semscape.cluster.threads import Mapper, local_mapper

__all__ = [
    "Counted",
    "Executor",
    "Mapper",
    "Outcome",
    "Placement",
    "Serial",
    "WorkerLostError",
    "local_mapper",
    "open_executor",
    "tell",
]
