"""Circles that a file itself shows: plain actions whose ends change the state on which they are decided."""

from __future__ import annotations

from itertools import islice, product
from typing import TYPE_CHECKING

from mdm.policies import StatePolicy

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from mdm.actors.abstraction.factors import StateFactor
    from mdm.actors.ensemble import Ensemble

__all__ = ["circles"]

_MOST = 256
"""Combinations of sensors' values that are tried."""


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
