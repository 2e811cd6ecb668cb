"""Teams in processes of their own, on ports that nobody has."""

from __future__ import annotations

import json
import re
import threading
from contextlib import contextmanager

from patience import PATIENCE
from programs import python
from transports import endpoint


def on_free_ports(text):
    """Return a team's file whose agents listen where nobody else does."""

    def own(found):
        names = re.findall(r'"(\w+)"', found[1])
        return "agents = [" + ", ".join(f'{{ name = "{name}", endpoint = "{endpoint()}" }}' for name in names) + "]"

    return re.sub(r"^agents = \[(.*)\]", own, text, count=1, flags=re.MULTILINE)


class Up:
    """A running `mdm team up`, and what it says."""

    def __init__(self, process):
        self.process = process
        self.records = []
        self._came = threading.Condition()
        self._readers = [threading.Thread(target=self._read, args=(pipe,)) for pipe in (process.stdout, process.stderr)]
        for reader in self._readers:
            reader.start()

    def _read(self, pipe):
        for line in pipe:
            with self._came:
                self.records.append(json.loads(line) if line.startswith("{") else {"event": "line", "text": line})
                self._came.notify_all()

    def hear(self, times=1, **wanted):
        """Wait until something was said so many times; return the last record of it."""

        def heard():
            return [record for record in self.records if all(record.get(key) == value for key, value in wanted.items())]

        with self._came:
            assert self._came.wait_for(lambda: len(heard()) >= times, PATIENCE), (wanted, self.records)
            return heard()[times - 1]

    def end(self):
        """Wait for its end; return its status, and what it said."""
        status = self.process.wait(PATIENCE)
        for reader in self._readers:
            reader.join()
        return status, self.records


@contextmanager
def up(path, *options):
    """Start `mdm team up` on a file, and yield what it says."""
    with python("-m", "mdm", "team", "up", path, "--log", "json", *options) as process:
        try:
            yield Up(process)
        finally:
            process.terminate()
            process.wait(PATIENCE)


def histories(folder):
    """Return the steps of each agent by the files of their decisions."""
    steps = {}
    for path in folder.iterdir():
        told = [json.loads(line) for line in path.read_text().splitlines()]
        steps[path.stem] = {(*one["term"], one["step"]): (one["input"], one["action"], one["digest"]) for one in told}
    return steps
