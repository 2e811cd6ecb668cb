"""Sharing: actors that belong to the runtime, and live as long as another one uses them."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from mdm.errors import Error

if TYPE_CHECKING:
    from mdm.runtime.actor import Actor

__all__ = ["Sharing"]


class _Loan:
    """Who uses an actor, the path that it lives at, and a lock, since its start and its stop take time."""

    __slots__ = ("lock", "place", "users")

    def __init__(self, place: str) -> None:
        self.place = place
        self.lock = asyncio.Lock()
        self.users: dict[Actor, None] = {}


class Sharing:
    """Starts actors for their first user, ahead of it, and stops them behind the last.

    An actor that has a parent already, or that a program has started itself, is left alone.

    Args:
        root: The parent of those that are shared.
    """

    def __init__(self, root: Actor) -> None:
        self._root = root
        self._loans: dict[Actor, _Loan] = {}

    def users(self, actor: Actor) -> tuple[Actor, ...]:
        """Return who uses an actor: its failure is theirs."""
        loan = self._loans.get(actor)
        return () if loan is None else tuple(loan.users)

    def reserve(self, actor: Actor, user: Actor) -> str:
        """Register a user; return the prefix of the actor's path: the path of its first user.

        Raises:
            Error: If it lives in another runtime, whose channels its user does not hear.
        """
        loan = self._loans.get(actor)
        if loan is None:
            if actor.parent is not None:
                if actor.life != "created" and actor.runtime is not user.runtime:
                    raise Error(
                        f"actor {user.path!r} cannot use {actor.path!r}, for {actor.path!r} lives in another runtime: "
                        "give each runtime one of its own"
                    )
                return ""
            loan = self._loans[actor] = _Loan(user.path)
        loan.users[user] = None
        return loan.place

    async def lend(self, actor: Actor) -> None:
        """Have an actor live for those who reserved it; an error of its start is raised here."""
        loan = self._loans.get(actor)
        if loan is None:
            return
        async with loan.lock:
            ended = actor.life == "stopped" or (actor.failing and actor.life != "restarting")
            if ended and actor.parent is self._root:
                await self._root.stop_child(actor)  # forget it: those who used it have yet to end
            if actor.parent is None:
                await self._root.start_child(actor, first=True, at=loan.place)

    async def give_back(self, actor: Actor, user: Actor) -> None:
        """Stop an actor if nobody uses it any more."""
        loan = self._loans.get(actor)
        if loan is None or user not in loan.users:
            return
        del loan.users[user]
        async with loan.lock:
            if loan.users:
                return
            if actor.parent is self._root:
                await self._root.stop_child(actor)
            if not loan.users and self._loans.get(actor) is loan:
                del self._loans[actor]
