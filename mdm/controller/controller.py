"""The controller holds the information state of a policy, updates it by actions and observations, and decides.

The information state is a state, a belief, or the nodes of a plan. The same calls give the same steps. Control layers,
simulations and traces all use it.
"""

from __future__ import annotations

import copy
import math
import sys
from typing import TYPE_CHECKING, Any, Literal, Unpack

import msgspec
import numpy as np

from mdm.beliefs import KnownState
from mdm.beliefs.choice import check_memory
from mdm.beliefs.information import restore, snapshot
from mdm.beliefs.tracker import agreeing
from mdm.compilation import sparing
from mdm.controller.held import Held, check_counts, check_information, checked_belief, copied, opened
from mdm.controller.step import KEPT, Past, Step
from mdm.errors import ConfigError, ModelError, PolicyError
from mdm.loading import model_of, policy_of, spared
from mdm.models.availability import refuse
from mdm.models.digest import digest, of_parts, parts, plain, short
from mdm.models.factored.flattening import RewardRow, RewardRows
from mdm.options import ControllerOptions, ControllerSettings
from mdm.policies import mismatch
from mdm.symbols import Symbols

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from mdm.beliefs import Information
    from mdm.explanation import Case
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.models.space import Symbol
    from mdm.options import OnImpossible
    from mdm.policies import Policy

    _MadeOf = tuple[Policy, MDP | None, Symbols, OnImpossible, bool]


def informed(policy: Policy, model: MDP | None, tracker: Information | None) -> Information:
    """Return the information state that a policy decides by: its own, or a tracker of the user's."""
    if tracker is None:
        return policy.information(model)
    if getattr(policy, "input", "belief") != "belief":
        raise ConfigError("a tracker needs a policy over beliefs", key="tracker")
    if isinstance(tracker, type):
        raise ConfigError(f"a tracker is an object, not the class {tracker.__name__}: make one of it", key="tracker")
    missing = [name for name in ("current", "reset", "update") if not hasattr(tracker, name)]
    if missing:
        raise ConfigError(
            f"the tracker {type(tracker).__name__} has no {' and no '.join(missing)}; see mdm.beliefs.Information",
            key="tracker",
        )
    return tracker


def horizon_of(information: Information, given: int | None) -> int | None:
    """Return the decisions per episode: as many as given, or as the policy has stages."""
    stages: int | None = getattr(information, "horizon", None)
    if given is None:
        return stages
    if stages is not None and given > stages:
        raise ConfigError(f"the policy is for episodes of at most {stages} decisions, not of {given}", key="horizon")
    return given


def expectation(information: Information, *, own: bool) -> Callable[[Vector | RewardRow], float] | None:
    """Return the expectation of functions of the state; None if the information state has no states."""
    known: Callable[[Vector | RewardRow], float] | None = getattr(information, "expected", None)
    if known is None and own:
        return lambda values: float(values.dot(information.current))
    return known


def reward_rows(
    given: npt.ArrayLike | None, model: MDP | None, symbols: Symbols
) -> Sequence[Vector] | RewardRows | None:
    """Return R as a row of S numbers for each action; of a model that stays factored none of them is made."""
    if given is None and model is None:
        return None
    if given is None and model is not None and model.network is not None and model.stays_factored:
        return RewardRows(model.network)
    rewards = model.rewards if given is None and model is not None else given
    try:
        array = np.asarray(rewards, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"rewards are a states x actions array of numbers: {error}", key="rewards") from None
    if array.ndim != 2:
        raise ConfigError(f"rewards are a states x actions array, not of shape {array.shape}", key="rewards")
    if not np.isfinite(array).all():
        state, action = (int(place[0]) for place in np.nonzero(~np.isfinite(array)))
        raise ConfigError(f"the reward of action {action} in state {state} is {array[state, action]}", key="rewards")
    states, actions = array.shape
    if (states, actions) != (symbols.num_states or states, symbols.policy.num_actions):
        raise ConfigError(
            f"the rewards are for {states} states and {actions} actions, but the policy is for "
            f"{symbols.num_states} and {symbols.policy.num_actions}",
            key="rewards",
        )
    return list(np.ascontiguousarray(array.T))


