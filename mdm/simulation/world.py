"""The world: an actor that samples a model, in response to the actions of an ensemble; and simulations in it.

`simulate` gives the mean discounted return of a policy in its model, by the real decision loop in virtual time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from mdm.actors import Ensemble, FixedRate
from mdm.beliefs import DrawnInformation
from mdm.checks import check_seed, is_whole
from mdm.errors import ConfigError
from mdm.loading import model_of, policy_of
from mdm.messages import Action, Belief, Fault, Observation, Reward, State
from mdm.models.units import check_steps, seconds_in
from mdm.runtime import Actor, Runtime, run
from mdm.simulation.batch import joined_evaluation
from mdm.simulation.sampler import Lengths, Sampler
from mdm.stimuli import TRUE_REWARD, TRUE_STATE

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Executor
    from pathlib import Path

    from mdm.actors import ControlOptions
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models import MDP, Durations
    from mdm.models.matrices import Vector
    from mdm.recording import Recorder
    from mdm.runtime.time.clock import Timer
    from mdm.simulation.batch import Evaluation


_LONGEST = 10_000
"""The number of time steps without an observation that ends an episode."""


class World(Actor):
    """A simulated world for an ensemble. Start it before the ensemble.

    Its payments for decisions are told on the channel ``true_reward`` of the ensemble, which records keep.
    After each decision it samples the next state and, for a POMDP, an observation. It sets the sensors of the
    ensemble's state factors, or raises the events of its observation factors; if there are none that code may set, it
    publishes on the ensemble's channels. For a `MixedPOMDP` it sets the initial belief to what is observed of the first
    state.

    A false negative, or an event without an observation, leads to no decision: the action goes on, each time step with
    its reward, until something is observed. A fixed-rate ensemble decides all the same. After 10,000 time steps without
    an observation the episode ends, with a fault.

    Args:
        ensemble: The ensemble that acts.
        model: The model of the world; by default the ensemble's.
        seed: The seed of the samples.
        period: Seconds from an action to its outcome; 0 for the same turn. A fixed-rate ensemble sees outcomes at its
            ticks, whatever the period.
        durations: How long actions take, and how much they earn by time, in place of a period. A step of unknown length
            is a second. An action that another one replaces before it is over has no outcome, and the
            other one begins in the same state.
        steps: Decisions per episode; by default the ensemble's horizon. An episode also ends with the policy's plan.
        finished: Called with each episode's discounted return. Without it a period of 0 has an end in virtual time:
            after 100,000 messages at one instant the runtime ends.

    Raises:
        ConfigError: If there is no model, it does not fit the ensemble, or durations are given beside a period or for
            an ensemble with a fixed rate.
        ModelError: If the durations are for other numbers of states or actions.

    Example::

        returns = []


        async def main():
            tiger = mdm.Ensemble(
                "tiger",
                policy="tiger.vf",
                model="tiger.pomdp",
                actions=dict.fromkeys(["listen", "open-left", "open-right"], lambda: None),
            )
            async with mdm.Runtime(log=None) as runtime:
                await runtime.start(mdm.World(tiger, seed=1, steps=10, finished=returns.append))
                await runtime.start(tiger)
                await runtime.clock.sleep(60)


        mdm.run(main, virtual=True)
        len(returns)  # 6
    """

    def __init__(
        self,
        ensemble: Ensemble,
        model: MDP | None = None,
        *,
        seed: int | None = None,
        period: float | None = None,
        durations: Durations | None = None,
        steps: int | None = None,
        finished: Callable[[float], object] | None = None,
        name: str = "world",
    ) -> None:
        super().__init__(name)
        given = ensemble.controller.model if model is None else model
        if given is None:
            raise ConfigError(f"a world for ensemble {ensemble.name!r} needs a model, but the ensemble has none")
        if ensemble.controller.takes != "state" and given.pomdp is None:
            raise ConfigError(f"ensemble {ensemble.name!r} needs observations, but the model of its world has none")
        if len(given.action_space) != ensemble.controller.policy.num_actions:
            raise ConfigError(
                f"ensemble {ensemble.name!r} has {ensemble.controller.policy.num_actions} actions, but its world "
                f"{len(given.action_space)}: a world needs the joint actions of the whole team"
            )
        self.ensemble = ensemble
        self.model: MDP = given
        self.state = 0
        self.steps = ensemble.controller.horizon if steps is None else steps
        # A plan without values has no use for a belief.
        self._belief_at_start: Callable[[int], Vector] | None = None
        if given.observed and given.pomdp is not None and ensemble.controller.symbols.num_states is not None:
            self._belief_at_start = given.pomdp.belief_at_start
        self._waits = not isinstance(ensemble.status().drive, FixedRate)
        # Who decides at a fixed rate is told of each step, of one that nobody detected, too.
        unseen = self._waits and ensemble.controller.takes != "state"
        self._false_negative = given.false_negative if unseen else None
        self._period = 0.0 if not self._waits else 1.0 if period is None else period
        if durations is not None and (period is not None or not self._waits):
            raise ConfigError("durations are for ensembles that decide on events, and take the place of a period")
        self._lengths = None if durations is None else Lengths(given, durations, seed)
        self._second = seconds_in(given.discount_of) or 1.0
        """Seconds of the unit that the discount is of."""
        scale = 1.0 if durations is None or durations.of == "second" else self._second
        self._rates: list[list[float]] | None = None
        if durations is not None and durations.rates.any():
            self._rates = np.broadcast_to(durations.rates / scale, given.rewards.shape).tolist()
        self._since: tuple[float, int, int] | None = None
        """When the action that goes on began in the present episode, in which state, and which it is."""
        self._sampler = Sampler(given, seed)
        self._finished = finished
        self._rewards: list[list[float]] = given.rewards.tolist()
        self._return = 0.0
        self._weight = 1.0
        self._step = self._epoch = 0
        self._began = 0
        self._unfinished: Timer | None = None
        self.moves = 0
        """Time steps in the present episode."""

    def on_start(self) -> None:
        """Subscribe to actions, and begin an episode."""
        path, channel = self.ensemble.path, self.runtime.channel
        self._states = channel(f"{path}/state", State, retain=True)
        self._observations = channel(f"{path}/observation", Observation)
        self._initial_beliefs = channel(f"{path}/initial_belief", Belief, retain=True)
        self._true_states = channel(f"{path}/{TRUE_STATE}", State, retain=True)
        self._true_rewards = channel(f"{path}/{TRUE_REWARD}", Reward)
        begin = self._on_action if self._lengths is None else self._on_lasting_action
        self.subscribe(channel(f"{path}/action", Action), begin)
        self._begin_episode()
        if self.ensemble.controller.takes == "state":
            self._show_state(changed=True)

    def _begin_episode(self) -> None:
        self._be_in(self._sampler.first_state())
        self._return = 0.0
        self._weight = 1.0
        self._step = 0
        self._began = self.runtime.now()
        self.moves = 0
        if self._belief_at_start is not None:
            self._initial_beliefs.publish(Belief(self.runtime.now(), self._belief_at_start(self.state)))

    def _on_action(self, action: Action) -> None:
        if self._finished is not None:  # with a period of 0 all episodes are one turn, until who counts them ends it
            self.runtime.dispatcher.count_afresh()
        self._reward(self._weight, self._rewards[self.state][action.index], action.epoch)
        self._weight *= self.model.discount
        self._step += 1
        self.moves += 1
        if self._step == self.steps or self.ensemble.controller.over:
            self._end_episode()
            # The next stimulus begins a new episode; its observation does not count.
            self._later(lambda: self._show(observation=0, changed=True))
            return
        before = self.state
        observation, steps = self._move(action)
        if observation is not None:
            self._later(lambda: self._show(observation, changed=self.state != before), steps)
        elif self._waits:
            self._tell_no_observation(action.index)
            self._end_episode()
            self._later(self.ensemble.reset)

    def _on_lasting_action(self, action: Action) -> None:
        if self._unfinished is not None:
            self._unfinished.cancel()
            self._earn(self._seconds)
        self._epoch = action.epoch
        self._pay(action.index)
        self._step += 1
        last = self._step == self.steps or self.ensemble.controller.over
        self._go_on(action.index, self._show_beginning if last else lambda: self._finish(action.index), last=last)

    def _go_on(self, action: int, then: Callable[[], object], *, last: bool = False) -> None:
        assert self._lengths is not None
        length = self._lengths.draw(self.state, action)
        self._since = self._seconds, self.state, action
        if last:  # nothing can replace it: what it earns is known
            self._earn(self._seconds + length)
            self._end_episode()
        self._unfinished = self.call_later(length, then)

    @property
    def _seconds(self) -> float:
        """Those since the episode began."""
        return (self.runtime.now() - self._began) / 1e9

    def _discount(self, seconds: float) -> float:
        return float(self.model.discount ** (seconds / self._second))

    def _pay(self, action: int) -> None:
        self._reward(self._discount(self._seconds), self._rewards[self.state][action], self._epoch)
        self.moves += 1

    def _earn(self, until: float) -> None:
        """Earn the pay by time, for the action that has gone on until some second of the episode."""
        if self._rates is None or self._since is None:
            return
        (began, state, action), self._since = self._since, None
        interest = -math.log(self.model.discount) / self._second
        weight = until - began
        if interest:
            weight = (self._discount(began) - self._discount(until)) / interest
        seconds, rate = until - began, self._rates[state][action]
        if seconds > 0:
            self._reward(weight / seconds, rate * seconds, self._epoch)

    def _show_beginning(self) -> None:
        self._began = self.runtime.now()
        self._show(observation=0, changed=True)

    def _finish(self, action: int) -> None:
        """Move on when an action is over; where nothing is observed of that, it goes on."""
        self._earn(self._seconds)
        before = self.state
        self._be_in(self._sampler.next_state(before, action))
        observation: int | None = 0
        if self.model.pomdp is not None:
            observation = self._sampler.observation(action, before, self.state)
        if observation is not None and observation != self._false_negative:
            self._show(observation, changed=self.state != before)
        elif self.moves < self._step + _LONGEST:
            self._pay(action)
            self._go_on(action, lambda: self._finish(action))
        else:
            self._tell_no_observation(action)
            self._end_episode()
            self.ensemble.reset()

    def _end_episode(self) -> None:
        if self._finished is not None:
            self._finished(self._return)
        self._begin_episode()

    def _be_in(self, state: int) -> None:
        """Take a state, and tell it where somebody wants to know, such as a record: no robot does."""
        self.state = state
        if self._true_states.heard or not self._true_states.published:
            self._true_states.derive(State(self.runtime.now(), state, self.model.state_space.unravel(state)))

    def _reward(self, weight: float, reward: float, epoch: int) -> None:
        """Pay for a decision, and tell it where somebody wants to know."""
        self._return += weight * reward
        if self._true_rewards.heard:
            self._true_rewards.publish(Reward(self.runtime.now(), epoch, reward))

    def _move(self, decided: Action) -> tuple[int | None, int]:
        """Advance until something is observed; return the observation or None, and the number of time steps."""
        action = decided.index
        for steps in range(1, _LONGEST):
            before = self.state
            self._be_in(self._sampler.next_state(before, action))
            if self.model.pomdp is None:
                return 0, steps
            observation = self._sampler.observation(action, before, self.state)
            if observation == self._false_negative:
                observation = None
            if observation is not None or not self._waits:
                return observation, steps
            self._reward(self._weight, self._rewards[self.state][action], decided.epoch)
            self.moves += 1
            self._weight *= self.model.discount
        return None, _LONGEST

    def _tell_no_observation(self, action: int) -> None:
        names = self.model.state_space.names[self.state], self.model.action_space.names[action]
        text = (
            f"no observation in {_LONGEST} time steps, in state {names[0]!r} during action {names[1]!r}: the episode "
            f"ends"
        )
        self.runtime.faults.publish(Fault(self.runtime.now(), self.path, "no_observation", text))

    def _later(self, show: Callable[[], object], steps: int = 1) -> None:
        if self._period > 0:
            self.call_later(steps * self._period, show)
        else:
            show()

    def _show(self, observation: int, *, changed: bool) -> None:
        if self.ensemble.controller.takes == "state":
            self._show_state(changed=changed)
        else:
            self._show_observation(observation)

    def _show_state(self, *, changed: bool) -> None:
        layer = self.ensemble.state
        values = self.model.state_space.unravel(self.state)
        if (
            changed
            and layer is not None
            and all(layer.predicates.declared.senses(name) for factor in layer.factors for name in factor.predicates)
        ):
            with layer.predicates.batch():
                for factor, value in zip(layer.factors, values, strict=True):
                    for name, holds in factor.truth(value).items():
                        layer.predicates.sense(name, holds)
        else:
            self._states.publish(State(self.runtime.now(), self.state, values))

    def _show_observation(self, index: int) -> None:
        layer = self.ensemble.observation
        assert self.model.observation_space is not None
        values = self.model.observation_space.unravel(index)
        if layer is not None and len(layer.factors) == len(values):
            events = [factor.events[value] for factor, value in zip(layer.factors, values, strict=True)]
            raised = [event for event in events if event is not None and layer.predicates.declared.raises(event)]
            if len(raised) == len(events):
                layer.predicates.occur(*raised)
                return
        mask = (True,) * len(values)
        self._observations.publish(Observation(self.runtime.now(), index, values, mask))


# -- Simulations -------------------------------------------------------------------------------------------------------

REST = 1e-4


def steps_for(discount: float) -> int:
    """Return the number of decisions after which the discounted weight of the rest is below 1e-4.

    Raises:
        ConfigError: If the discount is 1.
    """
    if discount >= 1:
        raise ConfigError("with a discount of 1 an episode needs an end: give a horizon or decisions (--steps)")
    return max(1, math.ceil(math.log(REST) / math.log(discount)))


def simulate(
    model: GivenModel,
    policy: GivenPolicy,
    *,
    episodes: int,
    steps: int | None = None,
    progress: Callable[[int, int], object] | None = None,
    record: str | Path | Recorder | None = None,
    executor: Executor | None = None,
    **options: Unpack[ControlOptions],
) -> Evaluation:
    """Run episodes of a policy in its model through the real decision loop, and return their value.

    It runs an ensemble and a `World` in an event loop of its own: call it from outside asyncio. Each episode has random
    numbers of its own, whatever those before it took.

    Args:
        model: The model of the world and of belief tracking, or the path of its file.
        policy: The policy; see `Controller`.
        episodes: The number of episodes.
        steps: Decisions per episode, at most those of the policy's plan. By default as many as the plan has, or until
            the discounted weight of the rest is below 1e-4.
        progress: Called after each episode, with an executor ten times a second, with how many have ended, and of how
            many; where it returns True, the result is of these.
        record: A file, such as ``simulated.mcap``, to which all is recorded, with the world's true states and a second
            of virtual time from decision to decision; or a `mdm.recording.Recorder` of one.
        executor: Any executor of ``concurrent.futures``, to run parts of the episodes on its workers; without a record.
        options: Options of the control layer, see `ControlOptions`. The ``seed`` is also the world's: the same seed
            gives the same result; by default it is random.

    Raises:
        ConfigError: If sizes do not fit, episodes have no end, or the executor's workers cannot be sent the work, see
            `mdm.simulation.parts.run_parts`.
        Error: If a part failed twice, and none had ended before.
        ModelError: If the model's discount is of a second: each action takes a step here.

    Example::

        result = mdm.simulate("tiger.pomdp", "tiger.vf", episodes=20, seed=1)
        result.episodes  # 20
        result.interval  # the 95 % confidence interval of the value
    """
    if not (is_whole(episodes) and episodes >= 1):
        raise ConfigError(f"a simulation needs at least 1 episode, not {episodes}")
    given = options.get("seed")
    check_seed(given)
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if given is None else given
    model = model_of(model)
    check_steps(model)
    if executor is not None and record is not None:
        raise ConfigError("a record is of one process: simulate without an executor", key="record")
    policy = policy_of(policy, model)
    if getattr(policy, "_seed", seed) is None:
        options["seed"] = seed
    work = _Loop(model, policy, episodes, seed, record, {"steps": steps, **options})
    work.prepare()
    return joined_evaluation(work, work.ensemble.controller.horizon or 0, progress, executor)


class _Loop:
    """The episodes of a simulation, which run in parts by the real decision loop."""

    ensemble: Any = None

    def __init__(self, model: MDP, policy: Any, episodes: int, seed: int, record: Any, given: dict[str, Any]) -> None:
        self.model, self.policy, self.seed, self.units = model, policy, seed, episodes
        self._record, self._given = record, given

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the ensemble, which each process makes for itself."""
        return {**self.__dict__, "ensemble": None}

    def size(self, first: int, last: int) -> int:
        return last - first

    def prepare(self) -> None:
        if self.ensemble is None:
            self.ensemble = simulated(self.model, self.policy, **self._given)

    def run(self, first: int, last: int, tell: Callable[[int], bool] = lambda _: False) -> tuple[Vector, int]:
        returns, moves, ended, ensemble = np.zeros(last - first), 0, 0, self.ensemble

        async def main() -> None:
            async with Runtime(log=None, record=self._record) as runtime:

                def finished(value: float) -> None:
                    nonlocal moves, ended
                    if ended < len(returns):
                        returns[ended] = value
                        ended += 1
                        moves += world.moves
                        if tell(ended) or ended == len(returns):
                            runtime.shut_down()
                            ensemble.stop()

                period = 0.0 if self._record is None else 1.0
                world = _Episodic(ensemble, period=period, finished=finished)
                world.seed, world.episode = self.seed, first
                await runtime.start(world)
                await runtime.start(ensemble)
                await runtime.wait()

        if isinstance(draws := ensemble.controller.information, DrawnInformation):
            draws.divide(first)
        run(main, virtual=True)
        return returns[:ended], moves


