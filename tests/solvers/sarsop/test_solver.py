"""SARSOP: bounds against exhaustive recursion, exact solvers' results, and known optima."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from places import EXAMPLES, each
from random_models import dense, distributions
from sarsop_models import mixed
from sentences import refused

from mdm import ConfigError, ModelError, ModelWarning, load_model, load_policy
from mdm.compilation import plain
from mdm.models import POMDP, MixedPOMDP
from mdm.problems import rock_sample
from mdm.solvers import Limits, solve
from mdm.solvers.sarsop import condensation, sarsop, solver
from mdm.solvers.sarsop.graph import VECTORS

TIGER = EXAMPLES / "tiger.pomdp"
COMPILED = pytest.mark.slow, pytest.mark.compiled("sarsop")


def small(seed, states=3, actions=2, observations=2, discount=0.5):
    random = np.random.default_rng(seed)
    return POMDP(
        distributions(random, actions, states, states),
        distributions(random, actions, states, observations),
        random.integers(-5, 6, size=(states, actions)).astype(float),
        discount=discount,
        initial_belief=distributions(random, states),
    )


def tightly(model, gap=1e-3):
    """Return a solution to hold others against."""
    return sarsop(model, limits=Limits(gap=gap, time=5))


def optimum(model, belief, depth):
    """Return what the best plan of so many steps is worth, by looking at all of them."""
    if depth == 0:
        return 0.0
    best = -np.inf
    for a in range(len(model.action_space)):
        value = belief @ model.rewards[:, a]
        ahead = belief @ model.transition_matrix(a)
        for o in range(len(model.observation_space)):
            after = ahead * model.observation_matrix(a)[:, o]
            chance = after.sum()
            if chance > 0:
                value += model.discount * chance * optimum(model, after / chance, depth - 1)
        best = max(best, value)
    return best


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 3))
def test_bounds_hold_the_value_that_all_plans_together_have(seed, states, actions):
    model = small(seed, states, actions)
    depth = 5 if actions > 2 else 7
    value = optimum(model, model.initial_belief, depth)
    rest = model.discount**depth * np.abs(model.rewards).max() / (1 - model.discount)
    found = sarsop(model, limits=Limits(gap=1e-4, time=5))
    assert found.lower <= value + rest + 1e-9
    assert found.upper >= value - rest - 1e-9
    assert found.reason == "gap"
    assert found.policy.value(model.initial_belief) == pytest.approx(found.lower, abs=1e-9)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_bounds_hold_wherever_it_stops(seed, backups):
    model = small(seed, discount=0.6)
    tight = tightly(model)
    early = sarsop(model, limits=Limits(gap=1e-5, iterations=backups))
    assert early.lower <= tight.upper + 1e-9
    assert early.upper >= tight.lower - 1e-9


def assert_worth_what_it_claims(model, policy, random):
    """At any belief, what the policy does and then its own value come to no less than its value."""
    for _ in range(20):
        belief = distributions(random, len(model.state_space))
        if isinstance(model, MixedPOMDP):
            belief = np.where(model.seen_in == random.choice(model.seen_in[belief > 0]), belief, 0)
            belief /= belief.sum()
        a = policy.action(belief)
        worth = belief @ model.rewards[:, a]
        for o in range(len(model.observation_space)):
            after = belief @ dense(model.joint_matrix(a, o))
            if after.sum() > 0:
                worth += model.discount * after.sum() * policy.value(after / after.sum())
        assert policy.value(belief) <= worth + 1e-7


@pytest.mark.parametrize("most", [300, pytest.param(1000, marks=COMPILED)])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.03, 1), seen=st.booleans())
def test_a_policy_is_worth_its_lower_bound_whenever_it_was_pruned(most, seed, share, seen):
    model = mixed(seed) if seen else small(seed, discount=0.9)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solver, "_LEAST_VECTORS", 3)
        found = sarsop(model, limits=Limits(gap=1e-6, iterations=int(share * most)))
    assert found.policy.value(model.initial_belief) == pytest.approx(found.lower, abs=1e-9)
    assert_worth_what_it_claims(model, found.policy, np.random.default_rng(seed))


@example(253, 10, False, 0.9)  # its bounds differ by less than beliefs that are taken for one may make of them
@settings(max_examples=6)
@given(st.integers(0, 2**32 - 1), st.integers(10, 100), st.booleans(), st.just(0.7))
def test_plans_that_are_taken_into_the_search_are_worth_what_they_claim(seed, backups, seen, discount):
    model = mixed(seed) if seen else small(seed, discount=discount)
    limits = Limits(gap=1e-6, iterations=backups, clock=ticks())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solver, "_LEAST_VECTORS", 3)
        patch.setattr(solver, "_FIRST_PLAN", 1e-3)
        patch.setattr(solver, "_PLANS", 1e9)
        patch.setattr(solver._Search, "condensed", lambda *_: None)
        found = sarsop(model, limits=limits)
    assert found.lower <= tightly(model, gap=0.02).upper + 1e-9
    assert_worth_what_it_claims(model, found.policy, np.random.default_rng(seed))


def test_a_plan_raises_the_lower_bound(monkeypatch):
    taken = []
    add = solver._Search._add
    monkeypatch.setattr(solver._Search, "_add", lambda self, plan: (taken.append(plan.lower), add(self, plan)))
    monkeypatch.setattr(solver, "_FIRST_PLAN", 1e-3)
    monkeypatch.setattr(solver, "_PLANS", 1e9)
    model = load_model(TIGER).with_discount(0.95)
    found = sarsop(model, limits=Limits(gap=0, iterations=200, clock=ticks()))
    assert taken
    assert max(taken) <= found.lower + 1e-9
    assert found.lower <= 19.3714


def test_plans_settle_where_choices_go_round_in_circles(monkeypatch):
    """From Tiger's first vectors on, they do; one phase of the circle listens for ever, for -20."""
    limits = Limits(gap=0, clock=ticks())
    search = solver._Search(load_model(TIGER).with_discount(0.95), limits)
    while search.backups < 120:
        search.run(limits)
    lower, upper = search.bounds()
    assert lower < -2
    for share in solver._FEWER[1:]:
        found = search._plan(limits, share * (upper - lower), 1e9, known=False)
        assert found.lower > 19
    monkeypatch.setattr(condensation, "_UNDAMPED", condensation._ROUNDS)
    assert search._plan(limits, 0.0, 1e9, known=False).lower < 19


