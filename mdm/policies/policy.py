"""What a policy is: a choice of action by what is known, and what each kind of policy says of itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, Self, TypeAlias

import numpy as np

from mdm.beliefs import BeliefTracker, Information, KnownState
from mdm.errors import ConfigError, ModelError
from mdm.models import POMDP

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch

__all__ = ["Arrays", "BeliefPolicy", "Deliberating", "Found", "Kind", "Packed", "Policy", "StatePolicy", "mismatch"]

Arrays: TypeAlias = "Mapping[str, npt.NDArray[Any]]"
Packed: TypeAlias = "tuple[dict[str, int], dict[str, npt.NDArray[Any]]]"
"""The sizes and the arrays that a policy is made of."""


class Policy(Protocol):
    """Chooses actions; implement it to bring a kind of policy of your own.

    `StatePolicy` and `BeliefPolicy` are bases that leave ``action`` to be written.

    Example::

        class Cautious(mdm.policies.BeliefPolicy):
            num_states, num_actions = 2, 3

            def action(self, belief):
                return 0 if belief.max() < 0.9 else 1 + int(belief.argmax() == 0)


        controller = mdm.Controller(Cautious(), "tiger.pomdp")
    """

    @property
    def num_actions(self) -> int:
        """How many (joint) actions it chooses among."""
        ...

    def information(self, model: MDP | None, /) -> Information:
        """Return what it chooses by, at its beginning.

        Raises:
            ConfigError: If that takes a model, and there is none, or one of another kind.
        """
        ...

    def action(self, x: Any, /) -> int:
        """Return the action for the information's ``current``."""
        ...


class Found(Protocol):
    """What a search found."""

    @property
    def action(self) -> int:
        """The action."""
        ...

    @property
    def expansions(self) -> int:
        """How many leaves of its tree were expanded."""
        ...


class Deliberating(Policy, Protocol):
    """A policy whose answer comes later, from a process of its own.

    Attributes:
        deliberates: True, by which a control layer knows it.
        worker: The module whose ``main`` runs in the process: it reads ``parts()``, then questions, and writes answers.
        seconds: How long an answer takes; None where a number of expansions decides.
        expansions: How many leaves are expanded at most; None where the time decides.
        fallback: What decides where no answer comes in time; or None.
    """

    deliberates: Literal[True]
    worker: str
    seconds: float | None
    expansions: int | None
    fallback: Policy | None

    def parts(self) -> Any:
        """Return what the process needs to know at its start."""
        ...

    def prepare(self) -> None:
        """Do what would make the first search in this process slow."""
        ...

    def belief_of(self, x: Any, /) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return a question as the process takes it: states, and their probabilities."""
        ...

    def search(self, x: Any, /, *, timed: bool = True) -> Found:
        """Search in this process."""
        ...


class Kind:
    """What kinds of policies have in common, as far as they know no better.

    Attributes:
        form: What the policy is, in a few words.
        horizon: How many decisions its plan has; None where it has no end.
    """

    form: ClassVar[str] = "a policy of another kind"
    input: Literal["state", "belief", "observation"]
    num_actions: int
    num_states: int | None
    horizon: int | None = None

    def value(self, x: Any, /) -> float:
        """Return the expected discounted return from a state or belief, which this kind of policy does not know.

        Raises:
            ModelError: Always.
        """
        raise ModelError(
            f"a {type(self).__name__} holds no values, so that of {x!r} is unknown: evaluate it on its model"
        )

    def value_at(self, belief: Vector) -> float | None:
        """Return what the policy claims to be worth at a belief over states; None where it claims nothing."""
        try:
            return self.value(belief)
        except ModelError:
            return None

    def mismatch(self, model: MDP) -> str | None:
        """Return what keeps the policy from being one for a model, as a sentence; None where it is."""
        sizes = len(model.state_space), len(model.action_space)
        if (self.num_states, self.num_actions) != sizes:
            return other_sizes((self.num_states, self.num_actions), ("states", "actions"), sizes)
        return None

    def facts(self) -> dict[str, Any]:
        """Return its sizes, by name."""
        return {"states": self.num_states, "actions": self.num_actions}

    def packed(self) -> Packed | None:
        """Return its sizes and arrays; None where files hold no policies of its kind."""
        return None

    def batch(self, model: MDP) -> Batch | None:  # noqa: ARG002 - for kinds that can
        """Return its decisions for many episodes at once; None where they are made one by one."""
        return None

    def __repr__(self) -> str:
        sizes = ", ".join(f"{count} {what}" for what, count in self.facts().items() if count is not None)
        return f"<{type(self).__name__}: {sizes}>"


class StatePolicy(Kind):
    """A policy over states, the base of its kinds. A kind of your own sets the sizes and defines ``action``.

    Attributes:
        num_states: S.
        num_actions: A.
        table: The action per state, a list, where the policy is no more than that; None for others.
    """

    input: Literal["state"] = "state"
    table: Sequence[int] | None = None
    num_states: int

    def information(self, model: MDP | None) -> Information:  # noqa: ARG002 - the state is seen
        """Return the state, which is not seen yet."""
        return KnownState()

    def action(self, state: Any, /) -> int:
        """Return the action for a state's index."""
        raise NotImplementedError

    def weights(self, stage: int = 0) -> Vector:  # noqa: ARG002 - for kinds with stages
        """Return the probability of each action in each state, A x S."""
        result = np.zeros((self.num_actions, self.num_states))
        result[[self.action(state) for state in range(self.num_states)], np.arange(self.num_states)] = 1
        return result

    def value_at(self, belief: Vector) -> float | None:
        """Return the expected value of the states; None where they have none."""
        (states,) = np.nonzero(belief)
        try:
            return float(sum(belief[state] * self.value(int(state)) for state in states))
        except ModelError:
            return None


