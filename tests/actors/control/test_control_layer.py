from __future__ import annotations

import figures
import numpy as np
import pytest
from decided import be, decided, ensemble, nothing, see
from hypothesis import given, settings, strategies as st
from sentences import refused

import mdm
from mdm import BeliefTracker, ConfigError, Ensemble, FixedRate, ModelError, ObservationFactor, StateFactor
from mdm.messages import Belief, Control, Observation, State, Tick
from mdm.models import MDP, POMDP
from mdm.policies import AlphaVectors, ConstantPolicy, DeterministicPolicy, QTable, StagedPolicy, StochasticPolicy
from mdm.problems import tiger


@settings(max_examples=40)
@given(st.lists(st.integers(0, 1), max_size=12))
def test_event_driven_pomdp_against_bayes_by_hand(observations):
    decisions, _, _ = decided([see(o) for o in observations])
    belief, model = np.array([0.5, 0.5]), tiger()
    assert len(decisions) == len(observations) + 1
    for epoch, (decision, seen) in enumerate(zip(decisions, [None, *observations], strict=True)):
        if seen is not None:
            likely = np.array([[0.85, 0.15], [0.15, 0.85]] if action == 0 else [[0.5, 0.5]] * 2)[:, seen]  # noqa: F821
            moved = belief if action == 0 else np.array([0.5, 0.5])  # noqa: F821
            belief = moved * likely / (moved * likely).sum()
        action = 1 if belief[1] > 0.9 else 2 if belief[0] > 0.9 else 0
        assert (decision.epoch, decision.action, decision.observation) == (epoch, action, seen)
        np.testing.assert_allclose(decision.belief, belief, atol=1e-12)
        assert decision.reward == pytest.approx(float(belief @ model.rewards[:, action]))
        assert decision.cause == ("start" if seen is None else "observation")


@pytest.mark.parametrize("problem", ["dec_tiger", "grid_small"])
def test_the_original_s_recorded_runs(problem):
    """The same actions, expected rewards and beliefs as the original's live controllers published.

    The original publishes two actions at once at its horizon (25 for the tiger); up to there the runs are compared as
    they are. Ours has exactly 25 decisions in an episode and begins the next one with the stimulus that follows, whose
    observation does not count; so the rest is compared with one more stimulus put in where the original restarted.
    """
    start, steps, horizon = figures.recorded(problem)
    expected, stimuli = [(*start, None)], []
    for seen, published in steps:
        stimuli += [see(seen), *[see(0)] * (len(published) - 1)]
        expected += published
    model = figures.model(problem)
    decisions, _, _ = decided(
        stimuli,
        model=model,
        policy=figures.vectors(problem, 0.9),
        actions=dict.fromkeys(range(len(model.action_space.factors[0])), nothing),
        on_impossible="keep",
        horizon=horizon,
    )
    assert len(decisions) == len(expected)
    for decision, (action, epoch, reward, belief) in zip(decisions, expected, strict=True):
        assert (decision.action, decision.epoch) == (action, epoch)
        assert decision.reward == pytest.approx(reward, abs=1e-6)
        if belief is not None:
            np.testing.assert_allclose(decision.belief, belief, atol=1e-6)


def test_an_mdp_decides_on_each_state_and_publishes_reward():
    model = MDP([np.eye(2)] * 2, [[1.0, 2.0], [3.0, 4.0]], discount=0.9)
    options = {"model": model, "policy": DeterministicPolicy([1, 0]), "actions": dict.fromkeys(range(2), nothing)}
    decisions, _, robot = decided([be(0), be(1), be(1)], **options)
    assert [(d.state, d.action, d.reward, d.epoch) for d in decisions] == [
        (0, 1, 2.0, 0),
        (1, 0, 3.0, 1),
        (1, 0, 3.0, 2),
    ]
    assert robot.control.latency.count == 3


def test_policies_without_a_model():
    table = {"model": None, "actions": {"a": nothing, "b": nothing}}
    decisions, _, _ = decided([be(1)], policy=QTable([[0, 1], [1, 0]]), **table)
    assert [(d.action_name, d.reward) for d in decisions] == [("a", None)]
    draws = [d.action for d in decided([be(0)] * 50, policy=StochasticPolicy([[0.5], [0.5]], seed=3), **table)[0]]
    assert draws == [
        d.action for d in decided([be(0)] * 50, policy=StochasticPolicy([[0.5], [0.5]], seed=3), **table)[0]
    ]
    assert set(draws) == {0, 1}
    decisions, _, _ = decided([be(0)], policy=DeterministicPolicy([1, 0]), rewards=[[1, 2], [3, 4]], **table)
    assert decisions[0].reward == 2


