"""What tests of policy files share: small models of given sizes, and what it means that a file is refused."""

from __future__ import annotations

import numpy as np
import pytest

from mdm import FormatError
from mdm.formats import files as policies
from mdm.models import POMDP


def model_of(num_states=2, num_actions=3, num_observations=2):
    """Return a model of so many states, actions and observations; by default as many as the tiger problem has."""
    uniform = np.full((num_actions, num_states, num_observations), 1 / num_observations)
    stay = [np.eye(num_states)] * num_actions
    return POMDP(stay, uniform, np.zeros((num_states, num_actions)), discount=0.9)


def pairs(policy):
    """Return the actions and values of alpha vectors."""
    return [(action, vector.tolist()) for action, vector in zip(policy.actions, policy.vectors, strict=True)]


def assert_refused(path, text, line, words):
    """Write a policy for a model of the tiger problem's sizes, and have it refused at a line, in these words."""
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        policies.load_policy(path, model_of())
    assert words in str(caught.value)
    assert caught.value.line == line
    assert caught.value.file == str(path)
