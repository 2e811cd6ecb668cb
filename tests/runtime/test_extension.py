"""Extensions: opened before actors, closed behind them, past whatever raises."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given, settings, strategies as st

import mdm
from mdm import Actor, Error, Runtime
from mdm.runtime.extension import extension_of
from mdm.testing import run_virtual

ERRORS = [ValueError, MemoryError, RecursionError, mdm.ConfigError]
ALL_ERRORS = [*ERRORS, asyncio.CancelledError, GeneratorExit]


class Noting(mdm.Extension):
    """Notes its life, and raises where it should.

    Args:
        notes: Where.
        name: Its name.
        fails: The errors that its methods raise, by name.
    """

    def __init__(self, notes, name="", **fails):
        self.notes, self.name, self.fails = notes, name, fails

    def _note(self, what):
        self.notes.append((what, self.name))
        if what in self.fails:
            raise self.fails[what](f"{what} fails")

    async def open(self, runtime):
        self.runtime = runtime
        self._note("open")

    async def close(self):
        await asyncio.sleep(0)
        self._note("close")

    def on_change(self, change):
        if change.actor and change.state in {"running", "stopped"}:
            self._note(change.state)

    def on_end(self):
        self._note("end")


def test_they_open_before_actors_and_close_behind_them_in_reverse():
    notes = []
    extensions = [Noting(notes, "first"), Noting(notes, "second")]
    runtimes = []

    async def main(runtime):
        runtimes.append(runtime)
        assert runtime.extensions == tuple(extensions)
        await runtime.start(Actor("robot"))

    run_virtual(main, extensions=extensions)
    assert notes == [
        ("open", "first"),
        ("open", "second"),
        ("running", "first"),
        ("running", "second"),
        ("stopped", "first"),
        ("stopped", "second"),
        ("close", "second"),
        ("close", "first"),
        ("end", "second"),
        ("end", "first"),
    ]
    assert all(each.runtime is runtimes[0] for each in extensions)


def test_they_close_behind_safe_actions():
    notes = []
    robot = mdm.Ensemble(
        "robot",
        policy=mdm.policies.DeterministicPolicy([0], 1),
        actions={"go": lambda: notes.append("go")},
        safe_action=lambda: notes.append("safe"),
    )

    async def main(runtime):
        await runtime.start(robot)
        robot.publish_state(0)

    run_virtual(main, extensions=[Noting(notes)])
    assert [note for note in notes if note in {"go", "safe", ("close", "")}] == ["go", "safe", ("close", "")]


@pytest.mark.parametrize("error", ERRORS)
def test_one_that_cannot_be_opened_ends_the_start_and_others_close(error):
    notes = []
    extensions = [Noting(notes, "first"), Noting(notes, "the link", open=error), Noting(notes, "third")]

    async def main():
        async with Runtime(extensions=extensions, log=False):
            raise AssertionError

    with pytest.raises(Error) as raised:
        mdm.run(main, virtual=True)
    told = "open fails" if error is mdm.ConfigError else f"the link cannot be opened: {error.__name__}: open fails"
    assert str(raised.value).startswith(told)
    assert notes == [("open", "first"), ("open", "the link"), ("close", "first"), ("end", "first")]


@given(st.lists(st.dictionaries(st.sampled_from(["close", "end", "running", "stopped"]), st.sampled_from(ALL_ERRORS))))
@settings(max_examples=40, deadline=None)
def test_those_that_raise_are_told_once_and_all_others_close(fails):
    notes, heard = [], []

    class Listening(mdm.Extension):
        def on_fault(self, fault):
            heard.append(fault)

    async def main(runtime):
        await runtime.start(Actor("robot"))

    extensions = [Noting(notes, f"number {place}", **failing) for place, failing in enumerate(fails)]
    run_virtual(main, extensions=[Listening(), *extensions])
    whole = [(what, each.name) for each in extensions for what in ("open", "running", "stopped", "close", "end")]
    assert sorted(notes) == sorted(whole)
    told = sorted(fault.detail.partition(" has failed")[0] for fault in heard)
    assert {fault.kind for fault in heard} <= {"observer"}
    closing = [each.name for each in extensions if "close" in each.fails]
    others = [each.name for each in extensions if set(each.fails) - {"close"}]
    assert told == sorted(closing + others)  # once each, and once more where it cannot be closed


def test_one_that_does_not_close_is_left_after_its_patience():
    notes, heard = [], []

    class Hanging(Noting):
        patience = 2.0

        async def close(self):
            await asyncio.Event().wait()

        def on_fault(self, fault):
            heard.append((fault.time, fault.detail))

    async def main(runtime):
        await runtime.start(Actor("robot"))

    run_virtual(main, extensions=[Noting(notes, "first"), Hanging(notes, "the link")])
    assert ("close", "first") in notes
    ((time, detail),) = heard
    assert time == 2_000_000_000
    assert detail.startswith("the link has failed: it is not closed after 2 s, and left so")


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_what_ends_a_program_in_a_close_is_raised_behind_the_others(error):
    notes = []

    async def main(runtime):
        await runtime.start(Actor("robot"))

    with pytest.raises(error):
        run_virtual(main, extensions=[Noting(notes, "first"), Noting(notes, "second", close=error)])
    assert notes.index(("close", "second")) < notes.index(("close", "first"))


def test_an_extension_is_of_one_runtime_and_given_once():
    extension = Noting([], "the link")
    with pytest.raises(Error, match="the link is given twice: an extension is opened once"):
        Runtime(extensions=[extension, extension])

    async def main():
        async with Runtime(extensions=[extension], log=False):
            with pytest.raises(Error, match="the link is open in a runtime: an extension lives as long as one"):
                async with Runtime(extensions=[extension], log=False, clock=mdm.VirtualClock()):
                    raise AssertionError
        async with Runtime(extensions=[extension], log=False):
            pass

    mdm.run(main, virtual=True)


def test_an_open_that_is_not_async_is_refused():
    class Plain(mdm.Extension):
        def open(self, runtime):
            pass

    async def main(runtime):
        raise AssertionError

    with pytest.raises(Error, match="Plain cannot be opened: its open is no async function"):
        run_virtual(main, extensions=[Plain()])


def test_what_is_no_extension_is_refused():
    with pytest.raises(Error, match="extensions are a list of such objects, not 3"):
        Runtime(extensions=3)
    with pytest.raises(Error, match="extensions are objects of a class derived from mdm.Extension, not 3"):
        Runtime(extensions=[3])


def test_an_option_that_nobody_takes_is_refused():
    with pytest.raises(Error, match="nothing is installed that takes the option 'ros' of a runtime"):
        extension_of("ros", 1)
