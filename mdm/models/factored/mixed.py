"""Mixed observability: some state factors are observed without error, the others are hidden.

A state is (x, y), x observed and y hidden, and the observation after an action is the pair (x', o). This is an ordinary
POMDP. The support of its beliefs has a single x, so it is no larger than the hidden part (S. C. W. Ong, S. W. Png, D.
Hsu and W. S. Lee, *Planning under uncertainty for robotic tasks with mixed observability*, International Journal of
Robotics Research 29, 2010).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.models.factored.model import FactoredPOMDP
from mdm.models.factored.two_slice import Node, Potential, Table, Tree, TwoSliceNetwork
from mdm.models.matrices import Checked, Vector, csr, is_compressed, read_only
from mdm.models.pomdp import POMDP
from mdm.models.space import Space

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Self

    import numpy.typing as npt

__all__ = ["MixedPOMDP"]


class MixedPOMDP(FactoredPOMDP):
    """A POMDP whose observations include the values of some state factors.

    These factors come first in its observation space, before those of the model. Their initial values are observed
    before the first action. `POMDP.revealed` makes one of a model that declares such factors.

    Args:
        model: The model; its observations depend on states.
        observed: The indices of the observed state factors.

    Raises:
        ModelError: If there is no such factor, the observations are events, or one of them is a false negative.

    Example::

        model = mdm.problems.tag()  # fully observed: the robot's cell
        mixed = mdm.models.MixedPOMDP(model, [0])
        len(model.observation_space), len(mixed.observation_space)  # 30, 870
    """

    def __init__(self, model: FactoredPOMDP, observed: Sequence[int]) -> None:
        states = model.state_space
        if not observed or not set(observed) <= set(range(len(states.factors))):
            raise ModelError(
                f"the observed factors {list(observed)} are not among the {len(states.factors)} state factors"
            )
        if len(set(observed)) < len(observed):
            raise ModelError(f"the observed factors {list(observed)} contain a duplicate")
        if model.event_observations:
            raise ModelError("a model with event observations cannot have observed factors")
        if model.false_negative is not None:
            raise ModelError(
                "observed factors are seen at every step, so the false negative must be a joint observation: declare "
                "it after revealing them, by model.revealed().with_false_negatives(...)"
            )
        super().__init__(_network(model.network, observed), discount=model.discount, sparse=True)
        self.discount_of = model.discount_of
        self.observed = tuple(observed)
        self._model = model

    @cached_property
    def seen_in(self) -> npt.NDArray[np.intp]:
        """For each state the joint index of its observed factors; read-only."""
        shape = self.state_space.shape
        digits = np.unravel_index(np.arange(len(self.state_space)), shape)
        seen = np.ravel_multi_index(
            [digits[place] for place in self.observed], [shape[place] for place in self.observed]
        )
        seen.flags.writeable = False
        return seen

    def _made(self) -> POMDP:
        model = self._model.flatten()
        return POMDP(
            Checked(model.transition_matrix(a) for a in range(len(model.action_space))),
            _observations(model, self.seen_in, len(self.observation_space)),
            model.rewards,
            discount=self.discount,
            states=self.state_space,
            actions=self.action_space,
            observation_names=self.observation_space,
            initial_belief=model.initial_belief,
            outcome_rewards=self.outcome_rewards,
            sparse=True,
        )

    @property
    def layout(self) -> npt.NDArray[np.intp]:
        """The index of each state: an X x Y array, observed x hidden."""
        states = self.state_space
        hidden = [place for place in range(len(states.factors)) if place not in self.observed]
        array = np.arange(len(states)).reshape(states.shape).transpose([*self.observed, *hidden])
        return np.ascontiguousarray(array.reshape(math.prod(array.shape[: len(self.observed)]), -1))

    def bare(self) -> Self:
        """Return the same model without what was made of it, or of the model that is revealed."""
        other = super().bare()
        other._model = self._model.bare()  # noqa: SLF001 - a model of the same kind
        return other

    def revealed(self) -> POMDP:
        """Return the model itself."""
        return self

    def belief_at_start(self, state: int) -> Vector:
        """Return the initial belief, conditioned on the observed factors of the first state.

        Raises:
            ModelError: If no episode begins with these values.
        """
        self.state_space.unravel(state)
        weights = np.where(self.seen_in == self.seen_in[state], self.initial_belief, 0.0)
        total = weights.sum()
        if not total > 0:
            raise ModelError(f"an episode cannot begin in state {self.state_space.names[state]!r}")
        weights /= total
        weights.setflags(write=False)
        return weights


def _network(network: TwoSliceNetwork, observed: Sequence[int]) -> TwoSliceNetwork:
    """Return a network with copies of some state factors as its first observations."""
    assert network.observations is not None
    seen = [network.states.factors[place] for place in observed]
    copies = [
        Table([Node("next_state", place), Node("observation", index)], np.eye(len(seen[index])))
        for index, place in enumerate(observed)
    ]
    return TwoSliceNetwork(
        network.states,
        network.actions,
        Space([*seen, *network.observations.factors]),
        initial=network.initial,
        transitions=network.transitions,
        observation=[*copies, *(_moved(potential, len(seen)) for potential in network.observation)],
        utilities=[_moved(potential, len(seen)) for potential in network.utilities],
        fully_observed=network.fully_observed,
    )


def _moved(potential: Potential, by: int) -> Potential:
    """Return a potential with the indices of its observations shifted."""

    def moved(node: Node) -> Node:
        return Node(node.role, node.place + by) if node.role == "observation" else node

    if isinstance(potential, Table):
        return Table([moved(node) for node in potential.scope], potential.values)
    return Tree(moved(potential.node), potential.choice.tolist(), [_moved(branch, by) for branch in potential.branches])


def _observations(model: POMDP, seen_in: npt.NDArray[np.intp], count: int) -> list[Any]:
    """Return P(x', o | a, s') per action, as CSR: the model's rows, shifted to the columns of x'."""
    width = len(model.observation_space)
    done: dict[int, Any] = {}
    result = []
    for action in range(len(model.action_space)):
        matrix = model.observation_matrix(action)
        if id(matrix) not in done:
            own = matrix if is_compressed(matrix) else csr(matrix)
            columns = own.indices + width * np.repeat(seen_in, np.diff(own.indptr))
            done[id(matrix)] = read_only(csr((own.data, columns, own.indptr), (len(seen_in), count)))
        result.append(done[id(matrix)])
    return result
