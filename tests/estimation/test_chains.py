"""Chains: decisions of which each follows from the one before."""

from __future__ import annotations

import asyncio

import pytest
from estimated import decision, nothing, visits

from mdm import Ensemble, ModelError, PredicateManager, StateFactor
from mdm.estimation import Stay, chains_of
from mdm.estimation.chains import BREAKS
from mdm.testing import capture_decisions, run_virtual


def states(chains):
    return [[each.state for each in chain.decisions] for chain in chains.chains]


@pytest.mark.parametrize("cause", sorted(BREAKS))
def test_what_does_not_follow_from_the_decision_before_begins_a_chain(cause):
    first = visits([0, 1, 2])
    then = [decision(3, 3, cause, 4), decision(4, 4, "state", 5)]
    assert states(chains_of(first + then)) == [[0, 1, 2], [4, 5]]


def test_a_lost_decision_begins_a_chain():
    whole = visits([0, 1, 2, 3, 4])
    assert states(chains_of(whole)) == [[0, 1, 2, 3, 4]]
    assert states(chains_of(whole[:2] + whole[3:])) == [[0, 1], [3, 4]]


def test_ticks_that_were_missed_begin_a_chain():
    whole = visits([0, 0, 1, 1, 1, 0], cause="tick", first="tick", times=[0, 1, 2, 3, 5, 6])
    chains = chains_of(whole)
    assert (chains.kind, states(chains)) == ("steps", [[0, 0, 1, 1], [1, 0]])


def test_stays_that_were_moved_late_by_jitter_are_no_missed_ticks():
    whole = visits([0, 0, 1, 1], cause="tick", first="tick", times=[0, 1.2, 2.0, 3.3])
    assert len(chains_of(whole).chains) == 1


def test_jumps_are_stays_in_a_state_until_another_one():
    stays = list(chains_of(visits([0, 1, 0], times=[0, 2, 5])).stays())
    assert stays == [Stay(0, 0, 2.0, 1, True), Stay(1, 0, 3.0, 0, True)]


def test_an_action_decided_again_goes_on_with_the_stay_and_another_one_cuts_it():
    told = [
        decision(0, 0, "start", 0, 1),
        decision(2, 1, "again", 0, 1),
        decision(3, 2, "again", 0, 2),
        decision(7, 3, "state", 1, 1),
    ]
    stays = list(chains_of(told).stays())
    assert stays == [Stay(0, 1, 3.0, None, False), Stay(0, 2, 4.0, 1, True)]


def test_an_action_decided_again_at_a_fixed_rate_is_that_of_its_step():
    told = [decision(0, 0, "tick", 0, 1), decision(0.5, 1, "again", 0, 2), decision(1, 2, "tick", 1, 1)]
    assert list(chains_of(told).stays()) == [Stay(0, 2, 1.0, 1, True)]


def test_a_reset_cuts_a_stay_short_and_the_end_of_an_episode_leaves_it_out():
    told = [*visits([0, 1]), decision(4, 0, "reset", 1), decision(6, 1, "state", 0), decision(7, 0, "episode", 1)]
    stays = list(chains_of(told).stays())
    assert stays == [Stay(0, 0, 1.0, 1, True), Stay(1, 0, 3.0, None, False), Stay(1, 0, 2.0, 0, True)]


def test_the_time_of_a_stop_cuts_a_stay_short():
    told = [*visits([0, 1]), decision(100, 0, "start", 0)]
    second = 1_000_000_000
    stays = list(chains_of(told, stops=[110 * second, 5 * second]).stays())
    assert stays == [Stay(0, 0, 1.0, 1, True), Stay(1, 0, 4.0, None, False), Stay(0, 0, 10.0, None, False)]


def test_a_world_that_tells_each_step_makes_steps_where_that_is_said():
    told = visits([0, 0, 1])
    assert list(chains_of(told).stays()) == [Stay(0, 0, 2.0, 1, True)]
    assert list(chains_of(told, kind="steps").stays()) == [Stay(0, 0, 1.0, 0, True), Stay(0, 0, 1.0, 1, True)]


def test_decisions_on_observations_are_steps_of_hidden_states():
    told = [decision(0, 0, "start"), decision(1, 1, "observation", observation=1)]
    chains = chains_of(told)
    assert (chains.kind, chains.hidden, chains.decisions) == ("steps", True, 2)
    with pytest.raises(ModelError, match="decides on observations: each is a step"):
        chains_of(told, kind="jumps")


def test_what_a_team_decided_is_left_out_and_counted():
    told = [*visits([0, 1]), decision(2, 2, "team"), decision(3, 3, "state", 0)]
    chains = chains_of(told)
    assert (states(chains), chains.discarded) == ([[0, 1], [0]], 1)


def test_one_of_several_ensembles_has_to_be_named():
    told = visits([0, 1]) + visits([2, 3], ensemble="robot/arm")
    with pytest.raises(ModelError, match="name one of robot, robot/arm"):
        chains_of(told)
    with pytest.raises(ModelError, match="no ensemble 'leg' has decided; there is robot, robot/arm"):
        chains_of(told, ensemble="leg")
    assert states(chains_of(told, ensemble="robot/arm")) == [[2, 3]]
    with pytest.raises(ModelError, match="there are no decisions"):
        chains_of([])


def test_a_robot_s_own_decisions_make_chains():
    predicates = PredicateManager()
    door = predicates.sensor("Open")
    robot = Ensemble(
        "robot",
        policy=[0, 1],
        predicates=predicates,
        states=[StateFactor("door", ["Open"])],
        actions={"knock": nothing, "go": nothing},
    )

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            for seconds, value in ((1, False), (2, True), (3, False)):
                door.set(value)
                await asyncio.sleep(seconds)
            robot.reset()
            await asyncio.sleep(4)
            end = runtime.clock.now()
        return chains_of(decisions, stops=[end])

    chains = run_virtual(main)
    assert (chains.ensemble, chains.kind, states(chains)) == ("robot", "jumps", [[0, 1, 0], [0]])
    assert list(chains.stays()) == [
        *(Stay(0, 0, 1.0, 1, True), Stay(1, 1, 2.0, 0, True)),
        *(Stay(0, 0, 3.0, None, False), Stay(0, 0, 4.0, None, False)),
    ]
