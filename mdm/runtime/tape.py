"""The tape: where a runtime and its actors note what a record keeps, within the turn and at the least cost.

Nothing here is encoded or written: whoever sets a tape sees to that, between turns. Where there is none, which is the
default, each place that would note something looks at one attribute.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.messages import Tick
    from mdm.runtime.channel import Channel
    from mdm.runtime.time.scheduler import Ticker
    from mdm.runtime.work import Work

__all__ = ["Acting", "Deciding", "Kept", "Tape"]

Kept = tuple[dict[str, "bool | None"], dict[str, int]]
"""The values that sensors told before a start, and when, in nanoseconds, where that is known."""


class Symbols(Protocol):
    """The names of states, actions and observations, where there are some."""

    @property
    def state_space(self) -> Names | None:
        """The states."""

    @property
    def action_space(self) -> Names | None:
        """The actions."""

    @property
    def observation_space(self) -> Names | None:
        """The observations."""


class Names(Protocol):
    """Symbols with names."""

    def __len__(self) -> int:
        """How many there are."""

    @property
    def names(self) -> Sequence[str]:
        """By index."""


class Acting(Protocol):
    """An action layer, as a tape knows it."""

    @property
    def calls(self) -> int:
        """The number of the life whose function is being called; 0 where none is."""


class Deciding(Protocol):
    """Where an ensemble's decisions are published, as a tape knows it.

    Attributes:
        factor_names: The names of values by factor, of ``state`` and ``observation``, where its symbols have none.
    """

    factor_names: dict[str, dict[str, tuple[str, ...]]]

    @property
    def ensemble(self) -> str:
        """The ensemble's path."""

    @property
    def configuration(self) -> str:
        """The digest of its model, policy and options."""

    def digests(self) -> dict[str, str]:
        """Return the digests of its model, its policy and its options, each by itself."""

    @property
    def symbols(self) -> Symbols:
        """The names of its states, actions and observations."""

    @property
    def draws(self) -> str:
        """The state of the random numbers by which its policy draws actions; empty where it does not."""

    def draw_from(self, draws: str) -> None:
        """Have the policy draw on from that state."""

    def name_of(self, action: int) -> str:
        """Return the name of an action."""

    def belief_of(self, current: Any) -> Any:
        """Return an information state as a belief, of S numbers; None where it is none."""


class Tape(Protocol):
    """Notes stimuli, and what was decided and done on them; all in the event loop's thread.

    Attributes:
        repeats: Whether a run is repeated from a record: what users' code and other processes did is in it.
    """

    repeats: bool

    # -- Stimuli -------------------------------------------------------------------------------------------------

    def said(self, channel: Channel[Any], message: Any, time: int) -> None:
        """A message was published on a channel of input, in the turn of a time or as the beginning of it."""

    async def comes(self, actor: str, step: str) -> None:
        """An actor is about to come to a step of its life: ``start``, ``run``, ``stop`` or ``end``."""

    def came(self, actor: str, step: str, time: int) -> None:
        """An actor has come to a step of its life."""

    def failed(self, actor: str, error: str, time: int) -> None:
        """An actor has failed, by itself or with another."""

    def kept(self, actor: str, values: dict[str, bool | None], times: dict[str, int], time: int) -> Kept:
        """Return the values that sensors told a predicate manager before it starts: those given, or the record's."""

    def counts_from(self, actor: str, time: int, begin: int) -> int:
        """Return when a delay begins that an actor asks for in the turn of a time: then, or as the record has it."""

    def place(self) -> int:
        """Return how far the run has come, by what was published."""

    def cut(self, time: int) -> None:
        """The turn of a time was cut short: other input comes before it goes on."""

    def resumed(self, time: int, *, starved: bool) -> None:
        """The turn that is cut goes on at a time; by then other input may have waited for too long."""

    def rates(self, actor: str, rate: float, ticker: Ticker) -> None:
        """An actor is to tick, so many times a second."""

    def ticked(self, actor: str, rate: float, tick: Tick) -> None:
        """An actor ticks."""

    def finishes(self, time: int) -> None:
        """The runtime begins to end."""

    def note(self, stimulus: Any) -> None:
        """A stimulus of another kind has come, such as a message of a teammate: one of `mdm.recording.stimuli`."""

    # -- Actions -------------------------------------------------------------------------------------------------

    def acts(self, ensemble: str, layer: Acting) -> None:
        """An action layer has started."""

    def lasts(self, ensemble: str, life: int, work: Work) -> None:
        """The function of a life has returned an awaitable, which runs as work."""

    def ended(self, ensemble: str, life: int, work: Work, time: int) -> None:
        """The work of a life has ended."""

    def raised(self, ensemble: str, life: int, error: str, time: int, *, unrun: bool) -> None:
        """The function of a life has raised, or returned something of which nothing has run."""

    def goes_on(self, ensemble: str, epoch: int, time: int, ask: Callable[[], bool]) -> bool:
        """Return whether a running action that is chosen again goes on: as its function says, or as the record does."""

    def over(self, ensemble: str, epoch: int, time: int, over: bool) -> bool:
        """Return whether the task that a decision meets is over, and its end on the way: as given, or as recorded."""

    def lived(self, ensemble: str, life: int, action: str, status: str, detail: str, time: int) -> None:
        """A life has begun or ended."""

    def called(self, ensemble: str, life: int, action: str, time: int) -> None:
        """A plain function has been called, and has succeeded: a whole life."""

    # -- Decisions -----------------------------------------------------------------------------------------------

    def controls(self, output: Deciding) -> None:
        """An ensemble's control layer has started."""

    def latency(self, ensemble: str, epoch: int, time: int, latency: int, limit: int) -> int:
        """Return how late a decision with a deadline is, in nanoseconds: so much, or as the record says."""

    def decided(
        self,
        output: Deciding,
        time: int,
        epoch: int,
        cause: str,
        state: int | None,
        observation: Any,
        current: Any,
        action: int,
        reward: float | None,
    ) -> None:
        """An ensemble has decided, on a state, or on an information state that may be a belief."""
