"""Joint observations, conflicts, and checks against models."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm import (
    ConfigError,
    Ensemble,
    ObservationFactor,
    ObservationLayer,
    PredicateManager,
)
from mdm.messages import Observation
from mdm.models import Factor, Space
from mdm.testing import probe, run_virtual


@given(st.data())
def test_joint_observations(data):
    kinds = data.draw(st.lists(st.sampled_from(["missing", "idle", "hold"]), min_size=1, max_size=3))
    sizes = [data.draw(st.integers(2, 3)) for _ in kinds]

    async def main(runtime):
        manager = PredicateManager()
        factors = []
        for index, (kind, size) in enumerate(zip(kinds, sizes, strict=True)):
            events = [f"E{index}_{symbol}" for symbol in range(size)]
            for name in events:
                manager.event(name)
            idle = events[0] if kind == "idle" else None
            factors.append(ObservationFactor(f"o{index}", events, idle=idle, hold=kind == "hold"))
        await runtime.start(manager)
        await runtime.start(ObservationLayer(factors, manager))
        seen = probe(runtime.channel("observation/observation", Observation))
        rest = [0 if kind == "idle" else None for kind in kinds]
        for _ in range(data.draw(st.integers(1, 8))):
            new = {i: data.draw(st.integers(0, sizes[i] - 1)) for i in range(len(kinds)) if data.draw(st.booleans())}
            count = len(seen)
            if new:
                manager.occur(*(f"E{index}_{symbol}" for index, symbol in new.items()))
            assert len(seen) - count == bool(new)
            if new:
                values = tuple(new.get(index, rest[index]) for index in range(len(kinds)))
                index = None if None in values else int(np.ravel_multi_index(values, sizes))
                mask = tuple(index in new for index in range(len(kinds)))
                assert (seen[-1].index, seen[-1].values, seen[-1].mask) == (index, values, mask)
                for component, symbol in new.items():
                    if kinds[component] == "hold":
                        rest[component] = symbol

    run_virtual(main)


def test_two_symbols_at_once_are_a_conflict(declared):
    async def main(runtime):
        await runtime.start(declared)
        layer = ObservationLayer([ObservationFactor("d", ["Up", "Down"])], declared)
        await runtime.start(layer)
        seen, faults = probe(runtime.channel("observation/observation", Observation)), probe(runtime.faults)
        declared.occur("Down", "Up")
        assert seen[-1].index == 0
        assert layer.conflicts == 1
        assert "Up and Down occurred at once" in faults[-1].detail

    run_virtual(main)


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ([ObservationFactor("d", ["Up", "Dawn"])], "'Dawn', which is no declared event; did you mean 'Down'"),
        (
            [ObservationFactor("d", ["Up", "Down"]), ObservationFactor("e", ["Hot", "Up"])],
            "'Up' belongs to .* 'd' and 'e'",
        ),
        ([ObservationFactor("d", ["Up", "Down"])], "1 observation factors .* do not make up the model's 6"),
        (
            [ObservationFactor("d", ["Up", "Down"]), ObservationFactor("t", ["Hot", "Cold"])],
            "'t' has 2 symbols, .* has 3",
        ),
    ],
)
def test_observation_factors_are_checked(factors, message, declared):
    async def main(runtime):
        await runtime.start(declared)
        space = Space([Factor("agent0", 2), Factor("agent1", 3)])
        with pytest.raises(ConfigError, match=message):
            await runtime.start(ObservationLayer(factors, declared, space=space))

    run_virtual(main)


def test_a_layer_that_covers_some_factors_observes_these_alone(declared):
    async def main(runtime):
        factors = [
            ObservationFactor("way", ["Up", "Down"]),
            ObservationFactor("air", ["Hot", "Cold"], idle="Cold", owner="other"),
        ]
        layer = ObservationLayer(factors, declared, name="robot")
        layer.cover(["way"])
        whole = probe(runtime.channel("robot/observation", Observation))
        part = probe(runtime.channel("robot/own_observation", Observation))
        await runtime.start(declared)
        await runtime.start(layer)
        declared.occur("Hot")
        declared.occur("Down")
        assert whole == []
        assert [(each.index, each.values, each.mask) for each in part] == [(None, (1, None), (True, False))]

    run_virtual(main)


@pytest.mark.parametrize(
    ("factor", "key"),
    [(ObservationFactor("d", ["Up", "Dawn"]), ".d"), (ObservationFactor("d", ["Up", "Down"]), "")],
)
def test_an_error_names_its_place_in_the_configuration(factor, key, declared):
    """Of a factor, or of all of them."""
    space = Space([Factor("agent0", 2), Factor("agent1", 3)])
    robot = Ensemble("robot", policy=[0], actions={"Go": lambda: None}, predicates=declared)
    layer = ObservationLayer([factor], declared, space=space)
    robot.add(layer)
    assert f"ensembles.robot.observations{key}" in {problem.key for problem in layer.problems()}
