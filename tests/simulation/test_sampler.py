"""Samples follow the model."""

from __future__ import annotations

import numpy as np
from random_models import random_mdp

from mdm.models import MDP
from mdm.simulation import Sampler


def test_draws_follow_the_model():
    model, _ = random_mdp(3)
    for sparse in (False, True):
        again = MDP([model.transition_matrix(a) for a in range(2)], model.rewards, discount=0.8, sparse=sparse)
        sampler = Sampler(again, seed=1)
        counts = np.bincount([sampler.next_state(2, 1) for _ in range(20_000)], minlength=4)
        np.testing.assert_allclose(counts / 20_000, model.transition_matrix(1)[2], atol=0.02)
