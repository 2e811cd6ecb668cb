"""How a solution prints."""

from __future__ import annotations

import re

import mdm


def test_a_solution_prints_in_one_line():
    solution = mdm.solve(mdm.problems.tiger(), gap=0.5)
    assert re.fullmatch(
        r"Solution\(.*, sarsop, value \S+ to \S+, \d+ iterations in \S+ s, stopped: gap\)", repr(solution)
    )
    assert "Progress" not in repr(solution)
