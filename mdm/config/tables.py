"""Typed tables of the TOML file: options, see `mdm.options`, and the keys that a file alone has."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mdm.actors.options import BindingSettings, SafetySettings
from mdm.options import Options, Seconds

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


class PredicateTable(Options, frozen=True):
    """A predicate set by code, also by numbers, or one derived by ``formula``, or by ``set`` and ``reset``.

    Attributes:
        sensor: False for a predicate that no code sets: it has a formula, or is a latch.
        when: When it holds, of numbers that code sets: ``< 0.2 until > 0.3``; without ``until`` one comparison.
        formula: Of other predicates and events, in propositional logic; short form: the formula alone.
        held_for: Seconds that the formula has to hold before the predicate is true.
        max_age: Seconds after which a value that was not told again is unknown.
        set: A predicate or event that makes it true, and it stays so.
        reset: A predicate or event that makes it false again.
        initial: Its value until it is told; by default it is unknown.
    """

    sensor: bool = True
    when: str | None = None
    formula: str | None = None
    held_for: Seconds | None = None
    max_age: Seconds | None = None
    set: str | None = None
    reset: str | None = None
    initial: bool | None = None


class EventTable(Options, frozen=True):
    """An event raised by code, or one that occurs when ``formula`` becomes true.

    Attributes:
        formula: Of predicates; short form: the formula alone.
    """

    formula: str | None = None


class StateTable(Options, frozen=True):
    """A state factor; short form: its predicates as a list or mapping."""

    predicates: list[str] | dict[str, str]
    on_violation: Literal["first", "hold", "error"] | None = None
    owner: str | None = None


class ObservationTable(Options, frozen=True):
    """An observation factor; short form: its events as a list or mapping."""

    events: list[str] | dict[str, str]
    idle: str | None = None
    hold: bool = False
    owner: str | None = None


class ActionTable(BindingSettings, frozen=True):
    """The binding of an action to a function (``call``), another ensemble, or a ``way`` or ``place`` of the map.

    Attributes:
        call: The function, ``module:name``, or ``module:object.name`` for a method; short form: the function alone.
        ensemble: Another ensemble of the file, which the action starts and its end stops.
        way: The label of a way, gone from the place where the robot is.
        place: The place to go to.
        navigate: Whether the function drives to places as well: it takes an argument ``navigate``.
        group: Of functions of the same group the next begins before the running one is cancelled.
    """

    call: str | None = None
    ensemble: str | None = None
    way: str | None = None
    place: str | None = None
    navigate: bool | None = None
    group: str | None = None


class RestartTable(Options, frozen=True):
    """Supervision by restart.

    Attributes:
        restart: How often, at most, within the time.
    """

    restart: Annotated[int, Meta(ge=0)]
    within: Seconds | None = None
    backoff: Annotated[float, Meta(ge=0, le=1e9, extra={"unit": "seconds"})] | None = None


class SearchTable(Options, frozen=True):
    """A tree search with the ensemble's policy as fallback and, with ``plans``, its vectors as lower bounds."""

    seconds: Seconds | None = None
    expansions: Annotated[int, Meta(gt=0)] | None = None
    particles: Annotated[int, Meta(gt=0)] | None = None
    plans: bool = False


class EnsembleTable(SafetySettings, frozen=True, kw_only=True):
    """An ensemble; nested tables are converted separately, so that their problems are reported with their keys.

    Attributes:
        policy: A file, a list with the index of an action for each state, or ``module:name`` for one of your own.
        actions: What each action is bound to, by name or by index.
        model: A file; needed by policies over beliefs; gives names and rewards.
        discount: Replaces the model's, above 0 and at most 1.
        durations: A file that says how long actions take in the model that the policy is for, of `save_durations`.
        policy_kind: The kind of a matrix in the policy's file; by default told by content and model.
        rewards: A file with R(s, a), where there is no model.
        initial_belief: A probability for each state, or the name of the state that is certain.
        tracker: ``module:name``, which makes an information state of your own.
        agents: In a team's file, the agents that have this ensemble; by default all.
        placement: In a team's file, where its layers are.
        search: A tree search that decides, with the policy as its fallback.
        drift: The odds at which a row of the model that decisions contradict is a fault `drift`, such as 1000: of so
            many robots whose model is right, one ever reports anything. By default nothing is watched.
        states: The factors of the state.
        observations: The factors of the observation.
    """

    policy: str | list[int]
    actions: dict[str, Any]
    model: str | None = None
    discount: float | None = None
    durations: str | None = None
    policy_kind: Literal["table", "stochastic", "q"] | None = None
    rewards: str | None = None
    initial_belief: list[float] | str | None = None
    tracker: str | None = None
    drive: str | float | None = None
    false_negative: str | int | None = None
    agent: int | str | None = None
    agents: list[str] | None = None
    placement: Any = None
    local: bool = False
    safe_action: str | None = None
    supervision: Any = "escalate"
    search: Any = None
    drift: Annotated[float, Meta(gt=1)] | None = None
    states: dict[str, Any] = msgspec.field(default_factory=dict)
    observations: dict[str, Any] = msgspec.field(default_factory=dict)
