"""The report: all that the decisions of an ensemble tell of its model, with names, in one struct."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ModelError
from mdm.estimation.agreement import FALSE_DISCOVERIES, Verdict, verdicts
from mdm.estimation.chains import Chain, Chains, Kind, chains_of, returns_of
from mdm.estimation.factors import pool_of
from mdm.estimation.gibbs import sample
from mdm.estimation.hidden import Matrices, alike, evidence_of, fit, frequencies, joint_odds
from mdm.estimation.intervals import LEVEL, check_level
from mdm.estimation.loss import Values, decided_policy, losses
from mdm.estimation.rates import MOST_STAGES, durations_of, rates_of, staying_of, transitions_after
from mdm.estimation.reestimation import reestimated, replaced
from mdm.estimation.rows import Row, counted, support, transition_rows
from mdm.models.durations import Durations
from mdm.models.mdp import MDP

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mdm.estimation.factors import Pool
    from mdm.estimation.hidden import Fit
    from mdm.estimation.rates import Rates
    from mdm.messages import Decision
    from mdm.models.matrices import Vector
    from mdm.models.pomdp import POMDP
    from mdm.models.space import Space

__all__ = [
    "Entry",
    "FitReport",
    "FrequencyReport",
    "RateReport",
    "Report",
    "RowReport",
    "statistics",
]

_LARGEST_LOSS = 4_000
"""States up to which losses of value are computed."""


class Entry(msgspec.Struct, frozen=True):
    """What may follow, by its name: its count, its probability (or rate a second) by the model and as estimated.

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
        says: See `mdm.estimation.agreement.Verdict`.
        p_value: Of the test; None where there was none.
        log_odds: The natural logarithm of the odds against the model; infinite where something impossible followed.
        loss: By how much the policy is worth less if the row is as estimated; None where that is not known, or the
            policy does not take the action there.
        entries: What may follow.
        impossible: What has followed though the model says that it cannot, with its count.
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
    """How long a state lasts under an action, and the rates of what follows.

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
        entries: The rates of what may follow.
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
    """All that the decisions of an ensemble tell of its model.

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
        notes: What was not computed, and why.
        model: The re-estimated model.
        durations: How long actions take in the re-estimated model; None where they take no time, or the period of a
            rate.
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
    """Return all that the decisions of an ensemble tell of its model.

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
    if chains.hidden:
        return _of_hidden(chains, model, notes, level=level, rate=false_discoveries, seed=seed)
    chains = _with_outcomes(chains, model, notes)
    return _of_states(chains, model, notes, step=step, policy=policy, level=level, rate=false_discoveries)


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
) -> Report:
    stays = list(chains.stays())
    if not any(stay.ended for stay in stays):
        raise ModelError(f"no decision of {chains.ensemble!r} follows from another: there is nothing to count")
    jumps = chains.kind == "jumps"
    rows = transition_rows(model, counted(stays), chains.kind, level=level)
    staying = _staying(model, rows) if jumps else {}
    found = rates_of(model, stays, level=level) if jumps else ()
    value, lost = _losses(model, chains, rows, staying, policy, notes)
    if step is not None and not jumps:
        raise ModelError("a step in seconds is for rates, of an ensemble that decides when its state changes")
    if step is not None and not (math.isfinite(step) and step > 0):
        raise ModelError(f"a time step of the model takes more than 0 seconds, not {step:g}")
    pool = pool_of(model, stays, chains.kind)
    if pool is not None:
        new = pool.model(step)
    else:
        new = reestimated(model, rows) if step is None else _after(model, found, step)
    if step is not None:
        if isinstance(model.discount_of, float) and model.discount_of != step:
            raise ModelError(f"a step of the model is {model.discount_of:g} s, not {step:g} s")
        steps = step if model.discount_of == "second" else 1.0
        new = new.with_discount(model.discount**steps, of=step)
    new.visits = np.zeros((len(model.state_space), len(model.action_space))) if pool is None else pool.visits()
    for row in rows:
        new.visits[row.state, row.action] = max(new.visits[row.state, row.action], row.visits)
    if jumps:  # as steps, of which some stay
        new.visits /= np.maximum(1 - staying_of(new), 1e-9)
    told = verdicts(rows, rate=rate)
    durations = _durations(new, chains, notes, pool) if step is None else Durations(step, MOST_STAGES)
    names = model.state_space
    reports = [_row("T", row, verdict, loss, model, names) for row, verdict, loss in zip(rows, told, lost, strict=True)]
    return Report(
        ensemble=chains.ensemble,
        kind=chains.kind,
        hidden=False,
        decisions=chains.decisions,
        chains=len(chains.chains),
        discarded=chains.discarded,
        level=level,
        value=value,
        rows=_sorted(reports),
        unvisited=_unvisited(model, {(row.action, row.state) for row in rows}),
        rates=tuple(_rates(each, model, step) for each in found),
        frequencies=(),
        returns=_returns(model, chains),
        paid=_returns(model, chains, paid=True),
        fit=None,
        impossible=(),
        ends=_ends(chains, model),
        notes=tuple(notes),
        model=new,
        durations=durations,
    )


def _of_hidden(chains: Chains, model: MDP, notes: list[str], *, level: float, rate: float, seed: int) -> Report:
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
    reports = []
    for (matrix, row), said in zip(rows, told, strict=True):
        verdict = _doubted(said, matrix, row, groups)
        names = pomdp.state_space if matrix == "T" else pomdp.observation_space
        reports.append(_row(matrix, row, verdict, None, pomdp, names))
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
    durations = _durations(model, chains, notes)
    seen = None if pomdp.event_observations else list(fitted.observations)
    new = replaced(model.flatten(), list(fitted.transitions), seen)
    new.visits = fitted.transition_counts.sum(axis=2).T
    return Report(
        ensemble=chains.ensemble,
        kind=chains.kind,
        hidden=True,
        decisions=chains.decisions,
        chains=len(chains.chains),
        discarded=chains.discarded,
        level=level,
        value=None,
        rows=_sorted(reports),
        unvisited=_unvisited(model, {(row.action, row.state) for matrix, row in rows if matrix == "T"}),
        rates=(),
        frequencies=_frequencies(pomdp, frequencies(pomdp, evidence)),
        returns=_returns(model, chains),
        paid=_returns(model, chains, paid=True),
        fit=FitReport(
            fitted.before,
            fitted.log_likelihood,
            fitted.rounds,
            odds,
            tuple(tuple(pomdp.state_space.names[state] for state in group) for group in groups),
        ),
        impossible=tuple(
            (model.action_space.names[action], _observed(pomdp, symbol), count)
            for action, symbol, count in evidence.impossible
        ),
        ends=_ends(chains, model),
        notes=tuple(notes),
        model=new,
        durations=durations,
    )


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


def _returns(model: MDP, chains: Chains, *, paid: bool = False) -> tuple[float, ...]:
    if paid and not any(chain.paid for chain in chains.chains):
        return ()
    return returns_of(model, chains.chains, in_time=model.discount_of == "second", paid=paid)


def _staying(model: MDP, rows: Iterable[Row]) -> dict[tuple[int, int], float]:
    """Return the probability of staying of rows that were visited, where it is not 0."""
    flat = model.flatten()
    found = {(row.action, row.state): float(flat.transition_matrix(row.action)[row.state, row.state]) for row in rows}
    return {key: stays for key, stays in found.items() if stays}


def _losses(
    model: MDP,
    chains: Chains,
    rows: Sequence[Row],
    staying: Mapping[tuple[int, int], float],
    policy: Sequence[int] | None,
    notes: list[str],
) -> tuple[float | None, list[float | None]]:
    timed = model.discount_of == "second"
    if timed or model.discount >= 1 or len(model.state_space) > _LARGEST_LOSS:
        why = "with a discount of a second" if timed else f"of more than {_LARGEST_LOSS} states"
        why = "with a discount of 1" if model.discount >= 1 else why
        notes.append(f"{why} the loss of value is not computed: mdm evaluate NEW_MODEL POLICY tells it")
        return None, [None] * len(rows)
    values = Values(model, decided_policy(model, chains.chains) if policy is None else policy)
    return values.start, losses(model, values, rows, staying)


def _after(model: MDP, found: Iterable[Rates], step: float) -> MDP:
    """Return the model whose rows are those of rates after a step, on its support."""
    flat, listed = model.flatten(), list(found)
    after = transitions_after(model, listed, step)
    rows = []
    for each in listed:
        symbols, probability = support(flat.transition_matrix(each.action), each.state)
        shares = after[each.action][each.state, symbols]
        shares = shares / shares.sum()
        # So many visits that the old row, which counts as one, tells nothing.
        rows.append(Row(each.action, each.state, symbols, probability, shares * 1e12, shares, shares, shares))
    return reestimated(model, rows)


def _durations(model: MDP, chains: Chains, notes: list[str], pool: Pool | None = None) -> Durations | None:
    if any(decision.cause == "tick" for chain in chains.chains for decision in chain.decisions):
        return None  # each takes its rate's period
    try:
        lasting = pool.lasting() if pool is not None and chains.kind == "jumps" else None
        return durations_of(model, chains.stays(), chains.kind, lasting=lasting)
    except ModelError as error:
        notes.append(str(error))
        return None


# -- Names -----------------------------------------------------------------------------------------------------------


def _row(matrix: str, row: Row, verdict: Verdict, loss: float | None, model: MDP, names: Space) -> RowReport:
    columns = (row.counts, row.model, row.estimates, row.low, row.high)
    symbols = [names.names[symbol] for symbol in row.symbols.tolist()]
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
        tuple((names.names[symbol], count) for symbol, count in row.impossible),
    )


def _sorted(rows: Iterable[RowReport]) -> tuple[RowReport, ...]:
    """Return the rows, those first that differ, by their evidence and their loss."""
    return tuple(sorted(rows, key=lambda row: (row.says != "differs", -row.log_odds, -(row.loss or 0.0))))


def _unvisited(model: MDP, visited: set[tuple[int, int]]) -> tuple[tuple[str, str], ...]:
    actions, states = model.action_space.names, model.state_space.names
    return tuple(
        (actions[action], states[state])
        for action in range(len(actions))
        for state in range(len(states))
        if (action, state) not in visited
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


def _frequencies(model: POMDP, found: Iterable[Any]) -> tuple[FrequencyReport, ...]:
    names = model.observation_space.names
    return tuple(
        FrequencyReport(
            model.action_space.names[each.action],
            tuple(zip(names, each.counts.tolist(), each.expected.tolist(), strict=True)),
            each.missing,
        )
        for each in found
    )


def _ends(chains: Chains, model: MDP) -> tuple[tuple[str, str, str, int], ...]:
    counts: Counter[tuple[int | None, int, str]] = Counter()
    for state, action, end, count in chains.ends:
        counts[state, action, end] += count
    actions, states = model.action_space.names, model.state_space.names
    return tuple(
        sorted(
            (actions[action], "" if state is None else states[state], end, n)
            for (state, action, end), n in counts.items()
        )
    )


def _observed(model: POMDP, symbol: int | tuple[int | None, ...] | None) -> str:
    if isinstance(symbol, int):
        return model.observation_space.names[symbol]
    if symbol is None:
        return "nothing"
    pairs = zip(model.observation_space.factors, symbol, strict=True)
    return ", ".join("?" if component is None else factor.names[component] for factor, component in pairs)
