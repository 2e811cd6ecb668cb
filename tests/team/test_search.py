"""Small spaces, searched whole; ``python -m team.search``, with ``tests`` in ``PYTHONPATH``, searches large ones."""

from __future__ import annotations

import pytest
from sentences import refused
from team.copies import Violation
from team.search import Search
from team.spaces import Space
from team.test_planted import COMMANDS, SameTerm, WithoutLog, WithoutMajority

SPACES = {
    "crash and restart": Space(2, "majority", False, crashes=1, restarts=1),
    "crash and restart, event-driven": Space(2, "majority", True, crashes=1, restarts=1),
    "cut and loss": Space(2, "majority", False, partitions=1, losses=1),
    "loss, repetition and overtaking": Space(2, "majority", False, losses=1, duplicates=1, overtakings=1),
    "cut, and both go on": Space(2, "continue", False, partitions=1),
    "crash, and the other goes on": Space(2, "continue", True, crashes=1),
    "three": Space(3, "majority", False, steps=1),
    "commands and a cut": Space(2, "majority", False, steps=0, partitions=1, commands=2, settled=True),
    "commands and a cut, and both go on": Space(2, "continue", False, steps=0, partitions=1, commands=2, settled=True),
    "commands, crash and restart": Space(
        2, "majority", False, steps=0, crashes=1, restarts=1, commands=2, settled=True
    ),
    "commands, crash and restart, kept": Space(
        2, "majority", False, steps=0, crashes=1, restarts=1, commands=2, settled=True, keeps=True
    ),
    "commands, crash and restart, kept, and the other goes on": Space(
        2, "continue", False, steps=0, crashes=1, restarts=1, commands=2, settled=True, keeps=True
    ),
    "commands of three": Space(3, "majority", False, steps=0, commands=2, settled=True),
}
LARGE = [pytest.param(space, 5_000, id=name, marks=pytest.mark.slow) for name, space in SPACES.items()]


def one_less(space):
    """Return the space with a step less, or a command less."""
    return space._replace(steps=space.steps - 1) if space.steps else space._replace(commands=space.commands - 1)


SMALL = [
    *(pytest.param(one_less(space), 300, id=f"{name}, one less") for name, space in SPACES.items()),
    pytest.param(Space(2, "majority", False, steps=0, commands=2, settled=True), 700, id="commands of two"),
]


@pytest.mark.parametrize(("space", "least"), [*SMALL, *LARGE])
def test_no_state_violates_what_is_promised(space, least):
    search = Search(space)
    assert search.run(settle_every=10) > least
    assert search.cut_off == 0


@pytest.mark.parametrize("machine", [SameTerm, WithoutLog, WithoutMajority])
def test_a_planted_fault_is_found(machine):
    with pytest.raises(Violation):
        Search(Space(2, "majority", True, crashes=1, restarts=1, losses=1), machine).run(settle_every=10)


@pytest.mark.parametrize("agents", [2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("fault", COMMANDS)
def test_a_planted_fault_of_commands_is_found(fault, agents, monkeypatch):
    for place, planted in COMMANDS[fault].items():
        monkeypatch.setattr(f"mdm.team.agreement.{place}", planted)
    with refused(Violation):
        Search(Space(agents, "majority", False, steps=0, partitions=1, commands=2, settled=True)).run(limit=500_000)
