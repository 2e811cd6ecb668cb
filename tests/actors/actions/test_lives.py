"""The state machine of lives: an exhaustive search of what may happen to a few actions, and faults planted in it."""

from __future__ import annotations

import copy
from collections import deque

import pytest

from mdm.actors.actions.lives import Gate, Life, Lives, Order


class Kind:
    """What the lives of an action have in common; the same object in each copy of a world."""

    def __init__(self, what="task", *, concurrent=False, group=None):
        self.what, self.concurrent, self.group = what, concurrent, group

    def __deepcopy__(self, memory):
        return self


class Run(Life):
    """A life, and how it is in this world: whether its function has returned, and its cancellation has reached it."""

    __slots__ = ("cancelled",)


KINDS = {
    "go": Kind(),
    "call": Kind("function"),
    "below": Kind("ensemble"),
    "left": Kind(group="drive"),
    "right": Kind(group="drive"),
    "sing": Kind(concurrent=True),
}
SAFE = Kind()


class Wrong(Exception):
    """What must not happen has happened."""


class World:
    """What a layer does with the orders, and what is true of the robot, counted apart from the machine."""

    def __init__(self):
        self.lives: Lives[Run] = Lives()
        self.running: list[Run] = []
        self.calls: list[tuple[Run, list]] = []
        self.admitted = self.barred = False
        self.safe = "none"  # or due, runs, done
        self.idle = True

    def demand(self, condition, text):
        if not condition:
            raise Wrong(text)

    # -- What a layer does ---------------------------------------------------------------------------------------

    def obey(self, orders):
        orders = list(orders)
        while orders:
            order, life = orders.pop(0)
            if order is Order.BEGIN:
                self.begin(life, orders)
                return
            if order in {Order.CANCEL, Order.CANCEL_BEHIND}:
                self.demand(life in self.running or life is self.calling, "what does not live is cancelled")
                life.cancelled = True

    @property
    def calling(self):
        return self.calls[-1][0] if self.calls else None

    def begin(self, life, rest=()):
        self.demand(not self.calls, "two functions are called at once")
        alone = [one for one in self.running if one is not life]
        if life.secures:
            self.demand(not alone and self.safe == "due", "the safe action begins beside another")
            self.safe = "runs"
        else:
            self.demand(self.admitted and not self.barred, "it begins though nothing may")
            if not life.kind.concurrent:
                for one in alone:
                    replaced = life.kind.group is not None and one.kind.group is life.kind.group and one.ending
                    self.demand(one.kind.concurrent or replaced, "two live at once")
        life.cancelled = False
        if life.kind.what == "ensemble":  # which starts without a call of its own
            self.lives.keep(life, task=False)
            self.running.append(life)
            self.obey(rest)
            return
        self.calls.append((life, list(rest)))
        self.lives.calling = True

    def returns(self, *, lasts):
        life, rest = self.calls.pop()
        self.lives.calling = False
        if lasts:
            self.lives.keep(life, task=True)
            self.running.append(life)
        elif life.secures:
            self.safe = "done"
            self.lives.secured(failed=False)
        if not self.lives.open and not life.secures and lasts:
            self.obey(self.lives.cancel(life, "preempted"))
        if not (lasts and self.lives.open) or self.lives.pending is not None:
            self.settle()
        self.obey(rest)

    def settle(self):
        if self.lives.calling:
            return
        if self.lives.safe_action_is_due:
            self.begin(Run("safe", SAFE, None, secures=True))
        elif (life := self.lives.next()) is not None:
            self.begin(life)
        if self.lives.quiet and not self.calls:
            self.demand(not self.running, "idle is told while something lives")
            self.idle = True

    # -- What may happen -----------------------------------------------------------------------------------------

    def events(self):
        if self.calls:
            yield "returned", lambda: self.returns(lasts=False)
            if self.calling.kind.what == "task":
                yield "goes on", lambda: self.returns(lasts=True)
        elif self.lives.open:
            for name, kind in KINDS.items():
                for goes_on in (True, False):
                    for own in (True, False) if self.lives.current and self.lives.current.task else (False,):
                        yield (
                            f"choose {name} {goes_on} {own}",
                            lambda name=name, kind=kind, goes_on=goes_on, own=own: self.obey(
                                self.lives.choose(Run(name, kind, None), lambda: goes_on, own=own)
                            ),
                        )
        # The end of a task, and a timeout, are turns of their own: no function is being called.
        for life in [one for one in self.running if not self.calls or one.kind.what == "ensemble"]:
            yield f"end {life.name}", lambda life=life: self.end(life)
            if life.ending is None:
                yield f"time out {life.name}", lambda life=life: self.obey(self.lives.cancel(life, "timed_out"))
        if self.safe != "runs" and self.lives.gate is not Gate.SAFE:
            if not self.calls:
                yield "admit", self.admit
            yield "secure", self.secure
        yield "latch", self.latch
        yield "halt", self.halt
        yield "bar", lambda: self.bar(barred=not self.barred)
        if self.lives.gate is Gate.FAILED:
            yield "give up", self.give_up

    def admit(self):
        self.admitted, self.safe = True, "none"
        self.lives.admit()

    def secure(self):
        self.admitted, self.safe = False, "due"
        self.obey(self.lives.secure())
        self.settle()

    def latch(self):
        self.admitted = False
        self.obey(self.lives.latch())

    def halt(self):
        self.admitted = self.idle = False
        self.obey(self.lives.halt())
        self.settle()

    def bar(self, *, barred):
        self.barred = barred
        self.lives.bar(barred=barred)

    def give_up(self):
        self.lives.give_up()
        self.settle()

    def end(self, life, *, failed=None):
        self.running.remove(life)
        self.demand(self.lives.end(life), "what lives is not known to")
        if life.secures:
            self.safe = "done"
            self.lives.secured(failed=life.ending is not None if failed is None else failed)
        self.settle()

    # -- What holds ----------------------------------------------------------------------------------------------

    def check(self):
        lives = self.lives
        self.demand(sorted(map(id, lives.living)) == sorted(map(id, self.running)), "it does not know what lives")
        self.demand(lives.open == (self.admitted and not self.barred), "it does not know what may begin")
        if lives.pending is not None and not self.calls:
            about_to_end = [one for one in self.running if one.ending or one is lives.current]
            self.demand(lives.open and about_to_end, "it waits for the end of nothing")
        if self.safe == "due":
            self.demand(all(one.ending for one in self.running), "what the safe action waits for is not to end")
            self.demand(self.running or self.calls, "the safe action is due, and nothing keeps it")

    def comes_to_an_end(self):
        """Hold that nothing waits for ever: where all that lives ends, what is due has run, and nothing waits."""
        world = copy.deepcopy(self)
        for _ in range(20):
            if world.calls:
                world.returns(lasts=False)
            elif world.running:
                world.end(world.running[0], failed=False)
        self.demand(world.lives.pending is None, "something waits for ever")
        self.demand(world.safe != "due" and world.lives.gate is not Gate.SAFE, "the safe action waits for ever")

    @property
    def key(self):
        def of(life):
            return life and (life.name, life.ending, life.task, life.secures, getattr(life, "cancelled", False))

        lives = self.lives
        machine = (lives.gate, lives.barred, lives.calling, of(lives.current), of(lives.pending))
        others = (tuple(map(of, lives.beside.values())), tuple(map(of, lives.replaced)))
        calls = tuple((of(life), tuple((order, of(one)) for order, one in rest)) for life, rest in self.calls)
        return (*machine, *others, tuple(map(of, self.running)), calls, self.admitted, self.safe)


