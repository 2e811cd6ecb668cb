"""mdm's own ``.npz`` format for models and for how long actions take, mapped into memory instead of parsed.

A flat model is stored as its matrices, shared ones once; a factored model as its network, packed into arrays and a
header. Reading validates all numbers in one pass, without a copy.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from mdm.errors import FormatError, ModelError, ModelWarning
from mdm.formats.archive import npz
from mdm.formats.archive.npz import Names, names_of, space_of
from mdm.models import MDP, POMDP, Durations, FactoredMDP, FactoredPOMDP
from mdm.models.availability import availability
from mdm.models.events import DenseEvents, TransitionEvents
from mdm.models.factored.two_slice import Node, Potential, Role, Table, Tree, TwoSliceNetwork
from mdm.models.matrices import ROUNDING, Checked, Matrix, Vector, csr, is_compressed
from mdm.models.rewards import RewardArray
from mdm.models.units import Unit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.models import Space

_LARGEST = 50_000_000


class _Header(msgspec.Struct):
    discount: float
    states: list[Names]
    actions: list[Names]
    observations: list[Names] | None = None
    transitions: list[str] = []
    observed: list[str] = []
    events: list[str] = []
    network: Network | None = None
    false_negative: int | None = None
    discount_of: Unit = "step"
    format: Literal["mdm model 1"] = "mdm model 1"


def read(path: str | Path, *, sparse: bool | None = None) -> MDP | POMDP:
    """Read a model from an archive; its matrices are mapped into memory unless ``sparse`` requires a conversion.

    Raises:
        FormatError: If the file is damaged or holds no model.
    """
    written, arrays = npz.read(Path(path))
    try:
        header = msgspec.json.decode(written, type=_Header)
        model = _model(header, arrays, sparse).with_false_negatives(header.false_negative)
        return model.with_discount(header.discount, of=header.discount_of)
    except KeyError as error:
        raise FormatError(f"the archive is damaged: {error} is missing", file=path) from None
    except (ModelError, msgspec.MsgspecError, ValueError, IndexError, OverflowError) as error:
        why = npz.what_else(written, "model", error)
        raise FormatError(f"the archive does not hold a model: {why}", file=path) from None


def write(model: MDP, path: str | Path) -> None:
    """Write a model to an archive, usually a ``.npz``.

    Rewards of single outcomes are kept up to 50 million numbers; beyond that only R(s, a), with a warning.

    Raises:
        FormatError: If the file cannot be written.
    """
    header = _Header(model.discount, names_of(model.state_space), names_of(model.action_space))
    header.discount_of = model.discount_of
    if model.observation_space is not None:
        header.observations = names_of(model.observation_space)
        header.false_negative = model.false_negative
    arrays: dict[str, Any] = {}
    if model.network is not None:
        header.network = pack_network(model.network, arrays)
    else:
        actions = range(len(model.action_space))
        arrays |= {"initial": model.initial_belief, "rewards": model.rewards}
        if model.available is not None:
            arrays["available"] = model.available.astype(np.uint8)
        header.transitions = _pack("T", [model.transition_matrix(a) for a in actions], arrays)
        if (pomdp := model.pomdp) is not None:
            events = pomdp.events
            if events is None:
                header.observed = _pack("O", [pomdp.observation_matrix(a) for a in actions], arrays)
            elif isinstance(events, DenseEvents):
                header.events = _pack("E", events.events, arrays)
            elif isinstance(events, TransitionEvents):
                header.events = _pack("E", [csr(matrix.tocsr()) for matrix in events.events], arrays)
        _pack_outcomes(model, arrays)
    if model.visits is not None:
        arrays["visits"] = model.visits
    npz.write(Path(path), header, arrays)


def _pack_outcomes(model: MDP, arrays: dict[str, Any]) -> None:
    if model.outcome_rewards is None:
        return
    outcomes = model.outcome_rewards.array(_LARGEST)
    if outcomes is not None:
        arrays["outcomes"] = outcomes
        return
    text = "there are too many rewards of single outcomes: only their expectation R(s, a) is kept"
    warnings.warn(text, ModelWarning, stacklevel=4)


def _pack(prefix: str, matrices: Any, arrays: dict[str, Any]) -> list[str]:
    """Add each distinct matrix to the arrays; return the name of each action's matrix."""
    names: dict[int, str] = {}
    for matrix in matrices:
        if id(matrix) in names:
            continue
        name = names[id(matrix)] = f"{prefix}{len(names)}"
        if is_compressed(matrix):
            parts = {"data": matrix.data, "indices": matrix.indices, "starts": matrix.indptr}
            arrays |= {f"{name}.{part}": array for part, array in parts.items()}
        else:
            arrays[name] = matrix
    return [names[id(matrix)] for matrix in matrices]


