"""The figures of a running system as Prometheus reads them: text, with a line for each value at this moment.

The format is version 0.0.4 of https://prometheus.io/docs/instrumenting/exposition_formats. All counts but those of
faults are kept by the actors anyway, so that no decision waits for them.
"""

from __future__ import annotations

import asyncio
import time as times
from collections import Counter
from itertools import accumulate
from typing import TYPE_CHECKING, Final

import numpy as np

from mdm.actors import Ensemble
from mdm.runtime.actor import descendants
from mdm.runtime.observing import Observer
from mdm.snapshots.beliefs import chances_of
from mdm.team import Member
from mdm.version import __version__

if TYPE_CHECKING:
    from mdm.messages import Fault
    from mdm.runtime import Actor, Histogram, Runtime

Figures = dict[str, float]
"""Values by what stands before them in a line: texts and numbers, of which the garbage collector takes no note."""

FAMILIES: Final = {
    "mdm_build_info": "gauge The version of the library; the value is 1.",
    "mdm_decisions_total": "counter Decisions of an ensemble by action.",
    "mdm_actions_ended_total": "counter Actions that have ended: succeeded, failed, preempted, timed_out or abandoned.",
    "mdm_latency_seconds": "histogram From each stimulus to the call of its action's function.",
    "mdm_mode": "gauge 1 for the mode that an ensemble is in (stopped, deciding or safe), and 0 for the others.",
    "mdm_idle": "gauge 1 where an ensemble decides, and has nothing to do.",
    "mdm_waiting": "gauge 1 where an ensemble cannot decide: an input is missing, or it pauses.",
    "mdm_belief_entropy_ratio": "gauge How unsure the belief decided on is: 0 of one state, 1 where all are as likely.",
    "mdm_faults_total": "counter Faults by kind.",
    "mdm_team_live": "gauge 1 where an agent and another one hear each other.",
    "mdm_team_silence_seconds": "gauge How long ago an agent last heard another one.",
    "mdm_team_sent_messages_total": "counter Messages that an agent has sent.",
    "mdm_team_received_messages_total": "counter Messages that an agent has received.",
    "mdm_team_dropped_messages_total": "counter Messages that were lost or not taken, by the reason.",
}
"""All families, each with its type and its help."""

_MODES = ("stopped", "deciding", "safe")
_BUCKETS = {repr(((1 << octave) - 1) / 1e9): 8 * octave - 1 for octave in range(10, 35)} | {"+Inf": -1}
"""The last of a histogram's own buckets up to each bound: below a power of two, from a microsecond to 17 seconds."""
_SLICE = 0.001
"""Seconds after which the event loop turns before the next ensemble is looked at."""
_ESCAPES = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


class Metrics(Observer):
    """The figures of a runtime, which no count of an ensemble falls in while it runs.

    Args:
        runtime: The runtime, which is heard from now on.
    """

    name = "the metrics"

    def __init__(self, runtime: Runtime) -> None:
        self._runtime = runtime
        self._faults = Counter[str]()
        self._known: dict[str, tuple[Actor, Figures, Figures]] = {}
        runtime.observe(self)

    def on_fault(self, fault: Fault) -> None:
        """Count a fault."""
        self._faults[fault.kind] += 1

    async def text(self) -> bytes:
        """Return all figures; the event loop goes on between the ensembles."""
        found: Figures = {_labels("mdm_build_info", version=__version__): 1}
        found |= {_labels("mdm_faults_total", kind=kind): count for kind, count in self._faults.items()}
        lines: dict[str, list[str]] = {name: [] for name in FAMILIES}
        until = times.perf_counter() + _SLICE
        for actor in [self._runtime.root, *descendants(self._runtime.root)]:
            if isinstance(actor, Ensemble):
                found = self._counted(actor, _counts(actor)) | _state(actor)
            elif isinstance(actor, Member):
                found = self._counted(actor, _traffic(actor)) | _links(actor)
            for key, value in found.items():
                name = key.partition("{")[0]
                lines[name if name in FAMILIES else name.rpartition("_")[0]].append(f"{key} {value!r}\n")
            found = Figures()
            if times.perf_counter() >= until:
                await asyncio.sleep(0)
                until = times.perf_counter() + _SLICE
        told = []
        for name, each in lines.items():
            kind, _, words = FAMILIES[name].partition(" ")
            told += [f"# HELP {name} {words}\n# TYPE {name} {kind}\n", *each] if each else []
        return "".join(told).encode(errors="replace")

    def _counted(self, actor: Actor, counts: Figures) -> Figures:
        """Return the counts of an actor and of those that were there before under its name."""
        known, before, told = self._known.get(actor.path, (actor, {}, {}))
        before = before if known is actor else told
        told = {key: before.get(key, 0) + counts.get(key, 0) for key in before | counts}
        self._known[actor.path] = actor, before, told
        return told


def _labels(metric: str, /, **told: str) -> str:
    return metric + "{" + ",".join([f'{name}="{value.translate(_ESCAPES)}"' for name, value in told.items()]) + "}"


def _counts(ensemble: Ensemble) -> Figures:
    path, action = ensemble.path, ensemble.action
    found = _histogram("mdm_latency_seconds", action.latency, ensemble=path)
    for name, count in (dict.fromkeys(action.names, 0) | action.decided).items():
        found[_labels("mdm_decisions_total", ensemble=path, action=name)] = count
    for how, count in action.ended.items():
        found[_labels("mdm_actions_ended_total", ensemble=path, status=how)] = count
    return found


def _state(ensemble: Ensemble) -> Figures:
    path, controller, status = ensemble.path, ensemble.controller, ensemble.status()
    found: Figures = {_labels("mdm_mode", ensemble=path, mode=mode): int(mode == status.mode) for mode in _MODES}
    found[_labels("mdm_idle", ensemble=path)] = int(status.idle_since is not None)
    found[_labels("mdm_waiting", ensemble=path)] = int(bool(status.waiting))
    belief, states = chances_of(controller.decided_by), controller.symbols.num_states or 0
    if belief is not None and states > 1:
        chances = belief[1]
        entropy = float(-(chances @ np.log(chances)) / np.log(states))
        found[_labels("mdm_belief_entropy_ratio", ensemble=path)] = round(max(entropy, 0.0), 6)
    return found


def _histogram(name: str, histogram: Histogram, **of: str) -> Figures:
    """Return a histogram, each of whose buckets counts all latencies up to its bound, of whole nanoseconds."""
    reached, told = [*accumulate(histogram.counts)], _labels("", **of)
    found: Figures = {f'{name}_bucket{told[:-1]},le="{bound}"}}': reached[last] for bound, last in _BUCKETS.items()}
    return found | {f"{name}_sum{told}": histogram.total, f"{name}_count{told}": reached[-1]}


def _traffic(member: Member) -> Figures:
    of, told = {"team": member.team.name, "agent": member.agent}, member.link.transport.statistics()
    found = Figures()
    for way, traffic in (("sent", told.sent), ("received", told.received)):
        found[_labels(f"mdm_team_{way}_messages_total", **of)] = sum(each.messages for each in traffic.values())
    for reason, count in told.dropped.items():
        found[_labels("mdm_team_dropped_messages_total", **of, reason=reason)] = count
    return found


def _links(member: Member) -> Figures:
    live, ages, found = member.link.live, member.link.ages, Figures()
    for other in sorted({*member.team.names} - {member.agent}):
        of = _labels("", team=member.team.name, agent=member.agent, other=other)
        found["mdm_team_live" + of] = int(other in live)
        if other in ages:
            found["mdm_team_silence_seconds" + of] = ages[other]
    return found
