"""`mdm latency`: rows, JSON, and what is refused."""

from __future__ import annotations

import json
import re

import pytest
from places import EXAMPLES

from mdm.cli.robots import latency
from mdm.latency import Report, Row

TIGER = [str(EXAMPLES / "tiger.pomdp"), str(EXAMPLES / "tiger.vf")]


REPORT = Report(
    (
        Row("in the loop", 2e-6, 9.5e-6, 0.0125, 7, 1, ((2.048e-6, 5), (8.192e-6, 1), (0.016777216, 1))),
        Row("from another process", needs="eclipse-zenoh"),
        Row("a bare loop", undecided=2),
    ),
    ("asyncio's own event loop wakes up slower than uvloop",),
    {"impossible": 2},
    60.0,
)


@pytest.fixture
def measured(monkeypatch):
    """Have a report as if something had been measured; return the arguments of each measurement."""
    calls = []

    def measure(given, **options):
        calls.append((given, options))
        return REPORT

    monkeypatch.setattr(latency, "measure", measure)
    return calls


def test_json_has_the_quantiles_of_each_row_in_seconds(mdm, measured):
    status, output, _ = mdm("latency", *TIGER, "--seconds", "0.7", "--json")
    assert status == 0
    first, absent, _ = json.loads(output[0])["rows"]
    assert first == {
        "name": "in the loop",
        "p50": 2e-6,
        "p99": 9.5e-6,
        "worst": 0.0125,
        "count": 7,
        "undecided": 1,
        "needs": "",
        "histogram": [[2.048e-6, 5], [8.192e-6, 1], [0.016777216, 1]],
    }
    assert (absent["p50"], absent["p99"], absent["worst"], absent["needs"]) == (None, None, None, "eclipse-zenoh")
    ((given, options),) = measured
    assert given == tuple(TIGER)
    assert options == {"seconds": 0.7, "burn": 0, "agent": None, "with_actions": False, "seed": 1}


def test_a_table_has_a_line_for_each_row(mdm, measured):
    status, output, errors = mdm("latency", EXAMPLES / "tiger.toml", "--with-actions", "--burn", "2")
    assert status == 0
    assert "the actions of" in errors
    assert "are called, many times a second, for 50 s; its tasks are not" in errors
    assert [re.split(" {2,}", line.strip(), maxsplit=6) for line in output] == [
        ["from the stimulus to the action's call", "p50", "p99", "worst", "count", "undecided", "histogram"],
        ["in the loop", "2 µs", "9.5 µs", "12.5 ms", "7", "1", "2.05 µs ▇ ▂          ▂"],
        ["from another process", "not measured: needs eclipse-zenoh: pip install eclipse-zenoh"],
        ["a bare loop", "0", "2", "no action was called"],
        ["meanwhile: 2 faults of the kind impossible"],
        ["faster: asyncio's own event loop wakes up slower than uvloop"],
    ]


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ((), 2, "give a TOML file, or a model and its policy"),
        ((TIGER[0],), 2, "give a TOML file, or a model together with its policy, in place of"),
        ((*TIGER, "--seconds", "0"), 2, "a number of seconds above 0 was expected"),
        ((*TIGER, "--burn", "x"), 2, "a number of processes"),
        ((*TIGER, "--agent", "a"), 2, "--agent and --with-actions are for a TOML file"),
        ((str(EXAMPLES / "team" / "meeting.toml"),), 1, "say which agent's part"),
        ((TIGER[1], TIGER[0]), 1, "mdm latency: "),
        (("absent.toml",), 1, "absent.toml"),
    ],
)
def test_what_cannot_be_measured_is_a_sentence(mdm, arguments, status, words):
    found, _, errors = mdm("latency", *arguments)
    assert found == status
    assert words in str(errors)
    assert "Traceback" not in str(errors)
