"""Rules of judgement, against histories that are made so."""

from __future__ import annotations

from math import inf

from hypothesis import given, strategies as st
from places import ROOT

from mdm.faults import KINDS
from mdm.messages import ActionLife, Cause, Decision, Fault, Mode
from mdm.snapshots.judgement import RULES, Ended, Judge, RunJudge, Seen, judged as judged_run, lasts_long, unmoved
from mdm.snapshots.reducer import Known


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


SECOND = 1_000_000_000


def judged(judge, until, rule):
    """Return when a rule begins to name something, and when that is over, in seconds, with the last words."""
    judge.finish(round(until * SECOND))
    (spells,) = [spells for (name, _), spells in judge.named.items() if name == rule]
    return [edge / SECOND for spell in spells for edge in spell.edges], spells[-1].found[-1][1].text


def decision(time, action="go", *, cause="again", wanted=None, state=1):
    name = None if wanted is None else "stay"
    return Decision(round(time * SECOND), "robot", 0, cause, state, None, None, 0, action, None, wanted, name)


def judge():
    return Judge(Known(None, str), lambda _: None)


def test_a_shield_that_decides_often_is_named_until_it_does_so_less():
    robot = judge()
    for time in range(100):
        robot.settle(time * SECOND)
        robot.decide(decision(time, wanted=1 if time % 4 == 0 and time < 60 else None), 1, 0)
    edges, text = judged(robot, 100, "shielded")
    assert edges == [36.0, 70.0]  # the tenth replaced, and with nine of them in the last 50
    assert text == "its shield decides in place of its policy"


def test_ticks_that_are_missed_are_named_for_ten_seconds():
    robot = judge()
    for time in (10.0, 11.0, 12.0):
        robot.settle(time * SECOND)
        robot.missed(round(time * SECOND), 2)
    assert judged(robot, 60, "late") == ([12.0, 20.0], "missed 6 ticks within 10 s")


def test_without_a_model_the_same_decision_for_ever_is_named_after_a_minute():
    robot = judge()
    for time in range(0, 200, 2):
        robot.settle(time * SECOND)
        robot.decide(decision(time), 1, 1)
    edges, text = judged(robot, 200, "same")
    assert edges == [98.0]
    assert text == "decided go 100 times in a row, always in the same state"


def test_a_safe_mode_is_named_with_its_cause_and_remedy_but_not_the_end():
    robot = judge()
    robot.mode(Mode(SECOND, "robot", "safe", SECOND, (Cause("policy", "it is torn", SECOND),)))
    robot.settle(2 * SECOND)
    robot.mode(Mode(3 * SECOND, "robot", "safe", 3 * SECOND, (Cause("end", "the runtime ends", SECOND),)))
    assert judged(robot, 5, "safe") == ([1.0, 3.0], "is safe (policy)")
    (judgement,), _ = judged_run({"robot": robot}, [], 2 * SECOND, lambda time: time / SECOND, stopped=False)
    assert str(judgement) == "robot: is safe (policy), since 00:01.0"
    assert (judgement.evidence, judgement.remedy) == ("policy: it is torn", KINDS["policy"].remedy)


def test_faults_of_a_kind_are_named_where_many_come_within_a_minute():
    run = RunJudge(lambda _: None)
    for time in (0, 70, 80, 90, 100, 110, 300):
        run.fault(Fault(time * SECOND, "robot", "violation", "both"))
    assert judged(run, 400, "faults") == ([110.0, 130.0], "5 faults of the kind violation")
    late = RunJudge(lambda _: None)
    for time in (1, 2, 3):
        late.fault(Fault(time * SECOND, "robot", "deadline", "no answer"))
    assert judged(late, 400, "late") == ([3.0, 61.0], "3 faults of the kind deadline")


def test_a_predicate_may_change_as_often_as_its_time_allows():
    run = RunJudge(lambda _: None)
    run.held_for = {"Slow": 2 * SECOND}
    for step in range(40):
        for name in ("Slow", "Plain"):
            run.change(step * SECOND, name, step % 2 == 0)  # once a second
    edges, text = judged(run, 100, "flickers")
    assert {of for _, of in run.named} == {"Slow"}  # which is to hold for two seconds, and is judged by twenty
    assert (edges, text) == ([10.0, 50.0], "flickers: it has changed 39 times")


def test_a_plain_function_is_named_by_its_failures_within_a_minute():
    robot = judge()
    for time in (0, 30, 31, 32, 33, 34):
        robot.settle(time * SECOND)
        for status in ("running", "failed"):
            robot.live(ActionLife(time * SECOND, "robot", time + 1, "beep", status, "no sound"))
    assert judged(robot, 200, "fails") == ([33.0, 90.0], "beep has failed 6 times")


def test_the_worst_comes_first_and_those_that_are_over_come_last():
    run = RunJudge(lambda _: None)
    run.fault(Fault(SECOND, "right", "refused", "other model"))
    run.finish(100 * SECOND)
    robot, look = judge(), judge()
    robot.mode(Mode(5 * SECOND, "robot", "safe", 5 * SECOND, (Cause("policy", "it is torn", SECOND),)))
    look.missed(90 * SECOND, 9)
    for each in (robot, look):
        each.settle(100 * SECOND)

    def told(time, *, stopped):
        found, worst = judged_run(
            {"a": robot, "b": look}, [run], time * SECOND, lambda at: at / SECOND, stopped=stopped
        )
        return [each.rule for each in found], worst

    assert told(95, stopped=False) == (["safe", "late", "disagrees"], "a: is safe (policy), since 00:05.0")
    assert told(4, stopped=False)[1] == "right: refused: 1 fault of the kind refused, since 00:01.0"
    robot.mode(Mode(96 * SECOND, "robot", "deciding", 96 * SECOND))
    for each in (robot, look):
        each.settle(101 * SECOND)
    assert told(102, stopped=False) == (["safe", "disagrees", "late"], "")
    assert told(102, stopped=True)[1] == "a: is safe (policy), since 00:05.0 until 01:36.0"
