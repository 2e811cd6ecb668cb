"""Monitors against a recursive evaluator of finite traces, and against the enumeration of continuations."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import assume, given, settings, strategies as st
from sentences import refused

from mdm.errors import Error, FormatError
from mdm.logic import Monitor, P

BINARY = ("and", "or", "implies", "xor", "U")


def trees(names, leaves=8):
    """Return formulas as nested tuples of a word and its parts."""
    return st.recursive(
        st.sampled_from([(name,) for name in names] + [("true",), ("false",)]),
        lambda inner: st.one_of(
            st.tuples(st.sampled_from(["not", "X", "F", "G"]), inner),
            st.tuples(st.sampled_from(BINARY), inner, inner),
        ),
        max_leaves=leaves,
    )


def text(tree):
    """Return the text of a tree, with all parentheses."""
    word, *parts = tree
    if not parts:
        return word
    if len(parts) == 1:
        return f"{word} ({text(parts[0])})"
    return f"({text(parts[0])}) {word} ({text(parts[1])})"


def holds(tree, trace, at=0):
    """Whether a formula holds at a place of a finite trace: the definition, read aloud."""
    word, *parts = tree
    behind = range(at, len(trace))
    if word == "X":
        return at + 1 < len(trace) and holds(parts[0], trace, at + 1)
    if word == "F":
        return any(holds(parts[0], trace, place) for place in behind)
    if word == "G":
        return all(holds(parts[0], trace, place) for place in behind)
    if word == "U":
        return any(
            holds(parts[1], trace, end) and all(holds(parts[0], trace, place) for place in range(at, end))
            for end in behind
        )
    if not parts:
        return {"true": True, "false": False}.get(word, trace[at].get(word))
    told = [holds(part, trace, at) for part in parts]
    return {
        "not": lambda: not told[0],
        "and": lambda: told[0] and told[1],
        "or": lambda: told[0] or told[1],
        "xor": lambda: told[0] != told[1],
        "implies": lambda: not told[0] or told[1],
    }[word]()


def names_in(tree):
    return {tree[0]} - {"true", "false"} if len(tree) == 1 else set().union(*map(names_in, tree[1:]))


def valuations(names, values=(False, True)):
    return [dict(zip(names, row, strict=True)) for row in product(values, repeat=len(names))]


def traces(names, *values, most=5):
    return st.lists(st.fixed_dictionaries({name: st.sampled_from(values) for name in names}), min_size=1, max_size=most)


def monitor_of(tree):
    """Return the monitor of a formula; skip one without predicates, and one that is too large."""
    assume(names_in(tree))
    try:
        return Monitor(text(tree))
    except Error:
        assume(False)


@given(trees("abc"), traces("abc", False, True, most=7))
@settings(max_examples=150)
def test_a_formula_holds_of_a_trace(tree, trace):
    hold_against_the_definition(tree, trace)


@pytest.mark.slow
@given(trees("abcd", 12), traces("abcd", False, True, most=9))
@settings(max_examples=1000)
def test_a_formula_holds_of_a_trace_in_a_thousand_examples(tree, trace):
    hold_against_the_definition(tree, trace)


def hold_against_the_definition(tree, trace):
    monitor = monitor_of(tree)
    for end, valuation in enumerate(trace, 1):
        verdict = monitor.update(valuation)
        assert monitor.holds is holds(tree, trace[:end])
        assert verdict in {None, monitor.holds}


def outcomes(tree, trace, names, longest):
    """Return the values that a formula takes over a trace's continuations up to a length."""
    words = (word for length in range(longest + 1) for word in product(valuations(names), repeat=length))
    return {holds(tree, [*trace, *word]) for word in words}


@given(trees("a", 6) | trees("ab", 5), traces("ab", False, True, most=3))
@settings(max_examples=150)
def test_verdicts_are_what_all_continuations_agree_on(tree, trace):
    monitor = monitor_of(tree)
    size = len(monitor.node.table[0])
    assume(size <= (7 if len(monitor.names) == 1 else 5))
    for end, valuation in enumerate(trace, 1):
        found = outcomes(tree, trace[:end], monitor.names, size - 1)  # a state is reached by as many steps, or never
        assert monitor.update(valuation) is (found.pop() if len(found) == 1 else None)


def after(node, formula, valuation):
    """Return the place of a monitor after one more valuation without unknown predicates."""
    monitor = Monitor(formula)
    monitor.node = node
    monitor.update(valuation)
    return monitor.node


