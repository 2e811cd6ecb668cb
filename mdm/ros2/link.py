"""The link between a runtime and ROS 2: opened before the first sensor, closed behind the safe actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.errors import ConfigError
from mdm.ros2.actions import Actions
from mdm.ros2.inputs import Topic
from mdm.ros2.wire import Quality
from mdm.runtime import Extension

if TYPE_CHECKING:
    from mdm.actors import PredicateManager
    from mdm.ros2.reports import Reports
    from mdm.ros2.wire import Wire
    from mdm.runtime import Runtime


class Link(Extension):
    """Links a runtime to ROS 2; a file's table ``ros2`` makes one, and a program without a file does so itself.

    Example::

        link = Link(RclpyWire("patrol"), predicates)
        battery = link.topic("/battery_state", "sensor_msgs/msg/BatteryState")
        battery.predicate("BatteryIsLow", "percentage < 0.2 until > 0.3", max_age=5.0)
        async with mdm.Runtime(extensions=[link]) as runtime:
            await runtime.start(predicates)

    Declare everything before the runtime begins.

    Args:
        wire: What carries it.
        predicates: Where predicates and events are declared.
        reports: What ROS sees of the run; nothing by default.

    Attributes:
        actions: Makes actions of goals, services and topics.
        topics: Those that are subscribed to, by name.
    """

    name = "the link to ROS 2"

    def __init__(self, wire: Wire, predicates: PredicateManager, reports: Reports | None = None) -> None:
        self.wire = wire
        self.actions = Actions(wire, predicates)
        self._reports, self._predicates = reports, predicates
        self.topics: dict[str, Topic] = {}

    def topic(self, name: str, kind: str, quality: Quality | None = None) -> Topic:
        """Return a topic, subscribed to once, whoever uses it; another type or quality is a `ConfigError`."""
        topic = self.topics.get(name) or Topic(self.wire, self._predicates, name, kind, quality or Quality())
        if topic.kind != kind:
            raise ConfigError(f"the topic {name} has the type {topic.kind} already: give it one type", key="type")
        if quality not in {None, topic.quality}:
            raise ConfigError(f"the topic {name} has another qos already: give it once", key="qos")
        self.topics[name] = topic
        return topic

    async def open(self, runtime: Runtime) -> None:
        """Carry all from now on."""
        for topic in self.topics.values():
            topic.open(runtime)
        await self.wire.open(runtime)
        try:
            await self.actions.open(runtime)
            if self._reports is not None:
                self._reports.open(runtime)
        except BaseException:
            await self.wire.close()
            raise

    async def close(self) -> None:
        """End the wire, behind the last report."""
        try:
            if self._reports is not None:
                self._reports.close()
            await self.actions.close()
        finally:
            await self.wire.close()
