"""Problems against files of the same problems, number by number."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from places import each
from same_model import assert_same_model

from mdm import load_model, problems
from mdm.errors import ModelWarning
from mdm.models import POMDP, Factor, Space

FILES = {
    "madp/dectiger.dpomdp": (problems.dec_tiger, 1e-12),
    "madp/dectiger_skewed.dpomdp": (lambda: problems.dec_tiger(left=0.8), 1e-12),
    "madp/broadcastChannel.dpomdp": (problems.broadcast_channel, 1e-12),
    "madp/GridSmall.dpomdp": (problems.grid_small, 1e-12),
    "madp/Grid3x3corners.dpomdp.gz": (problems.meeting, 1e-12),
    "madp/recycling.dpomdp": (problems.recycling_robots, 1e-12),
    "madp/relay4.dpomdp": (problems.relay, 1e-12),
    "madp/Mars.dpomdp.gz": (problems.mars_rovers, 1e-12),
    "pomdp-solve/tiger.95.POMDP": (problems.tiger, 1e-12),
    "pomdp-solve/tiger.aaai.POMDP": (lambda: problems.tiger(discount=0.75), 1e-12),
    "sarsop/TagAvoid.pomdpx": (problems.tag, 1e-9),
    # These files have six digits; of the hallways, five in places.
    "sarsop/RockSample_7_8.pomdpx": (lambda: problems.rock_sample(7, 8), 1e-6),
    "sarsop/Hallway.pomdp": (problems.hallway, 6e-5),
    "sarsop/Hallway2.pomdp": (problems.hallway2, 6e-5),
    "solvers/aloha.10.pomdp.gz": (problems.aloha, 2e-6),
    "solvers/machine.pomdp.gz": (problems.machine_maintenance, 5e-6),
}
"""Files of the same problems, and how many digits they have."""


@pytest.mark.foreign("models of MADPToolbox/MADP, cassandra/pomdp-solve, AdaCompNUS/sarsop and others")
@pytest.mark.parametrize("file", each(FILES))
@pytest.mark.filterwarnings("ignore::mdm.ModelWarning")  # few digits do not quite sum to 1
def test_problems_are_those_of_files(corpus, file):
    problem, exactness = FILES[file]
    assert_same_model(problem(), load_model(corpus / "models" / file), atol=exactness)


def box_pushing(corpus):
    """But for one entry, in which the file has the right agent turn while it moves."""
    model, other = problems.box_pushing(), load_model(corpus / "models" / "madp" / "boxPushingUAI07.dpomdp.gz")
    states = {name: index for index, name in enumerate(other.state_space.names)}
    transitions = [np.array(other.transition_matrix(action)) for action in range(16)]
    row = transitions[other.action_space.index("moveForward moveForward")][states["s2E4W"]]
    assert row[states["s3E4S"]] == pytest.approx(0.09)
    row[[states["s3E4S"], states["s3E4W"]]] = 0, 0.09
    mended = POMDP(
        transitions,
        [other.observation_matrix(action) for action in range(16)],
        other.rewards,
        discount=1.0,
        states=other.state_space,
        actions=other.action_space,
        observation_names=other.observation_space,
        initial_belief=other.initial_belief,
    )
    assert_same_model(model, mended, atol=1e-12)
    assert list(model.state_space.names) == list(other.state_space.names)


def fire_fighting(corpus):
    """The file has probabilities of two digits; those of observations and the rewards of outcomes are exact."""
    model, other = problems.fire_fighting().flatten(), load_model(corpus / "models/madp/fireFighting_2_3_3.dpomdp.gz")
    assert [name.replace(" ", "_") for name in model.state_space.names] == list(other.state_space.names)
    np.testing.assert_allclose(model.initial_belief, other.initial_belief, atol=1e-12)
    for action in range(9):
        np.testing.assert_allclose(model.observation_matrix(action), other.observation_matrix(action), atol=1e-12)
        difference = np.abs(model.transition_matrix(action) - other.transition_matrix(action))
        assert difference.max() < 0.006
        for state, later in np.argwhere(model.transition_matrix(action))[::97]:
            assert model.reward(action, state, later) == pytest.approx(other.reward(action, state, later))


def fire_fighting_graph(corpus):
    """The file names the second agent's observation first."""
    other = load_model(corpus / "models" / "madp" / "FFG343.pgmx").flatten()
    turned = np.arange(8).reshape(2, 2, 2).swapaxes(0, 1).ravel()
    mended = POMDP(
        [other.transition_matrix(action) for action in range(8)],
        [other.observation_matrix(action)[:, turned] for action in range(8)],
        other.rewards,
        discount=1.0,
        actions=other.action_space,
        observation_names=Space(Factor(f"agent{agent}", 2) for agent in range(3)),
        initial_belief=other.initial_belief,
    )
    assert_same_model(problems.fire_fighting_graph(), mended, atol=1e-12)


def patrol(corpus):
    """The file rounds the probabilities of observations to six digits."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        other = load_model(corpus / "models" / "madp" / "MAISS_Patrol_Single.pgmx").with_discount(0.9)
    model = problems.patrol()
    assert_same_model(model, other, atol=4e-7)
    for space, again in [(model.state_space, other.state_space), (model.observation_space, other.observation_space)]:
        assert [factor.names for factor in space.factors] == [factor.names for factor in again.factors]
    assert model.action_space.names == other.action_space.names


@pytest.mark.foreign("models of MADPToolbox/MADP")
@pytest.mark.parametrize("compare", each([box_pushing, fire_fighting, fire_fighting_graph, patrol]))
def test_problems_are_those_of_files_that_differ_in_little(corpus, compare):
    compare(corpus)
