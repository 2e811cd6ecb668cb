"""The controller: the original's recorded runs without a runtime; snapshots and digests; names; what is refused."""

from __future__ import annotations

import json
import subprocess
import sys

import figures
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from places import EXAMPLES
from random_models import flat_models
from sentences import refused
from trackers import Halving

import mdm
from mdm.beliefs import BeliefTracker
from mdm.controller import Controller
from mdm.errors import ModelError, PolicyError
from mdm.policies import (
    AlphaVectors,
    BeliefPolicy,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    QTable,
    RandomPolicy,
    StagedPolicy,
    StatePolicy,
    StochasticPolicy,
)
from mdm.problems import dec_tiger, tiger

PLAN = FiniteStateController([0, 1, 2], [[1, 2], [None, None], [None, None]], 3)


@pytest.mark.parametrize("problem", ["dec_tiger", "grid_small"])
def test_the_original_s_recorded_runs(problem):
    """The actions, epochs, expected rewards and beliefs of the original's live controllers, by plain calls."""
    start, steps, horizon = figures.recorded(problem)
    options = {"on_impossible": "keep", "horizon": horizon}
    controller = Controller(figures.vectors(problem, 0.9), figures.model(problem), **options)
    found, expected = [(controller.start(), controller.belief)], [(*start, None)]
    for seen, published in steps:
        # The original decides twice at its horizon; ours begins an episode with one more stimulus.
        stimuli = [seen, *[0] * (len(published) - 1)]
        found += [(controller.observe(observation), controller.belief) for observation in stimuli]
        expected += published
    assert len(found) == len(expected)
    for (step, belief), (action, epoch, reward, theirs) in zip(found, expected, strict=True):
        assert (step.action, step.epoch) == (action, epoch)
        assert step.reward == pytest.approx(reward, abs=1e-6)
        if theirs is not None:
            np.testing.assert_allclose(belief, theirs, atol=1e-6)


def test_names_wherever_indices_go():
    controller = Controller(EXAMPLES / "tiger.vf", EXAMPLES / "tiger.pomdp")
    first = controller.start()
    assert (first.epoch, first.action_name, first.reward, first.probability) == (0, "listen", -1.0, None)
    step = controller.observe("hear-left")
    assert (step.epoch, step.action_name, step.probability) == (1, "listen", 0.5)
    np.testing.assert_allclose(controller.belief, [0.85, 0.15])
    assert controller.start("tiger-left").action_name == "open-right"
    controller.begin_from("tiger-right")
    assert controller.start().action_name == "open-left"
    states = Controller([1, 0], mdm.models.MDP([np.eye(2)] * 2, np.zeros((2, 2)), discount=0.9, states=["low", "full"]))
    assert states.see("full").action == 0
    assert states.start("low").action == 1


def test_time_that_passes_moves_the_belief():
    model = mdm.models.POMDP([[[0.5, 0.5], [0, 1]]], [np.eye(2)], np.zeros((2, 1)), discount=0.9, initial_belief=[1, 0])
    controller = Controller(AlphaVectors([[0, 0]], [0]), model)
    controller.start()
    assert controller.observe(None).probability == 1
    np.testing.assert_allclose(controller.belief, [0.5, 0.5])


@pytest.mark.parametrize(("choice", "belief"), [("predict", [0, 1]), ("keep", [1, 0]), ("reset", [0.5, 0.5])])
def test_an_impossible_observation(choice, belief):
    move = [[0, 1], [1, 0]]
    model = mdm.models.POMDP([move], [np.eye(2)], np.zeros((2, 1)), discount=0.9, observation_names=["dark", "light"])
    controller = Controller(AlphaVectors([[0, 0]], [0]), model, on_impossible=choice)
    controller.start([1, 0])
    step = controller.observe("dark")
    assert (step.probability, controller.impossible) == (0.0, 1)
    assert controller.problem == (
        f"observation 'dark' after action '0' has probability 0 under the model and the belief; "
        f"on_impossible is {choice!r}"
    )
    np.testing.assert_allclose(controller.belief, belief)


def test_an_episode_has_its_horizon_and_the_next_begins_anew():
    controller = Controller(figures.vectors("dec_tiger", 0.9), dec_tiger(), horizon=2)
    steps = [controller.start(), controller.observe(0), controller.observe(0)]
    assert [step.epoch for step in steps] == [0, 1, 0]
    np.testing.assert_allclose(controller.belief, [0.5, 0.5])  # what was observed in between does not count
    plan = Controller(PLAN)
    assert [plan.start().action, plan.observe(1).action] == [0, 2]
    assert plan.over
    assert plan.observe(0).epoch == 0
    stages = Controller(StagedPolicy([[[0, 1]], [[1, 0]]]))
    assert [stages.see(0).action for _ in range(5)] == [1, 0, 1, 0, 1]


