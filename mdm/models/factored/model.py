"""Factored decision processes: two-slice networks, flattened into matrices on demand; also of mixed observability.

With mixed observability some state factors are observed without error, the others are hidden. A state is (x, y), x
observed and y hidden, and the observation after an action is the pair (x', o). This is an ordinary POMDP. The support
of its beliefs has a single x, so it is no larger than the hidden part (S. C. W. Ong, S. W. Png, D. Hsu and W. S. Lee,
*Planning under uncertainty for robotic tasks with mixed observability*, International Journal of Robotics Research 29,
2010).
"""

from __future__ import annotations

import copy
import math
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mdm.errors import ModelError
from mdm.models.events import DenseEvents, EventObservations, TransitionEvents
from mdm.models.factored import flattening
from mdm.models.factored.two_slice import Node, Potential, Table, Tree, TwoSliceNetwork
from mdm.models.matrices import (
    Checked,
    Matrix,
    MatrixSize,
    Vector,
    csr,
    distribution,
    is_compressed,
    is_large_and_sparse,
    read_only,
    stochastic_matrices,
)
from mdm.models.mdp import MDP, checked_discount
from mdm.models.pomdp import POMDP
from mdm.models.space import Space

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Self

    import numpy.typing as npt

    from mdm.models.factored.two_slice import Role

_ROWS = 10_000_000
"""The largest number of rows of T for which a model is flattened to track beliefs."""
_SMALL = 16_000_000
"""The bytes of matrices that are made even where memory is short."""

_MADE = frozenset({"_flat", "initial_belief", "seen_in"})
"""Large attributes of a factored model, made when they are first asked for."""

_Flat = TypeVar("_Flat", bound=MDP)


class _Factored(MDP):
    """The base of factored models: a network, and the quantities of its matrices."""

    network: TwoSliceNetwork

    @property
    def _flat(self) -> MDP:
        raise NotImplementedError

    def _kept(self, make: Callable[[], _Flat]) -> _Flat:
        """Return the matrices from where they are kept; else make them."""
        return make() if self._keeper is None else self._keeper(self, make)

    def __init__(self, network: TwoSliceNetwork, *, discount: float, sparse: bool | None = None) -> None:
        self.network = network
        self.state_space = network.states
        self.action_space = network.actions
        self.discount = checked_discount(discount)
        self.outcome_rewards = _outcomes(network)
        self.sparse = sparse

    @cached_property
    def initial_belief(self) -> Vector:
        """The distribution of the first state: S numbers, read-only."""
        first = flattening.first_distribution(self.network)
        return distribution(first, what="the initial belief", size=len(self.network.states))

    @cached_property
    def matrix_size(self) -> MatrixSize:
        """How large its matrices would be; they are not made for it."""
        return matrix_size(self.network, sparse=self.sparse)

    @property
    def is_flattened(self) -> bool:
        """Whether its matrices have been made."""
        return "_flat" in vars(self)

    @property
    def stays_factored(self) -> bool:  # type: ignore[override]
        """Whether beliefs and rewards are computed on the network, since its matrices would be large.

        That is so of more than ten million rows, and in a process that is sparing (`sparingly`) of more than 16 MB, but
        not where steps without an observation are to be summed over: that takes the matrices.
        """
        if self.false_negative is not None:
            return False
        if len(self.state_space) * len(self.action_space) > _ROWS:
            return True
        return self.is_sparing and not self._may_wait and self.matrix_size.total > _SMALL

    @property
    def _may_wait(self) -> bool:
        """Whether events may leave something to no observation."""
        return False

    def bare(self) -> Self:
        """Return the same model without the things made of it, to send to another process."""
        other = copy.copy(self)
        for name in _MADE & vars(other).keys():
            del vars(other)[name]
        return other

    @property
    def rewards(self) -> Vector:
        """The expected immediate reward R(s, a): S x A, read-only."""
        return self._flat.rewards

    def transition_matrix(self, action: Any) -> Matrix:
        """Return P(s' | s, a) as an S x S' matrix, read-only."""
        return self._flat.transition_matrix(action)


