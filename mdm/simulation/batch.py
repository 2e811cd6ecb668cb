"""The value of a policy in its model, by Monte Carlo simulation of batches of episodes, without the decision loop.

The estimate is the mean discounted return of independent episodes; its error falls with the square root of their
number. Policies of known kinds run as arrays, at millions of steps a second for small models: the states of a batch
are sampled together, and its beliefs are a matrix. Other policies, and beliefs over more than 2,000 states, run one
episode at a time. `simulate` runs the real decision loop, ten to a hundred times slower.

Random numbers belong to an episode and a time step, not to a policy. With the same seed, the difference of two policies
that run in batches is known far better than either value (common random numbers), and so is that of two which run one
episode at a time; a policy of each kind have different ones.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
from scipy.special import betaincinv

from mdm.beliefs import DrawnInformation, Support
from mdm.checks import check_seed, is_whole
from mdm.controller import Controller
from mdm.controller.controller import seeded
from mdm.errors import ConfigError
from mdm.loading import model_of, policy_of
from mdm.models.durations import discounts_in_time, paid_in_time
from mdm.models.dynamics import Dynamics
from mdm.models.matrices import Vector, read_only
from mdm.models.specification import Specification
from mdm.models.units import check_steps
from mdm.policies import mismatch
from mdm.policies.batch import ENDED
from mdm.simulation.parts import Worker, run_parts
from mdm.simulation.sampler import BatchSampler, Sampler, ended_states
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from concurrent.futures import Executor

    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models import MDP, Durations
    from mdm.policies.batch import Batch
    from mdm.simulation.parts import Work

_TOGETHER = 2_000
"""States up to which beliefs are kept as a matrix."""
_CHUNK = 10_000
_FIRST = 1_000
"""Episodes of the first part, which is known before the others."""
_NUMBERS = 4_000_000
_NORMAL = 1.959963985
"""Standard deviations within which 95 % of a normal distribution lie."""


def standard_error(numbers: Vector) -> float:
    """Return the standard error of a mean: 0 of a single number, and of none not a number."""
    if len(numbers) < 2:
        return 0.0 if len(numbers) else math.nan
    return float(numbers.std(ddof=1)) / math.sqrt(len(numbers))


class Evaluation(msgspec.Struct, frozen=True):
    """The result of simulated episodes of a policy.

    Attributes:
        mean: The mean of the discounted returns; not a number where no episode has ended.
        standard_error: The standard error of the mean; 0 for a single episode.
        returns: The return of each episode.
        steps: The longest episode: in decisions if their number was given, else in time steps.
        seed: The seed, for the same episodes again.
        moves: The number of simulated time steps.
        seconds: The time of the simulation.
        missing: How many episodes have no return, since the part that they were in failed.
        workers: Who ran it, where it ran in parts.
    """

    mean: float
    standard_error: float
    returns: Vector
    steps: int
    seed: int
    moves: int
    seconds: float
    missing: int = 0
    workers: tuple[Worker, ...] = ()

    @classmethod
    def of(cls, returns: Vector, steps: int, seed: int, moves: int, seconds: float, *ran: Any) -> Evaluation:
        """Return the result of some returns, and of how they ran; of none, it is not a number."""
        mean = float(returns.mean()) if len(returns) else math.nan
        return cls(mean, standard_error(returns), returns, steps, seed, moves, seconds, *ran)

    @property
    def episodes(self) -> int:
        """The number of episodes."""
        return len(self.returns)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of the policy's value."""
        return self.mean - _NORMAL * self.standard_error, self.mean + _NORMAL * self.standard_error

    def __repr__(self) -> str:
        low, high = self.interval
        episodes = counted(self.episodes, "episode") + (f", and {self.missing} are missing" if self.missing else "")
        return f"Evaluation({self.mean:.6g}, between {low:.6g} and {high:.6g} by 95 %, {episodes})"

    @property
    def steps_a_second(self) -> float:
        """Time steps per second."""
        return self.moves / self.seconds if self.seconds > 0 else math.inf