def test_a_team_s_plan_as_a_whole_and_by_each_agent():
    team = JointController([PLAN, PLAN])
    whole, alone = Controller(team), Controller(team, agent=1)
    assert whole.start().action == 0
    assert alone.start().action == 0
    assert whole.observe((1, 0)).action == 2 * 3 + 1
    assert alone.observe(0).action == 1
    assert (whole.nodes, alone.nodes) == ((2, 1), (1,))


def policies(draw, states, actions, kind):
    seed = draw(st.integers(0, 99))
    random = np.random.default_rng(seed)
    if kind == "state":
        return draw(
            st.sampled_from(
                [
                    DeterministicPolicy(random.integers(actions, size=states).tolist(), actions),
                    QTable(random.normal(size=(states, actions))),
                    StochasticPolicy(random.dirichlet(np.ones(actions), size=states).T, seed=seed),
                    StagedPolicy(random.normal(size=(3, states, actions))),
                    RandomPolicy(actions, states, seed=seed, input="state"),
                ]
            )
        )
    vectors = AlphaVectors(random.normal(size=(5, states)), random.integers(actions, size=5).tolist(), actions)
    return draw(st.sampled_from([vectors, RandomPolicy(actions, states, seed=seed)]))


@given(st.data())
@settings(max_examples=60)
def test_any_interleaving_of_steps_snapshots_and_restores(data):
    """What is restored decides and is digested as what went on, however steps and snapshots alternate."""
    model = data.draw(flat_models(kinds=("POMDP",)))
    kind = data.draw(st.sampled_from(["state", "belief"]))
    policy = policies(data.draw, len(model.state_space), len(model.action_space), kind)
    one, other = Controller(policy, model), Controller(policy, model)
    symbols = len(model.state_space) if kind == "state" else len(model.observation_space)

    def step(controller, symbol):
        found = controller.see(symbol) if kind == "state" else controller.observe(symbol)
        return found, controller.digest()

    # (A policy without a seed draws what is its own: the second begins where the first does.)
    other.restore(one.snapshot())
    marks = []
    for _ in range(data.draw(st.integers(1, 12))):
        match data.draw(st.sampled_from(["step", "step", "mark", "back"])):
            case "step":
                symbol = data.draw(st.integers(0, symbols - 1))
                assert step(one, symbol) == step(other, symbol)
            case "mark":
                marks.append((one.snapshot(), one.digest()))
            case "back" if marks:
                mark, digest = data.draw(st.sampled_from(marks))
                one.restore(mark)
                other = Controller(policy, model)
                other.restore(mark)
                assert one.digest() == other.digest() == digest


@given(st.data())
@settings(max_examples=60)
def test_a_controller_goes_back_to_any_mark(data):
    """From a mark the same calls give the same steps, and the same counts, any number of times."""
    model = data.draw(flat_models(kinds=("POMDP",)))
    policy = policies(data.draw, len(model.state_space), len(model.action_space), "belief")
    controller = Controller(policy, model, horizon=data.draw(st.sampled_from([None, 4])))
    inputs = data.draw(st.lists(st.none() | st.integers(0, len(model.observation_space) - 1), min_size=2, max_size=8))
    marks, digests, found = [], [], [controller.start()]
    for symbol in inputs:
        marks.append(controller.mark())
        digests.append((controller.digest(), controller.impossible, controller.problem))
        found.append(controller.observe(symbol))
    for _ in range(3):
        begin = data.draw(st.integers(0, len(inputs) - 1))
        controller.go_back(marks[begin])
        assert (controller.digest(), controller.impossible, controller.problem) == digests[begin]
        assert [controller.observe(symbol) for symbol in inputs[begin:]] == found[begin + 1 :]


PROGRAM = """
import json, sys
import mdm
policy, model, snapshot = sys.argv[1:]
controller = mdm.Controller(policy, model)
controller.restore(bytes.fromhex(snapshot))
found = [(controller.observe(o).action, controller.digest()) for o in (0, 0, 1, None, 1)]
print(json.dumps(found))
"""


