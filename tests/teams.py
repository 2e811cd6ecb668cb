"""Random teams, and the value of their plans by plain recursion."""

from __future__ import annotations

import itertools

import numpy as np
from random_models import distributions

from mdm.models import POMDP, Factor, Space


def team(seed, *, agents=2, states=2, actions=2, observations=2, events=False, seen=1.0, discount=0.9):
    """Return a random Dec-POMDP; of its events a share is observed."""
    random = np.random.default_rng(seed)
    joint_actions, joint_observations = actions**agents, observations**agents
    told = distributions(random, joint_actions, states, joint_observations)
    if events:
        told = seen * np.moveaxis(distributions(random, joint_actions, states, states, joint_observations), -1, 1)
    return POMDP(
        distributions(random, joint_actions, states, states),
        told,
        random.normal(size=(states, joint_actions)).round(2),
        discount=discount,
        actions=Space(Factor(f"robot{agent}", actions) for agent in range(agents)),
        observation_names=Space(Factor(f"robot{agent}", observations) for agent in range(agents)),
        initial_belief=distributions(random, states),
        event_observations=events,
    )


def worth(model, horizon, act):
    """Return the value of acting by ``act(histories)``, by recursion over states and observations."""
    seen = model.observation_space

    def from_here(state, histories, left):
        action = model.action_space.ravel(act(histories))
        total = float(model.rewards[state, action])
        if left > 1:
            for after in range(len(model.state_space)):
                for observation in range(len(seen)):
                    chance = model.transition(action, state, after) * model.observation(
                        action, after, observation, state=state
                    )
                    if chance > 0:
                        parts = seen.unravel(observation)
                        longer = tuple((*past, part) for past, part in zip(histories, parts, strict=True))
                        total += model.discount * chance * from_here(after, longer, left - 1)
        return total

    start = ((),) * model.num_agents
    return sum(p * from_here(s, start, horizon) for s, p in enumerate(model.initial_belief) if p > 0)


def by_trees(policy):
    def act(histories):
        actions = []
        for controller, past in zip(policy.controllers, histories, strict=True):
            node = controller.start
            for observation in past:
                node = controller.next_node(node, observation)
            actions.append(controller.action_at(node))
        return actions

    return act


def best_of_all(model, horizon):
    """Return the best value over all joint plans, by enumeration."""
    pasts = [past for length in range(horizon) for past in itertools.product(*[range(2)] * length)]
    agents = model.num_agents
    values = []
    for choice in itertools.product(range(2), repeat=len(pasts) * agents):
        tables = [dict(zip(pasts, choice[agent * len(pasts) :], strict=False)) for agent in range(agents)]
        values.append(
            worth(model, horizon, lambda seen, of=tables: [table[p] for table, p in zip(of, seen, strict=True)])
        )
    return max(values)
