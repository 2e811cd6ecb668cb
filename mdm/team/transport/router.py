"""The router: the common part of the transports of a team.

Each message has an envelope: who sent it, in which life, which number it has under its key, and in which form. What
comes is handed to the handlers of its key if it is whole, of a form that this program knows, under a key of its sender,
of the sender's present life, and newer than the last of its key. Any other is refused by its kind; both are counted.
"""

from __future__ import annotations

import asyncio
import struct
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Literal

from mdm.errors import Error
from mdm.runtime.statistics import FULL, Latencies
from mdm.team.transport.bounds import DAY
from mdm.team.transport.keys import check_expression, check_key, includes, matches, owner_of
from mdm.team.transport.transport import PROTOCOL, Sample, Traffic, TransportStatistics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

VERSION = 1
"""The form of envelopes and bodies that this program speaks; it grows when an older program could not read a newer."""

LARGEST = 1 << 20
"""The largest message in bytes, unless told otherwise."""

_MAGIC = b"mD"
_START = struct.Struct("<2sH?QB")  # magic, version, whether of a step, incarnation, bytes of the owner's name; the name
_REST = struct.Struct("<Qq")  # number, time; then the body
_MOST_KEYS = 4096
_NONE = -2  # a number that no other follows
_FAR = 1024  # further behind than that an owner's messages do not come, whatever overtakes them
_ENOUGH = 8
_APART = 250_000_000  # nanoseconds; two that come as far apart are enough: what comes again comes at once
_NO_START = b"no message begins so"
_MOST_MISSING = 1 << 20
_FRESH = 5_000_000_000  # nanoseconds for which a message is not taken for one that is sent again


class Refusal(Exception):
    """Why a message is not handed on.

    Args:
        kind: One word, as counted in `TransportStatistics.dropped`.
        reason: A sentence.
    """

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind


class _Doubt:
    """Whether the last number under a key was one of its owner's: messages far behind it follow each other."""

    __slots__ = ("ahead", "count", "number", "since")

    def __init__(self, number: int, ahead: int, now: int) -> None:
        self.number = number
        self.count = 1
        self.ahead = ahead
        self.since = now

    def confirms(self, number: int, ahead: int, now: int) -> bool:
        """Take note of one more message; return whether there were so many, or over so long a time, that they count."""
        if number == self.number + 1 and ahead == self.ahead:
            self.count += 1
        else:
            self.count, self.since = 1, now
        self.number, self.ahead = number, ahead
        return self.count >= _ENOUGH or (self.count > 1 and number < ahead and now - self.since >= _APART)


class Packer:
    """Puts the messages of an agent in envelopes, numbered from 1 under each key.

    Args:
        owner: The agent.
        incarnation: Which life of it.
        now: The time in nanoseconds.
        version: The form of the bodies.
        largest: The largest message in bytes.

    Attributes:
        sent: By key, the number of its messages, which is that of the last, and their bytes.
    """

    def __init__(
        self,
        owner: str,
        incarnation: int,
        now: Callable[[], int],
        *,
        version: int = VERSION,
        largest: int = LARGEST,
    ) -> None:
        name = owner.encode()
        self._starts = tuple(
            _START.pack(_MAGIC, version, step, incarnation, len(name)) + name for step in (False, True)
        )
        self._now = now
        self._largest = largest
        self.sent: dict[str, list[int]] = {}

    def pack(self, key: str, body: bytes, *, step: bool = False) -> bytes:
        """Return the next message under a key; one of an agreed step is given up last where there are too many.

        Raises:
            Error: If every receiver would drop it, since it is too large.
        """
        counts = self.sent.get(key)
        if counts is None:
            counts = self.sent[key] = [0, 0]
        data = self._starts[step] + _REST.pack(counts[0] + 1, self._now()) + body
        size = len(data)
        if size > self._largest:
            check_size(key, data, self._largest)
        counts[0] += 1
        counts[1] += size
        return data

    def size(self, body: bytes) -> int:
        """Return the bytes of a message with its envelope."""
        return len(self._starts[0]) + _REST.size + len(body)

    def seal(self, body: bytes) -> bytes:
        """Return a message without a number: a question or an answer."""
        return self._starts[0] + _REST.pack(0, self._now()) + body


