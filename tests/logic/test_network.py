"""Networks of predicates, against a plain recomputation."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import given, strategies as st

from mdm.errors import Error
from mdm.logic import Formula, Monitor, Network, P, parse
from mdm.logic.formula import Constant

values = st.sampled_from([True, False, None])


class Plain:
    """The same network, recomputed from nothing at each update: an independent reading of what each kind means."""

    def __init__(self, inputs, events, nodes):
        self.inputs = dict(inputs)
        self.events = list(events)
        self.nodes = nodes  # in dependency order: (kind, name, formulas)
        self.latched = {name: False for kind, name, _ in nodes if kind == "latch"}
        self.elapsed = {name: False for kind, name, _ in nodes if kind == "hold"}
        self.before = {name: None for kind, name, _ in nodes if kind == "rise"}
        self.visible = {}

    def untouched(self, formulas, now, raised):
        names = formulas[0].names | formulas[1].names
        return bool(self.visible) and not any(
            name in raised or (name in self.visible and self.visible[name] != now[name]) for name in names
        )

    def update(self, inputs, events, elapsed):
        self.inputs.update(inputs)
        for name in elapsed:
            self.elapsed[name] = True
        now = {**self.inputs, **{name: name in events for name in self.events}}
        raised = list(events)
        for kind, name, formulas in self.nodes:
            first = formulas[0].evaluate(now)
            if kind == "define":
                now[name] = first
            elif kind == "latch" and self.untouched(formulas, now, raised):
                now[name] = self.latched[name]  # judged only when something in its formulas happens
            elif kind == "latch":
                if formulas[1].evaluate(now) is True:
                    self.latched[name] = False
                elif first is True:
                    self.latched[name] = True
                now[name] = self.latched[name]
            elif kind == "hold":
                if first is not True:
                    self.elapsed[name] = False
                now[name] = self.elapsed[name] if first is True else first
            else:
                now[name] = first is True and self.before[name] is not True
                if now[name]:
                    raised.append(name)
        # After the instant events are over, and formulas over them are judged without them.
        rises = {name for kind, name, _ in self.nodes if kind == "rise"}
        later = {**now, **dict.fromkeys((*self.events, *rises), False)}
        for kind, name, formulas in self.nodes:
            if kind == "rise":
                self.before[name] = formulas[0].evaluate(later)
        visible = {name: value for name, value in now.items() if name not in self.events and name not in rises}
        changed = {name: value for name, value in visible.items() if self.visible.get(name, "none") != value}
        self.visible = visible
        return changed, set(raised)


def formula_over(draw, names):
    atoms = st.sampled_from(sorted(names)).map(P) | st.booleans().map(Constant)
    tree = st.recursive(
        atoms,
        lambda inner: (
            inner.map(lambda f: ~f)
            | st.tuples(inner, inner, st.sampled_from("&|^>")).map(
                lambda t: {"&": t[0] & t[1], "|": t[0] | t[1], "^": t[0] ^ t[1], ">": t[0] >> t[1]}[t[2]]
            )
        ),
        max_leaves=5,
    )
    return draw(tree)


@st.composite
def networks(draw):
    inputs = {f"in{i}": draw(values) for i in range(draw(st.integers(1, 4)))}
    events = [f"ev{i}" for i in range(draw(st.integers(0, 3)))]
    nodes: list[tuple[str, str, tuple[Formula, ...]]] = []
    predicates, occurrences = set(inputs), set(events)
    for index in range(draw(st.integers(0, 8))):
        kind = draw(st.sampled_from(["define", "define", "latch", "hold", "rise"]))
        name = f"{kind}{index}"
        usable = predicates | (occurrences if kind in {"latch", "rise"} else set())
        formulas = tuple(formula_over(draw, usable) for _ in range(2 if kind == "latch" else 1))
        nodes.append((kind, name, formulas))
        (occurrences if kind == "rise" else predicates).add(name)
    order = draw(st.permutations(nodes))
    return inputs, events, nodes, order


def build(inputs, events, order):
    network = Network()
    for name, value in inputs.items():
        network.add_input(name, value)
    for name in events:
        network.add_event(name)
    for kind, name, formulas in order:
        if kind == "latch":
            network.latch(name, set=formulas[0], reset=formulas[1])
        else:
            getattr(network, kind)(name, formulas[0])
    return network


@given(networks(), st.data())
def test_agrees_with_a_plain_recomputation(described, data):
    inputs, events, nodes, order = described
    network = build(inputs, events, order)
    plain = Plain(inputs, events, nodes)
    holds = [name for kind, name, _ in nodes if kind == "hold"]
    change = network.compile()
    expected, raised = plain.update({}, [], [])
    assert network.values() == expected
    assert set(change.events) == raised
    armed = set(change.armed)
    for _ in range(data.draw(st.integers(1, 12))):
        new = data.draw(st.lists(st.tuples(st.sampled_from(sorted(inputs)), values), max_size=3))
        fired = data.draw(st.lists(st.sampled_from(events), max_size=2, unique=True)) if events else []
        elapsed = sorted(name for name in armed if data.draw(st.booleans())) if holds else []
        as_given = data.draw(st.sampled_from([list, tuple]))  # of tuples what recurs is remembered
        change = network.update(as_given(new), as_given(fired), elapsed)
        expected, raised = plain.update(dict(new), fired, elapsed)
        seen = {}
        if change is not None:
            seen = dict.fromkeys(change.rising, True) | dict.fromkeys(change.falling, False)
            seen |= dict.fromkeys(change.unknown)
            armed |= set(change.armed)
            armed -= set(change.disarmed)
        assert seen == expected
        assert set(change.events if change else ()) == raised
        assert network.values() == plain.visible
        armed -= set(elapsed)


def test_glitch_free():
    """A derived predicate that two paths reach sees both at once: 'a and not a' is never true."""
    network = Network()
    network.add_input("a", False)
    network.define("nota", "not a")
    network.define("never", "a and nota")
    network.rise("glitch", "never")
    network.compile()
    for value in (True, False, None, True):
        change = network.update([("a", value)])
        assert change is not None
        assert "never" not in change.rising
        assert change.events == ()


@given(st.lists(st.lists(st.tuples(st.sampled_from("abc"), values), max_size=3).map(tuple), max_size=8))
def test_a_monitor_takes_each_valuation_that_an_update_brings_about(updates):
    """Also of derived predicates; what changes others alone is none."""
    formula, network = "G(a implies X both) and (not b U a)", Network()
    for name in "abc":
        network.add_input(name, False)
    network.monitor("watched", formula)
    network.define("both", "a and b")
    network.define("last", "not watched or c")
    network.compile()
    alone = Monitor(formula)
    before = None
    for inputs in ((), *updates):
        change = network.update(inputs)
        told = network.values()
        if (valuation := {name: told[name] for name in alone.names}) != before:
            alone.update(valuation)
            before = valuation
        assert network.monitors["watched"].verdict is alone.verdict
        assert told["watched"] is (alone.verdict is not False)
        assert change is None or "watched" not in change.unknown


def test_hold_waits_falls_at_once_and_starts_anew():
    network = Network()
    network.add_input("a", False)
    network.hold("held", "a")
    network.compile()
    assert network.update([("a", True)]).armed == ("held",)
    assert network.value("held") is False
    assert network.update([], [], ["held"]).rising == ("held",)
    change = network.update([("a", False)])
    assert (change.falling, change.disarmed) == (("a", "held"), ("held",))
    assert network.update([("a", True)]).armed == ("held",)
    assert network.value("held") is False
    assert network.update([("a", None)]).unknown == ("a", "held")


def test_latch_remembers_and_reset_wins():
    network = Network()
    for name in ("on", "off"):
        network.add_event(name)
    network.latch("lamp", set="on", reset="off")
    network.compile()
    assert network.update([], ["on"]).rising == ("lamp",)
    assert network.update([], ["on"]).rising == ()
    assert network.update([], ["on", "off"]).falling == ("lamp",)


def test_an_event_whose_formula_is_true_at_first_occurs():
    network = Network()
    network.add_input("a", True)
    network.rise("up", "a")
    assert network.compile().events == ("up",)


def test_nothing_changes_where_the_value_is_the_same():
    network = Network()
    network.add_input("a", True)
    network.define("b", "a or true")
    network.compile()
    assert network.update([("a", True)]) is None
    assert network.update([("a", False)]).falling == ("a",)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([("b", True)],), "'b' cannot be set from outside: it is derived"),
        (([("x", True)],), "no predicate or event 'x'"),
        (([("a", True), ("nope", True)],), "'nope'"),
        (([], ["a"]), "'a' cannot be raised"),
        (([], ["up"]), "'up'"),
    ],
)
def test_wrong_updates_are_refused_and_change_nothing(arguments, message):
    network = Network()
    network.add_input("a", False)
    network.define("b", parse("not a"))
    network.rise("up", "b and a")
    network.compile()
    before = network.values()
    with pytest.raises(Error, match=message):
        network.update(*arguments)
    assert network.values() == before


def test_a_chain_of_thousands_of_predicates_takes_no_square_of_it():
    length = 3000
    network = Network()
    network.add_input("p0", False)
    for place in range(1, length):
        network.define(f"p{place}", ~P(f"p{place - 1}"))
    tracemalloc.start()
    network.compile()
    change = network.update([("p0", True)])
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(change.rising) + len(change.falling) == length
    assert network.value(f"p{length - 1}") is False
    assert used < 50e6  # all that depends on each one took 380 MB
