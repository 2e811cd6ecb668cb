from __future__ import annotations

import numpy as np
from sentences import refused

from mdm import ModelError
from mdm.problems import tag


def test_published_sizes():
    model = tag()
    assert (len(model.state_space), len(model.action_space), len(model.observation_space)) == (870, 5, 30)
    assert model.state_space.shape == (29, 30)
    assert [
        f.name for f, seen in zip(model.state_space.factors, model.network.fully_observed, strict=True) if seen
    ] == ["robot"]


def test_the_target_flees():
    model = tag()
    # The robot in the south-west corner, the target two cells to the east of it: on a row with it.
    robot, target = "row4-column0", "row4-column2"
    row = model.transition("north", f"{robot} {target}").reshape(29, 30)
    reached = {
        (model.state_space.factors[0].names[r], model.state_space.factors[1].names[t]): round(float(row[r, t]), 12)
        for r, t in np.argwhere(row)
    }
    assert reached == {
        ("row3-column0", target): 0.4,  # it stays, or runs against the wall in the south
        ("row3-column0", "row4-column3"): 0.4,
        ("row3-column0", "row3-column2"): 0.2,
    }


def test_catching():
    model = tag()
    assert model.transition("catch", "row2-column5 row2-column5", "row2-column5 tagged") == 1
    assert model.reward("catch", "row2-column5 row2-column5") == 10
    assert model.reward("catch", "row2-column5 row2-column6") == -10
    assert model.reward("catch", "row2-column5 tagged") == 0
    assert model.reward("north", "row2-column5 row2-column5") == -1
    assert model.transition("north", "row2-column5 tagged", "row2-column5 tagged") == 1
    assert model.observation("north", "row2-column5 row2-column5", "target") == 1
    assert model.observation("north", "row2-column5 row2-column6", "row2-column5") == 1


def test_other_fields():
    model = tag("..\n..")
    assert model.state_space.shape == (4, 5)
    with refused(ModelError):
        tag(".")
