"""What agents told each other: a message that was received, and never sent in the replay of its sender."""

from __future__ import annotations

from records import Writing

from mdm.recording import Record
from mdm.recording.stimuli import Received, Stimulus
from mdm.replay import Exchange
from mdm.replay.transport import ReplayTransport


def received(time, agent, owner, body, *, life=1, sent=None):
    key = f"team/{owner}/votes"
    return Received(time, agent, "team/*/votes", key, owner, life, time - 1 if sent is None else sent, body)


def record(path, *stimuli):
    writing = Writing(path)
    for stimulus in stimuli:
        writing.write("stimuli", stimulus, Stimulus)
    return Record(writing.close())


def sender(agent, *bodies):
    transport = ReplayTransport(agent, 1)
    for body in bodies:
        transport.put(f"team/{agent}/votes", body)
    return {agent: transport}


def test_what_was_not_sent_is_found(tmp_path):
    exchange = Exchange()
    said = [received(10, "a", "b", b"yes"), received(20, "a", "b", b"forged")]
    exchange.add(record(tmp_path / "a.mcap", *said), sender("a", b"no"))
    exchange.add(record(tmp_path / "b.mcap", received(30, "b", "a", b"no", sent=15)), sender("b", b"yes"))
    assert exchange.compared == 3
    assert exchange.unlike() == [said[1]]


def test_agents_of_whom_there_is_no_record_and_what_comes_behind_its_end_are_not_compared(tmp_path):
    exchange = Exchange()
    said = [
        received(10, "a", "c", b"of an agent without a record"),
        received(20, "a", "b", b"of another life", life=2),
        received(60, "a", "b", b"sent behind the end of the record", sent=55),
        received(61, "a", "a", b"of its own"),
    ]
    exchange.add(record(tmp_path / "a.mcap", *said), sender("a"))
    exchange.add(record(tmp_path / "b.mcap", received(50, "b", "c", b"")), sender("b"))
    assert exchange.compared == 0
    assert exchange.unlike() == []
