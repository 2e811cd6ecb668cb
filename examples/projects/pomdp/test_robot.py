"""The robot passes doors, and looks at each until it is sure, in ten minutes of virtual time."""

from pathlib import Path

import mdm
from mdm.testing import capture_decisions, run_virtual

HERE = Path(__file__).parent


def test_it_passes_when_it_is_sure():
    async def minutes(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(mdm.load_system(HERE / "robot.toml"))
            await runtime.clock.sleep(600)
        return decisions

    decisions = run_virtual(minutes)
    assert {decision.action_name for decision in decisions} == {"look", "pass", "ring"}
    model = mdm.load_model(HERE / "robot.pomdp")
    is_open = model.state_space.index("open")
    for decision in decisions:
        if decision.action_name == "pass":
            assert decision.belief[is_open] > 0.9
