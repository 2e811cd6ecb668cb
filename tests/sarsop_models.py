"""Models for the tests of SARSOP."""

from __future__ import annotations

import numpy as np
from random_models import distributions

from mdm.models import POMDP, Factor, FactoredPOMDP, MixedPOMDP, Space
from mdm.models.factored.factoring import as_network


def mixed(seed):
    """Return a model whose first factor is seen."""
    random = np.random.default_rng(seed)
    states = Space([Factor("seen", 2), Factor("hidden", 3)])
    initial = np.zeros(6)
    initial[3:] = distributions(random, 3)
    model = POMDP(
        distributions(random, 2, 6, 6),
        distributions(random, 2, 6, 2),
        random.normal(size=(6, 2)),
        discount=0.6,
        states=states,
        initial_belief=initial,
    )
    return MixedPOMDP(FactoredPOMDP(as_network(model), discount=0.6), [0])