def with_false_negatives(model: MDP | None, symbol: Symbol) -> MDP:
    """Return a model in which a symbol of observation is a false negative."""
    if model is None or model.pomdp is None:
        raise ConfigError(
            "false negatives need a POMDP to track the belief, but there is none",
            key="false_negative",
        )
    try:
        return model.with_false_negatives(symbol)
    except ModelError as error:
        raise ConfigError(str(error), key="false_negative") from None


def within(memory: float | None, model: MDP | None, policy: Policy, *, tracked: bool) -> MDP | None:
    """Return a model that takes no more memory than it may; refuse one that would, before anything of it is made.

    Args:
        memory: The most megabytes; None for the machine's free memory.
        model: The model, if there is one.
        policy: The policy.
        tracked: Whether the controller tracks the belief, if the policy is over beliefs.
    """
    kind = getattr(policy, "input", "belief")
    if model is None or kind == "observation":  # a plan, which needs nothing of the model but names
        return model
    held = model if memory is None else spared(model)
    search = "a search" if getattr(policy, "deliberates", False) else None
    check_memory(held, memory, beliefs=tracked and kind == "belief", matrices=search)
    return held


def seeded(policy: Policy, seed: int) -> Policy:
    """Return a policy that draws by a seed; the one that was given stays as it is."""
    if not hasattr(policy, "seed"):
        raise ConfigError("a seed is for policies that draw their actions, which this one does not", key="seed")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigError(f"a seed is a whole number from 0 on, not {seed!r}", key="seed")
    own = copy.copy(policy)
    own.seed(int(seed))
    return own


_KEPT_UPDATES = 1_000
"""Updates that are kept at most: a belief may go on for hours while nothing is decided."""
_KEPT_NUMBERS = 1_000_000
"""Numbers of beliefs that are kept at most, to the same end."""
_SUPPORT = 1e-10
"""Smaller probabilities are rounding errors: their states are not thought possible."""


