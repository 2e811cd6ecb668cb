"""Decisions of a record, retraced by a controller alone."""

from __future__ import annotations

import numpy as np
import pytest
import records
from sentences import refused

import mdm
from mdm import Error, problems
from mdm.policies import AlphaVectors, FiniteStateController, StagedPolicy
from mdm.recording import Record
from mdm.replay.retraced import found, retraced

TIGER = AlphaVectors([[0, 0], [10, -90], [-90, 10]], [0, 2, 1])


def lived(controller, seen, *, beliefs=True):
    """Return what a controller decides, as a record has it."""
    step = controller.start()
    told, decisions = [(step, "start", None, controller.belief)], []
    for observation in seen:
        step = controller.observe(observation)
        told.append((step, "observation", observation, controller.belief))
    for number, (each, cause, observation, belief) in enumerate(told):
        facts = {"cause": cause, "observation": observation, "belief": belief if beliefs else None}
        decisions.append(decision(number, each.epoch, each.action, **facts))
    return decisions, step


def decision(number, epoch, action, *, state=None, observation=None, belief=None, cause="state", ensemble="patrol"):
    name = ("listen", "open-left", "open-right")[action]
    return mdm.messages.Decision(
        *(number * 10**9, ensemble, epoch, cause, state, observation, belief, action, name, None)
    )


def written(path, decisions):
    return Record(records.written(path, [("decisions", each) for each in decisions]))


@pytest.mark.parametrize("beliefs", [True, False])
def test_a_step_explains_itself_as_it_would_have_then(beliefs):
    model = problems.tiger()
    decisions, step = lived(mdm.Controller(TIGER, model), [0, 1, 0, 0, 0], beliefs=beliefs)
    again = retraced(mdm.Controller(TIGER, model), decisions, len(decisions) - 1)
    assert again == step
    assert again.explain() == step.explain()


def test_a_belief_that_does_not_follow_is_taken_as_it_is():
    decisions, _ = lived(mdm.Controller(TIGER, problems.tiger()), [0, 0])
    other = decision(1, 1, 0, cause="belief", belief=np.array([0.3, 0.7]))
    step = retraced(mdm.Controller(TIGER, problems.tiger()), [decisions[0], other], 1)
    assert step.at.tolist() == [0.3, 0.7]
    assert step.case().updates == ()


def test_decisions_that_are_missing():
    decisions, _ = lived(mdm.Controller(TIGER, problems.tiger()), [0, 0, 0])
    step = retraced(mdm.Controller(TIGER, problems.tiger()), [decisions[0], decisions[3]], 1)
    assert step.epoch == 3
    assert step.at == pytest.approx(decisions[3].belief)


def test_plans_and_stages():
    plan = FiniteStateController([0, 1, 2], [[0, 1], [1, 2], [2, 2]])
    decisions, step = lived(mdm.Controller(plan), [0, 1, 0], beliefs=False)
    assert retraced(mdm.Controller(plan), decisions, 3).at == step.at == (1,)
    staged = StagedPolicy([[[0, 1], [1, 0]], [[1, 0], [0, 1]]])
    told = [decision(0, 0, 1, state=0), decision(1, 1, 0, state=0)]
    step = retraced(mdm.Controller(staged), told, 1)
    assert (step.at.state, step.at.stage) == (0, 1)
    assert step.explain().cannot == ("there is no model: what comes next is unknown",)


def test_no_decision_of_the_policy():
    with refused(Error):
        retraced(mdm.Controller([0, 1]), [decision(0, -1, 0)], 0)


def test_which_decision_is_meant(tmp_path):
    decisions = [
        decision(1, 0, 0, state=0),
        decision(2, 0, 1, state=1, ensemble="other"),
        decision(3, 1, 1, state=1),
        decision(5, 0, 0, state=0),
    ]
    record = written(tmp_path / "run.mcap", decisions)

    def meant(*arguments):
        place, own = found(record, *arguments)
        return own[place].ensemble, own[place].time // 10**9

    assert meant() == ("patrol", 5)
    assert meant(None, 1) == ("patrol", 3)
    assert meant("other", 0) == ("other", 2)
    assert meant(None, 0.0) == ("patrol", 1)
    assert meant(None, 1.5) == ("other", 2)
    assert meant("patrol", 1.5) == ("patrol", 1)
    for arguments in ((None, 0), (None, 7), ("nobody",), ("other", 0.5)):
        with refused(Error):
            found(record, *arguments)
    with refused(Error):
        found(written(tmp_path / "other.mcap", []))
