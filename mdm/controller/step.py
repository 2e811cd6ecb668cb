"""Steps: decisions, and the past that explains them."""

from __future__ import annotations

from bisect import bisect_right
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.errors import ModelError

if TYPE_CHECKING:
    from mdm.explanation import Case, Explanation
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.options import OnImpossible
    from mdm.policies import Policy
    from mdm.symbols import Symbols

    _MadeOf = tuple[Policy, MDP | None, Symbols, OnImpossible, bool]

KEPT = 10
"""Decisions whose information is kept at least, to explain later ones by."""


class Step(msgspec.Struct, frozen=True, gc=False):
    """A decision.

    Attributes:
        epoch: Its number in the episode, from 0.
        action: The (joint) action's index.
        action_name: Its name.
        reward: The expected immediate reward; None if it is not known.
        probability: P(observation | information, action) of the observation before; 0 if it was impossible, None at
            the start and for policies over states.
        at: The state, the belief (an array or a `Support`) or the nodes that it was decided on. Steps are equal
            without it.
        past: The decisions before, to explain it by; None of a step that no controller has made.
    """

    epoch: int
    action: int
    action_name: str
    reward: float | None
    probability: float | None = None
    at: Any = None
    past: Past | None = None

    @property
    def wanted(self) -> int | None:
        """The action in whose place the policy's shield has taken this one; None where it has not."""
        return None if self.past is None else self.past.wanted(self.at)

    def explain(self, last: int = KEPT) -> Explanation:
        """Return why it was decided: values, the observation that mattered, the change for another decision.

        Args:
            last: How many of the last observations are looked at; ten are kept, of large beliefs fewer.

        Raises:
            ModelError: If no controller has made it.
        """
        from mdm.explanation import explain  # noqa: PLC0415 - nobody who runs a robot need load it

        return explain(self.case(last))

    def case(self, last: int = KEPT) -> Case:
        """Return it with its inputs, for the functions of `mdm.explanation`; arguments as of `explain`."""
        if self.past is None:
            raise ModelError("only a step that a controller has made can be explained")
        return self.past.case(self, last)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Step) and self._told() == other._told()

    def __hash__(self) -> int:
        return hash(self._told())

    def __repr__(self) -> str:
        told = zip(self.__struct_fields__, self._told(), strict=False)
        return f"Step({', '.join(f'{name}={value!r}' for name, value in told)})"

    def _told(self) -> tuple[int, int, str, float | None, float | None]:
        return self.epoch, self.action, self.action_name, self.reward, self.probability


class Past:
    """The last decisions of an episode, which only grow: a step is explained by those before it, also when it is old.

    Args:
        made_of: Their makers: policy, model, symbols, the meaning of an impossible observation, and whether the
            information state is a tracker of the user's.
        first: The number of the first one.
        initial: The belief from which the episode began, where that is not the model's; None for that.
        begins: Whether nothing came before the first one; else that is not known.
    """

    __slots__ = ("_begins", "_first", "_initial", "_made_of", "decided", "updates")

    def __init__(self, made_of: _MadeOf, first: int, initial: Vector | None, *, begins: bool) -> None:
        self.decided: list[Any] = []
        """What each was decided on."""
        self.updates: list[tuple[int, int, Any]] = []
        """The updates between them: the number of the decision that followed, the action before, the observation."""
        self._made_of = made_of
        self._first = first
        self._initial = initial
        self._begins = begins

    def wanted(self, at: Any) -> int | None:
        """Return the same of the information state of a step."""
        found: int | None = getattr(self._made_of[0], "wanted", lambda _: None)(at)
        return found

    def later(self, kept: int) -> Past:
        """Return the same without its first decisions, but for so many."""
        first = self._first + len(self.decided) - kept
        past = Past(self._made_of, first, self._initial, begins=False)
        past.decided = self.decided[-kept:]
        past.updates = self.updates[bisect_right(self.updates, first, key=itemgetter(0)) :]
        return past

    def case(self, step: Step, last: int) -> Case:
        """Return a step with its inputs."""
        from mdm.explanation.case import Case, Update  # noqa: PLC0415 - see `Step.explain`

        (policy, model, symbols, on_impossible, own_tracker), number = self._made_of, step.epoch - self._first
        known = symbols.takes != "state" and 0 <= number < len(self.decided)
        first = max(number - last, 0)
        initial = None
        if known and self._begins and first == 0 and model is not None:
            initial = model.initial_belief if self._initial is None and not model.stays_factored else self._initial
        return Case(
            *(policy, model, symbols.state_space, symbols.action_space, symbols.observation_space),
            *(step.epoch, step.action, step.at),
            before=self.decided[first] if known else None,
            updates=tuple(
                Update(*update) for update in self.updates if known and first < update[0] - self._first <= number
            ),
            initial=initial,
            on_impossible=on_impossible,
            tracked=not own_tracker,
        )
