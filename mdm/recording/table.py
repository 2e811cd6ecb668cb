"""The decisions of a record as a table: each with its names, the end of its action, and the true state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mdm.messages import ActionLife, Decision, Reward, State
from mdm.recording.names import Names, names_of
from mdm.stimuli import TRUE_REWARD, TRUE_STATE

if TYPE_CHECKING:
    from mdm.recording.reader import Record

__all__ = ["Row", "rows"]


class Row(msgspec.Struct):
    """A decision, and what became of it.

    Args:
        decision: The decision.
        state: The name of its state, if it has one.
        observation: The name of its observation, likewise.
        true_state: The state of the simulated world by then, None where none is told.
        true_reward: What the simulated world has paid for it, likewise; of several steps the sum.
        life: The number of the action's life that it began, or went on with.
        end: How that life ended, None where it did not, or went on with a later decision.
        ended: When, in nanoseconds.
        detail: What was said of the end.
    """

    decision: Decision
    state: str | None = None
    observation: str | None = None
    true_state: int | None = None
    true_reward: float | None = None
    life: int | None = None
    end: str | None = None
    ended: int | None = None
    detail: str = ""


def rows(record: Record, ensemble: str | None = None) -> list[Row]:
    """Return the decisions of a record in their order.

    An action's life belongs to the decision before its beginning; where later decisions go on with it, its end is that
    of the last of these.

    Args:
        record: The record.
        ensemble: The path of an ensemble, of whose decisions these are; by default all.
    """
    table = _Table(names_of(record))
    wanted = {"decisions", "lives", TRUE_REWARD, TRUE_STATE}
    topics = [each for each in record.topics if each.rpartition("/")[2] in wanted]
    for topic, _, _, message in record.messages(topics):
        if isinstance(message, Decision):
            table.add(message)
        elif isinstance(message, ActionLife):
            table.live(message)
        elif isinstance(message, Reward):
            table.pay(topic.removesuffix(f"/{TRUE_REWARD}"), message)
        elif isinstance(message, State):
            table.true[topic.removesuffix(f"/{TRUE_STATE}")] = message.index
    return [row for row in table.rows if ensemble in {None, row.decision.ensemble}]


class _Table:
    """The rows so far.

    Args:
        names: The names of each ensemble.
    """

    def __init__(self, names: dict[str, Names]) -> None:
        self.rows: list[Row] = []
        self.true: dict[str, int | None] = {}
        self._names = names
        self._latest: dict[str, Row] = {}
        self._before: dict[str, Row] = {}
        self._paid: dict[str, Reward] = {}
        self._lives: dict[tuple[str, int], Row] = {}

    def add(self, decision: Decision) -> None:
        """Take in a decision."""
        ensemble = decision.ensemble
        names = self._names.get(ensemble, Names())
        state, observation = names.state(decision.state), names.observation(decision.observation)
        row = Row(decision, state, observation, self.true.get(ensemble))
        before = self._latest.get(ensemble)
        if before is not None and before.end is None and before.decision.action == decision.action:
            row.life = before.life  # it goes on, and ends with this row
            if row.life is not None:
                self._lives[ensemble, row.life] = row
        if before is not None:
            self._before[ensemble] = before
        self._latest[ensemble] = row
        self.rows.append(row)
        paid = self._paid.pop(ensemble, None)
        if paid is not None and paid.epoch == decision.epoch:
            row.true_reward = paid.value

    def pay(self, ensemble: str, reward: Reward) -> None:
        """Take in what the world pays, which it may before the decision is told, or when the next one replaces it."""
        for row in (self._latest.get(ensemble), self._before.get(ensemble)):
            if row is not None and row.decision.epoch == reward.epoch:
                row.true_reward = (row.true_reward or 0.0) + reward.value
                return
        self._paid[ensemble] = reward

    def live(self, life: ActionLife) -> None:
        """Take in the beginning or the end of an action's life."""
        key = life.ensemble, life.life
        if life.status == "running":
            if life.ensemble in self._latest:
                row = self._lives[key] = self._latest[life.ensemble]
                row.life = life.life
        elif key in self._lives:
            row = self._lives.pop(key)
            row.end, row.ended, row.detail = life.status, life.time, life.detail
