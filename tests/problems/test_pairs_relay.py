from __future__ import annotations

import numpy as np
import pytest

from mdm.problems import relay


def test_entries():
    model = relay()
    assert model.transition("shuffle sense", "l1_r2").tolist() == [0, 0.5, 0, 0.5]
    assert model.transition("exchange exchange", "l1_r1").tolist() == [0.25] * 4
    assert model.transition("exchange exchange", "l1_r2").tolist() == [0, 1, 0, 0]
    assert model.observation("sense sense", "l1_r2", "door door") == pytest.approx(0.9 * 0.1)
    assert model.observation("shuffle sense", "l1_r1", "idle door") == pytest.approx(0.9)
    assert model.reward("exchange exchange", "l1_r1") == 50
    assert model.reward("exchange exchange", "l2_r1") == model.reward("sense exchange", "l1_r1") == -50
    assert model.reward("sense shuffle", "l2_r2") == -1


def test_value_of_agents_that_see_everything():
    """Exchange where both are at the door; else whoever is not there shuffles."""
    d, model = 0.95, relay()
    # V(both) = 50 + d (V(both) + 2 V(one) + V(none)) / 4, V(one) = -1 + d (V(both) + V(one)) / 2, and so on.
    system = [[1 - d / 4, -d / 2, -d / 4], [-d / 2, 1 - d / 2, 0], [-d / 4, -d / 2, 1 - d / 4]]
    both, one, none = np.linalg.solve(system, [50, -1, -1])
    values = np.zeros(4)
    for _ in range(1000):
        ahead = [model.transition_matrix(action) @ values for action in range(9)]
        values = (model.rewards.T + d * np.array(ahead)).max(axis=0)
    np.testing.assert_allclose(values, [both, one, one, none], atol=1e-9)