def test_fixed_rate_ticks_on_the_latest_observation():
    steps = [0.1, see(0), 0.3, see(1), see(0), 0.2, 1.0]
    decisions, _, robot = decided(steps, drive=FixedRate(2))
    assert [d.time for d in decisions] == [0, 500_000_000, 1_000_000_000, 1_500_000_000]
    assert [d.observation for d in decisions] == [None, 0, None, None]
    assert [d.epoch for d in decisions] == [0, 1, 2, 3]
    np.testing.assert_allclose(decisions[1].belief, [0.85, 0.15])
    np.testing.assert_allclose(decisions[2].belief, [0.85, 0.15])  # listening moves nothing: prediction only
    assert robot.control.ticks.superseded == 2


@pytest.mark.parametrize(
    ("option", "beliefs"),
    [("predict", [0.5, 0.85, 0.85]), ("repeat", [0.5, 0.85, 0.969799]), ("hear-right", [0.5, 0.85, 0.5])],
)
def test_ticks_without_an_observation(option, beliefs):
    decisions, _, _ = decided([0.1, see(0), 1.0], drive=FixedRate(2), on_no_observation=option)
    assert [d.belief[0] for d in decisions] == pytest.approx(beliefs, abs=1e-5)


def test_ticks_can_be_heard():
    ticks = []

    def listen(robot):
        robot.channel("tick", Tick).subscribe(ticks.append)

    decisions, _, _ = decided([1.2, listen, 1.0], drive=FixedRate(2))
    assert [(tick.time, tick.number, tick.missed) for tick in ticks] == [(1_500_000_000, 3, 0), (2_000_000_000, 4, 0)]
    assert [decision.time for decision in decisions][3:] == [tick.time for tick in ticks]


def test_fixed_rate_mdp_waits_for_a_state():
    options = {"model": None, "policy": DeterministicPolicy([1, 0]), "actions": dict.fromkeys(range(2), nothing)}
    decisions, _, robot = decided([1.2, be(1), 1.0], drive=FixedRate(1), **options)
    assert [(d.time, d.state) for d in decisions] == [(2_000_000_000, 1)]
    assert robot.control.ticks.undecided == 2


def test_event_driven_and_fixed_rate_agree_where_observations_are_ticks():
    seen = [0, 0, 1, 0, 1, 1, 1]
    by_event, _, _ = decided([see(o) for o in seen])
    by_tick, _, _ = decided([0.5, *[step for o in seen for step in (see(o), 1.0)]], drive=FixedRate(1))
    assert [d.action for d in by_event] == [d.action for d in by_tick]
    for one, other in zip(by_event, by_tick, strict=True):
        np.testing.assert_array_equal(one.belief, other.belief)


@pytest.mark.parametrize("horizon", [1, 2, 3])
def test_an_episode_has_exactly_as_many_decisions_as_its_horizon(horizon):
    decisions, _, _ = decided([see(0)] * 7, horizon=horizon)
    assert [d.epoch for d in decisions] == [index % horizon for index in range(8)]
    for decision in decisions:
        if decision.epoch == 0:
            np.testing.assert_array_equal(decision.belief, [0.5, 0.5])
            assert decision.cause in {"start", "episode"}
            assert decision.observation is None


def test_a_horizon_at_a_fixed_rate_and_for_an_mdp():
    decisions, _, _ = decided([3.5], drive=FixedRate(1), horizon=2)
    assert [d.epoch for d in decisions] == [0, 1, 0, 1]
    options = {"model": None, "policy": DeterministicPolicy([1, 0]), "actions": dict.fromkeys(range(2), nothing)}
    decisions, _, _ = decided([be(0), be(1), be(0)], horizon=2, **options)
    assert [(d.epoch, d.cause) for d in decisions] == [(0, "state"), (1, "state"), (0, "episode")]


