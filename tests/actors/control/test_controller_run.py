"""Control layers that run finite-state controllers, in virtual time."""

from __future__ import annotations

import asyncio

import figures
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sentences import refused

import mdm
from mdm import ConfigError, Ensemble, FixedRate, ObservationFactor, PredicateManager, bind
from mdm.messages import Belief, Observation, Reward
from mdm.policies import AlphaVectors, DeterministicPolicy, FiniteStateController, JointController
from mdm.problems import dec_tiger, tiger
from mdm.testing import capture_decisions, probe, run_virtual

PLAN = FiniteStateController([0, 1, 2], [[1, 2], [None, None], [None, None]], 3)
ROUND = FiniteStateController([0, 1], [[1, 0], [0, None]], 2)
TEAM = JointController([PLAN, ROUND])


def nothing():
    pass


def decided(policy, *steps, **options):
    """Return the decisions and faults of an ensemble under a script: calls with it, or seconds."""

    async def main(runtime):
        actions = options.pop("actions", dict.fromkeys(range(policy.num_actions), nothing))
        robot = Ensemble("robot", policy=policy, actions=actions, **options)
        faults = probe(runtime.faults)
        beliefs = probe(runtime.channel("robot/belief", Belief, retain=True))
        rewards = probe(runtime.channel("robot/reward", Reward, retain=True))
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            for step in steps:
                if isinstance(step, int | float):
                    await asyncio.sleep(step)
                else:
                    step(robot)
        assert beliefs == rewards == []
        assert all(decision.belief is decision.state is decision.reward is None for decision in decisions)
        return [(d.epoch, d.cause, d.observation, d.action) for d in decisions], faults

    return run_virtual(main)


def see(index):
    return lambda robot: robot.publish_observation(index)


def see_parts(*values):
    def publish(robot):
        mask = tuple(value is not None for value in values)
        robot.channel("observation", Observation).publish(Observation(0, None, values, mask))

    return publish


def believe(*numbers, channel="external_belief"):
    """Publish a belief as another program does, by its channel."""
    message = Belief(0, np.array(numbers))
    return lambda robot: robot.channel(channel, Belief, retain=channel == "initial_belief").publish(message)


# -- From node to node ---------------------------------------------------------------------------------------------


def test_it_decides_at_start_and_moves_by_each_observation():
    decisions, faults = decided(ROUND, see(0), see(0), see(1))
    assert decisions == [
        (0, "start", None, 0),
        (1, "observation", 0, 1),
        (2, "observation", 0, 0),
        (3, "observation", 1, 0),
    ]
    assert faults == []


def test_the_end_of_a_plan_ends_the_episode_as_a_horizon_does():
    decisions, faults = decided(PLAN, see(1), see(0), see(0))
    assert decisions == [
        (0, "start", None, 0),
        (1, "observation", 1, 2),
        (0, "episode", None, 0),
        (1, "observation", 0, 1),
    ]
    assert faults == []


def test_a_horizon_may_end_it_earlier():
    decisions, _ = decided(PLAN, see(1), see(0), horizon=1)
    assert [(epoch, cause, action) for epoch, cause, _, action in decisions] == [
        (0, "start", 0),
        (0, "episode", 0),
        (0, "episode", 0),
    ]


@pytest.mark.parametrize(("choice", "after"), [("predict", 1), ("keep", 1), ("reset", 0), ("safe_action", 1)])
def test_an_observation_without_an_edge_is_impossible(choice, after):
    safe = []
    decisions, faults = decided(
        ROUND,
        see(0),
        see(1),
        on_impossible=choice,
        safe_action=lambda: safe.append(1),
    )
    assert decisions[-1] == (2, "observation", 1, after)
    assert [(fault.kind, fault.source) for fault in faults] == [("impossible_observation", "robot/control")]
    assert "observation '1' after action '1' has no edge at the nodes (1,)" in faults[0].detail
    assert len(safe) == 1 + (choice == "safe_action")  # it runs when the runtime ends, too


def test_an_observation_that_there_is_not_is_reported_and_nothing_is_decided_on_it():
    def unknown(robot):
        with refused(mdm.ModelError):
            robot.publish_observation(7)
        robot.channel("observation", Observation).publish(Observation(0, 7, (7,), (True,)))

    decisions, faults = decided(ROUND, see(0), unknown)
    assert decisions[-1] == (1, "observation", 0, 1)
    assert [(fault.kind, fault.detail) for fault in faults] == [
        ("observation", "there is no symbol 7; the 2 symbols count from 0; it is not taken in")
    ]


def test_reset_begins_again_and_resume_goes_on():
    stop, start, reset = (lambda robot: robot.stop()), (lambda robot: robot.start()), (lambda robot: robot.reset())
    resume = lambda robot: robot.start(resume=True)
    decisions, _ = decided(ROUND, see(0), stop, see(0), resume, stop, start, see(0), reset)
    assert [(cause, action) for _, cause, _, action in decisions] == [
        ("start", 0),
        ("observation", 1),
        ("resume", 1),
        ("start", 0),
        ("observation", 1),
        ("reset", 0),
    ]


