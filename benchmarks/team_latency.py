"""How soon an agent's observation is a callback at another one, and how many joint steps a second a team makes.

Agents are processes. The bare ways are measured in the same processes, in blocks by turns with the team's, so that the
machine's moods hit all alike; everything is measured pinned to one core, and not. The Python calls of one joint step
are counted within one process and in virtual time, where they do not depend on the machine.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import statistics
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bare import Bare, Tcp
from measurement import free_port, parser, report, table

import mdm
from mdm.models import POMDP, Factor, Space
from mdm.policies import AlphaVectors
from mdm.team import Team

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from types import FrameType

    from mdm.team.transport.transport import Transport

LEASE = 10.0  # seconds, so that few beats come between
PATIENCE = 60.0  # seconds until all agents have met
FLOOR = "Zenoh, asyncio with eventfd"
PATHS = ("asyncio TCP", "Zenoh, callback", FLOOR, "centralised", "replicated")
now = time.monotonic  # one clock for all processes of a machine


def doors(agents: int) -> POMDP:
    """Return a task of so many agents that hear, each for itself, which of two states it is."""
    hears = np.array([[0.85, 0.15], [0.15, 0.85]])
    joint = np.ones((2, 1))
    for _ in range(agents):
        joint = np.einsum("so,sp->sop", joint, hears).reshape(2, -1)
    actions = 2**agents
    return POMDP(
        [np.full((2, 2), 0.5)] * actions,
        np.broadcast_to(joint, (actions, 2, joint.shape[1])),
        np.zeros((2, actions)),
        discount=0.9,
        actions=Space([Factor(f"agent{agent}", ["wait", "go"]) for agent in range(agents)]),
        observation_names=Space([Factor(f"agent{agent}", ["left", "right"]) for agent in range(agents)]),
    )


class Robot:
    """One agent of a team: observes, and knows when its callback was called."""

    def __init__(self, team: Team, number: int, transport: Transport | None = None) -> None:
        model = doors(len(team.names))
        self.calls: list[float] = []
        self.left = 0
        self.done = asyncio.Event()
        self.ensemble = mdm.Ensemble(
            "joint",
            policy=AlphaVectors([[1.0, 0.0], [0.0, 1.0]], [0, len(model.action_space) - 1]),
            model=model,
            actions=dict.fromkeys(("wait", "go"), self.act),
            agent=number,
        )
        self.member = team.member(team.names[number], self.ensemble, transport=transport)
        self._seen = [None if other != number else number % 2 for other in range(len(team.names))]
        self._size = len(team.names)
        self._lock_step = False

    def act(self) -> None:
        """Be the callback."""
        self.calls.append(now())
        self.left -= 1
        if self.left == 0:
            self.done.set()
        elif self.left > 0 and self._lock_step:
            self.observe()

    def observe(self) -> None:
        """Observe something."""
        self.ensemble.publish_observation(tuple(self._seen))

    async def ready(self) -> None:
        """Wait until the whole team decides.

        Raises:
            RuntimeError: If it does not for a minute.
        """
        layer, link, until = self.member.layers["joint"], self.member.link, now() + PATIENCE
        while True:
            members = getattr(layer.statistics(), "members", None)
            together = members is None or len(members) == self._size
            if self.calls and together and len(link.live) == self._size:
                return
            if now() > until:
                raise RuntimeError(
                    f"agent {link.agent!r} is not ready after {PATIENCE:g} s: of {self._size} agents it sees "
                    f"{', '.join(link.live) or 'none'}, in its steps take part {', '.join(members or ()) or 'none'}, "
                    f"and its callback was called {len(self.calls)} times"
                )
            await asyncio.sleep(0.02)

    async def paths(self, count: int) -> list[float]:
        """Observe so many times, each after the callback here of the last; return when."""
        self._lock_step, began = False, []
        for _ in range(count):
            self.left = 1
            self.done.clear()
            began.append(now())
            self.observe()
            await self.done.wait()
        return began

    async def steps(self, count: int) -> list[float]:
        """Observe at each step; return the time between the steps."""
        self.calls.clear()
        self.left, self._lock_step = count, True
        self.done.clear()
        self.observe()
        await self.done.wait()
        self._lock_step = False
        return list(np.diff(self.calls[:count]))


async def work(number: int, ports: dict[str, list[int]], orders: Connection) -> None:
    """Be one agent, in all ways of it, and do what is ordered."""

    def team(mode: Any) -> Team:
        agents = [(f"{mode}{place}", f"tcp/127.0.0.1:{port}") for place, port in enumerate(ports[mode])]
        return Team(mode, agents, mode=mode, lease=LEASE)

    modes = [mode for mode in ("centralised", "replicated") if mode in ports]
    robots = {mode: Robot(team(mode), number) for mode in modes}
    bare = Bare(number, ports["bare"], lease=LEASE)
    tcp = Tcp(number, ports["tcp"][0])
    async with mdm.Runtime(log=None) as runtime:
        try:
            async with asyncio.timeout(PATIENCE):
                await bare.open()
                await tcp.open()
            for robot in robots.values():
                await runtime.start(robot.member)
            for robot in robots.values():
                await robot.ready()
            orders.send("ready")
            await obey(orders, robots, bare, tcp)
        except TimeoutError:
            raise RuntimeError(f"agent {number} has not met the others, without a team, for {PATIENCE:g} s") from None
        finally:
            tcp.close()
            await bare.close()


async def obey(orders: Connection, robots: dict[str, Robot], bare: Bare, tcp: Tcp) -> None:
    """Do what is ordered, until there is nothing more."""
    while (order := await asyncio.to_thread(orders.recv)) is not None:
        what, way, count = order
        if what == "listen":
            if way in robots:
                robots[way].calls.clear()
            orders.send(None)
        elif what == "tell":
            orders.send(robots[way].calls[:count])
        elif what == "steps":
            orders.send(await (bare if way == "bare" else robots[way]).steps(count))
        elif way in robots:
            orders.send(await robots[way].paths(count))
        else:
            orders.send(await (tcp.round_trips(count) if "TCP" in way else bare.round_trips(count, way)))


def agent(number: int, ports: dict[str, list[int]], orders: Connection) -> None:
    """Run one agent."""
    asyncio.run(work(number, ports, orders))


class Agents:
    """Processes, one for each agent."""

    def __init__(self, count: int, *, centralised: bool) -> None:
        context = multiprocessing.get_context("spawn")
        ways = ["bare", "tcp", "replicated", *(["centralised"] if centralised else [])]
        ports = {way: [free_port() for _ in range(count)] for way in ways}
        self.pipes: list[Connection] = []
        self.processes = []
        for number in range(count):
            pipe, theirs = context.Pipe()
            self.pipes.append(pipe)
            self.processes.append(context.Process(target=agent, args=(number, ports, theirs), daemon=True))
            self.processes[-1].start()
            theirs.close()
        for number, pipe in enumerate(self.pipes):
            try:
                pipe.recv()
            except EOFError:
                raise SystemExit(f"agent {number} of {count} has ended before it was ready: see above") from None

    def path(self, way: str, count: int) -> list[float]:
        """Return the seconds of so many ways from the second agent to the first."""
        first, second = self.pipes[:2]
        first.send(("listen", way, count))
        first.recv()
        second.send(("path", way, count))
        found: list[float] = second.recv()
        if way not in ("centralised", "replicated"):
            return [seconds / 2 for seconds in found]  # of a round trip
        first.send(("tell", way, count))
        return [there - here for here, there in zip(found, first.recv(), strict=True)]

    def steps(self, way: str, count: int) -> list[float]:
        """Return the seconds between so many joint steps, at the first agent."""
        for pipe in self.pipes:
            pipe.send(("steps", way, count))
        first: list[float]
        first, *_ = [pipe.recv() for pipe in self.pipes]
        return first

    def end(self) -> None:
        """End them all."""
        for pipe in self.pipes:
            pipe.send(None)
        for process in self.processes:
            process.join()


class Calls:
    """Counts the Python calls within mdm between two moments, by agent and module, as `sys.setprofile` tells them.

    A call is its agent's who was last seen to handle something. The simulated network and clock are left out: between
    processes there are none.
    """

    LEFT_OUT = (
        "team/transport/network.py",
        "runtime/time/virtual.py",
        "runtime/time/clock.py",
        "runtime/process/runner.py",
    )

    def __init__(self, names: tuple[str, ...]) -> None:
        self.by_agent = dict.fromkeys(names, 0)
        self.modules: Counter[str] = Counter()
        self.actions: list[int] = []
        self.digests = 0
        self._agent = names[0]
        self._root = str(Path(mdm.__file__).parent)

    @property
    def total(self) -> int:
        """The calls of all agents."""
        return sum(self.by_agent.values())

    def begin(self, agent: str) -> None:
        """Count from now on; what comes first is this agent's."""
        self._agent = agent
        sys.setprofile(self._take)

    def end(self) -> None:
        """Count no more."""
        sys.setprofile(None)

    def _take(self, frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(self._root):
            return
        agent = getattr(frame.f_locals.get("self"), "agent", None)
        if isinstance(agent, str) and agent in self.by_agent:
            self._agent = agent
        module = code.co_filename[len(self._root) + 1 :]
        if module in self.LEFT_OUT:
            return
        self.by_agent[self._agent] += 1
        self.modules[module] += 1
        if code.co_qualname == "ActionLayer._on_action":
            self.actions.append(self.total)
        elif code.co_qualname == "Copy.digest":
            self.digests += 1


async def count_calls(size: int) -> dict[str, Any]:
    """Return what a joint step of so many agents is made of, in which the second one alone observes something."""
    async with mdm.Runtime(log=None) as runtime:
        team = Team("calls", [f"agent{number}" for number in range(size)], lease=LEASE)
        network = mdm.team.Network(runtime.clock, team="calls", delay=0.0001, lease=LEASE)
        robots = [Robot(team, number, network.transport(name)) for number, name in enumerate(team.names)]
        for robot in robots:
            await runtime.start(robot.member)
        for robot in robots:
            await robot.ready()
        for _ in range(3):  # the first steps look things up
            robots[1].observe()
            await asyncio.sleep(0.123)
        calls = Calls(team.names)
        calls.begin(team.names[1])
        robots[1].observe()
        await asyncio.sleep(0.005)  # until all is said, and before a timer asks for anything
        calls.end()
    leader, follower, *_ = calls.by_agent.values()
    return {
        "agents": size,
        "calls": calls.total,
        "modules": len(calls.modules),
        "leader": leader,
        "who observes": follower,
        "until the leader's callback": calls.actions[0],
        "digests": calls.digests,
    }


def measure(pinned: str, *, blocks: int, count: int, sizes: tuple[int, ...]) -> tuple[list[Any], list[Any]]:
    """Return the rows of ways, and of joint steps."""
    paths: dict[str, list[float]] = defaultdict(list)
    rows = []
    for size in sizes:
        agents = Agents(size, centralised=size == 2)
        steps: dict[str, list[float]] = defaultdict(list)
        for block in range(blocks + 1):  # the first warms up
            for way in PATHS if size == 2 else ():
                found = agents.path(way, count)
                paths[way] += found if block else []
            for way in ("bare", "replicated"):
                found = agents.steps(way, count)
                steps[way] += found if block else []
        agents.end()
        ours, bare = (statistics.median(steps[way]) for way in ("replicated", "bare"))
        rows.append(
            {
                "processes": pinned,
                "agents": size,
                "wait for all, ms": bare * 1e3,
                "replicated, ms": ours * 1e3,
                "mean, ms": statistics.mean(steps["replicated"]) * 1e3,
                "steps a second": round(1 / statistics.mean(steps["replicated"])),
                "of wait for all": ours / bare,
            }
        )
    floor = statistics.median(paths[FLOOR])
    return [
        {
            "processes": pinned,
            "way": way,
            "median, us": statistics.median(found) * 1e6,
            "90 %, us": float(np.quantile(found, 0.9)) * 1e6,
            "of eventfd": statistics.median(found) / floor,
        }
        for way, found in paths.items()
    ], rows


def main() -> None:
    """Measure, print and write."""
    options = parser(__doc__ or "").parse_args()
    blocks, count = (1, 20) if options.quick else (10, 200)
    sizes = (2,) if options.quick else (2, 3, 4, 8)
    calls = [mdm.run(lambda size=size: count_calls(size), virtual=True) for size in (2, 3)]  # type: ignore[misc]
    ways: list[Any] = []
    steps: list[Any] = []
    cores = os.sched_getaffinity(0)
    for pinned, chosen in (("on one core", {max(cores)}), ("free", cores)):
        os.sched_setaffinity(0, chosen)  # and with it, of all processes that this one starts
        of_ways, of_steps = measure(pinned, blocks=blocks, count=count, sizes=sizes)
        ways += of_ways
        steps += of_steps
    table("Python calls within mdm in one joint step, in which one agent observes something", calls)
    table("One way: from an agent's observation to the other's callback, or half a round trip", ways)
    table("Joint steps: all agents observe at each (medians)", steps)
    report("team_latency", {"calls": calls, "ways": ways, "steps": steps}, options.output)


if __name__ == "__main__":
    main()