def test_each_epoch_has_its_stage_of_a_staged_policy():
    staged = StagedPolicy([[[0, 1], [1, 0]], [[1, 0], [0, 1]], [[0, 1], [0, 1]]])
    options = {"model": None, "policy": staged, "actions": dict.fromkeys(range(2), nothing)}
    decisions, _, robot = decided([be(0), be(0), be(1), be(1), lambda robot: robot.reset()], **options)
    assert robot.controller.horizon == 3
    assert [(d.epoch, d.action) for d in decisions] == [(0, 1), (1, 0), (2, 1), (0, 0), (0, 0)]
    decisions, _, _ = decided([be(0), 3.5], drive=FixedRate(1), horizon=2, **options)
    assert [(d.epoch, d.action) for d in decisions] == [(0, 1), (1, 0), (0, 1), (1, 0)]
    with refused(ConfigError):
        ensemble(horizon=4, **options)


def test_a_probability_that_is_no_number_is_reported_as_impossible():
    class Own(BeliefTracker):
        def update(self, action, observation):
            return super().update(action, observation) if observation is None else np.nan

    _, faults, robot = decided([see(0)], tracker=Own(tiger()))
    assert faults == [("impossible_observation", "robot/control")]
    assert robot.controller.impossible == 1


def test_commands_by_method_and_by_message():
    def command(word):
        return lambda robot: robot.channel("control", Control).publish(Control(0, word))

    for stop, start, reset in (
        (lambda r: r.stop(), lambda r: r.start(), lambda r: r.reset()),
        (command("stop"), command("start"), command("reset")),
    ):
        steps = [see(0), stop, see(0), see(0), start, see(0), reset, start]
        decisions, _, robot = decided(steps)
        assert [(d.cause, d.epoch) for d in decisions] == [
            ("start", 0),
            ("observation", 1),
            ("start", 0),
            ("observation", 1),
            ("reset", 0),
        ]
        np.testing.assert_array_equal(decisions[2].belief, [0.5, 0.5])
        assert robot.active is False  # the runtime has ended


def test_resume_keeps_the_belief():
    decisions, _, _ = decided([see(0), lambda r: r.stop(), lambda r: r.start(resume=True)])
    assert decisions[-1].cause == "resume"
    assert decisions[-1].belief[0] == pytest.approx(0.85)


def test_a_stopped_mdp_controller_keeps_its_state_up_to_date():
    options = {"model": None, "policy": DeterministicPolicy([1, 0]), "actions": dict.fromkeys(range(2), nothing)}
    decisions, _, _ = decided([be(0), lambda r: r.stop(), be(1), lambda r: r.start()], **options)
    assert [(d.state, d.cause) for d in decisions] == [(0, "state"), (1, "start")]


def test_an_unknown_state_is_not_decided_on():
    def unknown(robot):
        robot.channel("state", State, retain=True).publish(State(0, None, (None,)))

    options = {"model": None, "policy": DeterministicPolicy([1, 0]), "actions": dict.fromkeys(range(2), nothing)}
    decisions, _, _ = decided([be(0), unknown, be(0)], **options)
    assert [d.state for d in decisions] == [0, 0]


@pytest.mark.parametrize("drive", [None, FixedRate(1)])
def test_a_state_beyond_the_policy_is_reported_and_runs_the_safe_action(drive):
    calls = []
    options = {"model": None, "policy": DeterministicPolicy([1, 0]), "actions": dict.fromkeys(range(2), nothing)}

    def beyond(robot):
        with refused(mdm.ModelError):
            robot.publish_state(7)
        robot.channel("state", State, retain=True).publish(State(0, 7, (7,)))

    decisions, faults, _ = decided(
        [beyond, 0.5, 0.1, be(1), 1.0], drive=drive, safe_action=lambda: calls.append("safe"), **options
    )
    assert ("state", "robot/control") in faults
    assert calls[0] == "safe"
    assert [decision.state for decision in decisions][-1] == 1


def sure(value):
    return lambda robot: robot.publish_belief([value, 1 - value])


