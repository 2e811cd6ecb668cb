"""Information states: the input of a policy, and its update.

It is the state if that is observed, else a belief, or the node of a plan. Each can be reset, updated by an action and
an observation, and read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import numpy as np

from mdm.errors import ModelError

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector


class Information(Protocol):
    """The input of a policy. Implement this protocol for a belief tracker or information state of your own.

    Optional members are ``takes`` ("state" or "observation", the default), ``belief`` (if ``current`` is not an array),
    ``expected(values)`` (the expectation of a function of the state), ``ended`` (whether a plan is over), ``horizon``
    (the number of stages), and ``snapshot()`` and ``restore(snapshot)``, with snapshots made of numbers, bytes, strings
    and lists. Without the last two, a snapshot is ``current``, which has to be a belief, and `reset` restores it.

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
        """The argument of the policy's ``action``; an array that was handed out never changes."""
        ...

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Begin an episode: from a belief, or the model's initial one."""
        ...

    def update(self, action: int, observation: Any) -> float:
        """Update by an action and the observation after it.

        Args:
            action: The index of the last (joint) action.
            observation: An index; a component per agent, None for a missing one; the set of indices of which one was
                observed, where the sensors are several and the model's observations are one flat set; or None for no
                observation.

        Returns:
            P(observation | information, action). If it is 0, the information is unchanged.
        """
        ...


class KnownState:
    """The observed state: each observation is the index of the state.

    Attributes:
        current: The state; None before the first observation.
    """

    __slots__ = ("current",)

    takes: Literal["state"] = "state"

    def __init__(self) -> None:
        self.current: Any = None

    @property
    def state(self) -> int | None:
        """The state's index; None until one is seen."""
        state: int | None = self.current
        return state

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Forget the state.

        Raises:
            ModelError: If a belief is given.
        """
        if belief is not None:
            raise ModelError("the policy is over states: it takes no belief")
        self.current = None

    def update(self, action: int | None, observation: int | None) -> float:
        """Set the state; None keeps the last one. Return 1."""
        if observation is not None:
            self.current = observation
        return 1.0

    def expected(self, values: Vector) -> float:
        """Return the state's entry of S values."""
        return float(values.item(self.current))

    def snapshot(self) -> Any:
        """Return the state."""
        return self.current

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        self.current = snapshot


class Drawn(NamedTuple):
    """Information, and a random number from [0, 1) for the draw of an action."""

    by: Any
    number: float


class DrawnInformation:
    """Information with a random number per decision, for stochastic policies: equal seeds give equal decisions.

    Args:
        of: The information.
        seed: The seed of the random numbers.

    Attributes:
        of: The information.
    """

    def __init__(self, of: Information, seed: int | None) -> None:
        self.of = of
        self.takes = getattr(of, "takes", "observation")
        self.expected = getattr(of, "expected", None)
        self._generator = np.random.PCG64(seed)
        self._number: float | None = None
        self._divided: str | None = None
        self._episode, self._drawn = 0, False

    def divide(self, episode: int) -> None:
        """Give each episode random numbers of its own, 2^64 of the sequence; the next one has those of this number."""
        self.draws = self._divided = self._divided or self.draws
        self._generator.advance(episode << 64)
        self._episode, self._drawn = episode, False

    @property
    def state(self) -> int | None:
        """The state's index, where it is seen."""
        state: int | None = getattr(self.of, "state", None)
        return state

    @property
    def current(self) -> Drawn:
        """The information and the number, which is drawn on first access."""
        if self._number is None:
            self._number, self._drawn = np.random.Generator(self._generator).random(), True
        return Drawn(self.of.current, self._number)

    @property
    def belief(self) -> Any:
        """The belief; None if none is tracked."""
        return getattr(self.of, "belief", None)

    @property
    def draws(self) -> str:
        """The state of the generator, from which it goes on where that is set."""
        state = self._generator.state["state"]
        return f"{state['state']} {state['inc']}"

    @draws.setter
    def draws(self, draws: str) -> None:
        state, inc = map(int, draws.split())
        self._generator.state = {**self._generator.state, "state": {"state": state, "inc": inc}}
        self._divided = self._divided and draws

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Begin an episode; the sequence of random numbers goes on, unless each has its own."""
        self.of.reset(belief)
        self._number = None
        if self._divided and self._drawn:
            self.divide(self._episode + 1)

    def update(self, action: int, observation: Any) -> float:
        """Update the information, and discard the number."""
        self._number = None
        return self.of.update(action, observation)

    def snapshot(self) -> Any:
        """Return the information, the number, and the state of the generator."""
        state = self._generator.state["state"]
        return [snapshot(self.of), self._number, str(state["state"]), str(state["inc"])]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot."""
        of, number, state, inc = snapshot
        if number is not None and not 0 <= number < 1:
            raise ModelError(f"{number!r} is no random number from [0, 1)")
        restore(self.of, of)
        self._number = number
        self._generator.state = {**self._generator.state, "state": {"state": int(state), "inc": int(inc)}}


def snapshot(information: Information) -> Any:
    """Return a snapshot made of numbers, bytes, strings and lists."""
    own = getattr(information, "snapshot", None)
    if own is not None:
        return own()
    try:
        return np.array(information.current, dtype=np.float64).tolist()
    except (TypeError, ValueError):
        raise ModelError(
            f"a {type(information).__name__} keeps more than a belief: to snapshot it, give it snapshot() and "
            "restore(snapshot), see mdm.beliefs.Information"
        ) from None


def restore(information: Information, snapshot: Any) -> None:
    """Restore a snapshot."""
    own = getattr(information, "restore", None)
    if own is not None:
        own(snapshot)
    else:
        information.reset(np.array(snapshot))
