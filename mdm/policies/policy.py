"""The protocol of policies, and the bases of their kinds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol, Self, TypeAlias

import numpy as np

from mdm.beliefs import BeliefTracker, Information, KnownState
from mdm.errors import ConfigError, ModelError
from mdm.models.units import Unit  # noqa: TC001 - field types are evaluated
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from mdm.models import MDP, POMDP
    from mdm.models.matrices import Vector
    from mdm.models.space import Space
    from mdm.policies.batch import Batch

Arrays: TypeAlias = "Mapping[str, npt.NDArray[Any]]"
Packed: TypeAlias = "tuple[dict[str, int], dict[str, npt.NDArray[Any]]]"
"""The sizes and arrays of a policy."""


class Scores(NamedTuple):
    """What a policy compares to choose an action: a number for each.

    Args:
        by: Expected returns (``value``), lower bounds of them (``bound``), probabilities of observed values that vote
            for an action (``vote``), or probabilities by which it is drawn (``chance``).
        numbers: A numbers; -inf for an action that is not weighed.
        upper: Of lower bounds, the upper ones; else None.
        effort: How many leaves a search has expanded for them; None where nothing is searched.
    """

    by: Literal["value", "bound", "vote", "chance"]
    numbers: Vector
    upper: Vector | None = None
    effort: int | None = None


class Policy(Protocol):
    """Chooses actions. Implement this protocol for a kind of policy of your own.

    The bases `StatePolicy` and `BeliefPolicy` leave only ``action`` to be written.

    Example::

        class Cautious(mdm.policies.BeliefPolicy):
            num_states, num_actions = 2, 3

            def action(self, belief):
                return 0 if belief.max() < 0.9 else 1 + int(belief.argmax() == 0)


        controller = mdm.Controller(Cautious(), "tiger.pomdp")
    """

    @property
    def num_actions(self) -> int:
        """The number of (joint) actions."""
        ...

    def information(self, model: MDP | None, /) -> Information:
        """Return its information state at the start of an episode.

        Raises:
            ConfigError: If it needs a model, and that is missing or of another kind.
        """
        ...

    def action(self, x: Any, /) -> int:
        """Return the action for the information's ``current``."""
        ...


class Found(Protocol):
    """The result of a search."""

    @property
    def action(self) -> int:
        """The action."""
        ...

    @property
    def expansions(self) -> int:
        """The number of expansions."""
        ...


class Deliberating(Policy, Protocol):
    """A policy whose answer comes later, from a process of its own.

    Attributes:
        deliberates: True; it marks the kind.
        worker: The module whose ``main`` runs in the process: it reads ``parts()``, then questions, and writes answers.
        seconds: The time for an answer; None if only ``expansions`` limits it.
        expansions: The most expansions per answer; None if only ``seconds`` limits it.
        fallback: The policy that decides if no answer comes in time; or None.
    """

    deliberates: Literal[True]
    worker: str
    seconds: float | None
    expansions: int | None
    fallback: Policy | None

    def parts(self) -> Any:
        """Return the message that starts the process."""
        ...

    def prepare(self) -> None:
        """Prepare this process, so that the first search is not slow."""
        ...

    def belief_of(self, x: Any, /) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return a question for the process: states, and their probabilities."""
        ...

    def search(self, x: Any, /, *, timed: bool = True) -> Found:
        """Search in this process."""
        ...


class Kind:
    """The defaults of all kinds of policies.

    Attributes:
        form: A description in a few words.
        horizon: The number of decisions of its plan; None without an end.
        discount_of: What the discount of its values is of, see `MDP.with_discount`.
        state_space: Of the model that it was solved or loaded with: tables take its names. None without one.
    """

    form: ClassVar[str] = "a policy of another kind"
    input: Literal["state", "belief", "observation"]
    num_actions: int
    num_states: int | None
    horizon: int | None = None
    discount_of: Unit = "step"
    state_space: Space | None = None

    def value(self, x: Any, /) -> float:
        """Return the expected discounted return from a state or belief.

        Raises:
            ModelError: If the policy has no values, which is the default.
        """
        raise ModelError(f"a {type(self).__name__} has no value for {x!r}: evaluate it on its model")

    def scores(self, x: Any, /) -> Scores | None:
        """Return what it compares to choose, for its information's ``current``; None if it compares nothing."""
        return None

    def value_at(self, belief: Vector) -> float | None:
        """Return the value that the policy claims at a belief; None if it has no values."""
        try:
            return self.value(belief)
        except ModelError:
            return None

    def mismatch(self, model: MDP) -> str | None:
        """Return why the policy does not fit a model, as a sentence; None if it fits."""
        sizes = len(model.state_space), len(model.action_space)
        if (self.num_states, self.num_actions) != sizes:
            return other_sizes((self.num_states, self.num_actions), ("states", "actions"), sizes)
        return None

    def facts(self) -> dict[str, Any]:
        """Return its sizes by name."""
        return {"states": self.num_states, "actions": self.num_actions}

    def for_first_states(self, count: int) -> Policy:
        """Return the same policy for the first so many states, where no other state follows.

        Raises:
            ModelError: If a policy of its kind cannot be cut, which is the default.
        """
        raise ModelError(f"a {type(self).__name__} cannot be cut to {count} states: take another solver")

    def packed(self) -> Packed | None:
        """Return its sizes and arrays; None if files cannot hold its kind."""
        return None

    def parameters(self) -> list[Any]:
        """Return what decides besides the information, as numbers, strings, lists and arrays; digests contain it."""
        packed = self.packed()
        if packed is None:
            return []
        sizes, arrays = packed
        return [sorted(sizes.items()), *(part for name in sorted(arrays) for part in (name, arrays[name]))]

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes; None if it decides for one at a time."""
        return None

    def __repr__(self) -> str:
        sizes = ", ".join(f"{count} {what}" for what, count in self.facts().items() if count is not None)
        return f"<{type(self).__name__}: {sizes}>"


class StatePolicy(Kind):
    """The base of policies over states. A kind of your own sets the sizes and defines ``action``.

    Attributes:
        num_states: S.
        num_actions: A.
        table: The list of actions per state, if that is the whole policy; else None.

    Example::

        class Parity(mdm.policies.StatePolicy):
            num_states, num_actions = 4, 2

            def action(self, state):
                return state % 2


        mdm.Controller(Parity()).start(3).action  # 1
    """

    input: Literal["state"] = "state"
    table: Sequence[int] | None = None
    num_states: int

    def information(self, model: MDP | None) -> Information:
        """Return the state, which is not known yet."""
        return KnownState()

    def action(self, state: Any, /) -> int:
        """Return the action for a state's index."""
        raise NotImplementedError

    def weights(self, stage: int = 0) -> Vector:
        """Return the probability of each action in each state, A x S."""
        result = np.zeros((self.num_actions, self.num_states))
        result[[self.action(state) for state in range(self.num_states)], np.arange(self.num_states)] = 1
        return result

    def value_at(self, belief: Vector) -> float | None:
        """Return the expected value of the states; None if they have none."""
        (states,) = np.nonzero(belief)
        try:
            return float(sum(belief[state] * self.value(int(state)) for state in states))
        except ModelError:
            return None


