"""Faults planted in the implementation: the oracles find each of them."""

from __future__ import annotations

import gc

import pytest
from chaos import faults, squads
from chaos.scenario import Scenario

from mdm import Actor, Ensemble, PredicateManager
from mdm.actors.actions.action_layer import ActionLayer
from mdm.actors.actions.lives import Lives
from mdm.actors.safety.liveness import Liveness
from mdm.actors.safety.modes import Stage
from mdm.actors.safety.safety import LastWord, Safety
from mdm.runtime.work import Jobs, Work, _Job

MOST = 1000
"""Scenarios in which a planted fault is found."""


def drop_the_latch(patch):
    def latch(self):
        self.pending = None
        return ()

    patch.setattr(Lives, "latch", latch)


def begin_before_the_old_one_has_ended(patch):
    choose = Lives.choose

    def hasty(self, life, goes_on, *, own):
        self.current = None
        return choose(self, life, goes_on, own=own)

    patch.setattr(Lives, "choose", hasty)


def do_not_cancel_before_the_safe_action(patch):
    def forget_all(self, *, but=None):
        self.current = None
        return ()

    patch.setattr(Lives, "cancel_all", forget_all)


def lose_the_timer_of_the_timeout(patch):
    cancel = Lives.cancel

    def lose(self, life, ending):
        return () if ending == "timed_out" else cancel(self, life, ending)

    patch.setattr(Lives, "cancel", lose)


def end_a_life_twice(patch):
    finish = ActionLayer._finish

    def twice(self, life, status, detail=""):
        finish(self, life, status, detail)
        self._end_life(life, status, detail)

    patch.setattr(ActionLayer, "_finish", twice)


def forget_the_safe_action_at_the_end(patch):
    patch.setattr(LastWord, "_end_here", lambda self, kind, detail: self.finish())


def let_the_end_not_wait_for_what_is_below(patch):
    def end(self, kind, detail, ended):
        self._ended.append(ended)
        self._end_here(kind, detail)

    patch.setattr(LastWord, "end", end)


def let_a_safe_action_that_began_before_those_below_have_ended_be_the_last(patch):
    patch.setattr(LastWord, "outlived", False)


def swallow_a_failure(patch):
    patch.setattr(Actor, "fail", lambda self, error: None)


def trust_a_retained_state_after_a_restart(patch):
    patch.setattr(Ensemble, "on_stop", lambda self: self.safety.waiting.end())


def trust_predicates_while_their_manager_is_down(patch):
    patch.setattr(PredicateManager, "on_failing", lambda self, error: None)


def lose_the_timer_of_the_grace(patch):
    patch.setattr(ActionLayer, "_abandon", lambda self, life: None)


def let_the_end_of_the_runtime_latch_nothing(patch):
    patch.setattr(Ensemble, "on_ending", lambda self: None)


def do_not_wait_for_threads(patch):
    patch.setattr(Jobs, "begin", lambda self: None)
    patch.setattr(Jobs, "end", lambda self: None)


def keep_the_count_of_a_job_that_cannot_begin(patch):
    drop = _Job.drop

    def keep(self, future=None):
        if future is None:
            self._state = "dropped"
        else:
            drop(self, future)

    patch.setattr(_Job, "drop", keep)


def let_a_job_that_was_refused_begin(patch):
    def drop(self, future=None):
        if self._state == "waiting":
            if future is not None:
                self._state = "dropped"
            self._jobs.end()

    patch.setattr(_Job, "drop", drop)


def start_what_is_safe_below_what_is_safe(patch):
    start = Safety.start

    def heedless(self, time):
        if self.modes.mode == "safe" and not self._ensemble.interrupted:
            self.obey(self.modes.start(time), time)
        else:
            start(self, time)

    patch.setattr(Safety, "start", heedless)


def put_off_what_is_replaced_behind_the_latch(patch):
    latch = Lives.latch

    def put_off(self):
        latch(self)
        return ()

    patch.setattr(Work, "begun", True)
    patch.setattr(Lives, "latch", put_off)


def begin_beside_what_was_replaced(patch):
    patch.setattr(Lives, "_is_free_for", lambda self, life: True)


def end_what_has_not_begun_to_start(patch):
    end = LastWord.end

    def heedless(self, kind, detail, ended):
        if self._modes.stage is Stage.CLOSED:
            self._modes.stage = Stage.OPEN
        end(self, kind, detail, ended)

    patch.setattr(LastWord, "end", heedless)


def wait_below_what_starts_for_its_end(patch):
    end = Ensemble.on_ending

    def on_ending(self):
        if not isinstance(self.parent, Ensemble):
            end(self)

    patch.setattr(Ensemble, "on_ending", on_ending)


def make_safe_before_the_layer_lives(patch):
    def unsafe(self):
        return self._safety.has_safe_action and (self._ensemble.action.started > self.safe_at or self.outlived)

    patch.setattr(LastWord, "unsafe", property(unsafe))


