"""Spells of judgements, against a judgement of all that has happened at each time."""

from __future__ import annotations

import random
from typing import NamedTuple

import numpy as np
import pytest

from mdm.messages import ActionLife, Decision, Mode
from mdm.snapshots.judgement import Ended, Seen, lasts_long, unmoved
from mdm.snapshots.reducer import EnsembleReducer, Known

SECOND = 1_000_000_000
RULES = {"repeats", "hangs", "unmoved"}


def happened(seed):
    """Return messages of a run of two minutes, of much that is wrong."""
    rng = random.Random(seed)
    messages, time, epoch, life, belief, living = [], 0, 0, 0, 0.5, {}
    messages.append(Mode(0, "robot", "deciding", 0))
    while time < 120 * SECOND:
        kind = rng.choice(["burst", "observe", "begin", "end", "mode", "wait"])
        if kind == "burst":
            action = rng.choice("ab")
            for _ in range(rng.randint(5, 30)):
                time += rng.randint(0, 800_000_000)
                cause = "again" if rng.random() < 0.9 else "tick"
                messages.append(Decision(time, "robot", epoch, cause, None, None, None, 0, action, None))
                epoch += 1
        elif kind == "observe":
            moves = rng.random() < 0.3
            for _ in range(rng.randint(5, 60)):
                time += rng.randint(0, 900_000_000)
                belief = rng.random() if moves else belief
                symbol = rng.randint(0, 1)
                state = np.array([belief, 1 - belief])
                messages.append(Decision(time, "robot", epoch, "observation", None, symbol, state, 0, "c", None))
                epoch += 1
        elif kind == "begin":
            life += 1
            living[life] = rng.choice("abcd")
            messages.append(ActionLife(time, "robot", life, living[life], "running"))
            time += 1  # one that takes no time is a plain function's, which lasts for none
        elif kind == "end" and living:
            number = rng.choice(list(living))
            messages.append(
                ActionLife(time, "robot", number, living.pop(number), rng.choice(["succeeded", "succeeded", "failed"]))
            )
        elif kind == "mode" and rng.random() < 0.3:
            messages.append(Mode(time, "robot", rng.choice(["deciding", "safe"]), time))
            time += rng.randint(0, SECOND)
            messages.append(Mode(time, "robot", "deciding", time))
        else:
            time += rng.randint(0, 15 * SECOND)
    return messages


def judged(messages, time):
    """Return the rules that name something at a time, and what of, by all messages until then."""
    past = [each for each in messages if each.time <= time]
    if [each for each in past if isinstance(each, Mode)][-1].mode != "deciding":
        return set()
    decisions = [each for each in past if isinstance(each, Decision)]
    found = set()
    if decisions:
        name = decisions[-1].action_name
        lately = [each for each in decisions if each.time > time - 5 * SECOND and each.cause == "again"]
        if sum(each.action_name == name for each in lately) >= 10:
            found.add(("repeats", name))
    begun, ended = {}, []
    for each in past:
        if isinstance(each, ActionLife) and each.status == "running":
            begun[each.life] = each
        elif isinstance(each, ActionLife):
            ended.append(Ended(each.action, (each.time - begun.pop(each.life).time) / 1e9, each.status))
    for each in begun.values():
        if each.action != "d" and time - each.time >= 1e9 * lasts_long(each.action, ended[-200:])[0]:
            found.add(("hangs", each.action))
    observed = [each for each in decisions if each.belief is not None][-40:]
    seen = [
        Seen(each.time / 1e9, each.observation, int(np.argmax(each.belief)), float(max(each.belief)))
        for each in observed
    ]
    if seen and time - observed[-1].time < 5 * SECOND and unmoved(seen, str, str):
        found.add(("unmoved", ""))
    return found


class Spell(NamedTuple):
    begin: int
    end: int
    rule: str
    of: str
    text: str


def spells(messages, end, gap=0):
    """Return the spells over which one of these rules names something."""
    told = []
    known = Known(None, str, composed=frozenset({"d"}))
    reducer = EnsembleReducer("robot", lambda _, each: told.append(each), known)
    reducer.judge.gap = gap
    for each in messages:
        reducer.add(each)
    reducer.judge.finish(end)
    begins = {each.number: each for each in told if each.status == "begins"}
    over = {each.number: each.time for each in told if each.status == "over"}
    assert list(begins) == list(range(1, len(begins) + 1))
    assert over.keys() <= begins.keys()
    spells = [Spell(each.time, over.get(number, end + 1), *each[3:]) for number, each in begins.items()]
    return [each for each in spells if each.rule in RULES]


@pytest.mark.parametrize("seed", range(12))
def test_something_is_in_a_spell_whenever_it_is_named_and_at_no_other_time(seed):
    messages = happened(seed)
    end = messages[-1].time
    found = spells(messages, end)
    assert all(each.begin < each.end and each.text for each in found)
    rng = random.Random(seed)
    edges = {time for each in found for time in (each.begin - 1, each.begin, each.end - 1, each.end)}
    times = [rng.randint(0, end) for _ in range(150)] + [each for each in edges if 0 <= each <= end]
    for time in times:
        within = {(each.rule, each.of) for each in found if each.begin <= time < each.end}
        assert within == judged(messages, time), time


def test_each_of_these_rules_names_something():
    rules = set()
    for seed in range(12):
        messages = happened(seed)
        rules |= {each.rule for each in spells(messages, messages[-1].time)}
    assert rules == RULES


def test_of_an_ensemble_of_which_only_the_name_is_known_nothing_is_named():
    assert spells([], 10 * SECOND) == []


def burst(begin, action):
    """Return ten decisions that repeat an action, and one for another action."""
    decisions = [
        Decision(begin + step, "robot", step, "again", None, None, None, 0, action, None) for step in range(10)
    ]
    return [*decisions, Decision(begin + 10, "robot", 10, "tick", None, None, None, 0, "z", None)]


def test_a_short_break_ends_no_spell_but_that_of_another_rule_or_action():
    def bursts(second, gap):
        messages = [Mode(0, "robot", "deciding", 0), *burst(0, "a"), *burst(20, second)]
        return [each[:4] for each in spells(messages, 40, gap)]

    assert bursts("a", 10) == [(9, 30, "repeats", "a")]
    assert bursts("a", 9) == [(9, 10, "repeats", "a"), (20, 30, "repeats", "a")]
    assert bursts("b", 20) == [(9, 10, "repeats", "a"), (29, 30, "repeats", "b")]


def test_a_tick_that_decides_a_repeated_action_once_more_is_in_a_spell_again():
    again = Decision(12, "robot", 11, "tick", None, None, None, 0, "a", None)
    messages = [Mode(0, "robot", "deciding", 0), *burst(0, "a"), again]
    assert [each[:4] for each in spells(messages, 40)] == [(9, 10, "repeats", "a"), (12, 41, "repeats", "a")]
