"""What watches a scenario: a record, a page and a log, some of which fail; and what an independent listener hears."""

from __future__ import annotations

import functools
import math
import os
import random
import tempfile
from pathlib import Path
from unittest.mock import patch

import msgspec

from mdm.messages import ActionLife
from mdm.recording import Record, Recorder, process
from mdm.recording.writer import RecordWriter
from mdm.runtime.observing import Observer
from mdm.runtime.process import log
from mdm.snapshots import LiveRun

NOTES = [name for name in vars(Observer) if name.startswith("on_") and name in vars(Recorder) and name != "on_end"]
HANDLERS = ("on_mode", "on_fault", "on_idle", "on_life")
ERRORS = (Exception, MemoryError, RecursionError)
MEMORY = Path("/dev/shm")
TOPICS = {"decisions": "decisions", "modes": "modes", "faults": "faults", "idles": "idles", "actors": "lives"}
"""The channel of the runtime that each topic of a record has."""
PATIENCE = 2_000_000_000
"""Nanoseconds after which a writer that still gets messages has noticed that its file is gone."""


class Here(RecordWriter):
    """Writes a record within this process, at once: what is tested of pipes and processes is not here."""

    def watch(self, now, lives=lambda: True):
        """Take who tells the time, and whether anybody is told of a fault."""
        self.now, self._lives, self._due = now, lives, 0
        self.flushed, self.is_silent = [], False
        return self

    def _start(self, path, descriptor):
        options = {"split_bytes": self._split_bytes, "split_time": self._split_time}
        self._said = []
        output = functools.partial(process._Output, path, os.dup(descriptor), "mdm/chaos", **options)
        self._taker = process._Recorder(output, self._said.append)

    def flush(self):
        time = self.now()
        if self._buffer:
            if self._lives():
                self.flushed.append(time)
            del self._buffer[: self._taker.take(self._buffer)]
            self._limit = self._bound if self._limit >= 0 else -1
        if time >= self._due:
            self._due = time + 1_000_000_000
            self._taker.second()
        self._hear()

    def drain(self, seconds):
        self.flush()

    def _hear(self):
        if self.is_silent:
            self._heard_by = 0.0
            return
        self._heard_by = math.inf
        self._heard += b"".join(msgspec.json.encode(each) + b"\n" for each in self._said)
        self._said.clear()
        self._take_in()
        if self.failure is not None:
            self._discard()

    def close(self, seconds=2.0):
        if self._gap:
            self._append(process.LOST, self._gap.to_bytes(8, "little"))
            self._gap = 0
        self._append(process.END, b"")
        self.flush()
        self._limit = -1
        self._taker.close()
        self._hear()

    def let_go(self):
        """Leave nothing open, whatever has kept this from being closed."""
        taker = getattr(self, "_taker", None)
        if taker is not None and taker._output is not None:
            taker._output.leave()


class Sabotage:
    """Raises in one of the calls that come to it, or in all of them.

    Args:
        error: What it raises; None for nothing.
        place: In which call, counted from 0; None for all.
        journal: Knows the runtime.

    Attributes:
        raised: How often it has.
        late: Whether it had not before the runtime's actors had ended: who would tell that may be gone.
    """

    def __init__(self, error, place, journal):
        self._error, self._place, self._calls, self._journal = error, place, -1, journal
        self.raised, self.late = 0, True

    def __call__(self, function):
        @functools.wraps(function)
        def called(*arguments, **named):
            self._calls += 1
            if self._error is not None and self._place in {None, self._calls}:
                self.raised += 1
                self.late = self.late and self._journal.runtime.root.life in {"stopping", "stopped", "failed"}
                raise self._error("as it was meant to be \udce9")
            return function(*arguments, **named)

        return called


class Page:
    """Shows a runtime to nobody.

    Args:
        sabotage: In what it fails.
    """

    def __init__(self, sabotage):
        made = {name: sabotage(vars(LiveRun)[name]) for name in HANDLERS}
        self._kind = type("Live", (LiveRun,), made)
        self.live = None

    async def open(self, runtime):
        self.live = self._kind(runtime)
        self.live.open()

    async def close(self):
        self.live.close()


