"""An executor whose threads work when they are told to, so that nothing depends on chance."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor


class Job:
    """What was handed in: it waits, or is at work in its thread, until it is released."""

    def __init__(self, function, args):
        self.future = Future()
        self._function, self._args = function, args
        self._begun, self._go = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def begin(self):
        """Begin in a thread, which then waits within the function."""
        self._thread.start()
        self._begun.wait()

    def wait(self):
        """Wait for the release; the function calls this."""
        self._begun.set()
        self._go.wait()

    def release(self):
        """Let it come to its end, and wait for that."""
        self._go.set()
        if not self._begun.is_set():
            self._thread.start()
        self._thread.join()

    def _run(self):
        if self.future.set_running_or_notify_cancel():
            try:
                result = self._function(*self._args)
            except BaseException as error:
                self.future.set_exception(error)
            else:
                self.future.set_result(result)
        self._begun.set()


class Pool(ThreadPoolExecutor):
    """An executor with a thread for each job.

    Attributes:
        last: The job that was handed in last.
        refusal: What the next call raises, once: as in Python's own, the job is queued by then.
    """

    def __init__(self):
        super().__init__(1)
        self.last = self.refusal = None

    def submit(self, function, /, *args):
        """Take a job, which waits."""
        self.last = Job(function, args)
        if self.refusal is not None:
            text, self.refusal = self.refusal, None
            raise RuntimeError(text)
        return self.last.future
