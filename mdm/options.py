"""The options of a decision process: one typed dictionary, which ensembles, files and commands pass on."""

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
    """What configures a controller, and so a control layer, an ensemble and a simulation.

    Attributes:
        horizon: Decisions in an episode; what comes after them starts a new one. By default, and at most, those that
            the policy has stages for.
        on_impossible: What becomes of the information at an observation of probability 0: ``predict`` (the default:
            time passes, nothing seen), ``keep`` it, ``reset`` it, or ``safe_action`` (as ``predict``; a control layer
            runs the safe action besides).
        rewards: R(s, a), an S x A array, where no model has it.
        initial_belief: In place of the model's: S numbers, or the name or index of a state that is certain.
        tracker: An information state of your own in place of the policy's; see `mdm.beliefs.Information`.
        false_negative: The observation, by name or index, that stands for an event that nobody noticed; see
            `POMDP.with_false_negatives`.
        seed: For policies that draw: the same seed makes the same decisions.
    """

    horizon: int | None
    on_impossible: OnImpossible
    rewards: npt.ArrayLike | None
    initial_belief: Any
    tracker: Information | None
    false_negative: Symbol | None
    seed: int | None


def check_options(options: Iterable[str], known: type) -> None:
    """Refuse options that there are not.

    Raises:
        ConfigError: With the names closest to it.
    """
    names: tuple[str, ...] = tuple(known.__annotations__)
    for option in options:
        if option not in names:
            close = difflib.get_close_matches(option, names, n=3)
            hint = f"did you mean {' or '.join(map(repr, close))}?" if close else f"there are {', '.join(names)}"
            raise ConfigError(f"there is no option {option!r}; {hint}", key=option)