def test_a_plan_that_was_at_its_end_resumes_at_its_start():
    decisions, _ = decided(PLAN, see(1), lambda robot: robot.stop(), lambda robot: robot.start(resume=True), see(0))
    assert [(cause, action) for _, cause, _, action in decisions[2:]] == [("resume", 0), ("observation", 1)]


# -- At a fixed rate -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("choice", "actions"),
    [("predict", [0, 1, 1, 1, 0]), ("repeat", [0, 1, 0, 1, 0]), ("0", [0, 1, 0, 1, 0]), ("1", [0, 1, 1, 1, 0])],
)
def test_ticks_without_an_observation(choice, actions):
    # seen before the second tick and before the last
    decisions, _ = decided(ROUND, 0.05, see(0), 0.3, see(0), 0.1, drive=FixedRate(10), on_no_observation=choice)
    assert [action for *_, action in decisions] == actions
    assert {cause for _, cause, *_ in decisions} == {"tick"}


def test_a_plan_at_a_fixed_rate_begins_again_at_the_tick_after_its_end():
    decisions, faults = decided(PLAN, 0.05, see(1), 0.3, drive=FixedRate(10))
    assert [(epoch, cause, action) for epoch, cause, _, action in decisions] == [
        (0, "tick", 0),
        (1, "tick", 2),
        (0, "episode", 0),
        (1, "tick", 0),
    ]
    assert faults == []


# -- Beliefs -------------------------------------------------------------------------------------------------------

KNOWN = FiniteStateController([0, 1], [[0, 1], [0, 1]], values=[[1, 0], [0, 1]])


def test_a_belief_means_nothing_where_the_nodes_values_are_not_known():
    initial = believe(0.5, 0.5, channel="initial_belief")
    decisions, faults = decided(ROUND, see(0), believe(0.5, 0.5), initial, see(1))
    assert [action for *_, action in decisions] == [0, 1, 1]
    assert [fault.kind for fault in faults] == ["belief", "belief", "impossible_observation"]
    assert "refused a belief on robot/external_belief: the nodes of the plan have no values" in faults[0].detail
    with refused(ConfigError):
        Ensemble("robot", policy=ROUND, actions={0: nothing, 1: nothing}, initial_belief=[1, 0])


def test_beliefs_choose_the_node_where_values_are_known():
    initial = lambda robot: robot.publish_initial_belief([1, 0])
    reset = lambda robot: robot.reset()
    decisions, faults = decided(
        KNOWN, believe(0.9, 0.1), believe(np.nan, 1), initial, see(1), reset, initial_belief=[0.2, 0.8]
    )
    assert [(cause, action) for _, cause, _, action in decisions] == [
        ("start", 1),
        ("belief", 0),
        ("observation", 1),
        ("reset", 0),
    ]
    assert [fault.kind for fault in faults] == ["belief"]


def test_the_initial_belief_changes_no_present_node():
    initial = lambda robot: robot.publish_initial_belief([1, 0])
    stays = FiniteStateController([0, 1], [[0], [1]], values=[[1, 0], [0, 1]])
    decisions, _ = decided(stays, initial, see(0), initial_belief=[0.2, 0.8])
    assert [action for *_, action in decisions] == [1, 1]


def test_an_outside_belief_at_a_fixed_rate_is_decided_on_at_the_tick():
    last = FiniteStateController([0, 1], [[0], [None]], values=[[1, 0], [0, 1]])
    decisions, _ = decided(last, 0.05, believe(0, 1), 0.2, drive=FixedRate(10), initial_belief=[1, 0])
    assert [(epoch, cause, action) for epoch, cause, _, action in decisions] == [
        (0, "tick", 0),
        (1, "tick", 1),
        (0, "episode", 0),
    ]


@settings(max_examples=20)
@given(st.lists(st.integers(0, 1), max_size=12))
def test_an_optimal_graph_decides_as_its_value_function_does(seen):
    model, graph = tiger(), figures.tiger_plan()
    vectors = AlphaVectors(graph.values, graph.actions)
    stimuli = [see(index) for index in seen]
    by_node, _ = decided(graph, *stimuli, model=model)

    async def main(runtime):
        robot = Ensemble("robot", policy=vectors, model=model, actions=dict.fromkeys(range(3), nothing))
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            for stimulus in stimuli:
                stimulus(robot)
        return [decision.action for decision in decisions]

    assert [action for *_, action in by_node] == run_virtual(main)


# -- Teams ---------------------------------------------------------------------------------------------------------


