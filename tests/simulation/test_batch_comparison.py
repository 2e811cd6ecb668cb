"""Several policies in the same luck."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused
from worked import Cautious

import mdm
from mdm import ConfigError
from mdm.policies import AlphaVectors, ConstantPolicy
from mdm.problems import tiger

POLICIES = [ConstantPolicy(0, 3, 2), AlphaVectors([[9, 9], [-90, 11], [11, -90]], [0, 1, 2])]


def test_differences_are_of_pairs():
    found = mdm.compare(tiger(), POLICIES, episodes=500, steps=20, seed=2)
    alone = [mdm.evaluate(tiger(), each, episodes=500, steps=20, seed=2).returns for each in POLICIES]
    assert all(np.array_equal(each.returns, own) for each, own in zip(found.evaluations, alone, strict=True))
    mean, within = found.difference(1)
    pairs = alone[1] - alone[0]
    assert mean == pytest.approx(pairs.mean())
    assert within == pytest.approx(1.96 * pairs.std(ddof=1) / np.sqrt(500))
    assert found.difference(0) == (0, 0)


def test_who_is_told_of_progress_ends_it():
    told = []
    found = mdm.compare(
        tiger(), [Cautious()] * 3, episodes=4, steps=3, seed=1, progress=lambda *each: told.append(each) or each[0] == 6
    )
    assert [each.episodes for each in found.evaluations] == [4, 2]
    assert told[-1] == (6, 12)
    assert found.difference(1)[1] > 0


def test_there_is_a_policy():
    for wrong in ([], "tiger.vf"):
        with refused(ConfigError):
            mdm.compare(tiger(), wrong)
