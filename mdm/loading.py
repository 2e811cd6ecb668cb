"""The forms in which users give models and policies: objects, paths of files, or plain numbers."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, cast

import numpy as np

from mdm.errors import ConfigError
from mdm.models import MDP
from mdm.policies import DeterministicPolicy, QTable, mismatch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from mdm.policies import Policy

    GivenModel: TypeAlias = MDP | str | os.PathLike[str]
    GivenPolicy: TypeAlias = (
        Policy | str | os.PathLike[str] | Sequence[int] | Sequence[Sequence[float]] | npt.NDArray[Any]
    )

__all__ = ["model_of", "pair_of", "policy_of", "revealed", "spared"]


_Flat = TypeVar("_Flat", bound=MDP)


def model_of(given: GivenModel) -> MDP:
    """Return a model, given itself or by the path of its file.

    Raises:
        ConfigError: If it is neither.
        FormatError: If the file is not a model.
    """
    if isinstance(given, MDP):
        return given
    if isinstance(given, str | os.PathLike):
        from mdm.formats import load_model  # noqa: PLC0415 - the formats are loaded for those who have files

        return load_model(Path(given))
    raise ConfigError(f"a model is an MDP or POMDP, or the path of a file, not {_told(given)}", key="model")


def spared(model: MDP) -> MDP:
    """Return a model for a process whose memory counts (`MDP.sparingly`) and which shares matrices with others."""
    return model.sparingly(_mapped)


def _mapped(model: MDP, make: Callable[[], _Flat]) -> _Flat:
    from mdm.formats.archive.flat import mapped  # noqa: PLC0415 - for those that need matrices

    return mapped(model, make)


def policy_of(given: GivenPolicy, model: MDP | None = None) -> Policy:
    """Return a policy, given itself, by the path of its file, or by numbers.

    Numbers are a list of actions, one per state, or a Q-table, states x actions.

    Raises:
        ConfigError: If it is none of these.
        FormatError: If the file is not a policy, or is for another model.
        ModelError: If the numbers are not a valid table.
    """
    if isinstance(given, str | os.PathLike):
        from mdm.formats import load_policy  # noqa: PLC0415 - the formats are loaded for those who have files

        return load_policy(Path(given), model)
    if isinstance(given, list | tuple | np.ndarray):
        try:
            array = np.asarray(given)
        except ValueError:
            array = np.empty(())
        if array.ndim == 1 and array.dtype.kind in "iu":
            return DeterministicPolicy(array.tolist(), None if model is None else len(model.action_space))
        if array.ndim == 2 and array.dtype.kind in "iuf":
            return QTable(array)
    elif (
        not isinstance(given, type)
        and callable(getattr(given, "information", None))
        and callable(getattr(given, "action", None))
        and hasattr(given, "num_actions")
    ):
        return cast("Policy", given)
    found: Any = getattr(given, "policy", None)  # of a solver's result
    if found is not None:
        return policy_of(found, model)
    missing = [name for name in ("num_actions", "information", "action") if not hasattr(given, name)]
    if hasattr(given, "action") and missing and not isinstance(given, type):
        raise ConfigError(
            f"the policy {type(given).__name__} has no {' and no '.join(missing)}: derive it from StatePolicy or "
            f"BeliefPolicy of mdm.policies",
            key="policy",
        )
    raise ConfigError(
        f"a policy is an object of mdm.policies, the path of a file, a list of action indices, one per state, or an "
        f"array of values, states x actions, not {_told(given)}",
        key="policy",
    )


def pair_of(
    model: MDP, path: str | os.PathLike[str], *, seed: int | None = None, false_negative: str | None = None
) -> tuple[Policy, MDP]:
    """Return the policy of a file, and a model as that policy sees it.

    A controller made for the model's own observations gets only these, without the fully observed factors.

    Args:
        model: The model.
        path: The policy's file.
        seed: Of the policy's draws, where it draws.
        false_negative: The observation that is seen where nothing is, if the model is to have one.

    Raises:
        FormatError: If the file is not a policy, or is for another model.
    """
    from mdm.formats import load_policy  # noqa: PLC0415 - the formats are loaded for those who have files

    seen = revealed(model)
    policy: Any = None
    if seen is not model:
        policy = load_policy(Path(path), seed=seed)
        if policy.input != "observation":
            policy = None
        elif mismatch(policy, seen) is not None:
            policy, seen = None, model
    if policy is None:
        policy = load_policy(Path(path), model, seed=seed)
    return policy, seen if false_negative is None else seen.with_false_negatives(false_negative)


def revealed(model: MDP) -> MDP:
    """Return a model whose observations include its fully observed state factors."""
    return model if model.event_observations else model.revealed()


def _told(given: object) -> str:
    if isinstance(given, type):
        return f"the class {given.__name__}: give an instance of it"
    text = repr(given)
    return text if len(text) <= 60 else f"{text[:57]}..."
