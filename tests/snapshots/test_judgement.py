"""Rules of judgement, against histories that are made so."""

from __future__ import annotations

from math import inf

from hypothesis import given, strategies as st
from places import ROOT

from mdm.snapshots.judgement import RULES, Ended, Seen, lasts_long, unmoved


def test_the_page_of_the_docs_has_all_rules_in_their_order():
    text = (ROOT / "docs" / "page.md").read_text()
    severities = {"wrong": "wrong", "look": "worth a look"}
    rows = [f"| `{name}` | {severities[each.severity]} | {each.when} | {each.remedy} |" for name, each in RULES.items()]
    assert "\n".join(rows) in text


def done(action, *seconds, status="succeeded"):
    return [Ended(action, each, status) for each in seconds]


def test_an_action_lasts_by_its_own_median():
    before = done("Go", 4.0, 5.0, 60.0)  # whose median is 5
    assert lasts_long("Go", before) == (25.0, "it usually takes 5.0 s")
    assert lasts_long("Go", done("Go", 0.1, 0.1, 0.1))[0] == 10.0


def test_an_action_that_has_never_ended_lasts_by_those_of_the_others():
    others = done("Help", 7.0, 4.0)
    assert lasts_long("Go", others) == (35.0, "it has never ended, and others took 7.0 s at most")
    assert lasts_long("Go", done("Help", 7.0)) == (inf, "")  # which is too little to judge by


def test_an_action_that_has_ended_once_or_twice_lasts_by_the_longest_of_all():
    before = done("Charge", 2.0, 2.0)
    assert lasts_long("Charge", before) == (30.0, "it took 2.0 s at most before")
    assert lasts_long("Charge", [*before, *done("Drive", 10.0)])[0] == 50.0


@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=50))
def test_an_action_that_others_end_has_no_time_of_its_own(seconds):
    before = [*done("Patrol", *seconds, status="preempted"), *done("Help", 1.0, 2.0)]
    assert lasts_long("Patrol", before) == (inf, "")


def seen(symbols, chances):
    return [
        Seen(float(time), symbol, 1, chance)
        for time, (symbol, chance) in enumerate(zip(symbols, chances, strict=False))
    ]


def test_a_belief_that_stands_still_while_observations_differ_is_named():
    def told(history):
        return unmoved(history, lambda symbol: f"hear-{symbol}", lambda state: f"s{state}")

    symbols = ["left"] * 17 + ["right"] * 3
    came = "hear-left 17 times, hear-right 3 times"
    assert told(seen(symbols, [0.5] * 20)) == f"observations differ ({came}); it stays at 50 % for s1"
    assert told(seen(symbols, [0.5] * 19 + [0.502])) == ""
    assert told(seen(["left"] * 20, [0.5] * 20)) == ""
    assert told(seen(symbols, [0.89] * 20)).endswith("89 % for s1")
    assert told(seen(symbols, [0.9] * 20)) == ""  # noise moves nobody who is that sure
    assert told(seen(symbols, [0.5] * 20)[:19]) == ""
