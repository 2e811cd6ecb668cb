"""The knowledge of one agent of a communicating team, alone and in common with the others.

A recollection is a team's controller that takes the observations of others late, in the order of their steps. It keeps
the information states of the last steps. A late experience is put where it belongs, and the controller goes on from
there: once everything has arrived, it has the same information as if everything had come in time. An experience that
never arrives is missing, and the belief update sums over it.

Cost: a copy of the belief per step; and for experiences that arrive k steps late, k updates, however many arrive
together.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import msgspec

from mdm.checks import is_whole
from mdm.controller import Controller
from mdm.errors import ConfigError, ModelError
from mdm.symbols import agent_index

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.controller import Step
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models import Space
    from mdm.models.matrices import Vector
    from mdm.options import ControllerOptions
    from mdm.team.communication import CommunicationPolicy


class Experience(msgspec.Struct, frozen=True, gc=False):
    """An action of one agent, and the observation after it.

    Attributes:
        step: The step that the observation is for, from 1; the action is that of the step before.
        action: Its own component of the joint action, by index; None if unknown.
        observation: Its own component of the observation, by index; None if it observed nothing.
    """

    step: int
    action: int | None
    observation: int | None


class RecollectionStatistics(msgspec.Struct, frozen=True):
    """Counts of the experiences of others, and of their cost.

    Attributes:
        heard: All that others told.
        late: Applied to a step before the present one.
        too_late: Not applied: from before the window.
        too_early: Not applied: from further ahead than the window is long.
        contradictory: Not applied: other than the same agent's experience of the same step before.
        repeated_steps: Steps that were gone through once more.
    """

    heard: int = 0
    late: int = 0
    too_late: int = 0
    too_early: int = 0
    contradictory: int = 0
    repeated_steps: int = 0


class Recollection:
    """A controller of a team at one agent, on this agent's observations and the experiences of others.

    Steps count from 0, with each `start`. At a step the agent observes, hears others' experiences, and decides; a
    `Controller` that gets all components in time knows the same as soon as everything has arrived, in whatever order,
    at most ``window`` steps late.

    The belief is updated by joint actions, of which an agent knows its own component alone. In place of another
    agent's it takes that agent's word; else the decision of its own controller for it, on all that is known *now* of
    that step: a teammate that runs the same policy is expected to have followed the best guess of its information. So
    the information depends on all that is known, and not on the order in which it came. The agent's own component is
    always the one that it did, even if it would decide otherwise by now. Without communication the assumption is
    wrong wherever a teammate acted on what it alone saw, and the belief is an approximation until it tells.

    Args:
        controller: A controller of the whole team that decides on beliefs. It is the recollection's from now on.
        agent: The agent, by index or name; None for nobody's: the knowledge by shared experiences alone.
        window: How many steps late something may come. It keeps as many beliefs, and two.

    Raises:
        ConfigError: If the controller is for one agent, decides on states or runs a plan, there is no such agent, or
            the window is no number of steps.

    Example::

        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        recollection = mdm.team.Recollection(mdm.Controller(policy, model), agent=0)
        recollection.start()
        recollection.decide().action_name  # 'listen listen'
        for _ in range(2):
            recollection.observe("hear-left")
        recollection.decide().action_name  # 'open-right open-right'
        recollection.hear(1, mdm.team.Experience(step=1, action=0, observation=1))  # True
        recollection.belief  # [0.85, 0.15]
        recollection.decide().action_name  # 'listen listen'
    """

    def __init__(self, controller: Controller, agent: int | str | None = None, *, window: int = 32) -> None:
        actions, observations = _spaces(controller)
        if not is_whole(window) or window < 0:
            raise ConfigError(f"a window is a number of steps from 0 on, not {window!r}", key="window")
        names = [factor.name for factor in actions.factors]
        self.agent = None if agent is None else agent_index(agent, names, len(names))
        self.window = int(window)
        self.step = -1
        self.problem: str | None = None
        """Why the last experience that was not applied was not, in words."""
        self._controller = controller
        controller.step_by_step()
        self._actions, self._observations = actions, observations
        self._agents = range(len(names))
        self._marks: deque[Any] = deque(maxlen=self.window + 2)
        """The information states before the decisions, up to that of the step that the controller has come to."""
        self._at = 0
        """That step: observations are applied when they are first needed, together with experiences heard meanwhile."""
        self._did: dict[int, list[int | None]] = {}
        """The components of each step's joint action, as far as they are known."""
        self._saw: dict[int, list[int | None]] = {}
        """The components of the observation that each step decides on, as far as they are known."""
        self._from = 0
        """The step from which to go on once more, if it is before that."""
        self._decision: Step | None = None
        """The decision at the step that the controller has come to."""
        self._counts = dict.fromkeys(RecollectionStatistics.__struct_fields__, 0)

    @property
    def controller(self) -> Controller:
        """The controller, at the present step, with everything applied that was told."""
        self._catch_up()
        return self._controller

    @property
    def belief(self) -> Vector | None:
        """The belief at the present step: S numbers, read-only."""
        return self.controller.belief

    def start(self) -> None:
        """Begin again: at step 0, from the initial belief, with nothing known."""
        self._controller.reset()
        self.step = self._at = self._from = 0
        self._decision = None
        self._did.clear()
        self._saw.clear()
        self._marks.clear()
        self._marks.append(self._controller.mark())

    def observe(self, observation: str | int | None = None) -> None:
        """Go on to the next step, with the agent's own observation.

        A step without a call of `decide` is taken as decided by the controller.

        Args:
            observation: The agent's component, by name or index; None if it observed nothing.

        Raises:
            ModelError: If there is no such observation; nothing is changed.
        """
        self._started()
        seen: int | None = None
        if observation is not None:
            if self.agent is None:
                raise ModelError("this recollection belongs to no agent: say whose the observation is with hear()")
            seen = self._observations.factors[self.agent].index(observation)
        self.step += 1
        if seen is not None and self.agent is not None:
            self._components(self._saw, self.step)[self.agent] = seen

    def hear(self, agent: int | str, experience: Experience) -> bool:
        """Take another agent's action and observation, of any step; they are applied when they are first needed.

        Returns:
            Whether it counts. It does not if it comes too late or too early, or contradicts an earlier one:
            `problem` says why, and `statistics` count it.

        Raises:
            ModelError: If there is no such agent, step, action or observation, or it is this agent's own; nothing is
                changed.
        """
        self._started()
        teller, step, action, observation = self._checked(agent, experience)
        self._counts["heard"] += 1
        name = self._actions.factors[teller].name
        if step < self.step - self.window:
            return self._refuse("too_late", f"step {step} of {name} came at step {self.step}, after the window")
        if step > self.step + self.window + 1:
            return self._refuse("too_early", f"step {step} of {name} came at step {self.step}, far ahead of it")
        did, saw = self._components(self._did, step - 1), self._components(self._saw, step)
        known = did[teller], saw[teller]
        if any(
            old is not None and new not in (None, old) for old, new in zip(known, (action, observation), strict=True)
        ):
            return self._refuse(
                "contradictory",
                f"{name} told two different things of step {step}: {known}, then {(action, observation)} as action and "
                f"observation; the first counts",
            )
        if action is not None:
            did[teller] = action
        if observation is not None:
            saw[teller] = observation
        if step <= self.step and (did[teller], saw[teller]) != known:
            self._counts["late"] += step < self.step
            self._from = min(self._from, step - 1)
        return True

    def decide(self) -> Step:
        """Decide by the information of the present step.

        It may be asked again when more is known; the last decision of a step counts as the agent's own action.

        Returns:
            The controller's decision, a joint action; the agent carries out its component.
        """
        self._started()
        self._catch_up()
        if self._decision is None:
            self._decision = self._controller.decide()
        if self.agent is not None:
            own = self._actions.unravel(self._decision.action)[self.agent]
            self._components(self._did, self.step)[self.agent] = own
        return self._decision

    def act(self, component: int | None) -> None:
        """Take note of the agent's real action at this step, in place of its decision.

        Args:
            component: Its own component of the joint action, by index; None where that is not known: it is then taken
                to be the controller's decision for it.
        """
        self._started()
        if self.agent is not None:
            self._components(self._did, self.step)[self.agent] = component

    @property
    def components(self) -> tuple[int | None, ...]:
        """The components of the observation that this step decides on, by index; None where one is not known."""
        return tuple(self._saw.get(self.step, self._nothing))

    @property
    def observed(self) -> Any:
        """The observation that this step decides on, as the controller takes it: an index, components, or None."""
        return self._observed(self.step)

    def look_ahead(self, action: int) -> float:
        """Return the value of a joint action at the present belief, Q(b, a), by one step of look-ahead.

        It is R(b, a), and discounted the sum over joint observations o of P(o | b, a) V(b'), with the policy's values
        V: from the next step on all know everything. Cost: an update and a value for each joint observation.

        Raises:
            ConfigError: If no rewards are known.
            ModelError: If the policy has no values.
        """
        self._started()
        self._catch_up()
        controller, decision = self._controller, self._decision
        controller.go_back(self._marks[-1])
        reward = controller.decide(action).reward
        if reward is None or controller.model is None:
            raise ConfigError("the value of a joint action needs rewards, but the controller knows none")
        total, value = 0.0, controller.policy.value  # type: ignore[attr-defined]
        if not controller.over:
            after = controller.mark()
            for observation in range(len(self._observations)):
                controller.go_back(after)
                probability = controller.advance(observation)
                if probability:
                    total += probability * value(controller.information.current)
        controller.go_back(self._marks[-1])
        if decision is not None:
            controller.decide(decision.action)
        return reward + controller.model.discount * total

    def statistics(self) -> RecollectionStatistics:
        """Return the counts since the recollection was made."""
        return RecollectionStatistics(**self._counts)

    # -- Going on ------------------------------------------------------------------------------------------------

    def _catch_up(self) -> None:
        """Apply everything that is known: go back to where the first of it belongs, and on to the present step."""
        again = self._at - self._from
        if again:
            self._counts["repeated_steps"] += again
            for _ in range(again):
                self._marks.pop()
            self._controller.go_back(self._marks[-1])
            self._at, self._decision = self._from, None
        if self._at == self.step:
            return
        while self._at < self.step:
            self._move()
        self._from = self._at
        for known in (self._did, self._saw):
            for step in [step for step in known if step <= self.step - len(self._marks)]:
                del known[step]

    def _move(self) -> None:
        """Go on to the next step."""
        controller, did = self._controller, self._did.get(self._at, self._nothing)
        decided = self._decision
        if decided is None and None in did:
            decided = controller.decide()
        joint = self._joint(did, decided)
        if decided is None or joint != decided.action:
            if decided is not None:
                controller.go_back(self._marks[-1])
            controller.decide(joint)
        if controller.over:  # the next decision is the first of an episode, of which nothing is observed yet
            controller.reset()
        else:
            controller.advance(self._observed(self._at + 1))
        self._marks.append(controller.mark())
        self._at, self._decision = self._at + 1, None

    def _joint(self, did: list[int | None], decided: Step | None) -> int:
        """Return the joint action of the known components, and the decided ones of the others."""
        if decided is not None:
            assumed = self._actions.unravel(decided.action)
            did = [at if own is None else own for own, at in zip(did, assumed, strict=True)]
        return self._actions.ravel(did)  # type: ignore[arg-type]

    def _observed(self, step: int) -> Any:
        saw = self._saw.get(step, self._nothing)
        if None not in saw:
            return self._observations.ravel(saw)  # type: ignore[arg-type]
        return None if saw == self._nothing else tuple(saw)

    # -- Details -------------------------------------------------------------------------------------------------

    @property
    def _nothing(self) -> list[int | None]:
        return [None for _ in self._agents]

    def _components(self, known: dict[int, list[int | None]], step: int) -> list[int | None]:
        return known.setdefault(step, self._nothing)

    def _started(self) -> None:
        if self.step < 0:
            raise ModelError("the recollection has not begun: start() it")

    def _checked(self, agent: int | str, told: Experience) -> tuple[int, int, int | None, int | None]:
        names = [factor.name for factor in self._actions.factors]
        try:
            teller = agent_index(agent, names, len(names))
        except ConfigError as error:
            raise ModelError(str(error)) from None
        if teller == self.agent:
            raise ModelError(f"{names[teller]!r} knows itself what it did and observed: others are heard")
        if not is_whole(told.step) or told.step < 1:
            raise ModelError(f"steps with an observation count from 1: there is none of step {told.step!r}")
        action = None if told.action is None else self._actions.factors[teller].index(told.action)
        seen = None if told.observation is None else self._observations.factors[teller].index(told.observation)
        return teller, int(told.step), action, seen

    def _refuse(self, kind: str, why: str) -> bool:
        self._counts[kind] += 1
        self.problem = why
        return False


