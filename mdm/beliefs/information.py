"""Information states: what a policy chooses by, and how it moves.

A state where it is seen, a belief where it is not, the node of a plan where neither is asked for: each is brought to a
beginning, moved by what was done and observed, and looked at. A decision process needs no more of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import numpy as np

from mdm.errors import ModelError

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector

__all__ = ["Drawn", "DrawnInformation", "Information", "KnownState", "restore", "snapshot"]


class Information(Protocol):
    """What a policy chooses by. Implement it to bring a belief tracker, or an information state, of your own.

    Optional members, used where they are there: ``takes`` ("state" or "observation", the default), ``belief`` (where
    ``current`` is no array), ``expected(values)`` (the expectation of a function of the state), ``ended`` (whether a
    plan is over), ``horizon`` (the number of stages), and ``snapshot()`` and ``restore(snapshot)``, whose snapshots are
    made of numbers, bytes, strings and lists. Without the last two, ``current`` is kept and begun from.

    Example::

        class Halving:
            def __init__(self):
                self.reset()

            def reset(self, belief=None):
                self.current = np.full(2, 0.5) if belief is None else np.asarray(belief)

            def update(self, action, observation):
                return 1.0


        controller = mdm.Controller("tiger.vf", "tiger.pomdp", tracker=Halving())
    """

    @property
    def current(self) -> Any:
        """What the policy is asked with; an array that was handed out never changes."""
        ...

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Begin anew: from a belief, or as the model says."""
        ...

    def update(self, action: int, observation: Any) -> float:
        """Take an action and what was observed after it, None where nothing was.

        Returns:
            P(observation | information, action). Where it is 0, the information stays as it was.
        """
        ...


class KnownState:
    """The state itself, where it is seen: each observation is the state's index.

    Attributes:
        current: The state; None until one is seen.
    """

    takes: Literal["state"] = "state"

    def __init__(self) -> None:
        self.current: Any = None

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Forget the state.

        Raises:
            ModelError: If a belief is given.
        """
        if belief is not None:
            raise ModelError("the policy decides on states that it sees: it takes no belief")
        self.current = None

    def update(self, action: int | None, observation: int | None) -> float:  # noqa: ARG002 - as any information
        """Take the state that is seen; None keeps the last one. Return 1."""
        if observation is not None:
            self.current = observation
        return 1.0

    def expected(self, values: Vector) -> float:
        """Return the value of the state, of S numbers."""
        return float(values.item(self.current))

    def snapshot(self) -> Any:
        """Return the state."""
        return self.current

    def restore(self, snapshot: Any) -> None:
        """Go on from a snapshot."""
        self.current = snapshot


class Drawn(NamedTuple):
    """Information, and the number from [0, 1) by which an action is drawn for it."""

    by: Any
    number: float


class DrawnInformation:
    """Information with a number for each decision, for policies that draw: the same seed makes the same decisions.

    Args:
        of: The information.
        seed: Seeds the numbers.
    """

    def __init__(self, of: Information, seed: int | None) -> None:
        self._of = of
        self.takes = getattr(of, "takes", "observation")
        self.expected = getattr(of, "expected", None)
        self._generator = np.random.PCG64(seed)
        self._number: float | None = None

    @property
    def current(self) -> Drawn:
        """The information, and the number; it is drawn when it is first asked for."""
        if self._number is None:
            self._number = np.random.Generator(self._generator).random()
        return Drawn(self._of.current, self._number)

    @property
    def belief(self) -> Any:
        """The belief, where one is tracked; else None."""
        return getattr(self._of, "belief", None)

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Begin anew; the numbers go on."""
        self._of.reset(belief)
        self._number = None

    def update(self, action: int, observation: Any) -> float:
        """Move, and forget the number."""
        self._number = None
        return self._of.update(action, observation)

    def snapshot(self) -> Any:
        """Return the information, the number, and where the generator is."""
        state = self._generator.state["state"]
        return [snapshot(self._of), self._number, str(state["state"]), str(state["inc"])]

    def restore(self, snapshot: Any) -> None:
        """Go on from a snapshot."""
        of, self._number, state, inc = snapshot
        restore(self._of, of)
        self._generator.state = {**self._generator.state, "state": {"state": int(state), "inc": int(inc)}}


def snapshot(information: Information) -> Any:
    """Return what it takes to go on from here, of numbers, bytes, strings and lists."""
    own = getattr(information, "snapshot", None)
    if own is not None:
        return own()
    return np.array(information.current, dtype=np.float64).tolist()


def restore(information: Information, snapshot: Any) -> None:
    """Go on from a snapshot."""
    own = getattr(information, "restore", None)
    if own is not None:
        own(snapshot)
    else:
        information.reset(np.array(snapshot))
