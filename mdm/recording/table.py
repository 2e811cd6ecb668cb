"""The decisions of a record as a table, and the names of joint states, observations and actions that it keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_type_hints

import msgspec

from mdm.errors import FormatError
from mdm.messages import ActionLife, Decision, Reward, State
from mdm.stimuli import TRUE_REWARD, TRUE_STATE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.recording.reader import Record

_ENSEMBLE = "ensemble "
"""What the names of metadata begin with that are about an ensemble; its path follows."""


class Names(msgspec.Struct, frozen=True):
    """The names of joint states, observations and actions, by their indices; none where they are not kept.

    Joint states and observations of several factors have a value of each, by its name.
    """

    states: tuple[str, ...] = ()
    observations: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    state_factors: dict[str, tuple[str, ...]] = {}
    observation_factors: dict[str, tuple[str, ...]] = {}

    def state(self, index: int | None) -> str | None:
        """Return the name of a joint state, None where it has none."""
        return _name(self.states, self.state_factors, index)

    def observation(self, given: int | Sequence[int | None] | None) -> str | None:
        """Return the name of a joint observation, or of those of its components that are known; None if it has none."""
        return _name(self.observations, self.observation_factors, given)


def _name(
    names: tuple[str, ...], factors: dict[str, tuple[str, ...]], given: int | Sequence[int | None] | None
) -> str | None:
    if given is None or not factors:
        return names[given] if isinstance(given, int) and 0 <= given < len(names) else None
    places = _places(factors, given) if isinstance(given, int) else list(given)
    if len(places) != len(factors):
        return None
    known = [(factor, place) for factor, place in zip(factors, places, strict=True) if place is not None]
    if not all(0 <= place < len(factors[factor]) for factor, place in known):
        return None
    return ", ".join(f"{factor}={factors[factor][place]}" for factor, place in known) or None


def _places(factors: dict[str, tuple[str, ...]], index: int) -> list[int | None]:
    """Return the place in each factor of a joint index, the last one the least significant; none if it is too large."""
    places: list[int | None] = []
    for symbols in reversed(factors.values()):
        index, place = divmod(index, max(1, len(symbols)))
        places.append(place)
    return [] if index else places[::-1]


_DECODERS: dict[str, msgspec.json.Decoder[Any]] = {
    name: msgspec.json.Decoder(kind) for name, kind in get_type_hints(Names).items()
}


def names_of(record: Record) -> dict[str, Names]:
    """Return the names of all ensembles of a record, by their paths.

    Raises:
        FormatError: If they are not lists of names, by factors or not.
    """
    found = {}
    for metadata, facts in record.metadata.items():
        if metadata.startswith(_ENSEMBLE):
            try:
                kept = {key: decoder.decode(facts[key]) for key, decoder in _DECODERS.items() if key in facts}
            except msgspec.MsgspecError as error:
                raise FormatError(f"the names of {metadata} are not a list: {error}", file=record.path) from None
            found[metadata.removeprefix(_ENSEMBLE)] = Names(**kept)
    return found


class Row(msgspec.Struct):
    """A decision and its consequences.

    Args:
        decision: The decision.
        state: The name of its state, if it has one.
        observation: The name of its observation, likewise.
        true_state: The state of the simulated world by then, None where none is told.
        true_reward: The reward that the simulated world has paid for it, likewise; of several steps the sum.
        life: The number of the action's life that it began, or went on with.
        end: How that life ended, None where it did not, or went on with a later decision.
        ended: When, in nanoseconds.
        detail: The end in words.
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
        """Take in a reward of the world, which may come before its decision, or when the next one replaces that."""
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
