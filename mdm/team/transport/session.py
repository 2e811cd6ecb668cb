"""The session: a team's transport between processes, over Zenoh.

Zenoh connects, carries and tells who is live. Its messages wait in a `Mailbox` for the event loop. Calls that may block
(opening, declaring, asking, closing) runs in a thread of the session's own.
"""

from __future__ import annotations

import asyncio
import json
import os
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import msgspec

from mdm.errors import Error
from mdm.runtime.time.clock import WallClock, check_seconds
from mdm.runtime.time.virtual import VirtualEventLoop
from mdm.team.transport.bounds import UNREADABLE
from mdm.team.transport.envelope import LARGEST, Packer, check_size, is_step
from mdm.team.transport.keys import check_expression, check_name, join
from mdm.team.transport.mailbox import Mailbox
from mdm.team.transport.router import Router
from mdm.team.transport.settings import check_endpoint, exposed, resolve, settings
from mdm.team.transport.transport import DOUBLE, LONGEST_CLOSE, PROTOCOL

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import zenoh

    from mdm.team.transport.allowance import Allowance
    from mdm.team.transport.transport import Priority, Sample, TransportStatistics

__all__ = ["Session", "import_zenoh"]

T = TypeVar("T")

_LIVE = "@team/live"
_WHO = "@team/who"
_FLUSH = 0.1
_RETRY = 0.25

_open: set[zenoh.Session] = set()
_forked = False
_prepared = False
_last_incarnation = 0


def _prepare() -> None:
    """See to it that no session is left to the interpreter's exit, which would wait for its threads, nor to a child."""
    global _prepared  # noqa: PLW0603 (once a process)
    if not _prepared:
        _prepared = True
        os.register_at_fork(after_in_child=_mark_child)
        # An `atexit` function would come too late: it is called after threads have been waited for.
        threading._register_atexit(_close_all)  # type: ignore[attr-defined]  # noqa: SLF001


def _mark_child() -> None:
    global _forked  # noqa: PLW0603 (one process, one answer)
    _forked = bool(_open) or _forked
    _open.clear()


def _close_all() -> None:
    while _open:
        _open.pop().close()  # type: ignore[no-untyped-call]


def _check_not_forked() -> None:
    if _forked:
        raise Error(
            "Zenoh does not work in a process that was forked from one with an open session: start processes with "
            "multiprocessing's method 'spawn', or as programs of their own"
        )


def _new_incarnation() -> int:
    global _last_incarnation  # noqa: PLW0603 (one process, one order)
    _last_incarnation = max(_last_incarnation + 1, time.time_ns())
    return _last_incarnation


