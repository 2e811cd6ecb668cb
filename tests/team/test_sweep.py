"""Large spaces as rows of numbers: what is left out changes nothing that is found."""

from __future__ import annotations

import pytest
from team.copies import Violation
from team.search import Search
from team.spaces import Space
from team.test_planted import PLANTED

# To compile the sweep takes longer than all small spaces here: the default ring has the search of `test_search`.
pytestmark = [pytest.mark.slow, pytest.mark.compiled("rows")]


def sweep(*arguments, **options):
    """Return a sweep, whose module loads the compiler."""
    from team.sweep import Sweep

    return Sweep(*arguments, **options)


SMALL = {
    "crash and restart": Space(2, "majority", False, steps=1, crashes=1, restarts=1),
    "crash and restart, event-driven": Space(2, "majority", True, steps=1, crashes=1, restarts=1),
    "cut, loss and repetition": Space(2, "majority", False, steps=1, partitions=1, losses=1, duplicates=1),
    "cut, and both go on": Space(2, "continue", False, steps=1, partitions=1),
    "crash, and somebody is impatient": Space(2, "majority", False, steps=1, crashes=1, impatience=1),
    "three": Space(3, "majority", False, steps=0, losses=1),
    "commands": Space(2, "majority", False, steps=0, commands=2, settled=True),
    "a command and a cut": Space(2, "majority", False, steps=0, partitions=1, commands=1, settled=True),
    "commands and a crash": Space(2, "majority", False, steps=0, crashes=1, commands=2, settled=True),
}
LARGE = {
    "crash and restart, two steps": Space(2, "majority", False, crashes=1, restarts=1),
    "cut, loss and repetition, two steps": Space(2, "majority", False, partitions=1, losses=1, duplicates=1),
    "crash, and somebody is impatient, two steps": Space(2, "majority", False, crashes=1, impatience=1),
    "three, and a step": Space(3, "majority", False, steps=1),
    "commands and a cut": Space(2, "majority", False, steps=0, partitions=1, commands=2, settled=True),
}
SPACES = [
    *(pytest.param(space, id=name) for name, space in SMALL.items()),
    *(pytest.param(space, id=name, marks=pytest.mark.slow) for name, space in LARGE.items()),
]


def visited(search):
    """Return where agents stand, but for what they never read again, and what was applied, in all states."""
    assert search.run() > 150
    assert search.cut_off == 0
    again = sweep(search.space)
    for machine in search.machines.things:
        again.number(machine)
    return set(again.machines.numbers), {entry for entry, *_ in search.entries.numbers}, set(search.bases.numbers)


@pytest.mark.parametrize("space", SPACES)
def test_agents_come_to_the_same_with_fewer_states(space):
    assert visited(sweep(space)) == visited(Search(space))


@pytest.mark.parametrize("steps", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_as_many_states_are_visited_where_none_is_left_out(steps):
    space = Space(2, "majority", False, steps=steps, crashes=1, restarts=1)
    assert 1 + sweep(space, reduced=False).run() == Search(space).run() > sweep(space).run()


@pytest.mark.parametrize(("steps", "least"), [(0, 500), pytest.param(1, 100_000, marks=pytest.mark.slow)])
def test_three_agents_lose_one_or_a_message(steps, least):
    search = sweep(Space(3, "majority", False, steps=steps, crashes=1, losses=1, duplicates=1))
    assert search.run(settle_every=least // 100) > least
    assert search.cut_off == 0


CAUGHT = {
    "no fence": Space(3, "majority", False, steps=1, partitions=1),
    "out of order": Space(3, "majority", False, losses=1),
    "late components": Space(2, "majority", False, losses=1),
    "not asking": Space(2, "majority", False, crashes=1, restarts=1),
    "not listening": Space(3, "majority", False, crashes=1),
    "a joiner without log": Space(2, "majority", False, crashes=1, restarts=1),
    "no majority": Space(3, "majority", False, losses=1),
    "a term again": Space(2, "majority", True, crashes=1, restarts=1, losses=1),
}
"""Faults that are planted, and where they show."""


@pytest.mark.parametrize("fault", PLANTED)
def test_a_planted_fault_is_found(fault, monkeypatch):
    machine, ballot = PLANTED[fault]
    if ballot is not None:
        monkeypatch.setattr("mdm.team.agreement.agreement.Ballot", ballot)
    with pytest.raises(Violation):
        sweep(CAUGHT[fault], machine).run(settle_every=100, limit=1_000_000)
