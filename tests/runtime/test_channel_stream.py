"""Streams: bounded, and ended with the runtime."""

from __future__ import annotations

import pytest
from recorded import state

from mdm import Error, Runtime, VirtualClock, run
from mdm.messages import State
from mdm.runtime import Overflow
from mdm.testing import run_virtual


@pytest.mark.parametrize(
    ("overflow", "expected"), [("drop_oldest", [3, 4]), ("drop_newest", [0, 1]), ("error", [0, 1])]
)
def test_streams_are_bounded(overflow, expected):
    async def main(runtime):
        channel = runtime.channel("x", State)
        with channel.stream(capacity=2, overflow=overflow) as stream:
            for number in range(5):
                channel.publish(state(number))
            got = []
            try:
                async for message in stream:
                    got.append(message.index)
                    if overflow != "error" and len(got) == 2:
                        break
            except Overflow as error:
                assert "fell more than 2 messages behind" in str(error)
                assert overflow == "error"
            assert got == expected
            assert stream.dropped == channel.statistics().dropped == (1 if overflow == "error" else 3)
        assert channel.statistics().streams == 0

    run_virtual(main)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"capacity": 0}, "a capacity of at least 1, not 0"),
        ({"capacity": "x"}, "a capacity of at least 1, not 'x'"),
        ({"overflow": "drop"}, "is 'drop_oldest', 'drop_newest' or 'error', not 'drop'"),
    ],
)
def test_what_no_stream_could_keep_is_refused(options, words):
    async def main(runtime):
        with pytest.raises(Error, match=words):
            runtime.channel("x", State).stream(**options)

    run_virtual(main)


def test_streams_end_with_the_runtime():
    async def main():
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            channel = runtime.channel("x", State, retain=True)
            channel.publish(state(1))
            stream = channel.stream()
        return [message.index async for message in stream]

    assert run(main, virtual=True) == [1]
