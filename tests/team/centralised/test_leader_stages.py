"""What a controller was asked for, and how far it is: each stage beside the flags that it stands for."""

from __future__ import annotations

from itertools import product

from mdm.team.agreement.proposals import STARTS
from mdm.team.centralised.leader import Asked

FLAGS = {
    (False, False): Asked.NOTHING,
    (False, True): Asked.VOID_START,
    (True, False): Asked.COMMAND,
    (True, True): Asked.START,
}
"""By whether a command was carried out, and whether a start was asked for."""


def test_each_stage_stands_for_one_combination_of_flags():
    reached = {Asked.NOTHING}
    for (flags, stage), command, void in product(FLAGS.items(), ["start", "resume", "stop", "reset"], [False, True]):
        after = (flags[0] or not void, flags[1] or command in STARTS)
        assert stage.after(command, void=void) is FLAGS[after]
        reached.add(FLAGS[after])
    assert reached == set(Asked)