class _Last:
    """The last message under a key: how it began, its number, and how many were left out if it was its owner's."""

    __slots__ = ("incarnation", "leap", "length", "number", "owner", "start")

    def __init__(self, owner: str, incarnation: int, number: int, start: bytes, leap: int = 0) -> None:
        self.owner = owner
        self.incarnation = incarnation
        self.number = number
        self.leap = leap
        self.start = _NO_START if leap else start  # else the next is taken without a look at this
        self.length = len(start)


class Unpacker:
    """Takes the messages of others out of their envelopes, and refuses those that must not be handed on.

    Args:
        team: Whose keys.
        agent: Who receives.
        largest: The largest message in bytes.
        missing: Called with a key and the number of its messages that were lost before the one that came.
        renumbered: Called with a key whose last number cannot have been its owner's, such as a forged one far ahead:
            some messages far behind it that follow each other are then gone on from.
    """

    def __init__(
        self,
        team: str,
        agent: str,
        missing: Callable[[str, int], None],
        renumbered: Callable[[str], None] = lambda _: None,
        *,
        largest: int = LARGEST,
    ) -> None:
        self.largest = largest
        self._team = team
        self._agent = agent
        self._missing = missing
        self._renumbered = renumbered
        self._present: dict[str, int] = {}
        self._last: dict[str, _Last] = {}
        self._excused: dict[str, int] = {}
        self._seen: dict[str, int] = {}
        self._doubts: dict[str, _Doubt] = {}

    def present(self, owner: str, incarnation: int) -> None:
        """Take this for the present life of an agent, because it is seen to live; messages of other lives are stale.

        It may be less than that of an earlier life, where a clock was set back.
        """
        self._seen[owner] = incarnation
        self._begin(owner, incarnation)

    def _begin(self, owner: str, incarnation: int) -> None:
        if self._present.get(owner) != incarnation:
            self._present[owner] = incarnation
            for last in self._last.values():
                if last.owner == owner and last.incarnation != incarnation:
                    last.number = _NONE

    def excuse(self, key: str, count: int) -> None:
        """Do not miss so many messages under a key: they came, and were superseded."""
        if key in self._last:
            self._excused[key] = self._excused.get(key, 0) + count

    def unpack(self, key: str, data: bytes, now: int = 0) -> Sample:
        """Return the message under a key.

        Args:
            key: The key.
            data: With its envelope.
            now: The time in nanoseconds, by which messages that are sent again are told from new ones.

        Raises:
            Refusal: If it must not be handed on.
        """
        # Every message comes here. Nearly all begin as the last of their key did, and are the next: these take a third
        # of the time that it takes to look at all of an envelope.
        last = self._last.get(key)
        if last is not None and data.startswith(last.start) and len(data) <= self.largest:
            length = last.length
            try:
                number, time = _REST.unpack_from(data, length)
            except struct.error:
                raise Refusal("malformed", f"a message under {key} is shorter than an envelope") from None
            if number == last.number + 1:
                last.number = number
                return Sample(key, last.owner, last.incarnation, data[length + 16 :], time)
        return self._unpack(key, data, last, now)

    def _unpack(self, key: str, data: bytes, last: _Last | None, now: int) -> Sample:
        owner, incarnation, number, time, start = _open(key, data, self.largest)
        if owner != owner_of(key, self._team):
            raise Refusal("foreign", f"agent {owner!r} sent under {key}, where it is not the owner")
        if owner == self._agent:
            raise Refusal("foreign", f"another process sent under {key}, of this agent")
        present = self._present.get(owner, 0)
        if incarnation < present and incarnation != self._seen.get(owner):
            raise Refusal("stale", f"a message under {key} is of an earlier life of agent {owner!r}")
        self._begin(owner, incarnation)
        leap = 0  # what one message tells that is far ahead counts when the next is there, and for so many at most
        if last is None:
            if len(self._last) >= _MOST_KEYS:
                oldest = next(iter(self._last))
                del self._last[oldest]
                self._excused.pop(oldest, None)
                self._doubts.pop(oldest, None)
        elif last.incarnation == incarnation and last.number != _NONE:
            missed = number - last.number - 1
            if missed < 0:
                self._doubt(key, number, last.number, now, fresh=0 < now < time + _FRESH)
                missed = 0
            elif missed > _FAR and last.leap == 0:
                leap, missed = missed, 0
            else:
                missed = min(missed + last.leap, _MOST_MISSING)
            missed -= 0 if leap else self._excused.pop(key, 0)
            if missed > 0:
                self._missing(key, missed)
        self._last[key] = _Last(owner, incarnation, number, data[:start], leap)
        return Sample(key, owner, incarnation, data[start + _REST.size :], time)

    def _doubt(self, key: str, number: int, ahead: int, now: int, *, fresh: bool) -> None:
        """Refuse a message that is behind the last of its key, unless that cannot have been its owner's.

        It cannot where it is far ahead of others that follow each other, or of such as were sent only now.

        Raises:
            Refusal: Nearly always.
        """
        if fresh or ahead - number > _FAR:
            doubt = self._doubts.setdefault(key, _Doubt(number, ahead, now))
            if doubt.number != number and doubt.confirms(number, ahead, now):
                del self._doubts[key]
                self._renumbered(key)
                return
        raise Refusal("repeated", f"a message under {key} came again, or after a newer one")

    def unseal(self, key: str, data: bytes, *, of_owner: bool) -> Sample:
        """Return a question or an answer; an answer is of the owner of the key.

        Raises:
            Refusal: If it must not be handed on.
        """
        owner, incarnation, _, time, start = _open(key, data, self.largest)
        if of_owner and owner != owner_of(key, self._team):
            raise Refusal("foreign", f"agent {owner!r} answered under {key}, where it is not the owner")
        return Sample(key, owner, incarnation, data[start + _REST.size :], time)