class Session:
    """An agent's transport over Zenoh; see `Transport` for its promises.

    Args:
        team: The team's name.
        agent: The agent's name.
        listen: The endpoint at which other agents reach this one, or several. Without a host of the network it is
            reached from its own machine alone.
        connect: The endpoints of other agents. Two agents meet where one of them connects to the other; it is enough
            that each connects to those declared before it.
        mode: ``client`` where ``connect`` is a router, which carries all messages and which `open` waits for.
        lease: After so many seconds of silence the others take this agent for lost.
        largest: The largest message in bytes, with its envelope.
        allowance: The most that this agent may send; any amount by default.
        configuration: Further settings of Zenoh, such as ceilings and access; they are laid over the session's own.

    Example::

        session = Session("rescue", "robot2", listen="tcp/127.0.0.1:7448", connect=["tcp/127.0.0.1:7447"])
        session.subscribe("mdm/rescue/*/patrol/state", print)
        await session.open()
        session.put("mdm/rescue/robot2/patrol/state", b"at home")
        await session.close()
    """

    def __init__(
        self,
        team: str,
        agent: str,
        *,
        listen: str | Sequence[str] = "tcp/127.0.0.1:7447",
        connect: Sequence[str] = (),
        mode: Literal["peer", "client"] = "peer",
        lease: float = 1.0,
        largest: int = LARGEST,
        allowance: Allowance | None = None,
        configuration: Mapping[str, Any] | None = None,
    ) -> None:
        self.team = check_name(team, "a team")
        self.agent = check_name(agent, "an agent")
        self.incarnation = _new_incarnation()
        self.allowance = allowance
        check_seconds(lease, "the lease")
        self._listen = [check_endpoint(one) for one in ([listen] if isinstance(listen, str) else listen)]
        self._connect = [check_endpoint(one, connect=True) for one in connect]
        self._lease = lease
        self._largest = largest
        self._settings = settings(listen=self._listen, connect=self._connect, lease=lease, largest=largest, mode=mode)
        _lay_over(self._settings, configuration or {})
        self._clock = WallClock()  # kept, so that it leaps with the runtime's
        self._now = self._clock.reader()
        self._packer = Packer(agent, self.incarnation, self._now, largest=largest)
        self._router = Router(
            team, agent, later=self._call_later, failed=_tell_loop, sent=self._packer.sent, largest=largest
        )
        self._state: Literal["new", "opening", "open", "closed"] = "new"
        self._zenoh: zenoh.Session | None = None
        self._mailbox: Mailbox | None = None
        self._worker: ThreadPoolExecutor | None = None
        self._tokens: dict[str, set[int]] = {}
        self._questions: set[asyncio.Future[None]] = set()
        self._keys: dict[str, zenoh.KeyExpr] = {}
        self._router.serve(join(team, agent, _WHO), self._who)

    protocol = PROTOCOL

    @property
    def identity(self) -> bytes:
        """Who this is, as agents are asked whether another process has its name."""
        return msgspec.msgpack.encode((self.agent, self.incarnation, (self._listen or self._connect)[0]))

    # Opening and closing

    async def open(self) -> None:
        """Take part; return once messages to the handlers given so far arrive wherever this agent is seen.

        Raises:
            Error: If an endpoint cannot be used, a live agent has this name, Zenoh is not installed, or the process was
                forked.
        """
        if self._state != "new":
            raise Error(f"the transport of agent {self.agent!r} is {self._state}: make a new one")
        _check_not_forked()
        library = import_zenoh()
        loop = asyncio.get_running_loop()
        if isinstance(loop, VirtualEventLoop):
            raise Error("Zenoh knows no virtual time: use a mdm.team.transport.network.Network there")
        self._state = "opening"
        _prepare()
        self._priorities = {
            "step": library.Priority.REAL_TIME,
            "value": library.Priority.DATA,
            "bulk": library.Priority.BACKGROUND,
        }
        self._drop = library.CongestionControl.DROP
        self._mailbox = Mailbox(
            loop, self._router.deliver, self._overflowed, now=self._now, urgent=is_step, failed=self._router.fail
        )
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"mdm-{self.agent}")
        try:
            while not await self._work(self._begin):  # noqa: ASYNC110 - a router that is not there says nothing
                await asyncio.sleep(_RETRY)
            # One that fell silent may be seen to live until its lease is over.
            await self._refuse_double(lambda _: True, patience=2 * self._lease + 0.5)
            await self._work(self._appear)
            # Of two that came at once, the one that began first stays.
            await self._refuse_double(lambda other: other < self.incarnation, patience=0)
        except BaseException:
            self._end()
            raise
        self._state = "open"
        risk = None if "access_control" in self._settings else exposed(self._listen or self._connect)
        if risk is not None:
            self._router.report("unprotected", risk)
        self._look()

    def _begin(self) -> bool:
        """Open the session; return whether its router was there, or it needs none."""
        library = import_zenoh()
        for endpoint in (*self._listen, *self._connect):
            resolve(endpoint)
        try:
            opened = library.open(library.Config.from_json5(json.dumps(self._settings)))
        except library.ZError as error:
            if self._settings["mode"] == "client" and "Unable to connect" in str(error):
                return False
            raise self._refusal(str(error)) from None
        _open.add(opened)
        self._zenoh = opened
        for expression in self._router.carriers():
            self._declare_subscriber(expression)
        for key in self._router.served():
            self._declare_queryable(key)
        opened.liveliness().declare_subscriber(
            join(self.team, "*", _LIVE, "*"),
            library.handlers.Callback(self._token_changed, indirect=False),
            history=True,
        )
        return True

    def _appear(self) -> None:
        # Others learn of the token after all that was declared before it on the same connection.
        assert self._zenoh is not None
        self._token = self._zenoh.liveliness().declare_token(join(self.team, self.agent, _LIVE, str(self.incarnation)))

    def _refusal(self, reason: str) -> Error:
        where = f"agent {self.agent!r} of team {self.team!r} cannot listen on {', '.join(self._listen)}"
        if "Address already in use" in reason:
            return Error(f"{where}: the port is in use; end the program that has it, or choose another one")
        if "Cannot assign requested address" in reason:
            return Error(f"{where}: that is no address of this machine; listen at one of its own, or at 0.0.0.0")
        if "Permission denied" in reason:
            return Error(f"{where}: that needs permission; choose a port above 1023")
        return Error(
            f"agent {self.agent!r} of team {self.team!r} cannot open its session: {reason.partition(' at /')[0]}"
        )

    async def _refuse_double(self, counts: Callable[[int], bool], *, patience: float) -> None:
        """Refuse a name that another live agent has for longer than so many seconds.

        Raises:
            Error: If one has it.
        """
        until = self._now() + round(patience * 1e9)
        while True:
            answers = await self.ask(join(self.team, "*", _WHO), timeout=min(self._lease, 1.0))
            others = {
                incarnation
                for answer in answers.values()
                for incarnation in _decode(answer).get(self.agent, ())
                if incarnation != self.incarnation and counts(incarnation)
            } | {other for other in self._tokens.get(self.agent, ()) if counts(other)}
            if not others:
                return
            if self._now() > until:
                await self.ask(join(self.team, "*", DOUBLE), self.identity)
                raise Error(
                    f"an agent {self.agent!r} of team {self.team!r} is live already: "
                    "end its process, or give this one another name"
                )
            await asyncio.sleep(self._lease / 10)

    async def close(self) -> None:
        """Leave. May be called again, does not hang, and no handler is called after it."""
        ended = self._end()
        if ended is not None:
            await asyncio.wait([asyncio.wrap_future(ended)], timeout=LONGEST_CLOSE)

    def _end(self) -> Future[None] | None:
        self._state = "closed"
        if self._mailbox is not None:
            self._mailbox.close()
        for question in self._questions:
            if not question.done():
                question.set_result(None)
        worker, self._worker = self._worker, None
        if worker is None:
            return None
        ended = worker.submit(self._close_zenoh)
        worker.shutdown(wait=False)
        return ended

    def _close_zenoh(self) -> None:
        opened, self._zenoh = self._zenoh, None
        if opened is not None:
            if self._tokens:  # what was put last, such as a farewell, reaches them before the end does
                time.sleep(_FLUSH)
            opened.close()  # type: ignore[no-untyped-call]
            _open.discard(opened)

    def _work(self, function: Callable[[], T]) -> asyncio.Future[T]:
        """Make a call that may block in the session's thread."""
        if self._worker is None:
            raise Error(f"the transport of agent {self.agent!r} is closed")
        return asyncio.wrap_future(self._worker.submit(function))

    def _work_later(self, function: Callable[[], None]) -> None:
        """Make a call that nobody waits for in the session's thread."""
        if self._worker is not None:
            self._worker.submit(function).add_done_callback(self._worked)

    def _worked(self, future: Future[None]) -> None:
        error = None if future.cancelled() else future.exception()
        if error is not None and self._mailbox is not None:
            self._mailbox.post(partial(self._router.fail, error))

    # Sending

    def put(self, key: str, body: bytes, *, priority: Priority = "value") -> bool:
        """Send to all who subscribed; never blocks. See `Transport.put`."""
        if self._state != "open" or _forked:
            _check_not_forked()
            self._router.check_own(key)
            if self._state != "closed":
                raise Error(f"the transport of agent {self.agent!r} is not open: await open() before put()")
            self._router.drop("closed", f"a message under {key} was put after the transport was closed")
            return False
        expression = self._keys.get(key) or self._own_key(key)
        if self.allowance is not None and not self.allowance.spend(
            self._packer.size(body), priority, self._now() / 1e9
        ):
            self._router.drop("held_back", f"messages under {key} were held back: the agent's allowance is spent")
            return False
        data = self._packer.pack(key, body, step=priority == "step")
        assert self._zenoh is not None
        self._zenoh.put(expression, data, priority=self._priorities[priority], congestion_control=self._drop)
        return True

    def _own_key(self, key: str) -> zenoh.KeyExpr:
        self._router.check_own(key)
        if len(self._keys) >= 4096:
            self._keys.clear()
        expression: zenoh.KeyExpr = import_zenoh().KeyExpr(key)
        self._keys[key] = expression
        self._work_later(partial(self._make_known, key))
        return expression

    def _make_known(self, key: str) -> None:
        """Have receivers know a key beforehand.

        Zenoh computes anew for each message of a key that nobody declared which of the wider subscriptions take it: 2.4
        µs, against 0.6 µs. Of all declarations one of a queryable makes a key known; this one answers nothing.
        """
        assert self._zenoh is not None
        library = import_zenoh()
        self._zenoh.declare_queryable(key, library.handlers.Callback(lambda query: query.drop(), indirect=False))

    # Receiving

    def subscribe(self, expression: str, handler: Callable[[Sample], None]) -> None:
        """Have a handler called with each message under the keys of an expression."""
        if self._router.subscribe(expression, handler) and self._state in {"opening", "open"}:
            self._work_later(partial(self._declare_subscriber, expression))

    def _declare_subscriber(self, carrier: str) -> None:
        assert self._zenoh is not None
        assert self._mailbox is not None
        put = self._mailbox.put

        def receive(sample: zenoh.Sample) -> None:
            put(carrier, str(sample.key_expr), sample.payload.to_bytes())

        self._zenoh.declare_subscriber(carrier, receive, allowed_origin=import_zenoh().Locality.REMOTE)

    def _overflowed(self, key: str, count: int) -> None:
        self._router.unpacker.excuse(key, count)
        self._router.drop("overflow", f"messages under {key} came faster than they were taken", count)

    # Questions and answers

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> None:
        """Answer requests under a key of this agent."""
        self._router.serve(key, answer)
        if self._state in {"opening", "open"}:
            self._work_later(partial(self._declare_queryable, key))

    def _declare_queryable(self, key: str) -> None:
        assert self._zenoh is not None
        assert self._mailbox is not None
        library, offer = import_zenoh(), self._mailbox.offer

        def receive(query: zenoh.Query) -> None:
            if not offer(key, partial(self._answer, key, query)):
                query.drop()  # type: ignore[no-untyped-call]

        self._zenoh.declare_queryable(key, library.handlers.Callback(receive, indirect=False))

    def _answer(self, key: str, query: zenoh.Query) -> None:
        payload = query.payload
        answer = self._router.answer(key, b"" if payload is None else payload.to_bytes())

        def reply() -> None:
            if answer is not None:
                query.reply(key, self._packer.seal(answer))
            query.drop()  # type: ignore[no-untyped-call]

        self._work_later(reply)

    async def ask(self, expression: str, body: bytes = b"", *, timeout: float = 1.0) -> dict[str, bytes]:  # noqa: ASYNC109
        """Ask all who serve the keys of an expression; return the answers by agent."""
        _check_not_forked()
        check_expression(expression)
        mailbox = self._mailbox
        if self._state not in {"opening", "open"} or mailbox is None:
            raise Error(f"the transport of agent {self.agent!r} is {self._state}: nothing can be asked")
        question = self._packer.seal(body)
        check_size(expression, question, self._largest)
        library, began = import_zenoh(), self._now()
        answers: dict[str, bytes] = {}
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        def take(key: str, data: bytes) -> None:
            answer = self._router.answered(key, data, (self._now() - began) / 1e9)
            if answer is not None and not done.done():
                answers[answer.owner] = answer.body

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                mailbox.post(partial(take, str(reply.ok.key_expr), reply.ok.payload.to_bytes()))

        def finish() -> None:
            if not done.done():
                done.set_result(None)

        def ask() -> None:
            assert self._zenoh is not None
            self._zenoh.get(
                expression,
                library.handlers.Callback(receive, lambda: mailbox.post(finish), indirect=False),
                target=library.QueryTarget.ALL,
                consolidation=library.ConsolidationMode.NONE,
                timeout=timeout,
                payload=question,
                allowed_destination=library.Locality.REMOTE,
            )

        self._questions.add(done)
        try:
            await self._work(ask)
            await asyncio.wait([done], timeout=timeout + 0.1)
        finally:
            self._questions.discard(done)
            done.cancel()
        return answers

    # Who is live

    def watch(self, handler: Callable[[Mapping[str, int]], None]) -> None:
        """Have a handler called with the live agents and their incarnations."""
        self._router.watch(handler)

    def _token_changed(self, sample: zenoh.Sample) -> None:
        assert self._mailbox is not None
        live = sample.kind == import_zenoh().SampleKind.PUT
        self._mailbox.post(partial(self._on_token, str(sample.key_expr), live))

    def _on_token(self, key: str, live: bool) -> None:
        _, _, agent, _, _, text = key.split("/")
        if not (text.isascii() and text.isdigit() and len(text) < 20):
            self._router.drop("malformed", f"{key} is no sign of life")
            return
        incarnations = self._tokens.setdefault(agent, set())
        if live:
            incarnations.add(int(text))
        else:
            incarnations.discard(int(text))
        if agent == self.agent:
            incarnations.discard(self.incarnation)
            if live and incarnations and self._state == "open":
                self._router.drop("duplicate", f"another agent {agent!r} of team {self.team!r} is live")
        if not incarnations:
            del self._tokens[agent]
        self._look()

    def _look(self) -> None:
        if self._state == "open":
            seen = {agent: max(incarnations) for agent, incarnations in self._tokens.items()}
            self._router.see({**seen, self.agent: self.incarnation})

    def _who(self, _: bytes) -> bytes:
        own = {self.agent: [self.incarnation]} if self._state == "open" else {}
        return msgspec.msgpack.encode({**{agent: sorted(seen) for agent, seen in self._tokens.items()}, **own})

    # Supervision

    def supervise(self, failed: Callable[[BaseException], None], report: Callable[[str, str], None]) -> None:
        """Report failures and dropped messages to these."""
        self._router.supervise(failed, report)

    def refuse(self, sender: str, reason: str) -> None:
        """Take note of a message that a handler did not take."""
        self._router.refuse(sender, "incredible", reason)

    def statistics(self) -> TransportStatistics:
        """Return the counts so far."""
        return self._router.statistics()

    def _call_later(self, seconds: float, callback: Callable[[], None]) -> None:
        asyncio.get_running_loop().call_later(seconds, callback)


def import_zenoh() -> Any:
    """Return the package that carries the messages.

    Raises:
        Error: If it is not installed.
    """
    try:
        import zenoh  # noqa: PLC0415 - an extra
        import zenoh.handlers  # noqa: PLC0415
    except ImportError:
        raise Error(
            "processes of a team talk through Zenoh, which is not installed: pip install 'markov-decision-making[team]'"
        ) from None
    return zenoh


def _decode(answer: bytes) -> dict[str, list[int]]:
    try:
        return msgspec.msgpack.decode(answer, type=dict[str, list[int]])
    except UNREADABLE:
        return {}


def _lay_over(base: dict[str, Any], more: Mapping[str, Any]) -> None:
    for name, value in more.items():
        if isinstance(value, dict) and isinstance(base.get(name), dict):
            _lay_over(base[name], value)
        else:
            base[name] = value


def _tell_loop(error: BaseException) -> None:
    asyncio.get_running_loop().call_exception_handler(
        {"message": "a handler of a team's messages failed", "exception": error}
    )
