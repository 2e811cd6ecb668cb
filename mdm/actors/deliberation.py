"""The control layer of an ensemble that thinks before it acts: a stimulus starts a search, its answer decides.

Until then the running action goes on, and the belief is still tracked by it. A stimulus that comes meanwhile is taken
into the belief, and the search begins anew from there: one decision answers both. An epoch is still one decision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.actors.control_layer import ControlLayer
from mdm.actors.drive import FixedRate
from mdm.actors.planner import Planner
from mdm.errors import ConfigError
from mdm.messages import Answer, Belief, Fault, Question

if TYPE_CHECKING:
    from mdm.solvers.online.tree_search import TreeSearch

__all__ = ["DeliberatingControlLayer"]


class DeliberatingControlLayer(ControlLayer):
    """A `ControlLayer` that has a `Planner` decide, which searches in a process of its own.

    Args:
        policy: The search. Where the drive is a fixed rate, its time is shorter than the period.
        args: As for `ControlLayer`. By the deadline, the fallback decides; without one the safe action runs.
        options: As for `ControlLayer`.

    Raises:
        ConfigError: If a search takes longer than the period, or takes another observation to be a false negative.
    """

    def __init__(self, policy: TreeSearch, *args: Any, **options: Any) -> None:
        super().__init__(policy, *args, **options)
        if isinstance(self.drive, FixedRate) and (policy.seconds or 0.0) >= 1 / self.drive.rate:
            raise ConfigError(
                f"the search takes {policy.seconds} s, but a decision is due every {1 / self.drive.rate:g} s",
                key="policy",
            )
        if self.model is not None and self.model.false_negative != policy.false_negative:
            raise ConfigError(
                "the search and the ensemble differ in the false negative: give both the same model",
                key="false_negative",
            )
        self.planner = Planner(policy, deadline=self.deadline)
        self.add(self.planner)
        self._choose = lambda _: self._chosen
        self._chosen = 0
        self._number = 0
        self._stimulus: tuple[int, str, int | tuple[int | None, ...] | None, int | None] | None = None

    def on_start(self) -> None:
        """Listen for stimuli, and for answers."""
        super().on_start()
        self._stimulus = None
        self._questions = self.owner.channel("question", Question)
        self.subscribe(self.owner.channel("answer", Answer), self._on_answer)

    def _begin_episode(self, *, keep_belief: bool = False) -> None:
        """Start an episode; what was asked in the one before decides nothing in it."""
        self._stimulus = None
        super()._begin_episode(keep_belief=keep_belief)

    def _on_external_belief(self, belief: Belief) -> None:
        """Take a belief from outside; at a fixed rate, too, what a tick has asked is asked anew from there."""
        super()._on_external_belief(belief)
        if self._given and self._stimulus is not None:
            self._given = False
            time, cause, observation, _ = self._stimulus
            self._decide(time, cause, observation)

    def _decide(self, time: int, cause: str, observation: int | tuple[int | None, ...] | None = None) -> None:
        """Ask for a decision."""
        state = self._state
        if self._tracker is None:
            assert state is not None
            assert self.policy.num_states is not None
            if not 0 <= state < self.policy.num_states:
                text = f"there is no state {state}; the policy is for {self.policy.num_states} states"
                self._safety.publish(Fault(time, self.path, "state", text))
                return
        self._number += 1
        self._stimulus = (time, cause, observation, state)
        self._questions.publish(Question(time, self._number, state if self._tracker is None else self.belief))

    def _on_answer(self, answer: Answer) -> None:
        if self._stimulus is None or answer.number != self._number or not self.running:
            return
        (time, cause, observation, state), self._stimulus = self._stimulus, None
        if answer.action is None:
            super()._late(self._now() - time, time)
            return
        self._chosen = answer.action
        present, self._state = self._state, state  # at a fixed rate it may have changed since the tick
        super()._decide(time, cause, observation)
        self._state = present

    def _late(self, latency: int, time: int) -> bool:  # noqa: ARG002 - the planner has seen to it
        """Whether it is too late for a decision: never, as the planner answers in time."""
        return False
