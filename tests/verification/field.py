"""Decision processes of the field in fractions, from their published descriptions: for tests of verification.

A process begins in its first state. Each state has one or more choices, each with the probabilities of what follows.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from fractions import Fraction
from math import comb
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array

from mdm import problems
from mdm.models import MDP

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from random_processes import Rows

    Choice = list[tuple[Fraction, Any]]

HALF = Fraction(1, 2)


@dataclass
class Process:
    """A process, the states that are reached (x) and those that are avoided (y)."""

    rows: Rows
    reached: list[int]
    avoided: list[int]

    def model(self) -> MDP:
        """Return the model: its states are named ``x0``, ``y1``, ``o2``, and so on, by what they are."""
        size, count = len(self.rows), max(map(len, self.rows))
        kinds = {**dict.fromkeys(self.avoided, "y"), **dict.fromkeys(self.reached, "x")}
        transitions = []
        for action in range(count):
            its = [choices[action] if action < len(choices) else {0: 1} for choices in self.rows]
            entries = [(state, after, float(chance)) for state, row in enumerate(its) for after, chance in row.items()]
            places, to, chances = (np.array(part) for part in zip(*entries, strict=True))
            transitions.append(csr_array((chances, (places, to)), shape=(size, size)))
        return MDP(
            transitions,
            np.zeros((size, count)),
            discount=0.9,
            states=[f"{kinds.get(state, 'o')}{state}" for state in range(size)],
            actions=[f"a{action}" for action in range(count)],
            initial_belief=np.eye(1, size)[0],
            available=np.array([[action < len(choices) for action in range(count)] for choices in self.rows]),
        )


def explored(
    first: Any,
    moves: Callable[[Any], list[Choice]],
    reached: Callable[[Any], bool],
    avoided: Callable[[Any], bool] = lambda _: False,
) -> Process:
    """Return the process of all that follows a state; one without choices stays as it is."""
    number, waiting, rows = {first: 0}, [first], []
    for state in waiting:
        choices = []
        for choice in moves(state) or [[(Fraction(1), state)]]:
            chances: dict[int, Fraction] = {}
            for chance, after in choice:
                if chance:
                    if after not in number:
                        number[after] = len(number)
                        waiting.append(after)
                    chances[number[after]] = chances.get(number[after], Fraction(0)) + chance
            assert sum(chances.values()) == 1
            choices.append(chances)
        rows.append(choices)
    its = [number[state] for state in waiting if reached(state)]
    return Process(rows, its, [number[state] for state in waiting if avoided(state) and number[state] not in its])


def evenly(states: Iterable[Any]) -> Choice:
    """Return the choice after which each of some states is as probable."""
    its = list(states)
    return [(Fraction(1, len(its)), state) for state in its]


def replaced(values: tuple[Any, ...], place: int, value: Any) -> tuple[Any, ...]:
    """Return a tuple with another value at a place."""
    return (*values[:place], value, *values[place + 1 :])


# -- Chains ------------------------------------------------------------------------------------------------------------

COIN = {0: (1, 2), 1: (3, 4), 2: (5, 6), 3: (1, "1"), 4: ("2", "3"), 5: ("4", "5"), 6: (2, "6")}


def die() -> Process:
    """D. Knuth and A. Yao, The complexity of nonuniform random number generation, 1976: a die of fair coins."""
    return explored(0, lambda at: [evenly(COIN[at])] if at in COIN else [], lambda at: at == "6", lambda at: at == "1")


def herman() -> Process:
    """T. Herman, Probabilistic self-stabilization, 1990: seven processes in a ring, a token where neighbours agree."""
    size = 7

    def moves(bits):
        ways = [(0, 1) if bits[at] == bits[at - 1] else (bits[at - 1],) for at in range(size)]
        return [evenly(itertools.product(*ways))]

    def tokens(bits):
        return sum(bits[at] == bits[at - 1] for at in range(size))

    return explored((0,) * size, moves, lambda bits: tokens(bits) == 1, lambda bits: tokens(bits) == 5)


def leader() -> Process:
    """A. Itai and M. Rodeh, Symmetry breaking in distributed networks, 1990: three draw numbers until one is alone."""
    size, numbers = 3, 4

    def moves(state):
        drawn, passed = state
        if not drawn:
            return [evenly((each, 0) for each in itertools.product(range(numbers), repeat=size))]
        if passed < size:
            return [[(Fraction(1), (drawn, passed + 1))]]
        return [] if alone(drawn) else [[(Fraction(1), ((), 0))]]

    def alone(drawn):
        return any(drawn.count(each) == 1 for each in drawn)

    return explored(
        ((), 0), moves, lambda s: s[1] == size and alone(s[0]), lambda s: len(s[0]) == size and len(set(s[0])) == 1
    )


def crowds() -> Process:
    """M. Reiter and A. Rubin, Crowds: anonymity for web transactions, 1998; chain of V. Shmatikov, 2002."""
    good, bad, forward = 4, 1, Fraction(4, 5)

    def moves(state):
        runs, seen, sender = state
        if sender is None:
            return [[(Fraction(1), (runs - 1, seen, 0))]] if runs else []
        caught = seen + (sender == 0)
        on = Fraction(1, good + bad)
        choice = [(on * bad * forward, (runs, caught, None)), (1 - forward, (runs, seen, None))]
        return [[*choice, *((on * forward, (runs, seen, other)) for other in range(good))]]

    return explored((4, 0, None), moves, lambda s: s[1] == 2, lambda s: s[2] == good - 1 and s[0] == 0)


def retransmission() -> Process:
    """L. Helmink, M. Sellink and F. Vaandrager, Proof-checking a data link protocol, 1994: lost frames are sent again.

    The probabilities are those of P. D'Argenio, B. Jeannet, H. Jensen and K. Larsen, 2001.
    """
    chunks, retries, lost, unheard = 16, 3, Fraction(2, 100), Fraction(1, 100)

    def moves(state):
        chunk, tries, phase = state
        if phase == "given up" or chunk == chunks:
            return []
        again = (chunk, tries + 1, "sends") if tries < retries else (chunk, tries, "given up")
        if phase == "sends":
            return [[(lost, again), (1 - lost, (chunk, tries, "answers"))]]
        return [[(unheard, again), (1 - unheard, (chunk + 1, 0, "sends"))]]

    return explored((0, 0, "sends"), moves, lambda s: s[2] == "given up", lambda s: s[:2] == (9, 1))


def nand() -> Process:
    """J. von Neumann, Probabilistic logics, 1956: bundles of lines through stages of gates that fail."""
    lines, stages, fails = 10, 6, Fraction(1, 50)

    def moves(state):
        stage, lit = state
        if stage == stages:
            return []
        both = Fraction(lit, lines) ** 2
        one = fails * both + (1 - fails) * (1 - both)
        odds = [comb(lines, each) * one**each * (1 - one) ** (lines - each) for each in range(lines + 1)]
        return [[(chance, (stage + 1, each)) for each, chance in enumerate(odds)]]

    return explored((0, 9), moves, lambda s: s[0] == stages and s[1] < 3, lambda s: s == (3, 5))


# -- Decisions ---------------------------------------------------------------------------------------------------------


def two_dice() -> Process:
    """Two such dice, whose coins are thrown in any order."""

    def moves(pair):
        return [
            evenly(replaced(pair, place, after) for after in COIN[pair[place]])
            for place in range(2)
            if pair[place] in COIN
        ]

    def thrown(pair):
        return sorted(map(str, pair)) if not set(pair) & set(COIN) else None

    return explored(
        (0, 0), moves, lambda pair: thrown(pair) in (["1", "6"], ["2", "5"], ["3", "4"]), lambda pair: pair[0] == "1"
    )


def gambler() -> Process:
    """R. Sutton and A. Barto, Reinforcement learning, 2018, example 4.3: stakes on a coin until 40 are won."""
    goal, wins = 40, Fraction(2, 5)

    def moves(held):
        return [
            [(wins, held + stake), (1 - wins, held - stake)]
            for stake in range(1, min(held, goal - held) + 1)
            if held < goal
        ]

    return explored(13, moves, lambda held: held == goal, lambda held: held in {20, 24})


def consensus() -> Process:
    """J. Aspnes and M. Herlihy, Fast randomized consensus using shared memory, 1990: two processes share a coin."""
    agents, far = 2, 2
    top = 2 * (far + 1) * agents

    def moves(state):
        count, does, coins = state
        choices = []
        for who in range(agents):
            if does[who] == "flip":
                choice = evenly((count, replaced(does, who, "write"), replaced(coins, who, coin)) for coin in (0, 1))
            elif does[who] == "write":
                on = min(max(count + (1 if coins[who] else -1), 0), top)
                choice = [(Fraction(1), (on, replaced(does, who, "check"), replaced(coins, who, 0)))]
            elif does[who] == "check":
                ends = count <= agents or count >= top - agents
                known = int(count >= top - agents)
                next_ = replaced(does, who, "done" if ends else "flip")
                choice = [(Fraction(1), (count, next_, replaced(coins, who, known)))]
            else:
                continue
            choices.append(choice)
        return choices

    def done(state):
        return set(state[1]) == {"done"}

    first = (top // 2, ("flip",) * agents, (0,) * agents)
    return explored(first, moves, lambda s: done(s) and all(s[2]), lambda s: s[0] == 4)


def zeroconf() -> Process:
    """H. Bohnenkamp and others, Cost-optimization of the Zeroconf protocol, 2003; the number of probes is chosen."""
    taken, lost = Fraction(1, 4), Fraction(1, 10)

    def moves(state):
        if state == "new":
            return [[(taken, (probes, probes)), (1 - taken, ("free", probes))] for probes in range(1, 5)]
        if state in ("wrong", "right"):
            return []
        kind, left = state
        if kind == "free":
            return [[(Fraction(1), ("free", left - 1) if left > 1 else "right")]]
        return [[(lost, (kind, left - 1) if left > 1 else "wrong"), (1 - lost, "new")]]

    return explored("new", moves, lambda s: s == "wrong", lambda s: s == (3, 1))


def tokens() -> Process:
    """A. Israeli and M. Jalfon, Token management schemes and random walks, 1990: six processes in a ring."""
    size = 6

    def moves(held):
        if len(held) == 1:
            return []
        return [evenly((held - {who}) | {(who + way) % size} for way in (-1, 1)) for who in sorted(held)]

    return explored(frozenset(range(size)), moves, lambda held: held == {0}, lambda held: held in ({1, 2}, {3, 5}))


def philosophers() -> Process:
    """D. Lehmann and M. Rabin, On the advantages of free choice, 1981: three who eat, in any order."""
    size = 3

    def holds(state, fork):
        left, right = state[fork], state[fork - 1]
        return left in ("has left", "eats") or right in ("has right", "eats")

    def moves(state):
        choices = []
        for who in range(size):
            forks = {"left": who, "right": (who + 1) % size}
            at = state[who]
            if at == "thinks":
                after = evenly(("wants left", "wants right"))
            elif at.startswith("wants"):
                side = at.split()[1]
                after = [(Fraction(1), at if holds(state, forks[side]) else f"has {side}")]
            elif at.startswith("has"):
                side = "right" if at == "has left" else "left"
                after = [(Fraction(1), "thinks" if holds(state, forks[side]) else "eats")]
            else:
                after = [(Fraction(1), "thinks")]
            choices.append([(chance, replaced(state, who, its)) for chance, its in after])
        return choices

    return explored(
        ("thinks",) * size, moves, lambda s: s[0] == "eats", lambda s: s[1] == "eats" and s[2] == "wants left"
    )


def contention() -> Process:
    """M. Stoelinga, Fun with FireWire, 2003: two nodes wait short or long by coins; delays are chosen."""

    def moves(state):
        if isinstance(state, str):
            return []
        one, two, rounds = state
        if one is None and two is None:
            return [evenly((each, None, rounds) for each in (0, 1)), evenly((None, each, rounds) for each in (0, 1))]
        if one is None or two is None:
            return [evenly((each if one is None else one, each if two is None else two, rounds) for each in (0, 1))]
        if one != two:
            return [[(Fraction(1), "first" if one else "second")]]
        again = (None, None, min(rounds + 1, 5))
        late = [(Fraction(1, 8), "first" if one else "second"), (Fraction(7, 8), again)]
        return [[(Fraction(1), again)], late]

    return explored((None, None, 0), moves, lambda s: s == "first", lambda s: not isinstance(s, str) and s[2] == 4)


def wireless() -> Process:
    """M. Kwiatkowska, G. Norman and J. Sproston, Model checking of IEEE 802.11, 2002: back-off by slots."""
    deepest, sending = 2, 3

    def drawn(depth):
        return [("waits", depth, slots) for slots in range(2 ** (depth + 1))]

    def moves(state):
        busy, *stations = state
        if all(each[0] == "sent" for each in stations):
            return []
        if busy:
            return [[(Fraction(1), (busy - 1, *stations))]]
        ready = [place for place, each in enumerate(stations) if each[0] == "waits" and each[2] == 0]
        fewer = [each if each[0] == "sent" else (*each[:2], max(each[2] - 1, 0)) for each in stations]
        if not ready:
            return [[(Fraction(1), (0, *fewer))]]
        choices = []
        for senders in itertools.chain.from_iterable(itertools.combinations(ready, many) for many in (1, 2)):
            if len(senders) == 1:
                choices.append([(Fraction(1), (sending, *replaced(tuple(stations), senders[0], ("sent", 0, 0))))])
            else:
                ways = [drawn(min(each[1] + 1, deepest)) for each in stations]
                choices.append(evenly((sending, *each) for each in itertools.product(*ways)))
        return choices

    def collided(state):
        return all(each[0] == "waits" and each[1] == deepest for each in state[1:])

    return explored(
        (0, ("waits", 0, 1), ("waits", 0, 1)),
        moves,
        lambda s: all(each[0] == "sent" for each in s[1:]),
        collided,
    )


def queue() -> Process:
    """M. Puterman, Markov decision processes, 1994, section 3.7: a queue of 20 whose server is slow or fast."""
    most, comes = 20, Fraction(3, 10)

    def moves(state):
        waiting, on = state
        rates = [Fraction(1, 5), Fraction(2, 5)] if on else [Fraction(0)]
        choices = []
        for rate in rates:
            odds = {
                (min(waiting + 1, most), on): comes * (1 - rate),
                (max(waiting - 1, 0), on): (1 - comes) * rate,
            }
            choices.append([*((chance, after) for after, chance in odds.items()), (1 - sum(odds.values()), state)])
        return [*choices, [(Fraction(1), (waiting, not on))]]

    return explored((3, True), moves, lambda s: s[0] == most, lambda s: s == (0, True))


def lake() -> Process:
    """Gymnasium's FrozenLake by its rules, on a map of its own: each step slips aside with 2/3."""
    side = 8
    holes = {(2, 3), (3, 5), (4, 3), (5, 1), (5, 2), (5, 6), (6, 4), (7, 0)}
    ways = [(0, -1), (1, 0), (0, 1), (-1, 0)]

    def moves(at):
        if at in holes or at == (7, 7):
            return []
        beside = [tuple(min(max(a + b, 0), side - 1) for a, b in zip(at, way, strict=True)) for way in ways]
        return [evenly([beside[way - 1], beside[way], beside[(way + 1) % 4]]) for way in range(4)]

    return explored((0, 0), moves, lambda at: at == (7, 7), lambda at: at in holes)


