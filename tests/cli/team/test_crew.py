"""Processes of a crew: how they fail, and how they end."""

from __future__ import annotations

import asyncio
import signal
import sys

import pytest
from patience import PATIENCE

from mdm.cli.team import crew as module
from mdm.cli.team.crew import Crew


class Told:
    """A console that keeps what it is told."""

    def __init__(self):
        self.lines = []
        self.events = []
        self.came = asyncio.Event()

    def line(self, agent, stream, text):
        self.lines.append((agent, stream, text))
        self.came.set()

    def record(self, agent, record):
        self.lines.append((agent, "record", record))
        self.came.set()

    def tell(self, agent, event, text, **_):
        self.events.append((agent, event, text))
        self.came.set()

    async def until(self, condition):
        async with asyncio.timeout(PATIENCE):
            while not condition():
                self.came.clear()
                await self.came.wait()


def program(code):
    return [sys.executable, "-u", "-c", code]


UP = 'import sys; print(\'{"event": "running", "actor": "a"}\', file=sys.stderr, flush=True)\n'
OBEDIENT = program("import sys; print('here'); sys.stdin.read()")
STUBBORN = program("import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('here'); time.sleep(600)")


def run(main):
    async def timed():
        async with asyncio.timeout(PATIENCE):
            await main()

    asyncio.run(timed())


def test_processes_end_with_their_input():
    async def main():
        told = Told()
        crew = Crew({"a": OBEDIENT, "b": OBEDIENT}, told, 20.0)
        running = asyncio.create_task(crew.run())
        await told.until(lambda: len(told.lines) == 2)
        crew.end()
        await running
        assert sorted(told.lines) == [("a", "output", "here"), ("b", "output", "here")]
        assert crew.failures == {"a": 0, "b": 0}
        assert told.events == []

    run(main)


def test_what_does_not_end_is_killed():
    async def main():
        told = Told()
        crew = Crew({"a": OBEDIENT, "b": STUBBORN}, told, 0.1)
        running = asyncio.create_task(crew.run())
        await told.until(lambda: len(told.lines) == 2)
        crew.end()
        await running
        assert ("b", "killed", "has not ended in order, and is killed") in told.events
        assert crew.failures == {"a": 0, "b": 1}

    run(main)


def test_a_stopped_process_is_killed_too():
    async def main():
        told = Told()
        crew = Crew({"a": OBEDIENT}, told, 0.1)
        running = asyncio.create_task(crew.run())
        await told.until(lambda: len(told.lines) == 1)
        crew._processes["a"].send_signal(signal.SIGSTOP)
        crew.end()
        await running
        assert crew._processes["a"].returncode == -signal.SIGKILL

    run(main)


def test_what_does_not_end_is_named_while_it_is_waited_for(monkeypatch):
    monkeypatch.setattr(module, "_SILENCE", 0.01)
    monkeypatch.setattr(module, "_AGAIN", 0.01)

    async def main():
        told = Told()
        crew = Crew({"a": OBEDIENT, "b": STUBBORN, "c": OBEDIENT}, told, 50.0)
        running = asyncio.create_task(crew.run())
        await told.until(lambda: len(told.lines) == 3)
        stopped = crew._processes["c"]
        stopped.send_signal(signal.SIGSTOP)
        crew.end()
        for agent, words in (
            ("b", "has not ended yet, and is killed in 50 s"),
            ("c", f": its process is stopped, and goes on with `kill -CONT {stopped.pid}`"),
        ):
            await told.until(
                lambda agent=agent, words=words: any(
                    (one, event) == (agent, "ending") and words in text for one, event, text in told.events
                )
            )
        stopped.send_signal(signal.SIGCONT)
        await told.until(lambda: stopped.returncode is not None)
        assert stopped.returncode == 0
        crew.kill()
        await running

    run(main)


