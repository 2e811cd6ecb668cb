"""Rates and holding times, against scipy's distributions and fits."""

from __future__ import annotations

import math
from fractions import Fraction

import msgspec
import numpy as np
import pytest
import scipy
from estimated import lived, visits
from hypothesis import given, strategies as st

from mdm import ModelError
from mdm.estimation import Stay, chains_of, durations_of, moran, rates_of, statistics
from mdm.estimation.rates import erlang, holding, transitions_after
from mdm.models import MDP, Durations

MODEL = MDP([[[0.5, 0.25, 0.25], [0.5, 0.5, 0], [1, 0, 0]]] * 2, np.zeros((3, 2)), discount=0.9)


def ended(seconds):
    return Stay(0, 0, seconds, 1, True)


def cut(seconds):
    return Stay(0, 0, seconds, None, False)


def test_rates_are_jumps_by_the_time_exposed():
    told = visits([0, 1, 0, 2, 0, 1], times=[0, 2, 3, 7, 8, 12])
    first, second, third = rates_of(MODEL, chains_of(told).stays())
    assert (first.action, first.state, first.symbols.tolist(), first.counts.tolist()) == (0, 0, [1, 2], [2, 1])
    assert (first.holding.exposure, first.holding.ends) == (10.0, 3)
    assert first.rates.tolist() == [0.25, 0.15]
    assert first.low[0] == pytest.approx(scipy.stats.gamma.ppf(0.025, 2.5, scale=0.1))
    assert first.holding.mean == pytest.approx(10 / 3)
    assert first.holding.high == pytest.approx(1 / scipy.stats.gamma.ppf(0.025, 3.5, scale=0.1))
    assert (second.state, second.symbols.tolist(), second.holding.exposure) == (1, [0], 1.0)
    assert (third.state, third.holding.exposure) == (2, 1.0)


def test_the_mean_of_stays_counts_those_that_were_cut_short():
    lengths, cuts = [2.0, 5.0, 1.0], [4.0, 0.5]
    held = holding([*map(ended, lengths), *map(cut, cuts)])
    fitted = scipy.stats.expon.fit(scipy.stats.CensoredData(lengths, right=cuts), floc=0)
    assert held.mean == pytest.approx(fitted[1], rel=1e-4)
    assert held.p_value is None


@pytest.mark.parametrize("count", [5, 20, 200])
def test_moran_s_test_refuses_exponential_times_as_often_as_it_says(count):
    random = np.random.default_rng(count)
    values = [moran(random.exponential(3.0, count)) for _ in range(2_000)]
    for level in (0.01, 0.1):
        expected, spread = level, math.sqrt(level * (1 - level) / 2_000)
        assert abs(np.mean(np.array(values) < level) - expected) < 4.5 * spread + 0.004


def test_moran_s_statistic_is_bartlett_s_for_variances_of_two_degrees():
    """An exponential time is a variance of two degrees of freedom: Bartlett's test of equality is the same."""
    times = [0.5, 1.5, 4.0, 0.7, 2.2]
    count, pooled = len(times), float(np.mean(times))
    freedom = 2
    statistic = count * freedom * math.log(pooled) - freedom * sum(map(math.log, times))
    statistic /= 1 + (count / freedom - 1 / (count * freedom)) / (3 * (count - 1))
    below = scipy.stats.chi2.cdf(statistic, count - 1)
    assert moran(times) == pytest.approx(2 * min(below, 1 - below), rel=1e-9)


def test_a_hundred_stays_of_weibull_s_distribution_are_no_exponential_ones():
    random = np.random.default_rng(2)
    assert np.mean([moran(random.weibull(1.5, 100)) < 0.05 for _ in range(200)]) > 0.97


def test_stays_that_are_cut_short_are_still_exponential():
    random = np.random.default_rng(3)
    refused = 0
    for _ in range(400):
        lengths, limits = random.exponential(2.0, 60), random.exponential(1.0, 60)
        stays = [ended(x) if x < y else cut(y) for x, y in zip(lengths, limits, strict=True)]
        p_value = holding(stays).p_value
        refused += p_value is not None and p_value < 0.01
    assert refused <= 14  # of 4 expected; more than 14 come once in 20,000 times


@pytest.mark.parametrize("stages", [2, 4, 9])
def test_erlang_stays_are_recognised_with_their_mean(stages):
    random = np.random.default_rng(stages)
    lengths = random.gamma(stages, 6.0 / stages, 600)
    mean, found = erlang(lengths, np.zeros(0))
    shape = scipy.stats.gamma.fit(lengths, floc=0)[0]
    assert found in {math.floor(shape), math.ceil(shape)}
    assert mean == pytest.approx(lengths.mean())
    held = holding(map(ended, lengths))
    assert (held.stages, held.is_exponential) == (found, False)


