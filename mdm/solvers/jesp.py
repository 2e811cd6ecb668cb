"""JESP: joint plans of a finite horizon for teams without communication (Dec-POMDPs), by alternating best responses.

From random plans, one agent after the other takes its best response to the others' plans, until no agent can improve
alone: a Nash equilibrium, hence a local optimum (R. Nair, M. Tambe, M. Yokoo, D. Pynadath and S. Marsella, *Taming
decentralized POMDPs: towards efficient policy computation for multiagent settings*, IJCAI 2003). Restarts find better
ones. Then a search of limited effort proves the best plan optimal, or finds the optimum. The lower bound is the exact
value of the plan at the initial belief; the upper one is the value of a team that shares all observations (MPOMDP), or
knows the state. For one agent alone the first response is optimal already, yet point-based solvers reach horizons that
this one does not.

A joint plan is for each agent a tree of actions by its own observations. Its exact value follows all joint histories
that can occur, with the distribution over states that comes with each: O(A^0 S^2 O^t) at step t at most, O being the
joint observations. With the others' plans fixed, an agent faces a POMDP whose states are the world's together with the
others' histories. Its reachable beliefs are followed forward, equal ones once, and their values computed backward
(ibid., DP-JESP). At step t there are at most (A_i O_i)^t beliefs, each of S numbers for each of the others' joint
histories. For a team taken as one agent this is the exact solution of the MPOMDP.

The search is multi-agent A* over partial plans, which fix the agents' actions in the first steps. The value of one is
at most that of these steps and, from there on, of a team that shares all observations. The most promising one is
continued by every joint decision rule that could still beat the best plan known (D. Szer, F. Charpillet and S.
Zilberstein, "MAA*: a heuristic search algorithm for solving decentralized POMDPs", UAI 2005). Histories of an agent
with equal distributions over states and over the others' histories are one (F. A. Oliehoek, S. Whiteson and M. T. J.
Spaan, *Lossless clustering of histories in decentralized POMDPs*, AAMAS 2009). The rules of a step are found by branch
and bound over one agent's cluster after the other. The worst case is doubly exponential in the horizon: it is for small
ones.
"""

from __future__ import annotations

import heapq
import itertools
import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from mdm.errors import ConfigError, ModelError
from mdm.models.dynamics import Dynamics, Indices
from mdm.models.events import check_no_false_negatives
from mdm.policies import FiniteStateController, JointController
from mdm.solvers.bounds import staged_values
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mdm.models import POMDP
    from mdm.models.matrices import Vector
    from mdm.solvers.solution import Solution

_BETTER = 1e-10


@makes(JointController)
def jesp(
    model: POMDP,
    *,
    limits: Limits | None = None,
    horizon: int = 3,
    restarts: int = 20,
    seed: int | None = 0,
    search: int = 200_000,
) -> Solution:
    """Return a joint plan of a finite horizon for a team whose members see only their own observations.

    Args:
        model: The team's POMDP, with a factor of observations per agent. Its discount applies; it may be 1.
        limits: When to stop, and where to report; an iteration is a best response.
        horizon: How many decisions the plan is for.
        restarts: The number of random plans to begin from.
        seed: Of the random plans.
        search: The most partial decision rules in the exact search that follows; 0 leaves it out.

    Returns:
        A `JointController` with a tree per agent: a node for each history of its observations.

    Raises:
        ConfigError: If there are no restarts.
        ModelError: If observations are not one per agent, an event may go unobserved or is a false negative, or the
            horizon is too long.
    """
    check_no_false_negatives(model, "JESP")
    if restarts < 1:
        raise ConfigError(f"at least 1 random plan is needed to begin with, not {restarts}", key="restarts")
    team = Team(model)
    return _Alternation(team, Limits() if limits is None else limits, horizon).run(
        Team(model, as_one=True), np.random.default_rng(seed), restarts, search
    )


