"""The process that works: reads tasks from its standard input, writes answers to its standard output.

It ends at once when its input closes. A worker whose master was killed so keeps no lock and writes no file that a new
master would wait for.
"""

from __future__ import annotations

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


def main() -> None:
    """Serve until the input closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the master's business, which then closes the input
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not stand among the answers
    logging.getLogger().addHandler(logging.NullHandler())
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
    try:
        while (frame := read_frame(stream)) is not None:
            requests.put(frame)
    finally:  # also where a task is too large to be read: without this thread the process would wait for ever
        os._exit(0)
