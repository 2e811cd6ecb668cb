"""Oracles: what must hold of every scenario, whatever has happened in it."""

from __future__ import annotations

SLACK = 3.0
"""Seconds that the end may take beside the limits of the ensembles: faulty actors, and restarts under way."""


class Oracles:
    """Hold what has happened against what is promised.

    Args:
        journal: What has happened.
        ended_by: What the block of the runtime has raised, or None.
        broken_off: Whether the program did not wait for the end, so that safe actions may not have run.
    """

    def __init__(self, journal, ended_by, *, broken_off):
        self._journal, self._ended_by, self._broken_off = journal, ended_by, broken_off

    def judge(self):
        """Yield what is wrong, each in a sentence."""
        yield from self._journal.wrong
        yield from self._one_life_each()
        yield from self._one_at_a_time()
        yield from self._nothing_left()
        if not self._broken_off:
            yield from self._all_told()
            yield from self._arrived()
            yield from self._excused()
            yield from self._ends_in_time()
            yield from self._ends_at_once()
            yield from self._safe_in_the_end()
            yield from self._outermost_last()

    def _one_life_each(self):
        ends = {}
        for life in self._lives():
            ends.setdefault((life.ensemble, life.life), []).append(life.status)
        for key, statuses in ends.items():
            if statuses[0] != "running" or len(statuses) > 2 or (len(statuses) < 2 and not self._broken_off):
                yield f"life {key} goes {statuses}"

    def _lives(self):
        return [life for messages in self._journal.lives for life in messages]

    def _abandoned(self):
        """Return the ensembles an action of which was abandoned, and may still live."""
        paths = {life.ensemble for life in self._lives() if life.status == "abandoned"}
        replaced = [fault.source for fault in self._journal.faults if "which was replaced, abandoned" in fault.detail]
        paths.update(source.removesuffix("/action") for source in replaced)
        return {path.rpartition("/")[2] for path in paths}

    def _ends_in_time(self):
        """Hold that what is decided anew ends what lives, within the time that it has for it."""
        journal = self._journal
        failed = {name for fault in journal.faults if fault.kind == "exception" for name in fault.source.split("/")}
        for name, robot in journal.robots.items():
            bindings = dict(zip(robot.action.names, robot.action.bindings, strict=True))
            path, begun = journal.path(name), {}
            lives = [life for life in self._lives() if life.ensemble == path and life.action in bindings]
            for life in () if name in failed else lives:
                binding = bindings[life.action]
                if life.status == "running" or binding.concurrent:
                    begun[life.life] = life.time
                    continue
                patience = binding.grace if binding.ensemble is None else binding.ensemble.patience
                latest = life.time - round((patience + 0.1 + journal.slack) * 1e9)
                for time, decision in journal.decisions:
                    chosen = decision.action_name
                    if decision.ensemble != path or chosen == life.action or bindings[chosen].concurrent:
                        continue
                    if begun[life.life] + journal.slack * 1e9 < time <= latest:
                        yield f"{life.action} of {name} lived on after {chosen} was decided"

    def _ends_at_once(self):
        """Hold that an end is over when nothing lives any more."""
        for ending in self._journal.endings:
            runs = [
                run for run in self._journal.runs if run.robot in ending.names and run.entered <= (ending.over or 0)
            ]
            if ending.until is None or any(run.left is None or run.left > ending.over for run in runs):
                continue
            took = (ending.until - max([ending.time, *(run.until for run in runs)])) / 1e9
            if took > SLACK:
                yield f"the end of {sorted(ending.names)} took {took:.1f} s more when nothing lived there"

    def _one_at_a_time(self):
        abandoned = self._abandoned()
        for before, after in self._journal.overlaps:
            if before.robot not in abandoned:
                yield f"{before.robot}: {after.action} starts while {before.action} lives"

    def _all_told(self):
        journal = self._journal
        answered = [word for error in journal.answers for word in causes(error)]
        words = [fault.detail for fault in journal.faults] + answered + list(causes(self._ended_by))
        for text in journal.raised:
            if not any(text in word for word in words):
                yield f"{text!r} was never told"
        untold = [text for text in journal.exits if not any(text in word for word in answered)]
        if untold and self._ended_by is None:
            yield f"{journal.exits} did not end the runtime"

    def _excused(self):
        """Hold that what was superseded takes nothing with it, though its cleanup fails."""
        told = [cause.detail for mode in self._journal.modes for cause in mode.causes if cause.kind == "action"]
        for text in self._journal.excused:
            if any(text in detail for detail in told):
                yield f"the cleanup that raised {text!r} was of what had been superseded, and is a cause of safety"

    def _arrived(self):
        """Hold that what may say that it has succeeded, and does so at each end, is not told as preempted."""
        for action in self._journal.arriving:
            ends = [life.status for life in self._lives() if life.action == action and life.status != "running"]
            entered = sum(run.action == action for run in self._journal.runs)
            early = ends.count("preempted") + ends.count("timed_out")  # before their first step, if at all
            if len(ends) >= entered > len(ends) - early:  # of some ensembles the lives are not heard
                yield f"{action} has come to its end {entered} times, and its lives are told as {ends}"

    def _nothing_left(self):
        journal = self._journal
        if any(run.left is None for run in journal.runs):
            yield "an action never ended"
        if journal.runtime.abandoned:
            yield f"work is left: {journal.runtime.abandoned}"
        for robot in journal.robots.values():
            for actor in (robot, *robot.children):
                if actor.life not in {"created", "stopped", "failed"}:
                    yield f"{actor.path} is {actor.life} in the end"

    def _safe_in_the_end(self):
        """Hold that whatever began to decide, and was not told to stop, has run its safe action since."""
        journal = self._journal
        for name, robot in journal.robots.items():
            told = [mode for mode in journal.modes if mode.ensemble == journal.path(name)]
            if not told or told[-1].mode == "stopped":
                continue
            if told[-1].mode == "deciding":
                yield f"{name} was deciding in the end"
                continue
            deciding = [mode.since for mode in told if mode.mode == "deciding"]
            began = max(deciding, default=told[-1].since)  # it may be safe from its start on
            if self._left_running(name, began):
                continue
            if not any(run.robot == name and run.safe and run.time >= began for run in journal.runs):
                yield f"{name} is {robot.mode} in the end, but has not run its safe action"
                continue
            last = [run for run in journal.runs if run.robot == name][-1]
            if not last.safe:
                yield f"{name} is {robot.mode} in the end, and its last action is {last.action}"

    def _outermost_last(self):
        """Hold that at each end what was deciding is made safe, and what is above after what is below."""
        journal, abandoned = self._journal, self._abandoned()
        for ending in journal.endings:
            over, last = journal.order if ending.over is None else ending.over, {}
            for name in ending.names:
                runs = [run for run in journal.runs if run.robot == name and run.safe]
                before = [run for run in runs if run.entered <= over]
                acts = name in ending.active or (before and before[-1].entered > (ending.began or ending.asked))
                if before and acts:
                    last[name] = before[-1]
                made_safe = any(run.entered > ending.asked for run in runs)
                if made_safe or self._left_running(name, 0):
                    continue
                if name in ending.deciding and not self._went_on(name, ending.asked):
                    yield f"{name} was deciding, and did not run its safe action at the end"
            for name in ending.names:
                runs = [run for run in journal.runs if run.robot == name and run.entered <= over]
                left = max((run.left or 0 for run in runs if run.safe or name not in abandoned), default=0)
                for above in journal.above(name)[1:]:
                    if above in last and last[above].entered < left and not self._left_running(above, 0):
                        yield f"the safe action of {above} has not the last word over {name}"

    def _left_running(self, name, since):
        """Whether its safe action was abandoned and still ran when it was due, which is told as an emergency."""
        faults = [fault for fault in self._journal.faults if fault.source == self._journal.path(name)]
        told = [fault for fault in faults if fault.kind == "safe_action" and fault.time >= since]
        return any("still runs since" in fault.detail for fault in told)

    def _went_on(self, name, order):
        """Whether something above has chosen another action since, as at a tick of the same moment."""
        above = self._journal.above(name)[1:]
        return any(run.robot in above and not run.safe and run.entered > order for run in self._journal.runs)


def causes(error):
    """Yield the words of an error, and of those that led to it."""
    while error is not None:
        yield str(error)
        if isinstance(error, BaseExceptionGroup):
            for inner in error.exceptions:
                yield from causes(inner)
        error = error.__cause__ or error.__context__