def begin_a_life_without_telling_that_it_is_stopped(patch):
    begin = Safety.open

    def hushed(self):
        self._told = ("stopped", ())
        begin(self)

    patch.setattr(Safety, "open", hushed)


def never_decide_again(patch):
    patch.setattr(Liveness, "_decide_again", lambda self: None)


def do_not_look_whether_anything_is_done(patch):
    patch.setattr(Liveness, "look", lambda self: None)


def do_not_tell_of_idleness(patch):
    patch.setattr(Liveness, "_complain", lambda self, after: None)


FIRST = {
    trust_predicates_while_their_manager_is_down: 1197,
    put_off_what_is_replaced_behind_the_latch: 287,
    end_what_has_not_begun_to_start: 164,
    wait_below_what_starts_for_its_end: 1310,
    make_safe_before_the_layer_lives: 187,
    drop_the_latch: 223,
    never_decide_again: 293,
    begin_beside_what_was_replaced: 1226,
}
"""The first scenarios that find the rarer ones; from 0 on it takes a minute or so."""


@pytest.mark.parametrize(
    "plant",
    [
        drop_the_latch,
        begin_before_the_old_one_has_ended,
        do_not_cancel_before_the_safe_action,
        pytest.param(lose_the_timer_of_the_timeout, marks=pytest.mark.slow),
        end_a_life_twice,
        forget_the_safe_action_at_the_end,
        let_the_end_not_wait_for_what_is_below,
        pytest.param(let_a_safe_action_that_began_before_those_below_have_ended_be_the_last, marks=pytest.mark.slow),
        swallow_a_failure,
        pytest.param(trust_a_retained_state_after_a_restart, marks=pytest.mark.slow),
        trust_predicates_while_their_manager_is_down,
        pytest.param(lose_the_timer_of_the_grace, marks=pytest.mark.slow),
        let_the_end_of_the_runtime_latch_nothing,
        do_not_wait_for_threads,
        keep_the_count_of_a_job_that_cannot_begin,
        let_a_job_that_was_refused_begin,
        start_what_is_safe_below_what_is_safe,
        put_off_what_is_replaced_behind_the_latch,
        pytest.param(begin_beside_what_was_replaced, marks=pytest.mark.slow),
        end_what_has_not_begun_to_start,
        wait_below_what_starts_for_its_end,
        make_safe_before_the_layer_lives,
        begin_a_life_without_telling_that_it_is_stopped,
        never_decide_again,
        do_not_look_whether_anything_is_done,
        do_not_tell_of_idleness,
    ],
)
def test_a_planted_fault_is_found(plant, monkeypatch):
    plant(monkeypatch)
    first = FIRST.get(plant, 0)
    assert any(Scenario(seed).run() for seed in range(first, first + MOST))


EDGES = {
    faults.keep_other_input_behind_a_turn_without_end: 13,
    faults.starve_nobody: 13,
    faults.leave_a_circle_in_which_no_time_passes_alone: 89,
    faults.let_no_time_pass_while_a_circle_ends: 89,
    faults.begin_an_abandoned_action_beside_itself: 591,
    faults.plan_no_pause_where_the_safe_action_is_due: 63,
    faults.lose_the_pause_with_a_safe_action_that_is_tried_again: 63,
    faults.take_the_decided_action_with_a_superseded_one: 189,
    faults.let_the_page_raise: 12,
    faults.let_the_record_raise: 17,
    faults.let_the_log_raise: 177,
    faults.leave_texts_as_they_are: 12,
    faults.leave_paths_as_they_are: 147,
    faults.end_the_record_with_what_cannot_be_encoded: 32,
    faults.count_nothing_that_is_lost: 17,
    faults.tell_nothing_of_a_writer_that_is_silent: 142,
    faults.write_to_a_file_that_is_gone: 47,
}
"""The first scenarios that find what was wrong at the edges."""
CIRCLES = {faults.leave_a_circle_in_which_no_time_passes_alone, faults.let_no_time_pass_while_a_circle_ends}
"""What leaves a circle alone, which takes some seconds of a processor."""


@pytest.mark.parametrize(
    "plant", [pytest.param(each, marks=[pytest.mark.slow] if each in CIRCLES else []) for each in EDGES]
)
def test_a_planted_fault_of_the_edges_is_found(plant, monkeypatch):
    plant(monkeypatch)
    first = EDGES[plant]
    assert any(wrong_with(seed) for seed in range(first, first + MOST))
    gc.collect()  # loops that ended by a failure


def wrong_with(seed):
    """Return what is wrong with a scenario, or what nobody has caught in it."""
    try:
        return Scenario(seed).run()
    except Exception as error:
        return [error]


@pytest.mark.parametrize("plant", [faults.forget_stops_with_the_process, faults.decide_without_having_met])
def test_a_planted_fault_of_teams_is_found(plant, monkeypatch):
    plant(monkeypatch)
    assert any(squads.violations(seed)[1] for seed in range(MOST))