def test_a_team_moves_each_agent_by_its_own_part():
    decisions, faults = decided(JointController([ROUND, ROUND]), see(1), see_parts(0, None), see_parts(None, None))
    assert [action for *_, action in decisions] == [0, 2, 0, 0]
    assert faults == []


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 1)), max_size=8), st.data())
@settings(max_examples=30)
def test_agents_alone_do_what_the_team_does_together(seen, data):
    nodes = st.integers(0, 2)
    row = st.lists(nodes, min_size=2, max_size=2)
    one, other = (
        FiniteStateController(
            data.draw(st.lists(st.integers(0, 1), min_size=3, max_size=3)),
            data.draw(st.lists(row, min_size=3, max_size=3)),
            2,
        )
        for _ in range(2)
    )
    team = JointController([one, other])
    together, _ = decided(team, *(see(2 * first + second) for first, second in seen))
    alone = [
        decided(team, *(see(parts[agent]) for parts in seen), agent=agent, local=True, actions={0: nothing, 1: nothing})
        for agent in range(2)
    ]
    pairs = zip(alone[0][0], alone[1][0], strict=True)
    assert [action for *_, action in together] == [2 * first[-1] + second[-1] for first, second in pairs]


def test_an_agent_of_a_model_goes_by_its_own_names_and_events():
    model = dec_tiger()
    listen_then_open = FiniteStateController([0, 1, 2], [[2, 1], [None, None], [None, None]], 3)
    team = JointController([FiniteStateController([0, 0, 0], [[1, 2]] * 3, 3), listen_then_open])
    names = model.action_space.factors[1].names
    seen = model.observation_space.factors[1].names
    done = []

    async def main(runtime):
        predicates = PredicateManager()
        for name in seen:
            predicates.event(name)
        robot = Ensemble(
            "robot",
            policy=team,
            model=model,
            agent=model.action_space.factors[1].name,
            local=True,
            predicates=predicates,
            observations=[ObservationFactor("ear", seen)],
            actions={name: bind(lambda name=name: done.append(name)) for name in names},
        )
        assert "a finite-state controller, 3 nodes, 3 actions" in robot.tree()
        await runtime.start(robot)
        predicates.occur(seen[1])
        assert robot.controller.nodes == (1,)

    run_virtual(main)
    assert done == [names[0], names[1]]


def test_a_whole_team_is_run_under_the_scope_of_each_agent():
    model = dec_tiger()
    team = JointController([FiniteStateController([2], [[0, 0]], 3), FiniteStateController([1], [[0, 0]], 3)])
    done = []

    def carried_out(agent):
        async def main(runtime):
            actions = {index: lambda index=index: done.append((agent, index)) for index in range(3)}
            await runtime.start(Ensemble("robot", policy=team, model=model, agent=agent, actions=actions))

        run_virtual(main)

    carried_out(0)
    carried_out(1)
    assert done == [(0, 2), (1, 1)]


# -- Refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"policy": PLAN, "local": True}, "one controller for the whole team, not one for each agent"),
        ({"policy": TEAM, "local": True, "agent": 2}, "there is no agent 2; the model has 2"),
        ({"policy": TEAM, "local": True, "agent": "a"}, "without a model agents have indices only"),
        ({"policy": PLAN, "rewards": [[0, 0, 0]]}, "a plan has no belief to expect rewards by"),
        ({"policy": PLAN, "false_negative": 0}, "false negatives need a POMDP"),
        ({"policy": PLAN, "on_no_observation": "x"}, "on_no_observation is 'predict', 'repeat' or"),
        (
            {"policy": ROUND, "actions": {"a": nothing}},
            "the policy has 2 actions, but one is bound (a): each needs one, in order",
        ),
    ],
)
def test_what_does_not_fit_is_refused(options, words):
    given_ = {"actions": dict.fromkeys(range(3), nothing)} | options
    with pytest.raises(ConfigError) as caught:
        Ensemble("robot", **given_)
    assert words in str(caught.value)


def test_controllers_are_compared_with_their_model():
    model = dec_tiger()
    actions = dict.fromkeys(range(3), nothing)
    with refused(ConfigError):
        Ensemble("robot", policy=TEAM, model=model, actions=actions)
    with refused(ConfigError):
        Ensemble("robot", policy=PLAN, model=model, actions=actions)


def test_a_table_has_no_part_that_is_one_agents_own():
    with refused(ConfigError):
        Ensemble("robot", policy=DeterministicPolicy([0], 1), actions={0: nothing}, local=True)


def test_observation_factors_are_compared_with_the_controller():
    async def main(runtime):
        predicates = PredicateManager()
        names = ["a", "b", "c"]
        for name in names:
            predicates.event(name)
        observations = [ObservationFactor("o", names)]
        actions = {0: nothing, 1: nothing}
        robot = Ensemble("robot", policy=ROUND, actions=actions, predicates=predicates, observations=observations)
        return [str(problem) for problem in robot.problems()]

    (problem,) = run_virtual(main)
    assert "observation" in problem
