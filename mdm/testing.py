"""Tools for testing programs that use the library: virtual time, probes, replays, and disturbed actors."""

from __future__ import annotations

import sys
import tempfile
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from mdm import replay as replays
from mdm.config.rebuilt import rebuilt_to_compare, replay_team
from mdm.errors import Error
from mdm.recording import Record, records_of
from mdm.runtime import Observer, Runtime, run

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator, Sequence

    from mdm.messages import Decision, Fault
    from mdm.runtime import Actor, Channel, Subscription

__all__ = ["block", "capture_decisions", "crash", "delay", "probe", "replay", "run_virtual"]

T = TypeVar("T")


def run_virtual(main: Callable[[Runtime], Coroutine[Any, Any, T]], **options: Any) -> T:
    """Run a coroutine function in virtual time with its own runtime, and return its result.

    Example::

        async def main(runtime: mdm.Runtime) -> None:
            await runtime.start(robot)
            await asyncio.sleep(60)  # takes no real time

        run_virtual(main)

    Args:
        main: Called with the running runtime.
        options: Options of `Runtime`; by default ``log=None``. The first fault of each source and kind is printed then.
    """
    results: list[T] = []

    async def program() -> T:
        options.setdefault("log", None)
        async with Runtime(**options) as runtime:
            if options["log"] is None:
                runtime.observe(_Faults())
            results.append(await main(runtime))
        return results[0]

    return run(program, virtual=True)


class _Faults(Observer):
    """Prints the first fault of each source and kind on standard error; failed actions the runtime prints itself."""

    def __init__(self) -> None:
        self._printed: set[tuple[str, str]] = set()

    def on_fault(self, fault: Fault) -> None:
        """Print a fault, where it is the first."""
        key = fault.source, fault.kind
        if fault.kind != "action" and key not in self._printed:
            self._printed.add(key)
            sys.stderr.write(f"mdm: {fault.source}: {fault.kind}: {fault.detail}\n")


def probe(channel: Channel[T]) -> list[T]:
    """Return a list to which a channel's messages are appended, beginning with the retained one."""
    messages: list[T] = []
    channel.subscribe(messages.append)
    return messages


@contextmanager
def capture_decisions(runtime: Runtime) -> Iterator[list[Decision]]:
    """Collect all decisions made inside the block.

    Example::

        with capture_decisions(runtime) as decisions:
            battery_is_fine.set(False)
        assert [decision.action_name for decision in decisions] == ["Charge"]
    """
    decisions: list[Decision] = []
    subscription = runtime.decisions.subscribe(decisions.append)
    try:
        yield decisions
    finally:
        subscription.cancel()


def replay(path: str | Path, actors: Actor | Sequence[Actor] | None = None, *, config: str | Path | None = None) -> int:
    """Run a record once more, in virtual time, and see that each decision is the one that was recorded.

    Users' functions are not called. Example::

        def test_the_robot_still_decides_as_it_did_in_the_hall():
            assert replay("hall.mcap", config="robot.toml") > 100

    Args:
        path: The record, or the folder with those of a team's agents, which are then replayed together.
        actors: The system, or the actors at the top, built as for the run and not started. Without them the TOML file
            is loaded that the record has.
        config: A TOML file in place of the record's own.

    Returns:
        How many decisions there are.

    Raises:
        AssertionError: If one of them differs: the first difference, with the input before it; if an agent of a team
            received what the replay of its sender has not sent; or if nothing can be told from some time on of a team
            that has another configuration.
        Error: If the record cannot be replayed: it has no beginning or no configuration, or its model is another one.
    """
    if Path(path).is_dir():
        if actors is not None:
            raise Error("a replay of a team's records takes config, and no actors: each agent has its own")
        return _replay_team(Path(path), config)
    record = Record(path)
    if actors is not None:
        if config is not None:
            raise Error("a replay takes either actors or config, not both")
        result = replays.replay(record, actors, most=1)
    else:
        with tempfile.TemporaryDirectory() as folder:
            run = rebuilt_to_compare(record, folder, config)
            result = replays.replay(record, run.actors, most=1, transports=run.transports)
    _raise_difference(record, result)
    return result.recorded


def _replay_team(folder: Path, config: str | Path | None) -> int:
    records = records_of(folder)
    together = replay_team(records, config, most=1)
    for name, result in together.agents.items():
        _raise_difference(records[name], result)
    for name, result in together.agents.items():
        if result.limit is not None:
            at = (result.limit.time - int(records[name].head["epoch"])) / 1e9
            raise AssertionError(
                f"{records[name].path}: from {at:.6f} s on nothing can be told, for {result.limit.reason}"
            )
    for received in together.unlike:
        raise AssertionError(
            f"{folder}: {received.agent} received {received.key} of {received.owner}, whose replay did not send it"
        )
    return sum(result.recorded for result in together.agents.values())


def _raise_difference(record: Record, result: replays.Replayed) -> None:
    for difference in result.differences:
        raise AssertionError(f"{record.path}: {difference.describe(int(record.head['epoch']))}")


def crash(actor: Actor, error: Exception | None = None) -> None:
    """Make an actor fail, as if one of its handlers had raised an error."""
    actor.fail(Error(f"actor {actor.path!r} was made to crash") if error is None else error)


@contextmanager
def block(actor: Actor) -> Iterator[list[Any]]:
    """Hold back an actor's messages inside the block, and deliver them in order at its end.

    Yields the list of messages held back.
    """
    held: list[Any] = []
    waiting: list[tuple[Subscription[Any], Any]] = []

    def hold(subscription: Subscription[Any], _: Callable[[Any], object], message: Any) -> None:
        held.append(message)
        waiting.append((subscription, message))

    try:
        with _intercepted(actor, hold):
            yield held
    finally:
        for subscription, message in waiting:
            actor.runtime.dispatcher.deliver(subscription, message)


@contextmanager
def delay(actor: Actor, seconds: float) -> Iterator[None]:
    """Delay an actor's messages inside the block by a number of seconds of the runtime's clock."""

    def later(_: Subscription[Any], handler: Callable[[Any], object], message: Any) -> None:
        actor.call_later(seconds, lambda: handler(message))

    with _intercepted(actor, later):
        yield


@contextmanager
def _intercepted(
    actor: Actor, take: Callable[[Subscription[Any], Callable[[Any], object], Any], None]
) -> Iterator[None]:
    originals = [(subscription, subscription.handler) for subscription in actor.subscriptions]
    for subscription, handler in originals:
        subscription.handler = partial(take, subscription, handler)
    try:
        yield
    finally:
        for subscription, handler in originals:
            if subscription in actor.subscriptions:
                subscription.handler = handler
