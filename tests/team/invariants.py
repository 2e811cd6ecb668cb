"""The invariants of an agent's state, as `mdm.team.agreement.state.State` has them in words, by their numbers there."""

from __future__ import annotations

from team.copies import Violation

INVARIANTS = {
    1: lambda agent, state: (
        state.ballot is None
        if state.role in {"following", "joining"}
        else agent.agent in state.ballot.joined
        and (state.term.leader, state.term.incarnation) == (agent.agent, agent.incarnation)
    ),
    2: lambda agent, state: (
        state.ballot is None
        or (
            len(state.live) >= agent.majority
            and (state.role == "calling" or len(state.ballot.joined) >= agent.majority)
        )
    ),
    3: lambda agent, state: (
        state.role != "following"
        or (state.term.leader != agent.agent and state.live.get(state.term.leader) == state.term.incarnation)
    ),
    4: lambda _, state: state.role in {"calling", "joining"} or state.sound,
    5: lambda _, state: (
        state.fetching is None
        or (state.role != "leading" and (state.role != "calling" or state.fetching in state.ballot.joined))
    ),
    6: lambda _, state: state.fetching is None or "retry" in state.timers,
    7: lambda _, state: (
        ("close" not in state.timers or state.role == "leading")
        and ("patience" not in state.timers or state.role == "calling")
        and ("invite" not in state.timers or state.role in {"leading", "calling"})
    ),
    8: lambda agent, state: (
        state.role != "leading" or max(state.applied.values()) == agent.step == state.applied[agent.agent]
    ),
    9: lambda _, state: state.term.number <= state.highest,
}


def check(agent):
    """Raise what does not hold of an agent's state between two events."""
    for number, holds in INVARIANTS.items():
        if not holds(agent, agent.state):
            raise Violation(f"{agent.agent} breaks invariant {number}: {agent.state}")
