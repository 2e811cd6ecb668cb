"""Functions that a turn would call without running them are refused where they are given."""

from __future__ import annotations

from contextlib import asynccontextmanager, contextmanager
from functools import partial

import pytest
from sentences import refused

from mdm import Actor, Error, PredicateManager
from mdm.messages import State
from mdm.runtime.handler import check_plain
from mdm.testing import run_virtual


async def is_async(_=None):
    pass


async def generates_later(_=None):
    yield


def generates(_=None):
    yield


@contextmanager
def holds(_=None):
    yield


@asynccontextmanager
async def holds_later(_=None):
    yield


class Callable:
    async def __call__(self, _=None):
        pass

    async def method(self, _=None):
        pass

    @staticmethod
    async def static(_=None):
        pass


WRONG = [
    (is_async, "is_async is an async function"),
    (generates_later, "generates_later is an async generator function"),
    (generates, "generates is a generator function"),
    (holds, "holds is a @contextmanager function"),
    (holds_later, "holds_later is an @asynccontextmanager function"),
    (partial(is_async, 1), "is an async function"),
    (Callable(), "is an async function"),
    (Callable().method, "Callable.method is an async function"),
    (Callable.static, "Callable.static is an async function"),
    (None, "is a function, not None"),
    ("on_state", "is a function, not 'on_state'"),
]


@pytest.mark.parametrize(("handler", "words"), WRONG)
def test_what_would_never_run_is_refused_everywhere(handler, words):
    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        states = runtime.channel("states", State)
        for give in (
            lambda: actor.subscribe(states, handler),
            lambda: states.subscribe(handler),
            lambda: actor.call_later(1.0, handler),
            lambda: actor.call_at(10**9, handler),
            lambda: actor.every(1.0, handler),
        ):
            with pytest.raises(Error, match=words):
                give()
        assert actor.subscriptions == ()
        if handler is not None:
            with pytest.raises(Error, match=words):
                actor.spawn(is_async(), handler)
            with pytest.raises(Error, match=words):
                PredicateManager().sensor("A", states, handler)

    run_virtual(main)


def test_work_is_awaitable():
    async def main(runtime):
        actor = Actor("actor")
        await runtime.start(actor)
        with refused(Error):
            actor.spawn(is_async)

    run_virtual(main)


@pytest.mark.parametrize("plain", [print, len, lambda: None, [].append, partial(print, 1), Callable, "".join])
def test_plain_functions_are_taken(plain):
    check_plain(plain, "this")
