"""The table ``ros2`` of a file, and the entries of its other tables that are of topics, actions and services."""

from __future__ import annotations

import asyncio
import re
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

import msgspec
from msgspec import Meta

from mdm.actors import Binding
from mdm.actors.options import BindingSettings
from mdm.config import TableReader
from mdm.config.functions import Lasting, nothing
from mdm.errors import ConfigError, Error
from mdm.options import Options, Seconds
from mdm.ros2.actions import Actions, CallTable, GoalTable, PublishTable
from mdm.ros2.conditions import Condition
from mdm.ros2.inputs import PoseKind
from mdm.ros2.link import Link
from mdm.ros2.navigator import GoalNavigator, NavigatorTable
from mdm.ros2.rclpy_wire import RclpyWire
from mdm.ros2.reports import SERVICES, Reports
from mdm.ros2.wire import Quality, check_name, check_node, near, parts_of
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from mdm.config import Reading
    from mdm.maps import Places
    from mdm.ros2.inputs import Topic
    from mdm.ros2.wire import Wire
    from mdm.runtime import Extension

_FUNCTION = re.compile(r"[\w.]+:[\w.]+")
_WHOLES = {"topic": "msg", "publish": "msg", "service": "srv", "action": "action"}
"""By the key that names it, the folder of its type."""
_ACTIONS: Final = {
    "action": (GoalTable, "goal", "goal"),
    "service": (CallTable, "call", "request"),
    "publish": (PublishTable, "publish", "message"),
}
"""By the key that an action has: its table, the method of `Actions` that makes it, and the key of its message."""


class Ros2Table(Options, frozen=True, kw_only=True):
    """How the robot is a node of ROS 2.

    Attributes:
        node: Its name.
        namespace: Its namespace, such as ``/robot1``; in a team's file it may be a table with one for each agent.
        remap: Names of topics, services and actions, by others that stand for them.
        services: Whether ``~/start``, ``~/stop``, ``~/reset`` and ``~/release`` are served, or which of them.
        diagnostics: Whether ``/diagnostics`` are published.
        decisions: Whether ``~/decisions`` and ``~/modes`` are, as JSON.
        wire: A function or class ``module:name`` that makes another wire than that over rclpy, of the arguments
            ``node``, ``namespace`` and ``remap``.
    """

    node: str = "mdm"
    namespace: str | dict[str, str] = ""
    remap: dict[str, str] = msgspec.field(default_factory=dict)
    services: bool | list[Literal["start", "stop", "reset", "release"]] = False
    diagnostics: bool = True
    decisions: bool = False
    wire: str | None = None


class TopicTable(Options, frozen=True, kw_only=True):
    """A topic.

    Attributes:
        topic: Its name.
        type: The type of its messages, such as ``std_msgs/msg/Bool``.
        qos: Its quality of service; a topic has one, whoever uses it.
    """

    topic: str
    type: str
    qos: Quality | None = None


class TopicPredicateTable(TopicTable, frozen=True, kw_only=True):
    """A predicate that the newest message of a topic decides.

    Attributes:
        when: Whether a message says that it holds: a condition, or a function ``module:name`` of the message.
        max_age: Seconds after which it is unknown, from when the last message came.
    """

    when: str
    max_age: Seconds | None = None


class TopicEventTable(TopicTable, frozen=True, kw_only=True):
    """An event that each message of a topic raises.

    Attributes:
        when: Whether a message raises it, as of a predicate.
    """

    when: str | None = None


class PoseTable(TopicTable, frozen=True, kw_only=True):
    """The topic that tells where the robot is.

    Attributes:
        covariance: The greatest variance of its place that is taken, along any axis.
    """

    type: PoseKind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    covariance: Annotated[float, Meta(gt=0, extra={"unit": "square metres"})] = 0.5


