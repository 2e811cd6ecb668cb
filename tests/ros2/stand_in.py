"""A wire in plain Python for virtual time, and servers of actions whose tests decide how they behave."""

from __future__ import annotations

import asyncio
import inspect
import re
from collections import defaultdict
from types import SimpleNamespace

from mdm.ros2.wire import ABORTED, CANCELED, ENDED, SUCCEEDED, UNKNOWN, Quality, WireError

ACCEPTED, EXECUTING, CANCELING = 1, 2, 3

TYPES = {
    "builtin_interfaces/msg/Time": {"sec": "int32", "nanosec": "uint32"},
    "std_msgs/msg/Header": {"stamp": "builtin_interfaces/Time", "frame_id": "string"},
    "std_msgs/msg/Bool": {"data": "boolean"},
    "std_msgs/msg/Float64": {"data": "double"},
    "std_msgs/msg/String": {"data": "string"},
    "std_srvs/srv/Empty": {},
    "std_srvs/srv/SetBool": {"data": "boolean"},
    "std_srvs/srv/SetBool_Response": {"success": "boolean", "message": "string"},
    "std_srvs/srv/Trigger": {},
    "std_srvs/srv/Trigger_Response": {"success": "boolean", "message": "string"},
    "geometry_msgs/msg/Point": {"x": "double", "y": "double", "z": "double"},
    "geometry_msgs/msg/Vector3": {"x": "double", "y": "double", "z": "double"},
    "geometry_msgs/msg/Quaternion": {"x": "double", "y": "double", "z": "double", "w": "double"},
    "geometry_msgs/msg/Pose": {"position": "geometry_msgs/Point", "orientation": "geometry_msgs/Quaternion"},
    "geometry_msgs/msg/PoseStamped": {"header": "std_msgs/Header", "pose": "geometry_msgs/Pose"},
    "geometry_msgs/msg/PoseWithCovariance": {"pose": "geometry_msgs/Pose", "covariance": "double[36]"},
    "geometry_msgs/msg/PoseWithCovarianceStamped": {
        "header": "std_msgs/Header",
        "pose": "geometry_msgs/PoseWithCovariance",
    },
    "geometry_msgs/msg/Twist": {"linear": "geometry_msgs/Vector3", "angular": "geometry_msgs/Vector3"},
    "geometry_msgs/msg/TwistWithCovariance": {"twist": "geometry_msgs/Twist", "covariance": "double[36]"},
    "nav_msgs/msg/Odometry": {
        "header": "std_msgs/Header",
        "child_frame_id": "string",
        "pose": "geometry_msgs/PoseWithCovariance",
        "twist": "geometry_msgs/TwistWithCovariance",
    },
    "sensor_msgs/msg/BatteryState": {
        "header": "std_msgs/Header",
        "voltage": "float",
        "percentage": "float",
        "present": "boolean",
        "cell_voltage": "sequence<float>",
    },
    "sensor_msgs/msg/LaserScan": {
        "header": "std_msgs/Header",
        "range_min": "float",
        "range_max": "float",
        "ranges": "sequence<float>",
    },
    "diagnostic_msgs/msg/KeyValue": {"key": "string", "value": "string"},
    "diagnostic_msgs/msg/DiagnosticStatus": {
        "level": "octet",
        "name": "string",
        "message": "string",
        "hardware_id": "string",
        "values": "sequence<diagnostic_msgs/KeyValue>",
    },
    "diagnostic_msgs/msg/DiagnosticArray": {
        "header": "std_msgs/Header",
        "status": "sequence<diagnostic_msgs/DiagnosticStatus>",
    },
    "nav2_msgs/action/DockRobot": {"dock_id": "string", "max_staging_time": "float"},
    "nav2_msgs/action/DockRobot_Feedback": {"count": "int32"},
    "nav2_msgs/action/NavigateToPose": {"pose": "geometry_msgs/PoseStamped", "behavior_tree": "string"},
    "test_msgs/action/Fibonacci": {"order": "int32"},
}
"""The fields of the types that there are, with their types; a test may add its own. An action's are its goal's."""

_PLAIN = {"boolean": bool, "float": float, "double": float, "string": str, "octet": bytes}