class Controller:
    """One decision process: a policy, its information state, and the count of its decisions.

    Args:
        policy: A policy; the path of its file; a list of actions, one per state; an array of Q-values.
        model: An MDP or POMDP, or the path of its file. Policies over beliefs need it; others take names and
            rewards from it.
        agent: The agent, by index or name, whose part of a joint plan is run on its own observations; by default the
            whole team, on joint observations.
        options: See `ControllerOptions`.

    Raises:
        ConfigError: If sizes or names do not fit each other, or an option does not apply to the policy.

    Attributes:
        policy: The policy.
        model: The model, or None.
        information: The information state.
        takes: The kind of input: ``state`` or ``observation``.
        symbols: The states, observations and actions, by index and name.
        horizon: Decisions per episode, or None.
        epoch: Decisions made in this episode.
        impossible: The number of impossible observations.
        problem: Why the last observation was impossible, in words; else None.
        last_action: The last decision of this episode, or None.
        decided_by: The information state of the last decision; None before it, and for a table.
        wanted: Returns the action that a shielded policy's original wants on an information state, None where that is
            taken; None for other policies.
        can_end: Whether the policy has a plan, which may end before the horizon.
        given: Whether the next decision is on a belief from outside, not on the observation.

    Example::

        controller = mdm.Controller("tiger.vf", "tiger.pomdp")
        controller.start().action_name  # 'listen'
        step = controller.observe("hear-left")
        step.action_name, step.probability, controller.belief  # 'listen', 0.5, [0.85, 0.15]
    """

    # What a look-up reads or writes, close together: among many controllers what is far apart is not in the cache.
    __slots__ = (
        "__dict__",
        "__weakref__",
        "_last_epoch",
        "_past",
        "_rewards",
        "_table",
        "_unchecked",
        "epoch",
        "information",
        "last_action",
    )

    def __init__(
        self,
        policy: GivenPolicy,
        model: GivenModel | None = None,
        *,
        agent: int | str | None = None,
        **options: Unpack[ControllerOptions],
    ) -> None:
        settings = ControllerSettings.from_keywords(options)
        self.model: MDP | None = None if model is None else model_of(model)
        false_negative = settings.false_negative
        if false_negative is not None:
            self.model = with_false_negatives(self.model, false_negative)
        with sparing(wanted=settings.memory is not None):
            whole = policy_of(policy, self.model)
        wrong = None if self.model is None else mismatch(whole, self.model)
        if wrong is not None:
            raise ConfigError(wrong, key="policy")
        self.symbols = Symbols(whole, self.model, agent)
        self.policy: Policy = self.symbols.policy
        self.seed = settings.seed
        if self.seed is not None:
            self.policy = seeded(self.policy, self.seed)
        # What a plan knows at its start it takes from the team's model; an agent's own part knows nothing of it.
        tracker = settings.tracker
        self.model = within(settings.memory, self.model, self.policy, tracked=tracker is None)
        self.information = informed(self.policy, None if agent is not None else self.model, tracker)
        self._tracks = getattr(self.policy, "input", "belief") == "belief" and tracker is None
        if false_negative is not None and not self._tracks:
            raise ConfigError(
                "false negatives need a policy over beliefs, and the model's own belief tracker",
                key="false_negative",
            )
        self.takes: Literal["state", "observation"] = getattr(self.information, "takes", "observation")
        self.symbols.takes = self.takes
        self.horizon = horizon_of(self.information, settings.horizon)
        self.on_impossible = settings.on_impossible
        self._own_tracker = tracker is not None
        self._expected = expectation(self.information, own=self._own_tracker)
        if self._expected is None and settings.rewards is not None:
            raise ConfigError("a plan has no belief to expect rewards by: give no rewards", key="rewards")
        self._rewards: Sequence[Vector] | RewardRows | None = None
        if self._expected is not None:
            self._rewards = reward_rows(settings.rewards, self.model, self.symbols)
        self._own_rewards = settings.rewards is not None
        self._initial: Vector | None = None
        self.epoch = 0
        self.impossible = 0
        self.problem: str | None = None
        self.last_action: int | None = None
        self.decided_by: Any = None
        self._probability: float | None = None
        self.given = False
        numbers = max(self.symbols.num_states or 1, 1) if self.takes == "observation" else 1
        self._most_kept = 2 * min(KEPT, max(1, _KEPT_NUMBERS // numbers // 2))
        # Looked up once, for every decision.
        self._choose = self.policy.action
        self._num_actions = self.policy.num_actions
        limited = self.model is not None and self.model.available is not None and agent is None
        self._unchecked = 0 if limited else self._num_actions  # actions below it are taken without a further look
        space = self.symbols.observation_space
        self._num_observations = 0 if space is None else len(space)
        self._sizes = () if space is None else space.shape
        self._parts: tuple[int, ...] | None = None
        self._name = self.symbols.action_name
        self._action_names = self.symbols.known_names
        table = getattr(self.policy, "table", None)
        self.wanted: Callable[[Any], int | None] | None = getattr(self.policy, "wanted", None)
        looks_up = type(self.information) is KnownState and self.wanted is None
        self._table: Sequence[int] | None = table if looks_up else None
        """The action per state, if a decision is a look-up."""
        self._last_epoch = sys.maxsize if self.horizon is None else self.horizon
        self.can_end = hasattr(self.information, "ended")
        self._made_of = self.policy, self.model, self.symbols, self.on_impossible, self._own_tracker
        self._forget(begins=True)
        try:
            if (initial := settings.initial_belief) is not None:
                self.begin_from(initial)
            self.information.reset(self._initial)
            self._forget(begins=True)
        except ModelError as error:
            raise ConfigError(str(error), key="initial_belief") from None

    def __repr__(self) -> str:
        return f"<Controller: {self.policy!r}, epoch {self.epoch}>"

    def step_by_step(self) -> None:
        """Begin again, as a controller that hears each time step, also where nothing is observed.

        So is one that decides at a fixed rate. Beliefs then count no unseen steps; see `POMDP.step_by_step`.
        """
        if self.model is None or not (self.model.event_observations or self.model.false_negative is not None):
            return
        self.model = self.model.step_by_step()
        self._made_of = self.policy, self.model, self.symbols, self.on_impossible, self._own_tracker
        self._configuration = None
        if self._tracks:
            self.information = self.policy.information(self.model)
            self._expected = expectation(self.information, own=False)
        self.reset()

    def divide_observations(self, sizes: Sequence[int]) -> None:
        """Take the observations of a model that does not divide them as made of components, the first most significant.

        An observation may then be given by components, None where one is missing: information states are told the set
        of observations that agree with it, and sum over them.

        Raises:
            ConfigError: If the components do not make up the model's observations.
        """
        if len(self._sizes) != 1 or math.prod(sizes) != self._num_observations:
            parts = " x ".join(map(str, sizes))
            raise ConfigError(f"{parts} components do not make up {self._num_observations} observations", key="model")
        self._parts = tuple(sizes)

    @property
    def divided(self) -> bool:
        """Whether observations are given by components that the model does not divide them into."""
        return self._parts is not None

    @property
    def has_own_tracker(self) -> bool:
        """Whether the information state is a tracker of the user's."""
        return self._own_tracker

    # -- Deciding ------------------------------------------------------------------------------------------------

    def start(self, at: Symbol | npt.ArrayLike | None = None) -> Step:
        """Begin an episode, and decide.

        Args:
            at: The first state, for a policy over states; for others a belief, by default the initial one.

        Raises:
            ModelError: If there is no such state, or the belief is invalid.
        """
        if self.takes == "state":
            if at is None:
                raise ModelError("a policy over states decides when it sees one: give the state to start at")
            state = self.symbols.state_index(at)  # type: ignore[arg-type]
            self.reset()
            return self.see(state)
        belief = None if at is None else self.symbols.belief_of(at)
        self.reset()
        if belief is not None:
            self.information.reset(belief)
            self._forget()
        return self.decide()

    def observe(self, observation: Any = None) -> Step:
        """Update by the observation after the last action, and decide.

        Before `start`, and after the last decision of an episode, a new episode begins, and the observation is ignored.

        Args:
            observation: By name or index; a component per agent, None where one is missing; or None where time has
                passed and nothing was observed (a policy over states then decides on its state once more).

        Raises:
            ModelError: If there is no such observation, or the policy decides on states.
        """
        if self.takes == "state":
            if observation is not None:
                raise ModelError("the policy decides on states, not on observations: tell it the state with see()")
            return self.see(self._seen())
        if self.over:
            self.reset()
        else:
            self.advance(observation)
        return self.decide()

    def see(self, state: Symbol) -> Step:
        """Set the observed state, and decide.

        Args:
            state: By name or index.

        Raises:
            ModelError: If there is no such state, or the policy decides on observations.
        """
        # Hot path: by a table, a look-up and no call (0.5 µs less of 5.5 from sensor to callback).
        table, epoch = self._table, self.epoch
        if table is not None and state.__class__ is int and -1 < state < len(table) and epoch < self._last_epoch:
            self.information.current = state  # type: ignore[misc]
            self.last_action = action = table[state]
            self.epoch = epoch + 1
            rewards = self._rewards
            name = self._action_names.get(action) or self._name(action)
            return Step(
                epoch, action, name, None if rewards is None else rewards[action].item(state), None, state, self._past
            )
        if self.takes != "state":
            raise ModelError("the policy decides on observations, not on states: use observe(observation)")
        state = self.symbols.state_index(state)
        if self.epoch >= self._last_epoch:
            self.reset()
        self.information.update(self.last_action, state)  # type: ignore[arg-type]
        return self.decide()

    def look_up(self, state: int) -> int:
        """As `see`, for hot paths: the action alone, where it is an entry of a table and no reward is to be told.

        Returns:
            The action; -1, with nothing decided, where it takes more than that.
        """
        table, epoch = self._table, self.epoch
        if table is None or self._rewards is not None or epoch >= self._last_epoch:
            return -1
        if state.__class__ is not int or not -1 < state < len(table):
            return -1
        self.information.current = state  # type: ignore[misc]
        self.last_action = action = table[state]
        self.epoch = epoch + 1
        return action

    def believe(self, belief: npt.ArrayLike) -> None:
        """Replace the information state by a belief; the next decision is on it.

        Raises:
            ModelError: If it is not a belief over the states; the information state is unchanged.
        """
        checked, over = self.symbols.belief_of(belief), self.over
        self.information.reset(checked)
        if over:
            self.reset(keep=True)
            self.information.reset(checked)
        self.given = True
        self._probability = None
        self._forget()

    def advance(self, observation: Any = None) -> float | None:
        """Update the information state by the observation after the last action, without a decision.

        Returns:
            The probability of the observation; None if it is ignored, as before the first decision of an episode.

        Raises:
            ModelError: If there is no such observation; the information state is unchanged.
        """
        action, self.problem = self.last_action, None
        observes = self.takes == "observation"
        observed: Any = self._observed(observation) if observes else None
        if self.given:  # a belief from outside counts in place of what is observed
            return None
        if not observes:
            observed = self._seen() if observation is None else self.symbols.state_index(observation)
        elif action is None:
            self._probability = None
            return None
        probability = self.information.update(action, observed)  # type: ignore[arg-type]
        if self._own_tracker and not isinstance(probability, float | int | np.floating):
            raise ModelError(f"the tracker's update returned {probability!r}, but a probability is needed")
        self._probability = probability
        if observes:
            updates = self._past.updates
            if len(updates) >= _KEPT_UPDATES:
                self._forget()
                updates = self._past.updates
            updates.append((self.epoch, action, observed))  # type: ignore[arg-type]
        if not probability > 0:  # true also for NaN, which a user's tracker may return
            self._probability = 0.0
            self._impossible(observation)
        return self._probability

    def decide(self, action: int | None = None) -> Step:
        """Decide on the present information state, and count the decision.

        Args:
            action: The action, by name or index, where it was chosen elsewhere, such as by a search that takes its
                time; by default the policy chooses.

        Raises:
            ModelError: If the policy returns something else than an action, or cannot choose.
            PolicyError: If it raises an error of another kind.
        """
        current = self.information.current
        if self._own_tracker:
            current = checked_belief(current, self.symbols.num_states)
        if action is None:
            try:
                action = (_ := self._choose)(current)
            except ModelError:
                raise
            except Exception as error:
                from mdm.runtime.supervision import describe  # noqa: PLC0415 - a controller needs no runtime

                raise PolicyError(f"the policy {type(self.policy).__name__} has raised {describe(error)}") from error
        if action.__class__ is not int or not -1 < action < self._unchecked:
            action = self._checked(action)
        epoch = self.epoch
        self.epoch = epoch + 1
        self.last_action = action
        self.given = False
        self.decided_by = current
        if self._rewards is None:
            reward = None
        elif current.__class__ is np.ndarray:  # a belief that is not given by its support
            reward = self._rewards[action].dot(current).item()
        else:
            reward = self._expected(self._rewards[action])  # type: ignore[misc]
        probability, self._probability = self._probability, None
        past = self._past
        if len(past.decided) >= self._most_kept:
            past = self._past = past.later(self._most_kept // 2)
        past.decided.append(current)
        name = self._action_names.get(action) or self._name(action)
        return Step(epoch, action, name, reward, probability, current, past)

    def reset(self, *, keep: bool = False) -> None:
        """Begin an episode at epoch 0 from the initial belief, without a decision.

        Args:
            keep: Keep the information state, unless its plan is over.
        """
        ended = self.can_end and self.information.ended  # type: ignore[attr-defined]
        if self.takes == "observation" and (not keep or ended):
            self.information.reset(self._initial)
        elif not keep:
            self.information.reset()
        self.epoch = 0
        self.last_action = None
        self.problem = None
        self._probability = None
        self.given = False
        self._forget(begins=not keep or ended)

    def _forget(self, *, begins: bool = False) -> None:
        """Forget the past: later decisions do not follow from it."""
        self._past = Past(self._made_of, self.epoch, self._initial, begins=begins)

    def begin_from(self, belief: Any) -> None:
        """Set the initial belief of further episodes.

        Raises:
            ModelError: If it is not a belief over the states.
        """
        self._initial = self.symbols.belief_of(belief)

    @property
    def over(self) -> bool:
        """Whether the episode is over, by the horizon or the end of a plan."""
        if self.epoch >= self._last_epoch:
            return True
        if not self.can_end or self.given or not self.epoch:  # no decision was made at the node of a given belief
            return False
        return bool(self.information.ended)  # type: ignore[attr-defined]

    # -- What is known -------------------------------------------------------------------------------------------

    @property
    def belief(self) -> Vector | None:
        """The present belief (S numbers, read-only); None if none is tracked."""
        if self.takes == "state":
            return None
        belief: Any = getattr(self.information, "belief", Ellipsis)
        tracked: Vector | None = self.information.current if belief is Ellipsis else belief
        return copied(tracked) if self._own_tracker and tracked is not None else tracked

    def case(self, last: int = KEPT) -> Case:
        """Return the last decision with its inputs, for the functions of `mdm.explanation`.

        Args:
            last: How many of the last observations.

        Raises:
            ModelError: If nothing was decided in this episode.
        """
        if self.last_action is None:
            raise ModelError("nothing was decided in this episode yet")
        at = self.information.current if self._table is not None else self.decided_by
        action = self.last_action
        return Step(self.epoch - 1, action, self._name(action), None, None, at, self._past).case(last)

    @property
    def observed(self) -> Any:
        """The observation that the last decision took in, by index or components; None where it took in none."""
        for epoch, _, observed in reversed(self._past.updates):
            if epoch < self.epoch:
                return observed if epoch == self.epoch - 1 else None
        return None

    def continue_at(self, epoch: int) -> None:
        """Count the next decision as that of an epoch; those before it are not known then.

        It is for decisions that are made again, of which some are missing.
        """
        self.epoch = epoch
        self._forget()

    @property
    def nodes(self) -> tuple[int, ...] | None:
        """The present node of each controller of a plan; None for other policies."""
        if not self.can_end:
            return None
        nodes: tuple[int, ...] = self.information.current
        return nodes

    def digest(self) -> str:
        """Return a hash of everything that determines further decisions.

        It is a hash of the model, the policy, the options that count and the information, bit by bit, the same in
        every process that tracks beliefs in the same way (with numba, or without). A policy of your own counts by
        the name of its class, unless it has ``parameters()``.
        """
        return of_parts([self.snapshot()])

    @property
    def configuration(self) -> str:
        """The digest of the constant part: model, policy and options."""
        if self._configuration is None:
            model, policy, options = self._constants()
            self._configuration = of_parts([*model, *policy, *options])
        return self._configuration

    _configuration: str | None = None
    _past: Past

    def digests(self) -> dict[str, str]:
        """Return the digests of ``model``, ``policy`` and ``options``, each by itself."""
        return dict(zip(("model", "policy", "options"), map(of_parts, self._constants()), strict=True))

    def parts(self) -> dict[str, str]:
        """Return the parts of model, policy and options, by names in words.

        Numbers and names are told as they are, arrays by short digests, which begin with ``#``: of two controllers
        whose digests differ, the first part that differs says where.
        """
        policy = self.policy
        told = {"model's kind": "none" if self.model is None else type(self.model).__name__}
        told |= {} if self.model is None else {f"model's {name}": part for name, part in parts(self.model).items()}
        told["policy's kind"] = type(policy).__name__
        packed = getattr(policy, "packed", lambda: None)()
        if packed is None:
            told["policy's parameters"] = short(getattr(policy, "parameters", list)())
        else:
            told |= {f"policy's number of {name}": str(size) for name, size in sorted(packed[0].items())}
            told |= {f"policy's {name}": short([array]) for name, array in sorted(packed[1].items())}
        told["tracker's kind"] = type(self.information).__name__
        told["option horizon"] = str(self.horizon)
        told["option on_impossible"] = self.on_impossible
        if self._own_rewards:
            rewards: Any = self._rewards
            told["option rewards"] = short(rewards)
        return told

    def _constants(self) -> tuple[list[Any], list[Any], list[Any]]:
        """Return model, policy and options as parts of a digest."""
        if self._model_digest is None and self.model is not None:
            self._model_digest = digest(self.model)
        policy = [type(self.policy).__name__, self._num_actions, *getattr(self.policy, "parameters", list)()]
        rewards: Any = self._rewards if self._own_rewards else []  # the model's are in its digest
        return (
            [self._model_digest],
            policy,
            [type(self.information).__name__, self.horizon, self.on_impossible, *rewards],
        )

    _model_digest: str | None = None

    def snapshot(self) -> bytes:
        """Return a snapshot to go on from here: with `restore`, the same calls then give the same steps.

        Of a tracker of your own without ``snapshot`` and ``restore`` its ``current`` alone is kept, a belief.

        Raises:
            ModelError: If it is none, so that it would take ``snapshot`` and ``restore``.
        """
        held = Held(
            self._configuration or self.configuration,
            self.epoch,
            self.last_action,
            self.given,
            self._probability,
            None if self._initial is None else self._initial.tolist(),
            snapshot(self.information),
        )
        return msgspec.msgpack.encode(held, enc_hook=plain)

    def mark(self) -> Any:
        """Return the present point in the process, for `go_back`: a `snapshot` for this controller alone, and quick.

        It costs a copy of the belief, and no hash of the model.
        """
        return (
            snapshot(self.information),
            *(self.epoch, self.last_action, self.given, self._probability, self._initial),
            *(self.impossible, self.problem, self.decided_by),
        )

    def go_back(self, mark: Any) -> None:
        """Go back to a `mark`: the same calls then give the same steps. A mark serves any number of times."""
        held, self.epoch, self.last_action, self.given, self._probability, self._initial = mark[:6]
        self.impossible, self.problem, self.decided_by = mark[6:]
        restore(self.information, held)
        self._forget()

    def restore(self, snapshot: bytes) -> None:
        """Restore a snapshot of a controller with the same `configuration`.

        Raises:
            ModelError: If it is invalid or of another configuration; the controller is unchanged.
        """
        held = opened(snapshot)
        if held.configuration != self.configuration:
            raise ModelError("the snapshot is of a controller with another model, policy or options")
        before = self.mark()
        self.epoch, self.last_action, self.given = held.epoch, held.last_action, held.given
        self._probability, self._initial = held.probability, None if held.initial is None else np.array(held.initial)
        self.problem = None
        try:
            check_counts(held, self._num_actions, self.horizon)
            if held.initial is not None:
                self.symbols.belief_of(held.initial)
            restore(self.information, held.information)
            self._forget()
            check_information(self.information, self.symbols.num_states)
        except Exception as error:
            self.go_back(before)
            raise ModelError(f"this is not a snapshot of a controller: {error}") from None

    # -- Checks --------------------------------------------------------------------------------------------------

    def _observed(self, observation: Any) -> int | tuple[int | None, ...] | frozenset[int] | None:
        """Return an observation by index, components or those that agree, as information states take it."""
        if observation.__class__ is int and -1 < observation < self._num_observations:
            return observation
        if observation.__class__ is tuple and self._parts is not None and len(observation) == len(self._parts):
            sizes = zip(observation, self._parts, strict=True)
            if not all(part is None or (part.__class__ is int and -1 < part < size) for part, size in sizes):
                raise ModelError(f"there is no observation {observation!r}; its components count from 0")
            return frozenset(agreeing(self._parts, observation))
        if observation is None or self.symbols.observation_space is None:
            return observation  # type: ignore[no-any-return]
        if observation.__class__ is tuple and None in observation and len(observation) == len(self._sizes):
            for component, size in zip(observation, self._sizes, strict=True):
                if component is not None and (component.__class__ is not int or not -1 < component < size):
                    break
            else:  # what a team's layer gives, where not all of its agents have observed something
                return observation
        index, components = self.symbols.observed(observation)
        return components if index is None else index

    def _seen(self) -> int:
        state: int | None = getattr(self.information, "state", None)
        if state is None:
            raise ModelError("the policy has seen no state yet: tell it one with see()")
        return state

    def _impossible(self, observation: Any) -> None:
        assert self.last_action is not None
        self.impossible += 1
        why = getattr(self.information, "impossible", "has probability 0 under the model and the belief")
        self.problem = (
            f"observation {self.symbols.observation_name(observation)} after action {self._name(self.last_action)!r} "
            f"{why}; on_impossible is {self.on_impossible!r}"
        )
        if self.on_impossible == "reset":
            self.information.reset(self._initial)
        elif self.on_impossible != "keep":
            self.information.update(self.last_action, None)

    def _checked(self, action: Any) -> int:
        """Return the index of an action; refuse one that is none, or is not available in a state that may be so."""
        index = self._index(action)
        if not self._unchecked and self.model is not None:
            seen = self.takes == "state"
            for state in [self._seen()] if seen else np.flatnonzero(np.asarray(self.belief) > _SUPPORT).tolist():
                refuse(self.model, state, index)
        return index

    def _index(self, action: Any) -> int:
        if isinstance(action, str) and self.symbols.action_space is not None:
            return self.symbols.action_space.index(action)
        if isinstance(action, int | np.integer) and not isinstance(action, bool):
            if 0 <= action < self._num_actions:
                return int(action)
            raise ModelError(f"the policy chose action {action}, but its actions are 0 to {self._num_actions - 1}")
        raise ModelError(f"the policy chose {action!r}, but an action's index is needed")
