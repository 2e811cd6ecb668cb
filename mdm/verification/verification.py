"""The numbers of a policy, or of all policies: `verify`.

Nothing is discounted. Policies over states and finite-state controllers are verified exactly, by their Markov
chains; policies over beliefs by simulation. Without a policy the numbers are the least and greatest over all
policies that see the state: no policy over observations is outside of them.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from mdm.checks import check_seed, is_whole
from mdm.errors import ConfigError, ModelError
from mdm.loading import model_of, policy_of
from mdm.models.specification import Specification
from mdm.policies import DeterministicPolicy, Policy, StagedPolicy, mismatch
from mdm.verification import reaching, shares
from mdm.verification.chains import chain_of_policy
from mdm.verification.choices import Choices, Graph
from mdm.verification.unfolding import Bounds, bounds_of
from mdm.verification.ways import Decision, Way, likeliest_way, worst_decision

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.models.space import Symbol
    from mdm.verification.optimum import Optimum

_STAGED = 20_000_000
"""The most numbers of a policy by stages; a larger one is not kept."""


class Exact(msgspec.Struct, frozen=True):
    """A number that is computed.

    Attributes:
        value: A probability, an expected number of steps (infinite where X is not certain), or a share of steps.
        error: How far it may be from the truth.
    """

    value: float
    error: float


class Estimate(msgspec.Struct, frozen=True):
    """A number that is estimated by simulation.

    Attributes:
        lower: The lower end of its interval.
        upper: The upper end.
        confidence: The probability with which such intervals hold the truth.
        episodes: How many were simulated.
        undecided: In how many it is not known whether they ever reach X: they count for both ends.
        seed: The seed, for the same episodes again.
    """

    lower: float
    upper: float
    confidence: float
    episodes: int
    undecided: int
    seed: int


class Verification(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to a specification.

    Attributes:
        kind: ``P`` for a probability, ``E`` for an expectation of steps, ``S`` for a share of steps.
        result: The policy's number; None where no policy is given.
        least: The least number of any policy that sees the state; None where a policy is given.
        greatest: The greatest.
        way: The most probable way into X, under the policy or one that attains the greatest; None if there is none.
        decision: The decision that contributes most to reaching X; None if no other lowers the probability.
        policies: Policies that attain the least and the greatest.
        bounds: Those of the belief graph, where they were asked for.
    """

    kind: Literal["P", "E", "S"]
    result: Exact | Estimate | None = None
    least: Exact | None = None
    greatest: Exact | None = None
    way: Way | None = None
    decision: Decision | None = None
    policies: tuple[Policy | None, Policy | None] = (None, None)
    bounds: Bounds | None = None

    def facts(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON, where an infinite one is the text ``infinite``."""

        def told(each: Exact | Estimate) -> dict[str, Any]:
            facts = msgspec.structs.asdict(each)
            if isinstance(each, Exact):
                facts = {"probability" if self.kind == "P" else "value": each.value, "error": each.error}
            numbers = {key: facts[key] for key in facts if key not in {"episodes", "undecided", "seed"}}
            return {key: number if np.isfinite(number) else "infinite" for key, number in numbers.items()}

        if self.result is not None:
            return told(self.result) | ({} if self.bounds is None else {"bounds": msgspec.structs.asdict(self.bounds)})
        return {key: told(each) for key in ("least", "greatest") if (each := getattr(self, key)) is not None}


def verify(
    model: GivenModel,
    specification: str,
    policy: GivenPolicy | None = None,
    *,
    start: Symbol | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    bounds: float | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Verification:
    """Return how probable, how soon or how often something is, under a policy or at least and at most.

    Specifications, with X and Y for formulas over states and actions:

    - ``P(reach X)``, ``P(reach X within 50)``, ``P(reach X before Y)``: the probability that X ever holds, within so
      many steps, or at a step before which Y has not held;
    - ``P(always X)``: that X holds at each step for ever;
    - ``E(steps until X)``: the expected steps before the first at which X holds, infinite where it may never hold;
    - ``S(X)``: the share of steps at which X holds, in the long run.

    Args:
        model: The model, or the path of its file. Its discount is of no effect.
        specification: The question.
        policy: A policy of any kind, see `Controller`; by default all policies that see the state.
        start: A state to begin in; by default the initial belief of the model.
        episodes: How many to simulate, for a policy over beliefs; by default 10,000, or 1,000 if they run one by one.
        seed: The same seed gives the same estimate; by default it is random.
        bounds: Seconds for which to unfold the belief graph of a policy over beliefs, for bounds beside the estimate.
        progress: Called with how many episodes have ended, and of how many; where it returns True there are no more.

    Raises:
        FormatError: If the specification does not parse.
        ModelError: If the model has no such name, or the number cannot be found for this kind of policy.
        ConfigError: If the policy does not fit the model.

    Example::

        answer = mdm.verify("grid.mdp", "P(reach pit-* before goal)", policy)
        answer.result.value  # .034
        answer = mdm.verify("grid.mdp", "P(reach pit-* before goal)")
        answer.least.value, answer.greatest.value  # 0.0, 1.0
    """
    model = model_of(model)
    asked = Specification.of(specification, model)
    if start is not None:
        first = np.zeros(len(model.state_space))
        first[model.state_space.index(start)] = 1
        first.setflags(write=False)
        model = copy.copy(model)
        vars(model).update(_initial_belief=first, initial_belief=first)  # one or the other, by the kind of model
    if bounds is not None and not bounds >= 0:
        raise ConfigError(f"bounds are given as 0 seconds or more, not {bounds}")
    found: Any = None if policy is None else policy_of(policy, model)
    if found is not None and (wrong := mismatch(found, model)) is not None:
        raise ConfigError(wrong)
    chain = None if found is None else chain_of_policy(model, found)
    if found is not None and chain is None:
        unfolded = None if bounds is None else bounds_of(model, found, asked, bounds)
        result = _simulated(model, found, asked, episodes, seed, progress)
        return Verification(kind=asked.kind, result=result, bounds=unfolded)
    if bounds is not None:
        raise ConfigError("bounds are for policies over beliefs: this number is exact without them")
    if chain is None:
        return _over_all(model, asked)
    choices = chain.before(asked)
    number, its, _ = _solved(asked, choices, chain.start, chain.chances(asked.target), greatest=True)
    way = likeliest_way(model, chain, choices, asked.within) if asked.kind == "P" else None
    decision = None
    if asked.kind == "P" and its is not None:
        decision = worst_decision(model, found, asked, chain, its.values)
    return Verification(kind=asked.kind, result=number, way=way, decision=decision)


def _solved(
    asked: Specification, choices: Choices, start: Vector, counts: Vector, *, greatest: bool, kept: bool = False
) -> tuple[Exact, Optimum | None, list[Vector]]:
    """Return a number at an initial distribution, with the values of states, or by stages the worth of choices."""
    its: Optimum | None = None
    worth: list[Vector] = []
    if asked.within is not None:
        values, worth, stages = reaching.within(choices, asked.within, greatest=greatest, kept=kept)
        error = float(np.finfo(float).eps * stages * (2 + int(np.diff(choices.moves.indptr).max(initial=0))))
    else:
        if asked.kind == "S":
            its = shares.share(choices, counts, greatest=greatest)
        else:
            its = (reaching.steps if asked.kind == "E" else reaching.reach)(choices, greatest=greatest)
        values, error = its.values, its.error
    value = float(start[start > 0] @ values[start > 0])
    return Exact(1 - value if asked.always else value, error if np.isfinite(value) else 0.0), its, worth


def _over_all(model: MDP, asked: Specification) -> Verification:
    choices, way = Choices.of_model(model, asked.reached, asked.before), None
    counts = asked.target[choices.state, choices.action].astype(float)
    kept = asked.within is not None and (asked.within + 1) * asked.target[:, :-1].size <= _STAGED
    found: list[tuple[Exact, Policy | None]] = []
    for greatest in (False, True):
        number, its, worth = _solved(asked, choices, model.initial_belief, counts, greatest=greatest, kept=kept)
        if its is None:
            staged = _staged(model, choices, worth, asked.within or 0, greatest=greatest) if kept else None
            found.append((number, staged))
            continue
        policy = DeterministicPolicy(choices.action[its.chosen].tolist(), len(model.action_space))
        policy.state_space = model.state_space
        found.append((number, policy))
        if greatest and asked.kind == "P":
            chain = chain_of_policy(model, policy)
            assert chain is not None
            way = likeliest_way(model, chain, choices.subset(its.chosen))
    (least, first), (most, last) = found[::-1] if asked.always else found
    return Verification(kind=asked.kind, least=least, greatest=most, way=way, policies=(first, last))


def _staged(model: MDP, choices: Choices, worth: list[Vector], most: int, *, greatest: bool) -> Policy:
    """Return a policy by stages that attains a number within some steps."""
    values = np.full((most + 1, len(model.state_space), len(model.action_space)), -np.inf)
    for stage in range(most + 1):
        its = worth[min(most - stage, len(worth) - 1)]
        values[stage, choices.state, choices.action] = its if greatest else -its
    policy = StagedPolicy(values)
    policy.state_space = model.state_space
    return policy


def _simulated(
    model: MDP,
    policy: Any,
    asked: Specification,
    episodes: int | None,
    seed: int | None,
    progress: Callable[[int, int], object] | None,
) -> Estimate:
    from mdm.simulation.batch import ReachingEvaluation, outcomes  # noqa: PLC0415 - loads what runs episodes

    if asked.kind == "S":
        raise ModelError(
            "the long-run share of a policy over beliefs is not known by simulation: ask P(reach …) or E(steps until "
            "…), or verify a finite-state controller"
        )
    if episodes is not None and not (is_whole(episodes) and episodes >= 1):
        raise ConfigError(f"a simulation needs at least 1 episode, not {episodes}")
    check_seed(seed)
    codes = asked.target.astype(float)
    codes[asked.miss] = -1
    choices = Choices.of_model(model, asked.target, asked.before)
    if hasattr(policy, "possible"):
        choices = choices.subset(policy.possible()[choices.state, choices.action])
    graph = Graph(choices)
    codes[(codes == 0) & graph.impossible()[:, None]] = -1
    if asked.kind == "P" and asked.within is None:
        codes[(codes == 0) & graph.unavoidable()[0][:, None]] = 1
    given: Any = {"episodes": episodes, "seed": seed, "progress": progress, "timed": asked.kind == "E"}
    its = outcomes(model, policy, codes, asked.within, **given)
    if not its.episodes:
        raise ModelError("no episode has ended: nothing is known of the policy")
    if isinstance(its, ReachingEvaluation):
        undecided, (low, high) = its.undecided, its.interval
    else:
        undecided = int(np.count_nonzero(its.returns == its.steps))
        low, high = (its.mean, its.mean) if np.isinf(its.mean) else its.interval
        high = np.inf if undecided else high
    if asked.always:
        low, high = 1 - high, 1 - low
    return Estimate(low, high, 0.95, its.episodes, undecided, its.seed)
