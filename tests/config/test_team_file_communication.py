"""Communication policies by their names in a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from mdm import ConfigError
from mdm.config.functions import Functions
from mdm.config.tables import Problems
from mdm.config.team_file import read_communication
from mdm.team import Always, Budget, Never, OnChange


def read(given, folder="."):
    problems = Problems(Path("team.toml"))
    policy = read_communication(given, Functions(Path(folder), problems, callbacks=True), problems)
    problems.raise_all()
    return policy


def test_each_has_a_name(tmp_path, monkeypatch):
    assert read(None) is None
    for name, kind in (("always", Always), ("never", Never), ("on_change", OnChange)):
        assert type(read(name)) is kind
    budget = read({"policy": "budget", "messages_per_second": 2.0, "of": "on_change"})
    assert (type(budget), type(budget.of)) == (Budget, OnChange)
    (tmp_path / "talking_code.py").write_text("from mdm.team import Never\ndef make():\n    return Never()\n")
    import sys

    monkeypatch.setattr(sys, "path", list(sys.path))
    assert type(read("talking_code:make", tmp_path)) is Never


@pytest.mark.parametrize(("rate", "burst"), [(2.0, 1), (0.25, 3)])
def test_a_budget_has_the_rate_and_the_burst_of_the_file(rate, burst):
    bucket = read({"policy": "budget", "messages_per_second": rate, "burst": burst}).bucket
    assert [bucket.take(0.0) for _ in range(burst + 1)] == [True] * burst + [False]
    assert (bucket.take(0.99 / rate), bucket.take(1.01 / rate)) == (False, True)


@pytest.mark.parametrize("threshold", [0.5, 0.0625])
def test_what_communication_is_worth_is_held_against_the_threshold_of_the_file(threshold):
    assert read({"policy": "value_of_communication", "threshold": threshold}).threshold == threshold


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("alway", "did you mean 'always'"),
        ("budget", "the communication policy 'budget' needs 'messages_per_second'"),
        ({"policy": "never", "threshold": 1.0}, "the communication policy 'never' has no key 'threshold'"),
        ({"policy": "value_of_communication", "threshold": -1.0}, "threshold"),
        ({"polic": "never"}, "did you mean 'policy'"),
        (7, "was expected, not 7"),
        ("os:kill", "'os:kill' makes no communication policy: TypeError"),
        ("nowhere:make", "there is no module 'nowhere'"),
    ],
)
def test_what_is_none_is_told_with_its_key(given, words):
    with pytest.raises(ConfigError) as caught:
        read(given)
    assert words in str(caught.value)
    assert all(problem.key.startswith("team.communication") for problem in caught.value.problems)
