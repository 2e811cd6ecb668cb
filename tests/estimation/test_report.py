"""The report about a model."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import decision, heard, lived, visits, wandering
from scipy.linalg import expm

import mdm
from mdm import ModelError
from mdm.estimation import as_data, as_text, chains_of, rate_intervals, statistics
from mdm.estimation.loss import Values
from mdm.models import MDP, Durations

TRUE = np.array([[0.5, 0.5, 0.0], [0.0, 0.9, 0.1], [1.0, 0.0, 0.0]])
USED = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [1.0, 0.0, 0.0]])


def model(**options):
    options = {"states": ["a", "b", "c"], "actions": ["x", "y"], "discount": 0.9} | options
    return MDP([USED, USED], [[0, 0], [0, 0], [1, 1]], **options)


def test_a_wrong_row_comes_first_with_its_loss_and_the_right_ones_agree():
    report = statistics(visits(wandering(TRUE, 2_000, seed=1)), model(), kind="steps")
    first = report.rows[0]
    assert (first.matrix, first.action, first.state, first.says) == ("T", "x", "b", "differs")
    assert {(row.state, row.says) for row in report.rows[1:]} == {("a", "agrees"), ("c", "certain")}
    assert [entry.symbol for entry in first.entries] == ["b", "c"]
    assert abs(first.entries[0].estimate - 0.9) < 0.03
    assert first.entries[0].low < 0.9 < first.entries[0].high
    other = np.array(USED)
    other[1] = [0, first.entries[0].estimate, first.entries[1].estimate]
    values = [Values(MDP([each], [[0], [0], [1]], discount=0.9), [0] * 3).start for each in (USED, other)]
    assert report.value == pytest.approx(values[0])
    assert first.loss == pytest.approx(values[0] - values[1])
    assert first.loss > 0.5
    assert report.unvisited == (("y", "a"), ("y", "b"), ("y", "c"))
    assert report.model.transition("x", "b") == pytest.approx([0, 0.9, 0.1], abs=0.03)
    assert report.model.transition("y", "b").tolist() == [0, 0.5, 0.5]


def test_a_policy_may_be_given_for_the_loss():
    told = visits(wandering(TRUE, 500))
    assert statistics(told, model(), kind="steps", policy=[1, 1, 1]).rows[0].loss is None


def test_without_a_discount_the_loss_is_not_computed_and_that_is_said():
    report = statistics(visits([0, 1, 2]), model(discount=1.0))
    assert (report.value, report.rows[0].loss) == (None, None)
    assert report.notes[0].startswith("with a discount of 1 the loss of value is not computed")


def test_jumps_have_rates_and_durations():
    told = visits([0, 1, 2, 0], times=[0, 2, 6, 7])
    report = statistics(told, model(), stops=[9_000_000_000])
    assert report.kind == "jumps"
    first = report.rates[0]
    assert (first.action, first.state, first.exposure, first.ends) == ("x", "a", 4.0, 1)
    assert first.entries[0].symbol == "b"
    assert first.entries[0].model is None
    assert first.entries[0].low == pytest.approx(float(rate_intervals([1], 4.0).low[0]))
    assert report.durations.means[:, 0].tolist() == [2.0, 2.0, 1.0]  # of 'a' and 'b' half of the steps stay
    assert report.model.transition("x", "a").tolist() == [0.5, 0.5, 0]  # what stays is not seen


@pytest.mark.parametrize(
    ("of", "step", "discount"),
    [("step", 10.0, 0.9), (10.0, 10.0, 0.9), ("second", 10.0, 0.9**10), ("second", 2.0, 0.81)],
)
def test_a_discount_is_converted_into_one_of_the_step(of, step, discount):
    told = visits([0, 1] * 6, times=[3 * time for time in range(12)])
    report = statistics(told, model().with_discount(0.9, of=of), step=step)
    assert (report.model.discount, report.model.discount_of) == (pytest.approx(discount), step)
    assert report.durations.means == pytest.approx(step)
    with pytest.raises(ModelError, match="a step of the model is 5 s, not 10 s"):
        statistics(told, model().with_discount(0.9, of=5.0), step=10.0)


def test_returns_by_a_discount_of_a_second_count_seconds():
    told = visits([0, 1, 0], times=[0, 3, 6])
    earns = model()
    (found,) = statistics(told, earns.with_discount(0.9, of="second")).returns
    rewards = [float(earns.rewards[each.state, each.action]) for each in told]
    assert found == pytest.approx(sum(0.9 ** (3 * place) * reward for place, reward in enumerate(rewards)))
    assert statistics(told, earns.with_discount(0.9, of="second")).value is None


def test_a_step_in_seconds_makes_rates_probabilities():
    told = visits([0, 1, 2] * 200 + [0], times=np.cumsum([0] + [10.0, 2.0, 1.0] * 200))
    report = statistics(told, model(), step=1.0)
    generator = np.diag([-200.5 / 2000, -200.5 / 400, -199.5 / 200])
    generator[[0, 1, 2], [1, 2, 0]] = -np.diag(generator)
    after = expm(generator)[0, :2]
    assert report.model.transition("x", "a") == pytest.approx([*after / after.sum(), 0], abs=1e-3)
    assert report.rates[0].entries[0].model == pytest.approx(np.log(2))
    with pytest.raises(ModelError, match="a step in seconds is for rates"):
        statistics(told, model(), kind="steps", step=1.0)


def test_hidden_states_are_estimated_with_intervals_and_verdicts():
    """The microphone hears right in 60 %, in place of the 85 % of the model."""
    random = np.random.default_rng(1)
    actions, symbols, door = [0], [], 0
    for step in range(500):
        action = actions[-1]
        if action:
            door = int(random.integers(2))
        symbols.append(door if random.random() < (0.5 if action else 0.6) else 1 - door)
        actions.append(1 if step % 10 == 9 else 0)
    report = statistics(heard(actions, symbols), mdm.problems.tiger())
    assert report.hidden
    assert report.fit.after > report.fit.before + 10
    rows = {(row.matrix, row.action, row.state): row for row in report.rows}
    listening = rows["O", "listen", "tiger-left"]
    assert (listening.says, rows["O", "open-left", "tiger-left"].says) == ("differs", "agrees")
    assert listening.entries[0].low < listening.entries[0].estimate < listening.entries[0].high < 0.85
    assert rows["T", "listen", "tiger-left"].says == "certain"
    assert {each.action for each in report.frequencies} == {"listen", "open-left"}
    assert report.model.observation("listen", "tiger-left", "hear-left") == listening.entries[0].estimate
    assert mdm.solve(report.model, iterations=20).policy.num_actions == 3


def looked(right, count=360):
    """Return what a robot hears of a door that stays as it is in nine of ten steps, by a sensor of its own."""
    random = np.random.default_rng(4)
    door, symbols = 0, []
    for _ in range(count):
        door = door if random.random() < 0.95 else 1 - door
        symbols.append(door if random.random() < right else 1 - door)
    return heard([0, 0, 1] * (count // 3) + [0], symbols)


def sensor(right):
    moved, seen = np.eye(2) * 0.9 + 0.05, np.array([[right, 1 - right], [1 - right, right]])
    names = {"states": ["open", "shut"], "actions": ["look", "drive"], "observation_names": ["gap", "wall"]}
    return mdm.models.POMDP([moved] * 2, [seen] * 2, np.zeros((2, 2)), discount=0.9, **names)


@pytest.mark.parametrize(
    ("says", "apart"),
    [
        (0.85, True),
        (0.6, True),
        (0.505, False),
        pytest.param(0.51, True, marks=pytest.mark.slow),
        pytest.param(0.5, False, marks=pytest.mark.slow),
    ],
)
def test_no_hidden_row_agrees_that_its_interval_refutes(says, apart):
    """The sensor is right in 85 %: each row alone, with all others held as in a wrong model, looked right."""
    report = statistics(looked(0.85), sensor(says))
    assert (report.fit.log_odds > np.log(1000)) == (says != 0.85)
    assert report.fit.alike == (() if apart else (("open", "shut"),))
    for row in report.rows:
        refuted = any(not entry.low <= entry.model <= entry.high for entry in row.entries)
        assert row.says in ({"differs", "unclear"} if refuted else {"agrees"}) if apart else row.says == "unclear"
    assert (report.rows[0].says == "differs") == (says in {0.6, 0.51})
    text = as_text(report)
    assert ("these states cannot be told apart by the model in this record: open, shut" in text) == (not apart)
    assert f"T and O together: the odds against the model are {'10^' if says != 0.85 else ''}" in text
    assert ("it agrees" in text) == (says == 0.85)
    assert "by all entries together" not in text


def test_the_decisions_of_a_real_loop_agree_with_the_model_that_drives_it():
    forest = mdm.problems.forest()
    told = lived(forest, mdm.solve(forest).policy, 4_000, horizon=50)
    report = statistics(told, forest, kind="steps")
    assert report.count("differs") == 0
    assert report.count("agrees") >= 2
    assert len(report.returns) > 50
    assert abs(np.mean(report.returns) - report.value) < 5 * np.std(report.returns) / len(report.returns) ** 0.5 + 1


def test_durations_of_a_world_are_found_again():
    forest = mdm.problems.forest()
    world = {"durations": Durations(3.0, stages=4)}
    report = statistics(lived(forest, mdm.solve(forest).policy, 3_000, world=world), forest, kind="steps")
    visited = {(row.action, row.state) for row in report.rows}
    for action, state in visited:
        place = forest.state_space.index(state), forest.action_space.index(action)
        assert report.durations.means[place] == pytest.approx(3, rel=0.15)
    assert (report.durations.stages.max(), report.durations.stages.min()) > (2, 0)


def test_a_fixed_rate_has_no_durations():
    forest = mdm.problems.forest()
    report = statistics(lived(forest, mdm.solve(forest).policy, 200, drive=2.0), forest)
    assert (report.kind, report.durations, report.chains) == ("steps", None, 1)
    assert report.decisions > 300


def test_what_does_not_fit_the_model_is_refused():
    with pytest.raises(ModelError, match="was in state 7, but the model has 3 states"):
        statistics(visits([0, 7]), model())
    with pytest.raises(ModelError, match="decided on action 5, but the model has 2 actions"):
        statistics(visits([0, 1], actions=[0, 5]), model())
    with pytest.raises(ModelError, match="decides on observations, but the model is an MDP"):
        statistics(heard([0, 0], [1]), model())
    with pytest.raises(ModelError, match="no decision of 'robot' follows from another"):
        statistics([decision(0, 0, "start")], mdm.problems.tiger())


def test_the_report_counts_what_the_chains_have():
    told = [*visits([0, 1, 2]), decision(3, 3, "team"), *visits([0, 1])]
    chains, report = chains_of(told), statistics(told, model())
    assert (report.chains, report.decisions, report.discarded) == (len(chains.chains), 5, 1)
    assert as_data(report)["chains"] == 2