def _spaces(controller: Controller) -> tuple[Space, Space]:
    """Return the actions and observations of a team, with a factor for each agent."""
    if controller.takes == "state":
        raise ConfigError("what others observed is recollected for policies over beliefs, but this one is over states")
    if controller.can_end:
        raise ConfigError("an agent runs its own part of a plan on its own observations: there is nothing to recollect")
    actions, observations = controller.symbols.action_space, controller.symbols.observation_space
    if actions is None or observations is None:
        raise ConfigError("a recollection needs the team's model, for its agents' actions and observations")
    if len(actions.factors) != len(observations.factors):
        raise ConfigError(
            f"the model has actions of {len(actions.factors)} agents, but observations of "
            f"{len(observations.factors)}: a recollection needs both for each agent"
        )
    return actions, observations


class SharedHistory(msgspec.Struct, frozen=True):
    """A message: the part of its history that an agent shares with all others.

    Attributes:
        agent: The agent's index.
        experiences: Its actions and observations, in the order of steps.
    """

    agent: int
    experiences: tuple[Experience, ...]


class Knowledge:
    """The knowledge of one agent, its decisions by that, and its messages to the others.

    It keeps two recollections: the agent's own, of all it observed and heard; and the *common* one, of the experiences
    that were shared, by itself or others, which all know as far as messages arrive. At each step the agent observes,
    shares the choice of its communication policy, hears the others, may share once more as long as it hears something
    new, and decides.

    Args:
        policy: The team's policy over beliefs; see `Controller`.
        model: The team's model.
        agent: The agent, by index or name.
        communication: The policy of sharing.
        window: How many steps late something may come; see `Recollection`. Older experiences are no longer shared.
        options: See `ControllerOptions`.

    Raises:
        ConfigError: If the policy does not fit the model, or cannot be recollected, or the communication policy does
            not fit them, or an option is wrong.

    Attributes:
        agent: The agent's index.
        communication: The communication policy.
        own: The recollection of all that the agent knows.
        common: That of all that has been shared; None if the communication policy does not use it.
        unshared: The agent's own history that is not shared yet, in the order of steps.
        last_shared: The last experience that was shared; None before.

    Example::

        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        first, second = (mdm.team.Knowledge(policy, model, agent, mdm.team.Always()) for agent in (0, 1))
        for agent in (first, second):
            agent.observe("hear-left")
        second.hear(first.share(now=1.0))  # 0
        second.belief  # [0.9698, 0.0302]
    """

    def __init__(
        self,
        policy: GivenPolicy,
        model: GivenModel,
        agent: int | str,
        communication: CommunicationPolicy,
        *,
        window: int = 32,
        **options: Unpack[ControllerOptions],
    ) -> None:
        another = partial(Controller, policy, model, **options)
        self._begin(another(), another, agent, communication, window)

    @classmethod
    def of(
        cls,
        controller: Controller,
        another: Callable[[], Controller],
        agent: int | str,
        communication: CommunicationPolicy,
        *,
        window: int = 32,
    ) -> Knowledge:
        """Return the knowledge of an agent with a controller of its own; `another` makes one for the common one."""
        knowledge = cls.__new__(cls)
        knowledge._begin(controller, another, agent, communication, window)  # noqa: SLF001 - it is one of these
        return knowledge

    def _begin(
        self,
        controller: Controller,
        another: Callable[[], Controller],
        agent: int | str,
        communication: CommunicationPolicy,
        window: int,
    ) -> None:
        if not callable(getattr(communication, "share", None)):
            raise ConfigError(
                f"a communication policy needs a method share, which {communication!r} lacks: use mdm.team.Always() or "
                f"another of mdm.team",
                key="communication",
            )
        if controller.has_own_tracker:
            raise ConfigError("the agent keeps two beliefs, which cannot share a tracker: leave it out", key="tracker")
        self.own = Recollection(controller, agent, window=window)
        assert self.own.agent is not None
        self.agent: int = self.own.agent
        self.communication = communication
        self.common: Recollection | None = None
        if getattr(communication, "uses_common_belief", True):
            self.common = Recollection(another(), window=window)
        if (check := getattr(communication, "check", None)) is not None:
            check(self)
        self._spaces = self.own.controller.symbols
        self.start()

    def start(self) -> None:
        """Begin again: at step 0, from the initial belief, with nothing shared."""
        self.unshared: tuple[Experience, ...] = ()
        self.last_shared: Experience | None = None
        self._did: int | None = None
        self.own.start()
        if self.common is not None:
            self.common.start()

    # -- A step --------------------------------------------------------------------------------------------------

    def observe(self, observation: str | int | None = None) -> None:
        """Go on to the next step, with the agent's own observation.

        Args:
            observation: The agent's component, by name or index; None if it observed nothing.

        Raises:
            ModelError: If there is no such observation; nothing is changed.
        """
        did = self._did
        self.own.observe(observation)
        if self.common is not None:
            self.common.observe()
        self._did = None
        space = self._spaces.observation_space
        assert space is not None
        seen = None if observation is None else space.factors[self.agent].index(observation)
        experience = Experience(self.own.step, did, seen)
        self.unshared = tuple(
            past for past in (*self.unshared, experience) if past.step >= self.own.step - self.own.window
        )

    def share(self, now: float) -> SharedHistory | None:
        """Ask the communication policy for experiences to share, and note them as shared.

        Args:
            now: Seconds on a clock that does not go back.

        Returns:
            The message to all others; None for silence.

        Raises:
            ModelError: If the communication policy chooses an experience that is not among ``unshared``.
        """
        if not self.unshared:
            return None
        chosen = tuple(self.communication.share(self, now))
        if not chosen:
            return None
        foreign = [each for each in chosen if each not in self.unshared]
        if foreign or len(set(chosen)) < len(chosen):
            raise ModelError(
                f"the communication policy {type(self.communication).__name__} chose {foreign or chosen}: it may "
                f"choose experiences from knowledge.unshared, each once"
            )
        chosen = tuple(sorted(chosen, key=lambda each: each.step))
        self.unshared = tuple(each for each in self.unshared if each not in chosen)
        self.last_shared = chosen[-1]
        self._note(self.common, self.agent, chosen)
        return SharedHistory(self.agent, chosen)

    def hear(self, history: SharedHistory) -> int:
        """Take the experiences that another agent shared.

        Returns:
            How many of its experiences do not count, as `Recollection.hear` tells: they are too late, say.

        Raises:
            ModelError: If there is no such agent, step, action or observation, or it is this agent's own; nothing of
                the experience in question, and of those behind it, is taken.
        """
        refused = self._note(self.own, history.agent, history.experiences)
        self._note(self.common, history.agent, history.experiences)
        return refused

    def decide(self) -> Step:
        """Decide on all that is known; the agent carries out its component of the joint action."""
        step = self.own.decide()
        self._did = self._part(step.action)
        return step

    def act(self, component: int | None) -> None:
        """Take note of the agent's real action at this step, where that may be other than its decision.

        Args:
            component: Its own component of the joint action, by index; None where it is none of the model's, or not
                known.
        """
        self._did = component
        self.own.act(component)

    @property
    def component(self) -> int | None:
        """The agent's own component of the joint action at this step, by index; None before it has decided."""
        return self._did

    # -- Feedback for communication policies ---------------------------------------------------------------------

    @property
    def step(self) -> int:
        """The present step."""
        return self.own.step

    @property
    def belief(self) -> Vector | None:
        """The agent's own belief: S numbers, read-only."""
        return self.own.belief

    @property
    def common_belief(self) -> Vector | None:
        """The belief by the shared history: S numbers, read-only."""
        return self._shared.belief

    @property
    def action(self) -> int:
        """The joint action that the own belief demands: the team's decision if all had this agent's knowledge."""
        return self.own.decide().action

    @property
    def action_in_silence(self) -> int:
        """The joint action in silence: the own component by the own belief, the others' by the common one."""
        space = self._spaces.action_space
        assert space is not None
        together = list(space.unravel(self._shared.decide().action))
        together[self.agent] = self._part(self.action)
        return space.ravel(together)

    def value_of(self, action: int) -> float:
        """Return the value of a joint action at the own belief; see `Recollection.look_ahead`."""
        return self.own.look_ahead(action)

    def __repr__(self) -> str:
        return f"<Knowledge: agent {self.agent}, step {self.step}, {len(self.unshared)} experiences not shared>"

    @property
    def _shared(self) -> Recollection:
        if self.common is None:
            raise ConfigError(
                f"the communication policy {type(self.communication).__name__} says that it does not use the common "
                f"belief: leave out uses_common_belief = False"
            )
        return self.common

    def _part(self, action: int) -> int:
        space = self._spaces.action_space
        assert space is not None
        return space.unravel(action)[self.agent]

    @staticmethod
    def _note(recollection: Recollection | None, agent: int, experiences: Any) -> int:
        if recollection is None:
            return 0
        return sum(not recollection.hear(agent, experience) for experience in experiences)