def test_a_snapshot_goes_on_in_another_process():
    files = str(EXAMPLES / "tiger.vf"), str(EXAMPLES / "tiger.pomdp")
    controller = Controller(*files)
    controller.start()
    controller.observe("hear-left")
    snapshot = controller.snapshot().hex()
    here = [[controller.observe(o).action, controller.digest()] for o in (0, 0, 1, None, 1)]
    there = subprocess.run(
        [sys.executable, "-c", PROGRAM, *files, snapshot], capture_output=True, text=True, check=True
    )
    assert json.loads(there.stdout) == here


def test_digests_differ_where_controllers_do():
    def digest(policy="tiger.vf", model=None, **options):
        return Controller(EXAMPLES / policy, tiger() if model is None else model, **options).digest()

    seen = [
        digest(),
        digest(model=tiger(discount=0.9)),
        digest(horizon=3),
        digest(on_impossible="keep"),
        digest(initial_belief=[0.4, 0.6]),
        Controller(QTable([[0, 1], [1, 0]])).digest(),
        Controller(QTable([[0, 1], [1, 0.5]])).digest(),
    ]
    assert len(set(seen)) == len(seen)
    assert digest() == seen[0]
    moved = Controller(EXAMPLES / "tiger.vf", tiger())
    moved.start()
    assert moved.digest() != seen[0]


def test_a_tracker_of_one_s_own():
    controller = Controller(EXAMPLES / "tiger.vf", tiger(), tracker=Halving())
    assert controller.start().reward == -1
    controller.observe(0)
    np.testing.assert_allclose(controller.belief, [0.75, 0.25])
    snapshot = controller.snapshot()
    again = controller.observe(1)
    controller.restore(snapshot)
    assert controller.observe(1) == again


def test_names_and_components_for_plans_and_trackers_of_one_s_own():
    """What is told by name reaches plans and trackers as indices."""
    team = Controller(JointController([FiniteStateController([0, 1], [[0, 1]] * 2, 3)] * 2), dec_tiger())
    team.start()
    assert team.observe(("hear-left", "hear-right")).action == 1
    assert team.observe(("hear-right", None)).action == 3 + 1
    assert team.observe("hear-left hear-left").action == 0
    alone = Controller(JointController([FiniteStateController([0, 1], [[0, 1]] * 2, 3)] * 2), dec_tiger(), agent=0)
    alone.start()
    assert alone.observe("hear-right").action == 1
    own = Controller(EXAMPLES / "tiger.vf", tiger(), tracker=Halving())
    own.start()
    own.observe("hear-left")
    np.testing.assert_allclose(own.belief, [0.75, 0.25])
    for wrong in (-1, "bogus", 2, True, 0.0):
        with refused(mdm.ModelError):
            own.observe(wrong)


def test_what_a_user_holds_is_not_written_to_and_not_looked_at_again():
    belief = np.array([0.9, 0.1])
    controller = Controller(EXAMPLES / "tiger.vf", tiger(), initial_belief=belief)
    belief[:] = [0.2, 0.8]
    controller.start()
    np.testing.assert_allclose(controller.belief, [0.9, 0.1])
    policy = RandomPolicy(3, 2, seed=5)
    Controller(policy, tiger(), seed=1)
    drawn, expected = Controller(policy, tiger()), Controller(RandomPolicy(3, 2, seed=5), tiger())
    assert [drawn.start().action for _ in range(9)] == [expected.start().action for _ in range(9)]


def test_a_search_draws_by_the_belief_and_keeps_nothing():
    """Restored, it decides the same; two that share a search do not disturb each other; its limits are digested."""
    model = figures.model("grid_small")

    def controller(**options):
        limits = {"expansions": 20, "particles": 1, "seed": 3} | options
        return Controller(mdm.solvers.TreeSearch(model, **limits), model)

    one = controller()
    one.start()
    snapshot = one.snapshot()
    first = [one.observe(None).action for _ in range(4)]
    one.restore(snapshot)
    assert [one.observe(None).action for _ in range(4)] == first
    assert len({controller().digest(), controller(seed=4).digest(), controller(expansions=21).digest()}) == 3


def test_a_start_that_is_refused_changes_nothing():
    controller = Controller(EXAMPLES / "tiger.vf", tiger())
    controller.start()
    controller.observe(0)
    before = controller.digest()
    with pytest.raises(mdm.ModelError):
        controller.start([2, 2])
    assert controller.digest() == before


def test_a_state_that_is_not_seen_again_stays():
    controller = Controller([0, 1, 1], horizon=2)
    with refused(mdm.ModelError):
        controller.observe()
    with refused(mdm.ModelError):
        controller.advance(7)
    assert [controller.see(1).action, controller.observe().action, controller.observe().epoch] == [1, 1, 0]


