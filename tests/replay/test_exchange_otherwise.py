"""A team replayed with another policy: what it would have decided, as a belief computed here says, and up to when."""

from __future__ import annotations

import re

import numpy as np
import pytest
from team_records import recorded, repeated
from team_robots import three

from mdm.errors import Error
from mdm.policies import AlphaVectors
from mdm.recording import Record
from mdm.replay import Together, replay_together
from mdm.replay.exchange import Traffic
from mdm.stimuli import Received
from mdm.team import Team
from mdm.team.communication import Always, OnChange, ValueOfCommunication

pytestmark = pytest.mark.usefixtures("recorded_here")

MODEL = three()
TRANSITIONS = [np.asarray(MODEL.transition_matrix(action)) for action in range(len(MODEL.action_space))]
OBSERVATIONS = [np.asarray(MODEL.observation_matrix(action)) for action in range(len(MODEL.action_space))]
REWARDS = np.asarray(MODEL.rewards)
SIZES = [len(factor.names) for factor in MODEL.observation_space.factors]


def vectors(seed):
    """Return a vector for each action: the values of the run's policy, with a bonus for each action by a seed."""
    best = REWARDS.max(axis=1)
    values = np.array([REWARDS[:, action] + 0.9 * matrix @ best for action, matrix in enumerate(TRANSITIONS)])
    return values + np.random.default_rng(seed).uniform(0, 0.3, len(values))[:, None]


def would_decide(decisions, values):
    """Return the actions by the vectors on the observations of recorded decisions, from the first belief on."""
    belief, actions = np.asarray(MODEL.initial_belief, dtype=float), []
    for decision in decisions:
        if actions and decision.cause != "start":
            observed = decision.observation
            if observed is None:
                observed = (None,) * len(SIZES)
            elif not isinstance(observed, list | tuple):
                observed = np.unravel_index(observed, SIZES)
            likely = OBSERVATIONS[actions[-1]].reshape(-1, *SIZES)
            likely = likely[(slice(None), *(slice(None) if one is None else slice(one, one + 1) for one in observed))]
            belief = (belief @ TRANSITIONS[actions[-1]]) * likely.reshape(len(belief), -1).sum(axis=1)
            belief /= belief.sum()
        actions.append(int(np.argmax(values @ belief)))
    return actions


def decisions_of(folder, name):
    return [each.message for each in Record(folder / f"{name}.mcap").messages(["decisions"])]


TEAMS = [{}, {"period": 0.1}, {"mode": "centralised"}, {"mode": "centralised", "period": 0.1}]


def each_once(options, seeds):
    """Return pairs of options and seeds: all, but each of the options with one seed alone in the default ring."""
    return [
        pytest.param(each, seed, id=f"options{place}-{seed}", marks=() if place % len(seeds) == n else pytest.mark.slow)
        for place, each in enumerate(options)
        for n, seed in enumerate(seeds)
    ]


@pytest.mark.parametrize(("options", "seed"), each_once(TEAMS, [1, 2, 3]))
def test_a_team_decides_what_another_policy_says_of_its_observations(tmp_path, options, seed):
    team, values = Team("fire", ["one", "two", "three"], **options), vectors(seed)
    recorded(team, MODEL, tmp_path, seed, delay=(0.001, 0.03), loss=0.1)
    as_recorded, _ = repeated(team, MODEL, tmp_path)
    policy = AlphaVectors(values, list(range(len(values))))
    together, _ = repeated(team, MODEL, tmp_path, policy, as_recorded)
    found = set()
    for name, result in together.agents.items():
        assert result.limit is None
        decisions = decisions_of(tmp_path, name)[: result.recorded]
        assert result.recorded == result.replayed == as_recorded.agents[name].recorded > 5
        expected = would_decide(decisions, values)
        different = [number for number, each in enumerate(decisions) if expected[number] != each.action]
        told = [each for each in result.differences if "action" in each.fields]
        assert [each.number for each in told] == different
        assert [each.replayed.action for each in told] == [expected[number] for number in different]
        if different:
            assert result.differences[0].number == different[0]
            found.add(name)
    assert bool(found) != together.same


def test_so_many_differences_are_kept_as_are_asked_for(tmp_path):
    team, policy = Team("fire", ["one", "two", "three"]), AlphaVectors(vectors(1), list(range(8)))
    recorded(team, MODEL, tmp_path, 1)
    as_recorded, _ = repeated(team, MODEL, tmp_path)
    together, _ = repeated(team, MODEL, tmp_path, policy, as_recorded, most=2)
    assert len(together.agents["one"].differences) == 2
    assert together.agents["one"].different > 4  # the others count, too
    together, _ = repeated(team, MODEL, tmp_path, policy, most=3)
    assert len(together.agents["one"].differences) == together.agents["one"].different == 3  # there it ends


def test_these_policies_do_differ(tmp_path):
    """Else the test above would show nothing."""
    team = Team("fire", ["one", "two", "three"])
    recorded(team, MODEL, tmp_path, 1)
    decisions = decisions_of(tmp_path, "one")
    firsts = []
    for seed in (1, 2, 3):
        actions = would_decide(decisions, vectors(seed))
        firsts.append(next((n for n, each in enumerate(decisions) if each.action != actions[n]), None))
    assert len(set(firsts)) > 1