def test_external_beliefs_at_once_and_at_the_tick():
    decisions, _, _ = decided([sure(0.95), see(0)])
    assert [(d.cause, d.action) for d in decisions] == [("start", 0), ("belief", 2), ("observation", 0)]
    decisions, _, _ = decided([0.1, see(1), sure(0.95), 0.6, 0.5], drive=FixedRate(2))
    assert [(d.time // 10**6, d.action) for d in decisions] == [(0, 0), (500, 2), (1000, 0)]
    np.testing.assert_array_equal(decisions[1].belief, [0.95, 1 - 0.95])


@pytest.mark.parametrize("belief", [[np.nan, 1], [-0.1, 1.1], [0.5, 0.6], [1.0], [0.2, 0.3, 0.5], [[0.5, 0.5]]])
@pytest.mark.parametrize("channel", ["external_belief", "initial_belief"])
def test_beliefs_that_are_none_are_reported_and_change_nothing(belief, channel):
    def publish(robot):
        robot.channel(channel, Belief, retain=channel == "initial_belief").publish(Belief(0, np.array(belief)))

    decisions, faults, _ = decided([see(0), publish, see(0)])
    assert faults == [("belief", "robot/control")]
    assert [d.belief[0] for d in decisions] == pytest.approx([0.5, 0.85, 0.969799], abs=1e-6)


@pytest.mark.parametrize("belief", [[np.nan, 1], [-0.1, 1.1], [4, 6], [1.0], [0.2, 0.3, 0.5], [[0.5, 0.5]], ["x", 1]])
def test_who_publishes_a_belief_that_is_none_is_told_so(belief):
    def publish(robot):
        for give in (robot.publish_belief, robot.publish_initial_belief):
            with refused(ModelError):
                give(belief)

    decisions, faults, _ = decided([see(0), publish, see(0)])
    assert faults == []
    assert [d.belief[0] for d in decisions] == pytest.approx([0.5, 0.85, 0.969799], abs=1e-6)


def test_the_last_initial_belief_given_begins_the_next_episode():
    decisions, faults, _ = decided(
        [see(0), lambda r: r.publish_initial_belief([0.2, 0.8]), see(0), lambda r: r.reset()]
    )
    assert faults == []
    assert [d.belief[0] for d in decisions] == pytest.approx([0.5, 0.85, 0.969799, 0.2], abs=1e-6)


def certain():
    """A model in which, in the state that is certain, one observation is impossible."""
    return POMDP(
        [np.array([[0.0, 1.0], [0.0, 1.0]])],
        [np.array([[1.0, 0.0], [1.0, 0.0]])],
        [[0.0], [0.0]],
        discount=0.9,
        initial_belief=[0.75, 0.25],
    )


@pytest.mark.parametrize(("option", "after"), [("predict", 0.0), ("keep", 0.75), ("reset", 0.75), ("safe_action", 0.0)])
def test_impossible_observations(option, after):
    calls = []
    options = {"model": certain(), "policy": AlphaVectors([[0.0, 0.0]], [0]), "actions": {0: nothing}}
    decisions, faults, robot = decided(
        [see(1)], on_impossible=option, safe_action=lambda: calls.append("safe"), **options
    )
    assert faults == [("impossible_observation", "robot/control")]
    assert decisions[-1].belief[0] == pytest.approx(after)
    assert robot.controller.impossible == 1
    assert calls == ["safe"] * (2 if option == "safe_action" else 1)  # once at the end of the runtime


def test_unknown_observations_are_reported():
    def unknown(robot):
        with refused(mdm.ModelError):
            robot.publish_observation(7)
        with refused(mdm.ModelError):
            robot.publish_observation("hear-lfet")
        robot.channel("observation", Observation).publish(Observation(0, 7, (7,), (True,)))

    decisions, faults, _ = decided([unknown])
    assert faults == [("observation", "robot/control")]
    assert len(decisions) == 1


def test_missing_components_are_summed_over():
    hear = np.array([[0.85, 0.15], [0.15, 0.85]])
    from mdm.models import Factor, Space

    two = np.stack([np.outer(row, row).ravel() for row in hear])
    model = POMDP(
        [np.eye(2)], [two], [[0.0], [0.0]], discount=0.9, observation_names=Space([Factor("a", 2), Factor("b", 2)])
    )

    def partial(robot):
        robot.channel("observation", Observation).publish(Observation(0, None, (0, None), (True, False)))

    decisions, _, _ = decided([partial], model=model, policy=AlphaVectors([[0.0, 0.0]], [0]), actions={0: nothing})
    assert decisions[-1].belief[0] == pytest.approx(0.85)
    assert decisions[-1].observation == (0, None)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizon": 0}, "horizon: a whole number of decisions of at least 1 was expected, not 0"),
        ({"deadline": 0}, "deadline"),
        ({"on_impossible": "panic"}, "'panic'"),
        ({"on_impossible": "safe_action"}, "there is none"),
        ({"on_no_observation": "hear-lft"}, "'hear-lft'"),
        ({"model": None}, "a policy over beliefs needs a POMDP"),
        ({"model": MDP([np.eye(2)] * 3, np.zeros((2, 3)), discount=0.9)}, "has no observations"),
        ({"policy": AlphaVectors([[0.0] * 3], [0], 3)}, "for 3 states, but the model has 2"),
        ({"policy": AlphaVectors([[0.0] * 2], [0], 4)}, "for 4 actions, but the model has 3"),
        ({"rewards": [[0, 1]]}, "for 1 states and 2 actions"),
        ({"rewards": [[0, np.nan, 1], [0, 0, 0]]}, "in state 0 is nan"),
        ({"drive": lambda: FixedRate(0)}, "rate"),
        ({"initial_belief": [0.5, 0.6]}, "sums to 1.1"),
        ({"actions": {"listen": nothing}}, "'open-left', 'open-right'"),
        ({"actions": {"listen": nothing, "open-lft": nothing}}, "no such action: 'open-lft'; did you mean 'open-left'"),
        ({"actions": {"listen": nothing, 1: nothing}}, "by name or by index, not both"),
        ({"actions": {0: nothing, 1: nothing, 2: 7}}, "not 7"),
        ({"actions": {0: nothing, 1: nothing, 2: lambda a, b: None}}, "asks for a, b"),
        ({"actions": {False: nothing, True: nothing, 2: nothing}}, "by name or by index, not both"),
        ({"actions": [nothing] * 3}, "actions are a mapping"),
        ({"actions": None}, "actions are a mapping"),
        ({"agent": 1}, "no agent 1"),
        ({"agent": None}, "by index or by name, not by None"),
        ({"agent": 3, "policy": [0, 1, 2], "model": None}, "no agent 3: without a model there is one"),
        ({"agent": "x", "policy": [0, 1, 2], "model": None}, "no agent 'x': without a model there is one"),
        ({"local": "yes"}, "local is True or False, not 'yes'"),
        ({"predicates": 5}, "predicates is a PredicateManager, not 5"),
        ({"states": StateFactor("a", ["A"])}, "states is a list of StateFactor"),
        ({"observations": ObservationFactor("a", ["A", "B"])}, "observations is a list of ObservationFactor"),
        ({"observations": [StateFactor("a", ["A"])]}, "observations is a list of ObservationFactor"),
        ({"states": None}, "states is a list of StateFactor.*, not None"),
        ({"supervision": "x"}, "supervision is 'stop', 'escalate' or Restart.*, not 'x'"),
        ({"supervision": 5}, "supervision is 'stop'"),
        ({"deadline": True}, "deadline: a number of seconds above 0 and at most 1,000,000,000 was expected, not true"),
        ({"deadline": "x"}, "deadline: a number of seconds above 0 and at most 1,000,000,000 was expected, not 'x'"),
        ({"on_no_observation": 5}, "on_no_observation: a text was expected, not 5"),
        ({"on_no_observation": None}, "on_no_observation: a text was expected, not None"),
        ({"safe_action": "Stop"}, "there is no action 'Stop' for safe_action; there are "),
    ],
)
def test_wrong_options_are_refused_with_the_key(options, message):
    from mdm import Error

    with pytest.raises(Error, match=message):
        ensemble(**{key: value() if key == "drive" else value for key, value in options.items()})
    if "drive" not in options and "initial_belief" not in options:
        with refused(ConfigError):
            ensemble(**options)


