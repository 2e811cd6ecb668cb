"""Joint states, violations, and checks against models."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import (
    ActorFailure,
    ConfigError,
    PredicateManager,
    StateFactor,
    StateLayer,
)
from mdm.messages import State
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


@given(
    st.lists(st.integers(2, 3), min_size=1, max_size=3),
    st.sampled_from([None, "first", "hold"]),
    st.integers(0, 1 << 30).map(Random),
)
def test_joint_states_that_recur_follow_from_the_predicates_alone(shape, on_violation, random):
    async def main(runtime):
        manager, factors = state_layer(shape, on_violation=on_violation)
        await runtime.start(manager)
        layer = StateLayer(factors, manager)
        await runtime.start(layer)
        states = probe(runtime.channel("state/state", State, retain=True))
        names = [name for factor in factors for name in factor.predicates]
        known, digits, violations, odd = dict.fromkeys(names), [None] * len(shape), 0, [None] * len(shape)
        last = None
        for _ in range(300):
            values = random.choices([True, False, None], [10, 15, 3], k=2)
            told = dict(zip(random.choices(names, k=2), values, strict=True))
            changed = {name for name, value in told.items() if known[name] is not value}
            with manager.batch():
                for name, value in told.items():
                    manager.sense(name, value)
            known.update(told)
            for at, factor in enumerate(factors):
                values = [known[name] for name in factor.predicates]
                if changed.isdisjoint(factor.predicates):
                    continue
                if len(values) == 1:
                    digits[at] = None if values[0] is None else int(values[0])
                    continue
                single, unclear = values.count(True) == 1, True not in values and None in values
                if not single and not unclear:
                    true = [value is True for value in values]
                    violations += true != odd[at]
                    odd[at] = true
                else:
                    odd[at] = None
                if unclear:
                    digits[at] = None
                elif single or (True in values and on_violation != "hold"):
                    digits[at] = values.index(True)
            now = None if None in digits else int(np.ravel_multi_index(digits, shape))
            assert (states[-1].index if states else None) == now
            if now is not None:
                assert states[-1].values == tuple(digits)
            assert (len(states) > 0) == (last is not None or now is not None)
            assert layer.violations == violations
            last = now if now is not None else last

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

    with refused(ActorFailure):
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
        ([StateFactor("person", ["Person"])], "the model's state factor 'room' has no predicates"),
        ([StateFactor("room", ["InA", "InB", "InC"])], "the model's state factor 'person' has no predicates"),
    ],
)
def test_state_factors_are_checked_against_the_model(factors, message, declared):
    async def main(runtime):
        await runtime.start(declared)
        with pytest.raises(ConfigError, match=message):
            await runtime.start(StateLayer(factors, declared, space=SPACE))

    run_virtual(main)


@pytest.mark.parametrize("positive", [0, 1])
def test_one_predicate_stands_for_the_index_that_it_is_given_for(positive):
    factor = StateFactor("a", {positive: "X"})
    assert factor.truth(positive) == {"X": True}

    async def main(runtime):
        manager = PredicateManager()
        manager.sensor("X", initial=True)
        await runtime.start(manager)
        await runtime.start(StateLayer([factor], manager))
        states = probe(runtime.channel("state/state", State, retain=True))
        manager.sense("X", False)
        assert [state.index for state in states] == [positive, 1 - positive]

    run_virtual(main)


def test_a_layer_that_covers_some_factors_tells_these_alone_whenever_they_change(declared):
    async def main(runtime):
        factors = [StateFactor("room", ["InA", "InB"]), StateFactor("person", ["Person"], owner="other")]
        layer = StateLayer(factors, declared, name="robot")
        layer.cover(["room"])
        whole = probe(runtime.channel("robot/state", State, retain=True))
        part = probe(runtime.channel("robot/own_state", State, retain=True))
        await runtime.start(declared)
        await runtime.start(layer)
        declared.sense("Person", True)
        declared.sense("InA", True)
        declared.sense("InB", False)
        with declared.batch():
            declared.sense("InA", False)
            declared.sense("InB", True)
        declared.sense("InA", None)
        declared.sense("InB", None)
        assert whole == []
        assert [(state.index, state.values) for state in part] == [
            (None, (0, None)),
            (None, (1, None)),
            (None, (None, None)),
        ]
        assert layer.unknown() == ("InA", "InB", "person (of other)")

    run_virtual(main)
