from unittest.mock import patch

import numpy as np
import pytest
from scipy.sparse.linalg import bicgstab, splu

from mdm.models.matrices import csr
from mdm.verification import choices, optimum as module
from mdm.verification.optimum import optimum


def line(size, up):
    """Return a gambler's walk on a line that is left at both ends, and the probability of leaving it above."""
    moves = np.diag(np.full(size - 1, up), 1) + np.diag(np.full(size - 1, 1 - up), -1)
    ratio = (1 - up) / up
    places = np.arange(1, size + 1)
    above = places / (size + 1) if ratio == 1 else (1 - ratio**places) / (1 - ratio ** (size + 1))
    return csr(moves), above


@pytest.mark.parametrize(("size", "up"), [(3, 0.5), (50, 0.4), (1_000, 0.5), (1_000, 0.6)])
def test_a_walk_on_a_line(size, up):
    moves, above = line(size, up)
    constant = np.zeros(size)
    constant[-1] = up
    found = optimum(moves, np.arange(size), constant, greatest=True)
    assert np.abs(found.values - above).max() <= found.error <= 1e-8


@pytest.mark.parametrize("greatest", [True, False])
def test_the_best_of_two_walks(greatest):
    size = 40
    walks = [line(size, up)[0].toarray() for up in (0.3, 0.6)]
    moves = csr(np.stack(walks, axis=1).reshape(2 * size, size))
    constant = np.zeros(2 * size)
    constant[-2:] = 0.3, 0.6
    found = optimum(moves, np.repeat(np.arange(size), 2), constant, greatest=greatest)
    assert found.values == pytest.approx(line(size, 0.6 if greatest else 0.3)[1], abs=1e-11)
    assert (found.chosen % 2 == greatest).all()


def test_a_way_that_failed_for_one_policy_is_not_tried_for_the_next():
    size = 500
    walks = [line(size, up)[0].toarray() for up in (0.5, 0.499)]
    moves = csr(np.stack(walks, axis=1).reshape(2 * size, size))
    with (
        patch.object(module, "bicgstab", wraps=bicgstab) as iterated,
        patch.object(module, "splu", wraps=splu) as solved,
    ):
        found = optimum(moves, np.repeat(np.arange(size), 2), np.ones(2 * size), greatest=True)
    places = np.arange(1, size + 1)
    assert (found.values >= places * (size + 1 - places) - found.error).all()
    assert iterated.call_count == 2
    assert solved.call_count > 1


def test_nothing_to_find():
    assert optimum(csr((0, 0)), np.empty(0, dtype=int), np.empty(0), greatest=True).error == 0


@pytest.mark.compiled("verification")
@pytest.mark.parametrize("greatest", [True, False])
def test_sweeps_find_what_elimination_finds(greatest):
    size, random = 600, np.random.default_rng(5)
    ways = random.dirichlet(np.full(size, 0.01), size=3 * size) * 0.99
    ways[ways < 1e-4] = 0
    state, constant = np.repeat(np.arange(size), 3), random.random(3 * size)
    with patch.object(module, "LARGE", 0), patch.object(choices, "LARGE", 0):
        swept = optimum(csr(ways), state, constant, greatest=greatest)
    with patch.object(module, "can_compile", lambda: False):
        plain = optimum(csr(ways), state, constant, greatest=greatest)
    assert (swept.chosen == plain.chosen).all()
    assert np.abs(swept.values - plain.values).max() <= swept.error + plain.error
    assert swept.error < 1e-8