class StandIn:
    """A `mdm.ros2.wire.Wire`: topics, services and actions by name, whose other side is the test.

    Attributes:
        subscribed: By topic, its type, who hears it, and its quality; `send` calls them.
        published: By topic, the time in seconds and the message of each that was published.
        subscribers: By topic, how many hear what is published: 1 where nothing else is said.
        services: By service, a function (or async function) from request to response: the test's; absent: no server.
        served: By service, its type and our function; `ask` calls it.
        servers: By action, its `Server`; absent: no server.
        graph: By role and name, the `mdm.ros2.wire.Peer`s in the graph.
        opened, closed: Whether it was.
    """

    def __init__(self, types=TYPES):
        self.types = dict(types)
        self.subscribed = defaultdict(list)
        self.published = defaultdict(list)
        self.publishers = {}
        self.subscribers = defaultdict(lambda: 1)
        self.services = {}
        self.clients = {}
        self.served = {}
        self.servers = {}
        self.actions = {}
        self.graph = {}
        self.opened = self.closed = False

    # -- What a test calls ---------------------------------------------------------------------------------------

    def send(self, topic, **fields):
        """Send a message with these fields on a topic that is subscribed to."""
        for kind, hear, _ in self.subscribed[topic]:
            hear(self.make(kind, fields))

    async def ask(self, service, **fields):
        """Return the response to a request of a service that is served."""
        kind, answer = self.served[service]
        response = answer(self.make(kind, fields))
        return await response if inspect.isawaitable(response) else response

    # -- The wire ------------------------------------------------------------------------------------------------

    def make(self, kind, fields=()):
        """Return a message with these fields; the others are zeros."""
        types = self.fields(kind)
        unknown = [name for name in fields if name not in types]
        if unknown:
            raise WireError(f"{kind} has no field {unknown[0]!r}; there are {', '.join(types)}")
        made = {name: self._value(kind, name, its) for name, its in types.items()}
        made.update({name: self._value(kind, name, types[name], value) for name, value in dict(fields).items()})
        return SimpleNamespace(**made)

    def fields(self, kind):
        """Return the type of each field."""
        if kind not in self.types:
            raise WireError(f"there is no type {kind!r}")
        return self.types[kind]

    def _value(self, kind, name, its, value=None):
        sequence = re.fullmatch(r"sequence<(.*)>|(.*)\[(\d+)\]", its)
        if sequence is not None:
            element, other, length = sequence.groups()
            if value is None:
                return [self._value(kind, name, other) for _ in range(int(length or 0))]
            if not isinstance(value, (list, tuple)) or (length is not None and len(value) != int(length)):
                raise WireError(f"{kind}: {name} is {its}, not {value!r}")
            return [self._value(kind, name, element or other, each) for each in value]
        if "/" in its:
            if isinstance(value, SimpleNamespace):
                return value
            if value is not None and not isinstance(value, dict):
                raise WireError(f"{kind}: {name} is {its}, not {value!r}")
            return self.make(its.replace("/", "/msg/"), value or {})
        plain = _PLAIN.get(its, int)
        if value is None:
            return b"\0" if plain is bytes else plain()
        fits = type(value) in {int, float} if plain is float else type(value) is plain
        if not fits:
            raise WireError(f"{kind}: {name} is {its}, not {value!r}")
        return plain(value)

    def subscribe(self, topic, kind, hear, quality):
        self.fields(kind)
        assert isinstance(quality, Quality)
        self.subscribed[topic].append((kind, hear, quality))

    def publish(self, topic, kind, quality):
        self.fields(kind)
        assert isinstance(quality, Quality)
        return self.publishers.setdefault(topic, _Publisher(self, topic, kind, quality))

    def call(self, service, kind):
        self.fields(kind)
        return self.clients.setdefault(service, _Client(self, service, kind))

    def action(self, name, kind):
        self.fields(kind)
        return self.actions.setdefault(name, _Goals(self, name, kind))

    def serve(self, service, kind, answer):
        self.fields(kind)
        self.served[service] = kind, answer

    def peers(self, role, name):
        return self.graph.get((role, name), ())

    async def open(self, runtime):
        self.runtime = runtime
        self.opened = True

    async def close(self):
        self.closed = True


