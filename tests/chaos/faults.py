"""Faults of the edges, planted in the implementation: what only watches, turns without end, ways back, stops."""

from __future__ import annotations

from mdm.actors.actions import action_layer
from mdm.actors.actions.lives import Lives
from mdm.actors.safety.liveness import Liveness
from mdm.actors.safety.safety import Safety
from mdm.recording import process
from mdm.recording.recorder import Recorder
from mdm.recording.writer import RecordWriter
from mdm.runtime import runtime, supervision
from mdm.runtime.dispatcher import Dispatcher
from mdm.runtime.observing import Guard
from mdm.runtime.runtime import Runtime
from mdm.runtime.time.virtual import VirtualEventLoop
from mdm.team.layer import TeamLayer
from mdm.team.storage import Storage


def keep_other_input_behind_a_turn_without_end(patch):
    def wait(self, items):
        self._behind.append((None, items))

    def take(self, subscription, message):
        self._behind.append((self.time, ((subscription, message),)))
        self.time = -1

    def resume(self, time, *, starved):
        self.time = self.last = time
        try:
            self.run()
        finally:
            if not self.active:
                self._end_cuts()

    patch.setattr(Dispatcher, "wait", wait)
    patch.setattr(Dispatcher, "_take", take)
    patch.setattr(Dispatcher, "resume", resume)


def starve_nobody(patch):
    patch.setattr(Runtime, "_starve", lambda self, detail: None)


def leave_a_circle_in_which_no_time_passes_alone(patch):
    patch.setattr(Runtime, "_stand_still", lambda self, detail: None)


def let_no_time_pass_while_a_circle_ends(patch):
    patch.setattr(VirtualEventLoop, "go_on", lambda self: None)


def begin_an_abandoned_action_beside_itself(patch):
    patch.setattr(Lives, "leave", lambda self, life: None)


def plan_no_pause_where_the_safe_action_is_due(patch):
    plan = Liveness._plan

    def forget(self, pause, name, status):
        if self._ensemble.safety.deciding:
            plan(self, pause, name, status)

    patch.setattr(Liveness, "_plan", forget)


def take_the_decided_action_with_a_superseded_one(patch):
    ended = Liveness.ended

    def blame(self, name, binding, status, text, lasted, asked):
        return ended(self, name, binding, status, text, lasted, False)

    patch.setattr(Liveness, "ended", blame)


def lose_the_pause_with_a_safe_action_that_is_tried_again(patch):
    secured = Safety._secured

    def forget(self, failure):
        secured(self, failure)
        if failure is not None:
            self._ensemble.liveness.end()

    patch.setattr(Safety, "_secured", forget)


def _unguarded(patch, name):
    call = Guard.__call__

    def guarded(self, hear):
        return hear if self._name == name else call(self, hear)

    patch.setattr(Guard, "__call__", guarded)


def let_the_page_raise(patch):
    _unguarded(patch, "the page")


def let_the_log_raise(patch):
    _unguarded(patch, "the log")


def let_the_record_raise(patch):
    _unguarded(patch, "the record")


def leave_texts_as_they_are(patch):
    patch.setattr("mdm.messages.encodable", str)
    patch.setattr(supervision, "encodable", str)


def leave_paths_as_they_are(patch):
    def described(error):
        return f"{type(error).__name__}: {supervision.text_of(error)}{supervision._place(error)}"

    for module in (action_layer, runtime, supervision):
        patch.setattr(module, "describe", described)


def end_the_record_with_what_cannot_be_encoded(patch):
    def write(self, slice_=None):
        items, self._items = self._items, []
        for item in items:
            self._encode_item(item)
        self._send()
        self._waits = False
        self._complain()

    patch.setattr(Recorder, "_write", write)


def tell_nothing_of_a_writer_that_is_silent(patch):
    patch.setattr(RecordWriter, "silent", False)


def write_to_a_file_that_is_gone(patch):
    patch.setattr(process._Stream, "check", lambda self: None)


def count_nothing_that_is_lost(patch):
    patch.setattr(Recorder, "_lost", 0)


# -- Of teams ----------------------------------------------------------------------------------------------------------


def forget_stops_with_the_process(patch):
    patch.setattr(Storage, "recall", lambda self, ensemble: None)


def decide_without_having_met(patch):
    patch.setattr(TeamLayer, "unmet", False)
