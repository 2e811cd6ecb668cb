"""Solving by name, with limits as options."""

from __future__ import annotations

import pytest
from places import ROOT
from sentences import refused

import mdm
from mdm.problems import dec_tiger, rock_sample, tiger
from mdm.solvers import SOLVERS
from mdm.solvers.solve import options_of, policy_class

CHAIN = mdm.models.MDP([[[0.0, 1.0], [0.0, 1.0]]], [[1.0], [0.0]], discount=0.5)
SEEN = rock_sample(2, 1).revealed()


def test_a_path_is_loaded():
    path = ROOT / "examples" / "tiger.pomdp"
    for given in (path, str(path)):
        assert mdm.solve(given, gap=10, time=60).policy.num_states == len(mdm.load_model(path).state_space)


@pytest.mark.parametrize(
    ("limit", "reason"),
    [({"gap": 200}, "gap"), ({"iterations": 0}, "iterations"), ({"time": 0}, "time"), ({"memory": 0}, "memory")],
)
def test_the_first_limit_ends_it(limit, reason):
    assert mdm.solve(tiger(), **{"gap": 0, **limit}).reason == reason


def test_progress_is_reported():
    reports = []
    solution = mdm.solve(tiger(), "qmdp", progress=reports.append)
    assert reports
    assert reports[-1].upper == solution.upper


def test_options_of_one_solver():
    assert mdm.solve(CHAIN, "value-iteration", horizon=1).policy.horizon == 1


def test_options_choose_a_solver_that_takes_them():
    assert mdm.solve(CHAIN, horizon=1).solver == "value-iteration"
    assert mdm.solve(tiger(), horizon=2).solver == "perseus"
    assert mdm.solve(tiger(), whole=True, iterations=1).solver == "sarsop"
    with refused(mdm.ConfigError):
        mdm.solve(tiger(), nonsense=1)


@pytest.mark.parametrize(
    ("model", "solver", "options", "message"),
    [
        (tiger(), "sarsoup", {}, "there is no solver 'sarsoup'; there are value-iteration"),
        (tiger(), "value-iteration", {}, "value-iteration solves MDPs, not POMDPs: take qmdp"),
        (CHAIN, "sarsop", {}, "sarsop solves POMDPs, not MDPs: take value-iteration"),
        (tiger(), "perseus", {"belief": 3}, "perseus takes no 'belief': its options are beliefs, seed"),
        (tiger(), "sarsop", {"limits": 3}, "sarsop takes no 'limits': its options are whole"),
        (tiger(), "qmdp", {"limits": 3}, "qmdp takes no 'limits': it has no options but the limits"),
        (tiger(), None, {"gap": "0.01"}, "gap is a number from 0 on, not '0.01'"),
        (tiger(), None, {"time": -1}, "time is a number from 0 on, not -1"),
        (tiger(), "perseus", {"horizon": 2.5}, "horizon is a whole number, not 2.5"),
        (tiger(), "perseus", {"horizon": True}, "horizon is a whole number, not True"),
        (tiger(), "perseus", {"seed": "a"}, "a seed is a whole number from 0 on, not 'a'"),
        (tiger(), "jesp", {"restarts": None}, "restarts is a whole number, not None"),
        (tiger(), "sarsop", {"whole": "no"}, "whole is True or False, not 'no'"),
    ],
)
def test_what_is_refused(model, solver, options, message):
    with pytest.raises(mdm.ConfigError, match=message):
        mdm.solve(model, solver, **options)


def test_a_file_that_is_not_there():
    with refused(mdm.FormatError):
        mdm.solve("nowhere.pomdp")


def test_every_solver_is_there():
    for name in SOLVERS:
        with refused(mdm.ConfigError):
            mdm.solve(tiger(), name, nonsense=1)


@pytest.mark.parametrize("horizon", [None, 2])
@pytest.mark.parametrize("name", SOLVERS)
def test_the_class_of_the_policy_is_known_before_it_is_made(name, horizon):
    *_, kind = SOLVERS[name]
    options = {} if horizon is None else {"horizon": horizon}
    if not set(options) <= set(options_of(name)) or (name == "jesp" and horizon is None):
        return
    options |= {"beliefs": 20} if name == "perseus" else {}
    for model in [CHAIN] if kind == "MDP" else [dec_tiger(discount=0.9)] if name == "jesp" else [tiger(), SEEN]:
        made = mdm.solve(model, name, iterations=2, **options).policy
        assert type(made) is policy_class(name, model, horizon=horizon, durations=None)
    if horizon is None and kind == "POMDP":
        timed = mdm.models.Durations([[1.0] * len(SEEN.action_space)] * len(SEEN.state_space))
        seen = SEEN.with_discount(SEEN.discount, of="second")
        made = mdm.solve(seen, name, iterations=1, durations=timed).policy
        assert type(made) is policy_class(name, SEEN, horizon=None, durations=timed)