def _model(header: _Header, arrays: Mapping[str, Any], sparse: bool | None) -> MDP | POMDP:
    model = _dynamics(header, arrays, sparse)
    if "visits" in arrays:
        model.visits = _floats(arrays["visits"]).reshape(len(model.state_space), len(model.action_space))
    return model


def _dynamics(header: _Header, arrays: Mapping[str, Any], sparse: bool | None) -> MDP | POMDP:
    states, actions = space_of(header.states), space_of(header.actions)
    observations = None if header.observations is None else space_of(header.observations)
    if header.network is not None:
        network = unpack_network(header.network, arrays, states, actions, observations)
        if network.observations is None:
            return FactoredMDP(network, discount=header.discount, sparse=sparse)
        return FactoredPOMDP(network, discount=header.discount, sparse=sparse)
    model = _flat(header, arrays, states, actions, observations)
    model = model if sparse is None or model.is_sparse == sparse else _converted(model, sparse)
    if "available" in arrays:  # whose rows stand in already
        model.available = availability(arrays["available"] == 1, states, actions)
    return model


def _flat(
    header: _Header, arrays: Mapping[str, Any], states: Space, actions: Space, observations: Space | None
) -> MDP | POMDP:
    size, count = len(states), len(actions)
    transitions = _matrices(header.transitions, arrays, (size, size), count)
    rewards = _floats(arrays["rewards"])
    if rewards.shape != (size, count):
        raise ModelError(f"the rewards have the shape {rewards.shape}, not {(size, count)}")
    outcomes = arrays.get("outcomes")
    shapes: list[tuple[int, ...]] = [(count, size, size)]
    if observations is not None:
        shapes.append((count, size, size, len(observations)))
    if outcomes is not None and (outcomes.shape not in shapes or not np.isfinite(outcomes).all()):
        raise ModelError("the rewards of outcomes have the wrong shape or are not finite")
    common: dict[str, Any] = {
        "discount": header.discount,
        "states": states,
        "actions": actions,
        "initial_belief": _floats(arrays["initial"]),
        "outcome_rewards": RewardArray(_floats(arrays["outcomes"])) if "outcomes" in arrays else None,
    }
    if observations is None:
        return MDP(transitions, rewards, **common)
    seen: Any = (
        _events(header.events, arrays, transitions, states, actions, len(observations))
        if header.events
        else _matrices(header.observed, arrays, (size, len(observations)), count)
    )
    return POMDP(transitions, seen, rewards, observation_names=observations, **common)


def _converted(model: MDP, sparse: bool) -> MDP | POMDP:
    """Convert a model's matrices between dense and CSR."""
    actions = range(len(model.action_space))
    transitions = [model.transition_matrix(action) for action in actions]
    common: dict[str, Any] = {
        "discount": model.discount,
        "states": model.state_space,
        "actions": model.action_space,
        "initial_belief": model.initial_belief,
        "outcome_rewards": model.outcome_rewards,
        "sparse": sparse,
    }
    pomdp = model.pomdp
    if pomdp is None:
        return MDP(transitions, model.rewards, **common)
    common |= {"observation_names": pomdp.observation_space, "event_observations": pomdp.event_observations}
    seen: list[Any] = (
        [[pomdp.event_matrix(action, o) for o in range(len(pomdp.observation_space))] for action in actions]
        if pomdp.event_observations
        else [pomdp.observation_matrix(action) for action in actions]
    )
    return POMDP(transitions, seen, model.rewards, **common)