@pytest.mark.parametrize("name", ["", None, 5])
def test_an_ensemble_is_called_by_a_text(name):
    with refused(ConfigError):
        Ensemble(name, policy=[0, 0], actions={0: nothing})


def test_a_wrong_rate_is_told_with_its_key():
    with refused(ConfigError):
        ensemble(drive=-1)


def test_states_may_be_counted_by_integers_of_numpy():
    async def main(runtime):
        robot = Ensemble("robot", policy=[0, 1], actions={0: nothing, 1: nothing})
        with mdm.testing.capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            runtime.channel("robot/state", State, retain=True).publish(State(0, np.int64(1), (1,)))
        return [(decision.state, decision.action) for decision in decisions]

    assert mdm.testing.run_virtual(main) == [(1, 1)]


def test_observations_may_be_counted_by_integers_of_numpy():
    seen = [np.int64(1), np.int32(1)]
    decisions, _, _ = decided([see(index) for index in seen])
    plain, _, _ = decided([see(1), see(1)])
    assert [decision.action for decision in decisions] == [decision.action for decision in plain]
    assert [decision.observation for decision in decisions] == [None, 1, 1]


TWO_EARS = np.array([[0.6, 0.1, 0.2, 0.1], [0.3, 0.2, 0.2, 0.3]])
"""P(gauge, ear | state), of 2 x 2 joint observations in a row."""


