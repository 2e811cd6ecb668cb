"""All numbers of decision processes, random and of the field, and of their policies against Storm's fractions."""

from __future__ import annotations

import functools
import math
import warnings
from fractions import Fraction

import numpy as np
import pytest
from random_processes import model_of_rows, random_rows, under
from verification.field import FIELD, evenly, explored
from verification.storm import answers, interpreter

from mdm.errors import ConfigError, ModelWarning
from mdm.models.specification import Specification
from mdm.policies import DeterministicPolicy, FiniteStateController
from mdm.verification import shield, verify
from mdm.verification.supports import Supports

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ASKED = [
    ("P(reach s1 or s2)", 'P{}=? [F "x"]'),
    ("P(reach s1 or s2 before s3 or s4)", 'P{}=? [!"y" U "x"]'),
    ("P(reach s1 or s2 within 7)", 'P{}=? [F<=7 "x"]'),
    ("P(reach s1 or s2 before s3 or s4 within 3)", 'P{}=? [!"y" U<=3 "x"]'),
    ("P(always not (s1 or s2))", 'P{}=? [G !"x"]'),
    ("E(steps until s1 or s2)", 'R{{"steps"}}{}=? [F "x"]'),
    ("S(s1 or s2 or s3)", 'LRA{}=? ["z"]'),
]


@pytest.fixture(scope="module")
def storm(tmp_path_factory):
    return interpreter(tmp_path_factory.getbasetemp().parent)


def question(rows, *ends, labels=None, asked=ASKED):
    return {
        "rows": [[[(after, str(chance)) for after, chance in choice.items()] for choice in state] for state in rows],
        "start": 0,
        "labels": labels or {"x": [1, 2], "y": [3, 4], "z": [1, 2, 3]},
        "formulas": [formula.format(end) for _, formula in asked for end in ends],
    }


OF_FIELD = [("s1 or s2 or s3", "x* or y*"), ("s1 or s2", "x*"), ("s3 or s4", "y*")]


@pytest.mark.parametrize("name", FIELD)
def test_numbers_of_the_field(storm, name):
    """Least and greatest are Storm's, and so are those of the policies that attain them."""
    process = FIELD[name]()
    model, rows = process.model(), process.rows
    labels = {"x": process.reached, "y": process.avoided, "z": process.reached + process.avoided}
    cases, asked = [], [question(rows, "min", "max", labels=labels)]
    for each in ASKED:
        text = functools.reduce(lambda text, change: text.replace(*change), OF_FIELD, each[0])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)  # nothing in the tiger's model is avoided
            answer = verify(model, text)
            for number, policy in zip((answer.least, answer.greatest), answer.policies, strict=True):
                cases.append((number, verify(model, text, policy).result, None))
                if policy.horizon is None:
                    actions = [policy.action(state) for state in range(len(rows))]
                    cases[-1] = (*cases[-1][:2], len(asked))
                    asked.append(question(under(rows, actions), "min", labels=labels, asked=[each]))
    told = answers(storm, asked)
    for (best, its, chain), wanted in zip(cases, told[0], strict=True):
        assert_close(best, wanted)
        assert_close(its, wanted)
        if chain is not None:
            assert_close(its, told[chain][0])


def assert_close(number, text):
    wanted = math.inf if text == "inf" else float(Fraction(text))
    assert number.value == wanted or abs(number.value - wanted) <= number.error + 1e-15 * max(1, abs(wanted))
    assert number.error <= 1e-8 * max(1, 0 if math.isinf(wanted) else wanted)


@pytest.mark.parametrize("seed", range(5))
def test_numbers_of_random_processes(storm, seed):
    random = np.random.default_rng(seed)
    made = [random_rows(random, int(random.integers(5, 30)), int(random.integers(2, 4))) for _ in range(10)]
    chosen = [random.integers(0, len(rows[0]), len(rows)).tolist() for rows in made]
    asked = [question(rows, "min", "max") for rows in made]
    asked += [question(under(rows, actions), "min") for rows, actions in zip(made, chosen, strict=True)]
    told = answers(storm, asked)
    for place, (rows, actions) in enumerate(zip(made, chosen, strict=True)):
        model = model_of_rows(rows)
        both, one = iter(told[place]), iter(told[len(made) + place])
        for text, _ in ASKED:
            answer = verify(model, text)
            assert_close(answer.least, next(both))
            assert_close(answer.greatest, next(both))
            assert_close(verify(model, text, actions).result, next(one))


