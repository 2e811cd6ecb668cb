"""The proposals of an agent, searched exhaustively with a controller, losses, and lives of the controller.

The controller is written anew here, from what is promised: it takes each number once, a stop or hold bars what was
asked for by an agent that did not know of it, and a start counts else.
"""

from __future__ import annotations

import copy

import pytest

from mdm.team.centralised.proposals import Proposals


class Controller:
    """A controller, as its agent sees it."""

    def __init__(self, life):
        self.life, self.step, self.running = life, 1, True
        self.taken, self.bar, self.barred, self.started = 0, (0, 0), 0, 1

    def take(self, proposal):
        if proposal.number <= self.taken:
            return
        self.taken = proposal.number
        if proposal.command in {"stop", "hold"}:
            self.step += 1
            self.barred, self.bar = self.step, (proposal.number, self.step)
            self.running = self.running and proposal.command == "hold"
        elif proposal.command == "start" and proposal.life == self.life and proposal.step >= self.barred:
            self.step += 1
            self.started, self.running = self.step, True

    def decision(self):
        return self.life, self.step, self.taken, self.bar, self.running, self.started


class World:
    """An agent, its controller, what is under way, and what a person asked for at the agent, in order."""

    def __init__(self, faults):
        self.agent, self.controller = Proposals(replace=False), Controller(1)
        self.line, self.life, self.faults = [], 1, faults
        self.asked, self.heard = [], False
        self.agent.follow(1, "none")
        self.deliver(self.controller.decision())

    def deliver(self, decision):
        life, step, taken, bar, running, started = decision
        if life != self.life:
            self.life = life
            self.agent.follow(life, "lost")
        self.agent.acknowledge(taken, bar[0])
        self.agent.settle(step, bar, running=running, started=started)
        self.heard = True

    def ask(self, command):
        pending = self.agent.ask(command, f"{command}{len(self.asked)}", reachable=self.heard)
        if command == "stop":
            self.asked = [*self.asked, "stop"]
        elif pending:
            self.asked = [*self.asked, "start"]

    def key(self):
        agent, controller = self.agent, self.controller
        waiting = tuple((each.number, each.command, each.life, each.step) for each in agent._waiting)
        return (
            waiting, agent._number, agent._life, agent._step, agent._told, agent._since, agent.stop.name,
            tuple(self.line), self.life, self.faults, tuple(self.asked), self.heard,
            *controller.decision(), controller.barred,
        )  # fmt: skip

    def after(self):
        """Yield every world that may be next."""
        for command in ("start", "stop"):
            if len(self.asked) < 3:
                world = copy.deepcopy(self)
                world.ask(command)
                yield world
        if self.agent.first is not None:
            world = copy.deepcopy(self)  # what is pending arrives, and perhaps again later on
            world.controller.take(world.agent.first)
            world.line = [*world.line[-1:], world.controller.decision()]
            yield world
        if self.line:
            world = copy.deepcopy(self)
            world.deliver(world.line.pop(0))
            yield world
            if self.faults:
                world = copy.deepcopy(self)
                world.line.pop(0)
                world.faults -= 1
                yield world
        if self.faults:
            world = copy.deepcopy(self)
            world.faults -= 1
            world.controller = Controller(self.controller.life + 1)
            world.line = [world.controller.decision()]
            yield world
        if self.faults and self.heard:
            world = copy.deepcopy(self)  # the controller is not heard for a while
            world.faults -= 1
            world.heard, world.line = False, []
            world.agent.leave("lost")
            yield world

    def settle(self):
        """Have all that is pending arrive, and all decisions; return the world at rest."""
        world = copy.deepcopy(self)
        for _ in range(30):
            if world.agent.first is not None:
                world.controller.take(world.agent.first)
            world.deliver(world.controller.decision())
        return world


def check(world):
    asked = world.asked
    if "stop" in asked and "start" not in asked[len(asked) - 1 - asked[::-1].index("stop") :]:
        assert world.agent.still, "an agent acts that was stopped, and was asked for no start since"
    rest = world.settle()
    assert rest.agent.first is None, "what is pending is never acknowledged"
    assert rest.agent.settled, "the controller never knows of the stop"
    if not asked:
        assert not rest.agent.still


@pytest.mark.parametrize(("faults", "states"), [(0, 416), (1, 3185)])
def test_no_agent_that_was_stopped_acts_before_a_start_and_all_is_acknowledged_in_the_end(faults, states):
    first = World(faults)
    seen, queue = {first.key()}, [first]
    while queue:
        world = queue.pop()
        check(world)
        for after in world.after():
            key = after.key()
            if key not in seen:
                seen.add(key)
                queue.append(after)
    assert len(seen) == states


def test_a_stop_is_told_anew_to_another_life_of_the_controller():
    proposals = Proposals(replace=False)
    proposals.follow(1, "none")
    proposals.settle(1, (0, 0), running=True, started=1)
    assert proposals.ask("stop", "a", reachable=True)
    proposals.follow(2, "lost")
    assert proposals.void == [("a", "lost")]
    proposals.settle(1, (0, 0), running=True, started=1)
    assert (proposals.first.command, proposals.first.number, proposals.still) == ("hold", 2, True)
    proposals.acknowledge(2, 2)
    proposals.settle(2, (2, 2), running=True, started=1)
    assert proposals.settled
    assert proposals.still
    proposals.settle(3, (2, 2), running=True, started=3)
    assert not proposals.still


def test_who_speaks_in_its_name_takes_no_command_away():
    proposals = Proposals(replace=False)
    proposals.ask("stop", "a", reachable=True)
    proposals.acknowledge(1, 0)  # as a part that another has sent under that number
    assert (proposals.first.number, proposals.first.command) == (2, "stop")
    proposals.observe(b"later")
    proposals.acknowledge(40, 2)
    assert proposals.first.number == 41


@pytest.mark.parametrize(("replace", "expected"), [(True, [b"0", b"99"]), (False, 64)])
def test_what_is_too_much_is_replaced_or_counted(replace, expected):
    proposals = Proposals(replace=replace)
    for number in range(100):
        proposals.observe(str(number).encode())
    waiting = [each.part for each in proposals._waiting]
    assert waiting == expected if replace else (len(waiting), proposals.dropped) == (expected, 36)
    assert waiting[0] == b"0"
