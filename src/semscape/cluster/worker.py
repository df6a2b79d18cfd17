"""The process that works: reads tasks from its standard input, writes answers to its standard output.

It ends at once when its input closes. A worker whose master was killed so keeps no lock and writes no file that a new
master would wait for.
"""

from __future__ import annotations

import argparse
import logging
import os
import queue
import signal
import struct
import sys
import threading
from typing import BinaryIO

from semscape.cluster.executor import answer
from semscape.cluster.notices import listening

FUNCTION, TASK, NOTICE, ANSWER = b"F", b"T", b"N", b"A"
_HEAD = struct.Struct("<cQ")


def write_frame(stream: BinaryIO, kind: bytes, content: bytes) -> None:
    """Write one message: its kind, its length, its content."""
    stream.write(_HEAD.pack(kind, len(content)))
    stream.write(content)
    stream.flush()


def read_frame(stream: BinaryIO) -> tuple[bytes, bytes] | None:
    """Read one message; None where the other side has gone, be it in the middle of one."""
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    kind, length = _HEAD.unpack(head)
    content = stream.read(length)
    return (kind, content) if len(content) == length else None


def limit_memory(limit_mb: int) -> None:
    """Let this process map no more than so many MB; what is beyond raises `MemoryError` (POSIX only)."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (limit_mb * 1_000_000, limit_mb * 1_000_000))


def main() -> None:
    """Serve until the input closes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--memory-mb", type=int, default=0)
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the master's business, which then closes the input
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not stand among the answers
    logging.getLogger().addHandler(logging.NullHandler())
    if arguments.memory_mb:
        limit_memory(arguments.memory_mb)
    requests: queue.SimpleQueue[tuple[bytes, bytes]] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(sys.stdin.buffer, requests), daemon=True).start()
    shared = b""
    while True:
        kind, content = requests.get()
        if kind == FUNCTION:
            shared = content
            continue
        with listening(lambda text: write_frame(answers, NOTICE, text.encode())):
            reply = answer(shared, content)
        write_frame(answers, ANSWER, reply)


def _receive(stream: BinaryIO, requests: queue.SimpleQueue[tuple[bytes, bytes]]) -> None:
    while (frame := read_frame(stream)) is not None:
        requests.put(frame)
    os._exit(0)
