"""The traffic of a replayed team: which message was received, and up to when none can have come that is not known."""

from __future__ import annotations

from mdm.replay.exchange import Limit, Sent, Side, Traffic
from mdm.stimuli import Began, Finished, Received


def received(time, agent, owner, body, sent):
    return Received(time, agent, "team/*/votes", f"team/{owner}/votes", owner, 1, sent, body)


def votes(agent, *sent):
    return {(agent, 1): [Sent(time, f"team/{agent}/votes", body) for time, body in sent]}


def side(agent, *stimuli, until=1000):
    return {agent: Side([Began(0, agent, "start"), *stimuli, Finished(until)], ((agent, 1),), until)}


def test_a_message_is_the_last_of_its_content_that_was_sent_by_then():
    traffic = Traffic(side("a") | side("b"), votes("a", (10, b"x"), (20, b"y"), (30, b"x"), (50, b"x")))
    assert traffic.number(received(40, "b", "a", b"x", 10)) == 0
    assert traffic.number(received(40, "b", "a", b"x", 31)) == 2
    assert traffic.number(received(40, "b", "a", b"y", 35)) == 1
    assert traffic.number(received(40, "b", "a", b"z", 35)) is None
    assert traffic.number(received(40, "b", "c", b"x", 35)) is None


def test_an_answer_is_no_message():
    traffic = Traffic(side("a") | side("b"), {("a", 1): [Sent(10, "team/a/votes", b"x", answer=True)]})
    assert traffic.number(received(40, "b", "a", b"x", 10)) is None


def test_who_receives_is_known_up_to_the_last_message_that_is():
    heard = [received(15, "b", "a", b"1", 10), received(25, "b", "a", b"2", 20), received(45, "b", "a", b"3", 40)]
    traffic = Traffic(side("a") | side("b", *heard), votes("a", (10, b"1"), (20, b"2"), (40, b"3")) | votes("b"))
    root = Limit(30, "a says another thing")
    assert traffic.limits({"a": root}) == {"a": root, "b": Limit(26, root.reason)}
    assert traffic.limits({"a": Limit(10, "")})["b"].time == 0  # none is known
    assert traffic.limits({"a": Limit(41, "")})["b"].time == 46
    assert traffic.limits({}) == {}


def test_at_the_time_of_a_next_stimulus_nothing_is_known():
    heard = [received(15, "b", "a", b"1", 10), received(15, "b", "a", b"2", 12)]
    traffic = Traffic(side("a") | side("b", *heard), votes("a", (10, b"1"), (12, b"2")) | votes("b"))
    assert traffic.limits({"a": Limit(11, "")})["b"].time == 15


def test_it_goes_on_from_agent_to_agent_and_back():
    """Of c nothing is known once b may have received of a, which has a limit of its own behind that."""
    told = votes("a", (10, b"1"), (40, b"2")) | votes("b", (12, b"3"), (28, b"4")) | votes("c", (5, b"5"))
    sides = (
        side("a", received(14, "a", "c", b"5", 5))
        | side("b", received(16, "b", "a", b"1", 10), received(45, "b", "a", b"2", 40))
        | side("c", received(13, "c", "b", b"3", 12), received(29, "c", "b", b"4", 28))
    )
    limits = Traffic(sides, told).limits({"a": Limit(30, "a")})
    assert {name: limit.time for name, limit in limits.items()} == {"b": 17, "c": 14, "a": 30}
    assert {limit.reason for limit in limits.values()} == {"a"}


def test_who_never_heard_of_an_agent_is_not_touched():
    traffic = Traffic(side("a") | side("b"), votes("a", (10, b"1")) | votes("b"))
    assert set(traffic.limits({"a": Limit(5, "")})) == {"a"}
