"""Policies that workers import, and executors whose workers are threads of a test."""

from __future__ import annotations

import os
import pickle
import random
import signal
import threading
from concurrent.futures import Executor, Future
from pathlib import Path

from mdm.policies import BeliefPolicy


class Cautious(BeliefPolicy):
    """Listens to the tiger until it is sure; it decides for one episode at a time."""

    num_actions, num_states = 3, 2

    def action(self, x):
        return 0 if 0.1 < x[0] < 0.9 else 2 if x[0] > 0.5 else 1


class Frail(Cautious):
    """Fails where it is sure of the left."""

    def __init__(self, most=0.9):
        self.most = most

    def action(self, x):
        if x[0] > self.most:
            raise ValueError("too sure")
        return super().action(x)


class Once(Cautious):
    """Does harm at its first decision, and none once a file is there: it fails, or kills its process."""

    def __init__(self, file, *, kills=False):
        self.file, self.kills = str(file), kills

    def action(self, x):
        try:
            Path(self.file).touch(exist_ok=False)
        except FileExistsError:
            return super().action(x)
        if self.kills:
            os.kill(os.getpid(), signal.SIGKILL)
        raise OSError("once")


def without_mdm(_):
    raise ModuleNotFoundError("No module named 'mdm'")


class Shuffled(Executor):
    """Calls functions in threads, whatever it was given last or first, by bytes as between processes.

    Args:
        workers: How many threads.
        seed: Of the order.
        changed: What becomes of a result.
    """

    def __init__(self, workers=2, seed=0, changed=lambda result: result):
        self._random = random.Random(seed)
        self._max_workers = workers
        self._changed = changed
        self._waiting = []
        self._bell = threading.Condition()
        self._closed = False
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(workers)]
        self.sent = []
        for thread in self._threads:
            thread.start()

    def submit(self, function, /, *arguments):
        future = Future()
        data = pickle.dumps((function, arguments))
        with self._bell:
            if self._closed:
                raise RuntimeError("cannot schedule new futures after shutdown")
            self.sent.append(arguments)
            self._waiting.append((future, data))
            self._bell.notify()
        return future

    def _work(self):
        while True:
            with self._bell:
                self._bell.wait_for(lambda: self._waiting or self._closed)
                if not self._waiting:
                    return
                future, data = self._waiting.pop(self._random.randrange(len(self._waiting)))
            if not future.set_running_or_notify_cancel():
                continue
            try:
                function, arguments = pickle.loads(data)
                future.set_result(self._changed(pickle.loads(pickle.dumps(function(*arguments)))))
            except BaseException as error:
                future.set_exception(error)

    def shutdown(self, wait=True, *, cancel_futures=False):
        with self._bell:
            self._closed = True
            self._bell.notify_all()
        for thread in self._threads:
            thread.join()
