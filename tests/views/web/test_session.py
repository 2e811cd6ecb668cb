"""What a browser may say, and what it is answered."""

from __future__ import annotations

import asyncio
import time

import msgspec
import pytest
from decided import ensemble
from sentences import refused

from mdm import Error
from mdm.snapshots import LiveRun, Ring
from mdm.testing import run_virtual
from mdm.views.web.session import Allowance, Reader


def said(**message):
    return msgspec.json.encode(message)


async def answers(reader, text):
    return await reader.answers(reader.read(text))


def with_reader(talk, *, control=False):
    """Have somebody talk with a reader of a running robot, in virtual time."""

    async def main(runtime):
        live = LiveRun(runtime, control=control)
        live.open()
        robot = ensemble()
        await runtime.start(robot)
        loop = asyncio.get_running_loop()

        async def newest():
            await asyncio.sleep(0.05)
            encoded = live.encoded(reader.close)
            return live.generation, encoded

        reader = Reader(live, newest, control=control)
        assert msgspec.json.decode(reader.greeting())["scene"]["ensembles"][0]["path"] == "robot"
        return await talk(reader, robot, loop)

    return run_virtual(main)


def test_a_frame_of_an_older_scene_is_left_out():
    """One that was made, and then, before it was sent, an ensemble came."""

    class Source:
        generation = 1
        ring = Ring()

        def scene(self):
            return {"ensembles": self.generation}

    source = Source()
    frames = iter([(1, b"1"), (1, b"1"), (2, b"2"), (2, b"2")])
    later = iter([1, 2, 2, 2])

    async def newest():
        source.generation = next(later)
        return next(frames)

    reader = Reader(source, newest, control=False)
    reader.greeting()

    async def talk():
        return [[msgspec.json.decode(each) for each in await answers(reader, said(say="drawn"))] for _ in range(3)]

    (old,), (scene, new), (again,) = asyncio.run(talk())
    assert old["frame"] == 1
    assert scene["scene"] == {"ensembles": 2}
    assert new["frame"] == again["frame"] == 2


def test_a_frame_comes_with_the_events_behind_the_cursor():
    async def talk(reader, robot, _):
        (first,) = await answers(reader, said(say="drawn", cursor=0, close=["robot"]))
        first = msgspec.json.decode(first)
        assert first["frame"]["ensembles"][0]["mode"] == "deciding"
        assert list(first["frame"]["details"]) == ["robot"]
        robot.publish_observation("hear-left")
        (second,) = await answers(reader, said(say="drawn", cursor=first["cursor"]))
        second = msgspec.json.decode(second)
        numbers = [event["number"] for event in first["events"] + second["events"]]
        assert numbers == list(range(1, len(numbers) + 1))
        assert [event["kind"] for event in second["events"]] == ["decision"]
        assert second["frame"].get("details", {}) == {}

    with_reader(talk)


def test_a_picture_is_told_of_an_ensemble_and_none_of_nobody():
    async def talk(reader, *_):
        (told,) = await answers(reader, said(say="draw", ensemble="robot", time=None, opened=[3]))
        told = msgspec.json.decode(told)
        assert told["ensemble"] == "robot"
        assert [each["title"] for each in told["pictures"]] == ["actions over beliefs in 2 states"]
        (nobody,) = await answers(reader, said(say="draw", ensemble="nobody"))
        assert msgspec.json.decode(nobody)["pictures"] == []

    with_reader(talk)


def test_commands_are_refused_unless_they_are_asked_for():
    async def talk(reader, robot, _):
        (answer,) = await answers(reader, said(say="command", command="stop", ensemble="robot"))
        assert "--page-control" in msgspec.json.decode(answer)["refused"]
        assert robot.mode == "deciding"

    with_reader(talk)

    async def commands(reader, robot, _):
        (answer,) = await answers(reader, said(say="command", command="stop", ensemble="robot"))
        assert msgspec.json.decode(answer) == {"done": "stop robot"}
        assert robot.mode == "stopped"
        (answer,) = await answers(reader, said(say="command", command="stop", ensemble="nobody"))
        assert msgspec.json.decode(answer) == {"refused": "there is no ensemble 'nobody'"}

    with_reader(commands, control=True)


def test_a_command_that_comes_too_late_is_refused():
    async def talk(reader, robot, _):
        soon, before = time.time_ns() + 10**12, time.time_ns() - 1
        for message in (
            {"say": "command", "command": "stop", "ensemble": "robot"},
            {"say": "sense", "predicate": "InLab", "value": True},
        ):
            (answer,) = await answers(reader, said(**message, before=before))
            assert msgspec.json.decode(answer) == {"refused": "this command has come too late"}
        assert robot.mode == "deciding"
        await answers(reader, said(say="command", command="stop", ensemble="robot", before=soon))
        assert robot.mode == "stopped"

    with_reader(talk, control=True)


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"[]",
        b'{"say": "explode"}',
        b'{"say": "drawn", "cursor": -1}',
        b'{"say": "drawn", "more": 1}',
        said(say="drawn", close=["x"] * 17),
        said(say="command", command="x" * 1001, ensemble="robot"),
        said(say="command", command="stop", ensemble="robot", before=-1),
        said(say="at", time=1.0),
        said(say="course", ensemble="robot", first=0.0, last=1.0),
        said(say="draw", ensemble="robot", opened=[-1]),
        said(say="draw", ensemble="robot", opened=[*range(101)]),
        b"\xff\xfe",
    ],
)
def test_what_is_no_message_ends_the_talk(message):
    async def talk(reader, *_):
        with pytest.raises(Error):
            await answers(reader, message)

    with_reader(talk, control=True)


def test_ten_thousand_commands_are_too_many():
    async def talk(reader, *_):
        answered = 0
        with refused(Error):
            for _ in range(10_000):
                await answers(reader, said(say="command", command="start", ensemble="robot"))
                answered += 1
        assert answered == 10

    with_reader(talk, control=True)


def test_an_allowance_is_a_rate_and_a_burst():
    now = [0.0]
    allowance = Allowance(2.0, 3.0, lambda: now[0])
    assert [allowance.take() for _ in range(4)] == [True, True, True, False]
    now[0] = 0.4
    assert not allowance.take()
    now[0] = 1.0
    assert [allowance.take() for _ in range(3)] == [True, True, False]
    now[0] = 100.0
    assert [allowance.take() for _ in range(4)] == [True, True, True, False]
