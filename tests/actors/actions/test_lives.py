"""The state machine of lives: an exhaustive search of what may happen to a few actions, and faults planted in it."""

from __future__ import annotations

import pickle
from collections import deque

import pytest

from mdm.actors.actions.lives import Gate, Life, Lives, Order


class Kind:
    """What the lives of an action have in common; the same object in each copy of a world."""

    def __init__(self, what="task", *, concurrent=False, group=None):
        self.what, self.concurrent, self.group = what, concurrent, group
        self.ensemble = self if what == "ensemble" else None

    def __reduce__(self):
        return kind_called, (next((name for name, kind in KINDS.items() if kind is self), "safe"),)


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


def kind_called(name):
    """Return the kind of an action, which copies of a world share."""
    return KINDS.get(name, SAFE)


class Wrong(Exception):
    """What must not happen has happened."""


class World:
    """What a layer does with the orders, and what is true of the robot, counted apart from the machine."""

    def __init__(self, kinds):
        self.kinds = kinds
        self.lives: Lives[Run] = Lives()
        self.running: list[Run] = []
        self.left: list[Run] = []  # abandoned, and running
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
        if self.lives.itself(life) is not None:
            self.fail_at_once(life, rest)
            return
        self.demand(
            all(left.binding is not life.binding for left in self.left), "an abandoned action begins beside itself"
        )
        alone = [one for one in self.running if one is not life]
        if life.secures:
            self.demand(not alone and self.safe == "due", "the safe action begins beside another")
            self.safe = "runs"
        else:
            self.demand(self.admitted and not self.barred, "it begins though nothing may")
            if not life.binding.concurrent:
                for one in alone:
                    replaced = life.binding.group is not None and one.binding.group is life.binding.group and one.ending
                    self.demand(one.binding.concurrent or replaced, "two live at once")
        life.cancelled = False
        if life.binding.what == "ensemble":  # which starts without a call of its own
            self.lives.keep(life)
            self.running.append(life)
            self.obey(rest)
            return
        self.calls.append((life, list(rest)))
        self.lives.calling = True

    def fail_at_once(self, life, rest):
        self.demand(any(left.binding is life.binding for left in self.left), "it fails though nothing of it runs")
        if life.secures:
            self.safe = "done"
            self.lives.secured(failed=True)
        self.obey(rest)

    def returns(self, *, lasts):
        life, rest = self.calls.pop()
        self.lives.calling = False
        if lasts:
            self.lives.keep(life)
            self.running.append(life)
        elif life.secures:
            self.safe = "done"
            self.lives.secured(failed=False)
        if not self.lives.open and not life.secures and lasts:
            self.obey(self.lives.cancel(life, "preempted"))
        if not (lasts and self.lives.open) or self.lives.waits:
            self.settle()
        self.obey(rest)

    def settle(self):
        if self.lives.calling:
            return
        if self.lives.safe_action_is_due:
            self.begin(Run("safe", SAFE, None, secures=True))
        while (life := self.lives.next()) is not None:
            self.begin(life)
        if self.lives.quiet and not self.calls:
            self.demand(not self.running, "idle is told while something lives")
            self.idle = True

    # -- What may happen -----------------------------------------------------------------------------------------

    def events(self):
        if self.calls:
            yield "returned", lambda: self.returns(lasts=False)
            if self.calling.binding.what == "task":
                yield "goes on", lambda: self.returns(lasts=True)
        elif self.lives.open:
            for name in self.kinds:
                kind = KINDS[name]
                met = self.lives.met_by(Run(name, kind, None))
                for goes_on in (True, False):
                    for own in (True, False) if met and not met.binding.ensemble else (False,):
                        yield (
                            f"choose {name} {goes_on} {own}",
                            lambda name=name, kind=kind, goes_on=goes_on, own=own: self.obey(
                                self.lives.choose(Run(name, kind, None), lambda: goes_on, own=own)
                            ),
                        )
        # The end of a task, and a timeout, are turns of their own: no function is being called.
        for life in [one for one in self.running if not self.calls or one.binding.what == "ensemble"]:
            yield f"end {life.name}", lambda life=life: self.end(life)
            if life.ending is not None and life.binding.what == "task":
                yield f"abandon {life.name}", lambda life=life: self.abandon(life)
            if life.ending is None:
                yield f"time out {life.name}", lambda life=life: self.obey(self.lives.cancel(life, "timed_out"))
        for life in self.left:
            yield f"what was left of {life.name} ends", lambda life=life: self.end_left(life)
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

    def abandon(self, life):
        self.left.append(life)
        self.lives.leave(life)
        self.end(life, failed=True)

    def end_left(self, life):
        self.left.remove(life)
        self.lives.forget(life)

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
        self.demand(lives.behind.keys() <= lives.beside.keys() or self.calls, "it waits for the end of nothing beside")
        self.demand(lives.open or not lives.waits, "what waits has outlived the latch")
        if self.safe == "due":
            self.demand(all(one.ending for one in self.running), "what the safe action waits for is not to end")
            self.demand(self.running or self.calls, "the safe action is due, and nothing keeps it")

    def comes_to_an_end(self):
        """Hold that nothing waits for ever: where all that lives ends, what is due has run, and nothing waits."""
        world = pickle.loads(pickle.dumps(self))
        for _ in range(20):
            if world.calls:
                world.returns(lasts=False)
            elif world.running:
                world.end(world.running[0], failed=False)
        self.demand(not world.lives.waits, "something waits for ever")
        self.demand(world.safe != "due" and world.lives.gate is not Gate.SAFE, "the safe action waits for ever")

    @property
    def key(self):
        def of(life):
            return life and (life.name, life.ending, life.secures, getattr(life, "cancelled", False))

        lives = self.lives
        machine = (lives.gate, lives.part, lives.calling, of(lives.current), of(lives.pending), *lives.behind)
        beside = (tuple(map(of, lives.beside.values())), tuple(map(of, lives.replaced)))
        left = (tuple(map(of, self.left)), tuple(map(of, lives.left)))
        calls = tuple((of(life), tuple((order, of(one)) for order, one in rest)) for life, rest in self.calls)
        return (*machine, *beside, *left, tuple(map(of, self.running)), calls, self.admitted, self.safe)


