"""What a monitor costs: one valuation, of 1 to 8 predicates, and an update of a network with one.

A valuation is measured against a plain formula over the same predicates, compiled as networks have it; the update
against that of a network with a latch in the monitor's place. Rounds take turns; medians are of processor time.
"""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING, Any

from measurement import arguments, report, table

from mdm.logic import Monitor, Network, parse
from mdm.logic.formula import compile_formula

if TYPE_CHECKING:
    from collections.abc import Callable

FORMULAS = {
    1: ("G(a)", "a"),
    2: ("G(not a) and F(b)", "not a and b"),
    4: ("G(a implies F(b)) and (not c U d)", "(a implies b) and (not c or d)"),
    8: (
        "G(a implies F(b)) and (not c U d) and G(e or f or X(g U h))",
        "(a implies b) and (not c or d) and (e or f or g or h)",
    ),
}
"""By the number of predicates, a formula in time and a plain one."""


def networks() -> dict[str, Callable[[list[int]], object]]:
    """Return updates of one sensor in a network with a monitor, and in one with a latch."""
    found: dict[str, Callable[[list[int]], object]] = {}
    for name in ("monitor", "latch"):
        network = Network()
        network.add_input("a", False)
        network.add_input("b", False)
        if name == "monitor":
            network.monitor("watched", "G(a implies F(b))")
        else:
            network.latch("watched", set="a and not b", reset="b")
        network.compile()

        def update(values: list[int], network: Network = network) -> object:
            return network.update((("a", values[0] == 2),))

        found[name] = update
    return found


def seconds(step: Callable[[list[int]], object], valuations: list[list[int]], count: int) -> float:
    """Return the processor seconds of one step, over valuations in turn."""
    rounds = count // len(valuations)
    began = time.process_time()
    for _ in range(rounds):
        for values in valuations:
            step(values)
    return (time.process_time() - began) / (rounds * len(valuations))


def measure(count: int, rounds: int) -> list[dict[str, Any]]:
    """Return a row for each number of predicates, and one for the update of a network."""
    cases: dict[str, tuple[Callable[[list[int]], object], Callable[[list[int]], object], list[list[int]]]] = {}
    for size, (in_time, plain) in FORMULAS.items():
        index = {name: place for place, name in enumerate("abcdefgh"[:size])}
        valuations = [[2 * (number >> place & 1) for place in range(size)] for number in range(1 << size)]
        step = Monitor(in_time).compiled(index)
        cases[f"a valuation of {size}"] = step, compile_formula(parse(plain), index), valuations
    both = networks()
    cases["an update of a network"] = both["monitor"], both["latch"], [[0], [2]]
    rows = []
    for name, (step, base, valuations) in cases.items():
        pairs = [(seconds(step, valuations, count), seconds(base, valuations, count)) for _ in range(rounds)]
        ours, theirs = (statistics.median(each) for each in zip(*pairs, strict=True))
        rows.append({"step": name, "monitor_us": ours * 1e6, "plain_us": theirs * 1e6, "times plain": ours / theirs})
    return rows


def main() -> None:
    """Measure; print and write."""
    given = arguments(__doc__ or "")
    rows = measure(2_000, 2) if given.quick else measure(200_000, 9)
    table("Monitors", rows)
    report("monitors", {"monitors": rows}, given.output)


if __name__ == "__main__":
    main()
