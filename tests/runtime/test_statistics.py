"""Latencies, against the list of them."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given, strategies as st

from mdm import Ensemble
from mdm.runtime import Latencies
from mdm.testing import run_virtual


@given(st.lists(st.integers(1, 10**10), min_size=1, max_size=200))
def test_latencies_are_exact_to_an_eighth_of_an_octave(values):
    latencies = Latencies()
    for value in values:
        latencies.record(value)
    histogram = latencies.snapshot()
    assert histogram.count == len(values)
    assert histogram.total == pytest.approx(sum(values) / 1e9)
    assert histogram.maximum == max(values) / 1e9
    for fraction in (0.1, 0.5, 0.9, 1.0):
        rank = max(1, -(-fraction * len(values) // 1))
        exact = sorted(values)[int(rank) - 1] / 1e9
        assert exact <= histogram.quantile(fraction) * (1 + 1e-9) <= exact * 1.2 + 2e-9


def test_statistics_print_what_is_not_zero():
    async def main(runtime):
        await runtime.start(Ensemble("robot", policy=[0], actions={"Wait": lambda: None}))
        robot = runtime.root.children[0]
        assert (
            repr(robot.control.statistics()) == "ControlStatistics(path='robot/control', state='running', received=1)"
        )
        robot.publish_state(0)
        text = repr(robot.control.statistics())
        assert "decisions=1" in text
        assert "latency=Histogram(count=1" in text
        assert "impossible" not in text
        whole = runtime.statistics()
        assert "=0" not in repr(whole)
        assert msgspec.json.decode(msgspec.json.encode(whole))["loop"] is None  # a record of it has them all
        assert msgspec.to_builtins(whole)["actors"][0]["failures"] == 0

    run_virtual(main)


def test_statistics_of_a_runtime_print_as_a_table():
    async def main(runtime):
        await runtime.start(Ensemble("robot", policy=[0, 0], actions={"Wait": lambda: None}))
        for state in (0, 1, 0):
            runtime.root.children[0].publish_state(state)
        return str(runtime.statistics())

    rows = dict(line.split("  ", 1) for line in run_virtual(main).splitlines())
    assert {name.split()[0] for name in rows} == {"dispatcher", "actor", "channel"}
    assert rows["channel robot/state"].strip().startswith("published 3")
    assert "ended 3 succeeded" in rows["actor robot/action"]
    assert " 0" not in "".join(rows.values()).replace(" 0.", "").replace("latency 0 s (at most 0 s)", "")
    assert not any("[" in row or "=" in row for row in rows.values())


def test_a_histogram_prints_in_one_line():
    latencies = Latencies()
    assert repr(latencies.snapshot()) == "Histogram(count=0)"
    for _ in range(4):
        latencies.record(2_000_000)
    text = repr(latencies.snapshot())
    assert text.startswith("Histogram(count=4, median=0.002 s, ")
    assert text.endswith("maximum=0.002 s)")
