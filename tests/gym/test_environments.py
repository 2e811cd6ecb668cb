"""Environments, by the checkers of Gymnasium and PettingZoo, and against the numbers of their models."""

from __future__ import annotations

import pickle
import sys
from collections import Counter
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, strategies as st
from pettingzoo.test import parallel_api_test, parallel_seed_test
from pettingzoo.utils.conversions import parallel_to_aec
from sentences import refused

import mdm
from mdm import ConfigError, Error, ModelError, problems
from mdm.models import MDP, POMDP, Factor, Space

ONE = ["tiger", "load_unload", "grid_world", "forest", "river_swim", "hallway", "aloha"]
TEAMS = ["dec_tiger", "broadcast_channel", "recycling_robots", "relay", "grid_small", "fire_fighting_graph"]
LARGE = ["machine_maintenance", "rock_sample", "field_vision_rock_sample", "tag", "hallway2", "patrol"]
LARGE_TEAMS = ["meeting", "box_pushing", "mars_rovers", "fire_fighting"]


def registered(model, **options):
    """Return an environment as ``gymnasium.make`` makes it, so that the checker makes others of its kind."""
    name = "mdm/Checked-v0"
    gymnasium.registry.pop(name, None)
    gymnasium.register(name, entry_point="mdm.gym:environment", kwargs={"model": model, **options})
    return gymnasium.make(name, disable_env_checker=True).unwrapped


def check(name):
    model = getattr(problems, name)()
    assert name in problems.__all__
    for observation in ("symbol", "belief") if model.pomdp else ("symbol",):
        for factored in (False, True):
            check_env(registered(model, observation=observation, factored=factored))


def check_team(name):
    model = getattr(problems, name)()
    parallel_api_test(mdm.gym.parallel(model, steps=20), num_cycles=50)
    parallel_seed_test(lambda: mdm.gym.parallel(model, steps=20))


@pytest.mark.parametrize("name", [*ONE, *TEAMS])
def test_problems_pass_the_checker_of_gymnasium(name):
    check(name)


@pytest.mark.parametrize("name", TEAMS)
def test_teams_pass_the_tests_of_pettingzoo(name, capsys):
    check_team(name)
    assert capsys.readouterr().out == "Passed Parallel API test\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", [*LARGE, *LARGE_TEAMS])
def test_large_problems_pass_the_checker_of_gymnasium(name):
    check(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE_TEAMS)
def test_large_teams_pass_the_tests_of_pettingzoo(name):
    check_team(name)


def test_a_team_of_an_mdp_sees_the_state_and_passes_too():
    space = Space([Factor("left", ["stay", "go"]), Factor("right", ["stay", "go"])])
    model = MDP(np.full((4, 3, 3), 1 / 3), np.arange(12.0).reshape(3, 4), discount=0.9, actions=space)
    parallel_api_test(mdm.gym.parallel(model, steps=20), num_cycles=50)
    env = mdm.gym.parallel(model)
    seen, _ = env.reset(seed=3)
    assert (env.agents, env.num_agents, env.max_num_agents) == (["left", "right"], 2, 2)
    assert seen["left"] == seen["right"] in range(3)
    check_env(registered(model, factored=True))


# -- Against the model -------------------------------------------------------------------------------------------------


@st.composite
def models(draw):
    """Return a POMDP of two agents with rewards of single outcomes, and a state that is absorbing."""
    size, random = draw(st.integers(2, 4)), np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    moves = random.dirichlet(np.ones(size), (4, size))
    moves[:, -1] = np.eye(size)[-1]
    rewards = random.normal(size=(4, size, size, 6))
    rewards[:, -1] = 0
    return POMDP(
        moves,
        random.dirichlet(np.ones(6), (4, size)),
        rewards,
        discount=0.9,
        actions=Space([Factor("one", 2), Factor("two", 2)]),
        observation_names=Space([Factor("one", 2), Factor("two", 3)]),
        initial_belief=random.dirichlet(np.ones(size)),
    )


@given(models(), st.integers(0, 1000))
def test_an_episode_is_one_of_the_model_with_its_rewards_observations_and_beliefs(model, seed):
    """The same draws in three environments; the belief is Bayes' rule, and the reward that of the outcome."""
    symbols, beliefs = mdm.gym.environment(model), mdm.gym.environment(model, "belief")
    each, team = mdm.gym.environment(model, factored=True), mdm.gym.parallel(model)
    assert symbols.reset(seed=seed) == (6, {})
    assert each.reset(seed=seed)[0].tolist() == [2, 3]
    assert team.reset(seed=seed)[0] == {"one": 2, "two": 3}
    belief = model.initial_belief
    assert np.array_equal(beliefs.reset(seed=seed)[0], belief.astype(np.float32))
    numbers = np.random.default_rng(seed)
    state = None
    for _ in range(20):
        action = int(numbers.integers(4))
        one, two = divmod(action, 2)
        observation, reward, terminated, truncated, _ = symbols.step(np.int64(action))
        told, *same, _ = beliefs.step(action)
        seen, *other, _ = each.step(np.array([one, two]))
        own, *shared = team.step({"one": one, "two": np.int64(two)})
        assert same == other == [reward, terminated, truncated] == [part["two"] for part in shared[:3]]
        assert seen.tolist() == list(divmod(observation, 3)) == [own["one"], own["two"]]
        joint = model.transition_matrix(action) * model.observation_matrix(action)[:, observation]
        belief = belief @ joint
        belief /= belief.sum()
        assert np.allclose(told, belief, atol=1e-6)
        possible = model.outcome_rewards.array(10**6)[action, :, :, observation]
        before, state = state, symbols._state  # the outcome's own reward, by the state that nobody is told
        rows = possible[:, state] if before is None else possible[before, state]
        assert np.isclose(rows, reward).any()
        assert terminated is (state == len(model.state_space) - 1)
        assert not truncated
        if terminated:
            break


