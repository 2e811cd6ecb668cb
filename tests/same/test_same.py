"""What compares two commits sees where they differ."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest
from same import systems, teams
from same.__main__ import difference, main
from same.commands import plain


def test_the_first_difference_is_told():
    assert difference(["a", "b"], ["a", "b"]) == ""
    assert difference(["a", "b"], ["a", "c"]) == "at 1 of 2:\n    before b\n    after  c"
    assert difference(["a"], ["a", "b"]) == "at 1 of 1:\n    before None\n    after  b"


def test_a_folder_and_times_are_no_difference():
    assert plain("/tmp/x/a.vf took 1.25 s, 3 states", Path("/tmp/x")) == "FOLDER/a.vf took SOME s, 3 states"


@pytest.mark.parametrize("part", [systems, teams])
def test_seeds_do_much_and_each_its_own(part):
    first, second = part.seen(1, None), part.seen(2, None)
    assert len(first) > 50
    assert first != second
    assert first == part.seen(1, None)


def test_a_difference_is_printed_with_its_seed(monkeypatch, capsys):
    lines = iter([['[0, ["a"]]', '[1, ["a"]]'], ['[0, ["a"]]', '[1, ["b"]]']])

    class Side(nullcontext):
        def __init__(self):
            super().__init__(self)
            self.stdout = iter(next(lines))

        def wait(self):
            return 0

    monkeypatch.setattr("same.__main__.side", lambda *_: Side())
    assert main([".", ".", "--part", "teams", "--count", "2"]) == 1
    assert (
        "teams, seed 1, at 0 of 1:\n    before a\n    after  b\nteams: 2 compared, 1 differ" in capsys.readouterr().out
    )


@pytest.mark.slow
def test_a_tree_is_the_same_as_itself(capsys):
    pytest.importorskip("mcap")
    assert main([".", ".", "--count", "2"]) == 0
    assert "records: 2 compared, 0 differ" in capsys.readouterr().out
