"""The beliefs that exploration meets."""

from __future__ import annotations

import numpy as np

from mdm.models.dynamics import Dynamics
from mdm.problems import tiger
from mdm.solvers import Limits
from mdm.solvers.joint_dynamics import JointDynamics
from mdm.solvers.perseus import sampled, starts


def test_fewer_beliefs_are_sampled_where_there_is_no_room_for_all():
    model = tiger()
    limits = Limits(memory=1)
    dynamics = JointDynamics(Dynamics(model))
    found = sampled(model, dynamics, starts(model), 50, np.random.default_rng(0), limits)
    assert len(found) == 1
    assert len(sampled(model, dynamics, starts(model), 50, np.random.default_rng(0), Limits())) > 1
