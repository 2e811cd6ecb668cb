"""Shields, against an enumeration of all policies of small models."""

import itertools

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from sentences import refused

import mdm
from mdm.errors import ConfigError, ModelError, ModelWarning
from mdm.models import MDP
from mdm.policies import StagedPolicy, StatePolicy, StochasticPolicy
from mdm.verification import shield, verify

SEEDS = st.integers(0, 10_000)


def drawn(seed, states=4, actions=2):
    """Return a model whose state 0 is a pit and whose state 1 is a goal, both left by nothing, from state 2 on."""
    random = np.random.default_rng(seed)
    moves = np.zeros((actions, states, states))
    for action, state in itertools.product(range(actions), range(states)):
        if state < 2:
            moves[action, state, state] = 1
            continue
        after = random.choice(states, size=random.integers(1, 3), replace=False)
        moves[action, state, after] = random.dirichlet(np.ones(len(after)))
    names = ["pit", "goal", *(f"at-{place}" for place in range(2, states))]
    begin = np.eye(states)[2]
    rewards = random.normal(size=(states, actions)).round(2)
    return MDP(moves, rewards, discount=0.9, states=names, initial_belief=begin)


def ends(model, actions, target):
    """Return the probabilities of ending in a state, by powers of the chain of some actions per state."""
    chain = np.stack([model.transition_matrix(action)[state] for state, action in enumerate(actions)])
    for _ in range(40):
        chain = chain @ chain
    return chain[:, target]


def all_ends(model, target, allowed=None):
    """Return those of all policies, and the policies."""
    size, count = len(model.state_space), len(model.action_space)
    each = [[a for a in range(count) if allowed is None or allowed[s][a]] for s in range(size)]
    found = list(itertools.product(*each))
    return np.array([ends(model, policy, target) for policy in found]), found


@hypothesis.given(seed=SEEDS)
@hypothesis.settings(max_examples=15, deadline=None)
def test_x_is_as_improbable_as_by_any_policy(seed):
    model = drawn(seed)
    least = all_ends(model, 0)[0].min(axis=0)
    for wrong in ([0] * 4, [1] * 4):
        if least[2] > 1e-9:
            with pytest.raises(ConfigError, match="no action keeps the start"):
                shield(wrong, model, avoid="pit")
            return
        try:
            safe = shield(wrong, model, avoid="pit")
        except ConfigError as error:
            assert "stand for ever" in str(error)
            continue
        assert ends(model, safe.table, 0) == pytest.approx(least, abs=1e-9)
        assert verify(model, "P(reach pit)", safe).result.value == 0


@hypothesis.given(seed=SEEDS)
@hypothesis.settings(max_examples=15, deadline=None)
def test_keep_attains_the_most_within_the_mask(seed):
    model = drawn(seed)
    pits = all_ends(model, 0)[0]
    safe = pits.min(axis=0) < 1e-9
    allowed = np.zeros((4, 2), dtype=bool)
    for state, action in itertools.product(range(4), range(2)):
        after = model.transition_matrix(action)[state] > 0
        allowed[state, action] = safe[after].all() if safe[state] else True
    if not safe[2]:
        return
    greatest = all_ends(model, 1, allowed)[0][:, 2].max()
    for wrong in ([0] * 4, [1] * 4, [0, 0, 0, 1]):
        if greatest < 1e-9:
            with pytest.raises(ConfigError, match="no way to"):
                shield(wrong, model, avoid="pit", keep="reach goal")
            continue
        its = shield(wrong, model, avoid="pit", keep="reach goal")
        assert ends(model, its.table, 1)[2] == pytest.approx(greatest, abs=1e-7)
        assert ends(model, its.table, 0)[2] == 0
        again = shield(wrong, model, avoid="pit", keep="reach goal", resolve=True)
        assert ends(model, again.table, 1)[2] == pytest.approx(greatest, abs=1e-7)
        assert ends(model, again.table, 0)[2] == 0


# -- Bad input ---------------------------------------------------------------------------------------------------------