def _matrices(names: list[str], arrays: Mapping[str, Any], shape: tuple[int, int], count: int) -> Checked:
    """Return one matrix per action, after checking that rows are distributions."""
    if len(names) != count:
        raise ModelError(f"there are {len(names)} matrices for {count} actions")
    done: dict[str, Matrix] = {}
    for name in names:
        if name not in done:
            done[name] = matrix = _stored(name, arrays, shape)
            data = matrix.data if is_compressed(matrix) else matrix
            sums = np.asarray(matrix.sum(axis=1)).ravel()
            if not (np.abs(sums - 1) <= ROUNDING).all() or (data < 0).any():
                raise ModelError(f"a row of {name} is not a distribution")
    if len({is_compressed(matrix) for matrix in done.values()}) != 1:
        raise ModelError("some matrices are sparse and others are not")
    return Checked(done[name] for name in names)


def _stored(name: str, arrays: Mapping[str, Any], shape: tuple[int, int]) -> Matrix:
    if name in arrays:
        matrix = _floats(arrays[name])
        if matrix.shape != shape:
            raise ModelError(f"{name} has the shape {matrix.shape}, not {shape}")
        return matrix
    data, indices, starts = (arrays[f"{name}.{part}"] for part in ("data", "indices", "starts"))
    data = _floats(data)
    whole = all(array.ndim == 1 and array.dtype.kind == "i" for array in (indices, starts))
    if not whole or data.ndim != 1 or len(indices) != len(data) or len(starts) != shape[0] + 1:
        raise ModelError(f"{name} is not a matrix of {shape[0]} rows")
    if starts[0] != 0 or starts[-1] != len(data) or (np.diff(starts) < 0).any():
        raise ModelError(f"the row starts of {name} are invalid")
    if len(indices) and not 0 <= indices.min() <= indices.max() < shape[1]:
        raise ModelError(f"{name} has entries beyond its {shape[1]} columns")
    falls = np.flatnonzero(indices[1:] <= indices[:-1]) + 1
    if not np.isin(falls, starts).all():
        raise ModelError(f"the entries of {name} are not sorted")
    return csr((data, indices, starts), shape, copy=False)


def _events(
    names: list[str], arrays: Mapping[str, Any], transitions: Checked, states: Space, actions: Space, count: int
) -> DenseEvents | TransitionEvents:
    if len(names) != len(actions):
        raise ModelError(f"there are {len(names)} event matrices for {len(actions)} actions")
    if is_compressed(transitions[0]):
        parts = [_stored(name, arrays, (t.nnz, count)) for name, t in zip(names, transitions, strict=True)]
        return TransitionEvents(transitions, parts, actions=actions, states=states)
    cubes = [_cube(arrays[name], count, len(states)) for name in names]
    return DenseEvents(transitions, cubes, actions=actions, states=states)


def _cube(array: Any, count: int, size: int) -> Vector:
    cube = _floats(array)
    if cube.shape != (count, size, size):
        raise ModelError(f"events have the shape {cube.shape}, not {(count, size, size)}")
    return cube


def _floats(array: Any) -> Vector:
    if array.dtype != np.float64:
        raise ModelError(f"numbers have type {array.dtype}, not float64")
    return np.asarray(array)


class _Table(msgspec.Struct, tag="table"):
    scope: list[tuple[Role, int]]
    values: str


class _Tree(msgspec.Struct, tag="tree"):
    node: tuple[Role, int]
    choice: list[int]
    branches: list[int]


