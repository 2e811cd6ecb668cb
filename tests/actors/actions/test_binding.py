"""Bindings: what is called, with what, and what is no target."""

from __future__ import annotations

from functools import partial

import pytest
from sentences import refused

from mdm import ConfigError, Ensemble, bind
from mdm.actors.actions.binding import returns_nothing
from mdm.messages import Action
from mdm.policies import DeterministicPolicy


async def drive():
    pass


class Button:
    def press(self, action):
        pass

    def __call__(self):
        pass


@pytest.mark.parametrize(
    ("target", "plain", "takes_action"),
    [
        (lambda: None, True, False),
        (lambda action: None, True, True),
        (lambda action=None: None, True, False),
        (lambda *parts: None, True, True),
        (drive, False, False),
        (Button().press, True, True),
        (Button(), True, False),
        (partial(Button().press, "fixed"), True, False),
        (print, True, True),
    ],
)
def test_a_function_gets_the_action_where_it_asks_for_an_argument(target, plain, takes_action):
    binding = bind(target)
    assert (binding.plain, binding.takes_action, binding.ensemble) == (plain, takes_action, None)


def test_an_ensemble_is_started_and_stopped():
    ensemble = Ensemble("below", policy=DeterministicPolicy([0]), actions={0: print})
    binding = bind(ensemble, resume=True)
    assert (binding.ensemble, binding.plain, binding.resume) == (ensemble, False, True)


@pytest.mark.parametrize(
    ("target", "options", "words"),
    [
        (7, {}, "a function or an ensemble, not 7"),
        ("drive", {}, "a function or an ensemble, not 'drive'"),
        (lambda one, two: None, {}, "asks for one, two"),
        (lambda *, speed: None, {}, "asks for speed"),
        (print, {"on_repeat": "again"}, "'again' is not one of 'continue', 'restart'"),
        (print, {"timeout": 0}, "timeout"),
        (print, {"grace": -1.0}, "grace"),
        (print, {"grace": None}, "grace"),
        (print, {"resume": "no"}, "resume: true or false was expected, not 'no'"),
        (print, {"concurrent": 1}, "concurrent: true or false was expected, not 1"),
    ],
)
def test_what_is_no_binding_is_refused(target, options, words):
    with pytest.raises(ConfigError, match=words):
        bind(target, **options)


def test_whether_an_action_goes_on_is_asked_only_where_it_starts_anew():
    asked = bind(print, on_repeat="restart", goes_on=lambda: True)
    told = bind(print, on_repeat="restart", goes_on=lambda action: action.state == 5)
    bindings = asked, bind(print), bind(print, on_repeat="restart"), told
    assert [binding.continues(Action(0, 0, 0, state=5)) for binding in bindings] == [True, True, False, True]
    assert not told.continues(Action(0, 0, 0, state=4))
    with refused(ConfigError):
        bind(print, goes_on=lambda: True)


def test_a_concurrent_action_is_of_no_group():
    with refused(ConfigError):
        bind(print, concurrent=True, group="drives")


def jumps(given=1):
    if given:
        return
    Button()


def cleans_up():
    try:
        Button()
    finally:
        Button()


def fails():
    raise ValueError


def tells_some(given=1):
    if given:
        return given
    return None


def tells_one(given=1):
    return given or None


def tells_length(given=()):
    return len(given) if len(given) > 1 else None


def tells_and_cleans_up(given=1):
    try:
        return given
    finally:
        Button()


@pytest.mark.parametrize(
    "function", [jumps, cleans_up, fails, Button().press, Button(), Button.press, lambda: None, lambda *_: None]
)
def test_functions_that_return_nothing(function):
    assert returns_nothing(function)


@pytest.mark.parametrize(
    "function",
    [tells_some, tells_one, tells_length, tells_and_cleans_up, partial(jumps), print, lambda: 0, Button],
)
def test_functions_of_which_it_is_not_known_that_they_return_nothing(function):
    assert not returns_nothing(function)