HALL = MDP(
    [
        [[0.0, 0.5, 0.5, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0]],
        [[0.9, 0, 0.1, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0.5, 0.5, 0]],
        [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0.2, 0, 0.8]],
    ],
    [[2.0, -1.0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 1]],
    discount=0.9,
    states=["hall", "stairs", "dock", "edge"],
    actions=["Rush", "Creep", "Wait"],
    initial_belief=[1, 0, 0, 0],
)
RUSH = [0, 0, 0, 0]

WRONG = {
    "a name": {"avoid": "stair"},
    "a goal's name": {"avoid": "stairs", "keep": "reach dokc"},
    "no formula": {"avoid": "stairs and"},
    "a second specification": {"avoid": "stairs within 5"},
    "a limit in before": {"avoid": "stairs before dock"},
    "no text": {"avoid": 1},
    "no keep": {"avoid": "stairs", "keep": "dock"},
    "a keep in time": {"avoid": "stairs", "keep": "reach dock within 7"},
    "a keep that holds always": {"avoid": "stairs", "keep": "always hall"},
    "a budget above 1": {"avoid": "stairs", "probability": 1.5},
    "a budget of no number": {"avoid": "stairs", "probability": float("nan")},
    "a budget that is a truth": {"avoid": "stairs", "probability": True},
    "a margin of two": {"avoid": "stairs", "margin": [["hall", "Rush"]]},
    "a margin that is a number": {"avoid": "stairs", "margin": 3},
    "a margin of numbers": {"avoid": "stairs", "margin": [5]},
    "a margin of a text": {"avoid": "stairs", "margin": ["hallway"]},
    "a margin of other states": {"avoid": "stairs", "margin": [["hall", "Rush", "lift"]]},
    "a margin and a budget": {"avoid": "stairs", "margin": [["hall", "Wait", "stairs"]], "probability": 0.5},
    "a policy for another model": {"avoid": "stairs", "policy": [0, 0]},
    "nothing allowed at the start": {"avoid": "hall or stairs"},
    "a start that the margin makes unsafe": {
        "avoid": "stairs",
        "margin": [["hall", each, "stairs"] for each in HALL.action_space.names],
    },
    "a budget that is too small": {"avoid": "stairs or dock", "probability": 0.1, "policy": [0, 0, 0, 0]},
    "a keep that cannot be kept": {"avoid": "stairs", "keep": "reach edge"},
    "a robot that stands for ever": {"avoid": "stairs or dock"},
}


@pytest.mark.parametrize("case", list(WRONG))
def test_bad_input_is_refused_in_a_sentence(case):
    options = dict(WRONG[case])
    policy = options.pop("policy", RUSH)
    model = HALL
    if case == "a budget that is too small":
        model = MDP([HALL.transition_matrix(0)] * 3, HALL.rewards, discount=0.9, states=HALL.state_space,
                    actions=HALL.action_space, initial_belief=[1, 0, 0, 0])  # fmt: skip
    with refused((ConfigError, ModelError)):
        shield(policy, model, **options)


def test_nothing_that_satisfies_x_is_told():
    with pytest.warns(ModelWarning, match="nothing in the model satisfies lift-"):
        safe = shield(RUSH, HALL, avoid="lift-*")
    assert safe.table == RUSH


def test_first_states_that_nothing_keeps_are_told():
    both = MDP([HALL.transition_matrix(action) for action in range(3)], HALL.rewards, discount=0.9,
               states=HALL.state_space, actions=HALL.action_space, initial_belief=[0.5, 0, 0, 0.5])  # fmt: skip
    with pytest.warns(ModelWarning, match="no action keeps 1 of the 2 first states from 'stairs': .* 0.25 at least"):
        safe = shield(RUSH, both, avoid="stairs")
    assert verify(both, "P(reach stairs)", safe).result.value == pytest.approx(0.25)


# -- Cases -------------------------------------------------------------------------------------------------------------


def test_where_nothing_is_safe_the_least_is_taken():
    safe = shield(RUSH, HALL, avoid="stairs", keep="reach dock")
    assert safe.action(3) == 1
    assert safe.wanted(3) == 0
    assert verify(HALL, "P(reach stairs)", safe, start="edge").result.value == pytest.approx(0.5)


