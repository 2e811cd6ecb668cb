"""The recorder: an observer that keeps a run in a file.

It appends events to a list within their turn, encodes them between turns, in slices so short that no decision waits for
long, and lets a process of its own write them (see `RecordWriter`).
"""

from __future__ import annotations

import asyncio
import importlib
import os
import platform
import time as times
from collections.abc import Iterable, Mapping
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict, Unpack

import msgspec
import numpy as np
from msgspec import Meta

from mdm.errors import ConfigError, Error
from mdm.messages import ActionLife, Decision, Fault
from mdm.recording import schemas
from mdm.recording.part import SYSTEM
from mdm.recording.writer import SILENT, FileSettings, RecordWriter
from mdm.runtime.extension import Extension
from mdm.runtime.time.virtual import VirtualClock
from mdm.stimuli import TRUE_REWARD, TRUE_STATE, Began, Finished, Said, Stimulus
from mdm.version import __version__

if TYPE_CHECKING:
    from mdm.recording.writer import RecordStatistics
    from mdm.runtime import Channel, Dispatcher, Runtime
    from mdm.runtime.observing import Deciding, Guard

FORMAT = 1

_AFTER = 0.05
"""Seconds after which what was noted is encoded."""
_SLICE = 100_000
"""Nanoseconds that encoding takes before the event loop has its turn."""
_LOOK = 1.0
"""Seconds after which the process that writes is listened to."""
_CLOSING = 5.0
"""Seconds within which what waits is written at the end."""
_BOUND = 100_000
_LATEST = 1 << 63
_HEARD, _SAID, _CALLED, _LIVED, _DECIDED, _SENT = range(6)


class RecorderSettings(FileSettings, frozen=True, kw_only=True):
    """What a record keeps, and in which files.

    Attributes:
        channels: Names of further channels of which each message is kept, such as ``robot/belief``. Of one that the
            run never had, a fault tells at its end.
        largest_belief: Beliefs over more states than this are not kept with decisions: a replay restores them.
        split_bytes: Begin another file when one has about this size.
        split_seconds: Begin another file when the messages of one span this time.
        bound: How many items may wait to be encoded; more are lost and counted.
        keep: Keep a record that is there already, and write ``run.2.mcap`` beside ``run.mcap``, and so on, as after a
            crash; False replaces it. From the runtime's begin on, ``path`` has the file that is written.
    """

    channels: Any = ()
    largest_belief: Annotated[int, Meta(ge=0, extra={"unit": "states"})] = 256
    bound: Annotated[int, Meta(ge=1, extra={"unit": "items"})] = _BOUND
    keep: bool = True


class RecorderOptions(TypedDict, total=False):
    """The keyword arguments of `RecorderSettings`."""

    channels: Iterable[str]
    largest_belief: int
    split_bytes: int | None
    split_seconds: float | None
    bound: int
    keep: bool


RecorderOptions.__doc__ = RecorderSettings.__doc__