class _Alternation:
    def __init__(self, team: Team, limits: Limits, horizon: int) -> None:
        self._team = team
        self._limits = limits
        self._horizon = horizon
        self._size = plan_size(team, horizon)
        self._responses = 0
        self.upper = float("inf")
        self.lower = -float("inf")
        self.best: JointPlan = []

    def run(self, one: Team, random: np.random.Generator, restarts: int, effort: int) -> Solution:
        """Solve; ``one`` is the team taken as one agent."""
        team, limits = self._team, self._limits
        with limits:
            self.upper = float(team.start @ staged_values(team.dynamics, self._horizon))
            self._take(random_plan(team, self._horizon, random))
            stages = None if self._ends() else solve_as_one(one, self._horizon, self._goes_on)
            if stages is not None:
                self.upper = min(self.upper, float(stages[0].values.max()))
            plan = self.best
            for restart in range(restarts):
                if restart:
                    plan = random_plan(team, self._horizon, random)
                if self._ends() or not self._climb(plan):
                    break
            exact = self._search(stages, effort) if stages is not None and effort and not self._ends() else False
            if not exact and limits.reason is None and not self._ends():
                limits.reason = "iterations"  # the restarts and the effort are used up
            # Rounding may have put the plan's value above the bound.
            self.upper = max(self.lower, self.upper)
            return limits.solution(
                as_controller(team, self.best),
                "jesp",
                self.lower,
                self.upper,
                iterations=self._responses,
                size=self._size,
                exact=exact,
            )

    def _goes_on(self) -> bool:
        return self._limits.remaining > 0

    def _ends(self) -> bool:
        return self._limits.ends(self.lower, self.upper, iterations=self._responses, size=self._size)

    def _take(self, plan: JointPlan) -> None:
        value = plan_value(self._team, plan)
        if value > self.lower:
            self.lower, self.best = value, plan

    def _climb(self, plan: JointPlan) -> bool:
        """Respond in turn until no agent improves; return whether to go on."""
        team = self._team
        value, unchanged, agent = -float("inf"), 0, 0
        while unchanged < team.num_agents:
            response = best_response(team, plan, agent, self._goes_on)
            if response is None:
                return not self._ends()
            self._responses += 1
            reached, tree = response
            if reached > value + _BETTER * (1 + abs(value) if value > -float("inf") else 0):
                value, unchanged = reached, 1
                plan = [*plan[:agent], tree, *plan[agent + 1 :]]
                if value > self.lower:
                    self._take(plan)
            else:
                unchanged += 1
            if self._ends():
                return False
            agent = (agent + 1) % team.num_agents
        return True

    def _search(self, stages: list[Stage], effort: int) -> bool:
        """Search for a better plan; return whether the best plan is proven optimal."""
        search = PlanSearch(self._team, stages, self.lower, effort, self._goes_on)
        while not search.done and search.effort > 0 and not self._ends():
            search.expand()
            if search.plan is not None:
                self._take(search.plan)
            self.upper = min(self.upper, search.upper)
        return search.done


# -- Joint plans -------------------------------------------------------------------------------------------------------

MOST = 50_000_000
"""Numbers that one step of a computation may take: 400 MB."""
_DIGITS = 12
"""Beliefs that agree to so many digits are one."""
_AS_ONE = 4_000_000


class Team:
    """A team's model.

    Args:
        model: A POMDP with as many factors of observations as agents.
        as_one: Take the agents as one that observes and decides for all (the MPOMDP).

    Raises:
        ModelError: If there is not one observation for each agent, or an event may be without an observation.
    """

    def __init__(self, model: POMDP, *, as_one: bool = False) -> None:
        if len(model.observation_space.factors) != model.num_agents:
            raise ModelError(
                f"agents of a team decide by their own observations, but the model has "
                f"{len(model.observation_space.factors)} factors of observations for {model.num_agents} agents"
            )
        self.dynamics = dynamics = Dynamics(model)
        self.actions = (len(model.action_space),) if as_one else model.action_space.shape
        self.observations = (len(model.observation_space),) if as_one else model.observation_space.shape
        self.num_agents = len(self.actions)
        self.num_states = dynamics.num_states
        self.discount = dynamics.discount
        self.start: Vector = model.initial_belief
        self.rewards: Vector = np.ascontiguousarray(dynamics.rewards.T)
        """R(s, a) of the joint actions, A x S."""
        self.seen: Indices = np.stack(np.unravel_index(np.arange(math.prod(self.observations)), self.observations), 1)
        """The agents' components of the joint observations, O x agents."""
        for action, name in enumerate(model.action_space.names if dynamics.by_transition else ()):
            total = dynamics.step(action, np.eye(self.num_states)).sum(axis=(1, 2))
            if np.abs(total - 1).max() > 1e-6:
                raise ModelError(
                    f"action {name!r} may lead to no observation at all; a joint plan is for agents that observe "
                    f"something at each step"
                )

    def joint_actions(self, own: list[Indices] | list[Indices | int]) -> Indices:
        """Return the indices of joint actions, of the agents' own."""
        return np.ravel_multi_index(tuple(np.broadcast_arrays(*own)), self.actions)

    def advance(self, beliefs: Vector, actions: Indices) -> Vector:
        """Step N x K distributions over states (N x K x S), those of a column by its joint action: N x K x O x S'."""
        count, columns, size = beliefs.shape
        result = np.empty((count, columns, len(self.seen), size))
        for action in np.unique(actions):
            taken = np.flatnonzero(actions == action)
            result[:, taken] = self.dynamics.step(int(action), beliefs[:, taken].reshape(-1, size)).reshape(
                count, len(taken), -1, size
            )
        return result