def test_x_itself_is_left_by_the_action_least_likely_to_come_back():
    model = MDP(
        [[[0, 1.0, 0], [0, 1.0, 0], [0, 0, 1]], [[1.0, 0, 0], [0.3, 0.7, 0], [0, 0, 1]], [[0, 0, 1.0]] * 3],
        np.zeros((3, 3)), discount=0.9, states=["floor", "mud", "dock"], initial_belief=[1, 0, 0],
    )  # fmt: skip
    assert shield([0, 0, 0], model, avoid="mud", keep="reach dock").table == [2, 2, 0]


def test_an_action_to_avoid_is_none_that_leads_away_from_it():
    model = MDP(
        [[[0, 1.0, 0], [0, 1.0, 0], [1.0, 0, 0]], [[0, 0.5, 0.5], [0, 1.0, 0], [1.0, 0, 0]]],
        np.zeros((3, 2)), discount=0.9, states=["home", "dock", "trap"], actions=["Grab", "Go"],
        initial_belief=[0.5, 0.5, 0], available=[[True, True], [False, True], [True, False]],
    )  # fmt: skip
    with pytest.warns(ModelWarning, match="1 of the 2 first states"):
        safe = shield([0, 1, 0], model, avoid="action = Grab")
    assert safe.action(0) == 1
    assert verify(model, "P(reach action = Grab)", safe).result.value == pytest.approx(0.25)


def test_a_margin_is_avoided_as_well():
    added = [["hall", "Creep", "edge"]]
    assert shield(RUSH, HALL, avoid="stairs", keep="reach dock").table[0] == 1
    with pytest.raises(ConfigError, match="no way to"):
        shield(RUSH, HALL, avoid="stairs", keep="reach dock", margin=added)
    assert shield([2, 0, 0, 0], HALL, avoid="stairs", margin=lambda model: added).table[0] == 2
    wide = shield([1, 0, 0, 0], HALL, avoid="stairs", margin=[(0, 2, 1)])
    assert wide.allowed(0).tolist() == [False, True, False]


def test_actions_may_be_avoided():
    safe = shield([2, 0, 0, 0], HALL, avoid="hall and action = Wait", keep="reach dock")
    assert safe.table[0] == 1
    assert verify(HALL, "P(reach hall and action = Wait)", safe).result.value == 0


def test_solved_again_within_the_mask():
    with pytest.raises(ConfigError, match="stand for ever"):  # nothing is paid for Wait, and Creep costs
        shield(RUSH, HALL, avoid="stairs", resolve=True)
    paid = [[2.0, 0, -1], [0, 0, 0], [1, 1, 1], [0, 0, 0]]
    spaces = {"states": HALL.state_space, "actions": HALL.action_space}
    moves = [HALL.transition_matrix(action) for action in range(3)]
    paid = MDP(moves, paid, discount=0.9, initial_belief=[1, 0, 0, 0], **spaces)
    safe = shield([2, 0, 0, 0], paid, avoid="stairs")
    assert (safe.table[0], safe.wanted(0)) == (2, None)
    safe = shield([2, 0, 0, 0], paid, avoid="stairs", resolve=True)
    assert (safe.table[0], safe.wanted(0)) == (1, 2)
    staged = StagedPolicy(np.zeros((2, 4, 3)))
    with pytest.raises(ConfigError, match="solve without a horizon"):
        shield(staged, HALL, avoid="stairs", resolve=True)


@pytest.mark.parametrize("probability", [0.0, 0.4])
def test_stages_have_masks_of_their_own(probability):
    values = np.zeros((3, 4, 3))
    values[:, 0, 0] = 1
    values[:2, 0, 2] = 2
    values[:, 3, 2] = 1
    plan = StagedPolicy(values)
    assert verify(HALL, "P(reach stairs)", plan).result.value == 0.5
    safe = shield(plan, HALL, avoid="stairs", keep="reach dock", probability=probability)
    controller = mdm.Controller(safe, HALL)
    assert [controller.see("hall").action_name for _ in range(3)] == ["Creep"] * 3
    if not probability:
        assert verify(HALL, "P(reach stairs)", safe).result.value == 0
        assert verify(HALL, "P(reach dock)", safe).result.value == pytest.approx(1 - 0.9**3)
        assert mdm.Controller(safe, HALL).see("edge").action_name == "Wait"  # 1 - .8 ** 3 is less than .5