def racetrack() -> Process:
    """A. Barto, S. Bradtke and S. Singh, Learning to act using real-time dynamic programming, 1995: on a small bend."""
    track = {(x, y) for x in range(8) for y in range(8) if y < 3 or x > 4}
    fails = Fraction(1, 10)

    def moves(state):
        if not isinstance(state, tuple):
            return []
        place, speed = state
        choices = []
        for push in itertools.product((-1, 0, 1), repeat=2):
            odds = []
            for chance, by in ((1 - fails, push), (fails, (0, 0))):
                now = tuple(min(max(a + b, -2), 2) for a, b in zip(speed, by, strict=True))
                to = tuple(a + b for a, b in zip(place, now, strict=True))
                done = to[0] > 4 and to[1] >= 8
                odds.append((chance, "finish" if done else (to, now) if to in track else "off"))
            choices.append(odds)
        return choices

    return explored(((0, 1), (0, 0)), moves, lambda s: s == "finish", lambda s: s == "off")


def tyres() -> Process:
    """I. Little and S. Thiébaux, Planning vs replanning, 2007: spare tyres lie along two sides of a triangle."""
    size = 5

    def spare(at):
        return at[0] == 0 or at[0] + at[1] == size - 1

    def moves(state):
        at, flat, carries, taken = state
        choices = []
        if flat and carries:
            choices.append([(Fraction(1), (at, False, False, taken))])
        if not carries and spare(at) and not taken:
            choices.append([(Fraction(1), (at, flat, True, True))])
        if not flat and at != (size - 1, 0):
            ways = [to for to in ((at[0] + 1, at[1]), (at[0], at[1] + 1)) if sum(to) < size]
            choices += [evenly((to, now, carries, False) for now in (False, True)) for to in ways]
        return choices

    return explored(((0, 0), False, False, False), moves, lambda s: s[0] == (size - 1, 0), lambda s: s[1] and not s[2])


