"""Probabilities, steps and shares of small decision processes by value iteration in fractions, apart from the library.

Values of reaching are iterated from below; policies are enumerated for expectations and shares, each chain by a dense
elimination in fractions.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction


def within(rows, target, before, most, pick):
    """Return the probability from state 0 of reaching the target within some steps, by enumeration of all steps."""
    values = [Fraction(state in target) for state in range(len(rows))]
    for _ in range(most):
        values = [
            Fraction(1)
            if state in target
            else Fraction(0)
            if state in before
            else pick(sum(chance * values[after] for after, chance in choice.items()) for choice in rows[state])
            for state in range(len(rows))
        ]
    return values[0]


def policies(rows):
    """Yield the chain of each policy that takes one action a state."""
    for chosen in itertools.product(*(range(len(choices)) for choices in rows)):
        yield [choices[action] for choices, action in zip(rows, chosen, strict=True)]


def closure(chain, start, stop=()):
    """Return the states that a chain reaches from one, without going on from some."""
    found, waiting = {start}, [start]
    while waiting:
        state = waiting.pop()
        if state not in stop:
            fresh = set(chain[state]) - found
            found |= fresh
            waiting += fresh
    return found


def eliminated(rows, right):
    """Return the solution of a linear system in fractions."""
    size = len(rows)
    rows = [[*row, value] for row, value in zip(rows, right, strict=True)]
    for place in range(size):
        pivot = next(at for at in range(place, size) if rows[at][place])
        rows[place], rows[pivot] = rows[pivot], rows[place]
        rows[place] = [value / rows[place][place] for value in rows[place]]
        for at in range(size):
            if at != place and rows[at][place]:
                rows[at] = [one - rows[at][place] * two for one, two in zip(rows[at], rows[place], strict=True)]
    return [row[-1] for row in rows]


def solved(chain, going, constant, known):
    """Return x = c + P x for the states that go on, with known values of others."""
    going = sorted(going)
    if not going:
        return {}
    rows = [[Fraction(int(one == two)) - chain[one].get(two, 0) for two in going] for one in going]
    right = [
        constant(one) + sum(chance * known.get(after, 0) for after, chance in chain[one].items() if after not in going)
        for one in going
    ]
    return dict(zip(going, eliminated(rows, right), strict=True))


def reaching(chain, target, before=()):
    """Return the probability that a chain reaches the target from state 0, before some other states."""
    before = set(before) - set(target)
    stop = set(target) | before
    can = {state for state in range(len(chain)) if closure(chain, state, stop) & set(target)} - before
    if 0 in target or 0 not in can:
        return Fraction(int(0 in target))
    return solved(chain, can - stop, lambda _: 0, dict.fromkeys(target, Fraction(1)))[0]


def steps(chain, target):
    """Return the expected steps of a chain until the target, from state 0."""
    if 0 in target:
        return Fraction(0)
    reached = closure(chain, 0, target)
    if not all(closure(chain, state, target) & set(target) for state in reached):
        return math.inf
    return solved(chain, reached - set(target), lambda _: 1, {})[0]


def share(chain, target):
    """Return the long-run share of a chain's steps in the target, from state 0."""
    total = Fraction(0)
    done = set()
    for state in closure(chain, 0):
        recurrent = frozenset(closure(chain, state))
        if state in done or any(closure(chain, other) != recurrent for other in recurrent):
            continue
        done |= recurrent
        its = sorted(recurrent)
        balance = [[chain[two].get(one, Fraction(0)) - int(one == two) for two in its] for one in its[1:]]
        weights = eliminated([[Fraction(1)] * len(its), *balance], [Fraction(1), *[Fraction(0)] * (len(its) - 1)])
        held = sum((weight for one, weight in zip(its, weights, strict=True) if one in target), Fraction(0))
        total += held * reaching(chain, recurrent)
    return total