class FactoredMDP(_Factored):
    """An MDP as a two-slice network; its matrices are made on first use, and kept.

    Args:
        network: The network; `TwoSliceNetwork` has an example.
        discount: In (0, 1].
        sparse: Force CSR or dense matrices; None chooses by size and density.
    """

    @cached_property
    def _flat(self) -> MDP:
        return self._kept(self._made)

    def _made(self) -> MDP:
        transitions = flattening.transition_matrices(self.network)
        return MDP(
            transitions,
            flattening.expected_rewards(self.network, transitions),
            discount=self.discount,
            states=self.state_space,
            actions=self.action_space,
            initial_belief=self.initial_belief,
            outcome_rewards=self.outcome_rewards,
            sparse=self.sparse,
        )

    def flatten(self) -> MDP:
        """Return the same model as matrices; they are made once and kept."""
        return self._flat.timed_as(self)

    def marginalize(self, factor: str) -> MDP:
        """Return the model without a state factor, as `MDP.marginalize` does; the result is flat."""
        return self.flatten().marginalize(factor)


class FactoredPOMDP(_Factored, POMDP):
    """A POMDP as a two-slice network; its matrices are made on first use, and kept.

    Args:
        network: The network, with observations; `TwoSliceNetwork` has an example.
        discount: In (0, 1].
        sparse: Force CSR or dense matrices; None chooses by size and density.

    Raises:
        ModelError: If the network has no observations.
    """

    def __init__(self, network: TwoSliceNetwork, *, discount: float, sparse: bool | None = None) -> None:
        if network.observations is None:
            raise ModelError("the network has no observations: make a FactoredMDP of it")
        super().__init__(network, discount=discount, sparse=sparse)
        self._resolvents = {}
        self.observation_space = network.observations

    @cached_property
    def _flat(self) -> POMDP:
        return self._kept(self._made)

    def _made(self) -> POMDP:
        network = self.network
        transitions = flattening.transition_matrices(network)
        rewards = flattening.expected_rewards(network, transitions)
        given: Any = transitions
        told: Any = None
        if network.event_observations:
            # Events follow the order of T's entries in the flat model.
            given = Checked(
                stochastic_matrices(
                    transitions,
                    what="T",
                    actions=network.actions,
                    rows=network.states,
                    columns=len(network.states),
                    sparse_=self.sparse,
                )
            )
            told = _events(network, given)
        return POMDP(
            given,
            flattening.observation_matrices(network) if told is None else told,
            rewards,
            discount=self.discount,
            states=self.state_space,
            actions=self.action_space,
            observation_names=self.observation_space,
            initial_belief=self.initial_belief,
            outcome_rewards=self.outcome_rewards,
            sparse=self.sparse,
        )

    def flatten(self) -> POMDP:
        """Return the same model as matrices; they are made once and kept."""
        flat = self._flat.timed_as(self)
        if self.false_negative is None and not self._tells_all and not self._discounts_waits:
            return flat
        # That of the same kind of model.
        return self._of_this_kind(flat._with_resolvents(self.false_negative, self._resolvents))  # noqa: SLF001

    def bare(self) -> Self:
        """Return the same model without the things made of it, to send to another process."""
        other = super().bare()
        other._resolvents = {}  # noqa: SLF001 - a model of the same kind
        return other

    def revealed(self) -> POMDP:
        """Return the `MixedPOMDP` in which fully observed state factors are part of the observations."""
        seen = [place for place, observed in enumerate(self.network.fully_observed) if observed]
        return MixedPOMDP(self, seen) if seen else self

    @property
    def events(self) -> EventObservations | None:
        """The event observations; None if observations depend on the next state alone."""
        return self._flat.events

    @property
    def event_observations(self) -> bool:
        """Whether observations are those of events, P(o | s, a, s')."""
        return self.network.event_observations

    @property
    def _may_wait(self) -> bool:
        return self.event_observations and not self._tells_all and not self.network.is_exact

    def observation_matrix(self, action: Any) -> Matrix:
        """Return P(o | a, s') as an S' x O matrix, read-only."""
        return self._flat.observation_matrix(action)

    def event_matrix(self, action: Any, observation: Any) -> Matrix:
        """Return P(o | s, a, s') of event observations as an S x S' matrix, read-only."""
        return self._flat.event_matrix(action, observation)

    def joint_matrix(self, action: Any, observation: Any) -> Matrix:
        """Return P(s', o | s, a) as an S x S' matrix."""
        return self._flat.joint_matrix(action, observation)

    def _event_row(self, action: int, state: int, next_state: int) -> Vector:
        return self._flat._event_row(action, state, next_state)  # noqa: SLF001 - a model of the same kind

    def marginalize(self, factor: str) -> POMDP:
        """Return the model without a state factor, as `POMDP.marginalize` does; the result is flat."""
        return self.flatten().marginalize(factor)