class Recorder(Extension):
    """Records a run: every stimulus, decision, life of an action, mode and fault, and channels that are asked for.

    Hand it to one `Runtime`, or a path alone where the defaults will do. A runtime that ends completes the file.

    Args:
        path: The file, such as ``run.mcap``.
        options: See `RecorderOptions`.

    Raises:
        ConfigError: If an option is of another kind.
    """

    name = "the record"

    def __init__(
        self,
        path: str | Path,
        **options: Unpack[RecorderOptions],
    ) -> None:
        settings = RecorderSettings.from_keywords(options)
        channels = settings.channels
        self.path = Path(path)
        listed = isinstance(channels, Iterable) and not isinstance(channels, str | bytes)
        self.channels = tuple(channels) if listed else ()
        if not listed or not all(isinstance(name, str) for name in self.channels):
            text = f"channels are a list of names, such as ['robot/state'], not {channels!r}"
            raise ConfigError(text, key="channels")
        self.lost = 0
        self.describer: Any = None  # keeps the parts of a run by `describe`, see `mdm.config.description`
        self.summary = ""  # makes the summary of the record as it is closed, as ``module:name``
        self._largest = settings.largest_belief
        self._bound = settings.bound
        self._writer = RecordWriter(path, settings)
        self._attached: list[tuple[str, str, bytes]] = []
        self._head: dict[str, str] = {}
        self._items: list[tuple[Any, ...]] = []
        self._topics: dict[str, int] = {}
        self._encode = msgspec.json.Encoder(enc_hook=_plain).encode
        self._controlled: set[str] = set()
        self._waits = False
        self._virtual = False
        self._failed = self._silent = False
        self._told_lost = self._skipped = 0
        self._guard: Guard
        self._looks: asyncio.TimerHandle | None = None
        self._runtime: Runtime | None = None
        self._dispatcher: Dispatcher
        self._tasks: dict[asyncio.Task[Any] | None, tuple[str, int]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None

    def head(self, **facts: str) -> None:
        """Say more about the run, in its record's head; before the runtime is entered."""
        self._head |= facts

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Keep a file with the record, such as the configuration; before the runtime is entered."""
        self._attached.append((name, media_type, data))

    def describe(self, files: Mapping[str, bytes], facts: Mapping[str, str]) -> None:
        """Keep the parts of a run that goes on: files, and facts of its head."""
        for name, data in files.items():
            self._writer.attach(name, "application/octet-stream", data)
        self._writer.metadata(SYSTEM, facts)

    # -- Life ----------------------------------------------------------------------------------------------------

    async def open(self, runtime: Runtime) -> None:
        """Begin the record of a runtime.

        Raises:
            Error: If the file cannot be written, mcap is not installed, or this has recorded a run before.
        """
        if self._runtime is not None:
            raise Error(f"{self.path}: a Recorder is for one run: make a new one for each runtime")
        self._writer.summary = self.summary
        self._writer.open()
        self.path = self._writer.path
        self._runtime, self._virtual = runtime, isinstance(runtime.clock, VirtualClock)
        self._loop = asyncio.get_running_loop()
        clock = {
            "clock": "virtual" if self._virtual else "wall",
            "epoch": str(runtime.clock.now()),
            "wall": str(times.time_ns()),
        }
        self._writer.metadata("mdm", {**environment(), **self._head, **clock})
        for name, media_type, data in self._attached:
            self._writer.attach(name, media_type, data)
        for topic, kind in (("stimuli", Stimulus), ("decisions", Decision), ("lives", ActionLife)):
            self._topics[topic] = self._writer.topic(topic, schemas.name(kind), schemas.schema(kind))
        self._dispatcher, self._tasks = runtime.dispatcher, runtime.observers.tasks
        self._guard = runtime.observe(self)
        for channel in (runtime.modes, runtime.faults, runtime.lives, runtime.idles):
            self._hear("actors" if channel is runtime.lives else channel.name, channel)
        if self.kept_files:
            runtime.say("record", file=str(self.path), detail=f"{self.kept_files[-1]} is kept as it is")
        if not self._virtual:
            self._looks = self._loop.call_later(_LOOK, self._look)

    def on_end(self) -> None:
        """Complete the file; messages that are not written after some seconds are lost."""
        if self._looks is not None:
            self._looks.cancel()
        try:
            if self.describer is not None:
                self._guard(self.describer.finish)()
            self._write(slice_=None)
            self._write(slice_=None)  # the faults that this has made
            self._writer.close(_CLOSING)
        finally:
            self._loop = None

    @property
    def kept_files(self) -> tuple[Path, ...]:
        """The records that are kept, in place of which another file is written; empty where its name was free."""
        return self._writer.kept_files

    @property
    def failure(self) -> str | None:
        """Why nothing more is written, None while all is well."""
        return self._writer.failure

    def statistics(self) -> RecordStatistics:
        """Return how many messages were taken, written and lost."""
        found = self._writer.statistics()
        return msgspec.structs.replace(found, dropped=found.dropped + self._lost - self._skipped)

    @property
    def _lost(self) -> int:
        return self.lost + (0 if self._runtime is None else self._guard.lost)

    # -- From what is heard to the file ------------------------------------------------------------------------------

    def _put(self, item: tuple[Any, ...]) -> None:
        items = self._items
        if len(items) >= self._bound:
            self.lost += 1
            return
        items.append(item)
        if not self._waits and self._loop is not None:
            self._waits = True
            if self._virtual:  # time may stand still for as long as a turn lasts
                self._loop.call_soon(self._write, None)
            else:
                self._loop.call_later(_AFTER, self._write)

    def _hear(self, topic: str, channel: Channel[Any]) -> None:
        """Keep each message of a channel."""
        if topic not in self._topics:
            kind: Any = channel.type  # which is hashable
            self._topics[topic] = self._writer.topic(topic, schemas.name(kind), schemas.schema(kind))
        number = self._topics[topic]
        channel.subscribe(self._guard(lambda message: self._put((_SENT, number, message))))

    def _write(self, slice_: int | None = _SLICE) -> None:
        """Encode waiting items, for so many nanoseconds, or all; one that fails is lost, and the others go on."""
        items, self._items = self._items, []
        until = None if slice_ is None else times.perf_counter_ns() + slice_
        for number, item in enumerate(items):
            try:
                self._encode_item(item)
            except Exception as error:
                self._guard.lose(error)
            if until is not None and not number % 8 and times.perf_counter_ns() > until:
                self._items = items[number + 1 :] + self._items
                break
        self._guard(self._send)()
        self._waits = False
        if self._items and self._loop is not None:
            self._waits = True
            self._loop.call_soon(self._write, slice_)
        self._complain()

    def _send(self) -> None:
        """Send encoded messages to the process that writes, and say how many are lost."""
        lost = self._lost
        self._writer.skip(lost - self._skipped)
        self._skipped = lost
        if self._virtual and not self._silent:
            self._writer.drain(10.0)  # time stands still: nothing is gained by losing anything
        else:
            self._writer.flush()

    def _look(self) -> None:
        """Hear the process that writes, whether there is something to write or not."""
        if self._loop is not None:
            self._looks = self._loop.call_later(_LOOK, self._look)
            self._guard(self._send)()
            self._complain()

    def _complain(self) -> None:
        """Make a fault of it, once, that the record ends, that nobody writes it, or that some of it is lost."""
        runtime, failure = self._runtime, self._writer.failure
        if runtime is None or self._loop is None:
            return
        silent, self._silent = self._silent, self._writer.silent
        if self._silent and not silent:
            text = (
                f"{self.path}: the process that writes the record has said nothing for {SILENT:g} s: what is recorded "
            )
            runtime.faults.publish(Fault(runtime.now(), "runtime", "record", f"{text}now is lost if that stays so"))
        lost = self.statistics().dropped - self._guard.lost  # of which another fault tells
        if failure is not None and not self._failed:
            self._failed = True
            text = f"{failure}; {lost:,} messages are lost by now, or may be" if lost else failure
            runtime.faults.publish(Fault(runtime.now(), "runtime", "record", text))
        if lost and not self._told_lost and not self._failed:
            self._told_lost = lost
            text = f"{self.path}: {lost:,} messages of the record are lost: more was recorded than could be written"
            runtime.faults.publish(Fault(runtime.now(), "runtime", "record", text))

    def _encode_item(self, item: tuple[Any, ...]) -> None:
        kind = item[0]
        if kind.__class__ is not int:
            self._add("stimuli", kind)
        elif kind == _HEARD:
            _, time, channel, message = item
            self._add("stimuli", Said(time, channel.name, type(message).__name__, message))
        elif kind == _DECIDED:
            _, output, (time, epoch, cause, state, observation, current, action, reward) = item
            belief = None if current is None else output.belief_of(current)
            if belief is not None and len(belief) > self._largest:
                belief = None
            of, name, wanted = output.ensemble, output.name_of(action), output.wanted(cause, current)
            decision = Decision(time, of, epoch, cause, state, observation, belief, action, name, reward, *wanted)
            self._add("decisions", decision)
        elif kind == _SAID:
            _, time, name, message, source = item
            self._add("stimuli", Said(time, name, type(message).__name__, message, *source))
        elif kind == _CALLED:
            _, ensemble, life, action, time = item
            self._add("lives", ActionLife(time, ensemble, life, action, "running"))
            self._add("lives", ActionLife(time, ensemble, life, action, "succeeded"))
        elif kind == _LIVED:
            self._add("lives", item[1])
        else:
            _, topic, message = item
            time = getattr(message, "time", None)
            if not isinstance(time, int) or not 0 <= time < _LATEST:
                time = self._now()
            self._writer.write(topic, time, self._encode(message))

    def _now(self) -> int:
        return 0 if self._runtime is None else self._runtime.now()

    def _add(self, topic: str, message: Any) -> None:
        self._writer.write(self._topics[topic], max(message.time, 0), self._encode(message))

    # -- What is heard -------------------------------------------------------------------------------------------

    def on_message(self, channel: Channel[Any], message: Any, time: int) -> None:
        """Keep a message on a channel of input, and whose code has said it."""
        item: tuple[Any, ...] = (_HEARD, time, channel, message)
        if self._dispatcher.active or self._tasks:
            item = (_SAID, time, channel.name, message, self._dispatcher.observers.source())
        # Hot path, as `on_step` is: appended here where `_put` would do no more than that.
        if self._waits and len(self._items) < self._bound:
            self._items.append(item)
        else:
            self._put(item)

    def on_stimulus(self, stimulus: Stimulus) -> None:
        """Keep a stimulus as it is; when an actor runs, hear the channels that there are by then."""
        self._put((stimulus,))
        if isinstance(stimulus, Finished):
            self._look_for_missing(stimulus.time)
        elif isinstance(stimulus, Began) and stimulus.step == "run":
            assert self._runtime is not None
            for channel in self._runtime.channels:
                wanted = channel.name in self.channels or channel.name.rpartition("/")[2] in {TRUE_REWARD, TRUE_STATE}
                if wanted and channel.name not in self._topics:
                    self._hear(channel.name, channel)

    def _look_for_missing(self, time: int) -> None:
        """Make a fault of channels that were asked for and never there."""
        missing = [name for name in self.channels if name not in self._topics]
        if missing and self._runtime is not None:
            there = [channel.name for channel in self._runtime.channels if channel.name not in self._topics]
            text = (
                f"{self.path}: nothing was recorded of channel {', '.join(map(repr, missing))}, which was not there "
                f"when an actor began; there are {', '.join(there[:_TOLD])}"
            )
            self._runtime.faults.publish(Fault(time, "runtime", "record", text))

    def on_life(self, life: ActionLife) -> None:
        """Keep that an action has begun or ended."""
        self._put((_LIVED, life))

    def on_call(self, ensemble: str, life: int, action: str, time: int) -> None:
        """Keep the whole life of a plain function."""
        if self._waits and len(self._items) < self._bound:
            self._items.append((_CALLED, ensemble, life, action, time))
        else:
            self._put((_CALLED, ensemble, life, action, time))

    def on_step(self, output: Deciding, *decision: Any) -> None:
        """Keep a decision."""
        if self._waits and len(self._items) < self._bound:
            self._items.append((_DECIDED, output, decision))
        else:
            self._put((_DECIDED, output, decision))

    def on_control(self, output: Deciding) -> None:
        """Keep the digests and names of an ensemble, in the record's head."""
        if output.ensemble not in self._controlled:
            self._controlled.add(output.ensemble)
            facts = {
                name: fact if isinstance(fact, str) else msgspec.json.encode(fact).decode()
                for name, fact in output.facts().items()
            }
            self._writer.metadata(f"ensemble {output.ensemble}", facts)
            own = self._head.keys().isdisjoint({"configuration", "simulation"})  # else the run's files are kept
            if self.describer is not None and own and self._loop is not None:
                self._loop.call_soon(self._guard(self.describer.look), self._runtime)


_TOLD = 20
"""Channels that are named, of those that there are."""


def _plain(value: object) -> object:
    """Return a value as JSON has it: lists for arrays, numbers for numpy's."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return repr(value)


def environment() -> dict[str, str]:
    """Return the facts on which the last bits of numbers depend, and the format of records."""
    loop = find_spec("mdm.runtime.dispatcher")
    plain = loop is None or loop.origin is None or loop.origin.endswith(".py")
    return {
        "format": str(FORMAT),
        "mdm": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": _numba(),
        "blas": _blas(),
        "machine": platform.machine(),
        "compiled": "no" if plain else "yes",
    }


def _numba() -> str:
    """Return the version by which kernels are compiled; empty where they are not."""
    if os.environ.get("MDM_COMPILE") == "0":
        return ""
    try:
        return metadata.version("numba")
    except metadata.PackageNotFoundError:
        return ""


def _blas() -> str:
    """Return the kernel of numpy's linear algebra; empty where nothing tells it.

    A library that scipy brings with it is loaded in some programs alone, and decides nothing.
    """
    try:
        threadpoolctl = importlib.import_module("threadpoolctl")  # which numba or scikit-learn may have brought
    except ImportError:
        return ""
    loaded = [each for each in threadpoolctl.threadpool_info() if each.get("user_api") == "blas"]
    # Other packages may have brought theirs, as soon as they are imported.
    found = [each for each in loaded if "numpy" in str(each.get("filepath"))] or loaded
    return ", ".join(
        sorted({f"{each.get('internal_api')} {each.get('version')} {each.get('architecture')}" for each in found})
    )


def recorder_of(given: object) -> Recorder:
    """Return the recorder that is given as itself or by the path of its file."""
    if isinstance(given, Recorder):
        return given
    if isinstance(given, str | os.PathLike):
        return Recorder(os.fspath(given))
    raise Error(f"a record is the path of a file, such as 'run.mcap', or a Recorder, not {given!r}")