class Minus(StatePolicy):
    num_states, num_actions = 2, 3

    def action(self, state):
        return (-1, 1.5)[state]


def test_no_action_that_is_none_is_decided():
    controller = Controller(Minus())
    with refused(mdm.ModelError):
        controller.see(0)
    with refused(mdm.ModelError):
        controller.see(1)


class Cautious(BeliefPolicy):
    num_states, num_actions = 2, 3

    def action(self, belief):
        return 0 if belief.max() < 0.9 else 1 + int(belief.argmax() == 0)


def test_a_policy_of_one_s_own():
    controller = Controller(Cautious(), EXAMPLES / "tiger.pomdp")
    assert [controller.start().action_name, *(controller.observe(0).action_name for _ in range(2))] == [
        "listen",
        "listen",
        "open-right",
    ]


class Half:
    num_actions = 2

    def action(self, x):
        return 0


@pytest.mark.parametrize(
    ("policy", "model", "options", "words"),
    [
        (Half(), None, {}, "the policy Half has no information: derive it from StatePolicy or BeliefPolicy"),
        (QTable, None, {}, "not the class QTable: give an instance of it"),
        (7, None, {}, "a policy is an object of mdm.policies, the path of a file, a list"),
        ([0.5, 1.5], None, {}, "a policy is an object of mdm.policies"),
        (Cautious(), None, {}, "needs a POMDP to track the belief, but there is none"),
        (Cautious(), 7, {}, "a model is an MDP or POMDP, or the path of a file, not 7"),
        ([0, 1], None, {"horizn": 3}, "there is no option 'horizn'; did you mean 'horizon'?"),
        ([0, 1], None, {"horizon": 0}, "horizon: a whole number of decisions of at least 1 was expected, not 0"),
        ([0, 1], None, {"horizon": 2.5}, "horizon: a whole number of decisions of at least 1 was expected, not 2.5"),
        ([0, 1], None, {"on_impossible": "ignore"}, "'ignore' is not one of 'predict', 'keep', 'reset', 'safe_action'"),
        ([0, 1], None, {"tracker": Halving()}, "a tracker needs a policy over beliefs"),
        ([0, 1], None, {"seed": 1}, "a seed is for policies that draw"),
        (
            RandomPolicy(2, 2, input="state"),
            None,
            {"seed": "x"},
            "seed: a whole number of at least 0 was expected, not 'x'",
        ),
        (Cautious(), EXAMPLES / "tiger.pomdp", {"tracker": Halving}, "not the class Halving: make one of it"),
        (Cautious(), EXAMPLES / "tiger.pomdp", {"rewards": "x"}, "rewards are a states x actions array of numbers"),
        ([0, 1], None, {"initial_belief": [0.5, 0.5]}, "it takes no belief"),
        (PLAN, None, {"rewards": [[0, 0, 0]]}, "a plan has no belief to expect rewards by"),
        (PLAN, None, {"agent": 0}, "one controller for the whole team"),
        ([0, 1], None, {"agent": 0}, "decides for the whole team"),
    ],
)
def test_what_does_not_fit_is_refused(policy, model, options, words):
    with pytest.raises(mdm.ConfigError) as caught:
        Controller(policy, model, **options)
    assert words in str(caught.value)


def test_what_cannot_be_told_is_refused():
    states, beliefs = Controller([0, 1]), Controller(EXAMPLES / "tiger.vf", tiger())
    for call, words in (
        (lambda: states.observe(0), "decides on states, not on observations"),
        (states.start, "give the state to start at"),
        (lambda: states.see(2), "there is no state 2"),
        (lambda: states.see(-1), "there is no state -1"),
        (lambda: states.see("full"), "without a model states have no names"),
        (lambda: states.see(1.7), "1.7 is not a state: give its index"),
        (lambda: states.see(True), "True is not a state"),
        (lambda: beliefs.believe({}), "the belief"),
        (lambda: beliefs.start(["tiger-left"]), "the belief"),
        (lambda: beliefs.observe(1.0), "1.0 is not a symbol: give a name, an index"),
        (lambda: beliefs.see(0), "decides on observations, not on states"),
        (lambda: beliefs.start([0.5, 0.6]), "sums to 1.1"),
        (lambda: beliefs.believe("tiger-lft"), "did you mean 'tiger-left'"),
        (lambda: beliefs.restore(b"nonsense"), "this is not a snapshot of a controller"),
        (lambda: beliefs.restore(states.snapshot()), "of a controller with another model, policy or options"),
    ):
        with pytest.raises(mdm.ModelError) as caught:
            call()
        assert words in str(caught.value)