def island() -> Process:
    """W. Feller, An introduction to probability theory, 1968, XIV: a walk on 200 places, with a choice of the coin."""
    size = 200

    def moves(at):
        coins = (HALF, Fraction(9, 20))
        return [[(up, at + 1), (1 - up, at - 1)] for up in coins] if 0 < at < size else []

    return explored(70, moves, lambda at: at == size, lambda at: at == 90)


# -- Problems of the library -------------------------------------------------------------------------------------------


def problem(model: MDP) -> Process:
    """Return the process of a model, whose numbers are taken as the fractions that they stand for.

    What is reached is the last state that a search finds, what is avoided the one half way.
    """
    start = int(np.argmax(model.initial_belief))

    def moves(state):
        choices = []
        for action in range(len(model.action_space)):
            if model.available is None or model.available[state, action]:
                row = np.asarray(csr_array(model.transition_matrix(action))[[state]].todense())[0]
                after = np.flatnonzero(row).tolist()
                chances = {each: Fraction(row[each]).limit_denominator(10**9) for each in after}
                chances[max(chances, key=chances.get)] += 1 - sum(chances.values())
                choices.append([(chance, each) for each, chance in chances.items()])
        return choices

    process = explored(start, moves, lambda _: False)
    size = len(process.rows)
    return Process(process.rows, [size - 1], [size // 2] if size > 2 else [])


FIELD = {
    made.__name__: made
    for made in (
        die,
        herman,
        leader,
        crowds,
        retransmission,
        nand,
        two_dice,
        gambler,
        consensus,
        zeroconf,
        tokens,
        philosophers,
        contention,
        wireless,
        queue,
        lake,
        racetrack,
        tyres,
        island,
    )
} | {
    name: lambda name=name, options=options: problem(getattr(problems, name)(**options))
    for name, options in {
        "grid_world": {},
        "river_swim": {},
        "forest": {},
        "tiger": {},
        "load_unload": {},
        "hallway": {},
        "machine_maintenance": {},
        "rock_sample": {"size": 3, "rocks": 2},
        "grid_small": {},
        "box_pushing": {},
        "patrol": {},
    }.items()
}
"""What makes each process."""
