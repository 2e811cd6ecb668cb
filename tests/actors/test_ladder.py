"""Three ensembles above each other, in all short sequences of what may happen to them; and faults planted there."""

from __future__ import annotations

import pytest
from ladder import search

from mdm.actors.actions.lives import Gate, Lives
from mdm.actors.ensemble import Ensemble
from mdm.actors.safety.modes import Modes, Stage


def test_nothing_goes_wrong_in_short_sequences():
    assert search(150) > 40


def begin_although_the_gate_is_closed(patch):
    patch.setattr(Lives, "_set", lambda self, gate: (setattr(self, "gate", gate), setattr(self, "open", True)))


def run_the_safe_action_beside_what_lives(patch):
    patch.setattr(Lives, "safe_action_is_due", property(lambda self: self.gate is Gate.SAFE and not self.calling))


def start_below_what_is_safe(patch):
    patch.setattr(Ensemble, "safe_above", lambda self: None)


def leave_what_lives_below(patch):
    patch.setattr(Ensemble, "interrupt", lambda self: self.control.pause())


def never_secure_twice(patch):
    secured = Modes.secured

    def once(self, failure, time, *, early=False):
        return secured(self, failure, time) if self.stage is not Stage.OPEN else ()

    patch.setattr(Modes, "secured", once)


@pytest.mark.parametrize(
    "plant",
    [
        begin_although_the_gate_is_closed,
        run_the_safe_action_beside_what_lives,
        start_below_what_is_safe,
        leave_what_lives_below,
        never_secure_twice,
    ],
)
def test_planted_faults_are_found(plant, monkeypatch):
    plant(monkeypatch)
    with pytest.raises(AssertionError):
        search(1500)