class Logger:
    """A log of the program's own.

    Args:
        sabotage: In what it fails.
    """

    def __init__(self, sabotage):
        self.debug = self.info = self.warning = self.error = sabotage(lambda *_, **__: None)


class Watchers:
    """Whoever watches a scenario, and a listener that notes what they should have heard.

    Args:
        seed: Draws who there is, and what fails.
        journal: Knows what happens.
    """

    def __init__(self, seed, journal):
        draw = self._random = random.Random(f"watchers of {seed}")
        self._journal = journal
        self._folder = tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None)
        self.path = Path(self._folder.name) / "run.mcap"
        self._sabotages = {name: self._sabotage() for name in ("record", "page", "log")}
        self._recorder = self._page = None
        self._harm = draw.choice([None] * 6 + ["remove", "cut", "silence"])
        self._harmed = None
        self._heard, self._patches = {}, []

    def _sabotage(self):
        draw = self._random
        error = draw.choice(ERRORS) if draw.random() < 0.3 else None
        place = draw.choice([None, *[round(2 ** draw.uniform(0, 9)) for _ in range(4)]])
        return Sabotage(error, place, self._journal)

    def options(self):
        """Return what a runtime takes."""
        draw, sabotages = self._random, self._sabotages
        kind = type("Taped", (Recorder,), {name: sabotages["record"](vars(Recorder)[name]) for name in NOTES})
        self._recorder = kind(self.path, channels=["own"])
        self._page = Page(sabotages["page"])
        logs = draw.choice([False, None, Logger(sabotages["log"])])
        if logs is None:  # and where it would print there is no room for one more thread
            self._patches.append(patch.object(log, "Writer", sabotages["log"](Quiet)))
        for each in self._patches:
            each.start()
        options = {"record": self._recorder, "page": self._page, "log": logs, "debug": draw.random() < 0.5}
        return {name: option for name, option in options.items() if name == "log" or draw.random() < 0.8}

    def listen(self, runtime):
        """Note what is published, before anybody else does."""
        if runtime.recorder is not None:
            self._recorder._writer = Here(self.path).watch(runtime.clock.now, lambda: runtime.root.life == "running")
        for topic, channel in TOPICS.items():
            runtime.__dict__[channel].subscribe(self._heard.setdefault(topic, []).append)
        for path in ["lamp", *map(self._journal.path, self._journal.robots)]:
            lives = runtime.channel(f"{path}/lives", ActionLife)
            lives.subscribe(self._heard.setdefault("lives", []).append)

    def look(self):
        """Do what watchers do between turns; harm the record now and then."""
        runtime, draw = self._journal.runtime, self._random
        if runtime.ending:
            return
        if self._page.live is not None:
            try:
                msgspec.json.decode(
                    self._page.live.encoded([self._journal.path(name) for name in self._journal.robots])
                )
            except Exception as error:
                self._journal.wrong.append(f"the page fails: {error!r}")
        if self._harm and runtime.recorder is not None and self._harmed is None and draw.random() < 0.15:
            self._harmed = self._journal.now()
            match self._harm:
                case "remove":
                    self.path.unlink()
                case "cut":
                    os.truncate(self.path, 10)
                case "silence":
                    self._recorder._writer.is_silent = True

    def close(self):
        """Leave nothing behind."""
        for each in self._patches:
            each.stop()
        if isinstance(self._recorder and self._recorder._writer, Here):
            self._recorder._writer.let_go()
        self._folder.cleanup()

    # -- Oracles -----------------------------------------------------------------------------------------------------

    def judge(self):
        """Yield what is wrong with what they have seen, each in a sentence."""
        faults = [fault for fault in self._heard["faults"] if fault.kind in {"observer", "record"}]
        for fault in self._heard["faults"]:
            fault.detail.encode()  # raises
        yield from self._told(faults)
        runtime = self._journal.runtime
        if runtime.recorder is not None:
            yield from self._as_heard() if self._harmed is None or self._harm == "silence" else ()
            yield from self._missed(faults)
        if self._page.live is not None and not self._sabotages["page"].raised:
            yield from self._shown()

    def _told(self, faults):
        """Hold that each who failed is told once, and nobody else."""
        for name, sabotage in self._sabotages.items():
            told = [fault for fault in faults if fault.kind == "observer" and fault.detail.startswith(f"the {name} ")]
            unfit = name == "record" and self._journal.unfit and self._journal.runtime.recorder is not None
            if len(told) > 1 or (told and not (sabotage.raised or unfit)):
                yield f"the {name} has raised {sabotage.raised} times, and that was told as {told}"
            if sabotage.raised and not (told or sabotage.late):
                yield f"the {name} has raised {sabotage.raised} times, which was not told"

    def _missed(self, faults):
        """Hold that a record which goes nowhere is told, once."""
        told = [fault.detail for fault in faults if fault.kind == "record" and "of channel 'own'" not in fault.detail]
        if self._harmed is None:
            if told:
                yield f"nothing was done to the record, and that was told as {told}"
            return
        wait = 0 if self._harm == "silence" else PATIENCE
        written = [time for time in self._recorder._writer.flushed if time > self._harmed + wait]
        if len(told) > 1 or (written and not told and not self._sabotages["record"].raised):
            yield f"{self._harm} at {self._harmed / 1e9:.1f} s was told as {told}"

    def _as_heard(self):
        """Hold that the record has what was heard."""
        found = Record(self.path, types={})
        raised = self._sabotages["record"].raised
        lost, counted = found.lost, self._recorder.statistics().dropped
        if found.torn or found.damage or not found.closed:
            yield f"the record is torn: {found.torn}, {found.damage}, closed: {found.closed}"
        if lost != counted or (lost and not (raised or self._journal.unfit)):
            yield f"the record lacks {lost} messages, {counted} were counted, and {raised} failed"
        for topic in ("decisions", "modes", "faults", "idles", "actors", "lives", "own"):
            kept = [_plain(each.message) for each in found.messages([topic])] if topic in found.topics else []
            heard = [_plain(each) for each in (self._journal.own if topic == "own" else self._heard.get(topic, ()))]
            if topic == "lives":
                kept, heard = _by_ensemble(kept), _by_ensemble(heard)
            if kept != heard and not (raised and topic in {"decisions", "lives", "own"}):
                yield f"{topic}: the record has {difference(kept, heard)}"

    def _shown(self):
        """Hold that the page has what was heard."""
        events = list(self._page.live.ring)
        for kind, name in (("mode", "modes"), ("fault", "faults")):
            shown = [(each.source, each.name) for each in events if each.kind == kind]
            heard = [
                (each.ensemble, each.mode) if kind == "mode" else (each.source, each.kind) for each in self._heard[name]
            ]
            late = [each for each in heard[len(shown) :] if each[1] not in {"observer", "record"}]
            if late or shown != heard[: len(shown)]:
                yield f"{name}: the page has {difference(shown, heard)}"


class Quiet(log.Writer):
    """Prints nothing."""

    def put(self, write, message):
        self._written += 1


def _plain(message):
    return msgspec.to_builtins(
        message, enc_hook=lambda value: value.tolist() if hasattr(value, "tolist") else repr(value)
    )


def _by_ensemble(lives):
    found = {}
    for life in lives:
        found.setdefault(life["ensemble"], []).append(life)
    return sorted(found.items())


def difference(one, other):
    """Return in words where two lists differ."""
    place = next((n for n, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
    there, heard = f"{one[place:][:2]!r:.600}", f"{other[place:][:2]!r:.600}"
    return f"{len(one)}, and {len(other)} were heard; from {place} on {there} for {heard}"
