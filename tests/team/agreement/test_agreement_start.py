from __future__ import annotations

import pytest
from sentences import refused
from team.lockstep import Lockstep

from mdm.errors import ConfigError
from mdm.team.agreement import Agreement


def test_an_agent_that_is_none_of_the_team_is_refused():
    with refused(ConfigError):
        Agreement("c", ["a", "b"], None, incarnation=1, event_driven=False, deadline_ns=1, retry_ns=1)


def test_before_anyone_is_seen_an_agent_waits():
    team = Lockstep(3, start=False)
    team.start("a")
    machine = team["a"]
    assert (machine.role, machine.leader, machine.step, machine.next_time) == ("waiting", None, 0, None)


@pytest.mark.parametrize(("event_driven", "steps"), [(True, [1, 1]), (False, [0, 0])])
def test_events_before_a_term_wait_for_it_and_readings_do_not(event_driven, steps):
    team = Lockstep(2, start=False, event_driven=event_driven)
    for name in team.names:
        team.start(name)
        team.propose(name, name.encode())
    assert not team.line
    team.see()
    team.deliver()
    assert team.steps == steps
