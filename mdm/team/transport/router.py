"""The router: hands the messages of a transport to the handlers, or refuses them, and counts both."""

from __future__ import annotations

from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.runtime.statistics import FULL, Latencies
from mdm.team.transport.bounds import DAY
from mdm.team.transport.envelope import LARGEST, Refusal, Unpacker
from mdm.team.transport.keys import check_expression, check_key, includes, matches, owner_of
from mdm.team.transport.transport import Sample, Traffic, TransportStatistics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

__all__ = ["Router"]

_MOST_KEYS = 4096
_REST = "..."
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
    """The receiving side of a transport.

    Args:
        team: Whose keys.
        agent: Who receives.
        later: Calls back after so many seconds.
        failed: Called with the error of a handler, until `supervise` names another.
        sent: By key, how many messages this agent has put, and their bytes.
        largest: The largest message in bytes.
    """

    def __init__(
        self,
        team: str,
        agent: str,
        *,
        later: Callable[[float, Callable[[], None]], object],
        failed: Callable[[BaseException], None],
        sent: Mapping[str, list[int]],
        largest: int = LARGEST,
    ) -> None:
        self.sent = sent
        self.unpacker = Unpacker(team, agent, self._missing, self._renumbered, largest=largest)
        self.live: dict[str, int] = {}
        self._team = team
        self._agent = agent
        self._later = later
        self._failed = failed
        self._report: Callable[[str, str], None] | None = None
        self._subscriptions: list[tuple[str, str, Callable[[Sample], None]]] = []  # carrier, expression, handler
        self._routes: dict[str, _Route] = {}
        self._rest = _Route(None, ())
        self._served: dict[str, Callable[[bytes], bytes]] = {}
        self._watchers: list[Callable[[Mapping[str, int]], None]] = []
        self._dropped: dict[str, int] = {}
        self._untold: dict[str, tuple[int, str]] = {}
        self._lateness = Latencies()
        self._late = self._lateness.pending
        self._refused: dict[str, int] = {}
        self._recent: dict[str, tuple[int, int]] = {}  # since when, and how many since then
        self._ignored: dict[str, int] = {}  # until when
        self._now = 0
        self._round_trips: dict[str, Latencies] = {}

    def supervise(self, failed: Callable[[BaseException], None], report: Callable[[str, str], None]) -> None:
        """Report failures and dropped messages to these."""
        self._failed, self._report = failed, report

    def fail(self, error: BaseException) -> None:
        """Tell of a failure."""
        self._failed(error)

    def subscribe(self, expression: str, handler: Callable[[Sample], None]) -> bool:
        """Have a handler called; return whether the transport must now carry this expression.

        It need not where the keys are among those of an earlier one.
        """
        check_expression(expression)
        carrier = next((wide for wide in self.carriers() if includes(wide, expression)), expression)
        known = carrier != expression or expression in self.carriers()
        self._subscriptions.append((carrier, expression, handler))
        for key, route in self._routes.items():
            if matches(expression, key):
                route.handlers += (handler,)
                route.carrier = route.carrier or carrier
        return not known

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
        self._now = now
        if self._ignored and self._ignores(key):
            return
        try:
            sample = self.unpacker.unpack(key, data, now)
        except Refusal as refusal:
            if refusal.kind in _OFFENCES:
                self.refuse(owner_of(key, self._team) or key, refusal.kind, str(refusal))
            else:
                self.drop(refusal.kind, str(refusal))
            return
        if not -DAY < now - sample.time < DAY:
            hours = abs(sample.time - now) / 3.6e12
            told = f"the clock of {sample.owner} is {hours:,.0f} hours off that of {self._agent}"
            self.refuse(sample.owner, "untimely", f"{told}: set it, or nothing that it says counts")
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

    def served(self, expression: str | None = None) -> Iterator[str]:
        """Return the keys that are answered here: all, or those of an expression."""
        return (key for key in tuple(self._served) if expression is None or matches(expression, key))

    def answer(self, key: str, data: bytes) -> bytes | None:
        """Return the answer to a question; None where there is none."""
        try:
            question = self.unpacker.unseal(key, data, of_owner=False)
            if question.owner == self._agent:
                self.drop("duplicate", f"another process asks as agent {self._agent!r}: two have this name")
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
        """Have a handler told who is live: now, where this agent is, and at each change."""
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
        if key not in self.sent and owner_of(check_key(key), self._team) != self._agent:
            raise Error(f"agent {self._agent!r} of team {self._team!r} must not use {key}, which is not its own")

    def _missing(self, key: str, count: int) -> None:
        self.drop("missing", f"messages under {key} were lost on the way", count)

    def _renumbered(self, key: str) -> None:
        self.drop("renumbered", f"the last number under {key} was far ahead of its owner's: what comes counts again")

    def report(self, kind: str, reason: str) -> None:
        """Report a failure that is no dropped message."""
        if self._report is not None:
            self._report(kind, reason)

    def refuse(self, sender: str, kind: str, reason: str) -> None:
        """Drop a message that no agent of this program sends; a sender that goes on is ignored for a while."""
        self.drop(kind, reason)
        if sender not in self._refused and len(self._refused) >= _MOST_KEYS:
            sender = _REST
        self._refused[sender] = self._refused.get(sender, 0) + 1
        since, count = self._recent.get(sender, _NO_OFFENCES)
        since, count = (since, count + 1) if self._now - since < _SECOND else (self._now, 1)
        if count > _MANY:
            self._ignored[sender] = self._now + _IGNORED
            since, count = _NO_OFFENCES
        self._recent[sender] = since, count

    def _ignores(self, key: str) -> bool:
        """Return whether messages under a key are dropped unread, since their sender sent too many that cannot be."""
        sender = owner_of(key, self._team) or key
        until = self._ignored.get(sender)
        if until is None:
            return False
        if self._now >= until:
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
            received[_REST] = Traffic(self._rest.messages, self._rest.bytes)
        return TransportStatistics(
            sent=_traffic(self.sent),
            received=received,
            dropped=dict(self._dropped),
            refused=dict(self._refused),
            lateness=self._lateness.snapshot(),
            round_trips={agent: latencies.snapshot() for agent, latencies in self._round_trips.items()},
        )


def _traffic(sent: Mapping[str, list[int]]) -> dict[str, Traffic]:
    """Return the counts of messages that were put; those of too many keys together."""
    told = {key: Traffic(*counts) for key, counts in islice(sent.items(), _MOST_KEYS) if counts[0]}
    if len(sent) > _MOST_KEYS:
        rest = [*islice(sent.values(), _MOST_KEYS, None)]
        told[_REST] = Traffic(sum(messages for messages, _ in rest), sum(size for _, size in rest))
    return told
