import math
import tracemalloc

import enumerated
import numpy as np
import pytest
from random_processes import model_of_rows, random_rows

from mdm.models.specification import Specification
from mdm.verification import verify
from mdm.verification.choices import Choices
from mdm.verification.reaching import within

TARGET, BEFORE = {1, 2}, {3}


def cases(count, size=5):
    random = np.random.default_rng(7)
    return [random_rows(random, size, 2) for _ in range(count)]


def close(one, two):
    return one == two or abs(float(one) - float(two)) < 1e-12 * max(1.0, abs(float(two)))


@pytest.mark.parametrize("rows", cases(12))
@pytest.mark.parametrize(
    ("text", "of"),
    [
        ("P(reach s1 or s2)", lambda chain: enumerated.reaching(chain, TARGET)),
        ("P(reach s1 or s2 before s3)", lambda chain: enumerated.reaching(chain, TARGET, BEFORE)),
        ("P(always not s1 and not s2)", lambda chain: 1 - enumerated.reaching(chain, TARGET)),
        ("E(steps until s1 or s2)", lambda chain: enumerated.steps(chain, TARGET)),
    ],
)
def test_the_least_and_the_greatest_are_those_of_all_policies(rows, text, of):
    answer = verify(model_of_rows(rows), text)
    all_values = [of(chain) for chain in enumerated.policies(rows)]
    assert close(answer.least.value, min(all_values))
    assert close(answer.greatest.value, max(all_values))
    for policy, number in zip(answer.policies, (answer.least, answer.greatest), strict=True):
        assert close(verify(model_of_rows(rows), text, policy).result.value, number.value)


@pytest.mark.parametrize("rows", cases(6, size=8))
@pytest.mark.parametrize("most", [0, 1, 5])
def test_within_some_steps_all_steps_are_enumerated(rows, most):
    model = model_of_rows(rows)
    answer = verify(model, f"P(reach s1 or s2 within {most} before s3)")
    for policy, number, pick in zip(answer.policies, (answer.least, answer.greatest), (min, max), strict=True):
        wanted = float(enumerated.within(rows, TARGET, BEFORE, most, pick))
        assert number.value == pytest.approx(wanted, abs=1e-15)
        its = verify(model, f"P(reach s1 or s2 within {most} before s3)", policy)
        assert its.result.value == pytest.approx(wanted, abs=1e-14)


def test_stages_end_where_nothing_changes_any_more():
    rows = [[{1: 1}], [{1: 1}], [{2: 1}]]
    model = model_of_rows(rows)
    choices = Choices.of_model(model, Specification.of("P(reach s1)", model).target, None)
    values, worth, stages = within(choices, 1_000_000, greatest=True, kept=True)
    assert values.tolist() == [1, 1, 0]
    assert len(worth) == stages == 3


def test_memory_does_not_grow_with_the_steps_of_a_policy():
    rows = [[{0: 1 - 1e-6, 1: 1e-6}], [{1: 1}], *[[{0: 1}]] * 500]
    model = model_of_rows(rows)
    tracemalloc.start()
    try:
        result = verify(model, "P(reach s1 within 2000)", [0] * len(rows)).result
        assert tracemalloc.get_traced_memory()[1] < 2_000 * 8 * len(rows) / 2
    finally:
        tracemalloc.stop()
    assert result.value == pytest.approx(-math.expm1(2_000 * math.log1p(-1e-6)), rel=1e-9)


def test_where_a_policy_may_stay_for_ever_the_greatest_leaves():
    # Two states go round; only one of them can leave, with a loss.
    rows = [[{1: 1}], [{0: 1}, {2: 0.5, 3: 0.5}], [{2: 1}], [{3: 1}]]
    rows = [[*choices, *[choices[0]] * (2 - len(choices))] for choices in rows]
    answer = verify(model_of_rows(rows), "P(reach s2)")
    assert (answer.least.value, answer.greatest.value) == (0, 0.5)
    assert answer.policies[1].action(1) == 1
    assert verify(model_of_rows(rows), "E(steps until s2 or s3)").least.value == 2
    assert verify(model_of_rows(rows), "E(steps until s2 or s3)").greatest.value == math.inf