class BeliefPolicy(Kind):
    """A policy over beliefs, the base of its kinds. A kind of your own sets the sizes and defines ``action``.

    Attributes:
        num_states: S.
        num_actions: A.
        by_support: Whether ``action`` takes a belief by its `Support`, too.
    """

    input: Literal["belief"] = "belief"
    num_states: int
    by_support: bool = False

    def information(self, model: MDP | None) -> Information:
        """Return the tracker of the belief.

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
    """A kind of policy that files hold."""

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return the policy that was packed.

        Raises:
            KeyError: If something is missing.
            ModelError: If something does not fit.
        """
        ...


def observable(model: MDP | None) -> POMDP:
    """Return a model by which beliefs are tracked.

    Raises:
        ConfigError: If it is none.
    """
    if isinstance(model, POMDP):
        return model
    why = "there is none" if model is None else "the one given has no observations"
    raise ConfigError(f"a policy over beliefs needs the POMDP by which to track the belief, but {why}", key="model")


def mismatch(policy: Any, model: MDP) -> str | None:
    """Return what keeps a policy from being one for a model, as a sentence; None where it is."""
    told = getattr(policy, "mismatch", None)
    if told is not None:
        text: str | None = told(model)
        return text
    if policy.num_actions != len(model.action_space):
        return f"the policy is for {policy.num_actions} actions, but the model has {len(model.action_space)}"
    return None


def other_sizes(ours: tuple[int | None, int], what: tuple[str, str], theirs: tuple[int, int]) -> str:
    """Return the sentence that a policy is of other sizes than a model."""
    return (
        f"the policy is for {ours[0]} {what[0]} and {ours[1]} {what[1]}, but the model has {theirs[0]} and {theirs[1]}"
    )


def whole(numbers: Any) -> npt.NDArray[np.int64]:
    """Return whole numbers as an array."""
    return np.fromiter(numbers, dtype=np.int64)


def listed(array: npt.NDArray[Any]) -> list[int]:
    """Return an array of one dimension of whole numbers as a list.

    Raises:
        ModelError: If it is none.
    """
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise ModelError("an array of indices has other numbers or dimensions")
    result: list[int] = array.tolist()
    return result