class _Outcomes:
    """The utilities of a network as rewards of outcomes."""

    def __init__(self, network: TwoSliceNetwork) -> None:
        self._network = network

    def at(self, action: int, state: int, next_state: int, observation: int | None) -> float:
        """Return R(a, s, s', o)."""
        network = self._network
        joint = [("state", network.states, state), ("action", network.actions, action)]
        joint.append(("next_state", network.states, next_state))
        if observation is not None and network.observations is not None:
            joint.append(("observation", network.observations, observation))
        digits = {
            Node(role, index): np.array([value])  # type: ignore[arg-type] # roles, written out above
            for role, space, symbol in joint
            for index, value in enumerate(space.unravel(symbol))
        }
        if any(node not in digits for utility in network.utilities for node in utility.scope):
            raise ModelError("the reward depends on the observation: name one")
        return float(sum(utility.rows(digits, 1, None, 1)[0, 0] for utility in network.utilities))

    def array(self, largest: int) -> Vector | None:
        """Return R(a, s, s'), or R(a, s, s', o) if observations matter; None if that would be too large."""
        network = self._network
        spaces: dict[Role, Space] = {"action": network.actions, "state": network.states, "next_state": network.states}
        if network.observations is not None and any(
            n.role == "observation" for u in network.utilities for n in u.scope
        ):
            spaces["observation"] = network.observations
        sizes = tuple(map(len, spaces.values()))
        count = math.prod(sizes)
        if count > largest:
            return None
        joint = dict(zip(spaces, np.unravel_index(np.arange(count), sizes), strict=True))
        digits = {
            Node(role, place): values
            for role, space in spaces.items()
            for place, values in enumerate(np.unravel_index(joint[role], space.shape))
        }
        values = sum((utility.rows(digits, count, None, 1)[:, 0] for utility in network.utilities), np.zeros(count))
        return values.reshape(sizes)


def _outcomes(network: TwoSliceNetwork) -> _Outcomes | None:
    later = {"next_state", "observation"}
    return _Outcomes(network) if any(node.role in later for u in network.utilities for node in u.scope) else None


def _events(network: TwoSliceNetwork, transitions: Checked) -> DenseEvents | TransitionEvents:
    size = len(network.states)
    names = {"actions": network.actions, "states": network.states}
    if is_compressed(transitions[0]):
        events = [
            flattening.transition_events(
                network, action, np.repeat(np.arange(size), np.diff(matrix.indptr)), matrix.indices
            )
            for action, matrix in enumerate(transitions)
        ]
        return TransitionEvents(transitions, events, **names)
    # All entries of the network, also where T is 0.
    states, next_states = (place.ravel() for place in np.indices((size, size)))
    everywhere = [
        flattening.transition_events(network, action, states, next_states).toarray().T.reshape(-1, size, size)
        for action in range(len(transitions))
    ]
    return DenseEvents(transitions, everywhere, **names)


_WALKS = 4096
_NUMBER = 8
"""Bytes of a number."""


