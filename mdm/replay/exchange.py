"""What the agents of a team have told each other: each message that one received, another's replay must have sent."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.recording.stimuli import Received

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mdm.recording import Record
    from mdm.replay.transport import ReplayTransport

__all__ = ["Exchange"]


class Exchange:
    """The messages between agents whose records are replayed one by one."""

    def __init__(self) -> None:
        self._sent: dict[tuple[str, int], set[tuple[str, bytes]]] = {}
        self._keys: dict[tuple[str, int], set[str]] = {}
        self._until: dict[tuple[str, int], int] = {}
        self._received: list[tuple[str, Received]] = []

    def add(self, record: Record, transports: Mapping[str, ReplayTransport]) -> None:
        """Add a record, of whose agents the replay has gone through these transports."""
        last = 0
        for each in record.messages(["stimuli"]):
            last = max(last, each.message.time)
            if isinstance(each.message, Received):
                self._received.append((each.message.agent, each.message))
        for agent, transport in transports.items():
            self._sent[agent, transport.incarnation] = set(transport.sent)
            self._keys[agent, transport.incarnation] = {key for key, _ in transport.sent}
            self._until[agent, transport.incarnation] = last

    @property
    def compared(self) -> int:
        """How many messages an agent has received from one that was replayed, too, as long as its record goes."""
        return sum(1 for _ in self._known())

    def unlike(self) -> list[Received]:
        """Return what was received, and never sent in the replay of its sender."""
        return [
            received
            for received in self._known()
            if (received.key, bytes(received.body)) not in self._sent[received.owner, received.incarnation]
        ]

    @property
    def unrepeated(self) -> int:
        """How many messages are of keys under which the replay of their sender sends nothing: what users' code does."""
        return sum(1 for received in self._from_replayed() if received.key not in self._keys[_life_of(received)])

    def _known(self) -> Iterable[Received]:
        return (received for received in self._from_replayed() if received.key in self._keys[_life_of(received)])

    def _from_replayed(self) -> Iterable[Received]:
        for agent, received in self._received:
            life = _life_of(received)
            if received.owner != agent and life in self._sent and received.sent < self._until[life]:
                yield received


def _life_of(received: Received) -> tuple[str, int]:
    return received.owner, received.incarnation