def search(most_lives=3):
    """Return the worlds that can be reached, with at most so many lives at once."""
    start = World()
    frontier, seen = deque([start]), {start.key}
    while frontier:
        world = frontier.popleft()
        for number, (name, _) in enumerate(world.events()):
            following = copy.deepcopy(world)
            try:
                [*following.events()][number][1]()
                following.check()
                if following.key in seen or len(following.running) > most_lives:
                    continue
                following.comes_to_an_end()
            except Wrong as wrong:
                raise AssertionError(f"after {name!r} in {world.key}: {wrong}") from None
            seen.add(following.key)
            frontier.append(following)
    return seen


def test_whatever_happens_to_a_few_actions_no_two_live_at_once_and_none_waits_for_ever():
    seen = search(2)
    assert {key[0] for key in seen} == set(Gate)
    assert len(seen) > 1000


def forget_the_latch(patch):
    patch.setattr(Lives, "latch", lambda self: ())


def keep_what_waits_at_the_latch(patch):
    def latch(self):
        self._set(Gate.CLOSED)
        return ()

    patch.setattr(Lives, "latch", latch)


def begin_beside_what_was_replaced(patch):
    patch.setattr(Lives, "_is_free_for", lambda self, life: True)


def begin_what_waits_beside_what_lives(patch):
    def next_(self):
        life, self.pending = self.pending, None
        return life

    patch.setattr(Lives, "next", next_)


def bar_nothing(patch):
    patch.setattr(Lives, "bar", lambda self, *, barred: None)


def secure_without_an_end_of_what_lives(patch):
    def secure(self):
        self._set(Gate.SAFE)
        return self.latch()

    patch.setattr(Lives, "secure", secure)


def begin_the_safe_action_beside_what_lives(patch):
    patch.setattr(Lives, "safe_action_is_due", property(lambda self: self.gate is Gate.SAFE and not self.calling))


def forget_a_life_that_lasts(patch):
    patch.setattr(Lives, "keep", lambda self, life, *, task: None)


def replace_what_is_about_to_end(patch):
    patch.setattr("mdm.actors.actions.lives._same_group", lambda one, other: True)


@pytest.mark.parametrize(
    "plant",
    [
        forget_the_latch,
        keep_what_waits_at_the_latch,
        begin_beside_what_was_replaced,
        begin_what_waits_beside_what_lives,
        bar_nothing,
        secure_without_an_end_of_what_lives,
        begin_the_safe_action_beside_what_lives,
        forget_a_life_that_lasts,
        replace_what_is_about_to_end,
    ],
)
def test_the_search_finds_faults(plant, monkeypatch):
    plant(monkeypatch)
    with pytest.raises(AssertionError):
        search(2)


def test_what_was_overtaken_before_it_began_is_counted():
    lives: Lives[Run] = Lives()
    lives.admit()
    first, second, third = (Run(name, KINDS["go"] if name == "go" else Kind(), None) for name in ("go", "a", "b"))
    assert lives.choose(first, lambda: True, own=False) == ((Order.BEGIN, first),)
    lives.keep(first, task=True)
    assert lives.choose(second, lambda: True, own=False) == ((Order.CANCEL, first),)
    assert lives.choose(third, lambda: True, own=False) == ()
    assert (lives.skipped, lives.pending) == (1, third)
    assert lives.end(first)
    assert lives.next() is third
    assert not lives.end(first)
