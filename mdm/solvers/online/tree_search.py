"""Online tree search: look ahead from the present belief for as long as there is time, then act.

It finds the best action at one belief, by best-first search in the tree of the beliefs that may follow. Each belief has
an upper and a lower bound of its value. Each expansion is that of the leaf with the largest error, discounted and
weighed by the probability of reaching it under the best actions (AEMS2; S. Ross, J. Pineau, S. Paquet and B.
Chaib-draa, *Online planning algorithms for POMDPs*, Journal of Artificial Intelligence Research 32, 2008). Small
beliefs are exact, large ones are sampled, with a seed (as in D. Silver and J. Veness, *Monte-Carlo planning in large
POMDPs*, NeurIPS 2010). Without a sampled belief in the tree, the bounds are certain.

Cost of an expansion: for one action, the possible transitions and observations of the belief, and for each belief that
may follow its states times the actions and plans. Choose it for models that are too large to be solved ahead, or to
improve a rough policy. Nearly optimal alpha vectors are faster, and as good.

The search reads its model as tables: arrays, and bounds of values that do not depend on the tree. For each first action
a belief's value is bounded above by the values of known states (QMDP), and below by that of the blind policy of this
action; see `mdm.solvers.bounds`.
"""

from __future__ import annotations

import hashlib
import time
import warnings
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.beliefs import BeliefTracker, Information, KnownState
from mdm.beliefs.choice import check_memory, slow_to_build
from mdm.compilation import kernels
from mdm.errors import ConfigError, ModelError, ModelWarning
from mdm.models.dynamics import Dynamics, Rows
from mdm.models.matrices import distribution
from mdm.policies.policy import Kind, Scores, observable
from mdm.solvers.bounds import blind_values, known_state_values

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.models import MDP
    from mdm.policies.alpha_vectors import AlphaVectors
    from mdm.policies.table import QTable
    from mdm.solvers.online.kernel import SearchTree


_ROUND = 0.001
"""Seconds between readings of the clock."""
_STEPS = "mdm.solvers.online.kernel"
"""The module of compiled steps."""


class SearchResult(msgspec.Struct, frozen=True):
    """The result of a search at one belief.

    Attributes:
        action: The action.
        lower: For each action a lower bound of its value; -inf where nothing is known.
        upper: For each action an upper bound of its value.
        expansions: How many leaves were expanded.
        nodes: How many beliefs the tree has.
        seconds: How long it took.
    """

    action: int
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    expansions: int
    nodes: int
    seconds: float


