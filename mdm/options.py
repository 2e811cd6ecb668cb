"""The options of a decision process: one typed dictionary for ensembles, files and commands."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from mdm.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy.typing as npt

    from mdm.beliefs import Information
    from mdm.models.space import Symbol

__all__ = ["ControllerOptions", "OnImpossible", "check_options"]

OnImpossible = Literal["predict", "keep", "reset", "safe_action"]


class ControllerOptions(TypedDict, total=False):
    """The options of a controller, and so of control layers, ensembles and simulations.

    Attributes:
        horizon: Decisions per episode, at most (and by default) the number of the policy's stages. The next input then
            begins a new episode.
        on_impossible: The treatment of an observation of probability 0: ``predict`` (the default) updates without an
            observation, ``keep`` keeps the information state, ``reset`` resets it, and ``safe_action`` predicts, while
            a control layer also runs the safe action.
        rewards: R(s, a), an S x A array; by default the model's.
        initial_belief: The initial belief: S numbers, or the name or index of a certain state; by default the model's.
        tracker: An information state of your own; see `mdm.beliefs.Information`.
        false_negative: The observation, by name or index, of an undetected event; see `POMDP.with_false_negatives`.
        memory: The most megabytes that the model may take here, as matrices or as its beliefs need them; one that would
            take more is refused before they are made. Memory then counts for more than microseconds: a factored model
            stays factored (`MDP.sparingly`). By default all that the machine has free, and speed counts.
        seed: The seed of a stochastic policy: equal seeds give equal decisions.
    """

    horizon: int | None
    on_impossible: OnImpossible
    rewards: npt.ArrayLike | None
    initial_belief: Any
    tracker: Information | None
    false_negative: Symbol | None
    memory: float | None
    seed: int | None


def check_options(options: Iterable[str], known: type) -> None:
    """Refuse unknown options.

    Raises:
        ConfigError: If there is one; the message suggests similar names.
    """
    names: tuple[str, ...] = tuple(known.__annotations__)
    for option in options:
        if option not in names:
            close = difflib.get_close_matches(option, names, n=3)
            hint = f"did you mean {' or '.join(map(repr, close))}?" if close else f"there are {', '.join(names)}"
            raise ConfigError(f"there is no option {option!r}; {hint}", key=option)