Tree: TypeAlias = "list[Indices]"
"""One agent's actions: an array for each step, by the index of its history (row-major, the oldest first)."""
JointPlan: TypeAlias = "list[Tree]"
"""A tree per agent."""


def plan_size(team: Team, horizon: int) -> int:
    """Return how many nodes the agents' trees have.

    Raises:
        ModelError: If there are too many to hold, or the horizon is no number of steps.
    """
    if horizon < 1:
        raise ModelError(f"a horizon is at least 1 decision, not {horizon}")
    nodes = 0
    for step in range(horizon):
        nodes += sum(symbols**step for symbols in team.observations)
        check_size(nodes, horizon)
    return nodes


def random_plan(team: Team, horizon: int, random: np.random.Generator) -> JointPlan:
    """Return a plan of actions drawn uniformly."""
    return [
        [random.integers(actions, size=symbols**step) for step in range(horizon)]
        for actions, symbols in zip(team.actions, team.observations, strict=True)
    ]


def plan_value(team: Team, plan: JointPlan) -> float:
    """Return the exact value of a plan at the initial belief.

    Raises:
        ModelError: If there are too many joint histories to follow.
    """
    horizon = len(plan[0])
    histories = np.zeros((1, team.num_agents), dtype=np.intp)
    reached = team.start[None, None, :]
    total, weight = 0.0, 1.0
    for step in range(horizon):
        actions = team.joint_actions([tree[step][histories[:, agent]] for agent, tree in enumerate(plan)])
        total += weight * float((reached[0] * team.rewards[actions]).sum())
        if step == horizon - 1:
            break
        check_size(reached.size * len(team.seen), horizon)
        after = team.advance(reached, actions).reshape(1, -1, team.num_states)
        possible = np.flatnonzero(after[0].any(axis=1))
        reached = after[:, possible]
        histories = lengthened(histories, team.seen, team.observations)[possible]
        weight *= team.discount
    return total


def lengthened(histories: Indices, seen: Indices, observations: Sequence[int]) -> Indices:
    """Return the histories (K x agents) that follow when each is continued by each joint observation: K O x agents."""
    longer = histories[:, None, :] * np.array(observations, dtype=np.intp) + seen[None]
    return longer.reshape(-1, longer.shape[2])


def check_size(size: int, horizon: int, most: int = MOST) -> None:
    """Refuse a computation that would take too much memory.

    Raises:
        ModelError: If it would.
    """
    if size > most:
        raise ModelError(
            f"a plan over {horizon} steps needs {size:,} numbers at once, more than {most:,}; take a shorter horizon"
        )


def as_controller(team: Team, plan: JointPlan) -> JointController:
    """Return a plan as controllers: each step's nodes follow those of the step before; nothing follows the last."""
    controllers = []
    for tree, count, symbols in zip(plan, team.actions, team.observations, strict=True):
        chosen: list[int] = []
        successors: list[Sequence[int | None]] = []
        for step, actions in enumerate(tree):
            chosen += actions.tolist()
            first = len(chosen)
            for history in range(len(actions)):
                begin = first + history * symbols
                successors.append([None] * symbols if step == len(tree) - 1 else range(begin, begin + symbols))
        controllers.append(FiniteStateController(chosen, successors, count))
    return JointController(controllers)


