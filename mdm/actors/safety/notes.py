"""What an ensemble's declarations show before it runs: input that is missing, and ends that lead nowhere or round.

Nothing of it is an error: `mdm check` prints it.
"""

from __future__ import annotations

from itertools import islice, product
from typing import TYPE_CHECKING

from mdm.actors.abstraction.factors import combined
from mdm.actors.options import OnEvent
from mdm.actors.predicates.declarations import ACTION_END
from mdm.policies import StatePolicy

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from mdm.actors.abstraction.factors import StateFactor
    from mdm.actors.ensemble import Ensemble

_MOST = 256
"""Combinations of sensors' values that are tried."""


def notes(ensemble: Ensemble) -> Iterator[str]:
    """Yield allowed oddities: input that nothing here gives, or nothing takes; of this ensemble alone."""
    over_states = ensemble.controller.takes == "state"
    wanted, other = ("states", "observations") if over_states else ("observations", "states")
    given = {"states": ensemble.state, "observations": ensemble.observation}
    if given[wanted] is None:
        yield f"ensemble {ensemble.name!r} has no {wanted}: it waits for code that publishes what it decides on"
    if given[other] is not None:
        yield f"ensemble {ensemble.name!r} has {other}, but its policy decides on {wanted}"
    for kind, layer in (("state", ensemble.state), ("observation", ensemble.observation)):
        pairs = [] if layer is None else list(islice(combined(layer.factors, layer.space), 2))
        if layer is not None and pairs:
            names = ", ".join(factor.name for factor in layer.factors)
            (symbol, condition) = pairs[-1]
            yield (
                f"ensemble {ensemble.name!r}: the order of the {kind} factors {names} decides which is which, for the "
                f"model does not name them: {kind} {symbol!r} is {condition}"
            )
    if ensemble.action.safe is not None and (silent := _silent(ensemble)):
        yield (
            f"ensemble {ensemble.name!r} has a safe action, but nothing tells that {', '.join(sorted(silent))} "
            f"{'is' if len(silent) == 1 else 'are'} no longer sensed: give sensors a max_age"
        )
    for name, binding in zip(ensemble.action.names, ensemble.action.bindings, strict=True):
        if binding.note:
            yield f"ensemble {ensemble.name!r}: action {name!r} {binding.note}"
    yield from _unsaid(ensemble)
    yield from circles(ensemble)
    if not ensemble.bound:  # else a decision above ends its action, too
        yield from _endless(ensemble)
        yield from _dead_ends(ensemble)


def _silent(ensemble: Ensemble) -> set[str]:
    """Return the predicates that it decides on and that code sets, unless one of them becomes unknown by age."""
    declared = None if ensemble.predicates is None else ensemble.predicates.declared
    layer = ensemble.state if ensemble.controller.takes == "state" else ensemble.observation
    if declared is None or layer is None:
        return set()
    names = {name for factor in layer.factors for name in factor.sources if name is not None}
    sensed = {sensor for name in names for sensor in declared.inputs_of(name) if declared.senses(sensor)}
    return set() if sensed & declared.aged else sensed


def _unsaid(ensemble: Ensemble) -> Iterator[str]:
    """Yield which actions can end with nothing that decides afterwards, unless an input changes."""
    if not ensemble.decides_alone:
        return
    used = ensemble.inputs()
    pairs = [*zip(ensemble.action.names, ensemble.action.bindings, strict=True)]
    lasting = [(name, binding) for name, binding in pairs if binding.lasts and binding.ensemble is None]
    unsaid = [name for name, binding in lasting if binding.sequel.then is None]
    succeed = {name for name in unsaid if f"{name}.succeeded" not in used}
    retried = {name for name, binding in lasting if ensemble.liveness.retries or binding.retries}
    fail = {name for name in unsaid if name not in retried and f"{name}.failed" not in used}
    for which, word in ((succeed & fail, "ended"), (succeed - fail, "succeeded"), (fail - succeed, "failed")):
        if which:
            yield (
                f"ensemble {ensemble.name!r}: when {' or '.join(filter(which.__contains__, unsaid))} has {word}, "
                f'nothing decides afterwards unless an input changes: say then = "decide" or "wait" at the action'
            )


def _endless(ensemble: Ensemble) -> Iterator[str]:
    """Yield which actions end all deciding where they never end themselves; of an ensemble at the top."""
    if ensemble.predicates is None or not ensemble.decides_alone:
        return
    given = ensemble.given()
    if not given or not all(map(ACTION_END.fullmatch, given)):
        return  # another input may change its decision
    pairs = zip(ensemble.action.names, ensemble.action.bindings, strict=True)
    names = [name for name, binding in pairs if binding.lasts and binding.timeout is None]
    if names:
        yield (
            f"ensemble {ensemble.name!r} decides on the ends of its actions alone, so that one that never ends is "
            f"its last: give a timeout to {', '.join(names)}"
        )


