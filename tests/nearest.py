"""Nearest beliefs by other means: linear programs of another form, none left out, and beliefs drawn near by.

Run it to look at a thousand beliefs: ``python tests/nearest.py``.
"""

from __future__ import annotations

import sys
import time
from itertools import product

import numpy as np
import scipy

import mdm
from mdm import problems
from mdm.explanation import moved, nearest_belief
from mdm.policies import AlphaVectors, MaskedAlphaVectors, MixedAlphaVectors

TIED = 1e-7
"""Where another action is as good, any change however small decides otherwise: there is no least one."""
SMALL = ["tiger", "dec_tiger", "recycling_robots", "relay", "broadcast_channel", "load_unload"]
LARGE = ["grid_small", "fire_fighting_graph", "box_pushing", "patrol"]


def solved(name, beliefs=60, rounds=15):
    """Return alpha vectors for a problem, the same each time."""
    model = getattr(problems, name)()
    model = model if model.discount < 1 else model.with_discount(0.9)
    return model, mdm.solve(model, solver="perseus", beliefs=beliefs, iterations=rounds).policy


def drawn(random, size):
    """Return a random belief: over all states or few, certain or not."""
    belief = random.dirichlet(np.full(size, random.choice([0.1, 0.5, 1.0, 3.0])))
    belief[random.random(size) < random.choice([0.0, 0.5])] = 0
    if not belief.sum():
        belief[random.integers(size)] = 1
    return belief / belief.sum()


def distance_of(belief, rival, own, allowed=None):
    """Return the least probability to move so that a vector is as good as others; inf where it never is.

    The variables are the new belief and the absolute values of the changes, which its opposite does not have.
    """
    size = len(belief)
    allowed = np.ones(size, dtype=bool) if allowed is None else allowed
    eye = np.eye(size)
    above = [np.concatenate([eye, -eye], axis=1), np.concatenate([-eye, -eye], axis=1)]
    right = [belief, -belief]
    if len(own):
        above.append(np.concatenate([own - rival, np.zeros((len(own), size))], axis=1))
        right.append(-1e-9 * np.abs(own - rival).max(axis=1))  # better, and not only as good
    found = scipy.optimize.linprog(
        np.concatenate([np.zeros(size), np.full(size, 0.5)]),
        A_ub=np.concatenate(above),
        b_ub=np.concatenate(right),
        A_eq=np.concatenate([np.ones(size), np.zeros(size)])[None],
        b_eq=[1.0],
        bounds=[(0, 1 if free else 0) for free in allowed] + [(0, None)] * size,
        method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    return found.fun if found.status == 0 else np.inf


def nearest_of_all(policy, belief):
    """Return the distance of the nearest belief at which alpha vectors decide otherwise, from every program."""
    actions = np.asarray(policy.actions)
    action = policy.action(belief)
    own = policy.vectors[actions == action]
    return min((distance_of(belief, rival, own) for rival in policy.vectors[actions != action]), default=np.inf)


def nearest_of_masked(policy, belief):
    """Return the same of masked vectors: for every support apart, where it is known which of them hold."""
    action, size = policy.action(belief), policy.num_states
    best = np.inf
    for support in product([False, True], repeat=size):
        chosen = np.array(support)
        holding = [row for row, vector in enumerate(policy.vectors) if set(np.flatnonzero(chosen)) <= set(vector)]
        dense = {row: np.array([policy.vectors[row].get(s, 0.0) for s in range(size)]) for row in holding}
        own = np.array([dense[row] for row in holding if policy.actions[row] == action]).reshape(-1, size)
        for row in holding:
            if policy.actions[row] != action:
                best = min(best, distance_of(belief, dense[row], own, chosen))
    return best


def near(random, belief, mass):
    """Return a random belief in which at most so much probability lies elsewhere."""
    other = drawn(random, len(belief))
    far = moved(belief, other)
    return belief if not far else belief + (other - belief) * min(1.0, mass / far)


def check(random, policy, belief, exact=None, tries=50):
    """Check the nearest belief: it decides otherwise, and none that is nearer by a hundredth does."""
    action = policy.action(belief)
    after = nearest_belief(policy, belief)
    if after is None:
        assert exact is None or exact == np.inf
        assert all(policy.action(drawn(random, len(belief))) == action for _ in range(tries))
        return None
    assert after.min() >= 0
    assert abs(after.sum() - 1) < 1e-12
    assert policy.action(after) != action
    mass = moved(belief, after)
    if exact is not None:
        assert mass <= exact * 1.001 + TIED
        assert exact >= 0.99 * mass - TIED
    if mass > TIED:
        assert all(policy.action(near(random, belief, 0.99 * mass)) == action for _ in range(tries))
    return mass


def random_alpha(random, size):
    count = int(random.integers(2, 12))
    return AlphaVectors(random.normal(size=(count, size)), random.integers(3, size=count).tolist(), 3)


def random_masked(random, size):
    count = int(random.integers(2, 7))
    masks = [random.permutation(size)[: random.integers(1, size + 1)].tolist() for _ in range(count)] + [range(size)]
    vectors = [dict.fromkeys(map(int, mask), 0.0) for mask in masks]
    vectors = [{state: float(random.normal()) for state in vector} for vector in vectors]
    return MaskedAlphaVectors(vectors, random.integers(3, size=len(vectors)).tolist(), size, 3)


def random_mixed(random, hidden, observed=3):
    per = [x for x in range(observed) for _ in range(4)]
    vectors = random.normal(size=(len(per), hidden))
    return MixedAlphaVectors(vectors, random.integers(3, size=len(per)).tolist(), per, 3)


def main():
    """Look at a thousand beliefs of ten models and of random vectors."""
    random = np.random.default_rng(0)
    told = []
    for name in SMALL + LARGE:
        _, policy = solved(name)
        began, masses = time.perf_counter(), []
        for _ in range(80 if name in SMALL else 30):
            belief = drawn(random, policy.num_states)
            masses.append(check(random, policy, belief, nearest_of_all(policy, belief)))
        known = [mass for mass in masses if mass is not None]
        told.append(len(masses))
        sys.stdout.write(
            f"{name}: {policy.num_states} states, {len(policy.vectors)} vectors, {len(masses)} beliefs, "
            f"median {np.median(known) if known else np.nan:.4f}, least {min(known, default=np.nan):.2g}, "
            f"{time.perf_counter() - began:.1f} s\n"
        )
    for kind, make, exact in (
        ("alpha", random_alpha, nearest_of_all),
        ("masked", random_masked, nearest_of_masked),
        ("mixed", random_mixed, None),
    ):
        for _ in range(200):
            policy = make(random, int(random.integers(2, 6)))
            belief = drawn(random, policy.num_states)
            if kind == "mixed":
                belief = np.zeros(policy.num_states)
                belief[policy.states[random.integers(3)]] = drawn(random, policy.states.shape[1])
            check(random, policy, belief, None if exact is None else exact(policy, belief))
        told.append(200)
        sys.stdout.write(f"random {kind} vectors: 200 beliefs\n")
    sys.stdout.write(f"{sum(told)} beliefs\n")


if __name__ == "__main__":
    main()
