"""The lives of one agent's actions, as a state machine: which live, which is pending, which may begin.

Events are its methods; each returns the orders that the action layer carries out, in their order. It knows no actor, no
clock, no task and no event loop: how a life is carried out, and how long that takes, is the layer's.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.actors.actions.binding import Binding
    from mdm.messages import Action, ActionStatus


class Gate(Enum):
    """Whether anything may begin.

    Attributes:
        CLOSED: Nothing may.
        OPEN: Decided actions may.
        SAFE: The safe action alone: it is due when nothing lives, or runs.
        FAILED: Nothing, until it is known whether the safe action, which has failed, runs once more.
    """

    CLOSED = "closed"
    OPEN = "open"
    SAFE = "safe"
    FAILED = "failed"


class Part(Enum):
    """The agent's part in the decided actions.

    Attributes:
        OWN: It carries them out.
        BARRED: It begins none for now; running lives go on, and the safe action runs when due.
        DELEGATED: Other agents carry out all of them, and the safe action, too; for good.
    """

    OWN = "own"
    BARRED = "barred"
    DELEGATED = "delegated"


class Order(Enum):
    """An order to the action layer about a life.

    Attributes:
        BEGIN: Begin it.
        CANCEL: Ask it to end; `Lives.end` is called when it has.
        REPLACE: Tell that it has ended as ``preempted``: another one of its group begins in its place.
        CANCEL_BEHIND: Ask it to end behind the first step of the one that has replaced it.
        CANCEL_NOW: Ask it to end now, where that was put off.
    """

    BEGIN = "begin"
    CANCEL = "cancel"
    REPLACE = "replace"
    CANCEL_BEHIND = "cancel behind"
    CANCEL_NOW = "cancel now"


class Life:
    """One run of one action.

    Args:
        name: The action's.
        binding: Its action's: the same of all its lives.
        action: The decision.
        secures: Whether it is the safe action's.

    Attributes:
        number: Counted from 1 on by the order in which they begin; 0 before it has begun.
        ending: How it was asked to end; None where it was not.
    """

    __slots__ = ("action", "binding", "ending", "name", "number", "secures")

    def __init__(self, name: str, binding: Binding, action: Action, *, secures: bool = False) -> None:
        self.name = name
        self.binding = binding
        self.action = action
        self.secures = secures
        self.number = 0
        self.ending: ActionStatus | None = None


L = TypeVar("L", bound=Life)

Orders = tuple[tuple[Order, L], ...]


class Lives(Generic[L]):
    """The state machine of one action layer.

    Attributes:
        gate: Whether anything may begin.
        part: This agent's part in what is decided.
        open: Whether a decided action may begin now: the gate is open, and they are this agent's own.
        calling: Whether the function of a life is being called, so that nothing else may begin.
        current: The life that the next decision replaces.
        pending: The one that begins when that has ended.
        beside: Lives of concurrent actions, by name.
        behind: Those that begin when the life of the same concurrent action has ended, by name.
        replaced: Lives that others of their group have replaced, and that have not ended yet.
        left: Abandoned lives that still run.
        skipped: Decisions that were overtaken before their action began.
    """

    __slots__ = (
        "behind",
        "beside",
        "calling",
        "current",
        "gate",
        "left",
        "open",
        "part",
        "pending",
        "replaced",
        "skipped",
    )

    def __init__(self) -> None:
        self.gate = Gate.CLOSED
        self.part = Part.OWN
        self.open = self.calling = False
        self.current: L | None = None
        self.pending: L | None = None
        self.beside: dict[str, L] = {}
        self.behind: dict[str, L] = {}
        self.replaced: list[L] = []
        self.left: list[L] = []
        self.skipped = 0

    @property
    def living(self) -> tuple[L, ...]:
        """All lives that have begun and not ended, but for abandoned ones."""
        return (*self.replaced, *self.beside.values(), *(() if self.current is None else (self.current,)))

    @property
    def quiet(self) -> bool:
        """Whether nothing lives or is pending, and the safe action is not due."""
        waits = self.waits or self.gate in {Gate.SAFE, Gate.FAILED}
        return not (waits or self.current is not None or self.beside or self.replaced)

    @property
    def waits(self) -> bool:
        """Whether something was decided that begins when another life has ended."""
        return self.pending is not None or bool(self.behind)

    # -- The gate ------------------------------------------------------------------------------------------------

    def restart(self) -> None:
        """Begin a life of the layer: nothing may begin in it yet."""
        self._take(Part.OWN)
        self._set(Gate.CLOSED)

    def admit(self) -> None:
        """Open the gate to decided actions."""
        self._set(Gate.OPEN)

    def bar(self, *, barred: bool) -> None:
        """Bar decided actions, or admit them again; running lives go on, and the safe action runs when due."""
        self._take(Part.BARRED if barred else Part.OWN)
        if barred:
            self._discard()

    def delegate(self) -> None:
        """Leave all that is decided to other agents, for good."""
        self._take(Part.DELEGATED)

    def latch(self) -> Orders[L]:
        """Let no decided action begin, and discard the pending life; running lives go on, but for replaced ones."""
        if self.gate is Gate.OPEN:
            self._set(Gate.CLOSED)
        self._discard()
        return tuple([(Order.CANCEL_NOW, life) for life in self.replaced])

    def halt(self) -> Orders[L]:
        """As `latch`, and cancel all lives but the safe action's."""
        return (*self.latch(), *self.cancel_all())

    def secure(self) -> Orders[L]:
        """As `halt`; the safe action begins when nothing lives."""
        orders = self.latch()
        self._set(Gate.SAFE)
        return (*orders, *self.cancel_all())

    def secured(self, *, failed: bool) -> bool:
        """Take the end of the safe action; return whether it was due."""
        due = self.gate is Gate.SAFE
        if due:
            self._set(Gate.FAILED if failed else Gate.CLOSED)
        return due

    def give_up(self) -> None:
        """Close the gate: the safe action, which has failed, does not run again."""
        if self.gate is Gate.FAILED:
            self._set(Gate.CLOSED)

    def _discard(self) -> None:
        self.pending = None
        self.behind.clear()

    def _take(self, part: Part) -> None:
        if self.part is not Part.DELEGATED:
            self.part = part
        self._set(self.gate)

    def _set(self, gate: Gate) -> None:
        self.gate = gate
        self.open = gate is Gate.OPEN and self.part is Part.OWN

    # -- Choosing ------------------------------------------------------------------------------------------------

    def met_by(self, life: L) -> L | None:
        """Return the life that goes on, is replaced or is waited for where another one is chosen, if any."""
        return self.beside.get(life.name) if life.binding.concurrent else self.current

    def choose(self, life: L, goes_on: Callable[[], bool], *, own: bool) -> Orders[L]:
        """An action was decided, while decided actions may begin.

        Args:
            life: The one that it would begin.
            goes_on: Asked where the same action lives already: whether that life goes on in its place.
            own: Whether the life that it meets has perhaps taken its last step: its own task has brought the decision
                about, as by an event that it raises, or is over. The decision is then to begin it once more.
        """
        current = self.current
        if life.binding.concurrent:
            return self._choose_beside(life, goes_on, own=own)
        if current is not None and current.binding is life.binding and current.ending is None and goes_on():
            self.pending = life if own else None
            return ()
        if self.pending is not None:
            self.pending = None
            self.skipped += 1
        if current is None:
            if self._is_free_for(life):
                return ((Order.BEGIN, life),)
        elif current.binding.ensemble is None and current.ending is None and not own and _same_group(current, life):
            current.ending = "preempted"
            self.current = None
            self.replaced.append(current)
            return ((Order.REPLACE, current), (Order.BEGIN, life), (Order.CANCEL_BEHIND, current))
        self.pending = life
        return () if current is None else self.cancel(current, "preempted")

    def _choose_beside(self, life: L, goes_on: Callable[[], bool], *, own: bool) -> Orders[L]:
        beside = self.beside.get(life.name)
        if beside is None:
            return ((Order.BEGIN, life),)
        waiting = self.behind.pop(life.name, None)
        if beside.ending is None and goes_on():
            if own:
                self.behind[life.name] = life
            return ()
        self.skipped += waiting is not None
        self.behind[life.name] = life
        return self.cancel(beside, "preempted")

    def _is_free_for(self, life: L) -> bool:
        """Whether none but those of its own group still come to their end, having been replaced."""
        return all(replaced.binding.group == life.binding.group for replaced in self.replaced)

    # -- Lives ---------------------------------------------------------------------------------------------------

    def keep(self, life: L) -> None:
        """A life lasts: it goes on behind the call that began it."""
        if life.binding.concurrent and not life.secures:
            self.beside[life.name] = life
        else:
            self.current = life

    def cancel(self, life: L, ending: ActionStatus) -> Orders[L]:
        """A life is to end; how it has ended is known when it has."""
        if life.ending is not None:
            return ()
        life.ending = ending
        return ((Order.CANCEL, life),)

    def cancel_all(self, *, but: Callable[[L], bool] = lambda _: False) -> Orders[L]:
        """All are to end, but the safe action, and those that are left out."""
        ending = [life for life in self.living if not life.secures and not but(life)]
        return tuple([order for life in ending for order in self.cancel(life, "preempted")])

    def end(self, life: L) -> bool:
        """A life has ended; return whether it was live: an abandoned one may end all the same."""
        if life in self.replaced:
            self.replaced.remove(life)
        elif self.current is life:
            self.current = None
        elif self.beside.get(life.name) is life:
            del self.beside[life.name]
        else:
            return False
        return True

    def leave(self, life: L) -> None:
        """A life is abandoned: it counts as ended, and still runs."""
        self.left.append(life)

    def forget(self, life: L) -> None:
        """An abandoned life has ended at last."""
        if life in self.left:
            self.left.remove(life)

    def itself(self, life: L) -> L | None:
        """Return the abandoned life of the same action that still runs: none is begun beside itself."""
        return next((left for left in self.left if left.binding is life.binding or left.name == life.name), None)

    @property
    def safe_action_is_due(self) -> bool:
        """Whether the safe action is to begin now."""
        return self.gate is Gate.SAFE and not (self.calling or self.living)

    def next(self) -> L | None:
        """Return a life that waits and may begin now; it waits no more."""
        if self.calling:
            return None
        life = self.pending
        if life is not None and self.current is None and self._is_free_for(life):
            self.pending = None
            return life
        name = next((name for name in self.behind if name not in self.beside), None)
        return None if name is None else self.behind.pop(name)


def _same_group(one: Life, other: Life) -> bool:
    return one.binding.group is not None and one.binding.group == other.binding.group