def test_numbers_of_random_controllers(storm):
    random = np.random.default_rng(9)
    cases, asked = [], []
    for _ in range(30):
        rows = random_rows(random, int(random.integers(5, 12)), 2)
        nodes, seen = int(random.integers(1, 4)), random.integers(0, 2, len(rows)).tolist()
        actions = random.integers(0, 2, nodes).tolist()
        after = random.integers(0, nodes, (nodes, 2)).tolist()
        pairs = [
            [{after[node][seen[state]] * len(rows) + state: chance for state, chance in choices[actions[node]].items()}]
            for node in range(nodes)
            for choices in rows
        ]
        its = question(pairs, "min")
        its["labels"] = {
            name: [node * len(rows) + state for node in range(nodes) for state in states]
            for name, states in its["labels"].items()
        }
        asked.append(its)
        cases.append((rows, seen, FiniteStateController(actions, after, 2)))
    for (rows, seen, controller), told in zip(cases, answers(storm, asked), strict=True):
        model = model_of_rows(rows, seen)
        with warnings.catch_warnings():
            warnings.simplefilter("error", ModelWarning)
            for (text, _), number in zip(ASKED, told, strict=True):
                assert_close(verify(model, text, controller).result, number)


@pytest.mark.parametrize("seed", range(5))
def test_shields_win_where_storm_does(storm, seed):
    """An action is allowed if it keeps to the states where X is reached with a least probability of 0.

    What the shield keeps is as probable as it can be in the process of these actions alone.
    """
    random = np.random.default_rng(100 + seed)
    made = [random_rows(random, int(random.integers(5, 30)), 3) for _ in range(40)]
    asked = [question(rows) | {"formulas": ['Pmin=? [F "x"]'], "everywhere": True} for rows in made]
    winning = [[number == "0" for number in told[0]] for told in answers(storm, asked)]
    shields, masked = [], []
    for rows, wins in zip(made, winning, strict=True):
        safe = [[all(wins[after] for after in choice) for choice in choices] for choices in rows]
        policy = DeterministicPolicy(random.integers(0, 3, len(rows)).tolist(), 3)
        for keep in (None, "reach s3 or s4"):
            try:
                shielded = shield(policy, model_of_rows(rows), avoid="s1 or s2", keep=keep)
            except ConfigError as error:
                assert wins[0] == (error.key == "keep" or "stand" in str(error)), error
                shielded = None
            else:
                assert wins[0]
                allowed = [shielded.allowed(state).tolist() for state in range(len(rows))]
                assert [its for its, win in zip(allowed, wins, strict=True) if win] == [
                    its for its, win in zip(safe, wins, strict=True) if win
                ]
                assert verify(model_of_rows(rows), "P(reach s1 or s2)", shielded).result.value == 0
            if keep and wins[0]:
                its = [
                    [choice for choice, good in zip(choices, may, strict=True) if good or not win]
                    for choices, may, win in zip(rows, safe, wins, strict=True)
                ]
                masked.append(question(its) | {"formulas": ['Pmax=? [F "y"]']})
                shields.append((rows, shielded))
    assert len(shields) > 10
    for (rows, shielded), (wanted,) in zip(shields, answers(storm, masked), strict=True):
        if shielded is None:
            assert wanted == "0"
        else:
            assert_close(verify(model_of_rows(rows), "P(reach s3 or s4)", shielded).result, wanted)


@pytest.mark.parametrize("seed", range(5))
def test_supports_win_where_storm_does(storm, seed):
    """A belief's support is a state of a process, in which what is seen next comes by chance."""
    random = np.random.default_rng(200 + seed)
    cases, asked = [], []
    for _ in range(20):
        rows = random_rows(random, int(random.integers(5, 12)), 3)
        seen = random.integers(0, 2, len(rows)).tolist()

        def moves(support, rows=rows, seen=seen):
            choices = []
            for action in range(3):
                after = {each for state in support for each in rows[state][action]}
                parts = {frozenset(each for each in after if seen[each] == told) for told in (0, 1)} - {frozenset()}
                choices.append(evenly(sorted(parts, key=sorted)))
            return choices

        supports = []
        process = explored(frozenset({0}), lambda at, all_=supports: all_.append(at) or moves(at), {1, 2}.intersection)
        cases.append((rows, seen, supports, process.rows))
        labels = {"x": process.reached}
        asked.append(question(process.rows, labels=labels) | {"formulas": ['Pmin=? [F "x"]'], "everywhere": True})
    won = 0
    for (rows, seen, supports, choices), (told,) in zip(cases, answers(storm, asked), strict=True):
        wins = [number == "0" for number in told]
        model = model_of_rows(rows, seen)
        found = Supports(model, Specification.of("P(reach s1 or s2)", model).target)
        for its, keeps, allowed in zip(
            np.split(found.states, found.starts[1:-1]), found.keeps, found.allowed, strict=True
        ):
            place = supports.index(frozenset(its.tolist()))
            assert keeps == wins[place]
            if keeps:
                assert allowed.tolist() == [all(wins[after] for after in choice) for choice in choices[place]]
                won += 1
        assert wins[0] == found.keeps[found.first].all()
    assert won > 10