def _dead_ends(ensemble: Ensemble) -> Iterator[str]:
    """Yield the safe modes that only a release ends: an input would, and only its own actions bring that about."""
    action, given, status = ensemble.action, ensemble.given(), ensemble.status()
    if action.safe is None or ensemble.shared or not given or not all(_is_own(ensemble, name) for name in given):
        return
    heeded = set() if ensemble.predicates is None else {*ensemble.predicates.declared.used, *given}
    found: dict[str, tuple[str, str]] = {}
    for name, binding in zip(action.names, action.bindings, strict=True):
        ends = ("failed",) if binding.timeout is None else ("failed", "timed_out")
        unheeded = binding.lasts and any(f"{name}.{end}" not in heeded for end in ends)
        if ensemble.safety.reacts_to_failures and unheeded and not binding.retries:
            found[f"actions.{name}"] = f"{name} has failed", 'say then = "decide" at the action'
        elif binding.sequel.attempts is not None and f"{name}.gave_up" not in heeded:
            found[f"actions.{name}"] = f"{name} is given up", f"use {name}.gave_up, or leave attempts out"
    if status.deadline is not None and isinstance(status.drive, OnEvent):
        found["deadline"] = "a decision was late", "decide at a fixed rate, or leave the deadline out"
    for key, (case, way_out) in found.items():
        yield (
            f"ensembles.{ensemble.name}.{key}: where {case}, nothing but a release leads out of the safe mode, for "
            f"only the ensemble's own actions change what it decides on ({', '.join(sorted(given))}): {way_out}"
        )


def _is_own(ensemble: Ensemble, name: str) -> bool:
    """Whether an input changes by actions here or below alone: it is the end of one, or the robot's place."""
    if ensemble.predicates is not None and ensemble.predicates.declared.moves(name):
        return True
    own = ACTION_END.fullmatch(name) is not None and name.rpartition(".")[0] in ensemble.action.names
    return own or any(_is_own(below, name) for below in ensemble.subensembles)


def circles(ensemble: Ensemble) -> Iterator[str]:
    """Yield the first circle of plain actions in which an ensemble would go round within one turn.

    Such an action ends as it is called. Where a latch heeds that end, the state may change, which has another action
    decided, and so on. What code sets within an action is not seen.
    """
    predicates, state, policy = ensemble.predicates, ensemble.state, ensemble.controller.policy
    chosen = policy.table if isinstance(policy, StatePolicy) else None
    if predicates is None or state is None or chosen is None:
        return
    used = state.inputs()
    ends = {name for name in used if name.endswith(".succeeded")}
    if not ends or not ensemble.decides_alone:
        return
    sensors = sorted(name for name in used if predicates.declared.senses(name))
    for values in islice(product((False, True), repeat=len(sensors)), _MOST):
        network = predicates.network()
        network.compile()
        network.update(tuple(zip(sensors, values, strict=True)))
        seen: list[tuple[int, str, tuple[bool | None, ...]]] = []
        while (index := _index(state.factors, known := network.values())) is not None:
            action = chosen[index]
            here = (index, ensemble.action.names[action], tuple(known.values()))
            if seen and index == seen[-1][0]:
                break  # nothing is decided where the state is as it was
            if here in seen:
                names = list(dict.fromkeys(name for _, name, _ in seen[seen.index(here) :]))
                yield (
                    f"ensemble {ensemble.name!r}: {' and '.join(names)} are plain functions, which succeed as they are "
                    f"called, and each end leads to the next: one turn without end. Have one take time (`async def`), "
                    f"or decide on what sensors see in place of {', '.join(sorted(ends))}"
                )
                return
            seen.append(here)
            if f"{here[1]}.succeeded" not in ends or not ensemble.action.bindings[action].plain:
                break
            network.update((), (f"{here[1]}.succeeded",))


def _index(factors: tuple[StateFactor, ...], values: Mapping[str, bool | None]) -> int | None:
    """Return the index of a state; None where a factor is not known, or is of no one value."""
    index = 0
    for factor in factors:
        known = [values.get(name) for name in factor.predicates]
        if None in known or (len(known) > 1 and known.count(True) != 1):
            return None
        digit = known.index(True) if len(known) > 1 else factor.positive if known[0] else 1 - factor.positive
        index = index * factor.size + digit
    return index
