"""Environments of models, for those who decide as one and for agents that decide each for itself.

They terminate in states that are never left and earn nothing: learners take the rest to be worth 0 (R. S. Sutton and A.
G. Barto, *Reinforcement learning: an introduction*, 2nd edition, 2018, section 3.4).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from pettingzoo import ParallelEnv

from mdm.beliefs import BeliefTracker
from mdm.checks import is_whole
from mdm.errors import ConfigError, ModelError
from mdm.models.dynamics import Dynamics
from mdm.models.matrices import ROUNDING
from mdm.models.units import check_steps
from mdm.simulation import Sampler

if TYPE_CHECKING:
    from mdm.models import MDP, Space


class AgentEnvironment(gymnasium.Env[Any, Any]):
    """A model as an environment, whose spaces `mdm.gym.environment` describes."""

    def __init__(self, model: MDP, *, beliefs: bool, steps: int | None, factored: bool) -> None:
        if steps is not None and not (is_whole(steps) and steps >= 1):
            raise ConfigError(f"an episode has at least 1 step, or None for no limit, not {steps!r}", key="steps")
        check_steps(model)
        self.model: MDP = model.step_by_step()
        dynamics = Dynamics(model)
        stays = [matrix.diagonal() >= 1 - ROUNDING for matrix in dynamics.matrices]
        self._absorbing = np.all([*stays, *(dynamics.rewards == 0).T], axis=0)
        self._sampler, self._source = Sampler(self.model), np.random.default_rng()
        self._factored, self._steps, self._taken = factored, math.inf if steps is None else steps, -1
        self._state, pomdp = 0, self.model.pomdp
        self._seen: int | None = None
        self._tracker = BeliefTracker(pomdp) if beliefs and pomdp is not None else None
        self._shown: Space = model.state_space if pomdp is None else pomdp.observation_space
        self.action_space = _space(model.action_space, 0, factored=factored)
        symbols = _space(self._shown, int(pomdp is not None), factored=factored)
        self.observation_space = Box(0.0, 1.0, (len(model.state_space),), np.float32) if beliefs else symbols

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; return the first observation and the info."""
        super().reset(seed=seed)
        if self.np_random is not self._source:
            self._source = self.np_random
            self._sampler.seed(self._source)
        self._state, self._seen, self._taken = self._sampler.first_state(), None, 0
        if self._tracker is not None and self.model.pomdp is not None:
            self._tracker.reset(self.model.pomdp.belief_at_start(self._state))
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take an action; return the observation, the reward, whether it is terminated, or truncated, and the info."""
        if self._taken < 0:
            raise ConfigError("no episode has begun: call reset() before step()")
        index = self.model.action_space.index(action.tolist() if isinstance(action, np.ndarray) else action)
        before, self._state = self._state, self._sampler.next_state(self._state, index)
        if self.model.pomdp is not None:
            self._seen = self._sampler.observation(index, before, self._state)
        if self._tracker is not None:
            self._tracker.update(index, self._seen)
        try:
            reward = self.model.reward(index, before, self._state, self._seen)
        except ModelError:  # it is of an observation, and there is none: R(s, a) counts nothing for it
            reward = 0.0
        self._taken += 1
        ends = bool(self._absorbing[self._state]), self._taken >= self._steps
        return self._observation(), reward, *ends, self._info()

    def _observation(self) -> Any:
        if self._tracker is not None:
            return self._tracker.belief.astype(np.float32)
        seen = self._state if self.model.pomdp is None else self._seen
        if self._factored:
            return np.array(self._shown.shape if seen is None else self._shown.unravel(seen), dtype=np.int64)
        return len(self._shown) if seen is None else seen

    def _info(self) -> dict[str, Any]:
        mask = None if self._factored else self.model.available
        return {} if mask is None else {"action_mask": mask[self._state].astype(np.int8)}


def _space(symbols: Space, more: int, *, factored: bool) -> Any:
    return MultiDiscrete([size + more for size in symbols.shape]) if factored else Discrete(len(symbols) + more)


class TeamEnvironment(ParallelEnv):
    """A team's model as an environment, which `mdm.gym.parallel` describes."""

    def __init__(self, model: MDP, *, steps: int | None) -> None:
        agents, pomdp = model.action_space.factors, model.pomdp
        seen = (
            len(agents) * [len(model.state_space)] if pomdp is None else [n + 1 for n in pomdp.observation_space.shape]
        )
        if len(seen) != len(agents):
            raise ModelError(
                f"{len(agents)} agents need as many factors of observations, not {len(seen)}: use environment()"
            )
        self._joint = AgentEnvironment(model, beliefs=False, steps=steps, factored=pomdp is not None)
        self.metadata, self.render_mode = {"name": "mdm", "render_modes": []}, None
        self.possible_agents = [agent.name for agent in agents]
        self.agents: list[str] = []
        self.action_spaces = {agent.name: Discrete(len(agent)) for agent in agents}
        self.observation_spaces = dict(zip(self.possible_agents, map(Discrete, seen), strict=True))
        self.action_space, self.observation_space = self.action_spaces.__getitem__, self.observation_spaces.__getitem__

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """Begin an episode; return each agent's first observation and its info."""
        seen, _ = self._joint.reset(seed=seed)
        self.agents = [*self.possible_agents]
        return self._each(seen), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, Any]) -> tuple[Any, ...]:
        """Take an action of each agent; return by agent observations, rewards, terminated, truncated and infos."""
        if not self.agents:
            raise ConfigError("the episode has ended: call reset() before step()")
        if missing := [agent for agent in self.agents if agent not in actions]:
            raise ConfigError(f"each agent acts at each step, but {missing[0]!r} has no action")
        seen, *outcome, _ = self._joint.step([actions[agent] for agent in self.agents])
        shared = [dict.fromkeys(self.agents, each) for each in outcome]
        result = self._each(seen), *shared, {agent: {} for agent in self.agents}
        if any(outcome[1:]):
            self.agents = []
        return result

    def _each(self, seen: Any) -> dict[str, int]:
        if self._joint.model.pomdp is None:
            return dict.fromkeys(self.agents, seen)
        return dict(zip(self.agents, seen.tolist(), strict=True))
