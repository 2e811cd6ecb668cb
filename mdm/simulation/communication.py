"""Simulation of a communicating team in one process: the return of a communication policy, and its messages.

The agents decide for themselves, each on its own `Knowledge`; a model drives the world. Messages arrive after a number
of steps, or are lost, by seed. There is no network, no runtime and no clock: time goes by steps.
"""

from __future__ import annotations

import copy
import time
from collections import defaultdict
from typing import TYPE_CHECKING, Unpack

import numpy as np

from mdm.checks import is_number, is_whole
from mdm.errors import ConfigError
from mdm.loading import model_of, policy_of
from mdm.models.matrices import Vector  # noqa: TC001 - field types are evaluated
from mdm.simulation.batch import Evaluation
from mdm.simulation.sampler import Sampler
from mdm.simulation.world import steps_for
from mdm.team import Knowledge

if TYPE_CHECKING:
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models import MDP, POMDP
    from mdm.options import ControllerOptions
    from mdm.team import CommunicationPolicy, SharedHistory


class CommunicationEvaluation(Evaluation, frozen=True, kw_only=True):
    """The result of simulated episodes of a communicating team.

    Attributes:
        messages: The number of messages of each episode. One to all others counts once.
        lost: The number of copies that did not arrive, of all episodes.
        too_late: The number of experiences that came after the window, of all episodes.
    """

    messages: Vector
    lost: int
    too_late: int

    @property
    def messages_per_step(self) -> float:
        """The mean number of messages per step, the first one apart, at which there is nothing to share."""
        return float(self.messages.sum()) / max(1, self.moves - self.episodes)


def evaluate_communication(
    model: GivenModel,
    policy: GivenPolicy,
    communication: CommunicationPolicy,
    *,
    episodes: int = 1_000,
    steps: int | None = None,
    delay: int = 0,
    loss: float = 0.0,
    in_turn: bool = False,
    period: float = 1.0,
    window: int = 32,
    **options: Unpack[ControllerOptions],
) -> CommunicationEvaluation:
    """Estimate the return of a team whose agents decide for themselves, and count its messages.

    At each step all agents observe, then share, then decide, all at once. Without a delay messages arrive before the
    decision, and an agent that heard something new may answer, until nobody has anything to say; or they share in turn,
    so that none repeats in effect what another has just said. An episode has ``steps`` decisions; by default so many
    that the discounted weight of the rest is below 1e-4.

    Args:
        model: The team's model, or the path of its file.
        policy: A policy of the team over beliefs, the same for all agents; see `Controller`.
        communication: Decides which experience an agent shares when. Each agent has a copy of its own in each episode.
        episodes: The number of episodes.
        steps: Decisions per episode.
        delay: The steps that a message takes.
        loss: The probability that a message does not reach another agent, for each of them.
        in_turn: Whether the agents of a step share one after the other, in their order, each knowing what arrived
            before. It takes a network that is as many times faster than the steps.
        period: Seconds per step, for communication policies that go by time.
        window: How many steps late something may come; see `Recollection`.
        options: See `ControllerOptions`. The ``seed`` is also the world's: the same seed gives the same result, and the
            same random numbers for another communication policy; by default it is random.

    Raises:
        ConfigError: If the policy does not fit the model, a number makes no sense, or episodes have no end.

    Example::

        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        talk = mdm.team.ValueOfCommunication(threshold=1.0)
        result = mdm.simulation.evaluate_communication(model, policy, talk, episodes=20, seed=1)
        result.mean, result.interval  # the return, and its 95 % confidence interval
        result.messages_per_step  # the messages of both agents together
    """
    given_model = model_of(model)
    policy = policy_of(policy, given_model)
    model = _checked(given_model, episodes, steps, delay, loss, period)
    count = options.get("horizon") or (steps_for(model.discount) if steps is None else steps)
    given = options.pop("seed", None)
    if given is not None and hasattr(policy, "seed"):
        options["seed"] = given
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if given is None else given
    agents = [
        Knowledge(policy, model, agent, communication, window=window, **options) for agent in range(model.num_agents)
    ]
    team = _Team(model, agents, communication, delay=delay, loss=loss, in_turn=in_turn, period=period)
    began = time.perf_counter()
    runs = [team.run(count, stream) for stream in np.random.SeedSequence(seed).spawn(episodes)]
    returns, messages = (np.array(column, dtype=np.float64) for column in zip(*runs, strict=True))
    returns.setflags(write=False)
    messages.setflags(write=False)
    seconds = time.perf_counter() - began
    told = Evaluation.of(returns, count, seed, episodes * count, seconds)
    too_late = sum(agent.own.statistics().too_late for agent in agents)
    return CommunicationEvaluation(
        *(told.mean, told.standard_error, told.returns, told.steps, told.seed, told.moves, told.seconds),
        messages=messages,
        lost=team.lost,
        too_late=too_late,
    )