def test_states_rewards_and_ends_are_as_often_as_the_model_says():
    """By 4,000 steps, within five standard deviations."""
    river = problems.river_swim()
    env, count = mdm.gym.environment(river, steps=2), 4000
    env.reset(seed=5)
    after = Counter()
    for _ in range(count):
        env.reset()
        first = env._state
        state, reward, *ends, _ = env.step(1)
        assert ends == [False, False]
        assert reward == pytest.approx(river.reward(1, first, state))
        after[first, state] += 1
    expected = river.initial_belief[:, None] * river.transition_matrix(1)
    for (first, state), chance in np.ndenumerate(expected):
        error = 5 * np.sqrt(chance * (1 - chance) / count)
        assert abs(after[first, state] / count - chance) <= error


def test_an_episode_is_terminated_where_nothing_more_can_come_and_truncated_after_its_steps():
    """A state that is never left, and still earns, terminates nothing: its rewards would be lost."""
    chain = [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    for last, terminated in ((0.0, True), (1.0, False)):
        model = MDP([chain, chain], [1, 0, last, 0], discount=0.9, initial_belief=[1, 0, 0, 0])
        env = mdm.gym.environment(model, steps=3)
        env.reset()
        assert [env.step(0)[1:4] for _ in range(3)] == [
            (1.0, False, False),
            (0.0, terminated, False),
            (last, terminated, True),
        ]
    one_leaves = [chain, np.roll(chain, 1, axis=1)]
    env = mdm.gym.environment(MDP(one_leaves, [0, 0, 0, 0], discount=0.9, initial_belief=[0, 1, 0, 0]))
    env.reset()
    assert env.step(0)[2] is False


def test_the_end_of_a_team_s_episode_is_everybody_s():
    env = mdm.gym.parallel(problems.dec_tiger(), steps=2)
    env.reset(seed=1)
    listen = dict.fromkeys(env.agents, "listen")
    *_, terminated, truncated, infos = env.step(listen)
    assert (terminated, truncated) == (dict.fromkeys(listen, False), dict.fromkeys(listen, False))
    *_, terminated, truncated, infos = env.step(listen)
    assert (terminated, truncated) == (dict.fromkeys(listen, False), dict.fromkeys(listen, True))
    assert (env.agents, infos) == ([], {"agent0": {}, "agent1": {}})
    assert infos["agent0"] is not infos["agent1"]
    with refused(ConfigError):
        env.step({})
    env.reset()
    assert env.agents == ["agent0", "agent1"]
    with refused(ConfigError):
        env.step({"agent0": 0})
    with refused(ModelError):
        env.step({"agent0": "listen", "agent1": "lisen"})


def test_a_team_can_take_turns_by_the_conversion_of_pettingzoo():
    env = parallel_to_aec(mdm.gym.parallel(problems.dec_tiger(), steps=3))
    env.reset(seed=1)
    earned = Counter()
    for agent in env.agent_iter():
        _, reward, terminated, truncated, _ = env.last()
        earned[agent] += reward
        env.step(None if terminated or truncated else 0)
    assert earned == {"agent0": -6.0, "agent1": -6.0}


# -- What is observed --------------------------------------------------------------------------------------------------


def test_what_events_leave_open_is_seen_as_nothing_and_earns_nothing_of_observations():
    events = np.zeros((1, 1, 2, 2))
    events[0, 0, 0, 1] = 1.0  # the way there is seen, what comes after is not
    numbers = [[[0, 1], [0, 1]]], events, np.full((1, 2, 2, 1), 7.0)
    with pytest.warns(mdm.ModelWarning):
        model = POMDP(*numbers, discount=0.9, event_observations=True, initial_belief=[1, 0])
    env = mdm.gym.environment(model)
    assert env.reset()[0] == 1
    assert env.step(0)[:2] == (0, 7.0)
    assert env.step(0)[:2] == (1, 0.0)
    assert model.reward(0, 1) == 0.0


def test_a_false_negative_is_seen_at_its_step():
    tiger = problems.tiger().with_false_negatives("hear-left")
    env = mdm.gym.environment(tiger)
    env.reset(seed=1)
    assert {env.step("listen")[0] for _ in range(50)} == {0, 1}
    env = mdm.gym.environment(tiger, "belief")
    for seed in range(5):
        env.reset(seed=seed)
        told = np.array([0.5, *(float(env.step("listen")[0][0]) for _ in range(4))])
        odds = np.log(told / (1 - told))
        assert np.abs(np.diff(odds)) == pytest.approx(np.log(0.85 / 0.15), abs=0.01)  # of one observation a step


def test_a_belief_begins_with_the_factors_that_are_observed():
    model = problems.tag().revealed()
    env = mdm.gym.environment(model, "belief")
    belief, _ = env.reset(seed=1)
    cells = {model.state_space.unravel(int(state))[0] for state in np.flatnonzero(belief)}
    assert len(cells) == 1
    assert belief.sum() == pytest.approx(1)


def test_actions_that_are_not_available_are_masked_and_refused():
    available = np.array([[True, False], [True, True]])
    model = MDP([[[0, 1], [1, 0]]] * 2, [[0, 0], [1, 2]], discount=0.9, available=available, initial_belief=[1, 0])
    env = mdm.gym.environment(model)
    _, info = env.reset()
    assert info["action_mask"].tolist() == [1, 0]
    assert env.action_space.sample(info["action_mask"]) == 0
    with refused(ModelError):
        env.step(1)
    assert env.step(0)[4]["action_mask"].tolist() == [1, 1]


# -- Seeds -------------------------------------------------------------------------------------------------------------


def run(env, seed, count=40):
    seen = [env.reset(seed=seed)[0]]
    for _ in range(count):
        observation, reward, terminated, *_ = env.step(int(env.np_random.integers(env.action_space.n)))
        seen += [observation, reward]
        if terminated:
            seen.append(env.reset()[0])
    return seen


def test_equal_seeds_bring_equal_episodes_and_others_do_not():
    model = problems.hallway()
    runs = [run(mdm.gym.environment(model), seed) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]
    env = mdm.gym.environment(model)
    assert [run(env, 1), run(env, 1)] == [runs[0]] * 2
    env.np_random = np.random.default_rng(7)  # as wrappers may
    first = [env.reset()[0], *(env.step(0)[:2] for _ in range(9))]
    env.np_random = np.random.default_rng(7)
    assert first == [env.reset()[0], *(env.step(0)[:2] for _ in range(9))]


def test_vectors_of_environments_and_copies_of_one_go_on_alike():
    tiger = problems.tiger()
    vector = gymnasium.vector.SyncVectorEnv([lambda: mdm.gym.environment(tiger, steps=5)] * 3)
    vector.reset(seed=[1, 1, 2])
    rows = [vector.step(np.zeros(3, dtype=int))[0] for _ in range(10)]
    assert all(row[0] == row[1] for row in rows)
    assert any(row[1] != row[2] for row in rows)
    env = mdm.gym.environment(tiger)
    env.reset(seed=4)
    env.step(0)
    copy = pickle.loads(pickle.dumps(env))
    assert [env.step(0)[0] for _ in range(20)] == [copy.step(0)[0] for _ in range(20)]


def test_seeds_of_teams_decide_their_episodes():
    def heard(seed):
        env = mdm.gym.parallel(problems.dec_tiger())
        env.reset(seed=seed)
        return [tuple(env.step({"agent0": 0, "agent1": 0})[0].values()) for _ in range(20)]

    runs = [heard(seed) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]
    assert any(one != two for one, two in pairwise(runs[0]))


# -- Arguments ---------------------------------------------------------------------------------------------------------


def test_what_no_environment_can_be_made_of_is_said():
    tiger, river = problems.tiger(), problems.river_swim()
    for wrong in (
        lambda: mdm.gym.environment(river, "belief"),
        lambda: mdm.gym.environment(tiger, "state"),
        lambda: mdm.gym.environment(tiger, steps=0),
        lambda: mdm.gym.environment(tiger, steps=True),
        lambda: mdm.gym.environment(tiger, factored="no"),
        lambda: mdm.gym.environment([1, 2]),
        lambda: mdm.gym.environment(tiger).step(0),
    ):
        with refused(ConfigError):
            wrong()
    seen_together = POMDP(
        [np.eye(2)] * 4,
        [np.eye(2)] * 4,
        np.zeros((2, 4)),
        discount=0.9,
        actions=Space([Factor("a", 2), Factor("b", 2)]),
    )
    for wrong in (
        lambda: mdm.gym.environment(tiger.with_discount(0.9, of="second")),
        lambda: mdm.gym.parallel(seen_together),
    ):
        with refused(ModelError):
            wrong()
    env = mdm.gym.environment(tiger)
    env.reset()
    for action in (3, -1, 1.0, True, "lisen"):
        with refused(ModelError):
            env.step(action)


@pytest.mark.parametrize("absent", ["gymnasium", "pettingzoo"])
def test_without_the_extra_a_sentence_says_what_to_install(absent, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == absent]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "mdm.gym.environments", raising=False)
    monkeypatch.delattr(mdm.gym, "environments", raising=False)
    monkeypatch.setitem(sys.modules, absent, None)
    for make in (mdm.gym.environment, mdm.gym.parallel):
        with refused(Error):
            make(problems.dec_tiger())
