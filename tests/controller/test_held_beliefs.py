"""Beliefs of a user's own tracker: what is none is refused, and what it changes in place changes nothing told."""

from __future__ import annotations

import numpy as np
import pytest
from places import EXAMPLES
from sentences import refused
from trackers import Halving

import mdm
from mdm.controller import Controller
from mdm.problems import tiger


class Broken(Halving):
    def update(self, action, observation):
        self.current = np.array([np.nan, 1.0])
        return 1.0


def test_no_belief_that_is_none_is_acted_on():
    controller = Controller(EXAMPLES / "tiger.vf", tiger(), tracker=Broken())
    controller.start()
    with refused(mdm.ModelError):
        controller.observe(0)


class Shifting(Halving):
    """Changes its array in place."""

    def update(self, action, observation):
        self.current[:] = [0.25, 0.75]
        return 1.0


def test_a_tracker_that_changes_its_array_in_place_changes_nothing_that_was_told():
    controller = Controller(EXAMPLES / "tiger.vf", tiger(), tracker=Shifting())
    controller.start()
    told, decided_by = controller.belief, controller.decided_by
    controller.observe(0)
    np.testing.assert_array_equal([told, decided_by, controller.belief], [[0.5, 0.5], [0.5, 0.5], [0.25, 0.75]])
    with refused(ValueError):
        controller.belief[0] = 1.0


@pytest.mark.parametrize(
    ("belief", "words"),
    [
        ("left", "is not an array of numbers, but 'left'"),
        ([0.2, 0.3, 0.5], r"has the shape \(3,\), but there are 2"),
        ([0.5, 0.5 + 2e-6], "is not a distribution"),
        ([0.6, 0.6], "is not a distribution"),
        ([1.5, -0.5], "is not a distribution"),
    ],
)
def test_what_is_no_belief_of_a_tracker_is_refused(belief, words):
    tracker = Halving()
    controller = Controller(EXAMPLES / "tiger.vf", tiger(), tracker=tracker)
    tracker.reset = lambda _=None: setattr(tracker, "current", belief)
    with pytest.raises(mdm.ModelError, match=words):
        controller.start()