def ticks():
    """Return a clock on which no work takes long enough to be compiled."""
    times = itertools.count(0, 1e-5)
    return lambda: next(times)


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_bounds_hold_for_what_beliefs_leave_out(seed):
    model = small(seed, discount=0.6)
    tight = tightly(model)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plain(solver._STEPS), "_NEGLIGIBLE", 0.2)
        rough = sarsop(model, limits=Limits(gap=1e-5, iterations=300))
    assert rough.lower <= tight.upper + 1e-9
    assert rough.upper >= tight.lower - 1e-9


def test_tiger_is_solved_to_a_thousandth():
    found = solve(load_model(TIGER).with_discount(0.95), gap=1e-3)
    assert found.solver == "sarsop"
    assert found.reason == "gap"
    assert found.lower <= 19.3714 <= found.upper  # A. R. Cassandra's optimum
    assert found.gap <= 1e-3


@pytest.mark.foreign("models of cassandra/pomdp-solve, and its exact solutions")
@pytest.mark.parametrize("name", each(["1d", "cheese.95", "ejs1", "parr95.95", "tiger.95", "tiger.aaai"]))
def test_what_exact_value_iteration_found_lies_between_the_bounds(corpus, name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(corpus / "models" / "pomdp-solve" / f"{name}.POMDP")
    if model.discount >= 1:
        pytest.skip("the exact values are those of a finite horizon")
    exact = load_policy(corpus / "policies" / "pomdp-solve" / f"{name}.alpha", model)
    value = exact.value(model.initial_belief)
    found = sarsop(model, limits=Limits(gap=1e-4, time=10))
    slack = 2e-3 * max(1.0, abs(value))  # the exact solver stops at a change of 1e-9 to 1e-3
    assert found.lower <= value + slack
    assert found.upper >= value - slack


def test_ctrl_c_leaves_the_best_so_far():
    def strike(progress):
        if progress.iterations > 50:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    model = load_model(TIGER).with_discount(0.99)
    found = sarsop(model, limits=Limits(gap=0, progress=strike))
    assert found.reason == "interrupted"
    assert found.policy.value(model.initial_belief) == pytest.approx(found.lower)
    assert signal.getsignal(signal.SIGINT) is before


def test_memory_and_time_end_it():
    model = load_model(TIGER).with_discount(0.95)
    assert sarsop(model, limits=Limits(gap=0, memory=1)).reason == "memory"
    times = iter(np.arange(0, 1000, 0.25))
    assert sarsop(model, limits=Limits(gap=0, time=5, clock=lambda: next(times))).reason == "time"


@pytest.mark.slow
@pytest.mark.compiled("sarsop")
@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the most held is not told")
def test_no_more_memory_is_held_than_may_be():
    program = """if True:
        import re
        import numpy as np
        from mdm.models import POMDP
        from mdm.solvers import Limits
        from mdm.solvers.solution import _held
        from mdm.solvers.sarsop import sarsop, solver
        random = np.random.default_rng(1)
        ways = random.dirichlet(np.full(100, 0.1), size=(4, 100))
        told = random.dirichlet(np.full(8, 0.5), size=(4, 100))
        model = POMDP(ways, told, random.normal(size=(100, 4)), discount=0.95)
        solver._compiled()
        with open("/proc/self/clear_refs", "w") as file:
            file.write("5")  # the most held is counted from here
        limit = _held() + 80_000_000
        found = sarsop(model, limits=Limits(gap=0, time=100, memory=limit))
        most = 1024 * int(re.search(r"VmHWM:\\s*(\\d+)", open("/proc/self/status").read())[1])
        worth = found.policy.value(model.initial_belief)
        print(found.reason, most / limit, worth - found.lower, len(found.policy.actions))
    """
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    reason, share, lost, _ = run.stdout.split()
    assert reason == "memory"
    assert 0.8 < float(share) < 1.03
    assert abs(float(lost)) < 1e-9


@pytest.mark.parametrize("step", [1e-4, 0.1])
def test_trials_are_no_deeper_than_there_is_time_for(monkeypatch, step):
    """A trial is begun with the pace of those before it in mind."""
    steps, depths, times = plain(solver._STEPS), [], itertools.count(0, step)
    explore = steps.explore

    def watched(layout, graph, scratch, *rest):
        depths.append(len(scratch.path))
        explore(layout, graph, scratch, *rest)
        return 10  # in two readings of the clock

    monkeypatch.setattr(steps, "explore", watched)
    monkeypatch.setattr(solver._Search, "_plan", lambda *_, **__: None)
    monkeypatch.setattr(solver, "_SHORT", np.inf)
    limits = Limits(gap=0, time=3, iterations=100, clock=lambda: next(times))
    sarsop(load_model(TIGER).with_discount(0.999), limits=limits)
    assert depths[0] == solver._LEAST_DEPTH
    assert depths[1:] == sorted(depths[1:], reverse=True)
    assert depths[1] == solver._DEPTH if step < 1e-3 else depths[1] <= 3 / (step / 10)


@pytest.mark.parametrize(("size", "backups"), [(4, 200), pytest.param(5, 500, marks=COMPILED)])
def test_a_plan_is_found_in_little_memory_and_takes_no_more(monkeypatch, size, backups):
    """A limit of memory should make no policy larger: there is a plan where vectors have eight times their room."""
    limits = Limits(gap=0)
    search = solver._Search(rock_sample(size, size), limits)
    while search.backups < backups:
        search.run(limits)
    lower, upper = search.bounds()
    given = 5e-3 * (upper - lower), 1e9
    assert search._plan(limits, *given, known=False) is not None  # and what it needs is compiled
    held = 8 * search.size * int(search._layout.first_state[1])
    for share, fits in ((3, False), (8, True)):
        monkeypatch.setattr(Limits, "room", share * held)
        tracemalloc.start()
        found = search._plan(limits, *given, known=False)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert (found is not None) == fits
        assert most <= share * held


def test_plans_end_with_the_time(monkeypatch):
    """Those of the search leave time for the last ones, which end a part of a second after the limit."""
    ends = []

    def plan(_search, limits, _slack, end, **_):
        ends.append((limits.reason, end))

    monkeypatch.setattr(solver._Search, "_plan", plan)
    times = itertools.count(0, 0.05)
    limits = Limits(gap=0, time=10, clock=lambda: next(times))
    found = sarsop(load_model(TIGER).with_discount(0.999), limits=limits)
    assert found.reason == "time"
    assert {reason for reason, _ in ends} == {None, "time"}
    assert max(end for reason, end in ends if reason is None) <= 8.5
    assert 9 < max(end for _, end in ends) <= 10.5
    assert found.history[-1].seconds <= 11


def test_followers_are_the_best_after_the_beliefs_that_vectors_were_found_at():
    model = load_model(TIGER).with_discount(0.95)
    limits = Limits(gap=0, clock=ticks())
    search = solver._Search(model, limits)
    while search.backups < 120:
        search.run(limits)
    search.bounds()
    search.learn_followers(limits)
    graph = search._graph
    (root,) = search._roots
    vector = int(graph.best[root])
    action = int(graph.vector_action[vector])
    values = np.array([search._part(v) for v in range(int(graph.counts[VECTORS]))])
    active = graph.is_active[: len(values)] > 0
    for o in range(len(model.observation_space)):
        after = (
            model.initial_belief[search._order] @ dense(model.joint_matrix(action, o))[search._order][:, search._order]
        )
        scores = values @ (after / after.sum())
        assert scores[search._after[vector, o]] == pytest.approx(scores[active].max(), abs=1e-3)


def test_a_gap_of_nothing_ends_where_numbers_end():
    model = load_model(TIGER).with_discount(0.95)
    found = sarsop(model, limits=Limits(gap=0, time=60))
    assert found.reason == "converged"
    assert found.lower == pytest.approx(19.37136, abs=1e-4)
    assert found.gap < 1e-8
    assert found.history[-1].size == len(found.policy.actions)
    single = POMDP(np.ones((1, 1, 1)), np.ones((1, 1, 1)), np.full((1, 1), 2.0), discount=0.9)
    found = sarsop(single, limits=Limits(gap=0, time=60))
    assert (found.reason, found.lower) == ("converged", pytest.approx(20))


def test_what_it_cannot_solve_is_told():
    huge = POMDP(np.ones((1, 1, 1)), np.ones((1, 1, 1)), np.full((1, 1), 1e308), discount=0.9)
    with refused(ModelError):
        sarsop(huge)
    with refused(ModelError):
        sarsop(load_model(TIGER).with_discount(1.0))
    with refused(ConfigError):
        solve(load_model(TIGER), "value-iteration")
    large = POMDP([np.eye(50)] * 2, np.full((2, 50, 2), 0.5), np.zeros((50, 2)), discount=0.5)
    with refused(ModelError):
        sarsop(large.with_false_negatives(0), limits=Limits(memory=1))


@pytest.mark.parametrize("size", [30, 300])
def test_states_whose_weight_underflows_are_not_reached(size):
    program = f"""if True:
        import numpy as np
        from mdm.models import POMDP
        from mdm.solvers import Limits
        from mdm.solvers.sarsop import sarsop
        initial = np.full({size}, 1e-300)
        initial[0] = 1
        ways = np.full(({size}, {size}), 1e-30)  # 1e-330 is 0
        ways[0] = 0
        np.fill_diagonal(ways, 1)
        rewards = np.zeros(({size}, 1))
        rewards[0] = 1
        model = POMDP([ways], np.full((1, {size}, 2), 0.5), rewards, discount=0.5, initial_belief=initial)
        found = sarsop(model, limits=Limits(gap=1e-6, iterations=3))
        print(found.lower, found.upper)
    """
    # Compiled, a write beyond an array would go unseen or end the process.
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env={**os.environ, "MDM_COMPILE": "0"}
    )
    assert run.returncode == 0, run.stderr
    assert [float(word) for word in run.stdout.split()] == pytest.approx([2, 2], abs=1e-5)