def search(most_lives, most_left=0, kinds=tuple(KINDS)):
    """Return the worlds that can be reached, with at most so many lives at once, and so many abandoned ones."""
    start = World(kinds)
    frontier, seen = deque([start]), {start.key}
    while frontier:
        world = frontier.popleft()
        kept = pickle.dumps(world)  # from which each copy comes in a third of the time that copy.deepcopy takes
        for number, (name, _) in enumerate(world.events()):
            following = pickle.loads(kept)
            try:
                [*following.events()][number][1]()
                following.check()
                many = len(following.running) > most_lives or len(following.left) > most_left
                if following.key in seen or many:
                    continue
                following.comes_to_an_end()
            except Wrong as wrong:
                raise AssertionError(f"after {name!r} in {world.key}: {wrong}") from None
            seen.add(following.key)
            frontier.append(following)
    return seen


@pytest.mark.parametrize(
    ("kinds", "most"),
    [
        (("go", "call", "below", "sing"), 500),
        (("go", "call", "below", "left", "right"), 400),
        (("left", "right", "sing"), 1000),
        pytest.param(tuple(KINDS), 2000, marks=pytest.mark.slow),
    ],
)
def test_whatever_happens_to_a_few_actions_no_two_live_at_once_and_none_waits_for_ever(kinds, most):
    seen = search(2, 0, kinds)
    assert {key[0] for key in seen} == set(Gate)
    assert len(seen) > most


@pytest.mark.parametrize(
    ("kinds", "most"), [(("go", "sing"), 100), pytest.param(tuple(KINDS), 10_000, marks=pytest.mark.slow)]
)
def test_what_was_abandoned_is_not_begun_beside_itself_and_keeps_nothing_else(kinds, most):
    seen = search(2, 1, kinds)
    assert {key[0] for key in seen} == set(Gate)
    assert len(seen) > most


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
    patch.setattr(Lives, "keep", lambda self, life: None)


def begin_an_abandoned_action_beside_itself(patch):
    patch.setattr(Lives, "itself", lambda self, life: None)


def forget_what_was_left_too_late(patch):
    patch.setattr(Lives, "forget", lambda self, life: None)


def keep_what_waits_beside_at_the_latch(patch):
    patch.setattr(Lives, "_discard", lambda self: setattr(self, "pending", None))


def begin_a_concurrent_action_beside_itself(patch):
    def next_(self):
        name = next(iter(self.behind), None)
        return None if name is None or self.calling else self.behind.pop(name)

    patch.setattr(Lives, "next", next_)


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
        begin_an_abandoned_action_beside_itself,
        forget_what_was_left_too_late,
        keep_what_waits_beside_at_the_latch,
        begin_a_concurrent_action_beside_itself,
        replace_what_is_about_to_end,
    ],
)
def test_the_search_finds_faults(plant, monkeypatch):
    plant(monkeypatch)
    with pytest.raises(AssertionError):
        for kinds in (("go", "sing"), ("go", "call", "below"), ("go", "left", "right")):
            search(2, len(kinds) == 2, kinds)


def test_what_was_overtaken_before_it_began_is_counted():
    lives: Lives[Run] = Lives()
    lives.admit()
    first, second, third = (Run(name, KINDS["go"] if name == "go" else Kind(), None) for name in ("go", "a", "b"))
    assert lives.choose(first, lambda: True, own=False) == ((Order.BEGIN, first),)
    lives.keep(first)
    assert lives.choose(second, lambda: True, own=False) == ((Order.CANCEL, first),)
    assert lives.choose(third, lambda: True, own=False) == ()
    assert (lives.skipped, lives.pending) == (1, third)
    assert lives.end(first)
    assert lives.next() is third
    assert not lives.end(first)