def worn_machine():
    """A machine whose observations are a flat list: fine-quiet, fine-loud, bad-quiet, bad-loud."""
    return POMDP(
        [[[0.9, 0.1], [0.0, 1.0]]],
        [TWO_EARS],
        [[0.0], [0.0]],
        discount=0.9,
        initial_belief=[1.0, 0.0],
        observation_names=["fine-quiet", "fine-loud", "bad-quiet", "bad-loud"],
    )


def two_sensors():
    predicates = mdm.PredicateManager()
    for event in ("GaugeFine", "GaugeBad", "Quiet", "Loud"):
        predicates.event(event)
    factors = [ObservationFactor("gauge", ["GaugeFine", "GaugeBad"]), ObservationFactor("ear", ["Quiet", "Loud"])]
    return {"predicates": predicates, "observations": factors}


@pytest.mark.parametrize(
    ("events", "agree"),
    [(("GaugeBad",), (2, 3)), (("Loud",), (1, 3)), (("GaugeFine",), (0, 1)), (("GaugeBad", "Quiet"), (2,))],
)
@pytest.mark.parametrize("drive", ["event", FixedRate(1.0)])
def test_one_of_several_sensors_of_a_flat_model_is_marginalised(events, agree, drive):
    expected = np.array([0.9, 0.1]) * TWO_EARS[:, list(agree)].sum(axis=1)
    decisions, faults, _ = decided(
        [0.5, lambda robot: robot.predicates.occur(*events), 1.0],
        policy=AlphaVectors([[0.0, 0.0]], [0]),
        model=worn_machine(),
        actions={0: nothing},
        drive=drive,
        **two_sensors(),
    )
    assert not faults
    assert decisions[1].belief == pytest.approx(expected / expected.sum())


def test_what_is_refused_is_not_decided_on_at_an_event_and_is_nothing_observed_at_a_tick():
    def unknown(robot):
        robot.channel("observation", Observation).publish(Observation(0, 7, (7,), (True,)))

    options = {"policy": AlphaVectors([[0.0, 0.0]], [0]), "model": worn_machine(), "actions": {0: nothing}}
    decisions, faults, _ = decided([unknown], **options)
    assert (len(decisions), faults) == (1, [("observation", "robot/control")])
    decisions, faults, _ = decided([0.5, unknown, 1.0], **options, drive=FixedRate(1.0))
    assert faults == [("observation", "robot/control")]
    assert (decisions[1].observation, decisions[1].belief) == (None, pytest.approx([0.9, 0.1]))


def test_a_plan_needs_whole_observations_of_a_flat_model():
    plan = mdm.policies.FiniteStateController([0], [[0, 0, 0, 0]], num_actions=1)
    robot = Ensemble("robot", policy=plan, model=worn_machine(), actions={0: nothing}, **two_sensors())
    assert [problem.key for problem in robot.problems()] == [
        "ensembles.robot.observations.gauge",
        "ensembles.robot.observations.ear",
    ]
    assert "give the factor 'idle' or 'hold'" in next(robot.problems()).message


def test_an_action_that_is_not_available_is_a_fault_and_is_not_done():
    """A policy over beliefs is asked for its actions alone: what it chooses is looked at when it chooses it."""
    model = POMDP(
        [[[0, 1], [0, 1]]] * 2,
        [[[1, 0], [0, 1]]] * 2,
        np.zeros((2, 2)),
        discount=0.9,
        available=[[True, True], [True, False]],
        states=["hall", "door"],
        actions=["wait", "walk"],
        initial_belief=[1, 0],
    )
    done = []
    actions = {"wait": lambda: done.append("wait"), "walk": lambda: done.append("walk")}
    options = {"policy": ConstantPolicy(1, 2, 2), "model": model, "actions": actions, "safe_action": "wait"}
    decisions, faults, robot = decided([see(1)], **options)
    assert [decision.action_name for decision in decisions] == ["walk"]
    assert faults == [("policy", "robot/control")]
    assert done == ["walk", "wait", "wait"]  # goes safe, and is so at the end
    with pytest.raises(
        mdm.ModelError, match="the action 'walk' is not available in state 'door'; available are 'wait'"
    ):
        robot.control.controller.decide()