class Stage(NamedTuple):
    """The N reachable beliefs after some steps.

    Attributes:
        rewards: N x A, expected.
        values: N x A, of the actions, from here to the end, discounted to this step.
        chances: N x A x O, P(o | belief, a); empty after the last step.
        following: N x A x O, the belief of the next stage; -1 where the observation is impossible.
    """

    rewards: Vector
    values: Vector
    chances: Vector
    following: Indices


def best_response(
    team: Team, plan: JointPlan, agent: int, goes_on: Callable[[], bool] = lambda: True
) -> tuple[float, Tree] | None:
    """Return the value of a plan with the best tree for an agent, and that tree.

    Unreachable parts of the tree stay as they were.

    Args:
        team: The team.
        plan: The others' trees, and the agent's present one.
        agent: The agent whose tree is replaced.
        goes_on: Asked now and then; False breaks off.

    Returns:
        None if it was broken off.

    Raises:
        ModelError: If it would take too much memory.
    """
    stages = _stages(team, plan, agent, len(plan[agent]), goes_on, MOST)
    if stages is None:
        return None
    tree: Tree = []
    nodes = np.zeros(1, dtype=np.intp)
    for stage, before in zip(stages, plan[agent], strict=True):
        reached = nodes >= 0
        actions = np.where(reached, stage.values.argmax(axis=1)[nodes], before)
        tree.append(actions)
        if stage.following.size:
            nodes = np.where(reached[:, None], stage.following[nodes, actions], -1).ravel()
    return float(stages[0].values[0].max()), tree


def solve_as_one(team: Team, horizon: int, goes_on: Callable[[], bool] = lambda: True) -> list[Stage] | None:
    """Return the exact solution of a team taken as one agent; None if it is too large or was broken off."""
    try:
        return _stages(team, [], 0, horizon, goes_on, _AS_ONE)
    except ModelError:
        return None


