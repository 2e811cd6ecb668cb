"""What may happen to a few agents that agree on steps: spaces that are searched, by name."""

from __future__ import annotations

from typing import NamedTuple


class Space(NamedTuple):
    """What may happen."""

    agents: int
    mode: str
    event_driven: bool
    steps: int = 2
    crashes: int = 0
    restarts: int = 0
    partitions: int = 0
    losses: int = 0
    duplicates: int = 0
    overtakings: int = 0
    impatience: int = 0  # how often somebody who is not the first calls, or a leader does not wait for all
    commands: int = 0  # how often somebody is asked to start or to stop
    settled: bool = False  # whether all have joined a term at the beginning
    keeps: bool = False  # whether a stop outlives the process of an agent


FAULTS = {"crashes": 1, "restarts": 1, "partitions": 1, "losses": 1, "duplicates": 1}
SPACES = {
    "two": Space(2, "majority", False, **FAULTS),
    "two-events": Space(2, "majority", True, **FAULTS),
    "two-continue": Space(2, "continue", False, **FAULTS, impatience=1),
    "two-continue-events": Space(2, "continue", True, **FAULTS, impatience=1),
    "three": Space(3, "majority", False),
    "three-events": Space(3, "majority", True),
    "three-crash": Space(3, "majority", False, crashes=1),
    "three-crash-lost": Space(3, "majority", False, crashes=1, losses=1, duplicates=1),
    "three-cut": Space(3, "majority", False, partitions=1),
    "three-lost": Space(3, "majority", False, losses=1, duplicates=1),
    "three-restart": Space(3, "majority", False, crashes=1, restarts=1),
    "one-step-crash-cut": Space(3, "majority", False, steps=1, crashes=1, partitions=1),
    "one-step-crash-cut-lost": Space(3, "majority", False, steps=1, crashes=1, partitions=1, losses=1, duplicates=1),
    "one-step-crash-lost": Space(3, "majority", False, steps=1, crashes=1, losses=1, duplicates=1),
    "one-step-cut": Space(3, "majority", False, steps=1, partitions=1),
    "one-step-cut-lost": Space(3, "majority", False, steps=1, partitions=1, losses=1, duplicates=1),
    "one-step-events": Space(3, "majority", True, steps=1),
    "one-step-lost": Space(3, "majority", False, steps=1, losses=1, duplicates=1),
    "one-step-restart": Space(3, "majority", False, steps=1, crashes=1, restarts=1),
    "commands-cut": Space(3, "majority", False, steps=0, partitions=1, commands=2, settled=True),
    "commands-crash": Space(3, "majority", False, steps=0, crashes=1, commands=2, settled=True),
    "commands-crash-cut": Space(3, "majority", False, steps=0, crashes=1, partitions=1, commands=2, settled=True),
    "three-commands-cut": Space(3, "majority", False, steps=0, partitions=1, commands=3, settled=True),
    "commands-continue": Space(2, "continue", False, steps=0, partitions=2, commands=3, settled=True),
    "commands-two": Space(2, "majority", False, steps=0, crashes=1, restarts=1, partitions=1, losses=1, commands=3),
    "commands-kept": Space(2, "majority", False, steps=0, crashes=1, restarts=1, commands=3, settled=True, keeps=True),
    "commands-kept-continue": Space(
        *(2, "continue", False), steps=0, crashes=2, restarts=2, partitions=1, commands=2, settled=True, keeps=True
    ),
    "commands-kept-all": Space(
        *(2, "majority", False), steps=0, crashes=2, restarts=2, commands=3, settled=True, keeps=True
    ),
    "one-step-restart-lost": Space(3, "majority", False, steps=1, crashes=1, restarts=1, losses=1, duplicates=1),
}
"""What is searched by name."""
