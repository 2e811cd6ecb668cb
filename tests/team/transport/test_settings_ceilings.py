from __future__ import annotations

import json

import pytest
from transports import LOOPBACK, key

from mdm.errors import ConfigError
from mdm.team.transport.settings import Ceiling, ceiling_settings


def test_messages_over_a_ceiling_are_held_back_by_zenoh():
    pytest.importorskip("zenoh")
    ceilings = [
        Ceiling("mdm/team/*/e/slow", rate=2.0),
        Ceiling("mdm/team/*/e/small", size=200),
        Ceiling("mdm/team/*/e/urgent", priority="step"),
    ]

    async def main(net):
        first = net.transport("a", configuration=ceiling_settings(ceilings))
        second = net.transport("b")
        got = []
        second.subscribe("mdm/team/**", lambda sample: got.append((sample.key.rpartition("/")[2], len(sample.body))))
        await net.open(first, second)
        for _ in range(20):
            first.put(key("a", "slow"), b"")
            first.put(key("a", "small"), bytes(1000))
        first.put(key("a", "small"), bytes(10))
        first.put(key("a", "urgent"), bytes(5000))
        first.put(key("a", "last"), b"")
        await net.until(lambda: ("last", 0) in got and ("urgent", 5000) in got)
        assert got.count(("slow", 0)) < 20
        assert [size for name, size in got if name == "small"] == [10]

    LOOPBACK(main)


def test_zenoh_takes_them_and_none():
    zenoh = pytest.importorskip("zenoh")
    made = ceiling_settings([Ceiling("mdm/**", rate=5, size=100, priority="bulk")])
    zenoh.Config.from_json5(json.dumps(made))
    zenoh.Config.from_json5(json.dumps(ceiling_settings([])))


@pytest.mark.parametrize(
    ("ceiling", "message"),
    [
        (Ceiling("mdm//x", rate=1), r"ceilings\[0\]\.keys: an expression"),
        (Ceiling("mdm/**"), r"ceilings\[0\]: a ceiling has a rate, a size or a priority"),
    ],
)
def test_wrong_ceilings_are_refused(ceiling, message):
    with pytest.raises(ConfigError, match=message):
        ceiling_settings([ceiling])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rate": 0}, "rate: a number of messages a second above 0 and at most 1,000,000,000 was expected, not 0"),
        ({"rate": "5"}, "rate: a number of messages a second above 0"),
        ({"size": 0.5}, "size: a whole number of bytes above 0 was expected, not 0.5"),
        ({"priority": "high"}, "priority: 'high' is not one of 'step', 'value', 'bulk'"),
    ],
)
def test_wrong_options_of_a_ceiling_are_refused(given, message):
    with pytest.raises(ConfigError, match=message):
        Ceiling("mdm/**", **given)