class Network(msgspec.Struct):
    """A network's distinct potentials, branches before their trees, and the indices of those in each role."""

    potentials: list[_Table | _Tree]
    initial: list[int]
    transitions: list[int]
    observation: list[int]
    utilities: list[int]
    fully_observed: list[bool]
    event_observations: bool


def pack_network(network: TwoSliceNetwork, arrays: dict[str, Any]) -> Network:
    """Return a network as a struct, and add its tables to ``arrays``."""
    places: dict[int, int] = {}
    potentials: list[_Table | _Tree] = []

    def place(potential: Potential) -> int:
        key = id(potential)
        if key in places:
            return places[key]
        if isinstance(potential, Table):
            name = f"P{len(potentials)}"
            arrays[name] = potential.values
            packed: _Table | _Tree = _Table([(node.role, node.place) for node in potential.scope], name)
        else:
            branches = [place(branch) for branch in potential.branches]
            packed = _Tree((potential.node.role, potential.node.place), potential.choice.tolist(), branches)
        potentials.append(packed)
        places[key] = len(potentials) - 1
        return places[key]

    def each(of: Sequence[Potential]) -> list[int]:
        return [place(potential) for potential in of]

    return Network(
        potentials,
        initial=each(network.initial),
        transitions=each(network.transitions),
        observation=each(network.observation),
        utilities=each(network.utilities),
        fully_observed=list(network.fully_observed),
        event_observations=network.event_observations,
    )


def unpack_network(
    packed: Network, arrays: Mapping[str, Any], states: Space, actions: Space, observations: Space | None
) -> TwoSliceNetwork:
    """Return the network of a packed struct and its arrays.

    Raises:
        KeyError: If an array is missing.
        ModelError: If the parts are inconsistent.
    """
    made: list[Potential] = []
    for potential in packed.potentials:
        if isinstance(potential, _Table):
            values = arrays[potential.values]
            if values.dtype != np.float64 or not np.isfinite(values).all():
                raise ModelError(f"table {potential.values} holds values that are not finite floats")
            made.append(Table([Node(*node) for node in potential.scope], values))
        else:
            made.append(Tree(Node(*potential.node), potential.choice, _chosen(made, potential.branches)))
    return TwoSliceNetwork(
        states,
        actions,
        observations,
        initial=_chosen(made, packed.initial),
        transitions=_chosen(made, packed.transitions),
        observation=_chosen(made, packed.observation),
        utilities=_chosen(made, packed.utilities),
        fully_observed=packed.fully_observed,
        event_observations=packed.event_observations,
    )


def _chosen(made: list[Potential], places: list[int]) -> list[Potential]:
    if not all(0 <= place < len(made) for place in places):
        raise ModelError("a potential refers to one that is not listed before it")
    return [made[place] for place in places]


class _Durations(msgspec.Struct):
    of: Literal["step", "second"] = "step"
    format: Literal["mdm durations 1"] = "mdm durations 1"


def load_durations(path: str | Path) -> Durations:
    """Read durations from an archive; in one of an earlier version, which has no unit, they count steps.

    Raises:
        FormatError: If the file is damaged or holds no durations.
    """
    header, arrays = npz.read(Path(path))
    try:
        if b"mdm durations " not in header:
            raise ModelError("it holds something else")
        of = msgspec.json.decode(header, type=_Durations).of
        return Durations(arrays["means"], arrays["stages"], arrays.get("rates", 0.0), of=of)
    except KeyError as error:
        raise FormatError(f"the archive does not hold durations: {error} is missing", file=path) from None
    except (ModelError, msgspec.MsgspecError, ValueError) as error:
        why = npz.what_else(header, "durations", error)
        raise FormatError(f"the archive does not hold durations: {why}", file=path) from None


def save_durations(durations: Durations, path: str | Path) -> None:
    """Write durations to an archive, usually a ``.npz``.

    Raises:
        FormatError: If the file cannot be written.
    """
    arrays = {name: np.asarray(getattr(durations, name)) for name in ("means", "stages", "rates")}
    npz.write(Path(path), _Durations(durations.of), arrays)
