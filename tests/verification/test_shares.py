import enumerated
import numpy as np
import pytest
from random_processes import model_of_rows, random_rows

from mdm.verification import verify

RANDOM = np.random.default_rng(3)
CASES = [random_rows(RANDOM, 5, 2) for _ in range(12)]


@pytest.mark.parametrize("rows", CASES)
def test_the_least_and_the_greatest_share_are_those_of_all_policies(rows):
    model = model_of_rows(rows)
    answer = verify(model, "S(s1 or s2)")
    shares = [enumerated.share(chain, {1, 2}) for chain in enumerated.policies(rows)]
    assert answer.least.value == pytest.approx(float(min(shares)), abs=1e-12)
    assert answer.greatest.value == pytest.approx(float(max(shares)), abs=1e-12)
    for policy, number in zip(answer.policies, (answer.least, answer.greatest), strict=True):
        assert verify(model, "S(s1 or s2)", policy).result.value == pytest.approx(number.value, abs=1e-12)


@pytest.mark.parametrize("size", [3, 1_200])  # by elimination of a dense and of a sparse system
def test_round_and_round_each_state_has_its_share(size):
    rows = [[{(state + 1) % size: 1}] for state in range(size)]
    answer = verify(model_of_rows(rows), "S(s1)", [0] * size)
    assert answer.result.value == pytest.approx(1 / size, rel=1e-12)
    assert answer.result.error < 1e-9


def test_a_share_counts_actions_too():
    model = model_of_rows([[{1: 1}, {0: 1}], [{0: 1}, {0: 1}]])
    assert verify(model, "S(action = a1)").greatest.value == 1
    assert verify(model, "S(s1 and action = a1)").greatest.value == 0.5
    assert verify(model, "S(action = a1)", [0, 1]).result.value == 0.5
