"""The wire over the user's rclpy: one node, in a context and on a thread of its own.

All of the node's life is on that thread. The event loop sends at once, and gets all answers handed. An action is its
three services and two topics here: rclpy's own client of actions can lose an answer that comes early.
"""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections import deque
from contextlib import ExitStack, suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from mdm.ros2.messages import fields, filled, interface, make
from mdm.ros2.wire import Peer, Quality, Role, WireError, check_name, check_node, report
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mdm.runtime import Runtime

_DOMAINS = 232
"""The last domain: with a greater one Fast DDS ends the process."""
_PATIENCE = 8.0
"""Seconds in which the node begins, and in which it ends where it could not."""
_LOOK = 5.0
"""Seconds between two looks at the types of publishers."""


class RclpyWire:
    """A `mdm.ros2.wire.Wire` over rclpy, with one node.

    Domain, discovery and middleware are those of the environment. It leaves signals, parameters and rclpy's log alone.

    Args:
        node: The node's name.
        namespace: Its namespace, such as ``/robot1``.
        remap: By name of a topic, service or action, the one that is used in its place.

    Raises:
        WireError: If rclpy is not there, the domain is none, or a name is none of ROS 2.

    Attributes:
        node: The node of rclpy; None unless the wire is open.
    """

    def __init__(self, node: str, namespace: str = "", remap: Mapping[str, str] | None = None) -> None:
        self._name, self._namespace, self._remap = node, f"/{namespace.strip('/')}", dict(remap or {})
        check_node(node, namespace, self._remap)
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        if not domain.isdecimal() or int(domain) > _DOMAINS:
            raise WireError(f"ROS_DOMAIN_ID is a whole number from 0 to {_DOMAINS}, not {domain!r}")
        try:
            self.rclpy: Any = import_module("rclpy")
            import_module("rclpy.node")  # and the modules that it needs
        except Exception as error:
            raise WireError(
                f"rclpy cannot be imported ({error}): it comes with ROS 2, so source the setup of your distribution "
                "(source /opt/ros/kilted/setup.bash), and run mdm with the Python for which that is built"
            ) from error
        self.node: Any = None
        self._makers: list[Callable[[], object]] = []
        self._waiting: set[asyncio.Future[Any]] = set()
        self._told: dict[tuple[str, str], float] = {}
        self._kinds: dict[str, str] = {}
        self._others: set[tuple[str, Peer]] = set()

    make, fields = staticmethod(make), staticmethod(fields)

    def subscribe(self, topic: str, kind: str, hear: Callable[[Any], object], quality: Quality, /) -> None:
        """Hear each message of a topic, in the node's thread."""
        self.listen(topic, interface(kind, "msg"), hear, quality)
        self._kinds[topic] = kind

    def publish(self, topic: str, kind: str, quality: Quality, /) -> _Publisher:
        """Return a publisher on a topic."""
        return _Publisher(self, topic, interface(kind, "msg"), quality)

    def call(self, service: str, kind: str, /) -> _Client:
        """Return a client of a service."""
        return _Client(self, service, interface(kind, "srv"))

    def action(self, name: str, kind: str, /) -> _Goals:
        """Return a sender of goals to an action's server."""
        return _Goals(self, name, interface(kind, "action"))

    def serve(self, service: str, kind: str, answer: Callable[[Any], Any], /) -> None:
        """Answer a service on the event loop, by the default response where ``answer`` fails."""
        loaded = interface(kind, "srv")

        def respond(request: Any, response: Any, answered: Any) -> None:
            try:
                response = filled(loaded.Response, answer(request))
            finally:
                answered.set_result(response)
                if self.node is not None:
                    self.node.executor.wake()

        async def asked(request: Any, response: Any) -> Any:
            answered = self.rclpy.task.Future()
            self.hand(service, respond, request, response, answered)
            return await answered

        group = self.rclpy.callback_groups.ReentrantCallbackGroup()  # others are heard meanwhile
        self.prepare(service, lambda: self.node.create_service(loaded, service, asked, callback_group=group))

    def peers(self, role: Role, name: str, /) -> list[Peer]:
        """Return who else has this role for a topic, a service or an action; nobody while the wire is not open."""
        found: list[tuple[str, str, str, Quality | None]] = []
        if (node := self.node) is None:
            return []
        if role in {"publisher", "subscription"}:
            for at in getattr(node, f"get_{role}s_info_by_topic")(name):
                found += [(at.node_namespace, at.node_name, at.topic_type, _quality(at.qos_profile))]
        else:
            full = self.full(name, "send_goal") if role == "action" else node.resolve_service_name(name)
            for other, space in node.get_node_names_and_namespaces():
                with suppress(Exception):  # it has left meanwhile
                    served = dict(node.get_service_names_and_types_by_node(other, space)).get(full, ())
                    found += [(space, other, kind.removesuffix("_SendGoal"), None) for kind in served]
        peers = [Peer(f"{space.rstrip('/')}/{other}", kind, quality) for space, other, kind, quality in found]
        return [peer for peer in peers if peer.node != node.get_fully_qualified_name()]

    async def open(self, runtime: Runtime) -> None:
        """Make the node and all that was asked for, and begin to hear; a `WireError` if that fails or takes long."""
        self._runtime, self._loop = runtime, asyncio.get_running_loop()
        self._closing, self._ended = self.rclpy.task.Future(), self._loop.create_future()
        begun = self._loop.create_future()
        # A daemon, lest a callback that hangs keeps the process; `close` waits for its end.
        self._thread = threading.Thread(target=self._live, args=(begun,), name="mdm:ros2", daemon=True)
        self._thread.start()
        try:
            await asyncio.wait_for(begun, _PATIENCE)
        except BaseException as error:
            with suppress(TimeoutError):  # a thread that hangs is left
                await asyncio.wait_for(self.close(), _PATIENCE)
            if isinstance(error, TimeoutError):
                raise WireError(f"the node {self._name!r} has not begun within {_PATIENCE:g} s") from None
            raise

    async def close(self) -> None:
        """Give the node back and wait for its thread; whoever waits for an answer gets a `WireError`."""
        self.node = None
        self._closing.set_result(None)
        await self._ended
        self._thread.join()

    def prepare(self, name: str, create: Callable[[], object]) -> Callable[[], Any]:
        """Have something made when the node begins; return a function that returns it while the wire is open."""
        check_name(name)
        made: list[Any] = []
        self._makers.append(lambda: made.append(create()))

        def get() -> Any:
            if self.node is None:
                raise WireError(f"{name} cannot be reached: the link to ROS 2 is not open")
            return made[-1]  # of the last time that it was opened

        return get

    def listen(self, name: str, kind: Any, hear: Callable[[Any], object], quality: Quality, part: str = "") -> None:
        """Subscribe to a topic, or to one that is part of an action."""

        def heard(message: Any) -> None:
            try:
                hear(message)
                time.sleep(0)  # lets the event loop go on now: else it waits .15 ms for what rclpy does next
            except Exception as error:
                self.report(name, "exception", describe(error))

        def create() -> object:
            options = self.options(quality, name, "Subscription", "a publisher offers")
            return self.node.create_subscription(kind, self.full(name, part), heard, **options)

        self.prepare(name, create)

    def resolve(self, name: str) -> str:
        """Return a name as ROS has it: from the root, and remapped; as it is where the wire is not open."""
        return name if self.node is None else self.node.resolve_topic_name(name)

    def full(self, name: str, part: str) -> str:
        """Return the name of a part of an action, which rclpy would not remap."""
        return f"{self.resolve(name)}/_action/{part}" if part else name

    def options(self, quality: Quality, name: str, side: str, who: str) -> dict[str, Any]:
        """Return a quality of service as rclpy has it, and the callbacks that report a side to which nothing passes."""
        qos = self.rclpy.qos

        def misfit(event: Any) -> None:
            policy = qos.qos_policy_name_from_kind(event.last_policy_kind).lower()
            self.report(name, "quality", f"{who} another {policy} than this side has, so that no message passes")

        reliability = qos.ReliabilityPolicy[quality.reliability.upper()]
        durability = qos.DurabilityPolicy[quality.durability.upper()]
        profile = qos.QoSProfile(depth=quality.depth, reliability=reliability, durability=durability)
        events = getattr(self.rclpy.event_handler, f"{side}EventCallbacks")(incompatible_qos=misfit)
        return {"qos_profile": profile, "event_callbacks": events}

    def hand(self, name: str, call: Callable[..., object], *arguments: Any) -> None:
        """Call a function on the event loop, from any thread; its error is a fault. After the end nothing is called."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._guarded, name, call, *arguments)

    def _guarded(self, name: str, call: Callable[..., object], *arguments: Any) -> None:
        try:
            call(*arguments)
        except Exception as error:
            self.report(name, "exception", describe(error))

    def report(self, name: str, kind: str, detail: str) -> None:
        """Publish a fault of a topic, service or action, from any thread; in a second the first of a kind."""
        now = time.monotonic()
        if now >= self._told.get((name, kind), now):
            self._told[name, kind] = now + 1
            report(self._runtime, name, kind, detail)

    def expect(self) -> asyncio.Future[Any]:
        """Return a future for an answer, which fails where the wire ends before."""
        answer = self._loop.create_future()
        self._waiting.add(answer)
        answer.add_done_callback(self._waiting.discard)
        return answer

    def _live(self, begun: asyncio.Future[None]) -> None:
        """Make the node and spin it until the wire closes, then give all back."""
        rclpy, undo = self.rclpy, ExitStack()
        try:
            undo.callback((context := rclpy.context.Context()).try_shutdown)
            context.init(args=[], initialize_logging=False)  # signal handlers are of rclpy.init alone
            rules = [part for old, new in self._remap.items() for part in ("-r", f"{old}:={new}")]
            own = {"context": context, "namespace": self._namespace, "cli_args": ["--ros-args", *rules]}
            off = dict.fromkeys(("use_global_arguments", "enable_rosout", "start_parameter_services"), False)
            self.node = node = rclpy.node.Node(self._name, **own, **off)
            undo.callback(node.destroy_node)
            undo.callback((executor := rclpy.executors.SingleThreadedExecutor(context=context)).shutdown)
            executor.add_node(node)
            for create in self._makers:
                create()
            node.create_timer(_LOOK, self._look)
            self.hand(self._name, _settle, begun, None)
            while not self._closing.done() and context.ok():  # a shutdown between two turns ends the spin untold
                try:
                    executor.spin_until_future_complete(self._closing)
                except rclpy.executors.ExternalShutdownException:
                    break
                except Exception as error:
                    self.report(self._name, "exception", describe(error))
                    time.sleep(0.01)  # where it comes again at once, the event loop has its time
            if not self._closing.done():
                self.node = None  # before it is told: nobody asks it from then on
                self.report(self._name, "exception", "the program has shut rclpy down: nothing comes any more")
        except Exception as error:
            self.hand(self._name, _settle, begun, WireError(f"the node {self._name!r} cannot begin: {error}"))
        finally:
            self.node = None
            with suppress(Exception):  # of a node that is gone already
                undo.close()
            self.hand(self._name, self._end)

    def _look(self) -> None:
        """Report publishers of other types, of which Fast DDS says nothing."""
        found = {(topic, peer) for topic in self._kinds for peer in self.peers("publisher", topic)}
        for topic, peer in found - self._others:
            if peer.kind != self._kinds[topic]:
                text = f"{peer.node} publishes {peer.kind}, and this side hears {self._kinds[topic]} alone"
                self.report(topic, "quality", text)
        self._others |= found

    def _end(self) -> None:
        """Tell all who wait that the thread has ended."""
        for answer in tuple(self._waiting):
            _settle(answer, WireError("the link to ROS 2 has ended"))
            answer.exception()  # which may be nobody's concern
        _settle(self._ended, None)


class _Publisher:
    """Publishes on a topic."""

    def __init__(self, wire: RclpyWire, topic: str, kind: Any, quality: Quality) -> None:
        def create() -> object:
            options = wire.options(quality, topic, "Publisher", "a subscription wants")
            return wire.node.create_publisher(kind, topic, **options)

        self._wire, self._kind, self._made = wire, kind, wire.prepare(topic, create)

    def __call__(self, message: Any, /) -> None:
        self._made().publish(filled(self._kind, message))

    @property
    def ready(self) -> bool:
        return self._wire.node is not None and self._made().get_subscription_count() > 0


class _Client:
    """Calls a service, or one that is part of an action."""

    def __init__(self, wire: RclpyWire, service: str, kind: Any, part: str = "") -> None:
        self._wire, self._service, self._kind = wire, service, kind
        self._made = wire.prepare(service, lambda: wire.node.create_client(kind, wire.full(service, part)))

    @property
    def ready(self) -> bool:
        return self._wire.node is not None and self._made().service_is_ready()

    def __call__(self, request: Any, /) -> asyncio.Future[Any]:
        return self.ask(filled(self._kind.Request, request))

    def ask(self, request: Any) -> asyncio.Future[Any]:
        """Send a request that was checked."""
        made, answer = self._made(), self._wire.expect()
        asked = made.call_async(request)
        answer.add_done_callback(lambda _: made.remove_pending_request(asked))
        asked.add_done_callback(lambda asked: self._wire.hand(self._service, _settle, answer, asked.result()))
        return answer


class _Goals:
    """Sends goals to an action's server."""

    def __init__(self, wire: RclpyWire, name: str, action: Any) -> None:
        self.wire, self.name, self.action = wire, name, action
        self.parts = parts = action.Impl
        self.sends = _Client(wire, name, parts.SendGoalService, "send_goal")
        self.results = _Client(wire, name, parts.GetResultService, "get_result")
        self.cancels = _Client(wire, name, parts.CancelGoalService, "cancel_goal")
        self.live: dict[bytes, _Goal] = {}
        wire.listen(name, parts.FeedbackMessage, self._feedback, Quality(reliability="reliable"), "feedback")
        wire.listen(name, parts.GoalStatusMessage, self._status, Quality(1, "reliable", "transient_local"), "status")

    @property
    def ready(self) -> bool:
        return self.sends.ready and self.results.ready and self.cancels.ready

    def send(self, goal: Any, feedback: Callable[[Any], object], status: Callable[[int], object], /) -> _Goal:
        return _Goal(self, goal, feedback, status)

    def _feedback(self, message: Any) -> None:
        if goal := self.live.get(bytes(message.goal_id.uuid)):
            goal.feed(message.feedback)

    def _status(self, message: Any) -> None:
        for each in message.status_list:
            if goal := self.live.get(bytes(each.goal_info.goal_id.uuid)):
                self.wire.hand(self.name, goal.tell, each.status)


