"""Communication policies: which part of its history an agent of a team shares, and when."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

from mdm.checks import is_number
from mdm.errors import ConfigError, ModelError
from mdm.team.transport.allowance import TokenBucket

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.team.knowledge import Experience, Knowledge


class CommunicationPolicy(Protocol):
    """Chooses the experiences that an agent shares. Implement this protocol for a communication policy of your own.

    It is asked at each step after the agent's own observation, and again whenever the agent heard something new before
    it decides. Each agent has a policy of its own, so it may keep a state.

    Optional members are ``uses_common_belief``, False for a policy that needs no common belief, which then costs
    nothing; ``silent``, True for one that never shares, so that nobody waits for it; and ``check(knowledge)``, called
    once before the start, which raises `ConfigError` if the policy does not fit the controller.

    Example::

        class WhenCertain:
            uses_common_belief = False

            def share(self, knowledge, now):
                return knowledge.unshared if knowledge.belief.max() > 0.9 else ()


        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        agent = mdm.team.Knowledge(policy, model, 0, WhenCertain())
        agent.observe("hear-left")
        agent.share(now=0.0) is None  # True
        agent.observe("hear-left")
        len(agent.share(now=1.0).experiences)  # 2
    """

    def share(self, knowledge: Knowledge, now: float) -> Sequence[Experience]:
        """Choose the experiences to share now.

        Args:
            knowledge: The agent's knowledge: its beliefs, its decision by them, and its history that is not shared yet.
            now: Seconds on a clock that does not go back.

        Returns:
            Experiences from ``knowledge.unshared``; none for silence. The others may be shared later.
        """
        ...


class Always:
    """Shares everything at once.

    If messages arrive before the next decision, and none is lost, all agents decide as one that observes everything.

    Example::

        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        agent = mdm.team.Knowledge(policy, model, 0, mdm.team.Always())
        agent.observe("hear-left")
        len(agent.share(now=0.0).experiences)  # 1
    """

    uses_common_belief = False

    def share(self, knowledge: Knowledge, now: float) -> Sequence[Experience]:
        """Choose everything that is not shared yet."""
        return knowledge.unshared


class Never:
    """Shares nothing: each agent decides on its own observations alone.

    Example::

        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        agent = mdm.team.Knowledge(policy, model, 0, mdm.team.Never())
        agent.observe("hear-left")
        agent.share(now=0.0) is None  # True
    """

    uses_common_belief = False
    silent = True

    def share(self, knowledge: Knowledge, now: float) -> Sequence[Experience]:
        """Choose nothing."""
        return ()


class OnChange:
    """Shares the history that is not shared yet when the observation is another than the last one that was shared.

    It suits observations that tell a state that seldom changes, such as a battery's. Where each repetition of an
    observation tells more, as where a sensor errs, silence keeps that from the others until the next change.

    Example::

        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        agent = mdm.team.Knowledge(policy, model, 0, mdm.team.OnChange())
        agent.observe("hear-left")
        len(agent.share(now=0.0).experiences)  # 1
        agent.observe("hear-left")
        agent.share(now=1.0) is None  # True
    """

    uses_common_belief = False

    def share(self, knowledge: Knowledge, now: float) -> Sequence[Experience]:
        """Choose everything after a change, else nothing."""
        last = knowledge.last_shared
        changed = last is None or knowledge.unshared[-1].observation != last.observation
        return knowledge.unshared if changed else ()


class Budget:
    """Shares the choice of another communication policy, within a number of messages per second.

    In any interval of time there are at most ``burst + messages_per_second x seconds`` messages. What is held back
    stays unshared, and may go with the next message.

    Args:
        messages_per_second: The rate.
        of: The policy that chooses; by default `Always`.
        burst: How many messages may come at once after a pause.

    Raises:
        ConfigError: If the rate is not a positive number, or the burst less than 1.

    Example::

        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        agent = mdm.team.Knowledge(policy, model, 0, mdm.team.Budget(0.5))
        agent.observe("hear-left")
        len(agent.share(now=0.0).experiences)  # 1
        agent.observe("hear-left")
        agent.share(now=1.0) is None  # True
    """

    def __init__(self, messages_per_second: float, of: CommunicationPolicy | None = None, *, burst: int = 1) -> None:
        self.of: CommunicationPolicy = Always() if of is None else of
        if not callable(getattr(self.of, "share", None)):
            raise ConfigError(f"a budget is of a communication policy, not of {of!r}", key="of")
        self.bucket = TokenBucket(messages_per_second, burst)
        self.uses_common_belief: bool = getattr(self.of, "uses_common_belief", True)

    def check(self, knowledge: Knowledge) -> None:
        """Check the policy that chooses.

        Raises:
            ConfigError: If it does not fit the controller.
        """
        if (check := getattr(self.of, "check", None)) is not None:
            check(knowledge)

    def share(self, knowledge: Knowledge, now: float) -> Sequence[Experience]:
        """Return the choice of the other policy, if the budget allows a message."""
        chosen = self.of.share(knowledge, now)
        return chosen if chosen and self.bucket.take(now) else ()


class ValueOfCommunication:
    """Shares its history if that changes the value of the joint decision by more than a threshold.

    An agent keeps two beliefs: its own, b, and the common one, by the shared history. In silence the team would do
    its own component of the policy's action at b, and the others' of that at the common belief; if it shares, all do
    the action at b. The value of communication is the difference of the two joint actions' values under b, as
    Q(b, a) = R(b, a) + discount x sum over o of P(o | b, a) V(b'), with the policy's values V.

    The idea is that of M. Roth, R. Simmons and M. Veloso, *Reasoning about joint beliefs for execution-time
    communication decisions*, AAMAS 2005: the team has a policy for free communication, and an agent shares its history
    if that changes the joint action to one of more value than silence costs. Theirs, Dec-Comm, decides on the
    distribution of possible joint beliefs, and agents never act on what they alone saw, so that they stay coordinated.
    Here agents decide on their own beliefs, and the common one is a single belief, in which what was not shared is
    missing: silence is not taken as a sign that there was nothing worth saying. Myopic it is in the sense of R. Becker,
    A. Carlin, V. Lesser and S. Zilberstein, *Analyzing myopic approaches for multi-agent communication*, Computational
    Intelligence 25, 2009: the present decision alone is weighed, as though communication could not wait. Where they
    value the future without communication, Q takes it as free, as Roth et al. do. So what pays only by later decisions
    is not seen; and a message is valued as though it arrived at once, whatever the network's delay.

    Args:
        threshold: The least worth of a message that is sent, in units of the reward: its cost, say. The greater it is,
            the fewer messages there are.

    Raises:
        ConfigError: If the threshold is not a number from 0 on.

    Example::

        model = mdm.problems.dec_tiger(discount=0.9)
        policy = mdm.policies.AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8])  # opens doors from 0.9 on
        agent = mdm.team.Knowledge(policy, model, 0, mdm.team.ValueOfCommunication(threshold=1.0))
        agent.observe("hear-left")
        agent.share(now=0.0) is None  # True
        agent.observe("hear-left")
        len(agent.share(now=1.0).experiences)  # 2
    """

    def __init__(self, threshold: float) -> None:
        if not is_number(threshold) or not 0 <= threshold < math.inf:
            raise ConfigError(f"a threshold is a number from 0 on, not {threshold!r}", key="threshold")
        self.threshold = float(threshold)

    def check(self, knowledge: Knowledge) -> None:
        """Check that the controller has values.

        Raises:
            ConfigError: If its policy has no values, or its model has events, after which time and steps go apart.
        """
        controller = knowledge.own.controller
        model = controller.model
        if model is None or model.event_observations:
            raise ConfigError(
                "the value of communication is a look-ahead of one step: it needs a model without event observations",
                key="communication",
            )
        try:
            controller.policy.value(controller.information.current)  # type: ignore[attr-defined]
        except (AttributeError, ModelError) as error:
            raise ConfigError(f"the value of communication needs a policy with values: {error}", key="policy") from None

    def share(self, knowledge: Knowledge, now: float) -> Sequence[Experience]:
        """Choose everything if that is worth more than the threshold, else nothing."""
        return knowledge.unshared if self.worth(knowledge) > self.threshold else ()

    def worth(self, knowledge: Knowledge) -> float:
        """Return the value of communication at present."""
        told, silent = knowledge.action, knowledge.action_in_silence
        return 0.0 if told == silent else knowledge.value_of(told) - knowledge.value_of(silent)
