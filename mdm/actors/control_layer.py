"""The control layer: holds the policy, tracks the belief, decides.

Event-driven and fixed-rate control share one path from a stimulus to a decision; only the trigger differs.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.actors.controller_run import ControllerRun
from mdm.actors.drive import Drive, FixedRate, OnEvent
from mdm.actors.layer import Layer
from mdm.actors.scope import Scope
from mdm.beliefs import BeliefTracker, Support, Tracker
from mdm.errors import ConfigError, Error, ModelError
from mdm.messages import Action, Belief, Control, Decision, Fault, Observation, Reward, State, Tick
from mdm.models import POMDP
from mdm.policies import FiniteStateController, JointController, StagedPolicy
from mdm.runtime import ActorStatistics, Histogram, Latencies

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mdm.models import MDP
    from mdm.models.space import Symbol
    from mdm.policies import Controller, Policy
    from mdm.runtime import Ticker

__all__ = ["ControlLayer", "ControlStatistics", "OnImpossible"]

OnImpossible = Literal["predict", "keep", "reset", "safe_action"]


class ControlStatistics(ActorStatistics, frozen=True):
    """What a control layer has decided: actions published, observations that were impossible or superseded.

    ``undecided`` counts ticks without a known state; ``latency`` is from stimulus to decision.
    """

    decisions: int
    impossible: int
    superseded: int
    undecided: int
    latency: Histogram


class ControlLayer(Layer):
    """Decides on states (MDP), on the belief that observations lead to (POMDP), or by the nodes of a controller.

    Reads ``state``, ``observation``, ``external_belief``, ``initial_belief`` and ``control``; publishes ``action``,
    ``reward`` and ``belief`` under its ensemble's name, and a `Decision` on the runtime's ``decisions``.

    A controller begins at its start, or at the node that is best for the initial belief where its nodes' values are
    known, and moves by each observation; no belief is tracked. It stays at its node where nothing is observed, and at
    an observation that has no edge, which is an impossible one. The last node of a plan ends the episode as a horizon
    does. A `JointController` takes joint observations to joint actions or, under the scope of an ``agent``, that
    agent's own.

    Args:
        policy: From a state index or a belief to a joint action; or a controller.
        model: Needed by a policy over beliefs, and for rewards.
        drive: When to decide.
        horizon: Decisions in an episode; the next stimulus after them starts a new one. By default, and at most, those
            of a `StagedPolicy`, which is asked at each decision for that of its epoch.
        on_impossible: What becomes of the belief at an observation that has probability 0: ``predict`` (time passes,
            nothing seen), ``keep`` it, ``reset`` it, or ``safe_action`` (predict, and run the safe action).
        on_no_observation: What a fixed-rate tick without a new observation means: ``predict``, ``repeat`` the last
            one, or the name of an observation.
        rewards: R(s, a), an S x A array, where no model has it.
        deadline: Seconds from stimulus to decision; a later decision is reported and the safe action runs instead.
        initial_belief: In place of the model's.
        tracker: A belief tracker of your own, in place of the model's.
        false_negative: The observation, by name or index, that is a false negative, as by
            ``model.with_false_negatives(...)``.
        agent: Whose own controller of a `JointController` it runs, by index or name, on that agent's observations
            alone; by default the whole team's, on joint ones.
    """

    def __init__(
        self,
        policy: Policy | Controller,
        model: MDP | POMDP | None = None,
        *,
        drive: Drive | None = None,
        horizon: int | None = None,
        on_impossible: OnImpossible = "predict",
        on_no_observation: str = "predict",
        rewards: npt.ArrayLike | None = None,
        deadline: float | None = None,
        initial_belief: npt.ArrayLike | None = None,
        tracker: Tracker | None = None,
        false_negative: Symbol | None = None,
        agent: int | str | None = None,
        name: str = "control",
    ) -> None:
        super().__init__(name)
        if false_negative is not None:
            model = _with_false_negatives(model, false_negative, policy, tracker)
        policy, self.action_space, self.observation_space = Scope.of(policy, model, agent)
        self.policy = policy
        self.model = model
        self.drive = OnEvent() if drive is None else drive
        self.horizon = horizon
        self.on_impossible = on_impossible
        self.on_no_observation = on_no_observation
        self.deadline = deadline
        self.has_safe_action = False
        self.running = False
        self.epoch = 0
        self.impossible = 0
        self.superseded = 0
        self.undecided = 0
        self.action_names: Sequence[str] = () if self.action_space is None else self.action_space.names
        self._controller: ControllerRun | None = None
        self._tracker: Tracker | ControllerRun | None = tracker
        self._choose: Callable[[Any], int]
        if isinstance(policy, FiniteStateController | JointController):
            if rewards is not None or tracker is not None:
                raise ConfigError(
                    "a controller knows of no state or belief: give neither rewards nor a tracker", key="policy"
                )
            self._tracker = self._controller = run = ControllerRun(policy, model)
            self._choose = lambda _: run.action
            self._rewards = None
        else:
            if tracker is None and policy.input == "belief" and isinstance(model, POMDP):
                self._tracker = BeliefTracker(model)
            self._choose = policy.action
            if isinstance(policy, StagedPolicy):
                self.horizon = policy.horizon if horizon is None else horizon
                self._choose = lambda state: policy.action(state, self.epoch)
            self._rewards = _rewards(rewards, model)
        self._num_states = 0 if policy.num_states is None else policy.num_states
        # Where beliefs can be had, and chosen by, without an array of all states.
        self._by_support = (
            self._tracker
            if isinstance(self._tracker, BeliefTracker) and getattr(policy, "takes_support", False)
            else None
        )
        self._initial = None if initial_belief is None else np.asarray(initial_belief, dtype=np.float64)
        self._check()
        self._check_start()
        self._no_observation = self._no_observation_symbol()
        self._deadline_ns = None if deadline is None else round(deadline * 1e9)
        self._horizon = sys.maxsize if self.horizon is None else self.horizon
        self._event_driven = isinstance(self.drive, OnEvent)
        self._latencies = Latencies()
        self._record = self._latencies.record
        self._state: int | None = None
        self._observation: Observation | None = None
        self._last_observation: int | tuple[int | None, ...] | None = None
        self._action: int | None = None
        self._given = False
        self._ticker: Ticker | None = None

    # -- Checks --------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        policy, model = self.policy, self.model
        if self.horizon is not None and self.horizon < 1:
            raise ConfigError(f"a horizon is at least 1 decision, not {self.horizon}", key="horizon")
        if isinstance(policy, StagedPolicy) and self.horizon is not None and self.horizon > policy.horizon:
            raise ConfigError(
                f"the policy is for episodes of at most {policy.horizon} decisions, not of {self.horizon}",
                key="horizon",
            )
        if self.deadline is not None and not self.deadline > 0:
            raise ConfigError(f"a deadline is a number of seconds above 0, not {self.deadline}", key="deadline")
        if self.on_impossible not in {"predict", "keep", "reset", "safe_action"}:
            raise ConfigError(
                f"on_impossible is 'predict', 'keep', 'reset' or 'safe_action', not {self.on_impossible!r}",
                key="on_impossible",
            )
        if policy.input == "belief" and self._tracker is None:
            why = "there is none" if model is None else "the one given has no observations"
            raise ConfigError(
                f"a policy over beliefs needs the POMDP by which to track the belief, but {why}", key="model"
            )
        if model is not None and self._controller is None:  # a controller was compared with its model before
            for what, ours, theirs in (
                ("states", policy.num_states, len(model.state_space)),
                ("actions", policy.num_actions, len(model.action_space)),
            ):
                if ours != theirs:
                    raise ConfigError(f"the policy is for {ours} {what}, but the model has {theirs}", key="policy")
        if self._rewards is not None and self._rewards.shape != (policy.num_actions, policy.num_states):
            actions, states = self._rewards.shape
            raise ConfigError(
                f"the rewards are for {states} states and {actions} actions, but the policy is for "
                f"{policy.num_states} and {policy.num_actions}",
                key="rewards",
            )

    def _check_start(self) -> None:
        if self._tracker is not None and (self._initial is not None or self._controller is not None):
            try:
                self._tracker.reset(self._initial)
            except ModelError as error:
                raise ConfigError(str(error), key="initial_belief") from None

    def _no_observation_symbol(self) -> int | Literal["predict", "repeat"]:
        if self.on_no_observation == "predict":
            return "predict"
        if self.on_no_observation == "repeat":
            return "repeat"
        space = self.observation_space
        if space is None:
            raise ConfigError(
                f"on_no_observation names {self.on_no_observation!r}, but there is no model with observations",
                key="on_no_observation",
            )
        try:
            return int(space.index(self.on_no_observation))
        except ModelError as error:
            raise ConfigError(
                f"on_no_observation is 'predict', 'repeat' or an observation's name: {error}", key="on_no_observation"
            ) from None

    def problems(self) -> Iterator[ConfigError]:
        """Yield nothing: a control layer that could be built can start."""
        yield from ()

    # -- Commands ------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin deciding at epoch 0; a policy over beliefs begins from the initial belief."""
        self._command("start")

    def stop(self) -> None:
        """Publish nothing more until started again."""
        self._command("stop")

    def reset(self) -> None:
        """Begin a new episode now: epoch 0, the initial belief."""
        self._command("reset")

    def resume(self) -> None:
        """Begin deciding at epoch 0, from the belief as it is."""
        self._command("resume")

    def _command(self, command: Literal["start", "stop", "reset", "resume"]) -> None:
        self.owner.channel("control", Control).publish(Control(self.runtime.clock.now(), command))

    @property
    def belief(self) -> npt.NDArray[np.float64] | None:
        """The present belief (S numbers, read-only), or None for a policy over states or a controller."""
        return None if self._tracker is None else self._tracker.belief

    @property
    def nodes(self) -> tuple[int, ...] | None:
        """The present node of each controller that it runs, or None for a policy of another kind."""
        return None if self._controller is None else self._controller.nodes

    @property
    def over(self) -> bool:
        """Whether the episode has had its last decision: by the horizon, or by the end of a controller's plan."""
        if self._controller is None or self._given:  # a belief from outside has put it at a node not yet decided on
            return self.epoch >= self._horizon
        return self.epoch >= self._horizon or (self.epoch > 0 and self._controller.ended)

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen; deciding begins with `start`."""
        channel = self.owner.channel
        self._now = self.runtime.clock.reader()
        self._actions = channel("action", Action)
        self._reward_channel = channel("reward", Reward, retain=True)
        self._beliefs = channel("belief", Belief, retain=True)
        self._decisions = self.runtime.decisions
        self._safety = channel("safety", Fault)
        self._path = self.owner.path
        self.running = False
        self._state = None
        if self.policy.input == "state":
            self.subscribe(channel("state", State, retain=True), self._on_state)
        else:
            self.subscribe(channel("observation", Observation), self._on_observation)
            self.subscribe(channel("external_belief", Belief), self._on_external_belief)
            self.subscribe(channel("initial_belief", Belief, retain=True), self._on_initial_belief)
        self.subscribe(channel("control", Control), self._on_control)

    def on_stop(self) -> None:
        """Decide nothing more."""
        self.running = False

    def _on_control(self, control: Control) -> None:
        command = control.command
        if command == "stop":
            self.running = False
            self._stop_ticking()
            return
        if command == "reset":
            self._begin_episode()
            if not self.running:
                return
        elif self.running:
            return
        else:
            ended = self._controller is not None and self._controller.ended
            self._begin_episode(keep_belief=command == "resume" and not ended)
            self.running = True
            if isinstance(self.drive, FixedRate):
                self._ticker = self.every(self.drive.rate, self._on_tick)
        if self._event_driven and (self._tracker is not None or self._state is not None):
            self._decide(control.time, command)

    def _begin_episode(self, *, keep_belief: bool = False) -> None:
        """Start an episode."""
        self.epoch = 0
        self._action = None
        self._observation = None
        self._last_observation = None
        self._given = False
        if self._tracker is not None and not keep_belief:
            self._tracker.reset(self._initial)

    def _stop_ticking(self) -> None:
        if self._ticker is not None:
            self._ticker.cancel()
            self._ticker = None

    # -- Stimuli -------------------------------------------------------------------------------------------------

    def _on_state(self, state: State) -> None:
        self._state = state.index
        if self.running and self._event_driven and state.index is not None:
            if self.epoch >= self._horizon:
                self._begin_episode()
                self._decide(state.time, "episode")
            else:
                self._decide(state.time, "state")

    def _on_observation(self, observation: Observation) -> None:
        if not self.running:
            return
        if not self._event_driven:
            if self._observation is not None:
                self.superseded += 1
            self._observation = observation
        elif self.over:
            self._begin_episode()
            self._decide(observation.time, "episode")
        else:
            symbol = observation.values if observation.index is None else observation.index
            self._update(symbol, observation.time)
            self._decide(observation.time, "observation", symbol)

    def _on_tick(self, tick: Tick) -> None:
        time = tick.time
        if self.over:
            self._begin_episode()
            self._decide_at_tick(time, "episode")
            return
        observation, self._observation = self._observation, None
        symbol: int | tuple[int | None, ...] | None = None
        if self._tracker is not None and self._action is not None and not self._given:
            if observation is not None:
                symbol = observation.values if observation.index is None else observation.index
            elif self._no_observation == "repeat":
                symbol = self._last_observation
            elif self._no_observation != "predict":
                symbol = self._no_observation
            self._update(symbol, time)
        self._given = False
        self._decide_at_tick(time, "tick", symbol)

    def _decide_at_tick(self, time: int, cause: str, symbol: int | tuple[int | None, ...] | None = None) -> None:
        if self._tracker is None and self._state is None:
            self.undecided += 1
        else:
            self._decide(time, cause, symbol)

    def _on_external_belief(self, belief: Belief) -> None:
        over = self.over
        if not self.running or not self._accept(belief, "external_belief"):
            return
        if not self._event_driven:
            self._given = True
            self._observation = None
        elif over:
            self._begin_episode(keep_belief=True)
            self._decide(belief.time, "episode")
        else:
            self._decide(belief.time, "belief")

    def _on_initial_belief(self, belief: Belief) -> None:
        present, nodes = self.belief, self.nodes
        if self._accept(belief, "initial_belief") and self._tracker is not None:
            self._initial = np.array(belief.probabilities, dtype=np.float64)
            if present is not None:
                self._tracker.reset(present)
        if self._controller is not None and nodes is not None:
            self._controller.nodes = nodes

    def _accept(self, belief: Belief, channel: str) -> bool:
        """Take a belief from outside; one that is no distribution is reported, and changes nothing."""
        if self._tracker is None:
            return False
        try:
            self._tracker.reset(belief.probabilities)
        except (Error, ValueError, TypeError) as error:
            self.report("belief", f"refused a belief on {self._path}/{channel}: {error}", time=belief.time)
            return False
        return True

    # -- Decisions -----------------------------------------------------------------------------------------------

    def _update(self, observation: int | tuple[int | None, ...] | None, time: int) -> None:
        tracker, action = self._tracker, self._action
        if tracker is None or action is None:
            return
        try:
            probability = tracker.update(action, observation)
        except ModelError as error:
            self.report("observation", str(error), time=time)
            return
        self._last_observation = observation
        if not probability > 0:  # nor is it, where a tracker of the user's says NaN
            self._on_impossible(observation, action, time)

    def _on_impossible(self, observation: int | tuple[int | None, ...] | None, action: int, time: int) -> None:
        self.impossible += 1
        assert self._tracker is not None
        policy = self.on_impossible
        why = "has probability 0 under the model and the belief"
        if self._controller is not None:
            why = f"has no edge at the nodes {self._controller.nodes}"
        text = f"observation {observation} after action {action} {why}; on_impossible is {policy!r}"
        fault = Fault(time, self.path, "impossible_observation", text)
        (self._safety if policy == "safe_action" else self.runtime.faults).publish(fault)
        if policy == "reset":
            self._tracker.reset(self._initial)
        elif policy != "keep":
            self._tracker.update(action, None)

    def _decide(self, time: int, cause: str, observation: int | tuple[int | None, ...] | None = None) -> None:
        """Choose an action and publish it first. Hot path: about 1 µs for a table."""
        tracker = self._tracker
        if tracker is None:
            state = self._state
            assert state is not None
            try:
                action = self._choose(state)
            except ModelError as error:
                self._safety.publish(Fault(time, self.path, "state", str(error)))
                return
            reward = None if self._rewards is None else self._rewards.item(action, state)
            belief = None
        else:
            state = None
            belief = tracker.belief if self._by_support is None else self._by_support.held
            action = self._choose(belief)
            if isinstance(belief, Support):
                reward = None if self._rewards is None else _expected(self._rewards[action], belief)
            else:
                reward = None if self._rewards is None else self._rewards[action].dot(belief).item()
        epoch = self.epoch
        self.epoch = epoch + 1
        self._action = action
        latency = self._now() - time
        if self._deadline_ns is None or latency <= self._deadline_ns or not self._late(latency, time):
            self._actions.emit(Action(time, epoch, action))
        self._record(latency)
        if reward is not None:
            self._reward_channel.emit(Reward(time, epoch, reward))
        if isinstance(belief, Support):
            self._publish_support(time, belief)
        elif belief is not None:
            self._beliefs.emit(Belief(time, belief))
        if self._decisions.heard:
            self._decisions.publish(
                Decision(
                    time, self._path, epoch, cause, state, observation, self.belief, action, self._name(action), reward
                )
            )

    def _publish_support(self, time: int, support: Support) -> None:
        """Publish a belief that is known by its support: an array is made of it only for somebody."""
        belief = self.belief if self._beliefs.heard else None
        if belief is not None:
            self._beliefs.emit(Belief(time, belief))
        else:
            self._beliefs.emit_later(time, lambda: Belief(time, support.dense(self._num_states)))

    def _late(self, latency: int, time: int) -> bool:
        """Report a missed deadline; return whether the safe action runs in place of what was decided."""
        text = f"a decision came {latency / 1e6:.3f} ms after its stimulus; the deadline is {self.deadline} s"
        channel = self._safety if self.has_safe_action else self.runtime.faults
        channel.publish(Fault(time, self.path, "deadline", text))
        return self.has_safe_action

    def _name(self, action: int) -> str:
        return self.action_names[action] if self.action_names else str(action)

    def statistics(self) -> ControlStatistics:
        """Return what the layer has decided so far."""
        return ControlStatistics(
            **msgspec.structs.asdict(super().statistics()),
            decisions=self._actions.published if self.life != "created" else 0,
            impossible=self.impossible,
            superseded=self.superseded,
            undecided=self.undecided,
            latency=self.latency,
        )

    @property
    def latency(self) -> Histogram:
        """The histogram of times from stimulus to decision."""
        return self._latencies.snapshot()


def _expected(rewards: npt.NDArray[np.float64], belief: Support) -> float:
    """Return the expectation of the rewards of all states."""
    reward: float = rewards.take(belief.states).dot(belief.probabilities).item()
    return reward


def _with_false_negatives(
    model: MDP | POMDP | None, symbol: Symbol, policy: Policy | Controller, tracker: Tracker | None
) -> MDP | POMDP:
    if model is None or tracker is not None or policy.input == "state":
        raise ConfigError(
            "a false negative is for policies that go by what is observed, with a model and its own tracker",
            key="false_negative",
        )
    try:
        return model.with_false_negatives(symbol)
    except ModelError as error:
        raise ConfigError(str(error), key="false_negative") from None


def _rewards(rewards: npt.ArrayLike | None, model: MDP | POMDP | None) -> npt.NDArray[np.float64] | None:
    """Return R as an A x S array, so that the rewards of one action lie side by side."""
    if rewards is None:
        if model is None:
            return None
        rewards = model.rewards
    array = np.asarray(rewards, dtype=np.float64)
    if array.ndim != 2 or not np.isfinite(array).all():
        raise ConfigError(f"rewards are a states x actions array of finite numbers, not {array.shape}", key="rewards")
    return np.ascontiguousarray(array.T)