def _stages(
    team: Team, plan: JointPlan, agent: int, horizon: int, goes_on: Callable[[], bool], most: int
) -> list[Stage] | None:
    others = [other for other in range(team.num_agents) if other != agent]
    own, symbols = team.actions[agent], team.observations[agent]
    their_symbols = [team.observations[other] for other in others]
    seen = np.stack(np.unravel_index(np.arange(len(team.seen) // symbols), tuple(their_symbols)), 1) if others else None
    histories = np.zeros((1, len(others)), dtype=np.intp)
    beliefs = team.start[None, None, :]  # N x the others' joint histories x S
    steps: list[tuple[Vector, Vector, Indices]] = []
    for step in range(horizon):
        count, columns, size = beliefs.shape
        actions: list[Indices | int] = [0] * team.num_agents
        for place, other in enumerate(others):
            actions[other] = plan[other][step][histories[:, place]]
        last = step == horizon - 1
        if not last:
            check_size(beliefs.size * own * len(team.seen), horizon, most)
        rewards = np.empty((count, own))
        after = np.empty((count, own, symbols, 0 if last else columns * len(team.seen) // symbols, size))
        for action in range(own):
            if not goes_on():
                return None
            actions[agent] = action
            joint = np.broadcast_to(team.joint_actions(actions), (columns,))
            rewards[:, action] = beliefs.reshape(count, -1) @ team.rewards[joint].ravel()
            if not last:
                moved = team.advance(beliefs, joint).reshape(count, columns, *team.observations, size)
                after[:, action] = np.moveaxis(moved, 2 + agent, 1).reshape(count, symbols, -1, size)
        chances = after.sum(axis=(3, 4))
        following = np.full((count, own, symbols), -1, dtype=np.intp)
        if not last:
            possible = chances > 0
            reached = after[possible] / chances[possible][:, None, None]
            if seen is not None:
                histories = lengthened(histories, seen, their_symbols)
                occurring = np.flatnonzero(reached.any(axis=(0, 2)))
                reached, histories = reached[:, occurring], histories[occurring]
            first, following[possible] = merged(np.round(reached.reshape(len(reached), -1), _DIGITS))
            beliefs = reached[first]
        steps.append((rewards, chances, following))
    return _valued(steps, team.discount)


def _valued(steps: list[tuple[Vector, Vector, Indices]], discount: float) -> list[Stage]:
    stages: list[Stage] = []
    for rewards, chances, following in reversed(steps):
        values = rewards
        if stages:
            best = stages[-1].values.max(axis=1)
            values = rewards + discount * (chances * best[following]).sum(axis=2)
        else:
            chances, following = chances[:, :, :0], following[:, :, :0]  # noqa: PLW2901 - nothing follows the last
        stages.append(Stage(rewards, values, chances, following))
    return stages[::-1]


def merged(rows: Vector) -> tuple[Indices, Indices]:
    """Return the first places of the distinct rows of an array, and for each row its number among these."""
    rows = np.ascontiguousarray(rows + 0.0)  # -0.0 becomes 0.0: bytes are compared
    keys = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel()
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    return first, which.ravel()


# -- The search --------------------------------------------------------------------------------------------------------

_CLUSTERED = 10
_SAME = 1e-10
"""Plans whose values differ by less, relative to the numbers at hand, are equally good."""

Rule = tuple[tuple[int, ...], ...]
"""The action of each agent in each of its clusters."""


class _Partial(NamedTuple):
    """A partial plan: its steps so far, and the joint clusters that its next step tells apart."""

    value: float
    chances: Vector  # C_1 x ... x C_n
    beliefs: Indices  # of the same shape: what the team as one would believe, by its number in the stage
    before: _Partial | None
    rule: Rule
    clusters: tuple[Indices, ...]  # per agent: C_i of the step before x O_i, -1 where it cannot occur

    @property
    def step(self) -> int:
        return 0 if self.before is None else self.before.step + 1


class PlanSearch:
    """A search under way: call `expand` until it is `done`.

    Args:
        team: The team.
        stages: The solution of the team as one agent, which bounds the value of a plan.
        lower: The value of the best plan known.
        effort: The most partial decision rules to try.
        goes_on: Asked now and then; False uses up the effort.
    """

    def __init__(
        self, team: Team, stages: list[Stage], lower: float, effort: int, goes_on: Callable[[], bool] = lambda: True
    ) -> None:
        self._team = team
        self._stages = stages
        self._shape = tuple(range(team.num_agents))
        self._scale = _SAME * (1 + max(float(np.abs(stage.values).max()) for stage in stages))
        self.lower = lower
        self.plan: JointPlan | None = None
        """The best plan found; None while none beats the one that was known."""
        self.effort = effort
        self._goes_on = goes_on
        self._numbers = itertools.count()
        self._open: list[tuple[float, int, _Partial | None, Rule]] = [
            (-float(stages[0].values.max()), next(self._numbers), None, ()),
        ]

    @property
    def upper(self) -> float:
        """No plan has a greater value."""
        return max(self.lower, -self._open[0][0]) if self._open else self.lower

    @property
    def done(self) -> bool:
        """Whether the best plan known is proven optimal."""
        return not self._open or -self._open[0][0] <= self.lower + self._scale

    def expand(self) -> None:
        """Continue the most promising partial plan by one step; where the effort is used up, it stays as it was."""
        bound, _, before, decided = self._open[0]
        if before is None:
            ones = (1,) * self._team.num_agents
            partial = _Partial(0.0, np.ones(ones), np.zeros(ones, dtype=np.intp), None, (), ())
        else:
            partial = self._continued(before, decided)
        step = partial.step
        stage = self._stages[step]
        game = self._team.discount**step * partial.chances[..., None] * stage.values[partial.beliefs]
        game = game.reshape(*partial.chances.shape, *self._team.actions)
        children: list[tuple[float, int, _Partial, Rule]] = []
        for gained, rule in self._rules(game, partial.value):
            if step == len(self._stages) - 1:
                self.lower = partial.value + gained
                self.plan = self._plan(partial, rule)
            else:
                children.append((-min(partial.value + gained, -bound), next(self._numbers), partial, rule))
        if self.effort > 0:
            heapq.heappop(self._open)
            for child in children:
                heapq.heappush(self._open, child)

    def _rules(self, game: Vector, value: float) -> Iterator[tuple[float, Rule]]:
        """Yield the joint decision rules that could beat the best plan known, with upper bounds of their values.

        ``game`` is clusters (one axis per agent) x actions (one axis per agent); actions that are ruled out are -inf.
        """
        agents = self._team.num_agents
        axes = tuple(range(agents, 2 * agents))
        weighed = [
            (-np.abs(np.moveaxis(game, agent, 0)[cluster]).sum(), agent, cluster)
            for agent in range(agents)
            for cluster in range(game.shape[agent])
        ]
        order = [(agent, cluster) for _, agent, cluster in sorted(weighed)]

        def descend(game: Vector, depth: int, chosen: dict[tuple[int, int], int]) -> Iterator[tuple[float, Rule]]:
            if depth == len(order):
                clusters = game.shape
                rule = tuple(tuple(chosen[agent, c] for c in range(clusters[agent])) for agent in range(agents))
                yield game.max(axis=axes).sum(), rule
                return
            agent, cluster = order[depth]
            options = []
            for action in range(self._team.actions[agent]):
                narrowed = game.copy()
                place = np.moveaxis(np.moveaxis(narrowed, agents + agent, 0), agent + 1, 1)  # A_i x C_i x the rest
                place[np.arange(len(place)) != action, cluster] = -math.inf
                options.append((-narrowed.max(axis=axes).sum(), action, narrowed))
            for least, action, narrowed in sorted(options, key=lambda option: option[:2]):
                self.effort = self.effort - 1 if self._goes_on() else 0
                if self.effort <= 0:
                    return
                if value - least <= self.lower + self._scale:
                    return  # and so are those after it
                yield from descend(narrowed, depth + 1, chosen | {(agent, cluster): action})

        return descend(game, 0, {})

    def _continued(self, partial: _Partial, rule: Rule) -> _Partial:
        team, stage = self._team, self._stages[partial.step]
        weight = team.discount**partial.step
        agents = self._shape
        actions = team.joint_actions([np.array(own) for own in np.ix_(*map(np.array, rule))])
        value = partial.value + weight * float((partial.chances * stage.rewards[partial.beliefs, actions]).sum())
        # C_1 x ... x C_n x O_1 x ... x O_n, then each agent's clusters beside its observations
        chances = partial.chances[..., None] * stage.chances[partial.beliefs, actions]
        beliefs = stage.following[partial.beliefs, actions]
        axes = tuple(axis for agent in agents for axis in (agent, len(agents) + agent))
        shape = tuple(count * symbols for count, symbols in zip(partial.chances.shape, team.observations, strict=True))
        spread = (*partial.chances.shape, *team.observations)
        chances = chances.reshape(spread).transpose(axes).reshape(shape)
        beliefs = np.where(chances > 0, beliefs.reshape(spread).transpose(axes).reshape(shape), -1)
        maps = []
        for agent in agents:
            chances, beliefs, clusters = _clustered(chances, beliefs, agent)
            maps.append(clusters.reshape(-1, team.observations[agent]))
        return _Partial(value, chances, beliefs, partial, rule, tuple(maps))

    def _plan(self, partial: _Partial, rule: Rule) -> JointPlan:
        """Return the plan that a partial one and its last rule make, for every history."""
        path: list[_Partial] = []
        node: _Partial | None = partial
        while node is not None:
            path.insert(0, node)
            node = node.before
        rules = [*(later.rule for later in path[1:]), rule]
        plan: JointPlan = []
        for agent in self._shape:
            clusters = np.zeros(1, dtype=np.intp)
            tree = []
            for step, decided in enumerate(rules):
                if step:
                    following = path[step].clusters[agent]
                    clusters = np.where(clusters[:, None] >= 0, following[clusters], -1).ravel()
                tree.append(np.where(clusters >= 0, np.array(decided[agent])[clusters], 0))
            plan.append(tree)
        return plan


def _clustered(chances: Vector, beliefs: Indices, agent: int) -> tuple[Vector, Indices, Indices]:
    """Join an agent's equivalent histories; return also the cluster of each, -1 for an impossible one."""
    rows = np.moveaxis(chances, agent, 0)
    rest = rows.shape[1:]
    rows = rows.reshape(len(rows), -1)
    numbers = np.moveaxis(beliefs, agent, 0).reshape(rows.shape)
    mass = rows.sum(axis=1)
    possible = np.flatnonzero(mass > 0)
    relative = np.round(rows[possible] / mass[possible, None], _CLUSTERED)
    first, which = merged(np.hstack([relative, numbers[possible]]))
    joined = np.zeros((len(first), rows.shape[1]))
    np.add.at(joined, which, rows[possible])
    clusters = np.full(len(rows), -1, dtype=np.intp)
    clusters[possible] = which
    kept = numbers[possible[first]].reshape(-1, *rest)
    return np.moveaxis(joined.reshape(-1, *rest), 0, agent), np.moveaxis(kept, 0, agent), clusters