class Ros2Reader(TableReader):
    """Makes the link of a file.

    Without functions, as for `mdm check` or a replay, and in virtual time, there is none: of types their form alone is
    checked, topics tell nothing, goals last until they are replaced, and the safe action ends at once.
    """

    entries: ClassVar[Mapping[str, frozenset[str]]] = {
        **dict.fromkeys(("predicates", "events", "pose"), frozenset({"topic"})),
        "actions": frozenset(_ACTIONS),
    }

    def __init__(self, value: Any, reading: Reading) -> None:
        self._reading = reading
        self._link: Link | None = None
        table: Ros2Table | None = reading.problems.convert(value, Ros2Table, "ros2")
        if table is not None:
            with reading.problems.collecting("ros2"):
                self._open(table)

    def _open(self, table: Ros2Table) -> None:
        share, functions, namespace = self._reading.share, self._reading.functions, table.namespace
        if isinstance(namespace, dict):
            if share is None:
                raise ConfigError("a namespace per agent is for a team's file, which has a table [team]")
            namespace = share.own(namespace) or ""
        check_node(table.node, namespace, table.remap)
        make: Any = self.wire if table.wire is None else functions.find(table.wire, "ros2.wire")
        if make is None or not functions.imported or (self._reading.virtual and table.wire is None):
            return
        try:
            wire = make(node=table.node, namespace=namespace, remap=table.remap)
        except Exception as error:
            raise error if isinstance(error, Error) else ConfigError(f"there is no wire: {describe(error)}") from error
        services = table.services if isinstance(table.services, list) else SERVICES if table.services else ()
        named = f"{namespace}/{table.node}".strip("/")
        told = Reports(wire, named, diagnostics=table.diagnostics, decisions=table.decisions, services=services)
        self._link = Link(wire, self._reading.predicates, told)

    def wire(self, node: str, namespace: str, remap: Mapping[str, str]) -> Wire:
        """Return the wire over rclpy; override this for another one."""
        return RclpyWire(node, namespace, remap)

    def extension(self) -> Extension | None:
        """Return the link."""
        return self._link

    def predicate(self, name: str, written: dict[str, Any], key: str) -> None:
        """Declare a predicate that a topic decides."""
        self._declare(name, self._entry(written, TopicPredicateTable, key), key)

    def event(self, name: str, written: dict[str, Any], key: str) -> None:
        """Declare an event that a topic raises."""
        self._declare(name, self._entry(written, TopicEventTable, key), key)

    def _declare(self, name: str, entry: Any, key: str) -> None:
        when: Any = None if entry is None or entry.when is None else self._when(entry.when, f"{key}.when")
        if entry is None or (when is None and entry.when is not None):
            return
        predicates = self._reading.predicates
        if isinstance(entry, TopicEventTable):
            predicates.event(name) if self._link is None else self._topic(entry).event(name, when)
        elif self._link is None:
            predicates.sensor(name, max_age=entry.max_age)
        else:
            self._topic(entry).predicate(name, when, entry.max_age)
        predicates.declared.tellers[name] = f"{entry.topic}: {entry.when or 'each message'}"

    def pose(self, written: dict[str, Any], places: Places, key: str) -> None:
        """Let a topic tell where the robot is."""
        entry = self._entry(written, PoseTable, key)
        if entry is not None and self._link is not None:
            self._topic(entry).pose(places, entry.covariance)

    def navigator(self, written: Any, key: str) -> GoalNavigator | None:
        """Return the navigator of a link."""
        table = self._entry(written, NavigatorTable, key)
        return None if table is None or self._link is None else GoalNavigator(self._link.actions, table)

    def action(self, written: dict[str, Any], key: str) -> Binding | None:
        """Return the binding of a goal, a call or a message."""
        role = next(name for name in written if name in _ACTIONS)
        kind, method, message = _ACTIONS[role]
        entry, before = self._entry(written, kind, key), len(self._reading.problems)
        if entry is None:
            return None
        given = msgspec.structs.asdict(entry)
        if isinstance(given[message], str):
            given[message] = self._reading.functions.find(given[message], f"{key}.{message}")
        if "feedback" in given:
            given["feedback"] = self._feedback(given["feedback"], f"{entry.type}_Feedback", f"{key}.feedback")
        if len(self._reading.problems) > before:
            return None
        if key.endswith("safe_action") and given.get("rate") is not None and given["until"] is None:
            raise ConfigError("a safe action has an end: give 'until', seconds or a predicate", key=f"{key}.until")
        actions = Actions(_Unchecked(), self._reading.predicates) if self._link is None else self._link.actions
        name = given.pop(role)
        bound: Binding = getattr(actions, method)(name, given.pop("type"), **given)
        if self._link is not None:
            return bound
        target: Any = partial(nothing) if role == "publish" and entry.rate is None else Lasting()
        if key.endswith("safe_action"):
            target = partial(asyncio.sleep, 0)
        target.__module__, target.__qualname__ = "mdm.ros2.actions", f"ros2({name!r})"
        stand_in = Binding(target, **entry.as_arguments(BindingSettings))
        stand_in.note = bound.note
        return stand_in

    def _topic(self, entry: TopicTable) -> Topic:
        assert self._link is not None
        return self._link.topic(entry.topic, entry.type, entry.qos)

    def _entry(self, written: Any, kind: Any, key: str) -> Any:
        """Return an entry as a struct; None where it has problems."""
        problems, before = self._reading.problems, len(self._reading.problems)
        if isinstance(written, dict) and isinstance(written.get("qos"), dict):
            problems.convert(written["qos"], Quality, f"{key}.qos")
        entry = problems.convert(written, kind, key) if len(problems) == before else None
        if entry is not None:
            role = next(role for role in _WHOLES if hasattr(entry, role))
            problems.attempt(f"{key}.{role}", check_name, getattr(entry, role))
            problems.attempt(f"{key}.type", parts_of, entry.type, _WHOLES[role])
        return entry if len(problems) == before else None

    def _when(self, text: str, key: str) -> Any:
        """Return a condition, or the function that is named; None where it is none."""
        if _FUNCTION.fullmatch(text):
            return self._reading.functions.find(text, key)
        return self._reading.problems.attempt(key, Condition, text)

    def _feedback(self, given: dict[str, str] | str | None, kind: str, key: str) -> Any:
        """Return who hears feedback: a function, a field by its name, or a predicate by a condition."""
        if isinstance(given, str) and _FUNCTION.fullmatch(given):
            return self._reading.functions.find(given, key)
        if not isinstance(given, dict):
            if given is not None and self._link is not None and given not in (known := self._link.wire.fields(kind)):
                raise ConfigError(f"{kind} has no {given!r}{near(given, known)}", key=key)
            return given
        if given.keys() != {"predicate", "when"}:
            raise ConfigError("feedback has the keys 'predicate' and 'when'", key=key)
        name, predicates, when = given["predicate"], self._reading.predicates, self._when(given["when"], f"{key}.when")
        predicates.declared.check_input(name, "predicate")
        if isinstance(when, Condition) and self._link is not None:
            when.check(kind, self._link.wire.fields)

        def hear(message: Any) -> None:
            predicates.sense(name, when(message))

        vars(hear)["begin"] = getattr(when, "begin", nothing)
        return hear


def notes(document: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the keys and a sentence of each oddity of a table: services, and names in ``remap`` that nothing has."""
    table = document["ros2"]
    if table.get("services"):
        yield ("ros2", "services"), "ros2.services: anybody on the ROS domain may call them, unless SROS2 is set up"
    own = f"{table.get('node', 'mdm')}/"
    space = namespace.strip("/") if isinstance(namespace := table.get("namespace", ""), str) else ""

    def full(name: str) -> str:
        return name if name[:1] == "/" else f"{f'/{space}' if space else ''}/{name.replace('~/', own)}"

    def named(value: Any) -> Iterator[str]:
        for key, each in value.items() if isinstance(value, dict) else ():
            yield from [each] if key in _WHOLES and isinstance(each, str) else named(each)

    ours = ("/diagnostics", "/navigate_to_pose", "~/decisions", "~/modes", *(f"~/{name}" for name in SERVICES))
    used = {full(name) for name in (*ours, *named(document))}
    for name in table.get("remap", ()):
        if full(name) not in used:
            yield ("ros2", "remap", name), f"ros2.remap: nothing in this file uses {name!r}"


class _Unchecked:
    """Stands for a wire where options are checked, and types are not."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None