def test_failures_are_waited_for_longer_and_longer(monkeypatch):
    monkeypatch.setattr(module, "_FIRST_WAIT", 0.01)

    async def main():
        told = Told()
        crew = Crew({"a": program(UP + "raise SystemExit(3)"), "b": OBEDIENT}, told, 20.0)
        running = asyncio.create_task(crew.run())
        await told.until(lambda: crew.failures["a"] == 3)
        crew.end()
        await running
        waits = [text for agent, event, text in told.events if event == "failed"]
        assert waits[:3] == [
            f"has failed with status 3, and is started again in {wait:g} s" for wait in (0.01, 0.02, 0.04)
        ]

    run(main)


def test_it_ends_when_all_have_ended():
    async def main():
        told = Told()
        await Crew({"a": program("print('x' * 200000)"), "b": program("")}, told, 20.0).run()
        assert {(agent, event) for agent, event, _ in told.events} == {("a", "ended"), ("b", "ended")}
        assert sum(len(text) for _, _, text in told.lines) == 200000

    run(main)


@pytest.mark.parametrize("seconds", [0.5])
def test_it_ends_after_some_seconds(seconds):
    async def main():
        crew = Crew({"a": OBEDIENT}, Told(), 20.0)
        await crew.run(seconds)
        assert crew._processes["a"].returncode == 0

    run(main)


def test_what_a_cancelled_crew_had_is_killed():
    async def main():
        told = Told()
        crew = Crew({"a": STUBBORN}, told, 20.0)
        running = asyncio.create_task(crew.run())
        await told.until(lambda: len(told.lines) == 1)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        assert await crew._processes["a"].wait() == -signal.SIGKILL

    run(main)


def test_one_that_was_never_up_is_not_started_again_and_the_others_go_on():
    async def main():
        told = Told()
        crew = Crew({"a": program("raise SystemExit(3)"), "b": OBEDIENT}, told, 20.0)
        running = asyncio.create_task(crew.run())
        await told.until(lambda: told.events and len(told.lines) == 1)
        assert told.events == [("a", "failed", "has failed with status 3 before it was up, and is not started again")]
        assert not running.done()
        crew.end()
        await running
        assert crew.failures == {"a": 1, "b": 0}

    run(main)


def test_one_that_fails_again_and_again_is_given_up(monkeypatch):
    monkeypatch.setattr(module, "_FIRST_WAIT", 0.001)

    async def main():
        told = Told()
        crew = Crew({"a": program(UP + "raise SystemExit(3)")}, told, 20.0)
        await crew.run()
        assert crew.failures == {"a": 6}
        assert [text for _, event, text in told.events if event == "failed"][-1] == (
            "has failed with status 3, and is not started again: it was 5 times within 60 s"
        )

    run(main)


def test_all_have_ended_when_none_can_be_started():
    async def main():
        told = Told()
        crew = Crew({"a": program("raise SystemExit(3)"), "b": program("raise SystemExit(3)")}, told, 20.0)
        await crew.run()
        assert crew.failures == {"a": 1, "b": 1}

    run(main)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_one_that_was_asked_to_end_is_not_started_again(monkeypatch, number):
    monkeypatch.setattr(module, "_FIRST_WAIT", 0.01)
    orderly = program(
        f"import signal\nsignal.signal({int(number)}, lambda number, _: exit(128 + number))\n" + UP + "signal.pause()"
    )

    async def main():
        told = Told()
        crew = Crew({"a": orderly, "b": OBEDIENT}, told, 20.0)
        running = asyncio.create_task(crew.run())
        await told.until(lambda: "a" in crew._up and told.lines)
        crew._processes["a"].send_signal(number)
        await told.until(lambda: any(event == "ended" for _, event, _ in told.events))
        assert told.events == [("a", "ended", f"has ended, asked by {number.name}, and is not started again")]
        crew.end()
        await running
        assert crew.failures == {"a": 0, "b": 0}

    run(main)
