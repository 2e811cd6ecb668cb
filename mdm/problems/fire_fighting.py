"""Fire fighting: a team that saves a row of houses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models import Factor, FactoredPOMDP, Node, Space, Table, Tree, TwoSliceNetwork
from mdm.problems.parameters import agents, checked

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.models import Potential
    from mdm.models.matrices import Vector

_SPREADS = 0.8  # to a house where nobody fights, from one beside it
_GROWS = 0.4  # where nobody fights and nothing burns beside it
_SHRINKS = 0.6  # where one agent fights while a house burns beside it
_SEES_FLAMES = (0.2, 0.5, 0.8)  # no fire, a small one, any larger one


@checked
def fire_fighting(houses: int = 3, team: int = 2, fire_levels: int = 3, *, discount: float = 1.0) -> FactoredPOMDP:
    """Return the problem of a team that fights fires in a row of houses, each agent at any house.

    At each step every agent goes to a house. A house where two agents or more fight is saved; one agent lowers its fire
    by a level, surely if nothing burns beside it, else with probability 0.6. Where nobody fights, a fire grows by a
    level with probability 0.4; if a house beside it burns, a fire begins or grows with probability 0.8. The reward is
    minus the sum of the levels after the step. An agent sees flames, or none, at the house it went to.

    fire_levels^houses x (houses + 1)^team states, houses^team actions, 2^team observations. A state has a factor for
    each house's fire, and for each agent's house (``start`` before the first step). Optimal values of decentralised
    plans with 3 houses, 2 agents and 3 levels, where probabilities are rounded to two digits as in the MADP toolbox'
    file: -4.38350 for 2 decisions, -5.73697 for 3, -6.57883 for 4; as they are here -4.38358 and -5.73714.

    Source: F. A. Oliehoek, M. T. J. Spaan and N. Vlassis, *Optimal and approximate Q-value functions for decentralized
    POMDPs*, JAIR 32, 2008. Values: F. A. Oliehoek, M. T. J. Spaan, C. Amato and S. Whiteson, *Incremental clustering
    and expansion for faster optimal planning in Dec-POMDPs*, JAIR 46, 2013.

    Args:
        houses: How many houses stand in a row.
        team: How many agents there are.
        fire_levels: How many levels a fire has, with that of no fire.
        discount: In (0, 1].

    Raises:
        ModelError: If there is no house, no agent, or less than 2 levels.
    """
    _check(houses, team, fire_levels)
    fires = [Factor(f"fire{house}", fire_levels, prefix="f") for house in range(1, houses + 1)]
    places = [*(f"h{house}" for house in range(1, houses + 1)), "start"]
    states = Space([*fires, *(Factor(f"location{agent}", places) for agent in range(team))])
    transitions: list[Potential] = [
        _fire(house, houses, fire_levels, dict.fromkeys(range(team), house), houses) for house in range(houses)
    ]
    goes = np.eye(houses, houses + 1)
    transitions += [Table([Node("action", agent), Node("next_state", houses + agent)], goes) for agent in range(team)]
    observation = []
    for agent in range(team):
        sees = Node("observation", agent)
        at_house = [Table([Node("next_state", house), sees], _flames(fire_levels)) for house in range(houses)]
        at_start = Table([sees], _flames(1)[0])
        location = Node("next_state", houses + agent)
        observation.append(Tree(location, range(houses + 1), [*at_house, at_start]))
    network = TwoSliceNetwork(
        states,
        agents([f"go{house}" for house in range(1, houses + 1)], team),
        agents(["flames", "noFlames"], team),
        initial=[
            *(Table([Node("state", house)], np.full(fire_levels, 1 / fire_levels)) for house in range(houses)),
            *(Table([Node("state", houses + agent)], np.eye(houses + 1)[-1]) for agent in range(team)),
        ],
        transitions=transitions,
        observation=observation,
        utilities=_losses(houses, fire_levels),
    )
    return FactoredPOMDP(network, discount=discount)


@checked
def fire_fighting_graph(team: int = 3, fire_levels: int = 3, *, discount: float = 1.0) -> FactoredPOMDP:
    """Return the problem of a team that fights fires in a row of houses, each agent between two of them.

    There is a house more than there are agents. At each step an agent goes to the house on its left or on its right.
    Fires, rewards and observations are those of `fire_fighting`; an agent's place is not part of the state, as its last
    action tells it.

    fire_levels^(team + 1) states, 2^team actions, 2^team observations.

    Source: F. A. Oliehoek, M. T. J. Spaan, S. Whiteson and N. Vlassis, *Exploiting locality of interaction in factored
    Dec-POMDPs*, AAMAS 2008.

    Args:
        team: How many agents there are.
        fire_levels: How many levels a fire has, with that of no fire.
        discount: In (0, 1].

    Raises:
        ModelError: If there is no agent, or less than 2 levels.
    """
    houses = team + 1
    _check(houses, team, fire_levels)
    left, right = 0, 1
    transitions = []
    for house in range(houses):
        coming = {house - 1: right, house: left}
        transitions.append(
            _fire(house, houses, fire_levels, {agent: go for agent, go in coming.items() if 0 <= agent < team}, 2)
        )
    observation = []
    for agent in range(team):
        sees = Node("observation", agent)
        sides = [Table([Node("next_state", agent + side), sees], _flames(fire_levels)) for side in range(2)]
        observation.append(Tree(Node("action", agent), [left, right], sides))
    network = TwoSliceNetwork(
        Space(Factor(f"fire{house}", fire_levels, prefix="f") for house in range(1, houses + 1)),
        agents(["left", "right"], team),
        agents(["flames", "noFlames"], team),
        initial=[Table([Node("state", house)], np.full(fire_levels, 1 / fire_levels)) for house in range(houses)],
        transitions=transitions,
        observation=observation,
        utilities=_losses(houses, fire_levels),
    )
    return FactoredPOMDP(network, discount=discount)


def _check(houses: int, team: int, fire_levels: int) -> None:
    if houses < 1 or team < 1 or fire_levels < 2:
        raise ModelError(
            f"fire fighting needs at least a house, an agent and 2 levels of fire, not {houses}, {team} and "
            f"{fire_levels}"
        )


def _fire(house: int, houses: int, levels: int, coming: Mapping[int, int], choices: int) -> Table:
    """Return how a house's fire goes on.

    Args:
        house: The house.
        houses: How many there are.
        levels: Levels of a fire.
        coming: For each agent that can fight here, the action that brings it here.
        choices: How many actions an agent has.
    """
    beside = [other for other in (house - 1, house + 1) if 0 <= other < houses]
    values = np.zeros((levels,) * (1 + len(beside)) + (choices,) * len(coming) + (levels,))
    for given in np.ndindex(values.shape[:-1]):
        level, around, actions = given[0], given[1 : 1 + len(beside)], given[1 + len(beside) :]
        fighting = sum(action == here for action, here in zip(actions, coming.values(), strict=True))
        values[given] = _next_level(level, levels, fighting, burns_beside=any(around))
    fires = [Node("state", other) for other in (house, *beside)]
    return Table([*fires, *(Node("action", agent) for agent in coming), Node("next_state", house)], values)


def _next_level(level: int, levels: int, fighting: int, *, burns_beside: bool) -> Vector:
    """Return the distribution of a fire's next level."""
    row = np.zeros(levels)
    if fighting > 1:
        row[0] = 1
    elif fighting == 1:
        shrinks = _SHRINKS if burns_beside else 1.0
        row[level] += 1 - shrinks
        row[max(level - 1, 0)] += shrinks
    else:
        grows = _SPREADS if burns_beside else _GROWS if level else 0.0
        row[level] += 1 - grows
        row[min(level + 1, levels - 1)] += grows
    return row


def _flames(levels: int) -> Vector:
    """Return for each level of a fire the probabilities to see flames and to see none."""
    seen = np.array([_SEES_FLAMES[min(level, 2)] for level in range(levels)])
    return np.stack([seen, 1 - seen], axis=1)


def _losses(houses: int, levels: int) -> list[Table]:
    return [Table([Node("next_state", house)], -np.arange(levels)) for house in range(houses)]
