"""The robot works, and never with a low battery, in an hour of virtual time."""

from pathlib import Path

import mdm
from mdm.testing import capture_decisions, run_virtual

HERE = Path(__file__).parent


def test_it_works_and_charges():
    async def hour(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(mdm.load_system(HERE / "robot.toml"))
            await runtime.clock.sleep(3600)
        return decisions

    decisions = run_virtual(hour)
    assert {decision.action_name for decision in decisions} == {"work", "charge"}
    assert len(decisions) > 1000
    full = mdm.load_model(HERE / "robot.mdp").state_space.index("full")
    assert all((decision.state == full) == (decision.action_name == "work") for decision in decisions)
