from __future__ import annotations

import pytest

from mdm.team.transport.router import Packer, Router

KEY = "mdm/team/b/e/c"


class Later:
    """Calls back when told to."""

    def __init__(self):
        self.waiting = []

    def __call__(self, seconds, callback):
        assert seconds == 1
        self.waiting.append(callback)

    def pass_(self):
        waiting, self.waiting = self.waiting, []
        for callback in waiting:
            callback()


def router(**options):
    later, reports, failures = Later(), [], []
    made = Router("team", "a", 1, int, **options)
    made._later = later
    made.supervise(failures.append, lambda kind, text: reports.append((kind, text)))
    return made, later, reports, failures


def test_reports_come_once_a_second_and_none_is_forgotten():
    made, later, reports, _ = router()
    made.subscribe("mdm/team/**", print)
    for _ in range(100):
        made.deliver(KEY, b"garbage", 0)
    assert reports == [("malformed", f"a message under {KEY} is shorter than an envelope")]
    later.pass_()
    assert len(reports) == 2
    assert reports[1][1].endswith("(99 such messages)")
    later.pass_()
    assert later.waiting == []
    made.deliver(KEY, b"garbage", 10**9)
    assert len(reports) == 3
    assert made.statistics().dropped == {"malformed": 101}


def test_a_sender_of_what_cannot_be_is_counted_and_ignored_for_a_while():
    made, _, reports, _ = router()
    heard = []
    made.subscribe("mdm/team/**", heard.append)
    packer = Packer("b", 1, int)
    for _ in range(101):
        made.deliver(KEY, b"garbage", 0)
    made.deliver(KEY, packer.pack(KEY, b"good"), 249_999_999)
    made.deliver("mdm/team/c/e/c", Packer("c", 1, int).pack("mdm/team/c/e/c", b"other"), 0)
    assert [sample.body for sample in heard] == [b"other"]
    assert made.statistics().dropped == {"malformed": 101, "ignored": 1}
    assert reports[-1] == ("ignored", "b is not heard: it sent a hundred messages in a second that cannot be")
    made.deliver(KEY, packer.pack(KEY, b"again"), 250_000_000)
    assert heard[-1].body == b"again"
    made.refuse("b", "no such action")
    assert made.statistics().refused == {"b": 102}


def test_few_a_second_of_what_cannot_be_are_no_reason_to_ignore_their_sender():
    made, _, _, _ = router()
    made.subscribe("mdm/team/**", print)
    for second in range(20):
        for _ in range(100):
            made.deliver(KEY, b"garbage", second * 10**9)
    assert made.statistics().dropped == {"malformed": 2000}


@pytest.mark.parametrize("time", [-(2**63), 2**63 - 1, 10**18 + 86_400 * 10**9, 10**18 - 86_400 * 10**9])
def test_a_clock_that_is_a_day_off_is_told_and_its_messages_are_dropped(time):
    made, _, reports, _ = router()
    heard = []
    made.subscribe("mdm/team/**", heard.append)
    made.deliver(KEY, Packer("b", 1, lambda: time).pack(KEY, b"late"), 10**18)
    assert heard == []
    assert [kind for kind, _ in reports] == ["untimely"]
    assert made.statistics().lateness.count == 0
    made.deliver(KEY, Packer("b", 2, lambda: 10**18 - 86_399 * 10**9).pack(KEY, b"good"), 10**18)
    assert len(heard) == 1


def test_each_kind_has_its_own_second():
    made, _, reports, _ = router()
    made.subscribe("mdm/team/**", print)
    made.deliver(KEY, b"garbage", 0)
    made.deliver(KEY, Packer("c", 1, int).pack(KEY, b""), 0)
    made.deliver(KEY, Packer("b", 1, int, version=9).pack(KEY, b""), 0)
    assert [kind for kind, _ in reports] == ["malformed", "foreign", "version"]


def test_a_question_of_another_process_in_this_agent_s_name_is_told():
    made, _, reports, _ = router()
    made.serve("mdm/team/a/call", lambda body: b"yes")
    assert made.answer("mdm/team/a/call", Packer("a", 7, int).seal(b"")) == b"yes"
    assert reports == [("duplicate", "another process asks as agent 'a': two have this name")]
    assert made.statistics().dropped == {"duplicate": 1}


def test_what_nobody_subscribed_to_is_not_looked_at():
    made, *_ = router()
    made.deliver(KEY, b"garbage", 0)
    assert made.statistics().dropped == {}
    assert not made.wants(KEY)


def test_an_expression_within_an_earlier_one_is_carried_by_it():
    made, *_ = router()
    carried = []
    made._carry = carried.append
    for expression in ("mdm/team/*/e/**", "mdm/team/b/e/c", "mdm/team/*/e/**", "mdm/team/b/**"):
        made.subscribe(expression, print)
    assert carried == ["mdm/team/*/e/**", "mdm/team/b/**"]
    assert made.carriers() == ("mdm/team/*/e/**", "mdm/team/b/**")


def test_a_message_that_two_expressions_bring_counts_once():
    made, *_ = router()
    got = []
    made.subscribe("mdm/team/*/e/c", lambda sample: got.append(1))
    made.subscribe("mdm/team/b/**", lambda sample: got.append(2))
    data = Packer("b", 1, int).pack(KEY, b"")
    made.deliver(KEY, data, 0, "mdm/team/b/**")
    assert got == []
    made.deliver(KEY, data, 0, "mdm/team/*/e/c")
    assert got == [1, 2]
    assert made.statistics().dropped == {}


def test_memory_is_bounded_under_ever_new_keys():
    made, *_ = router()
    got = []
    made.subscribe("mdm/team/**", got.append)
    sender = Packer("b", 1, int)
    made.packer.sent = sender.sent
    for number in range(5000):
        made.deliver(f"{KEY}{number}", sender.pack(f"{KEY}{number}", b""), 0)
    statistics = made.statistics()
    assert len(got) == 5000
    assert len(statistics.received) == len(statistics.sent) == 4097
    assert statistics.received["..."].messages == statistics.sent["..."].messages == 5000 - 4096


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt()])
def test_whatever_a_handler_a_watcher_or_an_answer_raises_is_told(error):
    made, _, _, failures = router()

    def fail(*_):
        raise error

    made.subscribe("mdm/team/**", fail)
    made.watch(fail)
    made.serve("mdm/team/a/e/call", fail)
    made.deliver(KEY, Packer("b", 1, int).pack(KEY, b""), 0)
    made.see({"a": 1})
    assert made.answer("mdm/team/a/e/call", Packer("b", 1, int).seal(b"")) is None
    assert failures == [error] * 3


def test_a_report_that_fails_is_told():
    made, _, _, failures = router()
    error = ValueError("no")

    def fail(*_):
        raise error

    made.supervise(failures.append, fail)
    made.drop("foreign", "because")
    assert failures == [error]


def test_watchers_are_told_of_changes_alone():
    made, *_ = router()
    seen = []
    made.watch(seen.append)
    made.see({"b": 2, "a": 1})
    made.see({"a": 1, "b": 2})
    made.see({"a": 1})
    assert seen == [{"a": 1, "b": 2}, {"a": 1}]
