"""The knowledge of one agent of a communicating team, alone and in common with the others."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import msgspec

from mdm.controller import Controller
from mdm.errors import ConfigError, ModelError
from mdm.team.communicating.recollection import Experience, Recollection

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.controller import Step
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models.matrices import Vector
    from mdm.options import ControllerOptions
    from mdm.team.communicating.communication import CommunicationPolicy

__all__ = ["Knowledge", "SharedHistory"]


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

    It keeps two recollections: the agent's own, of all it observed and heard; and the *common* one, of what has been
    shared alone, by itself or others, which all know as far as messages arrive. At each step the agent observes, shares
    what its communication policy chooses, hears what others share, may share once more as long as it hears something
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
        common: That of what has been shared; None if the communication policy does not use it.
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
        """Return the knowledge of an agent whose controller there is already.

        Args:
            controller: The agent's own; it is the knowledge's from now on.
            another: Makes one more of the same policy, model and options, for the common knowledge.
            agent: As above.
            communication: As above.
            window: As above.

        Raises:
            ConfigError: As above.
        """
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
                f"a communication policy has a method share, which {communication!r} has not: use mdm.team.Always() or "
                f"another of them",
                key="communication",
            )
        if controller.has_own_tracker:
            raise ConfigError("two beliefs are kept, which cannot share a tracker: give none", key="tracker")
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
        """Begin anew: at step 0, from the initial belief, with nothing shared."""
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
