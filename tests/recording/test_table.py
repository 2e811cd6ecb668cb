from __future__ import annotations

import numpy as np
import pytest
from records import Writing, decision, tiger

from mdm.messages import ActionLife, Reward, State
from mdm.recording.reader import Record
from mdm.recording.table import rows

pytestmark = pytest.mark.usefixtures("recorded_here")


def table(tmp_path, told, names=None, ensemble=None):
    """Return rows of a record of pairs of topic and message."""
    record = Writing(tmp_path / "run.mcap")
    if names is not None:
        record.writer.metadata("ensemble patrol", names)
    for topic, message in told:
        record.write(topic, message)
    return rows(Record(record.close()), ensemble)


def life(seconds, number, status, action="Go", detail="", ensemble="patrol"):
    return "lives", ActionLife(seconds * 1_000_000, ensemble, number, action, status, detail)


def made(seconds, action=1, **fields):
    return "decisions", decision(seconds, action=action, **fields)


def ends(found):
    return [(row.life, row.end, row.ended, row.detail) for row in found]


def test_an_action_s_end_is_that_of_its_decision(tmp_path):
    found = table(
        tmp_path,
        [
            made(1),
            life(1, 1, "running"),
            life(3, 1, "failed", detail="door"),
            made(4, 2),
            life(4, 2, "running"),
            life(5, 2, "succeeded"),
            made(6, 3),
        ],
    )
    assert ends(found) == [(1, "failed", 3_000_000, "door"), (2, "succeeded", 5_000_000, ""), (None, None, None, "")]


def test_a_pre_empted_action_ends_after_the_next_decision(tmp_path):
    found = table(
        tmp_path,
        [
            made(1),
            life(1, 1, "running"),
            made(4, 2),
            life(5, 1, "preempted"),
            life(5, 2, "running"),
            life(7, 2, "succeeded"),
        ],
    )
    assert [row[:3] for row in ends(found)] == [(1, "preempted", 5_000_000), (2, "succeeded", 7_000_000)]


def test_an_action_that_goes_on_ends_with_the_last_decision_for_it(tmp_path):
    found = table(tmp_path, [made(1), life(1, 1, "running"), made(2), made(3), life(4, 1, "timed_out"), made(5)])
    assert [row[:2] for row in ends(found)] == [(1, None), (1, None), (1, "timed_out"), (None, None)]


def test_ensembles_are_apart(tmp_path):
    told = [
        made(1, ensemble="top"),
        life(1, 1, "running", ensemble="top"),
        made(1, ensemble="below"),
        life(1, 1, "running", ensemble="below"),
        life(2, 1, "failed", ensemble="below"),
        life(3, 1, "succeeded", ensemble="top"),
        life(3, 9, "succeeded", ensemble="other"),
        life(3, 9, "running", ensemble="other"),
    ]
    assert [row.end for row in table(tmp_path, told)] == ["succeeded", "failed"]
    assert [row.end for row in table(tmp_path, told, ensemble="below")] == ["failed"]
    assert table(tmp_path, told, ensemble="nobody") == []


def test_true_rewards_belong_to_the_decision_of_their_number(tmp_path):
    """They come before the decision is told, or after it, and more than once where a step tells nothing."""
    pairs = [
        ("patrol/true_reward", Reward(0, 0, 2.0)),
        ("decisions", decision(0)),
        ("patrol/true_reward", Reward(0, 0, 0.5)),
        ("decisions", decision(1)),
        ("other/true_reward", Reward(1, 1, 9.0)),
        ("patrol/true_reward", Reward(2, 2, -1.0)),
        ("decisions", decision(2)),
        ("decisions", decision(3)),
        ("patrol/true_reward", Reward(3, 2, 0.25)),
    ]
    assert [row.true_reward for row in table(tmp_path, pairs)] == [2.5, None, -0.75, None]


def test_true_states_and_names(tmp_path):
    names = {"states": '["hall", "lab", "yard"]', "observations": '["light", "dark"]'}
    told = [
        made(1, state=None, observation=1),
        ("patrol/true_state", State(1, 2, (2,))),
        ("other/true_state", State(1, 0, (0,))),
        made(2, state=1, observation=None),
    ]
    found = table(tmp_path, told, names)
    assert [(row.state, row.observation, row.true_state) for row in found] == [(None, "dark", None), ("lab", None, 2)]


def test_the_tiger(tmp_path):
    """What its own decisions say: a belief by Bayes' rule, and doors that are opened at 0.97."""
    found = rows(Record(tiger(tmp_path / "run.mcap")))
    assert len(found) > 15
    assert {row.decision.action_name for row in found} == {"listen", "open-left", "open-right"}
    assert all(row.end == "succeeded" and row.ended == row.decision.time for row in found)
    heard = {"hear-left": np.array([0.85, 0.15]), "hear-right": np.array([0.15, 0.85])}
    belief = np.array([0.5, 0.5])
    before = None
    for row in found:
        if before is not None and before != "listen":
            belief = np.array([0.5, 0.5])
        elif row.observation is not None:
            belief = belief * heard[row.observation] / (belief @ heard[row.observation])
        np.testing.assert_allclose(row.decision.belief, belief, atol=1e-12)
        before = row.decision.action_name
