"""Reports: how a robot does, as ROS sees it in diagnostics, decisions and modes; and the services that command it."""

from __future__ import annotations

import asyncio
import time
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.actors import Ensemble
from mdm.ros2.wire import Quality
from mdm.runtime.actor import descendants
from mdm.runtime.observing import Observer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mdm.messages import Decision, Mode
    from mdm.ros2.wire import Wire
    from mdm.runtime import Runtime

SERVICES = ("start", "stop", "reset", "release")

_OK, _WARN, _ERROR = b"\0", b"\1", b"\2"
_KEPT = Quality(depth=100, reliability="reliable", durability="transient_local")


class Reports(Observer):
    """Tells ROS how each ensemble does, and takes commands where the file says so. A failure is a fault ``observer``.

    ``/diagnostics`` has a status of each ensemble, once a second and when a mode changes: safe is an error with its
    causes; waiting for something unknown, or stopped, a warning. ``~/decisions`` and ``~/modes`` have the fields of
    `Decision` (without its belief) and `Mode` as JSON in a ``std_msgs/msg/String``; times are nanoseconds. Services are
    ``std_srvs/srv/Trigger``; they command as a page does, so that start, stop and reset are the whole team's.

    Args:
        wire: Carries all this; has not opened.
        node: How each status begins, such as ``robot1/patrol``.
        diagnostics: Whether there are diagnostics.
        decisions: Whether decisions and modes are published.
        services: Which of ``~/start``, ``~/stop``, ``~/reset`` and ``~/release`` are served.
    """

    name = "the reports to ROS"

    def __init__(
        self, wire: Wire, node: str, *, diagnostics: bool = True, decisions: bool = False, services: Sequence[str] = ()
    ) -> None:
        self._make, self._node, self._services = wire.make, node, services
        self._next: asyncio.Handle | None = None
        self._runtime: Runtime | None = None
        self._look: Callable[[], object] = lambda: None
        self._diagnose = self._modes = None
        if diagnostics:
            reliable = Quality(reliability="reliable")
            self._diagnose = wire.publish("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", reliable)
        if decisions:
            self._decisions = wire.publish("~/decisions", "std_msgs/msg/String", _KEPT)
            self._modes = wire.publish("~/modes", "std_msgs/msg/String", _KEPT)
        for name in services:
            wire.serve(f"~/{name}", "std_srvs/srv/Trigger", partial(self._answer, name))

    def open(self, runtime: Runtime) -> None:
        """Begin, once the wire has opened."""
        self._runtime = runtime
        guard = runtime.observe(self)
        self._look = guard(self._tell)
        if self._modes is not None:
            guard.subscriptions.append(runtime.decisions.subscribe(guard(self._decided)))
        if self._services:
            served = ", ".join(f"~/{name}" for name in self._services)
            runtime.say("services", warning=f"anybody on the ROS domain may call {served}, unless SROS2 is set up")
        if self._diagnose is not None:
            self._beat()

    def close(self) -> None:
        """Tell once more how each ensemble is, before the wire closes."""
        if self._next is not None:
            self._next.cancel()
            self._next = None
            self._look()

    def on_mode(self, mode: Mode) -> None:
        """Publish a mode, and behind this turn how all ensembles are."""
        if self._next is not None:
            self._next.cancel()
            self._next = asyncio.get_running_loop().call_soon(self._beat)
        if self._modes is not None:
            self._modes(self._text(mode))

    def _decided(self, decision: Decision) -> None:
        told = {name: getattr(decision, name) for name in decision.__struct_fields__ if name != "belief"}
        self._decisions(self._text(told))

    def _text(self, told: object) -> Any:
        return self._make("std_msgs/msg/String", {"data": msgspec.json.encode(told).decode()})

    def _beat(self) -> None:
        self._next = asyncio.get_running_loop().call_later(1.0, self._beat)
        self._look()

    def _tell(self) -> None:
        assert self._diagnose is not None
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        stamp = {"stamp": {"sec": seconds, "nanosec": nanoseconds}}
        told = {"header": stamp, "status": [self._status(ensemble) for ensemble in self._ensembles()]}
        self._diagnose(self._make("diagnostic_msgs/msg/DiagnosticArray", told))

    def _status(self, ensemble: Ensemble) -> dict[str, Any]:
        status = ensemble.status()
        causes = "; ".join([f"{cause.kind}: {cause.detail}" for cause in status.causes])
        level, message = _OK, status.action_name or "nothing is decided yet"
        if status.mode == "safe":
            level, message = _ERROR, f"safe: {causes}"
        elif status.mode == "stopped":
            level, message = (_OK, "not chosen") if ensemble.bound else (_WARN, "stopped")
        elif status.waiting:
            level, message = _WARN, f"waits for {', '.join(status.waiting)}"
        since = datetime.fromtimestamp(status.since / 1e9, UTC).isoformat(timespec="milliseconds")
        values = {"mode": status.mode, "action": status.action_name, "since": since, "causes": causes}
        pairs = [{"key": key, "value": value} for key, value in values.items()]
        return {"level": level, "name": f"{self._node}: {ensemble.path}", "message": message, "values": pairs}

    def _answer(self, name: str, _: object) -> Any:
        done = []
        for ensemble in self._ensembles():
            if ensemble.mode == "safe" if name == "release" else not ensemble.bound:
                getattr(ensemble, name)()
                done.append(ensemble.path)
        told = f"{name}: {', '.join(done)}" if done else f"there is no ensemble to {name}"
        return self._make("std_srvs/srv/Trigger_Response", {"success": bool(done), "message": told})

    def _ensembles(self) -> Iterator[Ensemble]:
        actors = [] if self._runtime is None else descendants(self._runtime.root)
        return (actor for actor in actors if isinstance(actor, Ensemble))