@pytest.mark.parametrize("numbers", [int, np.int64, np.int32])
def test_numbers_of_numpy_are_digested_as_plain_ones(numbers):
    actions = [numbers(action) for action in (2, 1, 0)]
    vectors = np.eye(3, 2)
    policies = [
        AlphaVectors(vectors, actions),
        AlphaVectors(vectors, np.array(actions), numbers(3)),
    ]
    digests = {mdm.Controller(policy, mdm.problems.tiger()).digest() for policy in policies}
    assert digests == {mdm.Controller(AlphaVectors(vectors, [2, 1, 0], 3), mdm.problems.tiger()).digest()}


@given(states=st.lists(st.integers(-2, 4), max_size=12), horizon=st.none() | st.integers(1, 4))
def test_a_look_up_decides_as_see_or_not_at_all(states, horizon):
    quick, plain = (Controller([1, 0, 2], horizon=horizon) for _ in range(2))
    for state in states:
        before = (quick.epoch, quick.last_action, quick.information.current)
        action = quick.look_up(state)
        if action < 0:
            assert not 0 <= state < 3 or quick.epoch == horizon
            assert (quick.epoch, quick.last_action, quick.information.current) == before
            if 0 <= state < 3:
                assert quick.see(state) == plain.see(state)
        else:
            step = plain.see(state)
            assert (action, quick.epoch, quick.last_action) == (step.action, step.epoch + 1, plain.last_action)
        assert quick.snapshot() == plain.snapshot()


def test_a_look_up_leaves_to_others_what_is_no_entry_of_a_table():
    table = Controller([1, 0])
    assert (table.look_up(np.int64(1)), table.look_up(True), table.look_up(1)) == (-1, -1, 0)
    model = mdm.models.MDP([np.eye(2)] * 2, np.ones((2, 2)), discount=0.9)
    assert Controller([1, 0], model).look_up(0) == -1  # a reward is to be told
    drawn = mdm.policies.StochasticPolicy([[0.5, 0.5], [0.5, 0.5]], seed=1)
    assert Controller(drawn).look_up(0) == -1


class Counted:
    """A belief, and the number of its updates, as floats of numpy and a tuple."""

    def __init__(self, model, *, kept=True):
        self.tracker = BeliefTracker(model)
        self.reset()
        if kept:
            self.snapshot, self.restore = self._snapshot, self._restore

    def reset(self, belief=None):
        self.tracker.reset(belief)
        self.current = (self.tracker.current, np.float64(0.0))

    def update(self, action, observation):
        probability = self.tracker.update(action, observation)
        self.current = (self.tracker.current, self.current[1] + 1)
        return probability

    def _snapshot(self):
        return [self.current[0], self.current[1]]

    def _restore(self, snapshot):
        self.tracker.reset(np.array(snapshot[0]))
        self.current = (self.tracker.current, np.float64(snapshot[1]))


class EveryThird(BeliefPolicy):
    num_states, num_actions = 2, 3

    def __init__(self, *, kept=True):
        self.kept = kept

    def information(self, model):
        return Counted(model, kept=self.kept)

    def action(self, current):
        return int(current[1]) % 3


def test_information_of_one_s_own_is_kept_with_numbers_and_arrays_of_numpy():
    controller = Controller(EveryThird(), tiger())
    controller.start()
    controller.observe("hear-left")
    held, digest = controller.snapshot(), controller.digest()
    after = [controller.observe("hear-left") for _ in range(4)]
    assert controller.digest() != digest
    controller.restore(held)
    assert controller.digest() == digest
    assert [controller.observe("hear-left") for _ in range(4)] == after
    assert [step.action for step in after] == [2, 0, 1, 2]


def test_information_that_is_no_belief_and_cannot_be_kept_is_told():
    controller = Controller(EveryThird(kept=False), tiger())
    controller.start()
    for keep in (controller.snapshot, controller.digest, controller.mark):
        with refused(ModelError):
            keep()


def test_an_error_in_a_policy_s_code_is_told_with_its_place():
    class Broken(BeliefPolicy):
        num_states, num_actions = 2, 3

        def action(self, belief):
            return {}["gone"]

    with pytest.raises(
        PolicyError, match=r"Broken has raised KeyError: 'gone' \(at .*test_controller\.py:\d+\)"
    ) as told:
        Controller(Broken(), tiger()).start()
    assert isinstance(told.value.__cause__, KeyError)
