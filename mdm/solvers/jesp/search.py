"""The exact search for the best joint plan: multi-agent A* over partial plans, with clustered histories.

A partial plan fixes the agents' actions in the first steps. Its value is at most that of these steps and, from there
on, of a team that shares all observations. The most promising one is continued by every joint decision rule that could
still beat the best plan known (D. Szer, F. Charpillet and S. Zilberstein, "MAA*: a heuristic search algorithm for
solving decentralized POMDPs", UAI 2005). Histories of an agent with equal distributions over states and over the
others' histories are one (F. A. Oliehoek, S. Whiteson and M. T. J. Spaan, *Lossless clustering of histories in
decentralized POMDPs*, AAMAS 2009). The rules of a step are found by branch and bound over one agent's cluster after the
other. The worst case is doubly exponential in the horizon: it is for small ones.
"""

from __future__ import annotations

import heapq
import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.solvers.jesp.joint_plan import merged

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mdm.models.dynamics import Indices
    from mdm.models.matrices import Vector
    from mdm.solvers.jesp.joint_plan import JointPlan, Stage, Team

__all__ = ["PlanSearch"]

_DIGITS = 10
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
    relative = np.round(rows[possible] / mass[possible, None], _DIGITS)
    first, which = merged(np.hstack([relative, numbers[possible]]))
    joined = np.zeros((len(first), rows.shape[1]))
    np.add.at(joined, which, rows[possible])
    clusters = np.full(len(rows), -1, dtype=np.intp)
    clusters[possible] = which
    kept = numbers[possible[first]].reshape(-1, *rest)
    return np.moveaxis(joined.reshape(-1, *rest), 0, agent), np.moveaxis(kept, 0, agent), clusters
