"""Winning supports against an enumeration of strategies over supports, and the chain of each."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hidden_dangers import HIDDEN, tiger

import mdm
from mdm.models.specification import Specification
from mdm.simulation.sampler import BatchSampler
from mdm.solvers.online.tree_search import SearchResult
from mdm.verification.supports import Supports


def drawn(seed, *, absorbing):
    """Return a random POMDP of four states, X and a goal; an absorbing goal stays and shows nothing new."""
    random = np.random.default_rng(seed)
    moves = random.random((2, 4, 4)) * (random.random((2, 4, 4)) < 0.4)
    moves[:, :2, 2] *= random.random((2, 2)) < 0.4
    moves[:, range(4), random.choice([0, 1, 3], size=4)] += 0.1
    if absorbing:
        moves[:, 3] = [0, 0, 0, 1]
    moves /= moves.sum(axis=2, keepdims=True)
    seen = random.random((2, 4, 2)) * (random.random((2, 4, 2)) < 0.6) + np.eye(2)[random.integers(2, size=(2, 4))]
    seen /= seen.sum(axis=2, keepdims=True)
    begins = np.array([0.5, 0.5, 0, 0]) if random.random() < 0.7 else np.array([1, 0, 0, 0])
    model = mdm.POMDP(moves, seen, np.zeros((4, 2)), discount=0.9, initial_belief=begins)
    avoid, keep = np.zeros((4, 3), dtype=bool), np.zeros((4, 3), dtype=bool)
    avoid[2] = True
    avoid[:2, :2] |= random.random((2, 2)) < 0.15
    keep[3] = True
    return model, avoid, keep


def following(model, support, action):
    """Return the support after each observation, by definition."""
    after = {}
    for state in support:
        for target in range(4):
            for symbol in range(2):
                if (
                    model.transition_matrix(action)[state, target] * model.observation_matrix(action)[target, symbol]
                    > 0
                ):
                    after.setdefault(symbol, set()).add(target)
    return {symbol: frozenset(states) for symbol, states in after.items()}


def wins(model, avoid, keep):
    """Return from which supports some draw of actions by the support avoids X and reaches the goal, surely."""
    start = frozenset(np.flatnonzero(model.initial_belief).tolist())
    met, edges = [start], {}
    for support in met:
        for action in range(2):
            edges[support, action] = following(model, support, action)
            met += [each for each in dict.fromkeys(edges[support, action].values()) if each not in met]
    places = {(state, support, done): None for support in met for state in support for done in (False, True)}
    places = {place: number for number, place in enumerate(places)}
    won = set()
    if len(met) > 4:
        return None
    for strategy in itertools.product([(0,), (1,), (0, 1)], repeat=len(met)):
        chain = np.zeros((len(places) + 1, len(places) + 1))
        chain[-1, -1] = 1  # X
        for (state, support, done), row in places.items():
            actions = strategy[met.index(support)]
            for action in actions:
                if avoid[state, action]:
                    chain[row, -1] += 1 / len(actions)
                    continue
                now = done or keep is None or keep[state, action]
                for target in range(4):
                    for symbol in range(2):
                        chance = (
                            model.transition_matrix(action)[state, target]
                            * model.observation_matrix(action)[target, symbol]
                        )
                        if chance > 0:
                            column = places[target, edges[support, action][symbol], bool(now)]
                            chain[row, column] += chance / len(actions)
        for _ in range(40):
            chain = chain @ chain
            chain /= chain.sum(axis=1, keepdims=True)
        good = [number for (_, _, done), number in places.items() if done]
        for support in met:
            if all(chain[places[state, support, False], good].sum() > 1 - 1e-6 for state in support):
                won.add(support)
    return won


def told(model, avoid, keep):
    found = Supports(model, avoid, keep)
    cuts = zip(found.starts, found.starts[1:], found.keeps, strict=False)
    return {frozenset(found.states[a:b].tolist()): bool(keeps) for a, b, keeps in cuts}


@pytest.mark.parametrize("absorbing", [True, False])
@pytest.mark.parametrize("goal", [True, False])
def test_supports_win_where_a_strategy_over_supports_does(absorbing, goal):
    compared = won = 0
    for seed in range(40):
        model, avoid, keep = drawn(seed, absorbing=absorbing)
        truth = wins(model, avoid, keep if goal else None)
        if truth is None:
            continue
        for support, keeps in told(model, avoid, keep if goal else None).items():
            compared += 1
            won += keeps
            if absorbing or not goal:
                assert keeps == (support in truth), (seed, support)
            elif keeps:
                assert support in truth, (seed, support)
    assert 10 < won < compared


def reaches(model, avoid, keep):
    """Return whether allowed actions reach the goal from the start; None where that would take long."""
    safe = wins(model, avoid, None)
    start = frozenset(np.flatnonzero(model.initial_belief).tolist())
    if safe is None or start not in safe:
        return None
    met = [(start, state) for state in start]
    for support, state in met:
        for action in range(2):
            after = following(model, support, action)
            if any(avoid[each, action] for each in support) or not safe.issuperset(after.values()):
                continue
            if keep[state, action]:
                return True
            for symbol, states in after.items():
                chances = model.transition_matrix(action)[state] * model.observation_matrix(action)[:, symbol]
                met += [each for each in ((states, to) for to in np.flatnonzero(chances).tolist()) if each not in met]
    return False


def test_a_goal_is_possible_where_allowed_actions_reach_it():
    found = []
    for seed in range(80):
        model, avoid, keep = drawn(seed, absorbing=seed % 2)
        truth = reaches(model, avoid, keep)
        if truth is not None:
            found.append(truth)
            assert Supports(model, avoid, keep).possible == truth, seed
    assert 5 < sum(found) < len(found) - 5


def test_a_goal_that_the_shield_makes_impossible_is_refused():
    model = tiger()
    opens = mdm.policies.ConstantPolicy(1, 3, 4)
    search = mdm.solvers.TreeSearch(model, expansions=2)
    plan = mdm.policies.FiniteStateController([1], [[0] * 5], 3)
    for policy in (opens, search, plan):
        with pytest.raises(mdm.ConfigError, match="no way to the goal") as told:
            mdm.shield(policy, model, avoid="free or eaten", keep="reach free")
        assert told.value.key == "keep"


def test_a_goal_that_is_not_certain_from_the_start_is_told_with_its_probability():
    """Ten per cent of the way ends in a ditch that shows as the way does."""
    model = mdm.POMDP.from_functions(
        ["road", "ditch", "home", "pit"],
        ["walk", "jump"],
        ["seen"],
        transition=lambda state, action: (
            {state: 1.0} if state != "road" else {"home": 0.9, "ditch": 0.1} if action == "walk" else {"pit": 1.0}
        ),
        observation=lambda action, state: "seen",
        reward=lambda state, action: float(state == "road") * (1 + (action == "jump")),
        discount=0.9,
        initial="road",
    )
    jumps = mdm.policies.ConstantPolicy(1, 2, 4)
    found = mdm.verification.effect(mdm.shield(jumps, model, avoid="pit", keep="reach home"), model, seconds=math.inf)
    assert found.keep[0].upper < 0.1
    assert found.keep[1].lower <= 0.9 <= found.keep[1].upper < 1


def shielded(name, keep=True):
    make, avoid, goal = HIDDEN[name]
    model = make()
    policy = mdm.solve(model, "qmdp").policy
    return model, policy, mdm.shield(policy, model, avoid=avoid, keep=goal if keep else None)


def met(model, policy, formula, steps, seed=1):
    """Return how often a formula is met within some steps of 300 episodes."""
    within = mdm.verify(model, f"P(reach {formula} within {steps})", policy, episodes=300, seed=seed).result
    return within.lower, within.upper


@pytest.mark.parametrize("name", HIDDEN)
def test_a_shield_over_beliefs_avoids_and_does_not_freeze(name):
    _, avoid, goal = HIDDEN[name]
    model, policy, safe = shielded(name)
    assert met(model, policy, avoid, 50)[0] > 0.2
    assert met(model, safe, avoid, 200)[0] == 0.0
    assert met(model, safe, goal.removeprefix("reach "), 200)[1] == 1.0
    assert met(model, safe, goal.removeprefix("reach "), 200)[0] > 0.98


def test_a_mask_without_a_goal_freezes_where_the_goal_is_kept():
    model, _, safe = shielded("obstacles", keep=False)
    assert met(model, safe, "3,3", 100)[1] < 0.05


def test_it_takes_what_the_policy_wants_where_that_is_allowed():
    model, policy, safe = shielded("tiger")
    sure, unsure = [0, 1, 0, 0], [0.6, 0.4, 0, 0]
    assert safe.action(sure) == policy.action(sure)
    assert safe.wanted(sure) is None
    assert safe.action(unsure) == 0
    assert safe.wanted(unsure) == policy.action(unsure) != 0
    assert safe.allowed(unsure).tolist() == [True, False, False]
    assert safe.actions_at(np.array([sure, unsure])).tolist() == [policy.action(sure), 0]
    assert mdm.Controller(safe, model).start().action_name == "listen"


@pytest.mark.parametrize("kind", ["ShieldedBelief", "ShieldedSearch", "ShieldedController"])
def test_it_is_shown_as_its_original_and_what_it_avoids_and_not_saved(tmp_path, kind):
    model = HIDDEN["tiger"][0]()
    policy = {
        "ShieldedBelief": mdm.policies.ConstantPolicy(1, 3, 4),
        "ShieldedSearch": mdm.solvers.TreeSearch(model, expansions=2),
        "ShieldedController": mdm.policies.FiniteStateController([1], [[0] * 5], 3),
    }[kind]
    safe = mdm.shield(policy, model, avoid="eaten", keep="reach free")
    assert repr(safe) == f"<{kind} of {policy!r}: avoids eaten>"
    assert safe.facts()["avoids"] == "eaten"
    for suffix in ("npz", "pg"):
        with pytest.raises(mdm.Error, match=rf"a {kind} is not saved in files: .* shield = {{ avoid = 'eaten' }}"):
            mdm.save_policy(safe, tmp_path / f"safe.{suffix}", model)
    assert not list(tmp_path.iterdir())


def test_an_unknown_support_is_taken_for_the_smallest_known_around_it_and_an_unsafe_one_risks_least():
    _, _, safe = shielded("tiger")
    assert safe.allowed([0.5, 0.5, 0, 0]).tolist() == safe.allowed([0.6, 0.4, 0, 0]).tolist()
    assert safe.allowed([0.5, 0, 0, 0.5]).tolist() == [True, False, True]
    assert safe.allowed([0, 0, 0, 1]).all()


@pytest.mark.parametrize("name", ["tiger", pytest.param("obstacles", marks=pytest.mark.slow)])
def test_a_shielded_controller_is_a_controller_and_verified_exactly(name):
    make, avoid, goal = HIDDEN[name]
    model = make()
    plan = mdm.policies.FiniteStateController([1], [[0] * len(model.observation_space)], len(model.action_space))
    safe = mdm.shield(plan, model, avoid=avoid, keep=goal)
    assert mdm.verify(model, f"P(reach {avoid})", safe).result.value == 0
    assert mdm.verify(model, f"P({goal})", safe).result.value == pytest.approx(1)
    assert safe.wanted((safe.start,)) in {None, 1}
    assert safe.allowed((safe.start,))[safe.actions[safe.start]]


def test_a_search_and_its_fallback_are_shielded():
    make, avoid, goal = HIDDEN["tiger"]
    model = make()
    opens = mdm.policies.ConstantPolicy(1, 3, 4)
    search = mdm.solvers.TreeSearch(model, expansions=2, seed=1, fallback=opens)
    safe = mdm.shield(search, model, avoid=avoid, keep=goal)
    unsure = model.initial_belief
    assert safe.search(unsure).action == safe.action(unsure) == 0
    assert search.fallback.action(unsure) == 1
    assert safe.fallback.action(unsure) == 0
    wanted = safe.search(unsure).wanted
    assert wanted == search.search(unsure).action != 0
    assert safe.wanted(unsure) == wanted
    assert safe.wanted([0, 1, 0, 0]) is None
    found = SearchResult(1, lower=(-9.0, 5.0, 7.0), upper=(0.0, 9.0, 9.0), expansions=2, nodes=3, seconds=0.1)
    assert safe.answered(found, unsure) == (0, 2, 1)  # as the planner asks for a process's answer
    assert safe.answered(found, [0, 1, 0, 0]) == (1, 2, None)
    assert safe.answered(found, [1, 0, 0, 0]) == (2, 2, 1)


def test_a_search_forgets_the_oldest_wish_first(monkeypatch):
    monkeypatch.setattr("mdm.policies.supported._WISHES", 2)
    make, avoid, goal = HIDDEN["tiger"]
    safe = mdm.shield(mdm.solvers.TreeSearch(make(), expansions=2), make(), avoid=avoid, keep=goal)
    first, second, third = np.eye(4)[:3]
    for belief, wanted in ((first, 1), (second, 2), (first, 2), (third, 1)):
        safe.note(belief, wanted)
    assert [safe.wanted(belief) for belief in (first, second, third)] == [2, None, 1]


def test_a_margin_is_tracked_and_avoided():
    model, policy, _ = shielded("tiger")
    with pytest.raises(mdm.Error, match="allows nothing"):
        mdm.shield(policy, model, avoid="eaten", margin=[["tiger left", "listen", "eaten"]])
    safe = mdm.shield(policy, model, avoid="eaten", margin=[["tiger left", "listen", "tiger right"]])
    assert safe.allowed([1, 0, 0, 0]).tolist() == [True, False, True]
    tracker = safe.information(model)
    tracker.reset([1, 0, 0, 0])
    assert tracker.update(0, model.observation_space.index("tiger right")) == pytest.approx(3e-7)
    assert tracker.belief.tolist() == [0, 1, 0, 0]


def test_an_action_after_which_nothing_is_ever_detected_is_not_allowed():
    moves = [np.eye(2), [[0.0, 1.0], [0.0, 1.0]]]
    seen = [[[1.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 1.0]]]
    model = mdm.POMDP(moves, seen, np.zeros((2, 2)), discount=0.9, initial_belief=[1, 0]).with_false_negatives(0)
    avoid = np.zeros((2, 3), dtype=bool)
    found = Supports(model, avoid)
    assert found.allowed[found.first].tolist() == [[False, True]]
    assert found.keeps.all()


def test_a_model_of_too_many_supports_is_refused_with_their_number(monkeypatch):
    monkeypatch.setattr("mdm.verification.supports.MOST", 3)
    with pytest.raises(mdm.Error, match="more than 3 supports"):
        shielded("obstacles")


def test_a_controller_of_each_agent_is_refused():
    model = mdm.problems.dec_tiger()
    listen = mdm.policies.FiniteStateController([0], [[0, 0]], num_actions=3)
    with pytest.raises(mdm.Error, match="controller of each agent"):
        mdm.shield(mdm.policies.JointController([listen, listen]), model, avoid="action = 'open-left open-left'")


@pytest.mark.slow
@pytest.mark.parametrize("name", HIDDEN)
def test_a_million_steps_hold_no_violation(name):
    avoid = HIDDEN[name][1]
    model, _, safe = shielded(name)
    bad = Specification.of(f"P(reach {avoid})", model).target
    random, steps = np.random.default_rng(3), 0
    sampler, batch = BatchSampler(model), safe.batch(model)
    while steps < 1_000_000:
        states = sampler.first(random.random(2_000))
        actions, every = batch.begin(states, random.random(2_000)), np.arange(2_000)
        for _ in range(100):
            assert not bad[states, actions].any()
            states, seen = sampler.move(states, actions, random.random((3, 2_000)))
            actions = batch.next(every, states, actions, seen, random.random(2_000))
            steps += 2_000
