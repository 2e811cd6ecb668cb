"""The report: all that the decisions of an ensemble say about its model, with names, as a struct, text or data."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ModelError
from mdm.estimation.chains import Chain, Chains, Kind, chains_of, returns_of
from mdm.estimation.hidden import Matrices, alike, evidence_of, fit, frequencies, joint_odds, sample
from mdm.estimation.loss import Values, decided_policy, losses
from mdm.estimation.rates import MOST_STAGES, durations_of, rates_of, staying_of, transitions_after
from mdm.estimation.reestimation import pool_of, reestimated, replaced
from mdm.estimation.rows import (
    FALSE_DISCOVERIES,
    LEVEL,
    Row,
    Verdict,
    check_level,
    counted,
    support,
    transition_rows,
    verdicts,
)
from mdm.models.durations import Durations
from mdm.models.mdp import MDP
from mdm.texts import counted as number_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mdm.estimation.hidden import Fit
    from mdm.estimation.rates import Rates
    from mdm.estimation.reestimation import Pool
    from mdm.messages import Decision
    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP

_LARGEST_LOSS = 4_000
"""States up to which losses of value are computed."""
_SHOWN = 20
"""Rows of each kind that the text shows."""
_ODDS = 20
"""The odds from which on a model differs: of models that are right, one in so many."""
_NAMED = 3
"""Impossible symbols that a row names, of many."""


class Entry(msgspec.Struct, frozen=True):
    """A symbol that may follow, by name: its count, its probability (or rate a second) by the model and as estimated.

    ``low`` and ``high`` are the ends of the interval; ``model`` is None where the model tells no rate.
    """

    symbol: str
    count: float
    model: float | None
    estimate: float
    low: float
    high: float


class RowReport(msgspec.Struct, frozen=True):
    """A row of T or O, and whether it agrees with the model.

    Attributes:
        matrix: ``T`` or ``O``.
        action: The action.
        state: Of T the state before it, of O the one after it.
        visits: How often; expected, where states are hidden.
        says: See `mdm.estimation.rows.Verdict`.
        p_value: Of the test; None where there was none.
        log_odds: The natural logarithm of the odds against the model; infinite where something impossible followed.
        loss: By how much the policy is worth less if the row is as estimated; None where that is not known, or the
            policy does not take the action there.
        entries: The symbols that may follow.
        impossible: The symbols that have followed though the model says that they cannot, with their counts.
    """

    matrix: str
    action: str
    state: str
    visits: float
    says: str
    p_value: float | None
    log_odds: float
    loss: float | None
    entries: tuple[Entry, ...]
    impossible: tuple[tuple[str, int], ...]


class RateReport(msgspec.Struct, frozen=True):
    """How long a state lasts under an action, and the rates of the next ones.

    Attributes:
        action: The action.
        state: The state.
        exposure: The seconds spent in it.
        ends: How many stays came to their end.
        mean: The expected seconds; not a number where no stay has ended.
        low: The lower end of its interval.
        high: The upper end.
        p_value: Of Moran's test; None where it was not made.
        stages: Of the Erlang distribution; 1 where stays may be exponential.
        entries: The rates of the states that may follow.
    """

    action: str
    state: str
    exposure: float
    ends: int
    mean: float
    low: float
    high: float
    p_value: float | None
    stages: int
    entries: tuple[Entry, ...]


class FrequencyReport(msgspec.Struct, frozen=True):
    """How often each observation was made after an action, and how often the model expected it."""

    action: str
    observations: tuple[tuple[str, float, float], ...]
    missing: int


class FitReport(msgspec.Struct, frozen=True):
    """Expectation maximisation, and the test of all rows of T and O together.

    Attributes:
        before: The log likelihood by the model in use.
        after: By the estimate.
        rounds: The number of rounds.
        log_odds: The natural logarithm of the odds against all of T and O together: `mdm.estimation.hidden.joint_odds`.
        alike: The states that nothing in the record tells apart by the model, in groups.
    """

    before: float
    after: float
    rounds: int
    log_odds: float
    alike: tuple[tuple[str, ...], ...]


class Report(msgspec.Struct, frozen=True):
    """All that the decisions of an ensemble say about its model.

    Attributes:
        ensemble: The path of the ensemble.
        kind: ``steps`` or ``jumps``, see `mdm.estimation.chains.Kind`.
        hidden: Whether its states are hidden, so that counts are expected ones.
        decisions: The number of decisions that were counted.
        chains: The number of chains that they form.
        discarded: The number of decisions of which neither state nor observation is known.
        level: The probability of the intervals.
        value: The value of the policy by the model; None where it is not computed.
        rows: Rows of T and of O that were visited, those first that differ, by their evidence.
        unvisited: Actions and states of which nothing is known.
        rates: Rates and holding times, of jumps.
        frequencies: Observations, where states are hidden.
        returns: The discounted return of each episode, of rewards as the model in use and its beliefs expected them.
        paid: The same of the rewards that a simulated world has paid; none where no record tells them.
        fit: Where states are hidden.
        impossible: Observations that the model holds impossible, by action, with their count.
        ends: How actions have ended, of records: the action, the state that it was decided in (empty where hidden), the
            end as ``failed``, and how often.
        notes: The parts that were not computed, and why.
        model: The re-estimated model.
        durations: How long actions take in the re-estimated model; None where they take no time, or the period of a
            rate.
        shielded: Replaced by a shield: the action that the policy wanted, the one taken, and how often.
    """

    ensemble: str
    kind: Kind
    hidden: bool
    decisions: int
    chains: int
    discarded: int
    level: float
    value: float | None
    rows: tuple[RowReport, ...]
    unvisited: tuple[tuple[str, str], ...]
    rates: tuple[RateReport, ...]
    frequencies: tuple[FrequencyReport, ...]
    returns: tuple[float, ...]
    paid: tuple[float, ...]
    fit: FitReport | None
    impossible: tuple[tuple[str, str, int], ...]
    ends: tuple[tuple[str, str, str, int], ...]
    notes: tuple[str, ...]
    model: MDP
    durations: Durations | None
    shielded: tuple[tuple[str, str, int], ...] = ()

    def count(self, says: str) -> int:
        """Return of how many rows the verdict is this."""
        return sum(row.says == says for row in self.rows)


# -- Making it -------------------------------------------------------------------------------------------------------


def statistics(
    decisions: Iterable[Decision] | Chains,
    model: MDP,
    *,
    ensemble: str | None = None,
    kind: Kind | None = None,
    stops: Iterable[int] = (),
    step: float | None = None,
    policy: Sequence[int] | None = None,
    level: float = LEVEL,
    false_discoveries: float = FALSE_DISCOVERIES,
    seed: int = 0,
) -> Report:
    """Return all that the decisions of an ensemble say about its model.

    Args:
        decisions: Of a record, or of `mdm.testing.capture_decisions`, in their order; or chains of several runs.
        model: The model in use.
        ensemble: Its path; it has to be given where several have decided. Chains have theirs.
        kind: See `mdm.estimation.chains.chains_of`; chains have theirs.
        stops: See there; chains have theirs.
        step: The seconds that a time step of the model stands for, by which its rewards are paid. Rates then become the
            rows of the re-estimated model, expm(Q * step), and each action takes so long; its discount is of such a
            step, converted from that of the model in use where that is of a second. Without it its probabilities of
            staying are the old ones, and actions take as long as they were seen to.
        policy: The action of each state, for the loss of value; by default the actions that were decided.
        level: The probability of the intervals.
        false_discoveries: The share of rows said to differ that agree, in expectation.
        seed: Of the intervals where states are hidden.

    Raises:
        ModelError: If there is nothing to count, or the model does not fit the decisions.

    Example::

        with capture_decisions(runtime) as decisions:
            ...
        report = mdm.estimation.statistics(decisions, model)
        print(mdm.estimation.as_text(report))
    """
    chains = decisions
    if not isinstance(chains, Chains):
        chains = chains_of(chains, ensemble=ensemble, kind=kind, stops=stops)
    _check_fit(model, chains)
    check_level(level)
    notes = [f"not counted: {each}" for each in chains.unused]
    found: dict[str, Any] = {"value": None, "rates": (), "frequencies": (), "fit": None, "impossible": ()}
    if chains.hidden:
        found |= _of_hidden(chains, model, notes, level=level, rate=false_discoveries, seed=seed)
    else:
        chains = _with_outcomes(chains, model, notes)
        found |= _of_states(chains, model, notes, step=step, policy=policy, level=level, rate=false_discoveries)
    actions, states = model.action_space.names, model.state_space.names
    ends: Counter[tuple[str, str, str]] = Counter()
    for state, action, end, count in chains.ends:
        ends[actions[action], "" if state is None else states[state], end] += count
    told = [each for chain in chains.chains for each in chain.decisions if each.wanted is not None]
    shielded = Counter((str(each.wanted_name), each.action_name) for each in told)
    rows: list[tuple[str, Row, Verdict, float | None]] = found["rows"]
    visited = {(row.action, row.state) for matrix, row, _, _ in rows if matrix == "T"}
    pairs = ((action, state) for action in range(len(actions)) for state in range(len(states)))
    reports = [_row(model, *row) for row in rows]
    # Those first that differ, by their evidence and their loss.
    found["rows"] = tuple(sorted(reports, key=lambda row: (row.says != "differs", -row.log_odds, -(row.loss or 0.0))))
    in_time, paid = model.discount_of == "second", any(chain.paid for chain in chains.chains)
    return Report(
        ensemble=chains.ensemble,
        kind=chains.kind,
        hidden=chains.hidden,
        decisions=chains.decisions,
        chains=len(chains.chains),
        discarded=chains.discarded,
        level=level,
        unvisited=tuple((actions[pair[0]], states[pair[1]]) for pair in pairs if pair not in visited),
        returns=returns_of(model, chains.chains, in_time=in_time),
        paid=returns_of(model, chains.chains, in_time=in_time, paid=True) if paid else (),
        ends=tuple(sorted((*key, count) for key, count in ends.items())),
        notes=tuple(notes),
        shielded=tuple((*pair, count) for pair, count in shielded.most_common()),
        **found,
    )


def _check_fit(model: MDP, chains: Chains) -> None:
    states, actions = len(model.state_space), len(model.action_space)
    if chains.hidden and model.pomdp is None:
        raise ModelError(f"{chains.ensemble!r} decides on observations, but the model is an MDP, which has none")
    for chain in chains.chains:
        for decision in chain.decisions:
            if decision.action >= actions:
                raise ModelError(
                    f"{chains.ensemble!r} decided on action {decision.action}, but the model has {actions} actions"
                )
            if decision.state is not None and decision.state >= states:
                raise ModelError(
                    f"{chains.ensemble!r} was in state {decision.state}, but the model has {states} states"
                )
            if chains.hidden and decision.belief is not None and len(decision.belief) != states:
                raise ModelError(
                    f"{chains.ensemble!r} had a belief over {len(decision.belief)} states, but the model has {states}"
                )


def _with_outcomes(chains: Chains, model: MDP, notes: list[str]) -> Chains:
    """Return chains that end in the state that is the outcome of their last action, where that is known.

    An ensemble that was stopped by the success of its action decides on no outcome. If the action leads to one state
    that nothing leads out of, this is the outcome.
    """
    flat, actions = model.flatten(), range(len(model.action_space))
    stays = np.array([flat.transition_matrix(action).diagonal() for action in actions])
    absorbing = np.flatnonzero((stays == 1).all(axis=0))
    parts, unknown = [], 0
    for chain in chains.chains:
        last, at = chain.decisions[-1], chain.succeeded
        if at is not None and last.state is not None:
            reached = [state for state in absorbing.tolist() if flat.transition(last.action, last.state, state) > 0]
            unknown += len(reached) != 1
            if len(reached) == 1:
                end = msgspec.structs.replace(
                    last, time=at, epoch=last.epoch + 1, cause="state", state=reached[0], reward=0.0
                )
                parts.append(Chain((*chain.decisions, end), paid=chain.paid))
                continue
        parts.append(chain)
    if unknown:
        notes.append(
            f"{unknown} times the success of an action ended {chains.ensemble!r} before it had decided on the outcome: "
            f"the model has no single state there that nothing leads out of, so that the last step is not counted"
        )
    return msgspec.structs.replace(chains, chains=tuple(parts))


def _of_states(
    chains: Chains,
    model: MDP,
    notes: list[str],
    *,
    step: float | None,
    policy: Sequence[int] | None,
    level: float,
    rate: float,
) -> dict[str, Any]:
    """Return the parts of a report on states that are known, its rows yet without names."""
    stays = list(chains.stays())
    if not any(stay.ended for stay in stays):
        raise ModelError(f"no decision of {chains.ensemble!r} follows from another: there is nothing to count")
    jumps = chains.kind == "jumps"
    rows = transition_rows(model, counted(stays), chains.kind, level=level)
    found = rates_of(model, stays, level=level) if jumps else ()
    value: float | None = None
    lost: list[float | None] = [None] * len(rows)
    timed = model.discount_of == "second"
    if timed or model.discount >= 1 or len(model.state_space) > _LARGEST_LOSS:
        why = "with a discount of a second" if timed else f"of more than {_LARGEST_LOSS} states"
        why = "with a discount of 1" if model.discount >= 1 else why
        notes.append(f"{why} the loss of value is not computed: mdm evaluate NEW_MODEL POLICY tells it")
    else:
        values = Values(model, decided_policy(model, chains.chains) if policy is None else policy)
        value, lost = values.start, losses(model, values, rows, chains.kind)
    if step is not None and not jumps:
        raise ModelError("a step in seconds is for rates, of an ensemble that decides when its state changes")
    if step is not None and not (math.isfinite(step) and step > 0):
        raise ModelError(f"a time step of the model takes more than 0 seconds, not {step:g}")
    pool = pool_of(model, stays, chains.kind)
    if pool is not None:
        new = pool.model(step)
    else:
        new = reestimated(model, rows if step is None else _rows_after(model, found, step))
    if step is not None:
        if isinstance(model.discount_of, float) and model.discount_of != step:
            raise ModelError(f"a step of the model is {model.discount_of:g} s, not {step:g} s")
        new = new.with_discount(model.discount ** (step if timed else 1.0), of=step)
    new.visits = np.zeros((len(model.state_space), len(model.action_space))) if pool is None else pool.visits()
    for row in rows:
        new.visits[row.state, row.action] = max(new.visits[row.state, row.action], row.visits)
    if jumps:  # as steps, of which some stay
        new.visits /= np.maximum(1 - staying_of(new), 1e-9)
    told = verdicts(rows, rate=rate)
    return {
        "value": value,
        "rows": [("T", *each) for each in zip(rows, told, lost, strict=True)],
        "rates": tuple(_rates(each, model, step) for each in found),
        "model": new,
        "durations": _durations(new, chains, notes, pool) if step is None else Durations(step, MOST_STAGES),
    }


def _rows_after(model: MDP, found: Sequence[Rates], step: float) -> list[Row]:
    """Return the rows of rates after a step, on the support of the model."""
    flat, after = model.flatten(), transitions_after(model, found, step)
    rows = []
    for each in found:
        symbols, probability = support(flat.transition_matrix(each.action), each.state)
        shares = after[each.action][each.state, symbols]
        shares = shares / shares.sum()
        # So many visits that the old row, which counts as one, tells nothing.
        rows.append(Row(each.action, each.state, symbols, probability, shares * 1e12, shares, shares, shares))
    return rows


def _durations(model: MDP, chains: Chains, notes: list[str], pool: Pool | None = None) -> Durations | None:
    if any(decision.cause == "tick" for chain in chains.chains for decision in chain.decisions):
        return None  # each takes its rate's period
    try:
        lasting = pool.lasting() if pool is not None and chains.kind == "jumps" else None
        return durations_of(model, chains.stays(), chains.kind, lasting=lasting)
    except ModelError as error:
        notes.append(str(error))
        return None


def _of_hidden(chains: Chains, model: MDP, notes: list[str], *, level: float, rate: float, seed: int) -> dict[str, Any]:
    """Return the parts of a report on states that are hidden, its rows yet without names."""
    pomdp = model.pomdp
    assert pomdp is not None
    if any(decision.cause == "tick" for chain in chains.chains for decision in chain.decisions):
        pomdp = pomdp.step_by_step()
    evidence = evidence_of(pomdp, chains.chains)
    if not evidence.steps:
        outside = any(chain.decisions[0].cause == "belief" for chain in chains.chains)
        why = ": it decides on beliefs from outside, and what was observed is not known" if outside else ""
        raise ModelError(f"no decision of {chains.ensemble!r} follows from another{why}: there is nothing to count")
    fitted = fit(pomdp, evidence)
    intervals = sample(pomdp, evidence, fitted, seed=seed, level=level)
    rows = _hidden_rows(pomdp, fitted, intervals)
    groups = alike(pomdp, evidence)
    odds = joint_odds(pomdp, chains.chains, tilted=bool(groups))
    p_values = [float(intervals.p_values["TO".index(matrix)][row.action, row.state]) for matrix, row in rows]
    told = verdicts([row for _, row in rows], rate=rate, p_values=p_values)
    notes.append("where states are hidden the loss of value is not computed: mdm evaluate NEW_MODEL POLICY tells it")
    followers = [each for chain in chains.chains for each in chain.decisions[1:]]
    partly = sum(isinstance(each.observation, tuple) and None in each.observation for each in followers)
    if partly:
        notes.append(
            f"in {partly} of {evidence.steps} steps a part of the observation is missing: it counts as missing by "
            f"chance, as of a link, and not because of what was seen"
        )
    if pomdp.event_observations:
        notes.append("observations of events, P(o | s, a, s'), are those of the model; T alone was estimated")
    if model.network is not None:
        notes.append("where states are hidden rows are estimated one by one: the new model is flat, and no network")
    seen = None if pomdp.event_observations else list(fitted.observations)
    new = replaced(model.flatten(), list(fitted.transitions), seen)
    new.visits = fitted.transition_counts.sum(axis=2).T
    actions, observations = pomdp.action_space.names, pomdp.observation_space.names
    alikes = tuple(tuple(pomdp.state_space.names[state] for state in group) for group in groups)
    return {
        "rows": [
            (matrix, row, _doubted(verdict, matrix, row, groups), None)
            for (matrix, row), verdict in zip(rows, told, strict=True)
        ],
        "frequencies": tuple(
            FrequencyReport(
                actions[each.action],
                tuple(zip(observations, each.counts.tolist(), each.expected.tolist(), strict=True)),
                each.missing,
            )
            for each in frequencies(pomdp, evidence)
        ),
        "fit": FitReport(fitted.before, fitted.log_likelihood, fitted.rounds, odds, alikes),
        "impossible": tuple(
            (actions[action], _observed(pomdp, symbol), count) for action, symbol, count in evidence.impossible
        ),
        "model": new,
        "durations": _durations(model, chains, notes),
    }


def _hidden_rows(model: POMDP, fitted: Fit, intervals: Any) -> list[tuple[str, Row]]:
    """Return the rows of T and O that were visited at least half a time, in expectation."""
    old = Matrices.of(model)
    kinds: list[tuple[str, Vector, Vector, Vector, Vector]] = [
        ("T", old.transitions, fitted.transition_counts, fitted.transitions, intervals.transitions)
    ]
    if not model.event_observations:
        kinds.append(("O", old.observations, fitted.observation_counts, fitted.observations, intervals.observations))
    rows = []
    for matrix, before, counts, estimates, ends in kinds:
        for action, state in np.argwhere(counts.sum(axis=2) >= 0.5).tolist():
            symbols = np.flatnonzero(before[action, state])
            parts = [each[action, state, symbols] for each in (before, counts, estimates, ends[0], ends[1])]
            rows.append((matrix, Row(action, state, symbols, *parts)))
    return rows


def _doubted(verdict: Verdict, matrix: str, row: Row, groups: Sequence[tuple[int, ...]]) -> Verdict:
    """Return no agreement that an interval refutes, and none but doubt of states that are not told apart."""
    names = {row.state} | (set(row.symbols.tolist()) if matrix == "T" else set())
    mixed = any(row.state in group or len(names.intersection(group)) > 1 for group in groups)
    refuted = bool(((row.model < row.low) | (row.model > row.high)).any())
    if verdict.p_value is not None and (mixed or (refuted and verdict.says == "agrees")):
        return msgspec.structs.replace(verdict, says="unclear")
    return verdict


# -- Names -----------------------------------------------------------------------------------------------------------


def _row(model: MDP, matrix: str, row: Row, verdict: Verdict, loss: float | None) -> RowReport:
    space = model.state_space if matrix == "T" else model.observation_space
    assert space is not None
    columns = (row.counts, row.model, row.estimates, row.low, row.high)
    symbols = [space.names[symbol] for symbol in row.symbols.tolist()]
    entries = tuple(Entry(*parts) for parts in zip(symbols, *(column.tolist() for column in columns), strict=True))
    return RowReport(
        matrix,
        model.action_space.names[row.action],
        model.state_space.names[row.state],
        row.visits,
        verdict.says,
        verdict.p_value,
        verdict.log_odds,
        loss,
        entries,
        tuple((space.names[symbol], count) for symbol, count in row.impossible),
    )


def _rates(found: Rates, model: MDP, step: float | None) -> RateReport:
    held, names = found.holding, model.state_space.names
    expected: list[float | None] = [None] * len(found.symbols)
    if step is not None:
        row = model.transition(found.action, found.state)
        stays = float(row[found.state])
        leaving = -math.log(stays) / step if stays > 0 else math.inf
        expected = [leaving * float(row[symbol]) / (1 - stays) for symbol in found.symbols.tolist()]
    columns = (found.counts.tolist(), expected, found.rates.tolist(), found.low.tolist(), found.high.tolist())
    symbols = [names[symbol] for symbol in found.symbols.tolist()]
    return RateReport(
        model.action_space.names[found.action],
        names[found.state],
        *(held.exposure, held.ends, held.mean, held.low, held.high, held.p_value, held.stages),
        tuple(Entry(*parts) for parts in zip(symbols, *columns, strict=True)),
    )


def _observed(model: POMDP, symbol: int | tuple[int | None, ...] | None) -> str:
    if isinstance(symbol, int):
        return model.observation_space.names[symbol]
    if symbol is None:
        return "nothing"
    pairs = zip(model.observation_space.factors, symbol, strict=True)
    return ", ".join("?" if component is None else factor.names[component] for factor, component in pairs)


# -- Rendering ---------------------------------------------------------------------------------------------------------


def as_data(report: Report) -> dict[str, Any]:
    """Return a report as plain data for JSON, without the new model and the durations; no number is not finite."""
    fields = {name: getattr(report, name) for name in report.__struct_fields__ if name not in {"model", "durations"}}
    result: dict[str, Any] = _finite(msgspec.to_builtins(fields))
    return result


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_text(report: Report) -> str:
    """Return a report as lines for people: at most 20 rows of each kind, all of which `as_data` has."""
    lines = [*_head(report), *_rows_text(report), *_rates_text(report), *_frequencies_text(report)]
    lines += _ends_text(report)
    lines += [f"note: {note}" for note in report.notes]
    return "\n".join(lines)


def _head(report: Report) -> list[str]:
    states = "hidden states" if report.hidden else "known states"
    size = f"{number_of(report.decisions, 'decision')} in {number_of(report.chains, 'chain')}"
    lines = [f"{report.ensemble}: {size}, {report.kind}, {states}"]
    factors = [factor.name for factor in report.model.state_space.factors]
    if len(factors) > 1:
        lines.append(f"a state is {', '.join(factors)}")
    if report.discarded:
        lines.append(f"{number_of(report.discarded, 'decision')} left out: neither state nor observation is known")
    if report.shielded:
        pairs = [f"{wanted} by {action} {number_of(count, 'time')}" for wanted, action, count in report.shielded]
        times = f"{sum(count for _, _, count in report.shielded):,} of {number_of(report.decisions, 'decision')}"
        lines.append(f"the shield replaced the policy's action at {times}: {', '.join(pairs[:_NAMED])}")
    if report.returns:
        expected = f"expected by {'beliefs in ' if report.hidden else ''}the model in use"
        promised = "" if report.value is None else f"; the model promises {report.value:.4g}"
        episodes = f"returns of {number_of(len(report.returns), 'episode')}"
        lines.append(f"{episodes}, {expected}: {_mean(report.returns)}{promised}")
        if report.paid:
            lines.append(f"{episodes}, as the simulated world has paid: {_mean(report.paid)}")
    if report.fit is not None:
        lines.append(
            f"log likelihood {report.fit.before:.2f} by the model, {report.fit.after:.2f} by the estimate "
            f"({number_of(report.fit.rounds, 'round')})"
        )
        ruled = "it differs" if report.fit.log_odds >= math.log(_ODDS) else "it agrees"
        lines.append(f"T and O together: the odds against the model are {_odds(report.fit.log_odds)}: {ruled}")
        for group in report.fit.alike[:_NAMED]:
            more = f" and {len(group) - _NAMED} more" if len(group) > _NAMED else ""
            lines.append(
                f"these states cannot be told apart by the model in this record: {', '.join(group[:_NAMED])}{more}; "
                f"which of them is which is not estimated"
            )
    kinds = ("differs", "agrees", "certain", "too few", *(["unclear"] if report.count("unclear") else []))
    lines.append(
        f"rows: {', '.join(f'{report.count(says)} {says}' for says in kinds)}; {len(report.unvisited)} not visited"
    )
    return lines


def _mean(returns: Sequence[float]) -> str:
    values = np.asarray(returns)
    spread = f" ± {values.std(ddof=1) / math.sqrt(len(values)):.4g} (standard error)" if len(values) > 1 else ""
    return f"{values.mean():.4g}{spread}"


def _rows_text(report: Report) -> list[str]:
    lines = []
    impossible = [(row, symbol, count) for row in report.rows for symbol, count in row.impossible]
    for row, symbol, count in impossible[:_SHOWN]:
        lines.append(f"impossible by the model: {row.state} -{row.action}-> {symbol}, {count} times")
    for action, symbol, count in report.impossible[:_SHOWN]:
        lines.append(f"impossible by the model: {symbol} after {action}, {count} times")
    shown = [row for row in report.rows if row.says in {"differs", "unclear"} and row.entries][:_SHOWN]
    if not shown:
        return lines
    title = "rows that differ, or are unclear" if report.count("unclear") else "rows that differ"
    lines += ["", f"{title:40}" + f"visits    model  estimate  {report.level:.0%} interval"]
    for row in shown:
        lines.append(f"{row.matrix} {row.action} {row.state}: {_why(row)}")
        lines += [
            f"  {entry.symbol:36}{entry.count:8.6g} {entry.model or 0:8.4f}  {entry.estimate:8.4f}  "
            f"{entry.low:.4f} to {entry.high:.4f}"
            for entry in row.entries
        ]
    return lines


def _why(row: RowReport) -> str:
    """Return why a row differs from the model, and the loss of value."""
    parts = []
    if row.impossible:
        symbols = ", ".join(symbol for symbol, _ in row.impossible[:_NAMED])
        more = len(row.impossible) - _NAMED
        parts.append(f"{symbols}{f' and {more} more' if more > 0 else ''} followed, impossible by the model")
    parts += ["unclear"] if row.says == "unclear" else []
    parts += [] if row.p_value is None else [f"p {row.p_value:.2g}"]
    parts += [f"odds {_odds(row.log_odds)}"] if math.isfinite(row.log_odds) else []
    parts += [] if row.loss is None else [f"loss {row.loss:.4g}"]
    if (
        row.says == "differs"
        and not row.impossible
        and all(entry.low <= (entry.model or 0) <= entry.high for entry in row.entries)
    ):
        parts.append("by all entries together, of which each alone has the model's value in its interval")
    return ", ".join(parts)


def _odds(logarithm: float) -> str:
    power = logarithm / math.log(10)
    return f"10^{power:.0f} to 1" if power >= 4 else f"{10**power:.3g} to 1"


def _rates_text(report: Report) -> list[str]:
    if not report.rates:
        return []
    lines = ["", "how long states last" + " " * 20 + "  ends   seconds  interval"]
    for each in report.rates[:_SHOWN]:
        form = "" if each.stages == 1 else f"  Erlang, {each.stages} stages"
        lines.append(
            f"{each.state + ', ' + each.action:40}{each.ends:6} {each.mean:9.4g}  "
            f"{each.low:.4g} to {each.high:.4g}{form}"
        )
    return lines


def _ends_text(report: Report) -> list[str]:
    """Return how actions have ended that have not only succeeded, or been pre-empted."""
    by_row: dict[str, dict[str, int]] = {}
    for action, state, end, count in report.ends:
        by_row.setdefault(f"{state}, {action}" if state else action, {})[end] = count
    told = {row: ends for row, ends in by_row.items() if ends.keys() - {"succeeded", "preempted"}}
    lines = ["", "actions that failed or were cut short"] if told else []
    for row, ends in [*told.items()][:_SHOWN]:
        lines.append(f"{row}: {', '.join(f'{count} {end}' for end, count in ends.items())}")
    return lines


def _frequencies_text(report: Report) -> list[str]:
    if not report.frequencies:
        return []
    lines = ["", "observations" + " " * 28 + "  times  expected"]
    for each in report.frequencies[:_SHOWN]:
        lines += [
            f"{each.action + ', ' + name:40}{count:7.6g} {expected:9.6g}" for name, count, expected in each.observations
        ]
    return lines
