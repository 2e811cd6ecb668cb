"""Symbols wired by name: in whatever order they are given, the model's order is what is published."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import (
    ConfigError,
    Ensemble,
    ObservationFactor,
    ObservationLayer,
    PredicateManager,
    StateFactor,
    StateLayer,
    bind,
)
from mdm.messages import Belief, Observation, State
from mdm.models import POMDP, Factor, Space
from mdm.policies import ConstantPolicy
from mdm.testing import probe, run_virtual

ROOMS = Space([Factor("room", ["a", "b", "c"]), Factor("person", ["no", "yes"])])
UNNAMED = Space.single("state", ["low", "middle", "high"])


def declared(predicates=(), events=()):
    manager = PredicateManager()
    for name in predicates:
        manager.sensor(name)
    for name in events:
        manager.event(name)
    return manager


@st.composite
def named_spaces(draw):
    sizes = draw(st.lists(st.integers(2, 4), min_size=1, max_size=3))
    return Space(Factor(f"f{i}", [f"s{i}{value}" for value in range(size)]) for i, size in enumerate(sizes))


def shuffled(data, mapping):
    return dict(data.draw(st.permutations(list(mapping.items()))))


@given(named_spaces(), st.data())
def test_states_by_symbol_are_the_model_s_in_any_order(space, data):
    sources = {f.name: {symbol: f"Is_{symbol}" for symbol in f.names} for f in space.factors}
    alone = {f.name: data.draw(st.sampled_from(f.names)) for f in space.factors if len(f) == 2}
    alone = {name: symbol for name, symbol in alone.items() if data.draw(st.booleans())}
    for name, symbol in alone.items():
        sources[name] = {symbol: f"Is_{symbol}"}
    manager = declared(predicates=[source for wires in sources.values() for source in wires.values()])
    factors = [StateFactor(name, shuffled(data, wires)) for name, wires in shuffled(data, sources).items()]

    async def main(runtime):
        await runtime.start(manager)
        await runtime.start(StateLayer(factors, manager, space=space))
        states = probe(runtime.channel("state/state", State, retain=True))
        for _ in range(5):
            components = [data.draw(st.integers(0, len(factor) - 1)) for factor in space.factors]
            with manager.batch():
                for factor, component in zip(space.factors, components, strict=True):
                    for symbol, source in sources[factor.name].items():
                        manager.sense(source, factor.names[component] == symbol)
            assert states[-1].values == tuple(components)
            assert states[-1].index == np.ravel_multi_index(components, space.shape)

    run_virtual(main)


@given(named_spaces(), st.data())
def test_observations_by_symbol_are_the_model_s_in_any_order(space, data):
    events = {factor.name: {symbol: f"Saw_{symbol}" for symbol in factor.names} for factor in space.factors}
    idle = {factor.name: data.draw(st.none() | st.sampled_from(factor.names)) for factor in space.factors}
    for name, symbol in idle.items():
        if symbol is not None and data.draw(st.booleans()):
            del events[name][symbol]  # it stands for "no event" alone
    manager = declared(events=[event for wires in events.values() for event in wires.values()])
    factors = [
        ObservationFactor(name, shuffled(data, wires), idle=idle[name])
        for name, wires in shuffled(data, events).items()
    ]

    async def main(runtime):
        await runtime.start(manager)
        await runtime.start(ObservationLayer(factors, manager, space=space))
        seen = probe(runtime.channel("observation/observation", Observation))
        for _ in range(5):
            symbols = [data.draw(st.none() | st.sampled_from(factor.names)) for factor in space.factors]
            given_ = [(f, s) for f, s in zip(space.factors, symbols, strict=True) if s in events[f.name]]
            if given_:
                manager.occur(*(events[factor.name][symbol] for factor, symbol in given_))
                now = dict.fromkeys((f.name for f in space.factors), None) | idle | {f.name: s for f, s in given_}
                expected = tuple(None if now[f.name] is None else f.names.index(now[f.name]) for f in space.factors)
                assert seen[-1].values == expected
                known = None not in expected
                assert seen[-1].index == (np.ravel_multi_index(expected, space.shape) if known else None)

    run_virtual(main)


def test_a_camera_wired_by_name_gives_the_right_belief():
    """The door of 0.5, seen open by a camera that is right in 86 of 100: as a list in the wrong order, it was shut."""
    model = POMDP(
        [np.eye(2)],
        [[[0.86, 0.14], [0.14, 0.86]]],
        np.zeros((2, 1)),
        discount=0.9,
        states=["open", "closed"],
        actions=["look"],
        observation_names=Space([Factor("camera", ["open", "closed"])]),
    )
    manager = declared(events=["SawClosed", "SawOpen"])
    robot = Ensemble(
        "robot",
        model=model,
        policy=ConstantPolicy(0, 1, 2),
        predicates=manager,
        observations=[ObservationFactor("camera", {"closed": "SawClosed", "open": "SawOpen"})],
        actions={"look": bind(lambda: None)},
    )

    async def main(runtime):
        await runtime.start(robot)
        beliefs = probe(runtime.channel("robot/belief", Belief))
        manager.occur("SawOpen")
        return beliefs[-1].probabilities[0]

    assert run_virtual(main) == pytest.approx(0.86)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (StateFactor("room", {"a": "P", "b": "Q", "d": "R"}), "no symbol 'd'.*; nothing stands for the symbol 'c'"),
        (StateFactor("room", {"a": "P", "b": "Q"}), "nothing stands for the symbol 'c'"),
        (StateFactor("room", {"a": "P"}), "nothing stands for the symbol 'b' or 'c'"),
        (StateFactor("room", {"a": "P", "0": "Q", "c": "R"}), "the symbol 'a' is given twice; nothing stands .* 'b'"),
        (StateFactor("person", {"yess": "P"}), "no symbol 'yess'; did you mean 'yes'"),
        (StateFactor("person", {"no": "P", "yes": "Q", "perhaps": "R"}), "no symbol 'perhaps'"),
        (StateFactor("persn", ["P"]), "no state factor 'persn'; did you mean 'person'?"),
        (StateFactor("door", ["P"]), "no state factor 'door'; it has room, person"),
        (StateFactor("room", ["P", "Q"]), "'room' has 2 values, but the model's has 3"),
    ],
)
def test_state_wiring_is_checked_both_ways(factor, message):
    others = {"room": ["S", "T", "U"], "person": ["S"]}
    rest = [StateFactor(name, given) for name, given in others.items() if name != factor.name]
    factors = [factor, *(rest if factor.name in others else rest[:1])]
    layer = StateLayer(factors, declared(predicates="PQRSTU"), space=ROOMS)
    assert [problem.key for problem in layer.problems()] == [f"ensembles.state.states.{factor.name}"]
    with pytest.raises(ConfigError, match=message):
        raise next(layer.problems())


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ([ObservationFactor("room", {"a": "P", "b": "Q", "c": "R"})], "observation factor 'person' has no events"),
        (
            [ObservationFactor("room", {"a": "P", "b": "Q", "c": "R"}), ObservationFactor("human", ["S", "T"])],
            "the model has no observation factor 'human'",
        ),
        (
            [ObservationFactor("room", {"a": "P", "b": "Q"}), ObservationFactor("person", ["S", "T"])],
            "'room': nothing stands for the symbol 'c'",
        ),
        (
            [ObservationFactor("room", {"a": "P", "b": "Q"}, idle="d"), ObservationFactor("person", ["S", "T"])],
            "no symbol 'd'.*; nothing stands for the symbol 'c'",
        ),
        ([ObservationFactor("person", ["S", "T"]), ObservationFactor("person", ["P", "Q"])], "two observation factors"),
    ],
)
def test_observation_wiring_is_checked_both_ways(factors, message):
    layer = ObservationLayer(factors, declared(events="PQRST"), space=ROOMS)
    problems = list(layer.problems())
    assert len(problems) == 1
    with pytest.raises(ConfigError, match=message):
        raise problems[0]


def test_a_model_that_names_no_factors_takes_any_name_and_checks_the_symbols():
    manager = declared(predicates="PQR")
    layer = StateLayer([StateFactor("fill", {"high": "P", "low": "Q", "middle": "R"})], manager, space=UNNAMED)
    assert not list(layer.problems())
    assert layer.factors[0].predicates == ("Q", "R", "P")
    wrong = StateLayer([StateFactor("fill", {"high": "P", "low": "Q", "mid": "R"})], manager, space=UNNAMED)
    assert "nothing stands for the symbol 'middle'" in str(next(wrong.problems()))


def test_several_factors_that_make_up_one_go_by_order():
    manager = declared(predicates="PQ")
    space = Space.single("state", 4)
    assert not list(StateLayer([StateFactor("a", ["P"]), StateFactor("b", ["Q"])], manager, space=space).problems())
    mapped = StateLayer([StateFactor("a", ["P"]), StateFactor("b", {"1": "Q"})], manager, space=space)
    assert [problem.key for problem in mapped.problems()] == ["ensembles.state.states.b"]
    few = StateLayer([StateFactor("a", ["P"])], manager, space=space)
    assert "'a' has 2 values, but the model's has 4" in str(next(few.problems()))


def test_without_a_model_the_order_of_a_mapping_counts():
    factor = StateFactor("door", {"open": "P", "closed": "Q"})
    assert [(wire.symbol, wire.source) for wire in factor.wires()] == [("open", "P"), ("closed", "Q")]
    wires = StateFactor("person", {"yes": "P"}).wires()
    assert [(wire.symbol, wire.source) for wire in wires] == [("not yes", "not P"), ("yes", "P")]


@pytest.mark.parametrize(
    "make",
    [
        lambda: StateFactor("f", {"a": 1}),
        lambda: StateFactor("f", {1.5: "A"}),
        lambda: StateFactor("f", [True]),
        lambda: StateFactor("f", {}),
        lambda: StateFactor("f", None),
        lambda: ObservationFactor("f", {"a": "A"}),
        lambda: ObservationFactor("f", {"a": "A", "b": "A"}),
        lambda: ObservationFactor("f", {"a"}),
    ],
)
def test_what_is_no_wiring(make):
    with refused(ConfigError):
        make()


def test_the_wiring_is_told():
    manager = declared(predicates="PQR", events=["Seen"])
    states = StateLayer(
        [StateFactor("person", {"no": "P"}), StateFactor("room", {"b": "Q", "a": "R", "c": "S"})], manager, space=ROOMS
    )
    assert [wire[:3] for wire in states.wires()] == [
        ("room", "a", "R"),
        ("room", "b", "Q"),
        ("room", "c", "S"),
        ("person", "no", "P"),
        ("person", "yes", "not P"),
    ]
    listed = ObservationLayer([ObservationFactor("eye", ["Seen", "Lost"], idle="Lost")], manager)
    assert listed.wires() == (("eye", "0", "Seen", False), ("eye", "1", None, True))


@pytest.mark.parametrize("kind", [StateFactor, ObservationFactor])
@pytest.mark.parametrize(
    "wires",
    [{7: "X", 0: "Y"}, {1: "X", 2: "Y"}, {0: "X", -1: "Y"}, {False: "X", True: "Y"}, {0: "X", "one": "Y"}],
)
def test_what_is_no_index_is_refused(kind, wires):
    with refused(ConfigError):
        kind("a", wires)


@pytest.mark.parametrize("kind", [StateFactor, ObservationFactor])
@pytest.mark.parametrize("name", [5, None, "", True])
def test_factors_are_called_by_a_text(kind, name):
    with refused(ConfigError):
        kind(name, ["Up", "Down"])
