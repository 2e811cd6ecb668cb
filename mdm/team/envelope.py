"""The envelope of each message: who sent it, in which life, which number it has under its key, and in which form.

A receiver hands on what is whole, of a form that it knows, under a key of its sender, of the sender's present life, and
newer than the last of its key. What is not is refused by its kind.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.team.keys import owner_of
from mdm.team.transport import Sample

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["LARGEST", "VERSION", "Packer", "Refusal", "Unpacker"]

VERSION = 1
"""The form of envelopes and bodies that this program speaks; it grows when an older program could not read a newer."""

LARGEST = 1 << 20
"""The largest message in bytes, unless told otherwise."""

_MAGIC = b"mD"
_HEADER = struct.Struct("<2sHQQqB")  # magic, version, incarnation, number, time, bytes of the owner's name
_MOST_KEYS = 4096


class Refusal(Exception):
    """Why a message is not handed on.

    Args:
        kind: One word, as counted in `TransportStatistics.dropped`.
        reason: A sentence.
    """

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind


class Packer:
    """Puts the messages of an agent in envelopes, numbered from 1 under each key.

    Args:
        owner: The agent.
        incarnation: Which life of it.
        now: The time in nanoseconds.
        version: The form of the bodies.
    """

    def __init__(self, owner: str, incarnation: int, now: Callable[[], int], *, version: int = VERSION) -> None:
        self._name = owner.encode()
        self._incarnation = incarnation
        self._version = version
        self._now = now
        self._numbers: dict[str, int] = {}

    def pack(self, key: str, body: bytes) -> bytes:
        """Return the next message under a key."""
        number = self._numbers[key] = self._numbers.get(key, 0) + 1
        return self._pack(number, body)

    def size(self, body: bytes) -> int:
        """Return the bytes of a message with its envelope."""
        return _HEADER.size + len(self._name) + len(body)

    def seal(self, body: bytes) -> bytes:
        """Return a message without a number: a question or an answer."""
        return self._pack(0, body)

    def _pack(self, number: int, body: bytes) -> bytes:
        name = self._name
        header = _HEADER.pack(_MAGIC, self._version, self._incarnation, number, self._now(), len(name))
        return header + name + body


class Unpacker:
    """Takes the messages of others out of their envelopes, and refuses what must not be handed on.

    Args:
        team: Whose keys.
        largest: The largest message in bytes.
        missing: Called with a key and the number of its messages that were lost before the one that came.
    """

    def __init__(self, team: str, missing: Callable[[str, int], None], *, largest: int = LARGEST) -> None:
        self.largest = largest
        self._team = team
        self._missing = missing
        self._present: dict[str, int] = {}
        self._last: dict[str, tuple[int, int]] = {}
        self._excused: dict[str, int] = {}

    def present(self, owner: str, incarnation: int) -> None:
        """Take this for the present life of an agent, because it is seen to live; what other lives sent is stale."""
        self._present[owner] = incarnation

    def excuse(self, key: str, count: int) -> None:
        """Do not miss so many messages under a key: they came, and were superseded."""
        if key in self._last:
            self._excused[key] = self._excused.get(key, 0) + count

    def unpack(self, key: str, data: bytes) -> Sample:
        """Return the message under a key.

        Raises:
            Refusal: If it must not be handed on.
        """
        owner, incarnation, number, time, body = _open(key, data, self.largest)
        if owner != owner_of(key, self._team):
            raise Refusal("foreign", f"agent {owner!r} sent under {key}, where it is not the owner")
        present = self._present.get(owner, 0)
        if incarnation != present:
            if incarnation < present:
                raise Refusal("stale", f"a message under {key} is of an earlier life of agent {owner!r}")
            self._present[owner] = incarnation
        last = self._last.get(key)
        if last is None:
            if len(self._last) >= _MOST_KEYS:
                oldest = next(iter(self._last))
                del self._last[oldest]
                self._excused.pop(oldest, None)
        elif last[0] == incarnation:
            missed = number - last[1] - 1
            if missed < 0:
                raise Refusal("repeated", f"a message under {key} came again, or after a newer one")
            if missed:
                missed -= self._excused.pop(key, 0)
                if missed > 0:
                    self._missing(key, missed)
        self._last[key] = (incarnation, number)
        return Sample(key, owner, incarnation, body, time)

    def unseal(self, key: str, data: bytes, *, of_owner: bool) -> Sample:
        """Return a question or an answer; an answer is of the owner of the key.

        Raises:
            Refusal: If it must not be handed on.
        """
        owner, incarnation, _, time, body = _open(key, data, self.largest)
        if of_owner and owner != owner_of(key, self._team):
            raise Refusal("foreign", f"agent {owner!r} answered under {key}, where it is not the owner")
        return Sample(key, owner, incarnation, body, time)


def check_size(key: str, data: bytes, largest: int) -> None:
    """Refuse to send what every receiver would drop.

    Raises:
        Error: If it is larger than the limit.
    """
    if len(data) > largest:
        raise Error(f"a message under {key} has {len(data):,} bytes, and at most {largest:,} are taken")


def _open(key: str, data: bytes, largest: int) -> tuple[str, int, int, int, bytes]:
    if len(data) > largest:
        raise Refusal("oversize", f"a message under {key} has {len(data):,} bytes, and at most {largest:,} are taken")
    try:
        magic, version, incarnation, number, time, length = _HEADER.unpack_from(data)
    except struct.error:
        raise Refusal("malformed", f"a message under {key} is shorter than an envelope") from None
    if magic != _MAGIC:
        raise Refusal("malformed", f"a message under {key} is not of this program")
    if version != VERSION:
        raise Refusal(
            "version", f"a message under {key} is of version {version}, and this program reads version {VERSION}"
        )
    end = _HEADER.size + length
    try:
        owner = data[_HEADER.size : end].decode()
    except UnicodeDecodeError:
        raise Refusal("malformed", f"a message under {key} names no owner") from None
    return owner, incarnation, number, time, data[end:]
