"""Runs every kernel on odd models, as plain Python, in which each index is checked; prints those that were called."""

from __future__ import annotations

import functools
import sys
import warnings
from unittest.mock import patch

import numba
import numpy as np
from belief_steps import track
from random_models import distributions

from mdm import load_model, problems
from mdm.beliefs import Support
from mdm.models import MDP, POMDP
from mdm.models.dynamics import Dynamics
from mdm.policies import AlphaVectors, alpha_vectors
from mdm.solvers import Limits, bounds
from mdm.solvers.mdp.value_iteration import modified_policy_iteration, prioritised_sweeping, value_iteration
from mdm.solvers.online.tree_search import TreeSearch
from mdm.solvers.sarsop import sarsop, solver as sarsop_solver

CALLED: set[str] = set()


def uncompiled(**_):
    """Return what keeps the name of a kernel that is called, in place of compiling it."""

    def decorate(kernel):
        name = f"{kernel.__module__.removeprefix('mdm.')} {kernel.__name__}"

        @functools.wraps(kernel)
        def call(*arguments):
            CALLED.add(name)
            return kernel(*arguments)

        return call

    return decorate


def odd(seed: int) -> POMDP:
    """Return a random model: of any sizes, with tiny weights, unreachable and absorbing states, and odd rewards."""
    random = np.random.default_rng(seed)
    states, actions, observations = (int(random.choice([1, 2, 3, 7])) for _ in range(3))
    ways = distributions(random, actions, states, states)
    told = distributions(random, actions, states, observations)
    initial = distributions(random, states)
    for array in (ways, told, initial):
        kind = random.integers(4)
        if kind == 0:  # products of these are 0
            array[random.random(array.shape) < 0.5] *= 1e-200
        elif kind == 1:  # denormal, and zeros
            array[random.random(array.shape) < 0.3] = 5e-324
            array[random.random(array.shape) < 0.3] = 0
        array[:] = array + np.where(array.sum(axis=-1, keepdims=True) > 0, 0, 1)
        array[:] = array / array.sum(axis=-1, keepdims=True)
    if random.random() < 0.5:
        ways[:, -1] = np.eye(states)[-1]
    scale = random.choice([0.0, 1e-12, 1.0, 1e9, -1e12])
    rewards = scale * random.normal(size=(states, actions))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return POMDP(
            ways, told, rewards, discount=float(random.choice([0.1, 0.95, 0.999])), initial_belief=initial,
            sparse=bool(random.random() < 0.5),
        )  # fmt: skip


def chain(size: int) -> POMDP:
    """Return states that are left by steps so rare that beliefs in them are 0."""
    initial = np.full(size, 1e-300)
    initial[0] = 1
    ways = np.full((size, size), 1e-30)
    ways[0] = 0
    np.fill_diagonal(ways, 1)
    rewards = np.eye(size)[:, :1]
    return POMDP([ways], np.full((1, size, 2), 0.5), rewards, discount=0.5, initial_belief=initial)


def solve(model: MDP, seed: int) -> None:
    """Solve a model by everything that is compiled."""
    flat = MDP(list(Dynamics(model).matrices), model.rewards, discount=model.discount, sparse=True)
    with patch.object(Dynamics, "is_dense", False):
        for solver in (value_iteration, prioritised_sweeping, modified_policy_iteration):
            solver(flat, limits=Limits(gap=1e-6, iterations=20))
    TreeSearch(model, expansions=20, seed=seed, particles=3).action(
        model.initial_belief if isinstance(model, POMDP) else 0
    )
    if not isinstance(model, POMDP):
        return
    track(model, seed)
    found = sarsop(model, limits=Limits(gap=0, iterations=25), whole=seed % 2 == 0)
    if len(model.observation_space) > 1:
        sarsop(model.revealed().with_false_negatives(0), limits=Limits(gap=0, iterations=20))
    if (vectors := getattr(found.policy, "vectors", None)) is not None:
        policy = AlphaVectors(vectors, found.policy.actions)
        belief = model.initial_belief
        policy.action(belief)
        (states,) = belief.nonzero()
        policy.action(Support(states, belief[states]))


def main(count: int, files: list[str]) -> None:
    """Run on so many random models and on those of files, or on the named ones where there are no files.

    Where no random model is asked for, the named ones are few.
    """
    warnings.simplefilter("ignore")
    read = map(load_model, files)
    named = [model.with_discount(min(model.discount, 0.95)) for model in read] or [
        problems.tiger(), problems.aloha(3), problems.rock_sample(2, 2), problems.rock_sample(2, 2).revealed(),
        problems.machine_maintenance(1), problems.patrol(2), problems.forest(), problems.river_swim(),
        problems.grid_world(discount=0.9), chain(30),
    ][:: 1 if count else 3]  # fmt: skip
    everything = patch.object(bounds, "_LARGE", 0), patch.object(alpha_vectors, "_LARGE", 0)
    not_compiled = patch.object(numba, "njit", uncompiled)  # kernels are imported by whoever needs them first
    with everything[0], everything[1], patch.object(sarsop_solver, "_SMALL", 0), not_compiled:
        for seed, model in enumerate([*named, *map(odd, range(count))]):
            try:
                solve(model, seed)
            except BaseException as error:
                error.add_note(f"at model {seed}")
                raise
    sys.stdout.write("\n".join(sorted(CALLED)))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