class _Goal:
    """A goal that was sent."""

    def __init__(
        self, goals: _Goals, goal: Any, feedback: Callable[[Any], object], status: Callable[[int], object]
    ) -> None:
        self._goals, self._feedback, self._status = goals, feedback, status
        self._newest: deque[Any] = deque(maxlen=1)
        self._handed = False
        request, key = goals.parts.SendGoalService.Request(goal=filled(goals.action.Goal, goal)), uuid4().bytes
        request.goal_id.uuid = list(key)
        self._identity, self._answer = request.goal_id, goals.sends.ask(request)
        goals.live[key] = self
        self._result = asyncio.ensure_future(self._follow())
        self._result.add_done_callback(lambda ended: goals.live.pop(key) and (ended.cancelled() or ended.exception()))

    async def _follow(self) -> Any:
        service = self._goals.parts.GetResultService
        if await self.accepted():
            return await self._goals.results.ask(service.Request(goal_id=self._identity))
        return service.Response()

    async def accepted(self) -> bool:
        return bool((await asyncio.shield(self._answer)).accepted)

    async def end(self) -> tuple[int, Any]:
        ended = await asyncio.shield(self._result)
        return ended.status, ended.result

    async def cancel(self) -> int:
        request = self._goals.parts.CancelGoalService.Request()
        request.goal_info.goal_id = self._identity
        answered = await self._goals.cancels.ask(request)
        return answered.return_code or int(not answered.goals_canceling)  # rclpy's servers refuse by an empty list

    def feed(self, message: Any) -> None:
        """Have the newest feedback taken, from the node's thread."""
        self._newest.append(message)
        if not self._handed:
            self._handed = True
            self._goals.wire.hand(self._goals.name, self._fed)

    def _fed(self) -> None:
        self._handed = False  # before it is taken: one that comes meanwhile is handed again
        if self._newest:
            self._feedback(self._newest.pop())

    def tell(self, code: int) -> None:
        """Hear a status, which says that it is accepted where the answer was lost, as of a server that just began."""
        _settle(self._answer, self._goals.parts.SendGoalService.Response(accepted=True))
        self._status(code)


def _quality(profile: Any) -> Quality:
    """Return a quality of service of rclpy; ROS' graph may not know its depth, and best effort keeps for nobody."""
    reliability: Any = profile.reliability.name.lower()
    durability: Any = profile.durability.name.lower() if reliability == "reliable" else "volatile"
    return Quality(depth=max(profile.depth, 1), reliability=reliability, durability=durability)


def _settle(future: asyncio.Future[Any], outcome: Any) -> None:
    """Give a future its result, or its error, unless it has one."""
    if not future.done():
        (future.set_exception if isinstance(outcome, Exception) else future.set_result)(outcome)