def matrix_size(network: TwoSliceNetwork, *, sparse: bool | None = None) -> MatrixSize:
    """Return how many bytes the matrices of a network would take.

    Transitions and observations are counted on a sample of states and actions, by random walks: each variable of the
    next slice takes one of its possible values, and the product of their numbers is on average how many joint values
    are possible (D. E. Knuth, *Estimating the efficiency of backtrack programs*, Mathematics of Computation 29, 1975).
    The walks are the same in every process. Cost: some numpy calls per variable, whatever the size of the model.

    Args:
        network: The network.
        sparse: Force CSR or dense matrices; None chooses as models do.
    """
    states, actions = len(network.states), len(network.actions)
    observations = 0 if network.observations is None else len(network.observations)
    after, seen = _entries(network)
    matrices = _distinct(network, network.transitions)
    compressed = is_large_and_sparse(actions, states, states, after * actions) if sparse is None else sparse
    transitions = matrices * _bytes(states, states, after, compressed=compressed)
    if network.event_observations:
        told = actions * (
            _bytes(round(after), observations, after * seen, compressed=True)
            if compressed
            else states * states * observations * _NUMBER
        )
    elif observations:
        likely = is_large_and_sparse(actions, states, observations, seen * states * actions)
        narrow = likely if sparse is None else sparse
        told = _distinct(network, network.observation) * _bytes(states, observations, seen * states, compressed=narrow)
    else:
        told = 0
    told_entries = seen * (after if network.event_observations else states)
    return MatrixSize(transitions, told, states * actions * _NUMBER, matrices, round(after), round(told_entries))


def _entries(network: TwoSliceNetwork) -> tuple[float, float]:
    """Return how many entries T has for an action, and how many observations are possible after a transition."""
    random = np.random.Generator(np.random.PCG64(0))
    states, actions = len(network.states), len(network.actions)
    if states * actions <= _WALKS:
        joint = np.resize(np.arange(states * actions), _WALKS // (states * actions) * states * actions)
        before, taken = np.divmod(joint, actions)
    else:
        before, taken = random.integers(states, size=_WALKS), random.integers(actions, size=_WALKS)
    digits = _digits("state", before, network.states.shape) | _digits("action", taken, network.actions.shape)
    branches = _walk(network, "next_state", digits, random)
    if not network.event_observations:  # O has a row for each state, whether it is reached or not
        digits |= _digits("next_state", before, network.states.shape)
    told = _walk(network, "observation", digits, random)
    # Of events each entry of T has a row: a walk stands for as many as it has branches.
    weights = branches if network.event_observations else np.ones(len(branches))
    return float(branches.mean() * states), float(told @ weights / weights.sum())


def _walk(
    network: TwoSliceNetwork, role: Role, digits: dict[Node, npt.NDArray[np.intp]], random: np.random.Generator
) -> npt.NDArray[np.float64]:
    """Draw possible values of a role's variables into the digits; return the product of their numbers, of each walk."""
    count = len(next(iter(digits.values())))
    product = np.ones(count)
    for place in network.orders[role]:
        child, potential = Node(role, place), network.potentials(role)[place]
        given = {node: digits[node] for node in potential.scope if node != child}
        possible = potential.rows(given, count, child, len(network.factor(child))) > 0
        number = possible.sum(axis=1)
        product *= number
        drawn = (random.random(count) * number).astype(np.intp)
        digits[child] = (possible.cumsum(axis=1) > drawn[:, None]).argmax(axis=1)
    return product


def _distinct(network: TwoSliceNetwork, potentials: Sequence[Potential]) -> int:
    """Return how many different matrices there are: actions of equal effect share one."""
    used = {node for potential in potentials for node in potential.scope if node.role == "action"}
    return math.prod(len(network.factor(node)) for node in used)


def _bytes(rows: int, columns: int, entries: float, *, compressed: bool) -> int:
    """Return the bytes of a matrix."""
    if not compressed:
        return rows * columns * _NUMBER
    index = 4 if max(entries, columns, rows) <= np.iinfo(np.int32).max else 8
    return round(entries) * (_NUMBER + index) + (rows + 1) * index


def _digits(role: Role, joint: npt.NDArray[np.intp], shape: tuple[int, ...]) -> dict[Node, npt.NDArray[np.intp]]:
    return {Node(role, index): values for index, values in enumerate(np.unravel_index(joint, shape))}


# -- Mixed observability -----------------------------------------------------------------------------------------------


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
        super().__init__(_revealing(model.network, observed), discount=model.discount, sparse=True)
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
            _with_seen(model, self.seen_in, len(self.observation_space)),
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
        """Return the same model without the things made of it, or of the model that is revealed."""
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


def _revealing(network: TwoSliceNetwork, observed: Sequence[int]) -> TwoSliceNetwork:
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


def _with_seen(model: POMDP, seen_in: npt.NDArray[np.intp], count: int) -> list[Any]:
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