class _Episodic(World):
    """A world whose episodes have random numbers of their own, by the number of the next one."""

    seed = episode = 0

    def _begin_episode(self) -> None:
        self._sampler.seed(np.random.SeedSequence(self.seed, spawn_key=(self.episode,)))
        self.episode += 1
        super()._begin_episode()


def simulated(
    model: GivenModel, policy: GivenPolicy, *, steps: int | None = None, **options: Unpack[ControlOptions]
) -> Ensemble:
    """Return the ensemble that a simulation runs, as a replay of its record needs it: see `simulate`."""
    world_model = model_of(model)
    decides = policy_of(policy, world_model)
    if not hasattr(decides, "seed"):
        options.pop("seed", None)  # it is the world's alone
    planned: int | None = getattr(decides, "horizon", None)
    if planned is not None:
        options["horizon"] = planned if steps is None else min(steps, planned)
    else:
        options["horizon"] = steps_for(world_model.discount) if steps is None else steps
    actions = dict.fromkeys(range(len(world_model.action_space.factors[0])), _nothing)
    ensemble = Ensemble("ensemble", policy=decides, model=world_model, actions=actions, **options)
    if isinstance(draws := ensemble.controller.information, DrawnInformation):
        draws.divide(0)
    return ensemble


def _nothing() -> None:
    """Do nothing: the world takes actions from messages."""