class WhenOdd:
    """Shares where the present action has an odd number: with another policy, at other times."""

    uses_common_belief = False

    def share(self, knowledge, now):
        return knowledge.unshared if knowledge.action % 2 else ()


COMMUNICATING = [Always(), OnChange(), ValueOfCommunication(0.02), WhenOdd()]


@pytest.mark.parametrize(
    ("options", "seed"),
    each_once(
        [*TEAMS, *({"mode": "communicating", "period": 0.1, "communication": each} for each in COMMUNICATING)],
        [1, 2, 3, 4],
    ),
)
def test_it_is_what_the_team_decides_where_it_runs_with_the_other_policy(tmp_path, options, seed):
    """Sensors of this run say the same whatever is decided: so what would have been can be seen, up to the limit."""
    team, policy = Team("fire", ["one", "two", "three"], **options), AlphaVectors(vectors(seed), list(range(8)))
    recorded(team, MODEL, tmp_path, seed)
    recorded(team, MODEL, tmp_path / "other", seed, policy)
    as_recorded, _ = repeated(team, MODEL, tmp_path)
    assert as_recorded.same
    together, _ = repeated(team, MODEL, tmp_path, policy, as_recorded)
    for name, result in together.agents.items():
        decisions, different = decisions_of(tmp_path, name), {each.number: each for each in result.differences}
        assert all(each.recorded is not None and each.replayed is not None for each in result.differences)
        made = [different[n].replayed if n in different else decisions[n] for n in range(result.replayed)]
        seen = decisions_of(tmp_path / "other", name)[: len(made)]
        assert result.recorded == result.replayed
        assert result.limit is not None or len(made) > 5
        assert [(each.time, each.action_name) for each in made] == [(each.time, each.action_name) for each in seen]
        for one, other in zip(made, seen, strict=True):
            assert one.belief is None or np.array_equal(one.belief, other.belief)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_where_an_agent_would_share_otherwise_nothing_is_told_from_there_on(tmp_path, seed):
    team = Team("fire", ["one", "two", "three"], mode="communicating", period=0.1, communication=WhenOdd())
    recorded(team, MODEL, tmp_path, seed)
    as_recorded, _ = repeated(team, MODEL, tmp_path)
    together, _ = repeated(team, MODEL, tmp_path, AlphaVectors(vectors(seed), list(range(8))), as_recorded)
    assert not together.same
    for name, result in together.agents.items():
        assert result.recorded < as_recorded.agents[name].recorded
        assert re.search(
            r"(sends|sent) a message under mdm/fire/(one|two|three)/joint/update, and d", result.limit.reason
        )


def test_the_same_policy_decides_the_same(tmp_path):
    team = Team("fire", ["one", "two", "three"])
    recorded(team, MODEL, tmp_path, 1, delay=(0.001, 0.03), loss=0.1)
    as_recorded, _ = repeated(team, MODEL, tmp_path)
    together, _ = repeated(team, MODEL, tmp_path, None, as_recorded)
    assert together.same
    assert all(each.recorded == each.replayed > 5 for each in together.agents.values())


def test_another_lease_has_other_beats_of_which_nothing_follows(tmp_path):
    team = Team("fire", ["one", "two", "three"])
    recorded(team, MODEL, tmp_path, 1)
    as_recorded, _ = repeated(team, MODEL, tmp_path)
    together, _ = repeated(Team(team.name, team.names, lease=0.7), MODEL, tmp_path, None, as_recorded)
    assert not together.same
    for result in together.agents.values():
        assert (result.recorded, result.replayed, result.differences) == (0, 0, ())
        assert "/beat, and d" in result.limit.reason


def test_without_the_record_of_an_agent_nothing_is_told_once_it_was_heard(tmp_path):
    team, values = Team("fire", ["one", "two", "three"]), vectors(1)
    recorded(team, MODEL, tmp_path, 1)
    names = ["one", "two"]
    as_recorded, _ = repeated(team, MODEL, tmp_path, names=names)
    assert as_recorded.same
    assert as_recorded.strange["three"] > 10
    policy = AlphaVectors(values, list(range(len(values))))
    together, _ = repeated(team, MODEL, tmp_path, policy, as_recorded, names=names)
    for result in together.agents.values():
        assert (result.recorded, result.differences, result.same) == (0, (), False)
        assert "of three, of whose life then no record is here" in result.limit.reason


def test_records_that_are_not_repeated_as_they_are_tell_nothing():
    unlike = (Received(1, "b", "fire/*/x", "fire/a/x", "a", 1, 0, b""),)
    for as_recorded in (Together({}, 0, (), 0), Together({}, 1, unlike, 0, {}, Traffic({}, {}))):
        with pytest.raises(Error, match="are not repeated as they are"):
            replay_together({}, {}, {}, as_recorded=as_recorded)
