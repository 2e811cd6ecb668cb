"""How many joint steps a replicated team takes together over a link that loses packets, and its pause after a crash.

All agents run in one process and in virtual time. The link is a model of TCP, as a kernel and Zenoh have it: a lost
packet is sent again after 200 ms and a round trip, after twice that, and so on; what was sent later waits behind it; a
connection on which a message does not come for a lease is closed with all that was under way, and opened anew.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from contextlib import AsyncExitStack
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from measurement import arguments, report, table

import mdm
from mdm.policies import AlphaVectors
from mdm.team import Committed, Network, Team

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.team.transport.network import SimulatedTransport

ROUND_TRIP = 0.02
FIRST_RETRY = 0.2 + ROUND_TRIP
LONGEST_RETRY = 120.0
TRIES = 15
HANDSHAKE = 6  # messages until a connection of Zenoh is open, one after the other
QUANTILES = (0.5, 0.9, 0.99, 1.0)


class Radio(Network):
    """A network whose packets get lost and whose messages are late for it."""

    def __init__(self, clock: Any, *, packets_lost: float, seed: int, lease: float, silent: bool) -> None:
        super().__init__(clock, team="radio", seed=seed, lease=lease if silent else 0.0)
        self.packets_lost = packets_lost
        self.patience = round(lease * 1e9)
        self.cut: set[frozenset[str]] = set()
        self.connections: Counter[frozenset[str]] = Counter()
        self.ready: dict[tuple[str, str], int] = {}

    def connected(self, first: str, second: str) -> bool:
        """Whether two agents have a connection."""
        return super().connected(first, second) and frozenset((first, second)) not in self.cut

    def send(self, sender: str, receiver: SimulatedTransport, deliver: Callable[[], None]) -> None:
        """Deliver a message after those before it, or close a connection on which it does not come."""
        ends = frozenset((sender, receiver.agent))
        if not self.connected(sender, receiver.agent):
            return
        way, now = (sender, receiver.agent), self.clock.now()
        arrival = self.ready[way] = max(now + self.journey(), self.ready.get(way, 0))
        number = self.connections[ends]

        def arrive() -> None:
            if self.connected(*way) and self.connections[ends] == number:
                deliver()

        def close() -> None:
            if self.connections[ends] == number:
                self._close(ends)

        if arrival - now <= self.patience:
            self.clock.call_at(arrival, arrive)
        else:
            self.clock.call_at(now + self.patience, close)

    def _close(self, ends: frozenset[str]) -> None:
        self.cut.add(ends)
        self.connections[ends] += 1
        for one in [way for way in self.ready if ends == {*way}]:
            del self.ready[one]
        self._changed(0)
        again = self.clock.now() + round(self.random.uniform(0.1, 0.5) * 1e9)
        self.clock.call_at(again + sum(self.journey() for _ in range(HANDSHAKE)), partial(self._open_again, ends))

    def _open_again(self, ends: frozenset[str]) -> None:
        self.cut.discard(ends)
        self._changed(0)

    def journey(self) -> int:
        """Return how long a message takes, in nanoseconds."""
        seconds, wait = ROUND_TRIP / 2, FIRST_RETRY
        for _ in range(TRIES):
            if self.random.random() >= self.packets_lost:
                break
            seconds += wait
            wait = min(2 * wait, LONGEST_RETRY)
        return round(seconds * 1e9)


class Crew:
    """The agents of a team, and the steps of each with their times."""

    def __init__(
        self, count: int, *, loss: float, lease: float, period: float, seed: int, silent: bool = False
    ) -> None:
        self.team = Team("radio", [f"r{number}" for number in range(count)], period=period, lease=lease)
        self.model = mdm.problems.fire_fighting(2, count, 2)
        self.commits: dict[str, list[tuple[float, Committed]]] = {name: [] for name in self.team.names}
        self._options = {"packets_lost": loss, "lease": lease, "seed": seed, "silent": silent}

    async def open(self, stack: AsyncExitStack) -> None:
        """Start all agents."""
        self.runtimes = {name: await stack.enter_async_context(mdm.Runtime(log=None)) for name in self.team.names}
        self.clock = self.runtimes["r0"].clock
        self.network = Radio(self.clock, **self._options)
        await asyncio.gather(*map(self.start, self.team.names))

    async def start(self, name: str) -> None:
        """Start an agent."""
        number, model, actions = self.team.names.index(name), self.model, len(self.model.action_space)
        ensemble = mdm.Ensemble(
            "joint",
            policy=AlphaVectors(np.zeros((actions, len(model.state_space))), list(range(actions))),
            model=model,
            agent=number,
            actions=dict.fromkeys(model.action_space.factors[number].names, _nothing),
        )
        runtime = self.runtimes[name]
        runtime.channel(f"{name}/commits", Committed).subscribe(partial(self._keep, name))
        await runtime.start(self.team.member(name, ensemble, transport=self.network.transport(name)))

    def _keep(self, name: str, commit: Committed) -> None:
        self.commits[name].append((self.clock.now() / 1e9, commit))


def _nothing() -> None:
    """Do nothing: the steps are what counts."""


def share(loss: float, lease: float, *, seconds: float, period: float = 0.5) -> dict[str, Any]:
    """Return how many steps two agents take together."""
    crew = Crew(2, loss=loss, lease=lease, period=period, seed=1)

    async def main() -> None:
        async with AsyncExitStack() as stack:
            await crew.open(stack)
            await asyncio.sleep(seconds)

    mdm.run(main, virtual=True)
    first, second = (
        {(commit.term, commit.step, commit.digest): commit for _, commit in taken} for taken in crew.commits.values()
    )
    both, either = first.keys() & second.keys(), first.keys() | second.keys()
    whole = sum(not first[step].missing for step in both)
    return {
        "loss": loss,
        "lease": lease,
        "steps": len(either),
        "together %": 100 * len(both) / len(either),
        "together and whole %": 100 * whole / len(either),
        "connections lost an hour": 3600 * crew.network.connections.total() / seconds,
    }


def pauses(loss: float, lease: float, *, crashes: int, silent: bool, period: float = 0.1) -> dict[str, Any]:
    """Return the longest time without a step in the six leases after the leader of three agents has gone, in quantiles.

    Args:
        loss: The chance that a packet is lost.
        lease: The team's lease.
        crashes: How many times.
        silent: Whether nothing says that it has gone, as where a machine loses power; else the connection ends.
        period: The team's period.
    """
    found = []
    for seed in range(crashes):
        crew = Crew(3, loss=loss, lease=lease, period=period, seed=seed, silent=silent)

        async def main(crew: Crew = crew, moment: float = 3.0 + seed % 7 / 70) -> None:
            async with AsyncExitStack() as stack:
                await crew.open(stack)
                await asyncio.sleep(moment)
                crashed = crew.clock.now() / 1e9
                crew.network.crash("r0")
                await asyncio.sleep(6 * lease)
                taken = [when for when, _ in crew.commits["r1"] + crew.commits["r2"]]
                after = sorted({crashed, crew.clock.now() / 1e9, *(when for when in taken if when > crashed)})
                found.append(max(later - earlier for earlier, later in pairwise(after)))

        mdm.run(main, virtual=True)
    told = dict(zip(("median", "90 %", "99 %", "most"), np.quantile(found, QUANTILES).tolist(), strict=True))
    return {"how": "silent" if silent else "connection ends", "loss": loss, "lease": lease, "crashes": crashes, **told}


def main() -> None:
    """Measure."""
    asked = arguments(__doc__ or "")
    losses, leases = ((0.0, 0.2), (1.0,)) if asked.quick else ((0.0, 0.01, 0.05, 0.1, 0.2), (0.5, 1.0, 2.0, 4.0, 8.0))
    seconds, crashes = (30.0, 3) if asked.quick else (600.0, 30)
    rows = [share(loss, lease, seconds=seconds) for loss in losses for lease in leases]
    table("two agents, a step each 0.5 s", rows)
    cases = [(loss, lease) for loss in losses if loss in {0.0, 0.05, 0.2} for lease in leases if lease == 1.0]
    gone = [pauses(loss, lease, crashes=crashes, silent=silent) for silent in (False, True) for loss, lease in cases]
    table(
        "three agents, a step each 0.1 s: the longest time without a step, of the seconds after the leader has gone",
        gone,
    )
    report("team_radio", {"steps": rows, "pauses": gone}, asked.output)


if __name__ == "__main__":
    main()