class ReachingEvaluation(Evaluation, frozen=True, kw_only=True):
    """The share of simulated episodes in which something comes to hold.

    Attributes:
        undecided: In how many it is open whether it does: they count for both ends of the interval.
    """

    undecided: int

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of the probability (C. Clopper and E. Pearson, *Biometrika* 26, 1934)."""
        count, hits = len(self.returns), int(self.returns.sum())
        most = hits + self.undecided
        low = float(betaincinv(hits, count - hits + 1, 0.025)) if hits else 0.0
        return low, float(betaincinv(most + 1, count - most, 0.975)) if most < count else 1.0


def evaluate(
    model: GivenModel,
    policy: GivenPolicy,
    *,
    episodes: int | None = None,
    steps: int | None = None,
    seed: int | None = None,
    durations: Durations | None = None,
    until: str | None = None,
    progress: Callable[[int, int], object] | None = None,
    executor: Executor | None = None,
) -> Evaluation:
    """Estimate the value of a policy at the start of its model, or how probable it is that it reaches something.

    An episode ends after ``steps`` decisions; by default at the end of the policy's plan, or once the discounted weight
    of the rest is below a millionth. It ends early in states without further rewards. False negatives, and events
    without an observation, lead to no decision: the action goes on, each time step with its reward. A policy over
    states decides at every time step.

    Args:
        model: The model of the world and of belief tracking, or the path of its file.
        policy: A policy of any kind, see `Controller`. A plan with values begins at its best node.
        episodes: The number of episodes; by default 10,000, or 1,000 if they run one at a time.
        steps: Decisions per episode.
        seed: The same seed gives the same result; by default it is random.
        durations: How long actions take, and how much they earn by time. Times are not drawn: rewards after an action
            count by the expectation of the discount. By default all take one time step.
        until: A formula over states and actions, or more, as in ``P(reach …)`` of `mdm.verify`. Returns are then 1
            where it comes to hold and else 0, the mean is the share of such episodes, and the interval that of the
            probability. An episode ends in states from where it is out of reach, or undecided after 10,000 time steps.
        progress: Called at each time step, with an executor ten times a second, with how many episodes have ended, and
            of how many; where it returns True, the result is of those that are known by then, which may be none.
        executor: Any executor of ``concurrent.futures``, to run parts of the episodes on its workers, such as
            `Processes`: the result is the same.

    Raises:
        ConfigError: If the policy does not fit the model, episodes have no end, or the executor's workers cannot be
            sent the work; see `mdm.simulation.parts.run_parts`, also for its warnings.
        Error: If a part failed twice, and none had ended before.
        FormatError: If ``until`` does not parse.
        ModelError: If the durations do not fit the model, its discount is of a second and there are none, or it lacks a
            name of ``until``.

    Example::

        result = mdm.evaluate("tiger.pomdp", "tiger.vf", episodes=2000, seed=1)
        result.episodes  # 2000
        result.mean, result.interval  # the value, and its 95 % confidence interval
        result = mdm.evaluate("tiger.pomdp", "tiger.vf", until="tiger-left and action = open-left")
    """
    model = model_of(model)
    policy = policy_of(policy, model)
    _check(model, policy, episodes, steps)
    check_seed(seed)
    if until is not None:
        if steps is not None or durations is not None:
            raise ConfigError("until ends episodes by itself: it goes without steps and durations")
        asked = Specification.of(until, model, until=True)
        codes = asked.target.astype(float)
        codes[ended_states(Dynamics(model), codes)] = -1
        codes[asked.miss] = -1
        given: dict[str, Any] = {"episodes": episodes, "seed": seed, "progress": progress, "executor": executor}
        return outcomes(model, policy, codes, asked.within, **given)
    discounts = None
    if durations is None:
        check_steps(model)
    else:
        discounts = discounts_in_time(model, durations)
        model = paid_in_time(model, durations)
    ends = limits(model, policy, steps, None if discounts is None else float(discounts.max()))
    return _simulated(model, policy, ends, discounts, None, episodes, seed, progress, executor)


class Comparison(msgspec.Struct, frozen=True):
    """The results of several policies.

    Attributes:
        evaluations: Of each policy; fewer, and the last of fewer episodes, where it was ended.
    """

    evaluations: tuple[Evaluation, ...]

    def difference(self, place: int) -> tuple[float, float]:
        """Return how much more a policy is worth than the first, and the half of the 95 % confidence interval of that.

        Episodes are paired where none is missing of either.
        """
        theirs, ours = self.evaluations[0], self.evaluations[place]
        if ours.episodes != theirs.episodes or ours.missing or theirs.missing:
            return ours.mean - theirs.mean, 1.96 * math.hypot(ours.standard_error, theirs.standard_error)
        differences = ours.returns - theirs.returns
        return float(differences.mean()), 1.96 * standard_error(differences)


def compare(
    model: GivenModel,
    policies: Sequence[GivenPolicy],
    *,
    seed: int | None = None,
    progress: Callable[[int, int], object] | None = None,
    **given: Any,
) -> Comparison:
    """Estimate the values of several policies at the start of a model, in episodes with the same random numbers.

    Args:
        model: The model, or the path of its file.
        policies: The policies, of any kind; others are compared with the first.
        seed: The same seed gives the same result; by default it is random.
        progress: Called as by `evaluate`, with the episodes of all policies; where it returns True, these are all.
        given: Other arguments of `evaluate`, such as ``episodes`` and ``executor``.

    Raises:
        ConfigError: If there is no list of policies, or as of `evaluate`.

    Example::

        result = mdm.compare("tiger.pomdp", ["tiger.vf", "tiger.vf"], episodes=1000, seed=1)
        result.difference(1)  # (0.0, 0.0)
    """
    if isinstance(policies, str) or not policies:
        raise ConfigError("a comparison needs a list of policies, one or more", key="policies")
    model = model_of(model)
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
    found: list[Evaluation] = []
    told: list[bool] = [False]

    def tell(ended: int, count: int) -> bool:
        told[0] = progress is not None and progress(len(found) * count + ended, len(policies) * count) is True
        return told[0]

    while len(found) < len(policies) and not told[0]:
        found.append(evaluate(model, policies[len(found)], seed=seed, progress=tell, **given))
    return Comparison(tuple(found))


def outcomes(
    model: MDP, policy: Any, codes: Vector, within: int | None, *, timed: bool = False, **given: Any
) -> Evaluation:
    """Simulate a policy until X holds, or is out of reach: returns are 1 where it holds, else 0.

    Args:
        model: The model.
        policy: The policy, which fits it.
        codes: For each state and action, and in the last column a plan's end, 1 where X holds, -1 where it is out of
            reach, else 0: S x (A + 1).
        within: The most time steps, after which X is missed; by default there are 10,000, after which it is open.
        timed: Returns are the time steps until X, infinite where it is out of reach; those of open episodes are
            as many as ``steps``.
        given: The ``episodes``, ``seed``, ``progress`` and ``executor`` of `evaluate`.
    """
    open_, horizon = codes == 0, getattr(policy, "horizon", None)
    open_[:, -1] = False
    ends = Limits(math.inf if horizon is None else horizon, (_LONGEST if within is None else within) + 1)
    paid = np.select([open_, codes > 0], [float(timed), 1.0 - timed], math.inf if timed else -1.0)
    with np.errstate(invalid="ignore"):  # of infinite times
        its = _simulated(model, policy, ends, open_.astype(float), paid, **given)
        returns = np.nan_to_num(its.returns, nan=ends.moves if timed else 0.0, posinf=math.inf)
        reached = read_only(returns if timed else (returns > 0).astype(float))
        found = Evaluation.of(reached, int(ends.moves), its.seed, its.moves, its.seconds, its.missing, its.workers)
    if timed:
        return found
    undecided = int((returns == 0).sum()) if within is None else 0
    return ReachingEvaluation(**msgspec.structs.asdict(found), undecided=undecided)


def _simulated(
    model: MDP,
    policy: Any,
    ends: Limits,
    discounts: Vector | None,
    paid: Vector | None,
    episodes: int | None,
    seed: int | None,
    progress: Callable[[int, int], object] | None,
    executor: Executor | None = None,
) -> Evaluation:
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
    takes = getattr(policy, "input", "belief")
    small = takes != "belief" or len(model.state_space) <= _TOGETHER
    together = small and hasattr(policy, "batch") and policy.batch(model) is not None
    count = (10_000 if together else 1_000) if episodes is None else episodes
    if not together and getattr(policy, "_seed", seed) is None:  # a search or a draw without a seed of its own
        policy = seeded(policy, seed)
    work = _Episodes(model, policy, ends, count, seed, together=together, discounts=discounts, paid=paid)
    return joined_evaluation(work, int(min(ends)), progress, executor)


def joined_evaluation(
    work: Work, steps: int, progress: Callable[[int, int], object] | None, executor: Executor | None
) -> Evaluation:
    """Run a work whose parts give the returns of their episodes, of so many steps, and the time steps; join them."""
    began = time.perf_counter()
    results, missing, workers = run_parts(work, executor, progress)
    returns, moves = _in_order(results)
    return Evaluation.of(read_only(returns), steps, work.seed, moves, time.perf_counter() - began, missing, workers)


def _in_order(parts: list[tuple[Vector, int]]) -> tuple[Vector, int]:
    return np.concatenate([np.empty(0), *(part for part, _ in parts)]), sum(moves for _, moves in parts)


def _check(model: MDP, policy: Any, episodes: int | None, steps: int | None) -> None:
    if episodes is not None and not (is_whole(episodes) and episodes >= 1):
        raise ConfigError(f"an evaluation needs at least 1 episode, not {episodes}")
    if steps is not None and not (is_whole(steps) and steps >= 1):
        raise ConfigError(f"an episode needs at least 1 step, not {steps}")
    if getattr(policy, "input", "state") != "state" and model.pomdp is None:
        raise ConfigError("the policy needs observations, but the model is an MDP, which has none")
    wrong = mismatch(policy, model)
    if wrong is not None:
        raise ConfigError(wrong)


class _Episodes:
    """The episodes of an evaluation, which run in batches that fit into memory, or else one by one.

    The first batches are smaller, so that something is known soon. They are the same whatever the policy.
    """

    def __init__(
        self, model: MDP, policy: Any, ends: Limits, episodes: int, seed: int, *, together: bool, **given: Vector | None
    ) -> None:
        self.model, self.policy, self.seed, self.units = model, policy, seed, episodes
        self._ends, self._given = ends, given
        self._run: Any = None
        self._sizes: list[int] = []
        if together:
            chunk = min(_CHUNK, max(_TOGETHER, _NUMBERS // len(model.state_space)))
            while (left := episodes - sum(self._sizes)) > 0:
                self._sizes.append(min(left, chunk, _FIRST * 4 ** min(len(self._sizes), 9)))
            self.units = len(self._sizes)

    def size(self, first: int, last: int) -> int:
        return sum(self._sizes[first:last]) if self._sizes else last - first

    def prepare(self) -> None:
        if self._sizes:
            observed = getattr(self.policy, "input", "belief") != "state"
            batch = self.policy.batch(self.model)
            self._run = EpisodeBatch(self.model, batch, self._ends, observed=observed, **self._given)
        else:
            self._run = EpisodeRunner(self.model, self.policy, endless=self._given["paid"] is not None)

    def run(self, first: int, last: int, tell: Callable[[int], bool] = lambda _: False) -> tuple[Vector, int]:
        if not self._sizes:
            given: dict[str, Any] = {"episodes": last - first, "seed": self.seed, "first": first, "run": self._run}
            given |= {**self._given, "progress": lambda ended, _: tell(ended)}
            return one_by_one(self.model, self.policy, self._ends, **given)
        parts: list[tuple[Vector, int]] = []
        for unit in range(first, last):
            random = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(unit,)))
            before = self.size(first, unit)
            part = self._run(self._sizes[unit], random, lambda more, before=before: tell(before + more))
            if part is None:
                break
            parts.append(part)
        return _in_order(parts)


# -- Episodes ----------------------------------------------------------------------------------------------------------

_REST = 1e-6
"""The discounted weight of the rest at which an episode ends."""
_LONGEST = 10_000
"""The number of time steps without an observation that ends an episode."""


class Limits(NamedTuple):
    """The end of an episode.

    Attributes:
        decisions: The most decisions.
        moves: The most time steps, which false negatives make more than decisions.
    """

    decisions: float
    moves: float


def limits(model: MDP, policy: Any, steps: int | None, discount: float | None = None) -> Limits:
    """Return the end of episodes.

    Args:
        model: The model.
        policy: The policy.
        steps: Decisions.
        discount: In place of the model's, the most that a time step may have.

    Raises:
        ConfigError: If they have none.
    """
    horizon = getattr(policy, "horizon", None)  # of plans and staged policies
    if steps is not None:
        return Limits(steps if horizon is None else min(steps, horizon), math.inf)
    discount = model.discount if discount is None else discount
    if discount < 1:
        moves = max(1, math.ceil(math.log(_REST) / math.log(discount)))
        return Limits(math.inf if horizon is None else horizon, moves)
    if horizon is None:
        raise ConfigError(
            "with a discount of 1 an episode needs an end: give a discount (--discount) or decisions (--steps)"
        )
    return Limits(horizon, math.inf)


class EpisodeBatch:
    """Runs a batch of episodes as arrays.

    Args:
        model: The model.
        batch: The policy's decisions.
        observed: Whether the policy needs observations.
        ends: The end of an episode.
        discounts: Of each state and action, S x A; by default that of the model.
        paid: Rewards in the place of the model's, S x (A + 1), the last where the plan ends. Episodes then go on in
            states without further rewards.
    """

    def __init__(
        self,
        model: MDP,
        batch: Batch,
        ends: Limits,
        *,
        observed: bool,
        discounts: Vector | None = None,
        paid: Vector | None = None,
    ) -> None:
        self._sampler = BatchSampler(model, observed=observed)
        self._discount = model.discount
        self._discounts = discounts
        self._paid = paid
        if paid is not None:
            self._sampler.rewards, self._sampler.ended = paid, np.zeros(len(paid), dtype=bool)
        self._batch = batch
        self._observed = observed
        false_negative = model.false_negative
        self._false_negative = self._sampler.nothing if false_negative is None else false_negative
        self._ends = ends

    def __call__(
        self, episodes: int, random: np.random.Generator, ends: Callable[[int], bool] = lambda _: False
    ) -> tuple[Vector, int] | None:
        """Run some episodes; return their discounted returns, and the total number of time steps.

        The random numbers of an episode and time step depend neither on the policy nor on other episodes.

        Args:
            episodes: How many.
            random: The source of random numbers.
            ends: Told at each time step how many have ended; where it returns True, there is no result.
        """
        sampler = self._sampler
        returns = np.zeros(episodes)
        states = sampler.first(random.random(episodes))
        actions = self._batch.begin(states, random.random(episodes))
        decisions, waited, going = np.ones_like(states), np.zeros_like(states), np.arange(episodes)
        weight: float | Vector = 1.0 if self._discounts is None else np.ones(episodes)
        moves = time = 0
        goes = ~sampler.ended[states]
        while True:
            if not goes.all():
                states, actions, decisions = states[goes], actions[goes], decisions[goes]
                waited, going = waited[goes], going[goes]
                weight = weight[goes] if isinstance(weight, np.ndarray) else weight
                self._batch.keep(goes)
            if not len(going):
                return returns, moves
            if ends(episodes - len(going)):
                return None
            returns[going] += weight * sampler.rewards[states, actions]
            weight = weight * (self._discount if self._discounts is None else self._discounts[states, actions])
            time += 1
            moves += len(going)
            if time >= self._ends.moves:
                return returns, moves
            numbers = random.random((3, episodes))[:, going]
            states, seen = sampler.move(states, actions, numbers)
            over = decisions >= self._ends.decisions
            goes = ~over & ~sampler.ended[states]
            if self._ends.moves < math.inf:
                goes &= weight >= _REST  # after long actions that is sooner
            decides = goes
            if self._observed:
                decides = goes & (seen != self._false_negative) & (seen != sampler.nothing)
                waited = np.where(decides, 0, waited + 1)
                goes &= waited < _LONGEST
            which = np.flatnonzero(decides)
            if len(which):
                chosen = self._batch.next(which, states[which], actions[which], seen[which], numbers[2, which])
                actions[which] = chosen
                decisions[which] += 1
                over[which[chosen == ENDED]] = True
                goes &= ~over
            if self._paid is not None:
                over &= weight > 0
                returns[going[over]] += self._paid[states[over], ENDED]


class EpisodeStep(NamedTuple):
    """A time step of an episode.

    Attributes:
        state: The state before the action.
        belief: The belief, or its support; None for policies over states.
        action: The action: that of the last decision.
        seen: The last observation; None at the first decision, and for no observation.
        decided: Whether there was a decision at this time step.
    """

    state: int
    belief: Vector | Support | None
    action: int
    seen: int | None
    decided: bool


class EpisodeRunner:
    """Runs one episode of a policy at a time.

    Args:
        model: The model.
        policy: The policy, of any kind.
        endless: Whether episodes go on where no further reward is possible.
    """

    def __init__(self, model: MDP, policy: Any, *, endless: bool = False) -> None:
        self._model = model
        self._controller = Controller(policy, model)
        self._sampler = Sampler(model)
        self._ended = np.zeros(len(model.state_space), dtype=bool) if endless else ended_states(Dynamics(model))

    def __call__(self, seed: int | np.random.SeedSequence | None, number: int | None = None) -> Iterator[EpisodeStep]:
        """Yield the time steps of an episode until no further reward is possible, or the plan has ended.

        The caller may stop before. A policy that draws does so by its seed and the number of the episode, if it is
        given, else it draws on.
        """
        if number is not None and isinstance(self._controller.information, DrawnInformation):
            self._controller.information.divide(number)
        model, sampler, controller = self._model, self._sampler, self._controller
        sees, false_negative = controller.takes == "state", model.false_negative
        sampler.seed(seed)
        state, seen, waited = sampler.first_state(), None, 0
        if sees:
            step = controller.start(state)
        else:
            assert model.pomdp is not None
            knows = controller.symbols.num_states is not None  # not so for a plan without values
            step = controller.start(model.pomdp.belief_at_start(state) if knows else None)
        decided = True
        while not self._ended[state] and waited < _LONGEST:
            known = None if sees else controller.information.current
            belief = known if isinstance(known, np.ndarray | Support) else controller.belief
            yield EpisodeStep(state, belief, step.action, seen, decided)
            if controller.over:
                return
            before, state = state, sampler.next_state(state, step.action)
            if sees:
                step = controller.see(state)
                continue
            seen = sampler.observation(step.action, before, state)
            decided = seen is not None and seen != false_negative
            if decided:
                step, waited = controller.observe(seen), 0  # a prediction, if it is impossible by rounding
            else:
                seen, waited = None, waited + 1


def one_by_one(
    model: MDP,
    policy: Any,
    ends: Limits,
    *,
    episodes: int,
    seed: int,
    discounts: Vector | None = None,
    paid: Vector | None = None,
    progress: Callable[[int, int], object] | None = None,
    first: int = 0,
    run: EpisodeRunner | None = None,
) -> tuple[Vector, int]:
    """Run episodes one at a time, for policies of any kind.

    Args:
        model: The model.
        policy: The policy.
        ends: The end of an episode.
        episodes: How many.
        seed: Of their random numbers.
        discounts: Of each state and action, S x A; by default that of the model.
        paid: As of `EpisodeBatch`; the return of an episode that ends by itself is not a number then.
        progress: Told at each time step how many have ended; where it returns True, there are no more.
        first: The number of the first: each has random numbers of its own.
        run: Their runner; by default it is made.

    Returns:
        The discounted returns of those that have ended, and the total number of time steps.
    """
    run, discount = run or EpisodeRunner(model, policy, endless=paid is not None), model.discount
    rewards = model.rewards if paid is None else paid
    returns, moves = np.zeros(episodes), 0
    for episode in range(episodes):
        weight, total, decisions, time = 1.0, 0.0, 0, 0
        for step in run(np.random.SeedSequence(seed, spawn_key=(first + episode,)), first + episode):
            total += weight * float(rewards[step.state, step.action])
            weight *= discount if discounts is None else float(discounts[step.state, step.action])
            time += 1
            decisions += step.decided
            if decisions >= ends.decisions or time >= ends.moves or (weight < _REST and ends.moves < math.inf):
                break
            if progress is not None and progress(episode, episodes) is True:
                return returns[:episode], moves
        else:
            total = total if paid is None else math.nan
        returns[episode] = total
        moves += time
    return returns, moves
