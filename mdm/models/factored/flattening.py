"""Flattening: the matrices of a two-slice network, from products of its potentials.

Joint distributions grow variable by variable: each possible partial assignment is repeated for every possible value of
the next variable. Zeros are never stored, so nothing is larger than the result, and every step handles all states at
once. R(s, a) can also be computed where it is read: in one state, or in those that a belief holds possible.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.models.factored.two_slice import Node
from mdm.models.matrices import ROUNDING, csr

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

    import numpy.typing as npt

    from mdm.models.factored.two_slice import Potential, Role, TwoSliceNetwork
    from mdm.models.matrices import Vector

    Indices = npt.NDArray[np.intp]

_BLOCK = 1 << 20


class _Joint(NamedTuple):
    """Possible joint values: for each its row, its joint index and its probability."""

    rows: Indices
    values: Indices
    probabilities: Vector


def first_distribution(network: TwoSliceNetwork) -> Vector:
    """Return the initial belief, S numbers."""
    result = np.zeros(len(network.states))
    states, probabilities = first_states(network)
    result[states] = probabilities
    return result


def first_states(network: TwoSliceNetwork) -> tuple[Indices, Vector]:
    """Return the support of the initial belief: states and their probabilities."""
    joint = _grow(network, "state", 1, {})
    return joint.values, joint.probabilities


def following(network: TwoSliceNetwork, action: int, states: Indices) -> tuple[Indices, Indices, Vector]:
    """Return the transitions from some states: the place of the state, the next state, and the probability."""
    actions = _digits("action", np.array([action]), network.actions.shape)
    joint = _grow(network, "next_state", len(states), _digits("state", states, network.states.shape) | actions)
    return joint if network.is_exact else _normalised(joint, len(states))


def observed_chances(
    network: TwoSliceNetwork, action: int, states: Indices | None, next_states: Indices, observations: Sequence[int]
) -> Vector:
    """Return P(one of some observations | s, a, s') of some transitions; only events need ``states``."""
    assert network.observations is not None
    digits = _digits("action", np.array([action]), network.actions.shape)
    digits |= _digits("next_state", next_states, network.states.shape)
    if states is not None:
        digits |= _digits("state", states, network.states.shape)
    count, shape = len(next_states), network.observations.shape
    wanted = np.unique(np.array(observations, dtype=np.intp))
    allowed = [np.isin(np.arange(size), of) for size, of in zip(shape, np.unravel_index(wanted, shape), strict=True)]
    if network.is_exact and math.prod(int(each.sum()) for each in allowed) == len(wanted):
        # Components that may be anything are left out, unless others depend on them.
        seen = {place for place, each in enumerate(allowed) if not each.all()}
        joint = _grow(network, "observation", count, digits, _with_parents(network, "observation", seen), allowed)
    else:
        joint = _grow(network, "observation", count, digits)
        if not network.event_observations:
            joint = _normalised(joint, count)
        agree = np.isin(joint.values, wanted)
        joint = _Joint(joint.rows[agree], joint.values, joint.probabilities[agree])
    return np.bincount(joint.rows, joint.probabilities, minlength=count).astype(np.float64)


def rewards_at(network: TwoSliceNetwork, action: int, states: Indices) -> Vector:
    """Return R(s, a) of an action in some states, as `expected_rewards` has it, without anything of other states.

    Of the next slice only those variables are considered that a utility depends on.
    """
    count = len(states)
    digits = _digits("state", states, network.states.shape)
    digits |= _digits("action", np.array([action]), network.actions.shape)
    result = np.zeros(count)
    for utility in network.utilities if count else ():
        seen = {node.place for node in utility.scope if node.role == "observation"}
        after = {node.place for node in utility.scope if node.role == "next_state"}
        if not seen and not after:
            result += _values(network, utility, digits, count)
            continue
        if network.is_exact:
            seen = _with_parents(network, "observation", seen)
            after |= {
                node.place for place in seen for node in network.observation[place].scope if node.role == "next_state"
            }
            after = _with_parents(network, "next_state", after)
            joint = _grow(network, "next_state", count, digits, after)
        else:
            joint = _grow(network, "next_state", count, digits)
        inner = {node: _along(values, joint.rows) for node, values in digits.items()}
        inner |= _digits("next_state", joint.values, network.states.shape)
        values = _outcome_values(network, utility, inner, len(joint.rows), seen if network.is_exact else None)
        result += np.bincount(joint.rows, joint.probabilities * values, minlength=count)
    return result


def transition_matrices(network: TwoSliceNetwork) -> list[Any]:
    """Return T as an S x S CSR matrix per joint action; actions of equal effect share one."""
    count = len(network.states)
    states = _digits("state", np.arange(count), network.states.shape)

    def matrix(actions: dict[Node, Indices]) -> Any:
        return _compressed(_grow(network, "next_state", count, states | actions), (count, count))

    return _by_action(network, network.transitions, matrix)


def observation_matrices(network: TwoSliceNetwork) -> list[Any]:
    """Return O as an S' x O CSR matrix per joint action, for observations of states."""
    assert network.observations is not None
    count = len(network.states)
    states = _digits("next_state", np.arange(count), network.states.shape)
    shape = (count, len(network.observations))

    def matrix(actions: dict[Node, Indices]) -> Any:
        return _compressed(_grow(network, "observation", count, states | actions), shape)

    return _by_action(network, network.observation, matrix)


def transition_events(network: TwoSliceNetwork, action: int, states: Indices, next_states: Indices) -> Any:
    """Return P(o | s, a, s') of some transitions of an action, as a transitions x O CSR matrix."""
    assert network.observations is not None
    joint = _grow(network, "observation", len(states), _transition_digits(network, action, states, next_states))
    return _compressed(joint, (len(states), len(network.observations)))


def expected_rewards(network: TwoSliceNetwork, transitions: list[Any]) -> Vector:
    """Return R(s, a), S x A: the expected sum of the utilities."""
    count, num_actions = len(network.states), len(network.actions)
    result = np.zeros((count, num_actions))
    now = [u for u in network.utilities if all(node.role in {"state", "action"} for node in u.scope)]
    later = [u for u in network.utilities if u not in now]
    states = _digits("state", np.arange(count), network.states.shape)
    for action in range(num_actions):
        actions = _digits("action", np.array([action]), network.actions.shape)
        for utility in now:
            result[:, action] += _values(network, utility, states | actions, count)
        if not later:
            continue
        matrix = transitions[action]
        width = 1 if network.observations is None else len(network.observations)
        for first, last in _blocks(matrix, _BLOCK // width):
            part = matrix[first:last]
            rows = np.repeat(np.arange(first, last), np.diff(part.indptr))
            digits = _transition_digits(network, action, rows, part.indices)
            for utility in later:
                values = _outcome_values(network, utility, digits, len(rows))
                result[first:last, action] += np.bincount(rows - first, part.data * values, minlength=last - first)
    return result


def _outcome_values(
    network: TwoSliceNetwork,
    utility: Potential,
    digits: dict[Node, Indices],
    count: int,
    seen: Collection[int] | None = None,
) -> Vector:
    """Return the expectation of a utility over the observations, or over some of them, for some transitions."""
    if all(node.role != "observation" for node in utility.scope):
        return _values(network, utility, digits, count)
    assert network.observations is not None
    joint = _grow(network, "observation", count, digits, seen)
    inner = {node: _along(values, joint.rows) for node, values in digits.items()}
    inner |= _digits("observation", joint.values, network.observations.shape)
    weighted = joint.probabilities * _values(network, utility, inner, len(joint.rows))
    return np.asarray(np.bincount(joint.rows, weighted, minlength=count), dtype=np.float64)


def _by_action(network: TwoSliceNetwork, potentials: tuple[Potential, ...], build: Callable[..., Any]) -> list[Any]:
    """Build something per joint action, once for actions that no potential distinguishes."""
    used = sorted({node.place for potential in potentials for node in potential.scope if node.role == "action"})
    done: dict[tuple[int, ...], Any] = {}
    result = []
    for action in range(len(network.actions)):
        actions = _digits("action", np.array([action]), network.actions.shape)
        key = tuple(int(actions[Node("action", index)][0]) for index in used)
        if key not in done:
            done[key] = build(actions)
        result.append(done[key])
    return result


def _with_parents(network: TwoSliceNetwork, role: Role, places: Collection[int]) -> set[int]:
    """Return some variables of a role, with all of that role on which they depend."""
    found: set[int] = set()
    waiting = list(places)
    while waiting:
        place = waiting.pop()
        if place not in found:
            found.add(place)
            waiting += [node.place for node in network.parents(Node(role, place)) if node.role == role]
    return found


def _normalised(joint: _Joint, count: int) -> _Joint:
    """Return distributions that sum to 1 in each row, as matrices do that were checked (`stochastic_matrices`)."""
    sums = np.bincount(joint.rows, joint.probabilities, minlength=count)
    sums[np.abs(sums - 1) <= ROUNDING] = 1
    return _Joint(joint.rows, joint.values, joint.probabilities / sums[joint.rows])


def _grow(
    network: TwoSliceNetwork,
    role: Role,
    count: int,
    given: dict[Node, Indices],
    places: Collection[int] | None = None,
    allowed: Sequence[npt.NDArray[np.bool_]] | None = None,
) -> _Joint:
    """Return the joint distribution of a role's variables in each row, given the values of other variables there.

    Args:
        network: The network.
        role: The role.
        count: How many rows there are.
        given: The values of the other variables in each row, or in all.
        places: Which variables, with all of the role on which they depend; by default all. The rest count as 0.
        allowed: For each of the role's variables which values it may have; by default any.
    """
    factors = network.factors(role)
    strides = [math.prod(map(len, factors[index + 1 :])) for index in range(len(factors))]
    every = np.arange(count)
    joint = _Joint(every, np.zeros(count, dtype=np.intp), np.ones(count))
    for index in network.orders[role] if places is None else filter(places.__contains__, network.orders[role]):
        if not joint.rows.size:  # nothing is possible, as for an action without any event
            break
        potential = network.potentials(role)[index]
        child = Node(role, index)
        size = len(factors[index])
        masked = 1.0 if allowed is None else allowed[index]

        def digits(node: Node, joint: _Joint = joint) -> Indices:
            if node.role == role:
                return joint.values // strides[node.place] % len(factors[node.place])
            return given[node] if joint.rows is every else _along(given[node], joint.rows)

        parents = [node for node in potential.scope if node != child]
        varying = [node for node in parents if node.role == role or given[node].size > 1]
        fixed = {node: given[node] for node in parents if node not in varying}
        shape = tuple(len(network.factor(node)) for node in varying)
        if math.prod(shape) <= len(joint.rows):
            # Few different distributions: each is computed once.
            cases: Any = np.unravel_index(np.arange(math.prod(shape)), shape) if shape else ()
            of_row = np.zeros(len(joint.rows), dtype=np.intp)
            for node, factor_size in zip(varying, shape, strict=True):
                of_row *= factor_size
                of_row += digits(node)
            rows = potential.rows(_spread(varying, cases, fixed), math.prod(shape), child, size)
            joint = _extend(joint, rows * masked, of_row, strides[index])
        else:
            step = max(1, _BLOCK // size)
            parts = []
            columns = [digits(node) for node in varying]
            for start in range(0, len(joint.rows), step):
                part = _Joint(*(array[start : start + step] for array in joint))  # type: ignore[arg-type]
                cases = [column[start : start + step] for column in columns]
                rows = potential.rows(_spread(varying, cases, fixed), len(part.rows), child, size)
                parts.append(_extend(part, rows * masked, np.arange(len(part.rows)), strides[index]))
            joint = _Joint(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    return joint


def _spread(varying: list[Node], cases: Any, fixed: dict[Node, Indices]) -> dict[Node, Indices]:
    """Return the values of variables in arrays of one length."""
    count = len(cases[0]) if len(cases) else 1
    return dict(zip(varying, cases, strict=True)) | {
        node: np.broadcast_to(values, (count,)) for node, values in fixed.items()
    }


def _extend(joint: _Joint, distributions: Vector, of_row: Indices, stride: int) -> _Joint:
    """Repeat each joint value for every possible value of the next variable."""
    cases, values = np.nonzero(distributions)
    chances = distributions[cases, values]
    counts = np.bincount(cases, minlength=len(distributions))
    if len(values) == len(distributions) and (counts == 1).all():  # one value each: nothing to repeat
        certain = (chances == 1).all()
        probabilities = joint.probabilities if certain else joint.probabilities * chances[of_row]
        return _Joint(joint.rows, joint.values + stride * values[of_row], probabilities)
    starts = np.cumsum(counts) - counts
    repeats = counts[of_row]
    before = np.cumsum(repeats)
    before -= repeats
    before -= starts[of_row]
    entry = np.arange(repeats.sum()) - np.repeat(before, repeats)
    source = np.repeat(np.arange(len(of_row)), repeats)
    del before, repeats  # nothing is kept that is as large as the result
    rows, grown, probabilities = joint.rows[source], joint.values[source], joint.probabilities[source]
    del source
    grown += (stride * values)[entry]
    probabilities *= chances[entry]
    return _Joint(rows, grown, probabilities)


def _values(network: TwoSliceNetwork, utility: Potential, digits: dict[Node, Indices], count: int) -> Vector:
    """Return the values of a utility in each row."""
    varying = [node for node in utility.scope if digits[node].size > 1]
    fixed = {node: digits[node] for node in utility.scope if node not in varying}
    shape = tuple(len(network.factor(node)) for node in varying)
    total = math.prod(shape)
    if total > count:
        columns = [digits[node] for node in varying]
        return utility.rows(_spread(varying, columns, fixed), count, None, 1)[:, 0]
    cases: Any = np.unravel_index(np.arange(total), shape) if shape else ()
    of_row = np.zeros(count, dtype=np.intp)
    for node, size in zip(varying, shape, strict=True):
        of_row *= size
        of_row += digits[node]
    values: Vector = utility.rows(_spread(varying, cases, fixed), total, None, 1)[of_row, 0]
    return values


def _digits(role: Role, joint: Indices, shape: tuple[int, ...]) -> dict[Node, Indices]:
    return {Node(role, index): values for index, values in enumerate(np.unravel_index(joint, shape))}


def _transition_digits(
    network: TwoSliceNetwork, action: int, states: Indices, next_states: Indices
) -> dict[Node, Indices]:
    shape = network.states.shape
    return {
        **_digits("state", states, shape),
        **_digits("action", np.array([action]), network.actions.shape),
        **_digits("next_state", next_states, shape),
    }


def _along(values: Indices, rows: Indices) -> Indices:
    return values if values.size == 1 else values[rows]


def _compressed(joint: _Joint, shape: tuple[int, int]) -> Any:
    starts = np.concatenate(([0], np.cumsum(np.bincount(joint.rows, minlength=shape[0]))))
    width = np.int32 if max(len(joint.values), *shape) <= np.iinfo(np.int32).max else np.int64
    matrix = csr((joint.probabilities, joint.values.astype(width), starts.astype(width)), shape)
    matrix.sort_indices()
    return matrix


def _blocks(matrix: Any, size: int) -> Iterator[tuple[int, int]]:
    """Yield ranges of rows with about ``size`` entries each."""
    starts = matrix.indptr.astype(np.int64)
    first = 0
    while first < matrix.shape[0]:
        last = int(np.searchsorted(starts, starts[first] + size, side="right")) - 1
        last = min(max(last, first + 1), matrix.shape[0])
        yield first, last
        first = last


class RewardRows:
    """R as a row over the states for each action, none of which is made.

    Args:
        network: The network.
    """

    def __init__(self, network: TwoSliceNetwork) -> None:
        self._network = network

    def __getitem__(self, action: int) -> RewardRow:
        return RewardRow(self._network, action)


class RewardRow:
    """R(s, a) of one action; it is read as an array of S numbers is.

    Args:
        network: The network.
        action: The joint action.
    """

    __slots__ = ("_action", "_network")

    def __init__(self, network: TwoSliceNetwork, action: int) -> None:
        self._network = network
        self._action = action

    def take(self, states: npt.NDArray[np.intp]) -> Vector:
        """Return the rewards in some states."""
        return rewards_at(self._network, self._action, np.asarray(states))

    def item(self, state: int) -> float:
        """Return the reward in a state."""
        return float(self.take(np.array([state]))[0])

    def dot(self, belief: Vector) -> np.float64:
        """Return the expected reward, for a belief of S numbers."""
        (states,) = belief.nonzero()
        result: Any = self.take(states).dot(belief[states])
        return np.float64(result)