class _Publisher:
    def __init__(self, wire, topic, kind, quality):
        self.wire, self.topic, self.kind, self.quality = wire, topic, kind, quality

    def __call__(self, message):
        self.wire.published[self.topic].append((asyncio.get_running_loop().time(), message))

    @property
    def ready(self):
        return bool(self.wire.subscribers[self.topic])


class _Client:
    def __init__(self, wire, service, kind):
        self.wire, self.service, self.kind = wire, service, kind

    @property
    def ready(self):
        return self.service in self.wire.services

    async def __call__(self, request):
        if not self.ready:
            await asyncio.get_running_loop().create_future()  # as rclpy, whose request is lost
        response = self.wire.services[self.service](request)
        return await response if inspect.isawaitable(response) else response


# -- Actions -----------------------------------------------------------------------------------------------------


class Behaviour(SimpleNamespace):
    """What a server does with one goal; times in seconds.

    Attributes:
        accepts: Whether it accepts it.
        answers: After which time it answers.
        takes: After which time from then it ends by itself; None: when the test says so.
        ends: By which status it then ends, and the result's fields.
        feeds: How often it gives feedback, with the field ``count``; None: never.
        brakes: After which time a goal that is cancelled ends; None: a cancellation is ignored.
        cancelled: By which status it then ends: 5, or 4, or 6.
        mute: Whether its answer, feedback and statuses are lost on the way.
    """

    def __init__(self, **given):
        defaults = {
            "accepts": True,
            "answers": 0.0,
            "takes": None,
            "ends": SUCCEEDED,
            "result": {},
            "feeds": None,
            "brakes": 0.0,
            "cancelled": CANCELED,
            "mute": False,
        }
        assert set(given) <= set(defaults), given
        super().__init__(**{**defaults, **given})


class Server:
    """A server of an action.

    Args:
        wire: The wire.
        name: The action's.
        replaces: Whether a goal that is accepted aborts the one before, as in Nav2.
        behaviour: The `Behaviour` of each goal, as keyword arguments.

    Attributes:
        goals: All that have reached it, in order.
        next: Behaviours of the next goals, which come first; then ``behaviour``.
        most: How many goals were live at once, at most.
        sent: All that were sent to it, in order.
        held: Whether it does nothing at the moment, as a stopped process; what comes waits until it wakes.
    """

    def __init__(self, wire, name, *, replaces=False, **behaviour):
        self.wire, self.name, self.replaces = wire, name, replaces
        self.behaviour = Behaviour(**behaviour)
        self.next = []
        self.goals = []
        self.sent = []
        self.most = 0
        self.held = False
        self.gone = False
        self._waiting = []
        wire.servers[name] = self

    @property
    def live(self):
        """The goals that it pursues."""
        return [goal for goal in self.goals if goal.live]

    def hold(self):
        """Do nothing from now on, until `wake`."""
        self.held = True

    def wake(self):
        """Go on with the old goals, and with all that has come meanwhile, in order."""
        self.held = False
        waiting, self._waiting = self._waiting, []
        for step, comes in waiting:
            self._do(step, comes=comes)

    def lose(self):
        """Lose what has come while it was held, as the middleware does that has given it up."""
        self._waiting = [each for each in self._waiting if not each[1]]

    def vanish(self):
        """End as a process that is killed: nothing is answered or ended any more."""
        self.gone = True

    def start_again(self):
        """Start as another process of the same name, which knows none of the old goals."""
        return Server(self.wire, self.name, replaces=self.replaces, **vars(self.behaviour))

    def after(self, seconds, step):
        """Do something later, unless held or gone by then."""
        asyncio.get_running_loop().call_later(seconds, self._do, step)

    def comes(self, step):
        """Do what comes from outside, in its turn."""
        asyncio.get_running_loop().call_soon(lambda: self._do(step, comes=True))

    def _do(self, step, *, comes=False):
        if self.gone:
            return
        if self.held:
            self._waiting.append((step, comes))
        else:
            step()

    def take(self, goal):
        """A goal comes in."""
        goal.behaviour = self.next.pop(0) if self.next else self.behaviour
        self.goals.append(goal)
        self.after(goal.behaviour.answers, lambda: self._answer(goal))

    def _answer(self, goal):
        behaviour = goal.behaviour
        goal.live = goal.accepted = behaviour.accepts
        if goal.live:
            self.most = max(self.most, len(self.live) - (self.replaces and len(self.live) > 1))
        if behaviour.mute:
            goal.mute()
            return
        goal.told = asyncio.get_running_loop().time()
        goal.answered.set_result(None)
        if not goal.live:
            return
        goal.tell(ACCEPTED)
        goal.tell(EXECUTING)
        if self.replaces:
            for other in self.live:
                if other is not goal:
                    other.end(ABORTED)
        if behaviour.takes is not None:
            self.after(behaviour.takes, lambda: goal.end(behaviour.ends, **behaviour.result))
        if behaviour.feeds is not None:
            self.after(behaviour.feeds, goal.feed_on)