@pytest.mark.slow
@pytest.mark.compiled("sarsop")
def test_without_compilation_the_numbers_are_the_same():
    program = (
        "import sys, mdm; from mdm.solvers import solve; from mdm.solvers.sarsop import solver; solver._SMALL = 0\n"
        "solver._FIRST_PLAN = 1e9  # plans come by time\n"
        "found = solve(mdm.load_model(sys.argv[1]).with_discount(0.95), gap=1e-2, iterations=400)\n"
        "print(repr(found.lower), repr(found.upper), found.iterations)"
    )
    runs = [
        subprocess.run(
            [sys.executable, "-W", "error::RuntimeWarning", "-c", program, str(TIGER)],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "MDM_COMPILE": flag},
        )
        for flag in "01"
    ]
    outputs = [run.stdout.split() for run in runs]
    assert "pip install numba" in runs[0].stderr
    assert not runs[1].stderr
    assert [float(word) for word in outputs[0][:2]] == pytest.approx([float(word) for word in outputs[1][:2]], abs=1e-3)


def test_a_small_model_is_solved_without_waiting_for_a_compiler():
    program = (
        "import sys, mdm; from mdm.solvers.sarsop import solver; solver._SHORT = 60\n"
        "print(mdm.solve(sys.argv[1], gap=1e-2).reason, 'numba' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", program, str(TIGER)], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["gap", "False"]


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=COMPILED)])
@pytest.mark.parametrize("small", [0, 10**9])
def test_it_goes_on_where_steps_are_compiled(monkeypatch, small, compiled):
    monkeypatch.setattr(solver, "_SMALL", small)
    monkeypatch.setattr(solver, "_SHORT", 0.0)
    found = sarsop(load_model(TIGER).with_discount(0.95), limits=Limits(gap=1e-3))
    assert found.reason == "gap"
    assert found.lower <= 19.37137 <= found.upper
