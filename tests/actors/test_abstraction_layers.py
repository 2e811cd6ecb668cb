"""State and observation layers: index maps, violations, missing components, checks against models."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm import (
    ActorFailure,
    ConfigError,
    ObservationFactor,
    ObservationLayer,
    PredicateManager,
    StateFactor,
    StateLayer,
)
from mdm.messages import Observation, State
from mdm.models import Factor, Space
from mdm.testing import probe, run_virtual


def state_layer(shape, **options):
    manager = PredicateManager()
    factors = []
    for index, size in enumerate(shape):
        names = [f"F{index}"] if size == 2 else [f"F{index}_{value}" for value in range(size)]
        for name in names:
            manager.sensor(name)
        factors.append(StateFactor(f"factor{index}", names, **options))
    return manager, factors


def set_value(manager, factor, value):
    if len(factor.predicates) == 1:
        manager.sense(factor.predicates[0], None if value is None else bool(value))
    else:
        for position, name in enumerate(factor.predicates):
            manager.sense(name, None if value is None else position == value)


@given(st.lists(st.integers(2, 4), min_size=1, max_size=4), st.data())
def test_joint_states_are_those_of_numpy(shape, data):
    async def main(runtime):
        manager, factors = state_layer(shape)
        await runtime.start(manager)
        await runtime.start(StateLayer(factors, manager))
        states = probe(runtime.channel("state/state", State, retain=True))
        values: list[int | None] = [None] * len(shape)
        last: object = "none yet"
        for _ in range(data.draw(st.integers(1, 12))):
            count = len(states)
            with manager.batch():
                for index, size in enumerate(shape):
                    if data.draw(st.booleans()):
                        values[index] = data.draw(st.none() | st.integers(0, size - 1))
                        set_value(manager, factors[index], values[index])
            if None in values:
                expected = None
                published = isinstance(last, int)
            else:
                expected = int(np.ravel_multi_index(values, shape))
                published = expected != last
            assert len(states) - count == published
            if published:
                assert states[-1].index == expected
                assert states[-1].values == tuple(values)
                last = expected

    run_virtual(main)


@pytest.mark.parametrize(("on_violation", "both", "none"), [(None, 0, 1), ("first", 0, 1), ("hold", 1, 1)])
def test_violations_are_counted_reported_and_resolved(on_violation, both, none):
    async def main(runtime):
        manager, factors = state_layer([3], on_violation=on_violation)
        await runtime.start(manager)
        layer = StateLayer(factors, manager)
        await runtime.start(layer)
        states, faults = probe(runtime.channel("state/state", State, retain=True)), probe(runtime.faults)
        for name in factors[0].predicates:
            manager.sense(name, name == "F0_1")
        assert states[-1].index == 1
        manager.sense("F0_0", True)
        assert states[-1].index == both
        assert layer.violations == 1
        assert "factor 'factor0': F0_0 and F0_1 are true at once" in faults[-1].detail
        with manager.batch():
            manager.sense("F0_0", False)
        assert states[-1].index == 1
        manager.sense("F0_1", False)
        assert states[-1].index == none
        assert "none of F0_0, F0_1, F0_2 is true" in faults[-1].detail
        assert "held the last value" in faults[-1].detail
        assert layer.violations == len(faults) == 2

    run_virtual(main)


@pytest.mark.parametrize("what", ["both", "none"])
def test_a_violation_may_be_an_error(what):
    async def main(runtime):
        manager, factors = state_layer([3], on_violation="error")
        await runtime.start(manager)
        await runtime.start(StateLayer(factors, manager))
        for name in factors[0].predicates:
            manager.sense(name, name == "F0_1")
        manager.sense("F0_1" if what == "none" else "F0_2", what == "both")
        await runtime.clock.sleep(60)

    with pytest.raises(ActorFailure, match="though exactly one should be"):
        run_virtual(main)


def test_one_true_among_unknown_ones_is_enough():
    async def main(runtime):
        manager, factors = state_layer([3])
        await runtime.start(manager)
        await runtime.start(StateLayer(factors, manager))
        states = probe(runtime.channel("state/state", State, retain=True))
        manager.sense("F0_2", True)
        assert [state.index for state in states] == [2]

    run_virtual(main)


SPACE = Space([Factor("room", ["a", "b", "c"]), Factor("person", ["no", "yes"])])


def declared():
    manager = PredicateManager()
    for name in ("InA", "InB", "InC", "Person"):
        manager.sensor(name)
    for name in ("Up", "Down", "Hot", "Cold"):
        manager.event(name)
    return manager


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        (
            [StateFactor("room", ["InA", "InB"]), StateFactor("person", ["Person"])],
            "'room' has 2 values, .* model's has 3",
        ),
        (
            [StateFactor("room", ["InA", "InB", "InD"])],
            "'InD', which is no declared predicate; did you mean 'InC'|'InD'",
        ),
        ([StateFactor("place", ["InA", "InB", "InC"])], "no state factor 'place'; it has room, person"),
    ],
)
def test_state_factors_are_checked_against_the_model(factors, message):
    async def main(runtime):
        manager = declared()
        await runtime.start(manager)
        with pytest.raises(ConfigError, match=message):
            await runtime.start(StateLayer(factors, manager, space=SPACE))

    run_virtual(main)


def test_a_layer_may_cover_some_of_the_model_s_factors():
    async def main(runtime):
        manager = declared()
        await runtime.start(manager)
        await runtime.start(StateLayer([StateFactor("person", ["Person"])], manager, space=SPACE))
        states = probe(runtime.channel("state/state", State, retain=True))
        manager.sense("Person", True)
        assert states[-1].index == 1

    run_virtual(main)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StateFactor("f", []), "list of predicates"),
        (lambda: StateFactor("f", "A"), "list of predicates"),
        (lambda: StateFactor("f", ["A", "A"]), "twice"),
        (lambda: StateFactor("f", ["A"], on_violation="last"), "'last'"),
        (lambda: ObservationFactor("f", ["A"]), "at least two events"),
        (lambda: ObservationFactor("f", ["A", "A"]), "twice"),
        (lambda: ObservationFactor("f", ["A", "B"], idle="C"), "'C' of observation factor 'f' is none of A, B"),
        (lambda: ObservationFactor("f", ["A", "B"], idle="A", hold=True), "not both"),
    ],
)
def test_wrong_factors(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


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


def test_two_symbols_at_once_are_a_conflict():
    async def main(runtime):
        manager = declared()
        await runtime.start(manager)
        layer = ObservationLayer([ObservationFactor("d", ["Up", "Down"])], manager)
        await runtime.start(layer)
        seen, faults = probe(runtime.channel("observation/observation", Observation)), probe(runtime.faults)
        manager.occur("Down", "Up")
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
def test_observation_factors_are_checked(factors, message):
    async def main(runtime):
        manager = declared()
        await runtime.start(manager)
        space = Space([Factor("agent0", 2), Factor("agent1", 3)])
        with pytest.raises(ConfigError, match=message):
            await runtime.start(ObservationLayer(factors, manager, space=space))

    run_virtual(main)
