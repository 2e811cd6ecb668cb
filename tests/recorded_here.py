"""Records that are written without a process of their own: by a thread with the same code.

That records have a process, and what becomes of it, is tested in tests/recording, which needs the real one.
"""

from __future__ import annotations

import json
import os
import subprocess
import threading
from contextlib import contextmanager
from types import SimpleNamespace
from unittest.mock import patch

from mdm.recording import process, writer


class Thread:
    """Stands for the process that writes a record: frames in by a pipe, a file out."""

    def __init__(self, command, *, stdin, stdout, pass_fds, **_):
        settings = json.loads(command[-1])
        del settings["robot"]
        settings["descriptor"] = os.dup(*pass_fds)
        self._thread = threading.Thread(target=self._write, args=(settings, os.dup(stdin), os.dup(stdout)))
        self._thread.start()

    def _write(self, settings, source, told):
        with os.fdopen(source, "rb", 0) as frames, os.fdopen(told, "wb", 0) as robot:
            recorder = process._Recorder(
                lambda: process._Output(**settings), lambda said: robot.write(json.dumps(said).encode() + b"\n")
            )
            held = bytearray()
            while data := frames.read(process._READ):
                held += data
                del held[: recorder.take(held)]
            recorder.close()

    def poll(self):
        return None if self._thread.is_alive() else 0

    def wait(self, seconds):
        self._thread.join(seconds)
        if self._thread.is_alive():
            raise subprocess.TimeoutExpired("a record", seconds)
        return 0


@contextmanager
def recorded_by_threads():
    """Have records written by threads."""
    used = SimpleNamespace(Popen=Thread, DEVNULL=subprocess.DEVNULL, TimeoutExpired=subprocess.TimeoutExpired)
    with patch.object(writer, "subprocess", used):
        yield
