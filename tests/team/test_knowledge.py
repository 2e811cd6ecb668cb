"""Knowledge: what an agent observes, shares, hears and decides, with its own belief and the common one."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

import mdm
from mdm.policies import AlphaVectors
from mdm.team import Always, Experience, Knowledge, SharedHistory, ValueOfCommunication

TIGER = mdm.problems.dec_tiger(discount=0.9)
CAREFUL = AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8], 9)
"""Opens from 0.9 on."""


class Chosen:
    """Shares what a test says."""

    def __init__(self, choose):
        self.choose = choose

    def share(self, knowledge, now):
        return self.choose(knowledge)


def pair(communication=None, **options):
    shares = Always() if communication is None else communication
    return [Knowledge(CAREFUL, TIGER, agent, shares, **options) for agent in range(2)]


def test_what_is_shared_is_known_to_both():
    first, second = pair(Chosen(lambda knowledge: knowledge.unshared))
    for agent in (first, second):
        agent.decide()
        agent.observe("hear-left")
    np.testing.assert_allclose(second.belief, [0.85, 0.15])
    history = first.share(1.0)
    assert history == SharedHistory(0, (Experience(1, 0, 0),))
    assert second.hear(history) == 0
    together = 0.85**2 / (0.85**2 + 0.15**2)
    np.testing.assert_allclose(second.belief, [together, 1 - together])
    np.testing.assert_allclose(first.belief, [0.85, 0.15])
    np.testing.assert_allclose(second.common_belief, first.common_belief)
    np.testing.assert_allclose(first.common_belief, [0.85, 0.15])
    assert first.share(1.0) is None
    assert (first.unshared, first.last_shared) == ((), Experience(1, 0, 0))
    assert second.unshared == (Experience(1, 0, 0),)


def test_what_silence_leads_to():
    first, _ = pair(Chosen(lambda _: ()))
    for _ in range(2):
        first.decide()
        first.observe("hear-left")
    assert first.share(2.0) is None
    np.testing.assert_allclose(first.common_belief, [0.5, 0.5])
    assert TIGER.action_space.names[first.action] == "open-right open-right"
    assert TIGER.action_space.names[first.action_in_silence] == "open-right listen"
    assert first.value_of(first.action) > first.value_of(first.action_in_silence)
    assert first.unshared == (Experience(1, 0, 0), Experience(2, 0, 0))


def test_a_policy_may_share_a_part():
    first, second = pair(Chosen(lambda knowledge: knowledge.unshared[-1:]))
    for agent in (first, second):
        for symbol in ("hear-left", "hear-right"):
            agent.decide()
            agent.observe(symbol)
    assert first.share(2.0) == SharedHistory(0, (Experience(2, 0, 1),))
    assert first.unshared == (Experience(1, 0, 0),)
    assert first.share(2.0) == SharedHistory(0, (Experience(1, 0, 0),))


@pytest.mark.parametrize(
    "choose", [lambda _: [Experience(7, 0, 0)], lambda knowledge: [*knowledge.unshared, *knowledge.unshared]]
)
def test_what_is_not_there_to_be_shared_is_refused(choose):
    first, _ = pair(Chosen(choose))
    first.observe("hear-left")
    with refused(mdm.ModelError):
        first.share(1.0)
    assert len(first.unshared) == 1


def test_what_is_older_than_the_window_is_not_shared():
    first, second = pair(window=3)
    for _ in range(10):
        for agent in (first, second):
            agent.decide()
            agent.observe("hear-left")
    assert [each.step for each in first.unshared] == [7, 8, 9, 10]
    assert second.hear(first.share(10.0)) == 0
    assert second.hear(SharedHistory(0, (Experience(2, 0, 0),))) == 1


def test_beginning_anew_forgets():
    first, second = pair(Chosen(lambda knowledge: knowledge.unshared))
    first.observe("hear-left")
    second.hear(first.share(1.0))
    for agent in (first, second):
        agent.start()
        assert (agent.step, agent.unshared, agent.last_shared) == (0, (), None)
        np.testing.assert_allclose(agent.belief, [0.5, 0.5])
        np.testing.assert_allclose(agent.common_belief, [0.5, 0.5])


def test_an_action_that_was_not_decided_is_not_told():
    first, _ = pair()
    first.observe("hear-left")
    first.decide()
    first.observe(None)
    assert first.unshared == (Experience(1, None, 0), Experience(2, 0, None))


def test_without_a_common_belief_there_is_none():
    first, _ = pair()
    assert first.common is None
    with refused(mdm.ConfigError):
        _ = first.common_belief


def test_what_fits_not_is_refused():
    for communication in (3, None, object()):
        with refused(mdm.ConfigError):
            Knowledge(CAREFUL, TIGER, 0, communication)
    with refused(mdm.ConfigError):
        Knowledge(CAREFUL, TIGER, 0, Always(), tracker=mdm.BeliefTracker(TIGER))
    with refused(mdm.ConfigError):
        Knowledge(CAREFUL, TIGER, "agent2", Always())
    first, _ = pair()
    with refused(mdm.ModelError):
        first.hear(SharedHistory(9, (Experience(1, 0, 0),)))


def test_what_is_really_done_counts_in_place_of_what_was_decided():
    first, second = (Knowledge(CAREFUL, TIGER, agent, Always()) for agent in (0, 1))
    for agent in (first, second):
        agent.decide()
    first.act(1)  # opens a door
    assert first.component == 1
    for agent in (first, second):
        agent.observe(0)
    told = first.share(1.0)
    assert told.experiences[0].action == 1
    second.hear(told)
    first.hear(second.share(1.0))
    assert first.belief.tolist() == second.belief.tolist() == [0.5, 0.5]  # the tiger is behind any door again


def test_a_controller_that_is_there_already_is_the_agents_own():
    controller = mdm.Controller(CAREFUL, TIGER)
    knowledge = Knowledge.of(controller, lambda: mdm.Controller(CAREFUL, TIGER), 1, ValueOfCommunication(1.0))
    assert knowledge.own.controller is controller
    assert knowledge.common.controller is not controller