def is_step(data: bytes) -> bool:
    """Whether a message in its envelope says that it is one of an agreed step."""
    return data[4:5] == b"\1"


def check_size(key: str, data: bytes, largest: int) -> None:
    """Refuse to send a message that every receiver would drop.

    Raises:
        Error: If it is larger than the limit.
    """
    if len(data) > largest:
        raise Error(f"a message under {key} has {len(data):,} bytes, and at most {largest:,} are taken")


def _open(key: str, data: bytes, largest: int) -> tuple[str, int, int, int, int]:
    """Return the owner, its incarnation, the number, the time, and where the last two stand."""
    if len(data) > largest:
        raise Refusal("oversize", f"a message under {key} has {len(data):,} bytes, and at most {largest:,} are taken")
    try:
        magic, version, _, incarnation, length = _START.unpack_from(data)
        if magic == _MAGIC and version != VERSION:
            raise Refusal(
                "version", f"a message under {key} is of version {version}, and this program reads version {VERSION}"
            )
        start = _START.size + length
        number, time = _REST.unpack_from(data, start)
    except struct.error:
        raise Refusal("malformed", f"a message under {key} is shorter than an envelope") from None
    if magic != _MAGIC:
        raise Refusal("malformed", f"a message under {key} is not of this program")
    if incarnation >> 63:
        raise Refusal("malformed", f"a message under {key} is of life {incarnation}, which no agent has")
    try:
        owner = data[_START.size : start].decode()
    except UnicodeDecodeError:
        raise Refusal("malformed", f"a message under {key} names no owner") from None
    return owner, incarnation, number, time, start


_REST_OF_KEYS = "..."
_OFFENCES = frozenset({"malformed", "foreign", "oversize", "version"})
"""Kinds of messages that no agent of this program sends, and no network makes."""
_MANY = 100
_SECOND = 1_000_000_000
_IGNORED = 250_000_000
_NO_OFFENCES = (0, 0)


class _Route:
    """Where the messages under a key go, and how many went there."""

    __slots__ = ("bytes", "carrier", "handlers", "messages")

    def __init__(self, carrier: str | None, handlers: tuple[Callable[[Sample], None], ...]) -> None:
        self.carrier = carrier
        self.handlers = handlers
        self.messages = 0
        self.bytes = 0