def _checked(model: MDP, episodes: int, steps: int | None, delay: int, loss: float, period: float) -> POMDP:
    """Return the model of a team that communicates, where all else fits, too."""
    if model.pomdp is None or model.false_negative is not None:
        raise ConfigError("a communicating team shares observations: it needs a POMDP, without false negatives")
    for name, number, least in (("episodes", episodes, 1), ("steps", steps, 1), ("delay", delay, 0)):
        if number is not None and (not is_whole(number) or number < least):
            raise ConfigError(f"{name}: a whole number from {least} on is needed, not {number!r}", key=name)
    if not is_number(loss) or not 0 <= loss <= 1:
        raise ConfigError(f"a loss is a probability, not {loss!r}", key="loss")
    if not is_number(period) or not period > 0:
        raise ConfigError(f"a period is a positive number of seconds, not {period!r}", key="period")
    return model.pomdp


class _Team:
    """The agents, the world, and the messages between them."""

    def __init__(
        self,
        model: POMDP,
        agents: list[Knowledge],
        communication: CommunicationPolicy,
        *,
        delay: int,
        loss: float,
        in_turn: bool,
        period: float,
    ) -> None:
        self._model = model
        self._agents = agents
        self._communication = communication
        self._delay = delay
        self._loss = loss
        self._in_turn = in_turn
        self._period = period
        self._sampler = Sampler(model)
        self._rewards: list[list[float]] = model.rewards.tolist()
        self.lost = 0

    def run(self, steps: int, stream: np.random.SeedSequence) -> tuple[float, int]:
        """Run an episode; return its discounted return and the number of its messages."""
        world, network = stream.spawn(2)
        self._sampler.seed(world)
        self._network = np.random.default_rng(network)
        self._under_way: dict[int, list[tuple[int, SharedHistory]]] = defaultdict(list)
        for agent in self._agents:
            agent.communication = copy.deepcopy(self._communication)
            agent.start()
        state = self._sampler.first_state()
        actions, observations = self._model.action_space, self._model.observation_space
        total, weight, messages = 0.0, 1.0, 0
        for step in range(steps):
            messages += self._talk(step)
            action = actions.ravel([actions.unravel(each.decide().action)[each.agent] for each in self._agents])
            total += weight * self._rewards[state][action]
            weight *= self._model.discount
            before, state = state, self._sampler.next_state(state, action)
            observation = self._sampler.observation(action, before, state)
            seen = [None] * len(self._agents) if observation is None else observations.unravel(observation)
            for agent, component in zip(self._agents, seen, strict=True):
                agent.observe(component)
        return total, messages

    def _talk(self, step: int) -> int:
        """Deliver the messages of a step, and let all share until nobody has more to say; return how many messages."""
        self._deliver(step)
        asked, messages = set(range(len(self._agents))), 0
        while asked:
            now = {min(asked)} if self._in_turn else asked
            said = [history for each in sorted(now) if (history := self._agents[each].share(step * self._period))]
            for history in said:
                for other in range(len(self._agents)):
                    if other == history.agent:
                        continue
                    if self._network.random() < self._loss:
                        self.lost += 1
                    else:
                        self._under_way[step + self._delay].append((other, history))
            messages += len(said)
            asked = asked - now | self._deliver(step)
        return messages

    def _deliver(self, step: int) -> set[int]:
        """Deliver the messages of a step; return who heard something."""
        arrived = self._under_way.pop(step, [])
        for agent, history in arrived:
            self._agents[agent].hear(history)
        return {agent for agent, _ in arrived}
