"""JESP: joint plans of a finite horizon for teams without communication, by alternating best responses.

From random plans, one agent after the other takes its best response to the others' plans, until no agent can improve
alone: a Nash equilibrium, hence a local optimum (R. Nair, M. Tambe, M. Yokoo, D. Pynadath and S. Marsella, *Taming
decentralized POMDPs*, IJCAI 2003). Restarts find better ones. Then a search of limited effort proves the best plan
optimal, or finds the optimum (see `search`). The lower bound is the exact value of the plan at the initial belief; the
upper one is the value of a team that shares all observations (MPOMDP), or knows the state.

A best response costs up to (A_i O_i)^t beliefs of S times the others' histories numbers at step t, see `response`; the
search is doubly exponential in the horizon at worst. For one agent alone the first response is optimal already, yet
point-based solvers reach horizons that this one does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ConfigError
from mdm.models.events import check_no_false_negatives
from mdm.policies import JointController
from mdm.solvers.bounds import staged_values
from mdm.solvers.jesp.joint_plan import (
    Team,
    as_controller,
    best_response,
    plan_size,
    plan_value,
    random_plan,
    solve_as_one,
)
from mdm.solvers.jesp.search import PlanSearch
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    from mdm.models import POMDP
    from mdm.solvers.jesp.joint_plan import JointPlan, Stage
    from mdm.solvers.solution import Solution

__all__ = ["jesp"]

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
