"""Plans: what recurs is found again, is the same, and takes bounded memory."""

from __future__ import annotations

import random

from mdm.logic import Network, network as module, parse


def three() -> Network:
    network = Network()
    for name in "abc":
        network.add_input(name, False)
    network.define("some", parse("a or b"))
    network.define("odd", parse("a xor b xor c"))
    network.add_event("e")
    network.add_event("f")
    network.compile()
    return network


def test_a_change_that_recurs_is_the_same_object_whatever_has_come_of_its_inputs_besides():
    network = three()
    first = network.update((("a", True), ("b", True)))
    assert (first.rising, first.falling) == (("a", "b", "some"), ())
    network.update((("a", False),))
    alone = network.update((("a", True),))  # of the same two only one changes, and the formulas come out otherwise
    assert (alone.rising, alone.falling) == (("a",), ("odd",))
    network.update((("a", False), ("b", False)))
    assert network.update((("a", True), ("b", True))) is first
    network.update((("a", False), ("b", False)))
    network.update((("b", True),))
    part = network.update((("a", True), ("b", True)))
    assert (part.rising, part.falling) == (("a",), ("odd",))


def test_events_recur_alone_and_with_values():
    network = three()
    both = network.update((), ("e", "f"))
    assert both.events == ("e", "f")
    assert network.update((), ("e", "f")) is both
    mixed = network.update((("c", True),), ("f",))
    assert (mixed.rising, mixed.events) == (("c", "odd"), ("f",))
    unchanged = network.update((("c", True),), ("f",))
    assert (unchanged.rising, unchanged.events) == ((), ("f",))


def test_what_recurs_is_forgotten_when_it_becomes_much(monkeypatch):
    monkeypatch.setattr(module, "MOST", 5)
    network, values, draw = three(), dict.fromkeys("abc", False), random.Random(7)
    for _ in range(500):
        given = tuple((name, draw.choice([True, False, None])) for name in draw.sample("abc", draw.randint(1, 3)))
        values.update(given)
        network.update(given, draw.choice([(), (), ("e",)]))
        for name, text in (("some", "a or b"), ("odd", "a xor b xor c")):
            assert network.value(name) is parse(text).evaluate(values)
        assert sum(len(plan.changes) for plan in network._plans.values()) <= 5
