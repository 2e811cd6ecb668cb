"""The tables of the file, typed; a misspelt key is an error."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

__all__ = [
    "ActionTable",
    "EnsembleTable",
    "EventTable",
    "ObservationTable",
    "PredicateTable",
    "RestartTable",
    "SearchTable",
    "StateTable",
]


Seconds = Annotated[float, Meta(gt=0, le=1e9)]


class _Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A TOML table: a misspelt key is an error."""


class PredicateTable(_Table, frozen=True):
    """A predicate that code sets, or, with ``formula``, ``set`` or ``reset``, one that is derived."""

    sensor: bool = True
    formula: str | None = None
    held_for: Seconds | None = None
    max_age: Seconds | None = None
    set: str | None = None
    reset: str | None = None
    initial: bool | None = None


class EventTable(_Table, frozen=True):
    """An event that code raises, or, with ``formula``, one that rises with it."""

    formula: str | None = None


class StateTable(_Table, frozen=True):
    """A state factor; a list or a mapping alone stands for its predicates."""

    predicates: list[str] | dict[str, str]
    on_violation: Literal["first", "hold", "error"] | None = None


class ObservationTable(_Table, frozen=True):
    """An observation factor; a list or a mapping alone stands for its events."""

    events: list[str] | dict[str, str]
    idle: str | None = None
    hold: bool = False


class ActionTable(_Table, frozen=True):
    """What an action is bound to: a function (``call``) or another ensemble of the file."""

    call: str | None = None
    ensemble: str | None = None
    timeout: Seconds | None = None
    grace: Seconds = 5.0
    on_repeat: Literal["continue", "restart"] = "continue"
    resume: bool = False
    concurrent: bool = False


class RestartTable(_Table, frozen=True):
    """Supervision by restart."""

    restart: Annotated[int, Meta(ge=0)]
    within: Seconds = 60.0
    backoff: Annotated[float, Meta(ge=0, le=1e9)] = 0.1


class SearchTable(_Table, frozen=True):
    """A tree search, to which the ensemble's policy is the fallback; with ``plans`` its vectors are bounds, too."""

    seconds: Seconds | None = None
    expansions: Annotated[int, Meta(gt=0)] | None = None
    particles: Annotated[int, Meta(gt=0)] = 1000
    plans: bool = False


class EnsembleTable(_Table, frozen=True):
    """An ensemble; the tables in it are converted by themselves, so that what is wrong in one is told with its key."""

    policy: str | list[int]
    actions: dict[str, Any]
    model: str | None = None
    discount: float | None = None
    policy_kind: Literal["table", "stochastic", "q"] | None = None
    seed: Annotated[int, Meta(ge=0)] | None = None
    rewards: str | None = None
    initial_belief: list[float] | None = None
    drive: str | float = "event"
    horizon: int | None = None
    on_impossible: Literal["predict", "keep", "reset", "safe_action"] = "predict"
    on_no_observation: str = "predict"
    false_negative: str | int | None = None
    deadline: Seconds | None = None
    agent: int | str = 0
    local: bool = False
    safe_action: str | None = None
    safe_timeout: Seconds = 10.0
    on_failed_action: Literal["safe", "continue"] | None = None
    on_lost_input: Literal["safe", "continue"] | None = None
    on_unknown: Literal["safe", "continue"] | None = None
    after_safe: Literal["reset", "keep"] = "reset"
    supervision: Any = "escalate"
    search: Any = None
    states: dict[str, Any] = {}
    observations: dict[str, Any] = {}
