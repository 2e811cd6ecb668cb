"""The tables of the file, typed; a misspelt key is an error."""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = [
    "ActionTable",
    "EnsembleTable",
    "EventTable",
    "ObservationTable",
    "PredicateTable",
    "RestartTable",
    "StateTable",
]


class _Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A TOML table: a misspelt key is an error."""


class PredicateTable(_Table, frozen=True):
    """A predicate that code sets, or, with ``formula``, ``set`` or ``reset``, one that is derived."""

    sensor: bool = True
    formula: str | None = None
    held_for: float | None = None
    max_age: float | None = None
    set: str | None = None
    reset: str | None = None
    initial: bool | None = None


class EventTable(_Table, frozen=True):
    """An event that code raises, or, with ``formula``, one that rises with it."""

    formula: str | None = None


class StateTable(_Table, frozen=True):
    """A state factor."""

    predicates: list[str]
    on_violation: Literal["first", "hold", "error"] | None = None


class ObservationTable(_Table, frozen=True):
    """An observation factor."""

    events: list[str]
    idle: str | None = None
    hold: bool = False


class ActionTable(_Table, frozen=True):
    """What an action is bound to: a function (``call``) or another ensemble of the file."""

    call: str | None = None
    ensemble: str | None = None
    timeout: float | None = None
    grace: float = 1.0
    on_repeat: Literal["continue", "restart"] = "continue"
    resume: bool = False
    concurrent: bool = False


class RestartTable(_Table, frozen=True):
    """Supervision by restart."""

    restart: int
    within: float = 60.0
    backoff: float = 0.1


class EnsembleTable(_Table, frozen=True):
    """An ensemble."""

    policy: str | list[int]
    actions: dict[str, str | ActionTable]
    model: str | None = None
    discount: float | None = None
    policy_kind: Literal["table", "stochastic", "q"] | None = None
    seed: int | None = None
    rewards: str | None = None
    initial_belief: list[float] | None = None
    drive: Literal["event"] | float = "event"
    horizon: int | None = None
    on_impossible: Literal["predict", "keep", "reset", "safe_action"] = "predict"
    on_no_observation: str = "predict"
    deadline: float | None = None
    agent: int | str = 0
    safe_action: str | None = None
    supervision: Literal["stop", "escalate"] | RestartTable = "escalate"
    states: dict[str, list[str] | StateTable] = {}
    observations: dict[str, list[str] | ObservationTable] = {}
