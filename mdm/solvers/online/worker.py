"""The process that searches beside the loop, started by `SearchProcess`.

It reads frames from its standard input, a length and as many bytes of pickle: first the parts of the search, then
questions. It writes such frames to its standard output: None when it is ready, then an answer to each question. A
question that comes while it searches makes it answer the one before at once. It ends when its input does, so that it
never outlives whoever started it, and searches at a lower priority, so that it leaves the loop its core.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from contextlib import nullcontext
from typing import Any

from mdm.compilation import COMPILE_TIME
from mdm.runtime.process.frames import HEADER, frame, unframed
from mdm.solvers.online.tree_search import Search, received

_NICE = 10


def _read(descriptor: int, length: int) -> bytes:
    """Return so many bytes.

    Raises:
        EOFError: If there are no more.
    """
    parts = []
    while length:
        part = os.read(descriptor, min(length, 1 << 20))
        if not part:
            raise EOFError
        parts.append(part)
        length -= len(part)
    return b"".join(parts)


def _receive(descriptor: int) -> Any:
    length = int.from_bytes(_read(descriptor, HEADER), "big")
    return unframed(_read(descriptor, length))


def _send(descriptor: int, content: Any) -> None:
    data = frame(content)
    while data:
        data = data[os.write(descriptor, data) :]


def _tell() -> None:
    if sys.stderr is None:
        return
    sys.stderr.write("mdm: compiling the tree search, once on this machine; it takes some seconds\n")
    sys.stderr.flush()


def main(*, tells: bool = False) -> None:
    """Answer questions until there are no more.

    Args:
        tells: Whether standard error is told when compilation takes long.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    questions, answers = 0, os.dup(1)
    os.dup2(2, 1)  # whatever is printed is no answer
    poll = select.poll()
    poll.register(questions, select.POLLIN | select.POLLHUP)
    try:
        tables, options = _receive(questions)
        search = Search(received(tables), **options)
        with COMPILE_TIME.told(_tell) if tells else nullcontext():
            search.prepare()
        os.nice(_NICE)  # from now on: to compile, once after an installation, takes long enough
        _send(answers, None)
        while True:
            number, states, weights = _receive(questions)
            _send(answers, (number, search.run(states, weights, stopped=lambda: bool(poll.poll(0)))))
    except (EOFError, BrokenPipeError):
        return