class BeliefPolicy(Kind):
    """The base of policies over beliefs. A kind of your own sets the sizes and defines ``action``.

    Attributes:
        num_states: S.
        num_actions: A.
        by_support: Whether ``action`` accepts a `Support` as well as an array.

    Example::

        class Cautious(mdm.policies.BeliefPolicy):
            num_states, num_actions = 2, 3

            def action(self, belief):
                return 0 if belief.max() < 0.9 else 1 + int(belief.argmax() == 0)


        mdm.Controller(Cautious(), "tiger.pomdp").start().action_name  # 'listen'
    """

    input: Literal["belief"] = "belief"
    num_states: int
    by_support: bool = False

    def information(self, model: MDP | None) -> Information:
        """Return a belief tracker.

        Raises:
            ConfigError: If the model is no POMDP.
        """
        return BeliefTracker(observable(model), by_support=self.by_support)

    def action(self, belief: Any, /) -> int:
        """Return the action for a belief: an array of S numbers."""
        raise NotImplementedError

    def actions_at(self, beliefs: Vector) -> npt.NDArray[np.intp]:
        """Return the action for each belief, N x S."""
        return np.array([self.action(belief) for belief in beliefs], dtype=np.intp)


class Packable(Policy, Protocol):
    """A kind of policy that files can hold."""

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy.

        Raises:
            KeyError: If a size or an array is missing.
            ModelError: If they do not fit each other.
        """
        ...


def observable(model: MDP | None) -> POMDP:
    """Return a model for belief tracking.

    Raises:
        ConfigError: If it is not a POMDP.
    """
    if model is not None and model.pomdp is not None:
        return model.pomdp
    why = "there is none" if model is None else "the one given has no observations"
    raise ConfigError(f"a policy over beliefs needs a POMDP to track the belief, but {why}", key="model")


def mismatch(policy: Any, model: MDP) -> str | None:
    """Return why a policy does not fit a model, as a sentence; None if it fits."""
    told = getattr(policy, "mismatch", None)
    if told is not None:
        text: str | None = told(model)
        return text or (None if model.available is None else _unavailable(policy, model, model.available))
    if policy.num_actions != len(model.action_space):
        return f"the policy is for {counted(policy.num_actions, 'action')}, but the model has {len(model.action_space)}"
    return None


def _unavailable(policy: Any, model: MDP, available: npt.NDArray[np.bool_]) -> str | None:
    """Return which action a policy chooses where it is not available, as a sentence; None where it chooses none.

    What a policy over beliefs chooses is looked at where it is chosen.
    """
    if policy.input == "observation":
        return "a plan over observations does not know which actions are available: take a policy over beliefs"
    if policy.input == "state" and hasattr(policy, "weights"):
        for stage in range(policy.horizon or 1):
            wrong = np.argwhere((policy.weights(stage).T > 0) & ~available)
            for state, action in wrong.tolist():
                name, where = model.action_space.names[action], model.state_space.names[state]
                return f"the policy chooses {name!r} in state {where!r}, where that action is not available"
    return None


def other_sizes(ours: tuple[int | None, int], what: tuple[str, str], theirs: tuple[int, int]) -> str:
    """Return the sentence that a policy and a model differ in size, with the sizes that do."""
    differ = [at for at in range(2) if ours[at] != theirs[at]]
    own = " and ".join(f"{ours[at]} {what[at]}" for at in differ)
    return f"the policy is for {own}, but the model has {' and '.join(str(theirs[at]) for at in differ)}"


def whole(numbers: Any) -> npt.NDArray[np.int64]:
    """Return whole numbers as an array."""
    return np.fromiter(numbers, dtype=np.int64)


def listed(array: npt.NDArray[Any]) -> list[int]:
    """Return a one-dimensional array of whole numbers as a list.

    Raises:
        ModelError: If it has other dimensions or numbers.
    """
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise ModelError("an array of indices must be one-dimensional, of whole numbers")
    result: list[int] = array.tolist()
    return result