class Search:
    """The search itself: a model as arrays, and limits.

    Args:
        tables: The model.
        seconds: Search for so long; None sets no limit.
        expansions: Expand so many leaves at most; None sets no limit.
        particles: The most states of a belief in the tree; larger ones are sampled.
        memory: How many bytes the tree may take, roughly.
        seed: Of the samples.
        clock: Returns seconds; for tests.
    """

    def __init__(
        self,
        tables: SearchTables,
        *,
        seconds: float | None,
        expansions: int | None,
        particles: int,
        memory: int,
        seed: int | None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._tables = tables
        self._seconds = float("inf") if seconds is None else seconds
        self._expansions = expansions
        self._particles = particles
        self._memory = memory
        self._seed: int = np.random.SeedSequence().entropy if seed is None else seed  # type: ignore[assignment]
        self._clock = clock
        self._tree: SearchTree | None = None

    def prepare(self) -> None:
        """Allocate the tree, and compile, so that the first search is not slower than others."""
        if self._tree is None:
            self._run(np.zeros(1, dtype=np.int64), np.ones(1), stopped=lambda: True, seconds=float("inf"))

    def run(
        self,
        states: npt.NDArray[np.int64],
        weights: npt.NDArray[np.float64],
        *,
        stopped: Callable[[], bool] = lambda: False,
        timed: bool = True,
    ) -> SearchResult:
        """Search from a belief.

        Args:
            states: The states of the belief.
            weights: Their probabilities.
            stopped: Asked every millisecond whether to give up.
            timed: Whether its seconds count; without, its number of expansions alone ends it.
        """
        self.prepare()  # what that takes is none of the search's time
        return self._run(states, weights, stopped=stopped, seconds=self._seconds if timed else float("inf"))

    def _run(
        self,
        states: npt.NDArray[np.int64],
        weights: npt.NDArray[np.float64],
        *,
        stopped: Callable[[], bool],
        seconds: float,
    ) -> SearchResult:
        steps = kernels(_STEPS)
        began = self._clock()
        tree = self._room()
        drawn_by = hashlib.blake2b(states.tobytes() + weights.tobytes(), digest_size=8).digest()
        generator = np.random.default_rng([self._seed, int.from_bytes(drawn_by, "big")])
        steps.plant(self._tables, tree, states, weights, generator, self._particles)
        done, step = 0, 1
        while self._expansions is None or done < self._expansions:
            step = step if self._expansions is None else min(step, self._expansions - done)
            expanded = steps.grow(self._tables, tree, generator, self._particles, step)
            done += expanded
            passed = self._clock() - began
            if expanded < step or passed >= seconds or stopped():
                break
            span = min(_ROUND, seconds - passed)
            step = max(1, min(2 * step, int(done * span / passed) if passed > 0 else 2 * step))
        return SearchResult(
            action=int(tree.lower[0].argmax()),
            lower=tuple(tree.lower[0].tolist()),
            upper=tuple(tree.upper[0].tolist()),
            expansions=done,
            nodes=int(tree.sizes[0]),
            seconds=self._clock() - began,
        )

    def _room(self) -> SearchTree:
        if self._tree is None:
            size, actions = self._tables.rewards.shape
            nodes = self._memory // (2 * (40 * actions + 48))
            entries = self._memory // (2 * 16) + size
            if self._expansions is not None:
                nodes = min(nodes, self._expansions * (min(self._tables.num_observations, entries) + 1) + 1)
            self._tree = kernels(_STEPS).search_tree(self._tables, max(nodes, 2), entries)
        return self._tree


class TreeSearch(Kind):
    """Chooses by looking ahead from the present belief, again at each decision.

    In an ensemble the search runs in a process of its own, beside the loop: see `Planner`. Called directly,
    ``action`` searches before it returns. After the model's false negative, or no observation at all, the action
    goes on in the tree, as it does in an ensemble that is driven by events.

    Args:
        model: The model; its discount is below 1.
        seconds: How long to search.
        expansions: How many leaves to expand at most; with it alone, the same seed gives the same actions.
        seed: Of the samples of large beliefs.
        fallback: In an ensemble, the policy that decides when the search is too late.
        plans: Alpha vectors that are lower bounds, such as a point-based solver's (and not QMDP's, which are upper
            bounds), beside those of blind policies.
        bound: Q-values that are upper bounds, S x A, such as those of the fast informed bound; by default the values of
            known states.
        particles: The most states of a belief in the tree; larger ones are sampled.
        memory: How many bytes the tree may take.

    Raises:
        ConfigError: If there is neither a time nor a number of leaves, or one is not positive.
            Or if the model would take more memory than the machine has free, before any of it is built.
        ModelError: If the discount is 1, or a policy or bound is not for this model.

    Warns:
        ModelWarning: With the model's size, where it takes minutes to build.
    """

    form = "a tree search"
    num_states: int
    deliberates: Literal[True] = True
    worker = "mdm.solvers.online.worker"

    def __init__(
        self,
        model: MDP,
        *,
        seconds: float | None = None,
        expansions: int | None = None,
        seed: int | None = None,
        fallback: Any = None,
        plans: AlphaVectors | None = None,
        bound: QTable | None = None,
        particles: int = 1000,
        memory: int = 256_000_000,
    ) -> None:
        if seconds is None and expansions is None:
            raise ConfigError("a tree search needs an end: give it seconds, or a number of expansions", key="seconds")
        limits = {"seconds": seconds, "expansions": expansions, "particles": particles, "memory": memory}
        for name, limit in limits.items():
            if limit is not None and not limit > 0:
                raise ConfigError(f"{name} is a number above 0, not {limit}", key=name)
        if model.available is not None:
            raise ConfigError("a search does not know which actions are available: take a policy of mdm.solve")
        self.input = "state" if model.pomdp is None else "belief"
        self.num_states = len(model.state_space)
        self.num_actions = len(model.action_space)
        self.seconds = seconds
        self.expansions = expansions
        self.memory = memory
        self.fallback = fallback
        if plans is not None and not hasattr(plans, "vectors"):
            raise ModelError("plans are alpha vectors, but the policy is of another kind")
        for what, other in (("fallback", fallback), ("plans", plans), ("bound", bound)):
            if other is not None and (other.num_states, other.num_actions) != (self.num_states, self.num_actions):
                raise ModelError(
                    f"the {what} is for {other.num_states} states and {other.num_actions} actions, but the model has "
                    f"{self.num_states} and {self.num_actions}"
                )
        if getattr(fallback, "deliberates", False):
            raise ModelError("the fallback of a tree search decides at once: give it a policy that does not search")
        if fallback is not None and fallback.input != self.input:
            raise ModelError(f"the fallback chooses by {fallback.input}, but the search by {self.input}")
        self.false_negative = model.false_negative
        """The index of the observation that is the model's false negative, if there is one."""
        self._options = limits
        # What digests are made of; the tables follow from it and the model.
        self._given: list[Any] = [] if bound is None else [bound.values]
        self._given += [] if plans is None else [plans.vectors, list(plans.actions)]
        _check_size(model)
        self._tables = search_tables(
            model,
            upper=None if bound is None else bound.values,
            lower=None if plans is None else (plans.vectors, plans.actions),
        )
        self._mapped = model.bare() if model.flatten().stacked else None
        """The model, where another process can map its matrices as this one does."""
        self.seed(seed)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the tree, which other processes make for themselves."""
        return {**self.__dict__, "_search": None}

    def seed(self, seed: int | None) -> None:
        """Begin the samples again."""
        self._seed = seed
        self._search: Search | None = None

    def mismatch(self, model: MDP) -> str | None:
        """Return why the search is none for a model, as a sentence; None where it is."""
        if model.false_negative != self.false_negative:
            return "the search and the ensemble differ in the false negative: give both the same model"
        return super().mismatch(model)

    def information(self, model: MDP | None) -> Information:
        """Return the state, or the belief's tracker."""
        return KnownState() if self.input == "state" else BeliefTracker(observable(model), by_support=True)

    def parts(self) -> tuple[SearchTables | SentTables, dict[str, Any]]:
        """Return the parts of a `Search` in another process, which finds its tables by `received`."""
        tables = self._tables if self._mapped is None else sent(self._tables, self._mapped)
        return tables, self._arguments()

    def _arguments(self) -> dict[str, Any]:
        return {**self._options, "seed": self._seed}

    def parameters(self) -> list[Any]:
        """Return all that decides besides the information: limits, seed, and the policies that it goes by."""
        fallback: list[Any] = getattr(self.fallback, "parameters", list)()
        return [sorted(self._options.items()), self._seed, type(self.fallback).__name__, *fallback, *self._given]

    def prepare(self) -> None:
        """Compile, and take the tree's memory: the first decision is then no slower than others."""
        self._own().prepare()

    def _own(self) -> Search:
        if self._search is None:
            self._search = Search(self._tables, **self._arguments())
        return self._search

    def belief_of(self, x: Any) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Return the states and their probabilities that a state index, a belief, or just such a pair stands for.

        Raises:
            ModelError: If it is no state or belief of the model.
        """
        if self.input == "state":
            if not 0 <= x < self.num_states:
                raise ModelError(f"there is no state {x}; the model's {self.num_states} count from 0")
            return np.array([x]), np.ones(1)
        if isinstance(x, tuple):
            states = np.array(x[0], dtype=np.int64)
            if not ((states >= 0) & (states < self.num_states)).all():
                raise ModelError(f"the belief has states that are not among the model's {self.num_states}")
            return states, distribution(x[1], what="the belief", size=len(states))
        belief = distribution(x, what="the belief", size=self.num_states)
        states = np.flatnonzero(belief)
        return states, belief[states]

    def search(self, x: Any, *, timed: bool = True) -> SearchResult:
        """Search from a state index (MDP) or a belief: S numbers, or states and their probabilities.

        Args:
            x: The state or belief.
            timed: Whether its seconds count; without, its number of expansions alone ends it.
        """
        states, weights = self.belief_of(x)
        return self._own().run(states, weights, timed=timed)

    def action(self, x: Any) -> int:
        """Return the action for a state index (MDP) or a belief, after a search."""
        return self.search(x).action

    def value(self, x: Any) -> float:
        """Return a lower bound of the value of a state or belief, after a search."""
        return max(self.search(x).lower)

    def scores(self, x: Any, /) -> Scores:
        """Return bounds of the values of its actions, after a search.

        The search ends by its number of expansions alone where it has one: it is then the same each time.
        """
        found = self.search(x, timed=self.expansions is None)
        return Scores("bound", np.array(found.lower), np.array(found.upper), found.expansions)

    def q_values(self, x: Any) -> npt.NDArray[np.float64]:
        """Return a lower bound of the value of each action, after a search; -inf where nothing is known."""
        return np.array(self.search(x).lower)


def _check_size(model: MDP) -> None:
    """Refuse a model for which there is no memory, and warn of one that takes minutes to build."""
    check_memory(model, None, beliefs=True, matrices="a search")
    if (size := slow_to_build(model)) is not None:
        warnings.warn(f"{size}; a search reads them all", ModelWarning, stacklevel=3)


# -- Tables ------------------------------------------------------------------------------------------------------------

Whole = npt.NDArray[np.int64]
Real = npt.NDArray[np.float64]


class SearchTables(NamedTuple):
    """A model for compiled code.

    Attributes:
        transitions: P(s' | s, a): a row for each action and state.
        observations: A row for each action and next state; for events a row for each entry of ``transitions``. An
            MDP's observation is the next state. The index ``num_observations`` stands for no detection.
        by_transition: Whether the observations are events.
        num_observations: How many there are.
        rewards: R(s, a), S x A.
        discount: Below 1.
        upper: Upper bounds of the value of an action in a state, S x A.
        lower: Lower bounds of the value of plans in a state, S x N.
        actions: The first action of each plan.
    """

    transitions: Rows
    observations: Rows
    by_transition: bool
    num_observations: int
    rewards: Real
    discount: float
    upper: Real
    lower: Real
    actions: Whole


class SentTables(NamedTuple):
    """Tables for another process of this machine, which maps T, O and R from the file from which this one has them.

    Attributes:
        tables: The tables, where T and R are left out, and O if it is in the file as well.
        model: The model whose T, O and R they are.
    """

    tables: SearchTables
    model: MDP


_LEFT_OUT = Rows(np.zeros(0, np.int64), np.zeros(0, np.uint64), np.zeros(0, np.uint32), np.zeros(0))


def sent(tables: SearchTables, model: MDP) -> SentTables:
    """Return the tables of a model without the parts that another process can map from a file."""
    tables = tables._replace(transitions=_LEFT_OUT, rewards=np.zeros((0, 0)))
    if model.pomdp is None or tables.by_transition or model.false_negative is not None:
        return SentTables(tables, model)  # what is observed is made for the search
    return SentTables(tables._replace(observations=_LEFT_OUT), model)


def received(given: SearchTables | SentTables) -> SearchTables:
    """Return tables that another process has sent, with the parts left out."""
    if isinstance(given, SearchTables):
        return given
    dynamics = Dynamics(given.model)
    tables = given.tables._replace(transitions=dynamics.transitions, rewards=_rewards(dynamics))
    return tables if len(tables.observations.starts) else tables._replace(observations=dynamics.observations)


def search_tables(model: MDP, *, upper: Real | None, lower: tuple[Real, Sequence[int]] | None) -> SearchTables:
    """Return a model as arrays.

    Args:
        model: The model.
        upper: See `SearchTables`; None computes it.
        lower: N x S values of plans, and the first action of each, beside those of blind policies.

    Raises:
        ModelError: If the discount is 1: values have no bounds then.
    """
    if model.discount >= 1:
        raise ModelError("a tree search needs a discount below 1: give the model one with with_discount(...)")
    dynamics = Dynamics(model)
    if model.pomdp is None:  # an MDP's observations are its next states
        num_observations = size = dynamics.num_states
        first = np.zeros(dynamics.num_actions, dtype=np.int64)
        starts, columns = np.arange(size + 1, dtype=np.uint64), np.arange(size, dtype=np.uint32)
        observations = Rows(first, starts, columns, np.ones(size))
    else:
        observations, num_observations = dynamics.observations, dynamics.num_observations
    if model.false_negative is not None:
        missed = observations.columns == model.false_negative
        columns = np.where(missed, np.uint32(num_observations), observations.columns)
        observations = observations._replace(columns=columns)
    values, actions = blind_values(dynamics), list(range(dynamics.num_actions))
    if lower is not None:
        values, actions = np.concatenate([values, lower[0]]), [*actions, *lower[1]]
    return SearchTables(
        transitions=dynamics.transitions,
        observations=observations,
        by_transition=dynamics.by_transition,
        num_observations=num_observations,
        rewards=_rewards(dynamics),
        discount=dynamics.discount,
        upper=known_state_values(dynamics) if upper is None else np.array(upper),
        lower=np.array(values.T, order="C"),
        actions=np.array(actions, dtype=np.int64),
    )


def _rewards(dynamics: Dynamics) -> Real:
    """Return R(s, a) as an array that may be written to, which is a kind of its own to compiled code."""
    mapped: Real | None = dynamics.model.stacked.get("R")
    return np.array(dynamics.rewards) if mapped is None else mapped