class Router:
    """A transport without a carrier: it hands the messages that come to handlers, and counts all.

    Args:
        team: Whose keys.
        agent: The agent.
        incarnation: Which life of it.
        now: The time in nanoseconds.
        largest: The largest message in bytes.

    Attributes:
        protocol: The version of the protocol that it speaks.
        live: The agents that are seen to live, by incarnation.
    """

    def __init__(
        self, team: str, agent: str, incarnation: int, now: Callable[[], int], *, largest: int = LARGEST
    ) -> None:
        self.team, self.agent, self.incarnation, self.protocol = team, agent, incarnation, PROTOCOL
        self.state: Literal["new", "opening", "open", "closed"] = "new"
        self.packer = Packer(agent, incarnation, now, largest=largest)
        self.unpacker = Unpacker(team, agent, self._missing, self._renumbered, largest=largest)
        self.live: dict[str, int] = {}
        self._largest = largest
        self._failed: Callable[[BaseException], None] = _tell_loop
        self._report: Callable[[str, str], None] | None = None
        self._subscriptions: list[tuple[str, str, Callable[[Sample], None]]] = []  # carrier, expression, handler
        self._routes: dict[str, _Route] = {}
        self._rest = _Route(None, ())
        self._served: dict[str, Callable[[bytes], bytes]] = {}
        self._watchers: list[Callable[[Mapping[str, int]], None]] = []
        self._dropped: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self._untold: dict[str, tuple[int, str]] = {}
        self._lateness = Latencies()
        self._late = self._lateness.pending
        self._refused: dict[str, int] = {}
        self._recent: dict[str, tuple[int, int]] = {}  # since when, and how many since then
        self._ignored: dict[str, int] = {}  # until when
        self._at = 0
        self._round_trips: dict[str, Latencies] = {}

    # -- What a transport does by itself -------------------------------------------------------------------------

    def _later(self, seconds: float, callback: Callable[[], None]) -> object:
        """Call back after so many seconds."""
        raise NotImplementedError

    def _carry(self, expression: str) -> None:
        """Bring messages under the keys of one more expression."""

    def _offer(self, key: str) -> None:
        """Bring questions under one more key."""

    # -- Its state -----------------------------------------------------------------------------------------------

    def _check_new(self) -> None:
        """Refuse to open once more.

        Raises:
            Error: If it was opened before.
        """
        if self.state != "new":
            raise Error(f"the transport of agent {self.agent!r} is {self.state}: make a new one")

    def _is_closed(self, key: str) -> bool:
        """Return whether nothing is put under a key any more, which is then counted.

        Raises:
            Error: If the key is another agent's, or it was never open.
        """
        self.check_own(key)
        if self.state == "closed":
            self.drop("closed", f"a message under {key} was put after the transport was closed")
        elif self.state != "open":
            raise Error(f"the transport of agent {self.agent!r} is not open: await open() before put()")
        return self.state == "closed"

    def _question(self, expression: str, body: bytes) -> bytes:
        """Return a question in its envelope.

        Raises:
            Error: If it cannot be asked.
        """
        check_expression(expression)
        if self.state not in {"opening", "open"}:
            raise Error(f"the transport of agent {self.agent!r} is {self.state}: nothing can be asked")
        question = self.packer.seal(body)
        check_size(expression, question, self._largest)
        return question

    def supervise(self, failed: Callable[[BaseException], None], report: Callable[[str, str], None]) -> None:
        """Report failures and dropped messages to these."""
        self._failed, self._report = failed, report

    def fail(self, error: BaseException) -> None:
        """Report a failure."""
        self._failed(error)

    def subscribe(self, expression: str, handler: Callable[[Sample], None]) -> None:
        """Call a handler with each message under the keys of an expression."""
        check_expression(expression)
        carrier = next((wide for wide in self.carriers() if includes(wide, expression)), expression)
        carried = carrier != expression or expression in self.carriers()  # with the keys of an earlier one
        self._subscriptions.append((carrier, expression, handler))
        for key, route in self._routes.items():
            if matches(expression, key):
                route.handlers += (handler,)
                route.carrier = route.carrier or carrier
        if not carried:
            self._carry(expression)

    def carriers(self) -> tuple[str, ...]:
        """Return the expressions that the transport must carry."""
        return tuple(dict.fromkeys(carrier for carrier, _, _ in self._subscriptions))

    def wants(self, key: str) -> bool:
        """Whether anything subscribed to a key."""
        return bool((self._routes.get(key) or self._route(key)).handlers)

    def deliver(self, key: str, data: bytes, now: int, carrier: str | None = None) -> None:
        """Hand a message to the handlers of its key.

        Args:
            key: Under which it was put.
            data: With its envelope.
            now: The time in nanoseconds.
            carrier: The expression that brought it; where two bring the same message, one of them counts.
        """
        route = self._routes.get(key) or self._route(key)
        if (carrier is not None and carrier != route.carrier) or not route.handlers:
            return
        self._at = now
        if self._ignored and self._ignores(key):
            return
        try:
            sample = self.unpacker.unpack(key, data, now)
        except Refusal as refusal:
            if refusal.kind in _OFFENCES:
                self._refuse(owner_of(key, self.team) or key, refusal.kind, str(refusal))
            else:
                self.drop(refusal.kind, str(refusal))
            return
        if not -DAY < now - sample.time < DAY:
            hours = abs(sample.time - now) / 3.6e12
            told = f"the clock of {sample.owner} is {hours:,.0f} hours off that of {self.agent}"
            self._refuse(sample.owner, "untimely", f"{told}: set it, or nothing that it says counts")
            return
        route.messages += 1
        route.bytes += len(data)
        self._late.append(now - sample.time)
        if len(self._late) >= FULL:
            self._lateness.fold()
        for handler in route.handlers:
            try:
                handler(sample)
            except BaseException as error:
                self._failed(error)

    def _route(self, key: str) -> _Route:
        found = self._routes.get(key)
        if found is not None:
            return found
        taken = [(carrier, handler) for carrier, expression, handler in self._subscriptions if matches(expression, key)]
        # Two subscriptions that overlap both bring the message: the first that was made carries it for both.
        carrier = next((wide for wide in self.carriers() if matches(wide, key)), None)
        route = _Route(carrier, tuple(handler for _, handler in taken))
        if len(self._routes) < _MOST_KEYS:
            self._routes[key] = route
        elif taken:  # its messages are counted together with those of all further keys
            self._rest.carrier, self._rest.handlers = route.carrier, route.handlers
            return self._rest
        return route

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> None:
        """Answer questions under a key of this agent.

        Raises:
            Error: If the key is another agent's, or is answered already.
        """
        self.check_own(key)
        if key in self._served:
            raise Error(f"{key} is answered already")
        self._served[key] = answer
        self._offer(key)

    def served(self, expression: str | None = None) -> Iterator[str]:
        """Return the keys that are answered here: all, or those of an expression."""
        return (key for key in tuple(self._served) if expression is None or matches(expression, key))

    def answer(self, key: str, data: bytes) -> bytes | None:
        """Return the answer to a question; None where there is none."""
        try:
            question = self.unpacker.unseal(key, data, of_owner=False)
            if question.owner == self.agent:
                self.drop("duplicate", f"another process asks as agent {self.agent!r}: two have this name")
            return self._served[key](question.body)
        except Refusal as refusal:
            self.drop(refusal.kind, str(refusal))
        except BaseException as error:
            self._failed(error)
        return None

    def answered(self, key: str, data: bytes, seconds: float) -> Sample | None:
        """Return an answer that came after so many seconds, out of its envelope; None where it is refused."""
        try:
            answer = self.unpacker.unseal(key, data, of_owner=True)
        except Refusal as refusal:
            self.drop(refusal.kind, str(refusal))
            return None
        self._round_trips.setdefault(answer.owner, Latencies()).record(round(seconds * 1e9))
        return answer

    def watch(self, handler: Callable[[Mapping[str, int]], None]) -> None:
        """Tell a handler who is live: now, where this agent is, and at each change."""
        self._watchers.append(handler)
        if self.live:
            self._notify(handler)

    def see(self, live: Mapping[str, int]) -> None:
        """Take this for who is live now, by incarnation."""
        if live == self.live:
            return
        self.live = dict(sorted(live.items()))
        for agent, incarnation in live.items():
            self.unpacker.present(agent, incarnation)
        for handler in tuple(self._watchers):
            self._notify(handler)

    def _notify(self, handler: Callable[[Mapping[str, int]], None]) -> None:
        try:
            handler(dict(self.live))
        except BaseException as error:
            self._failed(error)

    def check_own(self, key: str) -> None:
        """Refuse to put or answer under a key of another agent.

        Raises:
            Error: If it is one, or is no key.
        """
        if key not in self.packer.sent and owner_of(check_key(key), self.team) != self.agent:
            raise Error(f"agent {self.agent!r} of team {self.team!r} must not use {key}, which is not its own")

    def _missing(self, key: str, count: int) -> None:
        owner = owner_of(key, self.team) or ""
        self._lost[owner] = self._lost.get(owner, 0) + count
        self.drop("missing", f"messages under {key} were lost on the way", count)

    def _renumbered(self, key: str) -> None:
        self.drop("renumbered", f"the last number under {key} was far ahead of its owner's: what comes counts again")

    def report(self, kind: str, reason: str) -> None:
        """Report a failure that is no dropped message."""
        if self._report is not None:
            self._report(kind, reason)

    def refuse(self, sender: str, reason: str) -> None:
        """Take note of a message that a handler did not take."""
        self._refuse(sender, "incredible", reason)

    def _refuse(self, sender: str, kind: str, reason: str) -> None:
        """Drop a message that no agent of this program sends; a sender that goes on is ignored for a while."""
        self.drop(kind, reason)
        if sender not in self._refused and len(self._refused) >= _MOST_KEYS:
            sender = _REST_OF_KEYS
        self._refused[sender] = self._refused.get(sender, 0) + 1
        since, count = self._recent.get(sender, _NO_OFFENCES)
        since, count = (since, count + 1) if self._at - since < _SECOND else (self._at, 1)
        if count > _MANY:
            self._ignored[sender] = self._at + _IGNORED
            since, count = _NO_OFFENCES
        self._recent[sender] = since, count

    def _ignores(self, key: str) -> bool:
        """Return whether messages under a key are dropped unread, since their sender sent too many that cannot be."""
        sender = owner_of(key, self.team) or key
        until = self._ignored.get(sender)
        if until is None:
            return False
        if self._at >= until:
            del self._ignored[sender]
            return False
        self.drop("ignored", f"{sender} is not heard: it sent a hundred messages in a second that cannot be")
        return True

    def drop(self, kind: str, reason: str, count: int = 1) -> None:
        """Count a dropped message, and report it: at once, but once a second at most."""
        self._dropped[kind] = self._dropped.get(kind, 0) + count
        if kind in self._untold:
            self._untold[kind] = (self._untold[kind][0] + count, reason)
        else:
            self._untold[kind] = (count, reason)
            self._report_dropped(kind)

    def _report_dropped(self, kind: str) -> None:
        count, reason = self._untold[kind]
        if not count:
            del self._untold[kind]
            return
        self._untold[kind] = (0, reason)
        self._later(1.0, partial(self._report_dropped, kind))
        if self._report is not None:
            try:
                self._report(kind, reason if count == 1 else f"{reason} ({count} such messages)")
            except BaseException as error:
                self._failed(error)

    def statistics(self) -> TransportStatistics:
        """Return the counts so far."""
        received = {key: Traffic(route.messages, route.bytes) for key, route in self._routes.items() if route.messages}
        if self._rest.messages:
            received[_REST_OF_KEYS] = Traffic(self._rest.messages, self._rest.bytes)
        return TransportStatistics(
            sent=_traffic(self.packer.sent),
            received=received,
            dropped=dict(self._dropped),
            lost=dict(self._lost),
            refused=dict(self._refused),
            lateness=self._lateness.snapshot(),
            round_trips={agent: latencies.snapshot() for agent, latencies in self._round_trips.items()},
        )


def _traffic(sent: Mapping[str, list[int]]) -> dict[str, Traffic]:
    """Return the counts of messages that were put; those of too many keys together."""
    told = {key: Traffic(*counts) for key, counts in islice(sent.items(), _MOST_KEYS) if counts[0]}
    if len(sent) > _MOST_KEYS:
        rest = [*islice(sent.values(), _MOST_KEYS, None)]
        told[_REST_OF_KEYS] = Traffic(sum(messages for messages, _ in rest), sum(size for _, size in rest))
    return told


def _tell_loop(error: BaseException) -> None:
    asyncio.get_running_loop().call_exception_handler(
        {"message": "a handler of a team's messages failed", "exception": error}
    )
