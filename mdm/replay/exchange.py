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

    def _known(self) -> Iterable[Received]:
        for agent, received in self._received:
            life = received.owner, received.incarnation
            if received.owner != agent and life in self._sent and received.sent < self._until[life]:
                yield received