def test_stages_of_a_dense_model_have_no_moves_of_probability_zero():
    moves = [[[0.5, 0.5, 0], [0.5, 0.5, 0], [0, 0, 1.0]], [[0.25, 0.25, 0.5]] * 3]
    model = MDP(moves, np.zeros((3, 2)), discount=0.9, states=["hall", "dock", "stairs"], initial_belief=[0, 1, 0])
    safe = shield(StagedPolicy(np.tile([0.0, 1.0], (2, 3, 1))), model, avoid="stairs")
    assert [safe.weights(stage)[0, :2].tolist() for stage in range(2)] == [[1, 1], [1, 1]]


def test_states_of_a_pomdp_are_seen():
    tiger = mdm.problems.tiger()
    safe = shield([1, 2], tiger, avoid="tiger-left and action = open-left or tiger-right and action = open-right")
    assert verify(tiger, "P(reach tiger-left and action = open-left)", safe).result.value == 0


def test_policies_with_a_memory_of_their_own_are_refused():
    class Remembering(StatePolicy):
        num_states, num_actions = 4, 3
        weights = None

        def information(self, model):
            return mdm.BeliefTracker(mdm.problems.tiger())

    with pytest.raises(ModelError, match="a Remembering keeps more than states in mind"):
        shield(Remembering(), HALL, avoid="stairs")


# -- Budgets -----------------------------------------------------------------------------------------------------------


def risk(model, safe, hit=0, miss=None, depth=60):
    """Return the exact probability of a state within some steps, by all runs, equal ones together, and the rest's."""
    information, found = safe.information(model), 0.0
    information.update(None, int(np.argmax(model.initial_belief)))
    runs = {"": (information.snapshot(), 1.0)}
    for _ in range(depth):
        later = {}
        for kept, weight in runs.values():
            information.restore(kept)
            action = safe.action(information.current)
            row = model.transition_matrix(action)[information.state]
            found += weight * row[hit]
            for after in np.flatnonzero(row).tolist():
                if after in {hit, miss}:
                    continue
                information.restore(kept)
                information.update(action, after)
                state, budget = information.snapshot()
                key = f"{state} {budget:.9f}"
                later[key] = ([state, budget], later.get(key, (0, 0.0))[1] + weight * row[after])
        runs = dict(sorted(later.items(), key=lambda item: -item[1][1])[:50])
    return found, sum(weight for _, weight in runs.values())


@hypothesis.given(seed=SEEDS, budget=st.floats(0.01, 0.95))
@hypothesis.settings(max_examples=10, deadline=None)
def test_a_run_spends_no_more_than_its_budget(seed, budget):
    model = drawn(seed, states=5)
    least = verify(model, "P(reach pit)").least.value
    for wrong in ([0] * 5, [1] * 5):
        if least > budget:
            with pytest.raises(ConfigError, match="more than the budget"):
                shield(wrong, model, avoid="pit", probability=budget)
            return
        before = verify(model, "P(reach pit)", wrong).result.value
        safe = shield(wrong, model, avoid="pit", probability=budget)
        spent, _ = risk(model, safe, depth=30)
        assert spent <= budget + 1e-9
        if before <= budget:  # nothing has to be changed
            assert spent <= before + 1e-9
            assert spent >= risk(model, shield(wrong, model, avoid="pit", probability=1.0), depth=30)[0] - 1e-9


def test_a_budget_is_spent_where_the_original_needs_it():
    safe = shield(RUSH, HALL, avoid="stairs", probability=0.5)
    assert risk(HALL, safe, 1)[0] == pytest.approx(0.5)
    assert risk(HALL, shield(RUSH, HALL, avoid="stairs", probability=0.49), 1)[0] == 0