@given(trees("a", 5) | trees("ab", 4), traces("ab", False, True, None, most=3))
@settings(max_examples=100)
def test_unknown_predicates_stand_for_all_values_any_number_of_times(tree, trace):
    monitor = monitor_of(tree)
    size = len(monitor.node.table[0])
    lived = [(monitor.node, [])]  # all that may have been, but for traces that led to the same place
    for valuation in trace:
        monitor.update(valuation)
        known = [each for each in valuations(monitor.names) if all(valuation[n] in {None, v} for n, v in each.items())]
        found, latest = {}, lived
        for _ in range(size if len(known) > 1 else 1):
            latest = [(after(node, monitor.formula, each), [*been, each]) for node, been in latest for each in known]
            latest = list({id(node): (node, been) for node, been in latest}.values())
            found |= {id(node): (node, been) for node, been in latest}
        lived = list(found.values())
        verdicts, values = {node.verdict for node, _ in lived}, {holds(tree, been) for _, been in lived}
        assert monitor.verdict is (verdicts.pop() if len(verdicts) == 1 else None)
        assert monitor.holds is (values.pop() if len(values) == 1 else None)


def test_a_monitor_comes_back_to_the_same_place():
    """However long it runs, it holds no more places than there are sets of states."""
    monitor = Monitor("G(a implies F(b)) and F(c)")
    visited = {}
    for number in range(500):
        monitor.update({name: (False, None, True)[number // base % 3] for name, base in (("a", 1), ("b", 3), ("c", 9))})
        visited[id(monitor.node)] = monitor.node
    assert len(visited) <= 2 ** len(monitor.node.table[0])
    assert sorted(map(id, monitor.node.table[2].values())) == sorted(visited)


@given(trees(["a", "G", "robot2/At", 'say "x"']))
def test_a_formula_is_read_as_it_is_written(tree):
    formula = monitor_of(quoted(tree)).formula
    assert Monitor(str(formula)).formula == formula


def quoted(tree):
    """Return a tree with its names as they are written."""
    return (
        (str(P(tree[0])) if tree[0] not in {"true", "false"} else tree[0],)
        if len(tree) == 1
        else (tree[0], *map(quoted, tree[1:]))
    )


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("not a U b", "(not a) U b"),
        ("a U b U c", "a U (b U c)"),
        ("a and b U c or G a and b", "(a and (b U c)) or ((G a) and b)"),
        ("G F a implies X not a", "(G(F(a))) implies (X(not a))"),
        ("F(a) & ! X b", "(F a) and (not X(b))"),
    ],
)
def test_what_binds_most(written, meant):
    assert Monitor(written).formula == Monitor(meant).formula


def test_what_no_progression_says_is_known_from_the_start():
    assert Monitor("G(p) and F(not p)").verdict is False
    assert Monitor("F(p and X q) and G(not q)").verdict is False
    assert Monitor("F(p) or not F(p)").update({"p": False}) is True
    assert Monitor("G(p or X F q)").verdict is None


def test_a_trace_has_no_next_valuation_at_its_end():
    strong, weak = Monitor("X(p or not p)"), Monitor("not X(p)")
    for monitor, told in ((strong, (False, True)), (weak, (True, False))):
        assert [monitor.update({"p": True}), monitor.holds] == [None, told[0]]
        assert [monitor.update({"p": True}), monitor.holds] == [told[1], told[1]]


@pytest.mark.parametrize(
    ("written", "column"),
    [
        ("", 1),
        ("G", 2),
        ("G(p", 4),
        ("p U", 4),
        ("U p", 1),
        ("p q", 3),
        ("p G q", 3),
        ("G(p) $", 6),
        ("X" * 3 + " and", 8),
        ("G " * 101 + "p", 201),
    ],
)
def test_what_is_no_formula_is_refused_at_its_place(written, column):
    with refused(FormatError) as caught:
        Monitor(written)
    assert caught.value.column == column


@pytest.mark.parametrize(
    "written",
    [
        "G true",
        " and ".join(f"F p{number}" for number in range(9)),
        "F(p and " + "X " * 9 + "p)",
        " and ".join(f"(F(p and X(q or {'X ' * n} p)) or G(q or X F({'X ' * n} q)))" for n in range(1, 12)),
    ],
)
def test_what_is_too_large_is_refused(written):
    with refused(Error):
        Monitor(written)
