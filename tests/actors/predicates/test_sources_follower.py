"""Another agent's predicates, followed and read anew where an update was lost."""

from __future__ import annotations

from mdm import PredicateManager
from mdm.messages import PredicateMap, PredicateUpdate
from mdm.testing import run_virtual


def test_other_agents_predicates_are_followed_and_resynchronised():
    async def main(runtime):
        other, own = PredicateManager("other"), PredicateManager("own")
        a, b = other.sensor("A", initial=True), other.sensor("B", initial=False)
        own.define("Both", "robot2/A and robot2/B")
        updates, full = runtime.channel("link/updates", PredicateUpdate), runtime.channel("other/map", PredicateMap)
        own.follow("robot2", updates, full)
        await runtime.start(other)
        lost = []

        def forward(update):
            if not lost:
                updates.publish(update)

        runtime.channel("other/updates", PredicateUpdate).subscribe(forward)
        await runtime.start(own)
        assert own.values() == {"Both": False, "robot2/A": True, "robot2/B": False}
        b.set(True)
        assert own.value("Both") is True
        lost.append(True)
        a.set(False)  # this update never arrives
        assert own.value("Both") is True
        lost.clear()
        b.set(None)  # the next one shows the gap
        assert own.values() == {"Both": False, "robot2/A": False, "robot2/B": None}

    run_virtual(main)
