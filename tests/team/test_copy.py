"""Copies of a joint process: parts put together, what is kept, and what two copies have in common."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import msgspec
import pytest
from sentences import refused
from team_robots import over_beliefs, over_states

import mdm
from mdm import problems
from mdm.messages import Observation, State
from mdm.team.copy import BEGIN, Copy
from mdm.team.ownership import Ownership
from mdm.team.team import Team
from mdm.testing import probe, run_virtual


class Lead:
    absence = ""

    def command(self, command):
        pass


async def copied(runtime, team, build, agent=0, **options):
    robot = SimpleNamespace(act=lambda name: lambda: None)
    ensemble = build(robot, agent, **options)
    ownership = Ownership(team, ensemble)
    process = ensemble.follow(Lead(), ownership.named(team.names[agent]))
    copy = Copy(team, team.names[agent], ensemble, process, ownership)
    await runtime.start(ensemble)
    return copy, ensemble


def of_tigers(**options):
    return Team("tigers", ["left", "right"], **options), over_beliefs(problems.dec_tiger(), **options)


def in_turn(ensemble, function, *arguments):
    ensemble.call_later(1e-9, lambda: function(*arguments))
    return asyncio.sleep(0.001)


def test_parts_are_put_together_and_decided_on_in_the_same_call():
    async def main(runtime):
        team, build = of_tigers()
        copy, ensemble = await copied(runtime, team, build)
        heard = probe(ensemble.channel("observation", Observation))
        assert not ensemble.control.running
        await in_turn(ensemble, copy.command, BEGIN, 0)
        assert ensemble.control.running
        assert copy.begun

        def both():
            copy.step({"left": copy.part(5, [1]), "right": copy.part(6, [0])}, (), 7)
            assert ensemble.controller.epoch == 2

        await in_turn(ensemble, both)
        await in_turn(ensemble, copy.step, {"right": copy.part(6, [0])}, ("left",), 8)
        await in_turn(ensemble, copy.step, {}, (), 9)
        assert [(o.time, o.index, o.values, o.mask) for o in heard] == [
            (7, 2, (1, 0), (True, True)),
            (8, None, (None, 0), (False, True)),
            (9, None, (None, None), (False, False)),
        ]
        assert ensemble.controller.epoch == 4
        assert copy.named({"left": copy.part(5, [1])}) == {"left": "hear-right"}

    run_virtual(main)


def test_two_copies_with_the_same_steps_are_the_same_and_one_can_become_the_other():
    async def main(runtime):
        team, build = of_tigers()
        one, first = await copied(runtime, team, build)
        two, second = await copied(SimpleNamespace(start=runtime.start), team, named(build, "other"), agent=1)
        assert one.digest() == two.digest()
        assert one.facts == two.facts
        for copy, ensemble in ((one, first), (two, second)):
            await in_turn(ensemble, copy.command, BEGIN, 0)
            await in_turn(ensemble, copy.step, {"left": one.part(1, [1])}, (), 2)
        assert one.digest() == two.digest()
        await in_turn(first, one.step, {"left": one.part(1, [1])}, (), 3)
        assert one.digest() != two.digest()
        two.restore(one.snapshot())
        assert one.digest() == two.digest()
        with refused(mdm.ModelError):
            two.restore(b"garbage")
        assert one.digest() == two.digest()

    run_virtual(main)


FORGED = (
    -(2**63),
    -1,
    1,
    7,
    2**62 - 1,
    2**62,
    2**64 - 1,
    None,
    True,
    "x",
    [],
    [None],
    [7, 7],
    [["x", 1]],
    [["a", "b"]],
    b"",
    1.5,
)


@pytest.mark.parametrize("takes", ["observations", "states"])
def test_whatever_a_snapshot_says_it_is_refused_or_gone_on_from(takes):
    """It may be forged: each field is replaced by what no copy holds, at each level."""

    async def main(runtime):
        team, build = of_tigers() if takes == "observations" else (Team("rooms", ["a", "b"]), over_states)
        copy, ensemble = await copied(runtime, team, build)
        names = team.names
        await in_turn(ensemble, copy.command, BEGIN, 0)
        await in_turn(ensemble, copy.step, {names[0]: copy.part(1, [1]), names[1]: copy.part(2, [0])}, (), 2)
        await in_turn(ensemble, copy.step, {names[0]: copy.part(3, [1])}, (names[1],), 4)
        whole, digest, refused, taken = copy.snapshot(), copy.digest(), 0, 0
        for snapshot in forged(whole):
            copy.restore(whole)
            try:
                copy.restore(snapshot)
            except mdm.ModelError:
                refused += 1
                assert copy.digest() == digest
                continue
            taken += 1
            await in_turn(ensemble, copy.step, {names[0]: copy.part(5, [1])}, (names[1],), 6)
            await in_turn(ensemble, copy.step, {names[1]: copy.part(7, [0])}, (names[0],), 8)
            copy.restore(copy.snapshot())  # which those who come later are sent
        assert refused > 5 * taken

    run_virtual(main)


def forged(snapshot, depth=2):
    """Yield snapshots of which one field was replaced, of the control layer's and the controller's, too."""
    fields = msgspec.msgpack.decode(snapshot)
    for place, held in enumerate(fields):
        inner = forged(held, depth - 1) if depth and isinstance(held, bytes) else ()
        for value in (*FORGED, *inner):
            yield msgspec.msgpack.encode([*fields[:place], value, *fields[place + 1 :]])


def named(build, name):
    def other(robot, agent, **options):
        ensemble = build(robot, agent, **options)
        ensemble.name = name
        return ensemble

    return other


@pytest.mark.parametrize("body", [b"", b"\xc1", b"\x92\x01\x91\x07", b"\x92\x01\x92\x00\x00", b"\x92\x01\xa1x"])
def test_what_is_no_part_of_an_agent_counts_as_missing(body):
    async def main(runtime):
        team, build = of_tigers()
        copy, ensemble = await copied(runtime, team, build)
        heard = probe(ensemble.channel("observation", Observation))
        await in_turn(ensemble, copy.command, BEGIN, 0)
        await in_turn(ensemble, copy.step, {"left": body, "right": copy.part(1, [0])}, (), 1)
        assert heard[-1].values == (None, 0)
        assert copy.malformed == 1
        assert "left" not in copy.named({"left": body})

    run_virtual(main)


@pytest.mark.parametrize("build", [over_beliefs(problems.dec_tiger()), over_states])
def test_a_part_of_an_agent_that_the_team_has_not_is_none(build):
    async def main(runtime):
        team = Team("rooms", ["a", "b"])
        copy, ensemble = await copied(runtime, team, build)
        await in_turn(ensemble, copy.command, BEGIN, 0)
        await in_turn(ensemble, copy.step, {"c": copy.part(1, ())}, ("d",), 2)
        assert copy.malformed == 1
        assert copy.named({"c": copy.part(1, ())}) == {}

    run_virtual(main)


def test_idle_and_held_symbols_stand_for_agents_that_are_there_and_see_nothing():
    async def main(runtime):
        team = Team("tigers", ["left", "right"])
        manager = mdm.PredicateManager()
        for name in ("L0", "L1", "R0", "R1"):
            manager.event(name)
        factors = [
            mdm.ObservationFactor("agent0", ["L0", "L1"], idle="L1"),
            mdm.ObservationFactor("agent1", ["R0", "R1"], hold=True),
        ]
        build = over_beliefs(problems.dec_tiger(), predicates=manager, observations=factors)
        copy, ensemble = await copied(runtime, team, build)
        heard = probe(ensemble.channel("observation", Observation))
        await in_turn(ensemble, copy.command, BEGIN, 0)
        await in_turn(ensemble, copy.step, {"right": copy.part(1, [0])}, (), 1)
        await in_turn(ensemble, copy.step, {"left": copy.part(1, [0])}, (), 1)
        await in_turn(ensemble, copy.step, {"left": copy.part(1, [0])}, ("right",), 1)
        await in_turn(ensemble, copy.step, {"right": copy.part(1, [1])}, ("left",), 1)
        await in_turn(ensemble, copy.step, {}, (), 1)
        assert [o.values for o in heard] == [(1, 0), (0, 0), (0, None), (None, 1), (None, None)]

    run_virtual(main)


def test_the_last_state_of_who_is_missing_counts_for_a_while():
    second = 1_000_000_000

    async def main(runtime):
        team = Team("rooms", ["a", "b"], max_age=2.0)
        copy, ensemble = await copied(runtime, team, over_states)
        heard = probe(ensemble.channel("state", State, retain=True))
        await in_turn(ensemble, copy.command, BEGIN, 0)
        await in_turn(ensemble, copy.step, {"a": copy.part(0, [0]), "b": copy.part(0, [1])}, (), 1)
        await in_turn(ensemble, copy.step, {"a": copy.part(9 * second, [1])}, ("b",), 2)
        assert copy.aging
        assert copy.last_values("b") == (1,)
        await in_turn(ensemble, copy.step, {"a": copy.part(11 * second, [0])}, ("b",), 3)
        await in_turn(ensemble, copy.step, {"a": copy.part(12 * second, [0])}, ("b",), 4)
        assert copy.last_values("b") == (None,)
        assert not copy.aging
        await in_turn(ensemble, copy.step, {"a": copy.part(13 * second, [0])}, (), 5)
        assert [state.values for state in heard] == [(0, 1), (1, 1), (0, 1), (0, None), (0, 1)]

    run_virtual(main)


def test_how_long_a_last_state_counts_does_not_hang_on_clocks_that_differ():
    async def main(runtime):
        copy, ensemble = await copied(runtime, Team("rooms", ["a", "b"], period=0.5, max_age=2.0), over_states)
        states = probe(ensemble.channel("state", State, retain=True))
        await in_turn(ensemble, copy.command, BEGIN, 0)
        second, hour = 10**9, 3600 * 10**9
        await in_turn(ensemble, copy.step, {"a": copy.part(0, [0]), "b": copy.part(hour, [1])}, (), 0)
        for time in range(1, 4):
            await in_turn(ensemble, copy.step, {"a": copy.part(time * second, [0])}, ("b",), 0)
        assert states[-1].values == (0, 1)
        await in_turn(ensemble, copy.step, {"a": copy.part(4 * second, [0])}, ("b",), 0)
        assert states[-1].values == (0, None)

    run_virtual(main)
