"""A lookout on one ensemble that runs: what it has observed, how long its actions take, and what looks odd of it.

It hears the lives of actions, which are rare, and looks between turns at all else, so that no decision pays for it. Its
memory is bounded.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, Any

from mdm.messages import Observation
from mdm.snapshots.observations import HISTORY, most_frequent, observed
from mdm.snapshots.oddities import KEPT, SEEN, WINDOW, Ended, Seen, lasting, likeliest, repeated, unmoved

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.actors import Ensemble, EnsembleStatus
    from mdm.messages import ActionLife

__all__ = ["Lookout"]

_EVERY = 0.5
"""Seconds between two looks for oddities."""
_KINDS = 1_000
"""Observations that are counted each."""


class Lookout:
    """Looks at an ensemble again and again.

    Args:
        ensemble: The ensemble.
        seconds: Of a time in nanoseconds, the seconds since the run's second 0.
        tell: Told when something begins to look odd, and when it has ceased, by the second, the rule, ``odd`` or
            ``over``, the number of the spell, and the words. Each is a new spell when it was over for `WINDOW` seconds.

    Attributes:
        odd: What looked odd at the last look, in words.
    """

    def __init__(
        self,
        ensemble: Ensemble,
        seconds: Callable[[int], float],
        tell: Callable[[float, str, str, int, str], object] = lambda *_: None,
    ) -> None:
        self.odd: tuple[str, ...] = ()
        self._tell = tell
        self._spells: dict[tuple[str, int | str], tuple[int, float]] = {}
        self._told = 0
        self._ensemble = ensemble
        self._seconds = seconds
        believes = ensemble.controller.takes != "state"
        self._observations = ensemble.channel("observation", Observation) if believes else None
        self._last: Any = None
        self._history: deque[tuple[float, Any]] = deque(maxlen=HISTORY)
        self._tally: Counter[Any] = Counter()
        self._begun: dict[int, int] = {}
        self._ended: deque[Ended] = deque(maxlen=KEPT)
        self._repeats: deque[tuple[float, int, int | None]] = deque(maxlen=round(WINDOW / _EVERY) + 1)
        self._seen: deque[Seen] = deque(maxlen=SEEN)

    def hear(self, life: ActionLife) -> None:
        """Take that an action has begun or ended."""
        if life.status == "running":
            self._begun[life.life] = life.time
        elif (begun := self._begun.pop(life.life, None)) is not None:
            self._ended.append(Ended(life.action, (life.time - begun) / 1e9, life.status))

    def observe(self) -> None:
        """Take the last observation, if it is a new one."""
        if self._observations is None:
            return
        last: Any = self._observations.last
        if last is None or last is self._last:
            return
        self._last = last
        symbol = tuple(last.values) if last.index is None else last.index
        time = self._seconds(last.time)
        self._history.append((time, symbol))
        if symbol in self._tally or len(self._tally) < _KINDS:
            self._tally[symbol] += 1
        current = self._ensemble.controller.decided_by
        found = likeliest(current)
        if found is not None:
            self._seen.append(Seen(time, symbol, *found))

    def look(self, now: float, status: EnsembleStatus) -> tuple[str, ...]:
        """Return what looks odd, in words; looked for anew where that is half a second ago.

        Args:
            now: Seconds since the run's second 0.
            status: How the ensemble is.
        """
        if self._repeats and now - self._repeats[-1][0] < _EVERY:
            return self.odd
        if self._repeats and self._repeats[-1][2] != status.action:
            self._repeats.clear()
        self._repeats.append((now, status.repeats, status.action))
        while now - self._repeats[0][0] > WINDOW:
            self._repeats.popleft()
        found = [each for each in self._found(now, status.action_name) if each[1]] if status.mode == "deciding" else []
        self.odd = tuple([text for _, text in found])
        self._tell_spells(now, dict(found))
        return self.odd

    def _tell_spells(self, now: float, found: dict[tuple[str, int | str], str]) -> None:
        for key, text in found.items():
            if key not in self._spells:
                self._told += 1
                self._tell(now, key[0], "odd", self._told, text)
                self._spells[key] = self._told, now
            number, _ = self._spells[key]
            self._spells[key] = number, now
        for key, (number, last) in [*self._spells.items()]:
            if now - last > WINDOW:
                del self._spells[key]
                self._tell(last, key[0], "over", number, "")

    def _found(self, now: float, action: str) -> list[tuple[tuple[str, int | str], str]]:
        """Return what may look odd, in words, by the rule and by the life or the action that it is of."""
        ensemble = self._ensemble
        found: list[tuple[tuple[str, int | str], str]] = []
        times = self._repeats[-1][1] - self._repeats[0][1]
        if times:
            found.append((("repeated", action), repeated(action, times)))
        for life in ensemble.action.lives.living:
            if not life.secures and life.binding.ensemble is None:
                since = self._seconds(life.action.time)
                found.append((("lasting", life.number), lasting(life.name, now - since, self._ended)))
        if self._seen and now - self._seen[-1].time < WINDOW:
            found.append((("unmoved", ""), unmoved(self._seen, self._name, self._state)))
        return found

    @property
    def history(self) -> tuple[tuple[float, str], ...]:
        """The last observations that were seen, with their times in seconds."""
        return tuple([(time, self._name(symbol)) for time, symbol in self._history])

    @property
    def ended(self) -> Ended | None:
        """The life of an action that ended last; None where there was none."""
        return self._ended[-1] if self._ended else None

    @property
    def latest(self) -> str:
        """The last observation that was seen; empty where there was none."""
        return self._name(self._history[-1][1]) if self._history else ""

    @property
    def tally(self) -> tuple[tuple[str, int], ...]:
        """How often each observation was seen, the most frequent ones."""
        return most_frequent({self._name(symbol): count for symbol, count in self._tally.items()})

    def _name(self, symbol: Any) -> str:
        return observed(self._ensemble.controller.symbols.observation_space, symbol) or str(symbol)

    def _state(self, state: int) -> str:
        space = self._ensemble.controller.symbols.state_space
        return str(state) if space is None else space.names[state]
