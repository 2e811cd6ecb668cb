"""Lines of stimuli: what they mean, their times, and where reading ends."""

from __future__ import annotations

import io

import pytest

from mdm import load_system
from mdm.cli.robots.trace import read_stimuli

ROBOTS = """
[predicates]
Fire = {}
Clear = "not Fire"
[events]
Smoke = {}
[ensembles.first]
policy = [0, 1]
states.fire = ["Fire"]
[ensembles.first.actions]
Wait = "robots:wait"
Go = "robots:go"
[ensembles.second]
policy = [0, 1]
[ensembles.second.actions]
Wait = "robots:wait"
Go = "robots:go"
"""


@pytest.fixture
def system(tmp_path):
    (tmp_path / "robots.toml").write_text(ROBOTS)
    return load_system(tmp_path / "robots.toml", callbacks=False)


def read(system, *lines):
    return read_stimuli(io.BytesIO("\n".join(lines).encode()), system)


def test_times_are_nanoseconds_and_stay_where_none_is_given(system):
    stimuli, wrong = read(system, '{"state": 0}', "", '{"time": 1.5}', '{"events": ["Smoke"]}', '{"time": 1.5}', "  ")
    assert [stimulus.when for stimulus in stimuli] == [0, 1_500_000_000, 1_500_000_000, 1_500_000_000]
    assert wrong is None


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("[1]", "Expected `object`"),
        ('{"sate": 0}', "sate"),
        ('{"state": 7}', "no state 7"),
        ('{"state": 0, "ensemble": "third"}', "no ensemble 'third'; there are first, second"),
        ('{"belief": [1, 0]}', "decides on states: give a state, not a belief"),
        ('{"predicates": {"Clear": true}}', "'Clear' is derived"),
        ('{"predicates": {"Water": true}}', "no predicate 'Water'"),
        ('{"events": ["Fire"]}', "no event 'Fire'"),
        ('{"control": "jump"}', "jump"),
        ('{"time": -1}', "a number of seconds from 0 on, not -1"),
        ('{"time": 1}', "time goes back from 2 to 1 s"),
        ('{"time": 1e300}', "a number of seconds from 0 on"),
        ('{"time": 1763851268.5}', "to 1,000,000,000, not 1763851268.5: where times are dates, take the first off"),
    ],
)
def test_reading_ends_at_the_first_wrong_line_and_says_which(system, line, words):
    stimuli, wrong = read(system, '{"time": 2}', "", line, '{"time": 3}')
    assert [stimulus.when for stimulus in stimuli] == [2_000_000_000]
    assert wrong.startswith("standard input:3: ")
    assert words in wrong


def test_bytes_that_are_no_text_are_told(system):
    stimuli, wrong = read_stimuli(io.BytesIO(b'{"time": 2}\n\xff\xfe\n'), system)
    assert len(stimuli) == 1
    assert wrong.startswith("standard input:2: ")
