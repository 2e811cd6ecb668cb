"""What is asked of agents from elsewhere."""

from __future__ import annotations

import asyncio

import msgspec
import pytest
from sentences import refused
from team_robots import Robot, over_beliefs, started

import mdm
from mdm import problems
from mdm.team.sharing.calls import CALLS, ask
from mdm.team.sharing.commanding import COMMANDS, command
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_agents_tell_how_they_are_and_do_what_is_asked(mode):
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = Team("tigers", ["left", "right"], mode=mode)
        left, right = await started(runtime, team, network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(0.5)
        asker = network.transport("console")
        await asker.open()
        status = await ask(asker, team, "status")
        assert list(status) == ["left", "right"]
        assert status["left"]["mode"] == status["right"]["mode"] == "deciding"
        assert status["left"]["role"] == "leading"
        assert status["right"]["leader"] == "left"
        assert status["left"]["digest"] == status["right"]["digest"]
        assert status["left"]["live"] == ["left", "right"]
        assert status["left"]["action"] == "listen listen"
        assert await ask(asker, team, "stop", agent="right") == {"right": "done"}
        await asyncio.sleep(0.5)
        assert left.ensemble.mode == right.ensemble.mode == "stopped"
        await ask(asker, team, "start", agent="left")
        await asyncio.sleep(0.5)
        assert left.ensemble.mode == right.ensemble.mode == "deciding"
        for call in CALLS:
            answers = await ask(asker, team, call)
            assert list(answers) == ["left", "right"]
            assert not any(isinstance(answer, Exception) for answer in answers.values())
        statistics = await ask(asker, team, "statistics", agent="left")
        assert statistics["left"]["control"]["decisions"] >= 2
        wiring = await ask(asker, team, "wiring", agent="left")
        assert wiring["left"]["factors"] == {"agent0": "left", "agent1": "right"}
        versions = await ask(asker, team, "versions")
        assert versions["left"] == versions["right"]
        with refused(mdm.Error):
            await ask(asker, team, "dance")
        with refused(mdm.Error):
            await ask(asker, team, "status", agent="console")
        assert await ask(asker, team, "status", ensemble="other") == {}
        await asker.close()

    run_virtual(main)


def test_who_is_gone_does_not_answer():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = Team("tigers", ["left", "right"])
        await started(runtime, team, network, over_beliefs(problems.dec_tiger()))
        network.crash("left")
        asker = network.transport("console")
        await asker.open()
        assert list(await ask(asker, team, "status")) == ["right"]

    run_virtual(main)


def test_who_is_refused_by_its_team_says_so():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        build = over_beliefs(problems.dec_tiger())
        left, right = Team("tigers", ["left", "right"]), Team("tigers", ["left", "right"], max_age=7.0)
        asks = (await Robot(left, "left", network, build).start(runtime)).member.link.transport
        await asyncio.sleep(2.0)
        await Robot(right, "right", network, build).start(runtime)
        await asyncio.sleep(2.0)
        for call in ("start", "reset"):
            answer = (await ask(asks, left, call, agent="right", ensemble="joint"))["right"]
            assert "takes no part in the team" in str(answer)
        assert await ask(asks, left, "stop", agent="right", ensemble="joint") == {"right": "done"}

    run_virtual(main)


class Answering:
    """A transport on which each agent answers what it is told to."""

    def __init__(self, answer):
        self.answer = msgspec.json.encode(answer)

    async def ask(self, *_, **__):
        return dict.fromkeys(("left", "right"), self.answer)


STATUS = {"ensemble": "joint", "mode": "stopped", "causes": [], "live": ["left", "right"]}
NONE = [
    {},
    [],
    ["result"],
    {"error": 7},
    {"result": 7},
    {"result": []},
    *({"result": {key: value for key, value in STATUS.items() if key != left}} for left in STATUS),
    *({"result": STATUS | {key: value}} for key in (*STATUS, "commands") for value in (None, 7, [7], [[]], {"x": 7})),
    {"result": STATUS | {"clocks": {"left": 7}}},
]


@pytest.mark.parametrize("call", sorted(COMMANDS))
def test_what_is_no_status_ends_no_command(call):
    """Who was asked may be forged, or another version: the others are told all the same, and it is named."""
    team = Team("tigers", ["left", "right"])

    async def told(answer):
        found = await command(Answering(answer), team, call, ensemble="joint", seconds=0.001)
        return [(one.agent, one.confirmed) for one in found]

    async def main():
        return await asyncio.gather(told({"result": STATUS}), *map(told, NONE))

    sound, *others = asyncio.run(main())
    assert sound == [("left", call != "start"), ("right", call != "start")]
    assert others == [[("left", False), ("right", False)]] * len(NONE)


@pytest.mark.parametrize("call", ["status", "statistics"])
def test_what_is_no_answer_is_an_error_of_that_agent(call):
    async def main():
        return [await ask(Answering(answer), Team("tigers", ["left", "right"]), call) for answer in NONE]

    for found in asyncio.run(main()):
        assert [type(found[agent]) for agent in ("left", "right")] == [mdm.Error] * 2


@pytest.mark.parametrize(
    ("call", "mode"), [("stop", "deciding"), ("stop", "safe"), ("start", "stopped"), ("release", "safe")]
)
def test_who_is_not_what_it_was_to_be_has_not_confirmed(call, mode):
    """Not even where it has answered that it is done."""
    team, answer = Team("tigers", ["left", "right"]), {"result": STATUS | {"mode": mode}}
    told = asyncio.run(command(Answering(answer), team, call, ensemble="joint", seconds=0.001))
    assert [(one.confirmed, one.problem) for one in told] == [(False, f"it is {mode}")] * 2


@pytest.mark.parametrize(("knows", "waits"), [(1, False), (2, True)])
def test_a_stop_is_over_when_all_that_one_sees_know_of_the_same(knows, waits):
    """A start that follows at another agent would be beaten by it, else."""

    class Knowing(Answering):
        asked = 0

        async def ask(self, *_, **__):
            self.asked += 1
            other = msgspec.json.encode({"result": STATUS | {"knows": knows if self.asked < 6 else 1}})
            return {"left": self.answer, "right": other}

    async def main():
        transport = Knowing({"result": STATUS | {"knows": 1}})
        told = await command(transport, Team("tigers", ["left", "right"]), "stop", ensemble="joint", seconds=30.0)
        assert [one.confirmed for one in told] == [True, True]
        return transport.asked

    assert (asyncio.run(main()) >= 6) is waits