@hypothesis.given(seed=SEEDS, budget=st.floats(0.01, 0.5))
@hypothesis.settings(max_examples=15, deadline=None)
def test_a_budget_costs_no_more_of_what_is_kept_than_itself(seed, budget):
    model = drawn(seed, states=5)
    if verify(model, "P(reach pit)").least.value > 0:
        return
    try:
        full = shield([0] * 5, model, avoid="pit", keep="reach goal")
    except ConfigError:
        return
    kept = verify(model, "P(reach goal)", full).result.value
    safe = shield([0] * 5, model, avoid="pit", keep="reach goal", probability=budget)
    goal, open_ = risk(model, safe, 1, 0, depth=150)
    assert goal + open_ >= kept - budget - 1e-3


# -- Long runs ---------------------------------------------------------------------------------------------------------


def pits(size, share, seed):
    """Return a grid with pits at random, a start in one corner and a goal in the other, and its marks."""
    random = np.random.default_rng(seed)
    marks = np.where(random.random((size, size)) < share, "-", ".")
    marks[:2, :2], marks[-2:, -2:] = ".", "."
    marks[0, 0], marks[-1, -1] = "s", "+"
    grid = mdm.problems.grid_world("/".join("".join(row) for row in marks), discount=0.99, pit_reward=-0.1)
    return grid, marks


def pit_names(grid, marks):
    names = grid.state_space.names
    return " or ".join(names[place] for place in np.flatnonzero(marks.ravel() == "-")), names[marks.size - 1]


@pytest.mark.slow
def test_a_large_grid_with_pits():
    grid, marks = pits(40, 0.03, 1)
    falls, goal = pit_names(grid, marks)
    optimal = mdm.solve(grid).policy
    before = verify(grid, f"P(reach {falls})", optimal).result.value
    assert before > 0.5
    for resolve in (False, True):
        safe = shield(optimal, grid, avoid=falls, keep=f"reach {goal}", resolve=resolve)
        assert verify(grid, f"P(reach {falls})", safe).result.value == 0
        assert verify(grid, f"P(reach {goal})", safe).result.value == pytest.approx(1, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_million_steps_without_a_violation(seed):
    grid, marks = pits(12, 0.06, seed)
    falls, goal = pit_names(grid, marks)
    random = np.random.default_rng(seed)
    wild = StochasticPolicy(random.dirichlet(np.ones(4), size=len(grid.state_space)).T, seed=seed)
    bad = [grid.state_space.index(name) for name in falls.split(" or ")]
    steps = np.zeros(2, dtype=int)
    violations = np.zeros(2, dtype=int)
    safe = shield(wild, grid, avoid=falls, keep=f"reach {goal}")
    for which, policy in enumerate((wild, safe)):
        weights = np.cumsum(policy.weights().T, axis=1)
        moves = np.stack([np.cumsum(grid.transition_matrix(action), axis=1) for action in range(4)])
        state = np.full(2_000, grid.state_space.index(grid.state_space.names[0]))
        while steps[which] < 1_000_000:
            action = (random.random((len(state), 1)) > weights[state]).sum(axis=1).clip(0, 3)
            state = (random.random((len(state), 1)) > moves[action, state]).sum(axis=1)
            fell = np.isin(state, bad)
            violations[which] += fell.sum()
            steps[which] += len(state)
            state[fell | (state >= marks.size - 1)] = 0
    assert violations[0] > 0
    assert violations[1] == 0


@pytest.mark.slow
@pytest.mark.parametrize("kept", [False, True])
@pytest.mark.parametrize("budget", [0.02, 0.1])
def test_ten_thousand_runs_within_a_budget(budget, kept):
    grid, marks = pits(8, 0.2, 6)
    falls, goal = pit_names(grid, marks)
    rows = "/".join("".join(row) for row in marks)
    hurried = mdm.solve(mdm.problems.grid_world(rows, discount=0.99, pit_reward=-0.1, step_reward=-0.3)).policy
    assert verify(grid, f"P(reach {falls})", hurried).result.value > 0.9
    safe = shield(hurried, grid, avoid=falls, keep=f"reach {goal}" if kept else None, probability=budget)
    result = verify(grid, f"P(reach {falls} before {goal})", safe, episodes=10_000, seed=7).result
    assert result.undecided == 0
    assert 0 < result.lower < budget
    assert kept or result.upper > 0.9 * budget  # and it is spent
