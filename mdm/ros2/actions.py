"""Actions of a link: goals, calls of services, and messages on topics, each as a `Binding`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from copy import copy
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Unpack

from msgspec import Meta

from mdm.actors import Ensemble
from mdm.actors.actions.binding import Binding
from mdm.actors.options import BindingOptions, BindingSettings
from mdm.errors import ConfigError, Error as _Error
from mdm.messages import Action, Progress
from mdm.options import Seconds
from mdm.ros2.goals import Server, found, ready
from mdm.ros2.wire import Quality, report
from mdm.runtime.actor import descendants
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from mdm.actors import PredicateManager
    from mdm.ros2.wire import Handle, Wire
    from mdm.runtime import Runtime

Made = Mapping[str, Any] | Callable[..., Any] | None
"""A message: its fields, or a plain function that returns them or the message; it may take the `Action` message."""

_START = 5.0
"""Seconds after the start at which who is missing is told."""
_MEETING, _MEETS = 3.0, 0.5
"""Seconds for which a publisher and a subscription may take to meet, and for which one of them may not know it yet."""


class GoalTable(BindingSettings, frozen=True, kw_only=True):
    """An action of ROS in a file: the options of an action, see `BindingOptions`, and these.

    Attributes:
        action: Its name.
        type: Its type, such as ``nav2_msgs/action/DockRobot``.
        goal: The goal's fields, or the function ``module:name`` that returns them, which may take the `Action` message.
        feedback: The function ``module:name`` that hears it; a field, told as `Progress` on ``ros2/progress``; or a
            predicate with its condition, ``{ predicate = "IsNear", when = "distance < 1" }``.
        silence: Seconds without feedback or status after which it has failed. None by default: with a server that gives
            no feedback each goal would fail.
        group: Of goals of the same group the next is sent before the running one ends, which the server aborts for it.
        may_succeed: A goal that is reached when it was asked to end has succeeded, by default.
    """

    action: str
    type: str
    goal: dict[str, Any] | str | None = None
    feedback: dict[str, str] | str | None = None
    silence: Seconds | None = None
    group: str | None = None
    may_succeed: bool = True


class CallTable(BindingSettings, frozen=True, kw_only=True):
    """The call of a service in a file: the options of an action, see `BindingOptions`, and these.

    Attributes:
        service: Its name.
        type: Its type, such as ``std_srvs/srv/SetBool``.
        request: The request's fields, or the function ``module:name`` that returns them, as of a goal.
    """

    service: str
    type: str
    request: dict[str, Any] | str | None = None


class PublishTable(BindingSettings, frozen=True, kw_only=True):
    """A message on a topic in a file: the options of an action, see `BindingOptions`, and these.

    Attributes:
        publish: The topic.
        type: Its type, such as ``geometry_msgs/msg/Twist``.
        message: The message's fields, or the function ``module:name`` that returns them, as of a goal; else zeros.
        rate: How many times a second it is published; once by default.
        until: With a rate, the predicate that ends it when true, or the seconds after which it ends. Where nobody
            subscribes to the topic then, it waits 3 s for somebody, and publishes for half a second more, or fails. By
            default it goes on until it is cancelled.
        last: With a rate, the fields of one more message, published when it ends or is cancelled; none by default.
        qos: The quality of service.
    """

    publish: str
    type: str
    message: dict[str, Any] | str | None = None
    rate: Annotated[float, Meta(gt=0, le=1000)] | None = None
    until: str | Seconds | None = None
    last: dict[str, Any] | None = None
    qos: Quality = Quality(reliability="reliable")


class Actions:
    """Makes actions over a wire, before that opens.

    A wrong option is a `ConfigError`, a wrong name, type or field a `WireError`. Where its server is not there, an
    action waits within its ``timeout``, and says so.

    Args:
        wire: The wire.
        predicates: Those that may end what is published at a rate.

    Example::

        actions = {"Dock": link.actions.goal("/dock", "nav2_msgs/action/DockRobot", goal={"dock_id": "home"})}
    """

    def __init__(self, wire: Wire, predicates: PredicateManager | None = None) -> None:
        self.wire = wire
        self._predicates = predicates
        self._servers: dict[str, Server] = {}
        self._handles: dict[str, Handle] = {}

    async def open(self, runtime: Runtime) -> None:
        """Begin; who is not there some seconds later is told."""
        self._runtime = runtime
        self._look = asyncio.get_running_loop().call_later(_START, self._report_missing)

    async def close(self) -> None:
        """End; goals whose end was not heard are left."""
        self._look.cancel()
        for server in self._servers.values():
            server.close()

    def goal(
        self,
        name: str,
        kind: str,
        *,
        goal: Made = None,
        feedback: Callable[[Any], object] | str | None = None,
        silence: float | None = None,
        **options: Unpack[BindingOptions],
    ) -> Binding:
        """Return the action that has a server pursue a goal; see `GoalTable`.

        A ``feedback`` with a method ``begin``, such as a `Condition` has, is told by it of each new goal.
        """
        GoalTable(action=name, type=kind, silence=silence)
        server, make, hear = self.server(name, kind), self._maker(kind, goal), self._hearer(name, feedback)
        options.setdefault("may_succeed", True)
        group, begin = options.get("group"), getattr(feedback, "begin", lambda: None)

        def within(ensemble: Ensemble | None) -> Callable[[Action], Any]:
            secured = partial(self.secured, ensemble)

            async def pursue(action: Action) -> None:
                begin()
                await server.pursue(make(action), hear, silence, group, secured, secures=action.epoch < 0)

            return _named(pursue, name)

        bound = _Goal(within(None), **options)
        bound.of = within
        if silence is not None:
            bound.note = (
                f"fails {silence:g} s after the last feedback or status: leave its silence out where none comes"
            )
        return bound

    def call(self, name: str, kind: str, *, request: Made = None, **options: Unpack[BindingOptions]) -> Binding:
        """Return the action that calls a service; ``success = false`` in the response fails; see `CallTable`."""
        client, make = self.wire.call(name, kind), self._maker(kind, request)
        self._handles[name] = client

        async def call(action: Action) -> None:
            message = make(action)
            await found(client, name, partial(self.report, name))
            response = await client(message)
            if not getattr(response, "success", True):
                raise _Error(f"the service {name} answered without success: {getattr(response, 'message', '')!r}")

        return Binding(_named(call, name), **options)

    def publish(
        self,
        name: str,
        kind: str,
        *,
        message: Made = None,
        rate: float | None = None,
        until: str | float | None = None,
        last: Mapping[str, Any] | None = None,
        qos: Quality | None = None,
        **options: Unpack[BindingOptions],
    ) -> Binding:
        """Return the action that publishes a message, once or at a rate; see `PublishTable`."""
        table = PublishTable(publish=name, type=kind, rate=rate, until=until)
        publisher, make = self.wire.publish(name, kind, qos or table.qos), self._maker(kind, message)
        self._handles[name] = publisher
        if rate is None:
            if given := [option for option, value in (("until", until), ("last", last)) if value is not None]:
                raise ConfigError(f"{given[0]!r} is for what is published at a 'rate'", key=given[0])
            return Binding(_named(lambda action: publisher(make(action)), name), **options)
        period, over = 1 / rate, self._ender(until)
        end = None if last is None else self.wire.make(kind, last)

        async def publish(action: Action) -> None:
            made, loop = make(action), asyncio.get_running_loop()
            begin = due = loop.time()
            try:
                while due == begin or not over(loop.time() - begin):
                    publisher(made)
                    due = due + period if due + period > loop.time() else loop.time() + period  # no burst after a delay
                    await asyncio.sleep(due - loop.time())
                if not publisher.ready:
                    if not await ready(publisher, _MEETING):
                        raise _Error(f"nobody has heard it: there is no subscription of {name}")
                    for _ in range(1 + int(_MEETS * rate)):
                        publisher(made)
                        await asyncio.sleep(period)
            finally:
                if end is not None:
                    publisher(end)

        return Binding(_named(publish, name), **options)

    def server(self, name: str, kind: str) -> Server:
        """Return the server of an action: one for all of its goals."""
        if name not in self._servers:
            goals = self._handles[name] = self.wire.action(name, kind)
            self._servers[name] = Server(name, goals, partial(self.report, name))
        return self._servers[name]

    def report(self, name: str, kind: str, detail: str) -> None:
        """Tell a fault of a topic, a service or an action."""
        report(self._runtime, name, kind, detail)

    def secured(self, ensemble: Ensemble | None) -> int:
        """Return how often the safe action has succeeded: of an ensemble and those above it, or without one of all."""
        actors = [each for each in descendants(self._runtime.root) if isinstance(each, Ensemble)]
        ours = [each for each in actors if ensemble is None or f"{ensemble.path}/".startswith(f"{each.path}/")]
        return sum(each.action.statistics().safe_ended.get("succeeded", 0) for each in ours)

    def _report_missing(self) -> None:
        for name, handle in self._handles.items():
            if not handle.ready:
                self.report(name, "unmatched", f"nobody is at {name} yet, {_START:g} s after the start")

    def _maker(self, kind: str, given: Made) -> Callable[[Action], Any]:
        if not callable(given):
            message = self.wire.make(kind, given or {})
            return lambda _: message
        asked = Binding(given)
        if not asked.plain:
            raise ConfigError(f"a message is returned by a plain function, not by {given!r}")

        def make(action: Action) -> Any:
            made = given(action) if asked.takes_action else given()
            return self.wire.make(kind, made) if isinstance(made, Mapping) else made

        return make

    def _hearer(self, name: str, feedback: Callable[[Any], object] | str | None) -> Callable[[Any], None]:
        failed = False

        def hear(message: Any) -> None:
            nonlocal failed
            try:
                if callable(feedback):
                    feedback(message)
                elif feedback is not None:
                    progress = Progress(self._runtime.now(), name, float(getattr(message, feedback)))
                    self._runtime.channel("ros2/progress", Progress).publish(progress)
            except Exception as error:
                if not failed:
                    self.report(name, "exception", f"the feedback cannot be taken: {describe(error)}")
                failed = True

        return hear

    def _ender(self, until: str | float | None) -> Callable[[float], bool]:
        if not isinstance(until, str):
            return lambda seconds: until is not None and seconds >= until - 1e-9
        predicates, name = self._predicates, until
        if predicates is None or predicates.declared.knows(name) != "predicate":
            raise ConfigError(f"there is no predicate {name!r} that would end it", key="until")
        return lambda _: predicates.value(name) is True


class _Goal(Binding):
    """The action of a goal: a function of its ensemble, which says whether the safe action has run."""

    __slots__ = ("of",)
    of: Callable[[Ensemble], Callable[[Action], Any]]

    def within(self, ensemble: Ensemble) -> Binding:
        """Return the goal as an action of an ensemble."""
        own = copy(self)
        own.function = self.of(ensemble)
        return own


def _named(function: Callable[[Action], Any], name: str) -> Callable[[Action], Any]:
    """Give an action the name by which it is listed."""
    function.__name__, function.__qualname__ = name, f"ros2({name!r})"
    return function