class ServerGoal:
    """A goal, as its server has it.

    Attributes:
        message: The goal's.
        accepted: Whether it was; None before the answer.
        live: Whether it is pursued.
        cancels: How many cancellations have reached the server.
        sent, told: When it was sent, and when its server last told something of it.
        beside: Those that were sent before, and had not ended by then, with when each was last told of.
        status, result: How it has ended.
    """

    def __init__(self, server, message, feedback, status):
        loop = asyncio.get_running_loop()
        self.server, self.message = server, message
        self.accepted = self.status = self.result = None
        self.live = False
        self.cancels = self.fed = 0
        self.sent = self.told = loop.time()
        self.beside = [(goal, goal.told) for goal in server.sent if goal.live or goal.accepted is None]
        server.sent.append(self)
        self.answered, self.over = loop.create_future(), loop.create_future()
        self._feedback, self._status = feedback, status

    def mute(self):
        """Have nothing arrive of what is told."""
        self._status = self._feedback = lambda told: None

    def tell(self, status):
        """Tell a status."""
        self.told = asyncio.get_running_loop().time()
        self._status(status)

    def feed(self, **fields):
        """Give feedback."""
        if self.live and not (self.server.held or self.server.gone):
            self.told = asyncio.get_running_loop().time()
            self._feedback(SimpleNamespace(**fields))

    def feed_on(self):
        if self.live:
            self.fed += 1
            self.feed(count=self.fed)
            self.server.after(self.behaviour.feeds, self.feed_on)

    def end(self, status, **result):
        """End by a status, with a result."""
        if not self.live:
            return
        self.live = False
        self.status, self.result = status, SimpleNamespace(**result)
        self.tell(status)
        self.over.set_result((status, self.result))

    def cancel(self, answered):
        if self.accepted is None:
            code = UNKNOWN
        else:
            self.cancels += 1
            if self.live and self.behaviour.brakes is not None:
                self.tell(CANCELING)
                self.server.after(self.behaviour.brakes, lambda: self.end(self.behaviour.cancelled))
            code = ENDED if self.status is not None else 0 if self.behaviour.brakes is not None else 1
        if not answered.done():
            answered.set_result(code)


class _Goals:
    """As `mdm.ros2.wire.Goals`."""

    def __init__(self, wire, name, kind):
        self.wire, self.name, self.kind = wire, name, kind

    @property
    def ready(self):
        server = self.wire.servers.get(self.name)
        return server is not None and not server.gone

    def send(self, message, feedback, status):
        server = self.wire.servers[self.name]
        goal = ServerGoal(server, message, feedback, status)
        server.comes(lambda: server.take(goal))
        return _Goal(goal)


class _Goal:
    """As `mdm.ros2.wire.Goal`."""

    def __init__(self, goal):
        self._goal = goal

    async def accepted(self):
        await asyncio.shield(self._goal.answered)
        return self._goal.accepted

    def end(self):
        return asyncio.shield(self._goal.over)

    async def cancel(self):
        answered = asyncio.get_running_loop().create_future()
        goal = self._goal
        server = goal.server.wire.servers[goal.server.name]
        if server is goal.server:
            server.comes(lambda: goal.cancel(answered))
        else:
            server.comes(lambda: answered.done() or answered.set_result(UNKNOWN))
        return await answered