def test_erlang_stays_that_are_cut_short_are_fitted_as_scipy_does():
    random = np.random.default_rng(4)
    lengths, limits = random.gamma(3, 2.0, 300), random.exponential(10.0, 300)
    done = lengths < limits
    mean, stages = erlang(lengths[done], limits[~done])
    data = scipy.stats.CensoredData(lengths[done], right=limits[~done])
    _, _, scale = scipy.stats.gamma.fit(data, stages, f0=stages, floc=0)
    assert stages == 3
    assert mean == pytest.approx(stages * scale, rel=1e-3)
    likelihood = {}
    for k in (2, 3, 4):
        shape, _, scale = scipy.stats.gamma.fit(data, k, f0=k, floc=0)
        told = scipy.stats.gamma(shape, scale=scale)
        likelihood[k] = told.logpdf(lengths[done]).sum() + told.logsf(limits[~done]).sum()
    assert max(likelihood, key=likelihood.get) == stages


def test_durations_are_those_that_were_seen_and_elsewhere_those_of_the_action():
    told = visits([0, 1, 0, 1, 0], times=[0, 2, 3, 7, 8])
    durations = durations_of(MODEL, chains_of(told).stays(), "steps")
    assert durations.means.tolist() == [[3.0, 2.0], [1.0, 2.0], [2.0, 2.0]]
    assert durations.stages.tolist() == [[1, 1]] * 3


def test_of_jumps_a_step_is_as_short_as_the_model_stays_long():
    """MODEL stays in its first two states with 1/2, and leaves the third at once."""
    told = visits([0, 1, 0, 1, 0], times=[0, 2, 3, 7, 8])
    durations = durations_of(MODEL, chains_of(told).stays(), "jumps")
    assert durations.means.tolist() == [[1.5, 1.0], [0.5, 1.0], [2.0, 2.0]]


def test_durations_of_a_world_are_found_again_from_changes_of_its_state():
    """The world takes steps of these durations, of which half change nothing and are not seen."""
    means = np.array([[3.0], [1.0], [2.0]])
    model = MDP([[[0.5, 0.25, 0.25], [0.5, 0.5, 0], [1, 0, 0]]], np.zeros((3, 1)), discount=0.9)
    told = lived(model, [0, 0, 0], 6_000, world={"durations": Durations(means)})
    durations = durations_of(model, chains_of(told, kind="jumps").stays(), "jumps")
    assert durations.means == pytest.approx(means, rel=0.1)
    endless = MDP([np.eye(3)], np.zeros((3, 1)), discount=0.9)
    assert durations_of(endless, chains_of(told, kind="jumps").stays(), "jumps").means[0] == pytest.approx(6, rel=0.1)


def test_durations_of_hidden_states_are_those_of_actions():
    stays = [Stay(None, 0, 2.0, None, True), Stay(None, 0, 4.0, None, True), Stay(None, 1, 9.0, None, False)]
    durations = durations_of(MODEL, stays, "steps")
    assert durations.means.tolist() == [3.0, 7.5]


def test_without_any_time_there_are_no_durations():
    for stays in ([], [ended(0.0)], [cut(3.0)]):
        with pytest.raises(ModelError, match="no action was seen to take time"):
            durations_of(MODEL, stays, "steps")


@given(st.floats(0.01, 2), st.floats(0.01, 2), st.floats(0.1, 3))
def test_the_transitions_after_a_step_are_those_of_two_states(up, down, step):
    """In two states, P(0 stays 0) = (down + up e^-(up + down) t) / (up + down)."""
    model = MDP([[[0.5, 0.5], [0.5, 0.5]]], np.zeros((2, 1)), discount=0.9)
    exposure = 1e9
    counts = round(up * exposure), round(down * exposure)
    found = rates_of(model, [Stay(0, 0, exposure, None, False), Stay(1, 0, exposure, None, False)])
    made = [_with(each, count / exposure) for each, count in zip(found, counts, strict=True)]
    total = up + down
    expected = (down + up * math.exp(-total * step)) / total
    assert transitions_after(model, made, step)[0][0, 0] == pytest.approx(expected, rel=1e-6)


def _with(rates, rate):
    return msgspec.structs.replace(rates, rates=np.array([rate]))


def test_a_step_takes_time():
    with pytest.raises(ModelError, match="takes more than 0 seconds, not 0"):
        statistics(visits([0, 1, 0]), MODEL, step=0.0)


def test_times_are_added_without_error():
    """So that they are the same on all versions of Python, whose sum is another since 3.12, and not exact either."""
    seconds = [2.0**106, 2.0**53, 1.0, 1.0]  # just above the middle of two numbers
    assert holding([cut(each) for each in seconds]).exposure == float(sum(map(Fraction, seconds))) > 2.0**106
